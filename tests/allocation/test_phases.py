"""
Phases under rule (2.8), one after another. Oracle: `simulate_allocation`, cut where its mode
changes; limits of TSC from long simulations of one mode.
"""

import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation import simulate_allocation
from trustlab.allocation.cycle import phases

LOWER, UPPER = 0.0, 0.35


@pytest.fixture
def model(operators):
    return operators["2"]


def of_times(human, robot):
    """A model of these time constants [samples]."""
    operator = tl.HumanModel(1.0 - 1.0 / human, 0.6, 0.3, 0.5)
    return tl.TscModel(tl.RobotModel(1.0 - 1.0 / robot, 0.2, 0.4, 0.5), operator)


def start_of_a_cycle(model):
    """A state as a manual phase begins, and a run from there."""
    run = simulate_allocation(model, LOWER, UPPER, 60_000, 0.4, mode=1)
    first = run.index[(run["mode"] == 1) & (run["mode"].shift() == 0)][0]
    r, p_r = run.loc[first, ["r", "p_r"]]
    return r, p_r, simulate_allocation(model, LOWER, UPPER, 200_000, r, p_r, mode=1)


def test_recorded_cycles_are_those_of_a_run(model):
    r, p_r, run = start_of_a_cycle(model)
    rows, seen = phases.record(r, p_r, LOWER, UPPER, model.constants(), 5, 10**6)
    edges = np.flatnonzero(np.diff(run["mode"])) + 1
    starts, switches = np.array([0, *edges[1::2]])[:6], edges[::2][:5]
    np.testing.assert_array_equal(rows["r"], run["r"][starts[:5]])
    np.testing.assert_array_equal(rows["p_r"], run["p_r"][starts[:5]])
    np.testing.assert_array_equal(rows["r_switch"], run["r"][switches])
    np.testing.assert_array_equal(rows["manual"], switches - starts[:5])
    np.testing.assert_array_equal(rows["autonomous"], starts[1:] - switches)
    part = run.iloc[: starts[5]]
    assert (seen.p_r_low, seen.p_r_high) == (part["p_r"].min(), part["p_r"].max())
    assert (seen.tsc_low, seen.tsc_high) == (part["tsc"].min(), part["tsc"].max())
    assert seen.sum_r == pytest.approx(part["r"].sum(), rel=1e-12)
    assert seen.sum_p_r == pytest.approx(part["p_r"].sum(), rel=1e-12)
    assert seen.samples == len(part)


def settled(model, steps, known=(), lower=LOWER, upper=UPPER, most=10**6, near=1e-9):
    r, p_r, run = start_of_a_cycle(model)
    states = np.array(known, float).reshape(-1, 2).T.copy()
    code, *state, samples = phases.settle(
        r, p_r, lower, upper, model.constants(), steps, most, states[0], states[1], near
    )
    return code, tuple(state), samples, run


@pytest.mark.parametrize("steps", [1, 700, 40_000, 150_000])
def test_transients_are_simulated_in_whole_cycles(model, steps):
    code, state, samples, run = settled(model, steps)
    assert code == 0
    assert steps <= samples < steps + 2000
    assert state == tuple(run.loc[samples, ["r", "p_r"]])
    assert run.loc[samples, "mode"] == 1
    assert run.loc[samples - 1, "mode"] == 0


def test_whole_periods_of_a_motion_that_repeats_to_the_bit_are_left_out(model):
    code, state, samples, run = settled(model, 10**13)
    assert code == 0
    assert 10**13 <= samples < 10**13 + 2000
    cycles = run[(run["mode"] == 1) & (run["mode"].shift() == 0)].tail(50)
    assert state in set(zip(cycles["r"], cycles["p_r"], strict=True))


def test_a_known_state_ends_the_search(model):
    _, state, samples, run = settled(model, 20_000)
    assert settled(model, 10**6, [(9.0, 9.0), state], near=1e-15)[:3] == (1, state, samples)
    beside = state[0] + 2e-9, state[1]
    above = state[0], state[1] + 2e-9
    assert settled(model, 100_000, [beside, above])[0] == 0
    code, _, samples, _ = settled(model, 10**6, [run.loc[0, ["r", "p_r"]]])
    assert (code, samples) == (1, 0)


