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
)
from trustlab.models.compiled import njit

ROUNDING = 1e-12
GAINS = ("mass", "damping", "stiffness", "weight")


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


class Arm(NamedTuple):
    """What the operator's arm adds to an axis of the device: M [kg], K [N/m] and B [N s/m]."""

    mass: float
    stiffness: float
    damping: float


NO_ARM = Arm(0.0, 0.0, 0.0)


@njit(error_model="numpy", forceinline=True)
def held_device(gains, arm, sample_time):
    """
    Return one axis of a device in a hand; `gains` is what has its mass, damping, stiffness and
    weight.
    """
    mass, stiffness = gains.mass + arm.mass, gains.stiffness + arm.stiffness
    damping = gains.damping + arm.damping
    return Device(
        sample_time,
        gains.mass,
        gains.damping,
        gains.stiffness,
        gains.weight,
        held_mass=mass,
        held_stiffness=stiffness,
        inertia=2.0 * mass / sample_time + damping + 0.5 * sample_time * stiffness,
        lever=1.0 + 0.5 * sample_time * gains.weight,
    )


@njit(error_model="numpy", forceinline=True)
def free_force(device, x, v, force):
    """Return inertia times the velocity at the middle of the sample without feedback [N]."""
    momentum = 2.0 * device.held_mass * v / device.sample_time
    return momentum - device.held_stiffness * x + force


@njit(error_model="numpy", forceinline=True)
def midpoint_velocity(device, x, v, force, feedback):
    """
    Return the velocity at the middle of the sample under the hand's force and the scaled feedback.
    """
    return (free_force(device, x, v, force) - feedback) / device.inertia


@njit(error_model="numpy", forceinline=True)
def free_output(device, x, v, force):
    """
    Return the output r_m that the device would have without feedback; the channel's end is solved
    with it.
    """
    return device.lever * free_force(device, x, v, force) / device.inertia + device.weight * x


@njit(error_model="numpy", forceinline=True)
def device_storage(device, x, v):
    """Return the storage of one axis, (3.9), before static scaling [J]."""
    r = v + device.weight * x
    spare = device.stiffness + device.weight * (device.damping - device.mass * device.weight)
    return 0.5 * (device.mass * r * r + spare * x * x)


@njit(error_model="numpy", forceinline=True)
def device_loss(device, x_middle, v_middle):
    """
    Return the power dissipated on one axis at the midpoint, (3.10), before static scaling [W].
    """
    damped = (device.damping - device.mass * device.weight) * v_middle**2
    return damped + device.weight * device.stiffness * x_middle**2


class PassivityError(ValueError):
    """A block would generate energy."""


@dataclass(frozen=True, eq=False)
class HapticDevice:
    """
    A haptic device made r-passive by a local PD loop, equations (3.8)-(3.11).

    M dv/dt = −B v − K x + f_h − γ f''_m with the output r_m = v + Λ x, axis by axis. With B ≥ MΛ
    and K + ΛB ≥ ΛMΛ it is passive with the storage V_hd = ½ Σ (M r_m² + (K + ΛB − ΛMΛ) x²). The
    inertia is constant, so that C(x, v) = 0.

    Parameters
    ----------
    mass, damping, weight : float or array_like, shape (n,)
        M [kg], B [N s/m] and Λ [1/s], positive: a number, or one per axis; three axes where all
        gains are numbers.
    stiffness : float or array_like, shape (n,)
        K [N/m], 0 or more.
    force_scaling : float
        γ of (3.25), static scaling of the force feedback; positive.
    port_damping : float
        Least damping that the channel adds at the port, β_min b (Section 3.7.2) [N s/m]; counted in
        the conditions.
    require_passive : bool
        Refuse gains that are not r-passive.

    Attributes
    ----------
    mass, damping, stiffness, weight : numpy.ndarray, shape (n,)
        The gains by axis.

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
    port_damping: float = 0.0
    require_passive: bool = True

    def __post_init__(self):
        gains = [getattr(self, name) for name in GAINS]
        sizes = {np.size(gain) for gain in gains if np.ndim(gain)} or {3}
        if len(sizes) > 1 or 0 in sizes:
            raise ValueError(
                "mass, damping, stiffness and weight must be numbers or have one for each axis, "
                f"got lengths {sizes}"
            )
        set_checked(self, flag, "require_passive")
        set_checked(self, positive, "force_scaling")
        set_checked(self, not_negative, "port_damping")
        for name, gain in zip(GAINS, gains, strict=True):
            check = not_negative if name == "stiffness" else positive
            values = [check(name, value) for value in np.atleast_1d(gain)]
            self.__dict__[name] = np.full(max(sizes), values)
        if self.require_passive and not self.is_passive:
            most = rounded_down(self.largest_mass(), 4)
            at_port = self.force_scaling * self.port_damping
            damping = rounded_up((self.mass * self.weight).max() - at_port, 4)
            raise PassivityError(
                "the device is not r-passive: B ≥ MΛ and K + ΛB ≥ ΛMΛ (3.9)-(3.10) hold up to "
                f"{most:g} kg only, and it has {self.mass.max():.4g} kg; raise damping to "
                f"{damping:g} N s/m, lower weight, or pass require_passive=False to see it fail"
            )

    @property
    def is_passive(self) -> bool:
        """Whether B ≥ MΛ and K + ΛB ≥ ΛMΛ on every axis, up to rounding."""
        return bool(self.largest_mass() >= self.mass.max() * (1.0 - ROUNDING))

    def largest_mass(self) -> float:
        """
        Return the largest mass [kg] (of the heaviest axis, M scaled as a whole) that is r-passive
        with these gains.
        """
        # From B ≥ MΛ follows K + ΛB ≥ ΛMΛ, for K is not negative.
        damping = self.damping + self.force_scaling * self.port_damping
        return float((damping / (self.mass * self.weight)).min() * self.mass.max())

    def output(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """
        Return r_m = v + Λ x [m/s].

        Parameters
        ----------
        x, v : array_like, shape (n,)
            Position [m] and velocity [m/s].
        """
        x, v = self._vectors(x=x, v=v)
        return v + self.weight * x

    def storage(self, x: np.ndarray, v: np.ndarray) -> float:
        """
        Return V_hd/γ [J], equations (3.9) and (3.25).

        Parameters
        ----------
        x, v : array_like, shape (n,)
            Position [m] and velocity [m/s].
        """
        stored = device_storage.py_func(self, *self._vectors(x=x, v=v))
        return float(stored.sum()) / self.force_scaling

    def dissipation(self, x: np.ndarray, v: np.ndarray) -> float:
        """
        Return S_hd/γ [W], equation (3.10) with C = 0.

        Parameters
        ----------
        x, v : array_like, shape (n,)
            Position [m] and velocity [m/s].
        """
        lost = device_loss.py_func(self, *self._vectors(x=x, v=v))
        return float(lost.sum()) / self.force_scaling

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
        T, feedback = positive("sample_time", sample_time), self.force_scaling * f_m
        axes = held_device.py_func(self, NO_ARM, T)
        middle = midpoint_velocity.py_func(axes, x, v, f_h, feedback)
        r_m = self.output(x + 0.5 * T * middle, middle)
        supply = T * float(r_m @ (f_h - feedback)) / self.force_scaling
        return x + T * middle, 2.0 * middle - v, supply

    def _vectors(self, **vectors) -> list[np.ndarray]:
        """Return the arguments as finite vectors of the device's dimension."""
        return [finite_array(name, x, length=self.mass.size) for name, x in vectors.items()]
