"""
What each rule of a recipe does to a log, and recipes drafted from one.

Oracles: values computed by hand; the values of the log, written out.
"""

import gzip
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.cases import refused
from tests.sessions.logs import table_recipe
from trustlab.sessions import draft_recipe, read_frame, read_session
from trustlab.sessions.recipe import Recipe

# --- rules ----------------------------------------------------------------------------------------


LAB = """
name = "lab"
kind = "table"
performance_window = 100

[files]
pattern = "p{who:int}/run{trial:int}.csv"

[header]
file = "p{who}/runs.csv"
keys = { trial = "run" }

[table]
delimiter = ";"
decimal = ","
skip_lines = 1

[time]
column = "stamp"
unit = "ms"
from_zero = true

[columns]
mode = { column = "driver", map = { HUMAN = 1, ROBOT = 0, both = 0.5 } }
robot_x = { column = "x", unit = "mm" }
robot_y = { column = "y", unit = "cm", scale = -1.0, offset = 5.0 }
reference_x = { value = 20, unit = "cm" }
reference_y = { value = 0.0, unit = "m" }
yaw = { column = "heading", unit = "deg" }
r = { from = "header.share", unit = "%" }
beta = { from = "header.level", map = { low = 0.1, high = 0.9 } }
alpha = { from = "trial", scale = 0.1, offset = 0.2 }
path_error = { distance = ["robot", "reference"], axes = ["x", "y"] }
step_distance = { travelled = "robot", axes = ["x"] }

[metadata]
participant = { from = "who" }
group = { from = "who", map = { 1 = "A", 2 = "B" } }
condition = { from = "header.level" }
trial = { from = "trial" }
training = { from = "trial", map = { 1 = true }, default = false }
site = { value = "north" }
synthetic = { value = true }
"""
ROWS = """logger v2
stamp;x;y;heading;driver;junk
5000;0;5;180;HUMAN;a
5100;100;1,5;-90;ROBOT;b
5200;400;5;0;both;c
"""


def test_every_rule(tmp_path):
    lab, recipe = tmp_path / "p2" / "run3.csv", tmp_path / "lab.toml"
    lab.parent.mkdir()
    recipe.write_text(LAB)
    (lab.parent / "runs.csv").write_text("run,share,level\n1,10,low\n03.0,30,high\n")
    lab.write_text(ROWS)
    session = read_session(lab, recipe)
    expected = {
        "mode": [1, 0, 0.5],
        "robot_x": [0, 0.1, 0.4],
        "robot_y": [0, 0.035, 0],
        "reference_x": 0.2,
        "reference_y": 0,
        "yaw": [np.pi, -np.pi / 2, 0],
        "r": 0.3,
        "beta": 0.9,
        "alpha": 0.5,
        "path_error": [0.2, np.hypot(0.1, 0.035), 0.2],
        "step_distance": [0.1, 0.1, 0.3],
    }
    assert session.columns == list(expected)
    for name, values in expected.items():
        assert_allclose(session[name], values, rtol=1e-15, atol=1e-15, err_msg=name)
    assert_allclose(session.t, [0, 0.1, 0.2], rtol=1e-15)
    facts = session.metadata
    assert (facts.participant, facts.condition, facts.synthetic) == (2, "high", True)
    derived = {"trial": 3, "group": "B", "training": False, "site": "north"}
    assert dict(facts.more) == derived | {"start_time": 5.0, "performance_window": 100}
    # Columns by name bring what they are computed from, and no more.
    assert read_session(lab, recipe, columns=["path_error"]).columns == ["path_error"]


@pytest.mark.parametrize("zone", ["", "Z", "+01:00"])
def test_dates_keep_their_digits(read, zone):
    """Oracle: fractions of whole numbers, exact to the rounding of one float."""
    stamps = [999_999_999 + 123_456_789 * k for k in range(400)]  # every step has nine digits
    times = [f"2026-03-01T12:00:{ns // 10**9:02}.{ns % 10**9:09}{zone}" for ns in stamps]
    frame = pd.DataFrame({"t": times, "p_r": 1.0})
    text = '[time]\nunit = "iso"\nfrom_zero = true\n[columns]\np_r = { column = "p_r" }'
    stamps_of_pandas = frame.assign(t=pd.to_datetime(frame["t"]))
    sessions = [
        read(frame.to_csv(index=False), text),
        read_frame(stamps_of_pandas, table_recipe(text)),
    ]
    start = pd.Timestamp(times[0]).timestamp()
    for session in sessions:
        assert session.t.tolist() == [float(Fraction(ns - stamps[0], 10**9)) for ns in stamps]
        assert session.metadata.more["start_time"] == start
    since_1970 = read_frame(frame, table_recipe(text.replace("true", "false")))
    assert_allclose(since_1970.t, start + sessions[0].t, rtol=0, atol=5e-7)


def test_numbered_columns_of_a_frame_are_named_by_their_numbers():
    """As streams of XDF come: an index there is the name."""
    frame = pd.DataFrame({0: [0.0, 0.1], 1: [0.5, 0.4]})
    recipe = table_recipe("[time]\ncolumn = 0\nunit = 's'\n[columns]\np_r = { column = 1 }")
    assert read_frame(frame, recipe)["p_r"].tolist() == [0.5, 0.4]


