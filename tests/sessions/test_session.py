"""The session table: what it holds, what it refuses, what it says of itself. Oracle: by hand."""

import pickle
from contextlib import nullcontext

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.sessions.vocabulary import UNITS, to_si


def frame(n=11, **columns):
    return pd.DataFrame({"mode": np.ones(n), **columns}, index=np.arange(n) * 0.1)


def test_a_session_knows_its_time_and_names():
    session = tl.Session(frame(p_r=0.5))
    assert (session.sample_time, session.duration, len(session)) == (0.1, 1.0, 11)
    table = session.table()
    assert list(session) == session.keys() == list(table) == ["t", "mode", "p_r"]
    assert session.columns == ["mode", "p_r"]
    assert {len(values) for values in dict(session).values()} == {11}
    assert ("t" in session, "p_h" in session) == (True, False)
    session.require("t", "mode")
    again = tl.Session(table)
    table.loc[:, "mode"] = 0.0
    assert again == session
    for key in (0, ["p_r"]):
        with pytest.raises(tl.SessionError, match=r"by a column's name, got .*table is \.data"):
            session[key]


@pytest.mark.parametrize("share", [0.9, 1.1])
@pytest.mark.parametrize("rows", [[7], [3, 7], [10]])
def test_a_step_may_differ_by_one_per_cent_of_the_median(share, rows):
    t = np.arange(11) * 0.1
    t[rows] += share * 0.01 * 0.1
    irregular = pytest.raises(tl.SessionError, match=f"row {rows[0]}, column t: sampling is irreg")
    with nullcontext() if share < 1.0 else irregular:
        assert tl.Session(frame().set_axis(t)).t.tolist() == t.tolist()


@pytest.mark.parametrize(
    ("t", "words"),
    [
        ([0.0, 0.1, 0.2, 0.5], r"a step of 0\.3 s at t = 0\.5 s.*median step is 0\.1 s; 1 of 3 "),
        ([0.0, 0.1, np.nan, 0.3], "row 2, column t: time is nan"),
    ],
)
def test_time_that_is_not_uniform(t, words):
    with pytest.raises(tl.SessionError, match=words):
        tl.Session(pd.DataFrame({"mode": 1.0}, index=t))


@pytest.mark.parametrize(
    ("value", "row"), [(np.nan, 0), (np.inf, 7), (-np.inf, 10), (1.5, 7), (-0.1, 10)]
)
def test_the_first_value_that_is_missing_or_out_of_range_is_named(value, row):
    mode = np.ones(11)
    mode[row] = mode[-1] = value
    words = rf"the log\.csv: row {row}, column 'mode', t = {0.1 * row:.6g} s: {value} "
    with pytest.raises(tl.SessionError, match=words):
        tl.Session(frame(mode=mode), tl.Metadata(source="the log.csv"))


def test_metadata_travels_and_can_be_added():
    facts = tl.Metadata(participant=3, condition="C1", synthetic=True, more={"trial": 2})
    session = tl.Session(frame(), facts)
    assert session.label == "operator 3, C1, trial 2, synthetic"
    assert repr(session).endswith("columns mode; metadata.more: trial>")
    changed = session.with_metadata(condition=0.4, block=1)
    assert changed.label == "operator 3, condition 0.4, trial 2, synthetic"
    own = {"participant": 3, "condition": 0.4, "source": None, "synthetic": True}
    assert changed.metadata.as_dict() == own | {"trial": 2, "block": 1}
    assert session.metadata == facts
    assert pickle.loads(pickle.dumps(changed)) == changed
    assert changed != session
    assert changed.with_metadata(source="elsewhere") == changed
    assert tl.Session(frame()).label == "session"


def test_parts_and_added_columns():
    session = tl.Session(frame())
    assert session.between(0.2, 0.5).t.tolist() == frame().index[2:6].tolist()
    more = session.with_columns(p_r=np.linspace(0, 1, 11), r=0.3)
    assert more.columns == ["mode", "p_r", "r"]
    assert (more["r"] == 0.3).all()
    assert more == more.with_columns(mode=1.0) == tl.Session(more.data[["r", "p_r", "mode"]])
    for wrong in ([1.0, 2.0], np.zeros((11, 2))):
        with pytest.raises(tl.SessionError, match=r"column 'p_r' is of shape \(.*, .* 11 samples"):
            session.with_columns(p_r=wrong)
    with pytest.raises(
        tl.SessionError, match=r"2\.0 s and 3\.0 s; the session runs from 0 s to 1 s"
    ):
        session.between(2.0, 3.0)
    assert session.columns == ["mode"]


