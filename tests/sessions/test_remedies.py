"""What an error says: file, line, column and remedy. Where the remedy is a line, it works."""

import os
import re

import numpy as np
import pandas as pd
import pytest

from tests.cases import refused
from tests.sessions.logs import Bag, table_recipe
from tests.sessions.test_recipes import LAB
from trustlab.sessions import (
    RecipeError,
    SessionError,
    load_recipe,
    read_frame,
    read_session,
    read_sessions,
    write_session,
)

HEAD = "t,mode,p_r\n"
GOOD = HEAD + "0,1,1\n1,0,1\n"
PLAIN = '[columns]\np_r = { column = "p_r" }\n'
TIME = '[time]\nunit = "s"\n'
DATES = '[time]\nunit = "iso"\n'
GRID = '[resampling]\nmethod = "linear"\nsample_time = 1\n'
SEMICOLONS = '[table]\ndelimiter = ";"\n'
MODE = '[columns]\nmode = { column = "m" }'
# What is read and by which recipe, what the error says (… stands for anything), and the remedy: the
# recipe, or arguments, by which it can be read.
LOGS = [
    ("", None, "line 1: is empty; the names of the columns", None),
    (
        GOOD.replace("p_r", "p_rr"),
        None,
        "line 1: column 'p_rr' is not in the vocabulary; did you mean 'p_r'? (map it with a",
        PLAIN.replace('"p_r"', '"p_rr"'),
    ),
    (
        GOOD.replace("t,", "time,"),
        PLAIN,
        "line 1: column 't' is missing; time needs the name t",
        f'[time]\ncolumn = "time"\nunit = "s"\n{PLAIN}',
    ),
    (
        "0,1,1\n1,1,1\n",
        None,
        "line 1: found numbers instead of column names … [table] and header = false",
        '[table]\nheader = false\n[time]\ncolumn = 0\nunit = "s"\n[columns]\np_r = { column = 1 }',
    ),
    (
        "t;p_r\n0;1\n1;1\n",
        None,
        "line 1: one column only, 't;p_r' … read it with delimiter=\";\"",
        {"delimiter": ";"},
    ),
    (
        't;p_r\n0;"0,5"\n1;1\n',
        SEMICOLONS + PLAIN,
        "line 2, column 'p_r': '0,5' is not a number … decimal=\",\", or set it in a recipe",
        f'{SEMICOLONS}decimal = ","\n{PLAIN}',
    ),
    (
        "t,m\n0,on\n1,off\n",
        MODE,
        "line 2, column 'm' (mode): 'on' is not a number … turn words into numbers with a … map",
        MODE.replace(" }", ", map = { on = 1, off = 0 } }"),
    ),
    (
        "t,m\n0,on\n1,\n",
        MODE.replace(" }", ", map = { on = 1 } }"),
        'line 3 … the cell is empty; fill it, or add blank = "hold" beside the map',
        MODE.replace(" }", ', map = { on = 1 }, blank = "hold" }'),
    ),
    (
        "t,p_r\n0,1\n1,\n2,1\n",
        PLAIN,
        'line 3, column \'p_r\', t = 1 s: nan is missing … (blank = "hold" or "linear")',
        PLAIN.replace(" }", ', blank = "linear" }'),
    ),
    (
        "t,p_r\n0,1\nsoon,1\n",
        DATES + PLAIN,
        "line 2, column t: '0' is not a time such as 2026-03-01T12:00:00; or give seconds",
        None,
    ),
    (
        "t,p_r\n2026-10-25T02:59:59.9+01:00,1\n2026-10-25T03:00:00,1\n",
        DATES + PLAIN,
        "line 3, column t: '2026-10-25T03:00:00' is not a time such as the first: all have a",
        None,
    ),
    (
        "t,p_r\n12:59:61,1\n13:00:02,1\n",
        f'[time]\nunit = "clock"\n{PLAIN}',
        "line 2, column t: '12:59:61' is not a time such as 12:00:00.5",
        None,
    ),
    (
        GOOD + "1,0,1\n",
        None,
        'line 4, column t: time repeats (1.0 s, then 1.0 s) … [time] repeated = "first"',
        f'{TIME}repeated = "first"\n{PLAIN}',
    ),
    (
        HEAD + "0,1,1\n1,1,1\n2,0,1\n0.5,0,1\n1.5,1,1\n2.5,1,1\n",
        PLAIN,
        'line 5, column t: time runs backwards … [time] sort = true … [time] jumps = "split"',
        f"{TIME}sort = true\n{PLAIN}",
    ),
    (
        GOOD + "3,0,1\n4,0,1\n",
        None,
        "line 4, column t: sampling is irregular (a step of 2 s at t = 3 s, the median step is 1 s"
        "; 1 of 3 steps … [resampling], method … sample_time = 1",
        GRID + PLAIN,
    ),
    (
        "t,m\n0,0.1\n1,3\n",
        MODE,
        "line 3, column 'mode', t = 1 s: 3.0 lies outside [0, 1] (who drives … (scale, above)",
        MODE.replace(" }", ", above = 2 }"),
    ),
    (
        "t,ä\n0,1\n1,1\n".encode("cp1252"),
        PLAIN.replace('"p_r"', '"ä"'),
        'line 1: byte 0xe4 is not UTF-8 text … [table] and encoding = "cp1252"',
        '[table]\nencoding = "cp1252"\n' + PLAIN.replace('"p_r"', '"ä"'),
    ),
    (
        "# rig 3\n" + GOOD,
        PLAIN,
        "line 1: found a comment instead of the names; skip it with [table] skip_lines",
        "[table]\nskip_lines = 1\n" + PLAIN,
    ),
    ("# trustlab {broken\n" + GOOD, None, "the trustlab metadata are damaged", None),
]


