"""
Times, blanks, gaps, jumps, resampling. Oracle: pandas, numpy.interp, and loops over whole numbers.
"""

import re
from contextlib import nullcontext
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose

from tests.cases import refused
from tests.sessions.logs import table_recipe
from trustlab.sessions import draft_recipe, read_frame

PLAIN = '[columns]\np_r = { column = "p_r" }\n'
ZERO = f'[time]\nunit = "UNIT"\nfrom_zero = true\n{PLAIN}'
RESAMPLED = '[resampling]\nmethod = "{}"\nsample_time = {}\n'
REPEATED = '[time]\nunit = "s"\nrepeated = "mean"\n'
JUMPS = '[time]\nunit = "s"\njumps = "split"\n'


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
    frame = pd.DataFrame({"t": times, "p_r": [0.1, 0.2, 0.3]})
    text = ZERO.replace("UNIT", unit)
    for session in (read(frame.to_csv(index=False), text), read_frame(frame, table_recipe(text))):
        assert_allclose(session.t, [0.0, 0.5, 1.0], rtol=0, atol=1e-9)
    note = session.metadata.more.get("midnights")
    assert note == ("1 passed; times count on" if "23" in str(times[0])[:2] else None)


# --- rows out of order, repeated, after a jump or a gap -------------------------------------------


# Columns of states, choices and robots: no other lies between two of them.
STATES = ["mode", "may_switch", "alpha_choice", "leader_choice", "leader"]
UNITS = {"step_distance": "m", "yaw": "rad"}


@given(
    rule=st.sampled_from(["first", "last", "mean"]),
    counts=st.lists(st.integers(1, 3), min_size=2, max_size=8),
    seed=st.integers(0, 99),
)
def test_sorted_and_merged_rows_are_those_of_pandas(rule, counts, seed):
    """A mean of states would be none, robot 2.5 led; of distances all but one were lost."""
    rng = np.random.default_rng(seed)
    t = rng.permutation(np.repeat(np.arange(len(counts)), counts))
    frame = pd.DataFrame(rng.random((t.size, 3)), columns=["p_r", "step_distance", "yaw"])
    frame[STATES] = rng.integers([0, 0, 0, 1, 1], [2, 2, 2, 3, 3], (t.size, 5))
    rules = "".join(
        f'{name} = {{ column = "{name}", unit = "{UNITS.get(name, 1)}" }}\n' for name in frame
    )
    text = f'[time]\nunit = "s"\nsort = true\nrepeated = "{rule}"\n[columns]\n{rules}'
    session = read_frame(frame.assign(t=t), table_recipe(text))
    ways = dict.fromkeys(["yaw", *STATES], "first" if rule == "first" else "last")
    groups = frame.assign(t=t).sort_values("t", kind="stable").groupby("t")
    expected = groups.agg({"p_r": rule, "step_distance": "sum", **ways})
    assert_allclose(session.data, expected, rtol=1e-15)
    more = session.metadata.more
    late = int((np.diff(t) < 0).sum())
    assert late == 0 or more["sorted"] == f"{late} samples stood after a later one"
    many = f"{t.size - len(counts)} of {t.size} samples merged by '{rule}'"
    assert t.size == len(counts) or more["repeated times"] == many


BLANKS = """[columns]
p_r = { column = "p_r", blank = "linear" }
p_h = { column = "p_h", blank = "hold" }"""


@given(
    steps=st.lists(st.sampled_from([1, 1, 1, 5, 2, -7]), min_size=3, max_size=15),
    share=st.sampled_from([0.0, 0.2, 0.5]),
    seed=st.integers(0, 99),
)
def test_parts_are_cut_where_time_jumps_and_blanks_filled_within(read_parts, steps, share, seed):
    """They were held across a jump or a gap, or lay on a line to the next session."""
    rng = np.random.default_rng(seed)
    t = np.cumsum([0, *steps])
    values, drawn = rng.random((2, t.size, 2))
    whole = pd.DataFrame(np.where(drawn < share, np.nan, values), t, ["p_r", "p_h"])
    whole.iloc[0] = 1.0
    cuts = np.flatnonzero((np.diff(t) < 0) | (np.diff(t) > 1)) + 1
    filled = [
        piece.assign(
            p_r=piece["p_r"].interpolate(method="index", limit_area="inside"),
            p_h=piece["p_h"].ffill(),
        ).dropna()
        for piece in (whole.iloc[first:end] for first, end in pairwise([0, *cuts, t.size]))
    ]
    parts = [piece for piece in filled if len(piece) > 1]
    left = pd.concat(filled).index.to_numpy()
    fault = "" if parts else "no part has two samples"
    if (np.diff(left) < 0).sum() < (np.diff(t) < 0).sum():
        fault = "time does not run back where the next begins; fill these cells"
    with refused(fault) if fault else nullcontext():
        sessions = read_parts(
            whole.to_csv(index_label="t"), f"{JUMPS}[splitting]\ngap = 1\n{BLANKS}"
        )
    if fault:
        return
    for each, part in zip(sessions, parts, strict=True):
        assert each.t.tolist() == part.index.tolist()
        assert_allclose(each.data, part, rtol=1e-12)
    assert [each.metadata.more["part"] for each in sessions] == list(range(len(parts)))
    more = sessions[0].metadata.more
    short = sum(len(piece) == 1 for piece in filled)
    assert more["split"] == (
        f"part 0 (from 0) of {len(parts)}, split where time runs back and at gaps of more than 1 s"
        f"; {short} too short"
    )
    blanks = f"{whole['p_h'].isna().sum()} of {t.size} cells, filled by 'hold'"
    assert more["blanks of p_h"] == blanks
    assert more.get("rows cut", "0 ").startswith(f"{t.size - left.size} ")


