"""
The communication channel by itself, any signals at its ports: with scales (Theorem 3), and switched
between leaders (4.7); a ledger of packets, and a passivity controller of a port.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import (
    array_between,
    finite_array,
    finite_numbers,
    of_class,
    one_of,
    positive,
    shown,
    whole_number,
)
from trustlab.models.compiled import njit
from trustlab.models.records import signals
from trustlab.teleoperation import ports
from trustlab.teleoperation.delays import delays_in_samples
from trustlab.teleoperation.ports import (
    END,
    METHODS,
    Scattering,
    accounts,
    amplitude,
    demanded,
    read_waves,
)

# How delayed waves are read.
READ_OUTS = ("ledger", "interpolated", "hold")
LEDGER, INTERPOLATED, HOLD = range(3)

# By how much, as a share, scales may lie beyond their bounds, for rounding.
SLACK = 1e-12


class ChannelRun(NamedTuple):
    """
    Signals of a channel, one row per sample.

    Parameters
    ----------
    t : numpy.ndarray, shape (N,)
        Time [s].
    r_m, f_m, r_s, f_s : numpy.ndarray, shape (N, n)
        Velocities [m/s] and forces [N] at the two ports.
    u_l, v_l, u_r, v_r : numpy.ndarray, shape (N, n)
        Waves [√W].
    sample_time : float
        T [s].
    """

    t: np.ndarray
    r_m: np.ndarray
    f_m: np.ndarray
    r_s: np.ndarray
    f_s: np.ndarray
    u_l: np.ndarray
    v_l: np.ndarray
    u_r: np.ndarray
    v_r: np.ndarray
    sample_time: float

    @property
    def energy(self) -> np.ndarray:
        """
        ∫ r_mᵀf_m − r_sᵀf_s dτ up to and with each sample [J], shape (N,): energy in the channel,
        (4.15) where leaders are switched.
        """
        return self._since_start(self.r_m * self.f_m - self.r_s * self.f_s)

    @property
    def wave_energy(self) -> np.ndarray:
        """
        ½ ∫ ‖u_l‖² − ‖v_l‖² + ‖u_r‖² − ‖v_r‖² dτ [J], shape (N,): the lower bound of the proof of
        Theorem 3.
        """
        squares = self.u_l**2 - self.v_l**2 + self.u_r**2 - self.v_r**2
        return self._since_start(0.5 * squares)

    def _since_start(self, power: np.ndarray) -> np.ndarray:
        """Return the energy up to and with each sample [J] from the power on each axis [W]."""
        return self.sample_time * np.cumsum(power.sum(axis=1))


@njit
def read_with_gain(sent, where, gain, interpolated):
    """
    Return the wave of a sample, read between samples or the last one, with the gain f_i of (3.16);
    zero before the first.
    """
    first = int(np.floor(where))
    part = where - first if interpolated else 0.0
    wave = np.zeros(sent.shape[1])
    if first >= 0:
        wave += (1.0 - part) * sent[first]
    if first >= -1:
        wave += part * sent[first + 1]
    return gain * wave


@njit
def _send(columns, near, far, alpha, beta, delays, read_out, gain, sample_time, accounts):
    """
    Fill the waves, f_m and r_s, sample by sample.

    columns: as in `ChannelRun`. near, far, shape (N,): the ends of the channel at the operator and
    at the robot, records of END.
    """
    r_m, f_m, r_s, f_s, u_l, v_l, u_r, v_r = columns
    arrives = np.ones(delays.shape, np.bool_)
    for k in range(len(r_m)):
        if read_out == LEDGER:
            read_waves(u_l, u_r, arrives, k, delays, sample_time, accounts, v_l[k], v_r[k])
        else:
            v_r[k] = read_with_gain(u_l, k - delays[0, k], gain, read_out == INTERPOLATED)
            v_l[k] = read_with_gain(u_r, k - delays[1, k], gain, read_out == INTERPOLATED)
        u_l[k] = ports.operator_wave(near[k], r_m[k], v_l[k])
        f_m[k] = beta[k] * ports.operator_force(near[k], r_m[k], v_l[k])
        u_r[k] = ports.robot_wave(far[k], f_s[k], v_r[k])
        r_s[k] = alpha[k] * ports.robot_velocity(far[k], f_s[k], v_r[k])


def channel_run(
    r_m: np.ndarray,
    f_s: np.ndarray,
    scattering: Scattering | Sequence[Scattering],
    sample_time: float,
    delay_1=0.1,
    delay_2=0.1,
    alpha: np.ndarray | float | None = None,
    beta: np.ndarray | float | None = None,
    read_out: str = "ledger",
    leaders: np.ndarray | None = None,
) -> ChannelRun:
    """
    Send a device's output and a robot's force through the channel, to one robot or to the leaders
    of a team.

    Waves carry their energy in watts, whatever b they were made with. The energy of each sample
    therefore balances at either end separately, and (4.13)-(4.15) hold for any switching times,
    also with waves under way at a switch and τ_min < T. The two ends need not switch at the same
    time as long as β stays within the bounds for which the operator's end is set.

    Parameters
    ----------
    r_m : array_like, shape (N, n) or (N,)
        Output of the haptic device [m/s].
    f_s : array_like, shape (N, n) or (N,)
        Force feedback at the robot's port [N].
    scattering : Scattering or sequence of Scattering
        Impedance, bounds of the scales, and f_i; with `leaders` those of every robot, of whose f_i
        the least is used.
    sample_time : float
        T [s].
    delay_1, delay_2 : float, callable or Delay
        Delay to the robot and back [s]; at least one sample. `packet_delay(sent, received)` is that
        of a recorded network, lost packets included.
    alpha, beta : float or array_like, shape (N,), optional
        Scales; their upper bounds when not given. With `leaders` their bounds are not checked, so
        that a run can break them.
    read_out : {"ledger", "interpolated", "hold"}
        How delayed waves are read. "ledger" holds the newest wave, at the gain √(1 − dT/dt) of the
        moment, and never gives out more energy than was sent, for any delay, loss and order.
        "interpolated" reads between samples with the gain f_i; for delays that grow at Ṫ_max it
        gives out at most 2.1 % more energy than was sent (nothing more at Ṫ_max = 1/2). "hold"
        reads the last sample with f_i, and is not passive for growing delays.
    leaders : array_like of int, shape (N,) or (2, N), optional
        For which robot the channel is set in each sample; two rows where the operator's end and the
        robot's end are set for different ones.

    Returns
    -------
    ChannelRun
        All signals, with `.energy` and `.wave_energy`.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite, a scale is out of its bounds, a leader does not
        exist, or a delay is not allowed.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> scattering = tl.Scattering(b=2.0, alpha_min=0.2, alpha_max=1.0, beta_min=0.05, beta_max=0.5)
    >>> velocity, force = np.random.default_rng(0).normal(size=(2, 500, 3))
    >>> run = tl.channel_run(velocity, force, scattering, 0.01, delay_1=0.1, delay_2=0.1)
    >>> bool(run.energy.min() > -1e-9)
    True
    """
    r_m, f_s = signals(2, r_m=r_m, f_s=f_s)
    count, period = len(r_m), positive("sample_time", sample_time)
    one_of("read_out", read_out, READ_OUTS)
    robots = [scattering] if leaders is None or not np.iterable(scattering) else scattering
    ends = [of_class("scattering", robot, Scattering) for robot in robots]
    numbers = np.zeros(count, int) if leaders is None else np.asarray(leaders)
    if numbers.shape not in ((count,), (2, count)) or not np.isin(numbers, range(len(ends))).all():
        raise ValueError(
            f"leaders must be {count} numbers of the {len(ends)} robots of scattering, or two rows "
            f"of these, got {shown(leaders)}"
        )
    near, far = np.broadcast_to(numbers.astype(int), (2, count))
    alphas = _scale("alpha", alpha, np.array([end.alpha_max for end in ends])[far])
    betas = _scale("beta", beta, np.array([end.beta_max for end in ends])[near])
    if leaders is None:
        end, low, high = ends[0], 1.0 - SLACK, 1.0 + SLACK
        alpha_ends = low * end.alpha_min, high * end.alpha_max
        beta_ends = low * end.beta_min, high * end.beta_max
        array_between("alpha", alphas, *alpha_ends, "alpha_min, alpha_max")
        array_between("beta", betas, *beta_ends, "beta_min, beta_max")
    rate = max(end.max_delay_rate for end in ends)
    pair = {"delay_1": delay_1, "delay_2": delay_2}
    delays = delays_in_samples(pair, rate, count, period)
    growth = np.diff(delays).max()
    if read_out != "ledger" and growth > rate + 1e-6:
        raise ValueError(
            f"a delay grows at up to {growth:g} s/s, but f_i is set for max_delay_rate = {rate:g}; "
            "raise max_delay_rate of the scattering, or use read_out='ledger'"
        )
    f_m, r_s, u_l, v_l, u_r, v_r = np.zeros((6, *r_m.shape))
    columns = (r_m, f_m, r_s, f_s, u_l, v_l, u_r, v_r)
    _send(
        columns,
        np.array([end.at_operator for end in ends], END)[near],
        np.array([end.at_robot for end in ends], END)[far],
        alphas,
        betas,
        delays,
        READ_OUTS.index(read_out),
        min(end.gain for end in ends),
        period,
        accounts(),
    )
    return ChannelRun(period * np.arange(count), *columns, period)


def _scale(name: str, scale, bounds: np.ndarray) -> np.ndarray:
    """Return a scale in every sample; its upper bounds when not given."""
    values = bounds if scale is None else finite_numbers(name, scale)
    if values.shape not in ((), bounds.shape):
        raise ValueError(
            f"{name} must be a number or have shape {bounds.shape}, got {values.shape}"
        )
    return np.full(bounds.shape, values)


# --- packets ------------------------------------------------------------------------------------

# How many of the newest packets an `EnergyLedger` remembers: 65 s at 1 kHz.
WINDOW = 65_536


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


# --- the passivity controller of a port, (3.19)-(3.20) -------------------------------------------


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

    f = f' + z v. In discrete time the observed energy, attribute `energy` [J], passes zero between
    samples, so that "cancel" tests it for ≤ 0.

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
