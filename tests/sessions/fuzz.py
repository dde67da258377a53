"""
Damage logs of every format at random and read them: only our errors may come out, soon, and in
little memory.

Times are the processor's, so that a busy machine does not make a log look slow.

Run it by hand: `python -m tests.sessions.fuzz --logs 100000`. Each format has a process of its own,
one after the other; what fails is printed with its seed, and `--only FORMAT --first SEED --logs 1`
repeats it. With `--section recipes` it is what recipes say that is damaged, and the cells of the
tables that they read: rules of every kind put together at random, selectors, splitting at gaps,
sorting, data frames, folders.
"""

import argparse
import gzip
import json
import logging
import multiprocessing
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from tests.sessions.logs import HAND, NUMBER, TEXT, Bag, hands, stamped
from trustlab.sessions import (
    Metadata,
    Session,
    SessionError,
    read_frame,
    read_session,
    read_sessions,
    write_session,
)
from trustlab.sessions.recipe import Recipe

MOST_SECONDS, MOST_BYTES = 5.0, 2**30


def session() -> Session:
    t = np.arange(40) * 0.1
    data = pd.DataFrame(
        {"mode": (t > 1.5) * 1.0, "p_r": 0.3 + 0.01 * np.sin(t), "robot_x": -t}, index=t
    )
    return Session(data, Metadata(participant=3, condition="C1", more={"trial": 2}))


RULES = Recipe.from_toml("""
kind = "table"
[time]
unit = "iso"
from_zero = true
repeated = "mean"
[splitting]
gap = 5.0
[columns]
p_r = { column = "p_r", blank = "hold" }
robot_x = { column = "pos", item = 0, unit = "m" }
mode = { column = "mode", above = 0.5 }
""")
TF = Recipe.from_toml("""
kind = "bag"
[columns.robot_x]
topic = "/tf"
field = 'transforms[child_frame_id="b"].transform.translation.x'
unit = "m"
""")


FILES = ["csv", "tsv", "txt", "csv.gz", "parquet", "feather"]
RECIPES = {"rules": RULES, "tf": TF}


def recording(path: Path) -> Path:
    """Write the session as a bag of ours, in the formats that `write_session` does not write."""
    bag = Bag(path)
    facts = {"participant": 3, "condition": "C1", "more": {"trial": 2}, "samples": 40}
    bag.add("/trustlab/metadata", 0, TEXT, data=json.dumps(facts))
    for name, values in session().table().items():
        for k, value in enumerate(values):
            bag.add(f"/trustlab/{name}", 0.1 * k, NUMBER, data=value)
    return bag.write()


def transforms(path: Path) -> Path:
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


def originals(folder: Path) -> dict[str, tuple[Path, Path]]:
    """Write a valid log of each format; return what is read, and the file of it that is damaged."""
    paths = {
        name: write_session(session(), folder / f"a.{name}") for name in ("csv", "parquet", "mcap")
    }
    paths["bag"] = recording(folder / "a.bag")
    files = {name: (path, path) for name, path in paths.items()}
    table = session().table()
    table.to_feather(folder / "a.feather")
    table.to_csv(folder / "a.tsv", sep="\t", index=False)
    (folder / "a.csv.gz").write_bytes(gzip.compress(table.to_csv(index=False).encode()))
    files |= {
        name: (folder / f"a.{name}", folder / f"a.{name}") for name in ("feather", "tsv", "csv.gz")
    }
    database = recording(folder / "recording")
    files["db3"] = (database, next(database.glob("*.db3")))
    yaml = recording(folder / "yaml")
    files["yaml"] = (yaml, yaml / "metadata.yaml")
    dates = pd.Timestamp("2026-03-01") + pd.to_timedelta(table["t"], unit="s")
    cells = [f"({x}, 0, 1)" for x in table["robot_x"]]
    ruled = table.assign(
        t=dates.astype(str), pos=cells, p_r=table["p_r"].where(table.index % 3 == 0)
    )
    ruled.to_csv(folder / "rules.csv", index=False)
    files["rules"] = (folder / "rules.csv", folder / "rules.csv")
    robots = transforms(folder / "robots")
    files["tf"] = (robots, next(robots.glob("*.db3")))
    return files


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with one to four faults of the kinds that disks, programs and people make."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(data) + 1))
        to = min(at + 1 + int(rng.exponential(0.05 * len(data) + 1)), len(data))
        kind = rng.integers(8)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del data[at:]
        elif kind == 2:
            data[at:at] = rng.bytes(int(rng.integers(1, 24)))
        elif kind == 3:
            del data[at:to]
        elif kind == 4:
            data[at:to] = bytes(to - at)
        elif kind == 5:
            data[at : at + 8] = rng.choice(
                [b"\xff" * 8, b"\x00" * 7 + b"\x7f", b"\xff\xff\xff\x7f", b"-1e999,"]
            )
        elif kind == 6:
            data[at:at] = data[at:to]
        else:
            data[at : at + 4] = int(rng.integers(2**32)).to_bytes(4, "little")
        data = data or bytearray(b"?")
    return bytes(data)


