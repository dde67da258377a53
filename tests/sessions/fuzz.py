"""
Damage logs of every format at random and read them: only our errors may come out, soon, and in little memory.

Times are the processor's, so that a busy machine does not make a log look slow.

Run it by hand: `python tests/sessions/fuzz.py --logs 100000 --seed 0`. Each format has a process of its own, one after
the other; what fails is printed with its seed, and `--only FORMAT --first SEED --logs 1` repeats it.
"""

import argparse
import gzip
import logging
import multiprocessing
import resource
import struct
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy import io

from trustlab.sessions import Metadata, Session, SessionError, read_session, write_session
from trustlab.sessions.recipe import Recipe

MOST_SECONDS, MOST_BYTES = 5.0, 2 * 2**30


def session() -> Session:
    t = np.arange(40) * 0.1
    data = pd.DataFrame({"mode": (t > 1.5) * 1.0, "p_r": 0.3 + 0.01 * np.sin(t), "robot_x": -t}, index=t)
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
[columns]
robot_x = { topic = "/tf", field = 'transforms[child_frame_id="b"].transform.translation.x', unit = "m" }
""")


POSE, ARM = (
    Recipe.from_toml(f'kind = "bag"\n[columns]\np_r = {{ topic = "{topic}", field = "x" }}')
    for topic in ("pose", "arm")
)
RECIPES = {"rules": RULES, "tf": TF, "ulg": POSE, "xdf": ARM}


def transforms(path: Path) -> Path:
    """Write a bag in which two robots publish their places in turn."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    of = lambda kind, **fields: store.types[kind](**fields)  # noqa: E731
    with Writer(path, version=8) as writer:
        topic = writer.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store)
        for k in range(40):
            stamp = of("builtin_interfaces/msg/Time", sec=k, nanosec=0)
            transform = of(
                "geometry_msgs/msg/Transform",
                translation=of("geometry_msgs/msg/Vector3", x=0.1 * k, y=0.0, z=0.0),
                rotation=of("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            )
            stamped = of(
                "geometry_msgs/msg/TransformStamped",
                header=of("std_msgs/msg/Header", stamp=stamp, frame_id="map"),
                child_frame_id="ab"[k % 2],
                transform=transform,
            )
            message = of("tf2_msgs/msg/TFMessage", transforms=[stamped])
            writer.write(topic, k * 10**9, store.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))
    return path


def write_ulog(path: Path, times, values) -> Path:
    """Write the smallest ULog file: one topic, `pose`, with one field, `x` (format: docs.px4.io, ULog File Format)."""

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    data += message("F", b"pose:uint64_t timestamp;float x;") + message("A", struct.pack("<BH", 0, 0) + b"pose")
    for t, value in zip(times, values, strict=True):
        data += message("D", struct.pack("<HQf", 0, round(t * 1e6), value))
    path.write_bytes(data)
    return path


def write_xdf(path: Path, times, values) -> Path:
    """Write the smallest XDF file: one stream, `arm`, with one channel, `x` (format: github.com/sccn/xdf, Specifications)."""

    def chunk(tag: int, content: bytes) -> bytes:
        return b"\x04" + struct.pack("<IH", len(content) + 2, tag) + content

    stream = struct.pack("<I", 1)
    about = "<name>arm</name><type>x</type><channel_count>1</channel_count><nominal_srate>0</nominal_srate>"
    about += "<channel_format>double64</channel_format>"
    about += "<desc><channels><channel><label>x</label></channel></channels></desc>"
    samples = [b"\x08" + struct.pack("<dd", t, value) for t, value in zip(times, values, strict=True)]
    data = b"XDF:" + chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>")
    data += chunk(2, stream + f"<?xml version='1.0'?><info>{about}</info>".encode())
    data += chunk(3, stream + b"\x04" + struct.pack("<I", len(samples)) + b"".join(samples))
    data += chunk(6, stream + b"<?xml version='1.0'?><info><first_timestamp>0</first_timestamp></info>")
    path.write_bytes(data)
    return path


def originals(folder: Path) -> dict[str, tuple[Path, Path]]:
    """Write a valid log of each format; return what is read, and the file of it that is damaged."""
    paths = {name: write_session(session(), folder / f"a.{name}") for name in ("csv", "parquet", "bag", "mcap")}
    files = {name: (path, path) for name, path in paths.items()}
    table = session().table()
    table.to_feather(folder / "a.feather")
    table.to_csv(folder / "a.tsv", sep="\t", index=False)
    (folder / "a.csv.gz").write_bytes(gzip.compress(table.to_csv(index=False).encode()))
    files |= {name: (folder / f"a.{name}", folder / f"a.{name}") for name in ("feather", "tsv", "csv.gz")}
    recording = write_session(session(), folder / "recording")
    files["db3"] = (recording, next(recording.glob("*.db3")))
    yaml = write_session(session(), folder / "yaml")
    files["yaml"] = (yaml, yaml / "metadata.yaml")
    dates = pd.Timestamp("2026-03-01") + pd.to_timedelta(table["t"], unit="s")
    cells = [f"({x}, 0, 1)" for x in table["robot_x"]]
    ruled = table.assign(t=dates.astype(str), pos=cells, p_r=table["p_r"].where(table.index % 3 == 0))
    ruled.to_csv(folder / "rules.csv", index=False)
    files["rules"] = (folder / "rules.csv", folder / "rules.csv")
    robots = transforms(folder / "robots")
    files["tf"] = (robots, next(robots.glob("*.db3")))
    columns = {name: table[name].to_numpy() for name in table}
    io.savemat(folder / "a.mat", columns, do_compression=True)
    with h5py.File(folder / "a.h5", "w") as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values, compression="gzip")
    write_ulog(folder / "a.ulg", table["t"], table["p_r"])
    write_xdf(folder / "a.xdf", table["t"], table["p_r"])
    files |= {name: (folder / f"a.{name}", folder / f"a.{name}") for name in ("mat", "h5", "ulg", "xdf")}
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
            data[at : at + 8] = rng.choice([b"\xff" * 8, b"\x00" * 7 + b"\x7f", b"\xff\xff\xff\x7f", b"-1e999,"])
        elif kind == 6:
            data[at:at] = data[at:to]
        else:
            data[at : at + 4] = int(rng.integers(2**32)).to_bytes(4, "little")
        data = data or bytearray(b"?")
    return bytes(data)


