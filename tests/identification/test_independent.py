"""
Output-error fits against a second implementation, written from (2.3), (2.5) and (2.6) alone.

Oracle: the recursions as plain Python loops on complex numbers, their Jacobian by complex steps
(exact to rounding), and Gauss–Newton steps from the truth until they no longer move. It shares no
code with the package: no compiled kernel, no sensitivities, no starting-value search.
"""

import cmath

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark

import trustlab as tl
from tests.identification.cases import log
from trustlab import fit_human

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


def least_squares_fit(output, logs, name, parameters):
    """
    Return parameters, cost ½ Σ e² and standard errors √diag(s² (JᵀJ)⁻¹) at the optimum for all
    logs, each of which has an initial state of its own.
    """

    def outputs(p):
        return np.concatenate([output([*p[:-2], p[k]], log) for k, log in enumerate(logs, -2)])

    measured = np.concatenate([log[name] for log in logs])
    steps = 1j * STEP * np.eye(len(parameters))
    for _ in range(30):
        error = measured - outputs(parameters).real
        J = np.column_stack([outputs(parameters + step).imag / STEP for step in steps])
        move = np.linalg.lstsq(J, error, rcond=None)[0]
        parameters = parameters + move
        if (abs(move) < 1e-12 * abs(parameters)).all():
            variance = error @ error / (len(J) - J.shape[1])
            stderr = np.sqrt(variance * np.diag(np.linalg.inv(J.T @ J)))
            return parameters, 0.5 * error @ error, stderr
    raise AssertionError("the oracle did not settle")


# --- sessions -------------------------------------------------------------------------------------


def phases(rng, shares):
    """Alternate modes over phases of random length; with `shares`, of random manual shares."""
    mode = np.empty(SAMPLES)
    k, on = 0, 1.0
    while k < SAMPLES:
        length = int(rng.integers(120, 420))
        mode[k : k + length] = rng.uniform(0.0, 1.0) if shares else on
        k, on = k + length, 1.0 - on
    return mode


def noisy_sessions(seed, shares=False):
    """
    Two sessions of an operator, drawn at random where 2,000 samples say enough, who begins as each
    session does; the parameters of operator and robot, and the initial states.
    """
    rng, logs = default_rng(seed), []
    human = rng.uniform([0.988, 0.45, 0.30, 0.46], [0.995, 0.75, 0.40, 0.60])
    robot = rng.uniform([0.985, 0.20, 0.36], [0.996, 0.26, 0.42])
    states = rng.uniform([[0.2], [0.28]], [[0.4], [0.34]], (2, 2))
    for r0, p_r0 in states.T:
        mode = phases(rng, shares)
        p_h = human_output([*human, r0], mode).real
        p_r = robot_output([*robot, p_r0], mode, p_h, human[3]).real
        noise = rng.normal(0.0, 0.003, (2, SAMPLES))
        logs.append(log(mode=mode, p_r=p_r + noise[0], p_h=p_h + noise[1]))
    return logs, np.r_[human, states[0]], np.r_[robot, states[1]]


# --- tests ----------------------------------------------------------------------------------------


def assert_agrees(fit, parameters, cost, stderr):
    """Compare a fit with the oracle's values, in standard errors, and with these."""
    assert fit.success, fit.message
    assert fit.cost == approx(cost, rel=1e-7)
    table, states = fit.table()[: len(parameters) - 2], fit.initial_states.to_numpy().T
    assert abs((np.r_[table["value"], states[0]] - parameters) / stderr).max() < 1e-3
    assert_allclose(np.r_[table["stderr"], states[1]], stderr, rtol=1e-3)


@mark.parametrize(("seed", "shares"), [(11, False), (12, False), (14, True)])
def test_fits_agree_with_the_second_implementation(seed, shares):
    logs, human, robot = noisy_sessions(seed, shares)
    p_h_max = human[3]
    oracle = least_squares_fit(lambda p, log: human_output(p, log["mode"]), logs, "p_h", human)
    assert_agrees(fit_human(logs, noise="white"), *oracle)

    def driven(p, log):
        return robot_output(p, log["mode"], log["p_h"], p_h_max)

    fit = tl.fit(tl.identification.ROBOT, logs, {"p_h_max": p_h_max}, noise="white")
    assert_agrees(fit, *least_squares_fit(driven, logs, "p_r", robot))


def test_the_comparison_would_notice_another_model():
    """Negative control: the oracle with (2.6) read one sample late is told apart."""
    logs, human, _ = noisy_sessions(11)
    parameters, cost, _ = least_squares_fit(
        lambda p, log: human_output(p, np.r_[1.0, log["mode"][:-1]]), logs, "p_h", human
    )
    fit = fit_human(logs, noise="white")
    assert abs(fit.cost / cost - 1.0) > 1e-5
    assert abs(fit.table()["value"][:2] / parameters[:2] - 1.0).max() > 1e-5
