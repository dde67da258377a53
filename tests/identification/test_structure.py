"""
A model of one's own: recovered, refused where it cannot be fitted, with the standard errors of
independent tools.

Oracles: parameters that data were made with; statsmodels OLS, with and without HAC covariance, for
a structure that is a linear regression; complex steps on the recursions written out here, for the
sensitivities of the package's own structures.
"""

import cmath

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
from statsmodels.stats.sandwich_covariance import S_hac_simple

import trustlab as tl
from trustlab.identification.human import HUMAN
from trustlab.identification.output_error import Problem, local_optimum
from trustlab.identification.residuals import hac_lags
from trustlab.identification.robot_performance import robot_structure
from trustlab.identification.runs import read_runs
from trustlab.identification.tsc import TSC

T = 0.1


def two_rates(run, rise, decay, p_r0):
    p_r = np.full(len(run["mode"]), p_r0)
    for k, mode in enumerate(run["mode"][:-1]):
        p_r[k + 1] = p_r[k] + (rise * (0.39 - p_r[k]) if mode else decay * (0.24 - p_r[k]))
    return p_r


RATES = [tl.Parameter("rise", 0.0, 0.2), tl.Parameter("decay", 0.0, 0.2)]
START = [tl.Parameter("p_r0", 0.0, 1.0)]
MINE = tl.Structure("two rates", RATES, outputs="p_r", simulate=two_rates, initial=START)


