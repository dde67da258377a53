"""
Correction of thresholds: clipping written out, and properties of (2.40)-(2.44).
"""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import trustlab as tl
from tests.allocation.cases import (
    OPERATORS,
    PILOT,
    SECOND,
    START,
    TARGET,
    corrector,
    written_out,
)
from tests.cases import refused
from trustlab.allocation import TargetWarning
from trustlab.allocation.correction import BOUNDED, OPTIMAL

approx = pytest.approx


def by_hand(model, r, p_r, lower, upper, mode, target, c_b, steps, lowering=0):
    """
    Clip (target − threshold) to (2.42) step by step, in plain Python, the switch as in (2.8).

    In the first steps, as many as `lowering`, TSC_u is lowered as far as (2.42) allows instead.
    """
    rows, cost, robot, pair = [], 0.0, model.robot, [lower, upper]
    motion = written_out(model, pair, r, p_r, mode)
    for k, (r_now, p_now, *_, mode_now) in zip(range(steps), motion, strict=False):
        part = (p_now - robot.p_min) / (robot.p_max - robot.p_min)
        low, high = -0.5 * (r_now + part) * c_b, 0.5 * (1 - r_now + 1 - part) * c_b
        c_l, c_u = (min(max(a - b, low), high) for a, b in zip(target, pair, strict=True))
        c_u = low if k < lowering else c_u
        pair[:] = pair[0] + c_l, pair[1] + c_u
        cost += (pair[0] - target[0]) ** 2 + (pair[1] - target[1]) ** 2
        rows.append((mode_now, c_l, c_u))
    return np.array(rows), cost


def test_the_bound_is_for_thresholds_between_start_and_target():
    """
    The example of `ThresholdCorrector`: (2.42)-(2.44) as printed allow a cheaper plan, which leaves
    that interval.
    """
    state, target = (0.97, 0.389, 0.2149, 0.645, 1), (0.29, 0.72)
    plan = corrector(target=target, c_b=1e-2, horizon=100).step(*state)
    rows, cost = by_hand(PILOT, *state, target, 1e-2, 100, lowering=2)
    assert plan.message == OPTIMAL
    assert plan.cost == plan.cost_lower_bound == approx(0.8477, abs=5e-5)
    assert cost == approx(0.5998, abs=5e-5)
    assert (rows[:2, 2] < 0.0).all()


pairs = st.tuples(st.floats(-0.4, 0.3), st.floats(0.01, 0.5)).map(lambda x: (x[0], sum(x)))


@settings(max_examples=150)
@given(
    st.floats(0, 1),
    st.floats(0, 1),
    pairs,
    pairs,
    st.integers(0, 1),
    st.one_of(st.floats(-6, -1.5), st.floats(0, 12)),
    st.integers(1, 60),
    st.sampled_from(list(OPERATORS.values())),
)
def test_plans_keep_their_promises(r, part, start, target, mode, decade, horizon, model):
    c_b, robot = 10.0**decade, model.robot
    ours = corrector(model, (0.05, 0.3), c_b=c_b, horizon=horizon)
    # Whatever the rule does under it.
    ours.target, ours._problem = target, (model.constants(), c_b, np.array(target))
    p_r = min(robot.p_min + part * (robot.p_max - robot.p_min), robot.p_max)
    plan = ours.step(r, p_r, *start, mode)
    table = plan.table()
    assert list(table) == ["r", "p_r", "lower", "upper", "mode", "c_l", "c_u"]
    pair = table[["lower", "upper"]]
    assert (pair >= np.minimum(start, target) - 1e-15).all(axis=None)
    assert (pair <= np.maximum(start, target) + 1e-15).all(axis=None)
    assert (table["lower"] < table["upper"]).all()
    rows, cost = by_hand(model, r, p_r, *start, mode, target, c_b, horizon)
    assert_allclose(table[["mode", "c_l", "c_u"]][:-1], rows, rtol=1e-9, atol=1e-15)
    assert plan.cost == approx(cost, rel=1e-9, abs=1e-25)
    assert 0.0 <= plan.cost_lower_bound <= plan.cost
    assert plan.relative_gap * plan.cost == approx(plan.gap)
    assert plan.message == (OPTIMAL if plan.gap == 0.0 else BOUNDED)
    assert plan.tsc == approx(model.value(p_r, model.human.performance(r)))
    assert plan.suggestion == (0 if plan.tsc >= start[1] else 1 if plan.tsc <= start[0] else -1)


def test_an_incentive_that_fails_on_the_way_holds_the_thresholds():
    def late(r, p_r, c_b, p_min, p_max):
        return (0.1 if r > 0.95 else -0.1) * c_b, 0.5 * c_b

    plan = corrector(incentive=late, horizon=8).step(0.97, 0.3, *START)
    assert (plan.status, plan.c_l, plan.c_u) == ("held", 0.0, 0.0)
    assert "the incentive leaves" in plan.message
    assert plan.table()["upper"][0] == START[1]
    assert plan.table()["mode"].isna().all()


@pytest.mark.parametrize(
    ("incentive", "says"),
    [
        (lambda r, *_: (0.0, 0.0) if r < 0.8 else 1 / 0, "ZeroDivision"),
        (lambda *_: np.array([[-1e-5], [1e-5]]), "TypeError"),
        (lambda *_: (-1e-5, 2e-5), r"in \[0, c_b\]"),
        (lambda *_: (1e-5, -1e-5), "returned 1e-05 and -1e-05"),
    ],
)
def test_what_is_no_incentive_is_refused_before_any_loop(incentive, says):
    with refused(f"incentive .*{says}"):
        corrector(incentive=incentive)


def test_incentive_bounds_at_the_corners_take_rounding_and_nothing_more():
    found = tl.incentive_bounds([0.0, 1.0, 0.0], [0.24, 0.39, 0.39 + 1e-12], 1e-5, PILOT)
    assert_allclose(found, [[0.0, -1e-5, -0.5e-5], [1e-5, 0.0, 0.5e-5]], atol=1e-20)
    for r, p_r in (([0.5, 1.5], 0.3), (0.5, 0.4)):
        with refused(r"lies outside the model's range"):
            tl.incentive_bounds(r, p_r, 1.0, PILOT)
    with refused("lies outside the model's range"):
        corrector().step(0.5, 0.4, *START)


@pytest.mark.filterwarnings("error")
def test_targets_outside_the_limits():
    limits = tl.threshold_limits(SECOND, None)
    for target in ((0.0, 0.9), (-0.9, 0.3)):
        with refused(f"{limits.upper:.4f}.*does not keep switching"):
            tl.ThresholdCorrector(SECOND, target)
    with pytest.warns(TargetWarning, match=r"-0\.1170 and TSC_ub = 0\.1170"):
        tl.ThresholdCorrector(PILOT, TARGET)
    with refused('limit would do nothing without engine="casadi"'):
        tl.ThresholdCorrector(SECOND, (0.05, 0.4), limit=1.0)


def test_plans_do_not_share_memory_and_go_to_other_processes():
    engine = corrector(horizon=10)
    first = engine.step(0.5, 0.3, *START)
    elsewhere = pickle.loads(pickle.dumps(engine)).step(0.5, 0.3, *START)
    assert engine.step(0.9, 0.39 + 1e-12, *START).path[1, 0] == 0.39
    assert_array_equal(elsewhere.path, first.path)
