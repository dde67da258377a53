"""Newton's last steps to an optimum, so that no digit of it hangs on where a search stopped."""

from collections.abc import Callable

import numpy as np

Slope = Callable[[np.ndarray], np.ndarray]

STEPS = 20
STEP = 1e-2  # of the differences that make a Hessian, whose error falls with its fourth power


def polished(slope: Slope, point: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the root of the slope next to a point, in its free coordinates, and the Hessian there.
    """
    hessian = _hessian(slope, point, free)
    here = slope(point)[free]
    for _ in range(STEPS):
        candidate = point.copy()
        candidate[free] -= np.linalg.lstsq(hessian, here)[0]
        there = slope(candidate)[free]
        if not np.abs(there).max(initial=0.0) < np.abs(here).max(initial=0.0):
            break
        point, here = candidate, there
    return point, hessian


def _hessian(slope: Slope, point: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the second derivatives along the free coordinates, by differences of the slope."""
    hessian = np.empty((free.size, free.size))
    for column, coordinate in enumerate(free):
        step = np.zeros(point.size)
        step[coordinate] = STEP * max(1.0, abs(point[coordinate]))
        near = slope(point + step) - slope(point - step)
        far = slope(point + 2.0 * step) - slope(point - 2.0 * step)
        hessian[:, column] = (8.0 * near - far)[free] / (12.0 * step[coordinate])
    return hessian
