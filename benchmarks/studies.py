"""Analyses of many simulated studies beside a loop over pingouin; ratings; power."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
import pandas as pd

import trustlab as tl
from benchmarks.timing import Row, beside, same, within
from trustlab.studies import Simulation, graded_covariance
from trustlab.studies.anova import Design, regress
from trustlab.studies.pairs import differences, level_pairs

STUDIES = 10_000

# Studies that the peer analyses in a repetition; its time is scaled to all.
LOOPED = 50


def rows() -> Iterator[Row]:
    """Yield one-way and two-way analyses, a model of ratings, and a power analysis."""
    warnings.simplefilter("ignore")  # pandas' own, from inside pingouin
    for shape, limit in (((5,), 100.0), ((2, 3), 1000.0)):
        yield from analyses(shape, limit)
    ratings = pd.DataFrame({"subject": np.repeat(range(40), 6), "condition": list("abc") * 80})
    person = np.random.default_rng(0).normal(size=(40, 1))
    score = person + np.random.default_rng(1).logistic(size=(40, 6)) + [0.0, 0.5, 1.0] * 2
    ratings["rating"] = np.clip(np.round(score.ravel() + 4.0), 1, 7)
    model = lambda: tl.ordinal_model(ratings, "rating", "condition")  # noqa: E731
    yield within("ordinal_model of 240 ratings", model, 3000.0, turns=3)
    yield power()


def analyses(shape: tuple[int, ...], limit: float) -> Iterator[Row]:
    """Yield the batch alone, and with pairs of one factor beside pingouin."""
    import pingouin

    names = list("AB")[: len(shape)]
    scores = np.random.default_rng(5).standard_normal((STUDIES, 36, *shape))
    scores += np.random.default_rng(6).standard_normal((STUDIES, 36, *[1] * len(shape)))
    cells = pd.MultiIndex.from_product([range(36), *map(range, shape)], names=["subject", *names])
    frames = [cells.to_frame(index=False).assign(dv=study.ravel()) for study in scores[:LOOPED]]
    within_subjects = names if len(names) > 1 else names[0]

    def loop() -> np.ndarray:
        tables = [pingouin.rm_anova(f, "dv", within_subjects, "subject") for f in frames]
        return np.concatenate([table["F"] for table in tables])

    def pairs() -> None:
        for frame in frames:
            pingouin.rm_anova(frame, "dv", "A", "subject")
            pingouin.pairwise_tests(
                frame, "dv", within="A", subject="subject", padjust="holm", effsize="cohen"
            )

    def batch() -> pd.DataFrame:
        return tl.repeated_measures_batch(scores)

    work = f"repeated_measures_batch, {STUDIES:,} studies of 36 × {' × '.join(map(str, shape))}"
    same("pingouin", tl.repeated_measures_batch(scores[:LOOPED])["F"], loop(), 1e-9)
    peer = "pingouin rm_anova, a loop, its time scaled"
    timed = {"least": 200.0, "turns": 3, "scale": STUDIES / LOOPED}
    yield beside(work, batch, peer, loop, limit=limit, **timed)
    if len(shape) == 1:
        design = Design(36, {"A": range(shape[0])})
        _, *weights = level_pairs(design, "A")
        both = lambda: (batch(), differences(regress(scores, design), *weights))  # noqa: E731
        peer = "pingouin rm_anova and pairwise_tests, a loop, its time scaled"
        yield beside(f"{work}, and all pairs", both, peer, pairs, **timed)


def power() -> Row:
    """Return a power analysis, whose result is checked against the noncentral F."""
    plan = {"mean": [0.0, 0.1, 0.4, 0.5, 0.5], "covariance": graded_covariance(5)}
    plan |= {"n": 36, "effect_size": 0.05, "simulation": Simulation(seed=1)}
    row = tl.power_analysis(**plan).table().iloc[0]
    exact = row["closed_form"]
    off = (row["power"] - exact) / np.sqrt(exact * (1.0 - exact) / 10_000)
    same("noncentral F, in standard errors", 1.0, 1.0 + off, 4.0)
    work = "power_analysis of 36 × 5, 10,000 simulated studies, all pairs"
    return within(work, lambda: tl.power_analysis(**plan), 5000.0, turns=3)
