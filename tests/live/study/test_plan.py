"""
The plan: frozen once, the same at every opening, refused where it would change. Oracle: the Latin
square of the design.
"""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.live.hands import HumanHand
from trustlab.live.study import plan as planning
from trustlab.live.study.__main__ import main
from trustlab.live.study.plan import drive_of, links_path, read_tokens, tokens_path
from trustlab.live.study.server import StudyServer
from trustlab.live.tasks.ground_robot import TASK, Drive
from trustlab.testbeds.ground_robot.kernel import COLUMNS


def test_the_plan_is_frozen_and_opens_again(make_plan):
    plan = make_plan()
    before = (plan.folder / "study.json").read_bytes()
    design = tl.latin_square_design(["C1", "C3"], ["P01", "P02", "P03"], 0, whole_squares=False)
    assert plan.table().equals(design.table())
    names = {path.name for path in plan.folder.iterdir()}
    assert names == {"P01", "P02", "P03", "study.json"}
    assert make_plan().content == tl.LiveStudy.open(plan.folder).content == json.loads(before)
    assert (plan.folder / "study.json").read_bytes() == before
    for other, words in (
        ({"conditions": ["C1", "C2"]}, "conditions, orders"),
        ({"laps": 2}, "laps"),
    ):
        with pytest.raises(ValueError, match=f"holds a frozen plan with other {words}; open it"):
            make_plan(**other)


def test_tokens_are_nowhere_in_the_study(make_plan):
    plan = make_plan()
    words = "".join(path.read_text() for path in plan.folder.rglob("*") if path.is_file())
    words += plan._repr_html_() + repr(plan)
    assert not any(token in words for token in read_tokens(plan.folder).values())


@pytest.mark.parametrize(
    ("codes", "said"),
    [
        ({"P01", "P02"}, "must be in an order"),
        (["p01", "P01"], "two codes are the same"),
        (["-rf", "b"], "begins with a letter"),
        (["x" * 300, "b"], "at most 40"),
        ("A7", "no list of codes, must be a whole number, from 1 to 999, got 'A7'"),
    ],
)
def test_codes_that_make_no_folder_are_refused(tmp_path, codes, said):
    with pytest.raises(ValueError, match=said):
        tl.LiveStudy(tmp_path / "s", participants=codes)
    assert not (tmp_path / "s").exists()