def test_phases_that_never_end_are_told_apart(model):
    code, (r, _), samples, _ = settled(model, 10**6, upper=0.99, most=5000)
    assert (code, samples) == (-1, 5000)
    assert r > 0.9
    code, (r, _), samples, _ = settled(model, 10**6, lower=-0.99, most=5000)
    assert code == -2
    assert samples == 5000  # of cycles before it, none
    assert r < 0.2
    n, *_ = phases.phase(True, 0.5, 0.25, -1.0, 0.9, model.constants(), 7, phases.NOTHING)
    assert n == -1


@pytest.mark.parametrize(
    ("human", "robot", "longest"), [(2.0, 1.5, 200), (10.0, 40.0, 2100), (500.0, 40.0, 25_100)]
)
def test_a_phase_may_take_fifty_time_constants(human, robot, longest):
    assert phases.longest_phase(of_times(human, robot).constants()) in (longest - 1, longest)


def test_time_constants_that_cannot_be_simulated_are_refused():
    assert phases.longest_phase(of_times(1.9e6, 10.0).constants()) > 90_000_000
    with pytest.raises(ValueError, match=r"time constant of 2\.1e\+06 samples is too long"):
        phases.longest_phase(of_times(2.1e6, 10.0).constants())


@pytest.mark.parametrize(
    ("human", "robot", "m"),
    [
        (200_400.0, 4000.0, 20),
        (4000.0, 200_400.0, 20),
        (1e6, 52.0, 2),
        (20_100.0, 4000.0, 2),
        (19_900.0, 4000.0, 1),
        (1e6, 39.0, 1),
    ],
)
def test_slow_models_are_looked_at_every_m_samples(human, robot, m):
    """The same phases, m samples at a time: decay, and where a mode settles."""
    model = of_times(human, robot)
    coarse = phases.resampled(model)
    assert (coarse is model) == (m == 1)
    mode = np.ones(4 * m + 1)
    r, _ = model.human.simulate(mode, 0.2)
    np.testing.assert_allclose(coarse.human.simulate(np.ones(5), 0.2)[0], r[::m], atol=1e-12)
    steady = np.full(mode.size, 0.45)
    p_r = model.robot.simulate(mode, steady, 0.25)[::m]
    np.testing.assert_allclose(coarse.robot.simulate(np.ones(5), steady[:5], 0.25), p_r, atol=1e-12)


def settles(model, mode, r0):
    """Where TSC settles in one mode; 60 time constants on."""
    run = model.simulate(np.full(150_000, mode), r0, model.robot.p_min)
    return run["tsc"].iloc[-1]


def test_from_where_a_mode_stays_for_ever(model):
    rest, load = settles(model, 0.0, 0.0), settles(model, 1.0, 1.0)
    for off in (1e-6, 1e-9):
        assert phases.endless_phase(model, rest + off, load - off).startswith("the mode may stay")
        assert phases.endless_phase(model, rest + off, load + off).startswith("from full load")
        assert phases.endless_phase(model, rest - off, load - off).startswith("from rest")
    middle = rest + 0.3 * (load - rest)
    assert phases.endless_phase(model, middle, rest + 0.5 * (load - rest)) == ""
    text = phases.endless_phase(model, rest - 0.1, middle)
    assert f"TSC settles at {rest:.6g} without falling to TSC_l = {rest - 0.1:.6g}" in text
    text = phases.endless_phase(model, middle, load + 0.1)
    assert f"TSC settles at {load:.6g} without rising to TSC_u = {load + 0.1:.6g}" in text


def test_rounding_widens_the_limits_of_a_slow_robot(model):
    """P_r stalls 1e-12/(1 − a) before its limit, 1e-9 for a = .999."""
    slow = of_times(500.0, 1000.0)
    rest, load = settles(slow, 0.0, 0.0), settles(slow, 1.0, 1.0)
    assert "from rest" in phases.endless_phase(slow, rest + 0.8e-9, 0.1)
    assert "from rest" not in phases.endless_phase(slow, rest + 1.2e-9, 0.1)
    middle = 0.5 * (rest + load)
    assert "from full load" in phases.endless_phase(slow, middle, load - 0.8e-9)
    assert "from full load" not in phases.endless_phase(slow, middle, load - 1.2e-9)
