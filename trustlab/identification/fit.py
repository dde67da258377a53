"""
`fit`: a model identified from sessions, and what to say of it.

1. Sessions become `Run`s, and the model what the log shows of it (log.py).
2. The model gives starts, from block means (tsc.py); a rough search goes from each, and samples far
   from the model are left out (search.py: `rough_optima`, `robust_search`).
3. From the best a fine search; the noise of its residuals is modelled, and the search goes on
   (`estimated`).
4. The covariance: of noise, of errors of the mode's stamps, of states at a bound.
5. Here: the table, what is weak, remarks, and doubts.

The likelihood of one point is problem.py's.

Remarks tell what a reader should know; doubtful are a mode stamped early or late, coarse numbers,
slow noise, and other values that explain the data as well.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from trustlab.identification.log import (
    LogSettings,
    Run,
    joined,
    log_settings,
    logged_model,
    read_runs,
    undo_window,
    window_means,
)
from trustlab.identification.model import IdentificationError, Model
from trustlab.identification.problem import HALF_WIDTH, NOT_WHITE, Problem, hac_lags
from trustlab.identification.result import FitResult, RunFit
from trustlab.identification.search import NOISES, Estimate, estimate_runs
from trustlab.models.checks import counted, of_class, one_of
from trustlab.sessions.session import Session


def fit(
    model: Model,
    sessions: Session | Iterable[Session],
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    guess: Mapping[str, float] | None = None,
    log: LogSettings | None = None,
    **settings: Any,
) -> FitResult:
    """
    Identify a model from sessions, which share its unknowns but not the initial states.

    Parameters
    ----------
    model : Model
        The model, of this package or your own.
    sessions : Session or iterable of Session
        Runs with the columns that are the model's inputs and outputs.
    fixed : mapping, optional
        Unknowns to hold fixed: values by name.
    bounds : mapping, optional
        Bounds (low, high) by name; None leaves a side open.
    noise : {"auto", "white", "correlated", "hac"}
        What the likelihood and the standard errors allow for. "white": white noise. "correlated":
        an AR(1) process plus white noise on each output, by the prediction errors of its Kalman
        filter; process noise of a first-order state looks the same. "hac": any autocorrelation that
        dies out (Newey–West), in the standard errors only. "auto" starts with the first, and it as
        well as "correlated" moves on to the next where a Ljung–Box test at 0.001 rejects it.
    guess : mapping, optional
        Starting values by name, in place of the model's own.
    log : LogSettings, optional
        How the log shows the model: window, step, mode_delay, stamp_error, robust.
    **settings : float or bool
        Fields of `LogSettings` as keywords; they replace those of `log`.

    Returns
    -------
    FitResult

    Raises
    ------
    IdentificationError
        If the data do not determine an unknown; it is named.
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood, or the simulation returns something other than finite
        outputs.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> robot = tl.fit(tl.identification.ROBOT, session, fixed={"p_h_max": 0.46})
    >>> round(robot.model.p_max, 2)
    0.39
    """
    of_class("model", model, Model)
    log = log_settings(log, settings)
    runs = read_runs(sessions, *dict.fromkeys((*model.inputs, *model.outputs)), log=log)
    # The values themselves drive the model, not their means over a window.
    driving = {"p_h", "p_r"} & set(model.inputs)
    runs = [run.changed({n: undo_window(run[n], run.window) for n in driving}) for run in runs]
    model = logged_model(model, runs[0].sample_time, log)
    return fit_runs(model, runs, noise, model.limits(fixed, bounds), guess, log.robust)


def fit_runs(
    model: Model,
    runs: list[Run],
    noise: str,
    limits: Mapping,
    guess: Mapping[str, float] | None = None,
    robust: bool = True,
) -> FitResult:
    """Identify a model from arrays; refuse data that cannot identify it, before any search."""
    one_of("noise", noise, NOISES)
    if model.check is not None:
        model.check(runs, limits)
    for output in model.outputs:
        values = joined(runs, output)
        if np.ptp(values) == 0.0:
            raise IdentificationError(
                f"{output} never moves (it is {values[0]:g} throughout), so the model cannot be "
                "identified; record a session in which it is measured",
                model.names,
            )
    return result_of(estimate_runs(model, runs, limits, noise, guess, robust))


# --- from an estimate to the tables ---------------------------------------------------------------


def result_of(estimate: Estimate) -> FitResult:
    """Put an estimate and its tables into a FitResult; weak unknowns are marked here."""
    problem = estimate.problem
    model, shared = problem.model, len(problem.model.names)
    table, covariance = estimate_table(estimate)
    weak = weak_names(estimate, table)
    reasons = list(doubts(estimate))
    marks = list(_mark(weak, table, model.hints))
    steps = estimate.optimum.steps
    search = f"Converged in {counted(steps, 'evaluation')}."
    if not estimate.optimum.converged:
        search = f"Stopped after {steps} evaluations without a minimum; do not use the numbers."
    sentences = [search, *marks, *remarks(estimate), *reasons]
    if (weak or reasons) and "p_h" in model.outputs:
        sentences.append("trustlab.sample_posterior says what mode, p_h and p_r do determine.")
    states = {}
    for j, name in enumerate(model.states):
        column = slice(shared + j, None, len(model.states))
        states[name], states[f"{name}_stderr"] = estimate.values[column], estimate.stderr[column]
    labels = pd.Index([run.label for run in problem.runs], name="run")
    return FitResult(
        model=_model(estimate, weak, [*marks, *reasons]),
        parameters=table,
        covariance=covariance,
        initial_states=pd.DataFrame(states, index=labels),
        runs=list(_run_fits(estimate)),
        noise=estimate.noise,
        sigma=dict(zip(model.outputs, estimate.sigma.tolist(), strict=True)),
        cost=0.5 * float(estimate.optimum.equations.squares.sum()),
        success=bool(estimate.optimum.converged and not weak and not reasons),
        message=" ".join(sentences),
        degrees_of_freedom=estimate.degrees_of_freedom,
    )


def estimate_table(estimate: Estimate) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the table of the names, derived rows included, and the covariance of the estimated."""
    model, names = estimate.problem.model, estimate.problem.model.names
    values, stderr = estimate.values[: len(names)], estimate.stderr[: len(names)]
    covariance = estimate.covariance[: len(names), : len(names)]
    status = np.where(estimate.optimum.at_bound, "at bound", "estimated")
    status = np.where(estimate.fixed, "fixed", status)[: len(names)]
    free = status == "estimated"
    rows = list(zip(values.tolist(), stderr.tolist(), status.tolist(), strict=True))
    known = np.nan_to_num(covariance)
    step = estimate.problem.runs[0].step
    derived = dict(model.derived)
    units = dict.fromkeys(names, "") | {"mode_delay": "s"}
    for name in names:
        if model.coordinates.get(name) == "rate":
            units[name] = f"per {step:g} s"
            # human_a has its human_time_constant.
            prefix = name[:-1] if f"_{name}".endswith("_a") else f"{name}_"
            longer = f"{prefix}time_constant"
            derived[longer], units[longer] = partial(_time_constant, name, step), "s"
    for function in derived.values():
        value, slope = _gradient(function, names, values)
        # NaN where nothing that the row depends on was estimated.
        error = float(np.sqrt(slope @ known @ slope)) if slope[free].any() else np.nan
        rows.append((value, error, "derived"))
    index = pd.Index([*names, *derived], name="parameter")
    table = pd.DataFrame(rows, index=index, columns=["value", "stderr", "status"])
    table["unit"] = [units.get(name, "") for name in index]
    labels = index[: len(names)][free].rename(None)
    block = covariance[np.ix_(free, free)]
    return table, pd.DataFrame(block, index=labels, columns=labels)


