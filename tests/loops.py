"""What tests of loops share: random signals, columns of flights, teams by one list of options."""

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from trustlab.teleoperation import Delay, TeamChannel, TeamSettings, TeamTrial
from trustlab.teleoperation.loop.kernel import GUIDANCE

# --- signals --------------------------------------------------------------------------------------


def random_signals(rng, t, size=3, fastest=2.0):
    """Two signals at times t [s]: each noise, sines up to 10^`fastest` rad/s, or steps."""
    count, drawn = len(t), []
    for kind in rng.integers(3, size=2):
        if kind == 0:
            signal = rng.normal(size=(count, size))
        elif kind == 1:
            rate = 10 ** rng.uniform(-1.0, fastest)
            signal = np.sin(rate * t[:, None] + rng.uniform(0.0, 6.0, size))
        else:
            signal = np.repeat(rng.normal(size=(count // 30 + 1, size)), 30, axis=0)[:count]
        drawn.append(10 ** rng.uniform(-2.0, 2.0) * signal)
    return drawn


# --- flights --------------------------------------------------------------------------------------


T = 0.01
each_guidance = pytest.mark.parametrize("guidance", GUIDANCE)


def columns(run, stem):
    """The three columns of a vector, of a session or of its data."""
    return np.column_stack([run[f"{stem}_{axis}"] for axis in "xyz"])


def missed(run):
    """From the robot to its target."""
    return columns(run, "reference") - columns(run, "robot")


def power(run, velocity, force):
    return (columns(run, velocity) * columns(run, force)).sum(axis=1)


def phase(seed):
    """Where the target of a seed begins on its way [rad]."""
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(5)[0])
    return rng.uniform(0.0, 2.0 * np.pi)


def jitter(seed, most=0.6):
    """A delay drawn anew in every sample: packets overtake one another."""
    return Delay(
        lambda t: np.random.default_rng(seed).uniform(0.02, most, t.size), np.inf, "drawn anew"
    )


def assert_device_balances(run, guarded=True, scaling=1.0):
    """
    What is stored and lost in the device is what its two ports supplied, from the log; (3.25), with
    the sign of (3.11).
    """
    held = run["energy_device"] + run["energy_dissipated"]
    supplied = T * np.cumsum(power(run, "r_m", "f_h") / scaling - power(run, "r_m", "f_m"))
    assert_allclose(held, supplied, rtol=1e-10, atol=1e-12 * max(1.0, held.max()))
    assert min(run["energy_device"]) >= 0.0
    assert min(np.diff(run["energy_dissipated"])) >= 0.0
    assert min(run["energy_port"]) >= -1e-9 or not guarded


# --- teams ----------------------------------------------------------------------------------------


def picked(kind, options):
    """The options that a class of settings has, taken out of `options`."""
    return {item.name: options.pop(item.name) for item in fields(kind) if item.name in options}


def team_loop(graph, policy="most_trusted", goal=(1.0, 2.0, 0.5), seed=0, **options):
    """A loop by one list of options, at 0.01 s; theorems hold whoever is trusted."""
    settings = options.pop("settings", TeamSettings())
    options = {"performance": "random", "sample_time": T} | options
    channel, trial = picked(TeamChannel, options), picked(TeamTrial, options)
    changed = {"channel": TeamChannel(**channel)} | picked(TeamSettings, options)
    options |= {"settings": replace(settings, **changed), "trial": TeamTrial(**trial)}
    return tl.TeamLoop(graph, policy, goal, seed, **options)


def simulate_team(*arguments, **options):
    return team_loop(*arguments, **options).run()
