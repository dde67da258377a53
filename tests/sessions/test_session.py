"""The session table: what it holds, what it refuses, what it says of itself. Oracle: by hand."""

import pickle
from contextlib import nullcontext

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from tests.cases import refused
from trustlab.sessions.vocabulary import UNITS, to_si

T = np.arange(11) * 0.1


def session(metadata=None, t=T, **columns):
    frame = pd.DataFrame({"mode": 1.0, **columns}, index=t)
    return tl.Session(frame, metadata or tl.Metadata())


def test_a_session_knows_its_time_and_names():
    whole = session(p_r=0.5)
    assert (whole.sample_time, whole.duration, len(whole)) == (0.1, 1.0, 11)
    table = whole.table()
    assert list(whole) == whole.keys() == list(table) == ["t", "mode", "p_r"]
    assert whole.columns == ["mode", "p_r"]
    assert {len(values) for values in dict(whole).values()} == {11}
    assert ("t" in whole, "p_h" in whole) == (True, False)
    whole.require("t", "mode")
    again = tl.Session(table)
    table.loc[:, "mode"] = 0.0
    assert again == whole
    for key in (0, ["p_r"]):
        with refused(r"by a column's name, got .*table is \.data"):
            whole[key]


@pytest.mark.parametrize("share", [0.9, 1.1, np.nan])
@pytest.mark.parametrize("rows", [[7], [3, 7], [10]])
def test_a_step_may_differ_by_one_per_cent_of_the_median(share, rows):
    t = T.copy()
    t[rows] += share * 0.01 * 0.1
    fault = "sampling is irreg" if share > 1.0 else "time is nan"
    with nullcontext() if share < 1.0 else refused(f"row {rows[0]}, column t: {fault}"):
        assert session(t=t).t.tolist() == t.tolist()


@pytest.mark.parametrize(
    ("value", "row"), [(np.nan, 0), (np.inf, 7), (-np.inf, 10), (1.5, 7), (-0.1, 10)]
)
def test_the_first_value_that_is_missing_or_out_of_range_is_named(value, row):
    mode = np.ones(11)
    mode[row] = mode[-1] = value
    words = rf"the log\.csv: row {row}, column 'mode', t = {0.1 * row:.6g} s: {value} "
    with refused(words):
        session(tl.Metadata(source="the log.csv"), mode=mode)


def test_metadata_travels_and_can_be_added():
    facts = tl.Metadata(participant=3, condition="C1", synthetic=True, more={"trial": 2})
    first = session(facts)
    assert first.label == "operator 3, C1, trial 2, synthetic"
    assert repr(first).endswith("columns mode; metadata.more: trial>")
    changed = first.with_metadata(condition=0.4, block=1)
    assert changed.label == "operator 3, condition 0.4, trial 2, synthetic"
    own = {"participant": 3, "condition": 0.4, "source": None, "synthetic": True}
    assert changed.metadata.as_dict() == own | {"trial": 2, "block": 1}
    assert first.metadata == facts
    assert pickle.loads(pickle.dumps(changed)) == changed
    assert changed != first
    assert changed.with_metadata(source="elsewhere") == changed
    assert session().label == "session"


def test_added_columns():
    whole = session()
    values = np.linspace(0, 1, 11)
    more = whole.with_columns(p_r=values, r=0.3)
    assert more.columns == ["mode", "p_r", "r"]
    assert (more["r"] == 0.3).all()
    assert more == more.with_columns(mode=1.0) == tl.Session(more.data[["r", "p_r", "mode"]])
    assert whole.columns == ["mode"]
    # A series is taken by place.
    assert whole.with_columns(p_r=pd.Series(values, T[::-1]), r=0.3) == more
    for wrong in ([1.0, 2.0], np.zeros((11, 2))):
        with refused(r"column 'p_r' is of shape \(.*, .* 11 samples"):
            whole.with_columns(p_r=wrong)


@pytest.mark.parametrize(
    ("ends", "rows"),
    [((0.0, 0.3), slice(4)), ((0.3, 0.6), slice(3, 7)), ((0.21, 0.59), slice(3, 6))],
)
def test_a_part_holds_the_samples_at_its_ends_and_has_facts_of_its_own(ends, rows):
    """0.30000000000000004 s was cut off by between(0.0, 0.3)."""
    whole = session()
    part = whole.between(*ends)
    assert part.t.tolist() == T[rows].tolist()
    part.metadata.more["excluded"] = True
    assert "excluded" not in whole.metadata.more
    with refused(r"2\.0 s and 3\.0 s; the session runs from 0 s to 1 s"):
        whole.between(2.0, 3.0)


def test_units_against_their_definitions():
    expected = {"km": 1e3, "cm": 1e-2, "mm": 1e-3, "min": 60, "h": 3600, "km/h": 1000 / 3600}
    expected |= {"deg": np.pi / 180, "%": 0.01}
    for unit, factor in expected.items():
        assert to_si(unit, UNITS[unit][0]) == pytest.approx(factor, rel=1e-15)
    assert to_si("km/h", "measure") == to_si("km/h", "m/s")
    assert tl.sessions.vocabulary().loc["path_error", ["unit", "low"]].tolist() == ["m", 0.0]


def test_manual_phases_are_shaded_by_the_share_of_the_operator():
    mode = [1.0, 1, 0, 0, 0, 0, 0.5, 0.5, 0.5, 0.5, 0.5]
    (bars,) = session(mode=mode, p_r=0.5).plot("p_r")[0].collections
    ends = [[path.get_extents().x0, path.get_extents().x1] for path in bars.get_paths()]
    assert_allclose(ends, [[0.0, 0.2], [0.2, 0.6], [0.6, 1.0]])
    assert_allclose(bars.get_facecolor()[:, 3], [0.2, 0.0, 0.1])
    plt.close("all")


def test_paths_and_means_of_several_sessions():
    places = [f"{who}_{axis}" for who in ("human", "robot", "reference") for axis in "yz"]
    real = session(tl.Metadata(participant=1), **dict.fromkeys(places, 0.5))
    axes = tl.sessions.plot_paths([real, real.with_metadata(synthetic=True)], plane="yz")
    assert [axis.get_title() for axis in axes] == ["participant 1", "operator 1, synthetic"]
    assert axes[0].figure.get_suptitle() == "synthetic data"
    assert axes[0].get_xlabel() == "y [m]"
    rows = [(1, 0.0, 1.0), (1, 0.0, 3.0), (1, 0.5, 4.0), (2, 0.0, 6.0), (2, 0.5, 8.0)]
    table = pd.DataFrame(rows, columns=["participant", "autonomy", "error"])
    mean = tl.sessions.plot_by_participant(table, "error").lines[-1]
    assert mean.get_ydata().tolist() == [4.0, 6.0]
    plt.close("all")


def test_columns_and_metadata_have_names(tmp_path):
    with refused("column 0 is not in the vocabulary"):
        tl.Session(pd.DataFrame(np.zeros((3, 1)), [0.0, 0.1, 0.2]))
    with refused("metadata 3 would not read back the same"):
        tl.write_session(session(tl.Metadata(more={3: "x"})), tmp_path / "a.csv")


def test_a_file_written_again_keeps_who_may_read_it_and_links(tmp_path):
    """Participants' data could be read by all from the second time on."""
    file, link = tmp_path / "a.csv", tmp_path / "b.csv"
    file.touch(mode=0o600)
    link.symlink_to(file)
    tl.write_session(session(), link)
    assert link.is_symlink()
    assert file.stat().st_mode & 0o777 == 0o600
    assert tl.read_session(file) == session()