@pytest.mark.filterwarnings("ignore:.*is 1 throughout")
@pytest.mark.parametrize(("text", "recipe", "words", "remedy"), LOGS)
def test_a_log_that_cannot_be_read_as_it_is(read, tmp_path, text, recipe, words, remedy):
    with pytest.raises(SessionError) as caught:
        read(text, recipe)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'run.csv'}: ")
    assert [each for each in words.split(" … ") if each not in message] == [], message
    assert "\n" not in message
    assert message.encode().decode() == message  # it can be printed
    if isinstance(remedy, dict):
        assert len(read(text, recipe, **remedy)) >= 2
    elif remedy:
        assert len(read(text, remedy)) >= 2


RECIPES = [
    ("[columns]", "[colums]", "recipe: unknown key 'colums'; did you mean 'columns'?"),
    ('kind = "table"', 'kind = "bag"', '[table] is for kind = "table"'),
    ("yaw =", "t =", "[columns] t: not in the vocabulary; time goes under [time]"),
    ("yaw =", "performance_window =", "performance_window goes above the first [table]"),
    ('"%" }', '"m" }', "[columns] r: 'm' measures m, but 1 is needed; leave the unit out"),
    (', unit = "mm"', "", "[columns] robot_x: needs its unit (the session holds m)"),
    ("scale =", "scal =", "[columns] robot_y: unknown key 'scal'; did you mean 'scale'?"),
    ('column = "x"', 'column = "x", value = 1', "[columns] robot_x: needs exactly one of column"),
    ('column = "x"', 'topic = "/a", field = "x"', 'topic does not go with kind = "table"'),
    ("HUMAN = 1", "1 = 1, '1.0' = 1", "[columns] mode: two keys of the map mean the same value"),
    ('["robot", "reference"]', '["robot", "human"]', "path_error: needs column 'human_x' from"),
    ('value = "north"', 'value = "north", from = "who"', "site: needs either from or value"),
    ("{ trial = ", "{ trail = ", "[header]: 'trail' is no field of the files pattern; did you"),
    ("p{who}/runs", "../runs", "leads from a folder down, so that it has no . or .. in it"),
    (
        'delimiter = ";"',
        'delimiter = ","',
        "decimal and delimiter of a table must differ, both are ','",
    ),
    ("from_zero", 'sort = true\njumps = "split"\nfrom_zero', "[time]: sort orders all rows"),
    ("[time]", "[time", "not a TOML file"),
    ("site =", "source =", "[metadata] source: this name is taken; choose another"),
]