def fuzz_alone(name: str, first: int, logs: int, failures) -> None:
    """Fuzz in a process of its own, in which too much memory is a MemoryError and not the end of the machine."""
    logging.disable()  # libraries report what they find damaged
    resource.setrlimit(resource.RLIMIT_AS, (3 * MOST_BYTES, resource.RLIM_INFINITY))
    fuzz(name, first, logs, failures)
    memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if memory > MOST_BYTES:
        failures.put((name, first, f"took {memory / 1e9:.2f} GB"))
    print(f"{name}: at most {memory / 1e6:.0f} MB", flush=True)


def fuzz(name: str, first: int, logs: int, failures) -> None:
    """Read damaged logs of one format, and put what fails into the queue."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path, file = originals(Path(folder))[name]
        options = {name: {"recipe": recipe} for name, recipe in RECIPES.items()}.get(name, {})
        options |= {"columns": ["p_r", "mode"]} if name in ("mat", "h5") else {}
        data = file.read_bytes()
        slowest = 0.0
        for seed in range(first, first + logs):
            file.write_bytes(damaged(data, np.random.default_rng([seed, len(name)])))
            begun = time.process_time()
            try:
                read = read_session(path, **options)
                assert np.isfinite(read.data.to_numpy()).all()
            except SessionError as error:
                assert len(str(error)) < 3000  # noqa: PT017
            except BaseException:
                failures.put((name, seed, traceback.format_exc(limit=-6)))
            slowest = max(slowest, time.process_time() - begun)
            if time.process_time() - begun > MOST_SECONDS:
                failures.put((name, seed, f"took {time.process_time() - begun:.1f} s"))
        print(f"{name}: {logs} logs, the slowest {slowest:.2f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        names = [arguments.only] if arguments.only else list(originals(Path(folder)))
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
