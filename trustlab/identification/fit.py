"""
`fit`: a model identified from sessions, and what to say of it.

1. Sessions become `Run`s, and the model what the log shows of it (log.py).
2. The model gives starts, from block means (tsc.py); a rough search goes from each, samples far
   from the model are left out, and a fine search goes on from the best (problem.py).
3. The noise of its residuals is modelled (log.py), and the search goes on.
4. The covariance: of noise, of errors of the mode's stamps, of states at a bound; in coordinates of
   the search, in which the likelihood is most nearly Gaussian.
5. The table, what is weak, remarks on the data, and doubts about the intervals.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.log import (
    NOT_WHITE,
    LogSettings,
    Noise,
    Run,
    averaged,
    delayed,
    hac_lags,
    joined,
    log_settings,
    never_switches,
    read_runs,
    undo_window,
    whiten,
    window_means,
)
from trustlab.identification.model import IdentificationError, Model
from trustlab.identification.problem import (
    Optimum,
    Problem,
    best_optimum,
    distinct,
    ends_of_loads,
    held_at,
    rough_optima,
    search,
)
from trustlab.identification.result import FitResult, RunFit
from trustlab.models.checks import counted, of_class, one_of
from trustlab.sessions.session import Session

NOISES = ("auto", "white", "correlated", "hac")

# Deviance above the least up to which a single value lies in its 95 % interval: 1.96².
LIKELY = 3.84

# Switches of mode per session beyond which errors of their stamps are worked out for a sample.
SWITCHES = 40

# Other optima within this deviance of the best still count as possible: odds of e⁵ to 1.
RIVAL = 10.0

# Standard errors from which on a delay counts: a false alarm in a thousand sound fits.
CERTAIN = 3.3

# Least length of a record in correlation times of its noise: below, intervals of simulated fits
# with process noise cover too rarely.
STRETCHES = 200


@np.errstate(under="ignore")
def fit(
    model: Model,
    sessions: Session | Iterable[Session],
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
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
    log : LogSettings, optional
        How the log shows the model: window, mode_delay, stamp_error, robust.
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
    runs = [run.mapped(averaged(model.inputs), undo_window) for run in runs]
    model = delayed(model) if log.mode_delay else model
    return fit_runs(model, runs, noise, model.limits(fixed, bounds), log.robust)


def fit_runs(
    model: Model, runs: list[Run], noise: str, limits: Mapping, robust: bool = True
) -> FitResult:
    """Identify a model from arrays; refuse data that cannot identify it, before any search."""
    one_of("noise", noise, NOISES)
    if model.check is not None:
        model.check(runs, limits)
    optima = rough_optima(model, runs, limits, robust)
    optimum = best_optimum(optima[0], robust)
    problem = optimum.problem
    simple_p = last_p = optimum.whiteness_p()
    if noise == "correlated" or (noise == "auto" and simple_p < NOT_WHITE):
        # The noise belongs to the residuals, and these to the estimates: three rounds settle both.
        for _ in range(3):
            problem.fit_noise(optimum.x)
            optimum = search(problem, optimum.x)
        last_p = optimum.whiteness_p()
    sandwiched = noise == "hac" or (noise != "white" and last_p < NOT_WHITE)
    inverse = optimum.inverse_information()
    delay = mode_delay(optimum, sandwiched)
    estimate = Estimate(
        optimum,
        distinct(optima, RIVAL),
        covariance_of(optimum, inverse, sandwiched, delay),
        simple_p,
        sandwiched,
        delay,
    )
    return result_of(estimate)


class ModeDelay(NamedTuple):
    """Delay of the mode behind its stamp [s]; `shift`, of the loose unknowns, is per second."""

    value: float
    stderr: float
    shift: np.ndarray


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    The best optimum with covariance and diagnostics.

    `rivals` are the best of the rough optima and others nearly as likely; `covariance` is that of
    the values, NaN in rows of unknowns that are fixed or at a bound. `simple_p` is the p value of
    the whiteness test before the noise was modelled; `sandwiched` says that the covariance allows
    for remaining correlation.
    """

    optimum: Optimum
    rivals: list[Optimum]
    covariance: np.ndarray
    simple_p: float
    sandwiched: bool
    delay: ModeDelay

    @property
    def problem(self) -> Problem:
        """The problem that is solved."""
        return self.optimum.problem

    @property
    def values(self) -> np.ndarray:
        """The values of the full vector."""
        return self.problem.values(self.optimum.x)

    @property
    def stderr(self) -> np.ndarray:
        """Standard errors of the full vector; NaN for what is fixed or held by a bound."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def degrees_of_freedom(self) -> float:
        """Samples less unknowns; for correlated noise, those of the slowest output."""
        problem, loose = self.problem, self.optimum.loose.size
        least = problem.counts.sum() - loose
        for count, noise in zip(problem.counts, problem.noise, strict=True):
            if noise.share > 0.0:
                # An AR(1) process tells its size as n (1 − φ)/(1 + φ) independent values would; the
                # fit uses up some.
                values = count * (1.0 - noise.memory) / (1.0 + noise.memory)
                least = min(least, max(values - loose, 3.0))
        return float(least)

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation √(Σ e²/(n − p)) by output; p is shared out over the outputs."""
        counts = self.problem.counts
        freedom = np.maximum(counts - self.optimum.loose.size / counts.size, 1.0)
        return np.sqrt(self.problem.equations(self.optimum.x).squares / freedom)


