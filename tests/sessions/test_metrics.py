"""(2.4), (2.7), Section 2.4.2 and (3.26)-(3.27) against plain loops and printed values."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from tests.cases import refused
from trustlab.sessions import metrics, tracking_error


def drive(n=1100, **columns):
    rng = np.random.default_rng(0)
    stems = ("u_h", "u_a", "u_i", "reference", "robot")
    names = ["v_command", "w_command", *(f"{stem}_{axis}" for stem in stems for axis in "xyz")]
    drawn = dict(zip(names, rng.normal(size=(17, n)), strict=True))
    drawn |= {"step_distance": rng.random(n) * 0.05, "path_error": rng.random(n) * 2.0}
    return tl.Session(pd.DataFrame({"mode": 1.0, **drawn, **columns}, index=0.1 * np.arange(n)))


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
    d, e = session["step_distance"], session["path_error"]
    v, w = session["v_command"], session["w_command"]
    means = {
        "p_r": d / 0.1 * (e_max - e) / e_max,
        "p_h": v * (e_max - e) / e_max + abs(w) * e / e_max,
    }
    for name, terms in means.items():
        expected = [terms[max(0, k - window + 1) : k + 1].mean() for k in range(1100)]
        assert_allclose(measured[name], expected, rtol=0, atol=1e-12)
    note = f"(2.4), (2.7), window {window / 10:g} s"
    facts = {"performance": note, "performance_window": window / 10}
    assert dict(measured.metadata.more) == facts


def test_means_of_a_part_that_are_computed_again_are_those_of_the_part():
    """A fit refused them still as cut, whose remedy this is."""
    whole = drive()
    again = whole.with_performance(10.0).between(20.0, 60.0).with_performance(10.0)
    assert again == whole.between(20.0, 60.0).with_performance(10.0)


def norm(session, first, second, axes="xyz"):
    return sum(abs(session[f"{first}_{axis}"] - session[f"{second}_{axis}"]) for axis in axes)


def test_uav_measures():
    session = drive()
    measured = session.with_performance(window=0.1, measure="uav_tracking", e_max=2.0, u_max=3.0)
    assert_allclose(measured["p_r"], (2.0 - session["path_error"]) / 2.0, atol=1e-12)
    quality = 1 - norm(session, "u_i", "u_h") / 3.0  # not clipped where it is negative
    assert_allclose(measured["p_h"], quality, atol=1e-12)
    assert measured["p_h"].min() < 0.0
    assert measured.metadata.more["performance"] == "Section 2.4.2.4, window 0.1 s"


def test_mixed_initiative_measures_are_3_27():
    """Where both shares are negative, so that their product is positive, nothing is good."""
    alpha = np.linspace(0.0, 1.0, 1100)
    scales = {"window": 0.1, "measure": "mixed_initiative", "e_max": 0.9, "u_max": 2.0}
    session = drive(alpha=alpha)  # α comes before the mode
    measured = session.with_performance(axes="yz", **scales)
    e = norm(session, "reference", "robot", "yz")
    for name, command, share in (("p_r", "u_a", 1 - alpha), ("p_h", "u_h", alpha)):
        quality, near = 1 - norm(session, command, "u_i", "yz") / 2.0, 1 - share * e / 0.9
        expected = np.maximum(quality, 0.0) * np.maximum(near, 0.0)
        assert_allclose(measured[name], expected, atol=1e-12)
        assert expected.any()
        assert ((quality < 0.0) & (near < 0.0)).any()
    assert measured.metadata.more["performance"] == "(3.26), (3.27), window 0.1 s"
    by_mode = drive(mode=alpha).with_performance(axes="yz", **scales)
    assert by_mode["p_r"].tolist() == measured["p_r"].tolist()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axes": "yz"}, r"u_max and axes are not used by \(2.4\)"),
        ({"e_max": -1.0}, "e_max must be positive"),
        ({"measure": "uav_tracking", "e_max": 1.0, "u_max": 0.0}, "u_max must be positive"),
        # Without any the operator was perfect.
        *(({"measure": "uav_tracking", "axes": axes}, "some of 'xyz'") for axes in ("", "yy", "w")),
    ],
)
def test_scales_are_named_and_those_without_effect_refused(change, words):
    with refused(words):
        drive().with_performance(window=0.1, **change)


MODE = np.arange(2000) // 200 % 2
QUARTER = np.arange(2000) % 4 == 0
NOISE = np.random.default_rng(0).uniform(-5e-3, 5e-3, 2000)


@pytest.mark.parametrize(
    ("v", "w", "mode", "share"),
    [
        (0.2 * MODE + NOISE, 0.0, MODE, 100),
        (np.where(MODE | QUARTER, 0.2, 0.0), 0.0, MODE, 75),
        (0.2 * MODE, np.where(MODE, 0.1, 0.01), MODE, None),  # 0.01 rad/s is a command
        (0.0, 0.0, 0.0 * MODE, 100),  # never by hand
        (0.0, 0.0, MODE, None),  # a rest by hand as well
        (0.2 * MODE, 0.0, 0.5 + 0.5 * MODE, None),  # half of the control is not autonomous
    ],
)
def test_commands_that_rest_while_the_robot_drives_are_told(recwarn, v, w, mode, share):
    moved = {"path_error": 0.1, "step_distance": 0.02}
    drive(2000, v_command=v, w_command=w, mode=mode, **moved).with_performance(window=10.0)
    words = [str(each.message) for each in recwarn]
    assert len(words) == (share is not None)
    for each in words:
        assert f"commands are zero in {share} % of the autonomous phases" in each
        assert "fit the robot alone, driven by the measured P_h" in each


def trial(number, block, level, error, training=False):
    more = {"trial": number, "block": block, "autonomy": level, "training": training}
    data = pd.DataFrame({"path_error": error}, index=0.1 * np.arange(4))
    return tl.Session(data, tl.Metadata(participant=1, more=more))


def test_tracking_error_leaves_out_training_and_the_first_trial():
    """Trial "10" was dropped as the first, before "2"; "no" was training."""
    trials = [
        trial(1, 0, 0.0, 9.0, training=True),
        trial(6, 1, 0.4, 5.0),
        trial("10", 1, 0.4, 0.01),
        trial("7", 1, 0.4, 0.03),
        trial(11, 2, 0.8, 5.0),
        trial(12, 2, 0.8, 0.05),
    ]
    table = tracking_error(trials[::-1])
    assert list(table.columns) == ["participant", "autonomy", "traj_err"]
    assert_allclose(table["traj_err"], [2.0, 5.0])
    assert_allclose(tracking_error(trials[2:4])["traj_err"], [1.0])
    assert_allclose(tracking_error(trials, drop_first=0)["traj_err"], [168.0, 252.5])
    assert tracking_error(trials[1], drop_first=0)["traj_err"].tolist() == [500.0]
    with refused("trial 6 of participant 1 occurs twice"):
        tracking_error([*trials, trials[1]])
    with refused("'training' must be true or false, got 'no'"):
        tracking_error([trials[0].with_metadata(training="no")])


def test_signals_of_unequal_length_are_refused():
    """One sample was taken for all."""
    three, one, commands = np.ones(3), np.ones(1), np.ones((3, 2))
    with refused("step_distance must have 3 samples, got 1"):
        metrics.goal_speed(one, three, 0.1)
    with refused("v_command must have 3 samples, got 1"):
        metrics.manoeuvring(one, three, three)
    with refused("alpha must have 3 samples, got 1"):
        metrics.mixed_initiative(*[commands] * 4, one, 1.0, 1.0)
    with refused(r"got \(3, 2\) and \(3, 1\)"):
        metrics.command_quality(commands, commands[:, :1], 1.0)
