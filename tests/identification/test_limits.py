"""
Data that cannot tell a parameter: it is named, its interval is wide, or the fit refuses with the
reason.
"""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.identification import IdentificationError


@pytest.mark.parametrize("value", [0.0, 1.0, 0.4])
@pytest.mark.parametrize("fit", [tl.fit_robot, tl.fit_tsc])
def test_a_mode_that_never_changes_is_refused(operators, make_session, fit, value):
    session = make_session(operators["pilot"], np.full(5000, value), noise=0.003)
    with pytest.raises(IdentificationError, match="mode never changes") as caught:
        fit(session)
    assert any(name.endswith("p_max") for name in caught.value.parameters)


def test_fixing_what_is_missing_lets_the_rest_be_found(operators, make_session):
    # All manual: with p_min known, a and p_max follow from the rise.
    model = operators["pilot"]
    session = make_session(model, np.ones(5000), p_r0=0.25)
    fit = tl.fit_robot(session, p_h_max=model.robot.p_h_max, fixed={"p_min": model.robot.p_min})
    assert fit.model.a == pytest.approx(model.robot.a, rel=1e-6)
    assert fit.model.p_max == pytest.approx(model.robot.p_max, rel=1e-6)
    row = fit.table().loc["p_min"]
    assert row["status"] == "fixed"
    assert np.isnan(row["stderr"])
    assert row["value"] == model.robot.p_min


def test_a_rested_operator_who_never_works_tells_nothing(operators, make_session):
    session = make_session(operators["pilot"], np.zeros(3000), noise=0.003, r0=0.0)
    fit = tl.fit_human(session)
    assert not fit.success
    assert fit.table().loc[["a", "beta", "p_max"], "status"].eq("weak").all()
    exact = make_session(operators["pilot"], np.zeros(3000), r0=0.0)
    with pytest.raises(IdentificationError, match="p_h never moves"):
        tl.fit_human(exact)


def test_performance_that_never_moves_is_refused(operators, make_session):
    session = make_session(operators["pilot"], np.repeat([1.0, 0.0], 500))
    flat = session.with_columns(p_h=np.full(1000, 0.4))
    with pytest.raises(IdentificationError, match="p_h never moves") as caught:
        tl.fit_human(flat)
    assert "beta" in caught.value.parameters
    with pytest.raises(IdentificationError, match="p_h_max") as caught:
        tl.fit_robot(flat)
    assert "p_h_max" in caught.value.parameters


def test_utilization_that_hardly_moves_names_beta(operators, make_session):
    # Quick alternation holds r near one half: the curve of (2.6) cannot be seen.
    session = make_session(operators["pilot"], np.tile([1.0, 0.0], 5000), noise=0.003, r0=0.5)
    fit = tl.fit_human(session)
    assert not fit.success
    assert fit.table().loc[["beta", "p_min"], "status"].eq("weak").all()


def test_no_decay_to_see_makes_a_wide_interval(operators):
    # A steady operator and one autonomous phase of two samples: nothing is seen of the decay.
    truth, rng = operators["pilot"].robot, np.random.default_rng(0)
    mode, p_h = np.ones(6000), np.full(6000, 0.44)
    mode[3000:3002] = 0.0
    p_r = truth.simulate(mode, p_h, truth.steady_state(1.0, 0.44)) + 0.003 * rng.standard_normal(
        6000
    )
    frame = pd.DataFrame({"mode": mode, "p_h": p_h, "p_r": p_r}, index=np.arange(6000) * 0.1)
    session = tl.Session(frame)
    with pytest.raises(
        IdentificationError, match=r"driven by the measured p_h: .*identification\.ROBOT"
    ):
        tl.fit_robot(session, p_h_max=0.4602)
    fit = tl.fit(tl.identification.ROBOT, session, fixed={"p_h_max": 0.4602})
    row = fit.table().loc["p_min"]
    assert not fit.success
    assert row["status"] == "weak"
    assert "p_min" in fit.message
    assert row["ci_high"] - row["ci_low"] > 0.1
    assert row["ci_low"] <= truth.p_min <= row["ci_high"]