def session_of(noise=0.0, seed=0, samples=3000, truth=(0.011, 0.006, 0.3), phase=300):
    mode = (np.arange(samples) // phase % 2 == 0).astype(float)
    p_r = two_rates({"mode": mode}, *truth) + noise * np.random.default_rng(seed).standard_normal(
        samples
    )
    frame = pd.DataFrame(
        {"mode": mode, "p_r": p_r}, index=pd.Index(T * np.arange(samples), name="t")
    )
    return tl.Session(frame, tl.Metadata(synthetic=True))


# --- a lab's own model ----------------------------------------------------------------------------


def test_a_plain_simulation_is_recovered():
    fit = tl.fit(MINE, [session_of(), session_of(truth=(0.011, 0.006, 0.26), samples=1500)])
    assert fit.success, fit.message
    assert fit.model["rise"] == pytest.approx(0.011, rel=1e-6)
    assert fit.model["decay"] == pytest.approx(0.006, rel=1e-6)
    np.testing.assert_allclose(fit.initial_states["p_r0"], [0.3, 0.26], rtol=1e-6)
    assert list(fit.table().columns) == ["value", "stderr", "ci_low", "ci_high", "status"]
    assert fit.plot().shape == (1, 2)
    assert fit.whiteness().index.tolist() == ["p_r"]


def test_its_intervals_cover_the_truth():
    """95 % intervals of 60 sessions: 57 ± 1.7 are expected to cover."""
    inside = [
        (table["ci_low"] <= truth) & (truth <= table["ci_high"])
        for truth in [pd.Series({"rise": 0.011, "decay": 0.006})]
        for table in (tl.fit(MINE, session_of(0.003, seed, 1200)).table() for seed in range(60))
    ]
    assert (pd.DataFrame(inside).sum() >= 51).all()


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_samples_left_out_count_alike_in_any_unit(unit):
    """Deviances with and without outliers are truncated squares, from their definition."""

    def level(run, height):
        return [np.full(run["mode"].size, height)], [np.ones((run["mode"].size, 1))]

    rng = np.random.default_rng(5)
    values = unit * (0.3 + 0.003 * rng.standard_normal(1000))
    clean = np.ones(values.size, dtype=bool)
    clean[400:430] = False
    values[~clean] += 0.1 * unit
    frame = pd.DataFrame({"mode": 1.0, "p_r": values}, index=T * np.arange(values.size))
    session = tl.Session(frame.rename_axis("t"), tl.Metadata(synthetic=True))
    names = [tl.Parameter("height", guess=0.3 * unit)]
    structure = tl.Structure("level", names, outputs="p_r", sensitivities=level)
    limits = {"height": (-np.inf, np.inf)}
    expected = {
        True: values.size * np.log(np.var(values[clean])) + 30 * 6.0**2,
        False: values.size * np.log(np.var(values)),
    }
    for robust, deviance in expected.items():
        runs = read_runs(session, *structure.inputs, *structure.outputs, log=tl.LogSettings())
        problem = Problem(structure, runs, {"height": 0.3 * unit})
        optimum = local_optimum(problem, np.array([0.3 * unit]), limits, robust)
        assert optimum.deviance == pytest.approx(deviance, abs=1e-6)


def test_sensitivities_of_its_own_give_the_same_fit():
    def by_hand(run, gain, offset):
        mode = run["mode"]
        return [gain * mode + offset], [np.column_stack([mode, np.ones(mode.size)])]

    names = [tl.Parameter("gain", guess=1.0), tl.Parameter("offset", guess=0.0)]
    exact = tl.Structure("line", names, outputs="p_r", sensitivities=by_hand)
    plain = tl.Structure(
        "line", names, outputs="p_r", simulate=lambda run, gain, offset: gain * run["mode"] + offset
    )
    exact_fit, plain_fit = (
        tl.fit(candidate, session_of(0.003), noise="white") for candidate in (exact, plain)
    )
    for column in ("value", "stderr"):
        np.testing.assert_allclose(
            exact_fit.parameters[column], plain_fit.parameters[column], rtol=1e-8
        )


def test_several_outputs_are_weighted_by_their_own_noise():
    """
    Two measurements of one level, one of them ten times as noisy: the variances add as those of a
    weighted mean.
    """
    rng = np.random.default_rng(5)
    quiet, loud = 0.3 + 0.001 * rng.standard_normal(4000), 0.3 + 0.01 * rng.standard_normal(4000)
    frame = pd.DataFrame({"mode": 1.0, "p_r": quiet, "p_h": loud}, index=T * np.arange(4000))
    level = tl.Structure(
        "level",
        [tl.Parameter("level", 0.0, 1.0)],
        outputs=("p_r", "p_h"),
        simulate=lambda run, level: (np.full(run.size, level), np.full(run.size, level)),
    )
    fit = tl.fit(level, tl.Session(frame), noise="white")
    weights = np.array([1.0 / quiet.var(), 1.0 / loud.var()])
    assert fit.model["level"] == pytest.approx(
        np.average([quiet.mean(), loud.mean()], weights=weights), rel=1e-6
    )
    assert fit.parameters.loc["level", "stderr"] == pytest.approx(
        (4000 * weights.sum()) ** -0.5, rel=1e-3
    )


def test_rates_are_searched_as_time_constants():
    """
    A slow state: in the parameter itself a step of central differences would be as long as 1 − a.
    """
    memory = tl.Structure(
        "memory",
        [tl.Parameter("a", search="rate", guess=0.9)],
        outputs="p_r",
        simulate=lambda run, a: 0.2 + 0.1 * a ** np.arange(run.size),
    )
    frame = pd.DataFrame(
        {"mode": 1.0, "p_r": 0.2 + 0.1 * 0.9999 ** np.arange(9000)}, index=T * np.arange(9000)
    )
    assert 1.0 - tl.fit(memory, tl.Session(frame)).model["a"] == pytest.approx(1e-4, rel=1e-6)


def test_its_derived_rows_carry_their_error():
    structure = tl.Structure(
        "two rates",
        RATES,
        outputs="p_r",
        simulate=two_rates,
        initial=START,
        derived={"sum": lambda at: at["rise"] + at["decay"]},
    )
    fit = tl.fit(structure, session_of(0.003), noise="white")
    assert fit.parameters.loc["sum", "status"] == "derived"
    assert fit.parameters.loc["sum", "stderr"] == pytest.approx(
        np.sqrt(fit.covariance.to_numpy().sum()), rel=1e-9
    )
    rates = {"rise": 0.011, "decay": 0.006}
    assert np.isnan(
        tl.fit(structure, session_of(0.003), fixed=rates).parameters.loc["sum", "stderr"]
    )


# --- standard errors ------------------------------------------------------------------------------


def straight_line(session, noise):
    structure = tl.Structure(
        "line",
        [tl.Parameter("gain", -1.0, 1.0), tl.Parameter("offset", -1.0, 1.0)],
        outputs="p_r",
        simulate=lambda run, gain, offset: gain * run["mode"] + offset,
    )
    return tl.fit(structure, session, noise=noise)


def test_standard_errors_are_those_of_ols():
    """
    With few samples, so that n/(n − p) shows: OLS without and with HAC covariance, its small-sample
    form.
    """
    session = session_of(0.01, samples=60, phase=15)
    line = sm.OLS(session["p_r"], np.column_stack([session["mode"], np.ones(60)]))
    white, robust = (straight_line(session, noise) for noise in ("white", "hac"))
    np.testing.assert_allclose(white.parameters["stderr"], line.fit().bse, rtol=1e-6)
    lags = hac_lags(robust.residuals())
    oracle = line.fit(cov_type="HAC", cov_kwds={"maxlags": lags, "use_correction": True})
    np.testing.assert_allclose(robust.parameters["stderr"], oracle.bse, rtol=1e-6)


def test_a_transfer_function_has_the_same_form_of_robust_errors():
    """
    It lacked n/(n − p). Oracle: the response written out, its Jacobian by central differences,
    statsmodels' HAC sum.
    """
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-0.2, 0.2, 8), 10)

    def response(gain, d, start):
        v, out = start, []
        for command in u:
            out.append(v)
            v = np.exp(-d * T) * v + gain * (1.0 - np.exp(-d * T)) / d * command
        return np.array(out)

    velocity = response(1.0, 0.5, 0.1) + 0.02 * rng.standard_normal(u.size)
    fit = tl.fit_transfer_function(u, velocity, T, order=1, noise="hac")
    estimates = np.r_[fit.parameters["value"], fit.initial_states["velocity_0"]]
    ends = [(estimates + s, estimates - s) for s in 1e-6 * np.diag(np.abs(estimates))]
    J = np.column_stack([(response(*a) - response(*b)) / (a - b).sum() for a, b in ends])
    e = velocity - response(*estimates)
    bread = np.linalg.inv(J.T @ J)
    meat = S_hac_simple(J * e[:, None], nlags=hac_lags([e]))
    expected = u.size / (u.size - 3) * bread @ meat @ bread
    np.testing.assert_allclose(fit.parameters["stderr"], np.sqrt(np.diag(expected))[:2], rtol=1e-4)


