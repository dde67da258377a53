"""
The communication channel by itself, any signals at its ports: with scales (Theorem 3), and switched
between leaders (4.7).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import finite_array, of_class, one_of, positive
from trustlab.models.compiled import njit
from trustlab.models.display import axes_or_new
from trustlab.teleoperation.delays import delays_in_samples
from trustlab.teleoperation.ports import waves as equations
from trustlab.teleoperation.ports.ledger import READ_OUTS, accounts, read_waves
from trustlab.teleoperation.ports.waves import Scattering
from trustlab.teleoperation.records import robot_numbers, signals


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

    @property
    def _powers(self) -> tuple[np.ndarray, np.ndarray]:
        """Return power into the operator's port and out of the robots' [W]."""
        return (self.r_m * self.f_m).sum(axis=1), (self.r_s * self.f_s).sum(axis=1)

    @cached_property
    def energy(self) -> np.ndarray:
        """
        ∫ r_mᵀf_m − r_sᵀf_s dτ up to and with each sample [J], shape (N,): energy in the channel.
        """
        near, far = self._powers
        return self.sample_time * np.cumsum(near - far)

    @cached_property
    def exchanged(self) -> np.ndarray:
        """``∫ |r_mᵀf_m| + |r_sᵀf_s| dτ`` up to and with each sample [J], shape (N,)."""
        near, far = self._powers
        return self.sample_time * np.cumsum(np.abs(near) + np.abs(far))

    @cached_property
    def wave_energy(self) -> np.ndarray:
        """
        ½ ∫ ‖u_l‖² − ‖v_l‖² + ‖u_r‖² − ‖v_r‖² dτ [J], shape (N,): the lower bound of the proof of
        Theorem 3.
        """
        u_l, v_l, u_r, v_r = (
            (wave**2).sum(axis=1) for wave in (self.u_l, self.v_l, self.u_r, self.v_r)
        )
        return 0.5 * self.sample_time * np.cumsum(u_l - v_l + u_r - v_r)

    def plot(self, ax=None):
        """
        Plot the energy in the channel over time.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; a new figure by default.

        Returns
        -------
        matplotlib.axes.Axes
            The axes.
        """
        ax = axes_or_new(ax)
        ax.plot(self.t, self.energy, label="energy in the channel")
        ax.plot(self.t, self.wave_energy, label="of it, waves under way")
        ax.axhline(0.0, color="0.6", linewidth=0.8)
        ax.set(xlabel="t [s]", ylabel="energy [J]")
        ax.legend()
        return ax


class Waves(NamedTuple):
    """
    The waves of a channel, shape (N, n) each: sent and arriving at the operator's end (l) and at
    the robot's (r).
    """

    u_l: np.ndarray
    v_l: np.ndarray
    u_r: np.ndarray
    v_r: np.ndarray


@njit
def _send(
    r_m,
    f_s,
    near,
    far,
    alpha,
    beta,
    bounds,
    delays,
    arrives,
    gain,
    read_out,
    period,
    books,
    waves,
    f_m,
    r_s,
):
    """
    Fill `waves`, f_m and r_s, sample by sample.

    near, far, shape (N,): which row of `bounds` holds for the operator's end and for the robot's.
    bounds, shape (robots, 5): b, α_min, α_max, β_min, β_max, a record each.
    """
    count, n = r_m.shape
    for k in range(count):
        read_waves(
            waves.u_l,
            waves.u_r,
            arrives,
            k,
            delays,
            gain,
            read_out,
            period,
            books,
            waves.v_l[k],
            waves.v_r[k],
        )
        here, there = bounds[near[k]], bounds[far[k]]
        operator = equations.operator_end(here.b, here.beta_min, here.beta_max)
        robot = equations.robot_end(there.b, there.alpha_min, there.alpha_max)
        for i in range(n):
            waves.u_l[k, i] = equations.operator_wave(operator, r_m[k, i], waves.v_l[k, i])
            f_m[k, i] = beta[k] * equations.operator_force(operator, r_m[k, i], waves.v_l[k, i])
            waves.u_r[k, i] = equations.robot_wave(robot, f_s[k, i], waves.v_r[k, i])
            r_s[k, i] = alpha[k] * equations.robot_velocity(robot, f_s[k, i], waves.v_r[k, i])


BOUNDS = np.dtype(
    [(name, float) for name in ("b", "alpha_min", "alpha_max", "beta_min", "beta_max")]
)


def _run(
    r_m, f_s, ends, near, far, alpha, beta, delays, read_out, sample_time, lost=None
) -> ChannelRun:
    """
    Send signals through a channel whose ends are set for given robots in every sample; delays are
    by argument name.
    """
    count, period = len(r_m), positive("sample_time", sample_time)
    one_of("read_out", read_out, READ_OUTS)
    rate = max(end.max_delay_rate for end in ends)
    late = delays_in_samples(delays, rate, read_out, count, period)
    bounds = np.array([tuple(getattr(end, name) for name in BOUNDS.names) for end in ends], BOUNDS)
    gain = min(end.gain for end in ends)
    f_m, r_s = np.empty_like(r_m), np.empty_like(r_m)
    waves = Waves(*np.zeros((4, *r_m.shape)))
    _send(
        r_m,
        f_s,
        near,
        far,
        alpha,
        beta,
        bounds,
        late,
        lost_waves(lost, count),
        gain,
        READ_OUTS[read_out],
        period,
        accounts(),
        waves,
        f_m,
        r_s,
    )
    return ChannelRun(period * np.arange(count), r_m, f_m, r_s, f_s, *waves, period)


def lost_waves(lost, count: int) -> np.ndarray:
    """
    Return which waves arrive, shape (2, count), from those that a user says are lost; all when none
    are named.
    """
    if lost is None:
        return np.ones((2, count), bool)
    missing = np.asarray(lost)
    if missing.shape != (2, count) or missing.dtype != bool:
        raise ValueError(
            f"lost must be True or False, shape (2, {count}), got {missing.dtype} {missing.shape}"
        )
    return ~missing


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
        How delayed waves are read. "ledger" holds the newest wave, at the gain √(1 − dT/dt) of the
        moment, and never gives out more energy than arrived, for any delay, loss and order.
        "interpolated" reads between samples with the gain f_i; passive for delays that grow at most
        at Ṫ_max, up to about 1 % of one sample's energy. "hold" reads the last sample with f_i, and
        is not passive for growing delays.
    lost : array_like of bool, shape (2, N), optional
        Waves that never arrive, to the robot and back.

    Returns
    -------
    ChannelRun
        All signals, with `.energy`, `.wave_energy` and `.plot()`.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite, a scale is out of its bounds, or a delay is not
        allowed.

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
    of_class("scattering", scattering, Scattering)
    count, scales = len(r_m), []
    for name, scale, default in (
        ("alpha", alpha, scattering.alpha_max),
        ("beta", beta, scattering.beta_max),
    ):
        values = np.asarray(default if scale is None else scale, dtype=float)
        if values.ndim and values.shape != (count,):
            raise ValueError(
                f"{name} must be a number or have shape ({count},), got {values.shape}"
            )
        scales.append(np.ascontiguousarray(np.broadcast_to(values, (count,))))
    scattering.check_scales(*scales)
    (alphas, betas), always = scales, np.zeros(count, np.int64)
    delays = {"delay_1": delay_1, "delay_2": delay_2}
    return _run(
        r_m, f_s, (scattering,), always, always, alphas, betas, delays, read_out, sample_time, lost
    )


def switched_channel_run(
    r_m: np.ndarray,
    f_s: np.ndarray,
    ends: Sequence[Scattering],
    leaders: np.ndarray,
    sample_time: float,
    beta: np.ndarray,
    delay=0.1,
    delay_back=None,
    read_out: str = "ledger",
    operator_leaders: np.ndarray | None = None,
) -> ChannelRun:
    """
    Send given signals through the channel while the leader, and with it b and the bounds of β, is
    switched.

    Waves carry their energy in watts, whatever b they were made with. The energy of each sample
    therefore balances at either end separately, and (4.13)-(4.15) hold for any switching times,
    also with waves under way at a switch and τ_min < T. The two ends need not switch at the same
    time as long as β stays within the bounds for which the operator's end is set.

    Parameters
    ----------
    r_m : array_like, shape (K, n)
        Velocity at the operator's port [m/s].
    f_s : array_like, shape (K, n)
        Force at the robots' port [N].
    ends : sequence of Scattering
        b and the bounds of β of every robot; α is 1.
    leaders : array_like of int, shape (K,)
        Which robot leads in each sample.
    sample_time : float
        T [s].
    beta : array_like, shape (K,)
        β_ik(t); bounds are not checked here, so that a run can break them.
    delay, delay_back : float or Delay
        Delays [s], at least one sample; the same both ways when `delay_back` is not given.
    read_out : {"ledger", "interpolated", "hold"}
        As in `channel_run`.
    operator_leaders : array_like of int, shape (K,), optional
        For which robot the operator's end is set, where that differs.

    Returns
    -------
    ChannelRun
        With `.energy`, which is V_ch of (4.15), and `.wave_energy`.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite, or a leader does not exist.
    """
    ends = tuple(ends)
    if not ends:
        raise ValueError("ends must hold one Scattering per robot, got none")
    for place, end in enumerate(ends):
        of_class(f"ends[{place}]", end, Scattering)
    r_m, f_s = signals(2, r_m=r_m, f_s=f_s)
    count, robots = len(r_m), len(ends)
    far = robot_numbers("leaders", leaders, count, robots)
    near = (
        far
        if operator_leaders is None
        else robot_numbers("operator_leaders", operator_leaders, count, robots)
    )
    beta = finite_array("beta", beta, length=count)
    delays = {"delay": delay, "delay_back": delay if delay_back is None else delay_back}
    return _run(r_m, f_s, ends, near, far, np.ones(count), beta, delays, read_out, sample_time)
