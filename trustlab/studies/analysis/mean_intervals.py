"""Means with intervals: between subjects, and within subjects after Cousineau and Morey."""

from __future__ import annotations

import numpy as np
from scipy import special

__all__ = ["between_half_width", "cousineau_morey_half_width"]


def between_half_width(scores: np.ndarray, level: float = 0.95) -> np.ndarray:
    """
    Return t · s_j / √n of each condition's own scores.

    Parameters
    ----------
    scores : numpy.ndarray, shape (n, k)
        Complete scores.
    level : float
        Coverage.

    Returns
    -------
    numpy.ndarray, shape (k,)
    """
    n = scores.shape[0]
    return special.stdtrit(n - 1, 0.5 + 0.5 * level) * scores.std(axis=0, ddof=1) / np.sqrt(n)


def cousineau_morey_half_width(scores: np.ndarray, level: float = 0.95) -> np.ndarray:
    """
    Return t · s′_j / √n, s′ of scores less the subject's mean, times √(k/(k − 1)).

    Removing the subjects' means (Cousineau, 2005) leaves the spread that a within-subject comparison sees; the factor
    (Morey, 2008) undoes the shrinking that this brings. For k = 2 the interval is 1/√2 of the paired difference's.

    Parameters
    ----------
    scores : numpy.ndarray, shape (n, k)
        Complete scores.
    level : float
        Coverage.

    Returns
    -------
    numpy.ndarray, shape (k,)
    """
    k = scores.shape[1]
    centred = scores - scores.mean()
    return between_half_width(centred - centred.mean(axis=1, keepdims=True), level) * np.sqrt(k / (k - 1.0))
