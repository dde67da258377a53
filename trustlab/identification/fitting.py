"""From sessions and a structure to a FitResult: what the data can identify, the estimate, and what to say of it."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.fit_result import FitResult, parameter_table, run_fits
from trustlab.identification.output_error import NOISES, Estimate, Problem, estimate
from trustlab.identification.regression import regress
from trustlab.identification.runs import Run, joined, read_runs
from trustlab.identification.structure import IdentificationError, Parameter, Structure
from trustlab.models.checks import of_class, one_of
from trustlab.sessions.session import Session

HALF_WIDTH = float(special.ndtri(0.975))
"""Standard errors from the middle of a 95 % interval to its end."""


def fit(
    structure: Structure,
    sessions: Session | Iterable[Session],
    method: str = "output_error",
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    guess: Mapping[str, float] | None = None,
) -> FitResult:
    """
    Identify any structure from sessions: parameters are shared, initial states are each session's own.

    Parameters
    ----------
    structure : Structure
        The model, of this package or your own.
    sessions : Session or iterable of Session
        Runs with the columns that are the structure's inputs and outputs.
    method : {"output_error", "regression"}
        "output_error" simulates the model and minimises the squared error of each output, weighted by the inverse of
        its own residual variance. "regression" is least squares on one-step predictions, for a structure with a
        `LinearForm`: quick, and biased when the outputs are measured with noise.
    fixed : mapping, optional
        Values to hold, by name.
    bounds : mapping, optional
        (low, high) by name, None for an open side.
    noise : {"auto", "white", "hac"}
        What standard errors allow for: white residuals, or autocorrelated ones (Newey–West); "auto" chooses by a
        Ljung–Box test at 0.001.
    guess : mapping, optional
        Where the search starts, by name, in place of the structure's own guess.

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
        If an argument is not understood, or the simulation returns something other than finite outputs.
    """
    of_class("structure", structure, Structure)
    one_of("method", method, ("output_error", "regression"))
    limits = structure.limits(fixed, bounds)
    runs = read_runs(sessions, *structure.inputs, *structure.outputs)
    check_data(structure, runs, limits)
    if method == "regression":
        refuse_options(method, fixed, bounds, noise)
        return regress(structure, runs, method)
    return result(estimate_runs(structure, runs, limits, noise, guess))


def refuse_options(method: str, fixed: Mapping | None, bounds: Mapping | None, noise: str) -> None:
    """Refuse the options that only the output-error method has a use for."""
    if fixed or bounds or noise != "auto":
        raise ValueError(
            f'method "{method}" is plain least squares; to fix or bound a parameter, or choose its noise, use '
            '"output_error"'
        )


def check_data(structure: Structure, runs: list[Run], limits: Mapping) -> None:
    """Refuse data that cannot identify the structure, before any search."""
    if structure.check is not None:
        structure.check(runs, limits)
    shared = {one.name for one in structure.parameters}
    for output in structure.outputs:
        values = joined(runs, output)
        if np.ptp(values) > 0.0:
            continue
        others = [other for other in structure.outputs if other != output]
        elsewhere = {structure.names[j] for other in others for j in structure.columns_of(other)}
        lost = [structure.names[j] for j in structure.columns_of(output) if structure.names[j] in shared]
        # What another output shows as well is not lost, if there is anything that only this one shows.
        lost = [name for name in lost if name not in elsewhere] or lost
        raise IdentificationError(
            f"{output} never moves (it is {values[0]:g} throughout), so {' and '.join(lost)} cannot be identified; "
            "record a session in which performance is measured",
            tuple(lost),
        )


def estimate_runs(
    structure: Structure, runs: list[Run], limits: Mapping, noise: str = "auto", guess: Mapping | None = None
) -> Estimate:
    """Make the initial guess and run the output-error method."""
    one_of("noise", noise, NOISES)
    start = structure.guess(runs, limits) if structure.guess is not None else {}
    if guess is not None:
        structure.check_names(guess, "guess")
        start = {**start, **guess}
    for parameter in (*structure.parameters, *structure.initial):
        low, high = limits[parameter.name]
        value = start.get(parameter.name, parameter.guess)
        if value is None:
            if not np.isfinite(high - low):
                raise ValueError(
                    f"{parameter.name} needs a guess, or bounds on both sides: guess={{{parameter.name!r}: …}}"
                )
            value = 0.5 * (low + high)
        start[parameter.name] = value
    problem = Problem(structure, runs, start)
    return estimate(problem, problem.vector(start), limits, noise)


def found_table(found: Estimate) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the table of the shared parameters, derived rows included, and the covariance of the estimated ones."""
    structure, size = found.problem.structure, found.problem.shared
    covariance = found.covariance[:size, :size]
    return parameter_table(
        structure.names[:size], found.theta[:size], covariance, found.status[:size], structure.derived
    )