# --- recipes at random ----------------------------------------------------------------------------

ODD = [
    "",
    "nan",
    "inf",
    "-1e999",
    "x",
    "1,5",
    "(1, 2",
    "()",
    "(nan, 1, 2)",
    "(1, 2, 3, 4)",
    "0x10",
    "1e308",
    "1_000",
    " 1 ",
]
ODD += [
    "12:61:00",
    "2026-13-01T00:00:00",
    "23:59:59.9",
    "MANUAL",
    "AUTO",
    "true",
    "None",
    "\x00",
    '"',
    "9" * 400,
    "٣",
    "-0",
]
UNITS = ["mm", "s", "us", "%", "deg", "N", "furlong", ""]
POSITIONS = ["robot_x", "robot_y", "reference_x", "reference_y", "path_error"]
CELLS = ["t", "mode", "pedal", "speed", "err", "pos", "who"]
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
    "/hand": ["grip", "header.stamp.nanosec"],
}
PATHS = [
    OTHER,
    f"{OTHER}.translation",
    "position[1]",
    "name[0]",
    "effort[0]",
    "x[0]",
    "[",
    'a[b="',
    "yaw(x)",
]
PATHS += [
    'transforms[child_frame_id="c"].transform.translation.x',
    "header.stamp",
    "position",
    "transforms",
]


def one_of(rng: np.random.Generator, values):
    return values[int(rng.integers(len(values)))]


