"""
What stands at the ports of a teleoperation loop, with its compiled equations: the scattering
transformation with variable power scaling, (3.12)-(3.14) and (3.22), and how its waves are read
when they arrive late; the haptic device with its passivating loop, (3.8)-(3.11), and static force
scaling, (3.25); and what a passivity controller asks of a port, (3.19)-(3.20). The loops' kernels
join them.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    Share,
    finite_array,
    positive,
    rounded_down,
    rounded_up,
)
from trustlab.models.records import block, record
from trustlab.models.simulation import filled

ROUNDING = 1e-12


class End(NamedTuple):
    """
    Coefficients of (3.22) at one end. At the operator's f'_m = b r_m + arriving v_l, u_l = sent r_m
    + reflected v_l; at the robot's r'_s = (arriving v_r − f_s)/b, u_r = sent f_s − reflected v_r.
    """

    b: float
    arriving: float
    sent: float
    reflected: float


END = record(numbers=" ".join(End._fields))


@block(_nrt=False)
def dot(a, b):
    """Return aᵀb of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@block(_nrt=False)
def copy(source, target):
    """Copy a vector into another one."""
    for i in range(3):
        target[i] = source[i]


# With `Scattering.at_operator` and `.at_robot` these four are the only place of the wave equations.


@block
def operator_force(end, r_m, v_l):
    """Return the force f'_m at the operator's end, before its scaling by β."""
    return end.b * r_m + end.arriving * v_l


@block
def operator_wave(end, r_m, v_l):
    """Return the wave u_l that leaves the operator's end."""
    return end.sent * r_m + end.reflected * v_l


@block
def robot_velocity(end, f_s, v_r):
    """Return the velocity r'_s at the robot's end, before its scaling by α."""
    return end.arriving * v_r / end.b - f_s / end.b


@block
def robot_wave(end, f_s, v_r):
    """Return the wave u_r that leaves the robot's end."""
    return end.sent * f_s - end.reflected * v_r


@dataclass(frozen=True)
class Scattering(Checked):
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
    >>> import trustlab as tl
    >>> round(tl.Scattering(b=1.0, alpha_min=0.05, beta_min=0.2, max_delay_rate=0.5).gain, 4)
    0.7071
    """

    b: Positive
    alpha_min: float = 1.0
    alpha_max: Share = 1.0
    beta_min: float = 1.0
    beta_max: float = 1.0
    max_delay_rate: Share = 0.0  # else nothing arrives (Theorem 3)

    def __post_init__(self):
        super().__post_init__()
        for name in ("alpha", "beta"):
            low, high = getattr(self, f"{name}_min"), getattr(self, f"{name}_max")
            if not 0.0 < low <= high:  # a scale of zero leaves one-way teleoperation
                raise ValueError(
                    f"{name}_min must be positive and must not exceed {name}_max (3.1), got {low} "
                    f"and {high}"
                )

    @property
    def gain(self) -> float:
        """f_i = √(1 − Ṫ_max), the gain at which delayed waves are read (3.13)."""
        return math.sqrt(1.0 - self.max_delay_rate)

    @property
    def at_operator(self) -> End:
        """Coefficients of the wave equations at the operator's end."""
        return self._end(self.beta_min, self.beta_max, 2.0 * self.b * self.beta_min)

    @property
    def at_robot(self) -> End:
        """Coefficients of the wave equations at the robot's end."""
        return self._end(self.alpha_min, self.alpha_max, 2.0 * self.alpha_min / self.b)

    def _end(self, low: float, high: float, sent: float) -> End:
        return End(self.b, *map(math.sqrt, (2.0 * self.b / high, sent, low / high)))

    def dominance(self) -> dict[str, float]:
        """
        Return how far the wanted signal outweighs the other one, for force and for velocity.

        Each relation of (3.22) mixes the wanted signal with another one: f'_m = b r_m + √(2b/β_max)
        v_l should be v_l, and so on, and all four cannot be met at once. In u_r and f'_m the force
        dominates by √(2α_max/b) and √(2/(bβ_max)): it gains from smaller b and β_max and larger
        α_max. In r'_s and u_l the velocity dominates by √(2b/α_max) and √(2bβ_max): it gains from
        larger b, from smaller α_max in the first and larger β_max in the second. Section 3.7.1 says
        that a smaller β helps velocity; it does not, whichever bar the text has lost.

        Returns
        -------
        dict of str to float
            force_robot (f_s in u_r), force_operator (v_l in f'_m), velocity_robot (v_r in r'_s),
            velocity_operator (r_m in u_l).
        """
        near, far = self.at_operator, self.at_robot
        return {
            "force_operator": near.arriving / self.b,
            "force_robot": far.sent / far.reflected,
            "velocity_robot": far.arriving,
            "velocity_operator": near.sent / near.reflected,
        }


# --- waves that arrive late ---------------------------------------------------------------------

# The ledger of one direction: first sample not yet booked, energy in hand [J], latest sample that
# was read.
ACCOUNT = np.dtype([("unbooked", np.int64), ("balance", float), ("latest", float)])


def accounts() -> np.ndarray:
    """Return two empty accounts, to the robot and back."""
    pair = np.zeros(2, ACCOUNT)
    pair["latest"] = -1.0
    return pair


@block
def amplitude(energy, balance, pace):
    """
    Return the amplitude in [0, 1] at which the newest wave, of this energy per sample, is read.

    `pace` is the share of a sample by which the reading moves on, 1 − dT/dt: while a delay grows,
    waves are read at √pace, which spends their energy as evenly as it arrives. What the balance
    holds beyond one more packet is left from samples that jitter or loss made the reading skip; it
    is spent at once. Without this the energy would stay in the ledger for ever, and a steady wave
    would arrive too small.
    """
    if energy <= 0.0:
        return 1.0
    share = min(max(pace, (balance - energy) / energy), 1.0)
    return np.sqrt(min(share, balance / energy))


