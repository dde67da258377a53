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
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark
from scipy import stats
from scipy.special import logit

import trustlab as tl
from tests.cases import refused
from tests.house.documents import ROOT
from tests.identification.posterior.make_coverage import GROUPS, ORIGINS, PEOPLE, population_of
from tests.identification.posterior.simulated_logs import person_case
from trustlab import sample_posterior
from trustlab.identification.posterior import population as pooling
from trustlab.identification.posterior.result import MODEL
from trustlab.testbeds.populations import OperatorPopulation


def group(seed, count):
    """Three minutes of people spread as the printed five."""
    rng = default_rng(seed)
    means, spreads = PEOPLE.mean(axis=0), PEOPLE.std(axis=0, ddof=1)
    people = (means + spreads * rng.standard_normal(7) for _ in range(count))
    return {str(k): person_case(rng, each, "slow", 3.0)[0] for k, each in enumerate(people)}


pytestmark = mark.xdist_group("population")  # one worker fits the people of all


@pytest.fixture(scope="module")
def people():
    return tl.fit_population(group(5, 3), n=500)


# --- the Gibbs sampler ----------------------------------------------------------------------------


def test_people_and_their_population_have_the_moments_of_a_grid():
    """
    Four people known exactly, and draws of a fifth under priors that are divided out. Oracle: the
    likelihoods, integrated on a grid of the population's mean and spread.
    """
    values, rng = [0.3, 0.5, -0.2, 0.4], default_rng(1)
    mean = np.linspace(-3.0, 3.0, 301)[:, None]
    spread = np.linspace(1e-3, 4.0, 2000)
    # The fifth person's likelihood is normal about 2, with deviation 0.7.
    density = stats.norm.pdf(2.0, mean, np.hypot(spread, 0.7))
    density *= stats.norm.pdf(mean, scale=pooling.OF_MEAN**0.5)
    density *= stats.t.pdf(spread, pooling.FREEDOM, scale=pooling.SCALE)
    for value in values:
        density *= stats.norm.pdf(value, mean, spread)
    density /= density.sum()
    fifth = (mean / spread**2 + 2.0 / 0.49) / (spread**-2 + 1.0 / 0.49)
    for prior in (stats.norm(0.0, 2.0), stats.norm(-1.0, 1.0)):
        precision = 1.0 / prior.var() + 1.0 / 0.49
        centre = (prior.mean() / prior.var() + 2.0 / 0.49) / precision
        drawn = centre + rng.standard_normal((4000, 1)) / np.sqrt(precision)
        base = [*[np.zeros(1)] * 4, -prior.logpdf(drawn[:, 0])]
        found = pooling.pool([*(np.array([[x]]) for x in values), drawn], base, rng)
        assert found.means.mean() == approx((density * mean).sum(), abs=0.03)
        assert np.sqrt(found.covariances).mean() == approx((density * spread).sum(), abs=0.04)
        assert found.weights[-1] @ drawn[:, 0] == approx((density * fifth).sum(), abs=0.04)


def test_spreads_are_half_t_and_correlations_moderate_before_data():
    rng, drawn = default_rng(2), [np.eye(3)]
    for _ in range(20_000):
        drawn.append(pooling._covariance(np.empty((0, 3)), drawn[-1], rng))
    (first, both, _), (_, second, _), _ = np.transpose(drawn)
    # Half-t: the size of what is t-distributed.
    expected = pooling.SCALE * stats.t(pooling.FREEDOM).ppf([0.625, 0.75, 0.875])
    assert_allclose(np.quantile(first**0.5, [0.25, 0.5, 0.75]), expected, rtol=0.15)
    assert pooling.OF_MEAN + first.mean() == approx(1.0, rel=0.15)
    correlations = both / np.sqrt(first * second)
    assert correlations.std() == approx((pooling.FREEDOM + 1.0) ** -0.5, rel=0.1)


# --- people ---------------------------------------------------------------------------------------


def test_a_correlation_of_the_prior_is_that_of_new_people(monkeypatch):
    """It was divided out and lost. Oracle: like people under a prior without, turned alike."""
    monkeypatch.setattr(pooling, "admissible", lambda thetas: np.full(len(thetas), True))
    monkeypatch.setattr(pooling, "STEPS", 900)
    matrix = np.eye(7)
    matrix[0, 1] = matrix[1, 0] = 0.9
    people, found = default_rng(3).standard_normal((4, 1, 7)), []
    for prior in (tl.Prior(), tl.Prior(correlation=matrix)):
        mean, deviation, whitening = (part[..., :7] for part in prior.vectors(0))
        target = SimpleNamespace(mean=mean, whitening=whitening)
        thetas = mean + people @ np.linalg.inv(whitening[:7]).T
        known = [SimpleNamespace(thetas=each, target=target) for each in thetas]
        rng = default_rng(1)
        new = pooling._new_people(pooling._pooled(known, prior, rng), prior, rng)
        found.append((new - mean) / deviation)
    assert_allclose(found[1], found[0] @ np.linalg.cholesky(matrix).T, atol=1e-6)


