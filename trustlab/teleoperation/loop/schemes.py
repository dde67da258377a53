"""The control schemes of Sections 3.8 and 3.9 by name, and schemes of one's own."""

from collections.abc import Callable
from dataclasses import dataclass

from trustlab.allocation.blending import best_share
from trustlab.models.checks import flag, one_of, shown
from trustlab.models.compiled import njit
from trustlab.teleoperation.loop.kernel import BY_HAND, LOGISTIC, MANUAL, STEPS

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
    return best_share(c.blend, ahead, s.alpha_min, s.alpha_max, room.series, room.slope)[0]


@dataclass(frozen=True)
class Scheme:
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
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"name must be a text, got {shown(self.name)}")
        flag("bilateral", self.bilateral)
        if not callable(self.shares):
            one_of("shares", self.shares, RULES, also="a function of the state")


SCHEMES = {
    scheme.name: scheme
    for scheme in (
        Scheme("M", "manual", "manual teleoperation with force feedback"),
        Scheme(
            "MI",
            "logistic",
            "mixed initiative by trust (3.5), without force feedback",
            bilateral=False,
        ),
        Scheme("MMI", "by hand", "mixed initiative, allocated by hand, with force feedback"),
        Scheme(
            "TMIG",
            "logistic",
            "mixed initiative by trust, logistic scales (3.5), with force feedback",
        ),
        Scheme(
            "TMIS",
            "steps",
            "mixed initiative by trust, step scales (3.6), with force feedback",
        ),
        Scheme(
            "OMI",
            "optimal",
            "mixed initiative, optimal allocation (Appendix A), with force feedback",
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
