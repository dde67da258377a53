"""
Repeated-measures analyses of 10,000 studies of 36 subjects × 5 conditions, beside a loop over
pingouin.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd

import trustlab as tl
from benchmarks.timing import Row, here, in_turns
from trustlab.studies.pairs import condition_pairs

TITLE = "Repeated measures"
STUDIES = 10_000
SUBJECTS = 36
CONDITIONS = 5
LOOPED = 50
"""Studies that the peer analyses in one repetition; its time is scaled to all."""


def rows() -> Iterator[Row]:
    """
    Yield pingouin's ANOVA alone, and all numbers that the batch gives as far as pingouin has them.
    """
    array = studies()
    frames = [long_table(study) for study in array[:LOOPED]]
    batch = tl.repeated_measures_batch(array).droplevel("effect")
    pairs = condition_pairs(array)
    for peer, analyse in (
        ("pingouin rm_anova, a loop", anova),
        ("pingouin rm_anova, epsilon, pairwise_tests, a loop", everything),
    ):
        case = f"Repeated measures, {STUDIES:,} studies of {SUBJECTS} × {CONDITIONS}"
        ours = "trustlab repeated_measures_batch"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pandas' own, from inside pingouin
            error = greatest_error(batch, pairs, [analyse(frame) for frame in frames])
            if not error <= 1e-10:
                yield Row(case, ours, peer, fault=f"its values differ by {error:.2g}")
                continue
            yield timed(case, ours, peer, array, frames, analyse, error)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield two_way()


def two_way() -> Row:
    """Return the row of two-way studies, 36 subjects × 2 × 3, beside a loop over pingouin."""
    import pingouin

    case, peer = (
        f"Two-way repeated measures, {STUDIES:,} studies of {SUBJECTS} × 2 × 3",
        "pingouin rm_anova, a loop",
    )
    ours = "trustlab repeated_measures_batch"
    array = np.random.default_rng(6).standard_normal((STUDIES, SUBJECTS, 2, 3))
    cells = pd.MultiIndex.from_product(
        [range(SUBJECTS), range(2), range(3)], names=["subject", "A", "B"]
    ).to_frame(index=False)
    frames = [cells.assign(value=study.ravel()) for study in array[:LOOPED]]

    def analyse(frame: pd.DataFrame) -> pd.DataFrame:
        return pingouin.rm_anova(frame, dv="value", within=["A", "B"], subject="subject")

    found = tl.repeated_measures_batch(array[:LOOPED])
    errors = [
        np.abs(found.loc[s, "F"].to_numpy() / analyse(frame)["F"].to_numpy() - 1.0).max()
        for s, frame in enumerate(frames)
    ]
    error = float(max(errors))
    if not error <= 1e-9:
        return Row(case, ours, peer, fault=f"its values differ by {error:.2g}")
    loop = here(lambda: [analyse(frame) for frame in frames])
    ours_ms, peer_ms, ratio = in_turns(
        here(lambda: tl.repeated_measures_batch(array)),
        lambda calls: loop(calls) * STUDIES / len(frames),
        5,
    )
    return Row(
        case,
        ours,
        peer,
        ours_ms,
        peer_ms,
        ratio,
        goal="≤ 1000 ms",
        met=bool(ours_ms.median <= 1000.0),
        note=f"greatest difference {error:.1g} in {len(frames)} studies; peer's time scaled from "
        "these",
    )


def timed(
    case: str,
    ours: str,
    peer: str,
    array: np.ndarray,
    frames: list,
    analyse: Callable,
    error: float,
) -> Row:
    """
    Return the row of one way to use pingouin.

    Parameters
    ----------
    case, ours, peer : str
        What is compared.
    array : numpy.ndarray, shape (studies, subjects, conditions)
        All scores.
    frames : list of pandas.DataFrame
        The first of them as long tables.
    analyse : callable
        What the peer does with one table.
    error : float
        Greatest difference found.
    """
    loop = here(lambda: [analyse(frame) for frame in frames])
    ours_ms, peer_ms, ratio = in_turns(
        here(lambda: (tl.repeated_measures_batch(array), condition_pairs(array))),
        lambda calls: loop(calls) * STUDIES / len(frames),
        5,
    )
    return Row(
        case,
        ours,
        peer,
        ours_ms,
        peer_ms,
        ratio,
        goal="≤ 500 ms and ratio ≥ 200",
        met=bool(ours_ms.median <= 500.0 and ratio.median >= 200.0),
        note=f"greatest difference {error:.1g} in {len(frames)} studies; peer's time scaled from "
        "these",
    )


def studies() -> np.ndarray:
    """Return scores with correlated conditions, shape (studies, subjects, conditions)."""
    rng = np.random.default_rng(5)
    scores = rng.standard_normal((STUDIES, SUBJECTS, CONDITIONS)) + rng.standard_normal(
        (STUDIES, SUBJECTS, 1)
    )
    return 50.0 + 10.0 * (
        scores * np.linspace(1.0, 1.6, CONDITIONS) + np.linspace(0.0, 0.5, CONDITIONS)
    )


def long_table(study: np.ndarray) -> pd.DataFrame:
    """
    Return one study as the long table that pingouin reads.

    Parameters
    ----------
    study : numpy.ndarray, shape (subjects, conditions)
        Its scores.
    """
    n, k = study.shape
    return pd.DataFrame(
        {
            "subject": np.repeat(np.arange(n), k),
            "condition": np.tile(np.arange(k), n),
            "value": study.ravel(),
        }
    )


def anova(frame: pd.DataFrame) -> dict[str, object]:
    """
    Return what `pingouin.rm_anova` gives.

    Parameters
    ----------
    frame : pandas.DataFrame
        A long table.
    """
    import pingouin

    row = pingouin.rm_anova(
        frame, dv="value", within="condition", subject="subject", correction=True
    ).iloc[0]
    return {
        "F": row["F"],
        "p": row["p_unc"],
        "p_gg": row["p_GG_corr"],
        "epsilon_gg": row["eps"],
        "eta2_generalized": row["ng2"],
        "mauchly_w": row["W_spher"],
        "mauchly_p": row["p_spher"],
    }


def everything(frame: pd.DataFrame) -> dict[str, object]:
    """
    Return the ANOVA, Huynh–Feldt ε and all pairs with Holm's p-values.

    Parameters
    ----------
    frame : pandas.DataFrame
        A long table.
    """
    import pingouin

    columns = {"dv": "value", "within": "condition", "subject": "subject"}
    pairs = pingouin.pairwise_tests(frame, padjust="holm", **columns)
    return anova(frame) | {
        "epsilon_hf": pingouin.epsilon(frame, correction="hf", **columns),
        "t": pairs["T"].to_numpy(),
        "pair_p": pairs["p_unc"].to_numpy(),
        "p_holm": pairs["p_corr"].to_numpy(),
    }


def greatest_error(batch: pd.DataFrame, pairs, found: list[dict[str, object]]) -> float:
    """
    Return the greatest difference between the batch and the peer, relative where a value passes 1;
    NaN counts as one.

    Parameters
    ----------
    batch : pandas.DataFrame
        Ours, a row per study.
    pairs : Pairs
        Our comparisons of conditions.
    found : list of dict
        The peer's, study by study.
    """
    greatest = 0.0
    for s, values in enumerate(found):
        for name, theirs in values.items():
            if name in ("t", "pair_p", "p_holm"):
                ours = getattr(pairs, name.removeprefix("pair_"))[s]
            else:
                ours = batch.loc[s, name]
            error = np.max(np.abs(ours - theirs) / np.maximum(1.0, np.abs(theirs)))
            greatest = max(greatest, float(error)) if error == error else np.inf
    return greatest
