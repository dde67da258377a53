"""One step after another of the teleoperated team (Fig. 4.1), compiled: O(N) per step in the Laplacian's eigenbasis."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from trustlab.teleoperation.channel import read_wave

__all__ = ["BLOCKS", "COLUMNS", "NO_FILTER", "TWO_PORT", "WAVES", "TeamNumbers", "run_team"]

NO_FILTER, TWO_PORT, WAVES = 0, 1, 2
BLOCKS = ("haptic device", "channel", "team")
AXES = "xyz"


def _axes(stem: str) -> tuple[str, ...]:
    return tuple(f"{stem}_{axis}" for axis in AXES)


COLUMNS = (
    *_axes("leader"),
    *_axes("device"),
    *_axes("r_m"),
    *_axes("f_h"),
    *_axes("f_m"),
    *_axes("r_s"),
    *_axes("f_s"),
    "number",
    "beta",
    "trust_rh",
    "push",
    "v_h",
    "v_hd",
    "v_ch",
    "v_fs",
    "v_e",
    "v_e_delayed",
    "v_filter",
    "v_t",
    "supply_team",
    "supply_error",
    "supply_hand",
    "supply_device",
    "supply_filter",
    "lost_device",
    "lost_team",
    "lost_error",
    "lost_error_delayed",
)


class TeamNumbers(NamedTuple):
    """Device, filters, operator and how delays are read, as plain numbers; see `TeamSettings` and `TeamOperator`."""

    sample_time: float
    mass: float
    damping: float
    stiffness: float
    weight: float
    gain: float
    read_out: int
    filtering: int
    cutoff: float
    k12: float
    k21: float
    push: float
    reach: float
    drag: float
    budget: float
    reserve: float
    guarded: bool
    vision: int
    error_range: float
    steepness: float


@numba.njit(cache=True)
def push_share(budget, power, pull, stir, square, drag):
    """
    Return the greatest share σ ≤ 1 of a push whose power does not exceed `power`.

    The device yields by r = a + y σ p to the push p, drag d at the hand: the hand gives r (σ p − d r) =
    −d a² + σ p a (1 − 2 d y) + σ² y p² (1 − d y), with the sums pull = Σ p a (1 − 2 d y), stir = Σ y p² (1 − d y) and
    square = Σ a². Nothing is pushed while the budget is spent.
    """
    if budget <= 0.0 or power <= 0.0:
        return 0.0
    free = power + drag * square
    if stir + pull <= free:
        return 1.0
    return min(2.0 * free / (pull + np.sqrt(pull * pull + 4.0 * stir * free)), 1.0)


@numba.njit(cache=True, error_model="numpy")
def run_team(
    n, values, vectors, leads, heads, ends, trusts, delays, got, w, z, x, v, pushed, every, log, modes
):
    """
    Run the team and write a row of `log` and of `modes` every `every` samples.

    values, shape (N,), vectors, shape (N, N): eigenvalues and eigenvectors (columns) of the Laplacian. leads, heads, shape
    (K,): the robot that leads in each sample, and the one for which the operator's end of the channel is set (the same,
    unless that end fails to switch). ends, shape (N, 3): b and the bounds of β per robot. trusts, shape (N, 5): trust in the
    operator at the start, what is kept of it per sample, b/a, and its range. delays, shape (2, K), in samples. w, z, shape (3, N): modes of
    the robots' distance to the goal and of ζ, changed in place, as x, v, shape (3,), the device's state, are. pushed, shape
    (K, 3): force added to the hand's. A row is the state before a sample, with the signals of that sample. Returns the samples done and the block that diverged (−1: none).
    """
    count, size = leads.size, values.size
    T = n.sample_time
    h = 0.5 * T
    u_l, u_r = np.zeros((count, 3)), np.zeros((count, 3))
    sent, seen, lost, held = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count), np.zeros(count + 1)
    v_l, v_r = np.zeros(3), np.zeros(3)
    wave_l, wave_r = np.zeros(3), np.zeros(3)
    a1, c1, a2, c2 = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    a, y, p, error = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    f0, f1, e0, e1, h0 = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    r_m, f_m, f_h, r_s, f_s, at = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    accounts = np.zeros((2, 3))
    accounts[:, 2] = -1.0
    solve, stiffness = 1.0 / (1.0 + h * values + h * h * values**2), np.zeros(size)
    for i in range(size):
        for j in range(size):
            stiffness[i] += h * vectors[i, j] ** 2 * values[j] * solve[j]
    trust = trusts[:, 0].copy()
    left, tip = 2.0 * n.mass / T + n.damping + h * n.stiffness, 1.0 + h * n.weight
    admit = tip / left
    spare = n.stiffness + n.weight * n.damping - n.weight * n.mass * n.weight
    pole = h * n.cutoff
    keep, g = (1.0 / (1.0 + pole), pole / (1.0 + pole)) if n.filtering != NO_FILTER else (0.0, 1.0)
    port = n.filtering == TWO_PORT
    gate = g if port else 1.0
    stay = keep if port else 0.0
    k12, k21 = (n.k12, n.k21) if port else (0.0, 0.0)
    cut = n.cutoff if n.filtering != NO_FILTER else 1.0
    v_h = v_ch = supply_team = supply_error = supply_hand = supply_device = supply_filter = 0.0
    lost_device = lost_team = lost_error = lost_late = 0.0
    v_hd0 = 0.0
    for k in range(count):
        lead, head = leads[k], heads[k]
        b, low, high = ends[head, 0], ends[head, 1], ends[head, 2]
        far_b = ends[lead, 0]
        # storage at the start of this sample
        v_hd = v_fs = v_e = v_filter = 0.0
        for i in range(3):
            r = v[i] + n.weight * x[i]
            v_hd += 0.5 * (n.mass * r * r + spare * x[i] * x[i])
            for j in range(size):
                square = w[i, j] ** 2 + z[i, j] ** 2
                v_fs += 0.5 * values[j] * square
                v_e += 0.5 * square
            if port:
                v_filter += (k21 * (a1[i] ** 2 + a2[i] ** 2) + k12 * (c1[i] ** 2 + c2[i] ** 2)) / cut
        if k == 0:
            v_hd0 = v_hd
        held[k] = v_e
        # what the operator sees: the leader of `vision` samples ago, and what it was told to do
        late = k - n.vision
        for i in range(3):
            error[i] = -seen[late, i] if late >= 0 else 0.0
        distance = np.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
        good = max(1.0 - distance / n.error_range, 0.0) if late >= 0 and n.push > 0.0 else 0.0
        share = min(max((trust[lead] - trusts[lead, 3]) / (trusts[lead, 4] - trusts[lead, 3]), 0.0), 1.0)
        told = trust[lead]
        scale_low, scale_high = ends[lead, 1], ends[lead, 2]
        beta = scale_low + (scale_high - scale_low) * 0.5 * (1.0 - np.tanh(0.5 * n.steepness * (share - 0.5)))
        for i in range(size):
            goal = trusts[i, 3] + (trusts[i, 4] - trusts[i, 3]) * trusts[i, 2] * good
            trust[i] = trusts[i, 1] * trust[i] + (1.0 - trusts[i, 1]) * goal
        # waves that arrive
        read_wave(u_l, got[0], k, delays[0, k], n.gain, n.read_out, T, accounts[0], v_r)
        read_wave(u_r, got[1], k, delays[1, k], n.gain, n.read_out, T, accounts[1], v_l)
        if n.filtering == WAVES:
            for i in range(3):
                middle = keep * wave_r[i] + g * v_r[i]
                wave_r[i], v_r[i] = 2.0 * middle - wave_r[i], middle
                middle = keep * wave_l[i] + g * v_l[i]
                wave_l[i], v_l[i] = 2.0 * middle - wave_l[i], middle
        # the operator's end in closed form: f_m = f0 + f1 r_m, r_m = a + y σ p
        into, size_p = beta * np.sqrt(2.0 * b / high), n.push * distance
        cap = n.push * min(1.0, n.reach / size_p) if size_p > 0.0 else 0.0
        pull = stir = squares = seen_power = 0.0
        for i in range(3):
            h0[i] = stay * a1[i]
            e1[i] = beta * b * gate / (1.0 + beta * b * k12)
            e0[i] = (beta * b * h0[i] + into * v_l[i]) / (1.0 + beta * b * k12)
            f0[i] = stay * c1[i] + gate * e0[i]
            f1[i] = k21 + gate * e1[i]
            open_r = tip * (2.0 * n.mass * v[i] / T - n.stiffness * x[i]) / left + n.weight * x[i]
            under = 1.0 + admit * (f1[i] + n.drag)
            p[i] = cap * error[i]
            y[i] = admit / under
            a[i] = (open_r - admit * f0[i] + admit * pushed[k, i]) / under
            pull += p[i] * a[i] * (1.0 - 2.0 * n.drag * y[i])
            stir += y[i] * p[i] ** 2 * (1.0 - n.drag * y[i])
            squares += a[i] ** 2
            if late >= 0:
                seen_power += sent[late, i] * error[i]
        sigma = 1.0
        if n.guarded:
            free = v_h + n.budget - n.reserve
            sigma = push_share(free, free / T + seen_power, pull, stir, squares, n.drag)
        hand = device = channel = team = away = filters = 0.0
        lost_now = team_now = error_now = 0.0
        b_root = np.sqrt(2.0 / far_b)
        for i in range(3):
            r_m[i] = a[i] + y[i] * sigma * p[i]
            f_m[i] = f0[i] + f1[i] * r_m[i]
            f_h[i] = sigma * p[i] - n.drag * r_m[i] + pushed[k, i]
            near_r = h0[i] + gate * r_m[i]
            near_f = e0[i] + e1[i] * r_m[i]
            if port:
                near_r -= k12 * near_f
            middle = (2.0 * n.mass * v[i] / T - n.stiffness * x[i] + f_h[i] - f_m[i]) / left
            half = x[i] + h * middle
            hand += r_m[i] * f_h[i]
            device += r_m[i] * (f_h[i] - f_m[i])
            lost_now += (n.damping - n.mass * n.weight) * middle**2 + n.weight * n.stiffness * half**2
            u_l[k, i] = np.sqrt(2.0 * b * low) * near_r + np.sqrt(low / high) * v_l[i]
            # the robots' end in closed form: f_s = open_f + stiffness r_s
            open_f = 0.0
            for j in range(size):
                open_f += vectors[lead, j] * values[j] * solve[j] * (w[i, j] + h * values[j] * z[i, j])
            hard = stiffness[lead]
            under = 1.0 + k12 * hard
            part0, part1 = (stay * a2[i] - k12 * open_f) / under, gate / under
            back0 = stay * c2[i] + gate * (open_f + hard * part0)
            back1 = k21 + gate * hard * part1
            far_r = (b_root * v_r[i] - back0 / far_b) / (1.0 + back1 / far_b)
            far_f = back0 + back1 * far_r
            r_s[i] = part0 + part1 * far_r
            f_s[i] = open_f + hard * r_s[i]
            u_r[k, i] = b_root * far_f - v_r[i]
            channel += near_r * near_f - far_r * far_f
            filters += r_m[i] * f_m[i] - near_r * near_f + far_r * far_f - r_s[i] * f_s[i]
            if port:
                a1[i] += 2.0 * pole * (r_m[i] - a1[i]) / (1.0 + pole)
                c1[i] += 2.0 * pole * (near_f - c1[i]) / (1.0 + pole)
                a2[i] += 2.0 * pole * (far_r - a2[i]) / (1.0 + pole)
                c2[i] += 2.0 * pole * (f_s[i] - c2[i]) / (1.0 + pole)
            at[i] = 0.0
            if k % every == 0:
                row = k // every
                log[row, 3 + i] = x[i]
                for j in range(size):
                    modes[row, i, j] = w[i, j]
            for j in range(size):
                q = solve[j] * (w[i, j] + h * (values[j] * z[i, j] + vectors[lead, j] * r_s[i]))
                w[i, j] = 2.0 * q - w[i, j]
                z[i, j] -= T * values[j] * q
                at[i] += vectors[lead, j] * q
                team_now += (values[j] * q) ** 2
                error_now += values[j] * q * q
            team += r_s[i] * f_s[i]
            away += r_s[i] * at[i]
            x[i] += T * middle
            v[i] = 2.0 * middle - v[i]
            sent[k, i], seen[k, i] = r_s[i], at[i]
        lost[k] = error_now
        if k % every == 0:
            row = k // every
            for i in range(3):
                log[row, i], log[row, 6 + i], log[row, 9 + i] = at[i], r_m[i], f_h[i]
                log[row, 12 + i], log[row, 15 + i], log[row, 18 + i] = f_m[i], r_s[i], f_s[i]
            v_late = held[late] if late >= 0 else held[0]
            total = v_h + n.budget + v_hd + v_hd0 + v_ch + v_fs + v_late + v_filter
            log[row, 21], log[row, 22], log[row, 23], log[row, 24] = lead, beta, told, sigma
            log[row, 25], log[row, 26], log[row, 27], log[row, 28] = v_h, v_hd, v_ch, v_fs
            log[row, 29], log[row, 30], log[row, 31], log[row, 32] = v_e, v_late, v_filter, total
            log[row, 33], log[row, 34], log[row, 35] = supply_team, supply_error, supply_hand
            log[row, 36], log[row, 37] = supply_device, supply_filter
            log[row, 38], log[row, 39], log[row, 40], log[row, 41] = (
                lost_device,
                lost_team,
                lost_error,
                lost_late,
            )
        v_h += T * (seen_power - hand)
        v_ch += T * channel
        supply_team += T * team
        supply_error += T * away
        supply_hand += T * hand
        supply_device += T * device
        supply_filter += T * filters
        lost_device += T * lost_now
        lost_team += T * team_now
        lost_error += T * error_now
        if late >= 0:
            lost_late += T * lost[late]
        if not v_hd < 1e12:
            return k + 1, 0
        if not abs(v_ch) < 1e12:
            return k + 1, 1
        if not v_e < 1e12:
            return k + 1, 2
    return count, -1
