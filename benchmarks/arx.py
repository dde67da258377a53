"""ARX with covariance on 20,000 samples, beside statsmodels, SIPPY and SysIdentPy."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import machine
from benchmarks.data import session
from benchmarks.timing import Row, Spread, here, in_turns, seconds_per_call
from benchmarks.workers import PeerMissingError, Worker
from trustlab.identification import arx

TITLE = "ARX with covariance"
CASE = f"{TITLE}, 20,000 samples, na = nb = nk = 1, constant"
OURS = "trustlab arx: coefficients and standard errors"
LIMIT_MS, FASTER = 0.5, 5.0


def rows() -> Iterator[Row]:
    """Yield ours alone against its time limit, then one row per peer."""
    run = session()
    y, u = run["p_r"].copy(), run["mode"] * run["p_h"]

    def ours():
        fit = arx(y, u, na=1, nb=1, nk=1, intercept=True)
        return fit.coefficients, fit.stderr

    ours()
    alone = Spread.of([1e3 * seconds_per_call(ours, 25) for _ in range(25)])
    goal = f"≤ {LIMIT_MS} ms"
    yield Row(CASE, OURS, "(alone)", alone, goal=goal, met=alone.median <= LIMIT_MS)

    yield _compared(
        "statsmodels OLS: regressors, fit and bse", ours, *_statsmodels(y, u), ours()[0], turns=25
    )
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "arx.npz"
        np.savez(data, y=y, u=u)
        a, b, c = ours()[0]
        for script, way, peer, expected, note, turns in (
            (
                "sysidentpy_worker.py",
                "known structure",
                "SysIdentPy SimulateNARMAX, given structure, least squares",
                (c, -a, b),
                "no covariance; its quickest public way",
                25,
            ),
            (
                "sysidentpy_worker.py",
                "frols",
                "SysIdentPy FROLS, three terms, least squares",
                (c, -a, b),
                "no covariance; ranks the regressors too",
                25,
            ),
            (
                "sippy_worker.py",
                "arx",
                "SIPPY ARX (LLS)",
                arx(y - y.mean(), u - u.mean()).coefficients,
                "no covariance, no constant: means removed beforehand",
                9,
            ),
        ):
            try:
                with Worker(script, data) as worker:
                    machine.VERSIONS.update(worker.versions)
                    yield _compared(
                        peer,
                        ours,
                        worker.side(way),
                        worker.result(way),
                        expected,
                        turns=turns,
                        note=note,
                    )
            except PeerMissingError as error:
                yield Row(CASE, OURS, peer, goal=f"≥ {FASTER:g} × faster", fault=str(error))


def _statsmodels(y, u):
    import statsmodels.api as sm

    def peer():
        design = np.column_stack([-y[:-1], u[:-1], np.ones(y.size - 1)])
        fit = sm.OLS(y[1:], design).fit()
        return fit.params, fit.bse

    return here(peer), peer()[0]


def _compared(peer, ours, side, found, expected, turns, note="") -> Row:
    goal = f"≥ {FASTER:g} × faster"
    off = float(np.max(np.abs(np.asarray(found) / np.asarray(expected) - 1.0)))
    if not off < 1e-8:
        return Row(
            CASE, OURS, peer, goal=goal, fault=f"its coefficients differ by {off:.1e} (relative)"
        )
    ours_ms, peer_ms, ratio = in_turns(here(ours), side, turns)
    return Row(CASE, OURS, peer, ours_ms, peer_ms, ratio, goal, ratio.median >= FASTER, note)
