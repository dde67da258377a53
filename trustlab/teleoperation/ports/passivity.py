"""Passivity observer and controller of Theorem 4, (3.19)-(3.20), in discrete time."""

from typing import NamedTuple

import numpy as np

from trustlab.models.checks import finite_array, one_of, positive
from trustlab.models.compiled import njit

OFF = 0
CANCEL = 1
REPAY = 2
METHODS = {"off": OFF, "cancel": CANCEL, "repay": REPAY}


@njit(error_model="numpy", forceinline=True)
def demanded(method, energy, power, sample_time):
    """
    Return the power [W] that the port must take in this sample, or NaN where the controller rests.
    """
    if method == CANCEL and energy <= 0.0 and power < 0.0:
        return 0.0
    if method == REPAY and energy + sample_time * power < 0.0:
        return -energy / sample_time
    return np.nan


@njit(error_model="numpy", forceinline=True)
def activation(power, square, compliance, demand):
    """
    Return w ≥ 0 of the damping that makes a port take the power `demand`, and whether it can.

    The port's velocity yields to the force, v = v0/(1 + w) with w = compliance z. With power =
    v0ᵀf' and square = v0ᵀv0 the port takes [(1 + w) power + (w/compliance) square]/(1 + w)². The
    least w is returned; infinity stops the port, as is done with every port whose power stays
    negative however large w is.
    """
    gain = square / compliance
    if power >= demand:
        return 0.0, True
    if power + gain <= 0.0:
        return np.inf, demand <= 0.0
    if demand == 0.0:
        return -power / (power + gain), True
    half = 0.5 * (power + gain - 2.0 * demand)
    inner = half * half - demand * (demand - power)
    if inner < 0.0 or half <= 0.0:  # the most that the port can take
        return max((gain - power) / (gain + power), 0.0), False
    return (demand - power) / (half + np.sqrt(inner)), True


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
    >>> controller = PassivityController(sample_time=0.01)
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
