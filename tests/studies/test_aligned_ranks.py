"""
The aligned rank transform. Oracles: alignment written out in R with afex, lmerTest and emmeans on
published data (reference/aligned_ranks.R); the figures that ARTool prints for its own data sets,
where those are at hand; theorems.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.studies.pairs import aligned

SETS = json.loads((Path(__file__).parent / "reference" / "aligned_ranks.json").read_text())["sets"]
ARTOOL = tl.sessions.external_data("artool")
printed_by_artool = pytest.mark.skipif(
    ARTOOL is None,
    reason="needs the data sets of R's ARTool (GPL, not shipped) in data/external/artool",
)


def analysed(name):
    own = SETS[name]
    frame = pd.DataFrame(own["columns"]).sample(frac=1.0, random_state=0)
    return tl.repeated_measures(
        frame, own["dv"], own["within"], own["id"], between=own["between"] or None
    )


def two_way(seed=0, n=10):
    rng = np.random.default_rng(seed)
    cells = pd.MultiIndex.from_product(
        [range(n), ["low", "high"], ["a", "b", "c"]], names=["who", "x", "y"]
    )
    frame = cells.to_frame(index=False).assign(group=lambda f: np.where(f["who"] < 4, "g", "h"))
    return frame.assign(v=rng.exponential(size=len(frame)) + rng.standard_normal(n).repeat(6))


@pytest.mark.parametrize("name", SETS)
def test_tests_and_contrasts_agree_with_r(name):
    result = analysed(name)
    found = {
        error: {
            frozenset(row["effect"].split(" × ")): row
            for row in result.aligned_ranks(error).to_dict("records")
        }
        for error in ("own", "pooled")
    }
    for theirs in SETS[name]["effects"]:
        key = frozenset(theirs["effect"].split(":"))
        assert found["own"][key]["F"] == pytest.approx(theirs["F"], rel=1e-9)
        if "F_pooled" in theirs:
            assert found["pooled"][key]["F"] == pytest.approx(
                theirs["F_pooled"], rel=1e-5
            )  # lmer's own search
            assert found["pooled"][key]["df2"] == pytest.approx(theirs["df_pooled"], rel=1e-4)
    for theirs in SETS[name]["contrasts"]:
        ours = result.pairs(theirs["factor"], theirs["at"], method="aligned_ranks", error="pooled")
        rows = {(row["level"], row["a"], row["b"]): row for row in ours.to_dict("records")}
        for level, contrast, estimate, t, df in zip(
            *(theirs[x] for x in ("level", "contrast", "estimate", "t", "df")), strict=True
        ):
            a, b = (
                label.removeprefix(theirs["factor"]) for label in contrast.split(" - ")
            )  # as of angle0
            sign, row = (1, rows[level, a, b]) if (level, a, b) in rows else (-1, rows[level, b, a])
            assert sign * row["mean_difference"] == pytest.approx(estimate, abs=1e-9)
            assert sign * row["t"] == pytest.approx(t, rel=1e-5, abs=1e-9)
            assert row["df"] == pytest.approx(df, rel=1e-3)


@printed_by_artool
def test_higgins_table_5_as_artool_prints_it():
    """
    README of ARTool 0.11.2: F 23.833, 122.402, 5.118; tests/testthat/test.art.con.R: t of
    ARTool.exe and JMP.
    """
    frame = pd.read_csv(ARTOOL / "Higgins1990Table5.csv")
    result = tl.repeated_measures(frame, "DryMatter", ["Fertilizer"], "Tray", between="Moisture")
    table = result.aligned_ranks("pooled").set_index("effect")
    assert table["F"].round(3).tolist() == [23.833, 122.402, 5.118]
    assert table[["df1", "df2"]].to_numpy().tolist() == [[3, 8], [3, 24], [9, 24]]
    np.testing.assert_allclose(table["p"], [0.00024199, 1.1124e-14, 0.00064665], rtol=1e-4)
    pairs = result.pairs("Moisture", method="aligned_ranks", error="pooled")
    printed = [-5.606839446, -8.197725544, -3.68391617, -2.590886098, 1.9229232756, 4.5138093733]
    np.testing.assert_allclose(pairs["t"], printed, rtol=1e-9)
    first = result.pairs("Fertilizer", "Moisture", method="aligned_ranks", error="pooled").iloc[0]
    assert first["t"] == pytest.approx(-1.107980814, rel=1e-9)
    across = result.pairs("Moisture", "Fertilizer", method="aligned_ranks", error="pooled").iloc[0]
    assert across["t"] == pytest.approx(-3.036288461, rel=1e-9)


@printed_by_artool
def test_three_factors_as_artool_prints_them():
    """tests/testthat: HigginsABC (the original ARTool) and ElkinABC (ARTool.exe and JMP)."""
    frame = pd.read_csv(ARTOOL / "HigginsABC.csv")
    result = tl.repeated_measures(frame, "Y", ["C"], "Subject", between=["A", "B"])
    table = result.aligned_ranks("pooled").set_index("effect")["F"].round(4)
    printed = [120.4706, 120.4706, 14.3217, 81.92, 0.1259, 0.2319, 0.9715]
    assert table[["A", "B", "C", "A × B", "A × C", "B × C", "A × B × C"]].tolist() == printed
    result = tl.repeated_measures(pd.read_csv(ARTOOL / "ElkinABC.csv"), "Y", ["A", "B", "C"], "S")
    assert result.pairs("A", method="aligned_ranks", error="pooled")["t"].item() == pytest.approx(
        -16.98, abs=0.005
    )
    assert result.pairs("B", "A", method="aligned_ranks", error="pooled")["t"][0] == pytest.approx(
        -0.072115146, rel=1e-7
    )
    assert result.pairs("A", "B", method="aligned_ranks", error="pooled")["t"][0] == pytest.approx(
        -14.74754746, rel=1e-8
    )


def test_other_effects_are_gone():
    """
    In a balanced design the aligned scores have no other effect: before they are ranked, other F
    are 0.
    """
    frame = two_way()
    shifted = frame.assign(v=frame["v"] + 50.0 * (frame["y"] == "b") + 9.0 * (frame["x"] == "low"))
    for own, more in ((frame, shifted),):
        results = [tl.repeated_measures(f, "v", ["x", "y"], "who") for f in (own, more)]
        ranks = [aligned(x.scores.values, x.design, ("x", "y")) for x in results]
        np.testing.assert_array_equal(*ranks)


def test_own_error_is_pooled_error_where_all_contrasts_are_one():
    """Two levels within: one contrast, so that both error terms are the same."""
    frame = two_way()[lambda f: f["y"] == "a"]
    result = tl.repeated_measures(frame, "v", ["x"], "who", between="group")
    own, pooled = result.aligned_ranks(), result.aligned_ranks("pooled")
    np.testing.assert_allclose(own["F"], pooled["F"], rtol=1e-12)
    for method in ("t", "aligned_ranks"):
        pd.testing.assert_frame_equal(
            result.pairs("x", method=method),
            result.pairs("x", method=method, error="pooled"),
            rtol=1e-10,
            check_dtype=False,  # pooled degrees of freedom need not be whole
        )


def test_ranks_of_one_factor_need_no_alignment():
    """Oracle: the ANOVA of the ranks of all scores (Conover and Iman, 1981)."""
    frame = two_way()[lambda f: f["y"] == "a"]
    ranked = frame.assign(v=frame["v"].rank())
    tests = tl.repeated_measures(frame, "v", "x", "who").aligned_ranks()
    np.testing.assert_allclose(tests["F"], tl.repeated_measures(ranked, "v", "x", "who").F)


def test_faults_are_named():
    plain = tl.repeated_measures(two_way(), "v", ["x", "y"], "who")
    with pytest.raises(ValueError, match="error must be one of 'own', 'pooled'"):
        plain.aligned_ranks("residual")
    with pytest.raises(ValueError, match="method must be one of 't', 'aligned_ranks'"):
        plain.pairs("x", method="wilcoxon")
    with pytest.raises(ValueError, match="'z' is not a factor"):
        plain.pairs("z", method="aligned_ranks")


def test_ratings_are_noted():
    frame = two_way()
    rated = frame.assign(v=np.clip(np.round(frame["v"]), 1, 5))
    assert "aligned_ranks()" in tl.repeated_measures(rated, "v", ["x", "y"], "who").notes[0]
    assert tl.repeated_measures(frame, "v", ["x", "y"], "who").notes == ()
