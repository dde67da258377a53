"""What the compiled loop is given before it runs: its constants, and a vehicle as a part."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from trustlab.allocation.blending import OptimalBlending
from trustlab.models.checks import positive
from trustlab.models.uav import TransferFunction, three_axes
from trustlab.teleoperation.loop.defaults import linear_vehicle
from trustlab.teleoperation.loop.parts import Part
from trustlab.teleoperation.loop.settings import LoopSettings
from trustlab.teleoperation.loop.state import MEMORY, SETUP, STATE, VEHICLE
from trustlab.teleoperation.ports import device as haptic

# States that a vehicle given by matrices may have: its memory also holds where it started.
MOST_STATES = MEMORY - 3


def setup_of(
    settings: LoopSettings, hand: np.void, auto: np.void, sample_time: float
) -> np.ndarray:
    """Return the constants of a loop, a record of SETUP, without parts and vehicle."""
    setups = np.zeros(1, SETUP)
    device = settings.device()
    ends = settings.scattering
    held = haptic.held_device.py_func(
        *(np.diag(m) for m in (device.mass, device.damping, device.stiffness, device.weight)),
        hand["stiffness"],
        hand["damping"],
        sample_time,
    )
    setup = setups[0]
    setup["loop"] = settings.numbers(sample_time)
    setup["hand"] = hand
    setup["auto"] = auto
    setup["near"], setup["far"] = ends.at_operator, ends.at_robot
    for name, value in held._asdict().items():
        setup["device"][name] = value
    setup["admittance"] = settings.force_scaling * held.lever / held.inertia
    return setups


def state_of(settings: LoopSettings, sample_time: float) -> np.ndarray:
    """
    Return the state before the first sample, a record of STATE: scales at their upper bounds, trust
    mid-way.
    """
    states, ends = np.zeros(1, STATE), settings.scattering
    states["sample_time"] = sample_time
    for name in ("alpha", "beta"):
        states[f"{name}_min"], states[f"{name}_max"] = (
            getattr(ends, f"{name}_min"),
            getattr(ends, f"{name}_max"),
        )
        states[name] = states[f"{name}_max"]
    for name, model in (
        ("trust_hr", settings.human_to_robot),
        ("trust_rh", settings.robot_to_human),
    ):
        states[name] = model.t_min + (model.t_max - model.t_min) * 0.5
    return states


@lru_cache(maxsize=64)
def blending_cost(vehicle, gains, low: float, high: float) -> np.ndarray:
    """Return the cost of Appendix A for this vehicle and its controller, the same on three axes."""
    return OptimalBlending(vehicle, (gains,) * 3, low, high).weights


def vehicle_of(vehicle) -> tuple[tuple[TransferFunction, ...] | None, Part | Callable]:
    """
    Return a vehicle's transfer functions, where it has some, and the part or function that steps
    it.
    """
    if callable(vehicle):
        return None, vehicle
    if (
        isinstance(vehicle, (tuple, list))
        and len(vehicle) == 3
        and all(np.ndim(m) == 2 for m in vehicle)
    ):
        return None, state_space(
            *(tuple(map(tuple, np.asarray(m, dtype=float).tolist())) for m in vehicle)
        )
    return three_axes(vehicle), linear_vehicle


@lru_cache(maxsize=16)
def state_space(a: tuple, b: tuple, c: tuple) -> Callable:
    """
    Return the function that steps x' = A x + B u and moves the vehicle from its start by C x';
    matrices as tuples of rows.
    """
    given = {"A": np.array(a), "B": np.array(b), "C": np.array(c)}
    n = len(a)
    for (name, matrix), shape in zip(given.items(), ((n, n), (n, 3), (6, n)), strict=True):
        if matrix.shape != shape:
            raise ValueError(
                f"vehicle: {name} must have shape {shape}, got {matrix.shape}: A (n, n), B (n, 3) "
                "for the commands on x, y and z, C (6, n) for position and velocity"
            )
        if not np.isfinite(matrix).all():
            raise ValueError(f"vehicle: {name} must be finite")
    if n > MOST_STATES:
        raise ValueError(
            f"vehicle: at most {MOST_STATES} states, got {n}; write a function with a memory of "
            "its own instead"
        )
    transition, effect, output = given.values()

    def step(state, memory):
        x, start = memory[:n], memory[n : n + 3]
        if state.t == 0.0:
            start[:] = state.robot
        x[:] = transition @ x + effect @ state.command
        moved = output @ x
        return start + moved[:3], moved[3:]

    return step


def vehicle_matrices(axes, sample_time: float) -> np.ndarray:
    """
    Return exact one-sample matrices of (position, velocity, acceleration) for a command held over
    the sample.

    A record of VEHICLE, shape (1,): `phi` is the state transition per axis, `gamma` the effect of
    the command. An axis of order 1 leaves its acceleration at zero.
    """
    return _matrices(three_axes(axes), positive("sample_time", sample_time)).copy()


@lru_cache(maxsize=64)
def _matrices(axes: tuple, sample_time: float) -> np.ndarray:
    """
    Return the matrices of `vehicle_matrices`, worked out once: exponentials take longer than a
    minute of the loop.
    """
    from scipy.linalg import expm

    matrices = np.zeros(1, VEHICLE)
    for i, axis in enumerate(axes):
        n = axis.order + 1
        a, b = axis.matrices()
        # exp of the block matrix [[A, B], [0, 0]] holds both the transition and the integral of the
        # held command
        block = np.zeros((n + 1, n + 1))
        block[0, 1] = 1.0
        block[1:n, 1:n] = a
        block[1:n, n] = b
        whole = expm(block * sample_time)
        matrices["phi"][0, i, :n, :n], matrices["gamma"][0, i, :n] = whole[:n, :n], whole[:n, n]
    return matrices
