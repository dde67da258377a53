"""Performance measured from logs: (2.4), (2.7), (3.26)-(3.27), UAVs; tracking error of trials."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    array_between,
    finite_array,
    mode_array,
    one_of,
    positive,
    shown,
    warn,
)
from trustlab.sessions.errors import SessionError
from trustlab.sessions.patterns import natural_key

# Commands below this are none [m/s, rad/s]: a stick at rest is not quite at zero.
IDLE = 1e-2


def window_mean(values: np.ndarray, sample_time: float, window: float) -> np.ndarray:
    """
    Return the mean over the window of length W that ends at each sample, (1/W) Σ z(i).

    Before a full window has passed, the mean is over the samples so far.

    Parameters
    ----------
    values : array_like, shape (N,)
        The measure z at every sample.
    sample_time : float
        Time between samples [s].
    window : float
        Length W of the window [s]; the nearest whole number of samples is used.

    Raises
    ------
    ValueError
        If the window is shorter than one sample or a value is not finite.
    """
    values = finite_array("values", values)
    samples = round(positive("window", window) / positive("sample_time", sample_time))
    if samples < 1:
        raise ValueError(f"window = {window} s is shorter than one sample ({sample_time} s)")
    return pd.Series(values).rolling(samples, min_periods=1).mean().to_numpy()


def nearness(distance: np.ndarray, largest: float) -> np.ndarray:
    """
    Return N(y) = (y_max − y)/y_max: 1 without deviation, 0 at y_max, negative beyond it.

    Parameters
    ----------
    distance : array_like, shape (N,)
        y, a deviation; not negative.
    largest : float
        y_max, in the unit of `distance`.

    Raises
    ------
    ValueError
        If `largest` is not positive or a distance is negative.
    """
    distance = array_between("distance", distance, 0.0, np.inf, "a deviation cannot be negative")
    return 1.0 - distance / positive("largest", largest)


def goal_speed(
    step_distance: np.ndarray, path_error: np.ndarray, sample_time: float, e_max: float = 2.0
) -> np.ndarray:
    """
    Return (Δd/Δt)(e_max − e)/e_max, what (2.4) averages: speed, less far from the path.

    Parameters
    ----------
    step_distance : array_like, shape (N,)
        Δd, distance travelled since the sample before [m].
    path_error : array_like, shape (N,)
        e, deviation from the path [m].
    sample_time : float
        Time between samples [s].
    e_max : float
        Greatest acceptable deviation [m].

    Returns
    -------
    numpy.ndarray, shape (N,)
        In m/s, the unit of the printed values (Remark 7).
    """
    near = nearness(path_error, e_max)
    step = finite_array("step_distance", step_distance, length=near.size)
    return step / positive("sample_time", sample_time) * near


def manoeuvring(
    v_command: np.ndarray, w_command: np.ndarray, path_error: np.ndarray, e_max: float = 2.0
) -> np.ndarray:
    """
    Return ``v (e_max − e)/e_max + |ω| e/e_max``, what (2.7) averages: forward motion counts near
    the path, turning away from it.

    Parameters
    ----------
    v_command, w_command : array_like, shape (N,)
        Linear [m/s] and angular [rad/s] velocity commands; the absolute value of ω counts, so that
        left and right turns do not cancel.
    path_error : array_like, shape (N,)
        e, deviation from the path [m].
    e_max : float
        Greatest acceptable deviation [m].
    """
    near = nearness(path_error, e_max)
    forward = finite_array("v_command", v_command, length=near.size)
    turning = np.abs(finite_array("w_command", w_command, length=near.size))
    return forward * near + turning * (1.0 - near)


def command_quality(u_h: np.ndarray, u_i: np.ndarray, u_max: float) -> np.ndarray:
    """
    Return 1 − ‖u_i − u_h‖₁/Δu_max, the quality of the operator's commands in Section 2.4.2.

    The text prints the deviation itself, Σ (u_i − u_h)/Δu_max, which grows as the operator gets
    worse.

    Parameters
    ----------
    u_h, u_i : array_like, shape (N, axes)
        The operator's and the ideal command.
    u_max : float
        Δu_max, the deviation that counts as 0, in the unit of the commands.
    """
    return nearness(_norm1(u_h, u_i), u_max)


def mixed_initiative(
    u_h: np.ndarray,
    u_a: np.ndarray,
    u_i: np.ndarray,
    error: np.ndarray,
    alpha: np.ndarray,
    u_max: float,
    e_max: float,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return p'_r and p'_h of (3.27), what (3.26) averages.

    p'_r = N(‖u_a − u_i‖₁) N((1 − α)‖e‖₁) and p'_h = N(‖u_h − u_i‖₁) N(α‖e‖₁), N(y) = (y_max −
    y)/y_max and 0 beyond y_max: the product of two negative ones would be good.

    Parameters
    ----------
    u_h, u_a, u_i : array_like, shape (N, axes)
        The operator's, the autonomous controller's and the ideal command.
    error : array_like, shape (N, axes)
        e, target minus robot [m].
    alpha : array_like, shape (N,)
        α, the manual share, in [0, 1].
    u_max, e_max : float
        y_max of a command's deviation (unit of the commands) and of the tracking error [m].
    """
    off = np.abs(np.asarray(error, dtype=float)).sum(axis=1)
    alpha = finite_array("alpha", mode_array(alpha), length=off.size)

    def product(deviation: np.ndarray, error: np.ndarray) -> np.ndarray:
        near = nearness(deviation, u_max), nearness(error, e_max)
        return np.prod(np.maximum(near, 0.0), axis=0)

    return product(_norm1(u_a, u_i), (1.0 - alpha) * off), product(_norm1(u_h, u_i), alpha * off)


