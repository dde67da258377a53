"""
Output-error fits against a second implementation, written from (2.3), (2.5) and (2.6) alone.

Oracle: the recursions as plain Python loops on complex numbers, their Jacobian by complex steps
(exact to rounding), a SciPy trust-region search from values off the truth, and Gauss–Newton steps
at the end until they no longer move. It shares no code with the package: no compiled kernel, no
sensitivities, no starting-value search.
"""

import cmath

import numpy as np
import pytest
from scipy.optimize import least_squares

import trustlab as tl
from tests.identification.cases import log

STEP = 1e-100  # of the complex-step derivative: no cancellation, so it may be as small as one likes
SAMPLES = 2000


# --- the second implementation --------------------------------------------------------------------


def human_output(parameters, mode):
    """P_h(k) of (2.5)-(2.6); parameters a, beta, p_min, p_max, r0, any of them complex."""
    a, beta, p_min, p_max, r = parameters
    out = []
    for m in mode:
        bell = cmath.exp(beta * cmath.log(r / beta) + (1 - beta) * cmath.log((1 - r) / (1 - beta)))
        out.append((p_max - p_min) * bell + p_min)
        r = a * r + (1 - a) * m
    return np.array(out)


def robot_output(parameters, mode, p_h, p_h_max):
    """P_r(k) of (2.3) with its b; parameters a, p_min, p_max, p_r0, any of them complex."""
    a, p_min, p_max, p_r = parameters
    b = (1 - a) * (p_max - p_min) / p_h_max
    out = []
    for m, h in zip(mode, p_h, strict=True):
        out.append(p_r)
        p_r = a * p_r + (1 - a) * p_min + m * b * h
    return np.array(out)


def complex_step_jacobian(output, parameters):
    columns = []
    for j in range(len(parameters)):
        moved = [complex(value) for value in parameters]
        moved[j] += 1j * STEP
        columns.append(output(moved).imag / STEP)
    return np.column_stack(columns)


def least_squares_fit(output, measured, start, low, high):
    """Return parameters, cost ½ Σ e² and the Jacobian at the least-squares optimum of `output`."""

    def residual(parameters):
        return output([complex(value) for value in parameters]).real - measured

    def jacobian(parameters):
        return complex_step_jacobian(output, parameters)

    tight = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14}
    found = least_squares(residual, start, jac=jacobian, bounds=(low, high), x_scale="jac", **tight)
    parameters = found.x
    for _ in range(30):
        step = np.linalg.lstsq(jacobian(parameters), residual(parameters), rcond=None)[0]
        parameters = parameters - step
        if np.all(np.abs(step) < 1e-12 * np.abs(parameters)):
            break
    else:
        raise AssertionError("the oracle did not settle")
    error = residual(parameters)
    return parameters, 0.5 * error @ error, jacobian(parameters)


# --- sessions -------------------------------------------------------------------------------------


def phases(rng, samples=SAMPLES, shares=False):
    """Alternate modes over phases of random length; with `shares`, of random manual shares."""
    mode = np.empty(samples)
    k, on = 0, 1.0
    while k < samples:
        length = int(rng.integers(120, 420))
        mode[k : k + length] = rng.uniform(0.0, 1.0) if shares else on
        k, on = k + length, 1.0 - on
    return mode


