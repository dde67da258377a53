"""The allocation rule in a ROS 2 node: topics in, the command out, a journal of all of it."""

import json
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from trustlab.ros.decision import Decision
from trustlab.ros.feed import Feed
from trustlab.ros.journal import Journal
from trustlab.ros.recorded import JOURNAL, RobotRun, finish_run
from trustlab.ros.run import RUN, STATES, RunSettings, Topic

# Samples missing are made up for, step by step, up to this gap [ns]; the notes name a longer one.
MOST_MADE_UP = 10**9


class Allocation:
    """
    The allocation rule in a node of your own.

    A step follows each odometry message or, where none comes, the node's timer. The command goes
    out first, then mode, TSC, suggestion and thresholds as std_msgs/Float64 on /allocation/mode
    and so on. A thread writes every message to a journal, from which `finish` makes the bag and the
    session. Faults of messages are warnings of the node's logger and notes of the session.

    Parameters
    ----------
    node : rclpy.node.Node
        The node; it must be spun by one thread.
    run : RunSettings
        What to do.
    path : path-like
        The bag to come; until `finish` its journal stands there, with the suffix .journal.

    Raises
    ------
    ValueError
        If there is no message of a type.
    FileExistsError
        If there is such a journal already.
    """

    def __init__(self, node: Any, run: RunSettings, path: str | Path):
        self.node = node
        self.run = run
        self.core = run.core()
        self.latest: Decision | None = None
        self.due: int | None = None
        self.last = 0
        self.noted = 0
        self.period = round(run.settings.period * 1e9)
        self.classes = {topic: _class(kind) for topic, kind in run.types().items()}
        self.journal = Journal(Path(path).with_suffix(JOURNAL), node.get_logger().error)
        self.feed = Feed(run, self.core, self._now())
        self._record(RUN, self.classes[RUN](data=json.dumps(run.tables())))
        sent = [run.topics["command"].topic, *STATES]
        self.publishers = {
            topic: node.create_publisher(self.classes[topic], topic, 1) for topic in sent
        }
        for names in self.feed.names.values():
            self._subscribe(run.topics[names[0]])
        self.timer = node.create_timer(run.settings.period, self._tick)

    def _subscribe(self, source: Topic) -> None:
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        policy = ReliabilityPolicy.BEST_EFFORT if source.best_effort else ReliabilityPolicy.RELIABLE
        profile = QoSProfile(depth=50, reliability=policy)
        heard = partial(self._heard, source.topic)
        kind = self.classes[source.topic]
        self.node.create_subscription(kind, source.topic, heard, profile, raw=True)

    def _now(self) -> int:
        """Return the time [ns], which does not go back."""
        self.last = max(self.last + 1, self.node.get_clock().now().nanoseconds)
        return self.last

    def _record(self, topic: str, message: Any) -> None:
        from rclpy.serialization import serialize_message

        self.journal.write(topic, self.last, serialize_message(message))

    def _heard(self, topic: str, data: bytes) -> None:
        from rclpy.serialization import deserialize_message

        now = self._now()
        self.journal.write(topic, now, data)
        message = deserialize_message(data, self.classes[topic])
        stopped = self.core.stopped
        if "odometry" in self.feed.hear(topic, message, now):
            self._sampled(self.run.topics["odometry"].stamped(message, now), now)
        elif self.core.stopped and not stopped:
            self._send(0.0, 0.0)  # the next step may be a period away

    def _sampled(self, stamp: int, now: int) -> None:
        """Step for the sample that an odometry message is, and for those missing before it."""
        if self.due is None:
            self.due = stamp
        elif stamp > self.due + MOST_MADE_UP:
            self.core.note(f"gap: no sample for {(stamp - self.due) / 1e9:.3g} s")
            self.due = stamp
        while stamp > self.due + self.period // 2:
            self._step(now)
        if stamp >= self.due - self.period // 2:
            self._step(now)

    def _tick(self) -> None:
        """Step where odometry is missing, so that watchdogs act."""
        now = self._now()
        if self.due is not None and now > self.due + 2 * self.period:
            self._step(now)

    def _step(self, now: int) -> None:
        decision = self.core.step(self.feed.seconds(now))
        command = self._send(decision.v, decision.w)
        self._record(self.run.topics["command"].topic, command)
        for topic, name in STATES.items():
            state = self.classes[topic](data=float(getattr(decision, name)))
            self.publishers[topic].publish(state)
            self._record(topic, state)
        for _, text in self.core.notes[self.noted :]:
            self.node.get_logger().warning(text)
        self.noted = len(self.core.notes)
        self.latest = decision
        self.due += self.period

    def _send(self, *values: float) -> Any:
        """Publish a command and return its message."""
        topic = self.run.topics["command"]
        command = self.classes[topic.topic]()
        if hasattr(command, "header"):
            command.header.stamp.sec, command.header.stamp.nanosec = divmod(self.last, 10**9)
        topic.fill(command, values)
        self.publishers[topic.topic].publish(command)
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
            If fewer than two samples were logged.
        """
        self._send(0.0, 0.0)
        self.node.destroy_timer(self.timer)
        self.journal.close()
        return finish_run(self.journal.path, self.run, interrupted=False)


def _class(kind: str) -> Any:
    """Return the class of a type of messages, as "nav_msgs/msg/Odometry"."""
    package, _, name = kind.partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"there is no ROS message {kind}: {error}") from None