def test_p_max_is_doubted_with_the_operator_it_refers_to(operators, make_session):
    # Half a minute each way: utilization hardly moves, and the greatest performance is anyone's
    # guess.
    session = make_session(operators["pilot"], np.repeat([1.0, 0.0], 300), noise=0.006)
    fit = tl.fit_robot(session)
    assert not fit.success
    assert "nor on p_max, which refers to it: give p_h_max" in fit.message
    assert fit.table().loc[["p_max", "p_h_max"], "status"].eq("weak").all()


def test_a_robot_that_is_better_alone_contradicts_the_model(operators, make_session, switching):
    session = make_session(operators["pilot"], switching, noise=0.001)
    turned = session.with_columns(p_r=0.7 - session["p_r"])
    with pytest.raises(IdentificationError, match="does not rise under manual control"):
        tl.fit_robot(turned)


def test_bounds_hold_and_are_reported(operators, make_session, switching):
    session = make_session(operators["pilot"], switching, noise=0.003)
    fit = tl.fit_human(session, bounds={"beta": (None, 0.7)})
    assert fit.model.beta == pytest.approx(0.7, abs=1e-12)
    assert fit.table().loc["beta", "status"] == "at bound"
    assert not fit.success
    assert "beta is at its bound" in fit.message
    free = tl.fit_human(session, bounds={"beta": (0.6, 0.9)})
    assert free.model.beta == pytest.approx(tl.fit_human(session).model.beta, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"fixed": {"betta": 0.7}}, "did you mean 'beta'"),
        ({"bounds": {"beta": (1.5, 2.0)}}, "lie outside"),
        ({"fixed": 0.9}, "fixed must be a dictionary"),
        ({"fixed": {"a": 0.9}, "bounds": {"a": (0.8, 0.95)}}, "both fixed and bounded"),
    ],
)
def test_arguments_that_are_not_understood(operators, make_session, switching, arguments, says):
    session = make_session(operators["pilot"], switching[:6000], noise=0.003)
    with pytest.raises(ValueError, match=says):
        tl.fit_human(session, **arguments)


def test_sessions_that_do_not_fit_together(operators, make_session, switching):
    session = make_session(operators["pilot"], switching[:6000])
    faster = make_session(operators["pilot"], switching[:6000], sample_time=0.05)
    with pytest.raises(IdentificationError, match=r"0.1 s and .*0.05 s"):
        tl.fit_robot([session, faster])
    with pytest.raises(IdentificationError, match="no session"):
        tl.fit_robot([])
    with pytest.raises(
        ValueError, match="must be of class Session, got DataFrame; pass a session or"
    ):
        tl.fit_robot([session.data])
    run = SimpleNamespace(session=session)
    for sessions in (run, [run]):
        with pytest.raises(ValueError, match=r"got SimpleNamespace; pass its \.session"):
            tl.fit_robot(sessions)
    with pytest.raises(tl.SessionError, match="no column 'p_h'"):
        tl.fit_human(tl.Session(session.data[["mode", "p_r"]]))
    with pytest.raises(ValueError, match="p_h_max must be positive"):
        tl.fit_robot(session, p_h_max=-1.0)


@pytest.mark.parametrize("level", [0.0, 0.3])
@pytest.mark.parametrize("fit", [tl.fit_robot, tl.fit_tsc])
def test_robot_performance_that_never_moves_is_refused(
    operators, make_session, switching, fit, level
):
    session = make_session(operators["pilot"], switching, noise=0.003)
    with pytest.raises(IdentificationError, match="p_r never moves"):
        fit(session.with_columns(p_r=np.full(switching.size, level)))


def test_an_initial_state_at_its_bound_widens_the_intervals(operators, make_session):
    """Oracle: fits with r0 held where the likelihood is nearly as great as at the bound."""
    mode = np.repeat([1.0, 0.0] * 4, 1500)
    run = operators["pilot"].simulate(mode, 0.04, 0.24)
    rng = np.random.default_rng([6, 13])
    columns = {name: run[name] + 0.02 * rng.normal(size=mode.size) for name in ("p_h", "p_r")}
    frame = pd.DataFrame({"t": 0.1 * np.arange(mode.size), "mode": mode, **columns})
    session = tl.Session(frame.set_index("t"), tl.Metadata(synthetic=True))
    fit = tl.fit_tsc(session)
    assert "r0 = 0, a rested operator" in fit.message

    def deviance(fit):
        return mode.size * sum(np.log(np.mean(fit.residuals(y)[0] ** 2)) for y in fit.outputs)

    row = fit.table().loc["human_p_min"]
    held = [tl.fit_tsc(session, fixed={"r0": r0}) for r0 in (0.0, 0.001, 0.004, 0.01, 0.02, 0.04)]
    least = deviance(held[0])
    assert deviance(fit) == pytest.approx(least, abs=1e-3)
    likely = [each.table().loc["human_p_min"] for each in held if deviance(each) < least + 3.84]
    assert len(likely) > 1
    assert all(row["ci_low"] < each["value"] < row["ci_high"] for each in likely)
    assert row["stderr"] > 1.2 * likely[0]["stderr"]


