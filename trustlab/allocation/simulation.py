"""The model under rule (2.8), sample by sample."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.phases import human_at, pack
from trustlab.models.checks import finite_number, whole_number
from trustlab.models.tsc import TscModel

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["simulate_allocation"]

MOST_STEPS = 100_000_000
"""Longest simulation: 40 bytes are kept of every sample."""


@numba.njit(cache=True)
def switched(r, p_r, mode, lower, upper, c, out):
    """Fill rows r, p_r, p_h, tsc, mode of `out`: the mode follows from TSC of the same sample (2.8)."""
    for k in range(out.shape[1]):
        p_h = human_at(r, c)
        tsc = c[7] * p_r - c[8] * p_h
        if tsc >= upper:
            mode = 0.0
        elif tsc <= lower:
            mode = 1.0
        out[0, k], out[1, k], out[2, k], out[3, k], out[4, k] = r, p_r, p_h, tsc, mode
        p_r = c[4] * p_r + (1.0 - c[4]) * c[6] + mode * c[5] * p_h
        r = c[0] * r + (1.0 - c[0]) * mode


def simulate_allocation(
    tsc: TscModel,
    lower: float,
    upper: float,
    steps: int,
    r0: float = 0.0,
    p_r0: float | None = None,
    mode: int = 1,
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
    r0 = finite_number("r0", r0)
    if not 0.0 <= r0 <= 1.0:
        raise ValueError(f"r0 must lie in [0, 1], got {r0}")
    mode = whole_number("mode", mode, least=0, most=1)
    start = tsc.robot.p_min if p_r0 is None else finite_number("p_r0", p_r0)
    out = np.empty((5, steps))
    switched(r0, start, float(mode), lower, upper, pack(tsc), out)
    return pd.DataFrame(dict(zip(("r", "p_r", "p_h", "tsc", "mode"), out, strict=True)), copy=False)
