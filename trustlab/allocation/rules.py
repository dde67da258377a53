"""Rules that allocate control, (2.8), Algorithm 2 or a user's own, and the model under them."""

import itertools
from collections.abc import Callable
from copy import deepcopy
from dataclasses import astuple, dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    between,
    finite_number,
    in_order,
    of_class,
    set_in_order,
    shown,
    whole_number,
)
from trustlab.models.compiled import njit
from trustlab.models.simulation import Simulation, asked
from trustlab.models.tsc import (
    TscConstants,
    TscModel,
    advance,
    human_at,
    threshold_mode,
    tsc_at,
)

# How far below P_max, as a share of P_max − P_min, performance still counts as P_max in Algorithm
# 2. As printed it is 0, which a measured performance never meets exactly; 0.05 is half-way to 0.9
# (P_max − P_min), where manual is suggested.
PERFORMANCE_TOLERANCE = 0.05


@njit
def performance_suggestion(p_r, p_min, p_max, tolerance=PERFORMANCE_TOLERANCE):
    """
    Return what Algorithm 2 suggests: 0 near P_max, 1 at low performance, −1 (nothing) between.

    Performance is low up to P_min + 0.9(P_max − P_min).
    """
    if p_r >= p_max - tolerance * (p_max - p_min):
        return 0
    if p_r <= p_min + 0.9 * (p_max - p_min):
        return 1
    return -1


@dataclass(slots=True)
class ThresholdRule:
    """
    Rule (2.8): manual once TSC falls to TSC_l, autonomous once it rises to TSC_u.

    Thresholds and mode may be assigned while the rule runs; each step checks them.

    Parameters
    ----------
    lower, upper : float
        TSC_l and TSC_u, lower < upper.
    mode : int
        The initial mode: 1 manual, 0 autonomous.

    Raises
    ------
    ValueError
        If the thresholds are not finite or in the wrong order, or the mode is not 0 or 1.

    Examples
    --------
    >>> import trustlab as tl
    >>> rule = tl.ThresholdRule(lower=0.02, upper=0.45)
    >>> [rule.step(tsc=value) for value in (0.3, 0.5, 0.3, 0.0)]
    [1, 0, 0, 1]
    """

    lower: float
    upper: float
    mode: int = 1

    def __post_init__(self):
        self.lower, self.upper = in_order("lower", self.lower, "upper", self.upper)
        self.mode = whole_number("mode", self.mode, least=0, most=1)

    def step(self, tsc: float | None = None, p_r: float | None = None) -> int:
        """
        Return the mode for this sample and remember it.

        Parameters
        ----------
        tsc : float
            TSC now; needed.
        p_r : float, optional
            Robot performance. The rule does not use it; it is accepted so that both rules are
            called alike.

        Raises
        ------
        ValueError
            If TSC is not a finite number, or what was assigned is no rule; the mode stays.
        """
        self.__post_init__()  # as they may have been assigned since
        tsc = finite_number("tsc, which rule (2.8) needs,", tsc)
        self.mode = int(threshold_mode(tsc, self.lower, self.upper, self.mode))
        return self.mode


@dataclass(frozen=True)
class PerformanceRule:
    """
    Algorithm 2: autonomous at P_r = P_max, manual where P_r is low, else nothing.

    P_r is low up to P_min + 0.9 (P_max − P_min).

    Parameters
    ----------
    p_min, p_max : float
        Least and greatest robot performance.
    tolerance : float
        How far below P_max, as a share of P_max − P_min, counts as P_max; 0 is as printed, which a
        measured performance never meets exactly.

    Raises
    ------
    ValueError
        If p_min is not below p_max, or the tolerance is outside [0, 0.1].

    Examples
    --------
    >>> import trustlab as tl
    >>> rule = tl.PerformanceRule(p_min=0.24, p_max=0.36)
    >>> [rule.step(p_r=p_r) for p_r in (0.30, 0.35, 0.36)]
    [1, None, 0]
    """

    p_min: float
    p_max: float
    tolerance: float = PERFORMANCE_TOLERANCE

    def __post_init__(self):
        set_in_order(self, "p_min", "p_max")
        # From 0.9 (P_max − P_min) down manual is suggested.
        self.__dict__["tolerance"] = between("tolerance", self.tolerance, 0.0, 0.1)

    def step(self, tsc: float | None = None, p_r: float | None = None) -> int | None:
        """
        Return the mode suggested, 1 or 0, or None for no suggestion.

        Parameters
        ----------
        tsc : float, optional
            TSC. The rule does not use it; it is accepted so that both rules are called alike.
        p_r : float
            Robot performance now; needed.

        Raises
        ------
        ValueError
            If P_r is not a finite number.
        """
        p_r = finite_number("p_r, which Algorithm 2 needs,", p_r)
        mode = int(performance_suggestion(p_r, self.p_min, self.p_max, self.tolerance))
        return None if mode < 0 else mode


def prepared_rule(rule: object, mode: int | None = None) -> tuple[Any, int]:
    """
    Return a rule and the mode before the first sample: the one given, else `rule.mode`, else 1.

    The rule comes back as a copy, so that a run leaves it as it is. A rule that has a mode is set
    to the one given.
    """
    if isinstance(rule, type) or not callable(getattr(rule, "step", None)):
        raise ValueError(
            "rule must have a method step(tsc=…, p_r=…) that returns 1 (manual), 0 (autonomous) or "
            "None (keep the mode), as objects of ThresholdRule and PerformanceRule have; got "
            f"{shown(rule)}"
        )
    rule = asked("rule must be one that copy.deepcopy can copy", deepcopy, rule)
    own = whole_number("rule.mode", getattr(rule, "mode", 1), least=0, most=1)
    mode = own if mode is None else whole_number("mode", mode, least=0, most=1)
    if mode != own and hasattr(rule, "mode"):
        rule.mode = mode
    return rule, mode


def decision(rule: Any, where: str, tsc: float, p_r: float) -> int | None:
    """
    Ask a rule for the mode, 1, 0 or None for the one that is on; `where` is the sample, for errors.
    """
    here = f"at {where}, with TSC = {tsc:.6g} and P_r = {p_r:.6g}"
    mode = asked(f"rule.step failed {here}", rule.step, tsc=tsc, p_r=p_r)
    if mode is None:
        return None
    if isinstance(mode, bool | np.bool_):
        return int(mode)
    name = f"what rule.step returns (1 manual, 0 autonomous, None to keep the mode) {here}"
    return whole_number(name, mode, least=0, most=1)


# --- the model under a rule -----------------------------------------------------------------------

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
