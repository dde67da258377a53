"""
A model of one's own: recovered, refused where it cannot be fitted, with the standard errors of
independent tools.

Oracles: parameters that data were made with; statsmodels OLS, with and without HAC covariance, for
a model that is a linear regression; complex steps on the recursions written out here, for the
derivatives that lanes give.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
from scipy.signal import lfilter

import trustlab as tl
from tests.identification.cases import PILOT, SWITCHING, log, scores, session
from tests.identification.test_independent import human_output, robot_output
from trustlab.identification import ROBOT, TSC
from trustlab.identification.log import read_runs
from trustlab.identification.noise import hac_lags
from trustlab.identification.problem import Problem

T = 0.1


def two_rates(run, rise, decay, p_r0):
    p_r = np.full(len(run["mode"]), p_r0)
    for k, mode in enumerate(run["mode"][:-1]):
        p_r[k + 1] = p_r[k] + (rise * (0.39 - p_r[k]) if mode else decay * (0.24 - p_r[k]))
    return p_r


MINE = tl.Model(
    ("rise", "decay"), "p_r0", "p_r", low=(0, 0, 0), high=(0.2, 0.2, 1), simulate=two_rates
)


def session_of(noise=0.0, seed=0, samples=3000, truth=(0.011, 0.006, 0.3), phase=300):
    mode = (np.arange(samples) // phase % 2 == 0).astype(float)
    errors = noise * np.random.default_rng(seed).standard_normal(samples)
    return log(mode=mode, p_r=two_rates({"mode": mode}, *truth) + errors)


def levels(**outputs):
    """A session in manual control, and a model of one level that all its outputs have."""
    size = len(next(iter(outputs.values())))

    def simulate(run, level):
        return tuple(np.full(run.size, level) for _ in outputs)

    def starts(runs, limits):
        return [{"level": np.median(runs[0][model.outputs[0]])}]

    model = tl.Model("level", (), tuple(outputs), simulate=simulate, starts=starts)
    return model, log(mode=np.ones(size), **outputs)


# --- a lab's own model ----------------------------------------------------------------------------


def test_a_plain_simulation_is_recovered():
    fit = tl.fit(MINE, [session_of(), session_of(truth=(0.011, 0.006, 0.26), samples=1500)])
    assert fit.success, fit.message
    np.testing.assert_allclose([*fit.model.values()], [0.011, 0.006], rtol=1e-6)
    np.testing.assert_allclose(fit.initial_states["p_r0"], [0.3, 0.26], rtol=1e-6)
    assert fit.plot().shape == (1, 2)


def test_its_intervals_cover_the_truth():
    """95 % intervals of 60 sessions: 57 ± 1.7 are expected to cover."""
    tables = [tl.fit(MINE, session_of(0.003, seed, 1200)).table() for seed in range(60)]
    inside = scores(tables, pd.Series({"rise": 0.011, "decay": 0.006}))[1]
    assert (inside.sum() >= 51).all()


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_samples_are_left_out_alike_in_any_unit(unit):
    rng = np.random.default_rng(5)
    values = unit * (0.3 + 0.003 * rng.standard_normal(1000))
    clean = np.ones(values.size, dtype=bool)
    clean[400:430] = False
    values[~clean] += 0.1 * unit
    for robust, kept in ((True, clean), (False, np.ones_like(clean))):
        fit = tl.fit(*levels(p_r=values), robust=robust, noise="white")
        assert fit.model["level"] == pytest.approx(values[kept].mean(), rel=1e-9)
        assert fit.cost == pytest.approx(0.5 * kept.sum() * np.var(values[kept]), rel=1e-6)


def straight_line(session, noise, **options):
    def simulate(run, gain, offset):
        return gain * (run["mode"][:, None] if options else run["mode"]) + offset

    def starts(runs, limits):
        return [{"gain": 1.0, "offset": 0.0}]

    model = tl.Model(("gain", "offset"), (), "p_r", simulate=simulate, starts=starts, **options)
    return tl.fit(model, session, noise=noise)


def test_many_lanes_in_one_call_give_the_same_fit():
    alone, together = (
        straight_line(session_of(0.003), "white", **options) for options in ({}, {"lanes": True})
    )
    pd.testing.assert_frame_equal(alone.parameters, together.parameters, check_exact=True)


def test_several_outputs_are_weighted_by_their_own_noise():
    """
    Two measurements of one level, one of them ten times as noisy: the variances add as those of a
    weighted mean.
    """
    rng = np.random.default_rng(5)
    quiet, loud = 0.3 + 0.001 * rng.standard_normal(4000), 0.3 + 0.01 * rng.standard_normal(4000)
    fit = tl.fit(*levels(p_r=quiet, p_h=loud), noise="white")
    weights = np.array([1.0 / quiet.var(), 1.0 / loud.var()])
    assert fit.model["level"] == pytest.approx(
        np.average([quiet.mean(), loud.mean()], weights=weights), rel=1e-6
    )
    assert fit.parameters.loc["level", "stderr"] == pytest.approx(
        (4000 * weights.sum()) ** -0.5, rel=1e-3
    )


def test_rates_are_searched_as_time_constants():
    """
    A slow state: in the unknown itself a step of differences would be as long as 1 − a.
    """
    memory = tl.Model(
        "a",
        (),
        "p_r",
        simulate=lambda run, a: 0.2 + 0.1 * a ** np.arange(run.size),
        starts=lambda runs, limits: [{"a": 0.9}],
        coordinates={"a": "rate"},
    )
    slow = log(mode=np.ones(9000), p_r=0.2 + 0.1 * 0.9999 ** np.arange(9000))
    assert 1.0 - tl.fit(memory, slow).model["a"] == pytest.approx(1e-4, rel=1e-6)


def test_its_derived_rows_carry_their_error():
    model = replace(MINE, derived={"sum": lambda rise, decay: rise + decay})
    fit = tl.fit(model, session_of(0.003), noise="white")
    row = fit.parameters.loc["sum"]
    assert row["status"] == "derived"
    assert row["stderr"] == pytest.approx(np.sqrt(fit.covariance.to_numpy().sum()), rel=1e-9)
    held = tl.fit(model, session_of(0.003), fixed={"rise": 0.011, "decay": 0.006})
    assert np.isnan(held.parameters.loc["sum", "stderr"])


# --- standard errors ------------------------------------------------------------------------------


def test_standard_errors_are_those_of_ols():
    """
    With few samples, so that n/(n − p) shows: OLS without and with HAC covariance, its small-sample
    form.
    """
    short = session_of(0.01, samples=60, phase=15)
    line = sm.OLS(short["p_r"], np.column_stack([short["mode"], np.ones(60)]))
    white, robust = (straight_line(short, noise) for noise in ("white", "hac"))
    np.testing.assert_allclose(white.parameters["stderr"], line.fit().bse, rtol=1e-6)
    lags = hac_lags(robust.residuals())
    oracle = line.fit(cov_type="HAC", cov_kwds={"maxlags": lags, "use_correction": True})
    np.testing.assert_allclose(robust.parameters["stderr"], oracle.bse, rtol=1e-6)


# --- the package's own structures -----------------------------------------------------------------


def outputs_of(run, v):
    """P_h and P_r by the second implementation; values may be complex."""
    p_h_max, mode = v["human_p_max"], run["mode"]
    of_human = (v["human_a"], v["human_beta"], v["human_p_min"], p_h_max, v["r0"])
    of_robot = (v["robot_a"], v["robot_p_min"], v["robot_p_max"], v["p_r0"])
    p_h = human_output(of_human, mode)
    return p_h, robot_output(of_robot, mode, p_h, p_h_max)


AT = {
    "human_a": 0.995,
    "human_beta": 0.7,
    "human_p_min": 0.39,
    "human_p_max": 0.46,
    "robot_a": 0.99,
    "robot_p_min": 0.24,
    "robot_p_max": 0.39,
    "r0": 0.3,
    "p_r0": 0.3,
}


def short_run():
    return read_runs(session(np.repeat([1.0, 0.0, 0.5], 200)), "mode", "p_h", "p_r")[0]


def test_lanes_give_outputs_and_derivatives():
    """Of values: the derivatives of lanes are those by coordinates, divided by dv/dx."""
    run = short_run()
    problem = Problem(TSC, [run], TSC.limits())
    x = problem.full_vector(AT)
    problem.equations(x)
    slopes = np.imag(problem.values(x + 1e-100j)) / 1e-100
    outputs = zip(problem.series[0], problem.simulated(run, 0, x), strict=True)
    for place, (series, output) in enumerate(outputs):
        np.testing.assert_allclose(output, outputs_of(run, AT)[place].real, rtol=1e-12)
        for j, name in enumerate(problem.unknowns):
            moved = outputs_of(run, AT | {name: AT[name] + 1e-100j})[place]
            slope = moved.imag / 1e-100
            derivative = series.slopes[:, j] / slopes[j]
            # A load has a longer step, across its kinks.
            rtol = 1e-3 if name == "r0" else 1e-4
            np.testing.assert_allclose(derivative, slope, rtol=rtol, atol=2e-5)


# --- refusals -------------------------------------------------------------------------------------


def test_models_that_cannot_be_made_or_fitted_are_refused():
    def short(run, **at):
        return np.ones(7)

    def lost(run, **at):
        return np.full(run.size, np.nan)

    def starting(*points):
        return {"starts": lambda runs, limits: [*points]}

    for says, fields in (
        ("two unknowns called 'rise'", {"names": ("rise", "rise")}),
        ("rise needs bounds with low < high", {"low": (np.nan, 0.0, 0.0)}),
        ("coordinates names 'rize'.*did you mean 'rise'", {"coordinates": {"rize": "rate"}}),
        (r"must return p_r, shape \(3000,\) each, got \(7,\)", {"simulate": short}),
        (r"p_r, shape \(3000, \d\) each, got \(7,\)", {"simulate": short, "lanes": True}),
        ("not finite at rise", {"simulate": lost}),
        ("hints names 'rize'.*did you mean 'rise'", {"hints": {"rize": "record more"}}),
        ("starts names 'rize'.*did you mean 'rise'", starting({"rize": 0.1})),
        ("starts must be of class dict, got str; .* returns a list of dict", starting("rise")),
        ("starts must be of class dict, got NoneType; .* returns a list of dict", starting()),
        ("rise needs bounds on both sides, or a start", {"high": (np.inf, 0.2, 1.0)}),
    ):
        with pytest.raises(ValueError, match=says):
            tl.fit(replace(MINE, **fields), session_of())
    with pytest.raises(ValueError, match="fixed a must lie strictly between 0 and 1, got 1"):
        ROBOT.limits({"a": 1.0})


def test_a_simulation_cannot_write_into_what_it_is_compared_with():
    """The log was changed for all later evaluations, and the error blamed the data."""

    def simulate(run, rise, decay, p_r0):
        p_r = run["p_r"]
        p_r[:] = two_rates(run, rise, decay, p_r0)
        return p_r

    with pytest.raises(ValueError, match="read-only"):
        tl.fit(replace(MINE, simulate=simulate), session_of())


def test_an_unknown_without_effect_is_named():
    def simulate(run, idle, **at):
        return two_rates(run, **at)

    names, low, high = (*MINE.names, "idle"), (0.0,) * 4, (0.2, 0.2, 1.0, 1.0)
    model = replace(MINE, names=names, low=low, high=high, simulate=simulate)
    with pytest.raises(tl.IdentificationError, match="do not determine idle") as caught:
        tl.fit(model, session_of(0.003))
    assert caught.value.parameters == ("idle",)


def test_a_delay_is_estimated_without_starts_and_beside_derived_rows():
    noisy = session(np.repeat([1.0, 0.0] * 3, 1000))
    driven = tl.fit(ROBOT, noisy, fixed={"p_h_max": PILOT.human.p_max}, mode_delay=True)
    assert abs(driven.table().loc["mode_delay", "value"]) < 0.5
    assert "its noise counts as performance" in driven.message
    mine = tl.fit(MINE, noisy.between(0.0, 300.0), mode_delay=True)
    assert "mode_delay" in mine.table().index
    with pytest.raises(tl.IdentificationError, match="do not determine p_max and p_h_max"):
        tl.fit(ROBOT, noisy)


def test_a_model_that_takes_no_notice_of_mode_has_no_delay():
    """Errors of the mode's stamps widen nothing that does not depend on them."""
    flat, noisy = levels(p_r=0.3 + np.random.default_rng(0).normal(0, 0.01, 500))
    switched = noisy.with_columns(mode=np.repeat([0.0, 1.0], 250))
    exact, rough = (tl.fit(flat, switched, stamp_error=error).table() for error in (0.0, 3.0))
    pd.testing.assert_frame_equal(exact, rough)


def test_a_start_far_away_finds_the_same_as_one_nearby():
    """From the middle of the bounds, a search that runs to a bound would end with a = 1."""

    def lag(run, a, low, high, level, p_r0):
        u = (1.0 - a) * (low + (high - low) * run["mode"])
        p_r = lfilter([0.0, 1.0], [1.0, -a], u) + p_r0 * a ** np.arange(run.size)
        return p_r, np.full(run.size, level)

    model = tl.Model(
        ["a", "low", "high", "level"],
        ["p_r0"],
        ["p_r", "p_h"],
        [0.0] * 5,
        [1.0] * 5,
        simulate=lag,
        coordinates={"a": "rate"},
    )
    near = {"a": 0.996, "low": 0.24, "high": 0.38, "level": 0.43, "p_r0": 0.3}
    noisy = session(SWITCHING)
    far, guessed = (
        tl.fit(replace(model, starts=lambda runs, limits, at=at: [at]), noisy, noise="white")
        for at in ({"a": 0.995}, near)
    )
    np.testing.assert_allclose(far.parameters["value"], guessed.parameters["value"], rtol=1e-4)
    assert far.model["a"] == pytest.approx(PILOT.robot.a, abs=1e-3)
