"""The control schemes of Sections 3.8 and 3.9 by name, and schemes of one's own."""

from collections.abc import Callable
from dataclasses import dataclass

from trustlab.allocation.blending import best_share
from trustlab.models.checks import flag, one_of, shown
from trustlab.models.compiled import njit
from trustlab.models.trust import logistic_scale
from trustlab.teleoperation.loop.parts import Part


@njit(error_model="numpy", forceinline=True)
def share_of_range(trust, model):
    """
    Return trust as a share of its range; the scales (3.5) and (3.6) have their midpoint at half of
    it.
    """
    return (trust - model.t_min) / (model.t_max - model.t_min)


@Part
def manual(state, setup):
    """Leave all to the operator: both scales at their upper bounds."""
    state.alpha, state.beta = state.alpha_max, state.beta_max


@Part
def logistic_by_trust(state, setup):
    """Set both scales by trust (3.5)."""
    n = setup.loop
    hr, rh = share_of_range(state.trust_hr, n.trust_hr), share_of_range(state.trust_rh, n.trust_rh)
    state.alpha = logistic_scale(state.alpha_min, state.alpha_max, n.steepness, 0.5, hr)
    state.beta = logistic_scale(state.beta_min, state.beta_max, n.steepness, 0.5, rh)


@Part
def stepped_by_trust(state, setup):
    """Set both scales by trust (3.6)."""
    n = setup.loop
    state.alpha = (
        state.alpha_min if share_of_range(state.trust_hr, n.trust_hr) >= 0.5 else state.alpha_max
    )
    state.beta = (
        state.beta_min if share_of_range(state.trust_rh, n.trust_rh) >= 0.5 else state.beta_max
    )


@Part
def by_hand(state, setup):
    """Let the operator move α now and then towards the partner that performs better."""
    hand = setup.hand
    state.waited += 1
    if state.waited >= hand.patience:
        state.waited = 0
        state.alpha += hand.shift if state.p_h > state.p_r else -hand.shift
        state.alpha = min(max(state.alpha, state.alpha_min), state.alpha_max)
    state.beta = state.beta_max


@Part
def optimal(state, setup):
    """Set α by Appendix A, from what the operator commanded in the sample before."""
    room = state.blending
    ahead = room.ahead
    for i in range(3):
        ahead[i, 0] = state.r_s[i] / state.alpha
        ahead[i, 1] = state.u_a[i]
        ahead[i, 2] = state.error[i]
        ahead[i, 3] = state.reference_velocity[i] - state.velocity[i]
        ahead[i, 4] = -state.acceleration[i]
    low, high = state.alpha_min, state.alpha_max
    state.alpha = best_share(setup.blend, ahead, low, high, room.series, room.slope)[0]
    state.beta = state.beta_max


@dataclass(frozen=True)
class Scheme:
    """
    Who sets the scales, and whether the operator feels a force.

    Parameters
    ----------
    name : str
        M, MI, MMI, TMIG, TMIS, OMI, or your own.
    shares : callable
        f(state) → (α, β), called in every sample: α within [state.alpha_min, state.alpha_max], β
        within [state.beta_min, state.beta_max], the bounds for which the channel's ends are set
        (3.1). `state` has everything that a run logs, by name, as it is known when the scales are
        set: t, p_r, p_h, trust_hr, trust_rh, path_error, robot, velocity, … A function f(state,
        memory) has 16 numbers of its own, zero at the start. It is compiled where numba can, else
        called in Python.
    title : str
        What it is.
    bilateral : bool
        Whether forces come back.

    Raises
    ------
    ValueError
        If the name is empty or `shares` cannot be called.

    Examples
    --------
    >>> import trustlab as tl
    >>> def shares(state):
    ...     return state.alpha_max - (state.alpha_max - state.alpha_min) * state.p_r, state.beta_max
    >>> run = tl.simulate_teleoperation(tl.Scheme("mine", shares), duration=5.0, seed=0)
    >>> bool((run["alpha"] <= 1.0).all())
    True
    """

    name: str
    shares: Callable | Part
    title: str = "own scheme"
    bilateral: bool = True

    def __post_init__(self):
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"name must be a text, got {shown(self.name)}")
        flag("bilateral", self.bilateral)
        if not (callable(self.shares) or isinstance(self.shares, Part)):
            raise ValueError(
                f"shares must be a function of the state, got {type(self.shares).__name__}"
            )


SCHEMES = {
    scheme.name: scheme
    for scheme in (
        Scheme("M", manual, "manual teleoperation with force feedback"),
        Scheme(
            "MI",
            logistic_by_trust,
            "mixed initiative by trust (3.5), without force feedback",
            bilateral=False,
        ),
        Scheme("MMI", by_hand, "mixed initiative, allocated by hand, with force feedback"),
        Scheme(
            "TMIG",
            logistic_by_trust,
            "mixed initiative by trust, logistic scales (3.5), with force feedback",
        ),
        Scheme(
            "TMIS",
            stepped_by_trust,
            "mixed initiative by trust, step scales (3.6), with force feedback",
        ),
        Scheme(
            "OMI", optimal, "mixed initiative, optimal allocation (Appendix A), with force feedback"
        ),
    )
}


def scheme_named(name: str | Scheme) -> Scheme:
    """
    Return the scheme of this name, or one's own as it is; an unknown name is refused with the
    nearest.
    """
    return (
        name
        if isinstance(name, Scheme)
        else SCHEMES[one_of("scheme", name, SCHEMES, also="a trustlab.Scheme")]
    )