def test_trials_without_a_change_of_mode_are_named(operators, make_session):
    trials = [
        make_session(operators["pilot"], np.full(100, share), noise=0.003, seed=seed)
        for seed, share in enumerate((0.2, 0.4, 0.6, 0.8))
    ]
    with pytest.raises(IdentificationError, match="mode never changes within any of the 4 runs"):
        tl.fit_tsc(trials)
    long = [
        make_session(operators["pilot"], np.full(9000, share), noise=0.001, r0=r0)
        for share, r0 in ((1.0, 0.05), (0.0, 0.95))
    ]
    assert "Mode never changes within any of the 2 runs" in tl.fit_tsc(long).message


@pytest.mark.parametrize("mode_delay", [False, True])
def test_what_an_error_of_fit_robot_recommends_is_accepted(operators, make_session, mode_delay):
    model = operators["pilot"]
    session = make_session(model, np.ones(5000), p_r0=0.25)
    with pytest.raises(IdentificationError, match=r"fixed=\{'p_min': ...\}") as caught:
        tl.fit_robot(session, mode_delay=mode_delay)
    assert caught.value.parameters == ("p_min", "p_max")
    with pytest.raises(ValueError, match=r"fixed names 'robot_p_min'"):
        tl.fit_robot(session, fixed={"robot_p_min": 0.24}, mode_delay=mode_delay)


def test_an_operator_who_does_not_follow_is_named_and_the_measured_one_drives_the_robot(operators):
    truth, rng = operators["pilot"].robot, np.random.default_rng(0)
    mode = np.repeat([1.0, 0.0] * 3, 1000)
    t = 0.1 * np.arange(mode.size)
    p_h = 0.4 + 0.05 * np.sin(2.0 * np.pi * t / 40.0)
    p_r = truth.simulate(mode, p_h, 0.24)
    noisy = {
        name: values + 0.003 * rng.standard_normal(t.size)
        for name, values in (("p_h", p_h), ("p_r", p_r))
    }
    frame = pd.DataFrame({"mode": mode, **noisy}, index=pd.Index(t, name="t"))
    session = tl.Session(frame, tl.Metadata(synthetic=True))
    joint = tl.fit_robot(session, p_h_max=truth.p_h_max)
    assert not joint.success
    assert "The residuals of p_h are not white" in joint.message
    assert "driven by the measured p_h" in joint.message
    driven = tl.fit(tl.identification.ROBOT, session, fixed={"p_h_max": truth.p_h_max})
    assert driven.success, driven.message
    expected = pd.Series({"a": truth.a, "p_min": truth.p_min, "p_max": truth.p_max})
    assert driven.model.p_max == pytest.approx(truth.p_max, abs=1e-3)
    assert ((driven.table()["value"] - expected) / driven.table()["stderr"]).abs().max() < 4.0


def test_noise_and_robust_act_on_the_operator_of_fit_robot(operators, make_session, switching):
    session = make_session(operators["pilot"], switching, noise=0.003, seed=1)
    p_h = session["p_h"].copy()
    p_h[3000:3200] = 0.0
    dropouts = session.with_columns(p_h=p_h)
    kept, left_out = (tl.fit_robot(dropouts, robust=robust).table() for robust in (False, True))
    assert abs(kept.loc["p_h_max", "value"] - left_out.loc["p_h_max", "value"]) > 1e-3
    white, hac = (tl.fit_robot(session, noise=noise).table() for noise in ("white", "hac"))
    assert white.loc["p_h_max", "stderr"] != hac.loc["p_h_max", "stderr"]
    for noise, table in (("white", white), ("hac", hac)):
        joint = tl.fit_tsc(session, noise=noise).table().loc["human_p_max"]
        assert table.loc["p_h_max", "stderr"] == pytest.approx(joint["stderr"], rel=1e-6)
