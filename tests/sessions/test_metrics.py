"""(2.4), (2.7), Section 2.4.2 and (3.26)-(3.27) against plain loops and printed values."""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.sessions import metrics


def drive(n=1100, seed=0, **columns):
    rng = np.random.default_rng(seed)
    drawn = {
        "mode": np.ones(n),
        "step_distance": rng.random(n) * 0.05,
        "path_error": rng.random(n) * 2.0,
        "v_command": rng.normal(size=n),
        "w_command": rng.normal(size=n),
    }
    return tl.Session(pd.DataFrame(drawn | columns, index=0.1 * np.arange(n)))


@pytest.mark.parametrize(
    ("options", "window", "e_max"),
    [({}, 1000, 2.0), ({"window": 0.26}, 3, 2.0), ({"window": 0.1, "e_max": 3.0}, 1, 3.0)],
)
def test_ground_robot_measures_are_the_printed_sums(options, window, e_max):
    """
    Chapter 2 takes a window of 100 s and e_max = 2 m, which are the defaults. What is noted is the
    window that was used, not one that is no whole number of samples.
    """
    session = drive()
    measured = session.with_performance(**options)
    d, e, v, w = (session[name] for name in session.columns[1:])
    for k in (0, 2, 3, 250, 999, 1000, 1099):
        samples = range(max(0, k - window + 1), k + 1)
        p_r = sum(d[i] / 0.1 * (e_max - e[i]) / e_max for i in samples) / len(samples)
        p_h = sum(v[i] * (e_max - e[i]) / e_max + abs(w[i]) * e[i] / e_max for i in samples)
        assert measured["p_r"][k] == pytest.approx(p_r, abs=1e-12)
        assert measured["p_h"][k] == pytest.approx(p_h / len(samples), abs=1e-12)
    note = f"(2.4), (2.7), window {window / 10:g} s"
    facts = {"performance": note, "performance_window": window / 10}
    assert dict(measured.metadata.more) == facts
    assert metrics.with_performance(session, **options) == measured


def arm(n=50, **extra):
    rng = np.random.default_rng(1)
    columns = {"mode": rng.random(n), "path_error": rng.random(n)}
    for stem in ("u_h", "u_a", "u_i", "reference", "robot"):
        columns |= {f"{stem}_{axis}": rng.normal(size=n) for axis in "xyz"}
    return tl.Session(pd.DataFrame(columns | extra, index=0.1 * np.arange(n)))


def norm(session, first, second, axes="xyz"):
    return sum(abs(session[f"{first}_{axis}"] - session[f"{second}_{axis}"]) for axis in axes)


def test_uav_measures():
    session = arm()
    measured = session.with_performance(window=0.1, measure="uav_tracking", e_max=2.0, u_max=3.0)
    np.testing.assert_allclose(measured["p_r"], (2.0 - session["path_error"]) / 2.0, atol=1e-12)
    quality = 1 - norm(session, "u_i", "u_h") / 3.0  # not clipped where it is negative
    np.testing.assert_allclose(measured["p_h"], quality, atol=1e-12)
    assert measured["p_h"].min() < 0.0
    assert measured.metadata.more["performance"] == "Section 2.4.2.4, window 0.1 s"


def test_mixed_initiative_measures_are_3_27():
    """Where both shares are negative, so that their product is positive, nothing is good."""
    alpha = np.linspace(0.0, 1.0, 50)
    scales = {"window": 0.1, "measure": "mixed_initiative", "e_max": 0.9, "u_max": 2.0}
    session = arm(mode=alpha)
    measured = session.with_performance(axes="yz", **scales)
    e = norm(session, "reference", "robot", "yz")
    for name, command, share in (("p_r", "u_a", 1 - alpha), ("p_h", "u_h", alpha)):
        quality, near = 1 - norm(session, command, "u_i", "yz") / 2.0, 1 - share * e / 0.9
        expected = np.maximum(quality, 0.0) * np.maximum(near, 0.0)
        np.testing.assert_allclose(measured[name], expected, atol=1e-12)
        assert expected.any()
        assert ((quality < 0.0) & (near < 0.0)).any()
    assert measured.metadata.more["performance"] == "(3.26), (3.27), window 0.1 s"
    # α comes before the mode.
    both = arm(alpha=alpha).with_performance(**scales)
    assert both["p_r"].tolist() == session.with_performance(**scales)["p_r"].tolist()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axes": "yz"}, r"u_max and axes are not used by \(2.4\)"),
        ({"e_max": -1.0}, "e_max must be positive"),
        ({"measure": "uav_tracking", "e_max": 1.0, "u_max": 0.0}, "u_max must be positive"),
    ],
)
def test_scales_are_named_and_those_without_effect_refused(change, words):
    with pytest.raises(ValueError, match=words):
        arm().with_performance(window=0.1, **change)


