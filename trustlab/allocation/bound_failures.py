"""How often the printed steady-state bounds are left, over random parameter sets."""

from __future__ import annotations

import numba
import numpy as np
import pandas as pd

from trustlab.allocation.invariant_bounds import invariant_bounds
from trustlab.allocation.limits import threshold_limits
from trustlab.allocation.phases import human_at, pack
from trustlab.allocation.steady_state import steady_state_bounds
from trustlab.models.checks import whole_number
from trustlab.models.human import HumanModel
from trustlab.models.robot import RobotModel
from trustlab.models.tsc import TscModel

__all__ = ["bound_failures", "random_set", "steady_extremes"]

SETTLING, RECORDED = 12.0, 5.0
"""How many of the longest time constant pass before extremes are taken, and while they are."""

TOLERANCE = 1e-5
"""By how much a bound must be left to count: more than what is left of the transient (e⁻¹² = 6e-6)."""


@numba.njit(cache=True)
def steady_extremes(r, p_r, lower, upper, c, settling, recorded, out):
    """
    Run (2.8) on the model and fill `out` with what is seen after `settling` samples, in the next `recorded`.

    Least and greatest r, P_r and TSC, then the largest one-step changes of P_r and P_h, then the number of switches.
    """
    mode, before, before_h = 1.0, p_r, human_at(r, c)
    out[:] = np.array([np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0, 0.0])
    for k in range(settling + recorded):
        p_h = human_at(r, c)
        tsc = c[7] * p_r - c[8] * p_h
        was = mode
        if tsc >= upper:
            mode = 0.0
        elif tsc <= lower:
            mode = 1.0
        if k >= settling:
            out[0], out[1] = min(out[0], r), max(out[1], r)
            out[2], out[3] = min(out[2], p_r), max(out[3], p_r)
            out[4], out[5] = min(out[4], tsc), max(out[5], tsc)
            out[6], out[7] = max(out[6], abs(p_r - before)), max(out[7], abs(p_h - before_h))
            if mode != was:
                out[8] += 1.0
        before, before_h = p_r, p_h
        p_r = c[4] * p_r + (1.0 - c[4]) * c[6] + mode * c[5] * p_h
        r = c[0] * r + (1.0 - c[0]) * mode


def random_set(rng: np.random.Generator) -> tuple[TscModel, float, float]:
    """
    Draw a model and thresholds between its limits at δ_Ph = 0, at least 0.02 apart.

    Parameters
    ----------
    rng : numpy.random.Generator
        Where to draw from.

    Returns
    -------
    TscModel, float, float
        The model, TSC_l and TSC_u. Time constants are log-uniform, 50 to 2000 samples for utilization and 20 to 630 for
        robot performance; ranges of performance are 2 to 50 % (human) and 10 to 100 % (robot) of their least values.

    Raises
    ------
    ValueError
        If `rng` is not a generator.
    """
    if not isinstance(rng, np.random.Generator):
        raise ValueError(
            f"rng must be a numpy Generator, got {type(rng).__name__}; numpy.random.default_rng(0) makes one"
        )
    while True:
        h_min, r_min = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.4)
        h_max, r_max = h_min * (1.0 + rng.uniform(0.02, 0.5)), r_min * (1.0 + rng.uniform(0.1, 1.0))
        human = HumanModel(1.0 - 10.0 ** rng.uniform(-3.3, -1.7), rng.uniform(0.3, 0.95), h_min, h_max)
        model = TscModel(RobotModel(1.0 - 10.0 ** rng.uniform(-2.8, -1.3), r_min, r_max, h_max), human)
        limits = threshold_limits(model, 0.0)
        if limits.feasible:
            lower, upper = np.sort(rng.uniform(limits.lower, limits.upper, 2))
            if upper - lower > 0.02:
                return model, float(lower), float(upper)


def bound_failures(sets: int = 20_000, seed: int = 0, invariant: int = 0) -> pd.DataFrame:
    """
    Count, over random parameter sets that meet the conditions of Theorem 1, how often each printed bound is left.

    Every set is drawn by `random_set`, followed until transients have died away, and kept if its thresholds lie within
    (2.9)-(2.10) with the δ_Ph of that motion. Bounds take the δ_TSC of that motion.

    Parameters
    ----------
    sets : int
        How many sets to keep.
    seed : int
        Each set has a child of this seed.
    invariant : int
        For how many of them, the first ones, `invariant_bounds` is held against the same motion.

    Returns
    -------
    pandas.DataFrame
        Index `bound`; columns sets (how many it was tried on), left (by how many it was), share. Synthetic.

    Raises
    ------
    ValueError
        If a count is not a whole number.
    """
    sets = whole_number("sets", sets, most=10**6)
    invariant = whole_number("invariant", invariant, least=0, most=sets)
    root = np.random.SeedSequence(whole_number("seed", seed, least=0))
    out, left, sure, kept = np.empty(9), np.zeros(4, int), np.zeros(2, int), 0
    while kept < sets:
        rng = np.random.default_rng(root.spawn(1)[0])
        model, lower, upper = random_set(rng)
        longest = 1.0 / (1.0 - max(model.human.a, model.robot.a))
        times = int(SETTLING * longest), int(RECORDED * longest)
        steady_extremes(rng.random(), model.robot.p_min, lower, upper, pack(model), *times, out)
        if not threshold_limits(model, out[7]).contains(lower, upper):
            continue
        printed = steady_state_bounds(model, lower, upper, delta_tsc=model.delta(out[6], out[7]))
        left += (
            out[0] < printed.r_low - TOLERANCE,
            out[1] > printed.r_high + TOLERANCE,
            out[2] < printed.p_r_low - TOLERANCE or out[3] > printed.p_r_high + TOLERANCE,
            out[4] < printed.tsc_low - TOLERANCE or out[5] > printed.tsc_high + TOLERANCE,
        )
        if kept < invariant:
            bounds = invariant_bounds(model, lower, upper, cells=16)
            sure += (
                out[0] < bounds.r_low - TOLERANCE or out[1] > bounds.r_high + TOLERANCE,
                out[2] < bounds.p_r_low - TOLERANCE or out[3] > bounds.p_r_high + TOLERANCE,
            )
        kept += 1
    names = [
        "r ≥ r_l (2.33)",
        "r ≤ r_u (2.33)",
        "P_r (2.15)",
        "TSC (2.14)",
        "r, invariant_bounds",
        "P_r, invariant_bounds",
    ]
    table = pd.DataFrame(
        {"sets": [sets] * 4 + [invariant] * 2, "left": [*left, *sure]}, pd.Index(names, name="bound")
    )
    table["share"] = table["left"] / table["sets"].where(table["sets"] > 0)
    return table
