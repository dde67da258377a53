"""
The loop that can pause, on the model (2.1)-(2.8). Oracle: `simulate_allocation`, which has a loop
of its own, and the same loop in other portions.
"""

import numba
import numpy as np
import pytest

import trustlab as tl
from trustlab.models.simulation import END, DivergenceError, Simulation
from trustlab.models.tsc import advance, human_at, threshold_mode, tsc_at

SAMPLES = 4000
STATE = np.dtype([(name, float) for name in ("r", "p_r", "p_h", "tsc", "mode")])
INPUT = np.dtype([("mode", float)])


@numba.njit
def lead_to_pause(s, c):
    """Measure everything; rule (2.8) proposes a mode."""
    s.p_h = human_at(s.r, c)
    s.tsc = tsc_at(s.p_r, s.p_h, c)
    s.mode = threshold_mode(s.tsc, 0.0, 0.35, s.mode)


@numba.njit
def kernel(first, stop, c, state, inputs, log):
    s = state[0]
    for k in range(first, stop):
        if s.p_r > 1e6:
            return k, 1
        if not np.isnan(inputs[k].mode):
            s.mode = inputs[k].mode
        log[k] = s
        s.r, s.p_r = advance(s.r, s.p_r, s.p_h, s.mode, c)
        lead_to_pause(s, c)
    return stop, -1


def simulated(*stops, inputs=None, **options):
    """A simulation that has been advanced to each of `stops` in turn, and to the end."""
    model = tl.published_models()["2"]
    state = np.zeros(1, STATE).view(np.recarray)
    state.p_r, state.mode = model.robot.p_min, 1.0
    lead_to_pause(state[0], model.constants())
    if inputs is None:
        inputs = np.full(SAMPLES, np.nan, INPUT)
    log, options["blocks"] = np.zeros(SAMPLES, STATE), ("operator", "robot")
    run = Simulation(kernel, model.constants(), state, inputs, log, **options)
    for stop in (*stops, SAMPLES):
        run.advance(stop)
        assert run.done == stop
    return run


class Relay:
    """A rule with hysteresis, for both loops; it counts how often it is asked, and for how long."""

    def __init__(self):
        self.asked, self.mode, self.spans = 0, 1.0, set()

    def step(self, tsc, p_r):
        self.asked += 1
        self.mode = 0.0 if tsc > 0.2 else 1.0 if tsc < 0.1 else self.mode
        return self.mode

    def decide(self, state, inputs):
        self.spans.add(len(inputs))
        inputs["mode"] = self.step(state["tsc"][0], None)


def watch(state, inputs):
    """Decide nothing: what is built in goes on."""


def test_thresholds_without_decisions_are_simulate_allocation():
    run = simulated()
    expected = tl.simulate_allocation(tl.published_models()["2"], 0.0, 0.35, steps=SAMPLES)
    for name in STATE.names:
        np.testing.assert_array_equal(run.log[name], expected[name])
    assert np.count_nonzero(np.diff(run.log["mode"])) > 2


@pytest.mark.parametrize(
    ("stops", "options"),
    [(range(1, SAMPLES), {}), ((1, 13, 14, 14, 999), {"decide": watch, "every": 7})],
)
def test_one_sample_at_a_time_and_paused_runs_have_the_bits_of_many_at_once(stops, options):
    np.testing.assert_array_equal(simulated(*stops, **options).log, simulated().log)


@pytest.mark.parametrize("every", [1, 10])
def test_a_rule_is_asked_when_it_is_due_and_its_run_repeated_without_it(every):
    rule, again, allocation = Relay(), Relay(), Relay()
    run = simulated(decide=rule.decide, every=every)
    portions = simulated(1, 2, 15, 20, 20, 2001, decide=again.decide, every=every)
    assert rule.asked == again.asked == SAMPLES // every
    assert rule.spans == again.spans == {every}
    np.testing.assert_array_equal(portions.log, run.log)
    np.testing.assert_array_equal(simulated(17, inputs=run.inputs).log, run.log)
    expected = tl.simulate_allocation(tl.published_models()["2"], rule=allocation, steps=SAMPLES)
    assert np.array_equal(run.log["tsc"], expected["tsc"]) == (every == 1)


@pytest.mark.parametrize("options", [{}, {"decide": watch}, {"decide": watch, "every": 50}])
def test_a_block_that_diverges_is_named_with_its_sample(options):
    inputs = np.full(SAMPLES, np.nan, INPUT)
    inputs["mode"][1233] = 1e12
    with pytest.raises(DivergenceError, match=r"^robot diverged at sample 1234 \(12\.34 s\)$"):
        simulated(inputs=inputs, sample_time=0.01, **options)


def test_a_run_that_comes_to_its_end_stays_there():
    @numba.njit
    def count_to_seven(first, stop, setup, state, inputs, log):
        for k in range(first, stop):
            log[k] = k
            if k == 7:
                return k + 1, END
        return stop, -1

    for options in ({}, {"decide": watch, "every": 3}):
        arrays = np.zeros(0), np.zeros(9), np.zeros(9)
        run = Simulation(count_to_seven, (), *arrays, **options)
        run.advance(5)
        assert (run.done, run.ended) == (5, False)
        for _ in range(2):
            run.advance(9)
            assert (run.done, run.ended) == (8, True)
        assert run.log.tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 0]
