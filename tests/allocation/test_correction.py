"""
Correction of thresholds: clipping as closed form, an independent simulation, properties
(2.40)-(2.44), bad input.
"""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import trustlab as tl
from trustlab.allocation import TargetWarning, incentive_box
from trustlab.allocation.correction import BOUNDED, OPTIMAL
from trustlab.models.published import published_models

PILOT = published_models()["pilot"]
SECOND = published_models()["2"]
START, TARGET = (0.02, 0.45), (0.15, 0.56)
LIGHT = settings(max_examples=150, deadline=None, derandomize=True)


def corrector(model=PILOT, target=TARGET, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TargetWarning)
        return tl.ThresholdCorrector(model, target, **more)


def by_hand(model, r, p_r, lower, upper, mode, target, c_b, steps, lowering=0):
    """
    Clip (target − threshold) to (2.42) step by step, in plain Python, the switch as in (2.8).

    In the first steps, as many as `lowering`, TSC_u is lowered as far as (2.42) allows instead.
    """
    rows = []
    cost = 0.0
    robot = model.robot
    human = model.human
    for k in range(steps):
        p_h = human.p_min
        if 0 < r < 1:
            share = (r / human.beta) ** human.beta * ((1 - r) / (1 - human.beta)) ** (
                1 - human.beta
            )
            p_h += (human.p_max - human.p_min) * share
        tsc = model.a_T * p_r - model.b_T * p_h
        mode = 0 if tsc >= upper else 1 if tsc <= lower else mode
        part = (p_r - robot.p_min) / (robot.p_max - robot.p_min)
        low, high = -0.5 * (r + part) * c_b, 0.5 * (1 - r + 1 - part) * c_b
        c_l, c_u = (min(max(a - b, low), high) for a, b in zip(target, (lower, upper), strict=True))
        c_u = low if k < lowering else c_u
        lower, upper = lower + c_l, upper + c_u
        cost += (lower - target[0]) ** 2 + (upper - target[1]) ** 2
        rows.append((c_l, c_u, mode))
        p_r = robot.a * p_r + (1 - robot.a) * robot.p_min + mode * robot.b * p_h
        r = human.a * r + (1 - human.a) * mode
    return np.array(rows), cost


@pytest.mark.parametrize(
    ("start", "target"),
    [(START, TARGET), (START, (0.1, 0.55)), (TARGET, START), ((0.1, 0.4), (0.02, 0.5))],
)
def test_without_a_choice_of_modes_the_plan_is_clipping(start, target):
    plan = corrector(target=target).step(r=0.6, p_r=0.33, lower=start[0], upper=start[1], mode=1)
    rows, cost = by_hand(PILOT, 0.6, 0.33, *start, 1, target, 1e-5, 200)
    assert plan.gap == 0.0
    assert (plan.status, plan.message) == ("planned", OPTIMAL)
    assert plan.cost == pytest.approx(cost, rel=1e-12)
    table = plan.table().iloc[:-1]
    np.testing.assert_allclose(table[["c_l", "c_u"]], rows[:, :2], rtol=1e-9, atol=1e-20)
    np.testing.assert_array_equal(table["mode"], rows[:, 2])


def test_the_bound_is_for_thresholds_between_start_and_target():
    """
    The example of `ThresholdCorrector`: (2.42)-(2.44) as printed allow a cheaper plan, which leaves
    that interval.
    """
    state = (0.97, 0.389, 0.2149, 0.645, 1)
    target = (0.29, 0.72)
    c_b = 1e-2
    steps = 100
    plan = corrector(target=target, c_b=c_b, horizon=steps).step(*state)
    rows, cost = by_hand(PILOT, *state, target, c_b, steps, lowering=2)
    assert "between its value now and its target" in plan.message
    assert plan.cost == plan.cost_lower_bound == pytest.approx(0.8477, abs=5e-5)
    assert cost == pytest.approx(0.5998, abs=5e-5)
    assert (rows[:2, 1] < 0.0).all()


states = st.tuples(
    st.floats(0, 1), st.floats(0, 1), st.floats(-0.4, 0.3), st.floats(0.01, 0.5), st.integers(0, 1)
)


