"""Correction on the ground-robot testbed: what is logged against the corrector, step by step."""

import numpy as np
import pytest

import trustlab as tl
from trustlab.testbeds import GroundRobotTests, run_condition
from trustlab.testbeds.ground_robot.conditions import published_model, published_operator

TARGET = (0.05, 0.4)


def corrected(habit="following", tests=1, seed=3, c_b=1e-4, participant=2, **more):
    corrector = tl.ThresholdCorrector(published_model(2), TARGET, c_b=c_b)
    setting = GroundRobotTests(participant, **more)
    return tl.run_correction(corrector, None, tests, habit, seed, setting)


@pytest.fixture(scope="module")
def run():
    return corrected(tests=2, laps=3)


def test_every_correction_is_the_corrector_s(run):
    model = published_model(2)
    corrector = tl.ThresholdCorrector(model, TARGET, c_b=1e-4)
    data = run.data[run.data["status"] != "held"].iloc[::37]
    assert len(data) > 20
    for row in data.itertuples():
        before = run.data["mode"][row.Index - 1]
        p_r = min(max(row.p_r, model.robot.p_min), model.robot.p_max)
        plan = corrector.step(row.r, p_r, row.lower, row.upper, int(before))
        assert (row.c_l, row.c_u) == pytest.approx((plan.c_l, plan.c_u), abs=1e-16)
        assert row.cost == pytest.approx(plan.cost, rel=1e-9)


def test_thresholds_stay_and_go_on(run):
    data = run.data
    assert (data.loc[data["status"] == "held", ["c_l", "c_u"]] == 0.0).all(axis=None)
    assert (data.groupby("test")["status"].apply(lambda s: (s == "held").sum()) == 1000).all()
    steps = data[["lower", "upper"]].diff().iloc[1:]
    assert (steps >= 0.0).all(axis=None)
    assert steps.max(axis=None) <= 1e-4
    assert data["lower"].between(0.0, TARGET[0]).all()
    assert data["upper"].between(0.35, TARGET[1]).all()
    assert all(session.metadata.synthetic for session in run.sessions)
    assert "synthetic" in run.source


def test_suggestions_follow_the_moving_thresholds(run):
    data = run.data[(run.data["status"] != "held")]
    assert (data.loc[data["tsc"] >= data["upper"], "suggestion"] == 0).all()
    assert (data.loc[data["tsc"] <= data["lower"], "suggestion"] == 1).all()


def test_ignoring_leaves_the_operator_as_they_were_and_adopting_does_not():
    ignoring, adopting = (
        corrected(habit, laps=4, c_b=1e-3, seed=5) for habit in ("ignoring", "adopting")
    )
    child = np.random.SeedSequence(5).spawn(1)[0]
    alone = run_condition("C1", published_operator(2), published_model(2), laps=4, seed=child)
    np.testing.assert_array_equal(ignoring.data["p_r"], alone.session["p_r"])
    assert (
        len(adopting.data) != len(ignoring.data)
        or (adopting.data["mode"] != ignoring.data["mode"]).any()
    )


def test_same_seed_same_run():
    one, two = (corrected("lagging", laps=1, seed=9, participant="2") for _ in range(2))
    np.testing.assert_array_equal(one.data["p_r"], two.data["p_r"])


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"habit": "asleep"}, "following"),
        ({"tests": 0}, "tests"),
        ({"laps": 0}, "laps"),
        ({"lag": -1.0}, "lag"),
        ({"seed": -3}, "seed"),
        ({"r0": 1.5}, "r0"),
        ({"participant": 9}, "no participant"),
        ({"participant": published_operator(2)}, "start must be two numbers"),
    ],
)
def test_bad_arguments(more, words):
    with pytest.raises(ValueError, match=words):
        corrected(**more)


def test_the_testbed_takes_incentives_of_ones_own():
    corrector = tl.ThresholdCorrector(
        published_model(2), TARGET, horizon=5, incentive=lambda r, p, c, a, b: (-0.5 * c, 0.5 * c)
    )
    run = tl.run_correction(corrector, tests=1, setting=GroundRobotTests(2, laps=2))
    settled = run.data["t"] >= 100.0
    first = np.cumsum(settled) - 1
    start = run.data["lower"].iloc[0]
    expected = np.minimum(start + 0.5 * corrector.c_b * np.maximum(first, 0), TARGET[0])
    np.testing.assert_allclose(run.data["lower"], expected, atol=1e-12)
    assert (run.data["latency"] > 0.0).all()
