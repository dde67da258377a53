"""
The joint fit of operator and robot: two states, 20,000 samples, eight parameters; beside SciPy by
hand and CasADi's example.

`fit_tsc` weights each output by its own residual variance. The peers are given those weights (1/σ
of our fit, free of charge), so all have one and the same optimum, and are held to it before they
are timed: cost to 1e-6 of itself, parameters to a hundredth of a standard error. The SciPy peers
start from the values that `fit_tsc` searches for itself; CasADi starts from the truth.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator

import numpy as np

import trustlab as tl
from benchmarks.data import pilot, session
from benchmarks.peers import scipy_trust_region
from benchmarks.peers.casadi_shooting import SingleShooting
from benchmarks.timing import Row, here, in_turns
from trustlab.identification.log import read_runs
from trustlab.identification.tsc import TSC

TITLE = "Joint grey-box fit"
CASE = f"{TITLE}, 20,000 samples, 2 states, 8 parameters"
OURS = "trustlab fit_tsc: search of starting values, fit, covariance, diagnostics"
FIXED = {"r0": 0.0}
HUMAN, ROBOT = ("a", "beta", "p_min", "p_max"), ("a", "p_min", "p_max")
SLOWER, FASTER = 1.2, 15.0


def rows() -> Iterator[Row]:
    """Yield one row per peer."""
    run = session()
    mode, p_h, p_r = (run[name].copy() for name in ("mode", "p_h", "p_r"))

    def ours():
        return tl.fit_tsc(run, fixed=FIXED)

    fit = ours()
    table = fit.parameters.loc[
        [f"human_{name}" for name in HUMAN] + [f"robot_{name}" for name in ROBOT]
    ]
    theta = np.r_[table["value"], fit.initial_states["p_r0"]].astype(float)
    stderr = np.r_[table["stderr"], fit.initial_states["p_r0_stderr"]].astype(float)
    sd = fit.sigma["p_h"], fit.sigma["p_r"]
    cost = 0.5 * sum(
        float(e @ e) / s**2
        for e, s in zip((fit.residuals("p_h")[0], fit.residuals("p_r")[0]), sd, strict=True)
    )
    start = own_start(run)

    def compared(peer, call, turns, goal="", meets=None, note="", warm=True):
        try:
            x, its = call()[:2]
        except Exception as error:
            return Row(
                CASE,
                OURS,
                peer,
                goal=goal,
                fault=f"failed: {type(error).__name__}: {str(error)[:200]}",
            )
        apart, excess = float(np.max(np.abs(x - theta) / stderr)), its / cost - 1.0
        if not (apart < 1e-2 and abs(excess) < 1e-6):
            return Row(
                CASE,
                OURS,
                peer,
                goal=goal,
                fault=f"another optimum: {apart:.1e} standard errors away, cost {excess:+.1e} "
                "relative",
            )
        ours_ms, peer_ms, ratio = in_turns(here(ours), here(call), turns, warm)
        note = "; ".join(filter(None, [note, f"same optimum to {apart:.0e} standard errors"]))
        met = None if meets is None else meets(ratio.median)
        return Row(CASE, OURS, peer, ours_ms, peer_ms, ratio, goal, met, note)

    for solver in ("exact", "lsmr"):
        yield compared(
            f"SciPy least_squares trf ({solver}), compiled sensitivities, covariance; our "
            "starting values, given",
            lambda solver=solver: scipy_trust_region.fit(
                start, mode, p_h, p_r, *sd, tr_solver=solver
            ),
            turns=25,
            goal=f"ours ≤ {SLOWER} × peer (ratio ≥ {1 / SLOWER:.3f})",
            meets=lambda ratio: ratio >= 1.0 / SLOWER,
            note="SciPy's choice for dense Jacobians"
            if solver == "exact"
            else "the quicker choice here",
        )
    yield compared(
        "SciPy least_squares trf (exact), the search of starting values timed on its side too",
        lambda: scipy_trust_region.fit(own_start(run), mode, p_h, p_r, *sd),
        turns=25,
    )

    model = pilot()
    known = [getattr(model.human, name) for name in HUMAN] + [
        getattr(model.robot, name) for name in ROBOT
    ]
    truth = np.array([*known, model.robot.p_min])
    data = (mode, p_h, p_r, *sd, truth)
    goal, meets = f"≥ {FASTER:g} × faster", lambda ratio: ratio >= FASTER
    plain = SingleShooting(*data)
    yield compared(
        "CasADi's example (single shooting, IPOPT), interpreted: the solver call alone, from the "
        "truth",
        lambda: plain.solve(truth),
        turns=5,
        goal=goal,
        meets=meets,
        note="building the expressions is not counted",
    )
    if shutil.which("gcc") is None:
        note = "left out: the example's generated code needs gcc, which is not here"
        yield Row(CASE, OURS, "CasADi's example with generated code", note=note)
        return
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        yield compared(
            "CasADi's example (single shooting, IPOPT) as it stands, with generated code: from "
            "data to parameters",
            lambda: SingleShooting(*data, compiled=True).solve(truth),
            turns=3,
            goal=goal,
            meets=meets,
            note="expressions, compilation and solver call: the data are constants of its code",
            warm=False,
        )
        for flags in ("", "-O3"):
            solver = SingleShooting(*data, compiled=True, flags=flags)
            yield compared(
                f"CasADi's example with generated code{' and gcc ' + flags if flags else ''}: the "
                "solver call alone",
                lambda solver=solver: solver.solve(truth),
                turns=9,
                note="compilation (seconds) is not counted, though new data need it again",
            )
            del solver


def own_start(run: tl.Session) -> np.ndarray:
    """
    Return the values from which `fit_tsc` starts, in the order of its parameters.

    Parameters
    ----------
    run : Session
        The data.
    """
    guess = TSC.starts(read_runs(run, "mode", "p_h", "p_r"), TSC.limits(fixed=FIXED))[0]
    names = [
        *(f"human_{name}" for name in HUMAN),
        *(f"robot_{name}" for name in ROBOT),
    ]  # r0 is fixed
    return np.array([*(guess[name] for name in names), guess["p_r0"][0]])
