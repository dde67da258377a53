"""
What comes out of a study. Oracles: the files themselves, summed by hand; a bit that is changed on
its way must be found.
"""

import io
import json
import zipfile

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.live.cases import advance, entries, events
from trustlab.live.fit import FROM_PART, FROM_STAND_IN, identified
from trustlab.live.hands import HumanHand
from trustlab.live.study.participant import Participant
from trustlab.live.study.recorded import write_export
from trustlab.live.task import scripted_commands
from trustlab.live.tasks.ground_robot import TASK, drive_config, model_of
from trustlab.live.trial import Trial
from trustlab.testbeds import published_operator
from trustlab.testbeds.ground_robot.conditions import drive_modes

pytestmark = pytest.mark.xdist_group("recorded")  # one worker rehearses the studies of all

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
]
"""


def planned(folder, participants, seconds, **more):
    """A study of two conditions to be rehearsed, with short drives."""
    phases = [(1, seconds), (0, seconds)]
    course = tl.testbeds.Course(((0, 0), (4, 0), (4, 4), (0, 4)), radius=1.0)
    short = {"laps": 1, "training": 5.0, "identification": phases, "rehearsal": True}
    with pytest.warns(UserWarning, match="nobody may switch"):
        return tl.LiveStudy(
            folder / "mystudy", ["C1", "C3"], participants, course=course, **short, **more
        )


@pytest.fixture(scope="module")
def rehearsed(tmp_path_factory):
    """
    A rehearsed study; in the first participant's second drive the computer makes a mistake of a
    millionth.
    """
    folder = tmp_path_factory.mktemp("studies")
    (folder / "pages.toml").write_text(OWN_PAGE)
    plan = planned(folder, 2, 10.0, pages=folder / "pages.toml")
    finish = Trial.finish

    def changed(trial, why):
        if trial.log.path == plan.folder / "P01" / "09-drive.jsonl":
            trial.rows[7][trial.settings["columns"].index("p_r")] += 1e-6
        finish(trial, why)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Trial, "finish", changed)
        plan.rehearse(seed=1)
    return tl.read_live_study(plan.folder)


def test_measures_are_those_of_the_files(rehearsed):
    measures = rehearsed.measures.set_index(["participant", "condition"])
    assert len(measures) == 4
    assert measures["synthetic"].all()
    for (code, condition), row in measures.iterrows():
        logs = map(entries, (rehearsed.plan.folder / code).glob("*-drive.jsonl"))
        header, *rest = next(log for log in logs if log[0]["condition"] == condition)
        rows = [row for entry in rest for row in entry.get("rows", [])]
        table = pd.DataFrame(rows, columns=header["settings"]["columns"])
        assert row["p_r"] == pytest.approx(table["p_r"].mean(), rel=1e-13)
        assert row["duration"] == pytest.approx((len(table) - 1) * 0.1, abs=1e-9)
        assert row["position"] == rehearsed.plan.orders[code].index(condition) + 1
        own = {
            event["name"]: event["answers"]
            for event in events(rehearsed.plan, code)
            if event.get("condition") == condition and "answers" in event
        }
        assert row["tlx_raw"] == pytest.approx(sum(own["nasa_tlx"].values()) / 6)
        turned = ("deceptive", "underhanded", "suspicious", "wary", "harmful")
        trust = [8 - x if name in turned else x for name, x in own["trust"].items()]
        assert row["trust_mean"] == pytest.approx(sum(trust) / 12)
        satisfaction = [own["satisfaction"][n] for n in ("satisfaction", "comfort", "control")]
        assert row["satisfaction_mean"] == pytest.approx(sum(satisfaction) / 3)


def test_answers_are_all_there_and_own_questionnaires_scored(rehearsed):
    answers = rehearsed.answers()
    assert len(answers) == 2 * (1 + 3 + 2 * 22)
    hours = answers[answers["page"] == "hours"].set_index(["participant", "item"])
    scores = rehearsed.scores()["hours"].scores.set_index("participant")["hours_mean"]
    for code, score in scores.items():
        games, late = (hours.loc[(code, name), "answer"] for name in ("games", "late"))
        assert score == (games + 6 - late) / 2
        assert hours.loc[(code, "hand"), "text"] in ("left", "right")
    assert answers.attrs["origin"] == "scripted hands, no person took part"


def test_sessions_are_like_any_other_and_the_folder_is_as_it_was(rehearsed):
    files = rehearsed.plan.folder.rglob
    before = {path: path.stat().st_mtime_ns for path in files("*")}
    again = tl.read_live_study(rehearsed.plan.folder)
    assert again.measures.equals(rehearsed.measures)
    assert again.measures.attrs == {"origin": rehearsed.origin}
    assert again.participants.equals(rehearsed.participants)
    session = again.sessions()[0]
    assert session.metadata.synthetic
    notes = {"verified", "thresholds_from", "performance_window", "lap_times"}
    assert notes <= set(session.metadata.more)
    assert {path: path.stat().st_mtime_ns for path in files("*")} == before


def test_the_export_holds_what_the_tables_do_and_says_what_it_means(rehearsed, tmp_path):
    """Oracle: the tables themselves."""
    path = rehearsed.export(tmp_path / "data.zip")
    archive = zipfile.ZipFile(path)
    assert {entry.date_time[0] for entry in archive.infolist()} == {1980}  # no time of writing
    words = archive.read("README.txt").decode()
    assert "scripted hands, no person took part" in words
    assert "  p_r [m/s]: " in words
    samples = words.partition("samples.csv")[2]
    assert "  p_r [m/s]: robot performance P_r as measured" in samples
    assert not [line for line in words.splitlines() if line.endswith(": ")], "all have a meaning"
    measures = pd.read_parquet(io.BytesIO(archive.read("measures.parquet")))
    pd.testing.assert_frame_equal(measures, rehearsed.measures, check_dtype=False)
    samples = pd.read_csv(io.BytesIO(archive.read("samples.csv")))
    drive = samples.query("participant == 'P02' and condition == 'C3'")
    labels = [s.label for s in rehearsed.sessions()]
    session = rehearsed.sessions()[labels.index("operator P02, C3, synthetic")]
    np.testing.assert_array_equal(drive["p_r"], session["p_r"])
    items = pd.read_csv(io.BytesIO(archive.read("items.csv")))
    assert "The robot is deceptive." in set(items["words"])
    turned = ["late", "deceptive", "underhanded", "suspicious", "wary", "harmful"]
    assert items.query("reversed")["item"].tolist() == turned


def test_a_folder_that_is_not_there_is_named(rehearsed, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none/data\.zip'$"):
        rehearsed.export(tmp_path / "none" / "data.zip")


def test_words_are_no_formulas_in_a_spreadsheet(tmp_path):
    table = pd.DataFrame(
        {"text": ["=1+1", "@SUM(A1)", "-a", "fine"], "answer": [-1.0, 2.0, 3.0, 4.0]}
    )
    write_export(tmp_path / "a.zip", {"answers": table}, "A study.")
    archive = zipfile.ZipFile(tmp_path / "a.zip")
    lines = archive.read("answers.csv").decode().splitlines()
    assert lines[1:] == ["'=1+1,-1.0", "'@SUM(A1),2.0", "'-a,3.0", "fine,4.0"]
    whole = pd.read_parquet(io.BytesIO(archive.read("answers.parquet")))
    assert whole["text"].tolist() == table["text"].tolist()


SCALES = """
[trust]
low = 0
high = 10

