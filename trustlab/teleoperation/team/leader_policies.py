"""
Who leads: leader policies as small objects, all with a minimum dwell time, and each switch to
another robot.
"""

import itertools
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

import numpy as np

from trustlab.models.checks import finite_array, not_negative, one_of, positive, set_checked
from trustlab.models.compiled import njit

# Times [s] so near each other are the same.
SLACK = 1e-9


@dataclass(frozen=True, eq=False)
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
    trust : numpy.ndarray, shape (N,)
        Human-to-robot trust (4.1) now; −inf for absent robots, so that argmax never picks them.
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
    where : callable
        Computes `positions`, only when asked for.
    """

    t: float
    robots: tuple
    present: np.ndarray
    trust: np.ndarray
    leader: int | None
    since: float
    dwell: float
    rng: np.random.Generator
    memory: dict = field(repr=False)
    where: Callable[[], np.ndarray] = field(repr=False)

    @property
    def positions(self) -> np.ndarray:
        """Where the robots are [m], shape (N, 3)."""
        return self.where()

    @property
    def free(self) -> bool:
        """
        Whether another robot may take over: there is no leader, it has left, or it has led for
        τ_min.
        """
        return (
            self.leader is None
            or not self.present[self.leader]
            or self.t - self.since >= self.dwell - SLACK
        )


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


@njit(error_model="numpy")
def most_trusted(trust, leader, free, margin):
    """
    Return who leads next: the most trusted robot where the present leader, −1 for none, is free to
    go and trusted less by more than a margin.
    """
    best = 0
    for robot in range(1, trust.size):
        if trust[robot] > trust[best]:
            best = robot
    if leader < 0:
        return best
    return best if free and trust[best] > trust[leader] + margin else leader


@dataclass(frozen=True)
class MostTrusted:
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

    margin: float = 0.0

    def __post_init__(self):
        set_checked(self, not_negative, "margin")

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
        leader = -1 if now.leader is None else now.leader
        return most_trusted(now.trust, leader, now.free, self.margin)


@dataclass(frozen=True)
class GivenSequence:
    """
    Robots lead in a given order.

    Parameters
    ----------
    robots : sequence, optional
        Names of the robots as the graph has them; all of them in turn when not given.
    times : array_like, shape (S,), optional
        When each begins to lead [s], the first at 0.
    every : float, optional
        How long each leads [s] if `times` is not given; the sequence then repeats. By default 2
        τ_min.

    Raises
    ------
    ValueError
        If a robot follows itself, times do not fit the robots, or both `times` and `every` are
        given; later, in `leader`, if a robot does not exist.
    """

    robots: Sequence[Hashable] | None = None
    times: Sequence[float] | None = None
    every: float | None = None
    title: ClassVar[str] = "given sequence"

    def __post_init__(self):
        if self.robots is not None:
            if isinstance(self.robots, str) or not np.iterable(self.robots):
                raise ValueError(f"robots must be a list of names, got {self.robots!r}")
            robots = tuple(self.robots)
            if not robots:
                raise ValueError("robots must name at least one robot")
            object.__setattr__(self, "robots", robots)
            for place, (before, robot) in enumerate(itertools.pairwise(robots), start=1):
                if robot == before:
                    raise ValueError(
                        f"a switch must pick another robot, but robots[{place}] is {robot!r} again"
                    )
        if self.times is not None:
            if self.every is not None or self.robots is None:
                raise ValueError("times need robots, and leave nothing for every to say")
            times = finite_array("times", self.times, length=len(self.robots))
            if times[0] != 0.0 or (np.diff(times) <= 0.0).any():
                raise ValueError(f"times must begin at 0 and increase, got {times.tolist()}")
            object.__setattr__(self, "times", tuple(times.tolist()))
        if self.every is not None:
            set_checked(self, positive, "every")
        again = self.times is None and self.robots is not None and len(self.robots) > 1
        if again and self.robots[0] == self.robots[-1]:
            raise ValueError(
                f"begun again, the sequence would have {self.robots[0]!r} follow itself"
            )

    def leader(self, now: TeamSituation) -> int:
        """
        Return the number of the robot that leads from now on.

        Parameters
        ----------
        now : TeamSituation
            Time, and names of the robots.
        """
        chosen = now.robots if self.robots is None else self.robots
        if self.times is not None:
            turn = int(np.searchsorted(self.times, now.t + SLACK, side="right")) - 1
        else:
            every = 2.0 * now.dwell if self.every is None else self.every
            turn = int((now.t + SLACK) / every) % len(chosen)
        for name in chosen:
            if name not in now.robots:
                raise ValueError(
                    f"the policy names robot {name!r}, which does not exist; robots are "
                    f"{list(now.robots)}"
                )
        return now.robots.index(chosen[turn])


@dataclass(frozen=True)
class RandomLeaders:
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

    waiting: float = 1.0
    title: ClassVar[str] = "arbitrary random"

    def __post_init__(self):
        set_checked(self, not_negative, "waiting")

    def leader(self, now: TeamSituation) -> int:
        """
        Return the number of the robot that leads from now on.

        Parameters
        ----------
        now : TeamSituation
            Time, and who is present; its memory keeps when the leader goes.
        """
        leader = now.leader
        if leader is not None and now.present[leader] and now.t < now.memory["until"] - SLACK:
            return leader
        robots = np.arange(len(now.robots))
        others = robots if leader is None else (leader + 1 + robots[:-1]) % robots.size
        others = others[now.present[others]]
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
