"""(2.9)-(2.21) and (2.33) against Tables 2.1 and 2.2, and what is claimed of them against simulation."""

import math

import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation import simulate_allocation, steady_state_bounds, step_bounds, threshold_limits
from trustlab.allocation.steady_state import utilization_bounds
from trustlab.reproduction import published_table


@pytest.fixture(scope="module")
def printed():
    """Table 2.1 and 2.2 as numbers, with the models that have the printed, rounded b_pr."""
    one, two = published_table("2.1").astype(float), published_table("2.2").astype(float)
    models = {}
    for name in one.columns:
        p = one[name]
        robot = tl.RobotModel(p["a_pr"], p["P_r_min"], p["P_r_max"], p["P_h_max"], b=p["b_pr"])
        human = tl.HumanModel(p["a_r"], p["beta"], p["P_h_min"], p["P_h_max"])
        models[name] = tl.TscModel(robot, human)
    return one, two, models


@pytest.mark.parametrize("name", ["2", "4"])
def test_limits_are_the_printed_ones(printed, name):
    one, _, models = printed
    limits = threshold_limits(models[name], one.loc["delta_P_h", name])
    assert limits.lower == pytest.approx(one.loc["TSC_lb", name], abs=0.0006)
    assert limits.upper == pytest.approx(one.loc["TSC_ub", name], abs=0.0006)


@pytest.mark.parametrize("name", ["2", "4", "5"])
def test_bounds_are_those_of_table_2_2(printed, name):
    one, two, models = printed
    row = two[name]
    bounds = steady_state_bounds(
        models[name], row["TSC_l"], row["TSC_u"], delta_tsc=one.loc["delta_TSC", name]
    )
    for key, value in (
        ("P_rl", bounds.p_r_low),
        ("P_ru", bounds.p_r_high),
        ("r_l", bounds.r_low),
        ("r_u", bounds.r_high),
    ):
        text = published_table("2.2").loc[key, name]
        unit = 10.0 ** -len(text.split(".")[1])
        assert abs(value - float(text)) <= 1.6 * unit, (key, value, text)


def test_participant_3_does_not_follow_from_its_own_thresholds(printed):
    one, two, models = printed
    row = two["3"]
    bounds = steady_state_bounds(models["3"], row["TSC_l"], row["TSC_u"], delta_tsc=one.loc["delta_TSC", "3"])
    assert bounds.p_r_low < row["P_rl"] - 0.005
    assert bounds.r_high < row["r_u"] - 0.05


def test_signs_of_a3_and_infinite_dwell_times(operators):
    human = tl.HumanModel(0.99, 0.7, 0.3, 0.4)
    wide, narrow = tl.RobotModel(0.9, 0.05, 0.5, 0.4), tl.RobotModel(0.9, 0.4, 0.41, 0.4)
    for robot, best in ((wide, human.p_min), (narrow, human.p_max)):
        model = tl.TscModel(robot, human)
        slope = model.a_T * robot.b / (1 - robot.a) - model.b_T
        assert (slope > 0) == (robot is wide)
        expected = slope * best + model.a_T * robot.p_min
        assert threshold_limits(model, 0.0).upper == pytest.approx(expected, abs=1e-12)
    first = steady_state_bounds(operators["1"], 0.15, 0.62, delta_tsc=0.0022)
    assert first.dwell_manual_high == math.inf
    assert first.r_high == 1.0
    low = steady_state_bounds(operators["1"], -0.694, 0.3, delta_tsc=0.0022)
    assert low.p_r_low == operators["1"].robot.p_min
    assert low.dwell_autonomous == math.inf
    assert low.r_low == 0.0
    assert utilization_bounds(0.999, math.inf, math.inf, 0.0) == (1.0, 1.0)


def test_remark_4_says_what_to_change():
    model = tl.TscModel(tl.RobotModel(0.999, 0.3, 0.4, 0.5), tl.HumanModel(0.9, 0.7, 0.3, 0.5))
    limits = threshold_limits(model, 0.01)
    assert not limits.feasible
    from trustlab.allocation.limits import check_thresholds

    with pytest.raises(ValueError, match=r"does not exceed TSC_lb.*Remark 4"):
        check_thresholds(model, 0.0, 0.1, limits)
    good = threshold_limits(model, 0.0)
    with pytest.raises(ValueError, match=f"TSC_ub = {good.upper:.4f}"):
        check_thresholds(model, 0.0, 0.99, good)


