"""
On-line correction and tests in a row: against the model simulated by itself, and against missing or
odd measurements.
"""

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose

import trustlab as tl
from tests.allocation.cases import SECOND, written_out
from tests.cases import refused
from trustlab.allocation import incentive_box
from trustlab.allocation.correction import OPTIMAL
from trustlab.allocation.correction_run import MISSING, NEAREST, OUTSIDE, _deciding
from trustlab.allocation.rules import STATE

START, TARGET = (0.0, 0.35), (0.05, 0.4)
CORRECTOR = tl.ThresholdCorrector(SECOND, TARGET, c_b=1e-4, horizon=50)


def online(**more):
    return tl.OnlineCorrection(CORRECTOR, START, **more)


def corrected(habit="following", **options):
    return tl.run_correction(
        tl.ThresholdCorrector(SECOND, TARGET, horizon=20), START, 2, habit, **options
    )


def test_a_step_of_the_online_form_is_a_step_of_the_corrector():
    state = 0.6, 0.325, *START
    step, plan = online(r=0.6).update(0.325, 0.38, 0), CORRECTOR.step(*state, 0)
    assert (step.c_l, step.c_u, step.cost) == (plan.c_l, plan.c_u, plan.cost)
    assert step.cost != CORRECTOR.step(*state, 1).cost, "which the mode decides"


def test_missing_data_hold_and_the_correction_goes_on():
    loop = online()
    loop.update(0.3, 0.38, 1)
    for p_r, p_h in ((np.float32("nan"), 0.38), (0.3, math.nan), (None, pd.NA)):
        loop.update(p_r, p_h, math.nan)
    loop.update(0.3, 0.38)
    loop.update(0.3, 0.38)
    table = loop.table()
    held = table[1:4]
    assert set(held["message"]) == {MISSING}
    assert table["status"].tolist() == ["planned", *["held"] * 3, "planned", "planned"]
    assert (held["suggestion"] == -1).all()
    assert (held[["c_l", "c_u"]] == 0.0).all(axis=None)
    assert held["cost"].isna().all()
    assert np.sign(np.diff(table["lower"])).tolist() == [1, 0, 0, 0, 1]
    assert_allclose(table["r"], 1.0 - SECOND.human.a ** np.arange(6))


def test_performance_outside_the_range():
    held = online().update(0.4, 0.38)
    assert (held.status, held.message) == ("held", OUTSIDE)
    assert (held.c_l, held.c_u, held.suggestion) == (0.0, 0.0, 0)
    nearest = online(outside="nearest").update(0.4, 0.38)
    assert (nearest.status, nearest.message) == ("planned", NEAREST)
    assert nearest.c_l == CORRECTOR.step(0.0, 0.35, *START).c_l
    assert nearest.tsc == SECOND.value(0.4, 0.38)
    assert nearest.latency > 0.0
    assert online().update(0.35 + 1e-12, 0.38).message == OPTIMAL


def test_what_is_refused_changes_nothing():
    loop = online()
    with refused("mode"):
        loop.update(0.3, 0.38, 2)
    with refused("mode"):
        online(mode=2)
    assert (loop.lower, loop.upper, loop.r, len(loop.table())) == (*START, 0.0, 0)


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.floats(-6, -2), st.sampled_from([1.0, -1.0]))
def test_closed_loop_keeps_range_order_and_incentives(seed, decade, way):
    """Whatever is measured and whoever drives."""
    start, target = (START, TARGET)[:: int(way)]
    c_b, rng = 10.0**decade, np.random.default_rng(seed)
    corrector = tl.ThresholdCorrector(SECOND, target, c_b=c_b, horizon=20)
    loop = tl.OnlineCorrection(corrector, start, r=rng.random())
    p_r = rng.uniform(0.24, 0.35, 150)
    p_r[rng.random(150) < 0.1] = math.nan
    for value in p_r:
        loop.update(float(value), rng.uniform(0.365, 0.407), int(rng.integers(2)))
    table = loop.table()
    pair = table[["lower", "upper"]]
    assert (way * (np.array(target) - pair) >= 0.0).all(axis=None)
    assert (way * pair.diff().iloc[1:] >= -1e-15).all(axis=None)
    assert (table["lower"] < table["upper"]).all()
    free = ~np.isnan(p_r)
    low, high = incentive_box(table["r"][free], p_r[free], c_b, 0.24, 0.35)
    for action in ("c_l", "c_u"):
        assert (table[action][~free] == 0.0).all()
        assert table[action][free].between(low - 1e-15, high + 1e-15).all()


def test_following_is_the_model_under_moving_thresholds():
    """Oracle: (2.44) written out, with the corrections that were applied."""
    run = corrected(duration=300)
    for _, part in run.data.groupby("test"):
        pair = [0.0, 0.0]
        motion = written_out(SECOND, pair, 0.0, 0.24, 1)
        for row in part.itertuples():
            pair[:] = row.lower, row.upper
            r, p_r, *_, mode = next(motion)
            assert (row.r, row.p_r, row.mode) == pytest.approx((r, p_r, mode), abs=1e-12)
    lower = run.data["lower"].to_numpy()
    assert_allclose(np.diff(lower), run.data["c_l"][:-1], atol=1e-17)
    assert set(run.data["status"]) == {"planned"}
    assert (run.data["message"] == OPTIMAL).mean() > 0.5


def test_habits_differ_as_they_should():
    with refused("lag would do nothing with habit='following'"):
        corrected(lag=8.0)
    own = tl.simulate_allocation(SECOND, *START, 9000)
    ignoring, lagging = corrected("ignoring", duration=900), corrected("lagging", lag=8.0)
    assert_allclose(ignoring.data["p_r"][:9000], own["p_r"], atol=1e-12)
    late = lagging.data
    first = late.index[(late["suggestion"] == 0) & (late["mode"] == 1)][0]
    assert late["mode"][first : first + 81].tolist() == [1.0] * 80 + [0.0]
    for run in (ignoring, lagging):
        table = run.table()
        assert table.columns[3] == "remaining"
        assert table["remaining"].is_monotonic_decreasing
        assert (table["held"] == 0).all()


def test_a_suggestion_that_is_withdrawn_is_not_followed():
    """ "lagging": follows those that still stand after a lag."""
    said = [0, 0, 0, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, -1]
    steps = iter(said)
    aid = SimpleNamespace(update=lambda *_: SimpleNamespace(suggestion=next(steps)))
    decide = _deciding(aid, "lagging", START, wait=5)
    now, inputs, modes = np.ones(1, STATE)[0], np.empty(1), []
    for _ in said:
        decide(now, inputs)
        now["mode"] = inputs[0]
        modes.append(inputs[0])
    assert modes == [1.0] * 13 + [0.0]