def test_facts_beside_a_frame(read):
    """An argument stands for what the recipe takes from the path; what no rule takes up is kept."""
    text = """[files]
pattern = "p{participant:int}.csv"
[columns]
p_r = { column = "p_r" }
"""
    taken = text + '[metadata]\nparticipant = { from = "participant" }'
    frame = pd.DataFrame({"t": [0, 1], "p_r": [0.5, 0.5]})
    session = read_frame(frame, table_recipe(taken), participant=3, condition="C1")
    assert session.label == "participant 3, C1"
    in_file = read(frame.to_csv(index=False), taken, name="p3.csv")
    assert in_file.with_metadata(condition="C1") == session
    assert dict(session.metadata.more) == {}
    with refused(r"no participant, .*; .* read_frame\(…"):
        read_frame(frame, table_recipe(taken))
    for recipe in (table_recipe(text), None):
        kept = read_frame(frame, recipe, participant=3, resampled="by hand", part=2).metadata
        assert (kept.participant, kept.more["part"]) == (3, 2)
    for name in ("resmaple", "sampel_time", "delimiter"):
        with refused(f"'{name}' looks like the argument '.*', not like"):
            read_frame(frame, **{name: 1})


@pytest.mark.parametrize("name", ["mode", "suggested_mode", "yaw"])
def test_states_and_angles_are_not_interpolated_over_blanks(read, name):
    unit = ', unit = "deg"' if name == "yaw" else ""
    rule = f'[columns]\n{name} = {{ column = "a", blank = "linear"{unit} }}'
    with refused(rf'recipe: .* {name} has no value between .*blank = "hold"'):
        table_recipe(rule)
    held = read("t,a\n0,1\n1,\n2,0\n", rule.replace("linear", "hold"))[name]
    assert held[1] == held[0] > held[2]


def test_a_window_of_ones_own_changes_no_other_recipe():
    facts = {}
    first = Recipe(kind="bag", columns={}, metadata=facts, performance_window=100)
    second = replace(first, performance_window=50)
    assert facts == {}
    values = [each.metadata["performance_window"].value for each in (first, second)]
    assert values == [100.0, 50.0]


def test_columns_that_are_not_asked_for_need_no_header(read):
    """A constant that nobody read had to be known; what a distance needs still has to."""
    rows = "t,m,x\n0,1,3\n1,0,3\n"
    recipe = """[columns]
mode = { column = "m" }
r = { from = "header.share" }
robot_x = { column = "x", unit = "m" }
robot_y = { value = 4, unit = "m" }
reference_x = { value = 0, unit = "m" }
reference_y = { value = 0, unit = "m" }
path_error = { distance = ["robot", "reference"], axes = ["x", "y"] }
"""
    session = read(rows, recipe, columns=["mode", "path_error"])
    assert session.data.to_dict("list") == {"mode": [1, 0], "path_error": [5, 5]}
    with refused(r"column 'r' .from header\.share"):
        read(rows, recipe)


# --- drafts ---------------------------------------------------------------------------------------


@pytest.fixture
def drafted(tmp_path):
    """A function that writes a log, drafts its recipe and fills in lines of it; reads by it."""

    def draft(text, name="run.csv", filled=()):
        log, recipe = tmp_path / name, tmp_path / f"{name}.toml"
        content = text if isinstance(text, bytes) else text.encode()
        log.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
        recipe.unlink(missing_ok=True)
        draft = draft_recipe(log, recipe).read_text(encoding="utf-8")
        for line in filled:
            draft = draft.replace(*line)
        recipe.write_text(draft, encoding="utf-8")
        return draft, read_session(log, recipe)

    return draft


RIG = """# rig 2, spring
Time [ms];Drive Mode;Cross Track Error [mm];pos x [m];pos y [m];note
0;manual;1,5;0,0;0,0;a
100;manual;1,6;0,0;0,1;b
200;robot;1,7;0,2;0,1;c
300;robot;1,8;0,3;0,1;d
"""


SPACES = """  stamp_s   driver   err_cm
 0.0   human    10
 0.1   robot     9.5
 0.2   human    11
"""
OF_SPACES = {"t": [0, 0.1, 0.2], "mode": [1, 0, 1], "path_error": [0.1, 0.095, 0.11]}
SHARES = "".join(f"{k / 10};{k / 50:g}\n" for k in range(50))
DRAFTS = [
    (
        "run.csv",
        RIG,
        {
            "t": [0, 0.1, 0.2, 0.3],
            "mode": [1, 1, 0, 0],
            "path_error": [1.5e-3, 1.6e-3, 1.7e-3, 1.8e-3],
            "robot_x": [0, 0, 0.2, 0.3],
            "robot_y": [0, 0.1, 0.1, 0.1],
        },
    ),
    ("run.txt", SPACES, OF_SPACES),
    *(
        (name, "".join(mark.join(line.split()) + "\n" for line in SPACES.splitlines()), OF_SPACES)
        for name, mark in (("run.csv.gz", ","), ("run.tsv", "\t"), ("run.csv", "|"))
    ),
    (
        "run.csv",
        "t,mode,robot perf (%),op_perf_pct\n0,1,31,50\n0.1,0,33,52\n",
        {"p_r": [0.31, 0.33], "p_h": [0.5, 0.52]},
    ),
    # Ten values got one with "?", and the eleventh had none. Excel's first line is skipped.
    ("run.csv", f"sep=;\nt;mode\n{SHARES}", {"mode": np.arange(50) / 50}),
    ("run.csv", f"sep=;\nt;autonomy\n{SHARES}", {"mode": 1 - np.arange(50) / 50}),
]


