"""
Theorem 1, (2.14), (2.15), Proposition 1 and Lemmas 1-4 as properties, against long simulation and
closed forms.
"""

import numpy as np
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from tests.allocation.cases import phases
from trustlab.allocation import simulate_allocation, steady_state_bounds, threshold_limits

EXAMPLES = settings(
    max_examples=120,
    deadline=None,
    derandomize=True,
    suppress_health_check=[
        HealthCheck.filter_too_much,
        HealthCheck.too_slow,
        HealthCheck.function_scoped_fixture,
    ],
)


def settled(sets, data):
    """
    A model, thresholds within its limits, and a run under them with transients gone and its largest
    steps.
    """
    model, lower, upper = data.draw(sets)
    tail = simulate_allocation(model, lower, upper, 60_000, data.draw(st.floats(0.0, 1.0))).iloc[
        30_000:
    ]
    change = tail.diff().abs().max()
    limits = threshold_limits(model, change["p_h"])
    assume(limits.contains(lower, upper))
    delta = model.delta(change["p_r"], change["p_h"])
    return model, limits, tail, steady_state_bounds(model, lower, upper, delta_tsc=delta)


@EXAMPLES
@given(data=st.data())
def test_theorem_1_the_rule_keeps_switching(sets, data):
    _, _, tail, _ = settled(sets, data)
    for part in np.array_split(tail["mode"].to_numpy(), 2):
        assert set(part) == {0.0, 1.0}


@settings(EXAMPLES, max_examples=40)
@given(data=st.data(), beyond=st.floats(0.001, 2.0), who=st.sampled_from([0.0, 1.0]))
def test_control_thresholds_that_tsc_never_meets_end_the_switching(sets, data, beyond, who):
    """
    TSC lies in [-1, 1]: without the condition of Theorem 1 there is nothing that keeps the rule
    switching.
    """
    model, lower, upper = data.draw(sets)
    lower, upper = (-1.0 - beyond, upper) if who == 0.0 else (lower, 1.0 + beyond)
    assert (
        simulate_allocation(model, lower, upper, 60_000, 0.5).iloc[30_000:]["mode"] == who
    ).all()


@EXAMPLES
@given(data=st.data())
def test_lemmas_1_and_2_tsc_falls_alone_and_rises_under_manual_control(sets, data):
    _, limits, tail, _ = settled(sets, data)
    now, change = tail.iloc[:-1], tail["tsc"].diff().shift(-1).iloc[:-1]
    assert (change[(now["mode"] == 0) & (now["tsc"] > limits.lower)] < 0).all()
    assert (change[(now["mode"] == 1) & (now["tsc"] < limits.upper)] > 0).all()


@EXAMPLES
@given(data=st.data())
def test_bounds_2_14_and_2_15_hold(sets, data):
    _, _, tail, bounds = settled(sets, data)
    assert tail["tsc"].between(bounds.tsc_low - 1e-12, bounds.tsc_high + 1e-12).all()
    assert tail["p_r"].between(bounds.p_r_low - 1e-12, bounds.p_r_high + 1e-12).all()


@EXAMPLES
@given(data=st.data())
def test_lemmas_3_and_4_longest_dwell_times(sets, data):
    """
    No phase is longer than ⌊·⌋ of (2.16) and (2.21), the floor included and without a sample to
    spare.

    A phase of n samples takes P_r from its first sample, within (2.15), over n steps to the first
    sample of the next phase, which is within (2.15) as well: δ_TSC makes room for the step that
    crosses. So n does not exceed the real number that is floored.
    """
    _, _, tail, bounds = settled(sets, data)
    who, lengths = phases(tail["mode"])
    assert lengths[who == 0].max() <= bounds.dwell_autonomous_high
    assert lengths[who == 1].max() <= bounds.dwell_manual_high


def test_control_dwell_times_of_a_narrower_band_are_too_short(random_model):
    """
    The lengths that Lemmas 3 and 4 bound do come near: bounds for a band of half the width are
    exceeded.
    """
    longer = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        model, lower, upper = random_model(rng)
        tail = simulate_allocation(model, lower, upper, 20_000, rng.random()).iloc[10_000:]
        who, lengths = phases(tail["mode"])
        quarter = 0.25 * (upper - lower)
        bounds = steady_state_bounds(model, lower + quarter, upper - quarter, delta_tsc=0.0)
        longer += lengths[who == 0].max(initial=0) > bounds.dwell_autonomous_high
        longer += lengths[who == 1].max(initial=0) > bounds.dwell_manual_high
    assert longer > 5


@settings(EXAMPLES, max_examples=400)
@given(data=st.data(), delta=st.floats(0.0, 0.05))
def test_proposition_1_order_of_the_dwell_times(sets, data, delta):
    model, lower, upper = data.draw(sets)
    bounds = steady_state_bounds(model, lower, upper, delta_tsc=delta)
    assert bounds.dwell_manual_low <= bounds.dwell_manual_high
    assert 0.0 <= bounds.r_low <= bounds.r_high <= 1.0