def toml(value) -> str:
    """Return a value as TOML: tables inline, all else as JSON writes it."""
    if isinstance(value, dict):
        return (
            "{ "
            + ", ".join(f"{json.dumps(str(name))} = {toml(each)}" for name, each in value.items())
            + " }"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


def mostly(rng: np.random.Generator, good, odd):
    """Return one of the good values, and now and then an odd one."""
    return one_of(rng, odd if rng.random() < 0.03 else good)


def some(rng: np.random.Generator, share: float, **keys) -> dict:
    """Return some of the keys, each with one of its good or odd values."""
    return {name: mostly(rng, *values) for name, values in keys.items() if rng.random() < share}


def random_column(rng: np.random.Generator, name: str, topics: list[str]) -> dict:
    """Return the rule of a column of a table, or of a bag with these topics."""
    numbers = [1, -1, 0.5, 2.5], [0, 1e308, -1e308, 1e-320, 10**30, "x", True]
    kind = rng.random()
    if kind < 0.06:
        return {"value": mostly(rng, *numbers)} | ({"unit": "m"} if name in POSITIONS else {})
    if kind < 0.10:
        return {
            "from": mostly(
                rng, ["participant", "block", "header.share"], ["trial", "kind", "start_time"]
            )
        }
    if kind < 0.16:
        way, stems = one_of(rng, [("distance", ["robot", "reference"]), ("travelled", "robot")])
        return {way: stems, "axes": mostly(rng, [["x"], ["x", "y"]], [["z"], []])}
    if topics:
        topic = mostly(rng, topics, ["/none", "/tf"])
        rule = {"topic": topic, "field": mostly(rng, TOPICS.get(topic, PATHS), PATHS)}
        rule |= some(rng, 0.15, hold=([True, False], ["x"]))
    else:
        own = {"mode": ["mode", "pedal"]}.get(name, ["pedal", "speed", "err", "pos"])
        rule = {"column": mostly(rng, own, [*CELLS, 0, 3, 99])}
        rule |= {"item": mostly(rng, [0, 1, 2], [7, -1])} if rule["column"] == "pos" else {}
        rule |= {"blank": mostly(rng, ["hold", "linear"], ["drop"])} if rng.random() < 0.6 else {}
        rule |= (
            {"above": mostly(rng, *numbers)} if rule["column"] == "pedal" and name == "mode" else {}
        )
        rule |= (
            {"map": {"MANUAL": 1, "AUTO": 0, "1": 0.5}}
            if rule["column"] == "mode" and rng.random() < 0.4
            else {}
        )
    rule |= (
        {"unit": mostly(rng, ["m", "mm"], UNITS)}
        if name in POSITIONS and rng.random() < 0.98
        else {}
    )
    maps = [{"1": 0.5, "0": 2}], [{"x": 1e308}, {}]
    rule |= some(
        rng, 0.05, scale=numbers, offset=numbers, above=numbers, map=maps, unit=(["m"], UNITS)
    )
    return rule | some(
        rng,
        0.1,
        absolute=([True, False], [0]),
        resample=(["previous", "linear", "nearest"], ["cubic"]),
    )


def random_recipe(rng: np.random.Generator, topics: list[str], unit: str = "s") -> str:
    """Return a recipe put together at random; one in ten is damaged as a text."""
    names = ["mode", "p_r", "p_h", "r", "beta", *POSITIONS]
    names = [str(name) for name in rng.permutation(names)[: rng.integers(1, 4)]]
    tables = {"columns": {name: random_column(rng, name, topics) for name in names}}
    repeats = ["first", "last", "mean"], ["median"]
    if topics:
        tables["time"] = some(rng, 0.3, stamp=(["receive"], ["header", "x"]), repeated=repeats)
        tables["time"] |= {"topics": {"/joint_states": "header"}} if rng.random() < 0.2 else {}
    else:
        tables["time"] = {"unit": mostly(rng, [unit], ["m", "us", "s", "iso", "clock"])}
        tables["time"] |= some(rng, 0.6, from_zero=([True, False], [1]), repeated=repeats)
        order = {"sort": ([True, False], ["x"]), "jumps": (["split"], ["drop"])}
        tables["time"] |= some(rng, 0.15, **order)
        tables["time"] |= some(rng, 0.05, column=(["t"], ["pos", 0, 99]))
        styles = {
            "header": ([True], [False]),
            "delimiter": ([","], [";", "x"]),
            "decimal": (["."], [","]),
        }
        tables["table"] = some(rng, 0.1, **styles, skip_lines=([0], [1, 7, 10**6]))
    if rng.random() < 0.6:
        steps = mostly(rng, [0.1, 0.03, 1.0, 1e-3], [1e-9, 1e9, 0, "x"])
        tables["resampling"] = {
            "method": one_of(rng, ["previous", "linear", "nearest"]),
            "sample_time": steps,
        }
    tables["splitting"] = (
        some(rng, 0.97, gap=([0.15, 0.5, 5.0], [1e-9, 1e300, 0, -1]))
        if rng.random() < 0.4
        else None
    )
    if topics:
        wanted = 0.95 if topics == ["/hand"] else 0.05
        tables["messages"] = (
            {"folder": mostly(rng, ["."], ["none", ".."])} if rng.random() < wanted else None
        )
    elif rng.random() < 0.3:
        tables["files"] = {
            "pattern": mostly(
                rng, ["a.{kind}", "read/a.{kind}"], ["*", "{kind:int}.csv", "{", "{a}{b}"]
            )
        }
        tables["header"] = some(
            rng, 0.97, file=(["head.index"], ["../head.index", "none.csv", "a.{kind}", "{x}"])
        )
        tables["header"] |= some(
            rng, 0.97, keys=([{"kind": "kind"}], [{"kind": "share"}, {"trial": "kind"}, {}])
        )
        tables["header"] = tables["header"] if rng.random() < 0.7 else None
    if rng.random() < 0.3:
        origin = {"from": (["participant"], ["trial", "none"])}
        tables["metadata"] = {
            "participant": some(rng, 0.95, value=([3], [True, 1e308, "x"])),
            "block": some(rng, 0.95, **origin, map=([{"3": 1}], [{"1": "x"}, {}]))
            | some(rng, 0.03, default=([0], ["x"])),
        }
    text = f'kind = "{"bag" if topics else "table"}"\n' + "performance_window = 100\n" * int(
        rng.random() < 0.1
    )
    for title, table in tables.items():
        if table is not None:
            text += f"[{title}]\n" + "".join(
                f"{json.dumps(key)} = {toml(value)}\n" for key, value in table.items()
            )
    return damaged(text.encode(), rng).decode(errors="replace") if rng.random() < 0.1 else text


def random_table(rng: np.random.Generator, unit: str) -> pd.DataFrame:
    """
    Return a table with times that repeat, jump or turn back, blanks, and cells that somebody typed.
    """
    rows = int(rng.integers(1, 60))
    steps = np.full(rows, 0.1)
    if rng.random() < 0.4:
        steps = rng.choice([0.1, 0.11, 0.0, 7.0, -0.2], rows, p=[0.7, 0.1, 0.1, 0.08, 0.02])
    t = np.cumsum(steps)
    dates = pd.Timestamp("2026-03-01T23:59:57") + pd.to_timedelta(t, unit="s")
    frame = pd.DataFrame(
        {
            "t": {
                "s": t,
                "ms": 1000.0 * t,
                "iso": one_of(rng, [dates.astype(str), dates]),
                "clock": dates.strftime("%H:%M:%S.%f"),
            }[unit],
            "mode": one_of(rng, [rng.integers(0, 2, rows), rng.choice(["MANUAL", "AUTO"], rows)]),
            "pedal": rng.random(rows),
            "speed": np.where(rng.random(rows) < 0.3, np.nan, rng.random(rows)),
            "err": mostly(
                rng,
                [rng.random(rows)],
                [rng.integers(-(2**60), 2**60, rows), rng.random(rows) < 0.5],
            ),
            "pos": [f"({x:.3f}, {y:.3f}, 0)" for x, y in rng.random((rows, 2))],
            "who": "a",
        }
    )
    if rng.random() < 0.3:
        frame = frame.astype(object)
        for _ in range(rng.integers(1, 4)):
            frame.iloc[int(rng.integers(rows)), int(rng.integers(len(CELLS)))] = one_of(
                rng, [*ODD, np.nan, None, 1e308]
            )
    return frame


def random_file(rng: np.random.Generator, folder: Path, unit: str) -> Path:
    """Write a random table in one of the formats for tables."""
    frame = random_table(rng, unit)
    kind = one_of(rng, FILES)
    path = folder / f"a.{kind}"
    if kind in ("csv", "tsv", "txt", "csv.gz"):
        text = frame.to_csv(index=False, sep="\t" if kind == "tsv" else ",").encode()
        path.write_bytes(gzip.compress(text) if kind == "csv.gz" else text)
        return path
    texts = frame.apply(lambda cells: cells.astype(str) if cells.dtype == object else cells)
    getattr(texts, f"to_{kind}")(path)
    return path


def read_by_random_recipe(
    name: str, folder: Path, bags: list[tuple[Path, list[str]]], rng: np.random.Generator
) -> list[Session]:
    """Write a recipe and something to read by it; return the sessions."""
    recipe = folder / "lab.toml"
    bag, topics = one_of(rng, bags) if name == "bags" else ("", [])
    unit = one_of(rng, ["s", "s", "ms", "iso", "clock"])
    recipe.write_bytes(random_recipe(rng, topics, unit).encode())
    options = {"recipe": recipe} | (
        {"resample": "linear", "sample_time": mostly(rng, [0.1], [1e-7, 1e9])}
        if rng.random() < 0.2
        else {}
    )
    if name == "bags":
        definition = damaged(HAND.encode(), rng) if rng.random() < 0.3 else HAND.encode()
        (folder / "lab_msgs" / "Hand.msg").write_bytes(definition)
        return [read_session(bag, **options)]
    if name == "frame":
        return [read_frame(random_table(rng, unit), **options)]
    path = random_file(rng, folder, unit)
    header = "kind,share\n" + "".join(
        f"{kind},0.5\n" for kind in mostly(rng, [[path.name[2:]]], [FILES, []])
    )
    head = damaged(header.encode(), rng) if rng.random() < 0.2 else header.encode()
    (folder / "head.index").write_bytes(head)
    try:
        if name == "file":
            return [read_session(path, **options)]
        return list(read_sessions(folder, **options, on_error=one_of(rng, ["raise", "collect"])))
    finally:
        path.unlink()


READS = ("file", "frame", "folder", "bags")


def fuzz_alone(name: str, first: int, logs: int, failures) -> None:
    """
    Fuzz in a process of its own, in which too much memory is a MemoryError and not the end of the
    machine.
    """
    logging.disable()  # libraries report what they find damaged
    resource.setrlimit(resource.RLIMIT_AS, (6 * MOST_BYTES, resource.RLIM_INFINITY))
    fuzz(name, first, logs, failures)
    memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if memory > MOST_BYTES:
        failures.put((name, first, f"took {memory / 1e9:.2f} GB"))
    print(f"{name}: at most {memory / 1e6:.0f} MB", flush=True)


def reading(name: str, folder: Path) -> Callable[[np.random.Generator], list[Session]]:
    """
    Return what writes something damaged and reads it: a log of the format, or one by a recipe at
    random.
    """
    files = originals(folder)
    if name in READS:
        (folder / "read" / "lab_msgs").mkdir(parents=True)
        bags = [
            (files["tf"][0], ["/tf", "/joint_states"]),
            (hands(folder / "hand"), ["/hand"]),
        ]
        return partial(read_by_random_recipe, name, folder / "read", bags)
    path, file = files[name]
    options = {"recipe": RECIPES[name]} if name in RECIPES else {}
    data = file.read_bytes()

    def read(rng: np.random.Generator) -> list[Session]:
        file.write_bytes(damaged(data, rng))
        return [read_session(path, **options)]

    return read


def readable(read: Callable[[], list[Session]]) -> bool:
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


def fuzz(name: str, first: int, logs: int, failures) -> int:
    """
    Read damaged logs of one format, and put what fails into the queue; return how many were read.
    """
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = reading(name, Path(folder))
        slowest, good = 0.0, 0
        for seed in range(first, first + logs):
            begun = time.process_time()
            try:
                good += readable(partial(read, np.random.default_rng([seed, len(name)])))
            except BaseException:
                failures.put((name, seed, traceback.format_exc(limit=-6)))
            slowest = max(slowest, time.process_time() - begun)
            if time.process_time() - begun > MOST_SECONDS:
                failures.put((name, seed, f"took {time.process_time() - begun:.1f} s"))
        print(f"{name}: {logs} logs, {good} of them read, the slowest {slowest:.2f} s", flush=True)
    return good


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--section", choices=["logs", "recipes"], default="logs")
    parser.add_argument("--only")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        every = READS if arguments.section == "recipes" else list(originals(Path(folder)))
        names = [arguments.only] if arguments.only else every
    failures: multiprocessing.Queue = multiprocessing.get_context("spawn").Queue()
    found = []
    for name in names:
        count = -(-arguments.logs // len(names))
        worker = multiprocessing.get_context("spawn").Process(
            target=fuzz_alone, args=(name, arguments.first, count, failures)
        )
        worker.start()
        while worker.is_alive() or not failures.empty():
            try:
                found.append(failures.get(timeout=0.5))
                print("FAILED", *found[-1], sep="\n", flush=True)
            except Exception:
                continue
        if worker.exitcode:
            found.append((name, "the process ended", worker.exitcode))
            print("FAILED", *found[-1], flush=True)
    print(f"{len(found)} failures")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
