"""
Fits of what was logged: window means, late or early modes, coarse, sparse, interrupted and
correlated data.

Oracles: the parameters that the data were made with; means written as loops; Cholesky factors of
the dense covariance for the Kalman filter; `with_performance` of the sessions' own room for the
window.
"""

import importlib
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st
from scipy import signal, stats

import trustlab as tl
from notebooks import noise_settings
from tests.identification.cases import (
    NOISE,
    PILOT,
    ROOT,
    SWITCHING,
    log,
    of_setting,
    scores,
    session,
    truth,
)
from trustlab.identification import TSC
from trustlab.identification.log import read_runs, undo_window, window_means
from trustlab.identification.problem import Problem, _deviance_with_noise, rough_optima
from trustlab.sessions.metrics import window_mean

STORED = ROOT / "data" / "coverage" / "fits.csv"
TRUTH = truth()
NAMES = noise_settings.TRUTH


def windowed(window, seed, loop="open", where="before", noise=NOISE):
    """A session of the pilot operator whose performances are means over a window."""
    return noise_settings.windowed(np.random.default_rng([seed, 7]), window, loop, where, noise)


# --- the window -----------------------------------------------------------------------------------


@given(st.integers(1, 60), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_window_means_are_those_of_sessions_and_can_be_undone(size, window, seed):
    values = np.random.default_rng(seed).standard_normal((size, 3))
    means = window_means(values, window)
    for k in range(size):
        np.testing.assert_allclose(
            means[k], values[max(0, k + 1 - window) : k + 1].mean(axis=0), atol=1e-12
        )
    np.testing.assert_allclose(
        means[:, 0], window_mean(values[:, 0], 0.1, 0.1 * window), atol=1e-12
    )
    undone = [undo_window(column, window) for column in means.T]
    np.testing.assert_allclose(undone, values.T, atol=1e-10)


@pytest.mark.parametrize("window", [10.0, 100.0])
def test_exact_windowed_data_give_the_parameters_back(window):
    exact = windowed(window, 0, noise=0.0)
    for who, fit_of in (("tsc", tl.fit_tsc), ("robot", tl.fit_robot), ("human", tl.fit_human)):
        fit, expected = fit_of(exact), truth(who=who)
        assert fit.success, fit.message
        assert f"window of {window:g} s" in fit.message
        np.testing.assert_allclose(fit.table().loc[expected.index, "value"], expected, rtol=1e-6)
    # What is fitted is the mean that with_performance would have made of the fitted model.
    joint = tl.fit_tsc(exact)
    run = joint.model.simulate(exact["mode"], *joint.initial_states[["r0", "p_r0"]].iloc[0])
    means = window_mean(run["p_r"], 0.1, window)
    np.testing.assert_allclose(joint.runs[0].fitted["p_r"], means, atol=1e-9)


def test_a_robot_is_driven_by_what_the_window_averaged():
    fixed = {"p_h_max": PILOT.robot.p_h_max}
    fit = tl.fit(tl.identification.ROBOT, windowed(10.0, 0, noise=0.0), fixed=fixed)
    assert fit.model.a == pytest.approx(PILOT.robot.a, abs=1e-7)


def test_a_second_valley_as_deep_is_named():
    """
    In closed loop r stays above 0.7: a rested operator with a high p_min explains the rest as well
    as the true one.
    """
    fit = tl.fit_tsc(windowed(30.0, 42, "closed", "after"))
    assert not scores([fit.table()], TRUTH)[1]["human_p_min"].item()
    assert not fit.success
    assert re.search(
        r"Other values explain these data nearly as well: .*human_p_min = 0\.\d+ for 0\.42\d+",
        fit.message,
    )
    # The negative control: phases that move the model leave one valley.
    assert "Other values" not in tl.fit_human(windowed(30.0, 42, "open", "after")).message


def test_how_noise_is_seen_depends_on_no_other_search():
    """Searches of one log wrote to the same buffers, and the noise was fitted to the last one's."""
    runs = read_runs(windowed(30.0, 0), "mode", "p_h", "p_r")
    (best, *_) = rough_optima(TSC, runs, TSC.limits())
    assert best.problem.unwindow
    before = _deviance_with_noise(best)
    best.problem.equations(best.x)
    Problem(TSC, best.problem.runs, TSC.limits(), True).equations(best.x + 0.01)
    assert _deviance_with_noise(best) == pytest.approx(before, abs=1e-6)


def test_a_log_of_a_lab_that_says_nothing_of_its_window_is_warned_of_once():
    short, other = (
        session(SWITCHING[:6000], seed=seed).with_metadata(synthetic=False) for seed in (0, 1)
    )
    with pytest.warns(UserWarning, match=r"state window=… \[s\], or window=0") as caught:
        tl.fit_human([short, other])
    assert len(caught) == 1
    assert tl.fit_human(short, window=0.0).success


def test_recipes_and_sessions_say_the_window(tmp_path):
    means = windowed(30.0, 0)
    means.data.reset_index().to_csv(tmp_path / "log.csv", index=False)
    recipe = 'kind = "table"\nperformance_window = 30\n[time]\nunit = "s"\n[columns]\n' + "".join(
        f'{name} = {{ column = "{name}" }}\n' for name in ("mode", "p_r", "p_h")
    )
    (tmp_path / "lab.toml").write_text(recipe)
    read = tl.read_session(tmp_path / "log.csv", recipe=tmp_path / "lab.toml")
    assert read.metadata.more["performance_window"] == 30
    assert tl.fit_human(read).model.a == pytest.approx(tl.fit_human(means).model.a, abs=1e-5)
    assert "moving window of 0 s and 30 s, " in tl.fit_human([means, session()]).message
    with pytest.raises(tl.IdentificationError, match="cut the log first"):
        tl.fit_human(means.between(100.0, 900.0))


def test_a_model_of_ones_own_has_a_window_for_free():
    def decay(run, rate, start):
        return 0.2 + start * np.exp(-rate * run.t)

    model = tl.Model(["rate", "start"], [], "p_r", [0.0, 0.0], [0.2, 1.0], simulate=decay)
    noise = 0.003 * np.random.default_rng(0).standard_normal(3000)
    values = 0.2 + 0.1 * np.exp(-0.002 * np.arange(3000)) + noise
    averaged = log(mode=np.ones(3000), p_r=window_mean(values, 0.1, 20.0))
    fit = tl.fit(model, averaged, window=20.0)
    assert abs(fit.model["rate"] - 0.02) < 3.0 * fit.parameters.loc["rate", "stderr"] < 0.002
    wrong = tl.fit(model, averaged, window=0.0, noise="white")
    assert abs(wrong.model["start"] - 0.1) > 5.0 * wrong.parameters.loc["start", "stderr"]


def test_only_performance_is_a_mean_over_the_window_of_performance():
    """Every output was, so that a model of path_error changed with the columns beside it."""
    rng, mode = np.random.default_rng(0), np.repeat([0.0, 1.0] * 5, 600)

    def simulate(run, rate, manual, auto, e0):
        e = np.full(run.size, e0)
        for k, m in enumerate(run["mode"][:-1]):
            e[k + 1] = e[k] + rate * ((manual if m else auto) - e[k])
        return e

    def both(run, **values):
        e = simulate(run, **values)
        return e, 1.0 - e

    names, low, high = ["rate", "manual", "auto"], [0.001, 0, 0, 0], [0.5, 1, 1, 1]
    true = {"rate": 0.02, "manual": 0.5, "auto": 0.2}
    bare = log(mode=mode, path_error=np.zeros(mode.size))
    e = simulate(read_runs(bare, "mode")[0], **true, e0=0.3)
    noise = 0.004 * rng.normal(size=(2, e.size))
    p_r = window_mean(1.0 - e + noise[1], 0.1, 20.0)
    plain = log(mode=mode, path_error=e + noise[0])
    beside = plain.with_columns(p_r=p_r).with_metadata(performance_window=20.0)
    model = tl.Model(names, ["e0"], "path_error", low, high, simulate=simulate)
    fits = [
        tl.fit(model, each) for each in (plain, beside, beside.with_metadata(performance_cut=1))
    ]
    assert fits[0].model == fits[1].model == fits[2].model
    assert fits[0].message == fits[1].message
    joint = tl.fit(tl.Model(names, ["e0"], ("path_error", "p_r"), low, high, simulate=both), beside)
    assert "takes p_r as means over a moving window of 20 s" in joint.message
    np.testing.assert_allclose([*joint.model.values()], [*true.values()], rtol=0.01)
    with pytest.raises(ValueError, match="window is that of p_r and p_h, which this model"):
        tl.fit(model, plain, window=20.0)


def test_a_window_that_is_far_from_whole_samples_is_refused():
    """Below a sample it was none, and 2.5 s were taken for 2 s."""
    for window, nearest in ((0.4, 1), (2.5, 2)):
        says = rf"window = {window} s is no whole number of samples .*of 1 s\); state {nearest} s"
        with pytest.raises(ValueError, match=says):
            tl.fit_tsc(session(step=1.0), window=window)


# --- noise ----------------------------------------------------------------------------------------


def test_what_a_log_may_do_is_named_and_allowed_for():
    dropouts = of_setting("dropouts to 0", 5)[0]
    assert "dropouts?" in tl.fit_tsc(dropouts).message
    early, options = of_setting("mode stamped 1 s early", 5)
    plain = tl.fit_tsc(early)
    assert not plain.success
    assert "mode_delay=True" in plain.message
    delay = tl.fit_tsc(early, **options).table().loc["mode_delay"]
    assert delay["ci_low"] - 0.05 < 1.0 < delay["ci_high"] + 0.05


def test_coarse_numbers_and_slow_noise_are_doubted():
    walk = np.cumsum(3e-4 * np.random.default_rng(0).standard_normal(SWITCHING.size))
    drifting = session().with_columns(p_h=session()["p_h"] + walk)
    for doubtful, says in (
        (of_setting("quantised at 0.01", 1)[0], "logged in steps of 0.01"),
        (drifting, "Noise counts as correlated over "),
    ):
        fit = tl.fit_human(doubtful)
        assert not fit.success
        assert says in fit.message


def test_slow_noise_tells_its_size_by_fewer_values():
    """Oracle: n values of an AR(1) process are worth n (1 − φ)/(1 + φ) independent ones."""
    rng, slow = np.random.default_rng(3), 0.98
    noisy = session(noise=0.0)
    noise = signal.lfilter([0.0006], [1.0, -slow], rng.standard_normal(noisy.data.shape[0]))
    fit = tl.fit_human(noisy.with_columns(p_h=noisy["p_h"] + noise))
    worth = noise.size * (1.0 - slow) / (1.0 + slow)
    assert fit.noise == "correlated"
    assert fit.degrees_of_freedom == pytest.approx(worth, rel=0.25)
    row = fit.table().loc["beta"]
    half = stats.t.ppf(0.975, fit.degrees_of_freedom) * row["stderr"]
    assert row["ci_high"] - row["value"] == pytest.approx(half)


def test_stamps_that_are_not_exact_widen_the_intervals():
    def errors(session, **options):
        return tl.fit_human(session, **options).table()["stderr"]

    noisy = session()
    exact, rough = (errors(noisy, stamp_error=error) for error in (0.0, 0.5))
    assert (rough > exact).all()
    pd.testing.assert_series_equal(errors(noisy), exact)  # simulated: switches on a sample
    same = errors(noisy, stamp_error=0.1 / np.sqrt(12.0))
    for changes in ({"resampled": "previous at 0.1 s"}, {"synthetic": False}):
        logged = noisy.with_metadata(performance_window=0.0, **changes)
        pd.testing.assert_series_equal(errors(logged), same)
        pd.testing.assert_series_equal(errors(logged.with_metadata(stamp_error=0.5)), rough)


def test_errors_of_many_stamps_are_worked_out_for_some_of_them(monkeypatch):
    module = importlib.import_module("trustlab.identification.fit")
    noisy, errors = session(np.repeat([1.0, 0.0] * 60, 100)), []
    for most in (10_000, 35):
        monkeypatch.setattr(module, "SWITCHES", most)
        errors.append(tl.fit_human(noisy, stamp_error=0.3).table()["stderr"])
    assert not errors[0].equals(errors[1])
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.05)


