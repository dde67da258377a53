"""
What is decided of a team every 0.1 s: how well each robot did, how far it is trusted (4.1), and who
leads.
"""

from bisect import bisect_right
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, Protocol

import numpy as np

from trustlab.models.checks import finite_array, not_negative, one_of, positive, set_checked
from trustlab.models.compiled import njit
from trustlab.models.simulation import PartError
from trustlab.models.trust import trust_step
from trustlab.trust.driving import TrustCourse, TrustInLoop

# Times [s] so near each other are the same.
SLACK = 1e-9
# Below these, motion [m/s] and distances [m] are rounding, and there is nothing to judge by.
LEAST_SPEED = 1e-6
LEAST_DISTANCE = 1e-6


# --- how well robots did --------------------------------------------------------------------------


@dataclass(eq=False)
class Motion:
    """
    What is measured of the robots at a decision.

    Parameters
    ----------
    t : float
        Now [s].
    leader : int
        Who led until now.
    present : numpy.ndarray, shape (N,)
        Which robots are in the team.
    adjacency : numpy.ndarray, shape (N, N)
        a_ij: who sees whom.
    received : float
        Share of the packets to the leader, since the decision before, that arrived.
    read : callable
        Computes what the attributes below return, only when asked for.
    """

    t: float
    leader: int
    present: np.ndarray
    adjacency: np.ndarray
    received: float
    read: Callable[[str], np.ndarray] = field(repr=False)

    @property
    def command(self) -> np.ndarray:
        """Velocity g r_s that the leader was sent in the last sample [m/s], shape (3,)."""
        return self.read("command")

    @property
    def positions(self) -> np.ndarray:
        """Where the robots are [m], shape (N, 3)."""
        return self.read("positions")

    @property
    def velocities(self) -> np.ndarray:
        """How they moved in the last sample [m/s], shape (N, 3)."""
        return self.read("velocity")

    @property
    def asked(self) -> np.ndarray:
        """How a faultless robot moves in their places by (4.22) [m/s], shape (N, 3)."""
        return self.read("asked")


@njit(error_model="numpy")
def rate_moves(velocities, asked, leader=-1, received=1.0):
    """
    Return 1 − ‖v − v̂‖/(‖v‖ + ‖v̂‖) of every robot, 2 s/(1 + s) for one of speed s; NaN where
    nothing moves. In steps of 0.001, so that no two faultless robots differ by their rounding.

    That of a leader counts times the share of the packets that it received, where it rests the
    share alone.
    """
    rated = np.full(len(velocities), np.nan)
    for robot in range(rated.size):
        off = moved = wanted = 0.0
        for i in range(3):
            off += (velocities[robot, i] - asked[robot, i]) ** 2
            moved += velocities[robot, i] ** 2
            wanted += asked[robot, i] ** 2
        moving = np.sqrt(moved) + np.sqrt(wanted)
        if moving > LEAST_SPEED:
            rated[robot] = np.rint(1000.0 * (1.0 - np.sqrt(off) / moving)) / 1000.0
    if leader >= 0:
        rated[leader] = received * (1.0 if np.isnan(rated[leader]) else rated[leader])
    return rated


def tracking(motion: Motion) -> np.ndarray:
    """Return how well robots move as (4.22) asks."""
    return rate_moves(motion.velocities, motion.asked)


def motion(motion: Motion) -> np.ndarray:
    """Return how well robots move as (4.22) asks, the leader's times the packets that arrived."""
    return rate_moves(motion.velocities, motion.asked, motion.leader, motion.received)


def packets(motion: Motion) -> np.ndarray:
    """Return the share of the leader's packets that arrived; to others none are sent."""
    robots = np.arange(len(motion.present))
    return np.where(robots == motion.leader, motion.received, np.nan)


def cohesion(motion: Motion) -> np.ndarray:
    """
    Return how near robots are to the mean of those they see, d̄/(d̄ + d) with the team's mean d̄.

    Rated in steps of 0.001; NaN where all have met. A leader runs ahead and loses by it.
    """
    here = motion.present
    weights = motion.adjacency / np.maximum(motion.adjacency.sum(axis=1, keepdims=True), 1e-300)
    mean = weights[:, here] @ motion.positions[here]
    away = np.linalg.norm(motion.positions - mean, axis=1)
    usual = float(away[here].mean())
    if usual < LEAST_DISTANCE:
        return np.full(len(here), np.nan)
    return np.round(usual / (usual + away), 3)


MEASURES = {"motion": motion, "tracking": tracking, "cohesion": cohesion, "packets": packets}
# Performance that is drawn and says nothing of the robots: for tests of theorems.
RANDOM = "random"


def measure_named(performance: str | Callable) -> Callable[[Motion], np.ndarray] | None:
    """Return a measure by name, or a user's function, checked; None for one at random."""
    if callable(performance):
        return partial(_measured, performance)
    also = "a function of Motion that returns one number per robot"
    return MEASURES.get(one_of("performance", performance, (*MEASURES, RANDOM), also))


