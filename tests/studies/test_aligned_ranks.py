"""
The aligned rank transform. Oracles: alignment written out in R with afex, lmerTest and emmeans on
published data (reference/aligned_ranks.R); the figures that ARTool prints for its own data sets,
where those are at hand; theorems.
"""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.studies.scores import drawn, reference
from trustlab.studies.pairs import aligned

SETS = reference("aligned_ranks")["sets"]
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


@pytest.mark.parametrize("name", SETS)
def test_tests_and_contrasts_agree_with_r(name):
    result = analysed(name)
    own, pooled = (
        {frozenset(row["effect"].split(" × ")): row for row in table.to_dict("records")}
        for table in (result.aligned_ranks("own"), result.aligned_ranks("pooled"))
    )
    for theirs in SETS[name]["effects"]:
        key = frozenset(theirs["effect"].split(":"))
        assert own[key]["F"] == pytest.approx(theirs["F"], rel=1e-9)
        if "F_pooled" in theirs:  # by lmer's own search
            assert pooled[key]["F"] == pytest.approx(theirs["F_pooled"], rel=1e-5)
            assert pooled[key]["df2"] == pytest.approx(theirs["df_pooled"], rel=1e-4)
    for theirs in SETS[name]["contrasts"]:
        ours = result.pairs(theirs["factor"], theirs["at"], method="aligned_ranks", error="pooled")
        rows = {(row["level"], row["a"], row["b"]): row for row in ours.to_dict("records")}
        for row in pd.DataFrame(theirs).itertuples():
            # A contrast is named as "angle0 - angle4".
            a, b = (x.removeprefix(row.factor) for x in row.contrast.split(" - "))
            sign = 1 if (row.level, a, b) in rows else -1
            found = rows[row.level, a, b] if sign == 1 else rows[row.level, b, a]
            assert sign * found["mean_difference"] == pytest.approx(row.estimate, abs=1e-9)
            assert sign * found["t"] == pytest.approx(row.t, rel=1e-5, abs=1e-9)
            assert found["df"] == pytest.approx(row.df, rel=1e-3)


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
    frame = drawn(10, x="lh", y="abc")
    shift = 50.0 * (frame["y"] == "b") + 9.0 * (frame["x"] == "l")
    results = [
        tl.repeated_measures(frame.assign(score=score), "score", ["x", "y"], "person")
        for score in (frame["score"], frame["score"] + shift)
    ]
    ranks = [aligned(x.scores.values, x.design, ("x", "y")) for x in results]
    np.testing.assert_array_equal(*ranks)
