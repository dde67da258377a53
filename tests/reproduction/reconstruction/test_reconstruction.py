"""
Reconstructed data have every printed statistic.

The oracle is an analysis written from the textbook definitions (tests/textbook.py).
"""

import json

import numpy as np
import pytest
from scipy import stats

import trustlab as tl
from tests import textbook
from tests.reproduction.cases import study_of
from trustlab import PublishedStudy, reconstruct
from trustlab.reproduction import ReconstructionError
from trustlab.reproduction.reconstruction import search

parametrize = pytest.mark.parametrize

STUDIES = tl.published_studies()
SLIPS = {"teleop.tracking_error": {"anova.df1"}}


def values_of(study, frame):
    """Rows of people; textbook.misses looks at their number."""
    return frame.pivot_table("value", "subject", "condition")[[*study.conditions]].to_numpy()


def misses(study, frame):
    """Printed statistics that the data do not have, as the study corrects by ε."""
    values = values_of(study, frame)
    factor = textbook.analysed(values)["epsilon"] if study.corrected else 1.0
    return textbook.misses(study, values, factor, factor)


@pytest.mark.slow
@parametrize("name", STUDIES)
@parametrize("seeds", [2, pytest.param(20, marks=pytest.mark.long)])
def test_every_seed_has_all_printed_statistics(name, seeds):
    study, seen = STUDIES[name], set()
    for seed in range(seeds):
        frame = reconstruct(study, seed=seed)
        assert misses(study, frame) == SLIPS.get(name, set())
        assert frame.attrs["p_adjust"] == "bonferroni"
        assert set(frame.attrs["left_out"]) == SLIPS.get(name, set())
        assert frame["value"].between(*study.scale).all()
        seen.add(round(frame["value"].iloc[0], 9))
    assert len(seen) == seeds


def test_the_comparison_sees_a_change():
    study = STUDIES["uav.tlx"]
    frame = reconstruct(study, 0)
    frame.loc[frame["condition"] == "C3", "value"] += 0.5
    assert {"mean.C3", "anova.F", "pairs.C2-C3"} <= misses(study, frame)


def test_data_say_that_they_are_reconstructed():
    attrs = reconstruct(STUDIES["teleop.tracking_error"], 0).attrs
    assert attrs["reconstructed"] is True
    assert "not measurements" in attrs["note"]
    assert json.loads(json.dumps(attrs)) == attrs
    assert "2.425" in attrs["left_out"]["anova.df1"]


def test_missing_cells_are_inferred():
    cells = "n = 24, scale = 1 to 7, mean.A = 5.00, mean.B = 4.20, sd.A = 1.00, sd.B = 1.10"
    tests = "pairs.A-B = 0.020, anova.F = 6.20, anova.df1 = 2, anova.df2 = 46"
    study = study_of(f"{cells}, {tests}", conditions=(*"ABC",))
    values = values_of(study, reconstruct(study))
    assert 1.0 < values[:, 2].mean() < 7.0
    # Means, SDs and p of A and B are printed: the correlation is pinned down by var(a − b) = n (m_a
    # − m_b)²/t², but for their rounding.
    t = stats.t.ppf(0.020 / 3 / 2, 23)
    exact = (1.0**2 + 1.1**2 - 24 * 0.8**2 / t**2) / (2 * 1.0 * 1.1)
    assert abs(np.corrcoef(values[:, :2].T)[0, 1] - exact) < 0.05


def edge(name):
    """A study that prints the statistics of true data at an edge, and of few people."""
    rng, digits, scale = np.random.default_rng(0), 2, (-np.inf, np.inf)
    if name.startswith("p = "):
        cells = "n = 10, mean.A = 5.0, mean.B = 5.0, sd.A = 1.0, sd.B = 1.1"
        return study_of(f"{cells}, t_test.t = 0.00, t_test.{name}")
    if name == "right or wrong":
        values = rng.normal(size=(24, 1)) + rng.normal(size=(24, 3)) + [0.0, 0.5, 1.0]
        values, scale = (values > -0.3).astype(float), (0.0, 1.0)
    elif name == "means printed equal":
        values = rng.normal(size=(20, 4)) * 0.2 + rng.normal(size=(20, 1)) * 0.2
        values, digits = values - values.mean(axis=0) + [4.96, 5.03, 5.01, 5.0], 1
    elif name == "F of 100,000":
        values = rng.normal(size=(20, 1)) + rng.normal(size=(20, 3)) * 0.014 + [0.0, 0.6, 1.2]
    else:
        n, k = map(int, name.split(" in "))
        values = rng.normal(size=(n, k)) + 0.5 * np.arange(k)
    found = textbook.analysed(values)
    anova = textbook.printed_anova(found, values.shape)
    del anova["p"]
    cells = textbook.printed_cells(found, digits, 2)
    return PublishedStudy("s", len(values), **cells, anova=anova, scale=scale)


EDGES = ["right or wrong", "means printed equal", "F of 100,000", "3 in 3", "4 in 4", "3 in 5"]
EDGES += ["4 in 6", "p = 1.000", "p = .999", "p = 1", "p = >.999"]


def test_no_data_is_an_error_that_says_what_the_closest_miss(monkeypatch):
    """Unadjusted, the pairs of this study are too far apart for its F."""
    monkeypatch.setattr(search, "STARTS", 6)
    with pytest.raises(ReconstructionError, match="starts; the closest miss "):
        reconstruct(STUDIES["uav.human_performance"], p_adjust="none")


def test_where_no_pairs_are_printed_one_adjustment_is_tried(monkeypatch):
    """Of its pairs nothing is known; the spread of C can be cancelled by A and B in part only."""
    monkeypatch.setattr(search, "STARTS", 3)
    cells = "mean.A = 0.00, mean.B = 1.00, mean.C = 2.00, sd.A = 1.00, sd.B = 1.00, sd.C = 10.00"
    with pytest.raises(ReconstructionError, match="p_adjust='bonferroni': No data"):
        reconstruct(study_of(f"n = 10, {cells}, anova.F = 0.21"))


@parametrize("name", EDGES)
def test_true_studies_at_the_edge_are_found(name):
    study = edge(name)
    frame = reconstruct(study)
    assert frame.attrs["left_out"] == {}
    assert textbook.misses(study, values_of(study, frame)) == set()
