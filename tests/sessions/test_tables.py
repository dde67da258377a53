"""Tables of text and Parquet. Oracle: pandas, and plain Python on the lines of a file."""

import io
import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, example, given, strategies as st
from numpy.testing import assert_allclose

from tests.cases import refused
from tests.sessions.logs import START, Bag, bag_recipe, table_recipe, write_table
from trustlab.sessions import draft_recipe, read_frame, read_session

TABLE = pd.DataFrame(
    {"t": np.arange(30) * 0.1, "p_r": np.sin(np.arange(30.0)) ** 2, "mode": np.arange(30) % 2}
)
TOPICS = """[columns]
p_r = { topic = "/p_r", field = "data" }
mode = { topic = "/mode", field = "data" }"""
TEXTS = ["a.csv", "a.CSV", "a.csv.gz", "a.tsv", "a.tsv.gz", "a.txt"]
BAGS = ["a.bag", "a.mcap", "a"]


@pytest.mark.parametrize("name", [*TEXTS, "a.parquet", *BAGS])
def test_one_run_in_every_format_is_the_same_session(tmp_path, name):
    path, recipe = tmp_path / name, None
    if name in BAGS:
        recipe, bag = bag_recipe(TOPICS), Bag(path)
        for column in ("p_r", "mode"):
            bag.numbers(f"/{column}", TABLE["t"], TABLE[column])
        bag.write()
    else:
        write_table(TABLE, path)
    session = read_session(path, recipe)
    assert session.metadata.source == str(path)
    # Stamps of bags are whole nanoseconds.
    assert_allclose(session.t, TABLE["t"], rtol=0.0, atol=1e-12 if recipe else 0.0)
    assert session.data.to_dict("list") == TABLE[["p_r", "mode"]].to_dict("list")
    assert session.columns == ["p_r", "mode"]


FINITE = st.floats(-1e300, 1e300)
STYLES = [repr, "{:.3e}".format, "{:+.2f}".format, "{:.17g}".format, "{:.0f}.".format]


@given(
    values=st.lists(st.tuples(FINITE, FINITE), min_size=2, max_size=6),
    style=st.sampled_from(STYLES),
    delimiter=st.sampled_from([",", ";", "\t", "|", " "]),
    comma=st.booleans(),
    header=st.booleans(),
    before=st.integers(0, 2),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    wrap=st.sampled_from(["{}", '"{}"']),
    mark=st.booleans(),
)
@example([(1.5, 2.5), (3.0, 4.0)], repr, ";", True, True, 1, "\r\n", '"{}"', True)
def test_a_table_of_any_layout_reads_as_pandas_reads_it(
    tmp_path, values, style, delimiter, comma, header, before, end, wrap, mark
):
    assume(not (comma and delimiter == ","))
    decimal = "," if comma else "."
    rows = [[f"{k / 4}", *map(style, row)] for k, row in enumerate(values)]
    rows = [[wrap.format(cell.replace(".", decimal)) for cell in row] for row in rows]
    lines = ["logger v2"] * before + [*map(delimiter.join, [["t", "x", "y"]] * header + rows)]
    text = end.join([*lines, ""])
    path = tmp_path / "run.csv"
    path.write_bytes("\ufeff".encode() * mark + text.encode())
    t, x, y = ('"t"', '"x"', '"y"') if header else (0, 1, 2)
    recipe = table_recipe(f"""
[table]
header = {str(header).lower()}
delimiter = {json.dumps(delimiter)}
decimal = "{decimal}"
skip_lines = {before}
[time]
column = {t}
unit = "s"
[columns]
trust_hr = {{ column = {x} }}
trust_rh = {{ column = {y} }}
""")
    expected = pd.read_csv(
        io.StringIO(text, newline=""),
        sep=delimiter,
        decimal=decimal,
        skiprows=before,
        header=0 if header else None,
    ).astype(float)
    table = read_session(path, recipe).table()
    assert table.to_numpy().tobytes() == expected.to_numpy().tobytes()


JUNK = ["abc", "1 2", "1_0", "0x1f", "٣", "--1", "true", "12:00", "1,5", "nan", "", "-", "inf"]


@given(
    n=st.integers(2, 40),
    data=st.data(),
    junk=st.sampled_from(JUNK),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
)
def test_a_cell_that_is_no_number_is_named_by_line_and_column(read, n, data, junk, end):
    row, column = data.draw(st.integers(0, n - 1)), data.draw(st.integers(0, 2))
    cells = [[f"{k / 4}", "0.5", "0.25"] for k in range(n)]
    cells[row][column] = f'"{junk}"'
    name = ["t", "p_r", "p_h"][column]
    with refused(rf"run\.csv: line {row + 2}, column '?{name}'?[,:]"):
        read(end.join(["t,p_r,p_h", *map(",".join, cells), ""]))


