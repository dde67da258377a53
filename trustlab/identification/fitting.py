"""
Fit a structure to sessions: read them, search from starting values, report.

`fit_tsc`, `fit_human` and a user's own structure go through `fit`; the likelihood that is maximised
is in `output_error.py`, the warnings in `diagnosis.py`.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.diagnosis import doubts, remarks, search_remark
from trustlab.identification.fit_result import FitResult, parameter_table, run_fits, state_table
from trustlab.identification.logged import averaged, logged_structure, undo_window, window_means
from trustlab.identification.output_error import (
    NOISES,
    SHALLOW,
    Estimate,
    LocalOptimum,
    Problem,
    fit_problem,
    local_optimum,
)
from trustlab.identification.regression import regress
from trustlab.identification.runs import LogSettings, Run, joined, log_settings, read_runs
from trustlab.identification.structure import IdentificationError, Parameter, Structure
from trustlab.models.checks import of_class, one_of
from trustlab.sessions.session import Session

HALF_WIDTH = float(special.ndtri(0.975))
"""Standard errors from the middle of a 95 % interval to its end."""

METHODS = ("output_error", "regression")

RIVAL = 10.0
"""
Deviance by which another optimum may lie higher and still hold the truth: odds of e^5 = 150 to 1.
"""


def fit(
    structure: Structure,
    sessions: Session | Iterable[Session],
    method: str = "output_error",
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    guess: Mapping[str, float] | None = None,
    log: LogSettings | None = None,
    **settings: Any,
) -> FitResult:
    """
    Identify any structure from sessions, which share the parameters but not the initial states.

    Parameters
    ----------
    structure : Structure
        The model, of this package or your own.
    sessions : Session or iterable of Session
        Runs with the columns that are the structure's inputs and outputs.
    method : {"output_error", "regression"}
        "output_error" simulates the model and minimises the squared error of each output, weighted
        by the inverse of its own residual variance. "regression" is least squares on one-step
        predictions, for a structure with a `LinearForm`: quick, and biased when the outputs are
        measured with noise.
    fixed : mapping, optional
        Parameters to hold fixed: values by name.
    bounds : mapping, optional
        Bounds (low, high) by name; None leaves a side open.
    noise : {"auto", "white", "correlated", "hac"}
        What the likelihood and the standard errors allow for. "white": white noise. "correlated":
        an AR(1) process plus white noise on each output, by the prediction errors of its Kalman
        filter; process noise of a first-order state looks the same. "hac": any autocorrelation that
        dies out (Newey–West), in the standard errors only. "auto" starts with the first and moves
        on to the next where a Ljung–Box test at 0.001 rejects it.
    guess : mapping, optional
        Starting values by name, in place of the structure's own.
    log : LogSettings, optional
        How the log shows the model: window, step, mode_delay, stamp_error, robust.
    **settings : float or bool
        Fields of `LogSettings` as keywords; they replace those of `log`.

    Returns
    -------
    FitResult
        With `model` as the structure makes it.

    Raises
    ------
    IdentificationError
        If the data do not determine a parameter; it is named.
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood, or the simulation returns something other than finite
        outputs.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> def simulate(run, rate, p_r0):
    ...     return 0.24 + (p_r0 - 0.24) * np.exp(-rate * np.arange(len(run["mode"])))
    >>> rate, start = tl.Parameter("rate", 0.0, 1.0), tl.Parameter("p_r0", 0.0, 1.0)
    >>> decay = tl.Structure("decay", [rate], outputs="p_r", simulate=simulate, initial=[start])
    >>> t = np.arange(200.0)
    >>> p_r = 0.24 + 0.1 * np.exp(-0.02 * t) + 1e-3 * np.random.default_rng(0).normal(size=200)
    >>> fit = tl.fit(decay, tl.read_frame(pd.DataFrame({"t": t, "mode": 0.0, "p_r": p_r})))
    >>> fit.table().loc["rate", ["value", "stderr"]].round(4)
    value     0.0199
    stderr    0.0001
    Name: rate, dtype: float64
    """
    of_class("structure", structure, Structure)
    log = log_settings(log, settings)
    one_of("method", method, METHODS)
    runs = read_runs(sessions, *structure.inputs, *structure.outputs, log=log)
    if method == "regression":
        refuse_options(fixed, bounds, noise, log, guess)
        check_data(structure, runs, structure.limits(fixed, bounds))
        return regress(structure, runs)
    structure = logged_structure(structure, runs[0].sample_time, log)
    limits = structure.limits(fixed, bounds)
    check_data(structure, runs, limits)
    return result(estimate_runs(structure, runs, limits, noise, guess, log.robust))


def refuse_options(
    fixed: Mapping | None,
    bounds: Mapping | None,
    noise: str,
    log: LogSettings,
    guess: Mapping | None = None,
) -> None:
    """Refuse the options that only the output-error method has a use for."""
    if fixed or bounds or guess or noise != "auto" or log.step or log.mode_delay:
        raise ValueError(
            'method "regression" is plain least squares; to fix, bound or guess a parameter, or '
            'choose its noise, use "output_error"'
        )


def check_data(structure: Structure, runs: list[Run], limits: Mapping) -> None:
    """Refuse data that cannot identify the structure, before any search."""
    if structure.check is not None:
        structure.check(runs, limits)
    shared = structure.names[: len(structure.parameters)]
    moved = {
        output: [structure.names[j] for j in structure.columns_of(output)]
        for output in structure.outputs
    }
    for output in structure.outputs:
        values = joined(runs, output)
        if np.ptp(values) > 0.0:
            continue
        elsewhere = {name for name in structure.outputs if name != output}
        visible = {parameter for name in elsewhere for parameter in moved[name]}
        lost = [name for name in moved[output] if name in shared]
        # What another output shows as well is not lost, if there is anything that only this one
        # shows.
        lost = [name for name in lost if name not in visible] or lost
        raise IdentificationError(
            f"{output} never moves (it is {values[0]:g} throughout), so {' and '.join(lost)} "
            "cannot be identified; record a session in which performance is measured",
            tuple(lost),
        )


# --- the search -----------------------------------------------------------------------------------


def estimate_runs(
    structure: Structure,
    runs: list[Run],
    limits: Mapping,
    noise: str = "auto",
    guess: Mapping | None = None,
    robust: bool = True,
) -> Estimate:
    """Search from every starting value, and return the best optimum as an estimate."""
    one_of("noise", noise, NOISES)
    if guess is not None:
        structure.check_names(guess, "guess")
    windowed = any(run.window > 1 for run in runs)
    views = [(False, runs)]
    if windowed:
        # Noise may be in the values that the window averages, or in the means: the likelihoods of
        # both decide. Each is started from its own view of the data. In the second the inputs are
        # averaged as well, which gives a linear model's means but for the beginning.
        views = [
            (True, [averaged(run, structure.outputs, undo_window) for run in runs]),
            (False, [averaged(run, structure.inputs, window_means) for run in runs]),
        ]
    problems = []
    for unwindow, view in views:
        for start in _starts(structure, view, limits, guess):
            problem = Problem(structure, runs, start, unwindow)
            problems.append((problem, problem.vector(start)))
    if len(problems) == 1:
        problem, theta = problems[0]
        return fit_problem(problem, theta, limits, noise, robust)
    optima = [
        local_optimum(problem, theta, limits, robust, rough=True) for problem, theta in problems
    ]
    if windowed:  # what the structure guesses from averages may miss an optimum
        optima += list(_elsewhere(_best(optima), limits))
    lowest = _best(optima)
    rivals = tuple(optimum for optimum in optima if optimum.deviance < lowest.deviance + RIVAL)
    for optimum in rivals:
        # Raises where an optimum that is nearly as likely does not determine the parameters.
        optimum.inverse_information()
    estimate = fit_problem(lowest.problem, lowest.theta, limits, noise, robust)
    return replace(estimate, rivals=rivals)


def _best(optima: list[LocalOptimum]) -> LocalOptimum:
    return min(optima, key=lambda optimum: optimum.deviance)


def _elsewhere(optimum: LocalOptimum, limits: Mapping) -> Iterator[LocalOptimum]:
    """
    Search with bounded initial states held at other places, and go on from there with them free.
    """
    # With the outliers left out that this optimum shows, so that deviances can be compared.
    problem = optimum.problem
    names = problem.structure.names[problem.shared :]
    bounded = [name for name in names if 0.0 < np.ptp(limits[name]) < np.inf]
    for share in (0.1, 0.3, 0.5, 0.8) if bounded else ():
        at = {name: limits[name][0] + share * np.ptp(limits[name]) for name in bounded}
        start = optimum.theta.copy()
        for j, name in enumerate(names):
            if name in at:
                start[problem.shared + j :: problem.states] = at[name]
        fixed = {name: (value, value) for name, value in at.items()}
        constrained = local_optimum(problem, start, {**limits, **fixed}, False, rough=True)
        yield constrained
        if constrained.deviance < optimum.deviance + SHALLOW:
            yield local_optimum(problem, constrained.theta, limits, False, rough=True)


def _starts(
    structure: Structure, runs: list[Run], limits: Mapping, guess: Mapping | None
) -> list[dict]:
    """Return starting values for every name: the user's, else the structure's, else a default."""
    guesses = {} if structure.guess is None else structure.guess(runs, limits)
    starts = []
    for values in guesses if isinstance(guesses, list) else [guesses]:
        start = {**values, **(guess or {})}
        for parameter in structure.unknowns:
            if start.get(parameter.name) is None:
                start[parameter.name] = _default(parameter, *limits[parameter.name])
        starts.append(start)
    return starts


def _default(parameter: Parameter, low: float, high: float) -> float:
    """Return a parameter's own starting value, or the middle of its bounds."""
    if parameter.guess is not None:
        return parameter.guess
    if not np.isfinite(high - low):
        raise ValueError(
            f"{parameter.name} needs a guess, or bounds on both sides: "
            f"guess={{{parameter.name!r}: …}}"
        )
    return 0.5 * (low + high)


