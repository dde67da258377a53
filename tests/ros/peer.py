"""
A robot and a person behind DDS by Cyclone alone: no ROS, another vendor, no code of the package.

    python peer.py robot,operator seconds log.csv
    python peer.py robot,operator,stop seconds log.csv stops.csv
    python peer.py hostile seconds log.csv commands.csv

The robot is a unicycle with a watchdog of 0.5 s. It writes time, applied v and w, the time from
odometry to the command that answers it, and the stamp that it sends [ns], each tick. Who stops
presses stop and release in turn, while the robot drives, and writes after how many seconds the
robot had heard 0. The hostile one sends from five seconds after the first command on what no
robot should, one fault of one topic after another; it writes time, v, w, topic and fault, and each
command into a second file.
"""

import math
import os
import random
import sys
from time import monotonic, sleep, time_ns

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PERIOD = 0.05
WATCHDOG = 0.5


def kind(name, fields, package="geometry_msgs"):
    """A type of messages as ROS 2 names it."""
    return make_idl_struct(name, f"{package}::msg::dds_::{name}_", fields)


XYZ = dict.fromkeys("xyz", float64)
Vector3, Point = kind("Vector3", XYZ), kind("Point", XYZ)
Quaternion = kind("Quaternion", dict.fromkeys("xyzw", float64))
Twist = kind("Twist", {"linear": Vector3, "angular": Vector3})
Pose = kind("Pose", {"position": Point, "orientation": Quaternion})
Time = kind("Time", {"sec": int32, "nanosec": uint32}, "builtin_interfaces")
Header = kind("Header", {"stamp": Time, "frame_id": str}, "std_msgs")
PoseStamped = kind("PoseStamped", {"header": Header, "pose": Pose})
Float64 = kind("Float64", {"data": float64}, "std_msgs")
Bool = kind("Bool", {"data": bool}, "std_msgs")
RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(50))


def writer(domain, name, kind):
    return DataWriter(domain, Topic(domain, f"rt/{name}", kind), qos=RELIABLE)


def write(file, *row):
    print(*row, sep=",", file=file, flush=True)


def twist(v, w):
    return Twist(Vector3(v, 0.0, 0.0), Vector3(0.0, 0.0, w))


