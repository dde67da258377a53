"""What a study takes from a teleoperation run: error, effort, allocation, and how its ports' energies ended."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from trustlab.sessions.session import Session

__all__ = ["teleoperation_measures"]

COLUMNS = (
    "participant",
    "scheme",
    "tracking_error",
    "worst_error",
    "p_r",
    "p_h",
    "alpha",
    "alpha_rate",
    "beta",
    "hand_force",
    "energy_operator",
    "energy_dissipated",
    "energy_channel_min",
    "energy_robot_min",
    "guarded",
    "port_share",
)
AXES = "xyz"


def teleoperation_measures(sessions: Session | Iterable[Session]) -> pd.DataFrame:
    """
    Return one row of measures per run.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs of `simulate_teleoperation`.

    Returns
    -------
    pandas.DataFrame
        participant, scheme; tracking_error, worst_error (mean and greatest distance to the target [m]); p_r, p_h, alpha, beta
        (means); alpha_rate (mean |dα/dt| [1/s]); hand_force (mean ‖f_h‖ [N]); energy_operator, energy_dissipated (at the end
        [J]); energy_channel_min, energy_robot_min (least values [J]); guarded (share of samples in which the passivity
        controller acted); port_share (mean share of the
        port's velocity that the controller let pass, 1 where it rests).

    Raises
    ------
    ValueError
        If there is no run, or an item is not a Session.
    SessionError
        If a run lacks a column.
    """
    runs = [sessions] if isinstance(sessions, Session) else list(sessions)
    if not runs:
        raise ValueError("sessions is empty: give at least one run of simulate_teleoperation")
    rows = []
    for number, run in enumerate(runs):
        if not isinstance(run, Session):
            raise ValueError(f"sessions[{number}] must be a Session, got {type(run).__name__}")
        names = ("path_error", "p_r", "p_h", "alpha", "beta", "port_share", "f_h_x", "f_h_y", "f_h_z")
        energies = ("energy_operator", "energy_dissipated", "energy_channel", "energy_robot")
        run.require(*names, *energies)
        force = np.sqrt(sum(run[f"f_h_{axis}"] ** 2 for axis in AXES))
        row = (
            run.metadata.participant,
            run.metadata.condition,
            run["path_error"].mean(),
            run["path_error"].max(),
            run["p_r"].mean(),
            run["p_h"].mean(),
            run["alpha"].mean(),
            np.abs(np.diff(run["alpha"])).mean() / run.sample_time,
            run["beta"].mean(),
            force.mean(),
            run["energy_operator"][-1],
            run["energy_dissipated"][-1],
            run["energy_channel"].min(),
            run["energy_robot"].min(),
            (run["port_share"] < 1.0).mean(),
            run["port_share"].mean(),
        )
        rows.append(row)
    frame = pd.DataFrame(rows, columns=COLUMNS)
    if any(run.metadata.synthetic for run in runs):
        frame.attrs["origin"] = "simulated operators"
    return frame
