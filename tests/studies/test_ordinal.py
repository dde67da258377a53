"""
Cumulative-link mixed models. Oracles: clmm of R's ordinal (reference/ordinal_model.R)
and, for two categories, glmer of lme4 (reference/logistic_model.R) on published data and as its
manual prints it; the likelihood's integral by another quadrature, closed forms, simulation;
rejections counted by clmm on studies that R drew (reference/ordinal_power.R).
"""

import contextlib
import itertools

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy import integrate, optimize, stats
from scipy.special import binom, expit, log_expit, logit

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import approx, drawn, parametrize, reference
from trustlab.studies.ordinal import Cumulative

R = reference("ordinal_model")
BINARY = reference("logistic_model")["sets"]
WINE = pd.DataFrame(R["wine"])
POWER = reference("ordinal_power")
BELOW = logit(np.cumsum(POWER["first"])[:-1])


@pytest.fixture(scope="module")
def wine():
    return tl.ordinal_model(WINE, "rating", ["temp", "contact"], "judge", points=9)


def test_agrees_with_clmm(wine):
    expected, table = R["interaction"], wine.coefficients_table()
    for name, thresholds in (("estimate", "thresholds"), ("se", "thresholds_se")):
        theirs = expected[name] + expected[thresholds]
        assert_allclose(table[name], theirs, atol=1e-5)
    variance = wine.random_effects()["variance"].item()
    assert variance == approx(expected["covariance"][0][0], abs=1e-5)
    assert wine.log_likelihood == approx(expected["log_likelihood"], abs=1e-8)
    assert wine.table()["chi2"].to_numpy() == approx([*R["tests"].values()], abs=1e-5)


def test_a_covariate_agrees_with_clmm2():
    """One called answer was taken for the ratings."""
    frame = pd.DataFrame(R["verbal"]).rename(columns={"answer": "rating"})
    frame["answer"] = (frame["mode"] == frame["mode"].max()) * 1.0
    model = tl.ordinal_model(frame, "rating", "situ", "id", covariates=["answer"])
    assert model.log_likelihood == approx(R["proportional"]["location"], abs=1e-4)


def outcomes(name):
    """A row for every success and failure of a reference, and how to fit them."""
    own = BINARY[name]
    frame = pd.DataFrame(own["data"])
    y = frame.pop(own["formula"].split(" ~ ")[0])
    size = frame.pop(own["trials"]) if own["trials"] else y * 0 + 1
    long = frame.loc[frame.index.repeat(size)].reset_index(drop=True)
    long["outcome"] = np.concatenate([np.arange(m) < k for k, m in zip(y, size, strict=True)]) * 1
    call = {"dv": "outcome", "within": ["period"], "subject": own["groups"]}
    if "btype" in frame:
        # A term without interactions: its levels come in as numbers.
        kinds = pd.get_dummies(long.pop("btype"), drop_first=True, dtype=float)
        long = long.join(kinds)
        call |= {"within": ["situ", "mode"], "covariates": [*kinds]}
    return long, call | {"points": own["points"]}, np.log(binom(size, y)).sum()


@parametrize("name", BINARY)
def test_two_categories_agree_with_lme4(name):
    own = BINARY[name]
    frame, call, constant = outcomes(name)
    model = tl.ordinal_model(frame, **call)
    table = model.table().set_index("term")
    for test in own["tests"]:
        if test["term"] == "btype":
            less = tl.ordinal_model(frame, **call | {"covariates": []})
            chi2 = 2.0 * (model.log_likelihood - less.log_likelihood)
        else:
            chi2, *others = table.loc[test["term"], ["chi2", "df", "p_chi2"]]
            assert others == approx([test["df"], test["p"]], rel=1e-7)
        assert chi2 == approx(test["chi2"], abs=1e-7)
    found = model.coefficients_table()
    found.index = found["name"].str.replace(r"\[T\.|\]|`", "", regex=True)
    found.loc["(Intercept)"] = found.loc["0 | 1"] * [1, -1, *[1] * 5]
    found = found.loc[[name.removeprefix("btype") for name in own["names"]]]
    assert_allclose(found["estimate"], own["estimate"], rtol=0.0, atol=5e-6)
    assert_allclose(found["se"], own["se"], rtol=1e-5)
    variance = model.random_effects()["variance"].item()
    assert variance == approx(own["variance"], rel=1e-4)
    # With several nodes lme4 gives the likelihood relative to the saturated model's.
    omitted = -41.978353768934 if "nine points" in name else 0.0
    likelihood = own["log_likelihood"] + omitted
    assert model.log_likelihood + constant == approx(likelihood, abs=2e-8)


