"""
Cumulative-link mixed models. Oracles: clmm and clmm2 of R's ordinal (reference/ordinal_model.R)
and, for two categories, glmer of lme4 (reference/logistic_model.R) on published data and as its
manual prints it; the likelihood's integral by another quadrature, logistic regression, simulation.
"""

import json
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, special, stats

import trustlab as tl
from trustlab.studies.ordinal import Cumulative

REFERENCE = Path(__file__).parent / "reference"
R = json.loads((REFERENCE / "ordinal_model.json").read_text())
BINARY = json.loads((REFERENCE / "logistic_model.json").read_text())["sets"]
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


def outcomes(name):
    """A row for every success and failure of a reference, and how to fit them."""
    reference = BINARY[name]
    frame = pd.DataFrame(reference["data"])
    y = frame.pop(reference["formula"].split(" ~ ")[0])
    size = frame.pop(reference["trials"]) if reference["trials"] else y * 0 + 1
    long = frame.loc[frame.index.repeat(size)].reset_index(drop=True)
    long["outcome"] = np.concatenate([np.arange(m) < k for k, m in zip(y, size, strict=True)]) * 1
    call = {"dv": "outcome", "within": ["period"], "subject": reference["groups"]}
    if "btype" in frame:
        # A term without interactions: its levels come in as numbers.
        kinds = pd.get_dummies(long.pop("btype"), drop_first=True, dtype=float)
        long = long.join(kinds)
        call |= {"within": ["situ", "mode"], "covariates": [*kinds]}
    else:
        # A herd need not have every period.
        assert long.groupby("herd")["period"].nunique().max() == 4
    constant = special.gammaln(size + 1) - special.gammaln(y + 1) - special.gammaln(size - y + 1)
    return long, call | {"points": reference["points"]}, constant.sum()


@pytest.mark.parametrize("name", BINARY)
def test_two_categories_agree_with_lme4(name):
    reference = BINARY[name]
    frame, call, constant = outcomes(name)
    model = tl.ordinal_model(frame, **call)
    table = model.table().set_index("term")
    for test in reference["tests"]:
        if test["term"] == "btype":
            less = tl.ordinal_model(frame, **call | {"covariates": []})
            chi2 = 2.0 * (model.log_likelihood - less.log_likelihood)
            # Beside the interaction, as the term is in no other.
            assert chi2 == pytest.approx(test["chi2"], abs=1e-7)
            continue
        row = table.loc[test["term"]]
        assert row["df"] == test["df"]
        assert row["chi2"] == pytest.approx(test["chi2"], abs=1e-7)
        assert row["p_chi2"] == pytest.approx(test["p"], rel=1e-7)
    expected = dict(zip(reference["names"], reference["estimate"], strict=True))
    errors = dict(zip(reference["names"], reference["se"], strict=True))
    threshold = model.thresholds_table().iloc[0]
    assert threshold["estimate"] == pytest.approx(-expected["(Intercept)"], abs=5e-6)
    assert threshold["se"] == pytest.approx(errors["(Intercept)"], rel=1e-5)
    for row in model.coefficients_table().itertuples():
        key = row.name.replace("[T.", "").replace("]", "").replace("`", "")
        key = key if key in expected else f"btype{key}"
        assert row.estimate == pytest.approx(expected[key], abs=5e-6)
        assert row.se == pytest.approx(errors[key], rel=1e-5)
    variance = model.random_effects()["variance"].item()
    assert variance == pytest.approx(reference["variance"], rel=1e-4)
    # With several nodes lme4 gives the likelihood relative to the saturated model's.
    omitted = -41.978353768934 if "nine points" in name else 0.0
    likelihood = reference["log_likelihood"] + omitted
    assert model.log_likelihood + constant == pytest.approx(likelihood, abs=2e-8)


def test_without_random_effects_it_is_logistic_regression():
    import statsmodels.api as sm

    rng = np.random.default_rng(1)
    frame = pd.DataFrame({"who": np.arange(240) % 4, "condition": np.repeat(["C2", "C4"], 120)})
    frame["followed"] = rng.random(240) < special.expit(0.5 - 0.8 * (frame["condition"] == "C4"))
    model = tl.ordinal_model(frame.astype({"followed": int}), "followed", "condition", "who")
    assert model.singular
    x = sm.add_constant((frame["condition"] == "C4") * 1.0)
    plain = sm.GLM(frame["followed"] * 1.0, x, sm.families.Binomial()).fit()
    row = model.coefficients_table().iloc[0]
    assert row["estimate"] == pytest.approx(plain.params.iloc[1], abs=1e-6)
    assert row["se"] == pytest.approx(plain.bse.iloc[1], rel=1e-4)


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


