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

import trustlab as tl
from tests.allocation.cases import SECOND, written_out
from trustlab.allocation import incentive_box
from trustlab.allocation.correction import OPTIMAL
from trustlab.allocation.correction_run import MISSING, NEAREST, OUTSIDE, _deciding
from trustlab.allocation.simulation import STATE

START, TARGET = (0.0, 0.35), (0.05, 0.4)


def corrected(tests=1, habit="following", **options):
    horizon = options.pop("horizon", 200)
    corrector = tl.ThresholdCorrector(SECOND, TARGET, horizon=horizon)
    return tl.run_correction(corrector, START, tests, habit, **options)


@pytest.fixture(scope="module")
def corrector():
    return tl.ThresholdCorrector(SECOND, TARGET, c_b=1e-4, horizon=50)


def online(corrector, **more):
    return tl.OnlineCorrection(corrector, START, **more)


def test_a_step_of_the_online_form_is_a_step_of_the_corrector(corrector):
    loop = online(corrector, r=0.6)
    plan = corrector.step(0.6, 0.3, *START, 1)
    step = loop.update(p_r=0.3, p_h=0.38, mode=1)
    for name in ("c_l", "c_u", "cost", "status"):
        assert getattr(step, name) == getattr(plan, name)
    assert step.tsc == pytest.approx(SECOND.value(0.3, 0.38))
    assert (loop.lower, loop.upper) == (START[0] + plan.c_l, START[1] + plan.c_u)
    assert loop.r == pytest.approx(SECOND.human.a * 0.6 + 1 - SECOND.human.a)
    assert step.latency > 0.0


def test_missing_data_hold_and_the_correction_goes_on(corrector):
    loop, steps = online(corrector), []
    for k in range(60):
        missing = 20 <= k < 40
        values = (
            ((np.float32("nan"), 0.38), (0.3, math.nan), (None, pd.NA))[k % 3]
            if missing
            else (0.3, 0.38)
        )
        steps.append(loop.update(*values, mode=math.nan if missing and k % 2 else 1))
    held = steps[20:40]
    assert {(step.status, step.message) for step in held} == {("held", MISSING)}
    assert all(step.suggestion == -1 and step.c_l == step.c_u == 0.0 for step in held)
    assert {(step.lower, step.upper) for step in held} == {(steps[20].lower, steps[20].upper)}
    assert steps[40].status == "planned"
    assert steps[41].lower > steps[40].lower == steps[20].lower
    assert np.isfinite([step.r for step in steps]).all()
    table = loop.table()
    assert len(table) == 60
    assert table["cost"].isna().sum() == (table["status"] == "held").sum() == 20


def test_performance_outside_the_range(corrector):
    held = online(corrector).update(0.4, 0.38)
    assert (held.status, held.message) == ("held", OUTSIDE)
    assert (held.c_l, held.c_u, held.suggestion) == (0.0, 0.0, 0)
    nearest = online(corrector, outside="nearest").update(0.4, 0.38)
    assert (nearest.status, nearest.message) == ("planned", NEAREST)
    assert nearest.c_l == corrector.step(0.0, 0.35, *START, 1).c_l
    assert online(corrector).update(0.35 + 1e-12, 0.38).message == OPTIMAL


def test_what_is_refused_changes_nothing(corrector):
    loop = online(corrector)
    with pytest.raises(ValueError, match="mode"):
        loop.update(0.3, 0.38, 2)
    assert (loop.lower, loop.upper, loop.r, len(loop.table())) == (*START, 0.0, 0)


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.floats(-6, -2), st.booleans())
def test_closed_loop_keeps_range_order_and_incentives(seed, decade, back):
    """Whatever is measured and whoever drives."""
    start, target = (TARGET, START) if back else (START, TARGET)
    c_b, rng = 10.0**decade, np.random.default_rng(seed)
    loop = tl.OnlineCorrection(
        tl.ThresholdCorrector(SECOND, target, c_b=c_b, horizon=20), start, r=rng.random()
    )
    p_r = rng.uniform(0.24, 0.35, 150)
    p_r[rng.random(150) < 0.1] = math.nan
    for value in p_r:
        loop.update(float(value), rng.uniform(0.365, 0.407), int(rng.integers(2)))
    table = loop.table()
    for side, begin, end in zip(("lower", "upper"), start, target, strict=True):
        assert table[side].between(min(begin, end), max(begin, end)).all()
        assert (table[side].diff().iloc[1:] * np.sign(end - begin) >= -1e-15).all()
    assert (table["lower"] < table["upper"]).all()
    free = ~np.isnan(p_r)
    low, high = incentive_box(table["r"][free], p_r[free], c_b, 0.24, 0.35)
    for action in ("c_l", "c_u"):
        assert (table[action][~free] == 0.0).all()
        assert table[action][free].between(low - 1e-15, high + 1e-15).all()


def test_following_is_the_model_under_moving_thresholds():
    """Oracle: (2.44) written out, with the corrections that were applied."""
    run = corrected(tests=2, duration=300)
    for _, part in run.data.groupby("test"):
        pair = [0.0, 0.0]
        motion = written_out(SECOND, pair, 0.0, 0.24, 1)
        for row in part.itertuples():
            pair[:] = row.lower, row.upper
            r, p_r, _, mode = next(motion)
            assert (row.r, row.p_r, row.mode) == pytest.approx((r, p_r, mode), abs=1e-12)
    lower = run.data["lower"].to_numpy()
    np.testing.assert_allclose(np.diff(lower), run.data["c_l"][:-1], atol=1e-17)
    assert set(run.data["status"]) == {"planned"}
    assert (run.data["message"] == OPTIMAL).mean() > 0.5


def test_habits_differ_as_they_should():
    runs = {
        habit: corrected(tests=2, habit=habit, horizon=20, duration=900, **lag)
        for habit, lag in (("following", {}), ("lagging", {"lag": 8.0}), ("ignoring", {}))
    }
    with pytest.raises(ValueError, match="lag would do nothing with habit='following'"):
        corrected(lag=8.0)
    own = tl.simulate_allocation(SECOND, *START, 9000)
    np.testing.assert_allclose(runs["ignoring"].data["p_r"][:9000], own["p_r"], atol=1e-12)
    late = runs["lagging"].data
    first = late.index[(late["suggestion"] == 0) & (late["mode"] == 1)][0]
    assert late["mode"].to_numpy()[first : first + 80].tolist() == [1.0] * 80
    assert late["mode"].to_numpy()[first + 80] == 0.0
    for run in runs.values():
        table = run.table()
        assert table["remaining"].is_monotonic_decreasing
        assert (table["held"] == 0).all()
        assert "simulated" in run._repr_html_()


def test_a_suggestion_that_is_withdrawn_is_not_followed():
    """ "lagging": follows those that still stand after a lag."""
    said = [0, 0, 0, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, -1]
    steps = iter(said)
    aid = SimpleNamespace(update=lambda *_: SimpleNamespace(suggestion=next(steps)))
    decide = _deciding(aid, "lagging", START, wait=5)
    now, modes = np.zeros(1, STATE)[0], []
    now["mode"] = 1
    for _ in said:
        inputs = np.empty(1)
        decide(now, inputs)
        now["mode"] = inputs[0]
        modes.append(inputs[0])
    assert modes == [1.0] * 13 + [0.0]
