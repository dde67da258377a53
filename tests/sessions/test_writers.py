"""What is written is whole or not there, whatever happens; what was damaged since is noticed."""

import itertools
import json
import multiprocessing
import os
import resource
import shutil
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import feather
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from trustlab.sessions import (
    Metadata,
    Session,
    SessionError,
    read_session,
    read_sessions,
    write_session,
)
from trustlab.sessions.recipe import Recipe

NAMES = ["a.csv", "a.parquet", "a.bag", "a.mcap", "a"]


def session(value=0.5, samples=50) -> Session:
    t = np.arange(samples) * 0.1
    return Session(
        pd.DataFrame({"p_r": value + 0.0 * t, "robot_x": np.sin(t)}, index=t),
        Metadata(condition=value),
    )


def write_for_ever(folder: Path, begun):
    """Write every format over itself, again and again."""
    for k in range(10**6):
        for name in NAMES:
            write_session(session(float(k)), folder / name)
            begun.set()


@pytest.fixture(scope="module")
def processes():
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["trustlab.sessions.writers", "pyarrow.parquet", "rosbags.highlevel", "apsw"]
    )
    return context


def left_by_a_killed_writer(folder):
    """
    All that is there reads and is overwritten, and what was half made has a name that no reader
    takes; return how much of it there is.
    """
    half_made = len(list(folder.glob(".trustlab-*"))) + len(list(folder.glob("*.partial-*")))
    for name in NAMES:
        if (folder / name).exists():
            read = read_session(folder / name)
            assert read == session(read.metadata.condition)
        assert read_session(write_session(session(), folder / name)) == session()
    there = {path.name for path in folder.iterdir() if ".partial-" not in path.name}
    assert {name for name in there if not name.startswith(".trustlab-")} == set(NAMES)
    assert len(list((folder / "a").iterdir())) == 2
    return half_made


def killed_before(folder, step, name):
    """Write every format over what is there, and be killed before a step that shows a new file."""
    steps = itertools.count()
    call = getattr(os, name)

    def watched(*args):
        if next(steps) == step:
            os.kill(os.getpid(), signal.SIGKILL)
        return call(*args)

    setattr(os, name, watched)
    write_for_ever(folder, threading.Event())


@pytest.mark.parametrize(("name", "steps"), [("replace", 6), ("fsync", 2)])
def test_writers_killed_at_every_step(tmp_path, processes, name, steps):
    for file in NAMES:
        write_session(session(), tmp_path / file)
    for step in range(steps):
        writer = processes.Process(target=killed_before, args=(tmp_path, step, name), daemon=True)
        writer.start()
        writer.join()
        assert writer.exitcode == -signal.SIGKILL
        assert left_by_a_killed_writer(tmp_path) == step + 1


@pytest.mark.long
def test_a_hundred_killed_writers(tmp_path, processes):
    """At random moments."""
    rng = np.random.default_rng(1)
    half_made = 0
    for _ in range(100):
        begun = processes.Event()
        writer = processes.Process(target=write_for_ever, args=(tmp_path, begun), daemon=True)
        writer.start()
        assert begun.wait(60)
        time.sleep(rng.uniform(0.0, 0.2))
        writer.kill()
        writer.join()
        half_made += left_by_a_killed_writer(tmp_path)
    assert half_made > 0


def test_a_recording_is_replaced_in_one_step(tmp_path, monkeypatch):
    """At every step between the two recordings, a kill leaves one of them."""
    path = write_session(session(1.0), tmp_path / "a")
    replace, seen = os.replace, []

    def watched(*args):
        replace(*args)
        seen.append(
            read_session(shutil.copytree(path, tmp_path / f"copy{len(seen)}")).metadata.condition
        )

    monkeypatch.setattr("trustlab.sessions.writers.os.replace", watched)
    write_session(session(2.0), path)
    assert seen == sorted(seen)
    assert set(seen) == {1.0, 2.0}
    assert read_session(path) == session(2.0)


def test_files_being_written_are_no_sessions(tmp_path):
    (tmp_path / ".trustlab-host-1-x").mkdir()
    write_session(session(), tmp_path / ".trustlab-host-1-x" / "run1.csv")
    write_session(session(), tmp_path / "run2.csv")
    (tmp_path / "run3.csv.partial-1").write_text("t,p_r\n0,")
    recipe = Recipe.from_toml(
        'kind = "table"\n[files]\npattern = "run{k:int}.csv*"\n[time]\nunit = '
        '"s"\n[columns]\np_r = {column = "p_r"}'
    )
    assert [each.metadata.source for each in read_sessions(tmp_path, recipe=recipe)] == [
        str(tmp_path / "run2.csv")
    ]


@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_is_a_sentence(tmp_path, name):
    write_session(session(0.1), tmp_path / name)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, limits[1]))
        with pytest.raises(SessionError, match="cannot be written"):
            write_session(session(samples=3000), tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert read_session(tmp_path / name) == session(0.1)


def test_symlink_loops(tmp_path):
    write_session(session(), tmp_path / "run1.csv")
    (tmp_path / "loop").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "run2.csv").symlink_to(tmp_path / "run2.csv")
    with pytest.raises(SessionError, match=r"run2\.csv: there is no such file"):
        read_session(tmp_path / "run2.csv")
    recipe = Recipe.from_toml(
        'kind = "table"\n[files]\npattern = "run{k:int}.csv"\n[time]\nunit = '
        '"s"\n[columns]\np_r = {column = "p_r"}'
    )
    with pytest.raises(SessionError, match=r"run2\.csv: there is no such file"):
        read_sessions(tmp_path, recipe=recipe)
    (tmp_path / "run2.csv").unlink()
    assert len(read_sessions(tmp_path, recipe=recipe)) == 1


