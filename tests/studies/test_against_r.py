"""
Oracle: R (afex, car, stats, nlme), values in reference/reference.json made by
reference/make_reference.R.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from tests.studies.scores import COLUMNS, approx, long, parametrize, reference

STUDIES = reference("reference")["studies"]
TOLERANCE = 1e-9  # of the unit, or relative for what is not of order 1; the issue asks for 1e-6
LOOSER = {
    # R's own sums lose these digits: scores of order 1 on an offset of a million
    "large_offset": 3e-7,
    "small_unit": 1e-7,  # R's own, a spread of a millionth on an offset of 2
    "very_large_effect": 1e-8,
}
NUMBERS = ["F", "df1", "df2", "p", "mauchly_w", "mauchly_p", "epsilon_gg", "p_gg", "p_hf"]
NUMBERS += ["epsilon_hf_untruncated", "eta2_partial", "eta2_generalized"]
# pf(ncp = …) and uniroot of R are good to some 1e-8
BY_SEARCH = ["eta2_partial_low", "eta2_partial_high"]
SMALL = ["p", "p_gg", "p_hf", "mauchly_p"]


def scores_of(study):
    """Rows in scrambled order, missing cells as NaN."""
    data = np.array(study["data"], dtype=float)
    return long(data, range(1, data.shape[1] + 1)).sample(frac=1.0, random_state=0)


def agree(ours, theirs, tolerance, what):
    """Where R has a number, ours is it; NaN is none."""
    ours, theirs = np.asarray(ours, dtype=float), np.asarray(theirs, dtype=float)
    near = np.abs(ours - theirs) <= tolerance * np.maximum(1.0, np.abs(theirs))
    assert near[np.isfinite(theirs)].all(), f"{what}: {ours} | {theirs}"


@pytest.fixture(scope="module", params=STUDIES)
def both(request):
    """The study, its analysis here, and the digits that R itself has."""
    study = STUDIES[request.param]
    missing = "listwise" if study["complete"] < len(study["data"]) else "raise"
    result = tl.repeated_measures(scores_of(study), **COLUMNS, missing=missing)
    return study, result, LOOSER.get(request.param, TOLERANCE)


def test_omnibus(both):
    study, result, tolerance = both
    for numbers, error in ((NUMBERS, tolerance), (BY_SEARCH, max(tolerance, 1e-7))):
        for number in numbers:
            if study[number] is not None:
                agree(getattr(result, number), study[number], error, number)
    relative = 1e-7 if tolerance == TOLERANCE else 1e-5
    for number in SMALL:
        if study[number] is not None:
            assert getattr(result, number) == approx(study[number], rel=relative), number
    assert_allclose(result.pairs()["p"], study["pairs"]["p"], rtol=relative)


def test_descriptives_and_ranks(both):
    study, result, _ = both
    stats, found = result.descriptives(), result.friedman().loc[0]
    assert_allclose(stats["mean"], study["mean"], rtol=1e-12)
    assert_allclose(stats["sd"], study["sd"], rtol=1e-9)
    assert_allclose(stats[["ci_low", "ci_high"]], study["ci"], rtol=1e-11)
    assert (stats["n"] == study["complete"]).all()
    for number in ("chi2", "df", "p"):
        agree(found[number], study[f"friedman_{number}"], 1e-11, number)
    most = study["complete"] * found["df"]
    assert found["kendall_w"] == approx(study["friedman_chi2"] / most, abs=1e-12)


def test_pairs_and_normality(both):
    study, result, tolerance = both
    pairs, normality, theirs = result.pairs(), result.normality(), study["pairs"]
    for column in ("a", "b"):
        assert pairs[column].tolist() == np.atleast_1d(theirs[column]).tolist()
    for column in pairs.columns[2:].difference(["d_z_low", "d_z_high"]):  # test_pairs.py
        agree(pairs[column], theirs[column], tolerance, column)
    agree(normality["W"], theirs["shapiro_w"], 1e-7, "Shapiro W")
    agree(normality["p"], theirs["shapiro_p"], 1e-6, "Shapiro p")


@parametrize("name", [name for name in STUDIES if STUDIES[name]["mixed_F"] is not None])
def test_mixed_model_against_nlme(name):
    study = STUDIES[name]
    found = tl.mixed_model(scores_of(study), **COLUMNS)
    assert found.df2 == study["mixed_df2"]
    # nlme stops there: test_mixed.py is tighter
    assert study["mixed_F"] == approx(found.F, rel=2e-6)


def test_a_wrong_value_is_seen():
    study = STUDIES["four_conditions_sphericity_violated"]
    with pytest.raises(AssertionError, match="epsilon"):
        agree(study["epsilon_gg"] + 1e-8, study["epsilon_gg"], TOLERANCE, "epsilon")
