"""The session table: what it accepts, what it refuses, and what it says of itself."""

import pickle

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.sessions.session import STEP_TOLERANCE, check_time
from trustlab.sessions.vocabulary import VOCABULARY


def frame(n=5, **columns):
    t = pd.Index(np.arange(n) * 0.1, name="t")
    return pd.DataFrame({"mode": np.ones(n), **columns}, index=t)


def test_a_session_knows_its_time():
    session = tl.Session(frame(11))
    assert session.sample_time == 0.1
    assert session.duration == pytest.approx(1.0)
    assert len(session) == 11
    np.testing.assert_array_equal(session["t"], session.t)
    assert "mode" in session
    assert "p_r" not in session


def test_names_work_as_those_of_a_data_frame():
    session = tl.Session(frame(11, p_r=0.5))
    assert "t" in session
    assert "p_h" not in session
    assert 0 not in session
    assert list(session) == session.keys() == ["t", "mode", "p_r"]
    assert all(name in session for name in session)
    assert {name: len(values) for name, values in dict(session).items()} == {
        "t": 11,
        "mode": 11,
        "p_r": 11,
    }
    session.require("t", "mode")
    with pytest.raises(tl.SessionError, match=r"indexed by a column's name, got 0"):
        session[0]
    axes = session.plot(["t", "p_r"])
    assert axes[0].get_ylabel() == "t [s]"
    plt.close("all")


def test_time_may_be_a_column():
    table = frame(5).reset_index()
    assert tl.Session(table) == tl.Session(frame(5))
    assert tl.Session(table).table().equals(table)


@pytest.mark.parametrize(
    ("t", "says"),
    [
        ([0.0, 0.1, 0.1, 0.2], "row 2, column t: time repeats"),
        ([0.0, 0.2, 0.1, 0.3], "row 2, column t: time runs backwards"),
        ([0.0, 0.1, 0.2, 0.5], r"row 3, column t: sampling is irregular.*resample"),
        ([0.0, 0.1, np.nan, 0.3], "row 2, column t: time is nan"),
        ([0.0], "at least two samples"),
    ],
)
def test_time_that_is_not_uniform_is_refused(t, says):
    with pytest.raises(tl.SessionError, match=says):
        tl.Session(pd.DataFrame({"mode": np.ones(len(t))}, index=pd.Index(t, name="t")))


def test_jitter_within_the_tolerance_is_kept_as_it_is():
    t = np.arange(50) * 0.1
    t[7] += 0.4 * STEP_TOLERANCE * 0.1
    check_time(t)
    t[7] += 2.0 * STEP_TOLERANCE * 0.1
    with pytest.raises(tl.SessionError, match="irregular"):
        check_time(t)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"p_rr": 1.0}, "'p_rr' is not in the vocabulary; did you mean 'p_r'"),
        ({"p_r": [0.1, 0.2, np.nan, 0.3, 0.4]}, r"row 2, column 'p_r', t = 0.2 s: nan is missing"),
        (
            {"path_error": [0.1, 0.2, 0.0, -0.3, 0.4]},
            r"row 3, column 'path_error', t = 0.3 s: -0.3 lies outside",
        ),
        ({"r": [0, 0, 0, 0, 1.01]}, "'r'.*lies outside"),
        ({"p_r": list("abcde")}, "must hold numbers"),
    ],
)
def test_columns_that_do_not_fit_are_refused(columns, says):
    with pytest.raises(tl.SessionError, match=says):
        tl.Session(frame(5, **columns))


def test_other_faults():
    twice = pd.concat([frame(3), frame(3)], axis=1)
    with pytest.raises(tl.SessionError, match="'mode' occurs twice"):
        tl.Session(twice)
    with pytest.raises(tl.SessionError, match="must be a pandas DataFrame"):
        tl.Session([1, 2, 3])
    with pytest.raises(tl.SessionError, match=r"must be a Metadata, for example.*got dict"):
        tl.Session(frame(3), {"participant": 3})
    with pytest.raises(tl.SessionError, match="at least one column"):
        tl.Session(frame(3)[[]])
    with pytest.raises(tl.SessionError, match=r"the log\.csv: row 1"):
        tl.Session(frame(3).assign(mode=[1, 2, 0]), tl.Metadata(source="the log.csv"))


def test_metadata_travels_and_can_be_added():
    session = tl.Session(
        frame(), tl.Metadata(participant=3, condition="C1", synthetic=True, more={"trial": 2})
    )
    assert session.label == "operator 3, C1, trial 2, synthetic"
    assert repr(session).endswith("columns mode; metadata.more: trial)")
    changed = session.with_metadata(condition="C2", block=1)
    assert changed.metadata.as_dict() == {
        "participant": 3,
        "condition": "C2",
        "source": None,
        "synthetic": True,
        "trial": 2,
        "block": 1,
    }
    assert session.metadata.condition == "C1"
    assert pickle.loads(pickle.dumps(changed)) == changed
    assert changed != session


