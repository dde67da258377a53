"""
(3.8)-(3.11) and Proposition 2: energy balance to rounding, python-control as oracle of passivity.
"""

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.teleoperation.ports import device as compiled
from trustlab.teleoperation.ports.device import HapticDevice, PassivityError

PRELIMINARY = {"damping": 0.55, "stiffness": 100.0, "weight": 60.0}
MAIN = {"damping": 5.5, "stiffness": 20.0, "weight": 10.0}
SETTINGS = settings(max_examples=60, deadline=None, derandomize=True)


def random_device(rng, n=3, passive=True):
    root = rng.normal(size=(n, n))
    mass, weight = root @ root.T + 0.1 * np.eye(n), rng.uniform(0.5, 20.0, n)
    cross = 0.5 * (mass * weight + (mass * weight).T)
    least = np.linalg.eigvalsh(cross)[-1]
    damping = (
        np.full(n, least) * (1.0 + rng.uniform(0.0, 1.0, n)) if passive else np.full(n, 0.1 * least)
    )
    stiffness = rng.uniform(0.0, 50.0, n) + (
        np.linalg.norm(weight) ** 2 * np.linalg.norm(mass) if passive else 0
    )
    return HapticDevice(
        mass,
        damping,
        stiffness,
        weight,
        force_scaling=rng.uniform(0.3, 3.0),
        require_passive=passive,
    )


def follow(device, rng, steps=200, sample_time=0.01):
    x, v = rng.normal(size=3), rng.normal(size=3)
    for _ in range(steps):
        f_h, f_m = rng.normal(size=3), rng.normal(size=3)
        x1, v1, supply = device.step(x, v, f_h, f_m, sample_time)
        yield x, v, x1, v1, f_h, f_m, supply
        x, v = x1, v1


@pytest.mark.parametrize("seed", range(20))
def test_storage_dissipation_and_supply_balance_to_rounding(seed):
    rng = np.random.default_rng([31, seed])
    device = random_device(rng)
    for x, v, x1, v1, f_h, f_m, supply in follow(device, rng):
        before, after = device.storage(x, v), device.storage(x1, v1)
        lost = 0.01 * device.dissipation((x + x1) / 2, (v + v1) / 2)
        assert min(before, after, lost) >= 0.0
        assert abs(after - before + lost - supply) <= 1e-12 * (before + after + lost + abs(supply))
        r = device.output((x + x1) / 2, (v + v1) / 2)
        again = 0.01 * (r @ f_h / device.force_scaling - r @ f_m)  # the supply r''·f_h − r·f''_m
        assert supply == pytest.approx(again, rel=1e-10, abs=1e-14)


def test_an_active_device_shows_negative_dissipation():
    rng = np.random.default_rng(5)
    device = random_device(rng, passive=False)
    lost = [
        device.dissipation((x + x1) / 2, (v + v1) / 2) for x, v, x1, v1, *_ in follow(device, rng)
    ]
    assert min(lost) < 0.0


@pytest.mark.parametrize("gains", [PRELIMINARY, MAIN], ids=["preliminary", "main"])
def test_stable_at_the_printed_sample_time(gains):
    most = HapticDevice(mass=1e-3, **gains).largest_mass()
    device = HapticDevice(mass=most, **gains)
    x, v = np.ones(3), np.zeros(3)
    levels = [device.storage(x, v)]
    for _ in range(2000):
        x, v, _ = device.step(x, v, np.zeros(3), np.zeros(3), 0.01)
        levels.append(device.storage(x, v))
    assert (np.diff(levels) <= 1e-12 * levels[0]).all()
    assert levels[-1] < 1e-6 * levels[0]


def test_heaviest_device_of_the_preliminary_study():
    assert HapticDevice(mass=0.001, **PRELIMINARY).largest_mass() == pytest.approx(
        0.55 / 60, rel=1e-12
    )
    counted = HapticDevice(mass=0.001, port_damping=0.2, **PRELIMINARY)
    assert counted.largest_mass() == pytest.approx(0.0125, rel=1e-12)
    with pytest.raises(PassivityError, match=r"up to 0.009166 kg only, and it has 1 kg"):
        HapticDevice(mass=1.0, **PRELIMINARY)


