"""
The loop that can pause, on the model (2.1)-(2.8). Oracle: `simulate_allocation`, which has a loop
of its own, and the same loop in other portions.
"""

import numba
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import trustlab as tl
from tests.cases import model
from trustlab.models.simulation import END, DivergenceError, Simulation
from trustlab.models.tsc import advance, human_at, threshold_mode, tsc_at

parametrize = pytest.mark.parametrize

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
    c = model().constants()
    state = np.zeros(1, STATE).view(np.recarray)
    state.p_r, state.mode = c.p_r_min, 1.0
    lead_to_pause(state[0], c)
    inputs = np.full(SAMPLES, np.nan, INPUT) if inputs is None else inputs
    log, options["blocks"] = np.zeros(SAMPLES, STATE), ("operator", "robot")
    run = Simulation(kernel, c, state, inputs, log, **options)
    for stop in (*stops, SAMPLES):
        run.advance(stop)
        assert run.done == stop
    return run


class Relay:
    """A rule with hysteresis, for both loops; it notes for how long it is asked each time."""

    def __init__(self):
        self.mode, self.spans = 1.0, []

    def step(self, tsc, p_r=None):
        self.mode = 0.0 if tsc > 0.2 else 1.0 if tsc < 0.1 else self.mode
        return self.mode

    def decide(self, state, inputs):
        self.spans.append(len(inputs))
        inputs["mode"] = self.step(state["tsc"][0])


def watch(state, inputs):
    """Decide nothing: what is built in goes on."""


def test_thresholds_without_decisions_are_simulate_allocation():
    run = simulated()
    expected = tl.simulate_allocation(model(), 0.0, 0.35, steps=SAMPLES)
    for name in STATE.names:
        assert_array_equal(run.log[name], expected[name])
    assert np.count_nonzero(np.diff(run.log["mode"])) > 2


@pytest.mark.parametrize(
    ("stops", "options"),
    [(range(1, SAMPLES), {}), ((1, 13, 14, 14, 999), {"decide": watch, "every": 7})],
)
def test_one_sample_at_a_time_and_paused_runs_have_the_bits_of_many_at_once(stops, options):
    assert_array_equal(simulated(*stops, **options).log, simulated().log)


@pytest.mark.parametrize("every", [1, 10])
def test_a_rule_is_asked_when_it_is_due_and_its_run_repeated_without_it(every):
    rule, again = Relay(), Relay()
    run = simulated(decide=rule.decide, every=every)
    portions = simulated(1, 2, 15, 20, 20, 2001, decide=again.decide, every=every)
    assert rule.spans == again.spans == [every] * (SAMPLES // every)
    assert_array_equal(portions.log, run.log)
    assert_array_equal(simulated(17, inputs=run.inputs).log, run.log)
    expected = tl.simulate_allocation(model(), rule=Relay(), steps=SAMPLES)
    assert np.array_equal(run.log["tsc"], expected["tsc"]) == (every == 1)


@pytest.mark.parametrize("options", [{}, {"decide": watch}, {"decide": watch, "every": 50}])
def test_a_block_that_diverges_is_named_with_its_sample(options):
    inputs = np.full(SAMPLES, np.nan, INPUT)
    inputs["mode"][1233] = 1e12
    with pytest.raises(DivergenceError, match=r"^robot diverged at sample 1234 \(12\.34 s\)$"):
        simulated(inputs=inputs, sample_time=0.01, **options)


@pytest.mark.parametrize("options", [{}, {"decide": watch, "every": 3}])
def test_a_run_that_comes_to_its_end_stays_there(options):
    @numba.njit
    def count_to_seven(first, stop, setup, state, inputs, log):
        for k in range(first, stop):
            log[k] = k
            if k == 7:
                return k + 1, END
        return stop, -1

    run = Simulation(count_to_seven, (), *np.zeros((3, 9)), **options)
    for stop, done, ended in ((5, 5, False), (9, 8, True), (9, 8, True)):
        run.advance(stop)
        assert (run.done, run.ended) == (done, ended)
    assert run.log.tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 0]
