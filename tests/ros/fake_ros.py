"""
A stand-in for rclpy in one process, with a clock that the test turns: nodes, publishers and
subscriptions are plain objects, messages and their CDR are those of rosbags. It shows what the
package does with messages; that ROS brings them is shown by `test_over_dds.py`.
"""

import sys
import types
from collections import defaultdict
from types import SimpleNamespace

from rosbags.typesys import Stores, get_typestore

from tests.sessions.logs import message

STORE = get_typestore(Stores.ROS2_HUMBLE)
STEP = 50_000_000  # period of a run [ns]
PACKAGES = ("std_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs")


class Kind:
    def __init__(self, name):
        self.name = name

    def __call__(self, **values):
        made = message(STORE, self.name)
        for name, value in values.items():
            setattr(made, name, value)
        return made


def serialize(made):
    return bytes(STORE.serialize_cdr(made, made.__msgtype__))


def install(monkeypatch):
    """Put the stand-in where `import rclpy` and the message packages look."""
    modules = {"rclpy": types.ModuleType("rclpy")}
    modules["rclpy.clock"] = SimpleNamespace(
        Clock=SimpleNamespace, ClockType=SimpleNamespace(STEADY_TIME="steady")
    )
    modules["rclpy.qos"] = SimpleNamespace(
        QoSProfile=SimpleNamespace,
        ReliabilityPolicy=SimpleNamespace(BEST_EFFORT="best effort", RELIABLE="reliable"),
    )
    modules["rclpy.serialization"] = SimpleNamespace(
        serialize_message=serialize,
        deserialize_message=lambda data, kind: STORE.deserialize_cdr(data, kind.name),
    )
    for package in PACKAGES:
        names = [n for n in STORE.types if n.startswith(f"{package}/msg/")]
        kinds = {name.rpartition("/")[2]: Kind(name) for name in names}
        modules[package] = types.ModuleType(package)
        modules[f"{package}.msg"] = SimpleNamespace(**kinds)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)


class Node:
    """A node whose time [ns] the test turns; `ahead` is how far its computer's clock is stepped."""

    def __init__(self):
        self.time = 1_700_000_000_000_000_000
        self.ahead = 0
        self.senders = 1
        self.sent = defaultdict(list)
        self.heard = {}
        self.profiles = {}
        self.timers = []
        self.log = []

    def get_clock(self):
        clock = SimpleNamespace(nanoseconds=self.time + self.ahead)
        return SimpleNamespace(now=lambda: clock)

    def count_publishers(self, topic):
        return self.senders

    def get_logger(self):
        return SimpleNamespace(warning=self.log.append, error=self.log.append)

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=self.sent[topic].append)

    def create_subscription(self, kind, topic, callback, profile, raw):
        assert raw
        self.heard[topic] = kind, callback
        self.profiles[topic] = profile

    def create_timer(self, period, callback, clock):
        assert clock.clock_type == "steady"
        self.timers.append(callback)
        return callback

    def destroy_timer(self, timer):
        self.timers.remove(timer)

    def send(self, topic, stamp=None, **values):
        """Deliver a message; values by dotted field path, with __ for the dots."""
        kind, callback = self.heard[topic]
        made = kind()
        for path, value in values.items():
            part = made
            *steps, name = path.split("__")
            for step in steps:
                part = getattr(part, step)
            setattr(part, name, value)
        if stamp is not None:
            made.header.stamp.sec, made.header.stamp.nanosec = divmod(stamp, 10**9)
        callback(serialize(made))

    def tick(self, period=STEP):
        self.time += period
        for callback in self.timers:
            callback()
