"""Recipes: what each rule does to a log, what a wrong recipe is told, header files and folders."""

import time
import warnings

import numpy as np
import pytest

from trustlab.sessions import (
    RecipeError,
    SessionError,
    list_recipes,
    load_recipe,
    read_session,
    read_sessions,
)
from trustlab.sessions.patterns import PathPattern, natural_key
from trustlab.sessions.recipe import Recipe
from trustlab.sessions.vocabulary import UNITS, to_si

LAB = """
name = "lab"
kind = "table"

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
ROWS = (
    "logger "
    "v2\nstamp;x;y;heading;driver;junk\n5000;0;5;180;HUMAN;a\n5100;100;1,5;-90;ROBOT;b\n5200;400;5;0;both;c\n"
)


def lay(tmp_path, recipe=LAB, people=(1, 2), runs=(1, 2, 3)):
    (tmp_path / "lab.toml").write_text(recipe)
    for who in people:
        folder = tmp_path / "raw" / f"p{who}"
        folder.mkdir(parents=True)
        (folder / "runs.csv").write_text(
            "run,share,level\n"
            + "".join(f"{k},{10 * k},{'low' if k < 3 else 'high'}\n" for k in runs)
        )
        for k in runs:
            (folder / f"run{k}.csv").write_text(ROWS)
    return tmp_path / "lab.toml"


def test_every_rule(tmp_path):
    recipe = lay(tmp_path)
    session = read_session(tmp_path / "raw/p2/run3.csv", recipe=recipe)
    expected = {
        "mode": [1, 0, 0.5],
        "robot_x": [0, 0.1, 0.4],
        "robot_y": [0, 0.035, 0],
        "reference_x": [0.2, 0.2, 0.2],
        "reference_y": [0, 0, 0],
        "yaw": [np.pi, -np.pi / 2, 0],
        "r": [0.3, 0.3, 0.3],
        "beta": [0.9, 0.9, 0.9],
        "path_error": [0.2, np.hypot(0.1, 0.035), 0.2],
        "step_distance": [0.1, 0.1, 0.3],
    }
    assert session.columns == list(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(session[name], values, rtol=1e-15, atol=1e-15, err_msg=name)
    np.testing.assert_allclose(session.t, [0, 0.1, 0.2], rtol=1e-15)
    metadata = session.metadata
    assert (metadata.participant, metadata.condition, metadata.synthetic) == (2, "high", True)
    assert dict(metadata.more) == {
        "start_time": 5.0,
        "trial": 3,
        "group": "B",
        "training": False,
        "site": "north",
    }
    # Columns by name bring what they are computed from, and no more.
    assert read_session(
        tmp_path / "raw/p2/run3.csv", recipe=recipe, columns=["path_error"]
    ).columns == ["path_error"]
    with pytest.raises(SessionError, match="no column 'path_eror'; did you mean 'path_error'"):
        read_session(tmp_path / "raw/p2/run3.csv", recipe=recipe, columns=["path_eror"])


@pytest.mark.parametrize("place", [".", "raw"])
def test_a_folder(tmp_path, place):
    recipe = lay(tmp_path, LAB.replace('2 = "B"', '10 = "B", 9 = "B", 8 = "B"'), people=(10, 9, 8))
    sessions = read_sessions(tmp_path / place, recipe=recipe)
    found = [(each.metadata.participant, each.metadata.more["trial"]) for each in sessions]
    assert found == [(who, trial) for who in (8, 9, 10) for trial in (1, 2, 3)]


def test_one_folder_by_itself(tmp_path, monkeypatch, recwarn):
    recipe = lay(tmp_path, people=(1, 2))
    monkeypatch.chdir(tmp_path / "raw" / "p1")
    assert [each.metadata.participant for each in read_sessions(".", recipe=recipe)] == [1, 1, 1]
    assert read_session("run1.csv", recipe=recipe).metadata.more["training"]
    assert not recwarn.list


def fails(call, *fragments):
    with pytest.raises(SessionError) as caught:
        call()
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_headers_and_files_name_each_other(tmp_path):
    recipe = lay(tmp_path)
    read = lambda: read_sessions(tmp_path, recipe=recipe)  # noqa: E731
    assert len(read()) == 6
    folder = tmp_path / "raw" / "p2"
    header, good = folder / "runs.csv", (folder / "runs.csv").read_text()

    (folder / "run3.csv").rename(folder / "away")
    fails(read, str(header), "line 4", "run 3", "no file")
    (folder / "away").rename(folder / "run4.csv")
    fails(read, "run4.csv", str(header), "no row for run 4")
    fails(lambda: read_session(folder / "run4.csv", recipe=recipe), "run4.csv", "no row for run 4")
    (folder / "run4.csv").rename(folder / "run3.csv")

    for text, fragments in [
        (
            good.replace("run,", "rum,"),
            ["runs.csv: line 1", "'run' is missing", "did you mean 'rum'"],
        ),
        (good.replace("share", "run"), ["line 1", "'run' occurs twice"]),
        (good + "3,1,low\n", ["line 5", "occurs twice, first in line 4"]),
        (good + "4,1\n", ["line 5", "2 cells", "3"]),
        (good + ",1,low\n", ["line 5", "a key is empty"]),
        (good.replace("1,10,low", "1,ten,low"), ["run1.csv", "'r'", "'ten'", "not a number"]),
        (
            good.replace("1,10,low", "1,10,medium"),
            ["run1.csv", "'beta' (from header.level)", "'medium'", "map (known: low, high)"],
        ),
        (good.replace("1,10,low", "1,,low"), ["run1.csv", "header.share is empty"]),
        (good.replace("share", "part"), ["run1.csv", "no header.share", "header.part"]),
        ("", ["line 1", "'run' is missing"]),
    ]:
        header.write_text(text)
        fails(read, *fragments)
    header.write_bytes(b"\xff\xfe")
    fails(read, "runs.csv", "UTF-8")
    header.unlink()
    fails(read, "p2", "its header", "runs.csv does not exist")
    # A header alone, all of its files gone.
    header.write_text(good)
    for path in folder.glob("run[0-9].csv"):
        path.unlink()
    fails(read, str(header), "line 2", "run 1", "no file")
    assert header.exists()


def test_faults_are_told_in_the_words_of_the_file(tmp_path):
    recipe = lay(tmp_path)
    path = tmp_path / "raw/p1/run1.csv"
    read = lambda: read_session(path, recipe=recipe)  # noqa: E731
    for old, new, fragments in [
        ("100;1,5", "abc;1,5", ["line 4", "'x' (robot_x)", "'abc'"]),
        ("1,5", "1.5", ["line 4", "'y' (robot_y)", "'1.5'"]),
        ("ROBOT", "ROBOTT", ["line 4", "'driver' (mode)", "'ROBOTT'", "did you mean 'ROBOT'"]),
        ("5100", "5000", ["line 4", "repeats"]),
        ("5200", "5250", ["line 4", "irregular"]),
        (";x;", ";xx;", ["line 2", "'x' is missing"]),
        ("stamp;", "stamps;", ["line 2", "'stamp' is missing", "did you mean 'stamps'"]),
    ]:
        path.write_text(ROWS.replace(old, new))
        fails(read, str(path), *fragments)
    path.write_text(ROWS)
    fails(
        lambda: read_session(path.rename(tmp_path / "run1.csv"), recipe=recipe),
        "does not fit",
        "p{who:int}",
    )
    fails(
        lambda: read_sessions(tmp_path / "raw" / "p1", recipe="autonomy_cl_trust"),
        "no file",
        "part{folder:int}",
    )


SIGNED = """
name = "signed"
kind = "table"
[time]
unit = "s"
[columns]
path_error = { column = "cte", unit = "mm", scale = 2.0, offset = 100.0, absolute = true }
"""


def test_a_signed_deviation_becomes_a_distance(tmp_path):
    """Oracle: |2 · raw + 100 mm| by hand."""
    (tmp_path / "my_lab.toml").write_text(SIGNED)
    path = tmp_path / "run.csv"
    path.write_text("t,cte\n0,-200\n1,-50\n2,50\n")
    session = read_session(path, recipe=tmp_path / "my_lab.toml")
    np.testing.assert_allclose(session["path_error"], [0.3, 0.0, 0.2], rtol=1e-15)
    (tmp_path / "my_lab.toml").write_text(SIGNED.replace(", absolute = true", ""))
    fails(
        lambda: read_session(path, recipe=tmp_path / "my_lab.toml"),
        "line 2",
        "-0.3",
        "absolute = true",
    )
    (tmp_path / "my_lab.toml").write_text(SIGNED.replace("absolute = true", 'absolute = "yes"'))
    fails(
        lambda: load_recipe(tmp_path / "my_lab.toml"),
        "path_error: absolute",
        "true or false",
        "'yes'",
    )


def test_a_recipe_and_a_delimiter_that_were_meant(tmp_path):
    recipe, path = tmp_path / "my_lab.toml", tmp_path / "run.csv"
    recipe.write_text(SIGNED)
    fails(lambda: load_recipe(tmp_path / "mylab.toml"), "did you mean 'my_lab.toml'")
    for mark, shown in ((";", '";"'), ("\t", '"\\t"')):
        path.write_text(f"t{mark}cte\n0{mark}1\n1{mark}2\n")
        fails(
            lambda: read_session(path, recipe=recipe),
            "line 1",
            "one column only",
            f"lines [table] and delimiter = {shown}",
        )
        recipe.write_text(SIGNED.replace("[time]", f"[table]\ndelimiter = {shown}\n[time]"))
        assert len(read_session(path, recipe=recipe)) == 2
        recipe.write_text(SIGNED)
    path.write_text("t,cte\n0,1\n1,2\n")
    recipe.write_text(
        SIGNED
        + '[files]\npattern = "{who}_{trial:int}.csv"\n[metadata]\nparticipant = { from = "who" }\n'
    )
    fails(lambda: read_session(path, recipe=recipe), "does not fit", "rename", "[metadata]")
    recipe.write_text(SIGNED + '[files]\npattern = "{who}_{trial:int}.csv"\n')
    assert len(read_session(path, recipe=recipe)) == 2  # the remedy


def test_the_same_session_twice(tmp_path):
    recipe = lay(tmp_path)
    lay(tmp_path / "copy" if (tmp_path / "copy").mkdir() is None else tmp_path)
    fails(
        lambda: read_sessions(tmp_path, recipe=recipe), "both who 1, trial 1", "one of the folders"
    )


def test_metadata_maps_without_a_way_out(tmp_path):
    recipe = lay(tmp_path, LAB.replace('2 = "B"', '25 = "B"'))
    fails(
        lambda: read_session(tmp_path / "raw/p2/run1.csv", recipe=recipe),
        "'group' (from who)",
        "'2'",
        "known: 1, 25",
    )


@pytest.mark.parametrize(
    ("old", "new", "fragments"),
    [
        ("[columns]", "[colums]", ["unknown key 'colums'", "did you mean 'columns'"]),
        ('kind = "table"', 'kind = "tabel"', ["kind must be", "'tabel'"]),
        ('kind = "table"\n', "", ["needs kind", '"table" or "bag"']),
        ('kind = "table"', 'kind = "bag"', ["[table] is for"]),
        ("robot_x =", "robot_xx =", ["robot_xx", "vocabulary", "did you mean 'robot_x'"]),
        ("yaw =", "t =", ["time goes under [time]"]),
        ('unit = "mm"', 'unit = "mmm"', ["robot_x", "unknown unit 'mmm'", "did you mean 'mm'"]),
        ('unit = "mm"', 'unit = "ms"', ["robot_x", "'ms' measures s, but m is needed"]),
        (', unit = "mm"', "", ["robot_x", "needs its unit", "m"]),
        (
            'unit = "ms"',
            'unit = "furlong"',
            ["[time]", "unit must be one of 'iso', 'clock'", "'furlong'"],
        ),
        ("scale =", "scal =", ["robot_y", "unknown key 'scal'", "did you mean 'scale'"]),
        ("scale = -1.0", 'scale = "x"', ["robot_y: scale", "'x'"]),
        ("scale = -1.0", "scale = nan", ["robot_y: scale", "finite"]),
        ('column = "x"', 'column = "x", value = 1', ["robot_x", "exactly one of"]),
        ('column = "x", ', "", ["robot_x", "exactly one of"]),
        ('column = "x"', "column = 3", ["robot_x", "given by name", "3"]),
        ('column = "x"', 'topic = "/odom"', ["robot_x", "needs field"]),
        ('column = "x"', 'topic = "/odom", field = "x"', ["robot_x", "topic does not go with"]),
        ("HUMAN = 1", 'HUMAN = "1"', ["mode", "map entry 'HUMAN'"]),
        ("HUMAN = 1", '1 = 1, "1.0" = 1', ["mode", "same value"]),
        (
            'distance = ["robot", "reference"]',
            'distance = ["robot", "target"]',
            ["path_error: distance must be one of 'robot', 'reference'", "'target'"],
        ),
        (
            'distance = ["robot", "reference"]',
            'distance = ["robot", "human"]',
            ["human_x", "no rule"],
        ),
        ('axes = ["x", "y"]', 'axes = ["x", "w"]', ["axes", "'w'"]),
        (
            'from = "who"',
            'from = "whom"',
            ["participant", "nothing is called 'whom'", "did you mean 'who'"],
        ),
        ('from = "trial", map', 'from = "traning", map', ["training", "nothing is called"]),
        ("default = false }", "bins = [1] }", ["training", "unknown key 'bins'"]),
        ('value = "north"', 'value = "north", from = "who"', ["site", "either from or value"]),
        (
            "default = false",
            "defualt = false",
            ["training", "unknown key", "did you mean 'default'"],
        ),
        (
            'keys = { trial = "run" }',
            'keys = { trail = "run" }',
            ["[header]", "'trail'", "did you mean 'trial'"],
        ),
        ("p{who}/runs", "p{whom}/runs", ["[header] file", "'whom'", "did you mean 'who'"]),
        (
            "{who:int}",
            "{who:integer}",
            ["[files]", "type of field 'who'", "'integer'", "did you mean 'int'"],
        ),
        ("{who:int}", "{who:int", ["brace"]),
        ("[table]", "[supersedes]", ["unknown key 'supersedes'"]),
        ('delimiter = ";"', 'delimiter = ";;"', ["delimiter"]),
        ('decimal = ","', 'decimal = ";"', ["decimal"]),
        ("skip_lines = 1", "skip_lines = -1", ["skip_lines"]),
        ("skip_lines = 1", "skip_lines = true", ["skip_lines"]),
        ("[time]", "[resampling]\nmethod = 'linear'\n[time]", ["[resampling]: needs sample_time"]),
        (
            "[time]",
            "[resampling]\nmethod = 'lin'\nsample_time = 1\n[time]",
            ["[resampling]: method must be", "'lin'", "did you mean 'linear'"],
        ),
        (
            "[time]",
            "[resampling]\nmethod = 'linear'\nsample_time = 0\n[time]",
            ["sample_time must be positive"],
        ),
        ("[time]", "[time", ["not a TOML file"]),
        ("site =", "source =", ["this name is taken"]),
    ],
)
def test_a_wrong_recipe_says_what_is_wrong(old, new, fragments):
    assert old in LAB
    with pytest.raises(RecipeError) as caught:
        Recipe.from_toml(LAB.replace(old, new, 1), "lab.toml")
    for fragment in ["lab.toml", *fragments]:
        assert fragment in str(caught.value)


def test_recipes_by_name_path_and_object(tmp_path):
    assert set(list_recipes()) >= {"autonomy_cl_trust", "ros_ground_robot"}
    assert all(list_recipes().values())
    recipe = load_recipe("autonomy_cl_trust")
    assert load_recipe(recipe) is recipe
    path = lay(tmp_path)
    assert load_recipe(path) == load_recipe(str(path))
    with pytest.raises(
        RecipeError, match=r"no recipe 'ros_ground_robt'.*did you mean 'ros_ground_robot'.*known"
    ):
        load_recipe("ros_ground_robt")
    for wrong in (3, None, tmp_path, "", "a\0b"):
        with pytest.raises(RecipeError):
            load_recipe(wrong)


def test_units_against_their_definitions():
    # Independent statement of each unit.
    expected = {
        "km": 1e3,
        "cm": 1e-2,
        "mm": 1e-3,
        "min": 60,
        "h": 3600,
        "km/h": 1000 / 3600,
        "deg": np.pi / 180,
        "%": 0.01,
    }
    for unit, factor in expected.items():
        assert to_si(unit, UNITS[unit][0]) == pytest.approx(factor, rel=1e-15)
    assert to_si("km/h", "measure") == to_si("km/h", "m/s")


def test_patterns():
    pattern = PathPattern("p{who:int}/{name}_run{trial:int}*.csv")
    match = pattern.match("/data/p07/anna_run12_final.csv")
    assert (match.base, dict(match.fields)) == ("/data", {"who": 7, "name": "anna", "trial": 12})
    assert match.texts["who"] == "07"
    assert PathPattern("p{who}/p{who}.csv").match("p1/p2.csv") is None
    assert PathPattern("a.csv").match("x/abcsv") is None
    assert sorted(["b", 10, "a10", "a2", 2, None], key=natural_key) == [
        2,
        10,
        "a2",
        "a10",
        "b",
        None,
    ]


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("vpA.csv", r"; vpA.csv would fit 'vp{participant}.csv', whose fields need not be numbers"),
        ("vp1.CSV", "; the nearest is vp1.CSV"),
        ("notes.md", "$"),
    ],
)
def test_a_pattern_that_nothing_fits_names_what_is_near(tmp_path, name, remedy):
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / name).write_text("t,mode\n0,1\n")
    recipe = tmp_path / "lab.toml"
    recipe.write_text(SIGNED + '[files]\npattern = "vp{participant:int}.csv"\n')
    with pytest.raises(SessionError, match=r"fits the recipe's pattern '[^']*'" + remedy):
        read_sessions(logs, recipe)


def test_patterns_match_in_time_that_grows_with_the_path():
    """
    A name of underscores that does not fit: each field more would otherwise multiply the places to
    try.
    """
    pattern = PathPattern("".join(f"{{f{k}}}_" for k in range(12)) + "end.csv")
    begun = time.process_time()
    assert pattern.match("/data/" + "_" * 240 + ".csv") is None
    assert time.process_time() - begun < 0.5
    names = "a b c d e f g h i j k l".split()  # noqa: SIM905
    assert list(pattern.match("/data/" + "_".join(names) + "_end.csv").fields.values()) == names
    assert PathPattern("{a}_{b}_{n:int}.csv").match("/x/1_2_3_4.csv").fields == {
        "a": "1",
        "b": "2_3",
        "n": 4,
    }
    with pytest.raises(ValueError, match=r"more than 3 \* in one name"):
        PathPattern("*a*b*c*.csv")


@pytest.mark.parametrize("where", ["../secret.csv", "p{who}/../runs.csv", "./runs.csv"])
def test_header_files_lie_below_the_folder(tmp_path, where):
    recipe = lay(tmp_path, LAB.replace("p{who}/runs.csv", where))
    fails(lambda: load_recipe(recipe), "[header]: pattern", "no . or ..")


def test_a_folder_below_the_header(tmp_path):
    """The header names sessions of other folders too, which are not asked for."""
    recipe = lay(
        tmp_path,
        LAB.replace("p{who}/runs.csv", "index.csv").replace(
            'trial = "run"', 'who = "who", trial = "run"'
        ),
    )
    rows = [f"{who},{k},{10 * k},low\n" for who in (1, 2) for k in (1, 2, 3)]
    (tmp_path / "raw" / "index.csv").write_text("who,run,share,level\n" + "".join(rows))
    assert len(read_sessions(tmp_path / "raw", recipe=recipe)) == 6
    assert len(read_sessions(tmp_path / "raw" / "p1", recipe=recipe)) == 3


def test_tables_of_100_000_columns_in_linear_time(tmp_path):
    names = ["t", *(f"c{k}" for k in range(100_000)), "p_r"]
    row = ",".join(["{}"] + ["0"] * 100_000 + ["0.5"])
    (tmp_path / "wide.csv").write_text(
        ",".join(names) + "\n" + "".join(row.format(k) + "\n" for k in range(3))
    )
    begun = time.process_time()
    assert read_session(tmp_path / "wide.csv", columns=["p_r"]).columns == ["p_r"]
    fails(lambda: read_session(tmp_path / "wide.csv"), "column 'c0' is not in the vocabulary")
    fails(lambda: read_session(tmp_path / "wide.csv", columns=["p_h"]), "'p_h' is missing")
    assert time.process_time() - begun < 5.0


TABLE = """
kind = "table"
performance_window = 0
[time]
unit = "{unit}"
[columns]
mode = {{ column = "trigger", above = 2.5 }}
p_r = {{ column = "p_r" }}
"""


def test_columns_that_are_no_means_are_said_to_be_none(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,trigger,p_r\n0,0.1,0.3\n100,3.3,0.3\n200,3.3,0.3\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        session = read_session(path, recipe=Recipe.from_toml(TABLE.format(unit="ms")))
    assert session.metadata.more["performance_window"] == 0.0
    with pytest.warns(
        UserWarning, match=r"a\.csv: samples are 100 s apart; if these are milliseconds"
    ) as caught:
        read_session(path, recipe=Recipe.from_toml(TABLE.format(unit="s")))
    assert caught[0].filename == __file__


def test_a_threshold_that_divides_nothing_is_told(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,trigger,p_r\n0,0.1,0.3\n100,0.2,0.3\n200,0.1,0.3\n")
    with pytest.warns(
        UserWarning, match=r"a\.csv: column mode is 0 throughout: 2\.5 divides no sample"
    ):
        read_session(path, recipe=Recipe.from_toml(TABLE.format(unit="ms")))


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        (
            'unit = "s"',
            'unit = "ISO8601"',
            r"'iso', 'clock', 's', .* got 'ISO8601'; did you mean 'iso'",
        ),
        (
            "[columns]",
            "[columns]\nperformance_window = 3",
            "performance_window goes above the first",
        ),
        (
            "mode =",
            "driver =",
            r"\[columns\] driver: not in the vocabulary.*trustlab\.sessions\.vocabulary\(\)",
        ),
    ],
)
def test_a_mistake_in_a_recipe_comes_with_the_remedy(before, after, says):
    with pytest.raises(RecipeError, match=says):
        Recipe.from_toml(TABLE.format(unit="s").replace(before, after))


def test_positions_come_from_the_log():
    """A recipe at random: a position that is computed from itself raised a bare KeyError."""
    for rule in (
        '{ travelled = "robot", axes = ["x"] }',
        '{ distance = ["robot", "reference"], axes = ["x"] }',
    ):
        text = (
            'kind = "table"\n[time]\nunit = "s"\n[columns]\nr = { column = "r" }\nrobot_x = '
            f"{rule}\n"
        )
        with pytest.raises(
            RecipeError, match=r"robot_x: needs column 'robot_x', which is itself computed"
        ):
            Recipe.from_toml(text)


@pytest.mark.parametrize(
    ("unit", "per_second", "name"),
    [("ms", 1e3, "milliseconds"), ("us", 1e6, "microseconds"), ("ns", 1e9, "nanoseconds")],
)
def test_epochs_name_their_unit_and_the_remedy_works(tmp_path, unit, per_second, name):
    t = 1.7e9 * per_second + 0.1 * per_second * np.arange(20)
    rows = "".join(f"{x:.0f},{k % 2 * 4},0.3\n" for k, x in enumerate(t))
    path = tmp_path / "a.csv"
    path.write_text("t,trigger,p_r\n" + rows)
    with pytest.warns(UserWarning, match=f'if these are {name}.*unit = "{unit}"'):
        read_session(path, recipe=Recipe.from_toml(TABLE.format(unit="s")))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        session = read_session(path, recipe=Recipe.from_toml(TABLE.format(unit=unit)))
    assert session.sample_time == pytest.approx(0.1, abs=1e-6)


@pytest.mark.parametrize(
    ("value", "words"),
    [("-0.1", "never negative"), ("35", 'unit = "%"'), ("1e26", "beyond any performance")],
)
def test_performance_out_of_scale_is_told(tmp_path, value, words):
    path = tmp_path / "a.csv"
    path.write_text(f"t,trigger,p_r\n0,0,30\n100,3,{value}\n200,3,30\n")
    with pytest.warns(UserWarning, match=f"column p_r goes .*{words}"):
        read_session(path, recipe=Recipe.from_toml(TABLE.format(unit="ms")))
    per_cent = TABLE.replace('"p_r" }}', '"p_r", unit = "%" }}')
    if value == "35":
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            session = read_session(path, recipe=Recipe.from_toml(per_cent.format(unit="ms")))
        assert session["p_r"].max() == pytest.approx(0.35)


def test_a_comment_before_the_names_is_skipped_on_request_only(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# rig 3; evening\nt,trigger,p_r\n0,0,0.3\n100,3,0.3\n200,3,0.3\n")
    plain = TABLE.format(unit="ms")
    with pytest.raises(SessionError, match=r"found a comment .* skip_lines"):
        read_session(path, recipe=Recipe.from_toml(plain))
    skipping = plain.replace("[columns]", "[table]\nskip_lines = 1\n[columns]")
    assert len(read_session(path, recipe=Recipe.from_toml(skipping))) == 3


FOUR = """name = "four"
kind = "table"

