"""Whatever bytes a file holds, reading it gives a valid session or one of our errors."""

import io
import os
import re
import warnings
from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st
from trustlab.sessions.readers.csv_files import _fast, _scan
from trustlab.sessions.readers.tables import SourceColumn

from trustlab.sessions import (
    Metadata,
    RecipeError,
    Session,
    SessionError,
    read_session,
    write_session,
)
from trustlab.sessions.recipe import Recipe, TableRule, load_recipe

MORE = (
    "TRUSTLAB_FUZZ" in os.environ
)  # a number of examples for a longer search, other ones each time
EXAMPLES = int(os.environ.get("TRUSTLAB_FUZZ", "120"))
deterministic = settings(
    max_examples=EXAMPLES,
    derandomize=not MORE,
    deadline=10_000,  # [ms]: nothing hangs
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


def session() -> Session:
    t = np.arange(12) * 0.1
    data = pd.DataFrame(
        {
            "mode": (t > 0.5) * 1.0,
            "p_r": 0.3 + 0.01 * np.sin(t),
            "robot_x": -t,
            "path_error": t / 7,
        },
        index=t,
    )
    return Session(
        data, Metadata(participant=3, condition="C1", more={"trial": 2, "autonomy": 0.4})
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def originals(folder):
    """Return the bytes of a valid file of each format."""
    paths = {
        suffix: write_session(session(), folder / f"valid{suffix}")
        for suffix in (".csv", ".parquet", ".bag", ".mcap")
    }
    written = {suffix: path.read_bytes() for suffix, path in paths.items()}
    bag = write_session(session(), folder / "valid")
    written["db3"] = next(bag.glob("*.db3")).read_bytes()
    written["yaml"] = (bag / "metadata.yaml").read_bytes()
    return written


def read_or_refuse(path, **options):
    """
    Read; only our errors may come out, and what comes out otherwise must hold what a session
    promises.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read = read_session(path, **options)
        except (SessionError, RecipeError) as error:
            fault = str(error)
        else:
            fault = None
    if fault is not None:
        assert 0 < len(fault) < 3000
        return None
    assert np.isfinite(read.data.to_numpy()).all()
    assert (np.diff(read.t) > 0).all()
    assert len(read) >= 2
    repr(read)
    return read


@st.composite
def mutations(draw):
    """Return a function that damages bytes."""
    kind = draw(st.sampled_from(["flip", "cut", "insert", "remove", "swap", "overwrite"]))
    where, share = draw(st.floats(0, 1)), draw(st.floats(0, 0.3))
    junk = draw(st.binary(min_size=1, max_size=24))

    def damage(data: bytes) -> bytes:
        at = min(int(where * len(data)), len(data) - 1)
        to = min(at + 1 + int(share * len(data)), len(data))
        if kind == "flip":
            return data[:at] + bytes([data[at] ^ junk[0]]) + data[at + 1 :]
        if kind == "cut":
            return data[:at]
        if kind == "insert":
            return data[:at] + junk + data[at:]
        if kind == "remove":
            return data[:at] + data[to:]
        if kind == "swap":
            return (
                data[:at]
                + data[to : to + 16]
                + data[at + 16 : to]
                + data[at : at + 16]
                + data[to + 16 :]
            )
        return data[:at] + junk + data[at + len(junk) :]

    return damage


@deterministic
@given(
    data=st.binary(max_size=300),
    suffix=st.sampled_from([".csv", ".parquet", ".bag", ".mcap", ".db3"]),
)
@example(data=b"", suffix=".csv")
@example(data=b"\xef\xbb\xbf", suffix=".csv")
@example(data=b"#ROSBAG V2.0\n", suffix=".bag")
@example(data=b"\x89MCAP0\r\n\x89MCAP0\r\n", suffix=".mcap")
@example(data=b"PAR1PAR1", suffix=".parquet")
def test_any_bytes(folder, data, suffix):
    path = folder / f"any{suffix}"
    path.write_bytes(data)
    assert read_or_refuse(path) is None


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".bag", ".mcap"])
@deterministic
@given(damages=st.lists(mutations(), min_size=1, max_size=3))
def test_damaged_files(folder, originals, suffix, damages):
    data = originals[suffix]
    for damage in damages:
        data = damage(data) or b"?"
    path = folder / f"damaged{suffix}"
    path.write_bytes(data)
    read_or_refuse(path)


@pytest.mark.parametrize("part", ["db3", "yaml"])
@deterministic
@given(damage=mutations())
def test_damaged_rosbag2_folders(folder, originals, part, damage):
    bag = folder / "damaged_folder"
    bag.mkdir(exist_ok=True)
    for name, kind in (("valid.db3", "db3"), ("metadata.yaml", "yaml")):
        (bag / name).write_bytes(damage(originals[kind]) if kind == part else originals[kind])
    read_or_refuse(bag)


CELLS = st.sampled_from(
    """0 1 -0.0 1e308 -1e308 1e-320 1e400 nan inf -inf NaN NA 0.1 0.2 0.30000000000000004 +.5 5.
    1e5 abc 1_0 0x1f ١ '' 1,5 2026-01-01 true 9007199254740993 - ä "0.4" "a""b" " """.split()  # noqa: SIM905
) | st.sampled_from(["", " ", " 0.1 ", "\t7", "\0", "1 2"])
NAMES = st.sampled_from(
    [
        "t",
        "mode",
        "p_r",
        "path_error",
        "robot_x",
        "time",
        "P_r",
        "modus",
        "",
        "#",
        "1",
        " t ",
        '"r"',
    ]
)


@st.composite
def tables(draw):
    """Return the text of a table that is nearly right."""
    width, rows = draw(st.integers(1, 4)), draw(st.integers(0, 6))
    names = ["t", *draw(st.permutations(["mode", "p_r", "robot_x"]))][:width]
    cells = [[f"{0.1 * k!r}", *(["0.5"] * (width - 1))] for k in range(rows)]
    for _ in range(draw(st.integers(0, 3))):
        if rows and draw(st.booleans()):
            row = cells[draw(st.integers(0, rows - 1))]
            if row:
                row[draw(st.integers(0, len(row) - 1))] = draw(CELLS)
        elif draw(st.booleans()):
            names[draw(st.integers(0, width - 1))] = draw(NAMES)
        elif rows:
            row = cells[draw(st.integers(0, rows - 1))]
            row.append(draw(CELLS)) if draw(st.booleans()) else row.pop() if row else None
    end = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    lines = [",".join(names), *(",".join(row) for row in cells)]
    if draw(st.integers(0, 5)) == 0:
        lines.insert(draw(st.integers(0, len(lines))), "")
    return end.join(lines) + draw(st.sampled_from(["", end, end + end]))


@settings(deterministic, max_examples=3 * EXAMPLES)
@given(
    text=tables(),
    resample=st.sampled_from([None, "linear", "previous", "nearest"]),
    step=st.sampled_from([0.05, 1e-9]),
)
def test_tables_that_are_nearly_right(folder, text, resample, step):
    path = folder / "nearly.csv"
    path.write_bytes(text.encode())
    read_or_refuse(path, **({"resample": resample, "sample_time": step} if resample else {}))


@settings(deterministic, max_examples=3 * EXAMPLES)
@given(text=tables())
def test_the_fast_reader_agrees_with_the_exact_one(text):
    body = text.split("\n", 1)[-1]
    width = max(body.split("\n")[0].count(",") + 1, 1)
    cells = [SourceColumn(str(k), k, str(k)) for k in range(width)]
    opened = partial(io.BytesIO, body.encode())
    fast = _fast(opened, 0, cells, TableRule(delimiter=","), width)
    if fast is None:
        return  # then the exact reader is the one that counts
    exact, _, fault = _scan(opened, 0, cells, TableRule(delimiter=","), width, "it has")
    assert fault is None
    for name, values in exact.items():
        assert values.tobytes() == np.ascontiguousarray(fast[name]).tobytes()


FINITE = st.floats(allow_nan=False, allow_infinity=False)
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | FINITE | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=4,
)