def test_folders_that_hold_no_study(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(ValueError, match="has other files in it"):
        tl.LiveStudy(tmp_path)
    with pytest.raises(ValueError, match=r"there is no study\.json in"):
        tl.read_live_study(tmp_path)


def test_the_command_line_plans_and_complains(tmp_path, monkeypatch, capsys):
    served = []

    def serve(plan, port, url, enrol):
        served.append((port, url, enrol))

    monkeypatch.setattr(planning.LiveStudy, "serve", serve)
    folder = str(tmp_path / "mystudy")
    proxy = "https://lab.test"
    assert main([folder]) == main([folder, "--port", "9000", "--url", proxy, "--enrol"]) == 0
    assert served == [(8765, "", False), (9000, proxy, True)]
    assert len(tl.LiveStudy.open(folder).orders) == 20
    assert main([str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "A new study: C1 to C5, 20 participants" in said.out
    assert "has other files in it" in said.err


def test_a_deletion_that_fails_is_told_and_the_next_one_finishes_it(make_plan, monkeypatch):
    plan = make_plan()
    (plan.folder / "P01" / "events.jsonl").touch()

    def refused(folder, ignore_errors=False):
        if not ignore_errors:
            raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(shutil, "rmtree", refused)
        with pytest.raises(PermissionError):
            plan.delete("P01")
    assert plan.deleted() == ["P01"]
    plan.delete("P01")
    assert not list(plan.folder.rglob("events.jsonl"))
    assert (plan.deleted(), plan.present()) == (["P01"], ["P02", "P03"])


def test_a_folder_lost_in_a_copy_is_nobody_who_was_deleted(make_plan, serving):
    """Some copies leave empty folders out."""
    plan = make_plan()
    (plan.folder / "P02").rmdir()
    assert tl.read_live_study(plan.folder).deleted == []
    with serving(plan) as served:
        assert served.state("P02").json["page"] == 0


def test_a_damaged_file_beside_the_study_is_named(make_plan):
    plan = make_plan()
    for path in (links_path(plan.folder), tokens_path(plan.folder)):
        path.write_bytes(b'{"P01": "\xff')
        path.chmod(0o600)
        with pytest.raises(ValueError, match=f"{path.name} was damaged"):
            StudyServer(plan).__enter__()
        path.unlink()


def test_a_plan_that_cannot_be_served_is_not_frozen(tmp_path):
    with pytest.raises(ValueError, match="guidance must be one of"):
        tl.LiveStudy(tmp_path / "s", participants=5, task="teleoperation", guidance="nonsense")
    assert not (tmp_path / "s").exists()


def test_arguments_are_named(make_plan, tmp_path):
    for more, said in (
        ({"lap": 2}, "a setting must be one of 'laps', .* got 'lap'; did you mean 'laps'"),
        ({"seed": -1, "participants": {"a": 2, "b": 2}}, "seed must be a whole number, 0 or more"),
        ({"pages": 5}, "pages must be a path, got 5"),
    ):
        with pytest.raises(ValueError, match=said):
            make_plan(**more)
    (tmp_path / "mystudy").touch()
    with pytest.raises(ValueError, match="mystudy is a file; a study needs a folder of its own"):
        make_plan()


def test_a_participant_may_be_called_experimenter(make_plan):
    """The experimenter's link was theirs."""
    with StudyServer(make_plan(participants=["experimenter", "B"])) as server:
        assert server.links()["experimenter"][-22:] != server.experimenter[-22:]


def test_a_rehearsal_that_was_interrupted_begins_again(make_team_plan, monkeypatch):
    """A notebook keeps the traceback, and with it all that the call held."""
    plan = make_team_plan()
    with monkeypatch.context() as patched:
        patched.setattr("trustlab.live.study.participant.Trial.take", interrupt)
        with pytest.raises(KeyboardInterrupt) as kept:
            plan.rehearse()
    plan.rehearse()
    assert kept.tb
    assert tl.read_live_study(plan.folder).participants["complete"].all()


def interrupt(*_):
    raise KeyboardInterrupt


def test_conditions_of_ones_own_have_no_bounds_and_no_idle_notice():
    """A weighted sum leaves [−1, 1]."""
    rule = tl.LiveCondition("sum", {"tsc": 2.0}, thresholds=(0.5, 1.5))
    assert rule.thresholds == (0.5, 1.5)
    with pytest.raises(ValueError, match="notice has no effect without forced=True"):
        tl.LiveCondition("a", suggestions="tsc", notice=10.0)


def drive_rows(config, switched):
    """The rows of a whole drive; `switched` says what a person makes of mode and suggestion."""
    drive, hand = Drive(config), HumanHand(config, 1)
    rows = []
    while not drive.done:
        mode = switched(drive.state["mode"], drive.state["suggested"])
        v, w, _ = hand(drive.picture())
        rows.append(drive.step(v, w, float(mode)))
    return pd.DataFrame(rows, columns=[*COLUMNS, "laps"])


def test_conditions_and_courses_of_ones_own_are_driven(make_plan):
    """A notice of 10 s, on another course. Oracle: time from suggestion to switch in the log."""
    slow = tl.LiveCondition("slow", suggestions="tsc", forced=True, notice=10.0)
    course = tl.testbeds.Course(((0, 0), (9, 0), (9, 9), (0, 9)), radius=2.0)
    options = {"course": course, "laps": 2, "training": 5.0, "rehearsal": True}
    plan = make_plan(["C3", slow], 2, **options)
    assert make_plan(["C3", slow], 2, **options).content == plan.content
    for name, notice in (("C3", 3.0), ("slow", 10.0)):
        config = drive_of(plan.content, name, seed=1)
        assert config["path"] == course.path.tolist()
        log = drive_rows(config, lambda mode, suggested: 1)  # nothing is accepted
        mode = log["mode"].to_numpy()
        switch = np.flatnonzero(np.diff(mode))[0] + 1
        stands = (log["suggested_mode"] >= 0) & (log["suggested_mode"] != mode)
        last = np.flatnonzero(~stands[:switch])[-1]
        assert 0.1 * (switch - last - 1) == pytest.approx(notice, abs=0.11), name
    plan.rehearse(seed=0)
    study = tl.read_live_study(plan.folder)
    assert set(study.measures["condition"]) == {"C3", "slow"}
    assert study.measures["verified"].all()


def test_a_rule_of_ones_own_is_driven(make_plan):
    """Oracle: the rule written out over the log's columns."""
    rest = tl.LiveCondition("rest", {"r": 1.0, "p_h": -0.5}, thresholds=(0.1, 0.3))
    options = {"laps": 3, "training": 5.0, "rehearsal": True}
    plan = make_plan(["C1", rest], 2, **options)
    assert make_plan(["C1", rest], 2, **options).content == plan.content
    config = drive_of(plan.content, "rest", seed=1)
    # Everything is accepted.
    log = drive_rows(config, lambda mode, suggested: mode if suggested < 0 else suggested)
    standing, expected = 1, []
    for t, value in zip(0.1 * log.index, log["r"] - 0.5 * log["p_h"], strict=True):
        if t < 100.0 - 1e-9:
            expected.append(-1)
            continue
        standing = 0 if value >= 0.3 else 1 if value <= 0.1 else standing
        expected.append(standing)
    assert log["suggested_mode"].tolist() == expected
    assert set(log["mode"]) == {0, 1}
    session = TASK.session(config, log.to_numpy())
    assert session.metadata.more["rule"] == {"p_h": -0.5, "r": 1.0}


def test_a_study_in_the_folder_of_a_removed_one_knows_nothing_of_it(tmp_path):
    """Everybody was locked out: their last lines were missing."""
    links_path(tmp_path / "a").write_text('{"P01": "0123456789abcdef"}')
    plan = tl.LiveStudy(tmp_path / "a", ["C1", "C3"], 2, rehearsal=True)
    assert not tl.read_live_study(plan.folder).faults()["fault"].any()


def test_whole_numbers_make_the_same_condition():
    def condition(number):
        rule = {"suggestions": {"r": number}, "thresholds": (0, number), "notice": 10 * number}
        return tl.LiveCondition("slow", forced=True, **rule)

    assert repr(condition(1)) == repr(condition(1.0))


def test_links_that_are_not_here_are_named(tmp_path):
    plan = tl.LiveStudy(tmp_path / "a", ["C1", "C3"], 2)
    tokens_path(plan.folder).unlink()
    with pytest.raises(ValueError, match="links of this study are not on this machine"):
        StudyServer(plan, 0).__enter__()