def _time_constant(name: str, step: float, /, **values: Any) -> Any:
    """Return after how many seconds 1/e of a deviation is left."""
    return -step / np.log(values[name])


def _gradient(function: Callable, names: tuple, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Return a function of estimates by name, and its derivatives by complex steps."""
    at = dict(zip(names, values.tolist(), strict=True))
    # f(x + ih) = f(x) + ih f'(x) + O(h²) involves no difference of like numbers, so h may be as
    # small as one likes, and the derivative is exact to rounding.
    step = 1e-100
    slopes = [
        np.imag(function(**at | {name: value + 1j * step})) / step for name, value in at.items()
    ]
    return float(function(**at)), np.array(slopes)


def weak_names(estimate: Estimate, table: pd.DataFrame) -> list[str]:
    """Return the names at a bound, or with a 95 % interval too wide to be of use."""
    model = estimate.problem.model
    useful = model.useful(table["value"].to_dict())
    rows = table.iloc[: len(model.names)]
    wide = HALF_WIDTH * rows["stderr"] > [useful[name] for name in rows.index]
    return list(rows.index[wide | (rows["status"] == "at bound")])


def _mark(weak: list[str], table: pd.DataFrame, hints: Mapping[str, str]) -> Iterator[str]:
    """Mark weak unknowns in the table and say what would help."""
    for name in weak:
        value, stderr = table["value"][name], table["stderr"][name]
        if table["status"][name] == "at bound":
            yield (
                f"{name} is at its bound, {value:.6g}: the fit is better beyond it, or "
                "these data do not determine it."
            )
        else:
            table.loc[name, "status"] = "weak"
            hint = hints.get(name, "record phases that move the model more")
            yield (
                f"{name} is weakly determined by these data ({value:.4g} ± "
                f"{HALF_WIDTH * stderr:.2g}); {hint}, or fix it."
            )


def _model(estimate: Estimate, weak: list[str], sentences: list[str]) -> Any:
    """Return the model's object, or say with the error what else is wrong with the data."""
    model = estimate.problem.model
    values = dict(zip(model.names, estimate.values.tolist(), strict=False))
    if model.build is None:
        return values
    try:
        return model.build(**values)
    except IdentificationError as error:
        text = " ".join([f"{error}.", *sentences])
        raise IdentificationError(text, tuple(weak) or error.parameters) from error


def _run_fits(estimate: Estimate) -> Iterator[RunFit]:
    """Put every run beside its fitted outputs and prediction errors."""
    problem = estimate.problem
    outputs, model = problem.model.outputs, problem.model
    for i, (run, of_run) in enumerate(zip(problem.runs, problem.by_run(), strict=True)):
        simulated = problem.simulated(run, i, estimate.optimum.x)
        if run.window > 1:
            simulated = [window_means(values, run.window) for values in simulated]
        yield RunFit(
            run.label,
            run.synthetic,
            run.t,
            inputs={name: run[name] for name in model.inputs},
            measured={name: run[name] for name in outputs},
            fitted=dict(zip(outputs, simulated, strict=True)),
            errors={outputs[s.output]: s.white[:, 0].copy() for s in of_run},
        )


# Standard errors from which on a delay counts: a false alarm in a thousand sound fits.
CERTAIN = 3.3

# Least length of a record in correlation times of its noise: below, intervals of simulated fits
# with process noise cover too rarely.
STRETCHES = 200


# --- remarks --------------------------------------------------------------------------------------


def remarks(estimate: Estimate) -> Iterator[str]:
    """Say what a reader should know of the data and of what the intervals allow for."""
    problem = estimate.problem
    yield from _initial_states(estimate)
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
    trials = [run["mode"] for run in problem.runs if "mode" in problem.model.inputs]
    if len(trials) > 1 and all(np.ptp(mode) == 0.0 for mode in trials):
        yield f"Mode never changes within any of the {len(trials)} runs."
    if "p_h" in problem.model.inputs:
        yield (
            "The measured p_h drives the model, and its noise counts as performance: where that is "
            "large, the effect of p_h is underrated."
        )
    yield from _dropouts(problem)
    yield from _noise(estimate)


def _initial_states(estimate: Estimate) -> Iterator[str]:
    """Say which initial loads lie at an end of their range."""
    problem, optimum = estimate.problem, estimate.optimum
    held = problem.loads[optimum.at_bound[problem.loads]]
    ends = Counter(f"{problem.unknowns[j]} = {estimate.values[j]:g}" for j in held)
    for end, number in sorted(ends.items()):
        yield f"{end}, an end of its range, in {number} of {counted(len(problem.runs), 'run')}."


def _dropouts(problem: Problem) -> Iterator[str]:
    """Say how many samples of each output were left out as outliers."""
    for name, of_output in zip(problem.model.outputs, problem.by_output(), strict=True):
        lost = [series for series in of_output if not series.known.all()]
        if lost:
            first = problem.runs[lost[0].run].t[~lost[0].known][0]
            yield (
                f"{sum((~series.known).sum() for series in lost)} samples of {name} jump away "
                f"from the model, the first at {first:g} s (dropouts?); they are left "
                "out, robust=False keeps them."
            )


def _noise(estimate: Estimate) -> Iterator[str]:
    """Say what the standard errors allow for."""
    problem, white = estimate.problem, estimate.simple_p >= NOT_WHITE
    if not white:
        yield f"Residuals are not white (Ljung–Box p = {estimate.simple_p:.2g})."
    for name, noise in zip(problem.model.outputs, problem.noise, strict=True):
        if noise.share > 0.0 and noise.memory > 0.0:
            seconds = -problem.runs[0].sample_time / np.log(noise.memory)
            yield (
                f"The fit allows for {100.0 * noise.share:.3g} % of the noise of {name} being "
                f"correlated over {seconds:.3g} s."
            )
    if estimate.sandwiched:
        yield "Standard errors allow for autocorrelation."
    elif estimate.noise == "white" and not white:
        yield 'These standard errors are too small; use noise="auto".'


# --- doubts ---------------------------------------------------------------------------------------


def doubts(estimate: Estimate) -> Iterator[str]:
    """Give every reason why the intervals of a fit cannot be trusted, and what to do."""
    if estimate.optimum.exact.any():
        return
    yield from _coarse(estimate)
    yield from _delay_warning(estimate)
    yield from _slow(estimate)
    yield from _rivals(estimate)


def _rivals(estimate: Estimate) -> Iterator[str]:
    """Find other values that explain the data as well, beyond what standard errors allow."""
    for rival in estimate.rivals[1:]:
        others = rival.problem.values(rival.x)
        # Where the likelihood is Gaussian, values z standard errors away cost a deviance of z² at
        # least.
        z = np.sqrt(4.0 + 2.0 * (rival.deviance - estimate.rivals[0].deviance))
        far = np.abs(others - estimate.values) > z * estimate.stderr
        listed = [
            f"{name} = {others[j]:.4g} for {estimate.values[j]:.4g}"
            for j, name in enumerate(rival.problem.model.names)
            if far[j]
        ]
        if listed:
            yield (
                f"Other values explain these data nearly as well: {' and '.join(listed)}; record "
                "phases that move the model more."
            )
            return


def _coarse(estimate: Estimate) -> Iterator[str]:
    """Find outputs that are logged in steps which their noise does not blur."""
    for name, sigma in zip(estimate.problem.model.outputs, estimate.sigma, strict=True):
        values = np.concatenate([run[name][:2000] for run in estimate.problem.runs[:4]])
        levels = np.unique(values)
        step = float(np.diff(levels).min(initial=np.inf))
        # Rounding is noise like any other where noise before it has more than half a step as its
        # standard deviation.
        if 1.6 * sigma < step < np.inf and levels.size < 0.5 * values.size:
            steps = (levels - levels[0]) / step
            if np.allclose(steps, np.round(steps), atol=1e-3):
                yield (
                    f"{name} is logged in steps of {step:.2g}, more than its noise ({sigma:.2g}): "
                    "rounding shifts the estimates by more than these standard errors; log more "
                    "digits."
                )


def _delay_warning(estimate: Estimate) -> Iterator[str]:
    """Test whether a mode that acts later or earlier than its stamp explains the residuals."""
    runs = estimate.problem.runs
    delay, stderr, _ = estimate.delay
    # Errors of the stamps' own size are in the intervals already.
    stamp_error = max(run.stamp_error for run in runs)
    if abs(delay) > CERTAIN * np.hypot(stderr, stamp_error):
        early = "early" if delay > 0.0 else "late"
        yield (
            f"The residuals look as if mode were stamped {abs(delay):.2g} s {early} (± "
            f"{2.0 * stderr:.1g} s, samples are {runs[0].sample_time:g} s apart): "
            "estimate it with mode_delay=True."
        )


def _slow(estimate: Estimate) -> Iterator[str]:
    """Find noise so slow that one record does not tell its size."""
    problem = estimate.problem
    samples = sum(run.size for run in problem.runs)
    correlated = [noise for noise in problem.noise if noise.share > 0.01 and noise.memory > 0.0]
    memory = [-1.0 / np.log(noise.memory) for noise in correlated]
    if estimate.sandwiched:
        memory.append(
            max(hac_lags([s.white[:, 0] for s in of_output]) for of_output in problem.by_output())
        )
    if memory and max(memory) * STRETCHES > samples:
        step = problem.runs[0].sample_time
        yield (
            f"Noise is correlated over {max(memory) * step:.3g} s, and there are only "
            f"{samples * step:.4g} s of data: too few for reliable intervals; record more."
        )
