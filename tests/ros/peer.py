"""
A robot and a person behind DDS by Cyclone alone: no ROS, another vendor, no code of the package.

    python peer.py robot,operator seconds log.csv

The robot is a unicycle with a watchdog of 0.5 s. It writes time, applied v and w, each tick.
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
        self.commands = DataReader(domain, Topic(domain, "rt/cmd_vel", Twist), qos=RELIABLE)
        kinds = {"pose": PoseStamped, "path_error": Float64, "autonomy/cmd_vel": Twist}
        self.out = {
            name: DataWriter(domain, Topic(domain, f"rt/{name}", kind), qos=RELIABLE)
            for name, kind in kinds.items()
        }

    def listen(self):
        for command in self.commands.take(50):
            if hasattr(command, "linear"):  # else news of a writer, no sample
                self.command = (command.linear.x, command.angular.z)
                self.heard = time.monotonic()

    def tick(self):
        now = time.monotonic()
        v, w = self.command if now - self.heard < WATCHDOG else (0.0, 0.0)
        x, y, yaw = self.pose
        yaw += w * PERIOD
        x, y = x + v * math.cos(yaw) * PERIOD, y + v * math.sin(yaw) * PERIOD
        self.pose = (x, y, yaw)
        print(now, v, w, sep=",", file=self.log, flush=True)
        self.out["path_error"].write(Float64(abs(math.hypot(x, y) - 4.0)))
        self.out["autonomy/cmd_vel"].write(twist(0.3, 0.3 / 4.0))
        self.out["pose"].write(stamped_pose(x, y, yaw, time.time_ns()))


class Operator:
    def __init__(self, domain):
        topic = Topic(domain, "rt/operator/cmd_vel", Twist)
        self.out = DataWriter(domain, topic, qos=RELIABLE)

    def listen(self):
        pass

    def tick(self):
        self.out.write(twist(0.4, 0.4 / 4.0 + random.gauss(0.0, 0.02)))


def main():
    roles = sys.argv[1].split(",")
    end = time.monotonic() + float(sys.argv[2])
    domain = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    with open(sys.argv[3], "w") as log:
        parts = [Robot(domain, log)] if "robot" in roles else []
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
