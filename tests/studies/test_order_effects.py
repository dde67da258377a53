"""
Orders of conditions. Oracles: R's lm on full and reduced models (reference/order_effects.R), SciPy,
simulation.
"""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.studies.scores import reference

SETS = reference("order_effects")["sets"]


def run(frame):
    return tl.order_effects(frame, "score", "condition", "position", subject="subject")


def effects_of(frame):
    return run(frame).table().set_index("effect")


def frame_of(name):
    return pd.DataFrame(SETS[name]["data"]).astype({"position": int, "condition": int})


def williams():
    frame = tl.latin_square_design([*"ABCD"], 8, seed=0).orders()
    rng = np.random.default_rng(0)
    score = rng.standard_normal(32) + rng.standard_normal(8).repeat(4)
    return frame.rename(columns={"participant": "subject"}).assign(score=score)


@pytest.mark.parametrize("name", SETS)
def test_agrees_with_r(name):
    found = effects_of(frame_of(name))
    for effect in ("position", "condition", "carry_over", "condition_without_carry_over"):
        for number, wanted in SETS[name][effect].items():
            if wanted is None or SETS[name][effect]["F"] is None:
                continue
            assert found.loc[effect, number] == pytest.approx(wanted, rel=1e-9), (effect, number)
    pairs = run(frame_of(name)).pairs()
    for row, (a, b, mean, error) in zip(pairs.itertuples(), SETS[name]["pairs"], strict=True):
        assert (row.a, row.b) == (a, b)
        assert row.mean_difference == pytest.approx(mean, rel=1e-8)
        assert row.mean_difference / row.t == pytest.approx(error, rel=1e-8)


def test_two_periods_do_not_separate_carry_over_and_say_so():
    found = effects_of(frame_of("two conditions"))
    assert "not estimable" in found.loc["carry_over", "note"]
    assert np.isnan(found.loc["carry_over", "F"])
    assert np.isfinite(found.loc["condition_without_carry_over", "F"])


def test_adjusted_differences_do_not_see_carry_over_and_raw_means_do():
    """
    A carry-over of 3 from D: the conditions after D are raised; unbalanced, as one order is left
    out.
    """
    frame = williams()
    before = frame.sort_values(["subject", "position"]).groupby("subject")["condition"].shift()
    clean = run(frame).pairs()
    carried = run(frame.assign(score=frame["score"] + 3.0 * (before == "D"))).pairs()
    np.testing.assert_allclose(carried["mean_difference"], clean["mean_difference"], atol=1e-9)
    np.testing.assert_allclose(carried["p"], clean["p"], rtol=1e-6)


def test_a_score_that_is_missing_is_named():
    with pytest.raises(ValueError, match="subject 1 has no score in condition 3"):
        run(williams().drop(index=2))