[nasa_tlx]
low = 1
high = 5
step = 1

[satisfaction]
low = 0
high = 10
"""
ONE_ITEM = """
[trust]
scored = "likert"
items = [{name = "trust", text = "How much do you trust it?", low = 0, high = 10}]

[why]
after = "trust"
title = "Why?"
text = "Say why."
items = [{name = "why", kind = "text", text = "Why?", required = true}]
"""


@pytest.mark.parametrize("pages", [SCALES, ONE_ITEM])
def test_questionnaires_on_other_scales_are_scored(make_team_plan, tmp_path, pages):
    (tmp_path / "pages.toml").write_text(pages)
    plan = make_team_plan(pages=tmp_path / "pages.toml")
    plan.rehearse(0)
    study = tl.read_live_study(plan.folder)
    assert study.measures["trust_mean"].between(0, 10).all()
    answers = study.answers()
    assert answers["text"].dtype == "str"
    rows = answers[(answers["page"] == "trust") & (answers["participant"] == "P01")]
    one = rows[rows["condition"] == "by_hand"]["answer"]
    own = study.measures.set_index(["participant", "condition"]).loc[("P01", "by_hand")]
    if pages == ONE_ITEM:
        assert own["trust_mean"] == one.item()
    assert study.export().exists()


CHECKED = """
[own]
after = "consent"
title = "You"
text = "About you."
scored = "likert"
items = [
    {name = "a", text = "A"},
    {name = "b", text = "B"},
    {name = "attention", text = "Mark 5 here.", expected = 5},
    {name = "words", text = "Write no.", kind = "text", expected = "no"},
]
"""


def test_checks_of_attention_are_counted_and_not_scored_and_scores_before_drives_are_in_a_table(
    make_team_plan, tmp_path
):
    """Oracle: the mean of 1 and 1."""
    (tmp_path / "pages.toml").write_text(CHECKED)
    plan = make_team_plan(pages=tmp_path / "pages.toml")
    who = Participant(plan, "P01")
    who.answers({"page": 0, "answers": {"consent": True}})
    who.answers({"page": 1, "answers": {"a": 1, "b": 1, "attention": 5, "words": "yes"}})
    people = tl.read_live_study(plan.folder).participants
    assert people["own_mean"].tolist() == pytest.approx([1.0, np.nan], nan_ok=True)
    assert people["attention"].tolist() == [1, 0]


def test_two_pages_of_one_questionnaire_have_scores_of_their_own(make_team_plan, tmp_path):
    """Oracle: the answers. What columns mean in the task, and of which table, is said as well."""
    items = "".join(f'{{name = "{name}", text = "x"}},' for name in tl.TRUST_CHECKLIST.items)
    head = '[trust_team]\nafter = "trust"\ntitle = "x"\ntext = "y"\nscored = "trust"\n'
    (tmp_path / "pages.toml").write_text(f"{head}items = [{items}]\n")
    plan = make_team_plan(pages=tmp_path / "pages.toml")
    plan.rehearse(0)
    study = tl.read_live_study(plan.folder)
    answers = study.answers().set_index(["participant", "condition", "page"])
    for _, row in study.measures.iterrows():
        for page, prefix in (("trust", ""), ("trust_team", "trust_team_")):
            own = answers.loc[(row["participant"], row["condition"], page)].set_index("item")
            distrust = own.loc[list(tl.TRUST_CHECKLIST.reversed), "answer"].mean()
            assert row[f"{prefix}distrust_subscale"] == pytest.approx(distrust)
    words = zipfile.ZipFile(study.export()).read("README.txt").decode()
    measures, samples = words.partition("measures.csv")[2].split("samples.csv")
    for line in (
        "path_error [m]: mean distance of the farthest robot from the goal",
        "switches [1]: changes of leader",
        "trust_mean: mean score of the questionnaire trust",
        "trust_team_distrust_subscale: score of the subscale trust_team_distrust",
    ):
        assert f"  {line}\n" in measures
    assert "  path_error [m]: deviation e from the path or target (a distance)\n" in samples


def test_a_drive_that_was_begun_twice_is_one(make_team_plan):
    """The server went away between the start and the first command. Oracle: two drives each."""
    plan = make_team_plan(4)
    who = Participant(plan, "P01", scripted=True)
    who.drive({"page": advance(who, "drive"), "window": "a", "begin": True})
    who.close()
    plan.rehearse(0)
    study = tl.read_live_study(plan.folder)
    kinds = [event["kind"] for event in events(plan, "P01")]
    assert kinds.count("begin") == 3
    assert len(study.measures) == len(study.sessions()) == 8
    assert study.analysis("force").n == 4


PRACTICE = """
[training]
section = "each"
"""


def test_practice_before_each_drive_is_no_data(make_team_plan, tmp_path):
    (tmp_path / "pages.toml").write_text(PRACTICE)
    plan = make_team_plan(pages=tmp_path / "pages.toml")
    for analysis in ("analysis", "order_effects"):
        with pytest.raises(ValueError, match="0 participants have all conditions; excl"):
            getattr(tl.read_live_study(plan.folder), analysis)("force")
    plan.rehearse(0)
    study = tl.read_live_study(plan.folder)
    assert len(study.measures) == len(study.sessions()) == 4
    assert len(study.complete()) == 4
    logs = (plan.folder / "P01").glob("*-training.jsonl")
    assert [entries(log)[0]["settings"]["condition"] for log in logs] == ["training"] * 2


# what is changed afterwards
# --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A rehearsed study in which nothing is wrong."""
    plan = planned(tmp_path_factory.mktemp("studies"), 2, 5.0)
    plan.rehearse(seed=1)
    return plan.folder


