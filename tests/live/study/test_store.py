"""A participant's folder, and the links of a study. Oracle: the list of what was written."""

import pytest

from trustlab.live.study.store import (
    EXPERIMENTER,
    JOIN,
    PREVIEW,
    DeletedError,
    Participant,
    delete_participant,
    deleted_codes,
    make_tokens,
    read_tokens,
    tokens_path,
)


def test_tokens_have_128_bits_stay_and_are_nobody_elses(tmp_path):
    folder = tmp_path / "mystudy"
    folder.mkdir()
    make_tokens(folder, ["P01", "P02"])
    first = read_tokens(folder)
    assert set(first) == {EXPERIMENTER, JOIN, PREVIEW, "P01", "P02"}
    assert {len(token) for token in first.values()} == {22}  # 16 bytes in base64
    assert len(set(first.values())) == 5
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
    return Participant(folder, "plan")


def test_torn_lines_are_cut_and_noted_when_a_folder_is_opened(tmp_path):
    own = participant(tmp_path)
    own.add("page", page=0)
    own.open_attempt("01-training.0", {"config": {}})
    assert own.take("01-training.0", [[0, 0.5], [1, 0.5]]) == 2
    for name, torn in (("events.jsonl", b'["0123456'), ("01-training.0.jsonl", b'["0123')):
        with (own.folder / name).open("ab") as file:
            file.write(torn)
    again = Participant(own.folder, "plan")
    assert [event["kind"] for event in again.events] == ["page", "torn", "torn"]
    assert {event["file"]: event["bytes"] for event in again.events[1:]} == {
        "events.jsonl": 9,
        "01-training.0.jsonl": 6,
    }
    assert again.count("01-training.0") == 2
    assert again.rows("01-training.0") == [[0, 0.5], [1, 0.5]]
    assert Participant(own.folder, "plan").events == again.events  # nothing is cut twice


def test_rows_are_taken_in_order_once(tmp_path):
    own = participant(tmp_path)
    own.open_attempt("a", {})
    assert own.take("a", [[0, 1.0], [1, 1.0]]) == 2
    assert own.take("a", [[1, 9.0], [2, 1.0]]) == 3  # sent again, with one that is new
    assert own.take("a", [[5, 1.0]]) == 3  # a gap is not filled
    assert own.rows("a") == [[0, 1.0], [1, 1.0], [2, 1.0]]
    assert Participant(own.folder, "plan").count("a") == 3


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
