"""Benchmarks run by name; a name that is none is refused with the list, before anything runs."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.__main__ import CASES, chosen, main

ROOT = Path(__file__).parents[2]


def test_cases_are_chosen_by_name_in_their_order():
    assert chosen([]) == list(CASES)
    assert chosen(["team", "arx"]) == ["arx", "team"]
    assert all((ROOT / "benchmarks" / f"{name}.py").is_file() for name in CASES)


def test_unknown_name_is_refused_with_the_list():
    with pytest.raises(ValueError, match="no benchmark is called axr; there are: arx, greybox"):
        chosen(["arx", "axr"])
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "axr"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert done.stderr.startswith("no benchmark is called axr")
    assert done.stdout == ""


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
