"""
Data that cannot tell a parameter: it is named, its interval is wide, or the fit refuses with the
reason.
"""

import re
from types import SimpleNamespace

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark
from scipy.signal import lfilter

import trustlab as tl
from tests.cases import refused
from tests.identification.cases import (
    NOISE,
    PILOT,
    SWITCHING,
    log,
    scores,
    session,
    truth,
    undetermined,
)
from trustlab import fit as fit_model, fit_human, fit_robot, fit_tsc, sample_posterior
from trustlab.identification import HUMAN, ROBOT


def statuses(fit, *names):
    return set(fit.table()["status"][[*names]])


@mark.parametrize("column", ["mode", "p_h", "p_r"])
@mark.parametrize("fit", [fit_robot, fit_tsc])
def test_a_column_that_never_moves_is_refused(fit, column):
    flat = session().with_columns(**{column: np.full(SWITCHING.size, 0.4)})
    with undetermined(f"{column} never (changes|moves)") as caught:
        fit(flat)
    assert any(name.endswith("p_max") for name in caught.value.parameters)


@mark.parametrize("mode_delay", [False, True])
def test_what_an_error_of_fit_robot_recommends_lets_the_rest_be_found(mode_delay):
    """All manual: with p_min known, a and p_max follow from the rise."""
    robot, manual = PILOT.robot, session(np.ones(5000), 0.0, p_r0=0.25)
    with undetermined(r"fixed=\{'p_min': ...\}") as caught:
        fit_robot(manual, mode_delay=mode_delay)
    assert caught.value.parameters == ("p_min", "p_max")
    fit = fit_robot(manual, p_h_max=robot.p_h_max, fixed={"p_min": robot.p_min})
    assert (fit.model.a, fit.model.p_max) == approx((robot.a, robot.p_max), rel=1e-6)
    row = fit.table().loc["p_min"]
    assert (row["status"], row["value"]) == ("fixed", robot.p_min)
    assert np.isnan(row["stderr"])


@mark.parametrize(
    ("mode", "r0", "weak"),
    [
        (np.zeros(3000), 0.0, ["a", "beta", "p_max"]),
        (np.tile([1, 0], 5000), 0.5, ["beta", "p_min"]),
    ],
    ids=["at rest", "one half"],
)
def test_utilization_that_hardly_moves_hides_the_curve(mode, r0, weak):
    fit = fit_human(session(mode, r0=r0))
    assert not fit.success
    assert statuses(fit, *weak) == {"weak"}


def test_an_operator_who_is_not_determined_is_named_in_the_fit_of_the_robot():
    """Half a minute each way: the greatest performance is anyone's guess."""
    fit = fit_robot(session(np.repeat([1.0, 0.0], 300), 0.006))
    assert not fit.success
    assert "human_beta is weakly determined" in fit.message
    assert not any(name.startswith("human") for name in fit.table().index)


def test_rounding_to_zero_is_no_error_of_the_user():
    short = session().between(0.0, 300.0)
    with np.errstate(all="raise"):
        assert fit_tsc(short).degrees_of_freedom > 0.0
        assert len(sample_posterior(short, n=100)) == 100


def test_a_robot_that_is_better_alone_contradicts_the_model():
    clean = session(noise=0.001)
    with undetermined(r"does not rise .* \(is mode 1 there\?\)"):
        fit_robot(clean.with_columns(p_r=0.7 - clean["p_r"]))


def test_an_autonomous_robot_with_a_known_p_min_says_nothing_of_p_max():
    fixed = {"robot_p_min": PILOT.robot.p_min}
    with undetermined("do not determine robot_p_max: mode never"):
        fit_tsc(session(np.zeros(3000)), fixed=fixed)


def test_ranges_that_give_no_weights_are_refused_where_these_are_returned():
    """TSC needs them, a robot does not."""
    noisy = session()
    lower = noisy.with_columns(p_r=noisy["p_r"] - 0.5)
    with undetermined("give no a_T and b_T") as caught:
        fit_tsc(lower)
    assert "robot_p_min" in caught.value.parameters
    above, below = (fit_robot(each).model for each in (noisy, lower))
    assert (below.a, below.p_min) == approx((above.a, above.p_min - 0.5), abs=1e-4)


