"""
The plan: frozen once, the same at every opening, refused where it would change. Oracle: the Latin
square of the design.
"""

import json
import shutil
from functools import partial
from unittest.mock import Mock, call

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.cases import model, refused
from tests.live.cases import recorded
from trustlab.live.hands import HumanHand
from trustlab.live.study.__main__ import main
from trustlab.live.study.plan import drive_of, links_path, read_tokens, tokens_path
from trustlab.live.study.server import StudyServer
from trustlab.live.task import scripted_commands
from trustlab.live.tasks.ground_robot import TASK


def test_the_plan_is_frozen_and_opens_again(make_plan):
    plan = make_plan()
    before = (plan.folder / "study.json").read_bytes()
    with pytest.warns(UserWarning, match="do not fill whole squares"):
        design = tl.latin_square_design(["C1", "C3"], list(plan.orders), 0, whole_squares=False)
    assert plan.table().equals(design.table())
    names = {path.name for path in plan.folder.iterdir()}
    assert names == {"P01", "P02", "P03", "study.json"}
    assert make_plan().content == tl.LiveStudy.open(plan.folder).content == json.loads(before)
    assert (plan.folder / "study.json").read_bytes() == before
    for other, words in (
        ({"laps": 2}, "laps"),
        ({"conditions": ["C1", "C2"]}, "conditions, orders"),
    ):
        with refused(f"holds a frozen plan with other {words}; open it"):
            make_plan(**other)


def test_tokens_are_nowhere_in_the_study(make_plan):
    plan = make_plan()
    words = "".join(path.read_text() for path in plan.folder.rglob("*") if path.is_file())
    words += plan._repr_html_() + repr(plan)
    assert not any(token in words for token in read_tokens(plan.folder).values())


def test_what_makes_no_study_is_refused_and_nothing_is_left(make_plan, tmp_path):
    own = {"task": "teleoperation", "guidance": "nonsense"}
    for more, said in (
        ({"participants": {"P01", "P02"}}, "must be in an order"),
        ({"participants": ["p01", "P01"]}, "two codes are the same"),
        ({"participants": ["-rf", "b"]}, "begins with a letter"),
        ({"participants": ["x" * 41, "b"]}, "at most 40"),
        (
            {"participants": "A7"},
            "no list of codes, must be a whole number, from 1 to 999, got 'A7'",
        ),
        ({"lap": 2}, "a setting must be one of 'laps', .* got 'lap'; did you mean 'laps'"),
        ({"conditions": ["M", "MI"], "short": own}, "guidance must be one of"),
    ):
        with refused(said):
            make_plan(**more)
    assert not (tmp_path / "mystudy").exists()
    with refused("do not fill whole squares"):
        tl.LiveStudy(tmp_path / "a", ["C1", "C3"], 3)
    with refused("has other files in it"):
        tl.LiveStudy(tmp_path)
    with refused(r"there is no study\.json in"):
        tl.read_live_study(tmp_path)
    (tmp_path / "mystudy").touch()
    with refused("mystudy is a file; a study needs a folder of its own"):
        make_plan()


