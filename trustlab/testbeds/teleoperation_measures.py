"""
What a study takes from teleoperation runs: measures of error, effort, allocation and energy, and
figures (Figs. 3.13, 3.14, 3.22).
"""

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class
from trustlab.models.display import axes_or_new
from trustlab.sessions.session import Session

SIGNALS = ("path_error", "p_r", "p_h", "alpha", "beta", "port_share")
ENERGIES = (
    "energy_operator",
    "energy_dissipated",
    "energy_channel",
    "energy_robot",
    "energy_port",
    "energy_target",
    "energy_guidance",
)

# A share this close to 1 is 1 but for rounding: the passivity controller did not act.
ROUNDING = 1e-9

# What the figures show, each with its label.
PANELS = (
    ("performance", {"p_r": "robot $P_r$", "p_h": "operator $P_h$"}),
    ("trust", {"trust_hr": "human-to-robot $T_{hr}$", "trust_rh": "robot-to-human $T_{rh}$"}),
    ("scale", {"alpha": "share of the operator $α$", "beta": "force feedback $β$"}),
)
PORT_ENERGIES = {
    "energy_operator": "supplied by the operator",
    "energy_device": "stored in the device",
    "energy_dissipated": "dissipated in the device",
    "energy_channel": "taken by the channel",
    "energy_robot": "taken by the robot's port",
    "energy_guidance": "taken by the guidance",
    "energy_port": "taken by the operator's port",
    "energy_target": "given by the moving target",
}
BLUE, RED = "#0072b2", "#d55e00"


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
        "synthetic": run.metadata.synthetic,
        "tracking_error": run["path_error"].mean(),
        "worst_error": run["path_error"].max(),
        **{name: run[name].mean() for name in ("p_r", "p_h", "alpha")},
        "alpha_rate": np.abs(np.diff(run["alpha"])).mean() / run.sample_time,
        "beta": run["beta"].mean(),
        "hand_force": np.sqrt(sum(run[f"f_h_{axis}"] ** 2 for axis in "xyz")).mean(),
        "guidance_felt": np.sqrt(sum(run[f"guide_{axis}"] ** 2 for axis in "xyz")).mean(),
        **{
            f"energy_{name}": run[f"energy_{name}"][-1]
            for name in ("operator", "dissipated", "target", "guidance")
        },
        **{
            f"energy_{name}_min": run[f"energy_{name}"].min()
            for name in ("channel", "robot", "port")
        },
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
    needed = [f"{stem}_{axis}" for stem in ("reference", "robot") for axis in "xyz"]
    of_class("session", session, Session).require(*needed)
    axes = axes_or_new(axes, figsize=(5.6, 4.6), subplot_kw={"projection": "3d"})
    x, y, z = (session[f"reference_{axis}"] for axis in "xyz")
    axes.plot(x, y, z, ls="--", lw=1.3, color=RED, label="target, at the height wanted")
    x, y, z = (session[f"robot_{axis}"] for axis in "xyz")
    axes.plot(x, y, z, lw=1.0, color=BLUE, label="UAV")
    height = session["reference_z"][0]
    axes.set_zlim(min(z.min(), height - 0.5), max(z.max(), height + 0.5))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_title(session.label, fontsize="medium")
    axes.legend(
        fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=2, frameon=False
    )
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
    of_class("session", session, Session).require(
        *(name for _, columns in PANELS for name in columns)
    )
    axes = axes_or_new(axes, len(PANELS), title=session.label, sharex=True, figsize=(7.2, 5.6))
    for panel, (title, columns) in zip(axes, PANELS, strict=True):
        for (name, label), color, style in zip(
            columns.items(), (BLUE, RED), ("-", "--"), strict=True
        ):
            panel.plot(session.t, session[name], style, color=color, lw=1.2, label=label)
        panel.set(ylabel=title, ylim=(-0.05, 1.05))
        panel.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    axes[-1].set_xlabel("time [s]")
    return axes


def plot_energies(session: Session, axes=None):
    """
    Plot the energies of all ports over time: operator, device, channel, robot, target.

    Of channel, both ports and target the legend has the least energy. Energies that agree to 1 % of
    their panel's range are one line, with both names.

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
    of_class("session", session, Session).require(*PORT_ENERGIES)
    axes = axes_or_new(axes, columns=2, title=session.label, figsize=(8.6, 4.2))
    names = tuple(PORT_ENERGIES)
    for panel, part in ((axes[0], names[:3]), (axes[1], names[3:])):
        values = np.array([session[name] for name in part])
        labels = [PORT_ENERGIES[name] for name in part]
        if panel is axes[1]:
            least = values.min(axis=1)
            labels = [
                f"{label}, least {low:z.3f} J" for label, low in zip(labels, least, strict=True)
            ]
        apart = np.abs(values[:, None] - values[None]).max(axis=2)
        # the first energy that each lies on
        lies_on = np.argmax(apart <= 0.01 * np.ptp(values) + 1e-12, axis=1)
        for style, k in zip(("-", "--", ":", "-."), np.unique(lies_on), strict=False):
            shared = [labels[i] for i in np.flatnonzero(lies_on == k)]
            panel.plot(session.t, values[k], style, lw=1.6, label=",\n".join(shared))
        panel.axhline(0.0, color="0.6", lw=0.8, zorder=0)
        panel.set(xlabel="time [s]", ylabel="energy [J]")
        panel.legend(fontsize="small", frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.18))
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
    axes = np.atleast_1d(
        axes_or_new(axes, len(runs), sharex=True, figsize=(7.2, 1.2 + 1.5 * len(runs)))
    )
    if axes.size != len(runs):
        raise ValueError(f"there are {len(runs)} runs and {axes.size} axes; give one per run")
    for panel, run in zip(axes, runs, strict=True):
        panel.plot(run.t, run["alpha"], lw=1.0, color=BLUE)
        panel.set(ylabel="operator's\nshare $α$", ylim=(-0.05, 1.05))
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
        ax.errorbar(
            place, frame["mean"], half, fmt="os^v"[number % 4], mfc=face, capsize=4, label=name
        )
        ax.set_xticks(np.arange(len(frame)), frame.index)
    return ax