def test_parts_and_added_columns():
    session = tl.Session(frame(11))
    assert session.between(0.2, 0.5).t[0] == 0.2
    more = session.with_columns(p_r=np.linspace(0, 1, 11))
    assert more.columns == ["mode", "p_r"]
    assert (session.with_columns(p_r=0.3)["p_r"] == 0.3).all()
    for wrong in ([1.0, 2.0], [], np.zeros((11, 2))):
        with pytest.raises(
            tl.SessionError, match=r"column 'p_r' is of shape .* the session has 11 samples"
        ):
            session.with_columns(p_r=wrong)
    with pytest.raises(tl.SessionError, match=r"no column 'p_h'; did you mean 'p_r'\?"):
        more.require("mode", "p_h")
    assert session.columns == ["mode"]


def test_a_session_cannot_be_changed_from_outside():
    table = frame(5)
    session = tl.Session(table)
    table.loc[:, "mode"] = 0.0
    assert (session["mode"] == 1.0).all()


def test_vocabulary_has_units_and_meanings():
    table = tl.sessions.vocabulary()
    assert table.loc["path_error", "unit"] == "m"
    assert list(table.index) == list(VOCABULARY)
    assert (table["meaning"].str.len() > 5).all()


def test_plots_and_pages_say_synthetic():
    session = tl.Session(frame(30, p_r=np.linspace(0, 1, 30)), tl.Metadata(synthetic=True))
    axes = session.plot()
    assert "synthetic" in axes[0].figure.get_suptitle()
    plt.close("all")
    assert "synthetic" in session._repr_html_()
    assert "synthetic" in repr(session)


def test_paths_of_several_sessions():
    def moving(synthetic):
        t = np.linspace(0, 1, 30)
        columns = {f"{who}_{axis}": t for who in ("human", "robot", "reference") for axis in "yz"}
        return tl.Session(frame(30, **columns), tl.Metadata(participant=1, synthetic=synthetic))

    axes = tl.sessions.plot_paths([moving(False), moving(True)], plane="yz")
    assert [axis.get_title() for axis in axes] == ["participant 1", "operator 1, synthetic"]
    assert [line.get_label() for line in axes[0].lines] == ["operator", "robot", "reference"]
    assert axes[0].figure.get_suptitle() == "synthetic data"
    assert (
        tl.sessions.plot_paths([moving(False)], "yz", titles=["one"])[0].figure.get_suptitle() == ""
    )
    with pytest.raises(tl.SessionError, match="no column 'human_x'"):
        tl.sessions.plot_paths([moving(False)])
    plt.close("all")


def test_a_measure_by_participant():
    """Oracle: means by hand."""
    rows = [(1, 0.0, 1.0), (1, 0.0, 3.0), (1, 0.5, 4.0), (2, 0.0, 6.0), (2, 0.5, 8.0)]
    table = pd.DataFrame(rows, columns=["participant", "autonomy", "error"])
    axis = tl.sessions.plot_by_participant(table, "error")
    np.testing.assert_array_equal(axis.lines[-1].get_ydata(), [4.0, 6.0])
    assert axis.lines[-1].get_label() == "mean of 2 participants"
    assert tl.sessions.plot_by_participant(table, "error", axis=axis) is axis
    plt.close("all")


def test_external_data_are_where_the_variable_says(tmp_path, monkeypatch):
    monkeypatch.setenv("TRUSTLAB_DATA", str(tmp_path))
    assert tl.sessions.external_data("lab") is None
    (tmp_path / "lab").mkdir()
    assert tl.sessions.external_data("lab") == tmp_path / "lab"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1.5, -0.1])
@pytest.mark.parametrize("row", [0, 7, 19])
def test_the_first_value_that_is_missing_or_out_of_range_is_named(value, row):
    mode = np.ones(20)
    mode[row] = mode[-1] = value
    with pytest.raises(tl.SessionError, match=rf"row {row}, column 'mode'"):
        tl.Session(pd.DataFrame({"mode": mode}, index=np.arange(20) * 0.1))


def test_the_largest_numbers_are_values_as_any_other():
    x = np.array([-1.7e308, 0.0, 1.7e308])
    assert tl.Session(pd.DataFrame({"robot_x": x}, index=[0.0, 0.1, 0.2]))["robot_x"][2] == 1.7e308
