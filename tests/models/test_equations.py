"""
The equations of the models: TSC and what it is made of, trust and its scalings, the printed UAV.

Oracles: the printed expressions written out, an independent integrator, python-control.
"""

from dataclasses import replace
from fractions import Fraction
from itertools import islice
from pathlib import Path

import control
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

import trustlab as tl
from tests.cases import motion, refused
from trustlab.models.published import printed_pilot
from trustlab.models.trust import TrustModel, logistic_scale
from trustlab.models.tsc import (
    advance,
    human_at,
    human_range,
    threshold_mode,
    tsc_at,
    yerkes_dodson,
)
from trustlab.models.uav import PRINTED_UAV, three_axes

approx = pytest.approx
parametrize = pytest.mark.parametrize

# --- TSC, robot and operator ----------------------------------------------------------------------


rates = st.floats(0.5, 0.9999)
shares = st.floats(0.0, 1.0)


@st.composite
def robots(draw):
    low = draw(st.floats(0.0, 0.5))
    return tl.RobotModel(
        draw(rates), low, low + draw(st.floats(0.02, 1.0)), draw(st.floats(0.1, 2))
    )


@st.composite
def humans(draw):
    low, beta = draw(st.floats(0.0, 0.5)), draw(st.floats(0.02, 0.98))
    return tl.HumanModel(draw(rates), beta, low, low + draw(st.floats(0.02, 0.5)))


models = st.builds(tl.TscModel, robots(), humans())


@given(
    st.floats(0.0, 1.0, exclude_min=True, exclude_max=True),
    st.lists(shares, min_size=20, max_size=20),
    st.sampled_from([0.0, 1e-300, 0.5, 1.0 - 2.0**-53, 1.0]),
)
def test_rounding_never_takes_utilization_out_of_the_unit_interval(a, mode, r0):
    human = tl.HumanModel(a, 0.7, 0.39, 0.46)
    for modes in (mode, np.round(mode), np.ones(20), np.zeros(20)):
        r, _ = human.simulate(modes, r0)
        assert 0.0 <= r.min() <= r.max() <= 1.0


@given(robots(), shares, st.integers(0, 2**32 - 1))
def test_robot_performance_stays_between_its_bounds_and_settles(robot, mode, seed):
    assert robot.b == approx((1 - robot.a) * (robot.p_max - robot.p_min) / robot.p_h_max)  # (2.3)
    rng = default_rng(seed)
    p_h, start = rng.random(500) * robot.p_h_max, rng.uniform(robot.p_min, robot.p_max)
    p_r = robot.simulate(rng.random(500), p_h, start)
    assert p_r.min() >= robot.p_min - 1e-12
    assert p_r.max() <= robot.p_max + 1e-12
    settled = robot.steady_state(mode, p_h[0])
    held = robot.simulate([mode, mode], p_h[[0, 0]], settled)
    assert_allclose(held, settled, atol=1e-14)


def test_bounds_need_the_gain_of_2_3():
    """Negative control: a larger gain lifts performance above P_r,max."""
    robot = tl.RobotModel(a=0.99, p_min=0.2, p_max=0.4, p_h_max=0.5, b=0.01)
    assert robot.simulate(np.ones(2000), np.full(2000, 0.5))[-1] > 0.4


def test_a_wrong_name_is_an_error_of_key_and_of_value_with_the_nearest():
    for error in (KeyError, ValueError):
        with pytest.raises(error, match=r"^nothing is called 3; did you mean '3'\? \(there are"):
            tl.published_models()[3]
    with refused(r"did you mean '.*tlx'"):
        tl.published_studies()["tlx"]


@parametrize("name", ["pilot", "1", "2", "3", "4", "5"])
def test_gains_are_those_printed(operators, name):
    printed = printed_pilot() if name == "pilot" else tl.published_table("2.1")[name]
    assert f"{operators[name].robot.b:.4f}" == printed["b_pr"]
    assert operators[name].human.b == approx(float(printed["b_r"]), abs=1e-12)
    assert replace(operators[name].robot, b=0.0013).b == 0.0013


def test_the_step_bound_of_the_pilot_is_the_printed_one(operators):
    """Remark 3: δ_Pr = 0.00069 and δ_Ph = 0.00021 give 0.0084."""
    assert round(operators["pilot"].delta(0.00069, 0.00021), 4) == 0.0084