@mark.parametrize(
    ("fit", "says", "arguments"),
    [
        (fit_robot, r"^p_h_max, .*is 0\.4, but the measured p_h is .*median", {"p_h_max": 0.4}),
        (fit_robot, "give it in this unit", {"p_h_max": 1000.0}),
        (fit_robot, "p_h_max is given twice", {"p_h_max": 0.46, "fixed": {"p_h_max": 0.6}}),
        (
            fit_robot,
            "or bounds rule it out: the fit has p_max = 0.3, not above p_min = 0.6",
            {"bounds": {"p_min": (0.6, 0.9), "p_max": (0.1, 0.3)}},
        ),
        (fit_human, r"partly within \[1e-09, 1\], got", {"bounds": {"beta": (1.5, 2.0)}}),
        (fit_human, "both fixed and bound", {"fixed": {"a": 0.9}, "bounds": {"a": (0.8, 0.95)}}),
        (fit_tsc, "did you mean 'human_a' or 'robot_a'", {"fixed": {"a": 0.99}}),
    ],
)
def test_values_that_cannot_be_held_are_refused_in_the_words_of_the_fit(fit, says, arguments):
    with refused(says):
        fit(session(), **arguments)


def test_bounds_hold_and_are_reported():
    noisy = session()
    fit = fit_human(noisy, bounds={"beta": (None, 0.7)})
    assert fit.model.beta == approx(0.7, abs=1e-12)
    assert statuses(fit, "beta") == {"at bound"}
    assert not fit.success
    assert "beta is at its bound" in fit.message
    for state, low in (("r0", 0.5), ("p_r0", 0.35)):
        bounded = fit_tsc(noisy, bounds={state: (low, None)})
        assert f"{state} = {low}, an end of its range, in 1 of 1 run." in bounded.message


def test_sessions_of_two_sample_times_and_what_holds_a_session_are_refused():
    one = session()
    with undetermined(r"0.1 s and .*0.05 s"):
        fit_robot([one, session(step=0.05)])
    with refused(r"got SimpleNamespace; pass its \.session"):
        fit_robot(SimpleNamespace(session=one))


def test_the_same_samples_do_not_count_twice():
    """Standard errors were 1/√2 of what they are, and one person was a population of two."""
    one, other = session(), session(seed=1)
    again = tl.Session(one.data, one.metadata)
    for call, logs in (
        (fit_tsc, [one, other, again]),
        (tl.fit_population, {"a": [other, one], "b": again}),
    ):
        with undetermined("operator 1, synthetic occurs twice"):
            call(logs)
    assert len(fit_tsc([one, other]).runs) == 2


def test_an_initial_state_at_its_bound_widens_the_intervals():
    """Oracle: fits with r0 held where the likelihood is nearly as great as at the bound."""
    mode = np.repeat([1.0, 0.0] * 4, 1500)
    run, noise = PILOT.simulate(mode, 0.04, 0.24), default_rng([6, 13]).normal(size=(2, mode.size))
    noisy = log(mode=mode, p_h=run["p_h"] + 0.02 * noise[0], p_r=run["p_r"] + 0.02 * noise[1])
    fit = fit_tsc(noisy)
    assert "r0 = 0, an end of its range" in fit.message

    def deviance(fit):
        return mode.size * sum(np.log(np.mean(fit.residuals(y)[0] ** 2)) for y in fit.outputs)

    row = fit.table().loc["human_p_min"]
    held = [fit_tsc(noisy, fixed={"r0": r0}) for r0 in (0.0, 0.001, 0.004, 0.01, 0.02, 0.04)]
    least = deviance(held[0])
    assert deviance(fit) == approx(least, abs=1e-3)
    likely = [each.table().loc["human_p_min"] for each in held if deviance(each) < least + 3.84]
    assert len(likely) > 1
    assert all(row["ci_low"] < each["value"] < row["ci_high"] for each in likely)
    assert row["stderr"] > 1.2 * likely[0]["stderr"]


