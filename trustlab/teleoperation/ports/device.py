"""
The haptic device with its passivating loop, (3.8)-(3.11), and the passivity controller of a port.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    finite_array,
    one_of,
    positive,
    rounded_down,
    rounded_up,
)
from trustlab.models.records import block, record
from trustlab.models.simulation import filled

ROUNDING = 1e-12

# One axis of the device, and what the implicit midpoint rule makes of it together with the hand
# that holds it: mass and stiffness of device and arm; `inertia`, force per velocity at the
# midpoint, 2M/T + B + KT/2 of device and arm; `lever`, r_m per velocity there, 1 + ΛT/2.
DEVICE = record(
    numbers="sample_time mass damping stiffness weight held_mass held_stiffness inertia lever"
)


def held_device(gains: Any, sample_time: float, arm: Any = None) -> np.void:
    """
    Return one axis of a device, alone or in a hand, a record of DEVICE; `gains` has its mass,
    damping, stiffness and weight, `arm` what the operator's arm adds to the first three.
    """
    mass, damping, stiffness = (
        getattr(gains, name) + getattr(arm, name, 0.0) for name in ("mass", "damping", "stiffness")
    )
    return filled(
        DEVICE,
        gains,
        sample_time=sample_time,
        held_mass=mass,
        held_stiffness=stiffness,
        inertia=2.0 * mass / sample_time + damping + 0.5 * sample_time * stiffness,
        lever=1.0 + 0.5 * sample_time * gains.weight,
    )


@block
def free_force(device, x, v, force):
    """Return inertia times the velocity at the middle of the sample without feedback [N]."""
    momentum = 2.0 * device.held_mass * v / device.sample_time
    return momentum - device.held_stiffness * x + force


@block
def midpoint_velocity(device, x, v, force, feedback):
    """Return the velocity at the middle of the sample under the hand's force and the feedback."""
    return (free_force(device, x, v, force) - feedback) / device.inertia


@block
def free_output(device, x, v, force):
    """
    Return the output r_m that the device would have without feedback; the channel's end is solved
    with it.
    """
    return device.lever * free_force(device, x, v, force) / device.inertia + device.weight * x


@block
def device_storage(device, x, v):
    """Return the storage of one axis, (3.9) [J]."""
    r = v + device.weight * x
    spare = device.stiffness + device.weight * (device.damping - device.mass * device.weight)
    return 0.5 * (device.mass * r * r + spare * x * x)


@block
def device_loss(device, x_middle, v_middle):
    """Return the power dissipated on one axis at the midpoint, (3.10) with C = 0 [W]."""
    damped = (device.damping - device.mass * device.weight) * v_middle**2
    return damped + device.weight * device.stiffness * x_middle**2


class PassivityError(ValueError):
    """A block would generate energy."""


@dataclass(frozen=True, eq=False)
class HapticDevice(Checked):
    """
    A haptic device made r-passive by a local PD loop, equations (3.8)-(3.11).

    M dv/dt = −B v − K x + f_h − f_m with the output r_m = v + Λ x, axis by axis. With B ≥ MΛ and
    K + ΛB ≥ ΛMΛ it is passive with the storage V_hd = ½ Σ (M r_m² + (K + ΛB − ΛMΛ) x²). The
    inertia is constant, so that C(x, v) = 0.

    Parameters
    ----------
    mass, damping, weight : float
        M [kg], B [N s/m] and Λ [1/s], positive; the same on all axes.
    stiffness : float
        K [N/m], 0 or more.
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
        If a gain is not finite or has the wrong sign.

    Notes
    -----
    Saeidi, Section 3.4. `simulate_teleoperation` steps the device.

    Examples
    --------
    >>> import trustlab as tl
    >>> device = tl.HapticDevice(mass=0.009, damping=0.55, stiffness=100.0, weight=60.0)
    >>> round(device.largest_mass(), 5)
    0.00917
    """

    mass: Positive
    damping: Positive
    stiffness: NotNegative
    weight: Positive
    port_damping: NotNegative = 0.0
    require_passive: bool = True

    def __post_init__(self):
        super().__post_init__()
        if self.require_passive and not self.is_passive:
            damping = self.mass * self.weight - self.port_damping
            raise PassivityError(
                "the device is not r-passive: B ≥ MΛ and K + ΛB ≥ ΛMΛ (3.9)-(3.10) hold up to "
                f"{rounded_down(self.largest_mass(), 4):g} kg only, and it has {self.mass:.4g} kg; "
                f"raise damping to {rounded_up(damping, 4):g} N s/m, lower weight, or pass "
                "require_passive=False to see it fail"
            )

    @property
    def is_passive(self) -> bool:
        """Whether B ≥ MΛ and K + ΛB ≥ ΛMΛ, up to rounding."""
        return self.largest_mass() >= self.mass * (1.0 - ROUNDING)

    def largest_mass(self) -> float:
        """Return the largest mass [kg] that is r-passive with these gains."""
        # From B ≥ MΛ follows K + ΛB ≥ ΛMΛ, for K is not negative.
        return (self.damping + self.port_damping) / self.weight