# --- the covariance -------------------------------------------------------------------------------


def covariance_of(
    optimum: Optimum, inverse: np.ndarray, sandwiched: bool, delay: ModeDelay
) -> np.ndarray:
    """Return the covariance of the values of the full vector; `inverse` is of the information."""
    problem, x, loose = optimum.problem, optimum.x, optimum.loose
    # For white residuals the covariance is the inverse information ([L] Section 9.4, [S] Section
    # 7.5); else that is the bread of a sandwich. Residuals are too small by (n − p)/n on average:
    # the factor makes the white form s² (JᵀJ)⁻¹ with s² = Σ e²/(n − p), and the robust one HC1 of
    # MacKinnon & White 1985 (Stata's newey).
    samples = problem.counts.sum()
    factor = samples / max(samples - loose.size, 1.0)
    block = factor * (optimum.sandwich(inverse) if sandwiched else inverse)
    block += _of_stamps(optimum, inverse)
    if any(run.stamp_error > 0.0 for run in problem.runs):
        # Stamps that are not exact may share an error, too: of any size that the residuals allow.
        square = delay.value**2 + delay.stderr**2
        block += square * np.outer(delay.shift, delay.shift)
    # d(value)/dx by a complex step, which is exact to rounding.
    slopes = np.imag(problem.values(x + 1e-100j)) / 1e-100
    places = problem.free[loose]
    covariance = np.full((x.size, x.size), np.nan)
    covariance[np.ix_(places, places)] = block * np.outer(slopes[places], slopes[places])
    shift = _shift_of_states(optimum)
    return covariance + np.outer(shift, shift) / LIKELY


