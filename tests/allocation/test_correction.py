"""
Correction of thresholds: clipping written out, random plans, and properties of (2.40)-(2.44).
"""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import trustlab as tl
from tests.allocation.cases import PILOT, SECOND, START, TARGET, corrector, written_out
from trustlab.allocation import TargetWarning
from trustlab.allocation.correction import BOUNDED, OPTIMAL


def towards(target, model=PILOT, **options):
    """A corrector with this target, whatever the rule does under it."""
    ours = corrector(model, (0.05, 0.3), **options)
    ours.target = target
    ours._problem = (model.constants(), ours.c_b, np.array(target))
    return ours


def by_hand(model, r, p_r, lower, upper, mode, target, c_b, steps, lowering=0):
    """
    Clip (target − threshold) to (2.42) step by step, in plain Python, the switch as in (2.8).

    In the first steps, as many as `lowering`, TSC_u is lowered as far as (2.42) allows instead.
    """
    rows, cost, robot, pair = [], 0.0, model.robot, [lower, upper]
    motion = written_out(model, pair, r, p_r, mode)
    for k, (r_now, p_now, _, mode_now) in zip(range(steps), motion, strict=False):
        part = (p_now - robot.p_min) / (robot.p_max - robot.p_min)
        low, high = -0.5 * (r_now + part) * c_b, 0.5 * (1 - r_now + 1 - part) * c_b
        c_l, c_u = (min(max(a - b, low), high) for a, b in zip(target, pair, strict=True))
        c_u = low if k < lowering else c_u
        pair[:] = pair[0] + c_l, pair[1] + c_u
        cost += (pair[0] - target[0]) ** 2 + (pair[1] - target[1]) ** 2
        rows.append((c_l, c_u, mode_now))
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
    assert plan.cost == plan.cost_lower_bound == pytest.approx(0.8477, abs=5e-5)
    assert cost == pytest.approx(0.5998, abs=5e-5)
    assert (rows[:2, 1] < 0.0).all()


states = st.tuples(
    st.floats(0, 1), st.floats(0, 1), st.floats(-0.4, 0.3), st.floats(0.01, 0.5), st.integers(0, 1)
)


@settings(max_examples=150)
@given(
    states,
    st.floats(-0.4, 0.3),
    st.floats(0.01, 0.5),
    st.one_of(st.floats(-6, -1.5), st.floats(0, 12)),
    st.integers(1, 60),
    st.sampled_from(["pilot", "1", "2", "3", "4", "5"]),
)
def test_plans_keep_their_promises(state, target_lower, width, decade, horizon, who):
    model, c_b = tl.published_models()[who], 10.0**decade
    r, part, lower, gap, mode = state
    upper, target = lower + gap, (target_lower, target_lower + width)
    p_r = min(model.robot.p_min + part * (model.robot.p_max - model.robot.p_min), model.robot.p_max)
    plan = towards(target, model, c_b=c_b, horizon=horizon).step(r, p_r, lower, upper, mode)
    table = plan.table()
    assert list(table) == ["r", "p_r", "lower", "upper", "mode", "c_l", "c_u"]
    for path, begin, end in (("lower", lower, target[0]), ("upper", upper, target[1])):
        assert min(begin, end) - 1e-15 <= table[path].min()
        assert table[path].max() <= max(begin, end) + 1e-15
    assert (table["lower"] < table["upper"]).all()
    rows, cost = by_hand(model, r, p_r, lower, upper, mode, target, c_b, horizon)
    np.testing.assert_allclose(table[["c_l", "c_u"]][:-1], rows[:, :2], rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(table["mode"][:-1], rows[:, 2])
    assert plan.cost == pytest.approx(cost, rel=1e-9, abs=1e-25)
    assert 0.0 <= plan.cost_lower_bound <= plan.cost
    assert plan.message == (OPTIMAL if plan.gap == 0.0 else BOUNDED)
    tsc = model.value(p_r, model.human.performance(r))
    assert plan.tsc == pytest.approx(tsc)
    assert plan.suggestion == (0 if plan.tsc >= upper else 1 if plan.tsc <= lower else -1)


@pytest.mark.parametrize("who", ["pilot", "1", "2", "3", "4", "5"])
def test_no_other_plan_costs_less_than_the_bound(who):
    """Oracle: plans of random corrections, mostly full steps, over horizons with many switches."""
    rng = np.random.default_rng(7)
    model = tl.published_models()[who]
    bounded = 0
    for _ in range(40):
        start = np.array([rng.uniform(-0.1, 0.1), rng.uniform(0.2, 0.45)])
        way = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.01, 0.1, 2)
        c_b, horizon = 10 ** rng.uniform(-5, -2), int(rng.integers(50, 1500))
        r, mode = rng.uniform(0.05, 0.95), int(rng.integers(2))
        p_r = rng.uniform(model.robot.p_min, model.robot.p_max)
        ours = towards(start + way, model, c_b=c_b, horizon=horizon)
        state = np.array([r, p_r, *start])
        plan = ours.step(*state, mode)
        ways = np.sign(way)[:, None]
        for _ in range(20):
            wish = np.where(rng.random((2, horizon)) < rng.uniform(0.5, 1.0), ways, -ways)
            cost = ours.followed(state, mode, wish * c_b * rng.random((2, 1)) ** 0.2)[0]
            assert plan.cost_lower_bound <= cost * (1.0 + 1e-12)
        bounded += plan.gap > 0.0
    assert bounded > 5


