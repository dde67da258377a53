"""
Files that only grow: whatever moment a writer dies at, what was acknowledged is there and nothing
else is, and no line can be changed unseen. Oracle: the list of entries written.
"""

import json
import os

import pytest
from hypothesis import given, settings, strategies as st

from trustlab.live.chain import Chain, check_writable, hold, read_chain

ENTRIES = st.lists(
    st.one_of(
        st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
        st.lists(st.floats(allow_nan=False, allow_infinity=False)),
    ),
    max_size=6,
)


@given(entries=ENTRIES, cut=st.integers(min_value=0))
def test_a_file_cut_anywhere_gives_its_whole_lines(entries, cut, tmp_path_factory):
    path = tmp_path_factory.mktemp("a") / "rows.jsonl"
    path.touch()
    Chain(path, "a").append(entries)
    data = path.read_bytes()
    cut = min(cut, len(data))
    path.write_bytes(data[:cut])
    whole = data[:cut].count(b"\n")
    reading = read_chain(path, "a")  # reading changes nothing
    assert reading.entries == entries[:whole]
    torn = cut - (data[:cut].rfind(b"\n") + 1)
    assert bool(reading.fault) == bool(torn)
    chain = Chain(path, "a")
    assert chain.torn == torn
    chain.append(["after"])
    reading = read_chain(path, "a")
    assert (reading.entries, reading.fault) == ([*entries[:whole], "after"], "")


@settings(max_examples=200)
@given(entries=ENTRIES.filter(bool), place=st.integers(min_value=0), bit=st.integers(0, 7))
def test_every_bit_that_is_changed_is_found(entries, place, bit, tmp_path_factory):
    path = tmp_path_factory.mktemp("a") / "rows.jsonl"
    Chain(path, "a").append(entries)
    data = bytearray(path.read_bytes())
    data[place % len(data)] ^= 1 << bit
    path.write_bytes(data)
    assert read_chain(path, "a").fault.startswith("rows.jsonl")


def test_lines_taken_out_put_in_or_exchanged_are_found_by_number(tmp_path):
    path = tmp_path / "rows.jsonl"
    Chain(path, "a").append([[k, 0.5] for k in range(5)])
    lines = path.read_text().splitlines(keepends=True)
    assert read_chain(path, "a").fault == ""
    assert "line 1" in read_chain(path, "b").fault, "of another study or participant"
    for number, changed in (
        (3, lines[:2] + lines[3:]),
        (3, [*lines[:2], lines[1], *lines[2:]]),
        (2, [lines[0], lines[2], lines[1], *lines[3:]]),
        (1, lines[1:]),
    ):
        path.write_text("".join(changed))
        assert read_chain(path, "a").fault.startswith(f"rows.jsonl, line {number}:")


def test_without_the_cut_the_next_line_would_be_lost(tmp_path):
    path = tmp_path / "rows.jsonl"
    chain = Chain(path, "a")
    chain.append([[0]])
    with path.open("ab") as file:
        file.write(b'["01')
    chain.append([[1]])  # by a writer who did not open the file again
    with pytest.raises(ValueError, match=r"rows\.jsonl, line 2: .* is no entry with its link"):
        chain.read()


def full(*_):
    raise OSError(28, "No space left on device")


def test_a_write_that_fails_leaves_no_half_line(tmp_path, monkeypatch):
    path = tmp_path / "rows.jsonl"
    chain = Chain(path, "a")
    chain.append([[0]])
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space"):
            chain.append([[1]])
    chain.append([[1]])
    assert chain.read().entries == [[0], [1]]
    assert chain.read().fault == ""


def test_a_disk_that_is_full_takes_half_a_line_back(tmp_path):
    """A limit on a file's size, as a real disk sets it: the write stops in the middle of a line."""
    resource = pytest.importorskip("resource")
    import signal

    path = tmp_path / "rows.jsonl"
    chain = Chain(path, "a")
    chain.append([[0]])
    size = path.stat().st_size
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 30, before[1]))
        with pytest.raises(OSError):
            chain.append([[k, 0.25] for k in range(20)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert path.stat().st_size == size
    chain.append([[1]])
    assert chain.read().entries == [[0], [1]]


def test_one_handle_holds_a_file(tmp_path):
    path = tmp_path / "rows.jsonl"
    path.touch()
    first = hold(path)
    assert hold(path) is None
    os.close(first)
    second = hold(path)
    assert second is not None
    os.close(second)


def test_a_folder_that_takes_nothing_is_refused(tmp_path, monkeypatch):
    check_writable(tmp_path)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ValueError, match=r"nothing can be written in .*No space left.*has room"):
        check_writable(tmp_path)


def test_the_lines_are_json(tmp_path):
    path = tmp_path / "rows.jsonl"
    Chain(path, "a").append([{"text": "ä"}, [1, 0.1]])
    assert [json.loads(line)[1] for line in path.read_text().splitlines()] == [
        {"text": "ä"},
        [1, 0.1],
    ]
