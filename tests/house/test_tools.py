"""Tools of the project: make, continuous integration, benchmarks, the run of changes."""

import fnmatch
import os
import re
import shlex
import shutil
import subprocess
import tomllib

import pytest

from benchmarks import __main__ as bench, loops, timing
from benchmarks.peers.worker import Seconds
from tests.house.documents import ROOT, TARGETS
from tests.mutation.run import LEFT_OUT, NOTICED_BY, modules_with_tests

# --- make and continuous integration --------------------------------------------------------------


def printed(*command, folder=ROOT):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def test_help_lists_every_target():
    lines = printed("make", "--no-print-directory", "help").stdout.splitlines()
    listed = {line.split()[1]: line.split(maxsplit=2)[2] for line in lines}
    assert set(listed) == TARGETS
    assert all(len(said) > 5 for said in listed.values())


def test_a_page_is_made_of_a_log_whose_path_has_spaces():
    """make took each word for a path."""
    files = ["FILE=my log.csv", "RECIPE=/my lab/lab.toml"]
    done = printed("make", "-n", "-o", ".venv/.stamp", "session", *files)
    words = shlex.split(re.search(r"-p session_file.*", done.stdout)[0])
    assert words == ["-p", "session_file", f"{ROOT}/my log.csv", "-p", "recipe", "/my lab/lab.toml"]


@pytest.mark.parametrize("broken", ["", "reports", "test"])
def test_continuous_integration_makes_reports_then_tests_and_stops_at_a_failure(
    tmp_path, monkeypatch, broken
):
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci")
    rules = [f"{name}:\n\t@echo $@; [ $@ != '{broken}' ]\n" for name in ("reports", "test")]
    (tmp_path / "Makefile").write_text("".join(rules))
    for name in [name for name in os.environ if name.startswith("MAKE")]:
        monkeypatch.delenv(name)
    done = printed("bash", ".ci/run", folder=tmp_path)
    assert done.stdout.split() == (["reports"] if broken == "reports" else ["reports", "test"])
    assert (done.returncode == 0) is (not broken)


# --- benchmarks -----------------------------------------------------------------------------------


def test_one_case_runs_alone_and_leaves_the_page(monkeypatch, capsys, tmp_path):
    row = timing.beside(
        "work", lambda: Seconds(1e-3), "peer", lambda: Seconds(2e-3), least=1.5, turns=2
    )
    assert (row.ratios, row.met) == ([2.0, 2.0], True)
    monkeypatch.setattr(loops, "rows", lambda: [row])
    monkeypatch.setattr(bench, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(bench, "RESULTS", tmp_path / "results.csv")
    assert bench.main(["loops"]) == 0
    said = capsys.readouterr().out
    assert "1 of 1 goals met" in said
    assert "work; 1 ms (1–1); peer: 2 ms (2–2); 2; ratio ≥ 1.5: met" in said
    assert list(tmp_path.iterdir()) == []
    bench.write([row])
    assert bench.RESULTS.read_text().endswith(
        "\nwork,1 ms (1–1),peer: 2 ms (2–2),2,ratio ≥ 1.5: met\n"
    )
    assert ":file: ../data/benchmarks/results.csv" in bench.PAGE.read_text()
    with pytest.raises(SystemExit, match="no benchmark is called lops; there are: first_use"):
        bench.main(["lops"])


def test_times_and_their_limits_are_written_out_in_the_same_units():
    assert timing.time_of([687.0, 644.0, 1543.0]) == "687 ms (644–1,540)"
    assert timing.time_of([0.0134]) == "13.4 µs"
    assert timing.number(1432.0) == "1,430"
    limit = timing.within("work", lambda: Seconds(10.6), 20_000.0, turns=1)
    assert (limit.goal, timing.time_of(limit.ours)) == ("≤ 20 s", "10.6 s")
    assert timing.tail("work", [0.014], 0.015).goal == "p99 ≤ 15 µs"


def test_a_peer_that_computes_something_else_is_not_compared(monkeypatch, capsys):
    def rows():
        timing.same("a peer", [1.0, 2.0], [1.0, 2.1], 1e-2)

    monkeypatch.setattr(loops, "rows", rows)
    assert bench.main(["loops"]) == 1
    assert "a peer: its results differ by 5.0e-02" in capsys.readouterr().err


# --- the run of changes ---------------------------------------------------------------------------


SURVIVORS = tomllib.loads((ROOT / "tests" / "mutation" / "survivors.toml").read_text())


def test_tests_and_modules_of_the_changes_are_there():
    modules = modules_with_tests()
    for tests, patterns in NOTICED_BY.items():
        assert (ROOT / "tests" / tests.split()[0]).is_file()
        assert all(fnmatch.filter(modules, pattern) for pattern in patterns.split()), tests
    assert all((ROOT / "trustlab" / f"{module}.py").is_file() for module in LEFT_OUT)


def test_every_listed_survivor_is_a_line_of_its_module_with_a_reason():
    assert SURVIVORS.keys() <= {*modules_with_tests()}
    for module, entries in SURVIVORS.items():
        source = (ROOT / "trustlab" / f"{module}.py").read_text()
        lines = {line.strip() for line in source.splitlines()}
        for entry in entries:
            assert entry["line"] in lines, (module, entry["line"])
            assert entry["reason"]
            assert entry["line"] not in entry.get("changes", ())
