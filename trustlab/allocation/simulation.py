"""The model under rule (2.8), Algorithm 2 or a user's own rule, sample by sample."""

import itertools
from collections.abc import Callable
from dataclasses import astuple
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.allocation.rules import (
    PerformanceRule,
    ThresholdRule,
    decision,
    performance_suggestion,
    prepared_rule,
)
from trustlab.models.checks import between, finite_number, of_class, whole_number
from trustlab.models.compiled import njit
from trustlab.models.simulation import Simulation
from trustlab.models.tsc import (
    TscConstants,
    TscModel,
    advance,
    human_at,
    threshold_mode,
    tsc_at,
)

# Longest simulation: 40 bytes are kept of every sample.
MOST_STEPS = 100_000_000

STATE = np.dtype([(name, float) for name in ("r", "p_r", "p_h", "tsc", "mode")])


class Rule(NamedTuple):
    """
    The model's constants, and a rule that needs no Python.

    `lower` and `upper` are the thresholds of (2.8); with a `tolerance` of 0 or more they are P_min
    and P_max of Algorithm 2.
    """

    constants: TscConstants
    lower: float
    upper: float
    tolerance: float


@njit
def simulate_model(first, stop, setup, state, inputs, log):
    """
    Simulate (2.1)-(2.8), as a kernel of `Simulation`.

    Inputs are modes; without any the rule decides. Rows of the log are those of STATE.
    """
    c = setup.constants
    r, p_r = state.r, state.p_r
    p_h, tsc = state.p_h, state.tsc
    mode = state.mode
    for k in range(first, stop):
        if inputs.size > 0:
            mode = inputs[k]
        elif setup.tolerance < 0.0:
            mode = threshold_mode(tsc, setup.lower, setup.upper, mode)
        else:
            suggested = performance_suggestion(p_r, setup.lower, setup.upper, setup.tolerance)
            mode = mode if suggested < 0 else suggested
        log[0, k], log[1, k] = r, p_r
        log[2, k], log[3, k] = p_h, tsc
        log[4, k] = mode
        r, p_r = advance(r, p_r, p_h, mode, c)
        p_h = human_at(r, c)
        tsc = tsc_at(p_r, p_h, c)
    state.r, state.p_r = r, p_r
    state.p_h, state.tsc = p_h, tsc
    state.mode = mode
    return stop, -1


def simulate_allocation(
    tsc: TscModel,
    lower: float | None = None,
    upper: float | None = None,
    steps: int | None = None,
    r0: float = 0.0,
    p_r0: float | None = None,
    mode: int | None = None,
    rule: Any = None,
) -> pd.DataFrame:
    """
    Simulate (2.1), (2.3), (2.5) and (2.6) under rule (2.8), or under any other rule.

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float, optional
        Thresholds TSC_l and TSC_u of (2.8); either both or `rule`.
    steps : int
        Number of samples; at most 100 million (4 GB).
    r0 : float
        Utilization at the first sample, in [0, 1].
    p_r0 : float, optional
        Robot performance at the first sample; the robot's P_min when not given.
    mode : int, optional
        Mode before the first sample: 1 manual, 0 autonomous. That of the rule, `rule.mode`, or else
        1 when not given.
    rule : object, optional
        Who drives: an object with a method that is called by keyword at each sample, step(tsc=…,
        p_r=…), and returns 1 (manual), 0 (autonomous) or None (keep the mode). True and False count
        as 1 and 0. `ThresholdRule` and `PerformanceRule` run compiled. A run works on a copy of
        the rule, so that what the rule remembers does not carry over to the next run.

    Returns
    -------
    pandas.DataFrame
        Columns r, p_r, p_h, tsc, mode; one row per sample.

    Raises
    ------
    ValueError
        If `tsc` is not a `TscModel`, the thresholds are not finite or in the wrong order, a start
        or `steps` is out of range, both thresholds and a rule are given or neither, or a rule has
        no step, raises an exception, or returns something else.

    Examples
    --------
    >>> import trustlab as tl
    >>> model = tl.published_models()["2"]
    >>> class Relay:
    ...     def step(self, tsc, p_r):
    ...         return 1 if p_r < 0.26 else 0 if p_r > 0.32 else None
    >>> len(tl.simulate_allocation(model, rule=Relay(), steps=5000))
    5000
    """
    of_class("tsc", tsc, TscModel)
    if (rule is None) == (lower is None and upper is None):
        raise ValueError(
            "give either lower= and upper=, the thresholds of (2.8), or rule=, and not both"
        )
    if rule is None:
        rule = ThresholdRule(lower, upper)
    rule, mode = prepared_rule(rule, mode)
    steps = whole_number("steps", steps, most=MOST_STEPS)
    r0 = between("r0", r0, 0.0, 1.0)
    p_r0 = tsc.robot.p_min if p_r0 is None else finite_number("p_r0", p_r0)
    start = r0, p_r0, mode
    if type(rule) is ThresholdRule:
        return run_model(tsc, steps, start, (rule.lower, rule.upper, -1.0))
    if type(rule) is PerformanceRule:
        return run_model(tsc, steps, start, astuple(rule))
    asked = itertools.count()

    def decide(now: np.void, inputs: np.ndarray) -> None:
        choice = decision(rule, f"step {next(asked)}", float(now["tsc"]), float(now["p_r"]))
        inputs[0] = now["mode"] if choice is None else choice

    return run_model(tsc, steps, start, decide=decide)


def run_model(
    tsc: TscModel,
    steps: int,
    start: tuple[float, float, int],
    rule: tuple[float, float, float] = (np.nan, np.nan, np.nan),
    decide: Callable | None = None,
) -> pd.DataFrame:
    """
    Simulate from r, P_r and a mode, under the numbers of a `Rule` or as `decide` writes the modes.
    """
    c = tsc.constants()
    (state,) = np.empty(1, STATE)
    state["r"], state["p_r"], state["mode"] = start
    state["p_h"] = human_at(state["r"], c)
    state["tsc"] = tsc_at(state["p_r"], state["p_h"], c)
    inputs = np.empty(0 if decide is None else steps)
    log = np.empty((len(STATE.names), steps))
    Simulation(simulate_model, Rule(c, *rule), state, inputs, log, decide).advance(steps)
    return pd.DataFrame(dict(zip(STATE.names, log, strict=True)), copy=False)