def verdict(folder):
    """The files that reading names, by an error or as those that fail, and the drives verified."""
    try:
        study = tl.read_live_study(folder)
        return set(study.faults()["file"]), int(study.measures["verified"].sum())
    except ValueError as error:  # what cannot be read at all is refused by name
        return {path.name for path in folder.rglob("*") if path.name in str(error)}, 0


@pytest.mark.parametrize("count", [16, pytest.param(200, marks=pytest.mark.long)])
def test_every_bit_that_is_changed_is_found(finished, count):
    """Change a bit at so many places of all files; each must be found, with its file's name."""
    files = sorted(path for path in finished.rglob("*") if path.is_file())
    rng = np.random.default_rng(count)
    assert {path.suffix for path in files} == {".json", ".jsonl"}
    for number in range(count):
        path = files[number % len(files)]
        data = path.read_bytes()
        changed = bytearray(data)
        changed[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        path.write_bytes(changed)
        names, verified = verdict(finished)
        path.write_bytes(data)
        assert path.name in names, (path.name, names)
        # A drive under a condition does not rest on the rows of a training drive.
        assert verified < 4 or "training" in path.name or "identification" in path.name
    assert verdict(finished) == (set(), 4)


def test_rows_answers_and_plans_that_are_rewritten_are_found(finished):
    """Whole and readable files, each not as it was written; None is a file that is gone."""
    drive, other = (next(finished.glob(f"{code}/*-drive.jsonl")) for code in ("P01", "P02"))
    study, events = finished / "study.json", finished / "P01" / "events.jsonl"
    lines = drive.read_text().splitlines(keepends=True)
    told = events.read_text().splitlines(keepends=True)
    happier = [line.replace('"comfort": ', '"comfort": 1') for line in told]
    assert happier != told
    longer = json.dumps(json.loads(study.read_text()) | {"laps": 2}, indent=1)
    for path, text in [
        (drive, "".join(lines[:2] + lines[3:])),
        (drive, "".join(lines[:-1])),
        (drive, other.read_text()),
        (drive, None),
        (events, "".join(happier)),
        (events, "".join(told[:3] + told[4:])),
        (events, "".join(told[:-2])),  # cut at a line's end
        (events, None),
        (study, longer),
    ]:
        before = path.read_bytes()
        path.unlink() if text is None else path.write_text(text)
        names, verified = verdict(finished)
        path.write_bytes(before)
        assert path.name in names, (path.name, names)
        assert verified < 4
    assert verdict(finished) == (set(), 4)


def exchange_folders(folder):
    first, second, away = folder / "P01", folder / "P02", folder / "x"
    for old, new in ((first, away), (second, first), (away, second)):
        old.rename(new)


def test_folders_of_two_participants_exchanged_are_named(finished):
    exchange_folders(finished)
    study = tl.read_live_study(finished)
    assert set(study.faults()["participant"]) == {"P01", "P02"}
    assert study.measures.empty
    assert set(study.exclusions()["participant"]) == {"P01", "P02"}
    study.export().unlink()
    exchange_folders(finished)
    assert verdict(finished) == (set(), 4)


def test_a_damaged_file_of_one_stops_nobodys_table(finished):
    path = next((finished / "P01").glob("*-drive.jsonl"))
    before = path.read_bytes()
    path.write_bytes(before.replace(b"{", b"\xff", 40))
    study = tl.read_live_study(finished)
    assert set(study.complete()["participant"]) == {"P02"}
    assert set(study.exclusions()["participant"]) == {"P01"}
    path.write_bytes(before)


def test_a_drive_behind_a_fault_is_not_said_to_be_undriven(finished):
    path = finished / "P01" / "events.jsonl"
    before = path.read_bytes()
    path.write_bytes(before.replace(b'"begin"', b'"began"', 1))
    reasons = tl.read_live_study(finished).exclusions()["reason"]
    path.write_bytes(before)
    assert reasons.str.contains("events.jsonl, line").tolist() == [True, True]


# the identification drive
# --------------------------------------------------------------------------------------------------


def drive(participant, *phases):
    mode = np.concatenate([np.full(round(10 * seconds), which) for which, seconds in phases])
    session = drive_modes(mode, published_operator(participant), seed=1)
    return session.with_metadata(performance_window=100.0)


def test_a_drive_too_short_falls_back_to_the_plan_and_says_so(make_plan):
    plan = make_plan()
    found = identified(plan.content, drive(2, (1, 30.0), (0, 30.0)))
    assert found["source"] == FROM_STAND_IN
    assert found["why"].startswith("no model: 60 s of this drive determine no level")
    assert found["why"].endswith("another model's values")
    assert (found["model"], found["thresholds"]) == tuple(plan.content["stand_in"].values())
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


def test_an_analysis_names_everybody_who_is_left_out(make_team_plan, monkeypatch):
    """It left them out and said nothing, or asked for an argument that it does not take."""
    plan = make_team_plan(6)
    plan.rehearse(0)
    next((plan.folder / "P04").glob("*-drive.jsonl")).unlink()
    study = tl.read_live_study(plan.folder)
    measures = study.measures
    unanswered = measures.assign(force=measures["force"].mask(measures["participant"] == "P02"))
    monkeypatch.setattr(type(study), "measures", unanswered)
    result = study.analysis("force")
    assert (result.n, result.excluded) == (4, ("P02", "P04"))
    assert "2 participants (P02, P04)" in result.apa()
    assert result.origin == study.origin
