"""
The scattering transformation with variable power scaling, (3.12)-(3.14) and (3.22), and how its
waves are read when they arrive late.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import (
    Checked,
    Positive,
    Share,
    finite_array,
    positive,
    whole_number,
)
from trustlab.models.records import block, record


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

# How many of the newest packets an `EnergyLedger` remembers: 65 s at 1 kHz.
WINDOW = 65_536


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


class EnergyLedger:
    """
    Read packets of waves so that never more energy leaves than came in, whatever their jitter, loss
    and order.

    Every packet is booked once, with the energy it carries, when it arrives. A read returns the
    newest wave, scaled down where the balance does not hold its energy. A packet that arrives
    65,536 numbers or more after a newer one is refused: it could not be told from a duplicate.

    Parameters
    ----------
    sample_time : float
        T [s]: a packet carries T‖u‖² [J].

    Raises
    ------
    ValueError
        If the sample time is not positive.

    Examples
    --------
    >>> import trustlab as tl
    >>> ledger = tl.EnergyLedger(sample_time=0.01)
    >>> ledger.receive(0, [2.0])
    True
    >>> ledger.read().tolist(), ledger.read().tolist()
    ([2.0], [0.0])
    """

    def __init__(self, sample_time: float):
        self.sample_time = positive("sample_time", sample_time)
        self.received = self.given = 0.0
        # A ring by number modulo its length: a duplicate is recognised in constant memory, however
        # long the run.
        self._seen = [-1] * WINDOW
        self._newest = -1
        self._wave = np.zeros(0)

    @property
    def balance(self) -> float:
        """Energy that came in and has not gone out [J]; never negative."""
        return max(self.received - self.given, 0.0)

    def _energy(self, wave: np.ndarray) -> float:
        """Return the energy that a wave carries in a sample [J]."""
        return self.sample_time * float(wave @ wave)

    def receive(self, number: int, wave: np.ndarray) -> bool:
        """
        Book a packet; a packet that came twice is booked once.

        Parameters
        ----------
        number : int
            The packet's number at its sender, 0 or more.
        wave : array_like, shape (n,)
            The wave it carries [√W].

        Returns
        -------
        bool
            Whether it was booked.

        Raises
        ------
        ValueError
            If the number is not a whole number, or the wave is not finite or has another length.
        """
        number = whole_number("number", number, least=0)
        values = finite_array(f"wave of packet {number}", wave, length=self._wave.size or None)
        if number <= self._newest - WINDOW or self._seen[number % WINDOW] == number:
            return False
        self._seen[number % WINDOW] = number
        self.received += self._energy(values)
        if number > self._newest:
            self._newest, self._wave = number, values.copy()
        return True

    def read(self) -> np.ndarray:
        """
        Return the wave to use in this sample, shape (n,); an empty array before the first packet.
        """
        # Packets carry no time, so that nothing is known of the delay's rate: they are read at full
        # pace.
        share = amplitude.py_func(self._energy(self._wave), self.balance, 1.0)
        out = self._wave * share
        self.given += self._energy(out)
        return out
