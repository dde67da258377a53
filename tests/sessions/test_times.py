"""
Times, blanks, gaps, jumps, resampling. Oracle: pandas, numpy.interp, and loops over whole numbers.
"""

import re
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

from tests.sessions.logs import table_recipe
from trustlab.sessions import SessionError, draft_recipe, read_frame, read_sessions

PLAIN = '[columns]\np_r = { column = "a" }\n'
RULE = '[columns]\np_r = { column = "p_r" }\n'
ZERO = f'[time]\nunit = "UNIT"\nfrom_zero = true\n{PLAIN}'
RESAMPLED = '[resampling]\nmethod = "{}"\nsample_time = {}\n'


# --- units --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "times"),
    [
        (
            "iso",
            ["2026-02-28 23:59:59.9Z", "2026-03-01T01:00:00,4+01:00", "2026-03-01T00:00:00.9Z"],
        ),
        ("clock", [" 12:00:00,5", "12:00:01 ", "12:00:01.500"]),
        ("clock", ["23:59:59.5", "00:00:00", "0:00:00.5"]),  # after midnight
        ("us", [7, 500_007, 1_000_007]),
        ("min", [0.0, 0.5 / 60, 1 / 60]),
    ],
)
def test_times_in_other_units(read, unit, times):
    frame = pd.DataFrame({"t": times, "a": [0.1, 0.2, 0.3]})
    text = ZERO.replace("UNIT", unit)
    for session in (read(frame.to_csv(index=False), text), read_frame(frame, table_recipe(text))):
        np.testing.assert_allclose(session.t, [0.0, 0.5, 1.0], rtol=0, atol=1e-9)
    note = session.metadata.more.get("midnights")
    assert note == ("1 passed; times count on" if "23" in str(times[0])[:2] else None)


@pytest.mark.parametrize("zone", ["", "Z", "+01:00"])
def test_dates_keep_their_digits(read, zone):
    """Oracle: fractions of whole numbers, exact to the rounding of one float."""
    stamps = [999_999_999 + 123_456_789 * k for k in range(400)]  # every step has nine digits
    times = [f"2026-03-01T12:00:{ns // 10**9:02}.{ns % 10**9:09}{zone}" for ns in stamps]
    frame = pd.DataFrame({"t": times, "a": 1.0})
    recipe = table_recipe(ZERO.replace("UNIT", "iso"))
    sessions = [
        read(frame.to_csv(index=False), ZERO.replace("UNIT", "iso")),
        read_frame(frame.assign(t=pd.to_datetime(frame["t"])), recipe),
    ]
    start = pd.Timestamp(times[0]).timestamp()
    for session in sessions:
        assert session.t.tolist() == [float(Fraction(ns - stamps[0], 10**9)) for ns in stamps]
        assert session.metadata.more["start_time"] == start
    since_1970 = read_frame(frame, table_recipe(f'[time]\nunit = "iso"\n{PLAIN}'))
    np.testing.assert_allclose(since_1970.t, start + sessions[0].t, rtol=0, atol=5e-7)


# --- rows out of order, repeated, after a jump or a gap -------------------------------------------


# Columns of states, robots and choices: no other lies between two of them.
WHOLE = {"mode": "m", "may_switch": "m", "alpha_choice": "m", "leader_choice": "n", "leader": "n"}


@given(counts=st.lists(st.integers(1, 3), min_size=2, max_size=8), seed=st.integers(0, 99))
@pytest.mark.parametrize("rule", ["first", "last", "mean"])
def test_sorted_and_merged_rows_are_those_of_pandas(rule, counts, seed):
    """A mean of states would be none, robot 2.5 led; of distances all but one were lost."""
    rng = np.random.default_rng(seed)
    t = rng.permutation(np.repeat(np.arange(len(counts)), counts))
    columns = {"a": rng.random(t.size), "h": rng.random(t.size)}
    columns |= {"m": rng.integers(0, 2, t.size), "n": rng.integers(1, 5, t.size)}
    frame = pd.DataFrame({"t": t, **columns})
    states = "".join(f'{ours} = {{ column = "{theirs}" }}\n' for ours, theirs in WHOLE.items())
    session = read_frame(
        frame,
        table_recipe(
            f'[time]\nunit = "s"\nsort = true\nrepeated = "{rule}"\n{PLAIN}{states}'
            'yaw = { column = "h", unit = "rad" }\nstep_distance = { column = "a", unit = "m" }'
        ),
    )
    groups = frame.sort_values("t", kind="stable").groupby("t")
    np.testing.assert_allclose(session["p_r"], getattr(groups["a"], rule)(), rtol=1e-15)
    np.testing.assert_allclose(session["step_distance"], groups["a"].sum(), rtol=1e-15)
    for ours, theirs in {**WHOLE, "yaw": "h"}.items():
        expected = groups[theirs].first() if rule == "first" else groups[theirs].last()
        assert session[ours].tolist() == expected.tolist()
    more = session.metadata.more
    late = int((np.diff(t) < 0).sum())
    assert late == 0 or more["sorted"] == f"{late} samples stood after a later one"
    many = f"{t.size - len(counts)} of {t.size} samples merged by '{rule}'"
    assert t.size == len(counts) or more["repeated times"] == many