@pytest.mark.parametrize("share", [0.5, 0.98, 1.02, 3.0])
@pytest.mark.parametrize("gains", [PRELIMINARY, MAIN], ids=["preliminary", "main"])
def test_python_control_agrees_on_passivity(gains, share):
    most = HapticDevice(mass=1e-3, dimensions=1, **gains).largest_mass()
    device = HapticDevice(mass=share * most, dimensions=1, require_passive=False, **gains)
    a, b, c = device.state_space()
    assert device.is_passive == (share < 1.0)
    assert bool(control.ispassive(control.ss(a, b, c, np.zeros((1, 1))))) == device.is_passive


@SETTINGS
@given(st.integers(0, 10_000), st.floats(0.2, 0.999))
def test_largest_mass_is_the_edge(seed, share):
    device = random_device(np.random.default_rng(seed))
    scale = device.largest_mass() / np.diag(device.mass).max()
    gains = [np.diag(m) for m in (device.damping, device.stiffness, device.weight)]
    inside = HapticDevice(device.mass * scale * share, *gains)
    assert inside.is_passive
    with pytest.raises(PassivityError):
        HapticDevice(device.mass * scale / share, *gains)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass": 0.0}, "positive definite"),
        ({"mass": np.eye(2), "damping": [1.0, 2.0, 3.0]}, "2 × 2 matrix"),
        ({"mass": [[1.0, 0.5], [0.0, 1.0]]}, "symmetric"),
        ({"damping": -1.0}, "damping must be positive"),
        ({"stiffness": -1.0}, "stiffness must be 0 or more"),
        ({"weight": 0.0}, "weight must be positive"),
        ({"weight": np.ones((3, 3)) + np.eye(3)}, "must be diagonal"),
        ({"damping": np.nan}, "damping must be finite"),
        ({"damping": "stiff"}, "damping must be a number"),
        ({"force_scaling": 0.0}, "force_scaling must be positive"),
        ({"dimensions": 0}, "dimensions must be"),
        ({"port_damping": -0.1}, "port_damping must not be negative"),
    ],
)
def test_bad_gains_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        HapticDevice(**({"mass": 0.001} | PRELIMINARY | change))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"f_h": [0.0, np.nan, 0.0]}, "f_h must be finite"),
        ({"f_m": [0.0, 0.0]}, "f_m must have 3 samples, got 2"),
        ({"sample_time": -0.01}, "sample_time must be positive"),
        ({"x": "here"}, "x must be an array of numbers"),
    ],
)
def test_bad_steps_are_refused(change, words):
    zero = np.zeros(3)
    arguments = {"x": zero, "v": zero, "f_h": zero, "f_m": zero, "sample_time": 0.01}
    with pytest.raises(ValueError, match=words):
        HapticDevice(mass=0.001, **PRELIMINARY).step(**(arguments | change))


@pytest.mark.parametrize("seed", range(5))
def test_one_compiled_axis_in_a_hand_is_the_device_with_springs_added(seed):
    """
    Oracle: the matrix device of one dimension; a hand that is a spring and a damper adds to K and B
    of the motion, and to neither storage nor loss.
    """
    rng = np.random.default_rng([32, seed])
    mass, damping, stiffness, weight, k_hand, b_hand, sample_time = rng.uniform(
        [0.01, 1.0, 5.0, 1.0, 0.0, 0.0, 1e-3], [0.1, 5.0, 50.0, 9.0, 20.0, 3.0, 1e-2]
    )
    arm = compiled.Arm(0.0, k_hand, b_hand)
    axis = compiled.held_device(mass, damping, stiffness, weight, arm, sample_time)
    bare = HapticDevice(mass, damping, stiffness, weight, dimensions=1)
    moved = HapticDevice(mass, damping + b_hand, stiffness + k_hand, weight, dimensions=1)
    x, v, force, feedback = rng.normal(size=4)
    ahead, _, _ = moved.step([x], [v], [force], [feedback], sample_time)
    middle = (ahead[0] - x) / sample_time
    assert compiled.midpoint_velocity(axis, x, v, force, feedback) == pytest.approx(
        middle, rel=1e-10
    )
    assert compiled.device_storage(axis, x, v) == pytest.approx(bare.storage([x], [v]), rel=1e-12)
    assert compiled.device_loss(axis, x, v) == pytest.approx(bare.dissipation([x], [v]), rel=1e-12)
    # Without feedback r_m of the midpoint is v + Λ (x + T v/2).
    ahead, _, _ = moved.step([x], [v], [force], [0.0], sample_time)
    middle = (ahead[0] - x) / sample_time
    output = middle + weight * (x + 0.5 * sample_time * middle)
    assert compiled.free_output(axis, x, v, force) == pytest.approx(output, rel=1e-10)
    assert axis.sample_time == sample_time
