"""The allocation rule in a ROS 2 node: topics in, the command out, a log of all of it."""

import json
import queue
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from time import monotonic_ns
from typing import Any

from trustlab.live.log import Log
from trustlab.ros.core import AHEAD, Decision
from trustlab.ros.recorded import END, LOG, Feed, RobotRun, finish_run, log_entry, typestore
from trustlab.ros.run import CLOCK, NOTE, RUN, STATES, RunSettings

# Samples missing are made up for, step by step, up to this gap [s]; a note names a longer one.
MOST_MADE_UP = 1.0
# What the computer's clock is ahead is recorded when it changed by so much [ns].
SLEW = 1_000_000


class Recorder:
    """
    Writes messages to a log in a thread of its own, so that nobody waits for the disk.

    A fault of the disk ends the log; `report` is called with it, in that thread.
    """

    def __init__(self, path: Path, report: Callable[[str], None]):
        if path.exists():
            raise FileExistsError(f"{path} is there already: of another run")
        self.log = Log(path)
        self.report = report
        self.queue = queue.SimpleQueue()
        self.thread = threading.Thread(target=self._write, name="log", daemon=True)
        self.thread.start()

    def write(self, topic: str, now: int, data: bytes) -> None:
        """Append a message."""
        if self.thread.is_alive():
            self.queue.put((topic, now, data))

    def _write(self) -> None:
        ended = False
        try:
            while not ended:
                messages = [self.queue.get()]
                while not self.queue.empty():
                    messages.append(self.queue.get())
                ended = None in messages
                self.log.append(log_entry(*message) for message in messages if message)
        except OSError as error:
            self.report(f"{self.log.path}: recording ends here, {error.strerror or error}")
        self.log.close()

    def close(self) -> None:
        """Wait until everything is on the disk."""
        self.queue.put(None)
        self.thread.join()


