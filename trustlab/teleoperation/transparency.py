"""
How near the channel comes to passing forces and velocities on unchanged (Section 3.7), and its
figures.
"""

import math

import numpy as np

from trustlab.models.checks import of_class
from trustlab.models.display import axes_or_new
from trustlab.models.trust import logistic_scale
from trustlab.teleoperation.loop.settings import STUDIES, LoopSettings
from trustlab.teleoperation.ports.waves import Scattering

# Gains that are mapped over the ranges of both scales; of the leaks the drag, as with b = 1 the
# drift is the same.
MAPS = {
    "force": "felt force, $f_m/(β f_s)$",
    "velocity": "robot's velocity, $r_s/(α r_m)$",
    "drag": "leaks at b = 1: drag and drift",
}


def dominance(scattering: Scattering) -> dict[str, float]:
    """
    Return how far the wanted signal outweighs the other one, for force and for velocity.

    Each relation of (3.22) mixes the wanted signal with another one: f'_m = b r_m + √(2b/β_max) v_l
    should be v_l, and so on, and all four cannot be met at once. In u_r and f'_m the force
    dominates by √(2α_max/b) and √(2/(bβ_max)): it gains from smaller b and β_max and larger α_max.
    In r'_s and u_l the velocity dominates by √(2b/α_max) and √(2bβ_max): it gains from larger b,
    from smaller α_max in the first and larger β_max in the second. Section 3.7.1 says that a
    smaller β helps velocity; it does not, whichever bar the text has lost.

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
    near, far = s.at_operator, s.at_robot
    return {
        "force_operator": float(near.arriving / s.b),
        "force_robot": float(far.sent / far.reflected),
        "velocity_robot": float(far.arriving),
        "velocity_operator": float(near.sent / near.reflected),
    }


def gains(scattering: Scattering) -> dict[str, float]:
    """
    Return what a slow signal becomes on its way, all delays having passed, the scales α and β at
    their upper bounds.

    force = f_m/f_s with the hand held still, 2β√(α_min/β_max)/(1 + κ); velocity = r_s/r_m with no
    force at the robot, 2α√(β_min/α_max)/(1 + κ), κ = √(α_minβ_min/(α_maxβ_max)). Neither depends on
    b, which sets what leaks across: drag = f_m/r_m felt without a force at the robot, βb(1 − κ)/(1
    + κ), and drift = −r_s/f_s, how the robot moves under its own force while the hand is still,
    (α/b)(1 − κ)/(1 + κ), all in SI units. The ideal is force = β, velocity = α, drag = drift = 0.
    """
    s = scattering
    kappa = math.sqrt(s.alpha_min * s.beta_min / (s.alpha_max * s.beta_max))
    leaked = (1.0 - kappa) / (1.0 + kappa)
    return {
        "force": 2.0 * s.beta_max * math.sqrt(s.alpha_min / s.beta_max) / (1.0 + kappa),
        "velocity": 2.0 * s.alpha_max * math.sqrt(s.beta_min / s.alpha_max) / (1.0 + kappa),
        "drag": s.beta_max * s.b * leaked,
        "drift": s.alpha_max / s.b * leaked,
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
    ax, trust, s = axes_or_new(ax), np.linspace(0.0, 1.0, 401), settings.scattering
    bounds = (("α", s.alpha_min, s.alpha_max, "C0"), ("β", s.beta_min, s.beta_max, "C1"))
    for symbol, low, high, color in bounds:
        logistic = logistic_scale.py_func(low, high, settings.steepness, 0.5, trust)  # (3.5)
        ax.plot(trust, logistic, color, label=f"{symbol}, logistic")
        step = np.where(trust >= 0.5, low, high)  # (3.6)
        ax.plot(trust, step, f"{color}:", label=f"{symbol}, step")
    ax.set(xlabel="trust, share of its range", ylabel="scale", title=f"{settings.study} study")
    return ax


def plot_transparency():
    """
    Plot gains and leaks of the channel over the ranges of its scales, α and β being one, and where
    both studies are.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (3,)
    """
    axes, ratios = axes_or_new(None, 1, 3, figsize=(8.2, 3.0)), np.geomspace(0.02, 1.0, 60)
    for ax, (name, title) in zip(axes, MAPS.items(), strict=True):
        values = [[gains(Scattering(1.0, y, 1.0, x))[name] for x in ratios] for y in ratios]
        ax.figure.colorbar(ax.contourf(ratios, ratios, values, 12), ax=ax)
        ax.set(xscale="log", yscale="log", title=title, xlabel="$β_{min}/β_{max}$")
        for mark, (study, settings) in zip("os", STUDIES.items(), strict=True):
            s = settings.scattering
            place = s.beta_min / s.beta_max, s.alpha_min / s.alpha_max
            ax.plot(*place, mark, mfc="white", mec="black", ms=7, label=study)
    axes[0].set(ylabel="$α_{min}/α_{max}$")
    axes[0].legend(fontsize="small", loc="lower left", frameon=True)
    return axes
