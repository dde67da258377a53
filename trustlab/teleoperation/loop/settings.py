"""
The teleoperation loop of Fig. 3.1: its settings, the printed ones of both studies, the schemes, and
the constants that the compiled loop takes.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated

import numpy as np

from trustlab.allocation.blending import OptimalBlending, best_share
from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    changes,
    named,
    not_negative,
    one_of,
    shown,
    text_of,
)
from trustlab.models.compiled import njit
from trustlab.models.display import axes_or_new
from trustlab.models.simulation import filled
from trustlab.models.trust import TrustModel, logistic_scale
from trustlab.models.uav import held_over
from trustlab.teleoperation.loop.kernel import (
    BY_HAND,
    GUIDANCE,
    LOGISTIC,
    MANUAL,
    SAMPLE,
    STATE,
    STEPS,
)
from trustlab.teleoperation.ports import METHODS, HapticDevice, Scattering

# By how much, as a share, scales and trust may lie beyond their bounds, for rounding.
SLACK = 1e-12


@dataclass(frozen=True)
class LoopSettings(Checked):
    """
    Settings of one teleoperation loop.

    Parameters
    ----------
    mass, damping, stiffness, weight : float
        M [kg], B [N s/m], K [N/m] and Λ [1/s] of the haptic device, the same on all axes.
    scattering : Scattering
        Impedance b, bounds of α and β, and Ṫ_max.
    k_ffa : float
        Stiffness of the force feedback f'_s = −k_ffa e [N/m], 0 or more; see `printed_sign`.
    height : float
        z_d, how far above its target the robot should fly [m].
    human_to_robot, robot_to_human : TrustModel
        (3.2) and (3.3).
    steepness : float
        s_α = s_β of (3.5), at least 10.
    force_scaling : float
        γ of (3.25).
    window : float
        W of (3.26) [s].
    command_range, error_range : float
        y_max of N in (3.27): for commands [m/s] and for tracking errors [m], both as 1-norms over
        three axes.
    printed_sign : bool
        Use the printed f'_s = +k_ffa e, an active spring that pushes the hand away from the target.
    require_passive : bool
        Refuse a device that is not r-passive.
    title : str
        What these settings are.
    study : {"main", "preliminary"}
        The study whose task, delays and operator's reach are the defaults; `dataclasses.replace`
        keeps it.
    sample_time : float
        T [s].

    Raises
    ------
    ValueError
        If a value is out of range; `PassivityError` if the device is too heavy for its gains.
    """

    mass: float
    damping: float
    stiffness: float
    weight: float
    scattering: Scattering
    k_ffa: NotNegative
    height: float
    human_to_robot: TrustModel = field(default_factory=lambda: TrustModel(a=0.2, b=0.2))
    robot_to_human: TrustModel = field(default_factory=lambda: TrustModel(a=0.2, b=0.2))
    steepness: Annotated[float, (10.0, 1e6)] = 10.0
    force_scaling: float = 1.0
    window: Positive = 10.0
    command_range: Positive = 3.0
    error_range: Positive = 3.0
    printed_sign: bool = False
    require_passive: bool = True
    title: str = "own settings"
    study: str = "main"
    sample_time: Annotated[float, (1e-5, 0.1)] = 0.01

    def __post_init__(self):
        super().__post_init__()
        one_of("study", self.study, ("preliminary", "main"))
        HapticDevice(  # refused if it is not r-passive with the damping that its port always has
            self.mass,
            self.damping,
            self.stiffness,
            self.weight,
            force_scaling=self.force_scaling,
            port_damping=self.scattering.beta_min * self.scattering.b,
            require_passive=self.require_passive,
        )

    def plot_scales(self, axes=None):
        """
        Plot the scales α and β over trust, as Figs. 3.2 and 3.3.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes
        """
        axes, trust, s = axes_or_new(axes), np.linspace(0.0, 1.0, 401), self.scattering
        bounds = (("α", s.alpha_min, s.alpha_max, "C0"), ("β", s.beta_min, s.beta_max, "C1"))
        for symbol, low, high, color in bounds:
            logistic = logistic_scale.py_func(low, high, self.steepness, 0.5, trust)  # (3.5)
            axes.plot(trust, logistic, color, label=f"{symbol}, logistic")
            step = np.where(trust >= 0.5, low, high)  # (3.6)
            axes.plot(trust, step, f"{color}:", label=f"{symbol}, step")
        axes.set(xlabel="trust, share of its range", ylabel="scale", title=f"{self.study} study")
        return axes


# Printed settings. The device's mass, the rates of trust and y_max are not printed: the first is
# near the heaviest that is r-passive with the printed gains of each study (9.2 g and 0.55 kg); the
# others are ours.
STUDIES = {
    "preliminary": LoopSettings(
        mass=0.009,
        damping=0.55,
        stiffness=100.0,
        weight=60.0,
        scattering=Scattering(1.0, 0.05, 1.0, 0.2, 1.0, max_delay_rate=0.5),
        k_ffa=3.0,
        height=4.0,
        command_range=6.0,
        error_range=12.0,
        title="preliminary study (Section 3.8.1)",
        study="preliminary",
    ),
    "main": LoopSettings(
        mass=0.5,
        damping=5.5,
        stiffness=20.0,
        weight=10.0,
        scattering=Scattering(2.0, 0.2, 1.0, 0.05, 0.5, max_delay_rate=0.5),
        k_ffa=6.0,
        height=1.5,
        command_range=2.0,
        error_range=3.0,
        title="main study (Section 3.9)",
        study="main",
    ),
}


def study_named(study: str | LoopSettings) -> LoopSettings:
    """Return the printed settings of a study by name, or own ones as they are."""
    return named("study", study, LoopSettings, STUDIES)


def described(settings: LoopSettings) -> dict[str, str]:
    """Return what is logged of settings: what they are, and how they differ from the printed."""
    usual = STUDIES[settings.study]
    return {"study": settings.title, "settings": changes(settings, usual)}


# --- schemes ------------------------------------------------------------------------------------

# Built-in rules for the scales, by their numbers in the kernel. That of Appendix A decides over
# the first.
RULES = {
    "manual": MANUAL,
    "logistic": LOGISTIC,
    "steps": STEPS,
    "by hand": BY_HAND,
    "optimal": MANUAL,
}


@njit(error_model="numpy", _nrt=False)
def optimal_share(numbers, whole):
    """
    Return α by Appendix A at the pause of a sample, from what the operator commanded in the one
    before.

    numbers, whole, shape (1,): records of NUMBERS and STATE; as arrays, for a record takes numba
    12 µs to unpack.
    """
    c, s = numbers[0], whole[0]
    now, room = s.now, s.blending
    ahead = room.ahead
    for i in range(3):
        ahead[i, 0] = now.r_s[i] / now.alpha
        ahead[i, 1] = now.u_a[i]
        ahead[i, 2] = now.error[i]
        ahead[i, 3] = s.reference_velocity[i] - now.velocity[i]
        ahead[i, 4] = -s.acceleration[i]
    return best_share(c.blend, ahead, s.alpha_min, s.alpha_max, room.series)


@dataclass(frozen=True)
class Scheme(Checked):
    """
    Who sets the scales, and whether the operator feels a force.

    Parameters
    ----------
    name : str
        M, MI, MMI, TMIG, TMIS, OMI, or your own.
    shares : callable, or one of RULES
        f(state) → (α, β), called in every sample: α within [state.alpha_min, state.alpha_max], β
        within [state.beta_min, state.beta_max], the bounds for which the channel's ends are set
        (3.1). `state` has everything that a run logs, by name, as it is known when the scales are
        set: t, p_r, p_h, trust_hr, trust_rh, path_error, robot, velocity, … `state.memory` is a
        dictionary, empty at the start of a run. Or a built-in rule: "manual", "logistic" (3.5),
        "steps" (3.6), "by hand", "optimal" (Appendix A).
    title : str
        What it is.
    bilateral : bool
        Whether forces come back.

    Raises
    ------
    ValueError
        If `name` is no text, `shares` neither a function nor a rule, or `bilateral` not True or
        False.

    Examples
    --------
    >>> import trustlab as tl
    >>> def by_performance(state):
    ...     span = state.alpha_max - state.alpha_min
    ...     better = max(state.p_h, 1e-6) / (state.p_h + state.p_r + 2e-6)
    ...     return state.alpha_min + span * better, state.beta_max
    >>> mine = tl.Scheme("mine", by_performance)
    >>> run = tl.simulate_teleoperation(mine, duration=10.0, seed=0)
    >>> bool((run["alpha"] >= 0.2).all())
    True
    """

    name: str
    shares: Callable | str
    title: str = "own scheme"
    bilateral: bool = True

    def __post_init__(self):
        super().__post_init__()
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"name must be a text, got {shown(self.name)}")
        text_of("title", self.title)
        if not callable(self.shares):
            one_of("shares", self.shares, RULES, also="a function of the state")


_TRUST = "mixed initiative by trust"
SCHEMES = {
    scheme.name: scheme
    for scheme in (
        Scheme("M", "manual", "manual teleoperation with force feedback"),
        Scheme("MI", "logistic", f"{_TRUST} (3.5), without force feedback", bilateral=False),
        Scheme("MMI", "by hand", "mixed initiative, allocated by hand, with force feedback"),
        Scheme("TMIG", "logistic", f"{_TRUST}, logistic scales (3.5), with force feedback"),
        Scheme("TMIS", "steps", f"{_TRUST}, step scales (3.6), with force feedback"),
        Scheme("OMI", "optimal", "optimal allocation (Appendix A), with force feedback"),
    )
}


def scheme_named(name: str | Scheme) -> Scheme:
    """Return the scheme of this name, or one's own as it is."""
    return named("scheme", name, Scheme, SCHEMES)