# --- blanks -------------------------------------------------------------------------------------


def test_filling_blanks_leaves_what_was_measured(read):
    """Where times repeat, the last value replaced the others of its time."""
    session = read("t,p_r,p_h\n0,0,1\n1,,1\n2,2,1\n3,3,1\n3,5,1\n4,6,1\n", REPEATED + BLANKS)
    assert session["p_r"].tolist() == [0, 1, 2, 4, 6]


@pytest.mark.parametrize("word", ["none", "-", "NA", "null"])
def test_an_entry_of_a_map_is_no_blank(read, word):
    """The cell before was held over it."""
    entries = f'{{ "{word}" = -1, manual = 1, auto = 0 }}'
    text = f'[columns]\nsuggested_mode = {{ column = "s", map = {entries}, blank = "hold" }}'
    session = read(f"t,s\n0,manual\n1,{word}\n2,auto\n3,{word}\n4,\n", text)
    assert session["suggested_mode"].tolist() == [1, -1, 0, -1, -1]


# --- resampling ---------------------------------------------------------------------------------


@given(
    method=st.sampled_from(["linear", "previous", "nearest"]),
    steps=st.lists(st.integers(1, 40), min_size=2, max_size=12),
    start=st.integers(-50, 50),
    sample=st.integers(1, 30),
)
@pytest.mark.filterwarnings("ignore:.*bridges a gap")
def test_resampling_against_whole_hundredths(method, steps, start, sample):
    times = np.cumsum([start, *steps])
    grid = np.arange(times[0], times[-1] + 1, sample)
    k = np.arange(times.size)
    yaw = np.angle(np.exp(2.9j * k))
    columns = {"t": times / 100, "trust_1": k, "mode": k % 2, "p_r": np.sin(k) ** 2, "yaw": yaw}
    frame = pd.DataFrame(columns)
    options = {"resample": method, "sample_time": sample / 100}
    if grid.size < 2:
        with refused(r"would make 1[.\d]* samples, but 2 to 20,000,000"):
            read_frame(frame, **options)
        return
    session = read_frame(frame, **options)
    assert_allclose(session.t, grid / 100, rtol=0, atol=1e-12)
    note = f"{method} at {sample / 100:g} s; longest gap in the log {max(steps) / 100:g} s"
    assert session.metadata.more["resampled"] == note
    apart = grid[:, None] - times
    before = np.where(apart < 0, np.inf, apart).argmin(axis=1)
    if method == "linear":
        assert_allclose(session["p_r"], np.interp(grid, times, frame["p_r"]), atol=1e-12)
        turned = np.interp(grid, times, np.unwrap(yaw))  # the short way
        assert_allclose(np.exp(1j * (session["yaw"] - turned)), 1.0, atol=1e-12)
        assert np.abs(session["yaw"]).max() <= np.pi
        assert session["mode"].tolist() == (before % 2).tolist()  # no state is halved
        return
    chosen = session["trust_1"].astype(int)
    nearest = np.abs(apart[np.arange(grid.size), chosen]) == np.abs(apart).min(axis=1)
    assert (nearest if method == "nearest" else chosen == before).all()
    assert session.data.equals(frame.iloc[chosen, 1:].astype(float).set_axis(session.t))


@pytest.mark.parametrize("start", [0.0, 1396293889.454, 1.7e9 + 0.001])
@pytest.mark.parametrize("step", [0.001, 0.01, 0.05, 0.1])
@pytest.mark.parametrize("from_zero", ["true", "false"])
def test_samples_stay_their_own_when_times_are_seconds_since_1970(start, step, from_zero):
    """
    Times on the grid, so that "previous" returns the samples as they are. Rounding of 0.24 µs cost
    the last one in logs of some lengths.
    """
    text = ZERO.replace("UNIT", "s").replace("true", from_zero)
    recipe = table_recipe(RESAMPLED.format("previous", step) + text)
    for count in (*range(2, 40), 500):
        k = np.arange(count)
        frame = pd.DataFrame({"t": np.round(start + step * k, 3), "p_r": k / 500})
        assert read_frame(frame, recipe)["p_r"].tolist() == frame["p_r"].tolist()


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


