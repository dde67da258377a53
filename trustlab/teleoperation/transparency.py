"""
How near the channel comes to passing forces and velocities on unchanged (Section 3.7), a tuner for
it, and their figures.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    finite_array,
    finite_number,
    not_negative,
    of_class,
)
from trustlab.models.display import axes_or_new
from trustlab.models.trust import LogisticScaling, StepScaling
from trustlab.teleoperation.loop.settings import STUDIES, LoopSettings
from trustlab.teleoperation.ports.waves import Scattering

PARAMETERS = ("b", "alpha_min", "alpha_max", "beta_min", "beta_max")

# Maps of gains: title, which gain, and whether over the ranges of both scales or over b.
MAPS = (
    ("felt force, $f_m/(β f_s)$, hand still", "force", True),
    ("robot's velocity, $r_s/(α r_m)$, no force", "velocity", True),
    ("drag felt, $f_m/(β r_m)$ [N s/m]", "drag", False),
    ("drift, $-r_s/(α f_s)$ [m/s/N]", "drift", False),
)
ACROSS = {
    "x": "bounds of β, $\\underline{β}/\\overline{β}$",
    "y": "bounds of α, $\\underline{α}/\\overline{α}$",
    "bar": "gain, ideally 1",
}
OVER_B = {"x": "b [N s/m]", "y": "both ratios of bounds", "bar": "log$_{10}$, ideally −∞"}


def ideal_distances(scattering: Scattering):
    """
    Return by how much the four relations of (3.22) miss the ideal ones of (3.23).

    Each relation mixes the wanted signal with another one: f'_m = b r_m + √(2b/β_max) v_l should be
    v_l, u_r = √(2α_min/b) f_s − √(α_min/α_max) v_r should be f_s, and so on. All four cannot be met
    at once.

    Parameters
    ----------
    scattering : Scattering
        Impedance and bounds of the scales.

    Returns
    -------
    pandas.DataFrame
        Index `relation`; columns wanted, weight (of the wanted signal; ideal 1), other, leak
        (weight of the other signal; ideal 0), distance = √((weight − 1)² + leak²), ratio =
        weight/leak.
    """
    s = of_class("scattering", scattering, Scattering)
    near, far = s.at_operator, s.at_robot
    columns = ["wanted", "weight", "other", "leak"]
    rows = {
        "f'_m = v_l": ("v_l", near.arriving, "r_m", s.b),
        "u_r = f_s": ("f_s", far.sent, "v_r", far.reflected),
        "r'_s = v_r": ("v_r", np.sqrt(2.0 / (s.b * s.alpha_max)), "f_s", 1.0 / s.b),
        "u_l = r_m": ("r_m", near.sent, "v_l", near.reflected),
    }
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    frame["distance"] = np.hypot(frame["weight"] - 1.0, frame["leak"])
    frame["ratio"] = frame["weight"] / frame["leak"]
    return frame.rename_axis("relation")


def dominance(scattering: Scattering) -> dict[str, float]:
    """
    Return how far the wanted signal outweighs the other one, for force and for velocity.

    In u_r and f'_m the force dominates by √(2α_max/b) and √(2/(bβ_max)): it gains from smaller b
    and β_max and larger α_max. In r'_s and u_l the velocity dominates by √(2b/α_max) and
    √(2bβ_max): it gains from larger b, from smaller α_max in the first and larger β_max in the
    second. Section 3.7.1 says that a smaller β helps velocity; it does not, whichever bar the text
    has lost.

    Parameters
    ----------
    scattering : Scattering
        Impedance and bounds of the scales.

    Returns
    -------
    dict of str to float
        force_robot (f_s in u_r), force_operator (v_l in f'_m), velocity_robot (v_r in r'_s),
        velocity_operator (r_m in u_l).
    """
    s = of_class("scattering", scattering, Scattering)
    return {
        "force_robot": float(np.sqrt(2.0 * s.alpha_max / s.b)),
        "force_operator": float(np.sqrt(2.0 / (s.b * s.beta_max))),
        "velocity_robot": float(np.sqrt(2.0 * s.b / s.alpha_max)),
        "velocity_operator": float(np.sqrt(2.0 * s.b * s.beta_max)),
    }


def gains(
    scattering: Scattering, alpha: float | None = None, beta: float | None = None
) -> dict[str, float]:
    """
    Return what a slow signal becomes on its way, all delays having passed.

    force = f_m/f_s with the hand held still, 2β√(α_min/β_max)/(1 + κ); velocity = r_s/r_m with no
    force at the robot, 2α√(β_min/α_max)/(1 + κ), κ = √(α_minβ_min/(α_maxβ_max)). Neither depends on
    b, which sets what leaks across: drag = f_m/r_m felt without a force at the robot, βb(1 − κ)/(1
    + κ), and drift = −r_s/f_s, how the robot moves under its own force while the hand is still,
    (α/b)(1 − κ)/(1 + κ). The ideal is force = β, velocity = α, drag = drift = 0.

    Parameters
    ----------
    scattering : Scattering
        Impedance and bounds of the scales.
    alpha, beta : float, optional
        The scales; their upper bounds when not given.

    Returns
    -------
    dict of str to float
        force, velocity, drag [N s/m], drift [m/s/N].
    """
    s = of_class("scattering", scattering, Scattering)
    alpha, beta = _scales(s, alpha, beta)
    kappa = np.sqrt(s.alpha_min * s.beta_min / (s.alpha_max * s.beta_max))
    return {
        "force": float(2.0 * beta * np.sqrt(s.alpha_min / s.beta_max) / (1.0 + kappa)),
        "velocity": float(2.0 * alpha * np.sqrt(s.beta_min / s.alpha_max) / (1.0 + kappa)),
        "drag": float(beta * s.b * (1.0 - kappa) / (1.0 + kappa)),
        "drift": float(alpha / s.b * (1.0 - kappa) / (1.0 + kappa)),
    }


def rendered_impedance(
    scattering: Scattering,
    frequency: np.ndarray,
    environment: complex | np.ndarray = 0.0,
    delay_1: float = 0.0,
    delay_2: float = 0.0,
    alpha: float | None = None,
    beta: float | None = None,
) -> np.ndarray:
    """
    Return the impedance f_m/r_m that the operator feels through the channel, for constant delays
    and scales.

    Parameters
    ----------
    scattering : Scattering
        Impedance, bounds of the scales, and the gain f_i.
    frequency : array_like, shape (N,)
        Angular frequencies [rad/s].
    environment : complex or array_like, shape (N,)
        f_s/r_s at the robot's port [N s/m]; k/(jω) for a spring of stiffness k.
    delay_1, delay_2 : float
        Constant delays to the robot and back [s].
    alpha, beta : float, optional
        The scales; their upper bounds when not given.

    Returns
    -------
    numpy.ndarray of complex, shape (N,)
        Its real part is never negative where the environment's is not: the channel is passive.

    Raises
    ------
    ValueError
        If an argument is not finite or out of range.
    """
    s, omega = of_class("scattering", scattering, Scattering), finite_array("frequency", frequency)
    alpha, beta = _scales(s, alpha, beta)
    there, back = not_negative("delay_1", delay_1), not_negative("delay_2", delay_2)
    load = np.asarray(environment, dtype=complex)
    if (load.ndim and load.shape != omega.shape) or not np.isfinite(load).all():
        raise ValueError(
            f"environment must be a finite number or one per frequency, got shape {load.shape}"
        )
    loop = s.gain**2 * np.exp(-1j * omega * (there + back))
    near, far = s.at_operator, s.at_robot
    into = alpha * load * far.arriving / (s.b + alpha * load)
    reflected = far.sent * into - far.reflected
    arriving = loop * reflected * near.sent
    arriving = arriving / (1.0 - near.reflected * loop * reflected)
    return beta * (s.b + near.arriving * arriving)


def _scales(scattering: Scattering, alpha, beta) -> tuple[float, float]:
    alpha = scattering.alpha_max if alpha is None else finite_number("alpha", alpha)
    beta = scattering.beta_max if beta is None else finite_number("beta", beta)
    scattering.check_scales(alpha, beta)
    return alpha, beta


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
        ax.plot(
            trust,
            LogisticScaling(*bounds).value(trust),
            color=color,
            label=f"{symbol}, logistic (3.5)",
        )
        steep = LogisticScaling(*bounds, steepness=40.0).value(trust)
        ax.plot(trust, steep, color=color, lw=0.8, label=f"{symbol}, four times as steep")
        ax.plot(
            trust,
            StepScaling(*bounds).value(trust),
            ":",
            color=color,
            label=f"{symbol}, step (3.6)",
        )
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
    shares, impedances = np.geomspace(0.02, 1.0, points), np.geomspace(0.2, 10.0, points)
    for ax, (title, key, by_ranges) in zip(axes.flat, MAPS, strict=True):
        across = shares if by_ranges else impedances
        grid = np.empty((points, points))
        for i, j in np.ndindex(grid.shape):
            y, x = float(shares[i]), float(across[j])
            ends = Scattering(1.0, y, 1.0, x) if by_ranges else Scattering(x, y, 1.0, y)
            grid[i, j] = gains(ends)[key]
        names = ACROSS if by_ranges else OVER_B
        values = grid if by_ranges else np.log10(grid + 1e-12).clip(-2)
        bar = ax.figure.colorbar(ax.contourf(across, shares, values, 12), ax=ax)
        bar.set_label(names["bar"])
        ax.set(xscale="log", yscale="log", title=title, xlabel=names["x"], ylabel=names["y"])
        for (name, study), mark in zip(settings.items(), "os^v", strict=False):
            s = study.scattering
            alpha, beta = s.alpha_min / s.alpha_max, s.beta_min / s.beta_max
            place = (beta, alpha) if by_ranges else (s.b, np.sqrt(alpha * beta))
            ax.plot(*place, mark, mfc="white", mec="black", ms=7, label=name)
    axes.flat[0].legend(fontsize="small", loc="lower left", frameon=True)
    return axes


def plot_rendered_spring(
    settings: Mapping[str, LoopSettings] = STUDIES, delay: float = 0.05, ax=None
):
    """
    Plot the impedance that the operator feels of the guiding spring at the robot, with and without
    delay.

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
    for number, (name, study) in enumerate(settings.items()):
        spring = study.k_ffa / (1j * omega)
        late = rendered_impedance(study.scattering, omega, spring, delay, delay)
        ax.semilogx(
            omega, np.abs(late), f"C{number}-", label=f"{name}, delays of {1000 * delay:g} ms"
        )
        at_once = rendered_impedance(study.scattering, omega, spring)
        ax.semilogx(omega, np.abs(at_once), f"C{number}:", label=f"{name}, no delay")
    ax.set(
        xlabel="frequency ω [rad/s]",
        ylabel="felt impedance [N s/m]",
        title="rendered impedance of a spring",
    )
    ax.legend(fontsize="small", loc="lower left")
    return ax
