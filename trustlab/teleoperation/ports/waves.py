"""The scattering transformation with variable power scaling, (3.12)-(3.14) and (3.22)."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import finite_number, positive, set_checked
from trustlab.models.compiled import njit


class OperatorEnd(NamedTuple):
    """
    Coefficients of (3.22) at the operator's end: f'_m = b r_m + arriving v_l, u_l = sent r_m +
    reflected v_l.
    """

    b: float
    arriving: float
    sent: float
    reflected: float


class RobotEnd(NamedTuple):
    """
    Coefficients of (3.22) at the robot's end: r'_s = (arriving v_r − f_s)/b, u_r = sent f_s −
    reflected v_r.
    """

    b: float
    arriving: float
    sent: float
    reflected: float


# These six functions are the only place where the wave equations stand. Kernels call them compiled;
# `Scattering` calls their Python originals (`.py_func`) on whole arrays.


@njit(error_model="numpy", forceinline=True)
def operator_end(b, beta_min, beta_max):
    """Return the coefficients at the operator's end for an impedance and the bounds of β."""
    return OperatorEnd(
        b, np.sqrt(2.0 * b / beta_max), np.sqrt(2.0 * b * beta_min), np.sqrt(beta_min / beta_max)
    )


@njit(error_model="numpy", forceinline=True)
def robot_end(b, alpha_min, alpha_max):
    """Return the coefficients at the robot's end for an impedance and the bounds of α."""
    return RobotEnd(
        b,
        np.sqrt(2.0 * b / alpha_max),
        np.sqrt(2.0 * alpha_min / b),
        np.sqrt(alpha_min / alpha_max),
    )


@njit(error_model="numpy", forceinline=True)
def operator_force(end, r_m, v_l):
    """Return the force f'_m at the operator's end, before its scaling by β."""
    return end.b * r_m + end.arriving * v_l


@njit(error_model="numpy", forceinline=True)
def operator_wave(end, r_m, v_l):
    """Return the wave u_l that leaves the operator's end."""
    return end.sent * r_m + end.reflected * v_l


@njit(error_model="numpy", forceinline=True)
def robot_velocity(end, f_s, v_r):
    """Return the velocity r'_s at the robot's end, before its scaling by α."""
    return end.arriving * v_r / end.b - f_s / end.b


@njit(error_model="numpy", forceinline=True)
def robot_wave(end, f_s, v_r):
    """Return the wave u_r that leaves the robot's end."""
    return end.sent * f_s - end.reflected * v_r


def delay_rate(name: str, value) -> float:
    """Return how fast a delay grows at most [s/s], in [0, 1]."""
    rate = finite_number(name, value)
    if not 0.0 <= rate <= 1.0:
        raise ValueError(
            f"{name} must lie in [0, 1], got {rate}: a delay that grows faster than time lets "
            "nothing arrive (Theorem 3)"
        )
    return rate