def stamped_pose(x, y, yaw, stamp):
    pose = Pose(Point(x, y, 0.0), Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))
    return PoseStamped(Header(Time(stamp // 10**9, stamp % 10**9), "odom"), pose)


class Robot:
    def __init__(self, domain, log):
        self.log = log
        self.command = (0.0, 0.0)
        self.heard = -math.inf
        self.pose = (4.0, 0.0, math.pi / 2)
        self.sent = None
        self.delay = math.nan
        self.commands = DataReader(domain, Topic(domain, "rt/cmd_vel", Twist), qos=RELIABLE)
        kinds = {"pose": PoseStamped, "path_error": Float64, "autonomy/cmd_vel": Twist}
        self.out = {name: writer(domain, name, kind) for name, kind in kinds.items()}

    def listen(self):
        for command in self.commands.take(50):
            if hasattr(command, "linear"):  # else news of a writer, no sample
                self.command = (command.linear.x, command.angular.z)
                self.heard = monotonic()
                self.obeyed()

    def obeyed(self):
        if self.sent is not None:
            self.delay = self.heard - self.sent
            self.sent = None

    def drive(self, v, w):
        """Go on for a tick; return the distance from the path, a circle."""
        x, y, yaw = self.pose
        yaw += w * PERIOD
        x, y = x + v * math.cos(yaw) * PERIOD, y + v * math.sin(yaw) * PERIOD
        self.pose = (x, y, yaw)
        return abs(math.hypot(x, y) - 4.0)

    def tick(self):
        now = monotonic()
        v, w = self.command if now - self.heard < WATCHDOG else (0.0, 0.0)
        error, stamp = self.drive(v, w), time_ns()
        write(self.log, now, v, w, self.delay, stamp)
        self.delay = math.nan
        self.out["path_error"].write(Float64(error))
        self.out["autonomy/cmd_vel"].write(twist(0.3, 0.3 / 4.0))
        self.sent = monotonic()
        self.out["pose"].write(stamped_pose(*self.pose, stamp))


PHASE = 0.5
TOPICS = ("pose", "path_error", "autonomy/cmd_vel", "operator/cmd_vel")
FAULTS = ("nan", "inf", "-inf", "1e300", "1e5", "signs", "silent", "sixty")
PHASES = [(topic, fault) for topic in TOPICS for fault in FAULTS]


class Hostile(Robot):
    """A robot and a person whose messages have faults."""

    def __init__(self, domain, log, received):
        super().__init__(domain, log)
        self.received = received
        self.out = {"operator/cmd_vel": writer(domain, "operator/cmd_vel", Twist), **self.out}
        self.sign = 1

    def obeyed(self):
        write(self.received, self.heard, *self.command)

    def tick(self):
        now = monotonic()
        if self.heard < 0.0:  # the node is not there yet
            self.began = now
        phase = int((now - self.began - 5.0) / PHASE)
        topic, fault = PHASES[phase] if 0 <= phase < len(PHASES) else ("", "")
        self.sign = -self.sign
        error = self.drive(*self.command)
        for name, out in self.out.items():
            bad = fault if name == topic else ""
            for _ in range({"silent": 0, "sixty": 60}.get(bad, 1)):
                out.write(self.message(name, bad, error))
        write(self.log, now, *self.command, topic, fault)

    def message(self, name, bad, error):
        absurd = {"": None, "sixty": None, "signs": 3.0 * self.sign}.get(bad, bad)
        absurd = float(absurd) if isinstance(absurd, str) else absurd
        if name == "pose":
            # signs: a clock an hour before and behind, and another frame
            away = 3600 * 10**9 * self.sign if bad == "signs" else 0
            pose = stamped_pose(*self.pose, time_ns() + away)
            if bad == "signs":
                pose.header.frame_id = "moon"
            elif absurd is not None:
                pose.pose.position.x = absurd
            return pose
        if name == "path_error":
            return Float64(error if absurd is None else absurd)
        return twist(0.4, 0.1) if absurd is None else twist(absurd, absurd)


class Operator:
    def __init__(self, domain):
        self.out = writer(domain, "operator/cmd_vel", Twist)

    def listen(self):
        pass

    def tick(self):
        self.out.write(twist(0.4, 0.4 / 4.0 + random.gauss(0.0, 0.02)))


class Stopper:
    """An operator's hand on the buttons for stop and release."""

    def __init__(self, domain, robot, log):
        self.robot, self.log = robot, log
        self.out = {name: writer(domain, f"operator/{name}", Bool) for name in ("stop", "release")}
        self.pressed, self.ticks = None, 0

    def press(self, name, down):
        self.out[name].write(Bool(down))

    def listen(self):
        if self.pressed and self.robot.command == (0.0, 0.0):
            write(self.log, self.robot.heard - self.pressed)
            self.pressed, self.ticks = None, -20

    def tick(self):
        fast = self.robot.command[0] > 0.3
        self.ticks += fast or self.ticks < 0
        if self.ticks == -10:
            self.press("stop", False)
            self.press("release", True)
        elif self.ticks == -5:
            self.press("release", False)
        elif self.ticks > 20 and fast and self.pressed is None:
            self.pressed = monotonic()
            self.press("stop", True)


def main():
    roles = sys.argv[1].split(",")
    end = monotonic() + float(sys.argv[2])
    domain = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    with open(sys.argv[3], "w") as log, open(sys.argv[-1], "a") as received:
        parts = [Robot(domain, log)] if "robot" in roles else []
        parts += [Stopper(domain, parts[0], received)] if "stop" in roles else []
        parts += [Hostile(domain, log, received)] if "hostile" in roles else []
        parts = ([Operator(domain)] if "operator" in roles else []) + parts
        due = monotonic()
        while monotonic() < end:
            for part in parts:
                part.listen()
            if monotonic() >= due:
                due += PERIOD
                for part in parts:
                    part.tick()
            sleep(0.001)


if __name__ == "__main__":
    main()
