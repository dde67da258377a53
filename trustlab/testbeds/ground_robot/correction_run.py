"""Corrections over several tests in a row on the ground-robot testbed, as in Fig. 2.18."""

from dataclasses import replace

import numpy as np
import pandas as pd

from trustlab.allocation.correction.corrector import ThresholdCorrector, threshold_pair
from trustlab.allocation.correction.in_loop import loop_correction
from trustlab.allocation.correction.tests_in_a_row import CorrectionRun
from trustlab.models.checks import not_negative, one_of, spawned, whole_number
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator
from trustlab.testbeds.deciding import OWN, TSC, framed, task_of
from trustlab.testbeds.ground_robot import conditions as bed
from trustlab.testbeds.ground_robot.course import Course
from trustlab.testbeds.ground_robot.pioneer import Pioneer

# What operators do about suggestions: scheme of the testbed, whether all are followed, whether own
# thresholds move.
HABITS = {
    "following": (TSC, True, False),
    "lagging": (TSC, True, False),
    "free": (TSC, False, False),
    "ignoring": (OWN, False, False),
    "adopting": (OWN, False, True),
}


def run_correction(
    participant: int | str | Operator,
    target: tuple[float, float],
    start: tuple[float, float] | None = None,
    habit: str = "following",
    tests: int = 4,
    laps: int = 8,
    c_b: float = 1e-5,
    horizon: int = 200,
    seed: int | np.random.SeedSequence = 0,
    lag: float = 10.0,
    model: TscModel | None = None,
    robot: Pioneer | None = None,
    course: Course | None = None,
    r0: float = 0.0,
) -> CorrectionRun:
    """
    Drive tests in a row while the thresholds of the suggestions are corrected, Section 2.5, by the
    exact engine.

    TSC comes from performance as measured, (2.4) and (2.7) over 100 s. Thresholds are held until
    that window is full and carried on from test to test. Measured performance outside the model's
    range is planned with as at its end; the status says so.

    Parameters
    ----------
    participant : int, str or Operator
        Who drives, as for `run_condition`.
    target : (float, float)
        TSC_ld and TSC_ud.
    start : (float, float), optional
        TSC_l and TSC_u to begin with; for a printed participant the printed ones when not given.
    habit : {"following", "lagging", "free", "ignoring", "adopting"}
        Follows all suggestions after a reaction; after the longer reaction `lag`; as many as the
        operator does in C2; allocates by own thresholds whatever is suggested; or by own thresholds
        that move by the same corrections.
    tests : int
        How many tests.
    laps : int
        How many laps in each.
    c_b : float
        Largest correction per step.
    horizon : int
        N of (2.43).
    seed : int or numpy.random.SeedSequence
        One child is spawned from it per test.
    lag : float
        Median reaction of the habit "lagging" [s].
    model : TscModel, optional
        The model; for a printed participant the printed one when not given.
    robot : Pioneer, optional
        The robot, if not the calibrated one.
    course : Course, optional
        The course, if not the default one.
    r0 : float
        Utilization at the beginning of each test.

    Returns
    -------
    CorrectionRun
        With `.data`, `.table()`, `.plot()` and `.sessions`; latencies are NaN, as the loop is
        compiled as a whole.

    Raises
    ------
    ValueError
        If an argument is not understood or out of range, or laps are not finished at 0.15 m/s on
        average.

    Notes
    -----
    Simulated: no person took part.
    """
    scheme, forced, adopted = HABITS[one_of("habit", habit, HABITS)]
    operator, model, printed = bed.who_drives(participant, None, model)
    operator, robot, course = bed.checked(operator, robot, course)
    corrector = ThresholdCorrector(model, target, c_b, horizon)
    if start is None and printed is None:
        raise ValueError("an Operator needs start=(TSC_l, TSC_u), the thresholds to begin with")
    start = threshold_pair("start", printed if start is None else start)
    tests, laps = (
        whole_number("tests", tests, most=100),
        whole_number("laps", laps, most=bed.MOST_LAPS),
    )
    lag = not_negative("lag", lag)
    if habit == "lagging":
        operator = replace(operator, reaction_lag=lag)
    most = bed.longest(laps, course)
    now = start
    parts = []
    sessions = []
    for test, child in enumerate(spawned(seed, tests), start=1):
        limits = (operator.lower, operator.upper) if scheme == OWN else now
        if adopted:
            limits = (limits[0] + now[0] - start[0], limits[1] + now[1] - start[1])
        task = task_of(
            scheme,
            bed.E_MAX,
            forced=forced,
            laps=laps,
            lower=limits[0],
            upper=limits[1],
            model=model,
            r0=r0,
        )
        plan = loop_correction(
            model, now, corrector.target, corrector.c_b, corrector.horizon, most, adopted
        )
        log, _ = bed.driven(task, most, robot, course, operator, child, correction=plan)
        data = framed(log)
        facts = {
            "laps": laps,
            "habit": habit,
            "test": test,
            "TSC_ld": target[0],
            "TSC_ud": target[1],
        }
        sessions.append(bed.session_of(data, operator, f"correction, {habit}", child, **facts))
        parts.append(_rows(test, data, plan.log[: len(data)], plan.thresholds))
        now = tuple(plan.thresholds.tolist())
    frame = pd.concat(parts, ignore_index=True)
    source = "simulated stand-in for the Stage testbed (synthetic)"
    return CorrectionRun(frame, start, corrector.target, habit, source, tuple(sessions))


def _rows(test, data, log, end) -> pd.DataFrame:
    frame = data[["r", "p_r", "p_h", "tsc", "mode"]].reset_index()
    suggested = data["suggested_mode"].to_numpy()
    frame["suggestion"] = np.where(np.isfinite(suggested), suggested, -1.0).astype(int)
    frame["lower"], frame["upper"] = log["lower"], log["upper"]
    for name, side, last in zip(("c_l", "c_u"), ("lower", "upper"), end, strict=True):
        frame[name] = np.diff(np.r_[log[side], last])
    cost, bound = log["cost"], log["bound"]
    frame["cost"], frame["cost_lower_bound"] = cost, bound
    names = np.where(
        log["clipped"], "NEAREST", np.where(cost - bound > 1e-12 * cost, "BOUNDED", "OPTIMAL")
    )
    frame["status"] = np.where(np.isnan(cost), "SETTLING", names)
    frame["latency"] = np.nan
    frame.insert(0, "test", test)
    return frame
