"""
Correction of thresholds: clipping as closed form, an independent simulation, properties
(2.40)-(2.44), bad input.
"""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import trustlab as tl
from trustlab.allocation import CorrectionStatus, TargetWarning, incentive_box, simulate_correction
from trustlab.allocation.correction.exact import ExactEngine
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
    assert plan.message.startswith("1 ")
    assert plan.gap == 0.0
    assert plan.status is CorrectionStatus.OPTIMAL
    assert plan.cost == pytest.approx(cost, rel=1e-12)
    np.testing.assert_allclose(plan.actions_l, rows[:, 0], rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(plan.actions_u, rows[:, 1], rtol=1e-9, atol=1e-20)
    np.testing.assert_array_equal(plan.mode, rows[:, 2])


def test_the_bound_is_for_thresholds_between_start_and_target():
    """
    The example of `ThresholdCorrector`: (2.42)-(2.44) as printed allow a cheaper plan, which leaves
    that interval.
    """
    state = (0.97, 0.389, 0.2149, 0.645, 1)
    target = (0.29, 0.72)
    c_b = 1e-2
    steps = 100
    plan = ExactEngine(PILOT, *target, c_b, steps).solve(*state)
    rows, cost = by_hand(PILOT, *state, target, c_b, steps, lowering=2)
    assert plan.status is CorrectionStatus.OPTIMAL
    assert "between its value now and its target" in plan.status.value
    assert plan.cost == plan.cost_lower_bound == pytest.approx(0.8477, abs=5e-5)
    assert cost == pytest.approx(0.5998, abs=5e-5)
    assert (rows[:2, 1] < 0.0).all()
    again = simulate_correction(PILOT, *state, rows[:, 0], rows[:, 1], target)
    assert again["cost"] == pytest.approx(cost, rel=1e-12)
    assert again["upper"].min() < state[3] < target[1]


def test_holding_back_can_beat_clipping():
    """
    TSC passes just below the threshold as clipping moves it: holding it back lets the robot drive
    earlier.
    """
    plan_of = ExactEngine(PILOT, *TARGET, 1e-5, 200)
    beaten = 0
    for p_r in np.linspace(0.3825, 0.3829, 4001):
        plan = plan_of.solve(0.8, float(p_r), 0.02, 0.45, 1)
        cost = (
            by_hand(PILOT, 0.8, p_r, 0.02, 0.45, 1, TARGET, 1e-5, 200)[1]
            if plan.gap > 0.0
            else plan.cost
        )
        assert plan.cost <= cost
        assert plan.cost_lower_bound <= plan.cost
        assert plan.relative_gap < 1e-11
        beaten += plan.cost < cost * (1 - 1e-12)
    assert beaten > 0


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
    plan = ExactEngine(model, *target, c_b, horizon).solve(r, p_r, lower, upper, mode)
    for path, begin, end in ((plan.lower, lower, target[0]), (plan.upper, upper, target[1])):
        assert min(begin, end) <= path.min()
        assert path.max() <= max(begin, end)
    assert (plan.lower < plan.upper).all()
    low, high = np.array(
        [
            incentive_box(*s, c_b, model.robot.p_min, model.robot.p_max)
            for s in zip(plan.r, plan.p_r, strict=True)
        ]
    ).T
    for actions in (plan.actions_l, plan.actions_u):
        assert (actions >= np.minimum(low[:-1], 0) - 1e-15).all()
        assert (actions <= np.maximum(high[:-1], 0) + 1e-15).all()
    run = simulate_correction(
        model, r, p_r, lower, upper, mode, plan.actions_l, plan.actions_u, target
    )
    np.testing.assert_array_equal(run["mode"], plan.mode)
    for name in ("r", "p_r", "lower", "upper"):
        np.testing.assert_array_equal(run[name], getattr(plan, name))
    assert run["cost"] == pytest.approx(plan.cost, rel=1e-12, abs=1e-300)
    assert 0.0 <= plan.cost_lower_bound <= plan.cost
    clipped = by_hand(model, r, p_r, lower, upper, mode, target, c_b, horizon)[1]
    assert plan.cost <= clipped * (1 + 1e-9) + 1e-25
    if plan.message.startswith("1 ") and plan.status is CorrectionStatus.OPTIMAL:
        assert plan.gap == 0.0


def test_the_bound_of_a_search_cut_short_holds():
    """
    Oracle: the plan of a long search, and plans of random corrections; none may cost less than the
    bound.
    """
    rng = np.random.default_rng(7)
    cut = tight = 0
    for _ in range(150):
        r = rng.random()
        lower = rng.uniform(-0.4, 0.3)
        gap = rng.uniform(0.01, 0.5)
        mode = int(rng.integers(2))
        p_r, horizon = (
            rng.uniform(SECOND.robot.p_min, SECOND.robot.p_max),
            int(rng.integers(50, 600)),
        )
        upper, c_b = lower + gap, 10 ** rng.uniform(-4.5, -2)
        target = (lower + rng.uniform(-0.1, 0.1), lower + gap + rng.uniform(-0.1, 0.1))
        if target[0] >= target[1]:
            continue
        short = ExactEngine(SECOND, *target, c_b, horizon, budget=1).solve(
            r, p_r, lower, upper, mode
        )
        long = ExactEngine(SECOND, *target, c_b, horizon, budget=100).solve(
            r, p_r, lower, upper, mode
        )
        cost = random_corrections(SECOND, r, p_r, lower, upper, mode, target, c_b, horizon, rng)
        for plan in (short, long):
            for other in (short.cost, long.cost, cost):
                assert plan.cost_lower_bound <= other * (1 + 1e-12)
        cut += short.status is CorrectionStatus.BOUNDED
        tight += long.cost < short.cost * (1 - 1e-9) or short.relative_gap < 0.01
    assert cut > 20
    assert tight > 20


def test_the_bound_over_many_switches_holds():
    """
    The same where whole phases bound the cost: long horizons, thresholds that rise, fall, or part;
    oracle as above.
    """
    rng = np.random.default_rng(11)
    cut = 0
    for who in ("pilot", "1", "2", "3", "4", "5") * 4:
        model, way = published_models()[who], rng.choice([-1.0, 1.0], 2)
        lower, upper = rng.uniform(-0.1, 0.1), rng.uniform(0.2, 0.45)
        target = (lower + way[0] * rng.uniform(0.01, 0.1), upper + way[1] * rng.uniform(0.01, 0.1))
        c_b, horizon = 10 ** rng.uniform(-5, -3.5), int(rng.integers(1200, 3000))
        r, mode = rng.uniform(0.3, 0.95), int(rng.integers(2))
        p_r = rng.uniform(model.robot.p_min, model.robot.p_max)
        plan = ExactEngine(model, *target, c_b, horizon, budget=2).solve(r, p_r, lower, upper, mode)
        other = ExactEngine(model, *target, c_b, horizon, budget=60).solve(
            r, p_r, lower, upper, mode
        )
        cost = random_corrections(model, r, p_r, lower, upper, mode, target, c_b, horizon, rng)
        assert max(plan.cost_lower_bound, other.cost_lower_bound) <= min(
            plan.cost, other.cost, cost
        ) * (1 + 1e-12)
        cut += plan.status is CorrectionStatus.BOUNDED
    assert cut > 6


@pytest.mark.parametrize("horizon", [3600, 36_000])
def test_the_bound_over_an_hour_is_valid_though_loose(horizon):
    plan = ExactEngine(PILOT, *TARGET, 1e-5, horizon).solve(0.8, 0.36, *START, 1)
    assert plan.status is CorrectionStatus.BOUNDED
    assert 0.0 <= plan.cost_lower_bound < plan.cost


def random_corrections(model, r, p_r, lower, upper, mode, target, c_b, steps, rng):
    """The cost of admissible corrections drawn at random, mostly full steps."""
    ends = [sorted(pair) for pair in zip((lower, upper), target, strict=True)]
    cost = 0.0
    for _ in range(steps):
        low, high = incentive_box(r, p_r, c_b, model.robot.p_min, model.robot.p_max)
        now = []
        for x, end, goal in zip((lower, upper), ends, target, strict=True):
            share = 1.0 if rng.random() < 0.8 else rng.random()
            forth, back = (high, low) if x < goal else (low, high)
            now.append(
                min(max(x + (share * forth if rng.random() < 0.95 else back), end[0]), end[1])
            )
        if now[0] >= now[1]:
            now = [lower, upper]
        run = simulate_correction(
            model, r, p_r, lower, upper, mode, [now[0] - lower], [now[1] - upper], target
        )
        cost += run["cost"]
        r, p_r, mode, (lower, upper) = run["r"][1], run["p_r"][1], int(run["mode"][0]), now
    return cost


def test_corrections_far_greater_than_the_way_stay_within_it():
    for c_b in (1.0, 1e6, 1e12):
        for p_r in np.linspace(0.24, 0.39, 40):
            plan = ExactEngine(PILOT, *TARGET, c_b, 30).solve(0.7, p_r, *START, 1)
            assert START[0] <= plan.lower.min()
            assert plan.lower.max() <= TARGET[0]
            assert START[1] <= plan.upper.min()
            assert plan.upper.max() <= TARGET[1]
            assert plan.cost_lower_bound <= plan.cost


def test_budget_and_status_go_together():
    plan = ExactEngine(PILOT, *TARGET, 1e-5, 5000, budget=1).solve(0.6, 0.35, *START, 1)
    assert plan.status is CorrectionStatus.BOUNDED
    assert 0.0 < plan.gap < plan.cost
    assert plan.relative_gap == plan.gap / plan.cost
    assert "budget" in plan.status.value


def test_closed_loop_follows_the_first_plan_when_nothing_disturbs():
    """
    Receding horizon towards the end of a plan that reaches its target: what was planned is what
    happens.
    """
    engine = corrector(c_b=5e-3, horizon=150)
    plan = engine.step(0.5, 0.3, *START, 1)
    r, p_r, lower, upper, mode = 0.5, 0.3, *START, 1
    for k in range(140):
        step = engine.step(r, p_r, lower, upper, mode)
        assert step.c_l == pytest.approx(plan.actions_l[k], abs=1e-15)
        assert step.c_u == pytest.approx(plan.actions_u[k], abs=1e-15)
        r = float(step.r[1])
        p_r = float(step.p_r[1])
        mode = int(step.mode[0])
        lower, upper = float(step.lower[1]), float(step.upper[1])
    assert (lower, upper) == pytest.approx(TARGET)


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
    assert "OPTIMAL" in repr(plan)
    assert "horizon=20" in repr(corrector(horizon=20))
    assert plan.solve_time > 0.0
    assert plan.cost_with_additions == plan.cost


def own_incentive(r, p_r, c_b, p_min, p_max):
    return -0.3 * r * c_b, 0.4 * (1.0 - r) * c_b


@pytest.mark.slow
def test_incentives_of_ones_own():
    """Compiled into the search: some seconds."""
    engine = corrector(incentive=own_incentive, horizon=50)
    plan = engine.step(0.6, 0.35, *START)
    np.testing.assert_allclose(plan.actions_u, 0.4 * (1 - plan.r[:-1]) * 1e-5, rtol=1e-12)
    assert plan.gap == 0.0


def test_wrong_incentives_are_refused():
    for wrong in (
        lambda r, p_r, c_b, p_min, p_max: (-2 * c_b, c_b),
        lambda r, p_r, c_b, p_min, p_max: (c_b, c_b),
        lambda r, p_r: (0.0, 0.0),
        lambda r, p_r, c_b, p_min, p_max: 0.5 * c_b,
        lambda r, p_r, c_b, p_min, p_max: (0.0, c_b * float("nan")),
    ):
        with pytest.raises(ValueError, match="incentive must"):
            corrector(incentive=wrong)
    with pytest.raises(ValueError, match="function of"):
        corrector(incentive=3)


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
        ({"target": (0.1, 0.1)}, "below"),
        ({"target": 0.1}, "two numbers"),
        ({"target": (0.1, 0.2, 0.3)}, "two numbers"),
        ({"target": (0.1, float("nan"))}, "finite"),
        ({"target": ("a", 0.2)}, "number"),
        ({"target": 10**400}, "two numbers, lower and upper, got 1000"),
        ({"c_b": 0.0}, "positive"),
        ({"c_b": -1e-5}, "positive"),
        ({"c_b": float("inf")}, "finite"),
        ({"horizon": 0}, "horizon"),
        ({"horizon": 2.5}, "horizon"),
        ({"horizon": True}, "horizon"),
        ({"engine": "ipopt"}, "'exact', 'casadi'"),
        ({"engine": ["exact"]}, "'exact', 'casadi'"),
        ({"budget": 10**20}, "budget"),
        ({"budget": 0}, "budget"),
        ({"budgt": 3}, "has no option 'budgt'; it has budget"),
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
    assert engine.step(0.5, 0.35 + 1e-12, 0.0, 0.35).p_r[0] == 0.35
    assert engine.step(np.float64(0.5), np.float32(0.3), 0.0, 0.35, np.int64(1)).mode[0] == 1.0


def test_plans_do_not_share_memory():
    engine = corrector(horizon=10)
    first = engine.step(0.5, 0.3, *START)
    kept = first.r.copy()
    engine.step(0.9, 0.38, *START)
    np.testing.assert_array_equal(first.r, kept)