# --- the report -----------------------------------------------------------------------------------


def estimate_table(estimate: Estimate) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the table of the shared parameters, and the covariance of the estimated ones."""
    structure = estimate.problem.structure
    size = estimate.problem.shared
    return parameter_table(
        structure.names[:size],
        estimate.theta[:size],
        estimate.covariance[:size, :size],
        estimate.status[:size],
        structure.derived,
    )


def result(
    estimate: Estimate, tables: tuple[pd.DataFrame, pd.DataFrame] | None = None
) -> FitResult:
    """Put an estimate and its tables into a FitResult; weak parameters are marked here."""
    problem = estimate.problem
    structure = problem.structure
    table, covariance = estimate_table(estimate) if tables is None else tables
    weak = weak_parameters(estimate, table)
    reasons = list(doubts(estimate))
    sentences = [search_remark(estimate), *_mark(weak, table), *remarks(estimate), *reasons]
    success = bool(estimate.search.converged and not weak and not reasons)
    if not success and structure.remedy:
        sentences.append(structure.remedy)
    # NaN for what was fixed; rows of what a bound holds are NaN already.
    stderr = np.sqrt(np.where(estimate.fixed, np.nan, np.diag(estimate.covariance)))
    shape = (len(problem.runs), problem.states)
    states = estimate.theta[problem.shared :].reshape(shape)
    state_errors = stderr[problem.shared :].reshape(shape)
    return FitResult(
        model=_model(estimate, weak, reasons),
        method="output_error",
        parameters=table,
        covariance=covariance,
        initial_states=state_table(structure, problem.runs, states, state_errors),
        runs=run_fits(structure, problem.runs, problem.fitted(), problem.residuals()),
        noise=estimate.noise,
        sigma=dict(zip(structure.outputs, estimate.sigma.tolist(), strict=True)),
        cost=0.5 * float(estimate.equations.squares.sum()),
        success=success,
        message=" ".join(sentences),
        degrees_of_freedom=estimate.degrees_of_freedom,
    )


def _mark(weak: list[Parameter], table: pd.DataFrame) -> Iterator[str]:
    """Mark weak parameters in the table and say what would help."""
    for parameter in weak:
        name = parameter.name
        value = table["value"][name]
        stderr = table["stderr"][name]
        if table["status"][name] == "at bound":
            yield (
                f"{name} is at its bound, {value:.6g}: the fit is better beyond it, or "
                "these data do not determine it."
            )
        else:
            table.loc[name, "status"] = "weak"
            yield (
                f"{name} is weakly determined by these data ({value:.4g} ± "
                f"{HALF_WIDTH * stderr:.2g}); {parameter.hint}, or fix it."
            )


def _model(estimate: Estimate, weak: list[Parameter], reasons: list[str]) -> Any:
    """Return the structure's model; an error names the weak parameters and the doubts."""
    structure = estimate.problem.structure
    shared = estimate.problem.shared
    values = dict(zip(structure.names, estimate.theta[:shared].tolist(), strict=False))
    if structure.model is None:
        return values
    try:
        return structure.model(**values)
    except IdentificationError as error:
        # What is wrong with the data may be why no model comes of them.
        lost = tuple(parameter.name for parameter in weak)
        text = f"{error}{'.' if reasons else ''}"
        if weak:
            text = (
                f"these data do not determine {', '.join(lost)}; hold some of them with "
                f"fixed={{…}}: {text}"
            )
        raise IdentificationError(" ".join([text, *reasons]), lost or error.parameters) from error


def weak_parameters(estimate: Estimate, table: pd.DataFrame) -> list[Parameter]:
    """Return the shared parameters at a bound, or with a 95 % interval too wide to be of use."""
    values, stderrs, statuses = (table[name].to_dict() for name in ("value", "stderr", "status"))
    weak = []
    for parameter in estimate.problem.structure.parameters:
        status = statuses[parameter.name]
        half_width = HALF_WIDTH * stderrs[parameter.name]
        wide = half_width > parameter.useful_half_width(values)
        if status == "at bound" or (status == "estimated" and wide):
            weak.append(parameter)
    return weak
