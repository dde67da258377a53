"""Identification of robot performance, (2.3): structure, sensitivities, initial guess, `fit_robot` and its errors."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from trustlab.identification.fit_result import FitResult, parameter_table
from trustlab.identification.fitting import (
    check_data,
    estimate_runs,
    found_table,
    refuse_options,
    result,
    weak_parameters,
)
from trustlab.identification.human import HUMAN, decay_rates, range_parameters, rate_parameter, solve_pair, undo_blocks
from trustlab.identification.output_error import Estimate
from trustlab.identification.regression import equations, regress
from trustlab.identification.runs import Run, as_columns, block_means, joined, read_runs
from trustlab.identification.structure import IdentificationError, LinearForm, Parameter, Structure
from trustlab.models.checks import one_of, positive
from trustlab.models.compiled import njit
from trustlab.models.robot import RobotModel
from trustlab.sessions.session import Session


def fit_robot(
    sessions: Session | Iterable[Session],
    method: str = "output_error",
    p_h_max: float | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
) -> FitResult:
    """
    Identify the robot model (2.3) from sessions: a, p_min, p_max, and P_r at the start of every session.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode, p_h and p_r; parameters are shared, initial performances are not.
    method : {"output_error", "arx"}
        "output_error" minimises Σ (p_r − P_r(k))² of the simulated model. "arx" is the dissertation's least squares
        on P_r(k + 1) = a P_r(k) + b M(k) P_h(k) + c: quick, and biased when p_r is measured with noise.
    p_h_max : float, optional
        Greatest human performance, which p_max refers to. Identified from the same sessions (`fit_human`) when not
        given; its uncertainty is then part of that of p_max.
    fixed : mapping, optional
        Values to hold, by name: a, p_min, p_max, p_r0.
    bounds : mapping, optional
        (low, high) by name, None for an open side.
    noise : {"auto", "white", "hac"}
        What standard errors allow for: white residuals, or autocorrelated ones (Newey–West); "auto" chooses by a
        Ljung–Box test at 0.001. White noise of the input p_h, estimated from its first differences, is allowed for
        in either case.

    Returns
    -------
    FitResult
        With a RobotModel.

    Raises
    ------
    IdentificationError
        If the data do not determine a parameter; it is named.
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood.
    """
    if one_of("method", method, ("output_error", "arx")) == "arx":
        refuse_options(method, fixed, bounds, noise)
    for given in (fixed, bounds):
        if isinstance(given, Mapping) and "p_h_max" in given:
            raise ValueError("p_h_max is not a parameter of the search; give it as fit_robot(..., p_h_max=...)")
    runs, any_operator = read_runs(sessions, "mode", "p_h", "p_r"), robot_structure(1.0)
    limits = any_operator.limits(fixed, bounds)
    check_data(any_operator, runs, limits)
    if p_h_max is not None:
        operator, best = None, _given_best(runs, p_h_max)
    else:
        operator = _fit_operator(runs)
        best = _parameter(operator, "p_max")
    structure = robot_structure(best)
    if method == "arx":
        fit = regress(structure, runs, method)
        values, covariance = fit.parameters["value"].to_numpy(), fit.covariance.to_numpy()
        tables = _tables_with_best(values, ["estimated"] * 3, covariance, best, operator)
        fit = replace(fit, parameters=tables[0], covariance=tables[1])
    else:
        found = estimate_runs(structure, runs, limits, noise)
        covariance, shared = np.nan_to_num(found.covariance), np.zeros(found.theta.size)
        # Robust errors see the noise of P_h already: filtered by (2.3), it is part of the residuals' autocorrelation.
        if found.noise == "white" and found.free.size:
            direct, shared = _input_noise(found, best, operator)
            covariance = covariance + direct
        shift = _shift_by_best(found, best)
        tables = _tables_with_best(
            found.theta[:3], found.status[:3], covariance[:3, :3], best, operator, shared[:3], shift[:3]
        )
        fit = result(found, tables)
    return fit if operator is None else _flag_weak_operator(fit, operator)


# --- the structure -------------------------------------------------------------------------------------------------

SLOPES = np.dtype([(name, float) for name in ("a", "p_min", "p_max", "p_r0")])


@njit
def _simulate_with_slopes(mode, p_h, a, p_min, p_max, p_h_max, p_r0, p_r, by):
    """Run (2.3) under a given P_h, and its derivatives by every parameter, into `p_r` and the records `by`."""
    now, by_a, by_min, by_max, by_0 = p_r0, 0.0, 0.0, 0.0, 1.0
    gain = (p_max - p_min) / p_h_max
    rest = 1.0 - a
    for k in range(mode.size):
        p_r[k] = now
        row = by[k]
        row.a = by_a
        row.p_min = by_min
        row.p_max = by_max
        row.p_r0 = by_0
        # (2.3) as P_r(k+1) = a P_r(k) + (1 − a)(p_min + gain M(k) P_h(k)), differentiated by each parameter in turn.
        drive = mode[k] * p_h[k]
        share = drive / p_h_max
        by_a = a * by_a + now - p_min - gain * drive
        by_min = a * by_min + rest * (1.0 - share)
        by_max = a * by_max + rest * share
        by_0 = a * by_0
        now = a * now + rest * (p_min + gain * drive)


def simulate_robot(run: Run, p_h: np.ndarray, p_h_max: float, a, p_min, p_max, p_r0):
    """Return P_r under a given P_h and the records of its derivatives by a, p_min, p_max and P_r at the start."""
    p_r, by = run.scratch("P_r"), run.scratch("of P_r", SLOPES)
    _simulate_with_slopes(run["mode"], p_h, a, p_min, p_max, p_h_max, p_r0, p_r, by)
    return p_r, by


def _input_influence(mode: np.ndarray, a: float, b: float, jacobian: np.ndarray) -> np.ndarray:
    """Return LᵀJ, shape (N, p), where L maps a change of P_h to the change of simulated P_r (2.3)."""
    from scipy import signal

    # L[k, i] = b M(i) a^(k−1−i) for i < k: one backward recursion per column instead of an N × N matrix.
    tail = signal.lfilter([0.0, 1.0], [1.0, -a], jacobian[::-1], axis=0)[::-1]
    return b * mode[:, None] * tail


def robot_parameters(prefix: str = "") -> tuple[Parameter, ...]:
    """Return a, p_min and p_max of (2.3)."""
    return (rate_parameter(prefix), *range_parameters(prefix))


def robot_structure(p_h_max: float) -> Structure:
    """Return the structure of (2.3), driven by the measured P_h, for a known greatest human performance."""

    def sensitivities(run, a, p_min, p_max, p_r0):
        p_r, by = simulate_robot(run, run["p_h"], p_h_max, a, p_min, p_max, p_r0)
        return [p_r], [as_columns(by)]

    def from_coefficients(a1, b, c):
        a = -a1
        p_min = c / (1.0 - a)
        return a, p_min, p_min + b / (1.0 - a) * p_h_max

    linear = LinearForm(
        coefficients=("a1", "b1", "c"),
        equations=lambda run: equations(run["p_r"], (run["mode"] * run["p_h"])[:, None], 1, (1,), (1,), True),
        parameters=from_coefficients,
        initial=lambda run: (float(run["p_r"][0]),),
        caution=(
            "Least squares on one-step predictions: measurement noise on p_r biases a towards 0, and these standard "
            "errors do not show it; compare output_error."
        ),
    )
    return Structure(
        "robot model (2.3)",
        parameters=robot_parameters(),
        initial=(Parameter("p_r0"),),
        inputs=("mode", "p_h"),
        outputs=("p_r",),
        sensitivities=sensitivities,
        guess=lambda runs, limits: robot_guess(runs, limits, p_h_max),
        model=lambda **values: build_robot(**values, p_h_max=p_h_max),
        check=check_excitation,
        linear=linear,
    )


def build_robot(a: float, p_min: float, p_max: float, p_h_max: float) -> RobotModel:
    """Return the model, or say what about the data contradicts (2.3)."""
    if not p_max > p_min:
        raise IdentificationError(
            "robot performance does not rise under manual control in these data (the fit has p_max = "
            f"{p_max:.4g}, not above p_min = {p_min:.4g}), so (2.3) does not describe them",
            ("p_min", "p_max"),
        )
    return RobotModel(float(a), float(p_min), float(p_max), float(p_h_max))


def check_excitation(runs: list[Run], limits: Mapping, low: str = "p_min", high: str = "p_max") -> None:
    """Refuse data in which nothing separates the least from the greatest robot performance."""
    modes = joined(runs, "mode")
    held = {name for name in (low, high) if limits[name][0] == limits[name][1]}
    # A mode that never changes leaves one steady state: under manual control either limit fixes the other, but an
    # autonomous robot says nothing of p_max.
    if np.ptp(modes) > 0.0 or (held and (modes[0] > 0.0 or high in held)):
        return
    lost = (high,) if modes[0] == 0.0 else (low, high)
    raise IdentificationError(
        f"these data do not determine {' and '.join(lost)}: mode never changes (it is {modes[0]:g} throughout); log at "
        "least one switch between manual and autonomous control, or fix a parameter, for example "
        f"fixed={{{lost[0]!r}: ...}}",
        lost,
    )


# --- the initial guess ---------------------------------------------------------------------------------------------


@njit
def _best_rate(mode, p_h, p_r, starts, rates, p_h_max):
    """Return the best of some rates, with p_min and p_max; NaN where no rate determines them."""
    least, best_a, best_min, best_max = np.inf, np.nan, np.nan, np.nan
    for a in rates:
        # P_r = p_min low + p_max high + what is left of the first sample is linear in p_min and p_max: solved for.
        s11 = s12 = s22 = t1 = t2 = total = 0.0
        for i in range(starts.size - 1):
            low, high, left = 0.0, 0.0, p_r[starts[i]]
            for k in range(starts[i], starts[i + 1]):
                y = p_r[k] - left
                s11 += low * low
                s12 += low * high
                s22 += high * high
                t1 += low * y
                t2 += high * y
                total += y * y
                share = mode[k] * p_h[k] / p_h_max
                low += (1.0 - a) * (1.0 - share - low)
                high += (1.0 - a) * (share - high)
                left *= a
        p_min, p_max = solve_pair(s11, s12, s22, t1, t2)
        squares = total - p_min * t1 - p_max * t2
        if np.isfinite(p_min) and squares < least:
            least, best_a, best_min, best_max = squares, a, p_min, p_max
    return best_a, best_min, best_max


def robot_guess(runs: list[Run], limits: Mapping, p_h_max: float) -> dict[str, float | np.ndarray]:
    """Return starting values of a, p_min, p_max and, for every run, p_r0, from a coarse search on block means."""
    means, length = block_means(runs)
    starts = np.cumsum([0, *(run.size for run in means)])
    rates = decay_rates(max(run.size for run in runs), length, limits["a"])
    mode, p_h, p_r = (joined(means, name) for name in ("mode", "p_h", "p_r"))
    a, p_min, p_max = _best_rate(mode, p_h, p_r, starts, rates, p_h_max)
    if not np.isfinite(a):
        a, p_min, p_max = rates[rates.size // 2], p_r.min(), p_r.max()
    first = np.array([run["p_r"][0] for run in means])
    return {"a": undo_blocks(a, length), "p_min": p_min, "p_max": p_max, "p_r0": first}


# --- the operator's greatest performance, and the errors that come of it -------------------------------------------


def _given_best(runs: list[Run], p_h_max: float) -> float:
    """Check a given greatest human performance against the data."""
    best, middle = positive("p_h_max", p_h_max), float(np.median(joined(runs, "p_h")))
    if best < middle:
        raise ValueError(
            f"p_h_max = {p_h_max} lies below the median of the measured p_h, {middle:.4g}; it is the greatest"
        )
    return best


def _fit_operator(runs: list[Run]) -> Estimate:
    """Identify the operator, whose p_max is the p_h_max of (2.3)."""
    limits = HUMAN.limits()
    try:
        check_data(HUMAN, runs, limits)
        operator = estimate_runs(HUMAN, runs, limits)
    except IdentificationError as error:
        raise IdentificationError(
            f"p_max refers to the operator's best performance, which could not be identified ({error}); "
            "give it as p_h_max=...",
            ("p_max", *error.parameters),
        ) from error
    best = _parameter(operator, "p_max")
    if not best > 0.0:
        raise IdentificationError(
            f"column p_h: the operator's greatest performance comes out as {best:.4g}, but (2.3) divides by it; use a "
            "measure of performance that is positive",
            ("p_max",),
        )
    return operator


def _parameter(found: Estimate, name: str) -> float:
    """Return one estimate."""
    return float(found.theta[found.problem.names.index(name)])


def _input_noise(found: Estimate, best: float, operator: Estimate | None) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what noise of the measured P_h adds to the covariance, and the covariance that it shares with p̂_h,max.

    The simulation is driven by the measured P_h, whose noise e_h reaches the estimates: to first order
    θ̂ − θ = (JᵀJ)⁻¹ Jᵀ(e_r − L e_h), with L the response of simulated P_r to P_h. So e_h, white with variance σ²,
    adds σ² (JᵀJ)⁻¹ JᵀL LᵀJ (JᵀJ)⁻¹. p̂_h,max = p_h,max + gᵀe_h comes from the same samples of P_h, so that its
    covariance with θ̂ is −σ² (JᵀJ)⁻¹ JᵀL g.
    """
    problem, free, size = found.problem, found.free, found.theta.size
    # The first difference of a signal that moves slowly under white noise has variance 2σ².
    variance = 0.5 * float(np.mean(np.concatenate([np.diff(run["p_h"]) for run in problem.runs]) ** 2))
    if operator is not None:
        variance = min(variance, float(operator.sigma[0]) ** 2)
    g = _best_by_samples(operator) if operator is not None else [np.zeros(run.size) for run in problem.runs]
    a, p_min, p_max = found.theta[:3]
    b = (1.0 - a) * (p_max - p_min) / best
    spread, mixed = np.zeros((size, size)), np.zeros(size)  # JᵀL LᵀJ and JᵀL g
    for i, run in enumerate(problem.runs):
        where = problem.where[i]
        influence = _input_influence(run["mode"], a, b, problem.latest[i][1][0])
        spread[np.ix_(where, where)] += influence.T @ influence
        mixed[where] += influence.T @ g[i]
    # `inverse` is (w JᵀJ)⁻¹ with w = n/Σ e²: times w it is (JᵀJ)⁻¹.
    solve = found.inverse * problem.weights(found.normal.squares)[0]
    direct, shared = np.zeros((size, size)), np.zeros(size)
    direct[np.ix_(free, free)] = variance * solve @ spread[np.ix_(free, free)] @ solve.T
    shared[free] = -variance * solve @ mixed[free]
    return direct, shared