def test_the_bound_over_hours_is_valid_though_loose():
    plan = corrector(horizon=36_000).step(0.8, 0.36, *START, 1)
    assert plan.message == BOUNDED
    assert 0.0 < plan.cost_lower_bound < plan.cost
    assert plan.relative_gap == plan.gap / plan.cost


def test_an_incentive_of_ones_own():
    def own(r, p_r, c_b, p_min, p_max):
        return -0.3 * r * c_b, 0.4 * (1.0 - r) * c_b

    plan = corrector(incentive=own, horizon=50).step(0.6, 0.35, *START)
    table = plan.table().iloc[:-1]
    np.testing.assert_allclose(table["c_u"], 0.4 * (1 - table["r"]) * 1e-5, rtol=1e-12)
    assert plan.gap == 0.0


def test_an_incentive_may_leave_no_correction():
    plan = corrector(incentive=lambda *_: (0.0, 0.0)).step(0.6, 0.35, *START)
    assert plan.status == "planned"
    assert not plan.table()[["c_l", "c_u"]].iloc[:-1].any(axis=None)


def test_an_incentive_that_fails_on_the_way_holds_the_thresholds():
    def late(r, p_r, c_b, p_min, p_max):
        return (0.1 if r > 0.95 else -0.1) * c_b, 0.5 * c_b

    plan = corrector(incentive=late, horizon=8).step(0.97, 0.3, *START)
    assert (plan.status, plan.c_l, plan.c_u) == ("held", 0.0, 0.0)
    assert "the incentive leaves" in plan.message
    assert plan.table()["upper"][0] == START[1]
    assert plan.table().isna().sum()["mode"] == 9


@pytest.mark.parametrize(
    ("incentive", "says"),
    [
        (lambda r, *_: (0.0, 0.0) if r < 0.8 else 1 / 0, "ZeroDivision"),
        (lambda *_: np.array([[-1e-5], [1e-5]]), "TypeError"),
        (lambda *_: (-1e-5, 2e-5), r"in \[0, c_b\]"),
        (lambda *_: (1e-5, -1e-5), "returned 1e-05 and -1e-05"),
        (lambda *_: (np.nan, 1e-5), "returned nan"),
    ],
)
def test_what_is_no_incentive_is_refused_before_any_loop(incentive, says):
    with pytest.raises(ValueError, match=f"incentive .*{says}"):
        corrector(incentive=incentive)


def test_incentive_bounds_at_the_corners_take_rounding_and_nothing_more():
    low, high = tl.incentive_bounds([0.0, 1.0, 0.0, 1.0], [0.24, 0.39, 0.39, 0.24], 1e-5, PILOT)
    np.testing.assert_allclose(low, [0.0, -1e-5, -0.5e-5, -0.5e-5], atol=1e-20)
    np.testing.assert_allclose(high, [1e-5, 0.0, 0.5e-5, 0.5e-5], atol=1e-20)
    assert tl.incentive_bounds(0.0, 0.39 + 1e-12, 1.0, PILOT)[1] == pytest.approx(0.5)
    for r, p_r in (([0.5, 1.5], 0.3), (0.5, 0.4)):
        with pytest.raises(ValueError, match=r"lies outside the model's range"):
            tl.incentive_bounds(r, p_r, 1.0, PILOT)


@pytest.mark.filterwarnings("error")
def test_targets_outside_the_limits():
    limits = tl.threshold_limits(SECOND, None)
    with pytest.raises(ValueError, match=f"{limits.upper:.4f}.*does not keep switching"):
        tl.ThresholdCorrector(SECOND, (0.0, 0.9))
    with pytest.raises(ValueError, match="does not keep switching"):
        tl.ThresholdCorrector(SECOND, (-0.9, 0.3))
    with pytest.warns(TargetWarning, match=r"-0\.1170 and TSC_ub = 0\.1170"):
        tl.ThresholdCorrector(PILOT, TARGET)
    tl.ThresholdCorrector(SECOND, (0.05, 0.4))


def test_bad_input_is_refused_and_rounding_of_performance_forgiven():
    engine = corrector(SECOND, (0.05, 0.4))
    with pytest.raises(ValueError, match=r"p_r = .* outside the model's range"):
        engine.step(0.5, 0.36, 0.0, 0.35)
    with pytest.raises(ValueError, match='limit would do nothing without engine="casadi"'):
        corrector(limit=1.0)
    assert engine.step(0.5, 0.35 + 1e-12, 0.0, 0.35).path[1, 0] == 0.35


def test_plans_do_not_share_memory_and_go_to_other_processes():
    engine = corrector(horizon=10)
    first = engine.step(0.5, 0.3, *START)
    elsewhere = pickle.loads(pickle.dumps(engine)).step(0.5, 0.3, *START)
    np.testing.assert_array_equal(elsewhere.path, first.path)
    path = first.path.copy()
    engine.step(0.9, 0.38, *START)
    np.testing.assert_array_equal(first.path, path)