# no reference counts (_nrt): they are atomic, and would take a third of the teleoperation loop's
# time
@block(_nrt=False)
def read_wave(sent, arrives, k, delay, sample_time, account, out):
    """
    Read the newest wave that has arrived in sample k, sent `delay` samples before, into `out`,
    with no more energy than its account, a record of ACCOUNT, holds.

    sent, shape (N, n): waves by the sample they were sent in. arrives, shape (N,): whether they
    arrive at all.
    """
    n = sent.shape[1]
    where = k - delay
    first = int(np.floor(where))
    while account.unbooked <= first:  # each packet is booked once, when it has arrived
        if arrives[account.unbooked]:
            for i in range(n):
                account.balance += sample_time * sent[account.unbooked, i] ** 2
        account.unbooked += 1
    pace = max(where - account.latest, 0.0)
    account.latest = max(account.latest, where)
    newest = first
    while newest >= 0 and not arrives[newest]:
        newest -= 1
    energy = spent = 0.0
    for i in range(n):
        out[i] = sent[newest, i] if newest >= 0 else 0.0
        energy += sample_time * out[i] ** 2
    share = amplitude(energy, account.balance, pace)
    for i in range(n):
        out[i] *= share
        spent += sample_time * out[i] ** 2
    account.balance = max(account.balance - spent, 0.0)  # rounding may leave −1e-17 J


@block(_nrt=False)
def read_waves(u_l, u_r, arrives, k, delays, sample_time, accounts, v_l, v_r):
    """Read the waves that arrive at both ends in sample k, (3.16), into `v_l` and `v_r`."""
    read_wave(u_l, arrives[0], k, delays[0, k], sample_time, accounts[0], v_r)
    read_wave(u_r, arrives[1], k, delays[1, k], sample_time, accounts[1], v_l)


# --- the haptic device --------------------------------------------------------------------------

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
    """
    Return the velocity at the middle of the sample under the hand's force and the scaled feedback.
    """
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
    """Return the storage of one axis, (3.9), before static scaling [J]."""
    r = v + device.weight * x
    spare = device.stiffness + device.weight * (device.damping - device.mass * device.weight)
    return 0.5 * (device.mass * r * r + spare * x * x)


@block
def device_loss(device, x_middle, v_middle):
    """
    Return the power dissipated on one axis at the midpoint, (3.10), before static scaling [W].
    """
    damped = (device.damping - device.mass * device.weight) * v_middle**2
    return damped + device.weight * device.stiffness * x_middle**2


class PassivityError(ValueError):
    """A block would generate energy."""


@dataclass(frozen=True, eq=False)
class HapticDevice(Checked):
    """
    A haptic device made r-passive by a local PD loop, equations (3.8)-(3.11).

    M dv/dt = −B v − K x + f_h − γ f''_m with the output r_m = v + Λ x, axis by axis. With B ≥ MΛ
    and K + ΛB ≥ ΛMΛ it is passive with the storage V_hd = ½ Σ (M r_m² + (K + ΛB − ΛMΛ) x²). The
    inertia is constant, so that C(x, v) = 0.

    Parameters
    ----------
    mass, damping, weight : float
        M [kg], B [N s/m] and Λ [1/s], positive; the same on all axes.
    stiffness : float
        K [N/m], 0 or more.
    force_scaling : float
        γ of (3.25), static scaling of the force feedback; positive.
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
    Saeidi, Section 3.4 and Proposition 2. The supply that (3.11) gives is r''_mᵀ f_h − r_mᵀ f''_m
    with r''_m = r_m/γ; (3.25) is printed with a plus.

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
    force_scaling: Positive = 1.0
    port_damping: NotNegative = 0.0
    require_passive: bool = True

    def __post_init__(self):
        super().__post_init__()
        if self.require_passive and not self.is_passive:
            damping = self.mass * self.weight - self.force_scaling * self.port_damping
            raise PassivityError(
                "the device is not r-passive: B ≥ MΛ and K + ΛB ≥ ΛMΛ (3.9)-(3.10) hold up to "
                f"{rounded_down(self.largest_mass(), 4):g} kg only, and it has {self.mass:.4g} kg; "
                f"raise damping to {rounded_up(damping, 4):g} N s/m, lower weight, or pass "
                "require_passive=False to see it fail"
            )

    @property
    def is_passive(self) -> bool:
        """Whether B ≥ MΛ and K + ΛB ≥ ΛMΛ with the port's damping in B, up to rounding."""
        return self.largest_mass() >= self.mass * (1.0 - ROUNDING)

    def largest_mass(self) -> float:
        """Return the largest mass [kg] that is r-passive with these gains."""
        # From B ≥ MΛ follows K + ΛB ≥ ΛMΛ, for K is not negative.
        return (self.damping + self.force_scaling * self.port_damping) / self.weight

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

        `storage`, `dissipation` at the midpoint and supply balance to rounding: V(k+1) − V(k) =
        supply − T S(midpoint).

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
        middle = midpoint_velocity(held_device(self, T), x, v, f_h, feedback)
        r_m = self.output(x + 0.5 * T * middle, middle)
        supply = T * float(r_m @ (f_h - feedback)) / self.force_scaling
        return x + T * middle, 2.0 * middle - v, supply

    def _vectors(self, **vectors) -> list[np.ndarray]:
        """Return the arguments as finite vectors of the same length."""
        length = np.size(vectors["x"])
        return [finite_array(name, values, length=length) for name, values in vectors.items()]


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