@given(steps=st.lists(st.sampled_from([1, 1, 1, 5, 2, -7]), min_size=3, max_size=30))
def test_parts_are_cut_where_time_jumps(tmp_path_factory, steps):
    t = np.cumsum([0, *steps])
    values = np.arange(t.size) / t.size
    folder = tmp_path_factory.mktemp("jumps")
    pd.DataFrame({"t": t, "a": values}).to_csv(folder / "run.csv", index=False)
    recipe = table_recipe(
        '[files]\npattern = "run.csv"\n[time]\nunit = "s"\njumps = "split"\n'
        f"[splitting]\ngap = 1\n{PLAIN}"
    )
    cuts = np.flatnonzero((np.diff(t) < 0) | (np.diff(t) > 1)) + 1
    pieces = list(zip(np.split(t, cuts), np.split(values, cuts), strict=True))
    parts = [(times.tolist(), a.tolist()) for times, a in pieces if times.size > 1]
    if not parts:
        with pytest.raises(SessionError, match="no part has two samples"):
            read_sessions(folder, recipe)
        return
    sessions = read_sessions(folder, recipe)
    assert [(each.t.tolist(), each["p_r"].tolist()) for each in sessions] == parts
    assert [each.metadata.more["part"] for each in sessions] == list(range(len(parts)))
    note = sessions[0].metadata.more["split"]
    short = len(pieces) - len(parts)
    assert note.startswith(f"part 0 (from 0) of {len(parts)}, split where time runs back and at ")
    assert note.endswith(f"gaps of more than 1 s; {short} too short")


# --- blanks -------------------------------------------------------------------------------------


CELL = st.none() | st.integers(0, 9)


@given(cells=st.lists(st.tuples(CELL, CELL), min_size=4, max_size=12), row=st.integers(0, 2))
def test_blanks_are_filled_as_pandas_fills_them(cells, row):
    cells = [*cells[:row], (1, 2), *cells[row:], (None, 4)]
    table = pd.DataFrame(cells, columns=["a", "b"], dtype=float)
    text = (
        '[columns]\np_r = { column = "a", blank = "hold" }\n'
        'p_h = { column = "b", blank = "linear" }'
    )
    frame = table.assign(t=np.arange(len(table)) / 4)
    session = read_frame(frame, table_recipe(text))
    filled = pd.DataFrame({"p_r": table["a"].ffill(), "p_h": table["b"].interpolate()})
    filled.loc[: table["b"].first_valid_index() - 1, "p_h"] = np.nan
    expected = filled.set_axis(frame["t"]).dropna()
    assert session.t.tolist() == expected.index.tolist()
    np.testing.assert_allclose(session.data, expected, rtol=1e-12)
    blank = f"{table['a'].isna().sum()} of {len(table)} cells, filled by 'hold'"
    assert session.metadata.more["blanks of p_r"] == blank
    cut = len(table) - len(expected)
    note = session.metadata.more.get("rows cut", "0 ")
    assert note.startswith(f"{cut} ")


@pytest.mark.parametrize("blank", ["hold", "linear"])
@pytest.mark.parametrize(
    ("rows", "parts", "begins"),
    [
        ("0,1\n1,2\n2,3\n3,\n0,\n1,5\n2,6", '[time]\nunit = "s"\njumps = "split"', 1),
        ("0,1\n1,2\n2,3\n3,\n9,\n10,5\n11,6", "[splitting]\ngap = 2", 10),
    ],
)
def test_blanks_at_the_edge_of_a_session_are_cut_and_not_filled_from_the_next(
    tmp_path, rows, parts, begins, blank
):
    """They were held across the jump or the gap, or lay on a line to the next session."""
    (tmp_path / "run.csv").write_text(f"t,a\n{rows}\n")
    recipe = table_recipe(
        f'[files]\npattern = "run.csv"\n{parts}\n'
        f'[columns]\npath_error = {{ column = "a", blank = "{blank}", unit = "m" }}\n'
    )
    first, second = read_sessions(tmp_path, recipe)
    assert first["path_error"].tolist() == ([1, 2, 3, 3] if blank == "hold" else [1, 2, 3])
    assert second.t.tolist() == [begins, begins + 1]
    assert second["path_error"].tolist() == [5, 6]


