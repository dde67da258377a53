"""The ground robot: limits, laser scanner, odometry and autonomous controller."""

from collections import namedtuple
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.models.checks import Checked, NotNegative, Positive, Share
from trustlab.models.compiled import inner
from trustlab.testbeds.ground_robot.course import angle_of, direction


@inner
def wrapped(angle):
    """Return the angle in (−π, π]."""
    return angle - 2.0 * np.pi * np.ceil(angle / (2.0 * np.pi) - 0.5)


@inner(_nrt=False)
def scan(posts, robot, state, sensing):
    """
    Compare posts seen with where the estimate has them: mean offset, turn of the pattern, number
    seen.

    While the operator drives, nothing is compared, but the noise is drawn all the same.
    """
    # Sums over posts seen: their ways from the robot, how far the estimate has them from there, and
    # products of both, dot and cross product in one.
    ways = offs = products = 0j
    seen = 0
    heading, half = direction(state.yaw), 0.5 * robot.field_of_view
    edge = np.cos(half) if half < np.pi else -2.0
    for post in posts:
        way = post - state.place
        square = way.real**2 + way.imag**2
        if square > robot.scan_range**2:
            continue
        distance = np.sqrt(square)
        # how far ahead a post stands tells whether it is in view without an angle
        if heading.real * way.real + heading.imag * way.imag < edge * distance:
            continue
        if sensing.random() > robot.detection:
            continue
        far = robot.range_noise * sensing.standard_normal()
        aside = robot.bearing_noise * sensing.standard_normal()
        if state.mode == 1:
            continue
        # Where the estimate has the post: what was seen, turned by the errors of bearing and of the
        # estimated heading.
        longer = 1.0 + far / max(distance, 1e-9)
        shown = longer * (direction(state.heading_error + aside) * way)
        ways += way
        offs += shown - way
        products += shown * way.conjugate()
        seen += 1
    if seen == 0:
        return 0j, 0.0, 0
    off = offs / seen
    # products of what lies beside the mean
    products -= (ways / seen + off) * ways.conjugate()
    turn = angle_of(products) if seen > 1 else 0.0
    return state.est - state.place + off, turn, seen


@dataclass(frozen=True)
class Pioneer(Checked):
    """
    A Pioneer-like robot (a unicycle) that finds its way by a laser scanner, guide posts and
    odometry.

    The autonomous controller is two proportional laws, on heading, w = steering_gain · (angle to
    the path point look_ahead ahead), and on speed, v = cruise_speed − speed_gain · (how far posts
    stand from where they are expected). Both work from an estimate of the pose that odometry
    carries on with a heading that is a little off, so that it drifts with distance, and that every
    post seen pulls back by a small share of the mismatch. While the operator drives between the
    posts the estimate is anchored anew.

    Parameters
    ----------
    max_speed, max_turn_rate : float
        Limits of speed [m/s] and turn rate [rad/s], for the operator's commands too.
    max_acceleration, max_turn_acceleration : float
        Limits of their rates of change [m/s², rad/s²].
    scan_range, field_of_view : float
        How far [m] and in how wide an angle ahead [rad] the scanner sees posts.
    detection : float
        Probability that a post in view is found in a scan; ten scans a second.
    range_noise, bearing_noise : float
        Standard deviations of measured range [m] and bearing [rad].
    heading_drift : float
        How much the odometry's heading goes wrong per metre [rad/m], positive to the left (wheels
        of unequal size).
    heading_noise : float
        Its random part [rad/√m].
    position_gain, heading_gain : float
        Share of the mismatch in place, and in direction, by which a scan corrects the estimate for
        every post seen (for every post but one).
    anchoring_time : float
        Time constant with which the estimate is anchored while the operator drives [s].
    look_ahead : float
        How far ahead on the path the heading law aims [m].
    steering_gain : float
        Turn rate per angle to that point [1/s].
    cruise_speed, search_speed : float
        Speed when posts stand where they are expected, and when none is seen [m/s].
    speed_gain : float
        Speed given up per metre of mismatch [1/s].

    Raises
    ------
    ValueError
        If a number is not finite, negative, or a share above 1.

    Notes
    -----
    A simulated stand-in for the robot of the Stage testbed (Fig. 2.1). The defaults are calibrated
    so that performance (2.4), left alone for long, has the size of Remark 7; they are not
    measurements of a robot.
    """

    max_speed: Positive = 0.7
    max_turn_rate: Positive = 1.0
    max_acceleration: Positive = 0.5
    max_turn_acceleration: Positive = 3.0
    scan_range: NotNegative = 4.0
    field_of_view: NotNegative = np.pi
    detection: Share = 0.8
    range_noise: NotNegative = 0.05
    bearing_noise: NotNegative = 0.02
    heading_drift: float = -0.042
    heading_noise: NotNegative = 0.01
    position_gain: Share = 0.003
    heading_gain: Share = 0.0016
    anchoring_time: Positive = 2.0
    look_ahead: Positive = 1.2
    steering_gain: Positive = 1.2
    cruise_speed: Positive = 0.425
    speed_gain: NotNegative = 0.03
    search_speed: NotNegative = 0.3

    @property
    def numbers(self) -> Any:
        """The robot as plain numbers for compiled loops, by the names that they have here."""
        return PioneerNumbers(**vars(self))


PioneerNumbers = namedtuple("PioneerNumbers", Pioneer.__match_args__)  # type: ignore[misc]