# --- guidance -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class GuidanceBudget(Checked):
    """
    Energy that guidance at the operator may give out beyond what its port took.

    In any stretch of s seconds the port gives out at most energy + power · s, under the guard
    "repay"; what it takes beyond `energy` is not saved up.

    Guidance that a passive port renders is hardly felt: it can help the hand by no more than the
    channel's drag takes. A port with a budget may give out more, by a stated amount.

    **Bound.** The port has an account. It starts at `energy`, every sample books what the port
    takes or gives out, cuts the account at `energy`, and adds `power` times the sample time; the
    controller ("repay") lets no sample end below zero. So in any stretch of s seconds, whenever it
    begins, the port gives out no more than the account then held and what was added since: energy +
    power s.

    **What follows.** By (3.9)-(3.11) the device stores and dissipates what the operator supplies
    less what the port takes. Over a time t it dissipates on average at most the operator's mean
    power + `power` + (energy stored at the start + `energy`)/t. An r-passive device dissipates a
    positive definite form of its position and velocity, so both stay bounded in the mean square,
    whatever channel, delays, losses and vehicle do. With power = 0 the port is passive in the sense
    of Theorem 4, with `energy` as the constant.

    Parameters
    ----------
    energy : float
        In the account at the start, and the most that it holds [J].
    power : float
        Added all the time [W].

    Raises
    ------
    ValueError
        If a number is negative or not finite.

    Examples
    --------
    >>> import trustlab as tl
    >>> from trustlab.teleoperation import Guidance, GuidanceBudget
    >>> budget = GuidanceBudget(energy=0.2, power=0.5)
    >>> run = tl.simulate_teleoperation("M", duration=10.0, guidance=Guidance(budget=budget))
    >>> bool(run["energy_port"].min() >= -budget.bound(10.0))
    True
    """

    energy: NotNegative = 0.0
    power: NotNegative = 0.0

    def bound(self, seconds: float) -> float:
        """
        Return the most that the port gives out in so many seconds, whenever they begin [J].

        Parameters
        ----------
        seconds : float
            s.
        """
        return self.energy + self.power * not_negative("seconds", seconds)


