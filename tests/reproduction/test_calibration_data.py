"""
The calibration that the repository holds (`make calibration`).

Oracles: leave-one-out, with every stored study in turn as the one observed; truths drawn anew; the
stored studies, simulated again.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.reproduction import read_calibration
from trustlab.reproduction.calibration import posterior_sample, prior_draws, simulated_study

DATA = Path(__file__).parents[2] / "data" / "calibration"


@pytest.fixture(scope="module", params=["uav", "ground_robot"])
def stored(request):
    return read_calibration(request.param, DATA)


@pytest.fixture(params=["all", "within reach"])
def chosen(stored, request):
    """The ids of the effects that are used."""
    measures = (stored if request.param == "all" else stored.within_reach()).measures
    return list(stored.observed.loc[stored.observed["measure"].isin(measures), "id"])


def coverage(places):
    """How often truths lie in the 95 % and the 50 % interval, from their places in samples."""
    away = (pd.DataFrame(places) - 0.5).abs()
    return (away <= 0.475).mean(), (away <= 0.25).mean()


def test_intervals_cover_simulated_studies(stored, chosen):
    """Leave-one-out over all stored studies: within 92 to 98 % and 45 to 55 %, each assumption."""
    drawn, effects = stored.simulations[list(stored.priors)], stored.simulations[chosen].to_numpy()
    places = []
    for i in range(len(drawn)):
        rest = np.arange(len(drawn)) != i
        sample, _ = posterior_sample(drawn[rest], effects[rest], effects[i], stored.priors)
        places.append((sample < drawn.iloc[i]).mean())
    wide, narrow = coverage(places)
    assert wide.between(0.92, 0.98).all()
    assert narrow.between(0.45, 0.55).all()


@pytest.mark.long
def test_intervals_cover_fresh_truths(stored, chosen):
    """50 studies that are not stored, under assumptions drawn anew; pooled over assumptions."""
    drawn, effects = stored.simulations[list(stored.priors)], stored.simulations[chosen].to_numpy()
    places = []
    seeds = np.random.SeedSequence(2026).spawn(50)
    for draw, seed in zip(prior_draws(stored.priors, 50, 2026), seeds, strict=True):
        fresh = simulated_study(stored.study, stored.settings["n"], seed, **draw)
        observed = np.array([fresh[id] for id in chosen])
        sample, _ = posterior_sample(drawn, effects, observed, stored.priors)
        places.append((sample < pd.Series(draw)).mean())
    wide, narrow = coverage(places)
    assert 0.92 <= wide.mean() <= 0.98
    assert 0.45 <= narrow.mean() <= 0.55


def test_a_part_of_the_stored_studies_is_simulated_again(stored):
    settings, effects = stored.settings, stored.simulations.columns[len(stored.priors) :]
    seeds = np.random.SeedSequence(settings["seed"]).spawn(3)
    first = next(iter(stored.priors))
    for draw, seed in zip(prior_draws(stored.priors, 3, settings["seed"]), seeds, strict=True):
        row = stored.simulations[np.isclose(stored.simulations[first], draw[first], rtol=1e-12)]
        again = simulated_study(stored.study, settings["n"], seed, **draw)
        expected = [again[id] for id in effects]
        np.testing.assert_allclose(row[effects].to_numpy()[0], expected, rtol=1e-9)


def test_reports_of_the_stored_calibration(stored):
    table = stored.table()
    ordered = table[["prior_low", "low", "median", "high", "prior_high"]].diff(axis=1).iloc[:, 1:]
    assert (ordered >= 0.0).all(axis=None)
    checks = stored.given("p_r", "r").checks(studies=4)
    assert set(checks["id"]) <= set(tl.printed_effects()["id"])
    assert (checks["low"] <= checks["high"]).all()
    # As the stored table of checks is made: with decisions that are free.
    free = stored.checks(2, people=stored.posterior.assign(attention_cost=0.0))
    assert free[["id", "prior_low"]].equals(stored.checks(2)[["id", "prior_low"]])
    assert stored.reach()["share"].between(0.0, 1.0).all()
    assert "simulated operators" in stored._repr_html_()