@given(models, shares, st.integers(0, 1000))
def test_simulation_and_compiled_equations_are_the_printed_recursion(model, r0, seed):
    mode = default_rng(seed).choice([0.0, 0.3, 1.0], 200)
    start = 0.5 * (model.robot.p_min + model.robot.p_max)
    run, c, modes = model.simulate(mode, r0, start), model.constants(), iter(mode)
    printed = [*islice(motion(model, r0, start, lambda tsc: next(modes)), 200)]
    assert_allclose(run[["r", "p_r", "p_h", "tsc", "mode"]], printed, atol=1e-11)
    assert_array_equal(model.human.simulate(mode, r0), run[["r", "p_h"]].T)
    assert_array_equal(model.robot.simulate(mode, run["p_h"], start), run["p_r"])
    r, p_r = r0, start
    for row in run.itertuples():
        p_h = human_at(r, c)
        assert (r, p_r, p_h, tsc_at(p_r, p_h, c)) == (row.r, row.p_r, row.p_h, row.tsc)
        r, p_r = advance(r, p_r, p_h, row.mode, c)
    first = model.simulate(mode).iloc[0]  # rested, with the robot at its least
    assert (first["r"], first["p_r"]) == (0.0, model.robot.p_min)


@given(models, shares, shares)
def test_the_range_of_human_performance_is_that_of_a_fine_grid(model, low, high):
    """One that ends at β has P_max itself, whatever (P_max − P_min) + P_min rounds to."""
    low, high = sorted((low, high))
    human, c = model.human, model.constants()
    values = human.performance(np.linspace(low, high, 400))
    least, greatest = human_range(low, high, c)
    assert least == approx(values.min(), abs=1e-12)
    assert values.max() - 1e-12 <= greatest <= values.max() + 0.005
    assert human_range(0.0, human.beta, c)[1] == human_range(human.beta, 1.0, c)[1] == human.p_max


def test_performance_beyond_the_unit_interval_and_modes_at_the_thresholds():
    assert [yerkes_dodson(beyond, 0.7) for beyond in (-0.5, 0.0, 1.0, 1.5)] == [0.0] * 4
    modes = [[threshold_mode(tsc, 0.1, 0.4, mode) for mode in (0, 1)] for tsc in (0.1, 0.25, 0.4)]
    assert modes == [[1, 1], [0, 1], [0, 0]]


@given(st.floats(-1.0, 1.0), st.floats(1e-3, 1.0), st.floats(-1.0, 1.0), st.floats(1e-3, 1.0))
def test_models_need_positive_weights_with_a_positive_denominator(a, b, c, d):
    """Oracle: (2.2) written out in exact fractions."""
    r_min, r_max, h_min, h_max = map(Fraction, (a, a + b, c, c + d))
    scale = r_max * h_max - r_min * h_min
    right = scale > 0 and (h_min + h_max) / scale > 0 and (r_min + r_max) / scale > 0
    parts = tl.RobotModel(0.99, a, a + b, 0.5), tl.HumanModel(0.999, 0.7, c, c + d)
    if right:
        assert tl.TscModel(*parts).a_T == approx(float((h_min + h_max) / scale))
    else:
        with refused("use measures of performance that are not negative"):
            tl.TscModel(*parts)


# --- trust ----------------------------------------------------------------------------------------


unit = st.floats(0.01, 1.0)


def test_a_run_is_the_exact_solution_for_performance_that_is_held():
    trust = TrustModel(a=0.7, b=0.4, t_min=1.0, t_max=3.0, p_min=0.2, p_max=0.9)

    def rate(_, level, held):  # (3.2) as printed
        return -0.7 * (level - 1.0) / 2.0 + 0.4 * (held - 0.2) / 0.7

    performance = [0.55, 0.2, 0.9, 0.3]
    run = trust.simulate(performance, 0.3, trust0=2.2)
    assert (run[0], run.size) == (2.2, 4)
    for held, before, after in zip(performance, run, run[1:], strict=False):
        options = {"args": (held,), "rtol": 1e-12, "atol": 1e-14}
        solved = solve_ivp(rate, (0.0, 0.3), [before], **options).y[0, -1]
        assert (after, trust.step(before, held, 0.3)) == approx((solved, solved), abs=1e-12)
        assert rate(0.0, trust.steady_state(held), held) == approx(0.0, abs=1e-15)
    assert trust.simulate(performance, 0.1)[0] == 1.0