def _best_by_samples(operator: Estimate) -> list[np.ndarray]:
    """Return g, the derivative of p̂_h,max by every sample of the measured P_h; 0 where the residuals are not white."""
    problem, row = operator.problem, operator.problem.names.index("p_max")
    solve = np.zeros(operator.theta.size)
    if operator.noise == "white":
        # p̂_h,max is one row of (JᵀJ)⁻¹ Jᵀ P_h, with the operator's own J.
        weight = problem.weights(operator.normal.squares)[0]
        solve[operator.free] = operator.inverse[list(operator.free).index(row)] * weight
    return [jacobians[0] @ solve[where] for (_, jacobians), where in zip(problem.latest, problem.where, strict=True)]


def _shift_by_best(found: Estimate, best: float) -> np.ndarray:
    """Return the derivative of all estimates by the p_h,max that they are made with."""
    # P_r depends on p_h,max through (p_max − p_min)/p_h,max alone, so ∂P_r/∂p_h,max = −gain ∂P_r/∂p_max, and least squares
    # answers with gain (JᵀJ)⁻¹ Jᵀ ∂P_r/∂p_max: p_max alone follows where it is free, the others give way where it is not.
    gain = (_parameter(found, "p_max") - _parameter(found, "p_min")) / best
    shift = np.zeros(found.theta.size)
    by_p_max = found.normal.matrix[found.free, found.problem.names.index("p_max")]
    shift[found.free] = gain * found.inverse @ by_p_max
    return shift


