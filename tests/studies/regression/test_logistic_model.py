"""
Logistic mixed models. Oracles: glmer of lme4 on published data (reference/logistic_model.R) and as
its manual prints it, the integral of the likelihood by another quadrature, logistic regression
without random effects, simulation.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, special, stats

import trustlab as tl
from trustlab.studies.regression.cumulative_model import (
    Logistic,
    log_likelihood,
    quadrature,
)

SETS = json.loads((Path(__file__).parents[1] / "reference" / "logistic_model.json").read_text())[
    "sets"
]


def fitted(name, **more):
    wanted = SETS[name]
    arguments = {
        "groups": wanted["groups"],
        "trials": wanted["trials"] or None,
        "points": wanted["points"],
    }
    return tl.formula_model(
        wanted["formula"], pd.DataFrame(wanted["data"]), family="binomial", **arguments | more
    )


def followed(seed=0, n=20, effect=0.0, sd=1.0):
    rng = np.random.default_rng(seed)
    frame = pd.DataFrame(
        {"who": np.repeat(range(n), 2), "condition": ["C2", "C4"] * n, "suggestions": 12}
    )
    eta = 0.5 + effect * (frame["condition"] == "C4") + sd * rng.standard_normal(n).repeat(2)
    return frame.assign(followed=rng.binomial(12, special.expit(eta)))


@pytest.mark.parametrize("name", SETS)
def test_agrees_with_lme4(name):
    wanted, found = SETS[name], fitted(name)
    table = found.table().set_index("term")
    for test in wanted["tests"]:
        row = table.loc[test["term"]]
        assert row["df"] == test["df"]
        assert row["chi2"] == pytest.approx(test["chi2"], abs=1e-7)
        assert row["p_chi2"] == pytest.approx(test["p"], rel=1e-7)
    coefficients = found.coefficients_table()
    np.testing.assert_allclose(coefficients["estimate"], wanted["estimate"], atol=5e-6)
    np.testing.assert_allclose(coefficients["se"], wanted["se"], rtol=1e-5)
    np.testing.assert_allclose(found.random_effects()["variance"], wanted["variance"], rtol=1e-4)
    # With several nodes lme4 gives the likelihood relative to the saturated model's, this one.
    omitted = -41.978353768934 if "nine points" in name else 0.0
    assert found.log_likelihood == pytest.approx(wanted["log_likelihood"] + omitted, abs=2e-8)


def test_agrees_with_the_printed_example_of_lme4():
    """
    summary(gm1) of help("glmer"): its inner search stops at 1e-7, which leaves 6e-4 in the
    estimates and 3e-4 in the likelihood.
    """
    found = fitted("Lesnoff and others (2004): lme4::cbpp, Laplace")
    rows = found.coefficients_table()
    np.testing.assert_allclose(rows["estimate"], [-1.3983, -0.9919, -1.1282, -1.5797], atol=6.5e-4)
    np.testing.assert_allclose(rows["se"], [0.2312, 0.3032, 0.3228, 0.4220], rtol=0.015)
    assert rows["z"].round(1).tolist() == [-6.0, -3.2, -3.5, -3.7]
    assert found.random_effects()["sd"].item() == pytest.approx(0.6421, abs=3e-4)
    assert round(found.log_likelihood, 1) == -92.0


def test_likelihood_is_the_integral():
    rng = np.random.default_rng(0)
    eta = rng.standard_normal(5)
    trials = np.array([3.0, 1.0, 10.0, 4.0, 40.0])
    sd = 1.7
    counts = np.array([0.0, 1.0, 7.0, 4.0, 39.0])

    def integrand(v):
        p = special.expit(eta + sd * v)
        return np.exp(
            (counts * np.log(p) + (trials - counts) * np.log1p(-p)).sum()
        ) * stats.norm.pdf(v)

    infinite = np.full(5, np.inf)
    # Failures lie below the threshold 0, successes above it.
    lower = np.concatenate([-infinite, -eta])
    upper = np.concatenate([-eta, infinite])
    weight = np.concatenate([trials - counts, counts])
    factor = np.array([[sd]])
    rows = (np.ones((10, 1)), weight, np.array([0, 10]))
    found = log_likelihood(lower, upper, *rows, factor, np.zeros((1, 1)), *quadrature(40, 1))
    scale = integrand(1.0)
    exact = integrate.quad(
        lambda v: integrand(v) / scale, -9.0, 9.0, points=[0.0, 1.0, 2.0], epsabs=0, epsrel=1e-12
    )[0]
    assert found == pytest.approx(np.log(exact) + np.log(scale), abs=1e-9)


def test_without_random_effects_it_is_logistic_regression():
    import statsmodels.api as sm

    frame = followed(1, sd=0.0, effect=-0.8).assign(who=lambda f: np.arange(len(f)) % 4)
    found = tl.formula_model(
        "followed ~ condition", frame, groups="who", family="binomial", trials="suggestions"
    )
    assert found.singular
    rest = frame["suggestions"] - frame["followed"]
    x = np.column_stack([np.ones(len(frame)), frame["condition"] == "C4"])
    plain = sm.GLM(np.column_stack([frame["followed"], rest]), x, sm.families.Binomial()).fit()
    np.testing.assert_allclose(found.coefficients["estimate"], plain.params, atol=1e-6)
    np.testing.assert_allclose(found.coefficients["se"], plain.bse, rtol=1e-4)


def test_order_of_rows_and_coding_of_outcomes():
    """Shuffled rows, and failures instead of successes, say the same."""
    frame = followed(1, effect=-1.0)
    turned = frame.assign(followed=frame["suggestions"] - frame["followed"]).sample(
        frac=1.0, random_state=0
    )
    one, other = (
        tl.formula_model(
            "followed ~ condition", f, groups="who", family="binomial", trials="suggestions"
        )
        for f in (frame, turned)
    )
    np.testing.assert_allclose(
        other.coefficients["estimate"], -one.coefficients["estimate"], atol=1e-5
    )
    np.testing.assert_allclose(other.table()["chi2"], one.table()["chi2"], atol=1e-8)


def test_bootstrap_and_draws():
    frame = followed(2, effect=-1.5)
    first, again = (
        tl.formula_model(
            "followed ~ condition",
            frame,
            groups="who",
            family="binomial",
            trials="suggestions",
            bootstrap=19,
            seed=1,
        )
        for _ in range(2)
    )
    pd.testing.assert_frame_equal(first.table(), again.table())
    assert first.table()["p_bootstrap"].item() == pytest.approx(0.05)
    codes = np.repeat(np.arange(4000), 2)
    model = Logistic(codes, np.full(8000, 12.0), 15)
    x = np.ones((8000, 1))
    drawn = model.draw(
        model.fit(followed(0, 4000, sd=1.3)["followed"].to_numpy(float), x),
        x,
        np.random.default_rng(0),
    )
    again = model.fit(drawn, x)
    assert again.sd == pytest.approx(1.3, abs=0.05)
    assert again.beta[0] == pytest.approx(0.5, abs=0.07)


def test_bad_input_names_what_is_wrong():
    frame = followed()
    give = {"groups": "who", "family": "binomial", "trials": "suggestions"}
    with pytest.raises(ValueError, match="row 3: 14 of 12 is no number of successes"):
        tl.formula_model(
            "followed ~ condition",
            frame.assign(followed=frame["followed"].where(frame.index != 3, 14)),
            **give,
        )
    with pytest.raises(ValueError, match='trials="…" names the column'):
        tl.formula_model("followed ~ condition", frame, groups="who", family="binomial")
    with pytest.raises(ValueError, match="random intercepts only"):
        tl.formula_model("followed ~ condition", frame, random="1 + condition", **give)
    with pytest.raises(ValueError, match="trials are of counts"):
        tl.formula_model("followed ~ condition", frame, groups="who", trials="suggestions")
    with pytest.raises(ValueError, match="family must be one of 'normal', 'binomial'"):
        tl.formula_model("followed ~ condition", frame, groups="who", family="poisson")
    never = frame.assign(followed=frame["followed"].where(frame["condition"] == "C2", 0))
    with pytest.raises(ValueError, match="separates successes from failures"):
        tl.formula_model("followed ~ condition", never, **give)


def test_people_who_always_answer_the_same_are_named():
    """Where nobody varies there is no estimate; where one person does not, there is."""
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"who": np.repeat(["P1", "P2", "P3", "P4"], 10), "mode": ["A", "B"] * 20})
    constant = frame.assign(followed=frame["who"].isin(["P2", "P4"]) * 1)
    give = {"groups": "who", "family": "binomial"}
    with pytest.raises(
        ValueError, match=r"groups \['P1', 'P3'\] never succeed and \['P2', 'P4'\] always do"
    ):
        tl.formula_model("followed ~ mode", constant, **give)
    answers = rng.integers(0, 2, 40)
    mixed = frame.assign(followed=np.where(frame["who"] == "P1", 0, answers))
    assert np.isfinite(tl.formula_model("followed ~ mode", mixed, **give).coefficients["se"]).all()
