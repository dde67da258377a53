"""Orders of conditions: period, sequence, carry-over, and effects adjusted for them."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.studies.anova import Design
from trustlab.studies.pairs import compared, level_pairs
from trustlab.studies.table import (
    Tested,
    complete_scores,
    labelled,
    origin_of,
    read_cells,
    read_factors,
    roles_of,
)

# Of a score, what rounding can change.
ROUNDING = 4.0 * np.finfo(float).eps


@dataclass(frozen=True, eq=False, repr=False)
class OrderEffects(Tested):
    """
    The analysis of a design in which conditions come in several orders.

    Parameters
    ----------
    dv : hashable
        Column analysed.
    scores : pandas.DataFrame
        What was analysed: a row per subject, a column per position.
    tests : pandas.DataFrame
        What `table` returns: the tests, each effect adjusted for all others within subjects;
        sequences are compared between subjects. Rows sequence, position, condition, carry_over and
        condition_without_carry_over (condition adjusted for position only); columns effect, ss,
        df1, df2, F, p, note. NaN where the orders do not separate an effect from others; the note
        says so.
    differences : pandas.DataFrame
        What `pairs` returns.
    """

    dv: Hashable
    scores: pd.DataFrame
    tests: pd.DataFrame
    differences: pd.DataFrame

    def pairs(self) -> pd.DataFrame:
        """
        Return differences between conditions, adjusted for position and carry-over (as far as the
        orders separate them).

        Returns
        -------
        pandas.DataFrame
            Columns a, b, mean_difference, ci_low, ci_high (95 %, unadjusted), t, df, p, p_holm.
        """
        return self.differences.copy()

    @property
    def title(self) -> str:
        """What was analysed."""
        return f"Order effects on {self.dv}"

    @property
    def message(self) -> str:
        """Which data."""
        return f"{self.origin} {len(self.scores)} subjects".strip()


def order_effects(
    frame: pd.DataFrame,
    dv: Hashable,
    condition: Hashable,
    position: Hashable,
    subject: Hashable = "subject",
    *,
    order: Sequence | None = None,
) -> OrderEffects:
    """
    Test period, sequence and first-order carry-over in Latin squares and Williams designs.

    Within subjects, score = subject + position + condition + carry-over of the condition before
    (none at the first position), by least squares; the sequence is tested on the subjects' means.

    Parameters
    ----------
    frame : pandas.DataFrame
        A row per subject and position.
    dv, condition, position, subject : hashable
        Columns with the score, the condition, the position (1, 2 …) and the subject.
    order : sequence, optional
        The order of the conditions.

    Returns
    -------
    OrderEffects

    Raises
    ------
    ValueError
        If a column is unknown, positions of a subject are not 1, 2 …, a score is missing, or
        nothing is left to estimate the error from.

    References
    ----------
    B. Jones, M. G. Kenward, Design and Analysis of Cross-Over Trials, 3rd ed., 2014, Chapter 5.

    Examples
    --------
    >>> import trustlab as tl
    >>> study = tl.virtual_study(n=10, conditions=["C1", "C2", "C3", "C4", "C5"], laps=2, seed=0)
    >>> columns = {"condition": "condition", "position": "position", "subject": "participant"}
    >>> effects = tl.order_effects(study.measures, dv="p_r", **columns)
    >>> effects.table()[["effect", "df1", "df2"]]
                             effect  df1  df2
    0                      sequence    9    0
    1                      position    4   28
    2                     condition    4   28
    3                    carry_over    4   28
    4  condition_without_carry_over    4   32
    """
    roles_of("frame", frame, position=[position], condition=[condition])
    factors = [position, condition]
    table, levels, _ = read_factors(frame, dv, factors, subject, order={condition: order})
    labels, places = levels[condition], levels[position]
    scores = complete_scores(read_cells(table, {position: places}, dv, subject), dv)[0]
    n, k = scores.shape
    if list(places) != list(range(1, k + 1)):
        raise ValueError(f"position: column {position!r} must hold 1 to {k}, got {list(places)}")
    rows = table.reset_index(drop=True).sort_values([subject, position])
    codes = rows[condition].cat.codes.to_numpy()
    direct = {
        "condition": np.eye(len(labels))[codes],
        "position": np.tile(np.eye(k), (n, 1)),
        "subject": np.repeat(np.eye(n), k, axis=0),
    }
    carried = np.roll(direct["condition"], 1, axis=0) - 1.0 / len(labels)
    carried[::k] = 0.0  # before the first position there is nothing to carry over
    full = direct | {"carry_over": carried}
    y = (scores - scores.mean(axis=None)).to_numpy().ravel()
    error, df = _residual(y, full)
    noise = y.size * (ROUNDING * np.abs(scores).max(axis=None)) ** 2
    if df == 0 or error <= noise:
        raise ValueError(f"dv: {y.size} scores leave no error variance beside all effects")
    sequence = np.unique(codes.reshape(n, k), axis=0, return_inverse=True)[1]
    between = {"mean": np.ones((n, 1)), "sequence": np.eye(sequence.max() + 1)[sequence]}
    tests = [
        _test("sequence", y.reshape(n, k).sum(axis=1) / np.sqrt(k), between, noise),
        *(_test(name, y, full, noise) for name in ("position", "condition", "carry_over")),
        _test("condition", y, direct, noise) | {"effect": "condition_without_carry_over"},
    ]
    separable = y.size - df == n + k - 1 + 2 * (len(labels) - 1)
    parts, design = full if separable else direct, Design(n, {condition: labels})
    pairs, origin = _differences(y, parts, design), origin_of(frame)
    return OrderEffects(dv, scores, labelled(pd.DataFrame(tests), origin), labelled(pairs, origin))


def _residual(y: np.ndarray, parts: dict[str, np.ndarray]) -> tuple[float, int]:
    """Return the residual sum of squares of a regression and its degrees of freedom."""
    x = np.column_stack([*parts.values()])
    beta, _, rank, _ = np.linalg.lstsq(x, y)
    return float(((y - x @ beta) ** 2).sum()), y.size - int(rank)


def _test(effect: str, y: np.ndarray, parts: dict[str, np.ndarray], noise: float) -> dict[str, Any]:
    """Return a row of the table: the regression on all parts against the one without the effect."""
    error, df2 = _residual(y, parts)
    total, df = _residual(y, {name: x for name, x in parts.items() if name != effect})
    df1, contrasts = df - df2, parts[effect].shape[1] - 1
    ss = f = p = np.nan
    if df1 == 0:
        note = "not estimable: these orders do not separate it from the other effects"
    elif df2 == 0:
        note = "not testable: every sequence has one subject"
    elif error <= noise:  # what rounding can leave
        note = "not testable: subjects' means do not differ within sequences"
    else:
        ss = total - error
        f = ss / df1 / (error / df2)
        p = special.fdtrc(df1, df2, f)
        few = f"only {df1} of {contrasts} contrasts are estimable from these orders"
        note = few if df1 < contrasts else ""
    return {"effect": effect, "ss": ss, "df1": df1, "df2": df2, "F": f, "p": p, "note": note}


def _differences(y: np.ndarray, parts: dict[str, np.ndarray], design: Design) -> pd.DataFrame:
    """Return the differences of conditions, whose regressors are the first."""
    error, df = _residual(y, parts)
    x = np.column_stack([*parts.values()])
    pairs, _, cells = level_pairs(design, *design.within)
    weights = np.pad(cells.T, ((0, 0), (0, x.shape[1] - len(cells))))
    weighted = weights @ np.linalg.pinv(x, 1e-12)
    # Estimable weights are combinations of contrasts of the regressors.
    estimable = np.isclose(weighted @ x, weights, atol=1e-8).all(axis=1)
    difference = np.where(estimable, weighted @ y, np.nan)
    se = np.sqrt(error / df) * np.linalg.norm(weighted, axis=1)
    table = compared(pairs, difference, se, df, np.nan)
    return table[["a", "b", "mean_difference", "ci_low", "ci_high", "t", "df", "p", "p_holm"]]