def _measured(measure: Callable, now: Motion) -> np.ndarray:
    """Return what a user's measure says, shape (N,): from 0 to 1, NaN where it says nothing."""
    where = f"the measure of performance {getattr(measure, '__name__', measure)!r}"
    try:
        values = np.asarray(measure(now), dtype=float)
    except Exception as error:
        raise PartError(
            f"{where} raised {type(error).__name__}: {error}, at {now.t:g} s"
        ) from error
    if values.shape != now.present.shape:
        raise PartError(f"{where} must return {now.present.size} numbers, got shape {values.shape}")
    off = (values < 0.0) | (values > 1.0)
    if off.any():
        raise PartError(
            f"{where} must be from 0 to 1, or NaN where it says nothing, but at {now.t:g} s it is "
            f"{values[off][0]:g} for robot {np.argmax(off)}"
        )
    return values


# --- how far robots are trusted -------------------------------------------------------------------


@njit(error_model="numpy")
def step_trust(share, performance, decay, gain):
    """Step trust (4.1) in every robot, as a share of its range; it stays where none was judged."""
    for robot in range(share.size):
        if not np.isnan(performance[robot]):
            share[robot] = trust_step(share[robot], performance[robot], decay[robot], gain[robot])


class TeamTrust:
    """
    Human-to-robot trust in every robot, by (4.1) or by a model of trust; `share` is trust in its
    range.

    Parameters
    ----------
    robots : numpy.ndarray, shape (N,)
        Records of `kernel.ROBOT`.
    driver : TrustInLoop, optional
        The model.
    step : float
        Time from one decision to the next [s].
    """

    def __init__(self, robots: np.ndarray, driver: TrustInLoop | None, step: float):
        self._range = robots["low"], robots["span"]
        self._rates = robots["hr_decay"].copy(), robots["hr_gain"].copy()
        self.share = np.full(robots.size, driver.start if driver else 0.5)
        self._courses = [TrustCourse(driver, step) for _ in robots] if driver else []
        self.title = driver.model.name if driver else "(4.1)"

    @property
    def trust(self) -> np.ndarray:
        """Trust in every robot now, shape (N,)."""
        low, span = self._range
        return low + span * self.share

    def judge(self, performance: np.ndarray) -> None:
        """Go on to the next decision, after a performance of each robot, shape (N,)."""
        if self._courses:
            judged = zip(self._courses, performance, strict=True)
            self.share = np.array([course.step(value) for course, value in judged])
        else:
            step_trust(self.share, performance, *self._rates)


# --- who leads ------------------------------------------------------------------------------------


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
    read : callable
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
    read: Callable[[str], np.ndarray] = field(repr=False)

    @property
    def positions(self) -> np.ndarray:
        """Where the robots are [m], shape (N, 3)."""
        return self.read("positions")

    @property
    def free(self) -> bool:
        """
        Whether another robot may take over: there is no leader, it has left, or it has led for
        τ_min.
        """
        leads = self.leader is not None and self.present[self.leader]
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
        Names of the robots as the graph has them; all of them in turn when not given.
    times : array_like, shape (S,), optional
        When each begins to lead [s], the first at 0.
    every : float, optional
        How long each leads [s] if `times` is not given; the sequence then repeats. By default 2
        τ_min.

    Raises
    ------
    ValueError
        If robots are no list, times do not fit the robots, or both `times` and `every` are given;
        later, in `leader`, if a robot does not exist.
    """

    robots: Sequence[Hashable] | None = None
    times: Sequence[float] | None = None
    every: float | None = None
    title: ClassVar[str] = "given sequence"

    def __post_init__(self):
        if self.robots is not None:
            set_checked(self, _listed, "robots")
        if self.every is not None:
            set_checked(self, positive, "every")
        if self.times is not None:
            if self.every is not None or self.robots is None:
                raise ValueError("times need robots, and leave nothing for every to say")
            times = finite_array("times", self.times, length=len(self.robots))
            if times[0] != 0.0 or (np.diff(times) <= 0.0).any():
                raise ValueError(f"times must begin at 0 and increase, got {times.tolist()}")
            object.__setattr__(self, "times", tuple(times.tolist()))

    def leader(self, now: TeamSituation) -> int:
        """
        Return the number of the robot that leads from now on.

        Parameters
        ----------
        now : TeamSituation
            Time, and names of the robots.
        """
        robots = now.robots if self.robots is None else self.robots
        for name in robots:
            if name not in now.robots:
                raise ValueError(
                    f"the policy names robot {name!r}, which does not exist; robots are "
                    f"{list(now.robots)}"
                )
        t = now.t + SLACK
        if self.times is not None:
            turn = bisect_right(self.times, t) - 1
        else:
            turn = int(t / (self.every or 2.0 * now.dwell)) % len(robots)
        return now.robots.index(robots[turn])


def _listed(name: str, value: Any) -> tuple:
    """Return names of robots, one or more."""
    listed = () if isinstance(value, str) or not np.iterable(value) else tuple(value)
    if not listed:
        raise ValueError(f"{name} must be a list of names, at least one, got {value!r}")
    return listed


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
