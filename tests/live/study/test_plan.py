"""
The plan: frozen once, the same at every opening, refused where it would change. Oracle: the Latin
square of the design.
"""

import json

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.live.hands import HumanHand
from trustlab.live.study import live_study as planning
from trustlab.live.study.__main__ import main
from trustlab.live.study.drives import drive_of
from trustlab.live.study.plan import read_tokens
from trustlab.live.tasks.ground_robot import TASK, Drive
from trustlab.testbeds.ground_robot.kernel import COLUMNS


def test_the_plan_is_frozen_and_opens_again(make_plan, tmp_path):
    plan = make_plan()
    before = (plan.folder / "study.json").read_bytes()
    design = tl.latin_square_design(["C1", "C3"], ["P01", "P02", "P03"], 0, whole_squares=False)
    assert plan.table().equals(design.table())
    assert sorted(path.name for path in plan.folder.iterdir()) == [
        "P01",
        "P02",
        "P03",
        "study.json",
    ]
    assert make_plan().content == tl.LiveStudy.open(plan.folder).content == json.loads(before)
    assert (plan.folder / "study.json").read_bytes() == before
    with pytest.raises(
        ValueError, match="holds a frozen plan with other conditions, orders; open it with"
    ):
        make_plan(["C1", "C2"])
    with pytest.raises(ValueError, match="holds a frozen plan with other laps"):
        make_plan(laps=2)


def test_tokens_are_nowhere_in_the_study(make_plan):
    plan = make_plan()
    words = "".join(path.read_text() for path in plan.folder.rglob("*") if path.is_file())
    assert not any(token in words for token in read_tokens(plan.folder).values())
    assert not any(
        token in plan._repr_html_() + repr(plan) for token in read_tokens(plan.folder).values()
    )


@pytest.mark.filterwarnings("ignore:.*do not fill whole squares")
def test_faults_of_a_plan(tmp_path):
    cases = [
        ({"conditions": ["C1", "C9"]}, "condition must be one of"),
        ({"conditions": ["C1"]}, "at least 2"),
        (
            {"participants": 3, "conditions": ["C1", "C2"]},
            "participants: 3 do not fill whole squares",
        ),
        (
            {"participants": ["P01", "Jane Doe"], "conditions": ["C1", "C2"]},
            "code has letters, digits, - and _ only, at most 40, .* got 'Jane Doe'",
        ),
        ({"participants": ["p01", "P01"]}, "two codes are the same"),
        ({"participants": ["../x", "b"], "conditions": ["C1", "C2"]}, "code has letters"),
        ({"participants": ["-rf", "b"], "conditions": ["C1", "C2"]}, "begins with a letter"),
        ({"participants": ["x" * 300, "b"], "conditions": ["C1", "C2"]}, "at most 40"),
        ({"thresholds": (0.0, 0.3)}, "belong together"),
        ({"identification": [(1, 100.0)]}, "phases of both modes"),
        (
            {"identification": [(2, 100.0)]},
            "a mode of identification must be a whole number, from 0 to 1",
        ),
        ({"laps": 0}, "laps must be a whole number"),
        ({"training": -1.0}, "training must be positive"),
    ]
    for number, (given, said) in enumerate(cases):
        with pytest.raises(ValueError, match=said):
            tl.LiveStudy(tmp_path / str(number), **{"participants": 20, **given})
        assert not (tmp_path / str(number)).exists()
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "thesis.tex").touch()
    with pytest.raises(ValueError, match="has other files in it"):
        tl.LiveStudy(tmp_path / "own")
    with pytest.raises(ValueError, match=r"there is no study\.json in"):
        tl.read_live_study(tmp_path)


def test_the_command_line_plans_deletes_and_complains(tmp_path, monkeypatch, capsys):
    served = []
    monkeypatch.setattr(
        planning.LiveStudy,
        "serve",
        lambda plan, *where, **options: served.append((plan.folder.name, *where)),
    )
    folder = tmp_path / "mystudy"
    assert main([str(folder), "--delete", "P01"]) == 2
    assert main([str(folder)]) == 0
    assert main([str(folder), "--port", "9000"]) == 0
    assert served == [("mystudy", "127.0.0.1", 8765), ("mystudy", "127.0.0.1", 9000)]
    assert len(tl.LiveStudy.open(folder).orders) == 20
    assert main([str(folder), "--delete", "P07"]) == 0
    assert tl.LiveStudy.open(folder).deleted() == ["P07"]
    assert main([str(folder), "--delete", "P99"]) == 2
    said = capsys.readouterr()
    assert "A new study: C1 to C5, 20 participants" in said.out
    assert "error: participant must be one of 'P01'" in said.err


def test_conditions_and_courses_of_ones_own_are_driven(make_plan):
    """A notice of 10 s, on another course. Oracle: time from suggestion to switch in the log."""
    slow = tl.LiveCondition("slow", suggestions="tsc", forced=True, notice=10.0)
    course = tl.testbeds.Course(((0, 0), (9, 0), (9, 9), (0, 9)), radius=2.0)
    options = {"course": course, "laps": 3, "training": 5.0, "rehearsal": True}
    plan = make_plan(["C3", slow], 2, **options)
    assert make_plan(["C3", slow], 2, **options).content == plan.content
    with pytest.raises(ValueError, match="holds a frozen plan with other own_conditions"):
        make_plan(["C3", tl.LiveCondition("slow", "tsc", True, 9.0)], 2, **options)
    for name, notice in (("C3", 3.0), ("slow", 10.0)):
        config = drive_of(plan.content, name, plan.content["stand_in"], seed=1)
        assert config["path"] == course.path.tolist()
        drive, hand = Drive(config), HumanHand(config, 1)
        rows = []
        while not drive.done:  # a hand that accepts nothing
            rows.append(drive.step(*hand.step(drive.picture()), 1.0))
        rows = np.array(rows)
        suggested = rows[:, COLUMNS.index("suggested_mode")]
        mode = rows[:, COLUMNS.index("mode")]
        switch = np.flatnonzero(np.diff(mode))[0] + 1
        stands = (suggested >= 0) & (suggested != mode)
        stands[switch] = True
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
    config = drive_of(plan.content, "rest", plan.content["stand_in"], seed=1)
    drive, hand = Drive(config), HumanHand(config, 1)
    rows = []
    while not drive.done:  # a hand that accepts everything
        suggested = drive.state["suggested"]
        mode = drive.state["mode"] if suggested < 0 else suggested
        rows.append(drive.step(*hand.step(drive.picture()), float(mode)))
    log = pd.DataFrame(rows, columns=[*COLUMNS, "laps"])
    score = log["r"] - 0.5 * log["p_h"]
    standing, expected = 1, []
    for k, value in enumerate(score):
        if 0.1 * k < 100.0 - 1e-9:
            expected.append(-1)
            continue
        standing = 0 if value >= 0.3 else 1 if value <= 0.1 else standing
        expected.append(standing)
    assert log["suggested_mode"].tolist() == expected
    assert set(log["mode"]) == {0, 1}
    session = TASK.session(config, rows)
    assert session.metadata.more["rule"] == {"p_h": -0.5, "r": 1.0}


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"name": "two words"}, "a condition's name has letters"),
        ({"name": "a", "suggestions": "tsc", "notice": -1.0}, "notice"),
        ({"name": "a", "suggestions": "tsc", "thresholds": (0.1, 0.2)}, "participant's own"),
    ],
)
def test_faults_of_conditions(settings, says):
    with pytest.raises(ValueError, match=says):
        tl.LiveCondition(**settings)
