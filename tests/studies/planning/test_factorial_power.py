"""
Power of designs with several factors and groups. Oracles: the noncentral F in closed form; a plain
loop of tl.repeated_measures over data drawn here; theorems (no effect: the level).
"""

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from tests.studies.planning.settings import settled
from tests.studies.scores import drawn
from trustlab.studies import graded_covariance

mpl.use("Agg")
CELLS = pd.MultiIndex.from_product(
    [["low", "high"], ["easy", "medium", "hard"]], names=["autonomy", "difficulty"]
)
MEANS = pd.Series([0.0, 0.3, 0.1, 0.2, 0.6, 0.7], CELLS)
TWO_WAY = {"covariance": graded_covariance(6, 0.5), "within": ["autonomy", "difficulty"]}
MIXED = pd.Series({("g", 0.0): 0.0, ("g", 1.0): 0.3, ("h", 0.0): 0.0, ("h", 1.0): 0.8})


def within_simulation_error(found, exact, replicates, sds=4.0):
    return abs(found - exact) < sds * np.sqrt(exact * (1 - exact) / replicates) + 1e-12


@pytest.mark.parametrize(
    ("mean", "design"),
    [
        (MEANS, TWO_WAY),
        (MIXED, {"covariance": graded_covariance(2, 0.4), "within": "test", "between": "group"}),
    ],
)
def test_simulation_agrees_with_the_closed_form(mean, design):
    table = settled(tl.power_analysis, mean, n=[12, 24], replicates=4000, **design).table()
    closed = table[table["closed_form"].notna()]
    assert set(closed["effect"]) == set(table["effect"])
    for row in closed.itertuples():
        assert within_simulation_error(row.power, row.closed_form, row.replicates), row


def test_closed_form_is_the_noncentral_f_written_out():
    """
    Autonomy has one contrast: d_z of the mean difference; difficulty by sums of squares of the
    marginal means.
    """
    table = settled(tl.power_analysis, MEANS, n=24, replicates=100, **TWO_WAY).table()
    closed = table[table["test"] == "none"].set_index("effect")["closed_form"]
    wide = MEANS.to_numpy().reshape(2, 3)
    difference = np.diff(wide.mean(axis=1)).item() ** 2
    variance = 2.0 / 3.0 * (1.0 - 0.5)  # of a difference of means of three cells
    exact = stats.ncf.sf(stats.f.isf(0.05, 1, 23), 1, 23, 24 * difference / variance)
    assert closed["autonomy"] == pytest.approx(exact, abs=1e-10)
    spread = ((wide.mean(axis=0) - wide.mean()) ** 2).sum() * 2
    exact = stats.ncf.sf(stats.f.isf(0.05, 2, 46), 2, 46, 24 * spread / (1.0 - 0.5))
    assert closed["difficulty"] == pytest.approx(exact, abs=1e-10)


def test_a_pilot_study_is_the_population():
    """Oracle: means and pooled covariance of the groups, given as such."""
    order = {"autonomy": ["low", "high"], "difficulty": ["easy", "medium", "hard"]}
    frame = drawn(20, **order)
    frame.attrs["synthetic"] = True
    columns = {"within": [*order], "between": "group"}
    pilot = {"dv": "score", "subject": "person", "order": order}
    small = {"n": 8, "replicates": 200}
    found = settled(tl.power_analysis, data=frame, **small, **columns, **pilot)
    wide = frame.pivot_table(index=["group", "person"], columns=[*order], values="score")
    wide = wide[list(CELLS)]
    residual = wide - wide.groupby("group").transform("mean")
    index = pd.MultiIndex.from_tuples([(g, *cell) for g in ("expert", "novice") for cell in CELLS])
    mean = pd.Series(wide.groupby("group").mean().to_numpy().ravel(), index)
    given = settled(tl.power_analysis, mean, residual.T @ residual / 18, **small, **columns)
    pd.testing.assert_frame_equal(found.table(), given.table(), rtol=1e-9)
    assert "synthetic data" in found.origin
    assert "synthetic data" in found.plot().get_title()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mean": MEANS.iloc[:-1]}, r"mean: no number for cell \('high', 'hard'\) of autonomy"),
        ({"effect_size": 0.2}, "effect_size has no effect here"),
    ],
)
def test_faults_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        settled(tl.power_analysis, **{"mean": MEANS, "replicates": 100} | TWO_WAY | arguments)
