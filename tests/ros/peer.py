"""
A robot and a person behind DDS by Cyclone alone: no ROS, another vendor, no code of the package.

    python peer.py robot,operator seconds log.csv
    python peer.py robot,operator,stop seconds log.csv stops.csv
    python peer.py hostile seconds log.csv commands.csv

The robot is a unicycle with a watchdog of 0.5 s. It writes time, applied v and w, age of the latest
command, the time from odometry to the command that answers it, and the stamp that it sends [ns],
each tick. Who stops presses stop and release in turn, while the robot drives, and writes after how
many seconds the robot had heard 0. The hostile one sends from the fifth second on what no robot
should, one fault of one topic after another; it writes time, v, w, topic and fault, and each
command into a second file.
"""

import math
import os
import random
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PERIOD = 0.05
WATCHDOG = 0.5


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
class Float64(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):
    data: float64


@dataclass
class Bool(IdlStruct, typename="std_msgs::msg::dds_::Bool_"):
    data: bool


RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(50))


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
        self.out = {
            name: DataWriter(domain, Topic(domain, f"rt/{name}", kind), qos=RELIABLE)
            for name, kind in kinds.items()
        }

    def listen(self):
        for command in self.commands.take(50):
            if not hasattr(command, "linear"):  # news of a writer, no sample
                continue
            self.command = (command.linear.x, command.angular.z)
            self.heard = time.monotonic()
            if self.sent is not None:
                self.delay = self.heard - self.sent
                self.sent = None

    def tick(self):
        now = time.monotonic()
        v, w = self.command if now - self.heard < WATCHDOG else (0.0, 0.0)
        x, y, yaw = self.pose
        yaw += w * PERIOD
        x, y = x + v * math.cos(yaw) * PERIOD, y + v * math.sin(yaw) * PERIOD
        self.pose = (x, y, yaw)
        stamp = time.time_ns()
        row = (now, v, w, now - self.heard, self.delay, stamp)
        print(*row, sep=",", file=self.log, flush=True)
        self.delay = math.nan
        self.out["path_error"].write(Float64(abs(math.hypot(x, y) - 4.0)))
        self.out["autonomy/cmd_vel"].write(twist(0.3, 0.3 / 4.0))
        self.sent = time.monotonic()
        self.out["pose"].write(stamped_pose(x, y, yaw, stamp))


PHASE = 0.5
TOPICS = ("pose", "path_error", "autonomy/cmd_vel", "operator/cmd_vel")
FAULTS = ("nan", "inf", "-inf", "1e300", "1e5", "signs", "silent", "sixty")
PHASES = [(topic, fault) for topic in TOPICS for fault in FAULTS]


class Hostile(Robot):
    """A robot and a person whose messages have faults."""

    def __init__(self, domain, log, received):
        super().__init__(domain, log)
        self.received = received
        topic = Topic(domain, "rt/operator/cmd_vel", Twist)
        self.out["operator/cmd_vel"] = DataWriter(domain, topic, qos=RELIABLE)
        self.began = time.monotonic()
        self.sign = 1

    def listen(self):
        for command in self.commands.take(50):
            if hasattr(command, "linear"):
                row = (time.monotonic(), command.linear.x, command.angular.z)
                print(*row, sep=",", file=self.received, flush=True)
                self.command, self.heard = (command.linear.x, command.angular.z), row[0]

    def tick(self):
        now = time.monotonic() - self.began
        phase = int((now - 5.0) / PHASE)
        topic, fault = PHASES[phase] if 0 <= phase < len(PHASES) else ("", "")
        self.sign = -self.sign
        v, w = self.command
        x, y, yaw = self.pose
        yaw += w * PERIOD
        self.pose = (x + v * math.cos(yaw) * PERIOD, y + v * math.sin(yaw) * PERIOD, yaw)
        for name in ("operator/cmd_vel", "autonomy/cmd_vel", "path_error", "pose"):
            bad = fault if name == topic else ""
            if bad != "silent":
                for _ in range(60 if bad == "sixty" else 1):
                    self.out[name].write(self.message(name, bad))
        print(now, v, w, topic, fault, sep=",", file=self.log, flush=True)

    def message(self, name, bad):
        absurd = {"": None, "sixty": None, "signs": 3.0 * self.sign}.get(bad, bad)
        absurd = float(absurd) if isinstance(absurd, str) else absurd
        if name == "pose":
            x, y, yaw = self.pose
            # signs: a clock an hour before and behind, and another frame
            away = 3600 * 10**9 * self.sign if bad == "signs" else 0
            pose = stamped_pose(x, y, yaw, max(time.time_ns() + away, 0))
            if bad == "signs":
                pose.header.frame_id = "moon"
            elif absurd is not None:
                pose.pose.position.x = absurd
            return pose
        if name == "path_error":
            x, y, _ = self.pose
            return Float64(abs(math.hypot(x, y) - 4.0) if absurd is None else absurd)
        return twist(0.4, 0.1) if absurd is None else twist(absurd, absurd)


class Operator:
    def __init__(self, domain):
        topic = Topic(domain, "rt/operator/cmd_vel", Twist)
        self.out = DataWriter(domain, topic, qos=RELIABLE)

    def listen(self):
        pass

    def tick(self):
        self.out.write(twist(0.4, 0.4 / 4.0 + random.gauss(0.0, 0.02)))


class Stopper:
    """An operator's hand on the buttons for stop and release."""

    def __init__(self, domain, robot, log):
        self.robot, self.log = robot, log
        self.out = {
            name: DataWriter(domain, Topic(domain, f"rt/operator/{name}", Bool), qos=RELIABLE)
            for name in ("stop", "release")
        }
        self.pressed, self.ticks = None, 0

    def press(self, name, down):
        self.out[name].write(Bool(down))

    def listen(self):
        if self.pressed and self.robot.command == (0.0, 0.0):
            print(self.robot.heard - self.pressed, file=self.log, flush=True)
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
            self.pressed = time.monotonic()
            self.press("stop", True)


def main():
    roles = sys.argv[1].split(",")
    end = time.monotonic() + float(sys.argv[2])
    domain = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    with open(sys.argv[3], "w") as log, open(sys.argv[-1], "a") as received:
        parts = [Robot(domain, log)] if "robot" in roles else []
        parts += [Stopper(domain, parts[0], received)] if "stop" in roles else []
        parts += [Hostile(domain, log, received)] if "hostile" in roles else []
        parts = ([Operator(domain)] if "operator" in roles else []) + parts
        due = time.monotonic()
        while time.monotonic() < end:
            for part in parts:
                part.listen()
            if time.monotonic() >= due:
                due += PERIOD
                for part in parts:
                    part.tick()
            time.sleep(0.001)


if __name__ == "__main__":
    main()
