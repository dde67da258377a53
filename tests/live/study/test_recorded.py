"""
What comes out of a study. Oracles: the files themselves, summed by hand; a bit that is changed on
its way must be found.
"""

import io
import json
import zipfile
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest
from pyarrow.parquet import read_table

import trustlab as tl
from tests.cases import refused
from tests.live.cases import advance, entries, events, recorded, written
from trustlab.live.fit import FROM_PART, FROM_STAND_IN, identified
from trustlab.live.hands import HumanHand
from trustlab.live.study.participant import Participant
from trustlab.live.study.recorded import write_export
from trustlab.live.task import scripted_commands
from trustlab.live.tasks.ground_robot import TASK, drive_config, model_of
from trustlab.testbeds import published_operator
from trustlab.testbeds.ground_robot.kernel import drive_modes

pytestmark = pytest.mark.xdist_group("recorded")  # one worker rehearses the studies of all
TURNED = list(tl.TRUST_CHECKLIST.reversed)

OWN_PAGE = """
[hours]
after = "consent"
title = "You"
text = "About you."
scored = "likert"
items = [
    {name = "games", text = "Games", low = 1, high = 5},
    {name = "late", text = "Late", low = 1, high = 5, reversed = true},
    {name = "hand", kind = "choice", text = "Hand", choices = ["left", "right"]},
    {name = "attention", text = "Mark 5 here.", expected = 5},
    {name = "words", text = "Write no.", kind = "text", expected = "no"},
]
"""


@pytest.fixture(scope="module")
def rehearsed(tmp_path_factory):
    """A rehearsed study of two conditions with short drives."""
    folder = tmp_path_factory.mktemp("studies")
    course = tl.testbeds.Course(((0, 0), (4, 0), (4, 4), (0, 4)), radius=1.0)
    short = {"laps": 1, "training": 5.0, "identification": [(1, 5.0), (0, 5.0)], "course": course}
    with pytest.warns(UserWarning, match="nobody may switch"):
        plan = tl.LiveStudy(
            folder / "mystudy",
            ["C1", "C3"],
            2,
            pages=written(folder, OWN_PAGE),
            rehearsal=True,
            **short,
        )
    plan.rehearse(seed=1)
    return recorded(plan)


def test_measures_are_those_of_the_files(rehearsed):
    measures = rehearsed.measures.set_index(["participant", "condition"])
    assert len(measures) == 4
    assert measures["synthetic"].all()
    for (code, condition), row in measures.iterrows():
        logs = map(entries, (rehearsed.plan.folder / code).glob("*-drive.jsonl"))
        header, *rest = next(log for log in logs if log[0]["settings"]["condition"] == condition)
        rows = [row for entry in rest for row in entry.get("rows", [])]
        table = pd.DataFrame(rows, columns=header["settings"]["columns"])
        assert row["p_r"] == pytest.approx(table["p_r"].mean(), rel=1e-13)
        assert row["duration"] == pytest.approx((len(table) - 1) * 0.1, abs=1e-9)
        assert row["position"] == rehearsed.plan.orders[code].index(condition) + 1
        own = {
            event["name"]: pd.Series(event["answers"])
            for event in events(rehearsed.plan, code)
            if event.get("condition") == condition and "answers" in event
        }
        trust = own["trust"]
        trust[TURNED] = 8 - trust[TURNED]
        satisfaction = own["satisfaction"][["satisfaction", "comfort", "control"]]
        scores = [own["nasa_tlx"].mean(), trust.mean(), satisfaction.mean()]
        assert [*row[["tlx_raw", "trust_mean", "satisfaction_mean"]]] == pytest.approx(scores)


def test_answers_are_all_there_own_questionnaires_scored_and_checks_of_attention_counted(rehearsed):
    answers = rehearsed.answers()
    assert len(answers) == 2 * (1 + 5 + 2 * 22)
    assert answers.attrs["origin"] == "scripted hands, no person took part"
    hours = answers[answers["page"] == "hours"].set_index(["participant", "item"])
    for _, person in rehearsed.participants.iterrows():
        said = hours.loc[person["participant"]]
        games, late, attention = said.loc[["games", "late", "attention"], "answer"]
        assert person["hours_mean"] == (games + 6 - late) / 2
        assert person["attention"] == (attention != 5) + 1, "and no hand writes no"
        assert said.loc["hand", "text"] in ("left", "right")