[time]
column = "t"
unit = "sec"

[columns]
mode = { column = "driver", mapp = { human = 1 } }
path_error = { column = "err" }
robott_x = { column = "x", unit = "m" }
"""


def test_faults_are_reported_together_each_with_its_line():
    with pytest.raises(RecipeError) as caught:
        Recipe.from_toml(FOUR)
    said = str(caught.value)
    assert "4 faults" in said
    assert "line 6: [time]: unit must be" in said
    assert "line 9: [columns] mode: unknown key 'mapp'; did you mean 'map'" in said
    assert "line 10: [columns] path_error: needs its unit" in said
    assert "line 11: [columns] robott_x: not in the vocabulary; did you mean 'robot_x'" in said


def test_columns_that_a_file_lacks_are_reported_together(tmp_path):
    (tmp_path / "run.csv").write_text("time,who\n0,1\n1,1\n")
    recipe = Recipe.from_toml(
        'kind = "table"\n[time]\ncolumn = "t"\nunit = "s"\n[columns]\n'
        'mode = { column = "driver" }\np_r = { column = "speed" }\n'
    )
    with pytest.raises(SessionError, match="3 faults") as caught:
        read_session(tmp_path / "run.csv", recipe)
    assert all(f"column {name!r} is missing" in str(caught.value) for name in ("t", "driver"))
    assert str(caught.value).startswith(str(tmp_path / "run.csv"))