@dataclass(frozen=True)
class Guidance(Checked):
    """
    How a guiding force reaches the operator, and what keeps it passive.

    Parameters
    ----------
    where : {"at_operator", "through_channel"}
        "at_operator": β times the force is rendered at the haptic device, from the camera's
        picture; it spends energy that the operator's port has earned, and the robot does what the
        operator commands. "through_channel": as printed, the force is at the robot's port,
        (3.17)-(3.22).
    guard : {"repay", "cancel", "off"}
        The passivity controller of the guidance: "repay" lets no port end a sample below zero;
        "cancel", as printed, undershoots by at most one sample's power at a time; "off" shows what
        they are for.
    budget : GuidanceBudget, optional
        What guidance at the operator may give out beyond what its port took, so that it is felt; in
        its place, when not given, is all that the port has earned since the start. Not with guard
        "off", which keeps to none.
    force : callable, optional
        f(state) → guiding force [N], shape (3,); −k_ffa e when not given, e being `state.stretch`.

    Raises
    ------
    ValueError
        If a word is unknown, or nothing keeps to the budget.

    Examples
    --------
    >>> import trustlab as tl
    >>> from trustlab.teleoperation import Guidance
    >>> weak = Guidance(force=lambda state: -2.0 * state.stretch)
    >>> run = tl.simulate_teleoperation("M", guidance=weak, duration=5.0)
    >>> bool(run["energy_port"].min() > -1e-9)
    True
    """

    where: str = "at_operator"
    guard: str = "repay"
    budget: GuidanceBudget | None = None
    force: Callable | None = None

    def __post_init__(self):
        super().__post_init__()
        one_of("where", self.where, GUIDANCE)
        one_of("guard", self.guard, METHODS)
        if self.budget and (self.where != "at_operator" or self.guard == "off"):
            raise ValueError(
                "budget is for guidance at_operator under a guard, got where = "
                f"{self.where!r} and guard = {self.guard!r}"
            )


