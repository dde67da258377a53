"""
Data that cannot tell a parameter: it is named, its interval is wide, or the fit refuses with the
reason.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

import trustlab as tl
from tests.identification.cases import PILOT, SWITCHING, log, scores, session, truth
from trustlab.identification import HUMAN, ROBOT, IdentificationError

ROBOTS_FITS = pytest.mark.parametrize("fit", [tl.fit_robot, tl.fit_tsc])


def statuses(fit, *names):
    return set(fit.table().loc[list(names), "status"])


@pytest.mark.parametrize("value", [0.0, 1.0, 0.4])
@ROBOTS_FITS
def test_a_mode_that_never_changes_is_refused(fit, value):
    with pytest.raises(IdentificationError, match="mode never changes") as caught:
        fit(session(np.full(5000, value)))
    assert any(name.endswith("p_max") for name in caught.value.parameters)


@pytest.mark.parametrize("mode_delay", [False, True])
def test_what_an_error_of_fit_robot_recommends_lets_the_rest_be_found(mode_delay):
    """All manual: with p_min known, a and p_max follow from the rise."""
    robot, manual = PILOT.robot, session(np.ones(5000), 0.0, p_r0=0.25)
    with pytest.raises(IdentificationError, match=r"fixed=\{'p_min': ...\}") as caught:
        tl.fit_robot(manual, mode_delay=mode_delay)
    assert caught.value.parameters == ("p_min", "p_max")
    fit = tl.fit_robot(manual, p_h_max=robot.p_h_max, fixed={"p_min": robot.p_min})
    assert fit.model.a == pytest.approx(robot.a, rel=1e-6)
    assert fit.model.p_max == pytest.approx(robot.p_max, rel=1e-6)
    row = fit.table().loc["p_min"]
    assert (row["status"], row["value"]) == ("fixed", robot.p_min)
    assert np.isnan(row["stderr"])


def test_a_rested_operator_who_never_works_tells_nothing():
    fit = tl.fit_human(session(np.zeros(3000), r0=0.0))
    assert not fit.success
    assert statuses(fit, "a", "beta", "p_max") == {"weak"}


@pytest.mark.parametrize("level", [0.0, 0.4])
@pytest.mark.parametrize("column", ["p_h", "p_r"])
@ROBOTS_FITS
def test_performance_that_never_moves_is_refused(fit, column, level):
    flat = session().with_columns(**{column: np.full(SWITCHING.size, level)})
    with pytest.raises(IdentificationError, match=f"{column} never moves") as caught:
        fit(flat)
    assert "human_beta" in caught.value.parameters


def test_utilization_that_hardly_moves_names_beta():
    """Quick alternation holds r near one half: the curve of (2.6) cannot be seen."""
    fit = tl.fit_human(session(np.tile([1.0, 0.0], 5000), r0=0.5))
    assert not fit.success
    assert statuses(fit, "beta", "p_min") == {"weak"}


def test_an_operator_who_is_not_determined_is_named_in_the_fit_of_the_robot():
    """
    Half a minute each way: utilization hardly moves, and the greatest performance is anyone's
    guess.
    """
    fit = tl.fit_robot(session(np.repeat([1.0, 0.0], 300), 0.006))
    assert not fit.success
    assert "human_beta is weakly determined" in fit.message
    assert not any(name.startswith("human") for name in fit.table().index)


def test_rounding_to_zero_is_no_error_of_the_user():
    short = session().between(0.0, 300.0)
    with np.errstate(all="raise"):
        assert tl.fit_tsc(short).degrees_of_freedom > 0.0
        assert len(tl.sample_posterior(short, n=100)) == 100


def test_a_robot_that_is_better_alone_contradicts_the_model():
    clean = session(noise=0.001)
    with pytest.raises(IdentificationError, match=r"does not rise .* \(is mode 1 there\?\)"):
        tl.fit_robot(clean.with_columns(p_r=0.7 - clean["p_r"]))


def test_an_autonomous_robot_with_a_known_p_min_says_nothing_of_p_max():
    alone = session(np.zeros(3000))
    fixed = {"robot_p_min": PILOT.robot.p_min}
    with pytest.raises(IdentificationError, match="do not determine robot_p_max: mode never"):
        tl.fit_tsc(alone, fixed=fixed)


def test_ranges_that_give_no_weights_are_refused_where_these_are_returned():
    """TSC needs them, a robot does not."""
    noisy = session()
    lower = noisy.with_columns(p_r=noisy["p_r"] - 0.5)
    with pytest.raises(IdentificationError, match="give no a_T and b_T") as caught:
        tl.fit_tsc(lower)
    assert "robot_p_min" in caught.value.parameters
    robots = [tl.fit_robot(each).model for each in (noisy, lower)]
    assert robots[1].p_min == pytest.approx(robots[0].p_min - 0.5, abs=1e-4)
    assert robots[1].a == pytest.approx(robots[0].a, abs=1e-4)


@pytest.mark.parametrize(
    ("fit", "arguments", "says"),
    [
        (tl.fit_robot, {"p_h_max": 0.4}, r"^p_h_max, .*is 0\.4, but the measured p_h is .*median"),
        (tl.fit_robot, {"p_h_max": 1000.0}, "give it in this unit"),
        (tl.fit_robot, {"p_h_max": 0.46, "fixed": {"p_h_max": 0.6}}, "p_h_max is given twice"),
        (
            tl.fit_robot,
            {"fixed": {"b": 0.1}},
            r"fixed names 'b'.*\(a, p_min, p_max, p_h_max,.* p_r0",
        ),
        (
            tl.fit_robot,
            {"bounds": {"p_min": (0.6, 0.9), "p_max": (0.1, 0.3)}},
            "or bounds rule it out: the fit has p_max = 0.3, not above p_min = 0.6",
        ),
        (tl.fit_human, {"bounds": {"beta": (1.5, 2.0)}}, "lie outside"),
        (tl.fit_human, {"fixed": {"a": 0.9}, "bounds": {"a": (0.8, 0.95)}}, "both fixed and bound"),
        (tl.fit_tsc, {"fixed": {"a": 0.99}}, "did you mean 'human_a' or 'robot_a'"),
    ],
)
def test_values_that_cannot_be_held_are_refused_in_the_words_of_the_fit(fit, arguments, says):
    with pytest.raises(ValueError, match=says):
        fit(session(), **arguments)


def test_bounds_hold_and_are_reported():
    fit = tl.fit_human(session(), bounds={"beta": (None, 0.7)})
    assert fit.model.beta == pytest.approx(0.7, abs=1e-12)
    assert statuses(fit, "beta") == {"at bound"}
    assert not fit.success
    assert "beta is at its bound" in fit.message
    for state, low in (("r0", 0.5), ("p_r0", 0.35)):
        bounded = tl.fit_tsc(session(), bounds={state: (low, None)})
        assert f"{state} = {low}, an end of its range, in 1 of 1 run." in bounded.message
    free = tl.fit_human(session(), bounds={"beta": (0.6, 0.9)})
    assert free.model.beta == pytest.approx(tl.fit_human(session()).model.beta, rel=1e-9)


def test_sessions_that_do_not_fit_together():
    one = session()
    run = SimpleNamespace(session=one)
    for sessions, error, says in (
        ([one, session(step=0.05)], IdentificationError, r"0.1 s and .*0.05 s"),
        (run, ValueError, r"got SimpleNamespace; pass its \.session"),
        (one.data, ValueError, r"got DataFrame; pass a session"),
        ({"1": one}, ValueError, r"got dict; pass a session"),
        (log(mode=one["mode"], p_r=one["p_r"]), tl.SessionError, "no column 'p_h'"),
    ):
        with pytest.raises(error, match=says):
            tl.fit_robot(sessions)


def test_the_same_samples_do_not_count_twice():
    """Standard errors were 1/√2 of what they are, and one person was a population of two."""
    one, other = session(), session(seed=1)
    again = tl.Session(one.data, one.metadata)
    for call in (
        lambda: tl.fit_tsc([one, other, again]),
        lambda: tl.sample_posterior([one, again]),
        lambda: tl.fit_population({"a": [other, one], "b": again}),
    ):
        with pytest.raises(IdentificationError, match="operator 1, synthetic occurs twice"):
            call()
    assert len(tl.fit_tsc([one, other]).runs) == 2


def test_an_initial_state_at_its_bound_widens_the_intervals():
    """Oracle: fits with r0 held where the likelihood is nearly as great as at the bound."""
    mode = np.repeat([1.0, 0.0] * 4, 1500)
    run = PILOT.simulate(mode, 0.04, 0.24)
    rng = np.random.default_rng([6, 13])
    noisy = log(
        mode=mode, **{y: run[y] + 0.02 * rng.normal(size=mode.size) for y in ("p_h", "p_r")}
    )
    fit = tl.fit_tsc(noisy)
    assert "r0 = 0, an end of its range" in fit.message

    def deviance(fit):
        return mode.size * sum(np.log(np.mean(fit.residuals(y)[0] ** 2)) for y in fit.outputs)

    row = fit.table().loc["human_p_min"]
    held = [tl.fit_tsc(noisy, fixed={"r0": r0}) for r0 in (0.0, 0.001, 0.004, 0.01, 0.02, 0.04)]
    least = deviance(held[0])
    assert deviance(fit) == pytest.approx(least, abs=1e-3)
    likely = [each.table().loc["human_p_min"] for each in held if deviance(each) < least + 3.84]
    assert len(likely) > 1
    assert all(row["ci_low"] < each["value"] < row["ci_high"] for each in likely)
    assert row["stderr"] > 1.2 * likely[0]["stderr"]


def test_trials_without_a_change_of_mode_are_named():
    trials = [session(np.full(100, share), seed=i) for i, share in enumerate((0.2, 0.4, 0.6, 0.8))]
    with pytest.raises(IdentificationError, match="mode never changes within any of the 4 runs"):
        tl.fit_tsc(trials)


def test_people_who_share_parameters_and_runs_without_a_change_of_mode_are_remarked_on():
    runs = [
        session(np.full(9000, share), 0.001, r0=r0).with_metadata(participant=person)
        for person, share, r0 in ((1, 1.0, 0.05), (2, 0.0, 0.95))
    ]
    message = tl.fit_human(runs).message
    assert "2 participants share one set of parameters; fit them one by one" in message
    assert "Mode never changes within any run." in message
    alone = tl.fit_human(runs[0].between(0.0, 60.0)).message
    assert "weakly" in alone
    assert "sample_posterior" not in alone  # which refuses it
    message = tl.fit_human([session(seed=k) for k in range(2)]).message
    assert "participants" not in message
    assert "Mode" not in message


def test_an_operator_who_does_not_follow_is_named_and_the_measured_one_drives_the_robot():
    robot, rng = PILOT.robot, np.random.default_rng(0)
    mode = np.repeat([1.0, 0.0] * 3, 1000)
    p_h = 0.4 + 0.05 * np.sin(2.0 * np.pi * 0.1 * np.arange(mode.size) / 40.0)
    p_r = robot.simulate(mode, p_h, 0.24)
    noise = 0.003 * rng.standard_normal((2, mode.size))
    noisy = log(mode=mode, p_h=p_h + noise[0], p_r=p_r + noise[1])
    joint = tl.fit_robot(noisy, p_h_max=robot.p_h_max)
    assert not joint.success
    assert "The residuals of p_h are not white" in joint.message
    assert "driven by the measured p_h" in joint.message
    driven = tl.fit(ROBOT, noisy, fixed={"p_h_max": robot.p_h_max})
    assert driven.success, driven.message
    assert driven.model.p_max == pytest.approx(robot.p_max, abs=1e-3)
    expected = truth(who="robot")[["a", "p_min", "p_max"]]
    assert scores([driven.table()], expected)[0].abs().max(axis=None) < 4.0


def test_noise_and_robust_act_on_the_operator_of_fit_robot():
    noisy = session(seed=1)
    p_h = noisy["p_h"].copy()
    p_h[3000:3200] = 0.0
    dropouts = noisy.with_columns(p_h=p_h)
    kept, left_out = (tl.fit_robot(dropouts, robust=robust).model for robust in (False, True))
    assert abs(kept.p_h_max - left_out.p_h_max) > 1e-3
    errors = {}
    for noise in ("white", "hac"):
        errors[noise] = tl.fit_robot(noisy, noise=noise).table().loc["p_h_max", "stderr"]
        joint = tl.fit_tsc(noisy, noise=noise).table().loc["human_p_max", "stderr"]
        assert errors[noise] == pytest.approx(joint, rel=1e-6)
    assert errors["white"] != errors["hac"]


def test_a_message_has_the_intervals_of_its_table():
    """Slow noise leaves few degrees of freedom, where t intervals are far wider than ±1.96."""
    slow = lfilter([0.001], [1.0, -0.99], np.random.default_rng(1).standard_normal(3000))
    short = session(SWITCHING[:3000])
    fit = tl.fit_human(short.with_columns(p_h=short["p_h"] + slow), noise="correlated")
    weak = fit.table().query("status == 'weak'")
    assert fit.degrees_of_freedom < 20
    assert len(weak)
    for row in weak.itertuples():
        assert f"({row.value:.4g} ± {row.ci_high - row.value:.2g})" in fit.message


def test_as_many_unknowns_as_values_are_weak():
    def line(run, level, slope):
        return level + slope * run.t

    model = tl.Model(["level", "slope"], [], "p_r", [0.0, -1.0], [1.0, 1.0], simulate=line)
    fit = tl.fit(model, log(mode=np.ones(2), p_r=np.array([0.30, 0.31])))
    assert not fit.success
    assert fit.table()["status"].eq("weak").all()


def test_a_range_that_is_open_at_one_end_is_no_measure_of_the_other():
    values = {"a": 0.99, "beta": 0.7, "p_min": -1588.0, "p_max": 1.5}
    assert HUMAN.useful(values)["p_max"] == 0.75