def _tables_with_best(
    values: np.ndarray,
    status: list[str],
    covariance: np.ndarray,
    best: float,
    operator: Estimate | None,
    shared: np.ndarray | None = None,
    shift: np.ndarray | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return table and covariance of a, p_min, p_max and p_h_max, and the row of b; `shared` is their covariance with p̂_h,max."""
    row = HUMAN.names.index("p_max")
    total = np.zeros((4, 4))
    total[:3, :3] = covariance
    total[3, 3] = 0.0 if operator is None else operator.covariance[row, row]
    total[:3, 3] = total[3, :3] = 0.0 if shared is None else shared
    # The estimates were made with p̂_h,max in place of p_h,max: its error is added to each as far as it shifts them.
    # Of a regression it shifts p_max alone, by the gain.
    _, p_min, p_max = values
    through = np.eye(4)
    through[:3, 3] = (0.0, 0.0, (p_max - p_min) / best) if shift is None else shift
    return parameter_table(
        ("a", "p_min", "p_max", "p_h_max"),
        np.r_[values, best],
        through @ total @ through.T,
        [*status, "given" if operator is None else "estimated"],
        {"b": lambda at: (1.0 - at["a"]) * (at["p_max"] - at["p_min"]) / at["p_h_max"]},
    )


def _flag_weak_operator(fit: FitResult, operator: Estimate) -> FitResult:
    """Mark p_max as weak where the operator's model, which p_h_max comes from, is weakly determined itself."""
    names = [parameter.name for parameter in weak_parameters(operator, found_table(operator)[0])]
    if operator.search.converged and not names:
        return fit
    parameters = fit.parameters.copy()
    parameters.loc[["p_max", "p_h_max"], "status"] = "weak"
    reason = f"{' and '.join(names)} of the operator's model" if names else "the operator's model"
    sentence = (
        "Do not rely on p_h_max, nor on p_max, which refers to it: these data do not determine "
        f"{reason}; give p_h_max=..."
    )
    return replace(fit, parameters=parameters, success=False, message=f"{fit.message} {sentence}.")
