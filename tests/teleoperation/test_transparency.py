"""
Section 3.7: distances and gains against the channel itself, and guidelines as monotone
tests.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.teleoperation.channel import channel_run
from trustlab.teleoperation.ports.waves import Scattering
from trustlab.teleoperation.transparency import (
    dominance,
    gains,
    ideal_distances,
    rendered_impedance,
)

SETTINGS = settings(max_examples=60, deadline=None, derandomize=True)
share = st.floats(0.02, 1.0)


@st.composite
def channels(draw):
    alphas, betas = sorted((draw(share), draw(share))), sorted((draw(share), draw(share)))
    return Scattering(draw(st.floats(0.1, 10.0)), alphas[0], alphas[1], betas[0], betas[1])


@SETTINGS
@given(channels())
def test_distances_are_the_coefficients_of_3_22(channel):
    frame = ideal_distances(channel)
    f_m, u_l = channel.master(np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    r_s, u_r = channel.slave(np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    expected = {
        "f'_m = v_l": f_m[::-1],
        "u_r = f_s": u_r,
        "r'_s = v_r": r_s[::-1],
        "u_l = r_m": u_l,
    }
    for relation, (weight, leak) in expected.items():
        assert frame.loc[relation, "weight"] == pytest.approx(weight, rel=1e-12)
        assert frame.loc[relation, "leak"] == pytest.approx(abs(leak), rel=1e-12)
    np.testing.assert_allclose(frame["distance"], np.hypot(frame["weight"] - 1.0, frame["leak"]))
    ratios = dominance(channel)  # oracle: the closed forms of its docstring
    b, alpha, beta = channel.b, channel.alpha_max, channel.beta_max
    assert ratios["force_operator"] == pytest.approx(np.sqrt(2.0 / (b * beta)), rel=1e-12)
    assert ratios["force_robot"] == pytest.approx(np.sqrt(2.0 * alpha / b), rel=1e-12)
    assert ratios["velocity_robot"] == pytest.approx(np.sqrt(2.0 * b / alpha), rel=1e-12)
    assert ratios["velocity_operator"] == pytest.approx(np.sqrt(2.0 * b * beta), rel=1e-12)
    np.testing.assert_allclose(frame["ratio"], list(ratios.values()), rtol=1e-12)


@SETTINGS
@given(channels(), st.floats(1.01, 3.0))
def test_guidelines_of_section_3_7_1(channel, factor):
    before = dominance(channel)
    smaller_b = dominance(
        Scattering(
            channel.b / factor,
            channel.alpha_min,
            channel.alpha_max,
            channel.beta_min,
            channel.beta_max,
        )
    )
    for name in before:
        assert (smaller_b[name] > before[name]) == name.startswith("force")
    larger_beta = dominance(
        Scattering(
            channel.b,
            channel.alpha_min,
            channel.alpha_max,
            channel.beta_min,
            channel.beta_max * factor,
        )
    )
    assert larger_beta["force_operator"] < before["force_operator"]
    assert larger_beta["velocity_operator"] > before["velocity_operator"]  # against the text
    smaller = Scattering(
        channel.b,
        channel.alpha_min / factor,
        channel.alpha_max / factor,
        channel.beta_min / factor,
        channel.beta_max,
    )
    assert dominance(smaller)["force_robot"] < before["force_robot"]
    assert dominance(smaller)["velocity_robot"] > before["velocity_robot"]
    # β_min has no say in it
    assert dominance(smaller)["velocity_operator"] == pytest.approx(
        before["velocity_operator"], rel=1e-12
    )


@pytest.mark.parametrize("seed", range(10))
def test_gains_are_what_slow_signals_become(seed):
    rng = np.random.default_rng([46, seed])
    alphas, betas = np.sort(rng.uniform(0.05, 1.0, 2)), np.sort(rng.uniform(0.05, 1.0, 2))
    channel = Scattering(rng.uniform(0.3, 4.0), *alphas, *betas)
    alpha, beta = rng.uniform(*alphas), rng.uniform(*betas)
    found = gains(channel, alpha, beta)
    one = np.ones((6000, 1))
    none = np.zeros((6000, 1))
    still = channel_run(none, one, channel, 0.01, 0.02, 0.02, alpha, beta)
    free = channel_run(one, none, channel, 0.01, 0.02, 0.02, alpha, beta)
    assert still.f_m[-1, 0] == pytest.approx(found["force"], rel=1e-9)
    assert still.r_s[-1, 0] == pytest.approx(-found["drift"], rel=1e-9)
    assert free.r_s[-1, 0] == pytest.approx(found["velocity"], rel=1e-9)
    assert free.f_m[-1, 0] == pytest.approx(found["drag"], rel=1e-9)


@SETTINGS
@given(channels(), st.floats(0.0, 20.0), st.floats(0.0, 2.0), st.floats(0.0, 1.0))
def test_rendered_impedance_is_passive(channel, load, delay, rate):
    omega = np.geomspace(0.01, 100.0, 200)
    channel = Scattering(
        channel.b, channel.alpha_min, channel.alpha_max, channel.beta_min, channel.beta_max, rate
    )
    spring = load / (1j * omega)
    for environment in (load, spring, spring + load):
        felt = rendered_impedance(channel, omega, environment, delay, 0.5 * delay)
        assert felt.real.min() >= -1e-9 * np.abs(felt).max()


def test_rendered_impedance_without_scaling_and_delay_is_the_environment():
    omega = np.geomspace(0.1, 10.0, 20)
    np.testing.assert_allclose(
        rendered_impedance(Scattering(1.7), omega, 3.0 + 2.0j), 3.0 + 2.0j, rtol=1e-12
    )


def test_rendered_impedance_is_that_of_the_channel_at_a_frequency():
    channel = Scattering(1.5, 0.3, 0.9, 0.2, 0.8)
    omega = 2.0
    sample_time = 0.005
    t = sample_time * np.arange(20000)
    r_m = np.sin(omega * t)[:, None]
    f_m = channel_run(r_m, np.zeros_like(r_m), channel, sample_time, 0.1, 0.2).f_m[-6283:, 0]
    t = t[-6283:]
    basis = np.column_stack([np.sin(omega * t), np.cos(omega * t)])
    in_phase, ahead = np.linalg.lstsq(basis, f_m, rcond=None)[0]
    felt = rendered_impedance(channel, [omega], 0.0, 0.1, 0.2)[0]
    assert in_phase + 1j * ahead == pytest.approx(felt, rel=1e-6)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ideal_distances(1.0), "must be of class Scattering"),
        (lambda: rendered_impedance(Scattering(1.0), [1.0], [1.0, 2.0]), "environment must be"),
    ],
)
def test_bad_input_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
