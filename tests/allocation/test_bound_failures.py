"""The count of failing bounds against whole simulations of the same sets."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation import (
    bound_failures,
    simulate_allocation,
    steady_state_bounds,
    threshold_limits,
)
from trustlab.allocation.bound_failures import RECORDED, SETTLING, TOLERANCE, random_set, steady_run

counting = sys.modules[random_set.__module__]


def test_invariant_bounds_are_tested_from_the_return_to_manual_control_on_from_which_they_hold():
    """
    Child 670 of seed 7: its bounds hold from the 53rd return on, and 12 time constants have 18.
    Oracle: the whole simulation.
    """
    child = np.random.SeedSequence(7).spawn(671)[670]
    rng = np.random.default_rng(child)
    model, lower, upper = random_set(rng)
    r0, longest = rng.random(), 1.0 / (1.0 - max(model.human.a, model.robot.a))
    settling, recorded = int(SETTLING * longest), int(RECORDED * longest)
    bounds = tl.invariant_bounds(model, lower, upper, cells=16)
    run = simulate_allocation(model, lower, upper, 60_000, r0)
    returns = np.flatnonzero(np.diff(run["mode"]) == 1.0) + 1
    assert (returns < settling).sum() < bounds.cycles
    early = run["r"].iloc[settling : settling + recorded]
    assert early.max() > bounds.r_high + TOLERANCE
    later = run["r"].iloc[returns[bounds.cycles - 1] :]
    assert bounds.r_low <= later.min() < later.max() <= bounds.r_high
    seen = steady_run(model, lower, upper, r0, settling, recorded, bounds.cycles)["r"].iloc[1:]
    np.testing.assert_array_equal(seen, later.iloc[:recorded])


def test_steady_motion_is_recorded_for_a_whole_cycle(monkeypatch):
    """
    Set 4676 of seed 0: a cycle takes 5,380 samples, of which 4,262 in the autonomous mode, and 5
    time constants are 3,125.

    Its steps within one phase admit thresholds that those of the whole cycle do not, so that it
    must not be kept. Oracle: the whole simulation.
    """
    human = tl.HumanModel(
        0.9886492193942705, 0.9466769667906756, 0.3993461003066844, 0.5474276734119928
    )
    model = tl.TscModel(
        tl.RobotModel(0.9984000689235221, 0.1299401205851406, 0.1937125598919029, human.p_max),
        human,
    )
    lower, upper = -0.11398324640198294, -0.07189896585608074
    run = simulate_allocation(model, lower, upper, 60_000, 0.03).iloc[20_000:]
    assert not threshold_limits(model, run["p_h"].diff().abs().max()).contains(lower, upper)
    quiet = run[
        run["mode"].rolling(3000).max() == 0.0
    ]  # each of them ends 3,000 samples in the autonomous mode
    assert threshold_limits(model, abs(quiet["p_h"].diff().iloc[1:500]).max()).contains(
        lower, upper
    )
    sets = iter([(model, lower, upper)])
    monkeypatch.setattr(counting, "random_set", lambda rng: next(sets, None) or random_set(rng))
    kept = []
    monkeypatch.setattr(
        counting,
        "steady_state_bounds",
        lambda tsc, *a, **k: kept.append(tsc) or steady_state_bounds(tsc, *a, **k),
    )
    bound_failures(sets=3)
    assert len(kept) == 3
    assert model not in kept


def test_counts_are_those_of_the_same_sets_one_by_one():
    table = bound_failures(sets=60, seed=3, invariant=20)
    root = np.random.SeedSequence(3)
    kept = 0
    left = np.zeros(5, int)
    while kept < 60:
        rng = np.random.default_rng(root.spawn(1)[0])
        model, lower, upper = random_set(rng)
        longest = 1.0 / (1.0 - max(model.human.a, model.robot.a))
        settling = int(SETTLING * longest)
        run = simulate_allocation(
            model, lower, upper, settling + int(RECORDED * longest), rng.random()
        )
        tail, change = run.iloc[settling:], run.diff().iloc[settling:].abs().max()
        if not threshold_limits(model, change["p_h"]).contains(lower, upper):
            continue
        kept += 1
        bounds = steady_state_bounds(model, lower, upper, model.delta(change["p_r"], change["p_h"]))
        left += [
            tail["r"].min() < bounds.r_low - TOLERANCE,
            tail["r"].max() > bounds.r_high + TOLERANCE,
            not tail["p_r"].between(bounds.p_r_low - TOLERANCE, bounds.p_r_high + TOLERANCE).all(),
            not tail["tsc"].between(bounds.tsc_low - TOLERANCE, bounds.tsc_high + TOLERANCE).all(),
            tail["mode"].min() == tail["mode"].max(),
        ]
    assert table["left"].tolist() == [*left, 0, 0]
    assert table["sets"].tolist() == [60] * 5 + [20] * 2
    assert left[1] > 5
    assert left[2] == left[3] == left[4] == 0


def test_control_a_motion_that_stops_switching_is_counted(monkeypatch):
    """
    With the conditions of Theorem 1 taken away, thresholds that TSC never meets end the switching.
    """
    module = sys.modules["trustlab.allocation.bound_failures"]
    everything = SimpleNamespace(
        contains=lambda lower, upper: True, feasible=True, lower=-0.9, upper=0.9
    )
    bounds = SimpleNamespace(
        **{f"{name}_{end}": 0.0 for name in ("r", "p_r", "tsc") for end in ("low", "high")}
    )
    monkeypatch.setattr(module, "threshold_limits", lambda *_: everything)
    monkeypatch.setattr(module, "random_set", lambda rng: (random_set(rng)[0], -1.5, 1.5))
    monkeypatch.setattr(module, "steady_state_bounds", lambda *_, **__: bounds)
    assert bound_failures(sets=3, seed=1).loc["switching (Theorem 1)", "left"] == 3


@pytest.mark.parametrize("wrong", [0, -1, 2.5, np.nan, None, "9", True, 10**7, []])
def test_counts_that_are_none_are_refused(wrong):
    with pytest.raises(ValueError, match="sets must be a whole number"):
        bound_failures(sets=wrong)
    with pytest.raises(ValueError, match="rng must be of class"):
        random_set(wrong)


def test_seeds_and_invariants_are_checked():
    with pytest.raises(ValueError, match="seed must be a whole number"):
        bound_failures(sets=1, seed=-1)
    with pytest.raises(ValueError, match="invariant must be a whole number, from 0 to 5"):
        bound_failures(sets=5, invariant=6)
