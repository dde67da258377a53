"""
Theorem 5, (4.5)-(4.15): the channel stores energy whatever the leader, the scale and the delay do;
guards removed.
"""

import numpy as np
import pytest

from trustlab.teleoperation.channel import channel_run
from trustlab.teleoperation.delays import random_walk_delay
from trustlab.teleoperation.ports.waves import Scattering

T, K = 0.01, 1500


def exchanged(run):
    """Return the energy that went to and fro at both ports up to and with each sample [J]."""
    ports = ((run.r_m, run.f_m), (run.r_s, run.f_s))
    return T * np.cumsum(sum(np.abs((v * f).sum(axis=1)) for v, f in ports))


def random_case(seed):
    """
    Robots with bounds of their own, signals from smooth to rough, leaders that change while waves
    are under way.
    """
    rng = np.random.default_rng([75, seed])
    robots = int(rng.integers(2, 7))
    rate = rng.uniform(0.0, 0.9)
    bounds = np.sort(rng.uniform(0.01, 3.0, (robots, 2)), axis=1)
    ends = [
        Scattering(10 ** rng.uniform(-1.5, 1.5), beta_min=low, beta_max=high, max_delay_rate=rate)
        for low, high in bounds
    ]
    t = T * np.arange(K)[:, None]
    signals = []
    for _ in range(2):
        kind = rng.integers(3)
        if kind == 0:
            signal = rng.normal(size=(K, 3))
        elif kind == 1:
            signal = np.sin(10 ** rng.uniform(-1, 2) * t + rng.uniform(0, 6, 3))
        else:
            signal = np.repeat(rng.normal(size=(K // 30, 3)), 30, axis=0)
        signals.append(10 ** rng.uniform(-2, 2) * signal)
    hold = int(10 ** rng.uniform(0, 2.5))  # from every sample to 3 s, delays are up to 1.5 s
    leaders = np.repeat(rng.integers(robots, size=K // hold + 1), hold)[:K]
    share = rng.choice([0.0, 1.0], K) if seed % 3 == 0 else rng.uniform(0.0, 1.0, K)
    beta = bounds[leaders, 0] + share * (bounds[leaders, 1] - bounds[leaders, 0])
    if seed % 2:
        delays = [float(T * rng.integers(1, 151)) for _ in range(2)]
    else:
        delays = [
            random_walk_delay(0.02, 1.5, rate, seed=int(s), hold=0.3)
            for s in rng.integers(1 << 30, size=2)
        ]
    return ends, signals, leaders, beta, delays


def test_energy_of_the_channel_in_500_runs():
    """(4.15) at every sample, and the wave energy of (4.13)-(4.14) below it."""
    least, switched_in_flight = np.inf, 0
    for seed in range(500):
        ends, signals, leaders, beta, delays = random_case(seed)
        run = channel_run(*signals, ends, T, *delays, beta=beta, leaders=leaders)
        slack = 1e-12 * exchanged(run).max()
        least = min(least, run.energy.min() / exchanged(run).max())
        assert run.energy.min() >= -slack
        assert run.wave_energy.min() >= -slack
        assert (run.energy - run.wave_energy).min() >= -slack
        waves = T * np.flatnonzero(np.diff(leaders))
        switched_in_flight += waves.size > 0
    assert switched_in_flight > 400


def test_ends_may_switch_at_other_times():
    """
    The operator's end may be set for any robot whose bounds hold β: each end balances by itself.
    """
    for seed in range(50):
        ends, signals, leaders, _, delays = random_case(seed)
        late = np.roll(leaders, 40)
        low = np.array([end.beta_min for end in ends])[late]
        high = np.array([end.beta_max for end in ends])[late]
        beta = np.random.default_rng(seed).uniform(low, high)
        run = channel_run(*signals, ends, T, *delays, beta=beta, leaders=np.array([late, leaders]))
        assert run.energy.min() >= -1e-12 * exchanged(run).max()


def absorbed(near, far, beta, b=2.0, delay=20):
    """
    A robot that takes all that arrives, f_s = √(b/2) v_r, so that nothing comes back: power out is
    ½‖v_r‖².
    """
    r_m = np.random.default_rng(76).normal(size=(K, 3))
    ends = [Scattering(b, beta_min=low, beta_max=high) for low, high in ((1.0, 2.0), (0.05, 0.1))]
    v_r = np.vstack([np.zeros((delay, 3)), np.sqrt(2.0 * b * ends[near].beta_min) * r_m[:-delay]])
    f_s = np.sqrt(0.5 * b) * v_r
    leaders = np.repeat([[near], [far]], K, axis=1)
    return channel_run(r_m, f_s, ends, T, delay * T, delay * T, beta=beta, leaders=leaders)


def test_bounds_not_switched_with_the_leader_give_energy():
    """
    Negative control: β of the new leader, but the end of the channel still set for the old one's
    bounds.
    """
    right, wrong = absorbed(1, 1, 0.05), absorbed(0, 1, 0.05)
    assert right.energy.min() >= -1e-12 * exchanged(right).max()
    # closed form: β b ‖r_m‖² goes in and β_min b ‖r_m‖² comes out, with β_min that of the wrong
    # robot
    given = T * (0.05 * 2.0 * (wrong.r_m**2).sum() - 1.0 * 2.0 * (wrong.r_m[:-20] ** 2).sum())
    assert wrong.energy[-1] == pytest.approx(given, rel=1e-9)
    assert given < -0.5 * exchanged(wrong)[-1]


def test_impedance_not_switched_with_the_leader_gives_none():
    """
    What an end not switched does harm by is its bounds, not its b: waves carry their energy
    whatever made them.
    """
    for seed in range(50):
        ends, signals, leaders, _, delays = random_case(seed)
        same = [
            Scattering(end.b, beta_min=0.5, beta_max=1.5, max_delay_rate=end.max_delay_rate)
            for end in ends
        ]
        beta = np.random.default_rng(seed).uniform(0.5, 1.5, K)
        rows = np.array([np.zeros(K, int), leaders])
        run = channel_run(*signals, same, T, *delays, beta=beta, leaders=rows)
        assert run.energy.min() >= -1e-12 * exchanged(run).max()


def test_waves_obey_4_7():
    """Oracle: the definitions of u and v in terms of f and r."""
    ends, signals, leaders, beta, delays = random_case(1)
    run = channel_run(*signals, ends, T, *delays, beta=beta, leaders=leaders)
    b, low, high = (
        np.array([getattr(end, name) for end in ends])[leaders][:, None]
        for name in ("b", "beta_min", "beta_max")
    )
    f = run.f_m / beta[:, None]
    for found, wanted in (
        (run.u_l, np.sqrt(low / (2 * b)) * (f + b * run.r_m)),
        (run.v_l, np.sqrt(high / (2 * b)) * (f - b * run.r_m)),
        (run.u_r, np.sqrt(0.5 / b) * (run.f_s - b * run.r_s)),
        (run.v_r, np.sqrt(0.5 / b) * (run.f_s + b * run.r_s)),
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_one_leader_is_the_channel_of_one_robot():
    """Oracle: the run without leaders; defaults are the upper bounds of the robot that leads."""
    signals = np.random.default_rng(77).normal(size=(2, 300, 2))
    ends = [Scattering(1.0), Scattering(2.0, 0.3, 0.8, 0.2, 1.7)]
    alone = channel_run(*signals, ends[1], T)
    led = channel_run(*signals, ends, T, leaders=np.ones(300, int))
    for name in ("f_m", "r_s", "u_l", "v_l", "u_r", "v_r", "energy"):
        np.testing.assert_array_equal(getattr(led, name), getattr(alone, name))


def test_refusals():
    ends, signals, leaders, beta, _ = random_case(1)
    good = {
        "r_m": signals[0],
        "f_s": signals[1],
        "scattering": ends,
        "leaders": leaders,
        "sample_time": T,
        "beta": beta,
    }
    for change, words in (
        ({"scattering": []}, "there are 0 robots"),
        ({"leaders": leaders.astype(float)}, "whole numbers"),
        ({"r_m": np.full((K, 3), np.nan)}, "finite"),
        ({"read_out": "x"}, "read_out"),
    ):
        with pytest.raises(ValueError, match=words):
            channel_run(**(good | change))
