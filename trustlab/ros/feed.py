"""From messages to the decision core: the same for a robot's node and for the replay of a bag."""

import math
from typing import Any

from trustlab.ros.decision import AllocationCore
from trustlab.ros.inputs import FIELDS
from trustlab.ros.run import RunSettings


class Feed:
    """Hands messages on topics to a core; times count from `start` [ns]."""

    def __init__(self, run: RunSettings, core: AllocationCore, start: int):
        self.run = run
        self.core = core
        self.start = start
        self.down: dict[str, bool] = {}
        self.names: dict[str, list[str]] = {}
        for name, topic in run.topics.items():
            if name != "command":
                self.names.setdefault(topic.topic, []).append(name)

    def seconds(self, stamp: int) -> float:
        """Return a time since the start [s]."""
        return (stamp - self.start) / 1e9

    def hear(self, topic: str, message: Any, now: int) -> list[str]:
        """Hand a message on and return the names of the inputs that took it over."""
        accepted = []
        for name in self.names[topic]:
            source = self.run.topics[name]
            try:
                numbers = source.numbers(message)
            except ValueError as error:
                self.core.note(f"{name}: {error}")
                continue
            if name not in FIELDS:
                self._press(name, numbers[0] >= 0.5)
                continue
            if len(numbers) > len(FIELDS[name]):  # of a reference: the path error is its distance
                place = self.core.inputs["odometry"].values
                if place is None:
                    continue
                numbers = (math.dist(place, numbers),)
            stamp = self.seconds(source.stamped(message, now))
            if self.core.hear(name, stamp, numbers, self.seconds(now)):
                accepted.append(name)
        return accepted

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
