"""A session to look at."""

from __future__ import annotations

import numpy as np

from trustlab.sessions.vocabulary import VOCABULARY

__all__ = ["plot_session", "shade_manual"]


def shade_manual(axes, t: np.ndarray, mode: np.ndarray) -> None:
    """
    Shade the manual phases of one panel.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        The panel.
    t : numpy.ndarray, shape (N,)
        Time [s].
    mode : numpy.ndarray, shape (N,)
        Manual share; shaded in proportion where it is constant, above one half otherwise.
    """
    edges = np.flatnonzero(np.diff(mode)) + 1
    if edges.size > 200:
        axes.fill_between(
            t, 0, 1, where=mode >= 0.5, transform=axes.get_xaxis_transform(), color="0.5", alpha=0.15, lw=0
        )
        return
    for start, stop in zip(np.r_[0, edges], np.r_[edges, mode.size - 1], strict=True):
        if mode[start] > 0:
            axes.axvspan(t[start], t[stop], color="0.5", alpha=0.2 * mode[start], lw=0)


def plot_session(session, columns: str | list[str] | None = None):
    """
    Plot columns of a session against time, one panel each.

    Parameters
    ----------
    session : Session
        What to plot.
    columns : str or list of str, optional
        Which columns; p_r, p_h and r where there, else all, when not given.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes
    """
    import matplotlib.pyplot as plt

    if isinstance(columns, str):
        columns = [columns]
    if columns is None:
        columns = [name for name in ("p_r", "p_h", "r") if name in session] or session.columns
    session.require(*columns)
    figure, axes = plt.subplots(
        len(columns),
        1,
        sharex=True,
        squeeze=False,
        figsize=(8, 1.2 + 1.5 * len(columns)),
        layout="constrained",
    )
    for panel, name in zip(axes[:, 0], columns, strict=True):
        panel.plot(session.t, session[name], lw=1)
        unit = "s" if name == "t" else VOCABULARY[name].unit
        panel.set_ylabel(name if unit in ("1", "measure") else f"{name} [{unit}]")
        if "mode" in session and name != "mode":
            shade_manual(panel, session.t, session["mode"])
    axes[-1, 0].set_xlabel("time [s]")
    figure.suptitle(
        session.label + (" (manual phases shaded)" if "mode" in session else ""), fontsize="medium"
    )
    return axes[:, 0]
