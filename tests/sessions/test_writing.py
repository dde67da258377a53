"""What is written reads back bit for bit, here and by others, and is whole or not there."""

import itertools
import json
import multiprocessing
import os
import resource
import signal
import threading

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from rosbags.highlevel import AnyReader

from tests.cases import refused
from trustlab.sessions import Metadata, Session, read_session, write_session

NAMES = ["a.csv", "a.parquet", "a.mcap"]


def session(value=0.5, samples=50):
    t = np.arange(samples) * 0.1
    frame = pd.DataFrame({"p_r": value, "robot_x": np.sin(t)}, index=t)
    return Session(frame, Metadata(condition=value))


FINITE = st.floats(allow_nan=False, allow_infinity=False)
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | FINITE | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner),
    max_leaves=4,
)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=25)
@given(
    values=st.lists(FINITE, min_size=2, max_size=5),
    start=st.floats(-1e9, 1e9),
    step=st.floats(1e-3, 1e6) | st.just(1e15),  # more nanoseconds than a stamp of ROS holds
    participant=st.none() | st.integers() | st.text(max_size=6),
    more=st.dictionaries(st.text(max_size=5), PLAIN, max_size=3),
    synthetic=st.booleans(),
)
@pytest.mark.filterwarnings("ignore:.*a[.]")  # of values that are hardly meant
def test_written_sessions_read_back_bit_for_bit(
    tmp_path, name, values, start, step, participant, more, synthetic
):
    t = start + step * np.arange(len(values))
    columns = {"robot_x": values, "p_r": values[::-1]}
    facts = Metadata(participant, more=more, synthetic=synthetic)
    original = Session(pd.DataFrame(columns, index=t), facts)
    path = write_session(original, tmp_path / name)
    again = read_session(path)
    assert again == original
    assert type(again.metadata.participant) is type(participant)
    assert again.metadata.source == str(path)
    assert again.table().to_numpy().tobytes() == original.table().to_numpy().tobytes()
    assert read_session(path, columns=["p_r"]).columns == ["p_r"]
    assert os.listdir(tmp_path) == [name]
    # Negative control: the least change of one number, or of the metadata, is not equal.
    values = np.nextafter(original["p_r"], 0.5)
    for other in (original.with_columns(p_r=values), original.with_metadata(trial=8)):
        assert read_session(write_session(other, path)) != original


@pytest.mark.parametrize("name", NAMES)
def test_others_read_what_is_written(tmp_path, name):
    """Oracle: pandas and rosbags."""
    path = write_session(session(), tmp_path / name)
    expected = session().table()
    if name == "a.csv":
        facts = json.loads(path.read_text().split("\n")[0].removeprefix("# trustlab "))
        assert facts["condition"] == 0.5
        assert pd.read_csv(path, comment="#").equals(expected)
    elif name == "a.parquet":
        assert pd.read_parquet(path).equals(expected)
    else:
        columns = {}
        with AnyReader([path]) as reader:
            for connection, _, data in reader.messages():
                message = reader.deserialize(data, connection.msgtype)
                columns.setdefault(connection.topic, []).append(message.data)
        assert json.loads(columns.pop("/trustlab/metadata")[0])["samples"] == 50
        assert columns == {f"/trustlab/{column}": expected[column].tolist() for column in expected}


def test_a_table_that_was_spoiled_is_not_written(tmp_path):
    """It was, and could not be read."""
    spoiled = session()
    spoiled.data["note"] = "x"
    with refused("column 'note' is not in the vocabulary"):
        write_session(spoiled, tmp_path / "a.csv")
    assert os.listdir(tmp_path) == []


def test_a_bag_that_lost_samples_is_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "trustlab.sessions.writing.metadata_to_json", lambda *_, samples: '{"samples": 100}'
    )
    with refused("has 50 samples where its metadata say 100"):
        read_session(write_session(session(), tmp_path / "half.mcap"))


# --- whole or not there -------------------------------------------------------------------------


def write_for_ever(folder, begun):
    """Write every format over itself, again and again."""
    for k in range(10**6):
        for name in NAMES:
            write_session(session(float(k)), folder / name)
            begun.set()


@pytest.fixture(scope="module")
def processes():
    context = multiprocessing.get_context("forkserver")
    modules = ["trustlab.sessions.writing", "pyarrow.parquet", "rosbags.highlevel"]
    context.set_forkserver_preload(modules)
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


@pytest.mark.parametrize(("name", "steps"), [("replace", 4), ("fsync", 2)])
def test_writers_killed_at_every_step(tmp_path, processes, name, steps):
    for file in NAMES:
        write_session(session(), tmp_path / file)
    for step in range(steps):
        writer = processes.Process(target=killed_before, args=(tmp_path, step, name), daemon=True)
        writer.start()
        writer.join(60)
        assert writer.exitcode == -signal.SIGKILL
        assert left_by_a_killed_writer(tmp_path) == step + 1


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*a[.]")  # of values that are hardly meant
def test_a_hundred_killed_writers(tmp_path, processes):
    """At random moments."""
    rng = np.random.default_rng(1)
    half_made = 0
    for _ in range(100):
        begun = processes.Event()
        writer = processes.Process(target=write_for_ever, args=(tmp_path, begun), daemon=True)
        writer.start()
        assert begun.wait(60)
        writer.join(rng.uniform(0.0, 0.2))
        writer.kill()
        writer.join()
        half_made += left_by_a_killed_writer(tmp_path)
    assert half_made > 0


@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_is_a_sentence(tmp_path, name):
    write_session(session(0.1), tmp_path / name)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, limits[1]))
        with refused(r"a\..*: cannot be written"):
            write_session(session(samples=3000), tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert read_session(tmp_path / name) == session(0.1)
    assert os.listdir(tmp_path) == [name]