def test_sessions_are_like_any_other_and_the_folder_is_as_it_was(rehearsed):
    def written():
        return {path: path.stat().st_mtime_ns for path in rehearsed.plan.folder.rglob("*")}

    before, again = written(), recorded(rehearsed.plan)
    assert again.measures.equals(rehearsed.measures)
    assert again.measures.attrs == {"origin": rehearsed.origin}
    about = again.sessions()[0].metadata
    assert about.synthetic
    assert {"verified", "thresholds_from", "performance_window", "lap_times"} <= set(about.more)
    assert written() == before


def test_the_export_holds_what_the_tables_do_and_says_what_it_means(rehearsed, tmp_path):
    """Oracle: the tables themselves."""
    archive = zipfile.ZipFile(rehearsed.export(tmp_path / "data.zip"))
    assert {entry.date_time[0] for entry in archive.infolist()} == {1980}  # no time of writing

    def table(name, read=pd.read_csv):
        return read(io.BytesIO(archive.read(name)))

    words = archive.read("README.txt").decode()
    assert "scripted hands, no person took part" in words
    assert "  p_r [m/s]: " in words
    assert "  p_r [m/s]: robot performance P_r as measured" in words.partition("samples.csv")[2]
    assert not [line for line in words.splitlines() if line.endswith(": ")], "all have a meaning"
    measures = table("measures.parquet", pd.read_parquet)
    pd.testing.assert_frame_equal(measures, rehearsed.measures, check_dtype=False)
    drive = table("samples.csv").query("participant == 'P02' and condition == 'C3'")
    session = {s.label: s for s in rehearsed.sessions()}["operator P02, C3, synthetic"]
    np.testing.assert_array_equal(drive["p_r"], session["p_r"])
    with pytest.raises(FileNotFoundError, match=r"none/data\.zip'$"):
        rehearsed.export(tmp_path / "none" / "data.zip")


def test_words_are_no_formulas_in_a_spreadsheet(tmp_path):
    table = pd.DataFrame({"text": ["=1+1", "@SUM(A1)", "-a", "fine"], "answer": -1.0})
    write_export(tmp_path / "a.zip", {"answers": table}, "A study.")
    archive = zipfile.ZipFile(tmp_path / "a.zip")
    lines = archive.read("answers.csv").decode().split()
    assert lines[1:] == ["'=1+1,-1.0", "'@SUM(A1),-1.0", "'-a,-1.0", "fine,-1.0"]
    whole = read_table(io.BytesIO(archive.read("answers.parquet")))  # as programs without pandas
    assert whole.to_pydict() == table.to_dict("list")


# a study of teams
# --------------------------------------------------------------------------------------------------


TEAM_PAGES = f"""
[training]
section = "each"

[trust]
low = 0
high = 10

[nasa_tlx]
low = 1
high = 5
step = 1

[trust_team]
after = "trust"
title = "x"
text = "y"
scored = "trust"
items = [{", ".join(f'{{name = "{name}", text = "x"}}' for name in tl.TRUST_CHECKLIST.items)}]

[one]
after = "trust"
title = "Trust"
text = "Your trust."
scored = "likert"
items = [
    {{name = "one", text = "How much do you trust it?", low = 0, high = 10}},
    {{name = "why", kind = "text", text = "Why?", required = true}},
]
"""


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    """
    A rehearsed study with practice before each drive; the server went away between the start of the
    first participant's first drive and its first command.
    """
    folder = tmp_path_factory.mktemp("teams")
    plan = tl.LiveStudy(
        folder / "team",
        ["by_hand", "most_trusted"],
        6,
        task="team",
        duration=2.0,
        training=1.0,
        rehearsal=True,
        pages=written(folder, TEAM_PAGES),
    )
    who = Participant(plan, "P01", scripted=True)
    who.drive({"page": advance(who, "drive"), "window": "a", "begin": True})
    who.close()
    plan.rehearse(0)
    return recorded(plan)


