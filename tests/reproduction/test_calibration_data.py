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


def coverage(stored, chosen, simulations, left_out):
    """
    How often the truths of simulated studies lie in their 95 % and 50 % intervals, from all stored
    studies, or all but the same one.
    """
    priors, drawn = stored.priors, stored.simulations[list(stored.priors)]
    effects, places = stored.simulations[chosen].to_numpy(), []
    for i, (truth, observed) in enumerate(
        zip(
            simulations[list(priors)].to_dict("records"),
            simulations[chosen].to_numpy(),
            strict=True,
        )
    ):
        rest = np.arange(len(drawn)) != (i if left_out else -1)
        sample, _ = posterior_sample(drawn[rest], effects[rest], observed, priors)
        places.append((sample < pd.Series(truth)).mean())
    away = (pd.DataFrame(places) - 0.5).abs()
    return (away <= 0.475).mean(), (away <= 0.25).mean()


def simulated_again(stored, count, seed):
    """Studies under assumptions drawn from the priors, as the campaign makes them."""
    rows = []
    seeds = np.random.SeedSequence(seed).spawn(count)
    for draw, stream in zip(prior_draws(stored.priors, count, seed), seeds, strict=True):
        rows.append(draw | simulated_study(stored.study, stored.settings["n"], stream, **draw))
    return pd.DataFrame(rows)


def test_intervals_cover_simulated_studies(stored, chosen):
    """Leave-one-out over all stored studies: within 92 to 98 % and 45 to 55 %, each assumption."""
    wide, narrow = coverage(stored, chosen, stored.simulations, left_out=True)
    assert wide.between(0.92, 0.98).all()
    assert narrow.between(0.45, 0.55).all()


@pytest.mark.long
def test_intervals_cover_fresh_truths(stored, chosen):
    """50 studies that are not stored, under assumptions drawn anew; pooled over assumptions."""
    fresh = simulated_again(stored, 50, 2026)
    wide, narrow = coverage(stored, chosen, fresh, left_out=False)
    assert 0.92 <= wide.mean() <= 0.98
    assert 0.45 <= narrow.mean() <= 0.55


def test_a_part_of_the_stored_studies_is_simulated_again(stored):
    again = simulated_again(stored, 3, stored.settings["seed"])
    first = next(iter(stored.priors))
    rows = [np.abs(stored.simulations[first] - value).argmin() for value in again[first]]
    again = again[stored.simulations.columns].astype(float)
    np.testing.assert_allclose(stored.simulations.iloc[rows], again, rtol=1e-9)


def test_reports_of_the_stored_calibration(stored):
    ordered = stored.table()[["prior_low", "low", "median", "high", "prior_high"]]
    assert (ordered.diff(axis=1).iloc[:, 1:] >= 0.0).all(axis=None)
    checks = stored.checks(2)
    assert set(checks["id"]) <= set(tl.printed_effects()["id"])
    assert (checks["low"] <= checks["high"]).all()
    # As the stored table of checks is made: with decisions that are free.
    free = stored.checks(2, people=stored.posterior.assign(attention_cost=0.0))
    assert free[["id", "prior_low"]].equals(checks[["id", "prior_low"]])
    assert "simulated operators" in stored._repr_html_()