@LIGHT
@given(
    states,
    st.floats(-0.4, 0.3),
    st.floats(0.01, 0.5),
    st.floats(-6, -1.5),
    st.integers(1, 60),
    st.sampled_from(["pilot", "1", "2", "3", "4", "5"]),
)
def test_plans_keep_their_promises(state, target_lower, width, decade, horizon, who):
    model, c_b = published_models()[who], 10.0**decade
    r, part, lower, gap, mode = state
    upper, target = lower + gap, (target_lower, target_lower + width)
    p_r = min(model.robot.p_min + part * (model.robot.p_max - model.robot.p_min), model.robot.p_max)
    plan = corrector(model, c_b=c_b, horizon=horizon)
    plan.target = target  # whatever the rule does under it
    plan._problem = (model.constants(), c_b, np.array(target))
    plan = plan.step(r, p_r, lower, upper, mode)
    table = plan.table()
    for path, begin, end in (("lower", lower, target[0]), ("upper", upper, target[1])):
        assert min(begin, end) - 1e-15 <= table[path].min()
        assert table[path].max() <= max(begin, end) + 1e-15
    assert (table["lower"] < table["upper"]).all()
    limits = model.robot.p_min, model.robot.p_max
    low, high = incentive_box(table["r"], table["p_r"], c_b, *limits)
    for actions in (table["c_l"][:-1], table["c_u"][:-1]):
        assert (actions >= np.minimum(low[:-1], 0) - 1e-15).all()
        assert (actions <= np.maximum(high[:-1], 0) + 1e-15).all()
    rows, cost = by_hand(model, r, p_r, lower, upper, mode, target, c_b, horizon)
    np.testing.assert_array_equal(table["mode"][:-1], rows[:, 2])
    assert plan.cost == pytest.approx(cost, rel=1e-9, abs=1e-25)
    assert 0.0 <= plan.cost_lower_bound <= plan.cost
    assert plan.message == (OPTIMAL if plan.gap == 0.0 else BOUNDED)


@pytest.mark.parametrize("who", ["pilot", "1", "2", "3", "4", "5"])
def test_no_other_plan_costs_less_than_the_bound(who):
    """Oracle: plans of random corrections, mostly full steps, over horizons with many switches."""
    rng = np.random.default_rng(7)
    model = published_models()[who]
    bounded = 0
    for _ in range(40):
        lower, upper = rng.uniform(-0.1, 0.1), rng.uniform(0.2, 0.45)
        way = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.01, 0.1, 2)
        target = (lower + way[0], upper + way[1])
        c_b, horizon = 10 ** rng.uniform(-5, -2), int(rng.integers(50, 1500))
        r, mode = rng.uniform(0.05, 0.95), int(rng.integers(2))
        p_r = rng.uniform(model.robot.p_min, model.robot.p_max)
        ours = corrector(model, c_b=c_b, horizon=horizon)
        ours._problem = (model.constants(), c_b, np.array(target))
        state = np.array([r, p_r, lower, upper])
        plan = ours.step(*state, mode)
        ways = np.sign(way)[:, None]
        for _ in range(20):
            wish = np.where(rng.random((2, horizon)) < rng.uniform(0.5, 1.0), ways, -ways)
            cost = ours.followed(state, mode, wish * c_b * rng.random((2, 1)) ** 0.2)[0]
            assert plan.cost_lower_bound <= cost * (1.0 + 1e-12)
        bounded += plan.gap > 0.0
    assert bounded > 5


def test_corrections_far_greater_than_the_way_stay_within_it():
    for c_b in (1.0, 1e6, 1e12):
        ours = corrector(c_b=c_b, horizon=30)
        for p_r in np.linspace(0.24, 0.39, 40):
            plan = ours.step(0.7, p_r, *START, 1)
            table = plan.table()
            assert table["lower"].between(START[0], TARGET[0]).all()
            assert table["upper"].between(START[1], TARGET[1]).all()
            assert plan.cost_lower_bound <= plan.cost


@pytest.mark.parametrize("horizon", [3600, 36_000])
def test_the_bound_over_an_hour_is_valid_though_loose(horizon):
    plan = corrector(horizon=horizon).step(0.8, 0.36, *START, 1)
    assert plan.message == BOUNDED
    assert 0.0 < plan.cost_lower_bound < plan.cost
    assert plan.relative_gap == plan.gap / plan.cost


