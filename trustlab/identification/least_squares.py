"""Bounded nonlinear least squares on accumulated normal equations (Gauss–Newton with Levenberg–Marquardt damping)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

__all__ = ["Minimum", "Normal", "minimise"]


@dataclass(frozen=True)
class Normal:
    """
    A likelihood's value with its gradient and Gauss–Newton matrix at one point.

    Parameters
    ----------
    value : float
        Σ over outputs of n ln(Σ e²), the concentrated Gaussian likelihood.
    gradient : numpy.ndarray, shape (p,)
        Σ over outputs of w Jᵀe with w = n/Σ e²: minus half the derivative of `value`.
    matrix : numpy.ndarray, shape (p, p)
        Σ over outputs of w JᵀJ.
    squares : numpy.ndarray, shape (outputs,)
        Σ e² of every output.
    exact : bool
        Whether the outputs are reproduced to rounding, so that no search can come nearer.
    """

    value: float
    gradient: np.ndarray
    matrix: np.ndarray
    squares: np.ndarray
    exact: bool = False


@dataclass(frozen=True)
class Minimum:
    """
    Where a search ended.

    Parameters
    ----------
    x : numpy.ndarray, shape (p,)
        The point.
    normal : Normal
        Value, gradient and matrix there.
    at_bound : numpy.ndarray of bool, shape (p,)
        Which coordinates a bound holds.
    converged : bool
        Whether the point is a minimum within the bounds.
    iterations : int
        Number of evaluations.
    """

    x: np.ndarray
    normal: Normal
    at_bound: np.ndarray
    converged: bool
    iterations: int


def minimise(
    evaluate: Callable[[np.ndarray], Normal],
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    tolerance: float = 1e-12,
    max_iterations: int = 200,
) -> Minimum:
    """
    Minimise a Gaussian likelihood within bounds.

    Parameters
    ----------
    evaluate : callable
        Takes a point, shape (p,), and returns its Normal.
    start, lower, upper : numpy.ndarray, shape (p,)
        Starting point and bounds; equal bounds fix a coordinate.
    tolerance : float
        The search ends when a step promises to lower the value by less than this (a step of √tolerance standard
        errors), or when six evaluations gain less than 1e-4 (a hundredth of a standard error).
    max_iterations : int
        Most evaluations.

    Returns
    -------
    Minimum
    """
    x = np.clip(start, lower, upper)
    now = evaluate(x)
    damping, iterations, history = 1e-4, 1, [now.value]
    pinned, refused, released = np.zeros(x.size, dtype=bool), 0, np.inf
    while True:
        diagonal = np.diag(now.matrix)
        held = (
            ((x <= lower) & (now.gradient <= 0.0))
            | ((x >= upper) & (now.gradient >= 0.0))
            | (diagonal <= 0.0)
            | pinned
        )
        free = np.flatnonzero(~held)
        done = free.size == 0
        if not done:
            scale = np.sqrt(diagonal[free])
            matrix = now.matrix[np.ix_(free, free)] / np.outer(scale, scale)
            gradient = now.gradient[free] / scale
            values, vectors = np.linalg.eigh(matrix)
            along, known = gradient @ vectors, values > 1e-14 * values[-1]
            promised = float(along[known] @ (along[known] / values[known]))
            # A kink, as of (2.6) at r = 0, defies any quadratic model: stop where six evaluations gained nothing.
            stalled = len(history) > 12 and promised < 1.0 and history[-7] - history[-1] < 1e-4
            done = stalled or promised <= (1e-3 if now.exact else tolerance)
        if done and pinned.any() and released - now.value > 1e-4:
            released, pinned, damping, refused = now.value, np.zeros(x.size, dtype=bool), 1e-4, 0
            continue
        if done or iterations >= max_iterations or damping > 1e14:
            bound = (lower < upper) & (
                ((x <= lower) & (now.gradient <= 0.0)) | ((x >= upper) & (now.gradient >= 0.0)) | pinned
            )
            return Minimum(x, now, bound, bool(done), iterations)
        step = np.zeros_like(x)
        step[free] = vectors @ (along / (np.maximum(values, 0.0) + damping)) / scale
        trial = np.clip(x + step, lower, upper)
        new = evaluate(trial)
        iterations += 1
        # Below a thousandth of a standard error the value's last digits are rounding: trust the step, not the value.
        slack = 1e-6 if promised < 1e-6 else 0.0
        if np.isfinite(new.value) and new.value < now.value + slack:
            x, now, damping, refused = trial, new, max(damping / 10.0, 1e-12), 0
        else:
            damping, refused = max(damping * 5.0, 1e-6), refused + 1
            on_edge = ~held & ((x <= lower) | (x >= upper))
            if refused >= 8 and on_edge.any():
                # The slope at a bound promises what no step away from it keeps (a kink): hold it there.
                pinned, damping, refused = pinned | on_edge, 1e-4, 0
        history.append(now.value)