def test_lemmas_theorem_1_and_the_bounds_that_hold(random_model):
    """TSC falls alone and rises under manual control inside the band; (2.14), (2.15), Proposition 1 and Lemmas 3-4 hold."""
    seen = below = above = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        model, lower, upper = random_model(rng, quick=False)
        run = simulate_allocation(model, lower, upper, 60_000, rng.random(), None, 1)
        tail = run.iloc[30_000:]
        change = tail.diff().shift(-1).iloc[:-1]
        delta_p_h, delta_p_r = change["p_h"].abs().max(), change["p_r"].abs().max()
        limits = threshold_limits(model, delta_p_h)
        if not limits.contains(lower, upper):
            continue
        seen += 1
        now = tail.iloc[:-1]
        alone = (now["mode"] == 0) & (now["tsc"] > limits.lower)
        driven = (now["mode"] == 1) & (now["tsc"] < limits.upper)
        assert (change["tsc"][alone] < 0).all()  # Lemma 1
        assert (change["tsc"][driven] > 0).all()  # Lemma 2
        assert tail["mode"].nunique() == 2  # Theorem 1
        delta = model.delta(delta_p_r, delta_p_h)
        bounds = steady_state_bounds(model, lower, upper, delta_tsc=delta)
        assert tail["tsc"].between(bounds.tsc_low - 1e-12, bounds.tsc_high + 1e-12).all()  # (2.14)
        assert tail["p_r"].between(bounds.p_r_low - 1e-12, bounds.p_r_high + 1e-12).all()  # (2.15)
        assert bounds.dwell_manual_low <= bounds.dwell_manual_high  # Proposition 1
        edges = np.flatnonzero(np.diff(tail["mode"])) + 1
        lengths, who = np.diff(edges), tail["mode"].to_numpy()[edges[:-1]]
        assert lengths[who == 0].max() <= bounds.dwell_autonomous + 1  # Lemma 3
        assert lengths[who == 1].max() <= bounds.dwell_manual_high + 1  # Lemma 4
        below += tail["r"].min() < bounds.r_low - 1e-12
        above += tail["r"].max() > bounds.r_high + 1e-12
    assert seen > 150
    # Theorem 2 claims both never happen. The upper bound is left often; the lower one too, since the swing of P_r is
    # narrower than from P_rl to P_ru, so that manual phases are shorter than τ_dml.
    assert 0.15 < above / seen < 0.5
    assert 0 < below / seen < 0.1


def test_lemma_5(operators):
    human = operators["pilot"].human
    r, _ = human.simulate(np.r_[np.ones(40), np.zeros(40)], r0=0.3)
    n = np.arange(40)
    np.testing.assert_allclose(r[:40], (0.3 - 1) * human.a**n + 1, atol=1e-13)
    np.testing.assert_allclose(r[40:], r[40] * human.a**n, atol=1e-13)


def test_step_bounds_bound_every_step(random_model):
    for seed in range(40):
        rng = np.random.default_rng(seed)
        model, lower, upper = random_model(rng)
        run = simulate_allocation(model, lower, upper, 5000, rng.random(), None, 1)
        inside = run.iloc[1000:]
        bounds = step_bounds(model, inside["r"].min() * 0.999, min(inside["r"].max() * 1.001, 1.0))
        assert inside["p_h"].diff().abs().max() <= bounds.delta_p_h * (1 + 1e-9)
        assert inside["p_r"].diff().abs().max() <= bounds.delta_p_r * (1 + 1e-9)
        assert inside["tsc"].diff().abs().max() <= bounds.delta_tsc * (1 + 1e-9)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((0.5, 0.1), "below"),
        ((0.0, 0.4, -0.1), "cannot be negative"),
        ((0.0, 0.4, float("nan")), "finite"),
        ((-3.0, 0.2, 0.001), r"strictly between TSC_lb = -0.4909 and TSC_ub = 0.4909"),
        ((0.0, 0.6, 0.001), "TSC_ub = 0.4909"),
    ],
)
def test_refuses(operators, arguments, says):
    with pytest.raises(ValueError, match=says):
        steady_state_bounds(operators["pilot"], *arguments)
    with pytest.raises(ValueError, match="cannot be negative"):
        threshold_limits(operators["pilot"], -1.0)
