"""
What a study takes from teleoperation runs: measures of error, effort, allocation and energy, and a
figure of the energies.
"""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from trustlab.models.checks import list_of, of_class
from trustlab.models.display import axes_or_new
from trustlab.sessions.session import Session

# A share this close to 1 is 1 but for rounding: the passivity controller did not act.
ROUNDING = 1e-9

# What each panel shows, with its label.
ENERGIES = (
    {
        "energy_operator": "supplied by the operator",
        "energy_target": "given by the moving target",
        "energy_device": "stored in the device",
        "energy_dissipated": "dissipated in the device",
    },
    {
        "energy_channel": "taken by the channel, least {:z.2g} J",
        "energy_robot": "taken by the robot's port, least {:z.2g} J",
        "energy_guidance": "taken by the guidance, least {:z.2g} J",
        "energy_port": "taken by the operator's port, least {:z.2g} J",
    },
)
# Each energy of a panel is drawn narrower than the one before, which shows on both sides of it.
WIDTHS = (6.0, 4.0, 2.5, 1.0)


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
    runs = [sessions] if isinstance(sessions, Session) else list_of("sessions", sessions)
    if not runs:
        raise ValueError("sessions is empty: give at least one run of simulate_teleoperation")
    rows = []
    for number, run in enumerate(runs):
        about = of_class(f"sessions[{number}]", run, Session).metadata
        names = {"participant": about.participant, "scheme": about.condition}
        rows.append({**names, "synthetic": about.synthetic, **measures_of(run)})
    frame = pd.DataFrame(rows)
    if any(run.metadata.synthetic for run in runs):
        frame.attrs["origin"] = "simulated operators"
    return frame


def measures_of(run: Session) -> dict[str, float]:
    """Return the measures of one run by column."""
    force, felt = (
        np.sqrt(sum(run[f"{name}_{axis}"] ** 2 for axis in "xyz")) for name in ("f_h", "guide")
    )
    last = [f"energy_{name}" for name in ("operator", "dissipated", "target", "guidance")]
    least = [f"energy_{name}" for name in ("channel", "robot", "port")]
    return {
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


def plot_energies(session: Session, axes=None):
    """
    Plot the energies of all ports over time: operator, device, channel, robot, target.

    Of channel, guidance and both ports the legend has the least energy.

    Parameters
    ----------
    session : Session
        A run of `simulate_teleoperation`.
    axes : sequence of two matplotlib.axes.Axes, optional
        Operator, target and device in the first, the others in the second; a new figure when not
        given.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (2,)

    Raises
    ------
    ValueError
        If `session` is not a Session, or lacks a column, or there are not two axes.
    """
    of_class("session", session, Session).require(*ENERGIES[0], *ENERGIES[1])
    axes = axes_or_new(axes, columns=2, title=session.label, figsize=(8.6, 4.2))
    for panel, names in zip(axes, ENERGIES, strict=True):
        for width, (name, label) in zip(WIDTHS, names.items(), strict=True):
            energy = session[name]
            label = label.format(energy.min().round(6)).replace("-", "−")
            panel.plot(session.t, energy, lw=width, label=label)
        panel.axhline(0.0, color="0.6", lw=0.8, zorder=0)
        panel.set(xlabel="time [s]", ylabel="energy [J]")
        # outside of the axes
        panel.legend(loc="upper left", bbox_to_anchor=(0.0, -0.18), fontsize="small", frameon=False)
    return axes
