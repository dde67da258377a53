"""
(2.9)-(2.21) and (2.33) against Tables 2.1 and 2.2, and what is claimed of them against simulation.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import trustlab as tl
from tests.allocation.cases import shape
from trustlab.allocation import (
    simulate_allocation,
    steady_state_bounds,
    step_bounds,
    threshold_limits,
)
from trustlab.allocation.bounds import utilization_as_printed
from trustlab.reproduction import published_table
from trustlab.reproduction.printed import half_unit


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
    """
    One unit of the last digit, but for participant 4's r_l: 0.5886 against 0.587, within the
    rounding of the inputs.
    """
    one, two, models = printed
    rows, p = ["P_rl", "P_ru", "r_l", "r_u"], two[name]
    bounds = steady_state_bounds(models[name], p["TSC_l"], p["TSC_u"], one.loc["delta_TSC", name])
    found = np.array([bounds.p_r_low, bounds.p_r_high, bounds.r_low, bounds.r_high])
    units = [2.0 * half_unit(text) for text in published_table("2.2").loc[rows, name]]
    off = np.abs(found - p[rows]) / units
    if name == "4":
        assert off.pop("r_l") == pytest.approx(1.574, abs=0.001)
    assert off.max() < 0.7


def test_participant_3_does_not_follow_from_its_own_thresholds(printed):
    one, two, models = printed
    row = two["3"]
    bounds = steady_state_bounds(
        models["3"], row["TSC_l"], row["TSC_u"], delta_tsc=one.loc["delta_TSC", "3"]
    )
    assert bounds.p_r_low < row["P_rl"] - 0.005
    assert bounds.r_high < row["r_u"] - 0.05


def test_signs_of_a3_and_infinite_dwell_times(operators):
    human = tl.HumanModel(0.99, 0.7, 0.3, 0.4)
    wide, narrow = tl.RobotModel(0.9, 0.05, 0.5, 0.4), tl.RobotModel(0.9, 0.4, 0.41, 0.4)
    middle = tl.RobotModel(0.9, 0.08, 0.46, 0.4)
    for robot, best in ((wide, human.p_min), (middle, human.p_min), (narrow, human.p_max)):
        model = tl.TscModel(robot, human)
        slope = model.a_T * robot.b / (1 - robot.a) - model.b_T
        assert (slope > 1.0, slope > 0.0) == (robot is wide, robot is not narrow)
        expected = slope * best + model.a_T * robot.p_min
        assert threshold_limits(model, 0.0).upper == pytest.approx(expected, abs=1e-12)
    first = steady_state_bounds(operators["1"], 0.15, 0.62, delta_tsc=0.0022)
    assert first.dwell_manual_high == math.inf
    assert first.r_high == 1.0
    low = steady_state_bounds(operators["1"], -0.694, 0.3, delta_tsc=0.0022)
    assert low.p_r_low == operators["1"].robot.p_min
    assert low.dwell_autonomous_high == math.inf
    assert low.r_low == 0.0
    assert utilization_as_printed(0.999, math.inf, math.inf, 0.0) == (1.0, 1.0)


def test_remark_4_says_what_to_change():
    model = tl.TscModel(tl.RobotModel(0.999, 0.3, 0.4, 0.5), tl.HumanModel(0.9, 0.7, 0.3, 0.5))
    with pytest.raises(ValueError, match=f"TSC_ub = {threshold_limits(model).upper:.4f}"):
        steady_state_bounds(model, 0.0, 0.99)
    narrow = tl.TscModel(tl.RobotModel(0.999, 0.3, 0.31, 0.5), tl.HumanModel(0.9, 0.7, 0.1, 0.5))
    assert not threshold_limits(narrow).feasible
    with pytest.raises(ValueError, match=r"no thresholds fit \(Remark 4\); widen the range"):
        steady_state_bounds(narrow, 0.0, 0.1)


def settled(model, lower, upper, r0):
    """A run's second half, and its largest one-step changes δ_Ph and δ_Pr."""
    tail = simulate_allocation(model, lower, upper, 60_000, r0).iloc[30_000:]
    change = tail.diff().abs().max()
    return tail, change["p_h"], change["p_r"]


def test_theorem_2_fails_above_often_and_below_sometimes(random_model):
    """
    Theorem 2 claims both never happen: for the upper bound the text takes the longest autonomous
    dwell time where the shortest is needed, for the lower one the dwell time of a swing from P_rl
    to P_ru, and actual swings are narrower.
    """
    seen = below = above = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        model, lower, upper = random_model(rng, quick=False)
        tail, delta_p_h, delta_p_r = settled(model, lower, upper, rng.random())
        if not threshold_limits(model, delta_p_h).contains(lower, upper):
            continue
        seen += 1
        bounds = steady_state_bounds(
            model, lower, upper, delta_tsc=model.delta(delta_p_r, delta_p_h)
        )
        below += tail["r"].min() < bounds.r_low - 1e-12
        above += tail["r"].max() > bounds.r_high + 1e-12
    assert seen > 150
    assert 0.15 < above / seen < 0.5
    assert 0 < below / seen < 0.1


