"""
Settings, files and hands of live drives. Oracles: the replay, Table 2.5 and Table 2.1 as printed,
files written by hand.
"""

import json
import math
import subprocess
import sys
import warnings

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
    one.close()
    again = Attempt(tmp_path, "me", config)
    assert again.key == one.key
    assert again.rows == one.rows
    assert again.answer({"begin": True})["rows"] == [row[2:] for row in sent[:25]]
    assert again.verified
    again.answer({"end": {"why": "complete"}})
    assert Attempt(tmp_path, "me", config).key != again.key
    late = again.answer({"rows": sent[25:27]})
    assert late == {"refused": "A row cannot be taken: the drive is over."}


def begun(folder, config, rows, window="a"):
    attempt = Attempt(folder, "me", config)
    attempt.answer({"begin": True, "window": window})
    sent = [[k, 100.0 * k, *row] for k, row in enumerate(rows.tolist())]
    return attempt, sent


def test_rows_that_no_drive_can_have_are_refused_in_words(driven, tmp_path):
    config, rows, _ = driven
    attempt, sent = begun(tmp_path, config, rows)
    number, ms, mode, suggested, *rest = sent[0]
    speed = COLUMNS.index("v_command") + 2
    bad = {
        "a row is 17 finite numbers": [
            sent[0][:-1],
            [number, ms, mode, suggested, *rest[:-1], "x"],
            [number, ms, mode, suggested, *rest[:-1], math.nan],
            [number, ms, mode, suggested, *rest[:-1], None],
        ],
        f"have numbers 0 to {config['samples'] - 1}": [
            [config["samples"], *sent[0][1:]],
            [-1, *sent[0][1:]],
            [0.0, *sent[0][1:]],
        ],
        "mode cannot be 2": [[number, ms, 2, *sent[0][3:]]],
        "suggested_mode cannot be 0.5": [[number, ms, mode, 0.5, *rest]],
        "v_command cannot be 0.6": [[*sent[0][:speed], 0.6, *sent[0][speed + 1 :]]],
    }
    for words, faults in bad.items():
        for row in faults:
            answer = attempt.answer({"rows": [row], "window": "a"})
            assert words in answer["refused"], (row, answer)
    assert attempt.rows == []
    assert attempt.answer({"rows": sent[:30], "window": "a"}) == {"have": 30}
    assert attempt.verified


def test_the_window_that_began_last_drives(driven, tmp_path):
    """Two views of one widget: what the first sends later is refused, and the log stays whole."""
    config, rows, _ = driven
    attempt, sent = begun(tmp_path, config, rows, "first")
    attempt.answer({"rows": sent[:20], "window": "first"})
    assert len(attempt.answer({"begin": True, "window": "second"})["rows"]) == 20
    other = [[k, ms, 1 - mode, *rest] for k, ms, mode, *rest in sent]
    assert "another window" in attempt.answer({"rows": other[20:40], "window": "first"})["refused"]
    assert "another window" in attempt.answer({"note": "x", "window": "first"})["refused"]
    attempt.answer({"rows": sent[20:40], "window": "second"})
    assert attempt.verified
    assert attempt.session.metadata.more["pauses"] == []
    attempt.close()
    again = Attempt(tmp_path, "me", config)
    assert again.answer({"rows": sent[40:50], "window": "second"}) == {"have": 50}, (
        "rows on their way come back after a restart"
    )


def test_one_kernel_writes_a_drive(driven, tmp_path):
    config, rows, _ = driven
    attempt, sent = begun(tmp_path, config, rows)
    assert Attempt.of(tmp_path, "me", config) is attempt, "the cell, run again"
    assert Attempt.of(tmp_path, "you", config) is not attempt
    script = (
        "import json, sys\n"
        "from trustlab.live.attempt import Attempt\n"
        "config = json.loads(sys.stdin.read())\n"
        "try:\n"
        "    print(len(Attempt(sys.argv[1], 'me', config).rows))\n"
        "except ValueError as error:\n"
        "    print(error)\n"
    )

    def elsewhere():
        return subprocess.run(
            [sys.executable, "-c", script, str(tmp_path)],
            input=json.dumps(config),
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    attempt.answer({"rows": sent[:20], "window": "a"})
    assert "is being driven in another kernel or notebook; shut that kernel down" in elsewhere()
    attempt.answer({"rows": sent[20:40], "window": "a"})
    assert attempt.verified
    attempt.close()
    assert elsewhere() == "40\n"


def test_a_row_that_is_changed_on_the_disk_is_not_verified(driven, tmp_path):
    config, rows, _ = driven
    attempt, sent = begun(tmp_path, config, rows)
    attempt.answer({"rows": sent[:30], "window": "a"})
    assert attempt.verified
    lines = attempt.path.read_text().splitlines(keepends=True)
    stamp = [*lines[:11], lines[11].replace(" 900.0,", " 901.0,"), *lines[12:]]
    assert stamp != lines
    attempt.path.write_text("".join(stamp))
    assert not attempt.verified, "the clock of a row, which no replay sees"
    attempt.close()
    assert not Attempt(tmp_path, "me", config).verified


def test_a_full_disk_is_said_and_loses_nothing(driven, tmp_path, monkeypatch):
    config, rows, _ = driven
    attempt, sent = begun(tmp_path, config, rows)

    def full(handle):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", full)
        answer = attempt.answer({"rows": sent[:20], "window": "a"})
        assert "cannot be saved (No space left on device)" in answer["trouble"]
        assert "have" not in answer
    assert attempt.answer({"rows": sent[:20], "window": "a"}) == {"have": 20}
    attempt.close()
    again = Attempt(tmp_path, "me", config)
    assert again.rows == [row[2:] for row in sent[:20]]
    assert again.verified


def test_laps_that_are_over_before_anybody_may_switch(tmp_path):
    with pytest.warns(UserWarning, match="take laps=2 or more"):
        tl.LiveGroundRobot("C1", model=MODEL, laps=1, folder=tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tl.LiveGroundRobot("C1", model=MODEL, laps=2, folder=tmp_path)


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
