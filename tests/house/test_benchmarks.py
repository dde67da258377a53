"""Benchmarks run by name; a name that is none is refused with the list, before anything runs."""

import sys
from types import SimpleNamespace

import pytest

from benchmarks.__main__ import main


def test_one_case_runs_alone_and_leaves_the_files(monkeypatch, capsys):
    from benchmarks import report

    monkeypatch.setitem(
        sys.modules, "benchmarks.team", SimpleNamespace(TITLE="Team", rows=lambda: iter([]))
    )
    monkeypatch.setattr(
        report, "write", lambda rows, seconds: pytest.fail("files of a whole run replaced")
    )
    assert main(["team"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Team …")
    assert said.count("…") == 1
