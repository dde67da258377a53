"""What the fits must give back: exact parameters from exact data, honest intervals from noisy data."""

import numpy as np
import pytest

import trustlab as tl

NAMES = ["pilot", "1", "2", "3", "4", "5"]


def truth(model):
    robot, human = model.robot, model.human
    return (
        {"a": robot.a, "p_min": robot.p_min, "p_max": robot.p_max, "p_h_max": robot.p_h_max, "b": robot.b},
        {"a": human.a, "beta": human.beta, "p_min": human.p_min, "p_max": human.p_max, "b": human.b},
    )


@pytest.mark.parametrize("start", [(0.0, None), (0.3, 0.3)])
@pytest.mark.parametrize("name", NAMES)
def test_exact_data_give_the_parameters_back(operators, make_session, switching, name, start):
    model = operators[name]
    session = make_session(model, switching, r0=start[0], p_r0=start[1])
    robot, human = truth(model)
    joint = {f"robot_{k}": v for k, v in robot.items() if k != "p_h_max"} | {
        f"human_{k}": v for k, v in human.items()
    }
    for fit, expected in (
        (tl.fit_robot(session), robot),
        (tl.fit_human(session), human),
        (tl.fit_tsc(session), joint),
    ):
        assert fit.success, fit.message
        found = fit.table()["value"]
        for key, value in expected.items():
            assert found[key] == pytest.approx(value, rel=1e-6), key
        assert np.min(fit.fit_percent) > 99.99
    assert tl.fit_robot(session, method="arx").model.a == pytest.approx(model.robot.a, rel=1e-9)


def test_runs_share_parameters_and_keep_their_own_beginning(operators, make_session):
    model = operators["2"]
    mode = np.repeat([1.0, 0.0, 1.0], 1500)
    runs = [
        make_session(model, mode, r0=0.1, p_r0=0.25),
        make_session(model, 1.0 - mode, r0=0.8, p_r0=0.34),
        make_session(model, np.full(700, 0.5), r0=0.4, p_r0=0.30),
    ]
    robot, human = tl.fit_robot(runs), tl.fit_human(runs)
    np.testing.assert_allclose(robot.initial_states["p_r0"], [0.25, 0.34, 0.30], rtol=1e-6)
    np.testing.assert_allclose(human.initial_states["r0"], [0.1, 0.8, 0.4], rtol=1e-5)
    assert robot.model.p_max == pytest.approx(model.robot.p_max, rel=1e-6)
    assert human.model.beta == pytest.approx(model.human.beta, rel=1e-6)
    joint = tl.fit_tsc(runs)
    np.testing.assert_allclose(
        joint.initial_states[["r0", "p_r0"]], [[0.1, 0.25], [0.8, 0.34], [0.4, 0.30]], rtol=1e-5
    )


def test_a_shared_mode_is_as_good_as_switching(operators, make_session):
    # Mode may be a manual share; nothing in (2.3), (2.5) needs it to be 0 or 1.
    rng = np.random.default_rng(3)
    mode = np.repeat(rng.random(20), 600)
    model = operators["pilot"]
    session = make_session(model, mode)
    assert tl.fit_robot(session).model.p_min == pytest.approx(model.robot.p_min, rel=1e-6)
    assert tl.fit_human(session).model.beta == pytest.approx(model.human.beta, rel=1e-6)


def noisy(make_session, model, switching):
    """400 sessions of 20,000 samples with seven switches and white noise of sd 0.003."""
    for child in np.random.SeedSequence(47).spawn(400):
        yield make_session(model, switching, noise=0.003, seed=child)


@pytest.mark.slow
@pytest.mark.parametrize("who", ["robot", "human"])
def test_intervals_cover_the_truth(operators, make_session, switching, who):
    """The 95 % intervals cover the truth in 92 to 98 % of 400 seeds (one sd of the share is 1.1 %)."""
    model = operators["pilot"]
    expected = truth(model)[("robot", "human").index(who)]
    fit = {"robot": tl.fit_robot, "human": tl.fit_human}[who]
    hits = dict.fromkeys(expected, 0)
    for session in noisy(make_session, model, switching):
        table = fit(session).table()
        for key, low, high in zip(table.index, table["ci_low"], table["ci_high"], strict=True):
            hits[key] += low <= expected[key] <= high
    coverage = {key: count / 400 for key, count in hits.items()}
    assert all(0.92 <= value <= 0.98 for value in coverage.values()), coverage


def test_arx_is_biased_and_does_not_know_it(operators, make_session, switching):
    """Negative control: the same check catches ARX, whose intervals know nothing of measurement noise."""
    model = operators["pilot"]
    rows = [
        tl.fit_robot(session, method="arx", p_h_max=model.robot.p_h_max).table().loc["a"]
        for session, _ in zip(noisy(make_session, model, switching), range(20), strict=False)
    ]
    assert not any(row["ci_low"] <= model.robot.a <= row["ci_high"] for row in rows)
    assert np.mean([row["value"] - model.robot.a for row in rows]) < -0.005


def test_autocorrelated_noise_widens_the_intervals(operators, make_session, switching):
    model = operators["pilot"]
    clean = make_session(model, switching)
    rng, drift = np.random.default_rng(5), np.zeros(switching.size)
    for k in range(1, drift.size):
        drift[k] = 0.99 * drift[k - 1] + 0.0004 * rng.standard_normal()
    session = clean.with_columns(p_h=clean["p_h"] + drift)
    robust, white = tl.fit_human(session), tl.fit_human(session, noise="white")
    assert robust.noise == "hac"
    assert white.noise == "white"
    assert "not white" in robust.message
    assert 'use noise="hac"' in white.message
    assert (robust.table()["stderr"] > 3.0 * white.table()["stderr"]).all()