def test_trials_without_a_change_of_mode_are_named():
    trials = [session(np.full(100, share), seed=i) for i, share in enumerate((0.2, 0.4, 0.6, 0.8))]
    with undetermined("mode never changes within any of the 4 runs"):
        fit_tsc(trials)


def test_people_who_share_parameters_and_runs_without_a_change_of_mode_are_remarked_on():
    runs = [
        session(np.full(9000, share), 0.001, r0=r0).with_metadata(participant=person)
        for person, share, r0 in ((1, 1.0, 0.05), (2, 0.0, 0.95))
    ]
    message = fit_human(runs).message
    assert "2 participants share one set of parameters; fit them one by one" in message
    assert "Mode never changes within any run." in message
    alone = fit_human(runs[0].between(0.0, 60.0)).message
    assert "weakly" in alone
    assert "sample_posterior" not in alone  # which refuses it
    assert not re.search("participants|Mode", fit_human([session(), session(seed=1)]).message)


def test_an_operator_who_does_not_follow_is_named_and_the_measured_one_drives_the_robot():
    robot, mode = PILOT.robot, np.repeat([1.0, 0.0] * 3, 1000)
    p_h = 0.4 + 0.05 * np.sin(0.005 * np.pi * np.arange(mode.size))
    noise = NOISE * default_rng(0).standard_normal((2, mode.size))
    p_r = robot.simulate(mode, p_h, 0.24) + noise[1]
    noisy = log(mode=mode, p_h=p_h + noise[0], p_r=p_r)
    joint = fit_robot(noisy, p_h_max=robot.p_h_max)
    assert not joint.success
    assert "The residuals of p_h are not white" in joint.message
    assert "driven by the measured p_h" in joint.message
    driven = fit_model(ROBOT, noisy, fixed={"p_h_max": robot.p_h_max})
    assert driven.success, driven.message
    expected = truth(who="robot")[["a", "p_min", "p_max"]]
    assert scores([driven.table()], expected)[0].abs().max(axis=None) < 4.0


def test_noise_and_robust_act_on_the_operator_of_fit_robot():
    noisy = session(seed=1)
    dropouts = noisy.with_columns(p_h=noisy["p_h"] * (abs(noisy.t - 310.0) > 10.0))
    kept, left_out = (fit_robot(dropouts, robust=robust).model for robust in (False, True))
    assert abs(kept.p_h_max - left_out.p_h_max) > 1e-3
    ways = "white", "hac"
    errors = [fit_robot(noisy, noise=way).table()["stderr"]["p_h_max"] for way in ways]
    joint = [fit_tsc(noisy, noise=way).table()["stderr"]["human_p_max"] for way in ways]
    assert errors == approx(joint, rel=1e-6)
    assert errors[0] != errors[1]


def test_a_message_has_the_intervals_of_its_table():
    """Slow noise leaves few degrees of freedom, where t intervals are far wider than ±1.96."""
    slow = lfilter([0.001], [1.0, -0.99], default_rng(1).standard_normal(3000))
    short = session(SWITCHING[:3000])
    fit = fit_human(short.with_columns(p_h=short["p_h"] + slow), noise="correlated")
    weak = fit.table().query("status == 'weak'")
    assert fit.degrees_of_freedom < 20
    assert len(weak)
    for row in weak.itertuples():
        assert f"({row.value:.4g} ± {row.ci_high - row.value:.2g})" in fit.message


def test_as_many_unknowns_as_values_are_weak():
    def line(run, level, slope):
        return level + slope * run.t

    model = tl.Model(["level", "slope"], (), "p_r", [0.0, -1.0], [1.0, 1.0], simulate=line)
    fit = fit_model(model, log(mode=np.ones(2), p_r=[0.30, 0.31]))
    assert not fit.success
    assert statuses(fit, "level", "slope") == {"weak"}


def test_a_range_that_is_open_at_one_end_is_no_measure_of_the_other():
    values = {"a": 0.99, "beta": 0.7, "p_min": -1588.0, "p_max": 1.5}
    assert HUMAN.useful(values)["p_max"] == 0.75
