"""
What holds for every trajectory, against brute force: the system written out in NumPy, from
adversarial starts.

Starts are r at 0 and 1, P_r at both ends of its range, and both modes; they share no code with the
package.
"""

import itertools

import numpy as np
import pytest

import trustlab as tl
from tests.allocation.cases import drawn_model, shape, weights
from trustlab.allocation import invariant_bounds, limit_cycle

STARTS = list(itertools.product((0.0, 1.0), (0.0, 1.0), (0.0, 1.0)))
STEPS = 6000


def random_pair(rng):
    """
    A fast model with thresholds inside and outside the limits of TSC, as often one as the other.
    """
    model = drawn_model(rng, (-1.8, -1.0), (-1.6, -0.7))
    robot, human = model.robot, model.human
    a_T, b_T = weights(model)
    rest = a_T * robot.p_min - b_T * human.p_min
    rise = (robot.p_max - robot.p_min) * human.p_min / human.p_max
    load = rest + a_T * rise
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
        r, h = model.robot, model.human
        robot, human = (r.a, r.b, r.p_min, r.p_max), (h.a, h.beta, h.p_min, h.p_max)
        rows.append((*robot, *human, *weights(model), lower, upper))
    # A row for each case, a column for each start.
    table = np.transpose(rows)[..., None]
    a, b, p_low, p_high, a_r, beta, h_low, h_high, a_T, b_T, lower, upper = table
    load, share, mode = np.tile(np.transpose(STARTS)[:, None], (len(cases), 1))
    p_r, last = p_low + share * (p_high - p_low), np.zeros((2, *load.shape))
    ranges = [np.full(load.shape, end) for end in (np.inf, -np.inf, np.inf, -np.inf)]
    for k in range(STEPS):
        p_h = h_low + (h_high - h_low) * shape(load, beta)
        tsc = a_T * p_r - b_T * p_h
        after = np.where(tsc >= upper, 0.0, np.where(tsc <= lower, 1.0, mode))
        for to in (0, 1):
            last[to][(after != mode) & (after == to)] = k
        mode = after
        if k > 2 * STEPS // 3:
            for j, values in enumerate((load, load, p_r, p_r)):
                ranges[j] = (np.maximum if j % 2 else np.minimum)(ranges[j], values)
        p_r = a * p_r + (1 - a) * p_low + mode * b * p_h
        load = np.clip(a_r * load + (1 - a_r) * mode, 0.0, 1.0)
    return last, ranges


@pytest.mark.parametrize(
    ("count", "seed"), [(100, 1), pytest.param(5000, 2, marks=pytest.mark.long)]
)
def test_what_is_guaranteed_holds_from_adversarial_starts(count, seed):
    """Some pairs have a cycle, though from other starts the rule never switches."""
    rng = np.random.default_rng(seed)
    cases = [random_pair(rng) for _ in range(count)]
    last, (r_low, r_high, p_low, p_high) = brute_force(cases)
    keeps = (last > 2 * STEPS // 3).all(axis=(0, 2))
    kept = stopped = often = 0
    for k, case in enumerate(cases):
        bounds = invariant_bounds(*case, cells=4, cycles=30)
        cycle = limit_cycle(*case)
        if bounds.guaranteed:
            assert keeps[k], (case, bounds.reason)
            assert bounds.r_low <= r_low[k].min() + 1e-9
            assert r_high[k].max() - 1e-9 <= bounds.r_high
            assert bounds.p_r_low <= p_low[k].min() + 1e-9
            assert p_high[k].max() - 1e-9 <= bounds.p_r_high
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


def test_at_the_limits_themselves_nothing_is_guaranteed(operators):
    """
    TSC only tends to its limit: with a threshold there, a trajectory may come ever nearer and never
    switch.

    Near full load (2.6) is so steep that r, which rounding keeps from 1 by 1e-13, leaves TSC below
    its limit by 0.0015.
    """
    model = operators["2"]
    a_T, b_T = weights(model)
    robot, human = model.robot, model.human
    rest = a_T * robot.p_min - b_T * human.p_min
    load = a_T * (robot.p_min + robot.b * human.p_min / (1 - robot.a)) - b_T * human.p_min
    for pair, inside in (((rest, 0.2), (rest + 1e-4, 0.2)), ((0.0, load), (0.0, load - 0.01))):
        assert not invariant_bounds(model, *pair).guaranteed
        assert not limit_cycle(model, *pair).always
        assert limit_cycle(model, *inside).always


def test_utilization_that_underflows(operators):
    """
    r falls below 1e-170 in autonomous phases that take hundreds of its time constants: no division
    by zero.
    """
    human = tl.HumanModel(0.5, 0.3, 0.3, 0.4)
    for a in (0.999, 0.9995, 0.9998):
        model = tl.TscModel(tl.RobotModel(a, 0.2, 0.4, 0.4), human)
        rest = model.value(0.2, 0.3)
        run = tl.simulate_allocation(model, rest + 0.05, rest + 0.3, 60_000)
        assert run["r"].min() < 1e-170
        bounds = invariant_bounds(model, rest + 0.05, rest + 0.3)
        assert bounds.guaranteed
        assert bounds.r_low <= run["r"].iloc[30_000:].min()


def test_slow_models_take_seconds_and_say_what_was_left_out():
    robot = tl.RobotModel(0.996, 0.24, 0.39, 0.4602)
    slow = tl.TscModel(robot, tl.HumanModel(1 - 1e-6, 0.74, 0.391, 0.4602))
    assert limit_cycle(slow, 0.02, 0.45).exists
    slower = tl.TscModel(robot, tl.HumanModel(1 - 1e-8, 0.74, 0.391, 0.4602))
    with pytest.raises(ValueError, match=r"time constant of 1e\+08 samples is too long"):
        limit_cycle(slower, 0.02, 0.45)
    both = tl.TscModel(tl.RobotModel(1 - 1e-6, 0.24, 0.39, 0.4602), slow.human)
    bounds = invariant_bounds(both, 0.02, 0.45)
    assert not bounds.guaranteed
    assert "not shown to end within 1562600 samples; cells= below 32 allow" in bounds.reason
    # The remedy that the reason names.
    assert invariant_bounds(both, 0.02, 0.45, cells=8, cycles=1).guaranteed
