"""
Theorems 3 and 5, (3.12)-(3.22) and (4.5)-(4.15): wave identities, passivity under any delay, scale
and leader, and guards that fail when removed.
"""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose

from tests.loops import jitter, random_signals
from trustlab.teleoperation import (
    Delay,
    EnergyLedger,
    Scattering,
    channel_run,
    packet_delay,
    random_walk_delay,
)

T, N = 0.01, 1500
TIMES = T * np.arange(N)
INTERPOLATION = 0.021
"""Share of the energy sent that the interpolated read-out may give out beyond it."""


def exchanged(run):
    """Return the energy that went to and fro at both ports up to and with each sample [J]."""
    return T * np.cumsum(np.abs(run.r_m * run.f_m) + np.abs(run.r_s * run.f_s), axis=0).sum(axis=1)


def random_channel(seed):
    """
    Arguments of a random channel: one robot or several with bounds of their own, leaders that
    change while waves are under way, scales within bounds or at them, and delays whose rate reaches
    its limit.
    """
    rng = default_rng([33, seed])
    robots = 1 if seed % 2 else int(rng.integers(2, 7))
    rate = rng.uniform(0.0, 1.0)
    lows, highs = np.sort(rng.uniform(0.01, (1.0, 3.0), (2, robots, 2)), axis=0)
    impedances = 10 ** rng.uniform(-1.5, 1.5, robots)
    ends = [
        Scattering(b, low[0], high[0], low[1], high[1], max_delay_rate=rate)
        for b, low, high in zip(impedances, lows, highs, strict=True)
    ]
    hold = int(10 ** rng.uniform(0.0, 2.5))  # from every sample to 3 s, delays are up to 1.5 s
    leaders = np.repeat(rng.integers(robots, size=N // hold + 1), hold)[:N]
    share = rng.uniform(size=(N, 2))
    if seed % 3 == 0:  # scales that jump from bound to bound
        share = share.round()
    alpha, beta = (lows[leaders] + share * (highs - lows)[leaders]).T
    delays = [
        random_walk_delay(0.02, 1.5, rate, seed=int(walk), hold=0.3)
        for walk in rng.integers(1 << 30, size=2)
    ]
    if seed % 5 == 0:
        delays = [float(T * late) for late in rng.integers(1, 151, size=2)]
    r_m, f_s = random_signals(rng, TIMES)
    return {
        "r_m": r_m,
        "f_s": f_s,
        "scattering": ends,
        "sample_time": T,
        "delay_1": delays[0],
        "delay_2": delays[1],
        "alpha": alpha,
        "beta": beta,
        "leaders": leaders,
    }


@pytest.mark.parametrize("read_out", ["ledger", "interpolated"])
def test_energy_is_never_negative_in_200_random_channels(read_out):
    """(4.15) at every sample, and the wave energy of (4.13)-(4.14) below it."""
    for seed in range(200):
        run = channel_run(**random_channel(seed), read_out=read_out)
        margin = rounding = 1e-12 * exchanged(run).max()
        if read_out == "interpolated":
            margin += INTERPOLATION * T * ((run.u_l**2).sum() + (run.u_r**2).sum())
        else:
            assert run.wave_energy.min() >= -margin, seed
        assert run.energy.min() >= -margin, seed
        assert (run.energy - run.wave_energy).min() >= -rounding, seed


def test_waves_are_those_of_3_13_and_4_7():
    """
    Oracle: u and v in terms of f and r, from which (3.15), the power at the ports, follows by
    algebra.
    """
    for seed in range(50):
        arguments = random_channel(seed)
        run, leaders = channel_run(**arguments), arguments["leaders"]
        assert_allclose(run.t, TIMES)
        b, a_low, a_high, b_low, b_high = (
            np.array([getattr(end, name) for end in arguments["scattering"]])[leaders][:, None]
            for name in ("b", "alpha_min", "alpha_max", "beta_min", "beta_max")
        )
        near, far = run.f_m / arguments["beta"][:, None], run.r_s / arguments["alpha"][:, None]
        waves = {
            "u_l": np.sqrt(b_low / (2 * b)) * (near + b * run.r_m),
            "v_l": np.sqrt(b_high / (2 * b)) * (near - b * run.r_m),
            "u_r": np.sqrt(a_low / (2 * b)) * (run.f_s - b * far),
            "v_r": np.sqrt(a_high / (2 * b)) * (run.f_s + b * far),
        }
        for name, wave in waves.items():
            atol = 1e-9 * np.abs(wave).max()
            assert_allclose(getattr(run, name), wave, rtol=1e-9, atol=atol)


def test_jitter_overtaking_and_lost_packets_only_take_energy_away():
    rng = default_rng(8)
    sent = T * np.arange(N + 100)
    for seed in range(40):
        received = sent + rng.uniform(0.01, 0.3, (2, sent.size))
        received[rng.uniform(size=received.shape) < 0.3] = np.nan
        lossy = [packet_delay(sent, times) for times in received]
        for there, back in (lossy, (jitter(seed, 0.3), jitter(seed + 40, 0.3))):
            run = channel_run(**random_channel(seed) | {"delay_1": there, "delay_2": back})
            assert (run.energy >= -1e-9 * exchanged(run)).all()
            assert run.v_r.any()


class Ungained(Scattering):
    """A guard removed: delayed waves are read at full size although the delay grows."""

    gain = 1.0


def one_way(seed, read_out, kind=Scattering):
    """
    The least energy of a wave sent one way only, against a delay that grows at a constant rate,
    relative to that of its greatest sample.
    """
    rng = default_rng([34, seed])
    rate = rng.uniform(0.05, 0.95)
    scattering = kind(1.0, 1e-9, 1.0, max_delay_rate=rate)
    wave = np.zeros((300, 1))
    begin, length = rng.integers(0, 60), rng.integers(1, 40)
    wave[begin : begin + length, 0] = rng.choice([-1.0, 1.0], length) if seed % 2 else 1.0
    start = rng.uniform(0.01, 0.02)
    delay = Delay(lambda t: start + rate * t, rate, "ramp")
    run = channel_run(wave, np.zeros_like(wave), scattering, T, delay, 0.05, read_out=read_out)
    return (run.wave_energy / (T * (run.u_l**2).max())).min()


@pytest.mark.parametrize(
    ("read_out", "kind", "low", "high"),
    [
        ("ledger", Scattering, -1e-12, 0.0),
        ("interpolated", Scattering, -INTERPOLATION, 0.0),
        ("hold", Scattering, -np.inf, -0.1),
        ("interpolated", Ungained, -np.inf, -5.0),
    ],
)
def test_which_read_outs_keep_their_margin_while_a_delay_grows(read_out, kind, low, high):
    """The last two are negative controls."""
    assert low <= min(one_way(seed, read_out, kind) for seed in range(200)) <= high


# Leaders of a team


@pytest.mark.parametrize("same_bounds", [False, True])
def test_ends_may_switch_at_other_times(same_bounds):
    """
    The operator's end may be set for any robot whose bounds hold β: each end balances by itself.
    With the same bounds it need not switch at all: waves carry their energy whatever b made them.
    """
    for seed in range(0, 100, 2):
        arguments = random_channel(seed)
        ends, leaders = arguments["scattering"], arguments["leaders"]
        near = np.roll(leaders, 40)
        if same_bounds:
            near = np.zeros(N, int)
            ends = [
                Scattering(end.b, beta_min=0.5, beta_max=1.5, max_delay_rate=end.max_delay_rate)
                for end in ends
            ]
            arguments["alpha"] = None
        low, high = np.array([(end.beta_min, end.beta_max) for end in ends])[near].T
        arguments["beta"] = default_rng(seed).uniform(low, high)
        arguments |= {"scattering": ends, "leaders": np.array([near, leaders])}
        run = channel_run(**arguments)
        assert run.energy.min() >= -1e-12 * exchanged(run).max()


# Ledgers and delays


@given(st.lists(st.tuples(st.integers(0, 30), st.floats(-5, 5), st.booleans()), max_size=80))
def test_a_ledger_never_gives_more_than_it_got(events):
    ledger, sent = EnergyLedger(T), {}
    for number, value, read in events:
        assert ledger.receive(number, [value]) == (number not in sent)
        sent.setdefault(number, value)
        if read:
            ledger.read()
        # A packet counts once, and also when a later one has come before it.
        got = T * sum(v * v for v in sent.values())
        assert ledger.received == pytest.approx(got)
        assert ledger.given <= got * (1 + 1e-12) + 1e-15
        assert ledger.balance >= 0.0


def test_a_trace_of_packets_is_read_at_the_newest_that_arrived():
    """Oracle: the newest of all that have come, by brute force; half are lost, some overtake."""
    rng, sent = default_rng(3), np.arange(0.0, 20.0, 0.005)
    received = sent + rng.exponential(0.05, sent.size)
    received[rng.uniform(size=sent.size) < 0.5] = np.nan
    trace = packet_delay(sent, received)
    assert (trace.end, trace.max_rate) == (np.nanmax(received), np.inf)
    late = trace.samples(1900, T)
    for k in range(0, 1900, 37):
        newest = max(sent[received <= T * k + 1e-9], default=-T)
        assert late[k] == pytest.approx(max(T * k - newest, T), abs=1e-12)


def test_random_walk_keeps_bounds_rate_and_seed():
    values, again = (random_walk_delay(0.05, 0.8, 0.6, seed=4).samples(5000, T) for _ in range(2))
    assert 0.05 <= values.min() <= values.max() <= 0.8
    assert 0.5 < (np.diff(values) / T).max() <= 0.6 + 1e-9
    np.testing.assert_array_equal(values, again)
