"""
What a study takes from teleoperation runs: measures of error, effort, allocation and energy, and
figures (Figs. 3.13, 3.14, 3.22).
"""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class
from trustlab.models.display import axes_or_new
from trustlab.sessions.session import Session

# A share this close to 1 is 1 but for rounding: the passivity controller did not act.
ROUNDING = 1e-9

# What the figures show, panel by panel, each with its label.
SIGNALS = {
    "performance": {"p_r": "robot $P_r$", "p_h": "operator $P_h$"},
    "trust": {"trust_hr": "human-to-robot $T_{hr}$", "trust_rh": "robot-to-human $T_{rh}$"},
    "scale": {"alpha": "share of the operator $α$", "beta": "force feedback $β$"},
}
ENERGIES = (
    {
        "energy_operator": "supplied by the operator",
        "energy_device": "stored in the device",
        "energy_dissipated": "dissipated in the device",
    },
    {
        "energy_channel": "taken by the channel, least {:z.3f} J",
        "energy_robot": "taken by the robot's port, least {:z.3f} J",
        "energy_guidance": "taken by the guidance, least {:z.3f} J",
        "energy_port": "taken by the operator's port, least {:z.3f} J",
        "energy_target": "given by the moving target, least {:z.3f} J",
    },
)
# Each energy of a panel is drawn narrower than the one before, which shows on both sides of it.
WIDTHS = (6.0, 4.5, 3.0, 2.0, 1.0)
# Legends stand outside of the axes.
OUTSIDE = {"fontsize": "small", "frameon": False}


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
        participant, scheme, synthetic; tracking_error, worst_error (mean and greatest distance to
        the target [m]); p_r, p_h, alpha, beta (means); alpha_rate (mean ``|dα/dt|`` [1/s]);
        hand_force (mean ‖f_h‖ [N]); guidance_felt (mean ‖f_m − β b r_m‖, what the device renders
        beyond the channel's own damping [N]); energy_operator, energy_dissipated, energy_target,
        energy_guidance (at the end [J]); energy_channel_min, energy_robot_min, energy_port_min
        (least values [J]); guarded (share of samples in which the passivity controller acted, by
        more than rounding);
        port_share (mean share of the port's velocity that it let pass, 1 where it rests).

    Raises
    ------
    ValueError
        If there is no run, or an item is not a Session.
    SessionError
        If a run lacks a column.

    Examples
    --------
    >>> import trustlab as tl
    >>> schemes = ("M", "TMIG")
    >>> runs = [tl.simulate_teleoperation(scheme, seed=0, duration=10.0) for scheme in schemes]
    >>> tl.teleoperation_measures(runs)[["scheme", "alpha", "energy_port_min"]].round(2)
      scheme  alpha  energy_port_min
    0      M   1.00             -0.0
    1   TMIG   0.34             -0.0
    """
    runs = _runs(sessions)
    frame = pd.DataFrame([_measures(run) for run in runs])
    if any(run.metadata.synthetic for run in runs):
        frame.attrs["origin"] = "simulated operators"
    return frame


def _runs(sessions: Session | Iterable[Session]) -> list[Session]:
    """Return the runs, at least one."""
    runs = [sessions] if isinstance(sessions, Session) else list(sessions)
    if not runs:
        raise ValueError("sessions is empty: give at least one run of simulate_teleoperation")
    return [of_class(f"sessions[{number}]", run, Session) for number, run in enumerate(runs)]


def _measures(run: Session) -> dict[str, object]:
    """Return the measures of one run by column."""
    force, felt = (
        np.sqrt(sum(run[f"{name}_{axis}"] ** 2 for axis in "xyz")) for name in ("f_h", "guide")
    )
    last = [f"energy_{name}" for name in ("operator", "dissipated", "target", "guidance")]
    least = [f"energy_{name}" for name in ("channel", "robot", "port")]
    return {
        "participant": run.metadata.participant,
        "scheme": run.metadata.condition,
        "synthetic": run.metadata.synthetic,
        "tracking_error": run["path_error"].mean(),
        "worst_error": run["path_error"].max(),
        **{name: run[name].mean() for name in ("p_r", "p_h", "alpha")},
        "alpha_rate": np.abs(np.diff(run["alpha"])).mean() / run.sample_time,
        "beta": run["beta"].mean(),
        "hand_force": force.mean(),
        "guidance_felt": felt.mean(),
        **{name: run[name][-1] for name in last},
        **{f"{name}_min": run[name].min() for name in least},
        "guarded": (run["port_share"] < 1.0 - ROUNDING).mean(),
        "port_share": run["port_share"].mean(),
    }


def plot_trajectory(session: Session, axes=None):
    """
    Plot where the UAV should be and where it was, in three dimensions, as Fig. 3.13.

    Parameters
    ----------
    session : Session
        A run of `simulate_teleoperation`.
    axes : mpl_toolkits.mplot3d.Axes3D, optional
        Where to plot; a new figure when not given.

    Returns
    -------
    mpl_toolkits.mplot3d.Axes3D

    Raises
    ------
    ValueError
        If `session` is not a Session, or lacks a column.
    """
    of_class("session", session, Session)
    target, robot = (
        [session[f"{name}_{axis}"] for axis in "xyz"] for name in ("reference", "robot")
    )
    axes = axes_or_new(axes, figsize=(5.6, 4.6), subplot_kw={"projection": "3d"})
    axes.plot(*target, ls="--", label="target, at the height wanted")
    axes.plot(*robot, lw=1.0, label="UAV")
    height, z = target[2][0], robot[2]
    axes.set_zlim(min(z.min(), height - 0.5), max(z.max(), height + 0.5))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_title(session.label, fontsize="medium")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=2, **OUTSIDE)
    return axes


def plot_signals(session: Session, axes=None):
    """
    Plot performance, trust and scales over time, as Fig. 3.14.

    Parameters
    ----------
    session : Session
        A run of `simulate_teleoperation`.
    axes : sequence of three matplotlib.axes.Axes, optional
        Where to plot; a new figure when not given.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (3,)

    Raises
    ------
    ValueError
        If `session` is not a Session, or lacks a column.
    """
    of_class("session", session, Session).require(*(n for names in SIGNALS.values() for n in names))
    axes = axes_or_new(axes, len(SIGNALS), title=session.label, sharex=True, figsize=(7.2, 5.6))
    for panel, (title, labels) in zip(axes, SIGNALS.items(), strict=True):
        for style, (name, label) in zip(("-", "--"), labels.items(), strict=True):
            panel.plot(session.t, session[name], style, lw=1.2, label=label)
        panel.set(ylabel=title, ylim=(-0.05, 1.05))
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **OUTSIDE)
    axes[-1].set_xlabel("time [s]")
    return axes


def plot_energies(session: Session, axes=None):
    """
    Plot the energies of all ports over time: operator, device, channel, robot, target.

    Of channel, both ports and target the legend has the least energy.

    Parameters
    ----------
    session : Session
        A run of `simulate_teleoperation`.
    axes : sequence of two matplotlib.axes.Axes, optional
        Operator and device in the first, channel, both ports and target in the second; a new figure
        when not given.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (2,)

    Raises
    ------
    ValueError
        If `session` is not a Session, or lacks a column.
    """
    of_class("session", session, Session).require(*ENERGIES[0], *ENERGIES[1])
    axes = axes_or_new(axes, columns=2, title=session.label, figsize=(8.6, 4.2))
    for panel, names in zip(axes, ENERGIES, strict=True):
        for width, (name, label) in zip(WIDTHS, names.items(), strict=False):
            energy = session[name]
            panel.plot(session.t, energy, lw=width, label=label.format(energy.min()))
        panel.axhline(0.0, color="0.6", lw=0.8, zorder=0)
        panel.set(xlabel="time [s]", ylabel="energy [J]")
        panel.legend(loc="upper left", bbox_to_anchor=(0.0, -0.18), **OUTSIDE)
    return axes


def plot_alpha(sessions: Iterable[Session], axes=None):
    """
    Plot the operator's share α of several runs, one panel each, as Fig. 3.22.

    Parameters
    ----------
    sessions : iterable of Session
        Runs of `simulate_teleoperation`.
    axes : sequence of matplotlib.axes.Axes, optional
        Where to plot, one per run; a new figure when not given.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (number of runs,)

    Raises
    ------
    ValueError
        If there is no run, an item is not a Session, or the number of axes differs.
    """
    runs = _runs(sessions)
    size = (7.2, 1.2 + 1.5 * len(runs))
    axes = np.atleast_1d(axes_or_new(axes, len(runs), sharex=True, figsize=size))
    for panel, run in zip(axes, runs, strict=True):
        panel.plot(run.t, run["alpha"], lw=1.0)
        panel.set(ylabel="operator's\nshare $α$", ylim=(-0.05, 1.05))
        panel.set_title(run.label, fontsize="medium")
    axes[-1].set_xlabel("time [s]")
    return axes