@pytest.mark.parametrize("name", NAMES)
def test_every_flipped_bit_is_noticed(tmp_path, name):
    """
    Whatever bit is flipped, the file reads as it was or is refused; without the digests, other
    numbers are read.
    """
    path = write_session(session(samples=40), tmp_path / name)
    file = next(path.glob("*.db3")) if path.is_dir() else path
    data = file.read_bytes()
    rng = np.random.default_rng(3)
    for at in rng.integers(len(data), size=60):
        file.write_bytes(
            data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]
        )
        try:
            assert read_session(path) == session(samples=40)
        except SessionError as error:
            assert str(path) in str(error)  # noqa: PT017


def test_a_flipped_bit_of_a_number_is_named(tmp_path):
    path = write_session(session(samples=40), tmp_path / "a.csv")
    text = path.read_text()
    at = text.index(f",{float(np.sin(0.5))!r}")
    path.write_text(text[: at + 5] + str(9 - int(text[at + 5])) + text[at + 6 :])
    with pytest.raises(
        SessionError,
        match=r"a\.csv: column 'robot_x' is not as trustlab wrote it.*remove the first line",
    ):
        read_session(path)
    (tmp_path / "edited.csv").write_text(path.read_text().split("\n", 1)[1])
    assert len(read_session(tmp_path / "edited.csv")) == 40  # the remedy
    path.write_text(text.replace('"condition": 0.5', '"condition": 0.6'))
    with pytest.raises(SessionError, match="metadata are not as they were written"):
        read_session(path)
    # Negative control: files of earlier versions have no digests, and read as before.
    content = json.loads(text.split("\n")[0].removeprefix("# trustlab "))
    del content["digests"]
    path.write_text(f"# trustlab {json.dumps(content)}\n" + text.split("\n", 1)[1])
    assert read_session(path) == session(samples=40)


BAG = 'kind = "bag"\n[columns]\np_r = { topic = "/p", field = "layout.data_offset" }\n'


def bomb(path: Path, samples=2, size=40_000_000):
    """Write a bag of messages whose many zeros are packed to next to nothing."""
    ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/Float64MultiArray"
    layout = store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=1)
    message = store.types[kind](layout=layout, data=np.zeros(size // 8))
    data = bytes(
        store.serialize_ros1(message, kind) if ros1 else store.serialize_cdr(message, kind)
    )
    folder = path if path.suffix in ("", ".bag") else path.with_suffix("")
    if ros1:
        writer = Writer1(folder)
        writer.set_compression(Writer1.CompressionFormat.BZ2)
    else:
        plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
        writer = Writer2(folder, version=8, storage_plugin=plugin)
        mode = {"file": CompressionMode.FILE, "b": CompressionMode.MESSAGE}.get(
            path.name, CompressionMode.STORAGE
        )
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/p", kind, typestore=store)
        for k in range(samples):
            writer.write(topic, k * 10**8, data)
    if path.suffix == ".mcap":
        next(folder.glob("*.mcap")).rename(path)


@pytest.mark.parametrize("name", ["b.mcap", "b.bag", "b", "file"])
def test_bags_that_unpack_to_much(tmp_path, name):
    path = tmp_path / name
    bomb(path)
    packed = (
        path.stat().st_size
        if path.is_file()
        else sum(file.stat().st_size for file in path.iterdir())
    )
    assert packed < 200_000
    recipe = Recipe.from_toml(BAG)
    assert len(read_session(path, recipe=recipe)) == 2  # 80 MB are allowed
    with pytest.raises(SessionError, match=r"unpacks to more than 20000000 bytes.*max_bytes"):
        read_session(path, recipe=recipe, max_bytes=20_000_000)


def test_tables_that_unpack_to_much(tmp_path):
    path = tmp_path / "b.parquet"
    column = pa.chunked_array([pa.array(np.zeros(2**20))] * 18)
    pq.write_table(pa.table({"t": column, "p_r": column}), path, compression="zstd")
    assert path.stat().st_size < 500_000
    with pytest.raises(SessionError, match=r"unpacks to more than 268435456 bytes"):
        read_session(path)
    with pytest.raises(SessionError, match="time repeats"):
        read_session(path, max_bytes=2**31)
    with pytest.raises(ValueError, match="max_bytes must be a whole number"):
        read_session(path, max_bytes=0)


def test_a_feather_file_that_unpacks_to_much_is_refused_before_it_does(tmp_path, monkeypatch):
    path = tmp_path / "b.feather"
    table = pa.table({"t": 0.1 * np.arange(2**19), "p_r": np.zeros(2**19)})
    feather.write_feather(table, path, compression="zstd", chunksize=2**19)
    assert len(read_session(path)) == 2**19
    monkeypatch.setattr(pa.ipc, "open_file", None)  # what would unpack it
    with pytest.raises(SessionError, match=r"unpacks to more than 8000000 bytes.*max_bytes"):
        read_session(path, max_bytes=8_000_000)
