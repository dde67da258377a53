"""How well a robot does, as (4.1) takes it: measured from its motion and from what reaches it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from trustlab.models.checks import one_of
from trustlab.models.compiled import njit
from trustlab.models.simulation import PartError

# Performance that is drawn at random and says nothing of the robots: for tests of theorems.
RANDOM = "random"
# Below these, motion [m/s] and distances [m] are rounding, and there is nothing to judge by.
LEAST_SPEED = 1e-6
LEAST_DISTANCE = 1e-6


@dataclass(frozen=True, eq=False)
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
    command : numpy.ndarray, shape (3,)
        g r_s, the velocity that the leader was sent in the last sample [m/s].
    received : float
        Share of the packets to the leader, since the decision before, that arrived.
    read : callable
        Computes `positions`, `velocities` and `asked`, only when asked for.
    """

    t: float
    leader: int
    present: np.ndarray
    adjacency: np.ndarray
    command: np.ndarray
    received: float
    read: Callable[[str], np.ndarray] = field(repr=False)

    @cached_property
    def positions(self) -> np.ndarray:
        """Where the robots are [m], shape (N, 3)."""
        return self.read("positions")

    @cached_property
    def velocities(self) -> np.ndarray:
        """How they moved in the last sample [m/s], shape (N, 3)."""
        return self.read("velocities")

    @cached_property
    def asked(self) -> np.ndarray:
        """How a faultless robot moves in their places by (4.22) [m/s], shape (N, 3)."""
        return self.read("asked")


@njit(error_model="numpy")
def rate_move(velocity, asked):
    """Return 1 − ‖v − v̂‖/(‖v‖ + ‖v̂‖) of one robot; NaN where nothing moves."""
    off = moved = wanted = 0.0
    for i in range(3):
        off += (velocity[i] - asked[i]) ** 2
        moved += velocity[i] ** 2
        wanted += asked[i] ** 2
    moving = np.sqrt(moved) + np.sqrt(wanted)
    if not moving > LEAST_SPEED:
        return np.nan
    return np.rint(1000.0 * (1.0 - np.sqrt(off) / moving)) / 1000.0


@njit(error_model="numpy")
def rate_moves(velocities, asked):
    """Return the same of every robot."""
    rated = np.empty(len(velocities))
    for robot in range(rated.size):
        rated[robot] = rate_move(velocities[robot], asked[robot])
    return rated


@njit(error_model="numpy")
def with_packets(rated, received):
    """Return how well the leader moves, times the share of its packets that arrived."""
    return received if np.isnan(rated) else rated * received


def tracking(motion: Motion) -> np.ndarray:
    """
    Return how well robots move as (4.22) asks, 1 − ‖v − v̂‖/(‖v‖ + ‖v̂‖); NaN where nothing moves.

    A robot of speed s has 2 s/(1 + s), one that does not move 0. Rated in steps of 0.001, so that
    no two faultless robots differ by their rounding.

    Parameters
    ----------
    motion : Motion
        What is measured.
    """
    return rate_moves(motion.velocities, motion.asked)


def packets(motion: Motion) -> np.ndarray:
    """
    Return the share of the leader's packets that arrived; NaN for others, to whom none are sent.

    Parameters
    ----------
    motion : Motion
        What is measured.
    """
    out = np.full(len(motion.present), np.nan)
    out[motion.leader] = motion.received
    return out


def cohesion(motion: Motion) -> np.ndarray:
    """
    Return how near robots are to the mean of those they see, d̄/(d̄ + d) with the team's mean d̄.

    Rated in steps of 0.001; NaN where all have met. A leader runs ahead and loses by it.

    Parameters
    ----------
    motion : Motion
        What is measured.
    """
    here = motion.present
    weights = motion.adjacency / np.maximum(motion.adjacency.sum(axis=1, keepdims=True), 1e-300)
    mean = weights[:, here] @ motion.positions[here]
    away = np.linalg.norm(motion.positions - mean, axis=1)
    usual = float(away[here].mean())
    if usual < LEAST_DISTANCE:
        return np.full(len(here), np.nan)
    return np.round(usual / (usual + away), 3)


def motion(motion: Motion) -> np.ndarray:
    """
    Return how well robots move as (4.22) asks, the leader's times the packets that arrived.

    Parameters
    ----------
    motion : Motion
        What is measured.
    """
    rated = tracking(motion)
    rated[motion.leader] = with_packets(rated[motion.leader], motion.received)
    return rated


# Measures by name.
MEASURES = {"motion": motion, "tracking": tracking, "cohesion": cohesion, "packets": packets}


def measure_named(performance: str | Callable) -> Callable | None:
    """Return a measure by name, or a user's function as it is; None for one at random."""
    if callable(performance):
        return performance
    also = "a function of Motion that returns one number per robot"
    named = one_of("performance", performance, (*MEASURES, RANDOM), also)
    return MEASURES.get(named)


def measured(measure: Callable, now: Motion) -> np.ndarray:
    """Return what a measure says, shape (N,), checked: from 0 to 1, NaN where it says nothing."""
    where = f"the measure of performance {getattr(measure, '__name__', measure)!r}"
    try:
        values = np.asarray(measure(now), dtype=float)
    except Exception as error:
        raise PartError(
            f"{where} raised {type(error).__name__}: {error}, at {now.t:g} s"
        ) from error
    size = len(now.present)
    if values.shape != (size,):
        raise PartError(f"{where} must return {size} numbers, got shape {values.shape}")
    off = (values < 0.0) | (values > 1.0)
    if off.any():
        robot = int(np.argmax(off))
        raise PartError(
            f"{where} must be from 0 to 1, or NaN where it says nothing, but at {now.t:g} s it is "
            f"{values[robot]:g} for robot {robot}"
        )
    return np.where(now.present, values, np.nan)
