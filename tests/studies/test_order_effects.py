"""
Orders of conditions. Oracles: R's lm on full and reduced models (reference/order_effects.R), SciPy,
simulation.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import trustlab as tl

SETS = json.loads((Path(__file__).parents[0] / "reference" / "order_effects.json").read_text())[
    "sets"
]


def run(frame, **more):
    columns = {
        "dv": "score",
        "condition": "condition",
        "position": "position",
        "subject": "subject",
    }
    return tl.order_effects(frame, **(columns | more))


def frame_of(name):
    return pd.DataFrame(SETS[name]["data"]).astype({"position": int, "condition": int})


def williams(n=12, seed=0, effect=0.0):
    frame = tl.latin_square_design(["A", "B", "C", "D"], n, seed=seed).orders()
    rng = np.random.default_rng(seed)
    score = (
        rng.standard_normal(len(frame))
        + rng.standard_normal(n).repeat(4)
        + effect * (frame["condition"] == "D")
    )
    return frame.rename(columns={"participant": "subject"}).assign(score=score)


@pytest.mark.parametrize("name", SETS)
def test_agrees_with_r(name):
    found = run(frame_of(name)).table().set_index("effect")
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
    found = run(frame_of("two conditions")).table().set_index("effect")
    assert "not estimable" in found.loc["carry_over", "note"]
    assert np.isnan(found.loc["carry_over", "F"])
    assert np.isfinite(found.loc["condition_without_carry_over", "F"])


def test_adjusted_differences_do_not_see_carry_over_and_raw_means_do():
    """
    A carry-over of 3 from D: the conditions after D are raised; unbalanced, as one order is left
    out.
    """
    frame = williams(8)
    before = frame.sort_values(["subject", "position"]).groupby("subject")["condition"].shift()
    clean = run(frame).pairs()
    carried = run(frame.assign(score=frame["score"] + 3.0 * (before == "D"))).pairs()
    np.testing.assert_allclose(carried["mean_difference"], clean["mean_difference"], atol=1e-9)
    np.testing.assert_allclose(carried["p"], clean["p"], rtol=1e-6)


@pytest.mark.parametrize("studies", [100, pytest.param(300, marks=pytest.mark.long)])
def test_type_one_error(studies):
    rejected = [
        run(williams(8, seed)).table().set_index("effect")["p"] < 0.05 for seed in range(studies)
    ]
    share = pd.concat(rejected, axis=1).mean(axis=1)
    assert (share < 0.05 + 4.0 * np.sqrt(0.05 * 0.95 / studies)).all()
    assert run(williams(12, effect=3.0)).table().set_index("effect").loc["condition", "p"] < 0.001


@pytest.mark.parametrize(
    ("change", "more", "message"),
    [
        (lambda f: f.drop(index=2), {}, "dv: subject 1 has no score at position 3"),
        (lambda f: f, {"order": ["A"]}, "order must list every condition"),
        (lambda f: f.to_numpy(), {}, "frame must be of class DataFrame"),
    ],
)
def test_bad_tables_are_refused(change, more, message):
    with pytest.raises(ValueError, match=message):
        run(change(williams()), **more)
