"""Bounds for every trajectory, against brute-force simulation from random starts."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng

import trustlab as tl
from tests.allocation.cases import SECOND, drawn_model, made, phases, random_case
from trustlab.allocation import invariant_bounds, simulate_allocation, threshold_limits


def leaves(bounds, rng):
    """Names of the bounds that one trajectory from a random start leaves, once they hold."""
    longest = bounds.dwell_manual_high + bounds.dwell_autonomous_high
    steps = min(int((bounds.cycles + 8) * longest) + 6000, 60_000)
    robot = bounds.model.robot
    start = rng.random(), rng.uniform(robot.p_min, robot.p_max), int(rng.integers(2))
    run = simulate_allocation(bounds.model, bounds.lower, bounds.upper, steps, *start)
    mode = run["mode"].to_numpy()
    returns = np.flatnonzero(np.diff(mode) > 0) + 1
    if returns.size <= bounds.cycles:
        return None
    begin = returns[bounds.cycles - 1]
    seen = {name: run[name].to_numpy()[begin:] for name in ("r", "p_r", "tsc")}
    who, lengths = phases(mode[begin - 1 :])
    seen |= {"dwell_manual": lengths[who == 1], "dwell_autonomous": lengths[who == 0]}
    ends = {
        name: (getattr(bounds, f"{name}_low"), getattr(bounds, f"{name}_high")) for name in seen
    }
    return [name for name in seen if np.any(seen[name] != seen[name].clip(*ends[name]))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "last"), [(0, 300), pytest.param(300, 2_000, marks=pytest.mark.long)]
)
def test_no_trajectory_leaves_them(first, last):
    """2,000 random feasible sets with ten random starts each; 300 of them in every `make test`."""
    checked = 0
    for child in np.random.SeedSequence(31).spawn(2_000)[first:last]:
        rng = default_rng(child)
        bounds = invariant_bounds(*random_case(rng), cells=8, cycles=6)
        for _ in range(10 if bounds.guaranteed else 0):
            found = leaves(bounds, rng)
            assert not found, (found, bounds)
            checked += found is not None
    assert checked > 0.98 * 10 * (last - first)


def test_more_cells_tighten_them():
    for seed in range(60):
        case = random_case(default_rng(seed))
        coarse, fine = (invariant_bounds(*case, cells=cells) for cells in (8, 64))
        assert coarse.guaranteed
        assert fine.guaranteed
        assert fine.r_high - fine.r_low <= (coarse.r_high - coarse.r_low) * 1.001


def test_the_check_catches_bounds_that_are_too_narrow():
    # Negative control: the cycle's own range of r, taken as a bound, is left by other trajectories'
    # transients.
    caught = 0
    for seed in range(20):
        rng = default_rng(seed)
        bounds = invariant_bounds(*random_case(rng), cells=8, cycles=6)
        width = bounds.r_high - bounds.r_low
        narrow = replace(
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
        rates = ((-1.3, -0.15), (-3.0, -1.0))[rng.integers(2)]
        betas = ((0.01, 0.05), (0.95, 0.99), (0.1, 0.9))[rng.integers(3)]
        spans = 10 ** rng.uniform((-2.5, -1.5), (0.0, 1.0))
        model = drawn_model(rng, rates, (-2.7, -1.5), betas, [(span, span) for span in spans])
        if rng.random() < 0.5:
            robot = replace(model.robot, b=rng.uniform(0.5, 1.5) * model.robot.b)
            model = tl.TscModel(robot, model.human)
        limits = threshold_limits(model, 0.0)
        if limits.feasible:
            lower, upper = np.sort(rng.uniform(limits.lower, limits.upper, 2)).tolist()
            if rng.random() < 0.2:
                upper = lower + 10 ** rng.uniform(-6, -3)
            if lower < upper:
                return model, lower, upper


def test_no_trajectory_leaves_them_at_the_ends_of_what_is_allowed():
    checked = 0
    for child in np.random.SeedSequence(77).spawn(800):
        rng = default_rng(child)
        bounds = invariant_bounds(*extreme(rng), cells=int(rng.choice([1, 16, 128])), cycles=9)
        if bounds.guaranteed:
            found = leaves(bounds, rng)
            assert not found, (found, bounds)
            checked += found is not None
    assert checked > 700


def test_bounds_that_have_not_settled_say_so_and_more_cycles_tighten_them():
    few, many = (invariant_bounds(SECOND, 0.0, 0.35, cycles=n) for n in (3, 6))
    assert "were still shrinking" in few.reason
    assert many.r_high - many.r_low < few.r_high - few.r_low


def test_an_operator_who_does_harm_takes_performance_below_its_least():
    """Where nothing is guaranteed, too: P_h below 0 lowers P_r."""
    model = made((0.98, 0.6, -0.1, 0.5), (0.95, 0.2, 0.4))
    bounds = invariant_bounds(model, 0.4, 0.9)
    assert not bounds.guaranteed
    assert bounds.p_r_low <= simulate_allocation(model, 0.4, 0.9, 400)["p_r"].min() < 0.2