# --- the passivity controller of a port, (3.19)-(3.20) ------------------------------------------

OFF = 0
CANCEL = 1
REPAY = 2
METHODS = {"off": OFF, "cancel": CANCEL, "repay": REPAY}


@block
def demanded(method, energy, power, sample_time):
    """
    Return the power [W] that the port must take in this sample, or NaN where the controller rests.
    """
    if method == CANCEL and energy <= 0.0 and power < 0.0:
        return 0.0
    if method == REPAY and energy + sample_time * power < 0.0:
        return -energy / sample_time
    return np.nan


@block
def activation(power, gain, demand):
    """
    Return w ≥ 0 of the damping that makes a port take the power `demand`.

    The port's velocity yields to the force, v = v0/(1 + w) with w = compliance z. With power =
    v0ᵀf' and gain = v0ᵀv0/compliance the port takes [(1 + w) power + w gain]/(1 + w)². The least w
    is returned, that of the most that the port can take where that is less; infinity stops the
    port, as is done with every port whose power stays negative however large w is.
    """
    if power >= demand:
        return 0.0
    if power + gain <= 0.0:
        return np.inf
    if demand == 0.0:
        return -power / (power + gain)
    half = 0.5 * (power + gain - 2.0 * demand)
    inner = half * half - demand * (demand - power)
    if inner < 0.0 or half <= 0.0:  # the most that the port can take
        return max((gain - power) / (gain + power), 0.0)
    return (demand - power) / (half + np.sqrt(inner))


class Controlled(NamedTuple):
    """
    What a passivity controller did with one sample.

    Parameters
    ----------
    force : numpy.ndarray, shape (n,)
        f = f' + z v [N].
    z : float
        Damping injected [N s/m].
    energy : float
        Energy observed up to and with this sample [J].
    deficit : float
        How far it is below zero [J].
    """

    force: np.ndarray
    z: float
    energy: float
    deficit: float


class PassivityController:
    """
    Keep a port with velocity input and force output from giving out more energy than it took,
    (3.19)-(3.20).

    f = f' + z v. In discrete time the observed energy, attribute `energy` [J], is never exactly
    zero, so that it is tested for ≤ 0.

    Parameters
    ----------
    sample_time : float
        T [s].
    method : {"cancel", "repay"}
        "cancel" is the printed rule: while the observed energy is ≤ 0, negative power is cancelled,
        z = −vᵀf'/‖v‖². The force never grows, and the energy undershoots zero by at most T|vᵀf'| of
        one sample. "repay" is Hannaford and Ryu's: the sample that would end below zero is damped
        so that it ends at zero; forces can spike.

    Raises
    ------
    ValueError
        If the sample time is not positive or the method is unknown.

    Notes
    -----
    B. Hannaford, J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Trans.
    Robotics and Automation 18(1), 2002.

    Examples
    --------
    >>> import trustlab as tl
    >>> controller = tl.PassivityController(sample_time=0.01)
    >>> controller.step([1.0], [-2.0]).force.tolist()
    [0.0]
    """

    def __init__(self, sample_time: float, method: str = "cancel"):
        self.sample_time = positive("sample_time", sample_time)
        self.method = one_of("method", method, ("cancel", "repay"))
        self.energy = 0.0

    def step(self, velocity: np.ndarray, force: np.ndarray) -> Controlled:
        """
        Return the force to apply in this sample.

        Parameters
        ----------
        velocity, force : array_like, shape (n,)
            v [m/s] into the port and f' [N] out of the guarded system.

        Raises
        ------
        ValueError
            If they are not finite or differ in shape; the observed energy stays what it was.
        """
        v = finite_array("velocity", velocity)
        f = finite_array("force", force, length=v.size)
        power, square = float(v @ f), float(v @ v)
        demand = demanded.py_func(METHODS[self.method], self.energy, power, self.sample_time)
        acts = square > 0.0 and not np.isnan(demand)
        z = (demand - power) / square if acts else 0.0
        self.energy += self.sample_time * (power + z * square)
        return Controlled(f + z * v, z, self.energy, max(-self.energy, 0.0))
