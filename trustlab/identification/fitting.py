"""
From sessions and a structure to a FitResult: what the data can identify, the estimate, and what to
say of it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.diagnosis import doubted
from trustlab.identification.fit_result import FitResult, parameter_table, run_fits
from trustlab.identification.logged import as_logged, averaged, undo_window, window_means
from trustlab.identification.output_error import (
    NOISES,
    NOT_WHITE,
    SHALLOW,
    Estimate,
    Problem,
    Valley,
    estimate,
    settle,
)
from trustlab.identification.regression import regress
from trustlab.identification.runs import HowLogged, Run, joined, read_runs
from trustlab.identification.structure import IdentificationError, Parameter, Structure
from trustlab.models.checks import of_class, one_of, positive
from trustlab.sessions.session import Session

HALF_WIDTH = float(special.ndtri(0.975))
"""Standard errors from the middle of a 95 % interval to its end."""

RIVAL = 10.0
"""
Deviance by which another valley may lie higher and still hold the truth: odds of e^5 = 150 to 1.
"""


def fit(
    structure: Structure,
    sessions: Session | Iterable[Session],
    method: str = "output_error",
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    guess: Mapping[str, float] | None = None,
    *,
    window: float | None = None,
    step: float | None = None,
    mode_delay: bool = False,
    stamp_error: float | None = None,
    robust: bool = True,
) -> FitResult:
    """
    Identify any structure from sessions: parameters are shared, initial states are each session's
    own.

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
    window : float, optional
        Length W [s] of the moving window over which the outputs were averaged, as
        `with_performance` does; 0 if they were not averaged. By default what each session's
        metadata say.
    step : float, optional
        Time step of the model [s], to which its rates refer, if it is shorter than the log's sample
        time; a sample must hold a whole number of steps.
    mode_delay : bool
        Whether to estimate the delay between the logged time of a change of mode and its effect
        [s], as a further parameter `mode_delay`.
    stamp_error : float, optional
        Standard deviation of the errors in the logged times of switches [s], independent from
        switch to switch; they widen the intervals, and so does an error that all share, as far as
        the residuals allow for one. By default what the session's metadata say (`stamp_error`);
        else 0.29 samples, the error of a time that is rounded to a sample, and 0 for simulated
        sessions that were not resampled.
    robust : bool
        Whether to leave out samples that lie far from the model, such as dropouts; the message says
        how many.

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
    how = HowLogged(window, step, mode_delay, stamp_error, robust)
    one_of("method", method, ("output_error", "regression"))
    runs = read_runs(sessions, *structure.inputs, *structure.outputs, how=how)
    if method == "regression":
        check_data(structure, runs, structure.limits(fixed, bounds))
        refuse_options(method, fixed, bounds, noise, how)
        return regress(structure, runs, method)
    return fit_runs(structure, runs, fixed, bounds, noise, guess, how)


def fit_runs(
    structure: Structure,
    runs: list[Run],
    fixed: Mapping | None,
    bounds: Mapping | None,
    noise: str,
    guess: Mapping | None,
    how: HowLogged,
) -> FitResult:
    """Identify a structure from runs that have been read, by the output-error method."""
    structure = _with_log(structure, runs, how.step, how.mode_delay)
    limits = structure.limits(fixed, bounds)
    check_data(structure, runs, limits)
    return result(estimate_runs(structure, runs, limits, noise, guess, how.robust))


def _with_log(
    structure: Structure, runs: list[Run], step: float | None, mode_delay: bool
) -> Structure:
    """Return the structure as these logs show it."""
    ratio = 1.0 if step is None else runs[0].sample_time / positive("step", step)
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise ValueError(
            f"step = {step:g} s does not divide the log's sample time, {runs[0].sample_time:g} s"
        )
    return (
        structure
        if step is None and not mode_delay
        else as_logged(structure, round(ratio), mode_delay)
    )