def _norm1(command: np.ndarray, ideal: np.ndarray) -> np.ndarray:
    command, ideal = np.asarray(command, dtype=float), np.asarray(ideal, dtype=float)
    if command.ndim != 2 or command.shape != ideal.shape:
        raise ValueError(
            f"commands must both have shape (N, axes), got {command.shape} and {ideal.shape}"
        )
    return np.abs(command - ideal).sum(axis=1)


def with_performance(
    session,
    window: float = 100.0,
    measure: str = "ground_robot",
    e_max: float | None = None,
    u_max: float | None = None,
    axes: str = "xyz",
):
    """
    Return a session with measured performance, columns p_r and p_h, as window means.

    Parameters
    ----------
    session : Session
        Needs step_distance, path_error, v_command and w_command ("ground_robot"); path_error, u_h
        and u_i ("uav_tracking"); u_h, u_a, u_i, reference, robot and, as α, alpha or else mode
        ("mixed_initiative").
    window : float
        Length W [s]; 100 s in Chapter 2, 10 s in Chapter 3.
    measure : {"ground_robot", "uav_tracking", "mixed_initiative"}
        (2.4) and (2.7); Section 2.4.2; (3.26)-(3.27).
    e_max : float, optional
        Greatest acceptable deviation [m]; 2 m for "ground_robot", required for the others.
    u_max : float, optional
        Greatest deviation of a command, in the unit of the commands; required for all but
        "ground_robot".
    axes : str
        Axes of the commands and positions that count, each once, for example "yz".

    Raises
    ------
    SessionError
        If a column is missing.
    ValueError
        If the measure or axes are unknown, or a scale is missing or not positive.
    """

    def vector(stem: str) -> np.ndarray:
        names = [f"{stem}_{axis}" for axis in axes]
        session.require(*names)
        return session.data[names].to_numpy()

    if not axes or sorted(axes) != sorted({*axes} & {*"xyz"}):
        raise ValueError(f"axes must be some of 'xyz', each once, got {shown(axes)}")
    one_of("measure", measure, ("ground_robot", "uav_tracking", "mixed_initiative"))
    for name, largest in {"e_max": e_max, "u_max": u_max}.items():
        if largest is not None:
            positive(name, largest)
    if measure == "ground_robot":
        if u_max is not None or axes != "xyz":
            raise ValueError("u_max and axes are not used by (2.4) and (2.7); leave them out")
        e_max = 2.0 if e_max is None else e_max
        names = ("step_distance", "path_error", "v_command", "w_command")
        session.require(*names)
        step_distance, path_error, v_command, w_command = (session[name] for name in names)
        p_r = goal_speed(step_distance, path_error, session.sample_time, e_max)
        p_h = manoeuvring(v_command, w_command, path_error, e_max)
        _warn_of_idle_commands(session)
        equations = "(2.4), (2.7)"
    elif e_max is None or u_max is None:
        raise ValueError(f"measure {measure!r} needs e_max [m] and u_max (unit of the commands)")
    elif measure == "uav_tracking":
        p_h = command_quality(vector("u_h"), vector("u_i"), u_max)
        p_r = nearness(session["path_error"], e_max)
        equations = "Section 2.4.2.4"
    else:
        u_h, u_a, u_i = (vector(stem) for stem in ("u_h", "u_a", "u_i"))
        apart = vector("reference") - vector("robot")
        share = session["alpha" if "alpha" in session else "mode"]
        p_r, p_h = mixed_initiative(u_h, u_a, u_i, apart, share, u_max, e_max)
        equations = "(3.26), (3.27)"
    step = session.sample_time
    p_r, p_h = (window_mean(values, step, window) for values in (p_r, p_h))
    window = round(round(window / step) * step, 9)  # as averaged
    if window > session.duration:
        warn(
            f"{session.label} lasts {session.duration:g} s, less than the window of {window:g} s: "
            "every value is the mean of what there was so far"
        )
    note = f"{equations}, window {window:g} s"
    # The new means begin where the session does, also where older ones had been cut.
    more = {**session.metadata.more, "performance": note, "performance_window": window}
    more.pop("performance_cut", None)
    measured = session.with_columns(p_r=p_r, p_h=p_h)
    return replace(measured, metadata=replace(session.metadata, more=more))


