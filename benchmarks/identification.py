"""Fits of one session of 20,000 samples, and posteriors of ten minutes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

import trustlab as tl
from benchmarks.peers import scipy_fit
from benchmarks.peers.worker import Worker
from benchmarks.timing import Row, beside, same, within
from trustlab.identification import TSC
from trustlab.identification.log import read_runs

SAMPLES = 20_000
FIXED = {"r0": 0.0}
NAMES = [f"human_{name}" for name in ("a", "beta", "p_min", "p_max")]
NAMES += [f"robot_{name}" for name in ("a", "p_min", "p_max")]


def session(minutes: float | None = None, model: tl.TscModel | None = None) -> tl.Session:
    """Return eight phases of an operator at 10 Hz with white noise, or the first minutes."""
    mode = (np.arange(SAMPLES) // (SAMPLES // 8) % 2 == 0).astype(float)
    model = model or tl.published_models()["pilot"]
    frame = model.simulate(mode)[["mode", "p_r", "p_h"]]
    rng = np.random.default_rng(20_190)
    frame[["p_r", "p_h"]] += 0.003 * rng.standard_normal((SAMPLES, 2))
    frame.index = pd.Index(0.1 * np.arange(SAMPLES), name="t")
    whole = tl.Session(frame, tl.Metadata(synthetic=True))
    return whole if minutes is None else whole.between(0.0, 60.0 * minutes)


def rows() -> Iterator[Row]:
    """Yield ARX, the joint fit, and posteriors."""
    yield from regressions()
    yield from joint_fits()
    short = session(10.0)
    posterior = "Posterior of ten minutes, 1,000 draws"
    yield within(posterior, lambda: tl.sample_posterior(short), 3000.0, turns=3)
    models = [tl.published_models()[name] for name in "12345"]
    people = {f"P{k}": session(10.0, model) for k, model in enumerate(models)}
    population = "Population of five, ten minutes each"
    yield within(population, lambda: tl.fit_population(people), 20_000.0, turns=1)


def regressions() -> Iterator[Row]:
    """Yield ARX with covariance beside statsmodels and SysIdentPy."""
    import statsmodels.api as sm

    run = session()
    y, u = run["p_r"].copy(), run["mode"] * run["p_h"]
    work = f"ARX with covariance, {SAMPLES:,} samples"

    def ours() -> np.ndarray:
        return tl.arx(y, u, intercept=True).coefficients

    def statsmodels() -> np.ndarray:
        fit = sm.OLS(y[1:], np.column_stack([-y[:-1], u[:-1], np.ones(y.size - 1)])).fit()
        return np.append(fit.params, fit.bse)

    same("statsmodels", ours(), statsmodels()[:3], 1e-8)
    yield beside(work, ours, "statsmodels OLS", statsmodels, limit=0.5, least=5.0, turns=25)
    with Worker("sysidentpy_arx", {"y": y, "u": u}) as worker:
        _, (c, a, b) = worker.ask("frols")
        same("SysIdentPy", ours(), [-a, b, c], 1e-8)
        peer = "SysIdentPy FROLS, no covariance"
        yield beside(work, ours, peer, worker.timed("frols"), least=5.0)


def joint_fits() -> Iterator[Row]:
    """
    Yield `fit_tsc` beside SciPy.

    SciPy is given the weights of both outputs, so that both have one optimum. Who takes it needs
    starting values too: our search of them counts on both sides, or on none.
    """
    run = session()
    work = f"Joint fit, {SAMPLES:,} samples, 8 unknowns"

    def ours():
        return tl.fit_tsc(run, fixed=FIXED, noise="white")

    fit = ours()
    values = np.append(fit.parameters.loc[NAMES, "value"], fit.initial_states["p_r0"])
    errors = np.append(fit.parameters.loc[NAMES, "stderr"], fit.initial_states["p_r0_stderr"])
    data = [run[name].copy() for name in ("mode", "p_h", "p_r")]
    data += [fit.sigma[name] for name in ("p_h", "p_r")]

    def start() -> np.ndarray:
        guess = TSC.starts(read_runs(run, "mode", "p_h", "p_r"), TSC.limits(fixed=FIXED))[0]
        return np.array([*(guess[name] for name in NAMES), guess["p_r0"][0]])

    def scipy(first) -> np.ndarray:
        return scipy_fit.fit(first, *data)

    given = start()
    # A hundredth of a standard error is the same optimum.
    same("SciPy", np.ones(8), 1.0 + (scipy(given) - values) / errors, 1e-2)
    peer = "SciPy least_squares (trf) with compiled sensitivities, after our search of its start"
    yield beside(work, ours, peer, lambda: scipy(start()), least=1 / 1.2)
    yield beside(work, ours, "the same, its start given", lambda: scipy(given))
