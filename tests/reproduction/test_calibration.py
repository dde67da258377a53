"""Calibration of assumptions about people.

Oracles: regressions that leave each simulation out; the campaign's own files. How often intervals
cover stands in `test_calibration_data.py`.
"""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from pandas.testing import assert_frame_equal
from scipy import stats

import trustlab as tl
from tests.cases import refused
from trustlab.models.published import data_folder
from trustlab.reproduction import read_calibration, write_calibration
from trustlab.reproduction.calibration import (
    PRIORS,
    TELEOPERATOR_PRIORS,
    Calibration,
    observed_effects,
    posterior_sample,
)

RANGES = {"a": (0.0, 1.0), "b": (-1.0, 1.0), "c": (0.0, 2.0)}


def test_residuals_are_those_of_leaving_each_simulation_out():
    """Oracle: a regression by the normal equations for every simulation that is left out."""
    rng = default_rng(0)
    low, high = np.transpose(list(RANGES.values()))
    drawn = pd.DataFrame(rng.uniform(low, high, (40, 3)), columns=list(RANGES))
    mixing = rng.normal(size=(3, 8))
    simulated = drawn.to_numpy() @ mixing + rng.normal(0.0, 0.5, (40, 8))
    observed = simulated[0] + 0.1
    # With an effect that is always the same, and says nothing.
    more = np.column_stack([simulated, np.ones(40)])
    sample, _ = posterior_sample(drawn, more, np.append(observed, 1.0), RANGES)
    theta = stats.norm.ppf((drawn.to_numpy() - low) / (high - low))
    X = np.column_stack([np.ones(40), simulated])
    x = np.append(1.0, observed)
    expected = x @ np.linalg.solve(X.T @ X, X.T @ theta)
    wider = np.sqrt(1.0 + x @ np.linalg.solve(X.T @ X, x))
    for i, row in enumerate(X):
        Z, rest = np.delete(X, i, axis=0), np.delete(theta, i, axis=0)
        missed = theta[i] - row @ np.linalg.solve(Z.T @ Z, Z.T @ rest)
        # e_i/√(1 − h_i): between the residual e_i and what leaving i out misses, e_i/(1 − h_i)
        spread = missed * np.sqrt(1.0 - row @ np.linalg.solve(X.T @ X, row))
        there = low + (high - low) * stats.norm.cdf(expected + wider * spread)
        np.testing.assert_allclose(sample.iloc[i], there, rtol=1e-9)


def test_a_calibration_grows_in_its_folder_and_is_read_again(tmp_path):
    priors, out = {"attention_cost": (0.0, 0.3), "r0": (0.0, 1.0)}, tmp_path / "campaign"
    arguments = {"study": "table_2.6", "n": 5, "priors": priors, "n_jobs": 1, "out": out}
    first = tl.calibrate(simulations=12, **arguments)
    stamps = {file: file.stat().st_mtime_ns for file in out.rglob("runs-*.json")}
    assert stamps
    grown = tl.calibrate(simulations=14, **arguments)
    assert {file: file.stat().st_mtime_ns for file in stamps} == stamps
    assert len(grown.simulations) == 14
    assert grown.settings == first.settings | {"simulations": 14}
    assert_frame_equal(grown.simulations[:12], first.simulations, check_exact=True)
    write_calibration(first, tmp_path / "data")
    read = read_calibration("table_2.6", tmp_path / "data")
    assert_frame_equal(first.simulations, read.simulations, rtol=1e-12)
    assert_frame_equal(first.posterior, read.posterior, rtol=1e-9)


TRUE = {"attention_cost": 0.15, "trust_bias": 0.0}


@cache
def made_up(beyond=0.0):
    """
    A calibration of Table 2.5 by a linear model whose true assumptions give what is printed, but
    effects on p_h lie above it.
    """
    rng = default_rng(4)
    priors = {"attention_cost": (0.0, 0.3), "trust_bias": (-0.4, 0.4)}
    table = pd.DataFrame({name: rng.uniform(*ends, 600) for name, ends in priors.items()})
    away = table - pd.Series(TRUE)
    for effect in observed_effects("table_2.5").itertuples():
        slopes = (1.0, 0.5) if effect.measure == "p_r" else (0.0, 1.0)
        lift = effect.printed + beyond * (effect.measure == "p_h")
        table[effect.id] = lift + away.to_numpy() @ slopes + rng.normal(0.0, 0.02, 600)
    settings = {"n": 5, "seed": 0, "simulations": 600, "left_out": 0}
    return Calibration("table_2.5", priors, table, settings)


def finds_attention_cost(calibration):
    row = calibration.table().set_index("assumption").loc["attention_cost"]
    return row["low"] < TRUE["attention_cost"] < row["high"]


def checks_of(people):
    return made_up().checks(1, people=people)


def test_a_study_that_the_model_can_give_is_within_reach_and_found():
    within = made_up()
    assert (within.reach()["share"] > 0.05).all()
    assert within.extrapolated == ()
    assert "no estimate" not in within.message
    assert finds_attention_cost(within)
    medians = within.table().set_index("assumption")["median"]
    assert within.assumptions == pytest.approx(medians.to_dict())


def test_effects_beyond_all_simulations_are_said_to_be_out_of_reach():
    beyond = made_up(1.0)
    reach = beyond.reach().set_index("measures")["share"]
    assert reach["p_h"] == reach["p_r p_h r"] == 0.0
    assert reach["p_r"] > 0.05
    assert "trust_bias" in beyond.extrapolated
    assert beyond.message.endswith(f"no estimate of {', '.join(beyond.extrapolated)}")
    assert beyond.table().set_index("assumption").loc["trust_bias", "extrapolated"]
    assert beyond.within_reach().measures == ("p_r", "r")
    rest = beyond.given("p_r", "r")
    assert list(rest.reach()["measures"]) == ["p_r", "r", "p_r r"]
    assert rest.extrapolated == ()
    assert finds_attention_cost(rest)


@pytest.mark.parametrize(("study", "priors"), [("uav", PRIORS), ("teleop", TELEOPERATOR_PRIORS)])
def test_stored_calibrations_have_the_usual_priors(study, priors):
    assert read_calibration(study, data_folder("calibration")).priors == priors


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: tl.calibrate(priors={"atention_cost": (0, 1)}), "an assumption must be one of"),
        (lambda: tl.calibrate("teleoperation"), "study must be one of"),
        (lambda: made_up().given(), "name at least one measure, any of"),
        (lambda: made_up().given("speed"), "a measure must be one of"),
        (lambda: made_up().checks(studies=5000), "studies must be .*600"),
        (lambda: checks_of({"trust_bias": [0.1]}), "people must be of class DataFrame"),
        (lambda: checks_of(pd.DataFrame({"trust_bia": [0.1]})), "did you mean 'trust_bias'"),
        (lambda: checks_of(pd.DataFrame({"trust_bias": [9.0]})), "trust_bias must lie in"),
    ],
)
def test_bad_input_is_refused(call, says):
    with refused(says):
        call()