def delayed(late):
    """A session whose mode acts late."""
    frame = noise_settings.white(np.random.default_rng(3), noise_settings.clean(late=late))
    return tl.Session(frame, tl.Metadata(synthetic=True))


def test_a_delay_within_the_error_of_the_stamps_is_in_the_intervals_and_no_doubt():
    exact, rough = (tl.fit_tsc(delayed(0.2), stamp_error=error) for error in (0.0, 0.2))
    assert "stamped" in exact.message
    assert not exact.success
    assert rough.success
    assert scores([rough.table()], TRUTH)[0].abs().max(axis=None) < 3.0


def test_an_error_that_all_stamps_share_widens_the_intervals_where_stamps_are_not_exact():
    """
    Oracle: the fit with the delay as a parameter, whose estimates differ by what the delay does to
    them.
    """
    exact, rough = (tl.fit_tsc(delayed(0.1), stamp_error=e).table() for e in (0.0, 1e-9))
    free = tl.fit_tsc(delayed(0.1), mode_delay=True).table()
    delay, stderr = free.loc["mode_delay", ["value", "stderr"]]
    assert abs(delay) > stderr
    added = np.sqrt(rough.loc["robot_a", "stderr"] ** 2 - exact.loc["robot_a", "stderr"] ** 2)
    moved = abs(free.loc["robot_a", "value"] - exact.loc["robot_a", "value"])
    assert added == pytest.approx(moved * np.sqrt(1.0 + (stderr / delay) ** 2), rel=0.1)
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