@pytest.mark.parametrize("rule", ["first", "last", "mean"])
def test_filling_blanks_leaves_what_was_measured(rule):
    """Where times repeat, the last value replaced the others of its time."""
    frame = pd.DataFrame({"t": [0, 1, 2, 3, 3, 4], "a": [0, None, 0.2, 0.3, 0.5, 0.6]})
    columns = '[columns]\np_r = { column = "a", blank = "linear" }'
    text = f'[time]\nunit = "s"\nrepeated = "{rule}"\n'
    session = read_frame(frame, table_recipe(text + columns))
    merged = {"first": 0.3, "last": 0.5, "mean": 0.4}[rule]
    np.testing.assert_allclose(session["p_r"], [0, 0.1, 0.2, merged, 0.6])


# --- resampling ---------------------------------------------------------------------------------


@given(
    steps=st.lists(st.integers(1, 40), min_size=2, max_size=12),
    start=st.integers(-50, 50),
    sample=st.integers(1, 30),
)
@pytest.mark.parametrize("method", ["linear", "previous", "nearest"])
@pytest.mark.filterwarnings("ignore:.*bridges a gap")
def test_resampling_against_loops_over_hundredths(method, steps, start, sample):
    times = np.cumsum([start, *steps])
    grid = np.arange(times[0], times[-1] + 1, sample)
    frame = pd.DataFrame({"t": times / 100, "mode": np.arange(times.size) % 2})
    frame["p_r"] = np.sin(np.arange(times.size)) ** 2
    frame["yaw"] = np.arctan2(np.sin(2.9 * frame.index), np.cos(2.9 * frame.index))
    options = {"resample": method, "sample_time": sample / 100}
    if grid.size < 2:
        with pytest.raises(SessionError, match=r"would make 1[.\d]* samples, but 2 to 20,000,000"):
            read_frame(frame, **options)
        return
    session = read_frame(frame, **options)
    np.testing.assert_allclose(session.t, grid / 100, rtol=0, atol=1e-12)
    before = [max(k for k in range(times.size) if times[k] <= g) for g in grid]
    note = f"{method} at {sample / 100:g} s; longest gap in the log {max(steps) / 100:g} s"
    assert session.metadata.more["resampled"] == note
    if method == "nearest":
        for value, g in zip(session["p_r"], grid, strict=True):
            nearest = np.flatnonzero(abs(times - g) == abs(times - g).min())
            assert value in frame["p_r"].to_numpy()[nearest]
        return
    assert session["mode"].tolist() == frame["mode"][before].tolist()  # no state is halved
    if method == "previous":
        assert session.data.equals(frame.iloc[before, 1:].astype(float).set_axis(session.t))
        return
    np.testing.assert_allclose(session["p_r"], np.interp(grid, times, frame["p_r"]), atol=1e-12)
    turned = np.interp(grid, times, np.unwrap(frame["yaw"]))  # the short way
    np.testing.assert_allclose(np.exp(1j * (session["yaw"] - turned)), 1.0, atol=1e-12)
    assert np.abs(session["yaw"]).max() <= np.pi


@pytest.mark.parametrize("start", [0.0, 1396293889.454, 1.7e9 + 0.001])
@pytest.mark.parametrize("step", [0.01, 0.05])
@pytest.mark.parametrize("from_zero", ["true", "false"])
def test_samples_stay_their_own_when_times_are_seconds_since_1970(start, step, from_zero):
    """Times on the grid, so that "previous" returns the samples as they are."""
    k = np.arange(500)
    frame = pd.DataFrame({"t": np.round(start + step * k, 3), "a": k / 500})
    text = ZERO.replace("UNIT", "s").replace("true", from_zero)
    session = read_frame(frame, table_recipe(RESAMPLED.format("previous", step) + text))
    assert session["p_r"].tolist() == frame["a"].tolist()


