"""
How near the channel comes to passing forces and velocities on unchanged (Section 3.7), and its
figures.
"""

import math

import numpy as np
import pandas as pd

from trustlab.models.checks import finite_array, finite_number, not_negative, of_class
from trustlab.models.display import axes_or_new
from trustlab.teleoperation.loop.settings import STUDIES, LoopSettings
from trustlab.teleoperation.ports.waves import Scattering

COLORS = ("C0", "C1")

# The relations of (3.22) by who should be passed on: names in `dominance`, index of
# `ideal_distances`.
RELATIONS = {
    "force_operator": "f'_m = v_l",
    "force_robot": "u_r = f_s",
    "velocity_robot": "r'_s = v_r",
    "velocity_operator": "u_l = r_m",
}

# Gains that are mapped over the ranges of both scales; of the leaks the drag, as with b = 1 the
# drift is the same.
MAPS = {
    "force": "felt force, $f_m/(β f_s)$",
    "velocity": "robot's velocity, $r_s/(α r_m)$",
    "drag": "leaks at b = 1: drag and drift",
}


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
    columns = {
        "wanted": ("v_l", "f_s", "v_r", "r_m"),
        "weight": (near.arriving, far.sent, far.arriving / s.b, near.sent),
        "other": ("r_m", "v_r", "f_s", "v_l"),
        "leak": (s.b, far.reflected, 1.0 / s.b, near.reflected),
    }
    frame = pd.DataFrame(columns, pd.Index(RELATIONS.values(), name="relation"))
    frame["distance"] = np.hypot(frame["weight"] - 1.0, frame["leak"])
    frame["ratio"] = frame["weight"] / frame["leak"]
    return frame


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
    ratio = ideal_distances(scattering)["ratio"]
    return {name: float(ratio[relation]) for name, relation in RELATIONS.items()}


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
    kappa = math.sqrt(s.alpha_min * s.beta_min / (s.alpha_max * s.beta_max))
    leaked = (1.0 - kappa) / (1.0 + kappa)
    return {
        "force": 2.0 * beta * math.sqrt(s.alpha_min / s.beta_max) / (1.0 + kappa),
        "velocity": 2.0 * alpha * math.sqrt(s.beta_min / s.alpha_max) / (1.0 + kappa),
        "drag": beta * s.b * leaked,
        "drift": alpha / s.b * leaked,
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
    if load.shape not in ((), omega.shape) or not np.isfinite(load).all():
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
    """Return the scales, their upper bounds where not given, within their bounds."""
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
    ax, trust = axes_or_new(ax), np.linspace(0.0, 1.0, 401)
    for kind, style in (("logistic", "-"), ("step", ":")):
        for symbol, scaling, color in zip("αβ", settings.scalings(kind), COLORS, strict=True):
            ax.plot(trust, scaling.value(trust), color + style, label=f"{symbol}, {kind}")
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
