"""The scattering transformation with variable power scaling, (3.12)-(3.14) and (3.22)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trustlab.models.checks import finite_number

__all__ = ["Scattering"]


@dataclass(frozen=True)
class Scattering:
    """
    Wave variables at both ends of a channel whose powers are scaled by α(t) and β(t), equations (3.13) and (3.22).

    f'_m = b r_m + √(2b/β_max) v_l, u_l = √(2bβ_min) r_m + √(β_min/β_max) v_l,
    r'_s = (√(2b/α_max) v_r − f_s)/b, u_r = √(2α_min/b) f_s − √(α_min/α_max) v_r, and r_s = α r'_s, f_m = β f'_m.
    Waves go out with the least scale and come in with the greatest, so that no scale within its bounds gives energy away.

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
        for name in ("b", "alpha_min", "alpha_max", "beta_min", "beta_max", "max_delay_rate"):
            object.__setattr__(self, name, finite_number(name, getattr(self, name)))
        if not self.b > 0.0:
            raise ValueError(f"b is an impedance and must be positive, got {self.b}")
        for name in ("alpha", "beta"):
            low, high = getattr(self, f"{name}_min"), getattr(self, f"{name}_max")
            if not low > 0.0:
                raise ValueError(
                    f"{name}_min must be positive, got {low}: a scale of zero leaves one-way teleoperation (3.1)"
                )
            if low > high:
                raise ValueError(f"{name}_min must not exceed {name}_max, got {low} and {high}")
        if self.alpha_max > 1.0:
            raise ValueError(f"alpha_max must not exceed 1 (3.1), got {self.alpha_max}")
        if not 0.0 <= self.max_delay_rate <= 1.0:
            raise ValueError(
                f"max_delay_rate must lie in [0, 1], got {self.max_delay_rate}: a delay that grows faster than time lets "
                "nothing arrive (Theorem 3)"
            )

    @property
    def gain(self) -> float:
        """f_i = √(1 − Ṫ_max), the gain at which delayed waves are read (3.13)."""
        return math.sqrt(1.0 - self.max_delay_rate)

    @property
    def numbers(self) -> np.ndarray:
        """b, α_min, α_max, β_min, β_max, f_i as compiled loops take them."""
        return np.array([self.b, self.alpha_min, self.alpha_max, self.beta_min, self.beta_max, self.gain])

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
        b, low, high = self.b, self.beta_min, self.beta_max
        return (
            b * r_m + math.sqrt(2.0 * b / high) * v_l,
            math.sqrt(2.0 * b * low) * r_m + math.sqrt(low / high) * v_l,
        )

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
        b, low, high = self.b, self.alpha_min, self.alpha_max
        return (
            (math.sqrt(2.0 * b / high) * v_r - f_s) / b,
            math.sqrt(2.0 * low / b) * f_s - math.sqrt(low / high) * v_r,
        )

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
                    f"{name} must lie in [{low}, {high}] ({name}_min, {name}_max), but sample {k} is {values.flat[k]}"
                )
