"""
Cumulative-link mixed models. Oracles: clmm and clmm2 of R's ordinal and glmer of lme4 on published
data (reference/ordinal_model.R), the integral of the likelihood by another quadrature, simulation.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, special, stats

import trustlab as tl
from trustlab.studies.regression.cumulative_model import log_likelihood, quadrature

R = json.loads((Path(__file__).parents[1] / "reference" / "ordinal_model.json").read_text())
WINE = pd.DataFrame(R["wine"])
VERBAL = pd.DataFrame(R["verbal"])


@pytest.fixture(scope="module")
def wine():
    return tl.ordinal_model(WINE, "rating", ["temp", "contact"], "judge", points=9)


def test_agrees_with_clmm(wine):
    expected = R["interaction"]
    rows = wine.coefficients_table()
    np.testing.assert_allclose(rows["estimate"], expected["estimate"], atol=1e-5)
    np.testing.assert_allclose(rows["se"], expected["se"], atol=1e-5)
    cuts = wine.thresholds_table()
    np.testing.assert_allclose(cuts["estimate"], expected["thresholds"], atol=1e-5)
    np.testing.assert_allclose(cuts["se"], expected["thresholds_se"], atol=1e-5)
    assert wine.random_effects()["variance"].item() == pytest.approx(
        expected["covariance"][0][0], abs=1e-5
    )
    assert wine.log_likelihood == pytest.approx(expected["log_likelihood"], abs=1e-8)
    assert wine.table()["chi2"].to_numpy() == pytest.approx([*R["tests"].values()], abs=1e-5)


def test_random_slopes_agree_with_clmm_and_glmer():
    # Without an interaction of factors: `mode` comes in as a number.
    frame = VERBAL.assign(do=(VERBAL["mode"] == sorted(VERBAL["mode"].unique())[1]) * 1.0)
    arguments = {"subject": "id", "covariates": ["do"], "random": "1 + do", "points": 1}
    for dv, expected in (("answer", R["slopes"]), ("yes", R["logistic"])):
        found = tl.ordinal_model(frame, dv, "situ", **arguments)
        effects = expected["estimate"][-2:]
        np.testing.assert_allclose(found.coefficients_table()["estimate"], effects, atol=2e-4)
        np.testing.assert_allclose(found.coefficients_table()["se"], expected["se"][-2:], rtol=2e-3)
        assert found.log_likelihood == pytest.approx(expected["log_likelihood"], abs=1e-5)
        variance = np.diag(expected["covariance"])
        np.testing.assert_allclose(found.random_effects()["variance"], variance, rtol=1e-3)


def test_proportional_odds_agree_with_clmm2():
    frame = VERBAL.assign(do=(VERBAL["mode"] == sorted(VERBAL["mode"].unique())[1]) * 1.0)
    found = tl.ordinal_model(frame, "answer", "situ", "id", covariates=["do"])
    expected = R["proportional"]
    check = found.proportional_odds().set_index("term").loc["do"]
    assert found.log_likelihood == pytest.approx(expected["location"], abs=1e-4)
    assert check["chi2"] == pytest.approx(
        2.0 * (expected["nominal"] - expected["location"]), abs=1e-3
    )
    assert check["df"] == 1
    assert check["p"] < 0.05


def test_likelihood_is_the_integral_over_two_effects():
    rng = np.random.default_rng(0)
    z = np.column_stack([np.ones(6), rng.standard_normal(6)])
    lower = np.array([-np.inf, -1.0, 0.5, -1.0, 0.5, -np.inf])
    upper = np.array([-1.0, 0.5, np.inf, 0.5, np.inf, -1.0])
    factor = np.array([[1.2, 0.0], [-0.4, 0.8]])

    def integrand(a, b):
        shift = z @ factor @ np.array([a, b])
        chance = special.expit(upper - shift) - special.expit(lower - shift)
        return np.prod(chance) * stats.norm.pdf(a) * stats.norm.pdf(b)

    exact = integrate.dblquad(integrand, -8, 8, -8, 8, epsabs=1e-11)[0]
    rows = (z, np.ones(6), np.array([0, 6]), factor, np.zeros((1, 2)))
    assert log_likelihood(lower, upper, *rows, *quadrature(25, 2)) == pytest.approx(
        np.log(exact), abs=1e-6
    )


def test_probabilities_are_shares_of_many_people(wine):
    """Drawn from the fitted model, people rate as often as it says."""
    cells = wine.probabilities()
    sums = cells.groupby(["temp", "contact"], observed=True)["probability"].sum()
    np.testing.assert_allclose(sums, 1.0, atol=1e-12)
    assert (
        (cells["ci_low"] < cells["probability"]) & (cells["probability"] < cells["ci_high"])
    ).all()
    rng = np.random.default_rng(0)
    people = wine.random_effects()["sd"].item() * rng.standard_normal(200_000)
    eta = wine.coefficients_table()["estimate"].sum() + people + rng.logistic(size=people.size)
    rating = np.searchsorted(wine.thresholds_table()["estimate"], eta)
    last = cells.tail(5)["probability"]
    np.testing.assert_allclose(np.bincount(rating) / people.size, last, atol=0.004)


def test_effects_are_odds_and_superiority(wine):
    """Of two answers of the median person, drawn many times, the share that is higher."""
    pair = wine.pairs().set_index(["a", "b"]).loc[("cold × no", "warm × yes")]
    assert pair["odds_ratio"] == pytest.approx(np.exp(-wine.coefficients_table()["estimate"].sum()))
    rng = np.random.default_rng(1)
    cuts = wine.thresholds_table()["estimate"].to_numpy()
    a = np.searchsorted(cuts, rng.logistic(size=200_000))
    b = np.searchsorted(cuts, rng.logistic(size=200_000) - pair["estimate"])
    share = (a > b).mean() + 0.5 * (a == b).mean()
    assert pair["superiority"] == pytest.approx(share, abs=0.004)


def test_bad_input_names_what_is_wrong():
    give = {"within": "temp", "subject": "judge"}
    with pytest.raises(ValueError, match="neither numbers nor an ordered categorical"):
        tl.ordinal_model(WINE.assign(rating="high"), "rating", **give)
    with pytest.raises(ValueError, match="has 1 different ratings, not 2 to 30"):
        tl.ordinal_model(WINE.assign(rating=1), "rating", **give)
    with pytest.raises(ValueError, match=r"72 different ratings.*formula_model"):
        tl.ordinal_model(WINE.assign(rating=range(72)), "rating", **give)
    with pytest.raises(ValueError, match="no column 'temperature'"):
        tl.ordinal_model(WINE, "rating", "temperature", "judge")
    with pytest.raises(ValueError, match="one level"):
        tl.ordinal_model(WINE.assign(temp="cold"), "rating", **give)
    with pytest.raises(ValueError, match="the likelihood has no maximum"):
        tl.ordinal_model(WINE.assign(rating=(WINE["temp"] == "cold") * 1), "rating", **give)
    with pytest.raises(ValueError, match="points=21"):
        tl.ordinal_model(WINE, "rating", random="1 + contact + temp", points=50, **give)


def test_power_of_ratings():
    """Level without an effect; with one and a rating per person and condition, a shared draw."""
    equal = [[0.1, 0.2, 0.3, 0.25, 0.15]] * 2
    quick = tl.studies.Simulation(replicates=100, seed=0)
    level = tl.power_analysis(tl.studies.Ratings(equal, sd=1.0), n=12, simulation=quick)
    assert level.table()["power"].item() <= 0.2
    # P(y ≤ k) one logit apart.
    below = special.logit(np.cumsum(equal[0])[:-1]) - 1.0
    shifted = np.diff(special.expit(below), prepend=0.0, append=1.0)
    plan = tl.power_analysis(
        tl.studies.Ratings([equal[0], shifted], sd=1.0), n=[6, 36], simulation=quick
    )
    small, large = plan.table()["power"]
    assert small < 0.4 < 0.5 < large
    with pytest.raises(ValueError, match=r"row 1 sums to 1\.1, not to 1"):
        tl.studies.Ratings([[0.5, 0.5], [0.5, 0.6]], sd=1.0)
    with pytest.raises(ValueError, match="a row per condition and a column per rating"):
        tl.studies.Ratings([0.5, 0.5], sd=1.0)
