"""Bounds for every trajectory, against brute-force simulation from random starts."""

import dataclasses

import numpy as np
import pytest

import trustlab as tl
from tests.allocation.cases import phases
from trustlab.allocation import invariant_bounds, simulate_allocation, threshold_limits


def leaves(bounds, rng):
    """Names of the bounds that one trajectory from a random start leaves, once they hold."""
    steps = (
        int((bounds.cycles + 8) * (bounds.dwell_manual_high + bounds.dwell_autonomous_high)) + 6000
    )
    robot = bounds.model.robot
    run = simulate_allocation(
        bounds.model,
        bounds.lower,
        bounds.upper,
        min(steps, 60_000),
        rng.random(),
        rng.uniform(robot.p_min, robot.p_max),
        int(rng.integers(2)),
    )
    mode = run["mode"].to_numpy()
    returns = np.flatnonzero(np.diff(mode) > 0) + 1
    if returns.size <= bounds.cycles:
        return None
    start = returns[bounds.cycles - 1]
    found = [
        name
        for name in ("r", "p_r", "tsc")
        if run[name].iloc[start:].min() < getattr(bounds, f"{name}_low")
        or run[name].iloc[start:].max() > getattr(bounds, f"{name}_high")
    ]
    who, lengths = phases(mode[start - 1 :])
    for value, name in ((1.0, "dwell_manual"), (0.0, "dwell_autonomous")):
        own = lengths[who == value]
        if own.size and (
            own.min() < getattr(bounds, f"{name}_low")
            or own.max() > getattr(bounds, f"{name}_high")
        ):
            found.append(name)
    return found


STARTS = 10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "last"), [(0, 300), pytest.param(300, 2_000, marks=pytest.mark.long)]
)
def test_no_trajectory_leaves_them(random_model, first, last):
    """2,000 random feasible sets with ten random starts each; 300 of them in every `make test`."""
    checked = 0
    for child in np.random.SeedSequence(31).spawn(2_000)[first:last]:
        rng = np.random.default_rng(child)
        bounds = invariant_bounds(*random_model(rng), cells=8, cycles=6)
        for _ in range(STARTS if bounds.guaranteed else 0):
            found = leaves(bounds, rng)
            assert not found, (found, bounds)
            checked += found is not None
    assert checked > 0.98 * STARTS * (last - first)


def test_more_cells_tighten_them(random_model):
    for seed in range(60):
        case = random_model(np.random.default_rng(seed))
        coarse, fine = (invariant_bounds(*case, cells=cells) for cells in (8, 64))
        assert coarse.guaranteed
        assert fine.guaranteed
        assert fine.r_high - fine.r_low <= (coarse.r_high - coarse.r_low) * 1.001


def test_the_check_catches_bounds_that_are_too_narrow(random_model):
    # Negative control: the cycle's own range of r, taken as a bound, is left by other trajectories'
    # transients.
    caught = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        bounds = invariant_bounds(*random_model(rng), cells=8, cycles=6)
        width = bounds.r_high - bounds.r_low
        narrow = dataclasses.replace(
            bounds, cycles=1, r_low=bounds.r_low + 0.1 * width, r_high=bounds.r_high - 0.1 * width
        )
        caught += bool(leaves(narrow, rng))
    assert caught > 10


def extreme(rng):
    """
    Models at the ends of what is allowed: r that saturates, β near 0 and 1, hair-thin and wide
    bands, b by hand.
    """
    while True:
        h_min = rng.uniform(0.1, 0.5)
        human = tl.HumanModel(
            rng.choice([rng.uniform(0.3, 0.95), 1 - 10 ** rng.uniform(-3, -1)]),
            rng.choice([rng.uniform(0.01, 0.05), rng.uniform(0.95, 0.99), rng.uniform(0.1, 0.9)]),
            h_min,
            h_min * (1 + 10 ** rng.uniform(-2.5, 0)),
        )
        r_min = rng.uniform(0.01, 0.4)
        r_max = r_min * (1 + 10 ** rng.uniform(-1.5, 1))
        robot = tl.RobotModel(1 - 10 ** rng.uniform(-2.7, -1.5), r_min, r_max, human.p_max)
        if rng.random() < 0.5:
            robot = dataclasses.replace(robot, b=rng.uniform(0.5, 1.5) * robot.b)
        model = tl.TscModel(robot, human)
        limits = threshold_limits(model, 0.0)
        if limits.feasible:
            lower, upper = np.sort(rng.uniform(limits.lower, limits.upper, 2))
            if rng.random() < 0.2:
                upper = lower + 10 ** rng.uniform(-6, -3)
            if lower < upper:
                return model, float(lower), float(upper)


def test_no_trajectory_leaves_them_at_the_ends_of_what_is_allowed():
    checked = 0
    for child in np.random.SeedSequence(77).spawn(800):
        rng = np.random.default_rng(child)
        bounds = invariant_bounds(*extreme(rng), cells=int(rng.choice([1, 16, 128])), cycles=9)
        if bounds.guaranteed:
            found = leaves(bounds, rng)
            assert not found, (found, bounds)
            checked += found is not None
    assert checked > 370


def test_bounds_that_have_not_settled_say_so_and_more_cycles_tighten_them(operators):
    few, many = (invariant_bounds(operators["2"], 0.0, 0.35, cycles=n) for n in (3, 6))
    assert "were still shrinking" in few.reason
    assert many.r_high - many.r_low < few.r_high - few.r_low


def test_bounds_for_printed_people_are_near_the_cycles(operators):
    """Within 0.01 of the TSC that the limit cycle reaches, at the printed thresholds."""
    table = tl.published_table("2.2")
    for who in "12345":
        thresholds = table.loc[["TSC_l", "TSC_u"], who].astype(float)
        bounds = tl.invariant_bounds(operators[who], *thresholds)
        cycle = tl.limit_cycle(operators[who], *thresholds)
        assert cycle.tsc_low - 0.01 < bounds.tsc_low <= cycle.tsc_low
        assert cycle.tsc_high <= bounds.tsc_high < cycle.tsc_high + 0.01
        low, high = bounds.table().loc["dwell time manual"]
        assert bounds.dwell_manual == (low, high)
        assert "shrinking" not in bounds.reason
