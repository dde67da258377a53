"""Identification of robot and operator together, (2.3), (2.5) and (2.6)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from trustlab.identification.bounds import limits_of
from trustlab.identification.fit_result import FitResult
from trustlab.identification.greybox import JOINT, Problem
from trustlab.identification.human import build_human, with_derived_b, with_row
from trustlab.identification.identifiability import check_mode_moves, check_output_moves
from trustlab.identification.output_error import estimate
from trustlab.identification.robot import build_robot
from trustlab.identification.starting_values import human_start, robot_start
from trustlab.identification.summary import parameter_table, result
from trustlab.identification.traces import traces
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session

__all__ = ["fit_tsc"]


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
    limits = limits_of(JOINT, {} if fixed is None else fixed, {} if bounds is None else bounds)
    runs, _ = traces(sessions, "p_h", "p_r")
    check_mode_moves(runs, limits, "robot_p_min", "robot_p_max")
    check_output_moves(runs, "p_h", ("human_beta", "human_p_min", "human_p_max"))
    check_output_moves(runs, "p_r", ("robot_a", "robot_p_min", "robot_p_max"))
    own = {name.removeprefix("human_"): limits[name] for name in JOINT.shared[:4]} | {"r0": limits["r0"]}
    human = human_start(runs, own)
    robot = robot_start(runs, None, human["p_max"], {"a": limits["robot_a"]})
    shared = [human[name] for name in ("a", "beta", "p_min", "p_max")] + [
        robot[name] for name in ("a", "p_min", "p_max")
    ]
    states = np.column_stack([np.full(len(runs), human["r0"]), robot["p_r0"]]).ravel()
    problem = Problem(JOINT, runs, power=human["beta"])
    found = estimate(problem, np.r_[shared, states], limits, noise)
    human_model = build_human(*found.theta[:4])
    robot_model = build_robot(*found.theta[4:7], human_model.p_max)
    table, covariance = parameter_table(problem, found)
    table = with_derived_b(table, "human_")
    a, p_min, p_max, best = robot_model.a, robot_model.p_min, robot_model.p_max, robot_model.p_h_max
    gain = (p_max - p_min) / best
    slope = np.zeros(7)
    slope[3:] = [-(1.0 - a) * gain / best, -gain, -(1.0 - a) / best, (1.0 - a) / best]
    stderr = float(np.sqrt(slope @ np.nan_to_num(found.covariance[:7, :7]) @ slope))
    table = with_row(table, "robot_b", robot_model.b, stderr, "derived")
    return result(problem, found, TscModel(robot_model, human_model), table, covariance)
