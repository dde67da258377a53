"""
Damage logs of every format at random and read them: only our errors may come out, soon, and in little memory.

Run it by hand: `python tests/sessions/fuzz.py --logs 100000 --seed 0`. Each format has a process of its own, one after
the other; what fails is printed with its seed, and `--only FORMAT --first SEED --logs 1` repeats it.
"""

import argparse
import gzip
import multiprocessing
import resource
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

from trustlab.sessions import Metadata, Session, SessionError, read_session, write_session

MOST_SECONDS, MOST_BYTES = 5.0, 2 * 2**30


def session() -> Session:
    t = np.arange(40) * 0.1
    data = pd.DataFrame({"mode": (t > 1.5) * 1.0, "p_r": 0.3 + 0.01 * np.sin(t), "robot_x": -t}, index=t)
    return Session(data, Metadata(participant=3, condition="C1", more={"trial": 2}))


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


def fuzz(name: str, first: int, logs: int, failures) -> None:
    """Read damaged logs of one format, and put what fails into the queue."""
    resource.setrlimit(resource.RLIMIT_AS, (3 * MOST_BYTES, resource.RLIM_INFINITY))
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path, file = originals(Path(folder))[name]
        data = file.read_bytes()
        slowest = 0.0
        for seed in range(first, first + logs):
            file.write_bytes(damaged(data, np.random.default_rng([seed, len(name)])))
            begun = time.perf_counter()
            try:
                read = read_session(path)
                assert np.isfinite(read.data.to_numpy()).all()
            except SessionError as error:
                assert len(str(error)) < 3000  # noqa: PT017
            except BaseException:
                failures.put((name, seed, traceback.format_exc(limit=-6)))
            slowest = max(slowest, time.perf_counter() - begun)
            if time.perf_counter() - begun > MOST_SECONDS:
                failures.put((name, seed, f"took {time.perf_counter() - begun:.1f} s"))
        memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if memory > MOST_BYTES:
            failures.put((name, first, f"took {memory / 1e9:.2f} GB"))
        print(f"{name}: {logs} logs, the slowest {slowest:.2f} s, at most {memory / 1e6:.0f} MB", flush=True)


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
            target=fuzz, args=(name, arguments.first, count, failures)
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