def test_closed_loop_follows_the_first_plan_when_nothing_disturbs():
    """
    Receding horizon towards the end of a plan that reaches its target: what was planned is what
    happens.
    """
    engine = corrector(c_b=5e-3, horizon=150)
    table = engine.step(0.5, 0.3, *START, 1).table()
    state, mode = (0.5, 0.3, *START), 1
    for k in range(140):
        step = engine.step(*state, mode)
        assert (step.c_l, step.c_u) == pytest.approx(tuple(table.loc[k, ["c_l", "c_u"]]), abs=1e-15)
        following = step.table()
        state, mode = tuple(following.iloc[1, :4]), int(following["mode"][0])
    assert state[2:] == pytest.approx(TARGET)


def test_suggestions_are_those_of_algorithm_3():
    engine = corrector(SECOND, (0.05, 0.4))
    for p_r in np.linspace(0.24, 0.35, 23):
        plan = engine.step(0.7, p_r, 0.0, 0.35, 1)
        tsc = SECOND.value(p_r, SECOND.human.performance(0.7))
        assert plan.tsc == pytest.approx(tsc)
        assert plan.suggestion == (0 if tsc >= 0.35 else 1 if tsc <= 0.0 else -1)


def test_table_plot_and_repr():
    plan = corrector(horizon=20).step(0.6, 0.35, *START)
    table = plan.table()
    assert list(table.columns) == ["r", "p_r", "lower", "upper", "mode", "c_l", "c_u"]
    assert len(table) == 21
    assert table.iloc[-1].isna().sum() == 3
    assert len(plan.plot()) == 2
    assert "planned" in repr(plan)
    assert "horizon=20" in repr(corrector(horizon=20))


def own_incentive(r, p_r, c_b, p_min, p_max):
    return -0.3 * r * c_b, 0.4 * (1.0 - r) * c_b


def test_incentives_of_ones_own():
    plan = corrector(incentive=own_incentive, horizon=50).step(0.6, 0.35, *START)
    table = plan.table().iloc[:-1]
    np.testing.assert_allclose(table["c_u"], 0.4 * (1 - table["r"]) * 1e-5, rtol=1e-12)
    assert plan.gap == 0.0


def test_an_incentive_that_fails_on_the_way_holds_the_thresholds():
    def late(r, p_r, c_b, p_min, p_max):
        return (0.1 if r > 0.95 else -0.1) * c_b, 0.5 * c_b

    plan = corrector(incentive=late, horizon=8).step(0.97, 0.3, *START)
    assert (plan.status, plan.c_l, plan.c_u) == ("held", 0.0, 0.0)
    assert "the incentive leaves" in plan.message
    assert (plan.table()["upper"] == START[1]).all()


# Incentive bounds (2.42)


def test_incentive_bounds_at_the_corners():
    low, high = tl.incentive_bounds([0.0, 1.0, 0.0, 1.0], [0.24, 0.39, 0.39, 0.24], 1e-5, PILOT)
    np.testing.assert_allclose(low, [0.0, -1e-5, -0.5e-5, -0.5e-5], atol=1e-20)
    np.testing.assert_allclose(high, [1e-5, 0.0, 0.5e-5, 0.5e-5], atol=1e-20)
    assert tl.incentive_bounds(0.5, 0.315, 2.0, PILOT.robot) == pytest.approx((-1.0, 1.0))
    assert tl.incentive_bounds(0.5, 0.3, 1e-5, PILOT.robot) == tl.incentive_bounds(
        0.5, 0.3, 1e-5, PILOT
    )
    with pytest.raises(ValueError, match=r"range \[0.24, 0.39\]"):
        tl.incentive_bounds(0.5, 0.4, 1e-5, PILOT)


def test_incentive_bounds_without_a_model_say_whose_range_they_take():
    with pytest.warns(
        UserWarning, match=r"pilot operator's range of robot performance, 0\.24 to 0\.39 m/s"
    ):
        assert tl.incentive_bounds(0.5, 0.3, 1e-5) == tl.incentive_bounds(0.5, 0.3, 1e-5, PILOT)


@LIGHT
@given(st.floats(0, 1), st.floats(0, 1), st.floats(0.0, 1.0))
def test_incentive_bounds_fall_with_effort_and_reward(r, share, more):
    p_r = 0.24 + 0.15 * share
    low, high = tl.incentive_bounds(r, p_r, 1e-5, PILOT)
    assert high - low == pytest.approx(1e-5)
    assert -1e-5 - 1e-20 <= low <= 0.0 <= high <= 1e-5 + 1e-20
    busier = tl.incentive_bounds(r + (1 - r) * more, p_r, 1e-5, PILOT)
    better = tl.incentive_bounds(r, min(p_r + (0.39 - p_r) * more, 0.39), 1e-5, PILOT)
    assert busier[0] <= low + 1e-20
    assert busier[1] <= high + 1e-20
    assert better[0] <= low + 1e-20
    assert better[1] <= high + 1e-20


