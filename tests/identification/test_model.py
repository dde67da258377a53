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
import statsmodels.api as sm
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark

from tests.cases import refused
from tests.identification.cases import PILOT, log, session, truth, undetermined
from tests.identification.test_independent import human_output, robot_output
from trustlab import Model, fit as fit_model
from trustlab.identification import ROBOT, TSC
from trustlab.identification.log import hac_lags, read_runs
from trustlab.identification.problem import Problem


def two_rates(run, rise, decay, p_r0):
    p_r = np.full(len(run["mode"]), p_r0)
    for k, mode in enumerate(run["mode"][:-1]):
        p_r[k + 1] = p_r[k] + (rise * (0.39 - p_r[k]) if mode else decay * (0.24 - p_r[k]))
    return p_r


MINE = Model(
    ("rise", "decay"), "p_r0", "p_r", low=(0, 0, 0), high=(0.2, 0.2, 1), simulate=two_rates
)


def session_of(noise=0.0, samples=3000, truth=(0.011, 0.006, 0.3), phase=300):
    mode = (np.arange(samples) // phase % 2 == 0).astype(float)
    errors = noise * default_rng(0).standard_normal(samples)
    return log(mode=mode, p_r=two_rates({"mode": mode}, *truth) + errors)


def levels(**outputs):
    """A model of one level that all its outputs have, and a session in manual control."""

    def simulate(run, level):
        return tuple(np.full(run.size, level) for _ in outputs)

    model = Model("level", (), [*outputs], (0,), (1000,), simulate=simulate)
    mode = np.ones_like(outputs["p_r"])
    return model, log(mode=mode, **outputs)


# --- a lab's own model ----------------------------------------------------------------------------


def test_a_plain_simulation_is_recovered():
    fit = fit_model(MINE, [session_of(), session_of(truth=(0.011, 0.006, 0.26), samples=1500)])
    assert fit.success, fit.message
    assert_allclose([*fit.model.values()], [0.011, 0.006], rtol=1e-6)
    assert_allclose(fit.initial_states["p_r0"], [0.3, 0.26], rtol=1e-6)
    assert fit.plot().shape == (1, 2)


@mark.parametrize("unit", [1.0, 1000.0])
def test_samples_are_left_out_alike_in_any_unit(unit):
    values = unit * (0.3 + 0.003 * default_rng(5).standard_normal(1000))
    kept = np.delete(values, np.s_[400:430])
    values[400:430] += 0.1 * unit
    fit = fit_model(*levels(p_r=values), noise="white")
    assert fit.model["level"] == approx(kept.mean(), rel=1e-9)
    assert fit.cost == approx(0.5 * kept.size * kept.var(), rel=1e-6)


def straight_line(session, noise):
    def simulate(run, gain, offset):
        return gain * run["mode"] + offset

    low, high = [-1.0, -1.0], [1.0, 1.0]
    model = Model(["gain", "offset"], (), "p_r", low, high, simulate=simulate)
    return fit_model(model, session, noise=noise)


def test_several_outputs_are_weighted_by_their_own_noise():
    """
    Two measurements of one level, one of them ten times as noisy: the variances add as those of a
    weighted mean.
    """
    values = 0.3 + default_rng(5).standard_normal((2, 4000)) * [[0.001], [0.01]]
    fit = fit_model(*levels(p_r=values[0], p_h=values[1]), noise="white")
    weights = 1.0 / values.var(axis=1)
    assert fit.model["level"] == approx(np.average(values.mean(axis=1), weights=weights), rel=1e-6)
    stderr = fit.parameters["stderr"]["level"]
    assert stderr == approx((4000 * weights.sum()) ** -0.5, rel=1e-3)


def test_rates_are_searched_as_time_constants():
    """A slow state: in the unknown itself a step of differences would be as long as 1 − a."""

    def memory(run, a):
        return 0.2 + 0.1 * a ** np.arange(run.size)

    model = Model("a", (), "p_r", (0,), (1,), simulate=memory, coordinates={"a": "rate"})
    slow = log(mode=np.ones(9000), p_r=0.2 + 0.1 * 0.9999 ** np.arange(9000))
    assert 1.0 - fit_model(model, slow).model["a"] == approx(1e-4, rel=1e-6)


def test_its_derived_rows_carry_their_error():
    model = replace(MINE, derived={"sum": lambda rise, decay: rise + decay})
    fit = fit_model(model, session_of(0.003), noise="white")
    row = fit.parameters.loc["sum"]
    assert row["status"] == "derived"
    assert row["stderr"] == approx(np.sqrt(fit.covariance.to_numpy().sum()), rel=1e-9)
    held = fit_model(model, session_of(0.003), fixed={"rise": 0.011, "decay": 0.006})
    assert np.isnan(held.parameters["stderr"]["sum"])


# --- standard errors ------------------------------------------------------------------------------


def test_standard_errors_are_those_of_ols():
    """
    With few samples, so that n/(n − p) shows: OLS without and with HAC covariance, its small-sample
    form.
    """
    short = session_of(0.01, samples=60, phase=15)
    line = sm.OLS(short["p_r"], np.column_stack([short["mode"], np.ones(60)]))
    white, robust = (straight_line(short, noise) for noise in ("white", "hac"))
    assert_allclose(white.parameters["stderr"], line.fit().bse, rtol=1e-6)
    lags = hac_lags(robust.residuals())
    oracle = line.fit(cov_type="HAC", cov_kwds={"maxlags": lags, "use_correction": True})
    assert_allclose(robust.parameters["stderr"], oracle.bse, rtol=1e-6)


# --- the package's own structures -----------------------------------------------------------------


def test_lanes_give_outputs_and_derivatives():
    """
    Oracle: the second implementation, by complex steps. Derivatives of lanes are those by
    coordinates, dv/dx times as large.
    """
    (run,) = read_runs(session(np.repeat([1.0, 0.0, 0.5], 200)), "mode", "p_h", "p_r")
    at, mode = {**truth(), "r0": 0.3, "p_r0": 0.3}, run["mode"]

    def outputs(v):
        human = [v[f"human_{name}"] for name in ("a", "beta", "p_min", "p_max")]
        robot = [v[f"robot_{name}"] for name in ("a", "p_min", "p_max")]
        p_h = human_output([*human, v["r0"]], mode)
        return np.array([p_h, robot_output([*robot, v["p_r0"]], mode, p_h, human[3])])

    problem = Problem(TSC, [run], TSC.limits())
    x = problem.full_vector(at)
    problem.equations(x)
    assert_allclose(problem.simulated(run, 0, x), outputs(at).real, rtol=1e-12)
    slopes = np.imag(problem.values(x + 1e-100j)) / 1e-100
    for j, name in enumerate(problem.unknowns):
        expected = outputs(at | {name: at[name] + 1e-100j}).imag / 1e-100
        lanes = [series.slopes[:, j] / slopes[j] for series in problem.series[0]]
        # A load has a longer step, across its kinks.
        assert_allclose(lanes, expected, rtol=1e-3 if name == "r0" else 1e-4, atol=2e-5)


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
        (r"must return p_r, shape \(3000,\) each, got \(7,\)", {"simulate": short}),
        (r"p_r, shape \(3000, \d\) each, got \(7,\)", {"simulate": short, "lanes": True}),
        ("not finite at rise", {"simulate": lost}),
        ("hints names 'rize'.*did you mean 'rise'", {"hints": {"rize": "record more"}}),
        ("starts names 'rize'", starting({"rize": 0.1})),
        ("starts must be of class dict, got NoneType; .* returns a list of dict", starting()),
        ("rise needs bounds on both sides, or a start", {"high": (np.inf, 0.2, 1.0)}),
    ):
        with refused(says):
            fit_model(replace(MINE, **fields), session_of())