def bounds_of(settings: LoopSettings) -> dict[str, tuple[float, float]]:
    """Return bounds of the scales (3.1) and of trust (3.4), with room for rounding."""
    ends, hr, rh = settings.scattering, settings.human_to_robot, settings.robot_to_human
    bounds = {
        "alpha": (ends.alpha_min, ends.alpha_max),
        "beta": (ends.beta_min, ends.beta_max),
        "trust_hr": (hr.t_min, 1e300 if hr.allow_unbounded else hr.t_max),
        "trust_rh": (rh.t_min, 1e300 if rh.allow_unbounded else rh.t_max),
    }
    return {
        name: (low - SLACK * abs(low), high + SLACK * abs(high))
        for name, (low, high) in bounds.items()
    }


def state_of(settings: LoopSettings, guidance: Guidance, start: float) -> np.ndarray:
    """
    Return the state before the first sample, a record of STATE: scales at their upper bounds, trust
    in the robot at a share of its range, that in the operator mid-way.
    """
    ends, models = settings.scattering, (settings.human_to_robot, settings.robot_to_human)
    shares = zip(models, (start, 0.5), strict=True)
    hr, rh = (model.t_min + (model.t_max - model.t_min) * share for model, share in shares)
    now = filled(SAMPLE, trust_hr=hr, trust_rh=rh, alpha=ends.alpha_max, beta=ends.beta_max)
    account = guidance.budget.energy if guidance.budget else 0.0
    return np.atleast_1d(filled(STATE, settings, ends, now=now, account=account))


@lru_cache(maxsize=64)
def blending_cost(vehicle, gains, low: float, high: float) -> np.ndarray:
    """Return the cost of Appendix A for this vehicle and its controller, the same on three axes."""
    return OptimalBlending(vehicle, (gains,) * 3, low, high).weights


@lru_cache(maxsize=64)
def vehicle_matrices(axes: tuple, sample_time: float) -> np.ndarray:
    """
    Return exact one-sample matrices, shape (3, 3, 4), by axis: (position, velocity, acceleration) a
    sample later from these and a command that is held.

    Worked out once: exponentials take longer than a minute of the loop. An axis of order 1 leaves
    its acceleration at zero.
    """
    matrices = np.zeros((3, 3, 4))
    for matrix, axis in zip(matrices, axes, strict=True):
        n = axis.order + 1
        a, b = axis.matrices()
        moving = np.pad(a, ((1, 0), (1, 0)))
        moving[0, 1] = 1.0
        matrix[:n, :n], matrix[:n, 3] = held_over(sample_time, moving, np.pad(b, (1, 0)))
    matrices.flags.writeable = False
    return matrices
