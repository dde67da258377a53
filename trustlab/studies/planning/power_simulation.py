"""Simulated studies counted: how many find the effect, and how many find which pair."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.random import SeedSequence

from trustlab.models.checks import did_you_mean
from trustlab.studies.analysis.batch import repeated_measures_batch
from trustlab.studies.analysis.sphericity import CORRECTIONS
from trustlab.studies.planning.covariances import Conditions

# Corrections of the omnibus F; "auto" is Greenhouse–Geisser where Mauchly's test rejects.
TESTS = (*CORRECTIONS, "auto")

# The correction that `repeated_measures` makes by default.
USUAL_TEST = "greenhouse-geisser"

# Adjustments of the pairs' p-values, and their names in `PairwiseBatch`.
ADJUSTMENTS = {"none": "p", "bonferroni": "p_bonferroni", "holm": "p_holm"}

# Scores drawn at a time, so that memory does not grow with the number of replicates.
_CHUNK = 1 << 20


def run_counts(task: Callable, cells: Sequence[tuple], fixed: Mapping, where: Mapping) -> list[dict]:
    """Return what a task counts in each cell (population, n, draws), with the same further arguments for all."""
    from trustlab.campaign import CampaignError, run_campaign

    parameters = [{"population": population, "n": n, "draws": draws, **fixed} for population, n, draws in cells]
    done = run_campaign(task, parameters, **where)
    if done["failed"].any():
        raise CampaignError(f"studies could not be simulated: {done.loc[done['failed'], 'error'].iloc[0]}")
    return done.to_dict("records")


def count_findings(
    population: Conditions, n: int, draws: SeedSequence, replicates: int, alpha: float, claims: Any, seed: SeedSequence
) -> dict[str, int]:
    """
    Draw studies from a normal population, analyse each, and count those that are significant: a task of `run_campaign`.

    Keys: "F test" by `TESTS`; "pair i adjustment", pairs a < b in order; and where `claims` says which pairs are claimed,
    "claims adjustment" (F under `USUAL_TEST` and every claimed pair in the claimed direction) and "claimed adjustment" (claimed
    pairs found, summed over studies). `draws` is the seed: which one belongs to which study size is the caller's choice.
    """
    rng = np.random.default_rng(draws)
    k = len(population.mean)
    root = np.linalg.cholesky(population.covariance).T
    a, b = np.triu_indices(k, 1)
    expected = np.sign(population.mean[a] - population.mean[b])
    counts: Counter = Counter()
    step = max(1, _CHUNK // (n * k))
    for first in range(0, replicates, step):
        studies = min(step, replicates - first)
        scores = rng.standard_normal((studies, n, k)) @ root + population.mean
        batch = repeated_measures_batch(scores)
        # An undefined p of Mauchly's test (n ≤ k − 1) counts as a rejection, as in `repeated_measures`.
        rejected = ~(batch.mauchly_p >= alpha) if k > 2 else np.zeros(studies, dtype=bool)
        p_values = (batch.p, batch.p_gg, batch.p_hf, np.where(rejected, batch.p_gg, batch.p))
        findings = {test: p < alpha for test, p in zip(TESTS, p_values, strict=True)}
        for test, found in findings.items():
            counts[f"F {test}"] += int(found.sum())
        for name, attribute in ADJUSTMENTS.items():
            hits = getattr(batch.pairwise, attribute) < alpha
            for i, found in enumerate(hits.sum(axis=0)):
                counts[f"pair {i} {name}"] += int(found)
            if claims is not None:
                right = hits & (np.sign(batch.pairwise.mean_difference) == expected)
                counts[f"claims {name}"] += int((right[:, claims].all(axis=1) & findings[USUAL_TEST]).sum())
                counts[f"claimed {name}"] += int(right[:, claims].sum())
    return dict(counts)


def claims_mask(claims: Sequence[tuple] | None, conditions: Conditions) -> np.ndarray | None:
    """Return which pairs are claimed, over all pairs a < b; None without claims."""
    if claims is None:
        return None
    labels = list(conditions.labels)
    pairs = list(combinations(labels, 2))
    mask = np.zeros(len(pairs), dtype=bool)
    if isinstance(claims, str | bytes) or not hasattr(claims, "__iter__"):
        raise ValueError(f"claims must be a list of pairs of conditions, got {claims!r:.60}")
    for pair in claims:
        if isinstance(pair, str) or not hasattr(pair, "__len__") or len(pair) != 2 or pair[0] == pair[1]:
            raise ValueError(f"a comparison is a pair of two conditions (a, b), got {pair!r:.60}")
        for label in pair:
            if label not in labels:
                there = ", ".join(map(str, labels))
                raise ValueError(f"unknown condition {label!r}{did_you_mean(label, labels)} (there are {there})")
        where = pairs.index(tuple(sorted(pair, key=labels.index)))
        if mask[where]:
            raise ValueError(f"pair {pair!r} is claimed twice")
        mask[where] = True
    if not mask.any():
        raise ValueError("claims is empty: give pairs of conditions, or leave it out")
    return mask