def test_the_step_of_tsc_is_that_of_the_steady_cycle(operators):
    model = operators["2"]
    cycle = tl.limit_cycle(model, 0.0, 0.35)
    expected = step_bounds(model, cycle.r_low, cycle.r_high).delta_tsc
    assert steady_state_bounds(model, 0.0, 0.35).delta_tsc == pytest.approx(expected, rel=1e-9)
    assert steady_state_bounds(model, 0.0, 0.35, delta_tsc=2.0).delta_tsc == 2.0


def test_phases_of_no_length_have_no_utilization():
    assert np.isnan(utilization_as_printed(0.999, 0.0, 0.0, 0.0)).all()
    low, high = utilization_as_printed(np.array([0.99, 0.999]), 5.0, 9.0, 20.0)
    for k, a in enumerate((0.99, 0.999)):
        r = 0.5
        for manual, expected in ((5, low[k]), (9, high[k])):
            for _ in range(20_000):
                peak = 1.0 - a**manual * (1.0 - r)
                r = peak * a**20
            assert expected == pytest.approx(r if manual == 5 else peak, rel=1e-12)


def test_the_plot_shows_what_dwell_times_are_derived_from(operators):
    bounds = steady_state_bounds(operators["2"], 0.0, 0.35, delta_tsc=0.005)
    alone, _, utilization = bounds.plot()
    curve = alone.lines[0]
    # (2.16): after τ_da samples, rounded down, P_r has fallen from P_ru to P_rl but for the part of
    # a sample.
    rest = 0.1 * bounds.dwell_autonomous_high
    at = np.interp([rest, rest + 0.1], *curve.get_data())
    assert at[0] >= bounds.p_r_low >= at[1]
    # (2.33): the bounds are the least and the greatest utilization of the two periodic motions.
    lines = {line.get_label(): line.get_ydata() for line in utilization.lines}
    ends = lines["to $r_l$"].min(), lines["to $r_u$"].max()
    assert ends == pytest.approx((bounds.r_low, bounds.r_high), abs=1e-9)
    plt.close("all")


def test_greatest_steps_are_those_of_every_state():
    """
    Oracle: (2.1), (2.3) and (2.5) written out on a grid of states; an operator better than the
    robot's model supposes drives P_r above its upper end.
    """
    r = np.linspace(0.05, 0.95, 200_001)
    for beta, p_h_max in ((0.3, 0.5), (0.74, 0.4602), (0.6, 0.7)):
        model = tl.TscModel(
            tl.RobotModel(0.99, 0.24, 0.39, 0.5), tl.HumanModel(0.995, beta, 0.35, p_h_max)
        )
        p_h = 0.35 + (p_h_max - 0.35) * shape(r, beta)
        change = max(
            np.abs(0.35 + (p_h_max - 0.35) * shape(0.995 * r + 0.005 * mode, beta) - p_h).max()
            for mode in (0, 1)
        )
        highest = max(0.39, 0.24 + model.robot.b * p_h_max / 0.01)
        steps = step_bounds(model)
        assert steps.delta_p_h == pytest.approx(change, rel=1e-4)
        assert steps.delta_p_r == pytest.approx(0.01 * (highest - 0.24), rel=1e-12)
        assert steps.delta_p_h >= change * (1 - 1e-12)


@pytest.mark.parametrize("beta", [0.1, 0.12, 0.15, 0.17])
def test_the_greatest_step_within_a_range_is_found_to_rounding(beta):
    """Oracle: SciPy's bounded search; above β, and below r = ½, the step is greatest in between."""
    model = tl.TscModel(tl.RobotModel(0.99, 0.2, 0.4, 0.5), tl.HumanModel(0.995, beta, 0.3, 0.5))

    def step(r):
        return 0.2 * (shape(0.995 * r + 0.005, beta) - shape(r, beta))

    best = minimize_scalar(step, bounds=(beta, 0.5), method="bounded", options={"xatol": 1e-10})
    assert beta + 0.1 < best.x < 0.49
    assert step_bounds(model, beta, 0.5).delta_p_h == pytest.approx(-best.fun, rel=1e-12)


def test_thresholds_at_their_limits_are_outside(operators):
    limits = threshold_limits(operators["pilot"], 0.0)
    assert limits.contains(np.nextafter(limits.lower, 1.0), np.nextafter(limits.upper, -1.0))
    assert not limits.contains(limits.lower, 0.0)
    assert not limits.contains(0.0, limits.upper)
    assert not limits.contains(0.1, 0.1)
