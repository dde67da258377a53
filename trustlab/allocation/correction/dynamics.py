"""The system (2.44) under given corrections, with the hard switch (2.8), and its cost (2.43)."""

from typing import Any

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, advance, human_at, threshold_mode, tsc_at


def suggestion_now(tsc: float, lower: float, upper: float) -> int:
    """Return what Algorithm 3 suggests: 0 from TSC_u on, 1 up to TSC_l, else −1, nothing."""
    return threshold_mode.py_func(tsc, lower, upper, -1)


@njit
def follow_actions(
    c, target_lower, target_upper, actions_l, actions_u, r, p_r, lower, upper, mode, before
):
    """
    Fill r, p_r, lower, upper (N + 1) and mode (N) from the actions; return the cost (2.43).

    All but the modes have their first entries already.

    `before` is the mode before the first sample.
    """
    cost = 0.0
    for k in range(actions_l.size):
        p_h = human_at(r[k], c)
        before = threshold_mode(tsc_at(p_r[k], p_h, c), lower[k], upper[k], before)
        mode[k] = before
        r[k + 1], p_r[k + 1] = advance(r[k], p_r[k], p_h, before, c)
        lower[k + 1] = lower[k] + actions_l[k]
        upper[k + 1] = upper[k] + actions_u[k]
        cost += (upper[k + 1] - target_upper) ** 2 + (lower[k + 1] - target_lower) ** 2
    return cost


def simulate_correction(
    tsc: TscModel,
    r: float,
    p_r: float,
    lower: float,
    upper: float,
    mode: int,
    actions_l: np.ndarray,
    actions_u: np.ndarray,
    target: tuple[float, float],
) -> dict[str, Any]:
    """
    Simulate (2.44) under given corrections and the hard switch (2.8).

    Parameters
    ----------
    tsc : TscModel
        The model.
    r, p_r : float
        Utilization and robot performance now.
    lower, upper : float
        TSC_l and TSC_u now.
    mode : int
        Mode before now: 1 manual, 0 autonomous.
    actions_l, actions_u : array_like, shape (N,)
        Corrections c_l and c_u.
    target : (float, float)
        TSC_ld and TSC_ud.

    Returns
    -------
    dict
        r, p_r, lower, upper (N + 1,), mode (N,) and cost (2.43).
    """
    actions_l = np.ascontiguousarray(actions_l, dtype=float)
    actions_u = np.ascontiguousarray(actions_u, dtype=float)
    out: dict[str, Any] = {
        name: np.empty(actions_l.size + 1) for name in ("r", "p_r", "lower", "upper")
    }
    for name, start in (("r", r), ("p_r", p_r), ("lower", lower), ("upper", upper)):
        out[name][0] = start
    modes = np.empty(actions_l.size)
    cost = follow_actions(
        tsc.constants(),
        *map(float, target),
        actions_l,
        actions_u,
        *out.values(),
        modes,
        float(mode),
    )
    return out | {"mode": modes, "cost": cost}
