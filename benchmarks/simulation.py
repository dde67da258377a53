"""
Simulation of (2.1), (2.3), (2.5) and (2.6) over 20,000 samples, beside plain Python and
scipy.signal.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import exp, log

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import trustlab as tl
from benchmarks.data import modes, pilot
from benchmarks.timing import Row, here, in_turns

TITLE = "Simulation"
OURS = "trustlab TscModel.simulate, a DataFrame"


def rows() -> Iterator[Row]:
    """Yield one row per way to simulate; for information."""
    model, mode = pilot(), modes()
    ours = model.simulate(mode)
    for peer, call, turns in (
        ("a loop in plain Python, a DataFrame", loop, 9),
        ("scipy.signal.lfilter and NumPy, a DataFrame", filtered, 25),
    ):
        case = f"Simulation of TSC, {mode.size:,} samples"
        if not np.allclose(call(model, mode), ours, rtol=1e-9, atol=1e-12):
            yield Row(case, OURS, peer, fault="its trajectories differ")
            continue
        ours_ms, peer_ms, ratio = in_turns(
            here(lambda: model.simulate(mode)), here(lambda call=call: call(model, mode)), turns
        )
        rates = [mode.size / spread.median / 1e3 for spread in (ours_ms, peer_ms)]
        note = f"million samples per second: {rates[0]:.1f} and {rates[1]:.2f}"
        yield Row(case, OURS, peer, ours_ms, peer_ms, ratio, note=note)
    yield allocation(model)


def allocation(model: tl.TscModel, steps: int = 200_000) -> Row:
    """
    Return the row of the model under rule (2.8), beside the same loop in plain Python.

    Parameters
    ----------
    model : TscModel
        The model.
    steps : int
        Samples to simulate.
    """
    case = f"Allocation by (2.8), {steps:,} samples"
    ours = "trustlab simulate_allocation"
    peer = "the loop in plain Python"
    call, other = (
        lambda: tl.simulate_allocation(model, 0.02, 0.45, steps),
        lambda: switching(model, 0.02, 0.45, steps),
    )
    if not np.allclose(other(), call(), rtol=1e-9, atol=1e-12):
        return Row(case, ours, peer, fault="its trajectories differ")
    ours_ms, peer_ms, ratio = in_turns(here(call), here(other), 9)
    rate = steps / ours_ms.median / 1e3
    goal, met = "≥ 10 million steps/s", bool(rate >= 10.0)
    return Row(
        case,
        ours,
        peer,
        ours_ms,
        peer_ms,
        ratio,
        goal=goal,
        met=met,
        note=f"{rate:.0f} million steps per second",
    )


def switching(model: tl.TscModel, lower: float, upper: float, steps: int) -> pd.DataFrame:
    """
    Simulate under rule (2.8) sample by sample.

    Parameters
    ----------
    model : TscModel
        The model.
    lower, upper : float
        Thresholds.
    steps : int
        Samples.
    """
    human = model.human
    robot = model.robot
    a_t = model.a_T
    b_t = model.b_T
    r = 0.0
    p_r = robot.p_min
    mode = 1.0
    out = []
    for _ in range(steps):
        bell = 0.0
        if 0.0 < r < 1.0:
            bell = exp(
                human.beta * log(r / human.beta)
                + (1 - human.beta) * log((1 - r) / (1 - human.beta))
            )
        p_h = (human.p_max - human.p_min) * bell + human.p_min
        tsc = a_t * p_r - b_t * p_h
        mode = 0.0 if tsc >= upper else 1.0 if tsc <= lower else mode
        out.append((r, p_r, p_h, tsc, mode))
        p_r = robot.a * p_r + (1 - robot.a) * robot.p_min + mode * robot.b * p_h
        r = human.a * r + (1 - human.a) * mode
    return pd.DataFrame(out, columns=["r", "p_r", "p_h", "tsc", "mode"])


def loop(model: tl.TscModel, mode: np.ndarray) -> pd.DataFrame:
    """
    Simulate sample by sample.

    Parameters
    ----------
    model : TscModel
        The model.
    mode : numpy.ndarray, shape (N,)
        Manual share.
    """
    human = model.human
    robot = model.robot
    a_t = model.a_T
    b_t = model.b_T
    r = 0.0
    p_r = robot.p_min
    out = []
    for m in mode.tolist():
        bell = 0.0
        if 0.0 < r < 1.0:
            bell = exp(
                human.beta * log(r / human.beta)
                + (1 - human.beta) * log((1 - r) / (1 - human.beta))
            )
        p_h = (human.p_max - human.p_min) * bell + human.p_min
        out.append((r, p_r, p_h, a_t * p_r - b_t * p_h, m))
        p_r = robot.a * p_r + (1 - robot.a) * robot.p_min + m * robot.b * p_h
        r = human.a * r + (1 - human.a) * m
    return pd.DataFrame(out, columns=["r", "p_r", "p_h", "tsc", "mode"])


def filtered(model: tl.TscModel, mode: np.ndarray) -> pd.DataFrame:
    """
    Simulate with two first-order filters and array arithmetic.

    Parameters
    ----------
    model : TscModel
        The model.
    mode : numpy.ndarray, shape (N,)
        Manual share.
    """
    human, robot = model.human, model.robot
    r = lfilter([0.0, 1.0 - human.a], [1.0, -human.a], mode)
    bell = (r / human.beta) ** human.beta * ((1 - r) / (1 - human.beta)) ** (1 - human.beta)
    p_h = (human.p_max - human.p_min) * bell + human.p_min
    p_r = robot.p_min + lfilter([0.0, robot.b], [1.0, -robot.a], mode * p_h)
    return pd.DataFrame(
        {"r": r, "p_r": p_r, "p_h": p_h, "tsc": model.value(p_r, p_h), "mode": mode}
    )