@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "a.bag", "a.mcap", "a"])
@settings(deterministic, max_examples=EXAMPLES // 3)
@given(
    values=st.lists(FINITE, min_size=2, max_size=5),
    start=st.floats(-1e9, 1e9),
    step=st.floats(1e-3, 1e6),
    participant=st.none() | st.integers() | st.text(max_size=6),
    more=st.dictionaries(st.text(max_size=5), PLAIN, max_size=3),
)
def test_written_sessions_read_back_bit_for_bit(
    folder, name, values, start, step, participant, more
):
    t = start + step * np.arange(len(values))
    more = {
        key: value
        for key, value in more.items()
        if key not in ("participant", "condition", "source", "synthetic")
    }
    original = Session(
        pd.DataFrame({"robot_x": values, "p_r": values[::-1]}, index=t),
        Metadata(participant, more=more),
    )
    read = read_session(write_session(original, folder / name))
    assert read == original
    assert type(read.metadata.participant) is type(participant)
    assert read.t.tobytes() == original.t.tobytes()
    for column in original.columns:
        assert read[column].tobytes() == original[column].tobytes()


RECIPE = """
name = "x"
kind = "table"
[files]
pattern = "p{who:int}/run{trial:int}.csv"
[table]
header = true
delimiter = ";"
[time]
column = "stamp"
unit = "ms"
from_zero = true
[resampling]
method = "linear"
sample_time = 0.1
[columns]
mode = { column = "who", map = { MANUAL = 1, AUTO = 0 } }
robot_x = { column = "x", unit = "mm", scale = 2.0 }
step_distance = { travelled = "robot", axes = ["x"] }
[metadata]
participant = { from = "who" }
training = { from = "trial", map = { 1 = true }, default = false }
"""
WORDS = st.sampled_from(re.split(r"[\s={}]+", RECIPE.strip())) | st.sampled_from(
    [
        "[]",
        "{}",
        "-1",
        "nan",
        "inf",
        "1e400",
        "true",
        '""',
        "''",
        "1979-05-27",
        "[[columns]]",
        "bag",
        "[1, 2]",
    ]
)


def test_the_recipe_that_is_damaged_below_is_valid():
    assert Recipe.from_toml(RECIPE).resampling.sample_time == 0.1


@settings(deterministic, max_examples=3 * EXAMPLES)
@given(old=WORDS, new=WORDS, damage=mutations(), words=st.booleans())
def test_damaged_recipes(old, new, damage, words):
    text = RECIPE.replace(old, new) if words else damage(RECIPE.encode()).decode("utf-8", "replace")
    try:
        recipe = Recipe.from_toml(text)
    except RecipeError as error:
        assert str(error)  # noqa: PT017
    else:
        assert recipe.columns


@deterministic
@given(data=st.binary(max_size=60))
def test_recipe_files_of_any_bytes(folder, data):
    path = folder / "any.toml"
    path.write_bytes(data)
    with pytest.raises(RecipeError):
        load_recipe(path)


def test_an_exception_that_is_not_ours_is_noticed(folder, monkeypatch):
    # Negative control: with the guard around the bag reader gone, damaged bags come out as foreign
    # exceptions.
    from contextlib import nullcontext

    path = folder / "control.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + b"\0" * 40)
    read_or_refuse(path)
    monkeypatch.setattr("trustlab.sessions.readers.bags._guard", nullcontext)
    with pytest.raises(Exception) as caught:
        read_or_refuse(path)
    assert not isinstance(caught.value, SessionError)
