"""How often the printed steady-state bounds are violated, over random parameter sets."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from trustlab.allocation.cycle.invariant_bounds import InvariantBounds, invariant_bounds
from trustlab.allocation.limits import threshold_limits
from trustlab.allocation.steady_state import SteadyStateBounds, steady_state_bounds
from trustlab.models.checks import of_class, whole_number
from trustlab.models.compiled import njit
from trustlab.models.human import HumanModel
from trustlab.models.robot import RobotModel
from trustlab.models.tsc import TscModel, advance, human_at, threshold_mode, tsc_at

SETTLING, RECORDED = 12.0, 5.0
"""How many of the longest time constant pass before extremes are taken, and while they are."""

TOLERANCE = 1e-5
"""By how much a bound must be exceeded to count: more than what is left of the transient (e⁻¹² = 6e-6)."""


class Extremes(NamedTuple):
    """What is seen of a trajectory: extremes of TSC, P_r and r, largest one-step changes, and the number of switches."""

    tsc_low: float
    tsc_high: float
    p_r_low: float
    p_r_high: float
    r_low: float
    r_high: float
    delta_p_r: float
    delta_p_h: float
    switches: int


@njit
def steady_extremes(r, p_r, lower, upper, c, settling, returns, recorded):
    """
    Simulate (2.8) in the manual mode from r and P_r and return the extremes of `recorded` samples.

    They are recorded once `settling` samples, and as many `returns` to manual control, have passed.
    """
    seen = Extremes(np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0, 0)
    mode, before, before_h = 1.0, p_r, human_at(r, c)
    k, returned, left = 0, 0, recorded
    while left > 0:
        p_h = human_at(r, c)
        tsc = tsc_at(p_r, p_h, c)
        was = mode
        mode = threshold_mode(tsc, lower, upper, mode)
        if mode > was:
            returned += 1
        if k >= settling and returned >= returns:
            left -= 1
            seen = Extremes(
                min(seen.tsc_low, tsc),
                max(seen.tsc_high, tsc),
                min(seen.p_r_low, p_r),
                max(seen.p_r_high, p_r),
                min(seen.r_low, r),
                max(seen.r_high, r),
                max(seen.delta_p_r, abs(p_r - before)),
                max(seen.delta_p_h, abs(p_h - before_h)),
                seen.switches + (mode != was),
            )
        before, before_h = p_r, p_h
        r, p_r = advance(r, p_r, p_h, mode, c)
        k += 1
    return seen


def random_set(rng: np.random.Generator) -> tuple[TscModel, float, float]:
    """
    Draw a model and thresholds between its limits at δ_Ph = 0, at least 0.02 apart.

    Time constants are log-uniform, 50 to 2000 samples for utilization and 20 to 630 for robot performance; ranges of
    performance are 2 to 50 % (human) and 10 to 100 % (robot) of their least values.
    """
    of_class("rng", rng, np.random.Generator, "numpy.random.default_rng(0) makes one")
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
    Count, over random parameter sets that meet the conditions of Theorem 1, how often each printed bound is violated.

    Every set is drawn by `random_set`, simulated until transients have decayed, and kept if its thresholds lie within
    (2.9)-(2.10) with the δ_Ph of that motion. Bounds take the δ_TSC of that motion.

    Parameters
    ----------
    sets : int
        How many sets to keep.
    seed : int
        Each set has a child of this seed.
    invariant : int
        For how many of them, the first ones, `invariant_bounds` is tested too, on the same motion from the return to
        manual control on from which these bounds hold.

    Returns
    -------
    pandas.DataFrame
        Index `bound`; columns sets (on how many it was tested), left (how many violate it), share. Synthetic.

    Raises
    ------
    ValueError
        If a count is not a whole number.
    """
    sets = whole_number("sets", sets, most=10**6)
    invariant = whole_number("invariant", invariant, least=0, most=sets)
    root = np.random.SeedSequence(whole_number("seed", seed, least=0))
    left, sure, kept = np.zeros(4, int), np.zeros(2, int), 0
    while kept < sets:
        rng = np.random.default_rng(root.spawn(1)[0])
        model, lower, upper = random_set(rng)
        longest = 1.0 / (1.0 - max(model.human.a, model.robot.a))
        settling, recorded = int(SETTLING * longest), int(RECORDED * longest)
        start = rng.random(), model.robot.p_min, lower, upper, model.constants()
        seen = steady_extremes(*start, settling, 0, recorded)
        if not threshold_limits(model, seen.delta_p_h).contains(lower, upper):
            continue
        delta = model.delta(seen.delta_p_r, seen.delta_p_h)
        printed = steady_state_bounds(model, lower, upper, delta_tsc=delta)
        outside = violated(seen, printed)
        left += outside["r_low"], outside["r_high"], outside["p_r"], outside["tsc"]
        if kept < invariant:
            bounds = invariant_bounds(model, lower, upper, cells=16)
            # Where cycles are long or transients slow, the bounds begin to hold after more than `settling` samples.
            outside = violated(steady_extremes(*start, settling, bounds.cycles, recorded), bounds)
            sure += outside["r_low"] or outside["r_high"], outside["p_r"]
        kept += 1
    tested = {
        "r ≥ r_l (2.33)": (sets, left[0]),
        "r ≤ r_u (2.33)": (sets, left[1]),
        "P_r (2.15)": (sets, left[2]),
        "TSC (2.14)": (sets, left[3]),
        "r, invariant_bounds": (invariant, sure[0]),
        "P_r, invariant_bounds": (invariant, sure[1]),
    }
    table = pd.DataFrame.from_dict(tested, orient="index", columns=["sets", "left"]).rename_axis("bound")
    table["share"] = table["left"] / table["sets"].where(table["sets"] > 0)
    return table


def violated(seen: Extremes, bounds: SteadyStateBounds | InvariantBounds) -> dict[str, bool]:
    """Return which bounds a trajectory violates by more than `TOLERANCE`."""
    return {
        "r_low": seen.r_low < bounds.r_low - TOLERANCE,
        "r_high": seen.r_high > bounds.r_high + TOLERANCE,
        "p_r": seen.p_r_low < bounds.p_r_low - TOLERANCE or seen.p_r_high > bounds.p_r_high + TOLERANCE,
        "tsc": seen.tsc_low < bounds.tsc_low - TOLERANCE or seen.tsc_high > bounds.tsc_high + TOLERANCE,
    }
