"""The communication channel: waves delayed, read so that no energy appears, scaled at both ends (Theorem 3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from trustlab.models.checks import finite_number
from trustlab.teleoperation.delays import delay_from
from trustlab.teleoperation.scattering import Scattering

__all__ = [
    "HOLD",
    "INTERPOLATED",
    "LEDGER",
    "READ_OUTS",
    "ChannelRun",
    "EnergyLedger",
    "channel_run",
    "read_wave",
]

HOLD, INTERPOLATED, LEDGER = 0, 1, 2
READ_OUTS = {"hold": HOLD, "interpolated": INTERPOLATED, "ledger": LEDGER}


@numba.njit(cache=True, error_model="numpy")
def read_wave(sent, got, k, delay, gain, read_out, sample_time, account, out):
    """
    Read the wave that arrives in sample k, sent `delay` samples before, into `out`.

    sent, shape (N, n): waves by the sample they were sent in. got, shape (N,): whether they arrive at all. account =
    [first sample not yet booked, energy booked and not yet given out, latest sample read], changed by the "ledger"
    read-out alone; it begins as zeros with −1 for the last.
    """
    n = sent.shape[1]
    where = k - delay
    first = int(np.floor(where))
    part = where - first
    if read_out != LEDGER:
        for i in range(n):
            if first < 0 or not got[first]:
                value = 0.0
            elif read_out == HOLD:
                value = sent[first, i]
            else:
                later = sent[first + 1, i] if part > 0.0 and got[first + 1] else 0.0
                value = (1.0 - part) * sent[first, i] + part * later
            out[i] = gain * value
        if read_out == INTERPOLATED and first == -1 and part > 0.0:
            for i in range(n):
                out[i] = gain * part * sent[0, i] * (1.0 if got[0] else 0.0)
        return
    while account[0] <= first:  # what has arrived by now is booked once
        j = int(account[0])
        if got[j]:
            for i in range(n):
                account[1] += sample_time * sent[j, i] ** 2
        account[0] += 1.0
    advance = min(max(where - account[2], 0.0), 1.0)
    account[2] = max(account[2], where)
    last = first
    while last >= 0 and not got[last]:
        last -= 1
    energy = 0.0
    for i in range(n):  # the newest wave, at the gain √(1 − dT/dt) of the moment
        out[i] = np.sqrt(advance) * sent[last, i] if last >= 0 else 0.0
        energy += sample_time * out[i] ** 2
    if energy > account[1]:
        share = np.sqrt(account[1] / energy)
        energy = 0.0
        for i in range(n):
            out[i] *= share
            energy += sample_time * out[i] ** 2
    account[1] = max(account[1] - energy, 0.0)


class EnergyLedger:
    """
    Read packets of waves so that never more energy leaves than came in, whatever their jitter, loss and order.

    Every packet is booked once, with the energy it carries, when it arrives. A read gives the newest wave, made smaller
    where the book does not hold its energy.

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
    >>> ledger = EnergyLedger(sample_time=0.01)
    >>> ledger.receive(0, [2.0])
    True
    >>> ledger.read().tolist(), ledger.read().tolist()
    ([2.0], [0.0])
    """

    def __init__(self, sample_time: float):
        self.sample_time = finite_number("sample_time", sample_time)
        if not self.sample_time > 0.0:
            raise ValueError(f"sample_time must be positive, got {sample_time}")
        self.received = self.given = 0.0
        self._seen: set[int] = set()
        self._newest, self._wave = -1, None

    @property
    def balance(self) -> float:
        """Energy that came in and has not gone out [J]; never negative."""
        return max(self.received - self.given, 0.0)

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
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or number < 0:
            raise ValueError(f"number must be a whole number, 0 or more, got {number!r}")
        values = np.atleast_1d(np.asarray(wave, dtype=float))
        if values.ndim != 1 or not np.isfinite(values).all():
            raise ValueError(
                f"packet {number}: wave must be finite numbers, shape (n,), got {values.tolist()}"
            )
        if self._wave is not None and values.shape != self._wave.shape:
            raise ValueError(
                f"packet {number}: wave has shape {values.shape}, those before {self._wave.shape}"
            )
        if number in self._seen:
            return False
        self._seen.add(int(number))
        self.received += self.sample_time * float(values @ values)
        if number > self._newest:
            self._newest, self._wave = int(number), values
        elif self._wave is None:
            self._wave = values
        return True

    def read(self) -> np.ndarray:
        """Return the wave to use in this sample, shape (n,); an empty array before the first packet."""
        if self._wave is None:
            return np.zeros(0)
        energy = self.sample_time * float(self._wave @ self._wave)
        out = self._wave * (1.0 if energy <= self.balance else np.sqrt(self.balance / energy))
        self.given += self.sample_time * float(out @ out)
        return out


@dataclass(frozen=True, eq=False)
class ChannelRun:
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

    @cached_property
    def energy(self) -> np.ndarray:
        """∫ r_mᵀf_m − r_sᵀf_s dτ up to and with each sample [J], shape (N,): energy in the channel."""
        power = (self.r_m * self.f_m).sum(axis=1) - (self.r_s * self.f_s).sum(axis=1)
        return self.sample_time * np.cumsum(power)

    @cached_property
    def exchanged(self) -> np.ndarray:
        """∫ |r_mᵀf_m| + |r_sᵀf_s| dτ up to and with each sample [J], shape (N,)."""
        power = np.abs((self.r_m * self.f_m).sum(axis=1)) + np.abs((self.r_s * self.f_s).sum(axis=1))
        return self.sample_time * np.cumsum(power)

    @cached_property
    def wave_energy(self) -> np.ndarray:
        """½ ∫ ‖u_l‖² − ‖v_l‖² + ‖u_r‖² − ‖v_r‖² dτ [J], shape (N,): the lower bound of the proof of Theorem 3."""
        power = sum(
            sign * (wave**2).sum(axis=1)
            for sign, wave in ((1, self.u_l), (-1, self.v_l), (1, self.u_r), (-1, self.v_r))
        )
        return 0.5 * self.sample_time * np.cumsum(power)

    def plot(self, ax=None):
        """
        Plot the energy in the channel over time.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes
            The axes.
        """
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots()[1]
        ax.plot(self.t, self.energy, label="energy in the channel")
        ax.plot(self.t, self.wave_energy, label="of it, waves under way")
        ax.axhline(0.0, color="0.6", linewidth=0.8)
        ax.set(xlabel="t [s]", ylabel="energy [J]")
        ax.legend()
        return ax


@numba.njit(cache=True)
def _channel(r_m, f_s, alpha, beta, delays, got, c, read_out, sample_time, f_m, r_s, waves):
    b, a_low, a_high, b_low, b_high, gain = c
    count, n = r_m.shape
    u_l, v_l, u_r, v_r = waves[0], waves[1], waves[2], waves[3]
    accounts = np.zeros((2, 3))
    accounts[:, 2] = -1.0
    for k in range(count):
        read_wave(u_l, got[0], k, delays[0, k], gain, read_out, sample_time, accounts[0], v_r[k])
        read_wave(u_r, got[1], k, delays[1, k], gain, read_out, sample_time, accounts[1], v_l[k])
        for i in range(n):
            u_l[k, i] = np.sqrt(2.0 * b * b_low) * r_m[k, i] + np.sqrt(b_low / b_high) * v_l[k, i]
            u_r[k, i] = np.sqrt(2.0 * a_low / b) * f_s[k, i] - np.sqrt(a_low / a_high) * v_r[k, i]
            f_m[k, i] = beta[k] * (b * r_m[k, i] + np.sqrt(2.0 * b / b_high) * v_l[k, i])
            r_s[k, i] = alpha[k] * (np.sqrt(2.0 * b / a_high) * v_r[k, i] - f_s[k, i]) / b


def _samples(name: str, values) -> np.ndarray:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of numbers, got {type(values).__name__}") from None
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[0] < 2 or array.shape[1] < 1:
        raise ValueError(f"{name} must have shape (N, n) with N ≥ 2, got {np.shape(values)}")
    if not np.isfinite(array).all():
        k, i = np.argwhere(~np.isfinite(array))[0]
        raise ValueError(f"{name} must be finite, but sample {k}, axis {i} is {array[k, i]}")
    return np.ascontiguousarray(array)


def channel_run(
    r_m: np.ndarray,
    f_s: np.ndarray,
    scattering: Scattering,
    sample_time: float,
    delay_1=0.1,
    delay_2=0.1,
    alpha: np.ndarray | float | None = None,
    beta: np.ndarray | float | None = None,
    read_out: str = "ledger",
    lost: np.ndarray | None = None,
) -> ChannelRun:
    """
    Send a device's output and a robot's force through the channel.

    Parameters
    ----------
    r_m : array_like, shape (N, n) or (N,)
        Output of the haptic device [m/s].
    f_s : array_like, shape (N, n) or (N,)
        Force feedback at the robot's port [N].
    scattering : Scattering
        Impedance, bounds of the scales, and f_i.
    sample_time : float
        T [s].
    delay_1, delay_2 : float or Delay
        Delay to the robot and back [s]; at least one sample.
    alpha, beta : float or array_like, shape (N,), optional
        Scales; their upper bounds when not given.
    read_out : {"ledger", "interpolated", "hold"}
        How delayed waves are read. "ledger" holds the newest wave, at the gain √(1 − dT/dt) of the moment, and
        never gives out more energy than arrived, for any delay, loss and order.
        "interpolated" reads between samples with the gain f_i; passive for delays that grow at most at Ṫ_max, up to about
        1 % of one sample's energy. "hold" reads the last sample with f_i, and is not passive for growing delays.
    lost : array_like of bool, shape (2, N), optional
        Waves that never arrive, to the robot and back.

    Returns
    -------
    ChannelRun
        All signals, with `.energy`, `.wave_energy` and `.plot()`.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite, a scale is out of its bounds, or a delay is not allowed.
    """
    r_m, f_s = _samples("r_m", r_m), _samples("f_s", f_s)
    if r_m.shape != f_s.shape:
        raise ValueError(f"r_m and f_s must have the same shape, got {r_m.shape} and {f_s.shape}")
    if not isinstance(scattering, Scattering):
        raise ValueError(f"scattering must be of class Scattering, got {type(scattering).__name__}")
    if read_out not in READ_OUTS:
        raise ValueError(f"read_out must be one of {', '.join(READ_OUTS)}, got {read_out!r}")
    sample_time = finite_number("sample_time", sample_time)
    if not sample_time > 0.0:
        raise ValueError(f"sample_time must be positive, got {sample_time}")
    count = r_m.shape[0]
    scales = []
    for name, given, default in (("alpha", alpha, scattering.alpha_max), ("beta", beta, scattering.beta_max)):
        values = np.asarray(default if given is None else given, dtype=float)
        if values.ndim and values.shape != (count,):
            raise ValueError(f"{name} must be a number or have shape ({count},), got {values.shape}")
        scales.append(np.ascontiguousarray(np.broadcast_to(values, (count,))))
    scattering.check_scales(*scales)
    delays = np.empty((2, count))
    for i, (name, given) in enumerate((("delay_1", delay_1), ("delay_2", delay_2))):
        delay = delay_from(name, given, scattering.max_delay_rate)
        if read_out == "interpolated" and delay.max_rate > scattering.max_delay_rate + 1e-9:
            raise ValueError(
                f"{name} grows at up to {delay.max_rate:g} s/s but scattering has max_delay_rate = "
                f"{scattering.max_delay_rate:g}; raise it, or read out by ledger"
            )
        delays[i] = delay.samples(count, sample_time) / sample_time
        if not delays[i].all():
            raise ValueError(f"{name} must be at least one sample, {sample_time:g} s, here")
    got = np.ones((2, count), bool)
    if lost is not None:
        missing = np.asarray(lost)
        if missing.shape != got.shape or missing.dtype != bool:
            raise ValueError(
                f"lost must be True or False, shape (2, {count}), got {missing.dtype} {missing.shape}"
            )
        got = ~missing
    f_m, r_s, waves = np.empty_like(r_m), np.empty_like(r_m), np.zeros((4, *r_m.shape))
    _channel(
        r_m, f_s, *scales, delays, got, scattering.numbers, READ_OUTS[read_out], sample_time, f_m, r_s, waves
    )
    return ChannelRun(sample_time * np.arange(count), r_m, f_m, r_s, f_s, *waves, sample_time)