def test_a_simulation_cannot_write_into_what_it_is_compared_with():
    """The log was changed for all later evaluations, and the error blamed the data."""

    def simulate(run, rise, decay, p_r0):
        p_r = run["p_r"]
        p_r[:] = two_rates(run, rise, decay, p_r0)
        return p_r

    with refused("read-only"):
        fit_model(replace(MINE, simulate=simulate), session_of())


def test_an_unknown_without_effect_is_named():
    def simulate(run, level, idle):
        return np.full(run.size, level)

    model = Model(["level", "idle"], (), "p_r", (0, 0), (1, 1), simulate=simulate)
    with undetermined("do not determine idle") as caught:
        fit_model(model, session_of())
    assert caught.value.parameters == ("idle",)


def test_a_delay_is_estimated_without_starts_and_beside_derived_rows():
    noisy = session(np.repeat([1.0, 0.0] * 3, 1000))
    driven = fit_model(ROBOT, noisy, fixed={"p_h_max": PILOT.human.p_max}, mode_delay=True)
    assert abs(driven.table().loc["mode_delay", "value"]) < 0.5
    assert "its noise counts as performance" in driven.message
    mine = fit_model(MINE, noisy.between(0.0, 300.0), mode_delay=True)
    assert "mode_delay" in mine.table().index
    with undetermined("do not determine p_max and p_h_max"):
        fit_model(ROBOT, noisy)


def test_a_model_that_takes_no_notice_of_mode_has_no_delay():
    """Errors of the mode's stamps widen nothing that does not depend on them."""
    flat, noisy = levels(p_r=0.3 + default_rng(0).normal(0, 0.01, 500))
    switched = noisy.with_columns(mode=np.repeat([0.0, 1.0], 250))
    exact, rough = (fit_model(flat, switched, stamp_error=error).table() for error in (0.0, 3.0))
    pd.testing.assert_frame_equal(exact, rough)
