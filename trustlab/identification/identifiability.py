"""What data can tell and what they cannot."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.errors import IdentificationError
from trustlab.identification.greybox import Problem
from trustlab.identification.traces import Trace

__all__ = ["HALF_WIDTH", "HINTS", "check_mode_moves", "check_output_moves", "undetermined"]


def check_output_moves(runs: list[Trace], name: str, parameters: tuple[str, ...]) -> None:
    """
    Refuse a run in which a measured performance never moves.

    Parameters
    ----------
    runs : list of Trace
        The data.
    name : str
        The column, p_h or p_r.
    parameters : tuple of str
        What cannot be told without it.

    Raises
    ------
    IdentificationError
        If it is constant over all runs.
    """
    values = np.concatenate([getattr(run, name) for run in runs])
    if np.ptp(values) == 0.0:
        raise IdentificationError(
            f"{name} never moves (it is {values[0]:g} throughout), so {', '.join(parameters[:-1])} and {parameters[-1]} "
            "cannot be told; record a session in which performance is measured",
            parameters,
        )


HINTS = {
    "a": "record a rise or a decay long enough to see its curvature",
    "beta": "record phases that take utilization to both sides of its best",
    "p_min": "record a phase long enough to settle at the least performance",
    "p_max": "record a phase long enough to come near the greatest performance",
}


def check_mode_moves(runs: list[Trace], limits: dict[str, tuple[float, float]], low: str, high: str) -> None:
    """
    Refuse data in which nothing separates the least from the greatest robot performance.

    Parameters
    ----------
    runs : list of Trace
        The data.
    limits : dict
        From `limits_of`.
    low, high : str
        Names of the least and the greatest robot performance.

    Raises
    ------
    IdentificationError
        If mode never changes and neither parameter is fixed, or is 0 throughout and `high` is not fixed.
    """
    modes = np.concatenate([run.mode for run in runs])
    held = {name for name in (low, high) if limits[name][0] == limits[name][1]}
    if np.ptp(modes) > 0.0 or (held and (modes[0] > 0.0 or high in held)):
        return
    lost = (high,) if modes[0] == 0.0 else (low, high)
    what = " and ".join(lost)
    raise IdentificationError(
        f"these data do not determine {what}: mode never changes (it is {modes[0]:g} throughout); log at least one "
        f"switch between manual and autonomous control, or fix a parameter, for example fixed={{{lost[0]!r}: ...}}",
        lost,
    )


HALF_WIDTH = float(special.ndtri(0.975))
"""Standard errors from the middle of a 95 % interval to its end."""


def _is_weak(kind: str, value: float, stderr: float, span: float) -> bool:
    half = HALF_WIDTH * stderr
    if kind == "rate":
        return half > 0.5 * (1.0 - value)
    if kind == "logit":
        return half > min(0.25, value, 1.0 - value)
    return half > 0.5 * abs(span)


def undetermined(problem: Problem, table: pd.DataFrame) -> list[str]:
    """
    Return the shared parameters that a bound holds or whose interval is too wide to be of use.

    Too wide: 95 % intervals beyond half the time constant, 0.25 or an end of (0, 1) on beta, or half the range from
    p_min to p_max.

    Parameters
    ----------
    problem : Problem
        Structure and data.
    table : pandas.DataFrame
        Index `parameter`; columns value, stderr, status.
    """
    names, (values, stderrs, statuses) = [], (table[c].to_dict() for c in ("value", "stderr", "status"))
    for name, kind in zip(problem.structure.shared, problem.structure.maps, strict=False):
        prefix = next((stem for stem in ("human_", "robot_") if name.startswith(stem)), "")
        span = values[f"{prefix}p_max"] - values[f"{prefix}p_min"]
        weak = statuses[name] == "estimated" and _is_weak(kind, values[name], stderrs[name], span)
        if weak or statuses[name] == "at bound":
            names.append(name)
    return names
