"""What each rule of a recipe does to a log. Oracle: values computed by hand."""

import numpy as np
import pandas as pd
import pytest

from tests.sessions.logs import table_recipe
from trustlab.sessions import (
    RecipeError,
    SessionError,
    read_frame,
    read_session,
)
from trustlab.sessions.patterns import PathPattern, natural_key

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


@pytest.fixture
def lab(tmp_path):
    folder = tmp_path / "p2"
    folder.mkdir()
    (tmp_path / "lab.toml").write_text(LAB)
    (folder / "runs.csv").write_text("run,share,level\n1,10,low\n03.0,30,high\n")
    (folder / "run3.csv").write_text(ROWS)
    return folder / "run3.csv"


def test_every_rule(lab):
    recipe = lab.parents[1] / "lab.toml"
    session = read_session(lab, recipe)
    expected = {
        "mode": [1, 0, 0.5],
        "robot_x": [0, 0.1, 0.4],
        "robot_y": [0, 0.035, 0],
        "reference_x": [0.2, 0.2, 0.2],
        "reference_y": [0, 0, 0],
        "yaw": [np.pi, -np.pi / 2, 0],
        "r": [0.3, 0.3, 0.3],
        "beta": [0.9, 0.9, 0.9],
        "alpha": [0.5, 0.5, 0.5],
        "path_error": [0.2, np.hypot(0.1, 0.035), 0.2],
        "step_distance": [0.1, 0.1, 0.3],
    }
    assert session.columns == list(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(session[name], values, rtol=1e-15, atol=1e-15, err_msg=name)
    np.testing.assert_allclose(session.t, [0, 0.1, 0.2], rtol=1e-15)
    facts = session.metadata
    assert (facts.participant, facts.condition, facts.synthetic) == (2, "high", True)
    derived = {"trial": 3, "group": "B", "training": False, "site": "north"}
    assert dict(facts.more) == derived | {"start_time": 5.0, "performance_window": 100}
    # Columns by name bring what they are computed from, and no more.
    assert read_session(lab, recipe, columns=["path_error"]).columns == ["path_error"]


def test_a_participant_beside_a_frame(read):
    """Where the recipe takes the participant from the path, the argument stands for it."""
    text = """[files]
pattern = "p{participant:int}.csv"
[columns]
p_r = { column = "a" }
[metadata]
participant = { from = "participant" }"""
    frame = pd.DataFrame({"t": [0, 1], "a": [0.5, 0.5]})
    session = read_frame(frame, table_recipe(text), participant=3, condition="C1")
    assert session.label == "participant 3, C1"
    in_file = read(frame.to_csv(index=False), text, name="p3.csv")
    assert in_file.with_metadata(condition="C1") == session
    assert dict(session.metadata.more) == {}
    with pytest.raises(SessionError, match=r"no participant, .*; .* read_frame\(…"):
        read_frame(frame, table_recipe(text))
    assert read_frame(frame.rename(columns={"a": "p_r"}), participant=3).label == "participant 3"


def test_an_analogue_channel_is_divided_in_two(read, recwarn):
    text = '[columns]\nmode = { column = "pedal", above = 2.5 }'
    session = read("t,pedal\n0,0.1\n1,2.5\n2,2.6\n", text)
    assert session["mode"].tolist() == [0, 0, 1]
    assert session.metadata.more["mode above 2.5"] == "1 of 3 samples"
    assert not recwarn.list
    for limit, state in ((3, 0), (0, 1)):
        words = rf"run\.csv: column mode is {state} throughout: {limit} divides no sample"
        with pytest.warns(UserWarning, match=words):
            read("t,pedal\n0,0.1\n1,2.5\n2,2.6\n", text.replace("2.5", str(limit)))


@pytest.mark.parametrize("name", ["mode", "suggested_mode", "yaw"])
def test_states_and_angles_are_not_interpolated_over_blanks(read, name):
    unit = ', unit = "deg"' if name == "yaw" else ""
    rule = f'[columns]\n{name} = {{ column = "a", blank = "linear"{unit} }}'
    with pytest.raises(RecipeError, match=rf'{name} has no value between .*blank = "hold"'):
        table_recipe(rule)
    held = read("t,a\n0,1\n1,\n2,0\n", rule.replace("linear", "hold"))[name]
    assert held[1] == held[0] > held[2]


def test_patterns():
    pattern = PathPattern("p{who:int}/{name}_run{trial:int}*.csv")
    match = pattern.match("/data/p07/anna_run12_final.csv")
    assert (match.base, dict(match.fields)) == ("/data", {"who": 7, "name": "anna", "trial": 12})
    assert match.texts["who"] == "07"
    level = PathPattern("a{level:float}.csv").match("/x/a-0.5.csv")
    assert (level.base, level.fields) == ("/x", {"level": -0.5})
    assert PathPattern("p{who}/p{who}.csv").match("p1/p2.csv") is None
    assert PathPattern("a.csv").match("x/abcsv") is None
    values = ["b", 10, "a10", "a2", 2, None]
    assert sorted(values, key=natural_key) == [2, 10, "a2", "a10", "b", None]