class Allocation:
    """
    The allocation rule in a node of your own.

    A step follows each odometry message or, where none comes, the node's timer. The command goes
    out first, then mode, TSC, suggestion and thresholds as std_msgs/Float64 on /allocation/mode
    and so on. A thread writes every message to a log, from which `finish` makes the bag and the
    session. Time is counted by the processor: a step of the computer's clock stops the robot for
    one period and is noted. Faults are warnings of the node's logger and notes of the session.

    Parameters
    ----------
    node : rclpy.node.Node
        The node; it must be spun by one thread.
    run : RunSettings
        What to do.
    path : path-like
        The bag to come; until `finish` its log stands there, with the suffix .jsonl.

    Raises
    ------
    ValueError
        If there is no message of a type, or it is none of ROS 2 Humble.
    FileExistsError
        If there is such a log already.
    """

    def __init__(self, node: Any, run: RunSettings, path: str | Path):
        from rclpy.clock import Clock, ClockType
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        self.node = node
        self.run = run
        self.core = run.core()
        self.latest: Decision | None = None
        self.due: float | None = None
        self.noted = 0
        self.senders = 1
        known = typestore().types
        for topic, kind in run.types().items():
            if kind not in known:
                raise ValueError(
                    f"{topic}: {kind} is no message of ROS 2 itself, so that the run could not be "
                    "read; send one that is"
                )
        self.classes = {topic: _class(kind) for topic, kind in run.types().items()}
        *inputs, self.command = run.topics.values()
        # Refuses a type without the fields, before anything is sent.
        self.command.numbers(self.classes[self.command.topic]())
        self.recorder = Recorder(Path(path).with_suffix(LOG), node.get_logger().error)
        self.began = monotonic_ns()
        self.last = node.get_clock().now().nanoseconds
        self.feed = Feed(run, self.core, self.last)
        self._record(RUN, data=json.dumps(run.tables()))
        self.publishers = {
            topic: node.create_publisher(self.classes[topic], topic, 1)
            for topic in (self.command.topic, *STATES)
        }
        for topic, best_effort in {each.topic: each.best_effort for each in inputs}.items():
            policy = ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE
            profile = QoSProfile(depth=50, reliability=policy)
            heard = partial(self._heard, topic)
            node.create_subscription(self.classes[topic], topic, heard, profile, raw=True)
        # Steady: a timer of the computer's clock would wait out an hour that the clock steps back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.timer = node.create_timer(run.settings.period, self._tick, clock=steady)

    def _now(self) -> int:
        """Return the run's clock [ns]; where the computer's stepped, stop the robot."""
        clock = self.node.get_clock()
        time = clock.now().nanoseconds
        if getattr(clock, "ros_time_is_active", False):  # a simulator's, which may stand still
            now = time - self.feed.ahead
        else:
            now = self.feed.start + monotonic_ns() - self.began
        self.last = max(self.last + 1, now)
        ahead = time - self.last
        step = abs(ahead - self.feed.ahead)
        if step > SLEW:
            self._record(CLOCK, data=ahead)
            if step > AHEAD * 1e9:
                self._send(0.0, 0.0)
        return self.last

    def _record(self, topic: str, message: Any = None, **values: Any) -> None:
        """Record a message; one about the run itself, made of values, is heard, too."""
        from rclpy.serialization import serialize_message

        if message is None:
            message = self.classes[topic](**values)
            self.feed.hear(topic, message, self.last)
        self.recorder.write(topic, self.last, serialize_message(message))

    def _heard(self, topic: str, data: bytes) -> None:
        from rclpy.serialization import deserialize_message

        now = self._now()
        self.recorder.write(topic, now, data)
        message = deserialize_message(data, self.classes[topic])
        stopped = self.core.stopped
        if "odometry" in self.feed.hear(topic, message, now):
            self._sampled(self.feed.stamp("odometry", message, now), now)
        elif self.core.stopped and not stopped:
            self._send(0.0, 0.0)  # the next step may be a period away

    def _sampled(self, stamp: float, now: int) -> None:
        """Step for the sample that an odometry message is, and for those missing before it."""
        half = 0.5 * self.run.settings.period
        if self.due is None:
            self.due = stamp
        elif stamp > self.due + MOST_MADE_UP:
            self._record(NOTE, data=f"gap: no sample for {stamp - self.due:.3g} s")
            self.due = stamp
        while stamp > self.due + half:
            self._step(now)
        if stamp >= self.due - half:
            self._step(now)

    def _tick(self) -> None:
        """Step where odometry is missing, so that watchdogs act; look for others who command."""
        now = self._now()
        senders = self.node.count_publishers(self.command.topic)
        if senders > self.senders:
            self._record(NOTE, data=f"command: {senders} publishers send it, not this one alone")
        self.senders = max(senders, 1)
        if (
            self.due is not None
            and self.feed.seconds(now) > self.due + 2 * self.run.settings.period
        ):
            self._step(now)

    def _step(self, now: int) -> None:
        decision = self.core.step(self.feed.seconds(now))
        self._record(self.command.topic, self._send(*self.core.command))
        for topic, name in STATES.items():
            state = self.classes[topic](data=float(getattr(decision, name)))
            self.publishers[topic].publish(state)
            self._record(topic, state)
        for _, text in self.core.notes[self.noted :]:
            self.node.get_logger().warning(text)
        self.noted = len(self.core.notes)
        self.latest = decision
        self.due += self.run.settings.period

    def _send(self, *values: float) -> Any:
        """Publish a command and return its message."""
        command = self.classes[self.command.topic]()
        self.command.fill(command, values)
        if hasattr(command, "header"):
            stamp = command.header.stamp
            stamp.sec, stamp.nanosec = divmod(self.last + self.feed.ahead, 10**9)
        self.publishers[self.command.topic].publish(command)
        return command

    def finish(self) -> RobotRun:
        """
        Stop the robot, and write the bag and, beside it, the session as .csv.

        Returns
        -------
        RobotRun

        Raises
        ------
        SessionError
            If fewer than two samples were logged; the bag then holds the messages alone.
        """
        self._send(0.0, 0.0)
        self.node.destroy_timer(self.timer)
        self._record(NOTE, data=END)
        self.recorder.close()
        return finish_run(self.recorder.log.path, self.run)


def _class(kind: str) -> Any:
    """Return the class of a type of messages, as "nav_msgs/msg/Odometry"."""
    try:
        return resolve_name(kind.replace("/msg/", ".msg:"))
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"there is no ROS message {kind}: {error}") from None
