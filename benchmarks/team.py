"""
One operator and a team of robots, 60 s at 1 kHz: cost against the number of robots, beside the same
model in plain NumPy.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import trustlab as tl
from benchmarks.timing import Row, here, in_turns
from trustlab.teleoperation import (
    GivenSequence,
    Scattering,
    TeamChannel,
    TeamOperator,
    TeamSettings,
    TeamTrial,
)
from trustlab.testbeds.team_run import TeamRun

TITLE = "Teleoperated team"
OURS = "trustlab simulate_team, all signals and storages"
PEER = "the same equations in plain NumPy, positions and forces"
ROBOTS = (2, 4, 12, 25, 50, 100)
SECONDS = 60.0
T = 1e-3
DELAY = 0.2
SHORT = 2.0
"""Length [s] of the peer's runs; its time is scaled up, as each of its steps costs the same."""


def rows() -> Iterator[Row]:
    """Yield a row per number of robots."""
    for robots in ROBOTS:
        case = f"Team of {robots} robots, 60 s at 1 kHz"
        ours, short = one(robots, SECONDS), one(robots, SHORT)
        if not np.allclose(plain(robots, SHORT), short.positions[::10], rtol=0.0, atol=1e-8):
            yield Row(case, OURS, PEER, fault="its positions differ")
            continue
        peer = here(lambda robots=robots: plain(robots, SHORT))
        ours_ms, peer_ms, ratio = in_turns(
            here(lambda robots=robots: one(robots, SECONDS)),
            lambda calls, peer=peer: SECONDS / SHORT * peer(calls),
            5,
        )
        note = (
            f"{1e6 * ours_ms.median / (SECONDS / T):.0f} ns per step; {len(ours.data)} rows "
            "recorded"
        )
        goal, met = ("≤ 40 ms", ours_ms.median <= 40.0) if robots == 4 else ("", None)
        yield Row(case, OURS, PEER, ours_ms, peer_ms, ratio, goal=goal, met=met, note=note)


def case(robots: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a ring where each sees two on either side, and where its robots begin.

    Parameters
    ----------
    robots : int
        How many.
    """
    apart = np.abs(np.subtract.outer(np.arange(robots), np.arange(robots)))
    apart = np.minimum(apart, robots - apart)
    return ((apart > 0) & (apart <= 2)).astype(float), np.random.default_rng(robots).uniform(
        -5.0, 5.0, (robots, 3)
    )


def one(robots: int, seconds: float) -> TeamRun:
    """
    Simulate with this package: filters, switching, scaling, storages.

    Parameters
    ----------
    robots : int
        How many.
    seconds : float
        Length [s].
    """
    graph, start = case(robots)
    return tl.simulate_team(
        graph,
        GivenSequence(every=5.0),
        (1.0, 2.0, 0.5),
        duration=seconds,
        operator=TeamOperator(reach=1e9, guarded=False),
        settings=TeamSettings(scattering=Scattering(2.0), channel=TeamChannel(DELAY)),
        trial=TeamTrial(T, record_every=0.01 if seconds > SHORT else T, start=start),
    )


def plain(robots: int, seconds: float) -> np.ndarray:
    """
    Simulate with NumPy: the team's implicit step as one product with a dense matrix, ports in
    closed form; no storages.

    Parameters
    ----------
    robots : int
        How many.
    seconds : float
        Length [s].
    """
    graph, start = case(robots)
    goal = np.array([1.0, 2.0, 0.5])
    h = 0.5 * T
    w = 10.0
    b = 2.0
    k12 = 0.25
    k21 = 1.0
    L = np.diag(graph.sum(axis=1)) - graph
    P = np.linalg.inv(np.eye(robots) + h * L + h * h * L @ L)
    from_zeta, response = h * P @ L, h * np.diag(L @ P)
    mass = 0.5
    damping = 5.5
    stiffness = 20.0
    weight = 10.0
    drag = 1.0
    push = 4.0 / (1.0 + 2.0 * DELAY)
    left, tip = 2.0 * mass / T + damping + h * stiffness, 1.0 + h * weight
    keep = 1.0 / (1.0 + h * w)
    g = h * w / (1.0 + h * w)
    late = round(DELAY / T)
    count = round(seconds / T)
    q = start - goal
    zeta = np.zeros((robots, 3))
    x = np.zeros(3)
    v = np.zeros(3)
    a1, c1, a2, c2 = np.zeros((4, 3))
    u_l, u_r, seen = np.zeros((3, count, 3))
    out = np.empty((-(-count // 10), robots, 3))
    for k in range(count):
        if k % 10 == 0:
            out[k // 10] = q
        lead = int(k * T / 5.0 + 1e-9) % robots
        v_r, v_l, error = (
            np.zeros((3, 3)) if k < late else (u_l[k - late], u_r[k - late], -seen[k - late])
        )
        under = 1.0 + b * k12
        e0, e1 = (b * keep * a1 + np.sqrt(2.0 * b) * v_l) / under, b * g / under
        f0, f1 = keep * c1 + g * e0, k21 + g * e1
        open_r = tip * (2.0 * mass * v / T - stiffness * x) / left + weight * x
        r_m = (open_r + tip / left * (push * error - f0)) / (1.0 + tip / left * (f1 + drag))
        near_f = e0 + e1 * r_m
        near_r = keep * a1 + g * r_m - k12 * near_f
        middle = (
            2.0 * mass * v / T - stiffness * x + push * error - drag * r_m - f0 - f1 * r_m
        ) / left
        q_open = P @ q + from_zeta @ zeta
        open_f, hard = L[lead] @ q_open, response[lead]
        part0, part1 = (keep * a2 - k12 * open_f) / (1.0 + k12 * hard), g / (1.0 + k12 * hard)
        back0, back1 = keep * c2 + g * (open_f + hard * part0), k21 + g * hard * part1
        far_r = (np.sqrt(2.0 / b) * v_r - back0 / b) / (1.0 + back1 / b)
        r_s = part0 + part1 * far_r
        f_s = open_f + hard * r_s
        u_l[k] = np.sqrt(2.0 * b) * near_r + v_l
        u_r[k] = np.sqrt(2.0 / b) * (back0 + back1 * far_r) - v_r
        q_mid = q_open + h * P[:, lead, None] * r_s
        seen[k] = q_mid[lead]
        q, zeta = 2.0 * q_mid - q, zeta - T * L @ q_mid
        x, v = x + T * middle, 2.0 * middle - v
        a1, c1 = a1 + 2.0 * g * (r_m - a1), c1 + 2.0 * g * (near_f - c1)
        a2, c2 = a2 + 2.0 * g * (far_r - a2), c2 + 2.0 * g * (f_s - c2)
    return out + goal