def test_the_command_line_plans_and_complains(tmp_path, monkeypatch, capsys):
    serve, folder, proxy = Mock(), str(tmp_path / "mystudy"), "https://lab.test"
    monkeypatch.setattr(tl.LiveStudy, "serve", serve)
    assert main([folder]) == main([folder, "--port", "9000", "--url", proxy, "--enrol"]) == 0
    usual = {"port": 8765, "url": "", "enrol": False}
    assert serve.mock_calls == [call(**usual), call(port=9000, url=proxy, enrol=True)]
    assert len(tl.LiveStudy.open(folder).orders) == 20
    assert main([str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "A new study: C1 to C5, 20 participants" in said.out
    assert "has other files in it" in said.err


def test_a_deletion_that_fails_is_told_and_the_next_one_finishes_it(make_plan, monkeypatch):
    plan = make_plan()
    (plan.folder / "P01" / "events.jsonl").touch()

    with monkeypatch.context() as patched:
        patched.setattr(shutil, "rmtree", Mock(side_effect=PermissionError))
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
    assert recorded(plan).deleted == []
    with serving(plan) as served:
        assert served.state("P02").json["page"] == 0


def test_damaged_files_beside_the_study_and_links_that_are_not_here_are_named(make_plan):
    plan = make_plan()
    for path in (links_path(plan.folder), tokens_path(plan.folder)):
        path.write_bytes(b'{"P01": "\xff')
        path.chmod(0o600)
        with refused(f"{path.name} was damaged"):
            StudyServer(plan).__enter__()
        path.unlink()
    with refused("links of this study are not on this machine"):
        StudyServer(plan).__enter__()


def test_a_participant_may_be_called_experimenter(make_plan):
    """The experimenter's link was theirs."""
    with StudyServer(make_plan(participants=["experimenter", "B"])) as server:
        assert server.links()["experimenter"][-22:] != server.experimenter[-22:]


def test_a_rehearsal_that_was_interrupted_begins_again(make_team_plan, monkeypatch):
    """A notebook keeps the traceback, and with it all that the call held."""
    plan, interrupted = make_team_plan(), Mock(side_effect=KeyboardInterrupt)
    with monkeypatch.context() as patched:
        patched.setattr("trustlab.live.study.participant.Trial.take", interrupted)
        with pytest.raises(KeyboardInterrupt) as kept:
            plan.rehearse()
    plan.rehearse()
    assert kept.tb
    assert recorded(plan).participants["complete"].all()


def test_conditions_that_cannot_be_are_refused():
    condition = partial(tl.LiveCondition, "a", notice=10.0)
    for make, given, said in (
        (condition, "tsc", "notice has no effect without forced=True"),
        (condition, {"speed": 1.0}, "a signal of suggestions must be one of"),
        (partial(tl.LiveGroundRobot, "C1", model()), (0.0, 0.3), "thresholds have no effect in C1"),
        (partial(tl.LiveGroundRobot, "C1", model(), None), 9, "laps .* from 1 to 8, got 9"),
    ):
        with refused(said):
            make(given)


def driven(config, hand):
    """The log of a whole drive."""
    _, rows = scripted_commands(TASK, config, hand)
    return pd.DataFrame(rows, columns=config["columns"])


def test_conditions_and_courses_of_ones_own_are_driven(make_plan):
    """
    A notice of 10 s and a rule, on another course. Oracles: the time from suggestion to switch in
    the log; the rule written out over the log's columns.
    """

    course = tl.testbeds.Course(((0, 0), (9, 0), (9, 9), (0, 9)), radius=2.0)

    def planned(one):
        """The plan with whole numbers given as such, or not."""
        slow = tl.LiveCondition("slow", "tsc", forced=True, notice=10 * one)
        weights = {"r": 10 * one, "p_h": -5 * one}  # no sum that lies within [−1, 1]
        rest = tl.LiveCondition("rest", weights, thresholds=(one, 3 * one))
        options = {"course": course, "laps": 3 * one, "training": 5.0, "rehearsal": True}
        options["pages"] = "[identification]\nskip = true"
        return make_plan(["C3", slow, rest], 1, **options)

    plan = planned(1)
    assert planned(1.0).content == plan.content
    for name, notice in (("C3", 3.0), ("slow", 10.0)):
        config = drive_of(plan.content, name, seed=1)
        assert config["path"] == course.path.tolist()
        hand = HumanHand(config, 1)
        log = driven(config, lambda picture, hand=hand: [*hand(picture)[:2], 1])  # never accepts
        mode = log["mode"].to_numpy()
        switch = np.flatnonzero(np.diff(mode))[0] + 1
        stands = (log["suggested_mode"] >= 0) & (log["suggested_mode"] != mode)
        last = np.flatnonzero(~stands[:switch])[-1]
        assert 0.1 * (switch - last - 1) == pytest.approx(notice, abs=0.11), name
    config = drive_of(plan.content, "rest", seed=1)
    log = driven(config, HumanHand(config, 1))  # always does
    standing, expected = 1, [-1] * 1000  # in the first 100 s nothing is suggested
    for value in (10.0 * log["r"] - 5.0 * log["p_h"])[1000:]:
        standing = 0 if value >= 3.0 else 1 if value <= 1.0 else standing
        expected.append(standing)
    assert log["suggested_mode"].tolist() == expected
    assert set(log["mode"]) == {0, 1}
    assert config["facts"]["rule"] == {"p_h": -5.0, "r": 10.0}
    plan.rehearse(seed=0)
    measures = recorded(plan).measures
    assert set(measures["condition"]) == {"C3", "slow", "rest"}
    assert measures["verified"].all()


def test_a_study_in_the_folder_of_a_removed_one_knows_nothing_of_it(tmp_path):
    """Everybody was locked out: their last lines were missing."""
    links_path(tmp_path / "a").write_text('{"P01": "0123456789abcdef"}')
    plan = tl.LiveStudy(tmp_path / "a", ["C1", "C3"], 2, rehearsal=True)
    assert not recorded(plan).faults()["fault"].any()
