"""
A simulated robot over ROS 2, with a scripted operator: it stands in for your robot and your person.

    python simulated_robot.py [seconds]

An ir-sim robot drives on a circle; 20 times a second it publishes odometry, its deviation from the
circle, the command of a scripted operator, who keeps to the circle, and that of its autonomy, whose
circle drifts off. Commands on /cmd_vel older than 0.5 s no longer move it.
"""

import math
import os
import sys
import tempfile
import time

os.environ.setdefault("MPLBACKEND", "Agg")
import irsim
import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from std_msgs.msg import Float64

PERIOD = 0.05
RADIUS = 4.0
WORLD = """
world: {height: 20, width: 20, step_time: 0.05, collision_mode: 'stop'}
robot:
  - kinematics: {name: 'diff'}
    shape: {name: 'circle', radius: 0.2}
    state: [14, 10, 1.5708]
    vel_max: [2, 4]
"""


class Robot:
    def __init__(self, node, world):
        self.node = node
        self.world = irsim.make(world, display=False, log_level="ERROR")
        self.command = (0.0, 0.0)
        self.heard = -math.inf
        self.drift = 0.0
        node.create_subscription(Twist, "/cmd_vel", self.hear, 10)
        self.odometry = node.create_publisher(Odometry, "/odom", 10)
        self.error = node.create_publisher(Float64, "/path_error", 10)
        self.operator = node.create_publisher(Twist, "/operator/cmd_vel", 10)
        self.autonomy = node.create_publisher(Twist, "/autonomy/cmd_vel", 10)
        node.create_timer(PERIOD, self.tick)

    def hear(self, command):
        self.command = (command.linear.x, command.angular.z)
        self.heard = time.monotonic()

    def tick(self):
        moving = time.monotonic() - self.heard < 0.5  # the robot's own watchdog
        v, w = self.command if moving else (0.0, 0.0)
        self.world.step(np.array([[v], [w]]))
        x, y, yaw = (float(value) for value in self.world.robot.state.ravel()[:3])
        radius = math.hypot(x - 10.0, y - 10.0)
        along = math.atan2(y - 10.0, x - 10.0)
        self.error.publish(Float64(data=abs(radius - RADIUS)))
        # Autonomy loses its way slowly, and a hand that drives sets it right again.
        apart = math.hypot(v - 0.4, w - self.steering(radius, along, yaw, 0.0, 0.4))
        self.drift += PERIOD * (-self.drift / 4.0 if apart < 0.05 else 0.03)
        self.operator.publish(self.twist(0.4, self.steering(radius, along, yaw, 0.0, 0.4)))
        self.autonomy.publish(self.twist(0.3, self.steering(radius, along, yaw, self.drift, 0.3)))
        odometry = Odometry()
        odometry.header.stamp = self.node.get_clock().now().to_msg()
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = x, y
        odometry.pose.pose.orientation.z = math.sin(yaw / 2.0)
        odometry.pose.pose.orientation.w = math.cos(yaw / 2.0)
        self.odometry.publish(odometry)

    def steering(self, radius, along, yaw, drift, speed):
        """Return the turn rate that leads back to the circle, or to one that is `drift` wider."""
        off = radius - RADIUS - drift
        wish = along + math.pi / 2.0 + math.atan(1.5 * off)
        turn = math.remainder(wish - yaw, 2.0 * math.pi)
        return speed / RADIUS + 1.5 * turn

    def twist(self, v, w):
        command = Twist()
        command.linear.x, command.angular.z = v, w
        return command


def main():
    rclpy.init()
    node = rclpy.create_node("robot")
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as world:
        world.write(WORLD)
        world.flush()
        Robot(node, world.name)
    end = time.monotonic() + (float(sys.argv[1]) if len(sys.argv) > 1 else math.inf)
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.2)


main()