def test_a_recipe_resamples_each_column_by_its_own_rule(read):
    text = RESAMPLED.format("linear", 0.5) + (
        '[columns]\np_r = { column = "a" }\np_h = { column = "a", resample = "previous" }\n'
        'path_error = { column = "b", unit = "m", absolute = true }'
    )
    rows = "t,a,b\n0,0,-2\n1,4,2\n2,0,2\n"
    session = read(rows, text)
    assert session["p_r"].tolist() == [0, 2, 4, 2, 0]
    assert session["p_h"].tolist() == [0, 0, 4, 4, 0]
    assert session["path_error"].tolist() == [2] * 5  # a distance before it is interpolated
    caller = read(rows, text, resample="previous", sample_time=1.0)
    assert caller["p_r"].tolist() == [0, 4, 0]
    assert caller.metadata.more["resampled"].startswith("previous at 1 s")


@pytest.mark.parametrize(("gap", "warned"), [(1.3, 1), (0.9, 0)])
def test_a_gap_that_resampling_bridges_is_told(recwarn, gap, warned):
    """More than ten of the log's steps, and of the new ones."""
    frame = pd.DataFrame({"t": [0.0, 0.1, 0.2, 0.3, 0.4, 0.4 + gap], "p_r": 0.3})
    read_frame(frame, resample="linear", sample_time=0.05)
    assert len(recwarn) == warned
    for each in recwarn:
        start = "data frame: resampling bridges a gap of 1.3 s at t = 0.4 s; "
        assert str(each.message).startswith(start)


@pytest.mark.parametrize("method", ["linear", "previous", "nearest"])
@pytest.mark.parametrize("sample_time", [0.05, 0.1, 0.25, 1.0])
def test_a_distance_since_the_sample_before_is_that_since_the_new_one(method, sample_time):
    """Steps were kept as they were, so that speed grew with the ratio of the sample times."""
    steps = np.random.default_rng(0).random(401) * np.repeat([1, 0, 2, 0], [101, 100, 100, 100])
    frame = pd.DataFrame({"t": np.arange(401) * 0.1, "step_distance": steps, "p_r": 0.1})
    session = read_frame(frame, resample=method, sample_time=sample_time)
    whole = np.arange(len(session))[np.isclose(session.t % 1.0, 0.0)]
    way = np.cumsum(session["step_distance"])
    np.testing.assert_allclose(np.diff(way[whole]), steps[1:].reshape(-1, 10).sum(axis=1))
    assert session["step_distance"][0] == session["step_distance"][1]


# --- what is doubted ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "value", "words", "unit", "rule", "meant"),
    [
        (4.99, 10, None, "s", "", 10),
        (100, 1, 'samples are 100 s apart, .* unit = "ms"', "ms", "", 1),
        (1e5, 1, 'samples are 100000 s apart, .* unit = "us"', "us", "", 1),
        (1e8, 1, 'samples are 1e[+]08 s apart, .* unit = "ns"', "ns", "", 1),
        (1, -0.1, "column p_r has negative values.*offset", "s", ", offset = 0.1", 0),
        (1, 35, 'column p_r goes beyond 10, .*unit = "%"', "s", ', unit = "%"', 0.35),
    ],
)
def test_values_hardly_meant_are_told_once_and_the_remedy_works(
    read, recwarn, step, value, words, unit, rule, meant
):
    rows = "t,a\n" + "".join(f"{1.7e9 + k * step:.2f},{value}\n" for k in range(9))
    read(rows, PLAIN)
    told = [str(each.message) for each in recwarn]
    assert len(told) == (words is not None)
    assert all(re.search(rf"run\.csv: {words}", each) for each in told)
    recwarn.clear()
    session = read(rows, f'[time]\nunit = "{unit}"\n' + PLAIN.replace('"a"', f'"a"{rule}'))
    assert not recwarn.list
    assert session["p_r"][0] == pytest.approx(meant)


