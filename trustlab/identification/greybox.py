"""The three grey-box problems: which parameters there are, how they are searched, what they predict."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from trustlab.identification.least_squares import Normal
from trustlab.identification.sensitivities import (
    EDGE,
    human_sensitivities,
    joint_sensitivities,
    robot_sensitivities,
)
from trustlab.identification.traces import Trace

__all__ = ["HUMAN", "JOINT", "ROBOT", "Predictions", "Problem", "Structure"]

UNIT_MARGIN = 1e-9
"""How near to 0 and 1 a parameter of (0, 1) may come during the search."""


@dataclass(frozen=True)
class Structure:
    """
    A model structure: shared parameters, one initial state or more per run, outputs.

    Parameters
    ----------
    shared : tuple of str
        Names of the parameters that all runs share.
    initial : tuple of str
        Names of each run's own initial states.
    outputs : tuple of str
        Columns that are predicted.
    maps : tuple of str
        How each of them is searched: "rate" (−ln(1 − x)), "logit", "rest" (a power, see `Problem`) or "plain".
    moves : tuple of tuple of int
        For each output, the numbers of the parameters that move it: the columns of its Jacobian.
    """

    shared: tuple[str, ...]
    initial: tuple[str, ...]
    outputs: tuple[str, ...]
    maps: tuple[str, ...]
    moves: tuple[tuple[int, ...], ...]

    def bounds(self, name: str) -> tuple[float, float]:
        """
        Return the widest bounds of a parameter.

        Parameters
        ----------
        name : str
            One of `shared` or `initial`.
        """
        kind = dict(zip(self.shared + self.initial, self.maps, strict=True))[name]
        if kind in ("rate", "logit"):
            return UNIT_MARGIN, 1.0 - UNIT_MARGIN
        return (0.0, 1.0) if kind == "rest" else (-np.inf, np.inf)


ROBOT = Structure(
    ("a", "p_min", "p_max"), ("p_r0",), ("p_r",), ("rate", "plain", "plain", "plain"), ((0, 1, 2, 3),)
)
HUMAN = Structure(
    ("a", "beta", "p_min", "p_max"),
    ("r0",),
    ("p_h",),
    ("rate", "logit", "plain", "plain", "rest"),
    ((0, 1, 2, 3, 4),),
)
JOINT = Structure(
    ("human_a", "human_beta", "human_p_min", "human_p_max", "robot_a", "robot_p_min", "robot_p_max"),
    ("r0", "p_r0"),
    ("p_h", "p_r"),
    ("rate", "logit", "plain", "plain", "rate", "plain", "plain", "rest", "plain"),
    ((0, 1, 2, 3, 7), tuple(range(9))),
)


@dataclass(frozen=True, eq=False)
class Predictions:
    """
    What a structure predicts for one run.

    Parameters
    ----------
    outputs : tuple of numpy.ndarray, each of shape (N,)
        Predicted columns.
    jacobians : tuple of numpy.ndarray
        Their derivatives by those parameters and initial states of this run that move them (`Structure.moves`).
    """

    outputs: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]


def _to_search(kinds: tuple[str, ...], theta: np.ndarray, power: float) -> np.ndarray:
    x = np.array(theta, dtype=float)
    for j, kind in enumerate(kinds):
        if kind == "rate":
            x[j] = -np.log1p(-theta[j])
        elif kind == "logit":
            x[j] = np.log(theta[j]) - np.log1p(-theta[j])
        elif kind == "rest":
            x[j] = theta[j] ** power
    return x


def _from_search(kinds: tuple[str, ...], x: np.ndarray, power: float) -> tuple[np.ndarray, np.ndarray]:
    theta, slope = np.array(x, dtype=float), np.ones(len(x))
    for j, kind in enumerate(kinds):
        if kind == "rate":
            slope[j] = np.exp(-x[j])
            theta[j] = -np.expm1(-x[j])
        elif kind == "logit":
            theta[j] = 1.0 / (1.0 + np.exp(-x[j]))
            slope[j] = theta[j] * (1.0 - theta[j])
        elif kind == "rest":
            theta[j] = x[j] ** (1.0 / power)
            slope[j] = max(x[j], EDGE**power) ** (1.0 / power - 1.0) / power
    return theta, slope


@dataclass(eq=False)
class Problem:
    """
    A structure with the runs it is to explain.

    Parameters
    ----------
    structure : Structure
        ROBOT, HUMAN or JOINT.
    runs : list of Trace
        The data.
    p_h_max : float
        Greatest human performance, for ROBOT.
    power : float
        Initial utilization is searched as r0 ** power. Near rest (2.6) grows as r ** β, so a power near β makes the
        likelihood smooth there.
    buffers : list
        Work arrays per run, kept between evaluations.
    """

    structure: Structure
    runs: list[Trace]
    p_h_max: float = 1.0
    power: float = 0.75
    buffers: list = field(default_factory=list)

    def __post_init__(self):
        for run in self.runs:
            n = run.mode.size
            self.buffers.append([(np.empty(n), np.empty((n, len(own)))) for own in self.structure.moves])
        measured = [
            np.concatenate([getattr(run, name) for run in self.runs]) for name in self.structure.outputs
        ]
        self.where = [self.columns(i) for i in range(len(self.runs))]
        self.counts = np.array([values.size for values in measured], dtype=float)
        scale = [max(float(np.sqrt(np.mean(values**2))), 1e-300) for values in measured]
        self.floors = self.counts * (1e-9 * np.array(scale)) ** 2

    @property
    def kinds(self) -> tuple[str, ...]:
        """How each coordinate of the search vector is mapped."""
        shared = len(self.structure.shared)
        return self.structure.maps[:shared] + self.structure.maps[shared:] * len(self.runs)

    @property
    def names(self) -> list[str]:
        """Names of all coordinates; initial states carry the number of their run."""
        many = len(self.runs) > 1
        own = [
            f"{name}[{i}]" if many else name for i in range(len(self.runs)) for name in self.structure.initial
        ]
        return [*self.structure.shared, *own]

    def columns(self, run: int) -> np.ndarray:
        """
        Return where the parameters and one run's initial states stand in the full vector.

        Parameters
        ----------
        run : int
            Number of the run.
        """
        shared, own = len(self.structure.shared), len(self.structure.initial)
        return np.r_[0:shared, shared + run * own : shared + (run + 1) * own]

    def predict(self, run: int, theta: np.ndarray) -> Predictions:
        """
        Simulate one run; the arrays returned are overwritten by the next call for the same run.

        Parameters
        ----------
        run : int
            Number of the run.
        theta : numpy.ndarray, shape (p,)
            The full vector of parameters.
        """
        own, trace, buffers = theta[self.where[run]], self.runs[run], self.buffers[run]
        if self.structure is ROBOT:
            (p_r, jacobian) = buffers[0]
            robot_sensitivities(
                trace.mode, trace.p_h, own[0], own[1], own[2], self.p_h_max, own[3], p_r, jacobian
            )
        elif self.structure is HUMAN:
            (p_h, jacobian) = buffers[0]
            human_sensitivities(trace.mode, own[0], own[1], own[2], own[3], own[4], p_h, jacobian)
        else:
            (p_h, by_human), (p_r, by_robot) = buffers
            joint_sensitivities(trace.mode, own[:4], own[4:7], own[7], own[8], p_h, p_r, by_human, by_robot)
        return self.latest(run)

    def latest(self, run: int) -> Predictions:
        """
        Return what `predict` gave last for one run.

        Parameters
        ----------
        run : int
            Number of the run.
        """
        buffers = self.buffers[run]
        return Predictions(tuple(b[0] for b in buffers), tuple(b[1] for b in buffers))

    def normal(self, theta: np.ndarray) -> Normal:
        """
        Accumulate the likelihood's gradient and Gauss–Newton matrix over all runs.

        Parameters
        ----------
        theta : numpy.ndarray, shape (p,)
            The full vector of parameters.
        """
        p, outputs = theta.size, len(self.structure.outputs)
        squares, gradients, matrices = np.zeros(outputs), np.zeros((outputs, p)), np.zeros((outputs, p, p))
        for i, run in enumerate(self.runs):
            predicted = self.predict(i, theta)
            for j, name in enumerate(self.structure.outputs):
                error = getattr(run, name) - predicted.outputs[j]
                jacobian = predicted.jacobians[j]
                squares[j] += error @ error
                where = self.where[i][list(self.structure.moves[j])]
                gradients[j, where] += error @ jacobian
                matrices[j][where[:, None], where] += jacobian.T @ jacobian
        weights = self.counts / (squares + self.floors)
        value = float(self.counts @ np.log(squares + self.floors))
        exact = bool((squares <= 1e-6 * self.floors).all())
        return Normal(value, weights @ gradients, np.einsum("i,ijk", weights, matrices), squares, exact)

    def search_normal(self, x: np.ndarray) -> Normal:
        """
        Return `normal` in the coordinates of the search.

        Parameters
        ----------
        x : numpy.ndarray, shape (p,)
            The full vector of search coordinates.
        """
        theta, slope = _from_search(self.kinds, x, self.power)
        at = self.normal(theta)
        return replace(at, gradient=at.gradient * slope, matrix=at.matrix * np.outer(slope, slope))

    def to_search(self, theta: np.ndarray) -> np.ndarray:
        """
        Return search coordinates of parameters.

        Parameters
        ----------
        theta : numpy.ndarray, shape (p,)
            The full vector of parameters.
        """
        return _to_search(self.kinds, theta, self.power)

    def from_search(self, x: np.ndarray) -> np.ndarray:
        """
        Return parameters of search coordinates.

        Parameters
        ----------
        x : numpy.ndarray, shape (p,)
            The full vector of search coordinates.
        """
        return _from_search(self.kinds, x, self.power)[0]
