"""Sessions, and measures of many sessions, to look at."""

from collections.abc import Sequence

import numpy as np

from trustlab.models.checks import shown
from trustlab.models.display import axes_or_new
from trustlab.sessions.errors import SessionError
from trustlab.sessions.vocabulary import VOCABULARY

# Columns in words, for axes.
LABELS = {
    "p_r": "robot\nperformance",
    "p_h": "human\nperformance",
    "r": "utilization",
    "tsc": "TSC",
    "trust_hr": "trust\nin the robot",
    "trust_rh": "trust in\nthe operator",
    "alpha": "share α",
    "beta": "scale β",
}


def shade_manual(axes, t: np.ndarray, mode: np.ndarray) -> None:
    """Shade the manual phases, in proportion to the manual share."""
    starts = np.flatnonzero(np.diff(mode, prepend=np.nan))
    spans = np.column_stack([t[starts], np.diff(t[starts], append=t[-1])])
    shades = [("0.5", 0.2 * share) for share in mode[starts]]
    whole = axes.get_xaxis_transform()
    axes.broken_barh(spans, (0, 1), transform=whole, facecolors=shades, lw=0)


def plot_session(session, columns: str | list[str] | None = None):
    """Plot columns against time, one panel each; by default p_r, p_h and r, or all."""
    if isinstance(columns, str):
        columns = [columns]
    if columns is None:
        columns = [name for name in ("p_r", "p_h", "r") if name in session] or session.columns
    if not isinstance(columns, list | tuple) or not columns:
        raise SessionError(f"columns must be a list of names, got {shown(columns)}")
    session.require(*columns)
    shaded = "mode" in session
    title = session.label + " (manual phases shaded)" * shaded
    size = (8, 1.2 + 1.5 * len(columns))
    axes = axes_or_new(None, len(columns), title=title, sharex=True, squeeze=False, figsize=size)
    for panel, name in zip(axes[:, 0], columns, strict=True):
        panel.plot(session.t, session[name], lw=1)
        unit = "s" if name == "t" else VOCABULARY[name].unit
        panel.set_ylabel(LABELS.get(name, name) + f" [{unit}]" * (unit not in ("1", "measure")))
        if shaded and name != "mode":
            shade_manual(panel, session.t, session["mode"])
    axes[-1, 0].set_xlabel("time [s]")
    return axes[:, 0]


def plot_paths(sessions: Sequence, plane: str = "xy", titles: Sequence[str] | None = None):
    """
    Plot the paths of operator, robot and reference, one panel per session.

    Parameters
    ----------
    sessions : sequence of Session
        With positions human, robot and reference in the plane [m].
    plane : str
        The two axes to plot, for example "yz".
    titles : sequence of str, optional
        The panels' titles; the sessions' labels when not given. That data are synthetic is said in
        any case.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes
    """
    across, up = plane[0], plane[1]
    size = (min(2.4 * len(sessions), 10.0), 2.8)
    axes = axes_or_new(columns=len(sessions), sharex=True, sharey=True, squeeze=False, figsize=size)
    titles = [session.label for session in sessions] if titles is None else titles
    for axis, session, title in zip(axes[0], sessions, titles, strict=True):
        for stem, label, style in (
            ("human", "operator", {"lw": 0.8, "color": "C1"}),
            ("robot", "robot", {"lw": 1.4, "color": "C0"}),
            ("reference", "reference", {"lw": 1.2, "color": "k", "ls": ":"}),
        ):
            axis.plot(session[f"{stem}_{across}"], session[f"{stem}_{up}"], label=label, **style)
        axis.set(title=title, xlabel=f"{across} [m]")
    axes[0, 0].set_ylabel(f"{up} [m]")
    axes[0, 0].legend(fontsize="small")
    if any(session.metadata.synthetic for session in sessions):
        axes[0, 0].figure.suptitle("synthetic data", fontsize="small")
    return axes[0]


def plot_by_participant(table, value: str, by: str = "autonomy", axis=None):
    """
    Plot a measure against a factor: a grey line per participant, and their mean.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns participant, `by` and `value`; rows of the same participant and level are averaged.
    value : str
        The column of the measure.
    by : str
        The column of the factor.
    axis : matplotlib.axes.Axes, optional
        Where to draw; a new figure when not given.

    Returns
    -------
    matplotlib.axes.Axes
    """
    wide = table.pivot_table(index="participant", columns=by, values=value)
    axis = axes_or_new(axis, figsize=(6, 3.4))
    axis.plot(wide.columns, wide.T, "o-", lw=0.8, ms=3, color="0.7")
    mean = f"mean of {len(wide)} participants"
    axis.plot(wide.columns, wide.mean(), "o-", lw=2.2, color="C0", label=mean)
    axis.set(xlabel=by, ylabel=value)
    return axis
