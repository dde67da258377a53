"""
Damage logs of every format at random and read them: only our errors may come out, and soon.

Times are the processor's, so that a busy machine does not make a log look slow.

What fails is returned with its seed, and `fuzz(FORMAT, [SEED])` repeats it. The last formats,
`READS`, damage what recipes say and the files, bags and cells that they read: rules of every kind
put together at random, selectors, splitting at gaps, sorting, data frames, folders.
"""

import json
import tempfile
import time
import traceback
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from tests.sessions.logs import TEXT, Bag, stamped, write_table
from trustlab.sessions import (
    SessionError,
    read_frame,
    read_session,
    read_sessions,
    write_session,
)

MOST_SECONDS = 5.0
READS = ("file", "frame", "folder", "bags")


def session():
    t = np.arange(40) * 0.1
    columns = {"t": t, "mode": t > 1.5, "p_r": 0.3 + 0.01 * np.sin(t), "robot_x": -t}
    return read_frame(pd.DataFrame(columns), participant=3, condition="C1", trial=2)


WRITTEN = ["csv", "parquet", "mcap"]
FILES = ["csv", "tsv", "txt", "csv.gz", "parquet"]


def recording(path):
    """Write the session as a bag of ours, in the formats that `write_session` does not write."""
    bag = Bag(path)
    facts = {"participant": 3, "condition": "C1", "more": {"trial": 2}, "samples": 40}
    bag.add("/trustlab/metadata", 0, TEXT, data=json.dumps(facts))
    for name, values in session().table().items():
        bag.numbers(f"/trustlab/{name}", session().t, values)
    return bag.write()


def transforms(path):
    """
    Write a bag in which two robots publish their places in turn, and a wheeled one the state of its
    joints.
    """
    bag = Bag(path)
    for k in range(40):
        place = {"translation": {"x": 0.1 * k}, "rotation": {"w": 1.0}}
        frame = {"header": stamped(k * 10**9), "child_frame_id": "ab"[k % 2], "transform": place}
        bag.add("/tf", k, "tf2_msgs/msg/TFMessage", transforms=[frame])
        joints = {
            "header": stamped(k * 10**9 + 10**8 * (k % 3)),
            "name": ["wheel_left", "wheel_right"][: 1 + k % 2],
            "position": np.array([0.1 * k, -0.1 * k])[: 1 + k % 2],
        }
        bag.add("/joint_states", k + 1e-9, "sensor_msgs/msg/JointState", **joints)
    return bag.write()


def originals(folder):
    """Write a valid log of each format; return what is read, and the file of it that is damaged."""
    paths = {name: write_session(session(), folder / f"a.{name}") for name in WRITTEN}
    paths["csv.gz"] = write_table(session().table(), folder / "a.csv.gz")
    paths |= {name: recording(folder / name) for name in ("a.bag", "db3", "yaml")}
    paths["bags"] = transforms(folder / "bags")
    inside = {"db3": "*.db3", "yaml": "metadata.yaml", "bags": "*.db3"}
    return {
        name: (path, next(path.glob(inside[name])) if name in inside else path)
        for name, path in paths.items()
    }