# --- the package's own structures -----------------------------------------------------------------


def outputs_of(run, v):
    """P_h and P_r of (2.3), (2.5), (2.6), written out; values may be complex."""
    r = v["r0"]
    p_r = v["p_r0"]
    p_h = []
    out = []
    for m in run["mode"]:
        beta, span = v["human_beta"], v["human_p_max"] - v["human_p_min"]
        shape = cmath.exp(beta * cmath.log(r / beta) + (1 - beta) * cmath.log((1 - r) / (1 - beta)))
        h = v["human_p_min"] + span * shape
        p_h.append(h)
        out.append(p_r)
        gain = (v["robot_p_max"] - v["robot_p_min"]) / v["human_p_max"]
        p_r = v["robot_a"] * p_r + (1 - v["robot_a"]) * (v["robot_p_min"] + gain * m * h)
        r = v["human_a"] * r + (1 - v["human_a"]) * m
    return np.array(p_h), np.array(out)


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


def test_sensitivities_agree_with_complex_steps(operators, make_session):
    run = read_runs(
        make_session(operators["pilot"], np.repeat([1.0, 0.0, 0.5], 200)), "mode", "p_h", "p_r"
    )[0]
    outputs, jacobians = TSC.predict(run, AT)
    for j, expected in enumerate(outputs_of(run, AT)):
        np.testing.assert_allclose(outputs[j], expected.real, rtol=1e-12)
        columns = [TSC.names[k] for k in TSC.columns_of(TSC.outputs[j])]
        for column, name in enumerate(columns):
            slope = outputs_of(run, AT | {name: AT[name] + 1e-100j})[j].imag / 1e-100
            np.testing.assert_allclose(jacobians[j][:, column], slope, rtol=1e-9, atol=1e-12)
    human = {name.removeprefix("human_"): AT[name] for name in TSC.names if name[:5] == "human"} | {
        "r0": 0.3
    }
    (p_h,), (by_human,) = HUMAN.predict(run, human)
    np.testing.assert_array_equal(p_h, outputs[0])
    np.testing.assert_array_equal(by_human, jacobians[0])


