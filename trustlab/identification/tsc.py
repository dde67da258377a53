"""Identification of robot and operator together, (2.3), (2.5) and (2.6): structure, sensitivities, `fit_tsc`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numba
import numpy as np

from trustlab.identification.fit_result import FitResult
from trustlab.identification.fitting import fit
from trustlab.identification.human import SLOPES as HUMAN_SLOPES
from trustlab.identification.human import (
    build_human,
    human_guess,
    human_parameters,
    initial_utilization,
    performance_slopes,
)
from trustlab.identification.robot import build_robot, check_excitation, robot_guess, robot_parameters
from trustlab.identification.runs import Run
from trustlab.identification.structure import Parameter, Structure
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session

__all__ = ["TSC", "fit_tsc"]


def fit_tsc(
    sessions: Session | Iterable[Session],
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
) -> FitResult:
    """
    Identify robot and operator together: one likelihood for p_r and p_h, the robot driven by the fitted operator.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode, p_h and p_r; parameters are shared, initial states are not.
    fixed : mapping, optional
        Values to hold, by name: human_a, human_beta, human_p_min, human_p_max, robot_a, robot_p_min, robot_p_max,
        r0, p_r0.
    bounds : mapping, optional
        (low, high) by name, None for an open side.
    noise : {"auto", "white", "hac"}
        What standard errors allow for: white residuals, or autocorrelated ones (Newey–West); "auto" chooses by a
        Ljung–Box test at 0.001.

    Returns
    -------
    FitResult
        With a TscModel; each output is weighted by the inverse of its own residual variance.

    Raises
    ------
    IdentificationError
        If the data do not determine a parameter; it is named.
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood.
    """
    return fit(TSC, sessions, fixed=fixed, bounds=bounds, noise=noise)


P_H_NAMES = ("human_a", "human_beta", "human_p_min", "human_p_max", "r0")
P_R_NAMES = (*P_H_NAMES[:-1], "robot_a", "robot_p_min", "robot_p_max", "r0", "p_r0")
ROBOT_SLOPES = np.dtype([(name, float) for name in P_R_NAMES])


@numba.njit(cache=True)
def _simulate_with_slopes(mode, human, robot, r0, p_r0, p_h, p_r, by_human, by_robot):
    """Run (2.3), (2.5), (2.6) with the simulated operator driving the robot, and all derivatives, into the last four."""
    a_h, beta, h_min, h_max = human
    a, p_min, p_max = robot
    span, gain, rest = h_max - h_min, (p_max - p_min) / h_max, 1.0 - a
    r, r_a, r_0, now, by_0 = r0, 0.0, 1.0, p_r0, 1.0
    # Derivatives of P_r by the human's parameters, by the robot's, and by r0.
    by_ha, by_beta, by_hmin, by_hmax, by_a, by_min, by_max, by_r0 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(mode.size):
        shape, slope, shape_beta = performance_slopes(r, beta)
        m = mode[k]
        h = h_min + span * shape
        h_a, h_beta, h_r0 = span * slope * r_a, span * shape_beta, span * slope * r_0
        p_h[k], p_r[k] = h, now
        row = by_human[k]
        row.a = h_a
        row.beta = h_beta
        row.p_min = 1.0 - shape
        row.p_max = shape
        row.r0 = h_r0
        slopes = by_robot[k]
        slopes.human_a = by_ha
        slopes.human_beta = by_beta
        slopes.human_p_min = by_hmin
        slopes.human_p_max = by_hmax
        slopes.robot_a = by_a
        slopes.robot_p_min = by_min
        slopes.robot_p_max = by_max
        slopes.r0 = by_r0
        slopes.p_r0 = by_0
        # As in the robot's own structure; the human's parameters act through P_h, and p_max also through the gain.
        drive = m * h
        share = drive / h_max
        into = rest * gain * m
        by_ha = a * by_ha + into * h_a
        by_beta = a * by_beta + into * h_beta
        by_hmin = a * by_hmin + into * (1.0 - shape)
        by_hmax = a * by_hmax + into * (shape - h / h_max)
        by_r0 = a * by_r0 + into * h_r0
        by_a = a * by_a + now - p_min - gain * drive
        by_min = a * by_min + rest * (1.0 - share)
        by_max = a * by_max + rest * share
        by_0 = a * by_0
        now = a * now + rest * (p_min + gain * drive)
        r_a = a_h * r_a + r - m
        r_0 = a_h * r_0
        r = a_h * r + (1.0 - a_h) * m


def _sensitivities(
    run: Run, human_a, human_beta, human_p_min, human_p_max, robot_a, robot_p_min, robot_p_max, r0, p_r0
):
    """Return P_h and P_r with their derivatives, shapes (N, 5) and (N, 9)."""
    human, robot = (human_a, human_beta, human_p_min, human_p_max), (robot_a, robot_p_min, robot_p_max)
    n = run.size
    p_h, p_r = np.empty(n), np.empty(n)
    by_human, by_robot = np.empty(n, HUMAN_SLOPES), np.empty(n, ROBOT_SLOPES)
    _simulate_with_slopes(run["mode"], human, robot, r0, p_r0, p_h, p_r, by_human, by_robot)
    return [p_h, p_r], [by.view(float).reshape(n, -1) for by in (by_human, by_robot)]


def _guess(runs: list[Run], limits: Mapping) -> dict:
    """Return starting values: the operator's first, then the robot's under the measured P_h."""
    own = {
        name.removeprefix("human_"): pair for name, pair in limits.items() if not name.startswith("robot_")
    }
    human = human_guess(runs, own)
    robot = robot_guess(runs, {"a": limits["robot_a"]}, human["p_max"])
    states = {"r0": human.pop("r0"), "p_r0": robot.pop("p_r0")}
    return (
        {f"human_{name}": value for name, value in human.items()}
        | {f"robot_{name}": value for name, value in robot.items()}
        | states
    )


def _build(**values) -> TscModel:
    human, robot = (
        {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}
        for prefix in ("human_", "robot_")
    )
    operator = build_human(**human)
    return TscModel(build_robot(**robot, p_h_max=operator.p_max), operator)


TSC = Structure(
    "robot and human model (2.3), (2.5)-(2.6)",
    parameters=(*human_parameters("human_"), *robot_parameters("robot_")),
    initial=(initial_utilization("human_beta"), Parameter("p_r0")),
    outputs=("p_h", "p_r"),
    sensitivities=_sensitivities,
    affected_by={"p_h": P_H_NAMES, "p_r": P_R_NAMES},
    guess=_guess,
    model=_build,
    derived={
        "human_b": lambda at: 1.0 - at["human_a"],
        "robot_b": lambda at: (
            (1.0 - at["robot_a"]) * (at["robot_p_max"] - at["robot_p_min"]) / at["human_p_max"]
        ),
    },
    check=lambda runs, limits: check_excitation(runs, limits, "robot_p_min", "robot_p_max"),
)
