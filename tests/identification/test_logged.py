"""
Fits of what was logged: window means, late or early modes, coarse, sparse, interrupted and
correlated data.

Oracles: the parameters that the data were made with; the mean of the sessions' own room for the
window; a fit with the delay as a parameter.
"""

import importlib
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark
from scipy import signal, stats

import trustlab as tl
from notebooks import noise_settings
from tests.cases import refused
from tests.identification.cases import (
    NOISE,
    PILOT,
    ROOT,
    SWITCHING,
    fits_giving_back,
    log,
    scores,
    session,
    truth,
    undetermined,
)
from trustlab import fit as fit_model, fit_human, fit_tsc
from trustlab.identification import TSC
from trustlab.identification.log import read_runs, undo_window, window_means
from trustlab.identification.problem import Problem, _deviance_with_noise, rough_optima
from trustlab.sessions.metrics import window_mean

STORED = ROOT / "data" / "coverage" / "fits.csv"
TRUTH = truth()


def windowed(window, seed, loop="open", where="before", noise=NOISE):
    """A session of the pilot operator whose performances are means over a window."""
    return noise_settings.windowed(default_rng([seed, 7]), window, loop, where, noise)


# --- the window -----------------------------------------------------------------------------------


@given(st.integers(1, 60), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_window_means_are_those_of_sessions_and_can_be_undone(size, window, seed):
    values = default_rng(seed).standard_normal((3, size))
    means = [window_mean(column, 0.1, 0.1 * window) for column in values]
    assert_allclose(window_means(values.T, window).T, means, atol=1e-12)
    assert_allclose([undo_window(column, window) for column in means], values, atol=1e-10)


@mark.parametrize("window", [10.0, 100.0])
def test_exact_windowed_data_give_the_parameters_back(window):
    exact = windowed(window, 0, noise=0.0)
    fits = fits_giving_back(exact)
    assert all(f"window of {window:g} s" in fit.message for fit in fits.values())
    # What is fitted is the mean that with_performance would have made of the fitted model.
    joint = fits["tsc"]
    run = joint.model.simulate(exact["mode"], *joint.initial_states[["r0", "p_r0"]].iloc[0])
    means = window_mean(run["p_r"], 0.1, window)
    assert_allclose(joint.runs[0].fitted["p_r"], means, atol=1e-9)


def test_a_robot_is_driven_by_what_the_window_averaged():
    fixed = {"p_h_max": PILOT.robot.p_h_max}
    fit = fit_model(tl.identification.ROBOT, windowed(10.0, 0, noise=0.0), fixed=fixed)
    assert fit.model.a == approx(PILOT.robot.a, abs=1e-7)


def test_a_second_valley_as_deep_is_named():
    """
    In closed loop r stays above 0.7: a rested operator with a high p_min explains the rest as well
    as the true one.
    """
    fit = fit_tsc(windowed(30.0, 42, "closed", "after"))
    assert not scores([fit.table()], TRUTH)[1]["human_p_min"].item()
    assert not fit.success
    assert re.search(r"Other values .* as well: .*human_p_min = 0\.\d+ for 0\.42", fit.message)
    # The negative control: phases that move the model leave one valley.
    assert "Other values" not in fit_human(windowed(30.0, 42, "open", "after")).message


def test_how_noise_is_seen_depends_on_no_other_search():
    """Searches of one log wrote to the same buffers, and the noise was fitted to the last one's."""
    runs = read_runs(windowed(30.0, 0), "mode", "p_h", "p_r")
    (best, *_) = rough_optima(TSC, runs, TSC.limits())
    assert best.problem.unwindow
    before = _deviance_with_noise(best)
    best.problem.equations(best.x)
    Problem(TSC, best.problem.runs, TSC.limits(), True).equations(best.x + 0.01)
    assert _deviance_with_noise(best) == approx(before, abs=1e-6)


def test_a_log_of_a_lab_that_says_nothing_of_its_window_is_warned_of_once():
    short, other = (
        session(SWITCHING[:6000], seed=seed).with_metadata(synthetic=False) for seed in (0, 1)
    )
    with pytest.warns(UserWarning, match=r"state window=… \[s\], or window=0") as caught:
        fit_human([short, other])
    assert len(caught) == 1
    assert fit_human(short, window=0.0).success


def test_every_session_says_its_window():
    means = windowed(30.0, 0)
    assert "moving window of 0 s and 30 s, " in fit_human([means, session()]).message
    with undetermined("cut the log first"):
        fit_human(means.between(100.0, 900.0))


def test_a_model_of_ones_own_has_a_window_for_its_performance_alone():
    """An error beside p_r was a mean as well, so that its model changed with the columns."""

    def model(*outputs):
        def simulate(run, rate, start):
            return (0.1 + start * np.exp(-rate * run.t),) * len(outputs)

        return tl.Model(["rate", "start"], [], outputs, [0.0, 0.0], [0.2, 1.0], simulate=simulate)

    noise = 0.003 * default_rng(0).standard_normal((2, 3000))
    noisy = 0.1 + 0.1 * np.exp(-0.002 * np.arange(3000)) + noise
    plain = log(mode=np.ones(3000), path_error=noisy[0])
    beside = plain.with_columns(p_r=window_mean(noisy[1], 0.1, 20.0))
    beside = beside.with_metadata(performance_window=20.0)
    for outputs in (["p_r"], ["path_error", "p_r"]):
        fit = fit_model(model(*outputs), beside)
        assert "p_r as means over a moving window of 20 s" in fit.message
        assert abs(fit.model["rate"] - 0.02) < 3.0 * fit.parameters.loc["rate", "stderr"] < 0.002
    wrong = fit_model(model("p_r"), beside, window=0.0, noise="white")
    assert abs(wrong.model["start"] - 0.1) > 5.0 * wrong.parameters.loc["start", "stderr"]
    logs = plain, beside, beside.with_metadata(performance_cut=1)
    fits = [fit_model(model("path_error"), each) for each in logs]
    assert fits[0].model == fits[1].model == fits[2].model
    assert fits[0].message == fits[1].message
    with refused("window is that of p_r and p_h, which this model"):
        fit_model(model("path_error"), plain, window=20.0)


def test_a_window_that_is_far_from_whole_samples_is_refused():
    """Below a sample it was none, and 2.5 s were taken for 2 s."""
    for window, nearest in ((0.4, 1), (2.5, 2)):
        says = rf"window = {window} s is no whole number of samples .*of 1 s\); state {nearest} s"
        with refused(says):
            fit_tsc(session(step=1.0), window=window)


# --- noise ----------------------------------------------------------------------------------------


def test_coarse_numbers_and_slow_noise_are_doubted():
    noisy = session()
    p_h, walk = noisy["p_h"], np.cumsum(3e-4 * default_rng(0).standard_normal(len(noisy)))
    for doubtful, says in (
        (p_h.round(2), "logged in steps of 0.01"),
        (p_h + walk, "Noise counts as correlated over "),
    ):
        fit = fit_human(noisy.with_columns(p_h=doubtful))
        assert not fit.success
        assert says in fit.message


def test_slow_noise_tells_its_size_by_fewer_values():
    """Oracle: n values of an AR(1) process are worth n (1 − φ)/(1 + φ) independent ones."""
    noisy = session(noise=0.0)
    noise = signal.lfilter([0.0006], [1.0, -0.98], default_rng(3).standard_normal(len(noisy)))
    fit = fit_human(noisy.with_columns(p_h=noisy["p_h"] + noise))
    assert fit.noise == "correlated"
    assert fit.degrees_of_freedom == approx(noise.size * 0.02 / 1.98, rel=0.25)
    row = fit.table().loc["beta"]
    half = stats.t.ppf(0.975, fit.degrees_of_freedom) * row["stderr"]
    assert row["ci_high"] - row["value"] == approx(half)


def test_stamps_that_are_not_exact_widen_the_intervals():
    def errors(session, stated=None):
        return fit_human(session, stamp_error=stated).table()["stderr"]

    noisy = session()
    exact, rough, rounded = (errors(noisy, each) for each in (0.0, 0.5, 0.1 / np.sqrt(12.0)))
    assert (rough > exact).all()
    for facts, expected in (
        ({}, exact),  # simulated: switches on a sample
        ({"resampled": "previous at 0.1 s"}, rounded),
        ({"synthetic": False}, rounded),
        ({"stamp_error": 0.5}, rough),
    ):
        logged = noisy.with_metadata(performance_window=0.0, **facts)
        pd.testing.assert_series_equal(errors(logged), expected)


def test_errors_of_many_stamps_are_worked_out_for_some_of_them(monkeypatch):
    module = importlib.import_module("trustlab.identification.fit")
    noisy, errors = session(np.repeat([1.0, 0.0] * 60, 100)), []
    for most in (10_000, 35):
        monkeypatch.setattr(module, "SWITCHES", most)
        errors.append(fit_human(noisy, stamp_error=0.3).table()["stderr"])
    assert not errors[0].equals(errors[1])
    assert_allclose(errors[1], errors[0], rtol=0.05)


def delayed(late):
    """A session whose mode acts late."""
    frame = noise_settings.white(default_rng(3), noise_settings.clean(late=late))
    return tl.Session(frame, tl.Metadata(synthetic=True))


def test_a_delay_within_the_error_of_the_stamps_is_in_the_intervals_and_no_doubt():
    exact, rough = (fit_tsc(delayed(0.2), stamp_error=error) for error in (0.0, 0.2))
    assert not exact.success
    assert re.search("stamped .*mode_delay=True", exact.message)
    assert rough.success
    assert scores([rough.table()], TRUTH)[0].abs().max(axis=None) < 3.0


def test_an_error_that_all_stamps_share_widens_the_intervals_where_stamps_are_not_exact():
    """
    Oracle: the fit with the delay as a parameter, whose estimates differ by what the delay does to
    them.
    """
    ways = {"stamp_error": 0.0}, {"stamp_error": 1e-9}, {"mode_delay": True}
    exact, rough, free = (fit_tsc(delayed(0.1), **way).table() for way in ways)
    delay, stderr = free.loc["mode_delay", ["value", "stderr"]]
    assert abs(delay - 0.1) < 4.0 * stderr
    assert abs(delay) > stderr
    of_exact, of_rough, of_free = (table.loc["robot_a"] for table in (exact, rough, free))
    added = np.sqrt(of_rough["stderr"] ** 2 - of_exact["stderr"] ** 2)
    moved = abs(of_free["value"] - of_exact["value"])
    assert added == approx(moved * np.sqrt(1.0 + (stderr / delay) ** 2), rel=0.1)
    assert rough["value"].equals(exact["value"])


# --- coverage as it is stored ---------------------------------------------------------------------


def shortfall(rows):
    """Which parameters are covered in fewer than 90 %, less two of that share's deviations."""
    table = noise_settings.by_parameter(rows)
    table = table[(table["way"] != "before") & (table["successes"] >= 0.1 * table["fits"])]
    least = 0.9 - 2.0 * np.sqrt(0.9 * 0.1 / table["successes"])
    return table[table["coverage"] < least]


def test_stored_coverage_is_met_or_doubted():
    """
    Every setting of data/coverage: 90 % for each parameter, or fewer than one fit in ten reports
    success.
    """
    stored = pd.read_csv(STORED)
    assert shortfall(stored).empty
    assert set(stored["setting"]) >= {*noise_settings.SETTINGS, *noise_settings.WINDOWS}


AGAIN = ["quantised at 0.01", "dropouts to 0", "logged at 1 Hz"]
AGAIN += ["100 s, open loop, noise after averaging", "30 s, closed loop, noise before averaging"]


@mark.parametrize("setting", AGAIN)
def test_stored_coverage_is_that_of_the_settings(setting):
    """A session of the stored ones, fitted again: the same errors, or doubted again."""
    stored = pd.read_csv(STORED)
    stored = stored[stored["setting"] == setting].set_index("session").loc[3]
    fresh = noise_settings.covers(np.random.SeedSequence([11, 3]), setting)
    for name, value in fresh.items():
        assert stored[name] == approx(value, rel=0.02, abs=0.02, nan_ok=True), name


@mark.long
@mark.parametrize("setting", [*noise_settings.SETTINGS, *noise_settings.WINDOWS])
def test_settings_cover_the_truth_or_say_that_they_do_not(setting):
    """40 seeds of each that are not the stored ones."""
    seeds = np.random.SeedSequence(11).spawn(40)
    rows = pd.DataFrame([noise_settings.covers(seed, setting) for seed in seeds])
    assert shortfall(rows.assign(setting=setting)).empty


def test_rates_belong_to_the_sample_time_and_tables_say_so():
    """Oracle: the operator of 10 Hz, whose time constants do not hang on how often one looks."""
    fine = session()
    fit = fit_tsc(tl.Session(fine.data[::10], fine.metadata))
    assert fit.success, fit.message
    table = fit.table()
    assert {*table["unit"][["human_a", "robot_a"]]} == {"per 1 s"}
    rows = table.loc[["human_time_constant", "robot_time_constant"]]
    assert {*rows["unit"]} == {"s"}
    expected = [0.1 * PILOT.human.time_constant, 0.1 * PILOT.robot.time_constant]
    assert (abs(rows["value"] - expected) < 4.0 * rows["stderr"]).all()
