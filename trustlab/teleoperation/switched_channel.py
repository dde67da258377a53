"""The channel of Fig. 4.4 by itself: scattering switched with the leader (4.7), scaling, delay, any signals at its ports."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from trustlab.models.checks import finite_array, finite_number
from trustlab.teleoperation.channel import READ_OUTS, ChannelRun, read_wave
from trustlab.teleoperation.delays import delay_from
from trustlab.teleoperation.scattering import Scattering

__all__ = ["switched_channel_run"]


@numba.njit(cache=True)
def _switched(r_m, f_s, near, far, beta, ends, delays, got, gain, read_out, sample_time, f_m, r_s, waves):
    count, n = r_m.shape
    u_l, v_l, u_r, v_r = waves[0], waves[1], waves[2], waves[3]
    accounts = np.zeros((2, 3))
    accounts[:, 2] = -1.0
    for k in range(count):
        read_wave(u_l, got[0], k, delays[0, k], gain, read_out, sample_time, accounts[0], v_r[k])
        read_wave(u_r, got[1], k, delays[1, k], gain, read_out, sample_time, accounts[1], v_l[k])
        b, low, high = ends[near[k], 0], ends[near[k], 1], ends[near[k], 2]
        far_b = ends[far[k], 0]
        for i in range(n):
            u_l[k, i] = np.sqrt(2.0 * b * low) * r_m[k, i] + np.sqrt(low / high) * v_l[k, i]
            f_m[k, i] = beta[k] * (b * r_m[k, i] + np.sqrt(2.0 * b / high) * v_l[k, i])
            u_r[k, i] = np.sqrt(2.0 / far_b) * f_s[k, i] - v_r[k, i]
            r_s[k, i] = (np.sqrt(2.0 * far_b) * v_r[k, i] - f_s[k, i]) / far_b


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
    Send given signals through the channel while the leader, and with it b and the bounds of β, is switched.

    Waves carry their energy in watts, whatever b they were made with. The energy balance of a sample at either end therefore holds
    for itself, and (4.13)-(4.15) follow for any switching times, also with waves under way at a switch and τ_min < T. The two
    ends need not even switch together as long as β keeps to the bounds that the operator's end is set for.

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
    if not ends or not all(isinstance(end, Scattering) for end in ends):
        raise ValueError("ends must hold one Scattering per robot")
    r_m, f_s = (np.ascontiguousarray(np.atleast_2d(np.asarray(a, dtype=float))) for a in (r_m, f_s))
    if r_m.shape != f_s.shape or len(r_m) < 2:
        raise ValueError(f"r_m and f_s must have one shape (K, n), K ≥ 2, got {r_m.shape} and {f_s.shape}")
    for name, array in (("r_m", r_m), ("f_s", f_s)):
        if not np.isfinite(array).all():
            raise ValueError(
                f"{name} must be finite, but sample {np.argwhere(~np.isfinite(array))[0, 0]} is not"
            )
    count, step = len(r_m), finite_number("sample_time", sample_time)
    if not step > 0.0:
        raise ValueError(f"sample_time must be positive, got {step}")
    if read_out not in READ_OUTS:
        raise ValueError(f"read_out must be one of {', '.join(READ_OUTS)}, got {read_out!r}")
    far = _robots("leaders", leaders, count, len(ends))
    near = (
        far if operator_leaders is None else _robots("operator_leaders", operator_leaders, count, len(ends))
    )
    scale = finite_array("beta", beta, length=count)
    rate = max(end.max_delay_rate for end in ends)
    delays = np.empty((2, count))
    for i, (name, given) in enumerate(
        (("delay", delay), ("delay_back", delay if delay_back is None else delay_back))
    ):
        delays[i] = delay_from(name, given, rate).samples(count, step) / step
        if not delays[i].all():
            raise ValueError(f"{name} must be at least one sample, {step:g} s")
    near_whole = np.round(delays)
    delays = np.where(np.abs(delays - near_whole) < 1e-6, near_whole, delays)
    table = np.array([(end.b, end.beta_min, end.beta_max) for end in ends])
    f_m, r_s, waves = np.empty_like(r_m), np.empty_like(r_m), np.zeros((4, *r_m.shape))
    _switched(
        r_m, f_s, near, far, scale, table, delays, np.ones((2, count), bool), float(np.sqrt(1.0 - rate)),
        READ_OUTS[read_out], step, f_m, r_s, waves,
    )  # fmt: skip
    return ChannelRun(step * np.arange(count), r_m, f_m, r_s, f_s, *waves, step)


def _robots(name: str, values, count: int, robots: int) -> np.ndarray:
    array = np.asarray(values)
    if array.shape != (count,) or array.dtype.kind not in "iu":
        raise ValueError(f"{name} must be {count} whole numbers, got {array.dtype} {array.shape}")
    if array.min() < 0 or array.max() >= robots:
        raise ValueError(
            f"{name} names robot {int(array[(array < 0) | (array >= robots)][0])}, but there are {robots}"
        )
    return array.astype(np.int64)
