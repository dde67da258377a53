"""How often random parameter sets violate the printed bounds or stop switching."""

import numpy as np
import pandas as pd

from trustlab.allocation.cycle.invariant_bounds import InvariantBounds, invariant_bounds
from trustlab.allocation.limits import threshold_limits
from trustlab.allocation.simulation import simulate_allocation
from trustlab.allocation.steady_state import SteadyStateBounds, steady_state_bounds
from trustlab.models.checks import of_class, whole_number
from trustlab.models.tsc import HumanModel, RobotModel, TscModel

# How many of the longest time constant pass before extremes are taken, and while they are.
SETTLING, RECORDED = 12.0, 5.0

# And for how many at most, where it takes so long to switch.
LONGEST = 200.0

# By how much a bound must be exceeded to count: more than what is left of the transient (e⁻¹² =
# 6e-6).
TOLERANCE = 1e-5


# What is tested: the rows of the table.
TESTED = (
    "r ≥ r_l (2.33)",
    "r ≤ r_u (2.33)",
    "P_r (2.15)",
    "TSC (2.14)",
    "switching (Theorem 1)",
    "r, invariant_bounds",
    "P_r, invariant_bounds",
)


def steady_run(
    model: TscModel,
    lower: float,
    upper: float,
    r0: float,
    settling: int,
    recorded: int,
    returns: int = 0,
) -> pd.DataFrame:
    """
    Simulate rule (2.8) from `r0` in the manual mode and return its last samples.

    They are so many `recorded` samples and the one before them.

    They begin once `settling` samples, and as many `returns` to manual control, have passed.
    """
    steps = settling + recorded
    while True:
        run = simulate_allocation(model, lower, upper, steps, r0)
        back = np.flatnonzero(np.diff(run["mode"].to_numpy()) > 0.0) + 1
        if back.size >= returns:
            first = max(settling, back[returns - 1]) if returns else settling
            if first + recorded <= steps:
                return run.iloc[first - 1 : first + recorded]
        steps *= 2


def random_set(rng: np.random.Generator) -> tuple[TscModel, float, float]:
    """
    Draw a model and thresholds between its limits at δ_Ph = 0, at least 0.02 apart.

    Time constants are log-uniform, 50 to 2000 samples for utilization and 20 to 630 for robot
    performance; ranges of performance are 2 to 50 % (human) and 10 to 100 % (robot) of their least
    values.
    """
    of_class("rng", rng, np.random.Generator, "numpy.random.default_rng(0) makes one")
    while True:
        h_min = rng.uniform(0.2, 0.5)
        r_min = rng.uniform(0.1, 0.4)
        h_max = h_min * (1.0 + rng.uniform(0.02, 0.5))
        r_max = r_min * (1.0 + rng.uniform(0.1, 1.0))
        human = HumanModel(
            1.0 - 10.0 ** rng.uniform(-3.3, -1.7), rng.uniform(0.3, 0.95), h_min, h_max
        )
        model = TscModel(
            RobotModel(1.0 - 10.0 ** rng.uniform(-2.8, -1.3), r_min, r_max, h_max), human
        )
        limits = threshold_limits(model, 0.0)
        if limits.feasible:
            lower, upper = np.sort(rng.uniform(limits.lower, limits.upper, 2))
            if upper - lower > 0.02:
                return model, float(lower), float(upper)


def bound_failures(sets: int = 20_000, seed: int = 0, invariant: int = 0) -> pd.DataFrame:
    """
    Count how often each printed bound is violated, over random parameter sets.

    All sets meet the conditions of Theorem 1.

    Every set is drawn by `random_set`, simulated until transients have decayed and then for at
    least a whole cycle, and kept if its thresholds lie within (2.9)-(2.10) with the δ_Ph of that
    motion. Bounds take the δ_TSC of that motion.

    Parameters
    ----------
    sets : int
        How many sets to keep.
    seed : int
        Each set has a child of this seed.
    invariant : int
        For how many of them, the first ones, `invariant_bounds` is tested too, on the same motion
        from the return to manual control on from which these bounds hold.

    Returns
    -------
    pandas.DataFrame
        Index `bound`, where "switching (Theorem 1)" is violated by motions that stay in one mode;
        columns sets (on how many it was tested), left (how many violate it), share. Synthetic.

    Raises
    ------
    ValueError
        If a count is not a whole number.
    """
    sets = whole_number("sets", sets, most=10**6)
    invariant = whole_number("invariant", invariant, least=0, most=sets)
    root = np.random.SeedSequence(whole_number("seed", seed, least=0))
    left = np.zeros(len(TESTED), int)
    counted = 0
    while counted < sets:
        rng = np.random.default_rng(root.spawn(1)[0])
        model, lower, upper = random_set(rng)
        longest = 1.0 / (1.0 - max(model.human.a, model.robot.a))
        settling = int(SETTLING * longest)
        recorded = int(RECORDED * longest)
        start = model, lower, upper, rng.random(), settling
        run = steady_run(*start, recorded)
        # Less than a cycle may hide the largest steps; a motion that stays in one mode has none.
        while np.count_nonzero(np.diff(run["mode"]) > 0.0) < 2 and recorded < LONGEST * longest:
            recorded *= 2
            run = steady_run(*start, recorded)
        delta_p_r, delta_p_h = (
            float(np.abs(np.diff(run[name].to_numpy())).max()) for name in ("p_r", "p_h")
        )
        if not threshold_limits(model, delta_p_h).contains(lower, upper):
            continue
        printed = steady_state_bounds(
            model, lower, upper, delta_tsc=model.delta(delta_p_r, delta_p_h)
        )
        left[:4] += outside(run, printed)
        left[4] += np.ptp(run["mode"].to_numpy()) == 0.0
        if counted < invariant:
            bounds = invariant_bounds(model, lower, upper, cells=16)
            # Where cycles are long or transients slow, the bounds begin to hold after more than
            # `settling` samples.
            below, above, p_r, _ = outside(steady_run(*start, recorded, bounds.cycles), bounds)
            left[5:] += below or above, p_r
        counted += 1
    table = pd.DataFrame(
        {"sets": [sets] * 5 + [invariant] * 2, "left": left}, index=pd.Index(TESTED, name="bound")
    )
    table["share"] = table["left"] / table["sets"].where(table["sets"] > 0)
    return table


def outside(run: pd.DataFrame, bounds: SteadyStateBounds | InvariantBounds) -> list[bool]:
    """
    Return whether a run leaves bounds: r below, r above, P_r, TSC.

    Its first sample does not count, nor does less than `TOLERANCE`.
    """
    left = []
    for name in ("r", "p_r", "tsc"):
        values = run[name].to_numpy()[1:]
        left.append(values.min() < getattr(bounds, f"{name}_low") - TOLERANCE)
        left.append(values.max() > getattr(bounds, f"{name}_high") + TOLERANCE)
    return [*left[:2], left[2] or left[3], left[4] or left[5]]