@pytest.mark.parametrize("method", ["linear", "previous", "nearest"])
@pytest.mark.parametrize("sample_time", [0.05, 0.1, 0.25, 1.0])
def test_a_distance_since_the_sample_before_is_that_since_the_new_one(method, sample_time):
    """Steps were kept as they were, so that speed grew with the ratio of the sample times."""
    steps = np.random.default_rng(0).random(401) * np.repeat([1, 0, 2, 0], [101, 100, 100, 100])
    frame = pd.DataFrame({"t": np.arange(401) * 0.1, "step_distance": steps, "p_r": 0.1})
    session = read_frame(frame, resample=method, sample_time=sample_time)
    whole = np.arange(len(session))[np.isclose(session.t % 1.0, 0.0)]
    way = np.cumsum(session["step_distance"])
    assert_allclose(np.diff(way[whole]), steps[1:].reshape(-1, 10).sum(axis=1))
    assert session["step_distance"][0] == session["step_distance"][1]


# --- what is doubted ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "value", "words", "unit", "rule", "meant"),
    [
        (4.99, 10, None, "s", "", 10),
        (100, 1, 'samples are 100 s apart, .* unit = "ms"', "ms", "", 1),
        (1e8, 1, 'samples are 1e[+]08 s apart, .* unit = "ns"', "ns", "", 1),
        (1, -0.1, "column p_r has negative values.*offset", "s", ", offset = 0.1", 0),
        (1, 35, 'column p_r goes beyond 10, .*unit = "%"', "s", ', unit = "%"', 0.35),
    ],
)
def test_values_hardly_meant_are_told_once_and_the_remedy_works(
    read, recwarn, step, value, words, unit, rule, meant
):
    rows = "t,p_r\n" + "".join(f"{1.7e9 + k * step:.2f},{value}\n" for k in range(9))
    read(rows)
    told = [str(each.message) for each in recwarn]
    assert len(told) == (words is not None)
    assert all(re.search(rf"run\.csv: {words}", each) for each in told)
    recwarn.clear()
    session = read(rows, f'[time]\nunit = "{unit}"\n' + PLAIN.replace(" }", f"{rule} }}"))
    assert not recwarn.list
    assert session["p_r"][0] == pytest.approx(meant)


@pytest.mark.parametrize("rate", [1, 200, 1000])
@pytest.mark.parametrize(("unit", "size"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_stamps_since_1970_tell_their_unit(read, recwarn, tmp_path, unit, size, rate):
    """At 200 Hz milliseconds passed for seconds, and nanoseconds for microseconds in a draft."""
    stamps = [size * (1_700_000_000 + k / rate) for k in range(9)]
    rows = "t,p_r\n" + "".join(f"{stamp:.{3 if size == 1 else 0}f},1\n" for stamp in stamps)
    read(rows)
    told = [str(each.message) for each in recwarn]
    assert [f'[time] unit = "{unit}"' in words for words in told] == [True] * (unit != "s")
    draft = draft_recipe(tmp_path / "run.csv", tmp_path / "lab.toml").read_text()
    assert f'\nunit = "{unit}"   # guessed' in draft
    recwarn.clear()
    read(rows, ZERO.replace("UNIT", unit))
    assert not recwarn.list
    if unit == "ns":  # a thousand times too long by such a recipe
        read(rows, ZERO.replace("UNIT", "us"))
        assert '[time] unit = "ns"' in str(recwarn.list[0].message)


@pytest.mark.parametrize(
    ("rows", "text", "cut"),
    [
        ("0,1\n1,1\n9,1\n10,1\n", "[splitting]\ngap = 2\n", [None, True]),
        ("0,1\n1,1\n0,1\n1,1\n", JUMPS, [None, True]),
        ("0,1\n9,1\n10,1\n", "[splitting]\ngap = 2\n", [True]),
        ("0,\n1,1\n2,1\n", "", [True]),
        ("0,1\n1,\n2,1\n", "", [None]),
    ],
)
@pytest.mark.parametrize("name", ["p_r", "p_h", "r"])
@pytest.mark.parametrize("window", ["performance_window = 100\n", ""])
def test_means_that_began_before_the_session_are_noted(read_parts, rows, text, cut, name, window):
    """They were fitted as if the averaging began with the session."""
    rule = f'[columns]\n{name} = {{ column = "a", blank = "hold" }}'
    sessions = read_parts(f"t,a\n{rows}", window + text + rule)
    noted = [each.metadata.more.get("performance_cut") for each in sessions]
    assert noted == (cut if window and name != "r" else [None] * len(cut))
