"""
The aligned rank transform. Oracles: alignment written out in R with afex, lmerTest and emmeans on
published data (reference/aligned_ranks.R); the figures that ARTool prints for its own data sets,
where those are at hand; theorems.
"""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.studies.scores import analysed_set, drawn, reference
from trustlab.studies.pairs import aligned

SETS = reference("aligned_ranks")["sets"]


@pytest.mark.parametrize("name", SETS)
def test_tests_and_contrasts_agree_with_r(name):
    result = analysed_set(SETS[name])
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
