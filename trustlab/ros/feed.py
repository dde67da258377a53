"""From messages to the decision core: the same for a robot's node and for the replay of a run."""

import math
from dataclasses import dataclass, field
from typing import Any

from trustlab.ros.core import AHEAD, AllocationCore
from trustlab.ros.run import CLOCK, NOTE, RunSettings

# What the node notes last: a run without it was cut off.
END = "the run ends"


@dataclass
class Feed:
    """
    Hands messages on topics to a core.

    The run's own clock starts at `start` [ns] of the computer's and goes on with its processor, so
    that it never steps; what the computer's clock is ahead of it stands on a topic of the run.
    """

    run: RunSettings
    core: AllocationCore
    start: int
    ahead: int = 0
    ended: bool = False
    apart: bool = False
    down: dict[str, bool] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)

    def seconds(self, now: int) -> float:
        """Return a time of the run's clock since the start [s]."""
        return (now - self.start) / 1e9

    def hear(self, topic: str, message: Any, now: int) -> list[str]:
        """Hand a message on and return the names of the inputs that took it over."""
        if topic == CLOCK:
            step = (message.data - self.ahead) / 1e9
            if abs(step) > AHEAD:
                self.core.rest(f"the computer's clock steps by {step:.3g} s")
            self.ahead = message.data
        elif topic == NOTE:
            self.ended = message.data == END
            if not self.ended:
                self.core.note(message.data)
        return [
            name
            for name, source in self.run.topics.items()
            if source.topic == topic and self._taken(name, message, now)
        ]

    def _taken(self, name: str, message: Any, now: int) -> bool:
        source = self.run.topics[name]
        try:
            numbers = source.numbers(message)
        except ValueError as error:
            self.core.note(f"{name}: {error}")
            return False
        if name not in self.core.inputs:
            self._press(name, numbers[0] >= 0.5)
            return False
        frame = getattr(getattr(message, "header", None), "frame_id", "")
        if frame != self.frames.setdefault(name, frame):
            self.core.note(f"{name}: in frame {frame!r}, before in {self.frames[name]!r}")
            self.frames[name] = frame
        if name == "path_error" and len(numbers) == 2:  # of a reference: its distance
            place = self.core.inputs["odometry"].values
            if place is None:
                return False
            other = self.frames["odometry"]
            if frame and other and frame != other and not self.apart:
                self.apart = True
                self.core.note(f"{name}: in frame {frame!r}, odometry in {other!r}")
            numbers = (math.dist(place, numbers),)
        return self.core.hear(name, self.stamp(name, message, now), numbers, self.seconds(now))

    def stamp(self, name: str, message: Any, now: int) -> float:
        """Return when an input's message was measured, by its header or its arrival [s]."""
        header = getattr(message, "header", None)
        if header is not None and self.run.topics[name].stamp == "header":
            now = header.stamp.sec * 10**9 + header.stamp.nanosec - self.ahead
        return self.seconds(now)

    def _press(self, name: str, down: bool) -> None:
        """Act when a button is pressed or, of the one that chooses the mode, moved."""
        before = self.down.get(name)
        self.down[name] = down
        if down == before:
            return
        if name == "button":
            self.core.press(int(down))
        elif down and name == "stop":
            self.core.stop()
        elif down and not self.down.get("stop"):  # a stop that is held down is not released
            self.core.release()
