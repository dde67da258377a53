"""
What holds for every trajectory, against brute force: the system written out in NumPy, from
adversarial starts.

Starts are r at 0 and 1, P_r at both ends of its range, and both modes; they share no code with the
package.
"""

import itertools
from dataclasses import astuple

import numpy as np
import pytest

import trustlab as tl
from tests.allocation.cases import drawn_model, ends_of_tsc, made
from tests.cases import refused, shape, weights
from trustlab.allocation import invariant_bounds, limit_cycle

STARTS = list(itertools.product((0.0, 1.0), repeat=3))
STEPS = 6000


def random_pair(rng):
    """
    A fast model with thresholds inside and outside the limits of TSC, as often one as the other.
    """
    model = drawn_model(rng, (-1.8, -1.0), (-1.6, -0.7))
    rest, load = ends_of_tsc(model)
    while True:
        lower, upper = rest + rng.normal() * 0.1, load + rng.normal() * 0.1
        if min(abs(lower - rest), abs(upper - load)) > 1e-3 and upper - lower > 0.02:
            return model, lower, upper


def brute_force(cases):
    """
    When each case, from each start, switched to manual and to autonomous last, and its range of r
    and P_r in the last third.
    """
    rows = []
    for model, lower, upper in cases:
        robot, human = astuple(model.robot), astuple(model.human)
        rows.append((*robot, *human, *weights(model), lower, upper))
    # A row for each case, a column for each start.
    table = np.transpose(rows)[..., None]
    a, p_low, p_high, _, b, a_r, beta, h_low, h_high, a_T, b_T, lower, upper = table
    load, share, mode = np.tile(np.transpose(STARTS)[:, None], (len(cases), 1))
    p_r, last = p_low + share * (p_high - p_low), np.zeros((2, *load.shape))
    least, most = np.inf, -np.inf
    for k in range(STEPS):
        p_h = h_low + (h_high - h_low) * shape(load, beta)
        tsc = a_T * p_r - b_T * p_h
        after = np.where(tsc >= upper, 0.0, np.where(tsc <= lower, 1.0, mode))
        for to in (0, 1):
            last[to][(after != mode) & (after == to)] = k
        mode = after
        if k > 2 * STEPS // 3:
            least, most = np.minimum(least, (load, p_r)), np.maximum(most, (load, p_r))
        p_r = a * p_r + (1 - a) * p_low + mode * b * p_h
        load = np.clip(a_r * load + (1 - a_r) * mode, 0.0, 1.0)
    return last, least.min(axis=2), most.max(axis=2)


@pytest.mark.parametrize(
    ("count", "seed"), [(100, 1), pytest.param(5000, 2, marks=pytest.mark.long)]
)
def test_what_is_guaranteed_holds_from_adversarial_starts(count, seed):
    """Some pairs have a cycle, though from other starts the rule never switches."""
    rng = np.random.default_rng(seed)
    cases = [random_pair(rng) for _ in range(count)]
    last, least, most = brute_force(cases)
    keeps = (last > 2 * STEPS // 3).all(axis=(0, 2))
    kept = stopped = often = 0
    for k, case in enumerate(cases):
        bounds = invariant_bounds(*case, cells=4, cycles=30)
        cycle = limit_cycle(*case)
        if bounds.guaranteed:
            assert keeps[k], (case, bounds.reason)
            assert ((bounds.r_low, bounds.p_r_low) <= least[:, k] + 1e-9).all()
            assert (most[:, k] - 1e-9 <= (bounds.r_high, bounds.p_r_high)).all()
            kept += 1
        elif "the mode stays" in bounds.reason:
            assert not keeps[k], (case, bounds.reason)
            stopped += 1
        if "may stay" in bounds.reason:  # rounding decides
            assert not cycle.always
        else:
            assert cycle.always == keeps[k], (case, cycle.reason)
        if cycle.exists and not cycle.always:
            often += 1
            assert "stay" in cycle.reason
    assert min(kept, stopped) > 0.1 * count
    assert often > 0.04 * count


def test_utilization_that_underflows():
    """
    r falls below 1e-170 in autonomous phases that take hundreds of its time constants: no division
    by zero.
    """
    for a in (0.999, 0.9995, 0.9998):
        model = made((0.5, 0.3, 0.3, 0.4), (a, 0.2, 0.4))
        rest = model.value(0.2, 0.3)
        run = tl.simulate_allocation(model, rest + 0.05, rest + 0.3, 60_000)
        assert run["r"].min() < 1e-170
        bounds = invariant_bounds(model, rest + 0.05, rest + 0.3)
        assert bounds.guaranteed
        assert bounds.r_low <= run["r"].iloc[30_000:].min()


def test_slow_models_take_seconds_and_say_what_was_left_out():
    operator, pair = (1 - 1e-6, 0.74, 0.391, 0.4602), (0.02, 0.45)
    assert limit_cycle(made(operator, (0.996, 0.24, 0.39)), *pair).exists
    slower = made((1 - 1e-8, *operator[1:]), (0.996, 0.24, 0.39))
    with refused(r"time constant of 1e\+08 samples is too long"):
        limit_cycle(slower, *pair)
    both = made(operator, (1 - 1e-6, 0.24, 0.39))
    bounds = invariant_bounds(both, *pair)
    assert not bounds.guaranteed
    assert "not shown to end within 1562600 samples; cells= below 32 allow" in bounds.reason
    # The remedy that the reason names.
    assert invariant_bounds(both, *pair, cells=8, cycles=1).guaranteed