def noisy_session(seed, shares=False):
    """
    Return a session of known truth, drawn at random inside the region where 2,000 samples say
    enough.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    human = rng.uniform([0.988, 0.45, 0.30, 0.46, 0.2], [0.995, 0.75, 0.40, 0.60, 0.4]).tolist()
    robot = rng.uniform([0.985, 0.20, 0.36, 0.28], [0.996, 0.26, 0.42, 0.34]).tolist()
    mode = phases(rng, shares=shares)
    p_h = human_output(human, mode).real
    p_r = robot_output(robot, mode, p_h, human[3]).real
    noise = rng.normal(0.0, 0.003, (2, SAMPLES))
    return log(mode=mode, p_r=p_r + noise[0], p_h=p_h + noise[1]), human, robot


# --- tests ----------------------------------------------------------------------------------------

CASES = [(11, False), (12, False), (13, False), (14, True), (15, True)]
HUMAN_NAMES = ["a", "beta", "p_min", "p_max"]
ROBOT_NAMES = ["a", "p_min", "p_max"]
HUMAN_BOUNDS = ([0.9, 0.05, 0.0, 0.0, 1e-3], [1.0 - 1e-6, 0.95, 1.0, 1.0, 1.0 - 1e-3])
ROBOT_BOUNDS = ([0.9, 0.0, 0.0, 0.0], [1.0 - 1e-6, 1.0, 1.0, 1.0])


def oracle_human(session, truth):
    start = np.add(truth, [-0.002, 0.03, -0.01, 0.02, 0.05])
    return least_squares_fit(
        lambda p: human_output(p, session["mode"]), session["p_h"], start, *HUMAN_BOUNDS
    )


def oracle_robot(session, truth, p_h_max):
    start = np.add(truth, [-0.003, -0.02, 0.02, 0.02])
    mode, p_h = session["mode"], session["p_h"]
    return least_squares_fit(
        lambda p: robot_output(p, mode, p_h, p_h_max), session["p_r"], start, *ROBOT_BOUNDS
    )


def standard_errors(cost, J):
    """Return √diag(s² (JᵀJ)⁻¹)."""
    variance = 2.0 * cost / (len(J) - J.shape[1])
    return np.sqrt(variance * np.diag(np.linalg.inv(J.T @ J)))


def assert_agrees(fit, names, state, parameters, cost, J):
    """Compare a fit with the oracle's values, in standard errors, and with these."""
    assert fit.success, fit.message
    assert fit.cost == pytest.approx(cost, rel=1e-7)
    table, states, stderr = fit.table().loc[names], fit.initial_states, standard_errors(cost, J)
    assert [getattr(fit.model, name) for name in names] == table["value"].tolist()
    assert np.abs((np.r_[table["value"], states[state]] - parameters) / stderr).max() < 1e-3
    errors = np.r_[table["stderr"], states[f"{state}_stderr"]]
    np.testing.assert_allclose(errors, stderr, rtol=1e-3)


@pytest.mark.parametrize(("seed", "shares"), CASES)
def test_fit_human_agrees_with_the_second_implementation(seed, shares):
    session, truth, _ = noisy_session(seed, shares)
    fit = tl.fit_human(session, noise="white")
    assert_agrees(fit, HUMAN_NAMES, "r0", *oracle_human(session, truth))


@pytest.mark.parametrize(("seed", "shares"), CASES)
def test_the_driven_robot_agrees_with_the_second_implementation(seed, shares):
    session, human, truth = noisy_session(seed, shares)
    parameters, cost, J = oracle_robot(session, truth, human[3])
    fit = tl.fit(tl.identification.ROBOT, session, {"p_h_max": human[3]}, noise="white")
    assert_agrees(fit, ROBOT_NAMES, "p_r0", parameters, cost, J)
    b = (1 - parameters[0]) * (parameters[2] - parameters[1]) / human[3]
    assert fit.model.b == pytest.approx(b, rel=1e-4)


def test_several_sessions_share_parameters_and_keep_their_own_initial_states():
    """Two runs of one operator: the oracle gets one vector with two initial utilizations."""
    first, truth, _ = noisy_session(11)
    rng = np.random.default_rng(np.random.SeedSequence(21))
    mode = phases(rng, samples=1200)
    p_h = human_output([*truth[:4], 0.55], mode).real + rng.normal(0.0, 0.003, mode.size)

    def both(p):
        return np.r_[human_output(p[:5], first["mode"]), human_output([*p[:4], p[5]], mode)]

    low, high = ([*side, side[-1]] for side in HUMAN_BOUNDS)
    y = np.r_[first["p_h"], p_h]
    oracle = least_squares_fit(both, y, [*truth, 0.5], low, high)
    fit = tl.fit_human([first, log(mode=mode, p_h=p_h)], noise="white")
    assert_agrees(fit, HUMAN_NAMES, "r0", *oracle)


def test_the_comparison_would_notice_another_model():
    """
    Negative control: the oracle with (2.6) read one sample late is another model, and is told
    apart.
    """
    session, truth, _ = noisy_session(11)
    late = np.r_[session["mode"][:1], session["mode"][:-1]]
    parameters, cost, _ = least_squares_fit(
        lambda p: human_output(p, late), session["p_h"], np.array(truth), *HUMAN_BOUNDS
    )
    fit = tl.fit_human(session, noise="white")
    assert abs(fit.cost / cost - 1.0) > 1e-5
    assert np.max(np.abs(np.array([fit.model.a, fit.model.beta]) / parameters[:2] - 1.0)) > 1e-5
