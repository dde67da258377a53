"""Figures of a teleoperation run: trajectories (Fig. 3.13), signals (Fig. 3.14), energies of all ports, shares (Fig. 3.22)."""

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from trustlab.models.axes import axes_or_new
from trustlab.models.checks import of_class
from trustlab.sessions.session import Session
from trustlab.testbeds.teleoperation_measures import runs_with

SIGNALS = (
    ("performance", {"p_r": "robot $P_r$", "p_h": "operator $P_h$"}),
    ("trust", {"trust_hr": "human-to-robot $T_{hr}$", "trust_rh": "robot-to-human $T_{rh}$"}),
    ("scale", {"alpha": "share of the operator $α$", "beta": "force feedback $β$"}),
)
ENERGIES = {
    "energy_operator": "supplied by the operator",
    "energy_device": "stored in the device",
    "energy_dissipated": "dissipated in the device",
    "energy_channel": "taken by the channel",
    "energy_robot": "taken by the robot's port",
    "energy_port": "taken by the operator's port",
    "energy_target": "given by the moving target",
}
BLUE, RED = "#0072b2", "#d55e00"


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
    of_class("session", session, Session).require(
        *(f"{stem}_{axis}" for stem in ("reference", "robot") for axis in "xyz")
    )
    axes = axes_or_new(axes, figsize=(5.6, 4.6), subplot_kw={"projection": "3d"})
    x, y, z = (session[f"reference_{axis}"] for axis in "xyz")
    axes.plot(x, y, z, ls="--", lw=1.3, color=RED, label="target, at the height wanted")
    x, y, z = (session[f"robot_{axis}"] for axis in "xyz")
    axes.plot(x, y, z, lw=1.0, color=BLUE, label="UAV")
    wanted = session["reference_z"][0]
    low, high = min(z.min(), wanted), max(z.max(), wanted)
    axes.set_zlim(min(low, wanted - 0.5), max(high, wanted + 0.5))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_title(session.label, fontsize="medium")
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=2, frameon=False)
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
    of_class("session", session, Session).require(*(name for _, columns in SIGNALS for name in columns))
    axes = axes_or_new(axes, len(SIGNALS), title=session.label, sharex=True, figsize=(7.2, 5.6))
    for panel, (title, columns) in zip(axes, SIGNALS, strict=True):
        for (name, label), color, style in zip(columns.items(), (BLUE, RED), ("-", "--"), strict=True):
            panel.plot(session.t, session[name], style, color=color, lw=1.2, label=label)
        panel.set(ylabel=title, ylim=(-0.05, 1.05))
        panel.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    axes[-1].set_xlabel("time [s]")
    return axes


def plot_energies(session: Session, axes=None):
    """
    Plot the energies of all ports over time: operator, device, channel, robot, target.

    Parameters
    ----------
    session : Session
        A run of `simulate_teleoperation`.
    axes : sequence of two matplotlib.axes.Axes, optional
        Operator and device in the first, channel, both ports and target in the second; a new figure when not given.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (2,)

    Raises
    ------
    ValueError
        If `session` is not a Session, or lacks a column.
    """
    of_class("session", session, Session).require(*ENERGIES)
    axes = axes_or_new(axes, columns=2, title=session.label, figsize=(8.6, 3.4))
    names = tuple(ENERGIES)
    for panel, part in ((axes[0], names[:3]), (axes[1], names[3:])):
        for name, style in zip(part, ("-", "--", ":", "-."), strict=False):
            panel.plot(session.t, session[name], style, lw=1.4, label=ENERGIES[name])
        panel.axhline(0.0, color="0.6", lw=0.8)
        panel.set(xlabel="time [s]", ylabel="energy [J]")
        panel.legend(fontsize="small", frameon=False)
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
    runs = runs_with(sessions, "alpha")
    axes = np.atleast_1d(axes_or_new(axes, len(runs), sharex=True, figsize=(7.2, 1.2 + 1.5 * len(runs))))
    if axes.size != len(runs):
        raise ValueError(f"there are {len(runs)} runs and {axes.size} axes; give one per run")
    for panel, run in zip(axes, runs, strict=True):
        panel.plot(run.t, run["alpha"], lw=1.0, color=BLUE)
        panel.set(ylabel="$α$", ylim=(-0.05, 1.05))
        panel.set_title(run.label, fontsize="medium")
    axes[-1].set_xlabel("time [s]")
    return axes


def plot_beside(series: Mapping[str, pd.DataFrame], ax=None):
    """
    Plot means with intervals by condition, several series beside each other.

    Parameters
    ----------
    series : mapping of str to pandas.DataFrame
        By name: index of conditions; columns mean, ci_low, ci_high.
    ax : matplotlib.axes.Axes, optional
        Where; a new figure when not given.

    Returns
    -------
    matplotlib.axes.Axes
    """
    ax = axes_or_new(ax)
    for number, (name, frame) in enumerate(series.items()):
        place = np.arange(len(frame)) + 0.24 * (number - 0.5 * (len(series) - 1))
        half = [frame["mean"] - frame["ci_low"], frame["ci_high"] - frame["mean"]]
        face = "white" if number else None
        ax.errorbar(place, frame["mean"], half, fmt="os^v"[number % 4], mfc=face, capsize=4, label=name)
        ax.set_xticks(np.arange(len(frame)), frame.index)
    return ax
