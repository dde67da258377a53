"""The model under rule (2.8), Algorithm 2 or a user's own rule, sample by sample."""

from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.rules import (
    PerformanceRule,
    ThresholdRule,
    decision,
    performance_suggestion,
    prepared_rule,
)
from trustlab.models.checks import between, finite_number, of_class, whole_number
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, advance, human_at, threshold_mode, tsc_at

# Longest simulation: 40 bytes are kept of every sample.
MOST_STEPS = 100_000_000

# How many samples the model is simulated ahead of a rule in Python, which then says where the mode
# changes.
AHEAD = 256


@njit
def simulate_rule(start_r, start_p_r, mode, lower, upper, tolerance, c, r, p_r, p_h, tsc, modes):
    """
    Fill five columns with the model under a rule.

    The mode follows from TSC and P_r of the same sample.

    `lower` and `upper` are the thresholds of (2.8); with a `tolerance` of 0 or more they are P_min
    and P_max of Algorithm 2.
    """
    now_r, now_p_r = start_r, start_p_r
    for k in range(r.size):
        r[k], p_r[k] = now_r, now_p_r
        p_h[k] = human_at(now_r, c)
        tsc[k] = tsc_at(now_p_r, p_h[k], c)
        if tolerance < 0.0:
            mode = threshold_mode(tsc[k], lower, upper, mode)
        else:
            suggested = performance_suggestion(now_p_r, lower, upper, tolerance)
            mode = mode if suggested < 0 else suggested
        modes[k] = mode
        now_r, now_p_r = advance(now_r, now_p_r, p_h[k], mode, c)


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
    rule, mode = prepared_rule(
        ThresholdRule(*check_thresholds(tsc, lower, upper)) if rule is None else rule, mode
    )
    steps = whole_number("steps", steps, most=MOST_STEPS)
    start = (
        between("r0", r0, 0.0, 1.0),
        tsc.robot.p_min if p_r0 is None else finite_number("p_r0", p_r0),
    )
    columns = dict(zip(("r", "p_r", "p_h", "tsc", "mode"), np.empty((5, steps)), strict=True))
    numbers = None
    if type(rule) is ThresholdRule:
        numbers = (rule.lower, rule.upper, -1.0)
    elif type(rule) is PerformanceRule:
        numbers = (rule.p_min, rule.p_max, rule.tolerance)
    if numbers is None:
        _ask_step_by_step(rule, mode, start, tsc.constants(), **columns)
    else:
        simulate_rule(*start, float(mode), *numbers, tsc.constants(), *columns.values())
    return pd.DataFrame(columns, copy=False)


def _ask_step_by_step(rule, now, start, c, r, p_r, p_h, tsc, mode):
    """
    Fill five columns as a rule in Python decides.

    The model is simulated ahead in the present mode, and again after a switch.
    """
    r[0], p_r[0] = start
    # The first sample of a stretch is already decided but for that of the whole run.
    first = decided = 0
    while decided < r.size:
        part = slice(first, first + AHEAD)
        stretch = r[part], p_r[part], p_h[part], tsc[part], mode[part]
        simulate_rule(r[first], p_r[first], float(now), -np.inf, np.inf, -1.0, c, *stretch)
        while decided < min(first + AHEAD, r.size):
            choice = decision(rule, f"step {decided}", float(tsc[decided]), float(p_r[decided]))
            decided += 1
            if choice not in (None, now):
                mode[decided - 1] = now = choice
                break
        first = decided - 1