def test_likelihood_is_the_integral():
    """With the answers of a person, some of them given many times."""
    ends = np.array([-np.inf, -1.0, 0.5, np.inf])
    kinds = [0, 1, 2, 1, 2, 0], np.random.default_rng(0).standard_normal(6)
    category, shift = np.repeat(kinds, [3, 1, 10, 4, 40, 1], axis=1)
    category = category.astype(int)
    bounds = ends[[category, category + 1]] - shift
    sd = 1.7

    def integrand(v):
        chance = expit(bounds[1] - sd * v) - expit(bounds[0] - sd * v)
        return np.exp(np.log(chance).sum() + 45.0) * stats.norm.pdf(v)

    exact = integrate.quad(integrand, -9.0, 9.0, points=[-1.0, 0.0], epsabs=0, epsrel=1e-12)[0]
    model = Cumulative(category, np.zeros(59, dtype=int), 40)
    found = model.log_likelihood(np.array([1.0, *ends[1:3], sd]), shift[:, None])
    assert found == approx(np.log(exact) - 45.0, abs=1e-9)


@parametrize("sd", [0.0, 1.0, 30.0, -1000.0])
@parametrize("cut", [0.0, 40.0, -4000.0, 1e6])
def test_likelihood_far_from_its_maximum_is_that_about_the_greatest_integrand(sd, cut):
    """A search goes there on its way. Oracle: Laplace's approximation about a root by bisection."""
    model = Cumulative(np.array([0, 1, 1, 1]), np.zeros(4, dtype=int), 1)

    def slope(v):
        low, high = expit(cut - sd * v), expit(sd * v - cut)
        return sd * (3.0 * low - high) - v

    v = optimize.bisect(slope, -1e6, 1e6, xtol=1e-14, rtol=1e-15, maxiter=200)
    logs = log_expit(cut - sd * v) + 3.0 * log_expit(sd * v - cut) - 0.5 * v**2
    bend = 1.0 + 4.0 * sd**2 * expit(cut - sd * v) * expit(sd * v - cut)
    found = model.log_likelihood(np.array([0.0, cut, sd]), np.zeros((4, 1)))
    assert found == approx(logs - 0.5 * np.log(bend), rel=1e-9)


def test_errors_where_people_do_not_vary_are_those_of_a_model_without_people():
    """The likelihood is flat in the SD, to its fourth power."""
    answers = [*itertools.product(range(3), repeat=2)] * 2
    frame = pd.DataFrame({"who": np.repeat(range(18), 2), "mode": [*"ab"] * 18})
    model = tl.ordinal_model(frame.assign(rating=np.ravel(answers)), "rating", "mode", "who")
    assert model.singular
    # Every rating has the probability 1/3, and the logistic density at both thresholds is 2/9.
    of_answer = 3.0 * (2.0 / 9.0) ** 2 * np.array([[2.0, -1.0], [-1.0, 2.0]])
    slopes = np.array([[[effect, 1.0, 0.0], [effect, 0.0, 1.0]] for effect in (0.0, -1.0)])
    information = 18.0 * (slopes.mT @ of_answer @ slopes).sum(axis=0)
    expected = np.sqrt(np.diag(np.linalg.inv(information)))
    assert_allclose(model.coefficients_table()["se"], expected, rtol=1e-4)


def test_answers_drawn_from_the_model_are_as_it_says(wine):
    """Of many people, the shares of ratings; of two answers of the median person, the higher."""
    cells = wine.probabilities()
    inside = (cells["ci_low"] < cells["probability"]) & (cells["probability"] < cells["ci_high"])
    assert inside.all()
    rng, draws = np.random.default_rng(0), 200_000
    effects, cuts = np.split(wine.coefficients_table()["estimate"].to_numpy(), [3])
    people = wine.random_effects()["sd"].item() * rng.standard_normal(draws)
    rating = np.searchsorted(cuts, effects.sum() + people + rng.logistic(size=draws))
    assert_allclose(np.bincount(rating) / draws, cells.tail(5)["probability"], atol=0.004)
    pair = wine.pairs().set_index(["a", "b"]).loc[("cold × no", "warm × yes")]
    assert pair["odds_ratio"] == approx(np.exp(-effects.sum()))
    a = np.searchsorted(cuts, rng.logistic(size=draws))
    b = np.searchsorted(cuts, rng.logistic(size=draws) + effects.sum())
    share = (a > b).mean() + 0.5 * (a == b).mean()
    assert pair["superiority"] == approx(share, abs=0.004)


TRUST = {"dv": "trust", "within": "mode", "subject": "person"}


def ratings():
    """Twelve ratings of each person, one to five, in four modes; the first half are novices."""
    frame = drawn(20, mode="abcd", trial=range(3))
    latent = 1.5 * frame["score"] + (frame["mode"] == "b") + 1.5 * (frame["mode"] == "c")
    return frame.assign(trust=1 + np.digitize(latent, [-1.5, -0.3, 0.6, 1.4]))


def test_groups_and_sentences():
    frame = ratings()
    model = tl.ordinal_model(frame, **TRUST, between="group", order={"mode": [*"dcba"]})
    assert model.probabilities()["mode"].unique().tolist() == [*"dcba"]
    sentence = "A cumulative-link mixed model of trust with random intercepts (20 people, 240 obs"
    for words in (sentence, "mode, χ²(3) = ", "group:mode, χ²", "novice × c"):
        assert words in model.apa()
    frame["trust"] = (frame["trust"] > 3) * 1
    binary = tl.ordinal_model(frame, **TRUST | {"within": [], "between": "group"})
    assert "A logistic mixed model" in binary.apa()
    assert binary.table()["term"].tolist() == ["group"]