def test_incentive_bounds_take_rounding_and_nothing_more():
    assert tl.incentive_bounds(0.0, 0.39 + 1e-12, 1.0, PILOT)[1] == pytest.approx(0.5)
    for arguments, words in (
        ((1.1, 0.3, 1.0), "r must lie"),
        ((0.5, 0.4, 1.0), "range"),
        ((0.5, 0.3, 0.0), "c_b must be positive"),
        ((0.5, float("nan"), 1.0), "finite"),
        (([0.5, 1.5], 0.3, 1.0), r"sample \(1,\)"),
        (([0.5], [0.3, 0.9], 1.0), r"sample \(1,\)"),
        (([], [], 1.0), "empty"),
        (("a", 0.3, 1.0), "number"),
        ((["a"], 0.3, 1.0), "numbers"),
    ):
        with pytest.raises(ValueError, match=words):
            tl.incentive_bounds(*arguments, PILOT)
    with pytest.raises(ValueError, match="TscModel or a RobotModel"):
        tl.incentive_bounds(0.5, 0.3, 1.0, PILOT.human)


# Bad input


def test_targets_outside_the_limits():
    limits = tl.threshold_limits(SECOND, None)
    with pytest.raises(ValueError, match=f"{limits.upper:.4f}.*does not keep switching"):
        tl.ThresholdCorrector(SECOND, (0.0, 0.9))
    with pytest.raises(ValueError, match="does not keep switching"):
        tl.ThresholdCorrector(SECOND, (-0.9, 0.3))
    with pytest.warns(TargetWarning, match="-0.1170 and TSC_ub = 0.1170"):
        tl.ThresholdCorrector(PILOT, TARGET)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tl.ThresholdCorrector(SECOND, (0.05, 0.4))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"target": (0.4, 0.05)}, "below"),
        ({"target": (0.1, float("nan"))}, "finite"),
        ({"c_b": 0.0}, "positive"),
        ({"horizon": 2.5}, "horizon"),
        ({"engine": ["casadi"]}, "'casadi'"),
        ({"model": "pilot"}, "TscModel"),
    ],
)
def test_bad_correctors_are_refused(more, words):
    arguments = {"model": SECOND, "target": (0.05, 0.4)} | more
    with pytest.raises(ValueError, match=words):
        tl.ThresholdCorrector(arguments.pop("model"), **arguments)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"r": -0.01}, r"\[0, 1\]"),
        ({"r": 1.0001}, r"\[0, 1\]"),
        ({"r": float("nan")}, "r must"),
        ({"r": None}, "number"),
        ({"r": "0.5"}, "number"),
        ({"r": True}, "number"),
        ({"p_r": 0.351}, "range"),
        ({"p_r": 0.2}, "range"),
        ({"p_r": float("nan")}, "p_r"),
        ({"p_r": np.array([0.3, 0.3])}, "number"),
        ({"lower": 0.35}, "below"),
        ({"lower": 0.4}, "below"),
        ({"upper": float("inf")}, "finite"),
        ({"upper": 1.01}, r"\[-1, 1\]"),
        ({"lower": -1e308}, r"\[-1, 1\]"),
        ({"mode": 2}, "mode"),
        ({"mode": 0.5}, "mode"),
        ({"mode": True}, "mode"),
        ({"mode": None}, "mode"),
    ],
)
def test_bad_states_are_refused(more, words):
    engine = corrector(SECOND, (0.05, 0.4))
    with pytest.raises(ValueError, match=words):
        engine.step(**({"r": 0.5, "p_r": 0.3, "lower": 0.0, "upper": 0.35, "mode": 1} | more))


def test_rounding_of_performance_is_forgiven():
    engine = corrector(SECOND, (0.05, 0.4))
    assert engine.step(0.5, 0.35 + 1e-12, 0.0, 0.35).path[1, 0] == 0.35
    assert engine.step(np.float64(0.5), np.float32(0.3), 0.0, 0.35, np.int64(1)).path[4, 0] == 1.0


def test_plans_do_not_share_memory():
    engine = corrector(horizon=10)
    first = engine.step(0.5, 0.3, *START)
    kept = first.path.copy()
    engine.step(0.9, 0.38, *START)
    np.testing.assert_array_equal(first.path, kept)
