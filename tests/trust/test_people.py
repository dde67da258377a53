"""Panels of real people: what the files hold, their repair, and tables of a user's own."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import loadmat

import trustlab as tl
from tests.cases import panel as few_people, refused
from trustlab.models.published import data_folder
from trustlab.trust import Event, people as sets, read_people
from trustlab.trust.likelihood import log_likelihood, predict

parametrize = pytest.mark.parametrize


def file_of(name):
    return data_folder("people") / sets.SETS[name][0]


def test_hybrid_panels_are_the_files():
    raw = json.loads(file_of("hybrid_real").read_text())
    panel = read_people("hybrid_real")
    assert_array_equal(panel.ratings, [person["trust"] for person in raw])
    signals = ("robot_decision_making", "human_decision_making", "state", "task_result")
    advice, decision, state, earned = (np.array(raw[17][name]) for name in signals)
    events = [panel.events.p_r[17], panel.events.followed[17], panel.events.p_h[17]]
    assert_array_equal(events, [advice == state, advice == decision, earned > 0])


def test_the_caution_on_reliance_is_true():
    for name in ("hybrid_real", "hybrid_vr"):
        panel = read_people(name)
        above = panel.ratings[:, :-1].ravel() > 0.5
        assert np.corrcoef(above, panel.events.followed.ravel())[0, 1] > 0.9
        assert "no conclusion on reliance" in panel.cautions[0]


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("hybrid_real", "19a50834eaed4553"),
        ("hybrid_vr", "57d9add2e9290609"),  # in which a comma is missing
        ("trust_transfer", "fadb8d79d62c5b5a"),
        ("btm", "787eca1ffaecf4ed"),
    ],
)
def test_files_are_those_published(name, digest):
    """By their SHA-256, first digits; with licence and source."""
    path = file_of(name)
    assert hashlib.sha256(path.read_bytes()).hexdigest().startswith(digest)
    beside = {other.name for other in path.parent.iterdir()}
    assert "NOTE.md" in beside
    assert beside & {"LICENSE", "LICENSE.md"}


def test_other_sets():
    transfer = read_people("trust_transfer")
    assert (len(transfer), transfer.trials) == (96, 1)
    raw = pd.read_csv(file_of("trust_transfer"))
    moved = [(raw[f"{task}2_rating"] - raw[f"{task}1_rating"]) / 6 for task in "CDE"]
    assert_allclose(np.diff(transfer.ratings)[:, 0], np.ravel(moved, order="F"))
    capabilities = read_people("btm")
    assert np.isfinite(capabilities.ratings[:, 1:]).sum() == 852
    assert np.isfinite(capabilities.events.dt).sum(axis=0).tolist() == [852, 568, 284]
    assert_allclose(np.unique(capabilities.ratings[:, 1:])[:7], np.arange(7) / 6)
    pairs = loadmat(file_of("btm"))["obs_task_perf_seq"]
    assert np.nansum(capabilities.events.p_r) == pairs[..., 1].sum()  # successes
    assert np.isfinite(log_likelihood(tl.trust.MODELS["performance"](), capabilities)).all()


def test_a_labs_file_by_recipe(tmp_path):
    """The first person has a missing rating, the second a missing trial."""
    path = tmp_path / "trust.csv"
    path.write_text("id,t,ok,answer\nA,0,0,4\nA,1,1,5\nA,2,0,\nB,0,0,7\nB,1,1,1\n")
    columns = {"person": "id", "trial": "t", "p_r": "ok", "rating": "answer"}
    recipe = {"columns": columns, "low": 1, "high": 7}
    panel = read_people(path, recipe)
    assert_allclose(panel.ratings, [[0.5, 4 / 6, np.nan], [1.0, 0.0, np.nan]])
    assert panel.resolution == pytest.approx(1 / 6)
    assert_array_equal(panel.events.p_r, [[1, 0], [1, np.nan]])
    assert read_people(pd.read_csv(path).assign(answer=4), recipe).resolution == 0.01


def test_missing_events_change_nothing():
    def longer(values):
        return np.pad(values, ((0, 0), (0, 3)), constant_values=np.nan)

    short = few_people()
    long = replace(short, events=Event(*map(longer, short.events)), ratings=longer(short.ratings))
    for name, model in tl.trust.MODELS.items():
        fits = [log_likelihood(model(), each) for each in (short, long)]
        assert_allclose(*fits, rtol=0.0, atol=1e-9, err_msg=name)
    # They last no time.
    course = predict(tl.trust.MODELS["performance"](), long).mean
    assert_allclose(course[:, -2:], course[:, -3:-1])


def test_a_recipe_may_be_a_file_scale_performance_and_lack_a_first_rating(tmp_path):
    rows = [("A", 2, 3.0, 1), ("A", 1, 0.0, 7), ("B", 1, 1.5, 4)]
    frame = pd.DataFrame(rows, columns=["who", "k", "cm", "trust"])
    path = tmp_path / "mine.toml"
    path.write_text(
        "low = 1\nhigh = 7\nbefore = false\nperformance = [3.0, 0.0]\n"
        'cautions = ["Mine."]\n[columns]\nperson = "who"\ntrial = "k"\np_r = "cm"\n'
        'rating = "trust"\n'
    )
    panel = read_people(frame, path)
    assert_array_equal(panel.events.p_r, [[1.0, 0.0], [0.5, np.nan]])
    assert_array_equal(panel.ratings, [[np.nan, 1.0, 0.0], [np.nan, 0.5, np.nan]])
    assert panel.cautions == ("Mine.",)


@pytest.mark.filterwarnings("ignore:nobody may switch:UserWarning")
def test_a_live_study_is_a_panel(tmp_path):
    """A rehearsal, whose answers are random: its panel has what its table of measures has."""
    pytest.importorskip("anywidget")
    course = tl.testbeds.Course(((0, 0), (4, 0), (4, 4), (0, 4)), radius=1.0)
    brief = {"training": 5.0, "identification": [(1, 5.0), (0, 5.0)], "course": course, "laps": 1}
    plan = tl.LiveStudy(tmp_path / "study", ["C1", "C3"], 2, 0, rehearsal=True, **brief)
    plan.rehearse(0)
    study = tl.read_live_study(tmp_path / "study")
    panel = read_people(study, {"performance": (0.0, 0.5)})
    rows = study.measures.sort_values(["participant", "position"])
    assert_allclose(panel.ratings[:, 1:].ravel(), (rows["trust_mean"] - 1.0) / 6.0)
    assert_allclose(panel.events.p_r.ravel(), rows["p_r"] / 0.5)
    assert np.isnan(panel.ratings[:, 0]).all()
    assert "scripted hands" in panel.source


def rows(**columns):
    """Two people in three rows each, the first before any event."""
    table = {"person": list("aaabbb"), "trial": [0, 1, 2] * 2, "rating": 0.5, "p_r": 1.0}
    return pd.DataFrame(table | columns)


@pytest.mark.parametrize(
    ("row", "column", "value", "message"),
    [
        (2, "person", None, "row 2 .* no person"),
        (0, "trial", "first", "row 0 .* no number of a trial"),
        (2, "trial", 1, "row 2 .* a second time"),
        (0, "rating", "a", "row 0 .* rating 'a'"),
        (4, "p_r", np.nan, "row 4 .* p_r nan, which must be a number from 0 to 1"),
        (1, "p_h", 55.0, "row 1 .* p_h 55.0, which must be a number from 0 to 1"),
        (1, "dt", -1.0, "dt -1.0, which must be a number from 0 to inf"),
    ],
)
def test_rows_that_are_no_trials_are_refused(row, column, value, message):
    """They were counted as further trials, sorted by the alphabet, or fitted as they were."""
    table = rows(p_h=0.5, dt=1.0).astype(object)
    table.loc[row, column] = value
    with refused(message):
        read_people(table)


def test_trials_in_text_are_in_the_order_of_numbers():
    """Trial "10" came before trial "9"."""
    table = rows(trial=["9", "10", "11"] * 2, rating=[0.1, 0.2, 0.3] * 2)
    assert_array_equal(read_people(table).ratings[0], [0.1, 0.2, 0.3])


@parametrize(
    ("name", "recipe", "message"),
    [
        ("hybrid_vrr", None, "did you mean 'hybrid_vr'"),
        ("hybrid_vr", {"low": 1, "high": 99}, "'hybrid_vr' .* recipe of its own"),
        (rows(), {"colums": {}}, "recipe's key.*'colums'.*did you mean 'columns'"),
        (rows(), {"columns": {"ratng": "rating"}}, "'ratng'.*did you mean 'rating'"),
        (rows(), {"columns": {"rating": "answers"}}, "no column 'answers'"),
        (rows(rating=7), {"low": 1, "high": 5}, "a number from 1 to 5; .* low and high"),
        (rows(), {"before": "no"}, "before must be True or False"),
        (rows(), {"performance": [1, 1]}, "performance"),
        (rows(), {"performance": [0.3, 0, 1]}, "performance must have 2"),
        (rows(), {"columns": ["rating"]}, "columns must be"),
        (rows(), {"cautions": "small"}, "cautions must be a list"),
        (rows(rating=4.0), {"low": 1, "high": 7, "resolution": 1}, "a share .* one point .* 0.16"),
        (rows()[::3], {}, "no event"),
    ],
)
def test_a_recipe_without_effect_or_sense_is_refused(name, recipe, message):
    """ "no" was taken for True, and a public set's recipe for nothing."""
    with refused(message):
        read_people(name, recipe)


def test_a_recipe_may_name_another_column_beside_one_of_the_signals_name():
    """The ratings are the answers, not what the table calls ratings."""
    table = pd.DataFrame({"person": "a", "trial": [0, 1], "rating": 9.0, "answer": [0.1, 0.2]})
    panel = read_people(table.assign(p_r=1.0), {"columns": {"rating": "answer"}})
    assert_array_equal(panel.ratings, [[0.1, 0.2]])


@parametrize("content", [b"person;trial\na;1\n", b"", b"a,b\n1,2\n1,2,3\n", b"a,b\n\xe9,1\n"])
def test_a_file_that_is_no_table_is_named_with_what_to_do(tmp_path, content):
    """The errors were those of pandas."""
    path = tmp_path / "mine.csv"
    path.write_bytes(content)
    with refused(r"mine.csv: no table .* commas and decimal points"):
        read_people(path)
    with refused(r"gone.toml: no recipe .* a file in TOML"):
        read_people(rows(), tmp_path / "gone.toml")
