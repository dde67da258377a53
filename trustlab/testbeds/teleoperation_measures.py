"""What a study takes from a teleoperation run: error, effort, allocation, and how its ports' energies ended."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class
from trustlab.sessions.session import Session

SIGNALS = ("path_error", "p_r", "p_h", "alpha", "beta", "port_share")
ENERGIES = ("energy_operator", "energy_dissipated", "energy_channel", "energy_robot", "energy_port", "energy_target")


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
        (means); alpha_rate (mean ``|dα/dt|`` [1/s]); hand_force (mean ‖f_h‖ [N]); guidance_felt (mean ‖f_m − β b r_m‖, what the device renders beyond the
        channel's own damping [N]); energy_operator, energy_dissipated, energy_target (at the end [J]); energy_channel_min,
        energy_robot_min, energy_port_min (least values [J]); guarded (share of samples in which the passivity controller
        acted); port_share (mean share that it let pass, 1 where it rests: of the port's velocity, or of the force with a tank).

    Raises
    ------
    ValueError
        If there is no run, or an item is not a Session.
    SessionError
        If a run lacks a column.

    Examples
    --------
    >>> import trustlab as tl
    >>> runs = [tl.simulate_teleoperation(scheme, seed=0, duration=10.0) for scheme in ("M", "TMIG")]
    >>> tl.teleoperation_measures(runs)[["scheme", "alpha", "energy_port_min"]].round(2)
      scheme  alpha  energy_port_min
    0      M   1.00             -0.0
    1   TMIG   0.34             -0.0
    """
    runs = runs_with(sessions, *SIGNALS, *ENERGIES)
    frame = pd.DataFrame([_measures(run) for run in runs])
    if any(run.metadata.synthetic for run in runs):
        frame.attrs["origin"] = "simulated operators"
    return frame


def runs_with(sessions: Session | Iterable[Session], *columns: str) -> list[Session]:
    """Return the runs, at least one and each with the columns."""
    runs = [sessions] if isinstance(sessions, Session) else list(sessions)
    if not runs:
        raise ValueError("sessions is empty: give at least one run of simulate_teleoperation")
    for number, run in enumerate(runs):
        of_class(f"sessions[{number}]", run, Session).require(*columns)
    return runs


def _measures(run: Session) -> dict[str, object]:
    """Return the measures of one run by column."""
    return {
        "participant": run.metadata.participant,
        "scheme": run.metadata.condition,
        "tracking_error": run["path_error"].mean(),
        "worst_error": run["path_error"].max(),
        "p_r": run["p_r"].mean(),
        "p_h": run["p_h"].mean(),
        "alpha": run["alpha"].mean(),
        "alpha_rate": np.abs(np.diff(run["alpha"])).mean() / run.sample_time,
        "beta": run["beta"].mean(),
        "hand_force": np.sqrt(sum(run[f"f_h_{axis}"] ** 2 for axis in "xyz")).mean(),
        "guidance_felt": np.sqrt(sum(run[f"guide_{axis}"] ** 2 for axis in "xyz")).mean(),
        "energy_operator": run["energy_operator"][-1],
        "energy_dissipated": run["energy_dissipated"][-1],
        "energy_target": run["energy_target"][-1],
        "energy_channel_min": run["energy_channel"].min(),
        "energy_robot_min": run["energy_robot"].min(),
        "energy_port_min": run["energy_port"].min(),
        "guarded": (run["port_share"] < 1.0).mean(),
        "port_share": run["port_share"].mean(),
    }