@pytest.mark.parametrize(("old", "new", "words"), RECIPES)
def test_the_first_fault_of_a_recipe_names_table_and_key(tmp_path, old, new, words):
    assert old in LAB
    path = tmp_path / "lab.toml"
    path.write_text(LAB.replace(old, new, 1))
    with pytest.raises(RecipeError, match=f"^{path}: .*{re.escape(words)}"):
        load_recipe(path)


def test_what_is_not_there_or_of_no_known_kind(read, tmp_path):
    """Single arguments that are wrong are those of the walk in `tests/test_contract.py`."""
    read(GOOD)
    own = write_session(read(GOOD), tmp_path / "own.mcap")
    bag = Bag(tmp_path / "a.mcap").numbers("/e", [0, 1]).write()
    (tmp_path / "run.sas7bdat").write_bytes(b"x")
    os.mkfifo(tmp_path / "pipe.csv")  # for whose writer reading waited for ever
    for path, options, words in [
        ("rum.csv", {}, "no file at this path (looked in "),
        (tmp_path / "pipe.csv", {}, "no file at this path"),
        (tmp_path / "run.csv", {"columns": [["p_r"]]}, "columns must be a list of names"),
        (tmp_path / "run.sas7bdat", {}, "then trustlab.read_frame(frame)"),
        (bag, {}, "not written by trustlab, so it needs a recipe (topics: /e)"),
        (own, {"delimiter": ";"}, "delimiter and decimal do not apply to .mcap"),
        (own, {"recipe": table_recipe(PLAIN)}, "'recipe' reads a table, but this is a bag"),
        (
            tmp_path / "run.csv",
            {"recipe": table_recipe(PLAIN), "delimiter": ";"},
            "beside a recipe: state them in its [table]",
        ),
    ]:
        with refused(re.escape(words)):
            read_session(path, **options)
    with refused("read a single file with read_session"):
        read_sessions(tmp_path / "run.csv")


def test_what_a_frame_lacks():
    frame = pd.DataFrame({"t": [0.0, 1.0], "p_r": [0.5, 0.5]})
    with refused(r"data frame: row 1 \(from 0\), column 'p"):
        read_frame(frame.assign(p_r=[1, np.nan]))
    with refused(r'write seconds, or set \[time\] unit = "iso" in a recipe'):
        read_frame(frame.assign(t=pd.to_datetime(["2026-03-01", "2026-03-02"])))
    for name, words in [
        ("p_h", r"session\.with_performance\(…\) computes p_r and"),
        ("u_h_x", r"with_columns\(u_h_x=session\['human_x'\], …\)"),
    ]:
        with refused(words):
            read_frame(frame).require(name)


def test_times_that_a_frame_has_twice_or_in_another_type():
    """pandas' own error, and a remedy that did not work."""
    frame = pd.DataFrame({"t": [0.0, 0.1, 0.2], "mode": [1, 1, 0]})
    with refused(r"'t' is both .* frame\.reset_index\(drop=True\)"):
        read_frame(frame.set_index("t", drop=False))
    spans = frame.assign(t=pd.to_timedelta(frame["t"], unit="s"))
    with refused(r"\.dt\.total_seconds\(\)"):
        read_frame(spans)
    assert read_frame(spans.assign(t=spans["t"].dt.total_seconds())) == read_frame(frame)


def test_times_of_too_few_digits_are_not_to_be_merged():
    """The remedy for equal times would have made six samples of ten minutes."""
    t = 1.7e9 + np.arange(60_000) * 0.01
    frame = pd.DataFrame({"t": t, "mode": 1, "p_r": 0.3})
    assert len(read_frame(frame)) == t.size
    with refused(r"32-bit floats .* to 128: .* 64-bit"):
        read_frame(frame.astype({"t": "float32"}))
    assert len(read_frame(frame.assign(t=t - t[0]).astype({"t": "float32"}))) == t.size
