"""
Files that only grow: whatever moment a writer dies at, what was acknowledged is there and nothing
else is, and no line can be changed unseen. Oracle: the list of entries written.
"""

import resource
import signal

import pytest
from hypothesis import given, strategies as st

from trustlab.live.log import Log, LogError, read_log

ENTRIES = st.lists(
    st.one_of(
        st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
        st.lists(st.floats(allow_nan=False, allow_infinity=False)),
    ),
    max_size=6,
)


def logged(folders, entries):
    """Return a log that holds these entries, and its bytes."""
    path = folders.mktemp("a") / "rows.jsonl"
    log = Log(path, "a")
    log.append(entries)
    log.close()
    return path, path.read_bytes()


@given(entries=ENTRIES, cut=st.integers(min_value=0))
def test_a_file_cut_anywhere_gives_its_whole_lines(entries, cut, tmp_path_factory):
    path, data = logged(tmp_path_factory, entries)
    cut = min(cut, len(data))
    path.write_bytes(data[:cut])
    whole = data[:cut].count(b"\n")
    reading = read_log(path, "a")  # reading changes nothing
    assert reading.entries == entries[:whole]
    torn = cut - (data[:cut].rfind(b"\n") + 1)
    assert bool(reading.fault) == bool(torn)
    log = Log(path, "a")
    assert log.torn == torn
    log.append(["after"])
    reading = read_log(path, "a")
    assert (reading.entries, reading.fault) == ([*entries[:whole], "after"], "")


@given(entries=ENTRIES.filter(bool), place=st.integers(min_value=0), bit=st.integers(0, 7))
def test_every_bit_that_is_changed_is_found(entries, place, bit, tmp_path_factory):
    path, data = logged(tmp_path_factory, entries)
    changed = bytearray(data)
    changed[place % len(data)] ^= 1 << bit
    path.write_bytes(changed)
    assert read_log(path, "a").fault.startswith("rows.jsonl")


def test_lines_taken_out_put_in_or_exchanged_are_found_by_number(tmp_path):
    path = tmp_path / "rows.jsonl"
    Log(path, "a").append([[k, 0.5] for k in range(5)])
    lines = path.read_text().splitlines(keepends=True)
    assert read_log(path, "a").fault == ""
    assert "line 1" in read_log(path, "b").fault, "of another study or participant"
    for number, changed in (
        (3, lines[:2] + lines[3:]),
        (3, [*lines[:2], lines[1], *lines[2:]]),
        (2, [lines[0], lines[2], lines[1], *lines[3:]]),
        (1, lines[1:]),
    ):
        path.write_text("".join(changed))
        assert read_log(path, "a").fault.startswith(f"rows.jsonl, line {number}:")


def test_a_disk_that_is_full_takes_half_a_line_back(tmp_path):
    """A limit on a file's size, as a real disk sets it: the write stops in the middle of a line."""
    path = tmp_path / "rows.jsonl"
    log = Log(path, "a")
    log.append([[0]])
    size = path.stat().st_size
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 30, before[1]))
        with pytest.raises(OSError):
            log.append([[k, 0.25] for k in range(20)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert path.stat().st_size == size
    log.append([[1]])
    assert read_log(path, "a").entries == [[0], [1]]


def test_one_handle_holds_a_log(tmp_path):
    first = Log(tmp_path / "rows.jsonl")
    with pytest.raises(LogError, match="is being written; end that first"):
        Log(tmp_path / "rows.jsonl")
    first.close()
    Log(tmp_path / "rows.jsonl").close()