def _warn_of_idle_commands(session) -> None:
    """Warn where nothing was commanded while the robot drove: P_h would follow the mode."""
    if "mode" not in session:
        return
    idle = (session.data[["v_command", "w_command"]].abs() < IDLE).all(axis=1)
    autonomous = session.data["mode"] < 0.5
    # Of no samples the mean is NaN, which is neither above nor below.
    if idle[autonomous].mean() > 0.5 and not idle[~autonomous].mean() >= 0.5:
        warn(
            f"{session.label}: the operator's commands are zero in "
            f"{100 * idle[autonomous].mean():.0f} % of the autonomous phases. (2.7) asks for what "
            "the operator commands while the robot drives; without it P_h only repeats the mode, "
            "and a fit says β → 1. Log the stick throughout and ask operators to go on steering, "
            "or fit the robot alone, driven by the measured P_h (trustlab.identification.ROBOT)"
        )


def tracking_error(sessions: Iterable, drop_first: int = 1) -> pd.DataFrame:
    """
    Return the mean tracking error of every participant at every level of autonomy.

    It is the mean over a block's trials of the trial's mean `path_error`, without training and
    without the first `drop_first` trials of each block.

    Parameters
    ----------
    sessions : iterable of Session
        Trials with column path_error [m] and metadata participant, autonomy, block, trial and
        training.
    drop_first : int
        How many trials at the beginning of each block do not count.

    Returns
    -------
    pandas.DataFrame
        Columns participant, autonomy, traj_err [cm]; one row per participant and level, sorted.

    Raises
    ------
    SessionError
        If a trial lacks path_error or one of the metadata, or a participant has no trial left at a
        level.
    """
    # A session alone is iterable too, over the names of its columns.
    sessions = [sessions] if hasattr(sessions, "metadata") else sessions
    rows = sorted(map(_trial, sessions), key=lambda row: natural_key(row["trial"]))
    trials = pd.DataFrame([row for row in rows if not row["training"]])
    if trials.empty:
        raise SessionError("no trial to average: all are training, or none was given")
    twice = trials[trials.duplicated(["participant", "trial"])]
    if len(twice):
        raise SessionError(
            "trial {trial} of participant {participant} occurs twice".format(**twice.iloc[0])
        )
    order = trials.groupby(["participant", "block"]).cumcount()
    trials["traj_err"] = trials["traj_err"].where(order >= drop_first)
    table = trials.groupby(["participant", "autonomy"], as_index=False)[["traj_err"]].mean()
    for lost in table[table["traj_err"].isna()].itertuples():
        raise SessionError(
            f"participant {lost.participant}, autonomy {lost.autonomy}: no trial is left after "
            f"dropping the first {drop_first}"
        )
    return table


def _trial(session) -> dict[str, object]:
    """Return what the tracking error of a trial [cm] is grouped by, and the error."""
    session.require("path_error")
    facts = session.metadata.as_dict()
    names = ("participant", "autonomy", "block", "trial", "training")
    for name in names:
        if facts.get(name) is None:
            raise SessionError(f"metadata {name!r} is missing", session.metadata.source)
    if facts["training"] not in (0, 1):
        raise SessionError(
            f"metadata 'training' must be true or false, got {shown(facts['training'])}; give the "
            "recipe a map",
            session.metadata.source,
        )
    return {name: facts[name] for name in names} | {
        "traj_err": 100.0 * session["path_error"].mean()
    }
