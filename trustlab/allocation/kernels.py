"""The rules that say who should drive, as scalar code for compiled loops: (2.8) and Algorithm 2."""

from __future__ import annotations

import numba

from trustlab.models.tsc import threshold_mode

__all__ = ["PERFORMANCE_TOLERANCE", "performance_suggestion", "threshold_mode"]

PERFORMANCE_TOLERANCE = 0.05
"""How far below P_max, as a share of P_max − P_min, performance counts as P_max in Algorithm 2. As printed it is 0,
which measured performance, a real number, would never meet; 0.05 halves the gap to 0.9, where the manual mode is
suggested."""


@numba.njit(cache=True)
def performance_suggestion(p_r, p_min, p_max, tolerance=PERFORMANCE_TOLERANCE):
    """Return what Algorithm 2 suggests: 0 near P_max, 1 up to P_min + 0.9(P_max − P_min), −1 (nothing) between."""
    if p_r >= p_max - tolerance * (p_max - p_min):
        return 0
    if p_r <= p_min + 0.9 * (p_max - p_min):
        return 1
    return -1