@pytest.mark.parametrize(("name", "text", "expected"), DRAFTS)
def test_a_draft_reads_every_text_that_a_recipe_reads(drafted, name, text, expected):
    _, session = drafted(text, name)
    for column, values in expected.items():
        assert_allclose(session[column], values, rtol=1e-12, atol=1e-12)


def test_a_draft_says_what_it_leaves_out_and_replaces_nothing(drafted, tmp_path):
    assert drafted(RIG)[0].endswith("#   note\n")
    with refused(r"run\.csv\.toml exists already"):
        draft_recipe(tmp_path / "run.csv", tmp_path / "run.csv.toml")
    # An error of the system.
    with refused(r"cannot write .*nowhere.*No such file or directory"):
        draft_recipe(tmp_path / "run.csv", tmp_path / "nowhere" / "lab.toml")


MET = 'unit = "m"'


@pytest.mark.parametrize(
    ("text", "filled"),
    [
        (
            "stamp,mode,heading\n10,on,0.1\n20,off,0.2\n30,on,0.3\n",
            [
                ('"on" = "?"', '"on" = 1', r"mode: map entry 'on' must be a number, got '\?'"),
                ('"off" = "?"', '"off" = 0', r"\[columns\] mode: map entry 'off'"),
                ('unit = "?"', 'unit = "deg"', r"\[columns\] yaw: unknown unit '\?'"),
            ],
        ),
        # Blank cells, signs and stamps that jitter.
        (
            "stamp_ms,mode,cte_m\n0,1,.30\n103,1,-.31\n199,1,\n300,1,.33\n",
            [
                (MET, f'{MET}, blank = "hold"', 'blank = "hold"'),
                (MET, f"{MET}, absolute = true", "absolute"),
                (
                    "# performance_window",
                    '\n[resampling]\nmethod = "linear"\nsample_time = 0.101\n# ',
                    r"\[resampling\]",
                ),
            ],
        ),
    ],
)
def test_what_a_draft_cannot_know_reading_asks_for(drafted, text, filled):
    """One after the other."""
    lines = [line for *line, _ in filled]
    for k, (*_, words) in enumerate(filled):
        with refused(words):
            drafted(text, filled=lines[:k])
    assert drafted(text, filled=lines)[1]["mode"][0] == 1.0


def test_who_drives_is_guessed_from_two_words_in_any_encoding(drafted):
    text = "Zeit (ms);Fahrer;Güte (%)\n0;Mensch;1,5\n100;Übergabe;1,6\n200;Mensch;1,7\n"
    for encoding in ("utf-8", "cp1252"):
        word = ('"Übergabe" = "?"', '"Übergabe" = 0')
        draft, session = drafted(text.encode(encoding), filled=[word])
        assert ('encoding = "cp1252"' in draft) == (encoding == "cp1252")
        assert draft.endswith("#   Güte (%)\n")
        assert session["mode"].tolist() == [1.0, 0.0, 1.0]
        assert_allclose(session.t, [0.0, 0.1, 0.2], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "no", "yes"),
    [
        ("auto", "off", "on"),
        ("autonomous", 0, 1),
        ("autopilot", "no", "yes"),
        ("manual", "off", "on"),
        ("manual", 0, 1),
    ],
)
def test_on_and_off_mean_what_their_column_is_called(drafted, name, no, yes):
    """ "on" was manual in a column called auto, so that each drove where the other did."""
    _, session = drafted(f"t,{name},cte_m\n0,{no},1\n0.1,{no},1\n0.2,{yes},1\n0.3,{yes},1\n")
    assert session["mode"].tolist() == ([0, 0, 1, 1] if name == "manual" else [1, 1, 0, 0])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.bag", b"x", "for a bag, name topics"),
        ("a.csv", b"", "no sample follows the names of its columns"),
        ("a.csv", b"t,mode,p_r\n", "no sample follows the names of its columns"),
        ("a.csv", "t;m\n0;1\n".encode("utf-16"), "this is UTF-16"),
        ("a.parquet", b"no", "cannot be read as a table"),
    ],
)
def test_a_draft_of_no_table_or_of_no_samples_is_refused(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with refused(rf"{name}: .*{words}"):
        draft_recipe(tmp_path / name, tmp_path / "lab.toml")
    assert not (tmp_path / "lab.toml").exists()
