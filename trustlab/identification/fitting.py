"""Fit a model to sessions: read them, search from starting values, report."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from trustlab.identification.estimate import NOISES, Estimate, estimated
from trustlab.identification.log import (
    LogSettings,
    Run,
    averaged,
    joined,
    log_settings,
    logged_model,
    read_runs,
    undo_window,
    window_means,
)
from trustlab.identification.model import IdentificationError, Model
from trustlab.identification.problem import Optimum, Problem
from trustlab.identification.result import FitResult, result_of
from trustlab.models.checks import of_class, one_of
from trustlab.sessions.session import Session

# Optima up to this far above the best, in deviance, are searched further.
SHALLOW = 30.0

# Other optima within this deviance of the best still count as possible: odds of e⁵ to 1.
RIVAL = 10.0

# Distances from rest or full load, in the coordinate of a load, that are tried where one is near.
NEAR = (0.0, 0.002, 0.008, 0.02, 0.05)

# How optima are searched before the best is known.
ROUGH: dict[str, Any] = {"tolerance": 0.1, "most": 40}


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
        dies out (Newey–West), in the standard errors only. "auto" starts with the first and moves
        on to the next where a Ljung–Box test at 0.001 rejects it.
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
    one_of("noise", noise, NOISES)
    runs = read_runs(sessions, *dict.fromkeys((*model.inputs, *model.outputs)), log=log)
    # What is logged as a mean over a window drives the model as it was.
    driving = {"p_h", "p_r"} & set(model.inputs)
    runs = [run.changed({n: undo_window(run[n], run.window) for n in driving}) for run in runs]
    model = logged_model(model, runs[0].sample_time, log)
    limits = model.limits(fixed, bounds)
    check_data(model, runs, limits)
    return result_of(estimate_runs(model, runs, limits, noise, guess, log.robust))


def check_data(model: Model, runs: list[Run], limits: Mapping) -> None:
    """Refuse data that cannot identify the model, before any search."""
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


def estimate_runs(
    model: Model,
    runs: list[Run],
    limits: Mapping,
    noise: str = "auto",
    guess: Mapping[str, float] | None = None,
    robust: bool = True,
) -> Estimate:
    """Search from every start, and return the best optimum as an estimate."""
    if guess is not None:
        model.check_names(guess, "guess")
    optima = rough_optima(model, runs, limits, guess, robust)
    best = optima[0]
    others = [optimum for optimum in optima[1:] if not optimum.same_as(best)]
    rivals = tuple(o for o in others if o.deviance < best.deviance + RIVAL)
    for optimum in rivals:
        # Raises where one that is nearly as likely does not determine the unknowns.
        optimum.inverse_information()
    optimum = _beside_ends(best.problem.robust_search(best.x, robust))
    return replace(estimated(optimum, noise), rivals=rivals)


def rough_optima(
    model: Model,
    runs: list[Run],
    limits: Mapping,
    guess: Mapping[str, float] | None = None,
    robust: bool = True,
) -> list[Optimum]:
    """Search roughly from every start, and return the optima, the most likely first."""
    optima = []
    for unwindow, view in _views(model, runs):
        for values in model.starts(view, limits) if model.starts else [{}]:
            problem = Problem(model, runs, limits, unwindow)
            x = problem.full_vector(_completed({**values, **(guess or {})}, limits))
            # A model's own start lies near an optimum; another may lie anywhere.
            near = not guess and values.keys() >= set(model.unknowns)
            method = "dogbox" if near else "trf"
            optima.append(problem.robust_search(x, robust, method=method, **ROUGH))
    optima.sort(key=lambda optimum: optimum.deviance)
    if any(run.window > 1 for run in runs):
        bests = [next(o for o in optima if o.problem.unwindow == view) for view in (True, False)]
        chosen = min(bests, key=_deviance_with_noise)
        optima = [o for o in optima if o.problem.unwindow == chosen.problem.unwindow]
        # Means hide where utilization began: another beginning may explain them as well.
        optima += _elsewhere(chosen)
        optima.sort(key=lambda optimum: optimum.deviance)
    return optima


def _deviance_with_noise(optimum: Optimum) -> float:
    """Return the deviance once the noise has a model, which rounded or averaged noise needs."""
    problem = optimum.problem
    white = problem.noise
    problem.equations(optimum.x)
    problem.set_noise(problem.fitted_noise())
    deviance = problem.search(optimum.x, **ROUGH).deviance
    problem.set_noise(white)
    return deviance


def _elsewhere(optimum: Optimum) -> Iterator[Optimum]:
    """Hold loads at other places, search there, and go on from there with them free."""
    problem = optimum.problem
    loads = np.intersect1d(problem.loads, problem.free)
    for share in (0.1, 0.3, 0.5, 0.8) if loads.size else ():
        x = optimum.x.copy()
        x[loads] = problem.low[loads] + share * (problem.high - problem.low)[loads]
        x = problem.descend(x, ~np.isin(problem.free, loads), **ROUGH)[0]
        if problem.equations(x).deviance < optimum.equations.deviance + SHALLOW:
            yield problem.search(x, **ROUGH)


def _beside_ends(optimum: Optimum) -> Optimum:
    """Search again from loads held where the best are near their end: (2.6) bends there."""
    problem, x = optimum.problem, optimum.x
    loads = np.intersect1d(problem.loads, problem.free)
    low, high = problem.low[loads], problem.high[loads]
    ends = np.where(x[loads] - low < high - x[loads], low, high)
    near = np.abs(x[loads] - ends) < NEAR[-1]
    if not near.any():
        return optimum
    inwards = (low + high - 2.0 * ends)[near]
    loads, ends = loads[near], ends[near]
    tried = []
    for share in NEAR:
        start = x.copy()
        start[loads] = ends + share * inwards
        start = problem.descend(start, ~np.isin(problem.free, loads), **ROUGH)[0]
        tried.append((problem.equations(start).deviance, share, start))
    other = problem.search(min(tried)[2])
    return min(optimum, other, key=lambda each: each.deviance)


def _views(model: Model, runs: list[Run]) -> list[tuple[bool, list[Run]]]:
    """
    Return the ways to see windowed runs, as they are for starting values: with noise in the values
    that the window averages, which are undone, or in the means.

    The likelihoods of both decide. In the second view the inputs are averaged as well, which gives
    a linear model's means but for the beginning.
    """
    if not any(run.window > 1 for run in runs):
        return [(False, runs)]
    return [
        (True, [averaged(run, model.outputs, undo_window) for run in runs]),
        (False, [averaged(run, model.inputs, window_means) for run in runs]),
    ]


def _completed(start: dict, limits: Mapping) -> dict:
    """Return a start with the middle of the bounds where it has no value."""
    for name, (low, high) in limits.items():
        if name not in start and not np.isfinite(high - low):
            raise ValueError(
                f"{name} needs a guess, or bounds on both sides: guess={{{name!r}: …}}"
            )
        start.setdefault(name, 0.5 * (low + high))
    return start
