"""A benchmark of a name runs alone and leaves the book's page; what differs is not compared."""

import sys
from types import SimpleNamespace

import pytest

from benchmarks import __main__ as bench, timing


def test_one_case_runs_alone_and_leaves_the_page(monkeypatch, capsys, tmp_path):
    row = timing.beside("work", lambda: 1e-3, "peer", lambda: 2e-3, least=1.5, turns=2)
    assert (row.ratios, row.met) == ([2.0, 2.0], True)
    monkeypatch.setitem(sys.modules, "benchmarks.loops", SimpleNamespace(rows=lambda: iter([row])))
    monkeypatch.setattr(bench, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(bench, "RESULTS", tmp_path / "results.csv")
    assert bench.main(["loops"]) == 0
    said = capsys.readouterr().out
    assert "1 of 1 goals met" in said
    assert "work; 1 ms (1–1); peer: 2 ms (2–2); 2; ratio ≥ 1.5: met" in said
    assert not bench.PAGE.exists()
    assert not bench.RESULTS.exists()
    bench.write([row])
    assert bench.RESULTS.read_text().endswith(
        "\nwork,1 ms (1–1),peer: 2 ms (2–2),2,ratio ≥ 1.5: met\n"
    )
    assert ":file: ../data/benchmarks/results.csv" in bench.PAGE.read_text()
    with pytest.raises(SystemExit, match="no benchmark is called lops; there are: first_use"):
        bench.main(["lops"])


def test_a_peer_that_computes_something_else_is_not_compared(monkeypatch, capsys):
    def rows():
        timing.same("a peer", [1.0, 2.0], [1.0, 2.1], 1e-2)
        yield None

    monkeypatch.setitem(sys.modules, "benchmarks.loops", SimpleNamespace(rows=rows))
    assert bench.main(["loops"]) == 1
    assert "a peer: its results differ by 5.0e-02" in capsys.readouterr().err
