"""
Stored results: as another CPU would compute them, the same digits; a part of each simulated table,
made again, is as stored.

Each setting of a CPU runs in a process of its own, because linear algebra, NumPy and numba choose
their code when they are loaded.
"""

import importlib
import json
import os
import platform
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from data.simulated import make_simulated as make
from tests import textbook
from tests.house.documents import ROOT
from trustlab.reproduction.reconstruction.contradictions import contradictions
from trustlab.testbeds import TeleoperatorPopulation

# --- digests --------------------------------------------------------------------------------------


SCRIPT = ROOT / "data" / "digests" / "make_digests.py"
SLOWEST = ("fit_population", "fit_trust")  # half the time of all cases
CPUS = [
    {"OPENBLAS_CORETYPE": "Nehalem"},
    {"OPENBLAS_CORETYPE": "Sandybridge"},
    {"OPENBLAS_CORETYPE": "Haswell"},
    {"OPENBLAS_NUM_THREADS": "2"},
    {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"},
    {"NUMBA_CPU_NAME": "generic", "OPENBLAS_CORETYPE": "Prescott"},
]


@pytest.fixture
def digests(monkeypatch):
    """The script as a module; its cases are beside it."""
    monkeypatch.syspath_prepend(SCRIPT.parent)
    return importlib.import_module("make_digests")


@pytest.mark.skipif(
    (platform.system(), platform.machine()) != ("Linux", "x86_64"),
    reason="the settings choose code for x86-64 on Linux",
)
@pytest.mark.parametrize(
    ("setting", "left_out"),
    [(CPUS[0], SLOWEST), *(pytest.param(cpu, (), marks=pytest.mark.long) for cpu in CPUS)],
    ids=str,
)
def test_another_cpu_computes_the_same_digits_and_decisions(digests, setting, left_out):
    environment = os.environ | setting | {"PYTHONWARNINGS": "ignore", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(SCRIPT), *(digests.CASES.keys() - {*left_out})]
    run = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr[-2000:]


def test_a_digest_tells_what_a_processor_may_change_from_what_it_may_not(digests):
    """Seven digits of values, a thousandth of a standard error of estimates, decisions exactly."""

    def told(column, value, **table):
        expected = {name: {"0": cell, "rows": 1} for name, cell in table.items()}
        return list(digests.differences(expected | {column: {"0": value, "rows": 1}}, expected))

    moved = 0.3 * (1.0 + 1e-6)
    fit = {"parameter": "beta", "estimate": 0.7, "standard_error": 0.02, "determined": True}
    assert told("x", 0.3 * (1.0 + 1e-8), x=0.3) == []
    assert told("x", moved, x=0.3) == [("x", "0", moved, 0.3)]
    assert told("x", float("nan"), x=0.3)
    for column, value, differs in (
        ("estimate", 0.7 + 1e-4 * 0.02, False),
        ("estimate", 0.7 + 1e-2 * 0.02, True),
        ("standard_error", 0.02 + 1e-4 * 0.02, False),
        ("standard_error", 0.0201, True),
        ("parameter", "Beta", True),
        ("determined", 1, True),
        ("another", 1.0, True),
    ):
        assert bool(told(column, value, **fit)) == differs


# --- tables ---------------------------------------------------------------------------------------


DATA = ROOT / "data" / "simulated"
SEED = json.loads((DATA / "guidance.json").read_text())["seed"]


def stored(name):
    return pd.read_csv(DATA / f"{name}.csv")


def same(again, row, rtol=1e-9):
    assert again == pytest.approx(row[list(again)].to_dict(), rel=rtol)


def test_trust_value():
    own = stored("trust_value")
    assert own.groupby("fault")["number"].nunique()["deaf"] >= 200
    for row in (own.iloc[3], own[own["policy"] == "random"].iloc[-1]):
        same(make.time_with_fault(row["fault"], row["policy"], row["number"], None), row)


def test_teleoperators():
    """One operator of each table flies again."""
    streams = np.random.SeedSequence(make.SEED).spawn(200)

    def person(number, drawn=None):
        people = TeleoperatorPopulation("main").draw(number, make.SEED, drawn)
        return people.to_dict("records")[-1]

    row = stored("compensation").query("operator == 'adapting' and failure_every == 15").iloc[4]
    who = person(5, {"adapting": 1.0})
    same(make.tracking_errors("main", ["M", "TMIG"], who, streams[4]), row)
    row = stored("orders").query("study == 'main' and law == 'crossover'").iloc[130]
    number = row["participant"]
    who = person(number, {name: row[name] for name in make.TELEOPERATOR_PRIORS})
    task = replace(make.TASKS["main"], view=row["view"])
    same(make.tracking_errors("main", ["MI", "TMIG"], who, streams[number - 1], task), row)
    row = stored("felt").query("law == 'proportional' and scheme == 'M'").iloc[2]
    same(make.flown_guided("M", person(3), row["k_ffa"], streams[2]), row)


def test_what_the_stored_flights_say():
    flights = stored("felt")
    assert flights["gain_apart"].abs().max() < 2e-3
    assert (flights["given_out"] <= 0.2 + 0.5 * 120.0 + 1e-9).all()
    printed = flights.query("law == 'proportional' and scheme == 'M' and k_ffa == 6")
    helped = (printed["without"] - printed["guided"]).mean()
    left = (printed["equal_gain"] - printed["guided"]).mean()
    assert printed["felt"].mean() > 1.0
    assert 0.0 < left < 0.1 * helped
    tried = stored("orders").query("operators == 'as shipped' and study == 'main'")
    assert (tried[["M", "MI", "MMI", "TMIG"]].idxmin(axis=1) == "MI").all()


def test_guidance():
    own = stored("guidance")
    again, before = make.guidance(1), own[own["participant"] == 1]
    # Between machines the last bits of a run of 12,000 samples may differ.
    assert_allclose(again["tracking_error"], before["tracking_error"], rtol=1e-6)
    assert again["guidance"].tolist() == before["guidance"].tolist()


def test_failures():
    own = stored("failures").set_index("bound")
    again = make.failures(200, SEED + 1, invariant=10).set_index("bound")
    spread = np.sqrt(own["share"] * (1.0 - own["share"]) / again["sets"])  # of binomial counts
    assert ((again["share"] - own["share"]).abs() <= 4.0 * spread).all()
    assert own["sets"].tolist() == [20_000] * 5 + [2_000] * 2
    assert own.loc["r ≤ r_u (2.33)", "share"] > 0.2


@pytest.mark.long
def test_adjustments():
    own = stored("adjustments").set_index(["study", "p_adjust"])["status"]
    name = "uav.robot_performance"
    for p_adjust, status in own[name].items():
        answer = tl.feasibility(tl.published_studies()[name], p_adjust, SEED + 1)
        assert status == ("found" if answer.rest_feasible else "not found"), p_adjust


def test_reconstructions():
    """Each stored data set has every printed statistic that arithmetic does not contradict."""
    studies, own = tl.published_studies(), stored("reconstructions")
    assert set(own["study"]) == set(studies)
    for (name, _), data in own.groupby(["study", "seed"]):
        study = studies[name]
        wide = data.pivot_table(index="subject", columns="condition", values="value")
        values = wide[list(study.conditions)].to_numpy()
        factor = textbook.analysed(values)["epsilon"] if study.corrected else 1.0
        assert textbook.misses(study, values, factor, factor) == set(contradictions(study)), name
    assert own.groupby("study")["seed"].nunique().to_dict()["uav.tlx"] == 5


def test_recording():
    """The page's table is that of the logs, and a log simulated again is as stored."""
    rows = stored("recording")
    kept = pd.read_csv(DATA / "recording_summary.csv", dtype=str)
    assert make.recording_summary().astype(str).to_numpy().tolist() == kept.to_numpy().tolist()
    # What the page says of it.
    medians = rows.pivot_table("width", ["noise", "minutes"], "switches", aggfunc="median")
    assert (medians[3] <= medians[9]).mean() > 0.9
    assert rows.loc[rows["offered"], "safe"].mean() >= 0.93
    assert rows["covered"].mean() >= 0.9
    one = rows.iloc[0]
    arguments = one[["minutes", "switches", "noise", "participant"]]
    result = make.decided(**arguments, seed=np.random.SeedSequence(make.SEED).spawn(1)[0])
    assert result["width"] == pytest.approx(one["width"], rel=1e-6)
    assert result["probability"] == pytest.approx(one["probability"], abs=0.02)


def test_trust_scores():
    own = stored("trust_scores").query("people == 'hybrid_vr' and criterion == 'step'")
    again = make.scored(tl.read_people("hybrid_vr"), "step", ["performance", "persistence"])
    both = again.merge(own, on=["split", "model", "measure"], suffixes=("", "_stored"))
    assert len(both) == 20
    # Optimisers leave digits open.
    assert_allclose(both["mean"], both["mean_stored"], rtol=2e-3)
    assert_allclose(both["difference"], both["difference_stored"], rtol=0.2, atol=1e-5)
    assert {"hybrid_real", "trust_transfer", "btm"} < set(stored("trust_scores")["people"])


def test_trust_residuals():
    own = stored("trust_residuals").query("people == 'hybrid_real' and model == 'performance'")
    again = make.residuals(tl.read_people("hybrid_real"), "performance")
    assert list(again["person"]) == list(own["person"])
    assert_allclose(again["residual"], own["residual"], atol=2e-3)


def test_trust_recovery():
    own = stored("trust_recovery").set_index("simulated")
    assert_allclose(own.sum(axis=1), 1.0)
    assert list(own) == list(own.index) == list(tl.trust.MODELS)


@pytest.mark.parametrize("name", [None, pytest.param("asymmetric", marks=pytest.mark.long)])
def test_trust_effects(name):
    own = stored("trust_effects").query("study == 'table_3.1'")
    own = own[own["trust"] == (name or make.PRINTED)].set_index("id")
    again = tl.simulated_effects(
        n=20, seed=SEED, only="table_3.1", trust=make.driver(name, 0.2), n_jobs=1
    ).set_index("id")
    assert_allclose(again["simulated"], own["simulated"], rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("case", [("sequence", None), ("most_trusted", "asymmetric")], ids=str)
def test_trust_teams(case):
    policy, name = case
    own = stored("trust_teams").query("policy == @policy and team == 3")
    row = own[own["trust"] == (name or make.PRINTED)].iloc[0]
    again = make.arrival(policy, name, 3)
    assert again["arrival"] == pytest.approx(row["arrival"], abs=0.2)
    assert again["switches"] == row["switches"]
