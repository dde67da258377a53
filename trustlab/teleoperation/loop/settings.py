"""
The teleoperation loop of Fig. 3.1: its settings, the printed ones of both studies, and the
constants that the compiled loop takes.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from trustlab.allocation.blending import OptimalBlending
from trustlab.models.checks import (
    finite_array,
    finite_number,
    of_class,
    one_of,
    positive,
    set_checked,
)
from trustlab.models.linear_algebra import matrix_exponential
from trustlab.models.simulation import DivergenceError as DivergenceError
from trustlab.models.trust import LogisticScaling, StepScaling, TrustModel
from trustlab.models.uav import TransferFunction, three_axes
from trustlab.sessions.session import Session
from trustlab.teleoperation.loop.kernel import linear_vehicle
from trustlab.teleoperation.loop.parts import LOOP, MEMORY, SETUP, STATE, VEHICLE, Part
from trustlab.teleoperation.ports import device as haptic
from trustlab.teleoperation.ports.device import HapticDevice
from trustlab.teleoperation.ports.waves import Scattering
from trustlab.teleoperation.records import filled

STUDY_NAMES = ("preliminary", "main")


class PartError(ValueError):
    """
    A part raised an error or returned an invalid value: says which and when. `.session` has the run
    so far, if two samples.
    """

    session: Session | None = None


@dataclass(frozen=True)
class LoopSettings:
    """
    Settings of one teleoperation loop.

    Parameters
    ----------
    mass, damping, stiffness, weight : float or three floats
        M [kg], B [N s/m], K [N/m] and Λ [1/s] of the haptic device, the same on all axes or axis by
        axis.
    scattering : Scattering
        Impedance b, bounds of α and β, and Ṫ_max.
    k_ffa : float
        Stiffness of the force feedback f'_s = −k_ffa e [N/m].
    height : float
        z_d, how far above its target the robot should fly [m].
    human_to_robot, robot_to_human : TrustModel
        (3.2) and (3.3).
    steepness : float
        s_α = s_β of (3.5).
    force_scaling : float
        γ of (3.25).
    window : float
        W of (3.26) [s].
    command_range, error_range : float
        y_max of N in (3.27): for commands [m/s] and for tracking errors [m], both as 1-norms over
        three axes.
    printed_sign : bool
        Use the printed f'_s = +k_ffa e, an active spring that pushes the hand away from the target.
    require_passive : bool
        Refuse a device that is not r-passive.
    title : str
        What these settings are.
    study : {"main", "preliminary"}
        The study whose task, delays and operator's reach are the defaults; `dataclasses.replace`
        keeps it.

    Raises
    ------
    ValueError
        If a value is out of range; `PassivityError` if the device is too heavy for its gains.
    """

    mass: float | tuple[float, float, float]
    damping: float | tuple[float, float, float]
    stiffness: float | tuple[float, float, float]
    weight: float | tuple[float, float, float]
    scattering: Scattering
    k_ffa: float
    height: float
    human_to_robot: TrustModel = field(default_factory=lambda: TrustModel(a=0.2, b=0.2))
    robot_to_human: TrustModel = field(default_factory=lambda: TrustModel(a=0.2, b=0.2))
    steepness: float = 10.0
    force_scaling: float = 1.0
    window: float = 10.0
    command_range: float = 3.0
    error_range: float = 3.0
    printed_sign: bool = False
    require_passive: bool = True
    title: str = "own settings"
    study: str = "main"

    def __post_init__(self):
        for name in ("mass", "damping", "stiffness", "weight"):
            value = getattr(self, name)
            each = np.ndim(value) and tuple(finite_array(name, value, length=3).tolist())
            object.__setattr__(self, name, each or finite_number(name, value))
        set_checked(self, finite_number, "height", "k_ffa")
        set_checked(self, positive, "window", "command_range", "error_range")
        of_class("scattering", self.scattering, Scattering)
        of_class("human_to_robot", self.human_to_robot, TrustModel)
        of_class("robot_to_human", self.robot_to_human, TrustModel)
        one_of("study", self.study, STUDY_NAMES)
        if self.k_ffa < 0.0:
            raise ValueError(
                f"k_ffa must not be negative, got {self.k_ffa}; printed_sign=True gives the "
                "printed direction"
            )
        self.scalings("logistic")
        self.device()

    def device(self) -> HapticDevice:
        """
        Return the haptic device, checked for r-passivity with the damping that its port always has.
        """
        return HapticDevice(
            self.mass,
            self.damping,
            self.stiffness,
            self.weight,
            force_scaling=self.force_scaling,
            port_damping=self.scattering.beta_min * self.scattering.b,
            require_passive=self.require_passive,
        )

    def scalings(self, kind: str = "logistic") -> tuple:
        """
        Return α as a function of human-to-robot trust, and β of robot-to-human trust.

        Parameters
        ----------
        kind : {"logistic", "step"}
            (3.5) or (3.6).
        """
        pairs = (
            (self.scattering.alpha_min, self.scattering.alpha_max, self.human_to_robot),
            (self.scattering.beta_min, self.scattering.beta_max, self.robot_to_human),
        )
        if kind == "step":
            return tuple(
                StepScaling(low, high, None, trust.t_min, trust.t_max) for low, high, trust in pairs
            )
        return tuple(
            LogisticScaling(low, high, self.steepness, None, trust.t_min, trust.t_max)
            for low, high, trust in pairs
        )

    def numbers(self, sample_time: float) -> np.void:
        """
        Return the settings as the compiled loop takes them.

        Parameters
        ----------
        sample_time : float
            T [s].
        """
        return filled(
            LOOP,
            force_scaling=self.force_scaling,
            gain=self.scattering.gain,
            guidance=-self.k_ffa if self.printed_sign else self.k_ffa,
            steepness=self.steepness,
            trust_hr=_trust_numbers(self.human_to_robot, sample_time),
            trust_rh=_trust_numbers(self.robot_to_human, sample_time),
            window=max(round(self.window / sample_time), 1),
            command_range=self.command_range,
            error_range=self.error_range,
        )


def _trust_numbers(trust: TrustModel, sample_time: float) -> tuple:
    """Return a trust model for one sample time, a record of TRUST."""
    return (
        trust.decay(sample_time),
        trust.b / trust.a,
        trust.p_min,
        trust.p_max,
        trust.t_min,
        trust.t_max,
    )


# Printed settings. The device's mass, the rates of trust and y_max are not printed: the first is
# near the heaviest that is r-passive with the printed gains of each study (9.2 g and 0.55 kg); the
# others are ours.
STUDIES = {
    "preliminary": LoopSettings(
        mass=0.009,
        damping=0.55,
        stiffness=100.0,
        weight=60.0,
        scattering=Scattering(1.0, 0.05, 1.0, 0.2, 1.0, max_delay_rate=0.5),
        k_ffa=3.0,
        height=4.0,
        command_range=6.0,
        error_range=12.0,
        title="preliminary study (Section 3.8.1)",
        study="preliminary",
    ),
    "main": LoopSettings(
        mass=0.5,
        damping=5.5,
        stiffness=20.0,
        weight=10.0,
        scattering=Scattering(2.0, 0.2, 1.0, 0.05, 0.5, max_delay_rate=0.5),
        k_ffa=6.0,
        height=1.5,
        command_range=2.0,
        error_range=3.0,
        title="main study (Section 3.9)",
        study="main",
    ),
}


def study_named(study: str | LoopSettings) -> LoopSettings:
    """Return the printed settings of a study by name, or own ones as they are."""
    if isinstance(study, LoopSettings):
        return study
    return STUDIES[one_of("study", study, STUDY_NAMES, also="LoopSettings")]


# States that a vehicle given by matrices may have: its memory also holds where it started.
MOST_STATES = MEMORY - 3


def setup_of(
    settings: LoopSettings, hand: np.void, auto: np.void, sample_time: float
) -> np.ndarray:
    """Return the constants of a loop, a record of SETUP, without parts and vehicle."""
    setups = np.zeros(1, SETUP)
    device = settings.device()
    ends = settings.scattering
    axes = haptic.held_device.py_func(
        *(np.diag(m) for m in (device.mass, device.damping, device.stiffness, device.weight)),
        hand["stiffness"],
        hand["damping"],
        sample_time,
    )
    setup = setups[0]
    setup["sample_time"] = sample_time
    setup["loop"] = settings.numbers(sample_time)
    setup["hand"] = hand
    setup["auto"] = auto
    setup["near"], setup["far"] = ends.at_operator, ends.at_robot
    for name, value in axes._asdict().items():
        setup["device"][name] = value
    setup["admittance"] = settings.force_scaling * axes.lever / axes.inertia
    return setups


def state_of(settings: LoopSettings, sample_time: float) -> np.ndarray:
    """
    Return the state before the first sample, a record of STATE: scales at their upper bounds, trust
    mid-way.
    """
    states, ends = np.zeros(1, STATE), settings.scattering
    states["sample_time"] = sample_time
    for name in ("alpha", "beta"):
        states[f"{name}_min"] = getattr(ends, f"{name}_min")
        states[f"{name}_max"] = states[name] = getattr(ends, f"{name}_max")
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
    matrices = {"A": np.array(a), "B": np.array(b), "C": np.array(c)}
    n = len(a)
    for (name, matrix), shape in zip(matrices.items(), ((n, n), (n, 3), (6, n)), strict=True):
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
    transition, effect, output = matrices.values()

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
        whole = matrix_exponential(block * sample_time)
        matrices["phi"][0, i, :n, :n], matrices["gamma"][0, i, :n] = whole[:n, :n], whole[:n, n]
    return matrices
