"""
Files that only grow: whatever moment a writer dies at, what was acknowledged is there and nothing
else is. Oracle: the list of lines written.
"""

import json
import os
import stat

import pytest
from hypothesis import given, strategies as st

from trustlab.live.study.store import (
    EVENTS,
    EXPERIMENTER,
    DeletedError,
    Participant,
    append,
    cut_torn_line,
    delete_participant,
    deleted_codes,
    make_tokens,
    read_lines,
    read_tokens,
    tokens_path,
    write_whole,
)

VALUES = st.lists(
    st.one_of(st.integers(), st.text(), st.lists(st.floats(allow_nan=False, allow_infinity=False))),
    max_size=6,
)


@given(values=VALUES, cut=st.integers(min_value=0))
def test_a_file_cut_anywhere_gives_its_whole_lines(values, cut, tmp_path_factory):
    path = tmp_path_factory.mktemp("a") / "rows.jsonl"
    path.touch()
    lines = [json.dumps(value) for value in values]
    append(path, lines)
    data = path.read_bytes()
    cut = min(cut, len(data))
    path.write_bytes(data[:cut])
    whole = data[:cut].count(b"\n")
    assert read_lines(path) == values[:whole]  # reading changes nothing
    torn = cut_torn_line(path)
    assert path.read_bytes() == b"".join(f"{line}\n".encode() for line in lines[:whole])
    assert torn == cut - path.stat().st_size
    append(path, ['"after"'])
    assert read_lines(path) == [*values[:whole], "after"]


def test_without_the_cut_the_next_line_would_be_lost(tmp_path):
    path = tmp_path / "rows.jsonl"
    path.write_bytes(b"[0]\n[1")
    append(path, ["[1]"])
    with pytest.raises(
        ValueError, match=r"rows\.jsonl, line 2: .* is no JSON; this line was changed"
    ):
        read_lines(path)


def test_a_write_that_fails_leaves_no_half_line(tmp_path, monkeypatch):
    path = tmp_path / "rows.jsonl"
    append(path, ["[0]"])

    def full(handle):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space"):
            append(path, ["[1]"])
    append(path, ["[1]"])
    assert read_lines(path) == [[0], [1]]


def test_a_file_is_replaced_at_once_and_private_where_asked(tmp_path):
    path = tmp_path / "tokens"
    write_whole(path, "old", 0o600)
    write_whole(path, "new", 0o600)
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert [one.name for one in tmp_path.iterdir()] == ["tokens"]


def test_tokens_have_128_bits_stay_and_are_nobody_elses(tmp_path):
    folder = tmp_path / "mystudy"
    folder.mkdir()
    make_tokens(folder, ["P01", "P02"])
    first = read_tokens(folder)
    assert set(first) == {EXPERIMENTER, "P01", "P02"}
    assert {len(token) for token in first.values()} == {22}  # 16 bytes in base64
    assert len(set(first.values())) == 3
    assert tokens_path(folder).parent == tmp_path  # apart from the data
    make_tokens(folder, ["P01", "P02", "P03"])
    assert {name: read_tokens(folder)[name] for name in first} == first
    tokens_path(folder).chmod(0o640)
    with pytest.raises(ValueError, match="can be read by others on this machine; run: chmod 600"):
        read_tokens(folder)


def participant(tmp_path):
    folder = tmp_path / "mystudy" / "P01"
    folder.mkdir(parents=True)
    make_tokens(folder.parent, ["P01", "P02"])
    return Participant(folder)


def test_torn_lines_are_cut_and_noted_when_a_folder_is_opened(tmp_path):
    own = participant(tmp_path)
    own.add("page", page=0)
    own.open_attempt("01-training.0", {"config": {}})
    assert own.take("01-training.0", [[0, 0.5], [1, 0.5]]) == 2
    for name, torn in ((EVENTS, b'{"at": 1'), ("01-training.0.jsonl", b"[2, 0.")):
        with (own.folder / name).open("ab") as file:
            file.write(torn)
    again = Participant(own.folder)
    assert [event["kind"] for event in again.events] == ["page", "torn", "torn"]
    assert {event["file"]: event["bytes"] for event in again.events[1:]} == {
        EVENTS: 8,
        "01-training.0.jsonl": 6,
    }
    assert again.count("01-training.0") == 2
    assert again.rows("01-training.0") == [[0, 0.5], [1, 0.5]]
    assert Participant(own.folder).events == again.events  # nothing is cut twice


def test_rows_are_taken_in_order_once(tmp_path):
    own = participant(tmp_path)
    own.open_attempt("a", {})
    assert own.take("a", [[0, 1.0], [1, 1.0]]) == 2
    assert own.take("a", [[1, 9.0], [2, 1.0]]) == 3  # sent again, with one that is new
    assert own.take("a", [[5, 1.0]]) == 3  # a gap is not filled
    assert own.rows("a") == [[0, 1.0], [1, 1.0], [2, 1.0]]
    assert Participant(own.folder).count("a") == 3


def test_a_deleted_participant_leaves_an_empty_file_and_can_write_nothing(tmp_path):
    own = participant(tmp_path)
    own.add("page", page=0, answers={"remark": "private words"})
    folder = own.folder.parent
    (folder / "report.html").write_text("private words")
    before = read_tokens(folder)
    delete_participant(folder, "P01")
    assert deleted_codes(folder) == ["P01"]
    assert read_tokens(folder) == {name: token for name, token in before.items() if name != "P01"}
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(path.name for path in files) == ["P01.deleted", "mystudy.tokens.json"]
    assert (folder / "P01.deleted").read_bytes() == b""
    assert own.deleted
    with pytest.raises(DeletedError):
        own.add("page", page=1)
    delete_participant(folder, "P01")  # again: nothing is left to do
    assert deleted_codes(folder) == ["P01"]
