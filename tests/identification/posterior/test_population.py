"""
Several people at once.

Oracles: the people that logs were made of; conjugate normal arithmetic where people are known
exactly; half-t spreads and their correlations by simulation of the prior.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import logit

import trustlab as tl
from tests.house.documents import ROOT
from tests.identification.posterior import simulated_logs
from tests.identification.posterior.make_coverage import GROUPS, ORIGINS, PEOPLE, population_of
from trustlab.identification.posterior import population as pooling
from trustlab.identification.posterior.result import MODEL
from trustlab.testbeds import GroundRobot
from trustlab.testbeds.populations import OperatorPopulation


def group(rng, kind, count, minutes):
    """Sessions of people spread as the printed five."""
    sessions = {}
    for name in map(str, range(count)):
        shared = PEOPLE.mean(axis=0) + PEOPLE.std(axis=0, ddof=1) * rng.standard_normal(7)
        sessions[name] = simulated_logs.person_case(rng, shared, kind, minutes)[0]
    return sessions


pytestmark = pytest.mark.xdist_group("population")  # one worker fits the people of all


@pytest.fixture(scope="module")
def people():
    return tl.fit_population(group(np.random.default_rng(5), "slow", 3, 3.0), n=500)


# --- the Gibbs sampler ----------------------------------------------------------------------------


def test_people_known_exactly_give_conjugate_moments():
    """One draw each: mean and covariance have a known posterior, integrated here on a grid."""
    rng = np.random.default_rng(1)
    values = np.array([0.3, 0.5, -0.2, 0.4])
    draws = [np.array([[value]]) for value in values]
    found = pooling.pool(draws, [np.zeros(1)] * 4, rng)
    mean = np.linspace(-3.0, 3.0, 301)[:, None]
    spread = np.linspace(1e-3, 4.0, 2000)[None, :]
    density = stats.norm.pdf(mean, scale=pooling.OF_MEAN**0.5)
    density = density * stats.t.pdf(spread, pooling.FREEDOM, scale=pooling.SCALE)
    for value in values:
        density = density * stats.norm.pdf(value, mean, spread)
    density /= density.sum()
    assert found.means.mean() == pytest.approx((density * mean).sum(), abs=0.03)
    spreads = np.sqrt(found.covariances[:, 0, 0])
    assert spreads.mean() == pytest.approx((density * spread).sum(), abs=0.04)
    assert [each.tolist() for each in found.weights] == [[1.0]] * 4


def test_spreads_are_half_t_and_correlations_moderate_before_data():
    rng = np.random.default_rng(2)
    covariance = np.eye(3)
    spreads, correlations = [], []
    for _ in range(20_000):
        covariance = pooling._covariance(np.empty((0, 3)), covariance, rng)
        spreads.append(np.sqrt(covariance[0, 0]))
        correlations.append(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))
    quartiles = np.quantile(spreads, [0.25, 0.5, 0.75])
    # Half-t: the size of what is t-distributed.
    expected = pooling.SCALE * stats.t(pooling.FREEDOM).ppf([0.625, 0.75, 0.875])
    np.testing.assert_allclose(quartiles, expected, rtol=0.15)
    variance = pooling.OF_MEAN + np.mean(np.square(spreads))
    assert variance == pytest.approx(1.0, rel=0.15)
    assert np.std(correlations) == pytest.approx((pooling.FREEDOM + 1.0) ** -0.5, rel=0.1)


def test_draws_count_as_the_likelihood_whatever_their_prior():
    """The same person, drawn under two priors that are divided out, is the same."""
    rng = np.random.default_rng(3)
    known = [np.array([[value]]) for value in (0.9, 1.1, 1.0, 0.8)]
    means = []
    for prior in (stats.norm(0.0, 2.0), stats.norm(1.0, 1.0)):
        # The likelihood is normal about 2, with deviation 0.7.
        precision = prior.std() ** -2 + 0.7**-2
        centre = (prior.mean() / prior.var() + 2.0 / 0.49) / precision
        drawn = centre + rng.standard_normal((4000, 1)) / np.sqrt(precision)
        base = [*[np.zeros(1)] * 4, -prior.logpdf(drawn[:, 0])]
        found = pooling.pool([*known, drawn], base, rng)
        means.append(found.weights[-1] @ drawn[:, 0])
    assert means[0] == pytest.approx(means[1], abs=0.05)
    assert 1.0 < means[0] < 1.9


# --- people ---------------------------------------------------------------------------------------


def test_a_correlation_of_the_prior_is_that_of_new_people(monkeypatch):
    """It was divided out and lost. Oracle: like people under a prior without, turned alike."""
    monkeypatch.setattr(pooling, "admissible", lambda thetas: np.full(len(thetas), True))
    matrix = np.eye(7)
    matrix[0, 1] = matrix[1, 0] = 0.9
    people, found = np.random.default_rng(3).standard_normal((4, 1, 7)), []
    for prior in (tl.Prior(), tl.Prior(correlation=matrix)):
        mean, deviation, whitening = (part[..., :7] for part in prior.vectors(0))
        target = SimpleNamespace(mean=mean, whitening=whitening)
        thetas = mean + people @ np.linalg.inv(whitening[:7]).T
        known = [SimpleNamespace(thetas=each, target=target) for each in thetas]
        rng = np.random.default_rng(1)
        new = pooling._new_people(pooling._pooled(known, prior, rng), prior, rng)
        found.append((new - mean) / deviation)
    alone, together = found
    np.testing.assert_allclose(together, alone @ np.linalg.cholesky(matrix).T, atol=1e-6)


def test_everyone_is_held_by_the_others(people):
    table = people.table()
    assert list(table) == ["mean", "sd", "ci_low", "ci_high", "alone_mean", "alone_sd"]
    assert table.index.get_level_values("person").unique().tolist() == ["0", "1", "2", "new person"]
    seen = table.drop("new person")
    weak = seen.xs("human_time_constant", level="parameter")
    assert weak["sd"].mean() < weak["alone_sd"].mean()
    new = table.loc["new person"]
    assert (new["sd"] > seen["sd"].groupby("parameter").mean()[new.index]).all()
    posterior = people.posterior("1")
    assert posterior.method == "population"
    assert len(posterior) == 500
    assert people.message.startswith(
        "3 people; of a new one they predict operator's time constant [s]"
    )
    assert "Population of 3" in people._repr_html_()
    with pytest.raises(ValueError, match="name"):
        people.posterior("4")


@pytest.mark.parametrize("names", [(1, "1"), ("ann", "new person")])
def test_two_people_of_one_name_are_refused(names):
    with pytest.raises(ValueError, match=f"people: '{names[1]}' names two rows"):
        tl.fit_population(dict.fromkeys(names))


def test_people_may_be_named_by_whole_numbers(people):
    """Their posteriors could not be had by any name."""
    numbered = replace(people, posteriors=dict(enumerate(people.posteriors.values())))
    assert numbered.posterior(1) is numbered.posterior("1") is [*people.posteriors.values()][1]
    with pytest.raises(ValueError, match=r"one of '0', '1'.*, got '77'"):
        numbered.posterior(77)


def test_what_is_predicted_is_the_next_ones_prior(people):
    log = group(np.random.default_rng(6), "slow", 1, 3.0)["0"]
    table = people.prior.table()
    new = people.new_person["human_beta"]
    assert table.loc["beta", "median"] == pytest.approx(new.median(), abs=0.08)
    wide = tl.sample_posterior(log).table()
    narrow = tl.sample_posterior(log, prior=people.prior).table()
    assert narrow.loc["robot_p_min", "sd"] < wide.loc["robot_p_min", "sd"]


def test_studies_draw_people_like_these(people):
    population = OperatorPopulation.of_people(people)
    drawn = population.draw(200)
    seconds = -0.1 / np.log(drawn["a_r"])
    expected = people.new_person["human_time_constant"].median()
    assert seconds.median() == pytest.approx(expected, rel=0.25)
    assert drawn["beta"].median() == pytest.approx(
        people.new_person["human_beta"].median(), abs=0.1
    )
    assert "3 people by fit_population" in population.origin
    bed = GroundRobot(laps=2, population=population)
    study = tl.virtual_study(n=4, conditions=["C1", "C3"], testbed=bed)
    assert set(study.participants["beta"]) == set(population.draw(4)["beta"])
    with pytest.raises(ValueError, match="fit_population"):
        OperatorPopulation.of_people(drawn)


# --- 120 groups of five people, as `make_coverage.py` stored them ---------------------------------

STORED = pd.read_csv(Path(__file__).with_name("populations.csv"))
COORDINATES = {"human_time_constant": np.log, "human_beta": logit, "robot_time_constant": np.log}


@pytest.mark.parametrize("noise", ["slow", "means"])
@pytest.mark.parametrize("origin", ORIGINS)
def test_groups_of_five(origin, noise):
    """95 % intervals cover 92 to 98 %."""
    rows = STORED[(STORED["origin"] == origin) & (STORED["noise"] == noise)]
    assert len(rows) == GROUPS * 5 * len(MODEL)
    covered = rows["truth"].between(rows["ci_low"], rows["ci_high"])
    assert 0.92 <= covered.mean() <= 0.98


def relative_errors(rows):
    """Errors of pooled estimates over those of each person alone, by noise and parameter."""
    ratios = []
    for (_, name), part in rows[rows["parameter"].isin(COORDINATES)].groupby(
        ["noise", "parameter"]
    ):
        of_name = part[["mean", "alone_mean"]].apply(COORDINATES[name])
        errors = of_name.sub(COORDINATES[name](part["truth"]), axis="index")
        pooled, alone = (errors**2).mean() ** 0.5
        ratios.append(pooled / alone)
    return ratios


def test_what_the_page_says_of_errors_is_true():
    words = " ".join((ROOT / "docs" / "how_to" / "identify.md").read_text().split())
    printed, *others = (relative_errors(STORED[STORED["origin"] == origin]) for origin in ORIGINS)
    others = np.concatenate(others)
    assert (len(printed), len(others)) == (6, 12)
    assert f"β were {min(others):.2f} to {max(others):.2f} times those of each person" in words
    assert f"but {min(printed):.2f} to {max(printed):.2f} times for the printed five" in words


@pytest.mark.long
def test_a_group_fitted_again_is_as_stored():
    again = population_of("prior", "means", 3).set_index(["person", "parameter"])
    rows = STORED.query("origin == 'prior' and noise == 'means' and number == 3")
    before = rows.astype({"person": str}).set_index(["person", "parameter"])
    # The same posterior, but a last bit, or another proposal, changes the draws: the ends of an
    # interval of somebody whose draws are worth 500 are some 8 % of its width apart (one standard
    # deviation).
    spread = before["ci_high"] - before["ci_low"]
    columns = ["mean", "ci_low", "ci_high"]
    changes = (again.loc[before.index, columns] - before[columns]).div(spread, axis="index")
    assert (changes.abs().max() < [0.08, 0.3, 0.3]).all()
    np.testing.assert_allclose(again.loc[before.index, "truth"], before["truth"], rtol=1e-6)
