"""
On-line correction and tests in a row: against the model simulated by itself, and against missing or
odd measurements.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import trustlab as tl
from trustlab.allocation import ModelTests, TargetWarning, incentive_box
from trustlab.allocation.correction import OPTIMAL
from trustlab.allocation.correction_run import MISSING, NEAREST, OUTSIDE, Responder
from trustlab.models.published import published_models

SECOND = published_models()["2"]
START, TARGET = (0.0, 0.35), (0.05, 0.4)


def corrected(
    start=START,
    target=TARGET,
    model=SECOND,
    tests=1,
    habit="following",
    seed=0,
    horizon=200,
    **setting,
):
    corrector = tl.ThresholdCorrector(model, target, horizon=horizon)
    return tl.run_correction(corrector, start, tests, habit, seed, ModelTests(**setting))


@pytest.fixture(scope="module")
def corrector():
    return tl.ThresholdCorrector(SECOND, TARGET, c_b=1e-4, horizon=50)


def online(corrector, **more):
    return tl.OnlineCorrection(corrector, START, **more)


def test_a_step_of_the_online_form_is_a_step_of_the_corrector(corrector):
    loop = online(corrector, r=0.6)
    plan = corrector.step(0.6, 0.3, *START, 1)
    step = loop.update(p_r=0.3, p_h=0.38, mode=1)
    assert (step.c_l, step.c_u, step.cost, step.status) == (
        plan.c_l,
        plan.c_u,
        plan.cost,
        plan.status,
    )
    assert step.tsc == pytest.approx(SECOND.value(0.3, 0.38))
    assert (loop.lower, loop.upper) == (START[0] + plan.c_l, START[1] + plan.c_u)
    assert loop.r == pytest.approx(SECOND.human.a * 0.6 + 1 - SECOND.human.a)
    assert step.latency > 0.0


def test_missing_data_hold_and_the_correction_goes_on(corrector):
    loop, steps = online(corrector), []
    for k in range(60):
        missing = 20 <= k < 40
        values = (
            ((math.nan, 0.38), (0.3, math.nan), (None, None))[k % 3] if missing else (0.3, 0.38)
        )
        steps.append(loop.update(*values, mode=math.nan if missing and k % 2 else 1))
    held = steps[20:40]
    assert {(step.status, step.message) for step in held} == {("held", MISSING)}
    assert all(step.suggestion == -1 and step.c_l == step.c_u == 0.0 for step in held)
    assert {(step.lower, step.upper) for step in held} == {(steps[20].lower, steps[20].upper)}
    assert steps[40].status == "planned"
    assert steps[40].lower == steps[20].lower
    assert steps[41].lower > steps[40].lower
    assert np.isfinite([step.r for step in steps]).all()
    table = loop.table()
    assert len(table) == 60
    assert (table["status"] == "held").sum() == 20
    assert table["cost"].isna().sum() == 20


def test_performance_outside_the_range(corrector):
    held = online(corrector).update(0.4, 0.38)
    assert (held.status, held.message) == ("held", OUTSIDE)
    assert (held.c_l, held.c_u) == (0.0, 0.0)
    assert held.suggestion == 0
    nearest = online(corrector, outside="nearest").update(0.4, 0.38)
    assert (nearest.status, nearest.message) == ("planned", NEAREST)
    assert nearest.c_l == corrector.step(0.0, 0.35, *START, 1).c_l
    assert online(corrector).update(0.35 + 1e-12, 0.38).message == OPTIMAL


@pytest.mark.parametrize("bad", ["0.3", True, np.array([0.3]), math.inf, [0.3], 1j])
def test_odd_measurements_are_refused_and_change_nothing(corrector, bad):
    loop = online(corrector)
    with pytest.raises(ValueError, match="p_r"):
        loop.update(bad, 0.38)
    with pytest.raises(ValueError, match="p_h"):
        loop.update(0.3, bad)
    with pytest.raises(ValueError, match="mode"):
        loop.update(0.3, 0.38, mode=2)
    with pytest.raises(ValueError, match="mode"):
        loop.update(0.3, 0.38, mode=np.array([math.nan, 1.0]))
    with pytest.raises(ValueError, match="overflows"):
        loop.update(0.3, 1e308)
    assert (loop.lower, loop.upper, loop.r, len(loop.table())) == (*START, 0.0, 0)


@settings(max_examples=60, deadline=None, derandomize=True)
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
    low, high = np.array(
        [
            incentive_box(r, p, c_b, 0.24, 0.35)
            for r, p in zip(table["r"][free], p_r[free], strict=True)
        ]
    ).T
    for action in ("c_l", "c_u"):
        assert (table[action][~free] == 0.0).all()
        assert table[action][free].between(low - 1e-15, high + 1e-15).all()


def test_following_is_the_model_under_moving_thresholds():
    """Oracle: (2.44) written out, with the corrections that were applied."""
    run = corrected(tests=2, duration=300)
    for _, part in run.data.groupby("test"):
        r = 0.0
        p_r = 0.24
        mode = 1
        for row in part.itertuples():
            p_h = SECOND.human.performance(r)
            tsc = SECOND.value(p_r, p_h)
            mode = 0 if tsc >= row.upper else 1 if tsc <= row.lower else mode
            assert (row.r, row.p_r, row.mode) == pytest.approx((r, p_r, mode), abs=1e-12)
            p_r = SECOND.robot.a * p_r + (1 - SECOND.robot.a) * 0.24 + mode * SECOND.robot.b * p_h
            r = SECOND.human.a * r + (1 - SECOND.human.a) * mode
    lower = run.data["lower"].to_numpy()
    np.testing.assert_allclose(np.diff(lower), run.data["c_l"][:-1], atol=1e-17)
    assert set(run.data["status"]) == {"planned"}
    assert (run.data["message"] == OPTIMAL).mean() > 0.5


def test_habits_differ_as_they_should():
    runs = {
        habit: corrected(tests=2, habit=habit, horizon=20, duration=900, lag=8.0)
        for habit in ("following", "lagging", "ignoring")
    }
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
        assert len(run.plot()) == 2
        assert "simulated" in run._repr_html_()


def test_a_suggestion_that_is_withdrawn_is_not_followed():
    """ "lagging": follows those that still stand after a lag."""
    operator = Responder("lagging", START, 5)
    for suggestion in (0, 0, 0, -1, -1, -1, -1, -1):
        operator.hear(suggestion)
        assert operator.decide(0.2, None) == 1
    for suggestion in (0, 0, 0, 0, 0):
        assert operator.decide(0.2, None) == 1
        operator.hear(suggestion)
    assert operator.decide(0.2, None) == 0


def test_noise_is_seeded():
    one, two, other = (
        corrected(seed=seed, horizon=20, duration=60, noise=1e-3).data["p_r"] for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, two)
    assert (one != other).any()
    assert one.between(0.24, 0.35).all()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"start": (0.4, 0.1)}, "below"),
        ({"duration": 1e308}, "number of samples"),
        ({"noise": math.nan}, "finite"),
        ({"seed": "a"}, "seed"),
    ],
)
def test_bad_runs_are_refused(more, words):
    with pytest.raises(ValueError, match=words):
        corrected(**({"duration": 10.0} | more))


def test_latency_histogram(corrector):
    loop = online(corrector)
    for _ in range(20):
        loop.update(0.3, 0.38, 1)
    assert "µs" in loop.plot().get_xlabel()


def test_the_pilot_warns_but_runs():
    with pytest.warns(TargetWarning):
        run = corrected((0.02, 0.45), (0.15, 0.56), published_models()["pilot"], duration=5)
    assert len(run.data) == 50


def test_a_run_does_not_depend_on_an_earlier_one():
    """The CasADi engine starts each search from its last plan, which a run forgets first."""
    corrector = tl.ThresholdCorrector(SECOND, TARGET, c_b=1e-3, horizon=10, engine="casadi")
    setting = ModelTests(duration=2.0)
    runs = [tl.run_correction(corrector, START, tests=2, setting=setting).data for _ in range(2)]
    np.testing.assert_array_equal(runs[0]["c_l"], runs[1]["c_l"])
