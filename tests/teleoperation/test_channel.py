"""
Theorem 3 and (3.12)-(3.22): wave identities, passivity under any delay, and guards that fail when
removed.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.teleoperation.channel import channel_run
from trustlab.teleoperation.delays import (
    Delay,
    delays_in_samples,
    packet_delay,
    random_walk_delay,
)
from trustlab.teleoperation.ports.waves import EnergyLedger, Scattering

T, N = 0.01, 1500
INTERPOLATION = 0.011
"""
Share of the greatest energy of one sample that the interpolated read-out may give beyond what was
sent.
"""


def exchanged(run):
    """Return the energy that went to and fro at both ports up to and with each sample [J]."""
    ports = ((run.r_m, run.f_m), (run.r_s, run.f_s))
    return run.sample_time * np.cumsum(sum(np.abs((v * f).sum(axis=1)) for v, f in ports))


def random_case(seed):
    """
    A random channel: bounds, scales, delays whose rate reaches its limit, and signals from smooth
    to rough.
    """
    rng = np.random.default_rng([33, seed])
    rate = rng.uniform(0.0, 1.0)
    alphas, betas = np.sort(rng.uniform(0.01, 1.0, 2)), np.sort(rng.uniform(0.01, 3.0, 2))
    scattering = Scattering(10 ** rng.uniform(-1, 1), *alphas, *betas, max_delay_rate=rate)
    signals = []
    for _ in range(2):
        kind, t = rng.integers(3), T * np.arange(N)[:, None]
        if kind == 0:
            signal = rng.normal(size=(N, 3))
        elif kind == 1:
            signal = np.sin(10 ** rng.uniform(-1, 2) * t + rng.uniform(0, 6, 3))
        else:
            signal = np.repeat(rng.normal(size=(N // 30 + 1, 3)), 30, axis=0)[:N]
        signals.append(10 ** rng.uniform(-2, 2) * signal)
    alpha, beta = rng.uniform(*alphas, N), rng.uniform(*betas, N)
    if seed % 3 == 0:  # scales that jump from bound to bound
        alpha, beta = rng.choice(alphas, N), rng.choice(betas, N)
    delays = [
        random_walk_delay(0.02, 1.5, rate, seed=int(s), hold=0.3)
        for s in rng.integers(1 << 30, size=2)
    ]
    return scattering, signals, alpha, beta, delays


class Ungained(Scattering):
    """A guard removed: delayed waves are read at full size although the delay grows."""

    gain = 1.0


def one_way(seed, read_out, kind=Scattering):
    """A wave sent one way only, against a delay that grows at a constant rate."""
    rng = np.random.default_rng([34, seed])
    rate = rng.uniform(0.05, 0.95)
    scattering = kind(1.0, 1e-9, 1.0, max_delay_rate=rate)
    wave = np.zeros((300, 1))
    begin, length = rng.integers(0, 60), rng.integers(1, 40)
    wave[begin : begin + length, 0] = rng.choice([-1.0, 1.0], length) if seed % 2 else 1.0
    start = rng.uniform(0.01, 0.02)
    delay = Delay(lambda t: start + rate * t, rate, "ramp")
    return channel_run(wave, np.zeros_like(wave), scattering, T, delay, 0.05, read_out=read_out)


@pytest.mark.parametrize("read_out", ["ledger", "interpolated"])
def test_energy_is_never_negative_in_500_random_channels(read_out):
    for seed in range(500):
        scattering, (r_m, f_s), alpha, beta, delays = random_case(seed)
        run = channel_run(r_m, f_s, scattering, T, *delays, alpha, beta, read_out)
        margin = 1e-9 * exchanged(run)
        if read_out == "interpolated":
            margin = margin + INTERPOLATION * T * max(
                (run.u_l**2).sum(1).max(), (run.u_r**2).sum(1).max()
            )
        assert (run.energy >= -margin).all(), seed
        assert (run.energy >= run.wave_energy - 1e-9 * exchanged(run)).all(), seed


def test_port_power_is_wave_power_in_every_sample():
    for seed in range(50):
        scattering, (r_m, f_s), alpha, beta, delays = random_case(seed)
        run = channel_run(r_m, f_s, scattering, T, *delays, alpha, beta)
        square = {
            name: (getattr(run, name) ** 2).sum(axis=1) for name in ("u_l", "v_l", "u_r", "v_r")
        }
        for port, scale, parts in (  # (3.15)
            (
                (run.r_m * run.f_m).sum(1),
                beta,
                (square["u_l"] / scattering.beta_min, square["v_l"] / scattering.beta_max),
            ),
            (
                (run.r_s * run.f_s).sum(1),
                alpha,
                (square["v_r"] / scattering.alpha_max, square["u_r"] / scattering.alpha_min),
            ),
        ):
            wave = scale / 2 * (parts[0] - parts[1])
            size = scale / 2 * (parts[0] + parts[1])
            assert (np.abs(port - wave) <= 1e-12 * (size + np.abs(port))).all()


def test_waves_are_those_of_3_13():
    scattering, b = Scattering(2.0, 0.2, 0.9, 0.05, 0.5), 2.0
    rng = np.random.default_rng(3)
    r_m, v_l, f_s, v_r = rng.normal(size=(4, 3))
    f_m, u_l = scattering.master(r_m, v_l)
    np.testing.assert_allclose(u_l, math.sqrt(0.05 / (2 * b)) * (f_m + b * r_m), atol=1e-14)
    np.testing.assert_allclose(v_l, math.sqrt(0.5 / (2 * b)) * (f_m - b * r_m), atol=1e-14)
    r_s, u_r = scattering.slave(f_s, v_r)
    np.testing.assert_allclose(u_r, math.sqrt(0.2 / (2 * b)) * (f_s - b * r_s), atol=1e-14)
    np.testing.assert_allclose(v_r, math.sqrt(0.9 / (2 * b)) * (f_s + b * r_s), atol=1e-14)


def test_constant_delay_of_whole_samples_shifts_the_waves():
    scattering, (r_m, f_s), alpha, beta, _ = random_case(7)
    scattering = Scattering(
        scattering.b,
        scattering.alpha_min,
        scattering.alpha_max,
        scattering.beta_min,
        scattering.beta_max,
    )
    for read_out in ("ledger", "interpolated", "hold"):
        run = channel_run(r_m, f_s, scattering, T, 0.05, 0.12, alpha, beta, read_out)
        np.testing.assert_allclose(run.v_r[5:], run.u_l[:-5], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(run.v_l[12:], run.u_r[:-12], rtol=1e-12, atol=1e-12)
        assert not run.v_r[:5].any()


def test_unit_scales_and_no_load_reflect_everything():
    scattering = Scattering(1.0)
    run = channel_run(np.ones((400, 1)), np.zeros((400, 1)), scattering, T, 0.02, 0.02)
    np.testing.assert_allclose(run.u_r, -run.v_r, atol=1e-14)


def test_jitter_overtaking_and_lost_packets_only_take_energy_away():
    rng = np.random.default_rng(8)
    sent = T * np.arange(N + 100)
    for seed in range(40):
        scattering, (r_m, f_s), alpha, beta, _ = random_case(seed)
        received = sent + rng.uniform(0.01, 0.3, (2, sent.size))
        received[rng.uniform(size=received.shape) < 0.3] = np.nan
        jitter = Delay(lambda t, rng=rng: rng.uniform(0.01, 0.3, t.size), 1e9, "jitter")
        there, back = (packet_delay(sent, times) for times in received)
        for delays in ((there, back), (jitter, jitter)):
            run = channel_run(r_m, f_s, scattering, T, *delays, alpha, beta)
            assert (run.energy >= -1e-9 * exchanged(run)).all()
            assert run.v_r.any()


def test_interpolation_keeps_its_margin_and_a_hold_does_not():
    worst = {}
    for read_out in ("interpolated", "hold", "ledger"):
        runs = [one_way(seed, read_out) for seed in range(200)]
        worst[read_out] = min((run.wave_energy / (T * (run.u_l**2).max())).min() for run in runs)
    assert worst["interpolated"] >= -INTERPOLATION
    assert worst["ledger"] >= -1e-12
    assert worst["hold"] < -0.1


def test_unit_gain_with_a_growing_delay_is_active():
    runs = [one_way(seed, "interpolated", Ungained) for seed in range(200)]
    assert min((run.wave_energy / (T * (run.u_l**2).max())).min() for run in runs) < -5.0


def swapped(run, scattering, alpha, beta):
    """
    Energy with the bars of (3.13) exchanged: waves out with the greatest scale, in with the least.
    """
    b, count = scattering.b, len(run.t)
    u_l, v_l, u_r, v_r = (np.zeros_like(run.r_m) for _ in range(4))
    energy = np.zeros(count)
    high, low = scattering.beta_max, scattering.beta_min
    a_high, a_low = scattering.alpha_max, scattering.alpha_min
    for k in range(count):
        v_r[k], v_l[k] = (u_l[k - 5], u_r[k - 5]) if k >= 5 else (0.0, 0.0)
        u_l[k] = math.sqrt(2 * b * high) * run.r_m[k] + math.sqrt(high / low) * v_l[k]
        u_r[k] = math.sqrt(2 * a_high / b) * run.f_s[k] - math.sqrt(a_high / a_low) * v_r[k]
        f_m = beta[k] * (b * run.r_m[k] + math.sqrt(2 * b / low) * v_l[k])
        r_s = alpha[k] * (math.sqrt(2 * b / a_low) * v_r[k] - run.f_s[k]) / b
        energy[k] = T * (run.r_m[k] @ f_m - r_s @ run.f_s[k])
    return np.cumsum(energy)


def test_swapped_bars_are_active():
    scattering = Scattering(1.0, 0.2, 1.0, 0.2, 1.0)
    rng = np.random.default_rng(2)
    r_m, f_s = rng.normal(size=(2, 60, 1))
    alpha, beta = rng.uniform(0.2, 1.0, (2, 60))
    run = channel_run(r_m, f_s, scattering, T, 0.05, 0.05, alpha, beta)
    assert (run.energy >= 0.0).all()
    assert swapped(run, scattering, alpha, beta).min() < -1.0


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 30), st.floats(-5, 5), st.booleans()), max_size=80))
def test_a_ledger_never_gives_more_than_it_got(events):
    ledger, sent = EnergyLedger(T), {}
    for number, value, read in events:
        ledger.receive(number, [value])
        sent.setdefault(number, value)
        if read:
            ledger.read()
        assert ledger.given <= T * sum(v * v for v in sent.values()) * (1 + 1e-12) + 1e-15
        assert ledger.balance >= 0.0


def test_a_ledger_books_a_packet_once():
    ledger = EnergyLedger(T)
    assert ledger.receive(3, [1.0, 0.0])
    assert not ledger.receive(3, [9.0, 9.0])
    assert ledger.receive(1, [5.0, 0.0])  # late: its energy counts, its wave is old
    assert ledger.read().tolist() == [1.0, 0.0]
    assert ledger.received == pytest.approx(T * 26.0)


def test_random_walk_keeps_bounds_rate_and_seed():
    delay = random_walk_delay(0.05, 0.8, 0.6, seed=4)
    values = delay.samples(5000, T)
    assert values.min() >= 0.05
    assert values.max() <= 0.8
    assert 0.5 < (np.diff(values) / T).max() <= 0.6 + 1e-9
    np.testing.assert_array_equal(
        values, random_walk_delay(0.05, 0.8, 0.6, seed=4).samples(5000, T)
    )


def test_numbers_and_functions_as_delays():
    pair = {"delay_1": lambda t: 0.1 + 0.05 * math.sin(t), "delay_2": 0.3}
    delays = delays_in_samples(pair, 0.05, "interpolated", 50, T)
    np.testing.assert_allclose(delays[0], 10.0 + 5.0 * np.sin(T * np.arange(50)))
    np.testing.assert_array_equal(delays[1], 30.0)
    none = delays_in_samples({"delay_1": 0.0, "delay_2": 0.0}, 0.0, "ledger", 10, T, zero=True)
    assert not none.any()


def test_a_trace_of_packets_is_read_at_the_newest_that_arrived():
    """Oracle: by hand; the third packet is lost, the fourth overtakes the second."""
    sent = [0.0, 0.1, 0.2, 0.3]
    trace = packet_delay(sent, [0.1, 0.5, np.nan, 0.4])
    assert (trace.end, trace.max_rate) == (0.5, np.inf)
    np.testing.assert_allclose(trace.samples(6, 0.1), [0.1, 0.1, 0.2, 0.3, 0.1, 0.2], atol=1e-12)
    with pytest.raises(ValueError, match=r"until 0\.5 s, and the run lasts until 0\.6 s"):
        trace.samples(7, 0.1)
    for bad, words in (
        ([0.1, 0.05, 0.3, 0.4], "packet 1, sent at t = 0.1 s, was received before"),
        ([np.nan] * 4, "ever received"),
        ([0.1], "same number of packets"),
    ):
        with pytest.raises(ValueError, match=words):
            packet_delay(sent, bad)
    with pytest.raises(ValueError, match="sent before the packet before it"):
        packet_delay([0.0, 0.2, 0.1, 0.3], [0.5] * 4)
    with pytest.raises(ValueError, match="give seconds from the start of the run"):
        packet_delay([100.0, 101.0], [100.5, 101.5]).samples(7, 0.1)


ONE = np.ones((50, 1))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Scattering(0.0), "b must be positive"),
        (lambda: Scattering(1.0, alpha_min=0.9, alpha_max=0.3), "alpha_min must not exceed"),
        (
            lambda: channel_run(ONE, ONE, Scattering(1.0), T, -0.1),
            "delay_1: a constant delay must not be negative",
        ),
        (
            lambda: channel_run(ONE, ONE, Scattering(1.0), T, (0.1, 0.2)),
            "delay_1: a constant delay must be a number",
        ),
        (lambda: channel_run(ONE, ONE, Scattering(1.0), T, 0.0, 0.1), "at least one sample"),
        (lambda: channel_run(ONE, ONE, Scattering(1.0), T, alpha=1.5), "alpha must lie in"),
        (
            lambda: Delay(lambda t: 0.1 - t, 0.1, "this delay").samples(50, T),
            r"-0\.01 s at t = 0\.11 s: it must not be negative",
        ),
        (lambda: EnergyLedger(0.0), "sample_time must be positive"),
    ],
)
def test_bad_input_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"max_delay_rate": -0.1}, "max_delay_rate must lie in"),
        ({"alpha_max": 1.1}, r"alpha_max must not exceed 1 \(3\.1\)"),
    ],
)
def test_what_a_channel_cannot_have(arguments, words):
    with pytest.raises(ValueError, match=words):
        Scattering(**{"b": 1.0} | arguments)
    assert Scattering(1.0, max_delay_rate=1.0).gain == 0.0