@dataclass(frozen=True)
class Scattering:
    """
    Wave variables at both ends of a channel whose powers are scaled by α(t) and β(t), equations
    (3.13) and (3.22).

    f'_m = b r_m + √(2b/β_max) v_l, u_l = √(2bβ_min) r_m + √(β_min/β_max) v_l, r'_s = (√(2b/α_max)
    v_r − f_s)/b, u_r = √(2α_min/b) f_s − √(α_min/α_max) v_r, and r_s = α r'_s, f_m = β f'_m. Waves
    leave with the lower bound of the scale and arrive with the upper one, so that no scale within
    its bounds generates energy.

    Parameters
    ----------
    b : float
        Characteristic impedance [N s/m], positive.
    alpha_min, alpha_max : float
        Bounds of α, 0 < alpha_min ≤ alpha_max ≤ 1 (3.1).
    beta_min, beta_max : float
        Bounds of β, 0 < beta_min ≤ beta_max (3.1).
    max_delay_rate : float
        Ṫ_max in [0, 1] of both delays; sets f_i = √(1 − Ṫ_max).

    Raises
    ------
    ValueError
        If a number is not finite or breaks (3.1).

    Notes
    -----
    Saeidi, Theorem 3.

    Examples
    --------
    >>> round(Scattering(b=1.0, alpha_min=0.05, beta_min=0.2, max_delay_rate=0.5).gain, 4)
    0.7071
    """

    b: float
    alpha_min: float = 1.0
    alpha_max: float = 1.0
    beta_min: float = 1.0
    beta_max: float = 1.0
    max_delay_rate: float = 0.0

    def __post_init__(self):
        set_checked(self, positive, "b")
        set_checked(self, delay_rate, "max_delay_rate")
        set_checked(self, finite_number, "alpha_min", "alpha_max", "beta_min", "beta_max")
        for name in ("alpha", "beta"):
            low, high = getattr(self, f"{name}_min"), getattr(self, f"{name}_max")
            if not low > 0.0:
                raise ValueError(
                    f"{name}_min must be positive, got {low}: a scale of zero leaves one-way "
                    "teleoperation (3.1)"
                )
            if low > high:
                raise ValueError(f"{name}_min must not exceed {name}_max, got {low} and {high}")
        if self.alpha_max > 1.0:
            raise ValueError(f"alpha_max must not exceed 1 (3.1), got {self.alpha_max}")

    @property
    def gain(self) -> float:
        """f_i = √(1 − Ṫ_max), the gain at which delayed waves are read (3.13)."""
        return math.sqrt(1.0 - self.max_delay_rate)

    @property
    def at_operator(self) -> OperatorEnd:
        """Coefficients of the wave equations at the operator's end."""
        return operator_end.py_func(self.b, self.beta_min, self.beta_max)

    @property
    def at_robot(self) -> RobotEnd:
        """Coefficients of the wave equations at the robot's end."""
        return robot_end.py_func(self.b, self.alpha_min, self.alpha_max)

    def master(self, r_m: np.ndarray, v_l: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return f'_m [N] and u_l [√W] at the operator's end.

        Parameters
        ----------
        r_m : array_like
            Output of the haptic device [m/s].
        v_l : array_like
            Wave that arrives from the robot [√W], of the same shape.
        """
        r_m, v_l = np.asarray(r_m, dtype=float), np.asarray(v_l, dtype=float)
        end = self.at_operator
        return operator_force.py_func(end, r_m, v_l), operator_wave.py_func(end, r_m, v_l)

    def slave(self, f_s: np.ndarray, v_r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return r'_s [m/s] and u_r [√W] at the robot's end.

        Parameters
        ----------
        f_s : array_like
            Force feedback at the robot's port [N].
        v_r : array_like
            Wave that arrives from the operator [√W], of the same shape.
        """
        f_s, v_r = np.asarray(f_s, dtype=float), np.asarray(v_r, dtype=float)
        end = self.at_robot
        return robot_velocity.py_func(end, f_s, v_r), robot_wave.py_func(end, f_s, v_r)

    def check_scales(self, alpha: np.ndarray, beta: np.ndarray) -> None:
        """
        Refuse scales outside their bounds.

        Parameters
        ----------
        alpha, beta : array_like
            α and β, any shape.

        Raises
        ------
        ValueError
            If a scale is not finite or outside its bounds; the sample is named.
        """
        for name, values in (("alpha", alpha), ("beta", beta)):
            values = np.atleast_1d(np.asarray(values, dtype=float))
            low, high = getattr(self, f"{name}_min"), getattr(self, f"{name}_max")
            bad = ~((values >= low * (1 - 1e-12)) & (values <= high * (1 + 1e-12)))
            if bad.any():
                k = int(np.argmax(bad))
                raise ValueError(
                    f"{name} must lie in [{low}, {high}] ({name}_min, {name}_max), but sample {k} "
                    f"is {values.flat[k]}"
                )