def weak_parameters(found: Estimate, table: pd.DataFrame) -> list[Parameter]:
    """Return the shared parameters that a bound holds, or whose 95 % interval is too wide to be of use."""
    values, stderrs, statuses = (table[column].to_dict() for column in ("value", "stderr", "status"))
    weak = []
    for parameter in found.problem.structure.parameters:
        status = statuses[parameter.name]
        wide = HALF_WIDTH * stderrs[parameter.name] > parameter.useful_half_width(values)
        if status == "at bound" or (status == "estimated" and wide):
            weak.append(parameter)
    return weak


def result(found: Estimate, tables: tuple[pd.DataFrame, pd.DataFrame] | None = None) -> FitResult:
    """Put an estimate and its tables into a FitResult; weakly determined parameters are marked here."""
    problem = found.problem
    structure, shared = problem.structure, problem.shared
    table, covariance = found_table(found) if tables is None else tables
    weak, sentences = weak_parameters(found, table), [_of_the_search(found)]
    for parameter in weak:
        value, stderr, status = (table[column][parameter.name] for column in ("value", "stderr", "status"))
        if status == "at bound":
            sentences.append(
                f"{parameter.name} is at its bound, {value:.6g}: the fit is better beyond it, or these data do not "
                "determine it."
            )
        else:
            table.loc[parameter.name, "status"] = "weak"
            sentences.append(
                f"{parameter.name} is weakly determined by these data ({value:.4g} ± {HALF_WIDTH * stderr:.2g}); "
                f"{parameter.hint}, or fix it."
            )
    sentences += [*_of_the_initial_states(found), *_of_the_runs(problem.runs), *_of_the_noise(found)]
    # NaN for what was fixed; rows of what a bound holds are NaN already.
    stderr = np.sqrt(np.where(found.fixed, np.nan, np.diag(found.covariance)))
    states = {}
    for j, parameter in enumerate(structure.initial):
        where = slice(shared + j, None, problem.own)
        states[parameter.name], states[f"{parameter.name}_stderr"] = found.theta[where], stderr[where]
    values = dict(zip(structure.names, found.theta[:shared].tolist(), strict=False))
    return FitResult(
        model=values if structure.model is None else structure.model(**values),
        method="output_error",
        parameters=table,
        covariance=covariance,
        initial_states=pd.DataFrame(states, index=pd.Index([run.label for run in problem.runs], name="run")),
        runs=run_fits(structure, problem.runs, [outputs for outputs, _ in problem.latest]),
        noise=found.noise,
        sigma=dict(zip(structure.outputs, found.sigma.tolist(), strict=True)),
        cost=0.5 * float(found.normal.squares.sum()),
        success=bool(found.search.converged and not weak),
        message=" ".join(sentences),
        degrees_of_freedom=float(problem.counts.sum() - found.free.size),
    )


def _of_the_search(found: Estimate) -> str:
    if found.search.converged:
        return f"Converged in {found.search.iterations} evaluations."
    return f"Stopped after {found.search.iterations} evaluations without reaching a minimum; do not use the numbers."


def _of_the_initial_states(found: Estimate) -> Iterator[str]:
    """Say which initial states lie at an end that has a meaning."""
    problem = found.problem
    for j, parameter in enumerate(problem.structure.initial):
        where = slice(problem.shared + j, None, problem.own)
        for bound, meaning in parameter.ends.items():
            held = int((found.search.at_bound[where] & (found.theta[where] == bound)).sum())
            if held:
                yield f"{parameter.name} = {bound:g}, {meaning}, in {held} of {len(problem.runs)} run(s)."


def _of_the_runs(runs: list[Run]) -> Iterator[str]:
    """Say what a reader should know of the data themselves."""
    people = {run.participant for run in runs}
    if len(people) > 1:
        yield f"{len(people)} participants share one set of parameters; fit them one by one unless that is meant."
    measures = sorted({str(run.performance_measure) for run in runs if run.performance_measure})
    if measures:
        yield (
            f"Performance is measured over a moving window ({', '.join(measures)}): rises and decays faster than the "
            "window are the window's own."
        )


def _of_the_noise(found: Estimate) -> Iterator[str]:
    """Say what the standard errors allow for."""
    white = found.whiteness_p >= 1e-3
    test = f"Residuals are not white (Ljung–Box p = {found.whiteness_p:.2g})"
    if found.noise == "hac":
        begin = "Standard errors" if white else f"{test}: standard errors"
        yield f"{begin} allow for autocorrelation."
    elif not white:
        yield f'{test}: these standard errors are too small; use noise="hac".'
