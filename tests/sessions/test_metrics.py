"""(2.4), (2.7), Section 2.4.2 and (3.26)-(3.27) against plain loops and printed values."""

import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

import trustlab as tl
from trustlab.sessions import metrics


@given(st.integers(1, 40), st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_window_mean_is_the_plain_loop(window, n, seed):
    values = np.random.default_rng(seed).normal(size=n)
    expected = [values[max(0, k - window + 1) : k + 1].mean() for k in range(n)]
    np.testing.assert_allclose(metrics.window_mean(values, 0.1, window * 0.1), expected, atol=1e-12)


@pytest.mark.parametrize(("speed", "error", "printed"), [(0.49, 0.38, 0.397), (0.39, 0.704, 0.253)])
def test_speed_near_the_path_is_that_of_remark_7(speed, error, printed):
    value = metrics.goal_speed(np.full(5, speed * 0.1), np.full(5, error), 0.1)
    assert np.round(value, 3) == pytest.approx(printed)


def ground(n=300, seed=0):
    rng = np.random.default_rng(seed)
    columns = {
        "mode": np.ones(n),
        "step_distance": rng.random(n) * 0.05,
        "path_error": rng.random(n) * 2.0,
        "v_command": rng.normal(size=n),
        "w_command": rng.normal(size=n),
    }
    return tl.Session(pd.DataFrame(columns, index=pd.Index(np.arange(n) * 0.1, name="t")))


def test_ground_robot_measures_are_the_printed_sums():
    session = ground()
    measured = session.with_performance(window=10.0)
    k, w = 250, 100
    own = slice(k - w + 1, k + 1)
    near = (2.0 - session["path_error"][own]) / 2.0
    p_r = np.sum(session["step_distance"][own] / 0.1 * near) / w
    p_h = (
        np.sum(
            session["v_command"][own] * near
            + np.abs(session["w_command"][own]) * session["path_error"][own] / 2
        )
        / w
    )
    assert measured["p_r"][k] == pytest.approx(p_r, abs=1e-12)
    assert measured["p_h"][k] == pytest.approx(p_h, abs=1e-12)
    assert measured.metadata.more["performance"] == "(2.4), (2.7), window 10 s"
    # A window longer than the session uses what there is.
    np.testing.assert_allclose(
        session.with_performance(window=100.0)["p_r"][-1],
        np.mean(session["step_distance"] / 0.1 * (1 - session["path_error"] / 2)),
    )


def arm(n=50, seed=1, **extra):
    rng = np.random.default_rng(seed)
    columns = {"mode": rng.random(n), "path_error": rng.random(n)}
    for stem in ("u_h", "u_a", "u_i", "reference", "robot"):
        columns |= {f"{stem}_{axis}": rng.normal(size=n) for axis in "xyz"}
    return tl.Session(pd.DataFrame(columns | extra, index=pd.Index(np.arange(n) * 0.1, name="t")))


def test_uav_measures_and_the_printed_deviation():
    session = arm()
    measured = session.with_performance(window=0.1, measure="uav_tracking", e_max=2.0, u_max=3.0)
    off = sum(abs(session[f"u_i_{axis}"] - session[f"u_h_{axis}"]) for axis in "xyz")
    np.testing.assert_allclose(measured["p_r"], (2.0 - session["path_error"]) / 2.0, atol=1e-12)
    np.testing.assert_allclose(measured["p_h"], 1 - off / 3.0, atol=1e-12)
    u_h, u_i = np.array([[0.0, 0.0], [0.5, 0.0]]), np.array([[1.0, 1.0], [0.5, 0.0]])
    # As printed the measure grows with the deviation; as a quality it falls.
    np.testing.assert_allclose(metrics.command_deviation(u_h, u_i, 4.0), [0.5, 0.0])
    np.testing.assert_allclose(metrics.command_quality(u_h, u_i, 4.0), [0.5, 1.0])


def test_mixed_initiative_measures_are_3_27():
    session = arm()
    measured = session.with_performance(
        window=0.1, measure="mixed_initiative", e_max=9.0, u_max=8.0, axes="yz"
    )
    alpha = session["mode"]

    def norm(a, b):
        return sum(abs(session[f"{a}_{axis}"] - session[f"{b}_{axis}"]) for axis in "yz")

    e = norm("reference", "robot")
    np.testing.assert_allclose(
        measured["p_r"], (1 - norm("u_a", "u_i") / 8) * (1 - (1 - alpha) * e / 9), atol=1e-12
    )
    np.testing.assert_allclose(
        measured["p_h"], (1 - norm("u_h", "u_i") / 8) * (1 - alpha * e / 9), atol=1e-12
    )


def test_nothing_is_clipped():
    assert metrics.nearness([3.0], 2.0)[0] == -0.5


@pytest.mark.parametrize(
    ("session", "arguments", "says"),
    [
        (arm(), {}, "no column 'step_distance'"),
        (ground(), {"measure": "speed"}, "measure must be one of .*got 'speed'"),
        (ground(), {"e_max": 0.0}, "must be positive"),
        (ground(), {"window": 0.01}, "shorter than one sample"),
        (ground(), {"u_max": 1.0}, "not used by"),
        (arm(), {"measure": "uav_tracking"}, "needs e_max"),
        (ground(), {"measure": "uav_tracking", "e_max": 1.0, "u_max": 1.0}, "no column 'u_h_x'"),
    ],
)
def test_refuses(session, arguments, says):
    with pytest.raises(ValueError, match=says):
        session.with_performance(**arguments)


def test_negative_distance_is_refused():
    with pytest.raises(ValueError, match=r"cannot be negative.*sample 1"):
        metrics.nearness([0.1, -0.1], 2.0)


def trial(number, block, level, error, training=False, participant=1):
    more = {"trial": number, "block": block, "autonomy": level, "training": training}
    data = pd.DataFrame(
        {"path_error": np.full(4, error)}, index=pd.Index(np.arange(4) * 0.1, name="t")
    )
    return tl.Session(data, tl.Metadata(participant=participant, more=more))


def test_tracking_error_leaves_out_training_and_the_first_trial():
    trials = [
        trial(1, 0, 0.0, 9.0, training=True),
        trial(6, 1, 0.4, 5.0),
        trial(8, 1, 0.4, 0.01),
        trial(7, 1, 0.4, 0.03),
        trial(11, 2, 0.8, 5.0),
        trial(12, 2, 0.8, 0.05),
    ]
    table = tl.sessions.tracking_error(trials[::-1])
    assert list(table.columns) == ["participant", "autonomy", "traj_err"]
    np.testing.assert_allclose(table["traj_err"], [2.0, 5.0])
    np.testing.assert_allclose(
        tl.sessions.tracking_error(trials, drop_first=0)["traj_err"], [168.0, 252.5]
    )


def test_what_the_dissertation_takes_is_the_default():
    """Chapter 2: a window of 100 s and e_max = 2 m; IDLE is 1 cm/s or 0.01 rad/s."""
    session = ground(1100)
    stated = session.with_performance(window=100.0, e_max=2.0)
    assert session.with_performance() == stated
    assert metrics.with_performance(session) == stated
    e, v, w = (session[name] for name in ("path_error", "v_command", "w_command"))
    np.testing.assert_array_equal(metrics.manoeuvring(v, w, e), metrics.manoeuvring(v, w, e, 2.0))
    d = session["step_distance"]
    np.testing.assert_array_equal(metrics.goal_speed(d, e, 0.1), metrics.goal_speed(d, e, 0.1, 2.0))
    assert metrics.IDLE == 1e-2


def test_mixed_initiative_takes_alpha_before_mode():
    alpha = np.linspace(0.0, 1.0, 50)
    scales = {"window": 0.1, "measure": "mixed_initiative", "e_max": 9.0, "u_max": 8.0}
    both, alone = arm(alpha=alpha), arm(mode=alpha)
    for name in ("p_r", "p_h"):
        np.testing.assert_array_equal(
            both.with_performance(**scales)[name], alone.with_performance(**scales)[name]
        )
    for scale in ("e_max", "u_max"):
        with pytest.raises(ValueError, match=r"needs e_max .* and u_max"):
            alone.with_performance(**{**scales, scale: None})


@pytest.mark.parametrize("shape", [(50,), (50, 3, 1), (49, 3)])
def test_commands_of_another_shape_are_refused(shape):
    with pytest.raises(ValueError, match=r"both have shape \(N, axes\)"):
        metrics.command_quality(np.zeros(shape), np.zeros((50, 3)), 1.0)
    if len(shape) != 2:
        with pytest.raises(ValueError, match=r"both have shape \(N, axes\)"):
            metrics.command_quality(np.zeros(shape), np.zeros(shape), 1.0)


def test_tracking_error_names_the_first_that_has_no_trial_left():
    trials = [trial(k, 1, level, 1.0, participant=p) for p, k, level in ((2, 6, 0.4), (1, 7, 0.8))]
    with pytest.raises(tl.SessionError, match=r"participant 1, autonomy 0\.8: no trial is left"):
        tl.sessions.tracking_error(trials)
    twice = [trial(k, 1, 0.4, 1.0, participant=p) for p, k in ((2, 6), (2, 6), (1, 7), (1, 7))]
    with pytest.raises(tl.SessionError, match="trial 6 of participant 2 occurs twice"):
        tl.sessions.tracking_error(twice)


def test_tracking_error_of_one_session_and_of_none():
    one = trial(6, 1, 0.4, 0.05)
    assert tl.sessions.tracking_error(one, drop_first=0)["traj_err"].tolist() == [5.0]
    with pytest.raises(tl.SessionError, match="none was given"):
        tl.sessions.tracking_error([])


def test_tracking_error_refuses():
    with pytest.raises(tl.SessionError, match="no trial"):
        tl.sessions.tracking_error([trial(1, 0, 0.0, 9.0, training=True)])
    with pytest.raises(tl.SessionError, match="trial 6 of participant 1 occurs twice"):
        tl.sessions.tracking_error([trial(6, 1, 0.4, 5.0), trial(6, 1, 0.4, 5.0)])
    with pytest.raises(tl.SessionError, match="no trial is left"):
        tl.sessions.tracking_error([trial(6, 1, 0.4, 5.0)])
    bare = tl.Session(trial(6, 1, 0.4, 5.0).data, tl.Metadata(participant=1))
    with pytest.raises(tl.SessionError, match="metadata 'autonomy' is missing"):
        tl.sessions.tracking_error([bare])


def test_real_tracking_error_is_the_published_one():
    folder = tl.sessions.external_data("autonomy_cl_trust")
    if folder is None:
        pytest.skip("needs the sessions of AutonomyCLTrust (docs/reports.md): TRUSTLAB_DATA=folder")
    sessions = tl.read_sessions(folder, recipe="autonomy_cl_trust")
    theirs = pd.read_csv(folder / "measures" / "traj_err_all_levels.csv")
    both = tl.sessions.tracking_error(sessions).merge(
        theirs,
        left_on=["participant", "autonomy"],
        right_on=["pid", "autonomy"],
        suffixes=("", "_theirs"),
    )
    assert len(both) == 40
    np.testing.assert_allclose(both["traj_err"], both["traj_err_theirs"], rtol=0, atol=1e-9)


def test_a_window_longer_than_the_log_is_told():
    columns = {
        "mode": 1.0,
        "path_error": 0.0,
        "step_distance": 0.01,
        "v_command": 0.1,
        "w_command": 0.0,
    }
    session = tl.Session(pd.DataFrame(columns, index=0.1 * np.arange(50)))
    with pytest.warns(UserWarning, match=r"lasts 4\.9 s, less than the window of 100 s"):
        session.with_performance()


def test_commands_that_rest_while_the_robot_drives_are_told():
    """Half of the autonomous samples at rest is the limit; manual rests and noise are no cause."""
    t = 0.1 * np.arange(2000)
    mode = (t // 20 % 2).astype(float)
    columns = {"mode": mode, "path_error": 0.1, "step_distance": 0.02, "w_command": 0.0}
    noise = np.random.default_rng(0).uniform(-5e-3, 5e-3, t.size)

    def computed(command):
        frame = pd.DataFrame({**columns, "v_command": command}, index=t)
        return tl.Session(frame).with_performance(window=10.0)

    with pytest.warns(UserWarning, match=r"zero in 100 % of the autonomous phases.*fit_robot"):
        computed(0.2 * mode + noise)
    quarter = np.arange(t.size) % 4 == 0
    with pytest.warns(UserWarning, match="zero in 75 % of the autonomous phases"):
        computed(np.where((mode == 0) & ~quarter, 0.0, 0.2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        columns["w_command"] = np.where(mode == 0, metrics.IDLE, 0.1)  # no longer at rest
        computed(0.2 * mode)
        columns["w_command"] = 0.0
        computed(np.full(t.size, 0.2))
        computed(np.zeros(t.size))
        computed(np.where((mode == 0) & (t % 10 < 4.5), 0.0, 0.2))
        half = np.arange(t.size) % 2 == 0
        computed(np.where((mode == 0) & half, 0.0, 0.2))
        computed(np.where((mode == 0) | half, 0.0, 0.2))
        columns["mode"] = np.where(mode == 0, 0.5, 1.0)  # half of the control is not autonomous
        computed(0.2 * mode)
        computed(np.full(t.size, 0.01))