def damaged(data, rng):
    """Return bytes with one to four faults of the kinds that disks, programs and people make."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(data) + 1))
        to = min(at + 1 + int(rng.exponential(0.05 * len(data) + 1)), len(data))
        bit = 1 << int(rng.integers(8))
        odd = one_of(rng, [b"\xff" * 8, b"\x00" * 7 + b"\x7f", b"\xff\xff\xff\x7f", b"-1e999,"])
        faults = [
            (at + 1, bytes(byte ^ bit for byte in data[at : at + 1])),
            (None, b""),
            (at, rng.bytes(int(rng.integers(1, 24)))),
            (to, b""),
            (to, bytes(to - at)),
            (at + 8, odd),
            (at, data[at:to]),
            (at + 4, rng.bytes(4)),
        ]
        end, put = one_of(rng, faults)
        data[at:end] = put
    return bytes(data)


# --- recipes at random ----------------------------------------------------------------------------

ODD = ["", "nan", "inf", "-1e999", "x", "1,5", "(1, 2", "()", "(nan, 1, 2)", "(1, 2, 3, 4)"]
ODD += ["0x10", "1e308", "1_000", " 1 ", "12:61:00", "2026-13-01T00:00:00", "23:59:59.9", "MANUAL"]
ODD += ["AUTO", "true", "None", "\x00", '"', "9" * 400, "٣", "-0"]
POSITIONS = ["robot_x", "robot_y", "reference_x", "reference_y", "path_error"]
OTHER = 'transforms[child_frame_id="b"].transform'
TOPICS = {
    "/tf": [
        f"{OTHER}.translation.x",
        f"yaw({OTHER}.rotation)",
        "transforms[0].transform.translation.y",
    ],
    "/joint_states": [
        'position[name="wheel_right"]',
        'position[name="wheel_left"]',
        "position[0]",
        "header.stamp.sec",
    ],
}
PATHS = [
    OTHER,
    f"{OTHER}.translation",
    'transforms[child_frame_id="c"].transform.translation.x',
    "transforms",
    "position",
    "position[1]",
    "name[0]",
    "effort[0]",
    "header.stamp",
    "x[0]",
    "[",
    'a[b="',
    "yaw(x)",
]

# What a key of a recipe may say, and what else some people write there.
FLAGS = [True, False]
NUMBERS = [1, -1, 0.5, 2.5]
LENGTH = {"unit": ["m", "mm"]}
REPEATS = {"repeated": ["first", "last", "mean"]}
METHODS = ["previous", "linear", "nearest"]
AXES = {"axes": [["x"], ["x", "y"]]}
ODD_NUMBERS = [0, -1, 7, 1e9, 1e-9, 1e300, 1e308, -1e308, 1e-320, 10**30, True, "x"]
ODD_WORDS = ["", "x", "none", "mm", "s", "deg", "furlong", "iso", "clock", "header", ";", ",", "{"]
ODD_WORDS += [
    "a.{kind}",
    "{a}{b}",
    "../head.index",
    ["z"],
    [],
    {},
    {"x": 1e308},
    {"trial": "kind"},
    0,
]
# Where a column comes from that is none of the log, and the column of modes.
CONSTANTS = [
    {"value": NUMBERS},
    {"from": ["participant", "block", "header.share"]},
    {"distance": [["robot", "reference"]], **AXES},
    {"travelled": ["robot"], **AXES},
]
OF_MODE = {
    "pedal": {"above": NUMBERS},
    "mode": {"map": [{"MANUAL": 1, "AUTO": 0, "1": 0.5, "0": 0}]},
}
ANY_COLUMN = {
    "scale": NUMBERS,
    "offset": NUMBERS,
    "above": NUMBERS,
    "map": [{"1": 0.5, "0": 2}],
    "unit": ["m"],
}
# Tables of a recipe, how often these keys are there, and what they say.
OF_BAGS = [
    ("time", 0.3, {"stamp": ["receive"], **REPEATS}),
    ("time", 0.2, {"topics": [{"/joint_states": "header"}]}),
]
OF_TABLES = [
    ("time", 0.6, {"from_zero": FLAGS, **REPEATS}),
    ("time", 0.15, {"sort": FLAGS}),
    ("time", 0.15, {"jumps": ["split"]}),
    ("time", 0.05, {"column": ["t", "pos"]}),
    ("table", 0.1, {"header": [True], "delimiter": [","], "decimal": ["."], "skip_lines": [0, 1]}),
    ("files", 0.3, {"pattern": ["a.{kind}", "read/a.{kind}"]}),
    ("header", 0.7, {"file": ["head.index"], "keys": [{"kind": "kind"}]}),
]
OF_BOTH = [
    ("resampling", 0.6, {"method": METHODS, "sample_time": [0.1, 0.03, 1.0, 1e-3]}),
    ("splitting", 0.4, {"gap": [0.15, 0.5, 5.0]}),
    (
        "metadata",
        0.3,
        {
            "participant": [{"value": 3}],
            "block": [
                {"from": "participant", "map": {"3": 1}},
                {"from": "participant", "map": {"1": "x"}, "default": 0},
            ],
        },
    ),
]


def one_of(rng, values):
    return values[int(rng.integers(len(values)))]


def toml(value):
    """Return a value as TOML: tables inline, all else as JSON writes it."""
    if isinstance(value, dict):
        inner = (f"{json.dumps(name)} = {toml(each)}" for name, each in value.items())
        return "{ " + ", ".join(inner) + " }"
    return json.dumps(value)


def mostly(rng, good):
    """Return one of the good values, and now and then an odd one."""
    value = one_of(rng, good)
    if rng.random() < 0.03:
        return one_of(rng, ODD_NUMBERS if isinstance(value, int | float) else ODD_WORDS)
    return value


def some(rng, share, keys):
    """Return some of the keys, each with one of its good values or an odd one."""
    return {name: mostly(rng, values) for name, values in keys.items() if rng.random() < share}


def random_column(rng, name, topics):
    """Return the rule of a column of a table, or of a bag with these topics."""
    length = some(rng, 0.98, LENGTH) if name in POSITIONS else {}
    if rng.random() < 0.16:
        rule = some(rng, 1, one_of(rng, CONSTANTS))
        return rule | length if "value" in rule else rule
    if topics:
        topic = mostly(rng, topics)
        paths = TOPICS.get(str(topic), PATHS)
        rule = {"topic": topic, "field": one_of(rng, PATHS if rng.random() < 0.03 else paths)}
        rule |= some(rng, 0.15, {"hold": FLAGS})
    else:
        own = ["mode", "pedal"] if name == "mode" else ["pedal", "speed", "err", "pos"]
        rule = {"column": mostly(rng, own)}
        rule |= some(rng, 0.6, {"blank": ["hold", "linear"]})
        if name == "mode":
            rule |= some(rng, 0.8, OF_MODE.get(str(rule["column"]), {}))
    rule |= length | some(rng, 0.05, ANY_COLUMN)
    return rule | some(rng, 0.1, {"absolute": FLAGS, "resample": METHODS})


def random_recipe(rng, topics, unit="s"):
    """Return a recipe put together at random; one in ten is damaged as a text."""
    names = rng.permutation(["mode", "p_r", "p_h", "r", "beta", *POSITIONS])[: rng.integers(1, 4)]
    tables = {"columns": {str(name): random_column(rng, name, topics) for name in names}}
    if not topics:
        tables["time"] = some(rng, 1, {"unit": [unit]})
    for title, chance, keys in (*(OF_BAGS if topics else OF_TABLES), *OF_BOTH):
        # Header tables are found by fields of paths.
        if rng.random() < chance and (title != "header" or "files" in tables):
            tables[title] = tables.get(title, {}) | some(rng, 0.97, keys)
    text = f'kind = "{"bag" if topics else "table"}"\n'
    text += "performance_window = 100\n" if rng.random() < 0.1 else ""
    for title, table in tables.items():
        keys = (f"{json.dumps(key)} = {toml(value)}\n" for key, value in table.items())
        text += f"[{title}]\n" + "".join(keys)
    return damaged(text.encode(), rng).decode(errors="replace") if rng.random() < 0.1 else text


def random_table(rng, unit):
    """
    Return a table with times that repeat, jump or turn back, blanks, and cells that somebody typed.
    """
    rows = int(rng.integers(1, 60))
    steps = np.full(rows, 0.1)
    if rng.random() < 0.4:
        steps = rng.choice([0.1, 0.11, 0.0, 7.0, -0.2], rows, p=[0.7, 0.1, 0.1, 0.08, 0.02])
    t = np.cumsum(steps)
    dates = pd.Timestamp("2026-03-01T23:59:57") + pd.to_timedelta(t, unit="s")
    times = {
        "s": t,
        "ms": 1000.0 * t,
        "iso": one_of(rng, [dates.astype(str), dates]),
        "clock": dates.strftime("%H:%M:%S.%f"),
    }
    frame = pd.DataFrame(rng.random((rows, 4)), columns=["pedal", "speed", "err", "pos"])
    frame.insert(0, "t", times[unit])
    frame["mode"] = rng.choice(one_of(rng, [[0, 1], ["MANUAL", "AUTO"]]), rows)
    frame.loc[frame["speed"] < 0.3, "speed"] = np.nan
    if rng.random() < 0.03:
        frame["err"] = one_of(rng, [rng.integers(-(2**60), 2**60, rows), frame["err"] < 0.5])
    if rng.random() < 0.3:
        frame = frame.astype(object)
        for _ in range(rng.integers(1, 4)):
            cell = one_of(rng, [*ODD, np.nan, None, 1e308])
            frame.iloc[rng.integers(rows), rng.integers(frame.shape[1])] = cell
    return frame


def random_file(rng, folder, unit):
    """Write a random table in one of the formats for tables."""
    frame, path = random_table(rng, unit), folder / f"a.{one_of(rng, FILES)}"
    if path.suffix == ".parquet":  # a column of theirs holds one type
        frame = frame.apply(lambda cells: cells.astype(str) if cells.dtype == object else cells)
    return write_table(frame, path)


def read_by_random_recipe(name, folder, bag, rng):
    """Write a recipe and something to read by it; return the sessions."""
    topics = [*TOPICS] if name == "bags" else []
    unit = one_of(rng, ["s", "s", "ms", "iso", "clock"])
    recipe = folder / "lab.toml"
    recipe.write_bytes(random_recipe(rng, topics, unit).encode())
    options = {"recipe": recipe}
    if rng.random() < 0.2:
        options |= {"resample": "linear", "sample_time": one_of(rng, [0.1, 0.1, 1e-7, 1e9])}
    if name == "bags":
        return [read_session(bag, **options)]
    if name == "frame":
        return [read_frame(random_table(rng, unit), **options)]
    path = random_file(rng, folder, unit)
    kinds = one_of(rng, [FILES, []]) if rng.random() < 0.03 else [path.name[2:]]
    head = folder / "head.index"
    head.write_text("\n".join(["kind,share", *(f"{kind},0.5" for kind in kinds), ""]))
    for file in (path, head):
        if rng.random() < 0.2:
            file.write_bytes(damaged(file.read_bytes(), rng))
    try:
        if name == "file":
            return [read_session(path, **options)]
        return list(read_sessions(folder, **options, on_error=one_of(rng, ["raise", "collect"])))
    finally:
        path.unlink()


def reading(name, folder):
    """
    Return what writes something damaged and reads it: a log of the format, or one by a recipe at
    random.
    """
    files = originals(folder)
    path, file = files.get(name, files["bags"])
    data = file.read_bytes()
    (folder / "read").mkdir()

    def read(rng):
        if name not in READS:
            file.write_bytes(damaged(data, rng))
            return [read_session(path)]
        file.write_bytes(damaged(data, rng) if rng.random() < 0.2 else data)
        return read_by_random_recipe(name, folder / "read", path, rng)

    return read


def readable(read):
    """Return whether there are sessions; they are valid, or the error is ours and printable."""
    try:
        sessions = read()
    except SessionError as error:
        assert 0 < len(str(error).encode()) < 3000  # noqa: PT017
        return False
    for each in sessions:
        assert len(each.t) >= 2
        assert np.isfinite(each.data.to_numpy()).all()
        assert (np.diff(each.t) > 0).all()
    return len(sessions) > 0


def fuzz(name, seeds):
    """Read damaged logs of one format; return how many were read, and what failed at which seed."""
    good, failures = 0, []
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = reading(name, Path(folder))
        for seed in seeds:
            begun = time.process_time()
            try:
                good += readable(partial(read, np.random.default_rng([seed, len(name)])))
                seconds = time.process_time() - begun
                assert seconds < MOST_SECONDS, f"took {seconds:.1f} s"
            except BaseException:
                failures.append(f"{name}, seed {seed}: {traceback.format_exc(limit=-6)}")
    return good, failures