AGAIN = ["white", "quantised at 0.01", "dropouts to 0", "logged at 1 Hz"]
AGAIN += ["100 s, open loop, noise after averaging", "30 s, closed loop, noise before averaging"]


@pytest.mark.parametrize("setting", AGAIN)
def test_stored_coverage_is_that_of_the_settings(setting):
    """A session of the stored ones, fitted again: the same errors, or doubted again."""
    stored = pd.read_csv(STORED)
    stored = stored[stored["setting"] == setting].set_index("session").loc[3]
    fresh = noise_settings.covers(np.random.SeedSequence([11, 3]), setting)
    for name, value in fresh.items():
        assert stored[name] == pytest.approx(value, rel=0.02, abs=0.02, nan_ok=True), name


@pytest.mark.long
@pytest.mark.parametrize("setting", [*noise_settings.SETTINGS, *noise_settings.WINDOWS])
def test_settings_cover_the_truth_or_say_that_they_do_not(setting):
    """40 seeds of each that are not the stored ones."""
    seeds = np.random.SeedSequence(11).spawn(40)
    rows = pd.DataFrame([noise_settings.covers(seed, setting) for seed in seeds])
    assert shortfall(rows.assign(setting=setting)).empty


@pytest.mark.parametrize("every", [2, 10])
def test_rates_belong_to_the_sample_time_and_tables_say_so(every):
    """Oracle: the operator of 10 Hz, whose time constants do not hang on how often one looks."""
    fine = session()
    fit = tl.fit_tsc(tl.Session(fine.data.iloc[::every], fine.metadata))
    assert fit.success, fit.message
    table = fit.table()
    assert table.loc[["human_a", "robot_a"], "unit"].eq(f"per {0.1 * every:g} s").all()
    for name, own in (("human", PILOT.human), ("robot", PILOT.robot)):
        row = table.loc[f"{name}_time_constant"]
        assert row["unit"] == "s"
        assert abs(row["value"] - 0.1 * own.time_constant) < 4.0 * row["stderr"]