def test_likelihood_is_the_integral_and_its_slopes_are_exact():
    """With few nodes, whose places matter, as with many."""
    rng = np.random.default_rng(0)
    ends = np.array([-np.inf, -1.0, 0.5, np.inf])
    category = np.array([0, 1, 2, 1, 2, 0])
    bounds = np.array([ends[category], ends[category + 1]]) - rng.standard_normal(6)
    weight = np.array([3.0, 1.0, 10.0, 4.0, 40.0, 1.0])
    sd = 1.7

    def integrand(v):
        chance = special.expit(bounds[1] - sd * v) - special.expit(bounds[0] - sd * v)
        return np.exp((weight * np.log(chance)).sum() + 45.0) * stats.norm.pdf(v)

    exact = integrate.quad(integrand, -9.0, 9.0, points=[-1.0, 0.0], epsabs=0, epsrel=1e-12)[0]
    many = Cumulative(np.zeros(6, dtype=int), 3, 40, weight)._integrals(bounds, sd)[0]
    assert many == pytest.approx(np.log(exact) - 45.0, abs=1e-9)
    for points in (1, 2, 15):
        model = Cumulative(np.array([0, 0, 1, 1, 2, 2]), 3, points, weight)
        _, by_bound, by_sd = model._integrals(bounds, sd)
        step = 1e-5

        def slope(move, by=0.0, model=model, step=step):
            ahead, behind = (
                model._integrals(bounds + sign * move, sd + sign * by)[0] for sign in (1, -1)
            )
            return (ahead - behind) / (2.0 * step)

        assert by_sd == pytest.approx(slope(0.0 * weight, step), abs=1e-7)
        for side, row in zip(*np.nonzero(np.isfinite(bounds)), strict=True):
            move = np.zeros((2, 6))
            move[side, row] = step
            assert by_bound[side, row] == pytest.approx(slope(move), abs=1e-7)


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


def ratings(n=20, seed=0):
    """Twelve ratings of each person, one to five, in four modes; the first half are novices."""
    rng = np.random.default_rng(seed)
    frame = pd.DataFrame({"subject": np.repeat(range(n), 12), "mode": [*"abcd"] * (3 * n)})
    frame["group"] = np.where(frame["subject"] < n // 2, "novice", "expert")
    latent = (frame["mode"] == "b") + 1.5 * (frame["mode"] == "c") + rng.logistic(size=len(frame))
    frame["trust"] = 1 + np.digitize(
        latent + 1.2 * rng.standard_normal(n)[frame["subject"]], [-1.5, -0.3, 0.6, 1.4]
    )
    return frame


def test_groups_sentences_and_speed():
    started = time.perf_counter()
    model = tl.ordinal_model(ratings(), "trust", "mode", between="group", order={"mode": [*"dcba"]})
    assert time.perf_counter() - started < 3.0
    assert model.table()["term"].tolist() == ["group", "mode", "group:mode"]
    assert model.probabilities()["mode"].unique().tolist() == [*"dcba"]
    assert (
        "A cumulative-link mixed model of trust with random intercepts (20 people, 240 ratings)"
        in model.apa()
    )
    assert "mode, χ²(3) = " in model.apa()
    assert "novice × c" in model.apa()
    assert model.apa() == model.message == tl.report(model).message
    binary = ratings().assign(trust=lambda f: (f["trust"] > 3) * 1)
    assert "A logistic mixed model" in tl.ordinal_model(binary, "trust", "mode").apa()
    between = tl.ordinal_model(ratings(), "trust", [], between="group")
    assert between.table()["term"].tolist() == ["group"]


def test_bootstrap_and_draws():
    frame = ratings(8)
    first, again = (
        tl.ordinal_model(frame, "trust", "mode", bootstrap=9, seed=1).table() for _ in range(2)
    )
    pd.testing.assert_frame_equal(first, again)
    assert 0.1 <= first["p_bootstrap"].item() <= 1.0
    codes = np.repeat(np.arange(1000), 4)
    model, x = Cumulative(codes, 3, 9), np.tile(np.eye(4)[:, 1:], (1000, 1))
    fit = model.fit(np.tile([0, 1, 2, 1], 1000), x)
    truth = fit._replace(beta=np.array([0.5, 1.0, -0.5]), thresholds=np.array([-1, 1.0]), sd=1.3)
    drawn = model.fit(model.draw(truth, x, np.random.default_rng(0)), x)
    assert drawn.sd == pytest.approx(1.3, abs=0.2)
    np.testing.assert_allclose(drawn.beta, truth.beta, atol=0.3)
    np.testing.assert_allclose(drawn.thresholds, truth.thresholds, atol=0.3)


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
    with pytest.raises(ValueError, match="one condition only"):
        tl.ordinal_model(WINE.assign(temp="cold"), "rating", **give)
    with pytest.raises(ValueError, match="the likelihood has no maximum"):
        tl.ordinal_model(WINE.assign(rating=(WINE["temp"] == "cold") * 1), "rating", **give)
    with pytest.raises(ValueError, match="points must be a whole number, from 1 to 100"):
        tl.ordinal_model(WINE, "rating", points=0, **give)
    with pytest.raises(ValueError, match="between: subject 0 has two labels in column 'mode'"):
        tl.ordinal_model(ratings(), "trust", [], between="mode")
    with pytest.raises(ValueError, match="within: column 'group' has one label for every person"):
        tl.ordinal_model(ratings(), "trust", "group")
    with pytest.raises(ValueError, match="within and between name no factor"):
        tl.ordinal_model(ratings(), "trust", [])
