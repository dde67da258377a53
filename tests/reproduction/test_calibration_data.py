"""
The calibration that the repository holds (`make calibration`).

Oracles: simulation-based calibration (Talts et al. 2018), leave-one-out: with every stored study in
turn as the one observed, the ranks of its assumptions in the posterior are uniform; those studies,
simulated again.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from trustlab.reproduction import read_calibration
from trustlab.reproduction.calibration import posterior_sample, prior_draws, simulated_study

DATA = Path(__file__).parents[2] / "data" / "calibration"


@pytest.fixture(scope="module", params=["uav", "ground_robot"])
def stored(request):
    return read_calibration(request.param, DATA)


def ranks(drawn, simulated, ranges, accepted, rows):
    """The place of every truth in the posterior made from all other simulations, in [0, 1]."""
    found = []
    for i in rows:
        others = np.arange(len(drawn)) != i
        sample, _ = posterior_sample(
            drawn[others], simulated[others], simulated[i], ranges, accepted, int(i)
        )
        found.append((sample < drawn.iloc[i]).mean())
    return pd.DataFrame(found)


def test_ranks_of_the_truth_are_uniform_on_simulated_studies(stored):
    names, effects = list(stored.priors), list(stored.simulations.columns[len(stored.priors) :])
    rows = np.random.default_rng(1).choice(len(stored.simulations), 150, replace=False)
    table = stored.simulations
    found = ranks(
        table[names], table[effects].to_numpy(), stored.priors, stored.settings["accepted"], rows
    )
    for name in names:
        assert stats.kstest(found[name], "uniform").pvalue > 0.002, name


def test_a_part_of_the_stored_studies_is_simulated_again(stored):
    settings, effects = stored.settings, stored.simulations.columns[len(stored.priors) :]
    seeds = np.random.SeedSequence(settings["seed"]).spawn(3)
    for draw, seed in zip(prior_draws(stored.priors, 3, settings["seed"]), seeds, strict=True):
        row = stored.simulations[
            np.isclose(stored.simulations["attention_cost"], draw["attention_cost"], rtol=1e-12)
        ]
        again = simulated_study(stored.study, settings["n"], seed, **draw)
        np.testing.assert_allclose(
            row[effects].to_numpy()[0], [again[id] for id in effects], rtol=1e-9
        )


def test_reports_of_the_stored_calibration(stored):
    table, given = stored.table(), stored.given("p_r", "r")
    assert ((table["low"] >= table["prior_low"]) & (table["high"] <= table["prior_high"])).all()
    assert ((table["low"] <= table["median"]) & (table["median"] <= table["high"])).all()
    checks = given.checks(studies=4)
    assert set(checks["id"]) <= set(tl.printed_effects()["id"])
    assert (checks["low"] <= checks["high"]).all()
    reach = stored.reach()
    assert ((reach["share"] >= 0.0) & (reach["share"] <= 1.0)).all()
    assert "simulated operators" in stored._repr_html_()
    assert "simulated" in stored.plot()[0].figure.get_suptitle()
    first = str(checks["id"][0])
    assert "simulated" in given.plot_sign(first).get_title()
    plt.close("all")


def test_what_the_stored_studies_say(stored):
    given = stored.given("p_r", "r")
    assert given.extrapolated == ()  # these effects are within reach of simulated operators
    assert given.assumptions["attention_cost"] > 0.02