def test_the_robot_s_sensitivities_agree_with_central_differences(operators, make_session):
    run = read_runs(
        make_session(operators["pilot"], np.repeat([1.0, 0.0, 0.5], 200)), "mode", "p_h", "p_r"
    )[0]
    structure = robot_structure(0.46)
    plain = tl.Structure(
        "robot",
        structure.parameters,
        structure.outputs,
        simulate=lambda run, **at: structure.predict(run, at)[0][0],
        initial=structure.initial,
        inputs=structure.inputs,
    )
    at = {"a": 0.99, "p_min": 0.24, "p_max": 0.39, "p_r0": 0.3}
    np.testing.assert_allclose(
        plain.predict(run, at)[1][0], structure.predict(run, at)[1][0], rtol=1e-5, atol=1e-7
    )


def test_any_structure_with_a_linear_form_can_be_regressed(operators, make_session, switching):
    model = operators["pilot"]
    session = make_session(model, switching, noise=0.001)
    general = tl.fit(robot_structure(model.robot.p_h_max), session, method="regression")
    # (2.3) as P_r(k+1) = a P_r(k) + b M(k) P_h(k) + c.
    drive = session["mode"] * session["p_h"]
    a1, b, c = tl.arx(session["p_r"], drive, intercept=True).coefficients
    p_min = c / (1.0 + a1)
    p_max = p_min + b / (1.0 + a1) * model.robot.p_h_max
    np.testing.assert_allclose(general.parameters["value"], [-a1, p_min, p_max], rtol=1e-10)
    with pytest.raises(ValueError, match="'two rates' has no linear form"):
        tl.fit(MINE, session, method="regression")


# --- refusals -------------------------------------------------------------------------------------


def refused(says, structure=MINE, session=None, **arguments):
    with pytest.raises(ValueError, match=says):
        tl.fit(structure, session or session_of(), **arguments)


def changed(**fields):
    given = {
        "name": "mine",
        "parameters": RATES,
        "outputs": "p_r",
        "simulate": two_rates,
        "initial": START,
    }
    return tl.Structure(**given | fields)


def test_what_makes_no_structure_is_refused():
    for says, fields in (
        ("must be a sequence of trustlab.Parameter", {"parameters": ["rise"]}),
        ("at least one parameter", {"parameters": []}),
        ("needs a function simulate", {"simulate": None}),
        ("two parameters called 'rise'", {"parameters": [RATES[0], RATES[0]]}),
    ):
        with pytest.raises(ValueError, match=says):
            changed(**fields)
    for says, arguments in (
        ("must be a Python name", {"name": "my rate"}),
        ("low < high", {"name": "rate", "low": 1.0, "high": 0.0}),
        ("low < high", {"name": "rate", "low": np.nan}),
        ("search of rate must be one of", {"name": "rate", "search": "log"}),
        ("guess of rate must lie in", {"name": "rate", "low": 0.0, "high": 1.0, "guess": 2.0}),
    ):
        with pytest.raises(ValueError, match=says):
            tl.Parameter(**arguments)


def test_what_cannot_be_fitted_is_refused():
    refused("structure must be of class Structure, got str; build one with", structure="robot")
    refused("method must be one of", method="pem")
    refused("noise must be one of", noise="pink")
    refused("fixed names 'rize'.*did you mean 'rise'", fixed={"rize": 0.1})
    refused("guess names 'rize'.*did you mean 'rise'", guess={"rize": 0.1})
    refused(
        r"must return p_r in the shapes \[\(3000,\)\]",
        structure=changed(simulate=lambda run, **at: np.ones(7)),
    )
    short = changed(sensitivities=lambda run, **at: ([run["mode"]], [np.ones((3000, 2))]))
    refused(r"derivatives of sensitivities .*\[\(3000, 3\)\], got \[\(3000, 2\)\]", structure=short)
    refused(
        "not finite at rise",
        structure=changed(simulate=lambda run, **at: np.full(run.size, np.nan)),
    )
    refused("speed needs a guess", structure=changed(parameters=[tl.Parameter("speed")]))
    refused("no column 'p_h'", structure=changed(inputs=("mode", "p_h")))
    flat = session_of().with_columns(p_r=np.full(3000, 0.3))
    refused("p_r never moves", session=flat)


def test_a_parameter_without_effect_is_named():
    structure = changed(
        parameters=[*RATES, tl.Parameter("idle", 0.0, 1.0)],
        simulate=lambda run, idle, **at: two_rates(run, **at),
    )
    with pytest.raises(tl.IdentificationError, match="do not determine idle") as caught:
        tl.fit(structure, session_of(0.003))
    assert caught.value.parameters == ("idle",)
