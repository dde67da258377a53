"""Leader policies: what is decided of a team every 0.1 s."""

from bisect import bisect_right
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from trustlab.models.checks import Checked, NotNegative, finite_array, list_of, one_of

# Times [s] so near each other are the same.
SLACK = 1e-9


@dataclass(eq=False)
class TeamSituation:
    """
    What a policy knows when it decides.

    Parameters
    ----------
    t : float
        Now [s].
    robots : tuple
        Names of all robots that are in the team at any time.
    present : numpy.ndarray, shape (N,)
        Which of them are in it now.
    may_lead : numpy.ndarray, shape (N,)
        Which of these all others see, directly or through others.
    trust : numpy.ndarray, shape (N,)
        Human-to-robot trust (4.1) now; −inf for who may not lead, so that argmax never picks them.
    leader : int or None
        Index of the present leader; None at the start.
    since : float
        When it began to lead [s].
    dwell : float
        τ_min [s]: how long a leader stays at the least, unless it leaves the team.
    rng : numpy.random.Generator
        The run's own stream for policies.
    memory : dict
        State of the policy: empty at the start, kept from one decision of a run to the next.
    loop : TeamLoop
        Whose positions are worked out only when asked for.
    """

    t: float
    robots: tuple
    present: np.ndarray
    may_lead: np.ndarray
    trust: np.ndarray
    leader: int | None
    since: float
    dwell: float
    rng: np.random.Generator
    memory: dict
    loop: Any = field(repr=False)

    @cached_property
    def positions(self) -> np.ndarray:
        """
        Where the robots are when this is first asked for [m], shape (N, 3); ∞ for absent ones,
        never the nearest.
        """
        return np.where(self.present[:, None], self.loop.positions, np.inf)

    @property
    def free(self) -> bool:
        """
        Whether another robot may take over: there is no leader, it may not lead any more, or it has
        led for τ_min.
        """
        leads = self.leader is not None and self.may_lead[self.leader]
        return not leads or self.t - self.since >= self.dwell - SLACK


class LeaderPolicy(Protocol):
    """Anything with a `title` and a method `leader`, called every 0.1 s."""

    title: str

    def leader(self, now: TeamSituation) -> int:
        """
        Return the number of the robot that leads from now on.

        Parameters
        ----------
        now : TeamSituation
            Time, trust, who is present, who leads since when; `now.memory` is the policy's to write
            to.
        """


@dataclass(frozen=True)
class MostTrusted(Checked):
    """
    The robot that is trusted most leads, as soon as the present leader has stayed for τ_min
    (Section 4.3).

    Parameters
    ----------
    margin : float
        By how much another robot must be trusted more before it takes over (hysteresis); 0 as
        printed.

    Raises
    ------
    ValueError
        If the margin is negative.
    """

    margin: NotNegative = 0.0

    @property
    def title(self) -> str:
        """What it is, for the log."""
        return f"most trusted, hysteresis {self.margin:g}" if self.margin else "most trusted"

    def leader(self, now: TeamSituation) -> int:
        """
        Return the number of the robot that leads from now on.

        Parameters
        ----------
        now : TeamSituation
            Time, trust, who is present, who leads since when.
        """
        leader, best = now.leader, int(now.trust.argmax())
        if leader is None or (now.free and now.trust[best] > now.trust[leader] + self.margin):
            return best
        return leader


@dataclass(frozen=True)
class GivenSequence:
    """
    Robots lead in a given order.

    Parameters
    ----------
    robots : sequence, optional
        Names of the robots as the graph has them; all who may lead in turn when not given.
    times : array_like, shape (S,), optional
        When each begins to lead [s], the first at 0. When not given, each leads for 2 τ_min, and
        the sequence repeats.

    Raises
    ------
    ValueError
        If robots are no list, or times do not fit them; later, in `leader`, if a robot does not
        exist.
    """

    robots: Sequence[Hashable] | None = None
    times: Sequence[float] | None = None
    title = "given sequence"

    def __post_init__(self):
        if self.robots is not None:
            names = tuple(list_of("robots", self.robots))
            if not names:
                raise ValueError("robots must be a list of at least one name, got none")
            object.__setattr__(self, "robots", names)
        if self.times is not None:
            if self.robots is None:
                raise ValueError("times need robots: who leads from each of them on")
            times = finite_array("times", self.times, length=len(self.robots))
            if times[0] != 0.0 or (np.diff(times) <= 0.0).any():
                raise ValueError(f"times must begin at 0 and increase, got {times.tolist()}")

    def leader(self, now: TeamSituation) -> int:
        """
        Return the number of the robot that leads from now on.

        Parameters
        ----------
        now : TeamSituation
            Time, and names of the robots.
        """
        able = [now.robots[i] for i in np.flatnonzero(now.may_lead)]
        robots = able if self.robots is None else self.robots
        for name in robots:
            if name not in now.robots:
                raise ValueError(
                    f"the policy names robot {name!r}, which does not exist; robots are "
                    f"{list(now.robots)}"
                )
        if self.times is None:
            turn = int((now.t + SLACK) / (2.0 * now.dwell)) % len(robots)
        else:
            turn = bisect_right(self.times, now.t + SLACK) - 1
        return now.robots.index(robots[turn])


@dataclass(frozen=True)
class RandomLeaders(Checked):
    """
    Any other robot takes over at any time once τ_min has passed.

    Parameters
    ----------
    waiting : float
        Mean time beyond τ_min until the next switch, in units of τ_min; exponential.

    Raises
    ------
    ValueError
        If it is negative.
    """

    waiting: NotNegative = 1.0
    title = "arbitrary random"

    def leader(self, now: TeamSituation) -> int:
        """
        Return the number of the robot that leads from now on.

        Parameters
        ----------
        now : TeamSituation
            Time, and who may lead; its memory keeps when the leader goes.
        """
        leader, until = now.leader, now.memory.get("until", now.since + now.dwell)
        if leader is not None and now.may_lead[leader] and now.t < until - SLACK:
            return leader
        robots = np.arange(len(now.robots))
        others = robots if leader is None else (leader + 1 + robots[:-1]) % robots.size
        others = others[now.may_lead[others]]
        if not others.size:
            return leader
        chosen = others[now.rng.integers(others.size)]
        now.memory["until"] = now.t + now.dwell * (1.0 + now.rng.exponential(self.waiting))
        return int(chosen)


# Policies by name.
POLICIES = {
    "most_trusted": MostTrusted(),
    "hysteresis": MostTrusted(margin=0.1),
    "sequence": GivenSequence(),
    "random": RandomLeaders(),
}


def policy_named(policy: str | LeaderPolicy) -> Any:
    """Return a leader policy by name, or a user's object as it is."""
    decides = callable(getattr(policy, "leader", None)) and hasattr(policy, "title")
    if decides and not isinstance(policy, type):
        return policy
    also = "an object, not a class, with a title and a method leader(now)"
    return POLICIES[one_of("policy", policy, POLICIES, also)]
