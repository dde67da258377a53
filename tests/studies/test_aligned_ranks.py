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
