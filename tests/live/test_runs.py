"""
Settings, files and hands of live drives. Oracles: the replay, Table 2.5 and Table 2.1 as printed,
files written by hand.
"""

import json

import numpy as np
import pytest

import trustlab as tl
from trustlab.live.attempt import Attempt
from trustlab.live.hand import HumanHand, live_difficulty, scripted_drive
from trustlab.live.runs import drive_config, replay, session_of
from trustlab.testbeds.ground_robot.kernel import COLUMNS

MODEL = tl.published_models()["2"]


@pytest.fixture(scope="module")
def driven():
    config = drive_config("C3", MODEL, (0.0, 0.35), laps=2, seed=3)
    return config, *scripted_drive(config, HumanHand(config, 1))


def test_the_live_task_is_as_hard_as_people_found_it():
    table = live_difficulty(seeds=2, laps=2).set_index("who")
    human, ideal = table.loc["HumanHand"], table.loc["IdealHand"]
    best = table.loc[[f"participant {n}" for n in "12345"]]
    assert table.loc["people, C3", "p_r"] == 0.329
    assert best["p_r"].min() - 0.02 < human["p_r"] < best["p_r"].max() + 0.02
    assert best["p_h"].min() < human["p_h"] < best["p_h"].max() + 0.02
    assert ideal["p_r"] > human["p_r"] + 0.08, "a hand that sees everything finds it easier"


def test_a_live_session_is_one_like_any_other(driven, tmp_path):
    config, rows, session = driven
    assert session.sample_time == 0.1
    assert session.metadata.synthetic
    assert replay(config, rows) is True
    again = tl.read_session(
        tl.write_session(session, tmp_path / "live.csv") or tmp_path / "live.csv"
    )
    np.testing.assert_array_equal(again["p_r"], session["p_r"])
    with pytest.raises(tl.IdentificationError, match="record more"):
        tl.fit_tsc(session)  # a scripted hand does not tire, and 200 s are few


def test_an_identification_drive_is_fitted():
    config = drive_config(
        "identification", MODEL, seed=3, schedule=[(1, 250.0), (0, 250.0), (1, 200.0)]
    )
    _, session = scripted_drive(config, HumanHand(config, 1))
    assert session["mode"][[0, 2499, 2500, 4999, 5000]].tolist() == [1.0, 1.0, 0.0, 0.0, 1.0]
    assert 0.25 < tl.fit_robot(session).model.p_max < 0.5


def test_the_last_rows_of_a_torn_file_are_cut_off(driven, tmp_path):
    config, rows, _ = driven
    one = Attempt(tmp_path, "me", config)
    sent = [[k, 100.0 * k, *row] for k, row in enumerate(rows[:30].tolist())]
    assert one.answer({"rows": sent[:20]})["have"] == 20
    assert one.answer({"rows": sent[10:25]})["have"] == 25, "rows that come twice are kept once"
    assert one.answer({"rows": sent[27:]})["have"] == 25, "a gap is not closed"
    with one.path.open("ab") as file:
        file.write(json.dumps(sent[25]).encode()[:40])
    again = Attempt(tmp_path, "me", config)
    assert again.key == one.key
    assert again.rows == one.rows
    assert again.answer({"begin": True})["rows"] == [row[2:] for row in sent[:25]]
    assert again.verified
    again.answer({"end": {"why": "complete"}})
    assert Attempt(tmp_path, "me", config).key != again.key
    with pytest.raises(ValueError, match="a row is 17 numbers"):
        again.answer({"rows": [[25, 0.0, "x"]]})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"condition": "C6"}, "condition must be one of 'C1', 'C2', 'C3', 'C4', 'C5', got 'C6'"),
        ({"model": None}, "model must be of class TscModel, got NoneType; fit one"),
        ({"thresholds": None}, "C3 needs thresholds"),
        ({"thresholds": (0.6, 0.1)}, "must be below"),
        ({"thresholds": (0.1, 0.9)}, "strictly between TSC_lb"),
        ({"condition": "C5"}, "no effect in C5"),
        ({"laps": 0}, "laps must be a whole number"),
        ({"laps": 50}, "split it"),
        ({"participant": ""}, "participant must be a name"),
        ({"seed": -1}, "seed must be a whole number"),
        ({"show_map": "yes"}, "show_map"),
    ],
)
def test_bad_arguments_are_named(change, says, tmp_path):
    good = {"condition": "C3", "model": MODEL, "thresholds": (0.0, 0.35), "folder": tmp_path}
    with pytest.raises(ValueError, match=says):
        tl.LiveGroundRobot(**(good | change))


def test_a_widget_before_anyone_drives(tmp_path):
    live = tl.LiveGroundRobot("C1", model=MODEL, folder=tmp_path)
    assert live.verified is False
    with pytest.raises(ValueError, match=r"shape|two samples"):
        live.session  # noqa: B018
    assert live.config["view"]["map"] is False


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({}, "give one of laps="),
        ({"laps": 2, "seconds": 10.0}, "give one of laps="),
        ({"seconds": 10.0, "delay_": 1.0}, "a setting of the view must be one of"),
        ({"seconds": 1e5}, "split it"),
        ({"schedule": [(1, 10.0)]}, "goes with the condition 'identification'"),
    ],
)
def test_bad_settings_are_named(change, says):
    with pytest.raises(ValueError, match=says):
        drive_config("training", MODEL, **change)


def test_rows_of_another_shape_are_refused(driven):
    config, rows, _ = driven
    for wrong in (rows[:, :5], rows[:1], "rows"):
        with pytest.raises(ValueError, match=r"rows|samples"):
            session_of(config, wrong)
    assert len(COLUMNS) == rows.shape[1]
