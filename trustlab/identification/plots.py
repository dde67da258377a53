"""Measured beside fitted, and what is left over."""

from __future__ import annotations

import numpy as np

from trustlab.sessions.plots import shade_manual

__all__ = ["plot_fit", "plot_residuals"]

LABELS = {"p_r": "robot performance $P_r$", "p_h": "human performance $P_h$"}


def plot_fit(fit, most: int = 6):
    """
    Plot measured and fitted outputs against time, one column of panels per run.

    Parameters
    ----------
    fit : FitResult
        What to plot.
    most : int
        Most runs to show.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (outputs, runs shown)
    """
    import matplotlib.pyplot as plt

    shown = fit.runs[: max(1, most)]
    size = (max(6.5, 3.0 * len(shown)), 0.8 + 2.4 * len(fit.outputs))
    figure, axes = plt.subplots(
        len(fit.outputs),
        len(shown),
        squeeze=False,
        sharey="row",
        sharex="col",
        figsize=size,
        layout="constrained",
    )
    for row, name in zip(axes, fit.outputs, strict=True):
        row[0].set_ylabel(LABELS.get(name, name))
        for panel, run in zip(row, shown, strict=True):
            panel.plot(run.t, run.measured[name], lw=0.8, color="0.55", label="measured")
            panel.plot(run.t, run.fitted[name], lw=1.6, ls="--", color="C1", label="fitted")
            shade_manual(panel, run.t, run.mode)
    for panel, run in zip(axes[0], shown, strict=True):
        panel.set_title(run.label, fontsize="small")
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    axes[0, 0].legend(fontsize="small", loc="best")
    notes = [
        f"{len(shown)} of {len(fit.runs)} runs" if len(shown) < len(fit.runs) else "",
        "manual phases shaded",
    ]
    figure.suptitle(", ".join(note for note in notes if note), fontsize="small")
    return axes


def plot_residuals(fit, lags: int = 25):
    """
    Plot auto- and cross-correlation of the residuals with their 99 % bands.

    Parameters
    ----------
    fit : FitResult
        What to plot.
    lags : int
        Largest lag [samples].

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (outputs, 2)
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        len(fit.outputs), 2, squeeze=False, figsize=(8, 0.6 + 2.2 * len(fit.outputs)), layout="constrained"
    )
    for row, name in zip(axes, fit.outputs, strict=True):
        frame = fit.residual_correlations(lags, name)
        pairs = [("autocorrelation", frame[frame.index > 0]), ("cross_correlation", frame)]
        for panel, (column, part) in zip(row, pairs, strict=True):
            panel.axhspan(
                -part["band"].iloc[0], part["band"].iloc[0], color="C0", alpha=0.15, lw=0, label="99 % band"
            )
            panel.vlines(part.index, 0.0, part[column], lw=1.2)
            panel.plot(part.index, part[column], "o", ms=3)
            panel.axhline(0.0, color="0.4", lw=0.6)
            panel.set_xlabel("lag [samples]")
        row[0].set_ylabel(f"{name} residual")
        row[0].set_title("autocorrelation", fontsize="small")
        row[1].set_title("with mode", fontsize="small")
    axes[0, 0].legend(fontsize="small")
    figure.suptitle("residual correlations" + (", synthetic data" if fit.synthetic else ""), fontsize="small")
    return np.asarray(axes)
