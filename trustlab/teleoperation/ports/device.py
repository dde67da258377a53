"""The haptic device with its passivating loop, (3.8)-(3.11), and static force scaling (3.25)."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.checks import (
    finite_array,
    flag,
    not_negative,
    positive,
    rounded_down,
    rounded_up,
    set_checked,
    whole_number,
)
from trustlab.models.compiled import njit

ROUNDING = 1e-12


class Device(NamedTuple):
    """
    One axis of the device, and what the implicit midpoint rule makes of it together with the hand
    that holds it.
    """

    sample_time: float
    mass: float
    damping: float
    stiffness: float
    weight: float
    held_mass: float  # of device and arm
    held_stiffness: float
    inertia: float  # 2M/T + B + KT/2, device and arm: force per velocity at the midpoint
    lever: float  # r_m per velocity at the midpoint, 1 + ΛT/2
    spare: float  # K + ΛB − ΛMΛ of (3.9)


class Arm(NamedTuple):
    """What the operator's arm adds to an axis of the device: M [kg], K [N/m] and B [N s/m]."""

    mass: float
    stiffness: float
    damping: float


NO_ARM = Arm(0.0, 0.0, 0.0)


@njit(error_model="numpy", forceinline=True)
def held_device(mass, damping, stiffness, weight, arm, sample_time):
    """Return one axis of a device in a hand."""
    held_mass, held_stiffness = mass + arm.mass, stiffness + arm.stiffness
    held_damping = damping + arm.damping
    inertia = 2.0 * held_mass / sample_time + held_damping + 0.5 * sample_time * held_stiffness
    return Device(
        sample_time,
        mass,
        damping,
        stiffness,
        weight,
        held_mass,
        held_stiffness,
        inertia,
        lever=1.0 + 0.5 * sample_time * weight,
        spare=stiffness + weight * damping - weight * mass * weight,
    )


@njit(error_model="numpy", forceinline=True)
def midpoint_velocity(device, x, v, force, feedback):
    """
    Return the velocity at the middle of the sample under the hand's force and the scaled feedback.
    """
    pull = (
        2.0 * device.held_mass * v / device.sample_time
        - device.held_stiffness * x
        + force
        - feedback
    )
    return pull / device.inertia


@njit(error_model="numpy", forceinline=True)
def free_output(device, x, v, force):
    """
    Return the output r_m that the device would have without feedback; the channel's end is solved
    with it.
    """
    pull = 2.0 * device.held_mass * v / device.sample_time - device.held_stiffness * x + force
    return device.lever * pull / device.inertia + device.weight * x


@njit(error_model="numpy", forceinline=True)
def device_storage(device, x, v):
    """Return the storage of one axis, (3.9), before static scaling [J]."""
    r = v + device.weight * x
    return 0.5 * (device.mass * r * r + device.spare * x * x)


@njit(error_model="numpy", forceinline=True)
def device_loss(device, x_middle, v_middle):
    """
    Return the power dissipated on one axis at the midpoint, (3.10), before static scaling [W].
    """
    damped = (device.damping - device.mass * device.weight) * v_middle**2
    return damped + device.weight * device.stiffness * x_middle**2


class PassivityError(ValueError):
    """A block would generate energy."""