def test_names_over_two_lines_and_commas_between_tabs(read):
    session = read(
        '"t\n[s]"\t"p_r"\n0\t0,5\n1\t0,25\n',
        """
[table]
decimal = ","
[time]
column = "t\\n[s]"
unit = "s"
[columns]
p_r = { column = "p_r" }
""",
        name="run.tsv",
    )
    assert session["p_r"].tolist() == [0.5, 0.25]
    with refused("line 4, column t"):
        read('"t","p\n_r"\n0,1\nx,1\n', '[columns]\np_r = { column = "p\\n_r" }')


def test_a_last_line_that_was_cut_is_noted_and_warned_of(read):
    with pytest.warns(UserWarning, match=r"run\.csv: the last line has no end; .* cut short"):
        session = read("t,p_r\n0,0.31\n1,0.32\n2,0.3")
    assert session.metadata.more["last line"].startswith("has no end")
    assert session["p_r"].tolist() == [0.31, 0.32, 0.3]


@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "frame"])
def test_the_columns_of_a_session_are_its_own(tmp_path, name):
    """Neither the file nor the frame that it came from can change it, and it can be changed."""
    frame = TABLE.astype(float)
    if name == "frame":
        session = read_frame(frame)
        frame.loc[:, "p_r"] = 7.0
    else:
        path = write_table(frame, tmp_path / name)
        session = read_session(path)
        with path.open("r+b") as file:
            file.write(bytes(path.stat().st_size))
    assert session["p_r"].tolist() == TABLE["p_r"].tolist()
    assert session.data.dtypes.unique().tolist() == [float]
    session.data.iloc[0, 0] = 4.0
    assert session["p_r"][0] == 4.0


def test_parquet_as_pandas_writes_an_index_and_small_types(tmp_path):
    small = {"mode": [True, False], "p_r": np.array([1, 2], "float32"), "r": [0, 1]}
    frame = pd.DataFrame(small, index=pd.Index([0.0, 1.0], name="t"))
    frame.to_parquet(tmp_path / "run.parquet")
    expected = {"mode": [1.0, 0.0], "p_r": [1.0, 2.0], "r": [0.0, 1.0]}
    for session in (read_session(tmp_path / "run.parquet"), read_frame(frame)):
        assert session.data.to_dict("list") == expected


@pytest.mark.parametrize("words", ["object", "str", "category"])
def test_a_parquet_file_with_a_recipe(tmp_path, words):
    """Stamps of 1.7e18 ns would be 256 ns apart if they became floats too early."""
    recipe = table_recipe("""
[time]
column = "stamp"
unit = "ns"
from_zero = true
[columns]
mode = { column = "who", map = { H = 1, R = 0 } }
robot_x = { column = "x", unit = "cm" }""")
    stamps = [START, START + 1_000, START + 2_000]
    frame = pd.DataFrame({"stamp": stamps, "who": ["H", "R", "H"], "x": [0, 50, 100]})
    frame.astype({"who": words}).to_parquet(tmp_path / "run.parquet")
    session = read_session(tmp_path / "run.parquet", recipe=recipe)
    assert session.t.tolist() == [0.0, 1_000 * 1e-9, 2_000 * 1e-9]
    assert session["mode"].tolist() == [1.0, 0.0, 1.0]
    assert session["robot_x"].tolist() == [0.0, 0.5, 1.0]
    assert session.metadata.more["start_time"] == pytest.approx(START / 1e9, abs=1e-6)
    frame.loc[1, "who"] = "RR"
    with refused(r"row 1 \(from 0\), column 'who' \(mode\): 'RR' is not"):
        read_frame(frame, recipe)


@pytest.mark.parametrize("mark", ["\x0b", "\x0c", "\x1c", "\x85", "\u2028"])
def test_only_line_ends_end_a_line_above_the_names(read, tmp_path, mark):
    """The names were looked for two lines too high."""
    text = f"made by{mark}our logger\nt,mode\n0,1\n1,0\n"
    session = read(text, '[table]\nskip_lines = 1\n[columns]\nmode = { column = "mode" }')
    assert session["mode"].tolist() == [1, 0]
    log = tmp_path / "draft.csv"
    log.write_text(f"# {text}")
    draft = draft_recipe(log, tmp_path / "lab.toml")
    assert read_session(log, draft)["mode"].tolist() == [1, 0]


def test_a_quotation_mark_that_does_not_close_above_the_data(read):
    """In a long file this was an UnboundLocalError."""
    with refused(r"run\.csv: line 1: a quotation mark that opens here"):
        read('"t,mode\n' + "0,1\n" * 40_000)


def test_quoted_decimal_commas_between_commas_are_read_by_pandas(read, tmp_path):
    """The remedy led to a refusal that had none, and a draft was a recipe that is refused."""
    text = 't,p_r\n0,"0,5"\n1,"0,25"\n'
    with refused('decimal=","'):
        read(text)
    words = r"must differ, both are ','; .*read_frame\(pandas\.read_csv\(path, decimal=\",\"\)\)"
    with refused(words):
        read(text, decimal=",")
    with refused(words):
        draft_recipe(tmp_path / "run.csv", tmp_path / "lab.toml")
    session = read_frame(pd.read_csv(tmp_path / "run.csv", decimal=","))
    assert session["p_r"].tolist() == [0.5, 0.25]
