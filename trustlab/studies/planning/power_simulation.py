"""Simulated studies counted: how many find the effect, and how many find which pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trustlab.models.checks import did_you_mean
from trustlab.studies.analysis.batch import repeated_measures_batch
from trustlab.studies.analysis.sphericity import CORRECTIONS
from trustlab.studies.planning.covariances import Conditions

__all__ = ["ADJUSTMENTS", "TESTS", "Counts", "claims_mask", "count_findings"]

TESTS = (*CORRECTIONS, "auto")
"""Corrections of the omnibus F; "auto" is that of `repeated_measures`: Greenhouse–Geisser where Mauchly's test rejects."""

ADJUSTMENTS = {"none": "p", "bonferroni": "p_bonferroni", "holm": "p_holm"}
"""Adjustments of the pairs' p-values, and their names in `PairwiseBatch`."""

_CHUNK = 1 << 20
"""Scores drawn at a time, so that memory does not grow with the number of replicates."""


@dataclass(frozen=True, eq=False)
class Counts:
    """
    How many of the simulated studies were significant.

    Parameters
    ----------
    omnibus : dict of str to int
        By correction, those of `TESTS`.
    pairs : dict of str to numpy.ndarray of int, shape (pairs,)
        By adjustment, pairs a < b in order.
    claims : dict of str to int
        By adjustment: F under "auto" and every claimed pair, in the claimed direction.
    claims_found : dict of str to int
        By adjustment: claimed pairs found, summed over studies.
    """

    omnibus: dict[str, int]
    pairs: dict[str, np.ndarray]
    claims: dict[str, int]
    claims_found: dict[str, int]


def count_findings(
    conditions: Conditions,
    n: int,
    replicates: int,
    alpha: float,
    seed: np.random.SeedSequence,
    claims: np.ndarray | None = None,
) -> Counts:
    """
    Draw studies from a normal population, analyse each, and count.

    Parameters
    ----------
    conditions : Conditions
        The population.
    n : int
        Subjects of each study.
    replicates : int
        Studies.
    alpha : float
        Level of every test, Mauchly's too.
    seed : numpy.random.SeedSequence
        Of the draws.
    claims : numpy.ndarray of bool, shape (pairs,), optional
        Pairs that must be found together.
    """
    rng = np.random.default_rng(seed)
    k = len(conditions.mean)
    root = np.linalg.cholesky(conditions.covariance).T
    a, b = np.triu_indices(k, 1)
    expected = np.sign(conditions.mean[a] - conditions.mean[b])
    omnibus = dict.fromkeys(TESTS, 0)
    pairs = {name: np.zeros(a.size, dtype=np.int64) for name in ADJUSTMENTS}
    together, found = dict.fromkeys(ADJUSTMENTS, 0), dict.fromkeys(ADJUSTMENTS, 0)
    step = max(1, _CHUNK // (n * k))
    for first in range(0, replicates, step):
        studies = min(step, replicates - first)
        scores = rng.standard_normal((studies, n, k)) @ root + conditions.mean
        batch = repeated_measures_batch(scores)
        rejected = ~(batch.mauchly_p >= alpha) if k > 2 else np.zeros(studies, dtype=bool)
        p_values = (batch.p, batch.p_gg, batch.p_hf, np.where(rejected, batch.p_gg, batch.p))
        for name, p in zip(TESTS, p_values, strict=True):
            omnibus[name] += int((p < alpha).sum())
        significant = p_values[-1] < alpha
        for name, attribute in ADJUSTMENTS.items():
            hits = getattr(batch.pairwise, attribute) < alpha
            pairs[name] += hits.sum(axis=0)
            if claims is not None:
                right = hits & (np.sign(batch.pairwise.mean_difference) == expected)
                together[name] += int((right[:, claims].all(axis=1) & significant).sum())
                found[name] += int(right[:, claims].sum())
    return Counts(omnibus, pairs, together, found)


def claims_mask(claims, conditions: Conditions) -> np.ndarray | None:
    """
    Return which pairs are claimed, over all pairs a < b.

    Parameters
    ----------
    claims : sequence of (a, b) or None
        Pairs of labels.
    conditions : Conditions
        Whose labels.

    Raises
    ------
    ValueError
        If a pair is no pair, its labels are unknown, or it is there twice.
    """
    if claims is None:
        return None
    labels = list(conditions.labels)
    places = {pair: i for i, pair in enumerate(zip(*np.triu_indices(len(labels), 1), strict=True))}
    mask = np.zeros(len(places), dtype=bool)
    if isinstance(claims, str | bytes) or not hasattr(claims, "__iter__"):
        raise ValueError(f"claims must be a list of pairs of conditions, got {claims!r:.60}")
    for pair in claims:
        if isinstance(pair, str) or not hasattr(pair, "__len__") or len(pair) != 2 or pair[0] == pair[1]:
            raise ValueError(f"a comparison is a pair of two conditions (a, b), got {pair!r:.60}")
        for label in pair:
            if label not in labels:
                raise ValueError(
                    f"unknown condition {label!r}{did_you_mean(label, labels)} (there are {', '.join(map(str, labels))})"
                )
        where = places[tuple(sorted(labels.index(label) for label in pair))]
        if mask[where]:
            raise ValueError(f"pair {pair!r} is claimed twice")
        mask[where] = True
    if not mask.any():
        raise ValueError("claims is empty: give pairs of conditions, or leave it out")
    return mask