def test_questionnaires_have_scores_of_their_own_on_their_scales(team):
    """Oracle: the answers."""
    assert team.answers()["text"].dtype == "str"
    keys = ["participant", "condition", "page", "item"]
    answers = team.answers().dropna().set_index(keys)["answer"].sort_index()
    for _, row in team.measures.iterrows():
        said = answers[row["participant"], row["condition"]]
        for page, prefix, ends in (("trust", "", 10), ("trust_team", "trust_team_", 8)):
            own = said[page].copy()
            assert row[f"{prefix}distrust_subscale"] == pytest.approx(own[TURNED].mean())
            own[TURNED] = ends - own[TURNED]
            assert row[f"{page}_mean"] == pytest.approx(own.mean())
        assert row["one_mean"] == said["one", "one"]


def test_the_export_says_what_columns_mean_in_the_task_and_of_which_table(team):
    words = zipfile.ZipFile(team.export()).read("README.txt").decode()
    measures, samples = words.partition("measures.csv")[2].split("samples.csv")
    for line in (
        "path_error [m]: mean distance of the farthest robot from the goal",
        "switches [1]: changes of leader",
        "trust_mean: mean score of the questionnaire trust",
        "trust_team_distrust_subscale: score of the subscale trust_team_distrust",
    ):
        assert f"  {line}\n" in measures
    assert "  path_error [m]: deviation e from the path or target (a distance)\n" in samples


def test_practice_is_no_data_and_a_drive_that_was_begun_twice_is_one(team):
    assert len(team.measures) == len(team.sessions()) == len(team.complete()) == 12
    kinds = [event["kind"] for event in events(team.plan)]
    assert kinds.count("begin") == 4
    logs = (team.plan.folder / "P02").glob("*-training.jsonl")
    assert [entries(log)[0]["settings"]["condition"] for log in logs] == ["training"] * 2


def test_an_analysis_names_everybody_who_is_left_out(team, monkeypatch):
    """It left them out and said nothing, or asked for an argument that it does not take."""
    with changed(next((team.plan.folder / "P04").glob("*-drive.jsonl")), None):
        study = recorded(team.plan)
        measures = study.measures
        answered = measures["force"].mask(measures["participant"] == "P02")
        monkeypatch.setattr(type(study), "measures", measures.assign(force=answered))
        result = study.analysis("force")
    assert (result.n, result.excluded) == (4, ("P02", "P04"))
    assert "2 participants (P02, P04)" in result.apa()
    assert result.origin == study.origin


# what is changed afterwards
# --------------------------------------------------------------------------------------------------


@contextmanager
def changed(path, data):
    """Within this block a file holds other bytes; None is a file that is gone."""
    before = path.read_bytes()
    path.unlink() if data is None else path.write_bytes(data)
    yield
    path.write_bytes(before)


@pytest.fixture
def folder(rehearsed):
    return rehearsed.plan.folder


def verdict(folder):
    """The files that reading names, by an error or as those that fail, and the drives verified."""
    try:
        study = tl.read_live_study(folder)
        return set(study.faults()["file"]), int(study.measures["verified"].sum())
    except ValueError as error:  # what cannot be read at all is refused by name
        return {path.name for path in folder.rglob("*") if path.name in str(error)}, 0