def test_a_part_holds_the_samples_at_its_ends_and_has_facts_of_its_own():
    """0.30000000000000004 s was cut off by between(0.0, 0.3)."""
    session = tl.Session(frame())
    parts = [session.between(*ends) for ends in ((0.0, 0.3), (0.3, 0.6), (0.30001, 0.59999))]
    assert [len(part) for part in parts] == [4, 4, 2]
    parts[0].metadata.more["excluded"] = True
    assert "excluded" not in session.metadata.more


def test_units_against_their_definitions():
    expected = {"km": 1e3, "cm": 1e-2, "mm": 1e-3, "min": 60, "h": 3600, "km/h": 1000 / 3600}
    expected |= {"deg": np.pi / 180, "%": 0.01}
    for unit, factor in expected.items():
        assert to_si(unit, UNITS[unit][0]) == pytest.approx(factor, rel=1e-15)
    assert to_si("km/h", "measure") == to_si("km/h", "m/s")
    assert tl.sessions.vocabulary().loc["path_error", ["unit", "low"]].tolist() == ["m", 0.0]


def test_manual_phases_are_shaded_by_the_share_of_the_operator():
    mode = [1.0, 1, 0, 0, 0, 0, 0.5, 0.5, 0.5, 0.5, 0.5]
    (bars,) = tl.Session(frame(mode=mode, p_r=0.5)).plot("p_r")[0].collections
    ends = [[path.get_extents().x0, path.get_extents().x1] for path in bars.get_paths()]
    np.testing.assert_allclose(ends, [[0.0, 0.2], [0.2, 0.6], [0.6, 1.0]])
    np.testing.assert_allclose(bars.get_facecolor()[:, 3], [0.2, 0.0, 0.1])
    plt.close("all")


def test_paths_and_means_of_several_sessions():
    places = [f"{who}_{axis}" for who in ("human", "robot", "reference") for axis in "yz"]
    real = tl.Session(frame(**dict.fromkeys(places, 0.5)), tl.Metadata(participant=1))
    axes = tl.sessions.plot_paths([real, real.with_metadata(synthetic=True)], plane="yz")
    assert [axis.get_title() for axis in axes] == ["participant 1", "operator 1, synthetic"]
    assert axes[0].figure.get_suptitle() == "synthetic data"
    assert axes[0].get_xlabel() == "y [m]"
    rows = [(1, 0.0, 1.0), (1, 0.0, 3.0), (1, 0.5, 4.0), (2, 0.0, 6.0), (2, 0.5, 8.0)]
    table = pd.DataFrame(rows, columns=["participant", "autonomy", "error"])
    mean = tl.sessions.plot_by_participant(table, "error").lines[-1]
    assert mean.get_ydata().tolist() == [4.0, 6.0]
    plt.close("all")


def test_a_series_is_taken_by_place():
    session = tl.Session(frame(p_r=0.5))
    values = np.linspace(0.0, 1.0, len(session))
    mixed = pd.Series(values, session.data.index[::-1])
    assert session.with_columns(p_r=mixed)["p_r"].tolist() == values.tolist()


def test_columns_and_metadata_have_names(tmp_path):
    with pytest.raises(tl.SessionError, match="column 0 is not in the vocabulary"):
        tl.Session(pd.DataFrame(np.zeros((3, 1)), [0.0, 0.1, 0.2]))
    named = tl.Session(frame(p_r=0.5), tl.Metadata(more={3: "x"}))
    with pytest.raises(tl.SessionError, match="metadata 3 would not read back the same"):
        tl.write_session(named, tmp_path / "a.csv")


def test_a_file_written_again_keeps_who_may_read_it_and_links(tmp_path):
    """Participants' data could be read by all from the second time on."""
    file, link = tmp_path / "a.csv", tmp_path / "b.csv"
    file.touch(mode=0o600)
    link.symlink_to(file)
    session = tl.Session(frame(p_r=0.5))
    tl.write_session(session, link)
    assert link.is_symlink()
    assert file.stat().st_mode & 0o777 == 0o600
    assert tl.read_session(file) == session


def test_metadata_of_a_frame_are_kept_where_no_rule_takes_them_up(tmp_path):
    recipe = tmp_path / "a.toml"
    text = 'name = "a"\nkind = "table"\n[files]\npattern = "p{participant:int}.csv"\n[time]\n'
    text += 'column = "t"\nunit = "s"\n[columns]\np_r = { column = "p_r" }\n'
    recipe.write_text(text)
    table = frame(p_r=0.5).reset_index(names="t")
    session = tl.read_frame(table, recipe, participant=3, returns=5)
    assert (session.metadata.participant, session.metadata.more["returns"]) == (3, 5)