def _matrix(name: str, value, n: int) -> np.ndarray:
    """Return a scalar, a diagonal or a matrix as a symmetric matrix."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be a number, a diagonal or a matrix of numbers, got {value!r}"
        ) from None
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {value!r}")
    if array.ndim == 0:
        array = np.eye(n) * array
    elif array.ndim == 1:
        array = np.diag(array)
    if array.shape != (n, n):
        raise ValueError(
            f"{name} must be a number, a diagonal or a {n} × {n} matrix, got shape "
            f"{np.shape(value)}"
        )
    if np.abs(array - array.T).max() > ROUNDING * np.abs(array).max():
        raise ValueError(f"{name} must be symmetric")
    return array


@dataclass(frozen=True, eq=False)
class HapticDevice:
    """
    A haptic device made r-passive by a local PD loop, equations (3.8)-(3.11).

    M dv/dt = −B v − K x + f_h − γ f''_m with the output r_m = v + Λ x. With B ≥ ½(MΛ + ΛM) and K +
    ΛB ≥ ΛMΛ it is passive with the storage V_hd = ½ r_mᵀM r_m + ½ xᵀ(K + ΛB − ΛMΛ)x. The inertia is
    constant, so that C(x, v) = 0.

    Parameters
    ----------
    mass : float or array_like
        M [kg]: a number, a diagonal, or a symmetric positive definite matrix.
    damping, stiffness, weight : float or array_like
        Diagonals B [N s/m], K [N/m] and Λ [1/s] of the local loop and the output; B > 0, K ≥ 0, Λ >
        0.
    force_scaling : float
        γ > 0 of (3.25), static scaling of the force feedback.
    dimensions : int
        Degrees of freedom where all gains are numbers.
    port_damping : float
        Least damping that the channel adds at the port, β_min b (Section 3.7.2) [N s/m]; counted in
        the conditions.
    require_passive : bool
        Refuse gains that are not r-passive.

    Raises
    ------
    PassivityError
        If the device is too heavy to be r-passive; the largest admissible mass is quoted.
    ValueError
        If a gain is not finite, has the wrong shape or sign.

    Notes
    -----
    Saeidi, Section 3.4 and Proposition 2. The supply that (3.11) gives is r''_mᵀ f_h − r_mᵀ f''_m
    with r''_m = r_m/γ; (3.25) is printed with a plus.

    Examples
    --------
    >>> device = HapticDevice(mass=0.009, damping=0.55, stiffness=100.0, weight=60.0)
    >>> round(device.largest_mass(), 5)
    0.00917
    """

    mass: Any
    damping: Any
    stiffness: Any
    weight: Any
    force_scaling: float = 1.0
    dimensions: int = 3
    port_damping: float = 0.0
    require_passive: bool = True

    def __post_init__(self):
        gains = (self.mass, self.damping, self.stiffness, self.weight)
        sizes = [np.shape(value)[0] for value in gains if np.ndim(value)]
        n = whole_number("dimensions", sizes[0] if sizes else self.dimensions)
        object.__setattr__(self, "dimensions", n)
        mass = _matrix("mass", self.mass, n)
        if np.linalg.eigvalsh(mass).min() <= 0.0:
            raise ValueError("mass must be positive definite")
        object.__setattr__(self, "mass", mass)
        for name, least in (
            ("damping", "positive"),
            ("stiffness", "0 or more"),
            ("weight", "positive"),
        ):
            matrix = _matrix(name, getattr(self, name), n)
            diagonal = np.diag(matrix)
            if (matrix != np.diag(diagonal)).any():
                raise ValueError(f"{name} must be diagonal (Section 3.4)")
            if (diagonal < 0.0).any() or (least == "positive" and (diagonal == 0.0).any()):
                raise ValueError(f"{name} must be {least} on its diagonal, got {diagonal.tolist()}")
            object.__setattr__(self, name, matrix)
        set_checked(self, flag, "require_passive")
        set_checked(self, positive, "force_scaling")
        set_checked(self, not_negative, "port_damping")
        if self.require_passive and not self.is_passive:
            most = rounded_down(self.largest_mass(), 4)
            damping = rounded_up(self._least_damping(), 4)
            raise PassivityError(
                "the device is not r-passive: B ≥ MΛ and K + ΛB ≥ ΛMΛ (3.9)-(3.10) hold up to "
                f"{most:g} kg only, and it has {np.diag(mass).max():.4g} kg; raise damping to "
                f"{damping:g} N s/m, lower weight, or pass require_passive=False "
                "to see it fail"
            )

    def _at_port(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return damping and stiffness with what the channel adds at the port, and ½(MΛ + ΛM)."""
        damping = self.damping + self.force_scaling * self.port_damping * np.eye(self.dimensions)
        stiffness = self.stiffness + self.force_scaling * self.port_damping * self.weight
        return damping, stiffness, 0.5 * (self.mass @ self.weight + self.weight @ self.mass)

    def _spare(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrices of (3.10) and (3.9) that must not be negative."""
        damping, stiffness, cross = self._at_port()
        return (
            damping - cross,
            stiffness + self.weight @ damping - self.weight @ self.mass @ self.weight,
        )

    @property
    def is_passive(self) -> bool:
        """Whether B ≥ ½(MΛ + ΛM) and K + ΛB ≥ ΛMΛ, up to rounding."""
        return all(
            np.linalg.eigvalsh(matrix).min() >= -ROUNDING * max(1.0, np.abs(matrix).max())
            for matrix in self._spare()
        )

    def largest_mass(self) -> float:
        """
        Return the largest mass [kg] (largest diagonal entry, M scaled as a whole) that is r-passive
        with these gains.
        """
        from scipy.linalg import eigh

        damping, stiffness, cross = self._at_port()
        squared = self.weight @ self.mass @ self.weight
        most = min(
            1.0 / eigh(cross, damping, eigvals_only=True).max(),
            1.0 / eigh(squared, stiffness + self.weight @ damping, eigvals_only=True).max(),
        )
        return float(most * np.diag(self.mass).max())

    def _least_damping(self) -> float:
        """
        Return the least damping [N s/m], the same on all axes, with which the device is r-passive.
        """
        cross = self._at_port()[2]
        return float(np.linalg.eigvalsh(cross).max() - self.force_scaling * self.port_damping)

    def output(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """
        Return r_m = v + Λ x [m/s].

        Parameters
        ----------
        x, v : array_like, shape (n,)
            Position [m] and velocity [m/s].
        """
        x, v = self._vectors(x=x, v=v)
        return v + self.weight @ x

    def storage(self, x: np.ndarray, v: np.ndarray) -> float:
        """
        Return V_hd/γ [J], equations (3.9) and (3.25).

        Parameters
        ----------
        x, v : array_like, shape (n,)
            Position [m] and velocity [m/s].
        """
        x, v = self._vectors(x=x, v=v)
        r = v + self.weight @ x
        inner = self.stiffness + self.weight @ self.damping - self.weight @ self.mass @ self.weight
        return float(0.5 * (r @ self.mass @ r + x @ inner @ x)) / self.force_scaling

    def dissipation(self, x: np.ndarray, v: np.ndarray) -> float:
        """
        Return S_hd/γ [W], equation (3.10) with C = 0.

        Parameters
        ----------
        x, v : array_like, shape (n,)
            Position [m] and velocity [m/s].
        """
        x, v = self._vectors(x=x, v=v)
        spare = self.damping - 0.5 * (self.mass @ self.weight + self.weight @ self.mass)
        return float(v @ spare @ v + x @ self.weight @ self.stiffness @ x) / self.force_scaling

    def step(
        self, x: np.ndarray, v: np.ndarray, f_h: np.ndarray, f_m: np.ndarray, sample_time: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """
        Return the state one sample later by the implicit midpoint rule, and the energy supplied
        over the sample.

        Storage, dissipation at the midpoint and supply balance to rounding: V(k+1) − V(k) = supply
        − T S_hd(midpoint).

        Parameters
        ----------
        x, v : array_like, shape (n,)
            Position [m] and velocity [m/s].
        f_h : array_like, shape (n,)
            Force of the operator's hand [N], held over the sample.
        f_m : array_like, shape (n,)
            Force feedback [N] before the static scaling, f''_m, held over the sample.
        sample_time : float
            T [s], positive.

        Returns
        -------
        x, v : numpy.ndarray, shape (n,)
            Position and velocity after the sample.
        supply : float
            T (r''_mᵀ f_h − r_mᵀ f''_m) at the midpoint [J].

        Raises
        ------
        ValueError
            If an argument is not finite or has the wrong shape, or `sample_time` is not positive.
        """
        x, v, f_h, f_m = self._vectors(x=x, v=v, f_h=f_h, f_m=f_m)
        sample_time = positive("sample_time", sample_time)
        half = 0.5 * sample_time
        left = self.mass + half * self.damping + half**2 * self.stiffness
        force = f_h - self.force_scaling * f_m
        middle = np.linalg.solve(left, self.mass @ v + half * (force - self.stiffness @ x))
        supply = (
            sample_time
            / self.force_scaling
            * float((middle + self.weight @ (x + half * middle)) @ force)
        )
        return x + sample_time * middle, 2.0 * middle - v, supply

    def state_space(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return A, B, C of the state (x, v), input f_h − γ f''_m and output r_m."""
        n = self.dimensions
        zero = np.zeros((n, n))
        unit = np.eye(n)
        inverse = np.linalg.inv(self.mass)
        a = np.block([[zero, unit], [-inverse @ self.stiffness, -inverse @ self.damping]])
        return a, np.vstack([zero, inverse]), np.hstack([self.weight, unit])

    def _vectors(self, **vectors) -> list[np.ndarray]:
        """Return the arguments as finite vectors of the device's dimension."""
        return [
            finite_array(name, value, length=self.dimensions) for name, value in vectors.items()
        ]
