"""
The ground robot: Assumptions 1 and 2 appear without being scripted, limits hold, conditions do what
they say.

Oracles: Remark 7 for the sizes; closed-form geometry, and the distance from all pieces of a path.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from tests.cases import distance
from trustlab.operators import operator
from trustlab.testbeds import Course, Pioneer, identification_session
from trustlab.testbeds.ground_robot.course import HALF_WIDTH, RESOLUTION, course_numbers
from trustlab.testbeds.ground_robot.kernel import drive_modes, locate


@pytest.fixture(scope="module")
def one(operators):
    """Participant 1, whose P_max is that of Remark 7."""
    return operator("1", operators["1"])


@pytest.fixture(scope="module")
def sessions(one):
    modes = np.repeat([1, 0, 1], [4000, 8000, 3000])
    return [drive_modes(modes, one, seed) for seed in range(8)]


# Assumptions 1 and 2


def test_left_alone_performance_decays_to_a_floor_and_a_skilled_operator_brings_it_back(sessions):
    for session in sessions:
        level = session["p_r"].reshape(-1, 100).mean(axis=1)  # of every ten seconds
        assert (np.diff(level[40:62:6]) < 0.0).all()
        assert 0.37 < level[38:40].mean() < 0.43
        floor = level[70:120].reshape(5, 10).mean(axis=1)
        assert 0.235 < min(floor) < max(floor) < 0.27
        assert np.ptp(floor) < 0.025
        assert (np.diff(level[120:133:4]) > 0.0).all()
        assert level[140:].mean() > floor[-1] + 0.12


@pytest.mark.parametrize(
    ("driven", "speed", "error"),
    [(slice(1000, 4000), 0.49, 0.38), (slice(6000, 12000), 0.39, 0.704)],
    ids=["by hand", "alone"],
)
def test_speeds_and_errors_are_those_of_remark_7(sessions, driven, speed, error):
    step, away = (
        np.mean([session[name][driven] for session in sessions])
        for name in ("step_distance", "path_error")
    )
    assert 10.0 * step == pytest.approx(speed, abs=0.015)
    assert away == pytest.approx(error, abs=0.04)


def test_the_models_fit_its_sessions(operators):
    pilot, fits = operators["pilot"], []
    for seed in range(2):
        session = identification_session(operator("pilot", pilot), seed)
        # Least squares: what the testbed's columns are like is asked here, not how certain the
        # estimates are.
        robot, human = tl.fit_robot(session, noise="white"), tl.fit_human(session, noise="white")
        assert robot.synthetic
        np.testing.assert_array_equal(session["mode"][:16000], np.repeat([1, 0], 8000))
        assert 0.993 < robot.model.a < 0.9995
        assert robot.model.p_min == pytest.approx(0.245, abs=0.01)
        assert robot.model.p_max == pytest.approx(0.395, abs=0.015)
        # as the session itself says
        assert "p_h and p_r as means over a moving window of 100 s" in robot.message
        assert human.model.beta == pytest.approx(pilot.human.beta, abs=0.15)
        assert human.fit_percent > 40.0
        fits.append(robot.fit_percent)
    assert min(fits) > 74.0
    assert np.mean(fits) > 78.0


# Geometry and limits


@pytest.mark.parametrize(("short", "ends"), [(1e-12, True), (1e-3, False)])
def test_rounding_does_not_decide_when_a_lap_ends(short, ends):
    """Where the path closes its corner can stay the nearest point, a lap but for rounding away."""
    course = Course()
    place = course.numbers.points[0]
    state = SimpleNamespace(place=place, yaw=0.0, arc=0.0, progress=course.length - short, laps=0)
    assert locate.py_func(course.numbers, 1, SimpleNamespace(), state) == ends
    assert state.laps == ends


def test_the_course_is_the_rounded_polygon():
    course = Course()
    corners = np.array(course.corners)
    ahead = np.roll(corners, -1, axis=0) - corners
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    turn = np.abs((heading - np.roll(heading, 1) + np.pi) % (2 * np.pi) - np.pi)
    exact = np.hypot(*ahead.T).sum() + (course.radius * (turn - 2 * np.tan(turn / 2))).sum()
    assert course.length == pytest.approx(exact, rel=1e-3)
    path = course.path
    assert (path[0, :2] == path[-1, :2]).all()
    direction = np.unwrap(np.arctan2(*np.diff(path[:, :2], axis=0).T[::-1]))
    assert np.abs(np.diff(direction)).max() < 1.1 * RESOLUTION / course.radius
    assert_allclose(distance(course, *course.posts.T), HALF_WIDTH, atol=0.01)
    for ours, drawn in zip(course.numbers, course_numbers(path, course.posts), strict=True):
        assert_allclose(drawn, ours, atol=1e-9)


WEAK = Pioneer(
    max_speed=0.4,
    max_turn_rate=0.35,
    max_acceleration=0.1,
    max_turn_acceleration=0.8,
    cruise_speed=0.4,
)


@pytest.mark.parametrize("robot", [Pioneer(), WEAK])
def test_limits_hold(one, robot):
    wild = replace(one, noise=3.0, steering_gain=5.0)
    session = drive_modes(np.repeat([1, 0, 1, 0], 1500), wild, 1, robot=robot)
    speed = session["step_distance"][1:] / 0.1
    turn = np.diff(np.unwrap(session["yaw"])) / 0.1
    for rate, most, change in (
        (speed, robot.max_speed, robot.max_acceleration),
        (turn, robot.max_turn_rate, robot.max_turn_acceleration),
    ):
        assert np.abs(rate).max() <= most + 1e-9
        assert np.abs(np.diff(rate)).max() <= 0.1 * change + 1e-9
    assert session["v_command"].max() <= robot.max_speed
    assert np.abs(session["w_command"]).max() == robot.max_turn_rate  # the hand does reach it
    moved = np.hypot(np.diff(session["robot_x"]), np.diff(session["robot_y"]))
    assert_allclose(session["step_distance"][1:], moved, atol=1e-12)
