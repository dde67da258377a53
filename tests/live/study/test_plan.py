"""
The plan: frozen once, the same at every opening, refused where it would change. Oracle: the Latin
square of the design.
"""

import json

import pytest

import trustlab as tl
from trustlab.live.study import live_study as planning
from trustlab.live.study.__main__ import main
from trustlab.live.study.server import StudyServer


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
    from trustlab.live.study.store import read_tokens

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
            "3 participants do not fill whole squares",
        ),
        (
            {"participants": ["P01", "Jane Doe"], "conditions": ["C1", "C2"]},
            "code has letters, digits, - and _ only, got 'Jane Doe'",
        ),
        ({"participants": ["p01", "P01"]}, "two codes are the same"),
        ({"participants": ["../x", "b"], "conditions": ["C1", "C2"]}, "code has letters"),
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


def test_the_physics_must_be_the_one_of_the_plan(make_plan, monkeypatch):
    plan = make_plan()
    monkeypatch.setattr("trustlab.live.study.server.kernel_digest", lambda: "another")
    with pytest.raises(
        ValueError, match=r"was frozen with physics .* this version of trustlab has another"
    ):
        StudyServer(plan)


def test_other_addresses_need_a_certificate_and_one_server_serves(make_plan):
    plan = make_plan()
    with pytest.raises(
        ValueError, match=r"'0\.0\.0\.0' can be reached from other machines.*give certificate="
    ):
        plan.serve("0.0.0.0")
    with (
        StudyServer(plan),
        pytest.raises(ValueError, match="is being served already"),
        StudyServer(plan),
    ):
        pass


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
