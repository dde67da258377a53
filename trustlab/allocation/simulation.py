"""The model under rule (2.8), sample by sample."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trustlab.allocation.limits import check_thresholds
from trustlab.models.checks import between, finite_number, whole_number
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, advance, human_at, threshold_mode, tsc_at

if TYPE_CHECKING:
    import pandas as pd

MOST_STEPS = 100_000_000
"""Longest simulation: 40 bytes are kept of every sample."""


@njit
def simulate_rule(start_r, start_p_r, mode, lower, upper, c, r, p_r, p_h, tsc, modes):
    """Fill five columns with the model under rule (2.8); the mode follows from TSC of the same sample."""
    now_r, now_p_r = start_r, start_p_r
    for k in range(r.size):
        r[k], p_r[k] = now_r, now_p_r
        p_h[k] = human_at(now_r, c)
        tsc[k] = tsc_at(now_p_r, p_h[k], c)
        mode = threshold_mode(tsc[k], lower, upper, mode)
        modes[k] = mode
        now_r, now_p_r = advance(now_r, now_p_r, p_h[k], mode, c)


def simulate_allocation(
    tsc: TscModel, lower: float, upper: float, steps: int, r0: float = 0.0, p_r0: float | None = None, mode: int = 1
) -> pd.DataFrame:
    """
    Simulate (2.1), (2.3), (2.5) and (2.6) under rule (2.8).

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    steps : int
        Number of samples; at most 100 million (4 GB).
    r0 : float
        Utilization at the first sample, in [0, 1].
    p_r0 : float, optional
        Robot performance at the first sample; the robot's P_min when not given.
    mode : int
        Mode before the first sample: 1 manual, 0 autonomous.

    Returns
    -------
    pandas.DataFrame
        Columns r, p_r, p_h, tsc, mode; one row per sample.

    Raises
    ------
    ValueError
        If `tsc` is not a `TscModel`, the thresholds are not finite or in the wrong order, or a start or `steps` is out
        of range.
    """
    import pandas as pd

    lower, upper = check_thresholds(tsc, lower, upper)
    steps = whole_number("steps", steps, most=MOST_STEPS)
    r0 = between("r0", r0, 0.0, 1.0)
    mode = whole_number("mode", mode, least=0, most=1)
    start = tsc.robot.p_min if p_r0 is None else finite_number("p_r0", p_r0)
    columns = dict(zip(("r", "p_r", "p_h", "tsc", "mode"), np.empty((5, steps)), strict=True))
    simulate_rule(r0, start, float(mode), lower, upper, tsc.constants(), *columns.values())
    return pd.DataFrame(columns, copy=False)