@pytest.mark.parametrize("count", [16, pytest.param(200, marks=pytest.mark.long)])
def test_every_bit_that_is_changed_is_found(folder, count):
    """Change a bit at so many places of all files; each must be found, with its file's name."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    rng = np.random.default_rng(count)
    assert {path.suffix for path in files} == {".json", ".jsonl"}
    for number in range(count):
        path = files[number % len(files)]
        data = bytearray(path.read_bytes())
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        with changed(path, data):
            names, verified = verdict(folder)
        assert path.name in names, (path.name, names)
        # A drive under a condition does not rest on the rows of a training drive.
        assert verified < 4 or "training" in path.name or "identification" in path.name
    assert verdict(folder) == (set(), 4)


def test_rows_answers_and_plans_that_are_rewritten_are_found(folder):
    """Whole and readable files, each not as it was written; None is a file that is gone."""
    drive, other = (next(folder.glob(f"{code}/*-drive.jsonl")) for code in ("P01", "P02"))
    study, told = folder / "study.json", folder / "P01" / "events.jsonl"
    rows, said = (path.read_bytes().splitlines(keepends=True) for path in (drive, told))
    happier = told.read_bytes().replace(b'"comfort": ', b'"comfort": 1')
    assert happier != told.read_bytes()
    longer = json.dumps(json.loads(study.read_text()) | {"laps": 2}, indent=1)
    for path, data in [
        (drive, b"".join(rows[:2] + rows[3:])),
        (drive, b"".join(rows[:-1])),
        (drive, other.read_bytes()),
        (drive, None),
        (told, happier),
        (told, b"".join(said[:3] + said[4:])),
        (told, b"".join(said[:-2])),  # cut at a line's end
        (told, None),
        (study, longer.encode()),
    ]:
        with changed(path, data):
            names, verified = verdict(folder)
        assert path.name in names, (path.name, names)
        assert verified < 4


def exchange_folders(folder):
    first, second, away = folder / "P01", folder / "P02", folder / "x"
    for old, new in ((first, away), (second, first), (away, second)):
        old.rename(new)


def test_folders_of_two_participants_exchanged_are_named(folder):
    exchange_folders(folder)
    study = tl.read_live_study(folder)
    for table in (study.faults(), study.exclusions()):
        assert set(table["participant"]) == {"P01", "P02"}
    assert study.measures.empty
    for analysis in (study.analysis, study.order_effects):
        with refused("0 participants have all conditions; excl"):
            analysis("p_r")
    study.export().unlink()
    exchange_folders(folder)
    assert verdict(folder) == (set(), 4)


def test_a_damaged_file_of_one_stops_nobodys_table(folder):
    drive, told = next((folder / "P01").glob("*-drive.jsonl")), folder / "P01" / "events.jsonl"
    with changed(drive, drive.read_bytes().replace(b"{", b"\xff", 40)):
        study = tl.read_live_study(folder)
        assert set(study.complete()["participant"]) == {"P02"}
        assert set(study.exclusions()["participant"]) == {"P01"}
    with changed(told, told.read_bytes().replace(b'"begin"', b'"began"', 1)):
        reasons = tl.read_live_study(folder).exclusions()["reason"]
    said = reasons.str.contains("events.jsonl, line")
    assert said.tolist() == [True, True], "not that nothing was driven"


# the identification drive
# --------------------------------------------------------------------------------------------------


def test_a_drive_too_short_falls_back_to_the_plan_and_says_so(make_plan):
    content = make_plan().content
    session = drive_modes(np.repeat([1.0, 0.0], 300), published_operator(2), seed=1)
    found = identified(content, session.with_metadata(performance_window=100.0))
    assert found["source"] == FROM_STAND_IN
    assert found["why"].startswith("no model: 60 s of this drive determine no level")
    assert found["why"].endswith("another model's values")
    assert (found["model"], found["thresholds"]) == tuple(content["stand_in"].values())
    assert model_of(found["model"]) == tl.published_models()["2"]


def test_a_person_better_than_the_stand_in_at_the_best_has_a_model_too():
    """What a hand leaves weak is held, also where P_h,max of the stand-in is below its median."""
    content = tl.DriveSettings().as_json()
    config = drive_config(content, "identification", 0)
    _, rows = scripted_commands(TASK, config, HumanHand(config, 0))
    session = TASK.session(config, rows)
    assert np.median(session["p_h"]) > content["stand_in"]["model"]["human"]["p_max"]
    found = identified(content, session)
    assert found["source"] == FROM_PART
    assert "human_p_max" in found["why"]
