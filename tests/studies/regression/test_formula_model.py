"""
Mixed models by formula. Oracles: lme4 on published data (reference/formula_model.R), the model of
one factor, simulation.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import trustlab as tl

SETS = json.loads((Path(__file__).parents[1] / "reference" / "formula_model.json").read_text())[
    "sets"
]


def trials(seed=0, n=8, effect=0.0):
    rng = np.random.default_rng(seed)
    frame = pd.DataFrame(
        {
            "who": np.repeat(range(n), 6),
            "mode": ["A", "B", "C"] * (2 * n),
            "trial": np.tile(range(6), n) * 1.0,
        }
    )
    score = (
        rng.standard_normal(len(frame))
        + rng.standard_normal(n).repeat(6)
        + effect * (frame["mode"] == "C")
    )
    return frame.assign(error=score)


@pytest.mark.parametrize("name", SETS)
def test_agrees_with_lme4(name):
    reference = SETS[name]
    fit = tl.formula_model(
        reference["formula"],
        pd.DataFrame(reference["data"]),
        groups=reference["groups"],
        random=reference["random"],
    )
    assert fit.log_likelihood == pytest.approx(reference["log_likelihood"], abs=1e-9)
    assert fit.singular == reference["singular"]
    table = fit.table().set_index("term")
    for test in reference["tests"]:
        row = table.loc[test["term"]]
        assert row["df"] == test["df"]
        assert row["chi2"] == pytest.approx(test["chi2"], abs=1e-7)
        assert row["p_chi2"] == pytest.approx(test["p"], rel=1e-7)
    coefficients = fit.coefficients_table()
    np.testing.assert_allclose(coefficients["estimate"], reference["estimate"], rtol=1e-8)
    np.testing.assert_allclose(coefficients["se"], reference["se"], rtol=1e-6)
    np.testing.assert_allclose(fit.random_effects()["variance"], reference["variances"], rtol=1e-5)


def test_the_unit_of_the_score_does_not_matter():
    one, other = (
        tl.formula_model("error ~ mode", f, groups="who")
        for f in (trials(), trials().assign(error=lambda f: 1e6 * f["error"]))
    )
    np.testing.assert_allclose(other.table()["chi2"], one.table()["chi2"], rtol=1e-6)
    np.testing.assert_allclose(
        other.coefficients["estimate"], 1e6 * one.coefficients["estimate"], rtol=1e-6
    )


def test_bootstrap():
    """Same seed, same p; an effect is found; the p is a share of draws."""
    first, again = (
        tl.formula_model("error ~ mode", trials(effect=1.5), groups="who", bootstrap=19, seed=3)
        for _ in range(2)
    )
    pd.testing.assert_frame_equal(first.table(), again.table())
    assert first.table()["p_bootstrap"].item() == pytest.approx(0.05)
    none = tl.formula_model("error ~ mode", trials(1), groups="who", bootstrap=19, seed=3).table()
    assert none["p_bootstrap"].item() > 0.05
    assert "19 simulated data sets" in first._repr_html_()


@pytest.mark.parametrize("kind", ["synthetic", "reconstructed"])
def test_origin_is_said(kind):
    frame = trials()
    frame.attrs[kind] = True
    found = tl.formula_model("error ~ trial", data=frame, groups="who")
    assert (
        found.origin
        == found.table().attrs["origin"]
        == found.coefficients.attrs["origin"]
        == f"{kind} data"
    )


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (lambda f: f, {"formula": "error ~ modes"}, "formula 'error ~ modes'.*modes"),
        (lambda f: f, {"formula": "error"}, "formula must be"),
        (lambda f: f, {"groups": "whom"}, "groups: no column 'whom'; did you mean 'who'"),
        (lambda f: f, {"random": 1}, "random must be of class str"),
        (
            lambda f: f.assign(trial=np.nan),
            {"formula": "error ~ trial"},
            "48 rows have a missing or infinite value",
        ),
        (
            lambda f: f.assign(twice=f["trial"]),
            {"formula": "error ~ trial + twice"},
            "linearly dependent",
        ),
        (lambda f: f.assign(error=1.0), {}, "every score is 1"),
        (lambda f: f[f["who"] < 2], {}, "has 2 groups"),
        (lambda f: None, {}, "data must be of class DataFrame"),
    ],
)
def test_bad_models_are_refused(change, arguments, message):
    options = {"formula": "error ~ mode", "groups": "who"} | arguments
    with pytest.raises(ValueError, match=message):
        tl.formula_model(options.pop("formula"), change(trials()), **options)


def test_an_unknown_reference_level_is_refused_with_the_formula():
    with pytest.raises(ValueError, match=r"formula .*'Z'.*is not among the provided levels"):
        tl.formula_model("error ~ C(mode, contr.treatment('Z'))", trials(), groups="who")
