"""What tests of the teleoperation loop read from a log, and what they put into it."""

import numpy as np

from trustlab.teleoperation import Delay

T = 0.01


def columns(run, stem):
    """The three columns of a vector, of a session or of its data."""
    return np.column_stack([run[f"{stem}_{axis}"] for axis in "xyz"])


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


def assert_device_balances(run):
    """What is stored and lost in the device is what its two ports supplied, from the log."""
    held = run["energy_device"] + run["energy_dissipated"]
    supplied = T * np.cumsum(power(run, "r_m", "f_h") - power(run, "r_m", "f_m"))
    np.testing.assert_allclose(held, supplied, rtol=1e-10, atol=1e-12 * max(1.0, held.max()))
    assert min(run["energy_device"]) >= 0.0
    assert min(np.diff(run["energy_dissipated"])) >= 0.0
    assert min(run["energy_port"]) >= -1e-9