def _of_stamps(optimum: Optimum, inverse: np.ndarray) -> np.ndarray:
    """Return the covariance due to independent errors of the mode's stamps."""
    problem, x = optimum.problem, optimum.x
    weights = problem.equations(x).weights
    added = np.zeros(inverse.shape)
    for i, run in enumerate(problem.runs):
        mode = run.columns.get("mode", np.zeros(1))
        switches = np.flatnonzero(np.diff(mode > 0.5)) + 1
        if run.stamp_error == 0.0:
            continue
        # Neighbours add about the same: of thousands of switches some stand for all.
        chosen = switches[:: 1 + switches.size // SWITCHES]
        before = problem.simulated(run, i, x)
        for k in chosen:
            # One switch a sample later, and what the estimates make of it.
            moved = mode.copy()
            moved[k] = mode[k - 1]
            after = problem.simulated(run.changed({"mode": moved}), i, x)
            answer = np.zeros(problem.free.size)
            for j, series in enumerate(problem.series[i]):
                change = ((after[j] - before[j]) * series.known)[:, None] / run.sample_time
                seen = whiten(change, series.known, problem.noise[j])[0][:, 0]
                answer[series.unknowns] += weights[j] * series.slopes.T @ seen
            shift = run.stamp_error * inverse @ answer[optimum.loose]
            added += np.outer(shift, shift) * switches.size / chosen.size
    return added


def mode_delay(optimum: Optimum, sandwiched: bool) -> ModeDelay:
    """Return the delay of the mode that the residuals show, to first order; 0 if they cannot."""
    problem, model = optimum.problem, optimum.problem.model
    none = ModeDelay(0.0, 0.0, np.zeros(optimum.loose.size))
    if "mode" not in model.inputs or "mode_delay" in model.names:
        return none
    # The same problem with the delay as one more unknown, the first, at the same point.
    late = problem.alike(delayed(model), {"mode_delay": (-np.inf, np.inf)})
    there = Optimum(late, np.insert(optimum.x, 0, 0.0), True)
    try:
        inverse = there.inverse_information()
    except IdentificationError:
        return none
    at = late.equations(there.x)
    gradient = at.root.T @ at.residual
    spread = there.sandwich(inverse) if sandwiched else inverse
    value = -inverse[0] @ gradient[there.loose]
    # What of the delay's effect the estimates imitate moves them; the rest tells of it.
    shift = inverse[0, 1:] / inverse[0, 0]
    return ModeDelay(float(value), float(np.sqrt(spread[0, 0])), shift)


def _shift_of_states(optimum: Optimum) -> np.ndarray:
    """
    Return how far the values move if loads leave their end as far as data allow.

    They are moved together, equally far in their coordinates, and the rest is estimated again (the
    profile of the likelihood), up to a deviance `LIKELY` above the least.
    """
    problem, (ends, inwards) = optimum.problem, ends_of_loads(optimum)
    held = optimum.at_bound[problem.loads]
    likely = optimum
    near, far = 1e-4, 1.0
    # Bisect the share of the way to the other end, on a logarithmic scale.
    for _ in range(7 if held.any() and not problem.exact(optimum.x).all() else 0):
        share = np.sqrt(near * far)
        there = held_at(optimum, problem.loads[held], (ends + share * inwards)[held])
        if there.deviance < optimum.deviance + LIKELY:
            near, likely = share, there
        else:
            far = share
    return problem.values(likely.x) - problem.values(optimum.x)


# --- from an estimate to the tables ---------------------------------------------------------------


def result_of(estimate: Estimate) -> FitResult:
    """Put an estimate and its tables into a FitResult; weak unknowns are marked here."""
    problem, optimum = estimate.problem, estimate.optimum
    model = problem.model
    table, covariance = estimate_table(estimate)
    marks = list(_mark(estimate, table))
    doubts = (_coarse, _delay_warning, _slow, _rivals)
    exact = problem.exact(optimum.x).any()
    reasons = [] if exact else [text for doubt in doubts for text in doubt(estimate)]
    settled = (
        "Converged." if optimum.converged else "Stopped without a minimum: do not use the numbers."
    )
    sentences = [settled, *marks, *remarks(estimate), *reasons]
    if (marks or reasons) and "p_h" in model.outputs and not never_switches(problem.runs):
        sentences.append("trustlab.sample_posterior says what mode, p_h and p_r do determine.")
    # A row of values, each with its error, for every run.
    states = np.stack([estimate.values, estimate.stderr], axis=1)[len(model.names) :]
    heads = [head for name in model.states for head in (name, f"{name}_stderr")]
    modelled = any(noise != Noise() for noise in problem.noise)
    return FitResult(
        model=_model(model, table["value"], [*marks, *reasons]),
        parameters=table,
        covariance=covariance,
        initial_states=pd.DataFrame(
            states.reshape(len(problem.runs), len(heads)),
            index=pd.Index([run.label for run in problem.runs], name="run"),
            columns=heads,
        ),
        runs=list(_run_fits(estimate)),
        noise="correlated" if modelled else "hac" if estimate.sandwiched else "white",
        sigma=dict(zip(model.outputs, estimate.sigma.tolist(), strict=True)),
        cost=0.5 * float(problem.equations(optimum.x).squares.sum()),
        success=bool(optimum.converged and not marks and not reasons),
        message=" ".join(sentences),
        degrees_of_freedom=estimate.degrees_of_freedom,
    )


def estimate_table(estimate: Estimate) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the table of the names, derived rows included, and the covariance of the estimated."""
    problem, model, names = estimate.problem, estimate.problem.model, estimate.problem.model.names
    values, count = estimate.values[: len(names)], len(names)
    status = np.where(estimate.optimum.at_bound, "at bound", "estimated")
    status = np.where(problem.low == problem.high, "fixed", status)[:count]
    step = problem.runs[0].sample_time
    derived = dict(model.derived)
    units = {"mode_delay": "s"}
    for name in names:
        if model.coordinates.get(name) == "rate":
            units[name] = f"per {step:g} s"
            # human_a has its human_time_constant.
            prefix = name[:-1] if f"_{name}".endswith("_a") else f"{name}_"
            longer = f"{prefix}time_constant"
            derived[longer], units[longer] = partial(_time_constant, name, step), "s"
    covariance, free = estimate.covariance[:count, :count], status == "estimated"
    rows = list(zip(names, values, estimate.stderr[:count], status, strict=True))
    for name, function in derived.items():
        value, slope = _with_slopes(function, names, values)
        # NaN where nothing that the row depends on was estimated.
        error = np.sqrt(slope @ np.nan_to_num(covariance) @ slope) if slope[free].any() else np.nan
        rows.append((name, value, error, "derived"))
    table = pd.DataFrame(rows, columns=["parameter", "value", "stderr", "status"])
    table["unit"] = [units.get(name, "") for name in table["parameter"]]
    labels = np.array(names)[free]
    covariance = pd.DataFrame(covariance[np.ix_(free, free)], labels, labels)
    return table.set_index("parameter"), covariance


def _time_constant(name: str, step: float, /, **values: Any) -> Any:
    """Return after how many seconds 1/e of a deviation is left."""
    return -step / np.log(values[name])


def _with_slopes(function: Callable, names: tuple, values: np.ndarray) -> tuple:
    """Return a function of estimates by name, and its derivatives by complex steps."""
    # f(x + ih) = f(x) + ih f'(x) + O(h²) involves no difference of like numbers, so h may be as
    # small as one likes, and the derivative is exact to rounding.
    moved = values + 1e-100j * np.eye(values.size)
    at = [dict(zip(names, row, strict=True)) for row in [values, *moved]]
    value, *others = (function(**{n: x[n] for n in x if n != "mode_delay"}) for x in at)
    return float(value), np.imag(others) / 1e-100


def _mark(estimate: Estimate, table: pd.DataFrame) -> Iterator[str]:
    """Mark names with a 95 % interval too wide to be of use, and say what would help."""
    model = estimate.problem.model
    useful = model.useful(table["value"].to_dict())
    t = special.stdtrit(estimate.degrees_of_freedom, 0.975)
    for name, value, stderr, status, _ in table.head(len(model.names)).itertuples():
        half = t * stderr
        if status == "at bound":
            yield (
                f"{name} is at its bound, {value:.6g}: the fit is better beyond it, or "
                "these data do not determine it."
            )
        elif status == "estimated" and not half <= useful[name]:  # NaN: as many unknowns as values
            table.loc[name, "status"] = "weak"
            hint = model.hints.get(name, "record phases that move the model more")
            yield (
                f"{name} is weakly determined by these data ({value:.4g} ± {half:.2g}); {hint}, "
                "or fix it."
            )


def _model(model: Model, values: pd.Series, sentences: list[str]) -> Any:
    """Return the model's object, or say with the error what else is wrong with the data."""
    estimates = {name: values[name] for name in model.names if name != "mode_delay"}
    if model.build is None:
        return estimates
    try:
        return model.build(**estimates)
    except IdentificationError as error:
        text = " ".join([f"{error}.", *sentences])
        raise IdentificationError(text, error.parameters) from error


def _run_fits(estimate: Estimate) -> Iterator[RunFit]:
    """Put every run beside its fitted outputs and prediction errors."""
    problem, x = estimate.problem, estimate.optimum.x
    problem.equations(x)
    for i, (run, of_run) in enumerate(zip(problem.runs, problem.series, strict=True)):
        inputs = {name: run[name] for name in problem.model.inputs}
        shown = RunFit(run.label, run.synthetic, run.t, inputs, {}, {}, {}, {})
        outputs = zip(problem.model.outputs, of_run, problem.simulated(run, i, x), strict=True)
        for name, series, simulated in outputs:
            # Values that the log has as means are shown as it has them.
            window = run.undone if averaged([name]) else 1
            shown.measured[name] = window_means(series.measured, window)
            shown.fitted[name] = window_means(simulated, window)
            shown.errors[name], shown.known[name] = series.errors.copy(), series.known
        yield shown


# --- remarks --------------------------------------------------------------------------------------


def remarks(estimate: Estimate) -> Iterator[str]:
    """Say what a reader should know of the data and of what the intervals allow for."""
    problem, optimum = estimate.problem, estimate.optimum
    held = [j for j in np.flatnonzero(optimum.at_bound) if j >= len(problem.model.names)]
    ends = Counter(f"{problem.unknowns[j]} = {estimate.values[j]:g}" for j in held)
    for end, number in sorted(ends.items()):
        yield f"{end}, an end of its range, in {number} of {counted(len(problem.runs), 'run')}."
    people = {run.participant for run in problem.runs}
    if len(people) > 1:
        yield (
            f"{len(people)} participants share one set of parameters; fit them one by one "
            "unless that is meant."
        )
    samples = {run.window * run.undone for run in problem.runs}
    windows = [(n > 1) * n * problem.runs[0].sample_time for n in sorted(samples)]
    means = " and ".join(averaged(problem.model.outputs))
    if means and any(windows):
        where = "in the values that are averaged" if problem.unwindow else "in the means"
        spans = " and ".join(f"{window:g} s" for window in windows)
        yield (
            f"The fit takes {means} as means over a moving window of {spans}, with noise {where}."
        )
    if never_switches(problem.runs):
        yield "Mode never changes within any run."
    if "p_h" in problem.model.inputs:
        yield (
            "The measured p_h drives the model, and its noise counts as performance: where that is "
            "large, the effect of p_h is underrated."
        )
    for name, of_output in zip(problem.model.outputs, problem.by_output(), strict=True):
        lost = [run.t[~s.known] for run, s in zip(problem.runs, of_output, strict=True)]
        times = np.concatenate(lost)
        if times.size:
            yield (
                f"{times.size} samples of {name} jump away from the model, the first at "
                f"{times[0]:g} s (dropouts?); they are left out, robust=False keeps them."
            )
    yield from _noise(estimate)


def _noise(estimate: Estimate) -> Iterator[str]:
    """Say what the standard errors allow for."""
    problem, white = estimate.problem, estimate.simple_p >= NOT_WHITE
    if not white:
        yield f"Residuals are not white (Ljung–Box p = {estimate.simple_p:.2g})."
    for name, noise in zip(problem.model.outputs, problem.noise, strict=True):
        if noise.memory > 0.0:
            seconds = -problem.runs[0].sample_time / np.log(noise.memory)
            yield (
                f"The fit allows for {100.0 * noise.share:.3g} % of the noise of {name} being "
                f"correlated over {seconds:.3g} s."
            )
    if estimate.sandwiched:
        yield "Standard errors allow for autocorrelation."
    elif not white and all(noise == Noise() for noise in problem.noise):
        yield 'These standard errors are too small; use noise="auto".'


# --- doubts: why intervals cannot be trusted, and what to do -------------------------------------


def _rivals(estimate: Estimate) -> Iterator[str]:
    """Find other values that explain the data as well, beyond what standard errors allow."""
    best, *rivals = estimate.rivals
    for rival in rivals:
        others = rival.problem.values(rival.x)
        # Where the likelihood is Gaussian, values z standard errors away cost a deviance of z² at
        # least.
        z = np.sqrt(4.0 + 2.0 * (rival.deviance - best.deviance))
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
        values = joined(estimate.problem.runs, name)[:8000]
        levels = np.unique(values)
        step = float(np.diff(levels).min(initial=np.inf))
        # Rounding is noise like any other where noise before it has more than half a step as its
        # standard deviation.
        if 1.6 * sigma < step < np.inf and levels.size < 0.5 * values.size:
            yield (
                f"{name} is logged in steps of {step:.2g}, more than its noise ({sigma:.2g}): "
                "rounding shifts the estimates by more than these standard errors; log more digits."
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
    memory = [-1.0 / np.log(n.memory) for n in problem.noise if n.share > 0.01 and n.memory > 0.0]
    if estimate.sandwiched:
        memory += map(hac_lags, problem.whitened(estimate.optimum.x))
    if memory and max(memory) * STRETCHES > samples:
        step = problem.runs[0].sample_time
        yield (
            f"Noise counts as correlated over {max(memory) * step:.3g} s, and there are only "
            f"{samples * step:.4g} s of data: too few for reliable intervals; record more."
        )
