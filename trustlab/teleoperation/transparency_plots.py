"""Figures of transparency: scales by trust (Figs. 3.2, 3.3), gains and leaks of the channel, what a spring feels like (Section 3.7)."""

from collections.abc import Iterable, Mapping

import numpy as np

from trustlab.models.axes import axes_or_new
from trustlab.models.trust import LogisticScaling, StepScaling
from trustlab.teleoperation.loop.settings import STUDIES, LoopSettings
from trustlab.teleoperation.ports.waves import Scattering
from trustlab.teleoperation.transparency import Tuning, gains, rendered_impedance

MAPS = {
    "felt force, $f_m/(β f_s)$, hand still": ("force", "ranges"),
    "robot's velocity, $r_s/(α r_m)$, no force": ("velocity", "ranges"),
    "drag felt, $f_m/(β r_m)$ [N s/m]": ("drag", "b"),
    "drift, $-r_s/(α f_s)$ [m/s/N]": ("drift", "b"),
}


def plot_scales(settings: LoopSettings, ax=None):
    """
    Plot the scales α and β over trust, as Figs. 3.2 and 3.3.

    Parameters
    ----------
    settings : LoopSettings
        Settings whose bounds are shown.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    matplotlib.axes.Axes
    """
    ax = axes_or_new(ax)
    trust, ends = np.linspace(0.0, 1.0, 401), settings.scattering
    scales = {"α": (ends.alpha_min, ends.alpha_max), "β": (ends.beta_min, ends.beta_max)}
    for (symbol, bounds), color in zip(scales.items(), ("C0", "C1"), strict=True):
        ax.plot(trust, LogisticScaling(*bounds).value(trust), color=color, label=f"{symbol}, logistic (3.5)")
        steep = LogisticScaling(*bounds, steepness=40.0).value(trust)
        ax.plot(trust, steep, color=color, lw=0.8, label=f"{symbol}, four times as steep")
        ax.plot(trust, StepScaling(*bounds).value(trust), ":", color=color, label=f"{symbol}, step (3.6)")
    ax.set(xlabel="trust, share of its range", ylabel="scale", title=f"{settings.study} study")
    return ax


def plot_transparency(settings: Mapping[str, LoopSettings] = STUDIES, points: int = 60):
    """
    Plot gains and leaks of the channel over the ranges of its scales and over b, α and β being one.

    Parameters
    ----------
    settings : mapping of str to LoopSettings
        Settings to mark, by label.
    points : int
        Number of points along each axis.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (2, 2)
    """
    axes = axes_or_new(None, 2, 2, figsize=(9.2, 7.0))
    low, impedance = np.geomspace(0.02, 1.0, points), np.geomspace(0.2, 10.0, points)
    for ax, (title, (key, over)) in zip(axes.flat, MAPS.items(), strict=True):
        across = low if over == "ranges" else impedance
        ends = [[(1.0, y, x) if over == "ranges" else (x, y, y) for x in across] for y in low]
        grid = np.array([[gains(Scattering(b, one, 1.0, two, 1.0))[key] for b, one, two in row] for row in ends])
        shown = grid if over == "ranges" else np.log10(grid + 1e-12).clip(-2)
        bar = ax.figure.colorbar(ax.contourf(across, low, shown, 12), ax=ax)
        ax.set(xscale="log", yscale="log", title=title)
        ax.set_xlabel("$\\underline{β}/\\overline{β}$" if over == "ranges" else "b [N s/m]")
        ax.set_ylabel("$\\underline{α}/\\overline{α}$" if over == "ranges" else "both ratios of bounds")
        bar.set_label("gain, ideally 1" if over == "ranges" else "log$_{10}$, ideally −∞")
        for (name, one), mark in zip(settings.items(), "os^v", strict=False):
            own = one.scattering
            alpha, beta = own.alpha_min / own.alpha_max, own.beta_min / own.beta_max
            place = (beta, alpha) if over == "ranges" else (own.b, np.sqrt(alpha * beta))
            ax.plot(*place, mark, mfc="white", mec="black", ms=7, label=name)
    axes.flat[0].legend(fontsize="small", loc="lower left", frameon=True)
    return axes


def plot_rendered_spring(settings: Mapping[str, LoopSettings] = STUDIES, delay: float = 0.05, ax=None):
    """
    Plot the impedance that the operator feels of the guiding spring at the robot, with and without delay.

    Parameters
    ----------
    settings : mapping of str to LoopSettings
        Settings whose springs and channels are shown, by label.
    delay : float
        One way [s].
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    matplotlib.axes.Axes
    """
    ax, omega = axes_or_new(ax), np.geomspace(0.05, 60.0, 400)
    for number, (name, one) in enumerate(settings.items()):
        spring = one.k_ffa / (1j * omega)
        late = rendered_impedance(one.scattering, omega, spring, delay, delay)
        ax.semilogx(omega, np.abs(late), f"C{number}-", label=f"{name}, delays of {1000 * delay:g} ms")
        at_once = rendered_impedance(one.scattering, omega, spring)
        ax.semilogx(omega, np.abs(at_once), f"C{number}:", label=f"{name}, no delay")
    ax.set(xlabel="ω [rad/s]", ylabel="$|f_m / r_m|$ [N s/m]", title="rendered impedance of a spring")
    ax.legend(fontsize="small", loc="lower left")
    return ax


def plot_tunings(tunings: Iterable[Tuning], ax=None):
    """
    Plot the trade-off between tunings with several weights: how far velocity and force are from ideal.

    Parameters
    ----------
    tunings : iterable of Tuning
        Results of `tune_transparency`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    matplotlib.axes.Axes
    """
    ax, rows = axes_or_new(ax), [next(tuning.table().itertuples()) for tuning in tunings]
    ax.plot([row.velocity for row in rows], [row.force for row in rows], "o-")
    for row in rows:
        ax.annotate(f"{row.weight:g}", (row.velocity, row.force), xytext=(5, 4), textcoords="offset points", fontsize=8)
    ax.set(xlabel="distance of velocity from ideal", ylabel="distance of force", title="what the tuner trades")
    return ax
