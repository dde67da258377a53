"""
Bounds: Theorem 1 with its lemmas, Theorem 2 as printed and on arrays, against what is simulated.

Oracles: numbers of Tables 2.1 and 2.2; the equations written out here.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

import trustlab as tl
from tests.allocation.cases import phases, settled, shape
from trustlab.allocation import steady_state_bounds, step_bounds, threshold_limits
from trustlab.allocation.bounds import performance_as_printed, utilization_as_printed
from trustlab.allocation.limits import limits_as_printed
from trustlab.models.tsc import TscConstants, performance_weights
from trustlab.reproduction import published_table
from trustlab.reproduction.printed import half_unit

# --- bounds as printed ----------------------------------------------------------------------------


def with_printed_gain(name):
    """The model of a participant with the printed, rounded b_pr."""
    tsc = tl.published_models()[name]
    gain = float(published_table("2.1").loc["b_pr", name])
    return tl.TscModel(replace(tsc.robot, b=gain), tsc.human)


@pytest.mark.parametrize("name", ["2", "4"])
def test_limits_are_the_printed_ones(name):
    p = published_table("2.1")[name].astype(float)
    limits = threshold_limits(with_printed_gain(name), p["delta_P_h"])
    assert limits.lower == pytest.approx(p["TSC_lb"], abs=0.0006)
    assert limits.upper == pytest.approx(p["TSC_ub"], abs=0.0006)


@pytest.mark.parametrize("name", ["2", "4", "5"])
def test_bounds_are_those_of_table_2_2(name):
    """
    One unit of the last digit, but for participant 4's r_l: 0.5886 against 0.587, within the
    rounding of the inputs.
    """
    printed, rows = published_table("2.2")[name], ["P_rl", "P_ru", "r_l", "r_u"]
    p, delta_tsc = printed.astype(float), float(published_table("2.1").loc["delta_TSC", name])
    bounds = steady_state_bounds(with_printed_gain(name), p["TSC_l"], p["TSC_u"], delta_tsc)
    found = np.array([bounds.p_r_low, bounds.p_r_high, bounds.r_low, bounds.r_high])
    units = [2.0 * half_unit(text) for text in printed[rows]]
    off = np.abs(found - p[rows]) / units
    if name == "4":
        assert off.pop("r_l") == pytest.approx(1.574, abs=0.001)
    assert off.max() < 0.7


def test_infinite_and_empty_dwell_times(operators):
    first = steady_state_bounds(operators["1"], 0.15, 0.62, delta_tsc=0.0022)
    assert first.dwell_manual_high == math.inf
    assert first.r_high == 1.0
    low = steady_state_bounds(operators["1"], -0.694, 0.3, delta_tsc=0.0022)
    assert low.p_r_low == operators["1"].robot.p_min
    assert low.dwell_autonomous_high == math.inf
    assert low.r_low == 0.0
    assert utilization_as_printed(0.999, math.inf, math.inf, 0.0) == (1.0, 1.0)
    assert np.isnan(utilization_as_printed(0.999, 0.0, 0.0, 0.0)).all()


def test_remark_4_says_what_to_change():
    model = tl.TscModel(tl.RobotModel(0.999, 0.3, 0.4, 0.5), tl.HumanModel(0.9, 0.7, 0.3, 0.5))
    with pytest.raises(ValueError, match=f"TSC_ub = {threshold_limits(model).upper:.4f}"):
        steady_state_bounds(model, 0.0, 0.99)
    narrow = tl.TscModel(tl.RobotModel(0.999, 0.3, 0.31, 0.5), tl.HumanModel(0.9, 0.7, 0.1, 0.5))
    with pytest.raises(ValueError, match=r"no thresholds fit \(Remark 4\); widen the range"):
        steady_state_bounds(narrow, 0.0, 0.1)


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
        tail = settled(model, lower, upper, r0=rng.random())
        step = tail.diff().abs().max()
        if not threshold_limits(model, step["p_h"]).contains(lower, upper):
            continue
        seen += 1
        delta_tsc = model.delta(step["p_r"], step["p_h"])
        bounds = steady_state_bounds(model, lower, upper, delta_tsc)
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


def test_the_plot_shows_what_dwell_times_are_derived_from(operators):
    """(2.16): after τ_da samples P_r has fallen from P_ru to P_rl but for the part of a sample."""
    bounds = steady_state_bounds(operators["2"], 0.0, 0.35, delta_tsc=0.005)
    curve = bounds.plot()[0].lines[0]
    rest = 0.1 * bounds.dwell_autonomous_high
    at = np.interp([rest, rest + 0.1], *curve.get_data())
    assert at[0] >= bounds.p_r_low >= at[1]
    assert curve.get_xdata()[curve.get_markevery()].tolist() == [pytest.approx(rest)]
    plt.close("all")


def test_greatest_steps_are_those_of_every_state():
    """
    Oracle: (2.1), (2.3) and (2.5) written out on a grid of states; an operator better than the
    robot's model supposes drives P_r above its upper end.
    """
    r = np.linspace(0.05, 0.95, 700_001)
    for beta, p_h_max in ((0.15, 0.5), (0.3, 0.5), (0.74, 0.4602), (0.6, 0.7)):
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
        assert steps.delta_p_r == pytest.approx(0.01 * (highest - 0.24), rel=1e-12)
        assert steps.delta_p_h == pytest.approx(change, rel=1e-9)


def test_the_greatest_step_is_found_at_few_utilizations(operators, monkeypatch):
    """Every corrector and every table of bounds asks for it."""
    performance, sizes = tl.HumanModel.performance, []

    def counted(human, r):
        sizes.append(np.size(r))
        return performance(human, r)

    monkeypatch.setattr(tl.HumanModel, "performance", counted)
    step_bounds(operators["2"])
    assert sum(sizes) < 100_000


def test_thresholds_at_their_limits_are_outside(operators):
    limits = threshold_limits(operators["pilot"], 0.0)
    assert limits.contains(np.nextafter(limits.lower, 1.0), np.nextafter(limits.upper, -1.0))
    assert not limits.contains(limits.lower, 0.0)
    assert not limits.contains(0.0, limits.upper)
    assert not limits.contains(0.1, 0.1)


# --- bounds on arrays -----------------------------------------------------------------------------


def gains(v):
    scale = v.p_r_max * v.p_h_max - v.p_r_min * v.p_h_min
    return (v.p_h_max + v.p_h_min) / scale, (v.p_r_max + v.p_r_min) / scale


def limits(v):
    """TSC_lb and TSC_ub, (2.9)-(2.10)."""
    a_t, b_t = gains(v)
    slack = b_t * v.delta_p_h / (1.0 - v.a_pr)
    slope = a_t * v.b_pr / (1.0 - v.a_pr) - b_t
    lower = a_t * v.p_r_min + slack - b_t * v.p_h_min
    upper = a_t * v.p_r_min - slack + np.minimum(slope * v.p_h_max, slope * v.p_h_min)
    return lower, upper


def dwell(start, end, a):
    """⌊ln(end/start)/ln a⌋, infinite where the end is never reached."""
    with np.errstate(all="ignore"):
        steps = np.floor(np.log(np.where(end > 0.0, end, 1.0) / start) / np.log(a))
    return np.where(end > 0.0, steps, np.inf)


def bounds(v, c):
    """P_rl, P_ru (2.15), r_l and r_u (2.33) at a given c of (2.20)."""
    a_t, b_t = gains(v)
    low = np.maximum((v.lower - v.delta_tsc + b_t * v.p_h_min) / a_t, v.p_r_min)
    high = np.minimum((v.upper + v.delta_tsc + b_t * v.p_h_max) / a_t, v.p_r_max)
    rest = dwell(high - v.p_r_min, low - v.p_r_min, v.a_pr)
    quick, slow = (
        dwell(v.p_r_min + rise - low, v.p_r_min + rise - high, v.a_pr)
        for rise in (c, c * v.p_h_min / v.p_h_max)
    )
    a = v.a_r
    with np.errstate(all="ignore"):
        r_low = (1.0 - a**quick) * a**rest / (1.0 - a ** (quick + rest))
        r_high = (1.0 - a**slow) / (1.0 - a ** (slow + rest))
    return low, high, r_low, r_high


@pytest.fixture(scope="module")
def random_numbers():
    """About those of Table 2.1, with slopes of (2.10) of both signs."""
    rng = np.random.default_rng(4)
    ranges = {
        "p_r_min": (0.2, 0.25),
        "p_r_max": (0.3, 0.45),
        "p_h_min": (0.3, 0.38),
        "p_h_max": (0.39, 0.47),
        "a_pr": (0.99, 0.999),
        "a_r": (0.99, 0.9995),
        "b_pr": (2e-4, 3e-3),
        "delta_p_h": (0.0, 2e-4),
        "delta_tsc": (0.0, 0.01),
        "lower": (-0.2, 0.05),
        "upper": (0.1, 0.3),
    }
    return SimpleNamespace(**{name: rng.uniform(*ends, 5000) for name, ends in ranges.items()})


def constants(v):
    a_T, b_T = performance_weights(v.p_r_min, v.p_r_max, v.p_h_min, v.p_h_max)
    known = vars(v) | {"beta": np.nan, "a_T": a_T, "b_T": b_T}
    return TscConstants(**{name: known[name] for name in TscConstants._fields})


def test_limits_are_the_equations(random_numbers):
    v = random_numbers
    found = limits_as_printed(constants(v), v.delta_p_h)
    np.testing.assert_allclose(found, limits(v), rtol=1e-9, atol=1e-12)
    a_t, b_t = gains(v)
    slope = a_t * v.b_pr / (1.0 - v.a_pr) - b_t
    assert slope.min() < 0.0 < slope.max()


@pytest.mark.parametrize("with_gain", [False, True])
def test_bounds_are_the_equations(random_numbers, with_gain):
    v = random_numbers
    rise = v.b_pr * v.p_h_max / (1.0 - v.a_pr) if with_gain else None
    p = performance_as_printed(constants(v), v.lower, v.upper, v.delta_tsc, rise)
    r = utilization_as_printed(
        v.a_r, p.dwell_manual_low, p.dwell_manual_high, p.dwell_autonomous_high
    )
    expected = bounds(v, rise if with_gain else v.p_r_max - v.p_r_min)
    for ours, theirs in zip((p.p_r_low, p.p_r_high, *r), expected, strict=True):
        close = np.isclose(ours, theirs, rtol=1e-9, atol=1e-12, equal_nan=True)
        # A dwell time is rounded down, so that the last bit of its logarithm may decide; never for
        # more than a handful.
        assert close.mean() > 0.998
    assert (p.p_r_low < p.p_r_high).mean() > 0.9


def test_an_endless_dwell_time_stays_endless(random_numbers):
    """
    P_ru clipped to P_r,max is never reached, whatever P_r,min + (P_r,max − P_r,min) rounds to.
    """
    v = random_numbers
    p = performance_as_printed(constants(v), v.lower, np.full(5000, 0.99), v.delta_tsc)
    assert (p.p_r_high == v.p_r_max).all()
    assert np.isinf(p.dwell_manual_low).all()


# --- Theorem 1 and lemmas -------------------------------------------------------------------------


EXAMPLES = settings(max_examples=120, suppress_health_check=list(HealthCheck))


@EXAMPLES
@given(data=st.data())
def test_theorem_1_lemmas_and_bounds_on_performance_hold(sets, data):
    """
    Of a run under thresholds within the limits, with transients gone. No phase is longer than ⌊·⌋
    of (2.16) and (2.21): one of n samples takes P_r from its first sample, within (2.15), over n
    steps to the first sample of the next phase, which is within (2.15) as well, as δ_TSC makes room
    for the step that crosses. So n does not exceed the real number that is floored.
    """
    model, lower, upper = data.draw(sets)
    tail = settled(model, lower, upper, r0=data.draw(st.floats(0.0, 1.0)))
    step = tail.diff().abs().max()
    limits = threshold_limits(model, step["p_h"])
    assume(limits.contains(lower, upper))
    bounds = steady_state_bounds(model, lower, upper, model.delta(step["p_r"], step["p_h"]))
    # Theorem 1
    for part in np.array_split(tail["mode"].to_numpy(), 2):
        assert set(part) == {0.0, 1.0}
    # Lemmas 1 and 2: TSC falls alone and rises under manual control
    now, change = tail.iloc[:-1], tail["tsc"].diff().shift(-1).iloc[:-1]
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
@given(data=st.data(), beyond=st.floats(0.001, 2.0), who=st.sampled_from([0.0, 1.0]))
def test_control_thresholds_that_tsc_never_meets_end_the_switching(sets, data, beyond, who):
    """
    TSC lies in [-1, 1]: without the condition of Theorem 1 there is nothing that keeps the rule
    switching.
    """
    model, lower, upper = data.draw(sets)
    lower, upper = (-1.0 - beyond, upper) if who == 0.0 else (lower, 1.0 + beyond)
    assert (settled(model, lower, upper, r0=0.5)["mode"] == who).all()


def test_control_dwell_times_of_a_narrower_band_are_too_short(random_model):
    """
    The lengths that Lemmas 3 and 4 bound do come near: bounds for a band of half the width are
    exceeded.
    """
    longer = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        model, lower, upper = random_model(rng)
        tail = settled(model, lower, upper, 20_000, r0=rng.random())
        who, lengths = phases(tail["mode"])
        quarter = 0.25 * (upper - lower)
        bounds = steady_state_bounds(model, lower + quarter, upper - quarter, delta_tsc=0.0)
        longer += lengths[who == 0].max(initial=0) > bounds.dwell_autonomous_high
        longer += lengths[who == 1].max(initial=0) > bounds.dwell_manual_high
    assert longer > 5


@settings(EXAMPLES, max_examples=400)
@given(data=st.data(), delta=st.floats(0.0, 0.05))
def test_proposition_1_order_of_the_dwell_times(sets, data, delta):
    model, lower, upper = data.draw(sets)
    bounds = steady_state_bounds(model, lower, upper, delta_tsc=delta)
    assert bounds.dwell_manual_low <= bounds.dwell_manual_high
    assert 0.0 <= bounds.r_low <= bounds.r_high <= 1.0


@pytest.mark.parametrize("reach", [(0.05, 0.999), (0.001, 0.7), (0.2, 0.4)])
def test_somebody_who_does_harm_lowers_the_robots_performance_by_more(reach):
    """Oracle: (2.3) written out on a grid of states, its steps down and up."""
    human = tl.HumanModel(0.99, 0.5, -0.4, 0.5)
    model = tl.TscModel(tl.RobotModel(0.99, 0.2, 0.4, 0.5), human)
    r, p_r = np.meshgrid(np.linspace(*reach, 2001), np.linspace(0.2, 0.4, 201))
    p_h = -0.4 + 0.9 * shape(r, 0.5)
    steps = [(0.99 - 1) * p_r + 0.01 * 0.2 + m * model.robot.b * p_h for m in (0, 1)]
    assert step_bounds(model, *reach).delta_p_r == pytest.approx(np.abs(steps).max(), rel=1e-9)
