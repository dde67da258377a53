"""
Bounds: Theorem 1 with its lemmas, Theorem 2 as printed and on arrays, against what is simulated.

Oracle: the equations written out here. The numbers of Tables 2.1 and 2.2 are compared by the audit.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from numpy.random import default_rng

import trustlab as tl
from tests.allocation.cases import (
    CASES,
    PILOT,
    SECOND,
    made,
    phases,
    random_case,
    settled,
)
from tests.cases import refused, shape, weights
from trustlab.allocation import steady_state_bounds, step_bounds, threshold_limits
from trustlab.allocation.bounds import performance_as_printed, utilization_as_printed

approx = pytest.approx

# --- bounds as printed ----------------------------------------------------------------------------


def test_endless_and_empty_dwell_times():
    assert utilization_as_printed(0.999, np.inf, np.inf, 0.0) == (1.0, 1.0)
    assert np.isnan(utilization_as_printed(0.999, 0.0, 0.0, 0.0)).all()


def test_remark_4_says_what_to_change():
    narrow = made((0.9, 0.7, 0.1, 0.5), (0.999, 0.3, 0.31))
    with refused(r"no thresholds fit \(Remark 4\); widen the range"):
        steady_state_bounds(narrow, 0.0, 0.1)
    with refused(f"TSC_ub = {threshold_limits(SECOND).upper:.4f}"):
        steady_state_bounds(SECOND, 0.0, 0.99)


def test_theorem_2_fails_above_often_and_below_sometimes():
    """
    Theorem 2 claims both never happen: for the upper bound the text takes the longest autonomous
    dwell time where the shortest is needed, for the lower one the dwell time of a swing from P_rl
    to P_ru, and actual swings are narrower.
    """
    seen = below = above = 0
    for seed in range(400):
        rng = default_rng(seed)
        model, *pair = random_case(rng, quick=False)
        tail = settled(model, *pair, r0=rng.random())
        step = tail.diff().abs().max()
        if not threshold_limits(model, step["p_h"]).contains(*pair):
            continue
        seen += 1
        bounds = steady_state_bounds(model, *pair, model.delta(step["p_r"], step["p_h"]))
        below += tail["r"].min() < bounds.r_low - 1e-12
        above += tail["r"].max() > bounds.r_high + 1e-12
    assert seen > 150
    assert 0.15 < above / seen < 0.5
    assert 0 < below / seen < 0.1


def test_the_step_of_tsc_is_that_of_the_steady_cycle():
    cycle = tl.limit_cycle(SECOND, 0.0, 0.35)
    expected = step_bounds(SECOND, cycle.r_low, cycle.r_high).delta_tsc
    assert steady_state_bounds(SECOND, 0.0, 0.35).delta_tsc == approx(expected, rel=1e-9)
    assert steady_state_bounds(SECOND, 0.0, 0.35, delta_tsc=2.0).delta_tsc == 2.0
    with refused("delta_tsc"):
        steady_state_bounds(SECOND, 0.0, 0.35, delta_tsc=2.1)
    with refused("r_low must lie"):
        step_bounds(SECOND, -0.1, 0.9)


@pytest.mark.parametrize(
    ("beta", "low", "high", "reach"),
    [
        (0.15, 0.35, 0.5, (0.05, 0.95)),
        (0.6, 0.35, 0.7, (0.05, 0.95)),
        (0.5, -0.4, 0.5, (0.001, 0.7)),
        (0.5, -0.4, 0.5, (0.2, 0.4)),
    ],
)
def test_greatest_steps_are_those_of_every_state(beta, low, high, reach):
    """
    Oracle: (2.3), (2.5) and (2.6) written out on a grid of states. An operator better than the
    robot's model supposes lifts P_r by more than it falls, and one who does harm lowers it by more.
    """
    robot = tl.RobotModel(0.99, 0.24, 0.39, 0.5)
    r = np.linspace(*reach, 700_001)
    p_h = low + (high - low) * shape(r, beta)
    human_steps, robot_steps = [], []
    for mode in (0, 1):
        human_steps += [(high - low) * shape(0.995 * r + 0.005 * mode, beta) + low - p_h]
        robot_steps += [0.01 * (0.24 - p_r) + mode * robot.b * p_h for p_r in (0.24, 0.39)]
    model = tl.TscModel(robot, tl.HumanModel(0.995, beta, low, high))
    steps = step_bounds(model, *reach)
    assert steps.delta_p_h == approx(np.abs(human_steps).max(), rel=1e-9)
    assert steps.delta_p_r == approx(np.abs(robot_steps).max(), rel=1e-9)


def test_thresholds_at_their_limits_are_outside():
    limits = threshold_limits(PILOT, 0.0)
    assert limits.contains(np.nextafter(limits.lower, 1.0), np.nextafter(limits.upper, -1.0))
    for pair in ((limits.lower, 0.0), (0.0, limits.upper), (0.1, 0.1)):
        assert not limits.contains(*pair)


# --- the equations written out --------------------------------------------------------------------


EXAMPLES = settings(max_examples=120, suppress_health_check=list(HealthCheck))


@settings(EXAMPLES, max_examples=400)
@given(CASES, st.floats(0.0, 0.05), st.one_of(st.none(), st.floats(0.5, 6.0)))
def test_limits_and_bounds_are_the_equations_and_proposition_1_holds(case, delta, gain):
    """
    (2.9), (2.10), (2.15), (2.16), (2.20), (2.21) and (2.33), with b_pr of (2.3) or another, with
    which the slope of (2.10) has either sign.
    """
    model, lower, upper = case
    robot, human, (a_T, b_T) = model.robot, model.human, weights(model)
    own = replace(robot, b=(gain or 1.0) * robot.b)
    slack, slope = b_T * delta / (1 - robot.a), a_T * own.b / (1 - robot.a) - b_T
    least = a_T * robot.p_min + slack - b_T * human.p_min
    most = a_T * robot.p_min - slack + min(slope * human.p_max, slope * human.p_min)
    limits = threshold_limits(tl.TscModel(own, human), delta)
    assert (limits.lower, limits.upper) == approx((least, most), rel=1e-9, abs=1e-12)
    low = max((lower - delta + b_T * human.p_min) / a_T, robot.p_min)
    high = min((upper + delta + b_T * human.p_max) / a_T, robot.p_max)
    rise = own.b * human.p_max / (1 - robot.a)
    best, worst = (robot.p_min + rise * p_h / human.p_max for p_h in (human.p_max, human.p_min))
    p = performance_as_printed(model.constants(), lower, upper, delta, gain and rise)
    assert p[:2] == approx((low, high), rel=1e-9)
    for steps, before, after in (
        (p.dwell_autonomous_high, high - robot.p_min, low - robot.p_min),
        (p.dwell_manual_low, best - low, best - high),
        (p.dwell_manual_high, worst - low, worst - high),
    ):
        exact = np.log(after / before) / np.log(robot.a) if after > 1e-12 else np.inf
        assert steps - 1e-9 <= exact <= steps + 1 + 1e-9
    rest, quick, slow = human.a ** np.array(p[2:])
    r = utilization_as_printed(human.a, *p[3:], p.dwell_autonomous_high)
    expected = (1 - quick) * rest / (1 - quick * rest), (1 - slow) / (1 - slow * rest)
    assert r == approx(expected, rel=1e-9)
    assert p.dwell_manual_low <= p.dwell_manual_high
    assert 0.0 <= r[0] <= r[1] <= 1.0


def test_an_endless_dwell_time_stays_endless():
    """
    P_ru clipped to P_r,max is never reached, whatever P_r,min + (P_r,max − P_r,min) rounds to.
    """
    rng = default_rng(4)
    least, most = rng.uniform(0.0, 0.2, 5000), rng.uniform(0.3, 1.0, 5000)
    c = SECOND.constants()._replace(p_r_min=least, p_r_max=most)
    p = performance_as_printed(c, 0.0, 99.0, 0.0)
    assert (p.p_r_high == most).all()
    assert np.isinf(p.dwell_manual_low).all()


# --- Theorem 1 and lemmas -------------------------------------------------------------------------


@EXAMPLES
@given(CASES, st.floats(0.0, 1.0))
def test_theorem_1_lemmas_and_bounds_on_performance_hold(case, r0):
    """
    Of a run under thresholds within the limits, with transients gone. No phase is longer than ⌊·⌋
    of (2.16) and (2.21): one of n samples takes P_r from its first sample, within (2.15), over n
    steps to the first sample of the next phase, which is within (2.15) as well, as δ_TSC makes room
    for the step that crosses. So n does not exceed the real number that is floored.
    """
    model, *pair = case
    tail = settled(*case, r0=r0)
    step = tail.diff().abs().max()
    limits = threshold_limits(model, step["p_h"])
    assume(limits.contains(*pair))
    bounds = steady_state_bounds(*case, model.delta(step["p_r"], step["p_h"]))
    # Theorem 1
    for part in np.array_split(tail["mode"], 2):
        assert set(part) == {0.0, 1.0}
    # Lemmas 1 and 2: TSC falls alone and rises under manual control
    now, change = tail.iloc[:-1], np.diff(tail["tsc"])
    assert (change[(now["mode"] == 0) & (now["tsc"] > limits.lower)] < 0).all()
    assert (change[(now["mode"] == 1) & (now["tsc"] < limits.upper)] > 0).all()
    # (2.14) and (2.15)
    assert tail["tsc"].between(bounds.tsc_low - 1e-12, bounds.tsc_high + 1e-12).all()
    assert tail["p_r"].between(bounds.p_r_low - 1e-12, bounds.p_r_high + 1e-12).all()
    # Lemmas 3 and 4
    who, lengths = phases(tail["mode"])
    assert lengths[who == 0].max() <= bounds.dwell_autonomous_high
    assert lengths[who == 1].max() <= bounds.dwell_manual_high


@settings(EXAMPLES, max_examples=40)
@given(CASES, st.floats(0.001, 2.0), st.booleans())
def test_control_thresholds_that_tsc_never_meets_end_the_switching(case, beyond, stays):
    """
    TSC lies in [-1, 1]: without the condition of Theorem 1 there is nothing that keeps the rule
    switching.
    """
    model, lower, upper = case
    pair = (lower, 1.0 + beyond) if stays else (-1.0 - beyond, upper)
    assert (settled(model, *pair, r0=0.5)["mode"] == stays).all()


def test_control_dwell_times_of_a_narrower_band_are_too_short():
    """
    The lengths that Lemmas 3 and 4 bound do come near: bounds for a band of half the width are
    exceeded.
    """
    longer = 0
    for seed in range(60):
        rng = default_rng(seed)
        model, lower, upper = random_case(rng)
        tail = settled(model, lower, upper, 20_000, r0=rng.random())
        who, lengths = phases(tail["mode"])
        quarter = 0.25 * (upper - lower)
        bounds = steady_state_bounds(model, lower + quarter, upper - quarter, delta_tsc=0.0)
        longer += lengths[who == 0].max(initial=0) > bounds.dwell_autonomous_high
        longer += lengths[who == 1].max(initial=0) > bounds.dwell_manual_high
    assert longer > 5
