"""
Who decides when, and what may be assumed of people: off by default, each with the effect that it
names.

Oracles: sessions of the version before there were assumptions; closed forms of (2.5) and (2.6); the
whole path searched by numpy.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import stats

import trustlab as tl
from tests.cases import distance, driver, model
from trustlab import run_condition
from trustlab.testbeds import Course
from trustlab.testbeds.deciding import RANDOM_PHASE, SAMPLE_TIME, SETTLING
from trustlab.testbeds.ground_robot.course import nearest_point, path_point


def run(condition, seed=7, laps=4, **assumed):
    """Participant 2 with assumptions, on the ground robot."""
    who = replace(driver(), **assumed)
    thresholds = (0.0, 0.35) if condition in ("C2", "C3") else None
    return run_condition(condition, who, model(), thresholds, laps=laps, seed=seed)


COURSES = [
    Course(),
    Course(((0, 0), (12, 0), (12, 9), (0, 9)), radius=2.0),
    Course(((0, 0), (9, 0), (9, 12)), radius=0),
]


@pytest.mark.parametrize("course", COURSES)
def test_the_nearest_point_is_looked_for_around_the_last_one(course):
    numbers, rng = course.numbers, np.random.default_rng(0)
    for s, aside in zip(rng.uniform(-50.0, 150.0, 500), rng.uniform(-0.3, 0.3, 500), strict=True):
        point, tangent = path_point(s, numbers)
        place = point + 1j * aside * tangent
        point, arc, away = nearest_point(place, s + rng.uniform(-1.0, 1.0), numbers)
        assert away == pytest.approx(distance(course, place.real, place.imag)[0], abs=1e-12)
        assert abs(point - place) == pytest.approx(away, abs=1e-12)
        assert path_point(arc, numbers)[0] == pytest.approx(point, abs=1e-9)


def test_a_robot_follows_any_closed_polyline():
    course = Course(((0, 0), (9, 0), (9, 9), (4, 5), (0, 9)), radius=0)
    bed = tl.testbeds.GroundRobot(laps=2, course=course)
    measures = run_condition("C5", 2, testbed=bed, seed=1).measures
    assert measures["laps"] == 2
    assert measures["path_error"] < 1.0


def test_attention_costs_while_a_suggestion_stands_that_may_be_declined():
    declined = {"follow_tsc": 0.0, "ignoring_time": 3000.0}
    costly, before = (run("C2", attention_cost=cost, **declined).session for cost in (0.2, 0.0))
    first = int(np.argmax(before["suggested_mode"] == 0.0))
    assert_array_equal(costly["p_h"][: first + 1], before["p_h"][: first + 1])
    later = slice(first + 1000, first + 1200)
    assert costly["p_h"][later].mean() / before["p_h"][later].mean() == pytest.approx(0.8, abs=0.05)


def test_bias_shifts_the_thresholds_of_tsc_as_measured():
    exact = {"lower_spread": 0.0, "upper_spread": 0.0, "reaction_lag": 0.0}
    trusting = run("C1", trust_bias=0.1, lower=-0.2, upper=0.5, **exact).session
    shifted = run("C1", lower=-0.3, upper=0.4, **exact).session
    assert_array_equal(trusting["mode"], shifted["mode"])
    assert run("C3", trust_bias=0.1).session == run("C3").session


@pytest.mark.parametrize("bed", [{"laps": 3}, {"testbed": "uav_following"}])
def test_own_is_c3_with_the_thresholds_that_switches_in_c1_show(bed):
    someone = replace(driver(), trust_bias=0.05)
    measured = (someone.lower - 0.05, someone.upper - 0.05)
    own, suggested, costly = (
        run_condition(*who, seed=3, **bed).session.data
        for who in (
            ("own", someone, model()),
            ("C3", someone, model(), measured),
            ("own", replace(someone, attention_cost=0.3), model()),
        )
    )
    assert_array_equal(own, suggested)
    assert_array_equal(own, costly)


def test_random_suggestions_come_at_random_times_and_cost_no_attention():
    at_once = {"laps": 300, "seed": 0, "reaction_lag": 0.0}
    session, costly = (run("random", attention_cost=c, **at_once).session for c in (0.0, 0.3))
    assert_array_equal(session.data, costly.data)
    after = session["mode"][session.t >= SETTLING]
    lengths = SAMPLE_TIME * np.diff(np.flatnonzero(np.diff(after)))
    assert lengths.size > 100
    assert stats.kstest(lengths, stats.expon(scale=RANDOM_PHASE).cdf).pvalue > 0.01
    assert stats.kstest(lengths, stats.expon(scale=RANDOM_PHASE / 1.5).cdf).pvalue < 0.01


def test_taking_over_late_delays_the_manual_mode_alone():
    late = run("C3", take_over_lag=5.0, reaction_lag=0.0).suggestions()
    delays = {mode: part["delay"].dropna() for mode, part in late.groupby("suggested_mode")}
    assert delays[0.0].max() <= 0.1
    assert delays[1.0].between(5.0, 5.2).all()
    assert delays[1.0].size > 0
