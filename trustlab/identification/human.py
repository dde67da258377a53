"""Identification of human utilization and performance, (2.5)-(2.6)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from trustlab.identification.arx import regression
from trustlab.identification.bounds import check_method, limits_of
from trustlab.identification.errors import IdentificationError
from trustlab.identification.fit_result import FitResult, RunFit
from trustlab.identification.greybox import HUMAN, Problem
from trustlab.identification.identifiability import check_output_moves
from trustlab.identification.output_error import Estimate, estimate
from trustlab.identification.starting_values import human_start
from trustlab.identification.summary import parameter_table, result
from trustlab.identification.traces import Trace, traces
from trustlab.models.human import HumanModel, performance_curve
from trustlab.sessions.session import Session

__all__ = ["build_human", "estimate_human", "fit_human", "with_derived_b"]


def fit_human(
    sessions: Session | Iterable[Session],
    method: str = "output_error",
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
) -> FitResult:
    """
    Identify the human model (2.5)-(2.6) from sessions: a, beta, p_min, p_max, and r at the start of every session.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode and p_h; parameters are shared, initial utilizations are not.
    method : {"output_error", "arx"}
        "output_error" minimises Σ (p_h − P_h(k))² of the simulated model (what the dissertation calls PEM).
        "arx" takes a from the logged column r by least squares on (2.5) and the rest from p_h against r.
    fixed : mapping, optional
        Values to hold, by name: a, beta, p_min, p_max, r0.
    bounds : mapping, optional
        (low, high) by name, None for an open side.
    noise : {"auto", "white", "hac"}
        What standard errors allow for: white residuals, or autocorrelated ones (Newey–West); "auto" chooses by a
        Ljung–Box test at 0.001.

    Returns
    -------
    FitResult
        With a HumanModel.

    Raises
    ------
    IdentificationError
        If the data do not determine a parameter; it is named.
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood.
    """
    fixed, bounds = {} if fixed is None else fixed, {} if bounds is None else bounds
    check_method(method, fixed, bounds, noise)
    if method == "arx":
        return _least_squares(sessions)
    runs, _ = traces(sessions, "p_h")
    problem, found = estimate_human(runs, limits_of(HUMAN, fixed, bounds), noise)
    table, covariance = parameter_table(problem, found)
    model = build_human(*found.theta[:4])
    return result(problem, found, model, with_derived_b(table), covariance)


def with_derived_b(table: pd.DataFrame, prefix: str = "") -> pd.DataFrame:
    """
    Add the row of b_r = 1 − a_r, equation (2.5).

    Parameters
    ----------
    table : pandas.DataFrame
        Parameters with columns value, stderr, status.
    prefix : str
        What stands before the parameters' names.
    """
    a = table.index.get_loc(f"{prefix}a")
    return with_row(table, f"{prefix}b", 1.0 - table["value"].iloc[a], table["stderr"].iloc[a], "derived")


def with_row(table: pd.DataFrame, name: str, value: float, stderr: float, status: str) -> pd.DataFrame:
    """
    Return a table of parameters with one row more; much quicker than `table.loc[name] = …`.

    Parameters
    ----------
    table : pandas.DataFrame
        Index `parameter`; columns value, stderr, status.
    name : str
        The new parameter.
    value, stderr : float
        What is known of it.
    status : str
        Where it comes from.
    """
    columns = {
        "value": np.append(table["value"].to_numpy(), value),
        "stderr": np.append(table["stderr"].to_numpy(), stderr),
        "status": [*table["status"], status],
    }
    return pd.DataFrame(columns, index=pd.Index([*table.index, name], name="parameter"))


def build_human(a: float, beta: float, p_min: float, p_max: float) -> HumanModel:
    """
    Return the model, or say what about the data contradicts (2.6).

    Parameters
    ----------
    a, beta, p_min, p_max : float
        Estimates.

    Raises
    ------
    IdentificationError
        If p_max is not above p_min.
    """
    if not p_max > p_min:
        raise IdentificationError(
            f"human performance is not greatest between rest and full load in these data (the fit has p_max = "
            f"{p_max:.4g} below p_min = {p_min:.4g}), so (2.6) does not describe them",
            ("p_min", "p_max"),
        )
    return HumanModel(float(a), float(beta), float(p_min), float(p_max))


def estimate_human(runs: list[Trace], limits: dict, noise: str = "auto") -> tuple[Problem, Estimate]:
    """
    Run the output-error method on (2.5)-(2.6).

    Parameters
    ----------
    runs : list of Trace
        Runs with mode and p_h.
    limits : dict
        From `limits_of`.
    noise : str
        As in `fit_human`.
    """
    check_output_moves(runs, "p_h", ("beta", "p_min", "p_max"))
    start = human_start(runs, limits)
    problem = Problem(HUMAN, runs, power=start["beta"])
    theta = np.r_[[start[name] for name in HUMAN.shared], np.full(len(runs), start["r0"])]
    return problem, estimate(problem, theta, limits, noise)


def _least_squares(sessions) -> FitResult:
    """Fit (2.5) to the logged utilization and (2.6) to performance against it."""
    from scipy import optimize

    try:
        runs, _ = traces(sessions, "p_h", "r")
    except ValueError as error:
        raise IdentificationError(
            f'method "arx" needs the logged utilization, column r, because (2.6) is not linear in its parameters: {error}; '
            'without it use method="output_error", as the dissertation does',
            ("a", "beta"),
        ) from error
    design = np.concatenate([run.r[:-1] - run.mode[:-1] for run in runs])[None, :]
    target = np.concatenate([run.r[1:] - run.mode[:-1] for run in runs])
    (a,), variance, _ = regression(design, target, ("a",))
    r, p_h = np.concatenate([run.r for run in runs]), np.concatenate([run.p_h for run in runs])

    def linear(beta):
        shape = performance_curve(r, beta, 0.0, 1.0)
        return regression(np.stack([1.0 - shape, shape]), p_h, ("p_min", "p_max"))

    search = optimize.minimize_scalar(
        lambda beta: linear(beta)[2] @ linear(beta)[2],
        bounds=(1e-4, 1.0 - 1e-4),
        method="bounded",
        options={"xatol": 1e-10},
    )
    beta = float(search.x)
    (p_min, p_max), _, residuals = linear(beta)
    step = 1e-6 * min(beta, 1.0 - beta)
    by_beta = (
        performance_curve(r, beta + step, p_min, p_max) - performance_curve(r, beta - step, p_min, p_max)
    ) / (2.0 * step)
    shape = performance_curve(r, beta, 0.0, 1.0)
    _, gram_inverse, _ = regression(
        np.stack([by_beta, 1.0 - shape, shape]), residuals, ("beta", "p_min", "p_max")
    )
    model = build_human(a, beta, p_min, p_max)
    names = ["a", "beta", "p_min", "p_max"]
    covariance = np.zeros((4, 4))
    covariance[0, 0], covariance[1:, 1:] = variance[0, 0], gram_inverse
    table = pd.DataFrame(
        {"value": [a, beta, p_min, p_max], "stderr": np.sqrt(np.diag(covariance)), "status": "estimated"},
        index=pd.Index(names, name="parameter"),
    )
    fits = []
    for run in runs:
        simulated = model.simulate(run.mode, float(run.r[0]))[1]
        fits.append(RunFit(run.label, run.synthetic, run.t, run.mode, {"p_h": run.p_h}, {"p_h": simulated}))
    errors = np.concatenate([fit.measured["p_h"] - fit.fitted["p_h"] for fit in fits])
    worthless = errors @ errors >= np.sum((p_h - p_h.mean()) ** 2)
    return FitResult(
        model=model,
        method="arx",
        parameters=with_derived_b(table),
        covariance=pd.DataFrame(covariance, index=pd.Index(names, name="parameter"), columns=names),
        initial_states=pd.DataFrame(
            {"r0": [run.r[0] for run in runs], "r0_stderr": np.nan},
            index=pd.Index([f.label for f in fits], name="run"),
        ),
        runs=fits,
        noise="white",
        sigma={"p_h": float(np.sqrt(residuals @ residuals / max(p_h.size - 3, 1)))},
        cost=0.5 * float(errors @ errors),
        success=not worthless,
        message="Least squares on the logged utilization: noise in column r biases a and beta."
        + (
            " The simulated model explains less than the mean does; do not use the numbers."
            if worthless
            else ""
        ),
        degrees_of_freedom=float(p_h.size - 3),
    )