@parametrize(
    ("trust", "factors", "message"),
    [
        ([1.0, np.inf] * 120, {}, "dv: column 'trust' holds inf in row 5"),
        ("high", {}, "neither numbers nor an ordered categorical"),
        (1, {}, "has 1 different ratings, not 2 to 30"),
        (range(240), {}, r"235 different ratings.*formula_model"),
        (1, {"within": "group"}, "within: column 'group' has one label for every person"),
        (1, {"within": []}, "within and between name no factor"),
        # The subject was taken for one, beside its random intercept.
        ([1, 2] * 120, {"covariates": ["person"]}, "columns must be different for every argument"),
        ([1, 2] * 120, {"covariates": "word"}, "covariates: column 'word' holds 'y' in row 5"),
    ],
)
def test_what_cannot_be_fitted_is_refused(trust, factors, message):
    with refused(message):
        tl.ordinal_model(ratings().assign(trust=trust, word="y")[5:], **TRUST | factors)


def answered(rng, n, per_condition, sd, shift):
    """Ratings of people under two conditions, on the categories whose shares R had."""
    frame = drawn(n, condition=range(2), trial=range(per_condition))
    latent = sd * rng.standard_normal(n)[frame["person"]] + shift * frame["condition"]
    return frame.assign(rating=np.searchsorted(BELOW, latent + rng.logistic(size=len(frame))))


@pytest.mark.long
@parametrize("case", POWER["cases"], ids=str)
def test_power_is_the_share_of_rejections_in_r(case):
    """
    Two binomial counts of one probability, within four standard errors. A study whose likelihood
    has no maximum is refused here; clmm stops somewhere.
    """
    rng, rejected = np.random.default_rng(3), []
    for _ in range(300):
        frame = answered(rng, case["n"], 1, case["sd"], case["shift"])
        with contextlib.suppress(ValueError):
            model = tl.ordinal_model(frame, "rating", "condition", "person")
            rejected.append(model.p_chi2 < 0.05)
    assert len(rejected) >= 297
    power, other = np.mean(rejected), case["rejected"] / POWER["replicates"]
    middle = 0.5 * (power + other)
    error = np.sqrt(middle * (1.0 - middle) * (1.0 / 300 + 1.0 / POWER["replicates"]))
    assert abs(power - other) <= 4.0 * error


@pytest.mark.long
def test_intervals_of_probabilities_cover_as_they_say():
    """30 people, two conditions, two ratings in each; the truth is an integral over people."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    sd, shift, studies = 1.2, 0.8, 150
    shifts = np.array([0.0, shift])[:, None, None]
    below = expit(BELOW[:, None] - shifts - sd * nodes)
    truth = np.diff(below @ weights / weights.sum(), prepend=0.0, append=1.0)
    rng = np.random.default_rng(0)
    hits = []
    for _ in range(studies):
        frame = answered(rng, 30, 2, sd, shift)
        cells = tl.ordinal_model(frame, "rating", "condition", "person").probabilities()
        right = truth[cells["condition"].astype(int), cells["category"].astype(int)]
        hits.extend((cells["ci_low"] <= right) & (right <= cells["ci_high"]))
    share = np.mean(hits)
    # Ten intervals of a study depend on each other; studies do not.
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], studies, 0.95) / studies
    assert low <= share <= high


def test_names_and_levels_may_be_numbers():
    """Columns that are called by numbers were not found, and pairs of levels were texts."""
    frame = ratings().replace({"mode": {"a": 1, "b": 2, "c": 10, "d": 20}})
    texts = tl.ordinal_model(frame, **TRUST, covariates=["trial"])
    numbered = frame.rename(columns={"trust": 2, "mode": 3, "trial": 4})
    found = tl.ordinal_model(numbered, 2, 3, "person", covariates=4)
    pd.testing.assert_frame_equal(found.pairs(), texts.pairs())
    assert found.pairs()["b"].tolist() == [2, 10, 20, 10, 20, 20]
    np.testing.assert_array_equal(found.probabilities(), texts.probabilities())
    assert found.probabilities().columns[0] == 3
    with refused("1 are numbers in a formula; rename the column"):
        tl.ordinal_model(numbered.rename(columns={3: 1}), 2, 1, "person")


@parametrize("name", ["category", "probability"])
def test_a_factor_named_like_a_column_of_probabilities_is_refused(name):
    """It was renamed category_x, or probabilities took its place."""
    model = tl.ordinal_model(ratings().rename(columns={"mode": name}), "trust", name, "person")
    with refused(f"'{name}' is the name of a factor and of a statistic; rename"):
        model.probabilities()


def test_a_condition_that_all_answer_alike_is_refused():
    """The estimate was 20, its standard error 3,400, and p < .001."""
    answers = np.random.default_rng(0).integers(0, 2, (12, 6))
    answers[:, 3:] = 1
    frame = pd.DataFrame({"s": np.repeat(range(12), 6), "c": list("aaabbb") * 12})
    with refused("the likelihood has no maximum"):
        tl.ordinal_model(frame.assign(y=answers.ravel()), "y", "c", "s")
