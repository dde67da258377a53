"""
Thresholds and motions under a posterior.

Oracles: `limit_cycle` of single draws; the people that the logs were made of.
"""

import importlib.util
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation.decision.steady import coarse, points, survey

LOGS = Path(__file__).parents[1] / "identification" / "posterior" / "simulated_logs.py"


@pytest.fixture(scope="module")
def logs():
    spec = importlib.util.spec_from_file_location("simulated_logs", LOGS)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def clear(logs):
    session, _ = logs.printed_case(np.random.default_rng(3), "white")
    return tl.sample_posterior(session)


@pytest.fixture(scope="module")
def unclear(logs):
    session, _ = logs.printed_case(np.random.default_rng(3), "slow", minutes=5.0)
    return tl.sample_posterior(session)


def test_coarse_motions_are_those_of_limit_cycle(operators):
    pairs = np.array([[0.0, 0.3], [-0.1, 0.2], [-3.0, 3.0]])
    models = [operators[name] for name in ("2", "3", "pilot")]
    motions = survey(models, pairs)
    for i, tsc in enumerate(models):
        _, ratio = coarse(tsc)
        for j, (lower, upper) in enumerate(pairs):
            cycle = tl.limit_cycle(tsc, lower, upper, starts=1)
            assert motions.switches[i, j] == cycle.exists
            if not cycle.exists:
                assert np.isnan(motions.mean_r[i, j])
                continue
            inside = cycle.r_low <= tsc.human.beta <= cycle.r_high
            near = min(abs(cycle.r_low - tsc.human.beta), abs(cycle.r_high - tsc.human.beta))
            assert motions.encloses[i, j] == inside or near < 0.01
            assert motions.mean_r[i, j] == pytest.approx(cycle.mean_r, abs=0.01)
            assert motions.mean_p_r[i, j] == pytest.approx(cycle.mean_p_r, abs=0.002)
            assert motions.peak[i, j] == pytest.approx(cycle.p_r_high, abs=0.003)
            least = min(cycle.dwell_manual[0], cycle.dwell_autonomous[0])
            assert motions.dwell[i, j] == pytest.approx(least, abs=2 * ratio)


def test_points_are_percentages_of_the_ranges(operators):
    tsc = operators["2"]
    run = tl.simulate_allocation(tsc, 0.0, 0.35, 60_000, r0=0.7).iloc[20_000:]
    motions = survey([tsc], np.array([[0.0, 0.35]]))
    of_robot = tl.relative_performance(run["p_r"], tsc.robot.p_min, tsc.robot.p_max)
    of_human = tl.relative_performance(run["p_h"], tsc.human.p_min, tsc.human.p_max)
    for weight in (0.0, 0.5, 1.0):
        expected = weight * of_robot + (1.0 - weight) * of_human
        assert points(motions, [tsc], weight).item() == pytest.approx(expected, abs=1.0)


def test_a_clear_log_gets_thresholds_that_do_what_is_said(clear, operators):
    choice = tl.choose_thresholds(clear, confidence=0.95)
    assert choice.offered
    assert choice.probability >= 0.95
    cycle = tl.limit_cycle(operators["pilot"], choice.lower, choice.upper)
    assert cycle.exists
    assert cycle.r_low <= operators["pilot"].human.beta <= cycle.r_high
    row = choice.table().loc["mean_p_r"]
    assert row["ci_low"] - 1e-3 < cycle.mean_p_r < row["ci_high"] + 1e-3
    mean = tl.choose_thresholds(clear, objective="mean")
    assert mean.table().loc["mean_p_r", "mean"] >= row["mean"]
    assert tl.choose_thresholds(clear, objective=0.5).offered
    assert choice.plot().get_xlabel() == "lower threshold $TSC_l$"
    plt.close("all")


@pytest.mark.parametrize("objective", ["peak", "mean", 0.0])
def test_a_pair_at_the_end_of_the_range_is_said_to_be_there(clear, objective):
    choice = tl.choose_thresholds(clear, objective=objective, enclose_beta=False)
    pairs = choice.candidates[["lower", "upper"]].to_numpy()
    at_end = choice.lower == pairs.min() or choice.upper == pairs.max()
    assert ("at the end of the range searched" in choice.message) == at_end
    if at_end and objective == "mean":  # what the message says of pairs beyond
        few = replace(clear, draws=clear.draws[:20], thetas=clear.thetas[:20])
        beyond = tl.limit_cycle(few, choice.lower + 0.03, choice.upper + 0.03)
        assert beyond.probability > 0.9
        mean_p_r = np.mean([motion.mean_p_r for motion in beyond.results if motion.exists])
        assert mean_p_r > choice.table().loc["mean_p_r", "mean"]


def test_an_unclear_log_abstains_and_says_what_to_record(unclear):
    choice = tl.choose_thresholds(unclear, confidence=0.99)
    assert not choice.offered
    assert choice.probability < 0.99
    assert choice.probability == choice.candidates["p_encloses"].max()
    assert "minutes" in choice.message
    assert tl.choose_thresholds(unclear, confidence=0.01).offered
    only_switching = tl.choose_thresholds(unclear, confidence=0.99, enclose_beta=False)
    assert only_switching.probability == only_switching.candidates["p_switches"].max()


def test_motions_over_draws_are_those_of_each(clear):
    few = replace(clear, draws=clear.draws[:4], thetas=clear.thetas[:4])
    cycles = tl.limit_cycle(few, 0.0, 0.3)
    assert len(cycles.results) == 4
    assert cycles.probability == np.mean([each.exists for each in cycles.results])
    table = cycles.table()
    values = [tl.limit_cycle(tsc, 0.0, 0.3, starts=1).r_low for tsc in few.models]
    assert table.loc["r", "low"] == pytest.approx(np.median(values))
    assert table.loc["r", "low_ci_low"] <= min(values) + np.ptp(values)
    bounds = tl.invariant_bounds(few, 0.0, 0.3)
    assert bounds.probability == 1.0
    assert (bounds.table()["low"]["r"]) <= table["low"]["r"] + 1e-9
    never = tl.limit_cycle(few, -9.0, 9.0)
    assert never.probability == 0.0
    assert never.table().isna().all().all()


def test_objectives_of_a_model(operators):
    choices = {
        each: tl.choose_thresholds(operators["2"], objective=each) for each in ("peak", "mean")
    }
    assert choices["mean"].cycle.mean_p_r > choices["peak"].cycle.mean_p_r
    assert choices["peak"].cycle.p_r_high > choices["mean"].cycle.p_r_high
    for wrong in ("best", 1.5, None):
        with pytest.raises(ValueError, match="objective"):
            tl.choose_thresholds(operators["2"], objective=wrong)
