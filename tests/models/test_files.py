"""Files are there whole or as they were."""

import os

import pytest

from trustlab.models.files import PARTIAL, write_atomically


def test_text_and_bytes_are_written(tmp_path):
    write_atomically(tmp_path / "a.txt", "naïve")
    write_atomically(str(tmp_path / "b.bin"), b"\x00\xff")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "naïve"
    assert (tmp_path / "b.bin").read_bytes() == b"\x00\xff"
    assert not list(tmp_path.glob(f"*{PARTIAL}*"))


def test_a_write_that_fails_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    path.write_text("before")

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, "after")
    assert path.read_text() == "before"
    assert not list(tmp_path.glob(f"*{PARTIAL}*"))