@given(unit, unit, st.integers(0, 1000), st.floats(0.001, 10.0))
def test_trust_stays_within_its_bounds(a, b, seed, sample_time):
    rng = default_rng(seed)
    trust = TrustModel(max(a, b), min(a, b), t_min=-0.5, t_max=1.5)
    run = trust.simulate(rng.integers(0, 2, 200), sample_time, rng.uniform(-0.5, 1.5))
    assert run.min() >= -0.5 - 1e-12
    assert run.max() <= 1.5 + 1e-12


def test_with_b_above_a_trust_leaves_its_bounds():
    """Negative control of (3.4), which the model therefore refuses unless it is asked for."""
    with refused(r"b = 0\.5 > a = 0\.2 .*allow_unbounded=True"):
        TrustModel(a=0.2, b=0.5)
    trust = TrustModel(a=0.2, b=0.5, allow_unbounded=True)
    assert trust.simulate(np.ones(500), 0.1).max() > 1.0


@given(unit, unit, st.floats(10.0, 1e4), st.lists(st.floats(-2.0, 3.0), min_size=2, max_size=20))
def test_the_scale_is_the_printed_one_falls_with_trust_and_keeps_its_bounds(a, b, s, trust):
    low, high, trust = min(a, b), max(a, b), np.sort(trust)
    values = [logistic_scale(low, high, s, 0.5, level) for level in trust]
    with np.errstate(over="ignore"):
        printed = high - (high - low) / (1.0 + np.exp(-s * (trust - 0.5)))
    assert_allclose(values, printed, atol=1e-14)
    assert (np.diff(values) <= 0.0).all()
    assert low * (1 - 1e-15) <= min(values) <= max(values) <= high * (1 + 1e-15)


# --- the UAV of Appendix A ------------------------------------------------------------------------


PRINTED = pd.read_csv(
    Path(__file__).parents[2] / "data" / "published" / "statements.csv", index_col="id"
)["printed"].filter(like="appendix_a/model/")


def test_the_numbers_are_those_printed():
    numbers = {}
    for axis, model in PRINTED_UAV.items():
        names = ("gain", "damping", "stiffness")
        for name, value in zip(names, (model.gain, *model.denominator), strict=False):
            numbers[f"{axis}_{name}"] = value
    assert numbers == {name.split("/")[-1]: float(text) for name, text in PRINTED.items()}


@parametrize("axis", "xyz")
def test_poles_and_discrete_form_are_those_of_python_control(axis):
    """Velocity at samples, under a command that changes at each, is the transfer function's."""
    model = PRINTED_UAV[axis]
    phi, gamma = model.discrete(0.01)
    plant = control.tf([model.gain], [1.0, *model.denominator])
    assert_allclose(np.sort(model.poles()), np.sort(plant.poles()), atol=1e-12)
    command = default_rng(0).standard_normal(400)
    sampled = control.c2d(plant, 0.01, method="zoh")
    expected = control.forced_response(sampled, U=command).outputs
    state, velocity = np.zeros(model.order), []
    for u in command:
        velocity.append(state[0])
        state = phi @ state + gamma * u
    assert_allclose(velocity, expected, atol=1e-10)


def test_a_vehicle_has_three_axes():
    axes = list(PRINTED_UAV.values())
    assert three_axes(axes) == tuple(axes)
    for wrong in (axes[:2], [1.0, *axes[:2]]):
        with refused("three transfer functions, for x, y and z, got list"):
            three_axes(wrong)


def test_the_printed_controller_does_not_stabilise_the_printed_model():
    # u_a = 0.5 e + 0.02 de/dt on x and y, 1.5 e on z (Appendix A), with position the integral of
    # velocity
    for axis, gains in {"x": (0.02, 0.5), "y": (0.02, 0.5), "z": (0.0, 1.5)}.items():
        model = PRINTED_UAV[axis]
        loop = np.array([1.0, *model.denominator, 0.0])
        loop[-2:] += np.multiply(model.gain, gains)
        worst = np.roots(loop).real.max()
        assert (worst > 0.1) == (axis in "xy")