def refuse_options(
    method: str, fixed: Mapping | None, bounds: Mapping | None, noise: str, how: HowLogged
) -> None:
    """Refuse the options that only the output-error method has a use for."""
    if fixed or bounds or noise != "auto" or how.step or how.mode_delay:
        raise ValueError(
            f'method "{method}" is plain least squares; to fix or bound a parameter, or choose '
            'its noise, use "output_error"'
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
        lost = [
            structure.names[j] for j in structure.columns_of(output) if structure.names[j] in shared
        ]
        # What another output shows as well is not lost, if there is anything that only this one
        # shows.
        lost = [name for name in lost if name not in elsewhere] or lost
        raise IdentificationError(
            f"{output} never moves (it is {values[0]:g} throughout), so {' and '.join(lost)} "
            "cannot be identified; record a session in which performance is measured",
            tuple(lost),
        )


def estimate_runs(
    structure: Structure,
    runs: list[Run],
    limits: Mapping,
    noise: str = "auto",
    guess: Mapping | None = None,
    robust: bool = True,
) -> Estimate:
    """Make the initial guess and run the output-error method."""
    one_of("noise", noise, NOISES)
    if guess is not None:
        structure.check_names(guess, "guess")
    windowed, views = any(run.window > 1 for run in runs), {False: runs}
    if windowed:
        # Noise may be in what the window averages, or come on top of the means: the likelihoods of
        # both decide. Means of a linear model are what the means of its inputs give, but for the
        # beginning: good enough to start from.
        views = {
            True: [averaged(run, structure.outputs, undo_window) for run in runs],
            False: [averaged(run, structure.inputs, window_means) for run in runs],
        }
    begun = []
    for unwindow, view in views.items():
        for start in _starts(structure, view, limits, guess):
            problem = Problem(structure, runs, start, unwindow)
            begun.append((problem, problem.vector(start)))
    if len(begun) == 1:
        problem, at = begun[0]
        return estimate(problem, at, limits, noise, robust)
    valleys = [settle(problem, at, limits, robust, rough=True) for problem, at in begun]
    lowest = min(valleys, key=lambda one: one.deviance)
    if windowed:  # what the structure guesses from averages may miss a valley
        valleys += list(_elsewhere(lowest, limits))
        lowest = min(valleys, key=lambda one: one.deviance)
    rivals = tuple(one for one in valleys if one.deviance < lowest.deviance + RIVAL)
    for one in rivals:
        one.inverse()  # raises where values that explain the data as well leave a parameter open
    return replace(estimate(lowest.problem, lowest.theta, limits, noise, robust), rivals=rivals)


def _elsewhere(valley: Valley, limits: Mapping) -> Iterator[Valley]:
    """
    Yield what the search finds with bounded initial states held at other places, and when they are
    let go there.
    """
    problem = (
        valley.problem
    )  # with the outliers left out that this valley shows, so that deviances can be compared
    bounded = [
        one.name for one in problem.structure.initial if 0.0 < np.ptp(limits[one.name]) < np.inf
    ]
    for share in (0.1, 0.3, 0.5, 0.8) if bounded else ():
        at = {name: limits[name][0] + share * np.ptp(limits[name]) for name in bounded}
        start = valley.theta.copy()
        for j, parameter in enumerate(problem.structure.initial):
            start[problem.shared + j :: problem.own] = at.get(
                parameter.name, start[problem.shared + j :: problem.own]
            )
        held = settle(
            problem,
            start,
            {**limits, **{name: (own, own) for name, own in at.items()}},
            False,
            rough=True,
        )
        yield held
        if held.deviance < valley.deviance + SHALLOW:
            yield settle(problem, held.theta, limits, False, rough=True)


def _starts(
    structure: Structure, runs: list[Run], limits: Mapping, guess: Mapping | None
) -> list[dict]:
    """
    Return the starting values that the structure guesses from runs, with the user's own and what
    either leaves open.
    """
    guessed = structure.guess(runs, limits) if structure.guess is not None else {}
    several = guessed if isinstance(guessed, list) else [guessed]
    return [_completed(structure, limits, one, guess) for one in several]


def _completed(
    structure: Structure, limits: Mapping, guessed: Mapping, guess: Mapping | None
) -> dict:
    """
    Return a starting value for every name: the user's, the structure's, the parameter's own, or the
    middle of its bounds.
    """
    start = {**guessed, **(guess or {})}
    for parameter in (*structure.parameters, *structure.initial):
        low, high = limits[parameter.name]
        value = start.get(parameter.name, parameter.guess)
        if value is None:
            if not np.isfinite(high - low):
                raise ValueError(
                    f"{parameter.name} needs a guess, or bounds on both sides: "
                    f"guess={{{parameter.name!r}: …}}"
                )
            value = 0.5 * (low + high)
        start[parameter.name] = value
    return start


def found_table(found: Estimate) -> tuple[pd.DataFrame, pd.DataFrame]:
    """
    Return the table of the shared parameters, derived rows included, and the covariance of the
    estimated ones.
    """
    structure, size = found.problem.structure, found.problem.shared
    covariance = found.covariance[:size, :size]
    return parameter_table(
        structure.names[:size],
        found.theta[:size],
        covariance,
        found.status[:size],
        structure.derived,
    )


def weak_parameters(found: Estimate, table: pd.DataFrame) -> list[Parameter]:
    """
    Return the shared parameters that a bound holds, or whose 95 % interval is too wide to be of
    use.
    """
    values, stderrs, statuses = (
        table[column].to_dict() for column in ("value", "stderr", "status")
    )
    weak = []
    for parameter in found.problem.structure.parameters:
        status = statuses[parameter.name]
        wide = HALF_WIDTH * stderrs[parameter.name] > parameter.useful_half_width(values)
        if status == "at bound" or (status == "estimated" and wide):
            weak.append(parameter)
    return weak


def result(found: Estimate, tables: tuple[pd.DataFrame, pd.DataFrame] | None = None) -> FitResult:
    """
    Put an estimate and its tables into a FitResult; weakly determined parameters are marked here.
    """
    problem = found.problem
    structure, shared = problem.structure, problem.shared
    table, covariance = found_table(found) if tables is None else tables
    weak, sentences = weak_parameters(found, table), [_of_the_search(found)]
    for parameter in weak:
        value, stderr, status = (
            table[column][parameter.name] for column in ("value", "stderr", "status")
        )
        if status == "at bound":
            sentences.append(
                f"{parameter.name} is at its bound, {value:.6g}: the fit is better beyond it, or "
                "these data do not determine it."
            )
        else:
            table.loc[parameter.name, "status"] = "weak"
            sentences.append(
                f"{parameter.name} is weakly determined by these data ({value:.4g} ± "
                f"{HALF_WIDTH * stderr:.2g}); {parameter.hint}, or fix it."
            )
    doubts = list(doubted(found))
    sentences += [
        *_of_the_initial_states(found),
        *_of_the_runs(problem),
        *_of_the_noise(found),
        *doubts,
    ]
    # NaN for what was fixed; rows of what a bound holds are NaN already.
    stderr = np.sqrt(np.where(found.fixed, np.nan, np.diag(found.covariance)))
    states = {}
    for j, parameter in enumerate(structure.initial):
        where = slice(shared + j, None, problem.own)
        states[parameter.name], states[f"{parameter.name}_stderr"] = (
            found.theta[where],
            stderr[where],
        )
    values = dict(zip(structure.names, found.theta[:shared].tolist(), strict=False))
    try:
        model = values if structure.model is None else structure.model(**values)
    except IdentificationError as error:
        # What is wrong with the data may be why no model comes of them.
        lost = tuple(each.name for each in weak)
        lacking = (
            f"these data do not determine {', '.join(lost)}; hold some of them with fixed={{…}}: "
            if weak
            else ""
        )
        why = " ".join([f"{lacking}{error}{'.' if doubts else ''}", *doubts])
        raise IdentificationError(why, lost or error.parameters) from error
    return FitResult(
        model=model,
        method="output_error",
        parameters=table,
        covariance=covariance,
        initial_states=pd.DataFrame(
            states, index=pd.Index([run.label for run in problem.runs], name="run")
        ),
        runs=run_fits(structure, problem.runs, problem.fitted(), problem.residuals()),
        noise=found.noise,
        sigma=dict(zip(structure.outputs, found.sigma.tolist(), strict=True)),
        cost=0.5 * float(found.normal.squares.sum()),
        success=bool(found.search.converged and not weak and not doubts),
        message=" ".join(sentences),
        degrees_of_freedom=found.degrees_of_freedom,
    )


def _of_the_search(found: Estimate) -> str:
    if found.search.converged:
        return f"Converged in {found.search.iterations} evaluations."
    return (
        f"Stopped after {found.search.iterations} evaluations without reaching a minimum; do "
        "not use the numbers."
    )


def _of_the_initial_states(found: Estimate) -> Iterator[str]:
    """Say which initial states lie at an end that has a meaning."""
    problem = found.problem
    for j, parameter in enumerate(problem.structure.initial):
        where = slice(problem.shared + j, None, problem.own)
        for bound, meaning in parameter.ends.items():
            held = int((found.search.at_bound[where] & (found.theta[where] == bound)).sum())
            if held:
                yield (
                    f"{parameter.name} = {bound:g}, {meaning}, in {held} of {len(problem.runs)} "
                    "run(s)."
                )


def _of_the_runs(problem: Problem) -> Iterator[str]:
    """Say what a reader should know of the data themselves."""
    people = {run.participant for run in problem.runs}
    if len(people) > 1:
        yield (
            f"{len(people)} participants share one set of parameters; fit them one by one "
            "unless that is meant."
        )
    windows = sorted({run.window * run.sample_time for run in problem.runs if run.window > 1})
    if windows:
        where = "in the values that are averaged" if problem.unwindow else "in the means"
        spans = " and ".join(f"{window:g} s" for window in windows)
        yield (
            f"The outputs are fitted as means over a moving window of {spans}, with noise {where}."
        )
    for j, name in enumerate(problem.structure.outputs):
        lost = [
            (run.t[own][0], own.sum())
            for run, own in zip(problem.runs, problem.missing[j], strict=True)
            if own.any()
        ]
        if lost:
            yield (
                f"{sum(count for _, count in lost)} samples of {name} are far from the model all "
                f"of a sudden, the first at {lost[0][0]:g} s (dropouts?); they are left out, "
                "robust=False keeps them."
            )


def _of_the_noise(found: Estimate) -> Iterator[str]:
    """Say what the standard errors allow for."""
    white = found.simple_p >= NOT_WHITE
    test = f"Residuals are not white (Ljung–Box p = {found.simple_p:.2g})"
    if found.noise == "correlated":
        step = found.problem.runs[0].sample_time
        parts = [
            f"{name} has {100.0 * share:.3g} % of its noise correlated over "
            f"{-step / np.log(kept):.3g} s"
            for name, (share, kept) in zip(
                found.problem.structure.outputs, found.problem.noise, strict=True
            )
            if share > 0.0 and kept > 0.0
        ]
        left = ", and standard errors for what correlation is left" if found.sandwiched else ""
        yield (
            f"{'The fit allows' if white else f'{test}: the fit allows'} for correlated noise "
            f"({'; '.join(parts)}){left}."
        )
    elif found.noise == "hac":
        begin = "Standard errors" if white else f"{test}: standard errors"
        yield f"{begin} allow for autocorrelation."
    elif not white:
        yield f'{test}: these standard errors are too small; use noise="auto".'