def test_everyone_is_held_by_the_others(people):
    table = people.table()
    seen, new = table.drop("new person"), table.loc["new person"]
    weak = seen.xs("human_time_constant", level="parameter")
    assert weak["sd"].mean() < weak["alone_sd"].mean()
    assert (new["sd"] > seen["sd"].groupby("parameter").mean()[new.index]).all()
    assert people.posterior("1").method == "population"
    assert len(people.posterior("1")) == 500
    words = "3 people; of a new one they predict operator's time constant [s]"
    assert people.message.startswith(words)
    assert "Population of 3" in people._repr_html_()


@mark.parametrize("names", [(1, "1"), ("ann", "new person")])
def test_two_people_of_one_name_are_refused(names):
    with refused(f"people: '{names[1]}' names two rows"):
        tl.fit_population(dict.fromkeys(names))


def test_people_may_be_named_by_whole_numbers(people):
    """Their posteriors could not be had by any name."""
    posteriors = [*people.posteriors.values()]
    numbered = replace(people, posteriors=dict(enumerate(posteriors)))
    assert numbered.posterior(1) is numbered.posterior("1") is posteriors[1]
    with refused(r"one of '0', '1'.*, got '77'"):
        numbered.posterior(77)


def test_what_is_predicted_is_the_next_ones_prior(people):
    (log,) = group(6, 1).values()
    median = people.prior.table()["median"]["beta"]
    assert median == approx(people.new_person["human_beta"].median(), abs=0.08)
    wide, narrow = (
        sample_posterior(log, prior=each).table()["sd"]["robot_p_min"]
        for each in ("weak", people.prior)
    )
    assert narrow < wide


def test_studies_draw_people_like_these(people):
    population = OperatorPopulation.of_people(people)
    drawn, new = population.draw(200).median(), people.new_person.median()
    assert -0.1 / np.log(drawn["a_r"]) == approx(new["human_time_constant"], rel=0.25)
    assert drawn["beta"] == approx(new["human_beta"], abs=0.1)
    assert "3 people by fit_population" in population.origin


# --- 120 groups of five people, as `make_coverage.py` stored them ---------------------------------

STORED = pd.read_csv(Path(__file__).with_name("populations.csv"))
COORDINATES = {"human_time_constant": np.log, "human_beta": logit, "robot_time_constant": np.log}


def test_groups_of_five():
    """95 % intervals cover 92 to 98 %."""
    inside = STORED["truth"].between(STORED["ci_low"], STORED["ci_high"])
    covered = inside.groupby([STORED["origin"], STORED["noise"]]).agg(["size", "mean"])
    assert [*covered["size"]] == [GROUPS * 5 * len(MODEL)] * 6
    assert covered["mean"].between(0.92, 0.98).all()


def relative_errors(origin):
    """Errors of pooled estimates over those of each person alone, by noise and parameter."""
    rows, ratios = STORED[STORED["origin"] == origin], []
    for (_, name), part in rows.groupby(["noise", "parameter"]):
        if name in COORDINATES:
            values = part[["mean", "alone_mean", "truth"]].apply(COORDINATES[name])
            errors = values.sub(values.pop("truth"), axis="index")
            pooled, alone = (errors**2).mean() ** 0.5
            ratios.append(pooled / alone)
    return ratios


def test_what_the_page_says_of_errors_is_true():
    words = " ".join((ROOT / "docs" / "how_to" / "identify.md").read_text().split())
    printed, *others = map(relative_errors, ORIGINS)
    others = np.concatenate(others)
    assert f"β were {min(others):.2f} to {max(others):.2f} times those of each person" in words
    assert f"but {min(printed):.2f} to {max(printed):.2f} times for the printed five" in words


@mark.long
def test_a_group_fitted_again_is_as_stored():
    rows = STORED.query("origin == 'prior' and noise == 'means' and number == 3")
    before, again = rows.reset_index(drop=True), population_of("prior", "means", 3)
    # The same posterior, but a last bit, or another proposal, changes the draws: the ends of an
    # interval of somebody whose draws are worth 500 are some 8 % of its width apart (one standard
    # deviation).
    spread = before["ci_high"] - before["ci_low"]
    for column, most in (("mean", 0.08), ("ci_low", 0.3), ("ci_high", 0.3)):
        assert ((again[column] - before[column]).abs() < most * spread).all()
    assert_allclose(again["truth"], before["truth"], rtol=1e-6)