MODE = np.arange(2000) // 200 % 2
QUARTER = np.arange(2000) % 4 == 0
NOISE = np.random.default_rng(0).uniform(-5e-3, 5e-3, 2000)


@pytest.mark.parametrize(
    ("v", "w", "mode", "share"),
    [
        (0.2 * MODE + NOISE, 0.0, MODE, 100),
        (np.where(MODE | QUARTER, 0.2, 0.0), 0.0, MODE, 75),
        (0.2 * MODE, np.where(MODE, 0.1, 0.01), MODE, None),  # 0.01 rad/s is a command
        (0.0, 0.0, MODE, None),  # a rest by hand as well
        (0.2 * MODE, 0.0, 0.5 + 0.5 * MODE, None),  # half of the control is not autonomous
    ],
)
def test_commands_that_rest_while_the_robot_drives_are_told(recwarn, v, w, mode, share):
    moved = {"path_error": 0.1, "step_distance": 0.02}
    session = drive(2000, v_command=v + 0.0 * MODE, w_command=w, mode=mode, **moved)
    session.with_performance(window=10.0)
    words = [str(each.message) for each in recwarn]
    assert len(words) == (share is not None)
    if share:
        assert f"commands are zero in {share} % of the autonomous phases" in words[0]
        assert "fit the robot alone, driven by the measured P_h" in words[0]


def trial(number, block, level, error, training=False, participant=1):
    more = {"trial": number, "block": block, "autonomy": level, "training": training}
    data = pd.DataFrame({"path_error": error}, index=0.1 * np.arange(4))
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
    every = tl.sessions.tracking_error(trials, drop_first=0)
    np.testing.assert_allclose(every["traj_err"], [168.0, 252.5])
    assert tl.sessions.tracking_error(trials[1], drop_first=0)["traj_err"].tolist() == [500.0]
    with pytest.raises(tl.SessionError, match="trial 6 of participant 1 occurs twice"):
        tl.sessions.tracking_error([*trials, trials[1]])


def test_signals_of_unequal_length_are_refused():
    """One sample was taken for all."""
    three, one = np.ones(3), np.ones(1)
    for call in (
        lambda: metrics.goal_speed(one, three, 0.1),
        lambda: metrics.manoeuvring(one, three, three),
        lambda: metrics.mixed_initiative(*[np.ones((3, 2))] * 4, one, 1.0, 1.0),
    ):
        with pytest.raises(ValueError, match="must have 3 samples, got 1"):
            call()
    with pytest.raises(ValueError, match=r"got \(3, 2\) and \(3, 1\)"):
        metrics.command_quality(np.ones((3, 2)), np.ones((3, 1)), 1.0)


def test_trials_are_ordered_by_their_numbers_and_training_is_true_or_false():
    """Trial "10" was dropped as the first, before "2"; "no" was training."""
    trials = [trial(number, 1, 0.0, error) for number, error in (("10", 0.01), ("2", 0.09))]
    assert tl.sessions.tracking_error(trials)["traj_err"].tolist() == [1.0]
    with pytest.raises(tl.SessionError, match="'training' must be true or false, got 'no'"):
        tl.sessions.tracking_error([trials[0].with_metadata(training="no")])


@pytest.mark.parametrize("axes", ["", "yy", "w"])
def test_axes_are_some_of_three(axes):
    """Without any the operator was perfect."""
    with pytest.raises(ValueError, match="axes must be some of 'xyz'"):
        metrics.with_performance(trial(1, 1, 0.0, 1.0), measure="uav_tracking", axes=axes)
