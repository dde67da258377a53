"""
How near the channel comes to passing forces and velocities on unchanged (Section 3.7), and its
figures.
"""

import numpy as np

from trustlab.models.checks import of_class
from trustlab.models.display import axes_or_new
from trustlab.models.trust import logistic_scale
from trustlab.teleoperation.loop.settings import LoopSettings
from trustlab.teleoperation.ports.waves import Scattering


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