@pytest.mark.parametrize("rate", [1, 200, 1000])
@pytest.mark.parametrize(("unit", "size"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_stamps_since_1970_tell_their_unit(read, recwarn, tmp_path, unit, size, rate):
    """At 200 Hz milliseconds passed for seconds, and nanoseconds for microseconds in a draft."""
    stamps = [size * (1_700_000_000 + k / rate) for k in range(9)]
    rows = "".join(f"{stamp:.{3 if size == 1 else 0}f},1\n" for stamp in stamps)
    read("t,p_r\n" + rows)
    told = [str(each.message) for each in recwarn]
    assert [f'[time] unit = "{unit}"' in words for words in told] == [True] * (unit != "s")
    draft = draft_recipe(tmp_path / "run.csv", tmp_path / "lab.toml").read_text()
    assert f'\nunit = "{unit}"   # guessed' in draft
    recwarn.clear()
    read("t,p_r\n" + rows, f'[time]\nunit = "{unit}"\nfrom_zero = true\n' + RULE)
    assert not recwarn.list
    if unit == "ns":  # a thousand times too long by such a recipe
        read("t,p_r\n" + rows, '[time]\nunit = "us"\nfrom_zero = true\n' + RULE)
        assert '[time] unit = "ns"' in str(recwarn.list[0].message)


@pytest.mark.parametrize("word", ["none", "-", "NA", "null"])
def test_an_entry_of_a_map_is_no_blank(word):
    """The cell before was held over it."""
    frame = pd.DataFrame({"t": range(5), "s": ["manual", word, "auto", word, ""]})
    entries = f'{{ "{word}" = -1, manual = 1, auto = 0 }}'
    text = f'[columns]\nsuggested_mode = {{ column = "s", map = {entries}, blank = "hold" }}'
    assert read_frame(frame, table_recipe(text))["suggested_mode"].tolist() == [1, -1, 0, -1, -1]


@pytest.mark.parametrize("start", [1.7e9, 1396293889.454])
@pytest.mark.parametrize("step", [0.1, 0.02, 0.001])
def test_the_last_sample_of_dates_in_seconds_is_not_lost(start, step):
    """Rounding of 0.24 µs cost it."""
    for count in range(2, 40):
        frame = pd.DataFrame({"t": start + step * np.arange(count), "p_r": np.arange(count) / 40})
        session = read_frame(frame, resample="previous", sample_time=step)
        assert session["p_r"].tolist() == frame["p_r"].tolist()


@pytest.mark.parametrize("resampled", ["", RESAMPLED.format("previous", 0.1)])
def test_a_part_too_short_to_be_resampled_is_counted_as_too_short(tmp_path, resampled):
    """It made the whole log unreadable; without resampling it is a session."""
    t = np.r_[np.arange(20) / 10, 5.0, 5.05, 9 + np.arange(20) / 10, 20.0]
    pd.DataFrame({"t": t, "a": 0.5}).to_csv(tmp_path / "run.csv", index=False)
    text = f'[files]\npattern = "run.csv"\n{resampled}[splitting]\ngap = 1.0\n{PLAIN}'
    sessions = read_sessions(tmp_path, table_recipe(text))
    assert [len(session) for session in sessions] == ([20, 20] if resampled else [20, 2, 20])
    note = f"{2 if resampled else 1} too short"
    assert sessions[0].metadata.more["split"].endswith(note)


SPLIT = "[splitting]\ngap = 2\n"
JUMPS = '[time]\nunit = "s"\njumps = "split"\n'


@pytest.mark.parametrize(
    ("t", "values", "text", "columns", "cut"),
    [
        ([0, 1, 2, 9, 10, 11], [0.5] * 6, SPLIT, "", [False, True]),
        ([0, 1, 2, 0, 1, 2], [0.5] * 6, JUMPS, "", [False, True]),
        ([0, 9, 10, 11], [0.5] * 4, SPLIT, "", [True]),
        ([0, 1, 2, 3], [None, 0.5, 0.5, 0.5], "", ', blank = "hold"', [True]),
        ([0, 1, 2, 3], [0.5, None, 0.5, 0.5], "", ', blank = "hold"', [False]),
    ],
)
@pytest.mark.parametrize(
    ("name", "window"), [("p_r", 100), ("p_h", 100), ("p_r", None), ("robot_x", 100)]
)
def test_means_that_began_before_the_session_are_noted(
    tmp_path, t, values, text, columns, cut, name, window
):
    """They were fitted as if the averaging began with the session."""
    pd.DataFrame({"t": t, "a": values}).to_csv(tmp_path / "run.csv", index=False)
    unit = ', unit = "m"' if name == "robot_x" else ""
    recipe = table_recipe(
        f'[files]\npattern = "run.csv"\n{text}'
        f'[columns]\n{name} = {{ column = "a"{columns}{unit} }}\n'
    )
    sessions = read_sessions(tmp_path, replace(recipe, performance_window=window))
    noted = [each.metadata.more.get("performance_cut") for each in sessions]
    averaged = window and name != "robot_x"
    assert noted == [True if each and averaged else None for each in cut]
