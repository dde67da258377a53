"""
What the fits must give back: exact parameters from exact data, honest intervals from noisy data.
"""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import mark

import trustlab as tl
from notebooks.noise_settings import ar1
from tests.identification.cases import (
    FITS,
    MODELS,
    ROOT,
    SWITCHING,
    fits_giving_back,
    scores,
    session,
    truth,
)
from trustlab import fit_human, fit_robot, fit_tsc

# Every operator, and the pilot as each session may begin and be driven.
SHORT = SWITCHING[::3]
EXACT = [(name, SHORT, 0.0, None) for name in MODELS] + [
    ("pilot", 1.0 - SHORT, 0.0, None),
    ("pilot", SHORT, 1.0, 0.3),
    # Nothing in (2.3), (2.5) needs a mode of 0 or 1.
    ("pilot", np.repeat(default_rng(3).random(20), 300), 0.3, 0.3),
]


@mark.parametrize(("name", "mode", "r0", "p_r0"), EXACT)
def test_exact_data_give_the_parameters_back(name, mode, r0, p_r0):
    model = MODELS[name]
    fits_giving_back(session(mode, 0.0, model=model, r0=r0, p_r0=p_r0), model)


def test_runs_may_begin_at_rest_and_at_work():
    """A start that all runs shared led to the other side of β for one of them."""
    mode, r0 = np.repeat([1.0, 0.0] * 4, 400), [0.0, 0.5, 0.95]
    fit = fit_tsc([session(abs(i % 2 - mode), r0=each, seed=i) for i, each in enumerate(r0)])
    assert fit.success, fit.message
    assert_allclose(fit.initial_states["r0"], r0, atol=0.03)


@mark.parametrize("name", MODELS)
def test_shipped_sessions_are_fitted(name):
    file = "pilot.csv" if name == "pilot" else f"participant_{name}.parquet"
    shipped = tl.read_session(ROOT / "data" / "sessions" / file)
    for who in ("robot", "human"):
        fit = FITS[who](shipped)
        assert fit.success, fit.message
        assert scores([fit.table(level=0.9999)], truth(MODELS[name], who))[1].all(axis=None)


@mark.slow
@mark.parametrize("who", ["robot", "human"])
@mark.parametrize(
    ("sessions", "least", "apart"),
    [(40, 0.86, 0.3), pytest.param(400, 0.92, 0.1, marks=mark.long)],
)
def test_intervals_cover_the_truth(who, sessions, least, apart):
    """
    20,000 samples with seven switches and white noise of sd 0.003.

    95 % intervals cover the truth in 95 % of seeds, less 2.5 sd of that share (3.4 % and 1.1 %);
    errors are as large as the standard errors say, but for 2.7 sd of so many (11 % and 3.5 %).
    Those of β are smaller: r0 may lie at its bound, for which the intervals allow.
    """
    seeds = np.random.SeedSequence(47).spawn(sessions)
    tables = [FITS[who](session(seed=seed)).table() for seed in seeds]
    z, inside = scores(tables, truth(who=who))
    assert (inside.mean() >= least).all()
    spread = (z**2).mean() ** 0.5
    assert spread.between(0.65, 1.0 + apart).all()
    loose = ["beta", "p_min"] if who == "human" else []
    assert spread.drop(loose).between(1.0 - apart, 1.0 + apart).all()


@mark.parametrize("seeds", [16, pytest.param(40, marks=mark.long)])
def test_slow_noise_under_white_noise_is_seen(seeds):
    """z scores over seeds: white noise must not hide slow noise from the robust standard errors."""
    beta, logs = truth(who="human")[["beta"]], []
    for seed in range(seeds):
        noisy = session(seed=seed)
        slow = ar1(default_rng(1000 + seed), len(noisy), 10.0, 0.001)
        logs.append(noisy.with_columns(p_h=noisy["p_h"] + slow))
    hac, white = ([fit_human(log, noise=way) for log in logs] for way in ("hac", "white"))
    assert 'use noise="auto"' in white[-1].message
    robust, plain = (scores([fit.table() for fit in fits], beta)[0] for fits in (hac, white))
    assert robust.std(ddof=0).item() < 1.7
    assert plain.std(ddof=0).item() > 2.5


@mark.parametrize("seeds", [20, pytest.param(100, marks=mark.long)])
@mark.parametrize(("held", "names"), [("p_h_max", ["p_max"]), ("p_max", ["a", "p_min", "b"])])
def test_noise_of_the_measured_input_is_allowed_for(held, names, seeds):
    """
    Input noise ten times that of the output: the spread of estimates is what standard errors say,
    with p_h_max given, or p_max held, to which its error is handed on.
    """
    expected, tables = truth(who="robot"), []
    for seed in range(seeds):
        clean, rng = session(seed=seed), default_rng(1000 + seed)
        log = clean.with_columns(p_h=clean["p_h"] + 0.03 * rng.standard_normal(len(clean)))
        tables.append(fit_robot(log, fixed={held: expected[held]}, noise="white").table())
    z = scores(tables, expected[names])[0]
    # Three sd of a standard deviation of so few, 1/√(2 seeds) each.
    assert (abs(z.std() - 1.0) < 3.0 / np.sqrt(2.0 * seeds)).all(), z.std()
    assert (abs(z.mean()) < 3.0 / np.sqrt(seeds)).all()


@mark.parametrize("r0", [0.003, 0.98, 1.0])
def test_no_utilization_near_an_end_explains_more(r0):
    """(2.6) bends at rest and at full load, so that a search may stop beside the optimum."""
    end, options = float(r0 > 0.5), {"noise": "white", "robust": False}
    for seed, name in enumerate(("pilot", "1")):
        log = session(abs(end - SWITCHING), seed=seed, model=MODELS[name], r0=r0)
        best = fit_human(log, **options)
        for apart in (0.0, 1e-4, 1e-3, 3e-3, 0.01, 0.02):
            held = fit_human(log, fixed={"r0": abs(end - apart)}, **options)
            assert len(log) * np.log(held.cost / best.cost) > -0.02, (name, apart)
