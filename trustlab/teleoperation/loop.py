"""The teleoperation loop of Fig. 3.1 with the printed settings of both studies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from trustlab.models.checks import finite_number
from trustlab.models.trust import LogisticScaling, StepScaling, TrustModel
from trustlab.models.uav import three_axes
from trustlab.teleoperation.haptic_device import HapticDevice
from trustlab.teleoperation.loop_kernel import LoopNumbers
from trustlab.teleoperation.scattering import Scattering

__all__ = ["STUDIES", "DivergenceError", "LoopSettings", "study_named", "vehicle_matrices"]


class DivergenceError(ArithmeticError):
    """A run grew without bound; says when, which block, and the energy in it."""


@dataclass(frozen=True)
class LoopSettings:
    """
    Settings of one teleoperation loop.

    Parameters
    ----------
    mass, damping, stiffness, weight : float
        M [kg], B [N s/m], K [N/m] and Λ [1/s] of the haptic device, the same on all axes.
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
        y_max of N in (3.27): for commands [m/s] and for tracking errors [m], both as 1-norms over three axes.
    printed_sign : bool
        Use the printed f'_s = +k_ffa e, an active spring that pushes the hand away from the target.
    require_passive : bool
        Refuse a device that is not r-passive.
    title : str
        What these settings are.

    Raises
    ------
    ValueError
        If a value is out of range; `PassivityError` if the device is too heavy for its gains.
    """

    mass: float
    damping: float
    stiffness: float
    weight: float
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

    def __post_init__(self):
        for name in ("mass", "damping", "stiffness", "weight"):
            object.__setattr__(self, name, finite_number(name, getattr(self, name)))
        if not isinstance(self.scattering, Scattering):
            raise ValueError(f"scattering must be of class Scattering, got {type(self.scattering).__name__}")
        for name in ("human_to_robot", "robot_to_human"):
            if not isinstance(getattr(self, name), TrustModel):
                raise ValueError(
                    f"{name} must be of class TrustModel, got {type(getattr(self, name)).__name__}"
                )
        for name in ("k_ffa", "height", "window", "command_range", "error_range"):
            object.__setattr__(self, name, finite_number(name, getattr(self, name)))
        if self.k_ffa < 0.0:
            raise ValueError(
                f"k_ffa cannot be negative, got {self.k_ffa}; printed_sign=True gives the printed direction"
            )
        for name in ("window", "command_range", "error_range"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        self.scalings("logistic")
        self.device()

    def device(self) -> HapticDevice:
        """Return the haptic device, checked for r-passivity with the damping that its port always has."""
        return HapticDevice(
            self.mass,
            self.damping,
            self.stiffness,
            self.weight,
            force_scaling=self.force_scaling,
            port_damping=self.scattering.beta_min * self.scattering.b,
            require_passive=self.require_passive,
        )

    def scalings(self, kind: str = "logistic"):
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
            return tuple(StepScaling(low, high, None, trust.t_min, trust.t_max) for low, high, trust in pairs)
        return tuple(
            LogisticScaling(low, high, self.steepness, None, trust.t_min, trust.t_max)
            for low, high, trust in pairs
        )

    def numbers(self, sample_time: float) -> LoopNumbers:
        """
        Return the settings as compiled loops take them.

        Parameters
        ----------
        sample_time : float
            T [s].
        """
        device, ends, (alpha, beta) = self.device(), self.scattering, self.scalings()
        trusts = (self.human_to_robot, self.robot_to_human)
        middle = [
            (scaling.midpoint - trust.t_min) / (trust.t_max - trust.t_min)
            for scaling, trust in zip((alpha, beta), trusts, strict=True)
        ]
        rates = [number for trust in trusts for number in (trust.keep(sample_time), trust.b / trust.a)]
        return LoopNumbers(
            sample_time,
            device.mass[0, 0],
            device.damping[0, 0],
            device.stiffness[0, 0],
            device.weight[0, 0],
            device.force_scaling,
            *ends.numbers.tolist(),
            -self.k_ffa if self.printed_sign else self.k_ffa,
            self.steepness,
            self.steepness,
            *middle,
            *rates,
            0.5,
            0.5,
            max(round(self.window / sample_time), 1),
            self.command_range,
            self.error_range,
            trusts[0].p_min,
            trusts[0].p_max,
        )


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
    ),
}
"""Printed settings. The device's mass, the rates of trust and y_max are not printed: the first is near the
heaviest that is r-passive with the printed gains of each study (9.2 g and 0.55 kg); the others are ours."""


def study_named(study: str | LoopSettings) -> LoopSettings:
    """
    Return the settings of a study.

    Parameters
    ----------
    study : {"preliminary", "main"} or LoopSettings
        Printed settings by name, or own ones.

    Raises
    ------
    ValueError
        If there is no study of that name.
    """
    if isinstance(study, LoopSettings):
        return study
    if isinstance(study, str) and study in STUDIES:
        return STUDIES[study]
    raise ValueError(f"study must be one of {', '.join(map(repr, STUDIES))}, or LoopSettings, got {study!r}")


def vehicle_matrices(axes, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return exact one-sample matrices of (position, velocity, acceleration) for a command held over the sample.

    Parameters
    ----------
    axes : sequence of three TransferFunction
        Command to velocity on x, y and z; order 1 leaves the acceleration at zero.
    sample_time : float
        T [s].

    Returns
    -------
    phi : numpy.ndarray, shape (3, 3, 3)
        State transition per axis.
    gamma : numpy.ndarray, shape (3, 3)
        Effect of the command per axis.

    Raises
    ------
    ValueError
        If there are not three transfer functions, or the sample time is not positive.
    """
    from scipy.linalg import expm

    sample_time = finite_number("sample_time", sample_time)
    if not sample_time > 0.0:
        raise ValueError(f"sample_time must be positive, got {sample_time}")
    axes = three_axes(axes)
    phi, gamma = np.zeros((3, 3, 3)), np.zeros((3, 3))
    for i, axis in enumerate(axes):
        n = axis.order + 1
        a, b = axis.matrices()
        block = np.zeros((n + 1, n + 1))
        block[0, 1], block[1:n, 1:n], block[1:n, n] = 1.0, a, b
        whole = expm(block * sample_time)
        phi[i, :n, :n], gamma[i, :n] = whole[:n, :n], whole[:n, n]
    return phi, gamma
