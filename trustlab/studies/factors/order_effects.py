"""Orders of conditions: period, sequence and first-order carry-over, and the conditions' effect adjusted for them."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import of_class
from trustlab.models.html import as_html
from trustlab.studies.analysis.pairwise import holm
from trustlab.studies.analysis.score_table import levels_of, read_scores
from trustlab.studies.columns import column_of


@dataclass(frozen=True, eq=False)
class OrderEffects:
    """
    The analysis of a design in which conditions come in several orders.

    Parameters
    ----------
    dv : hashable
        Column analysed.
    conditions : tuple
        Labels of the conditions.
    n : int
        Subjects.
    tests, differences : pandas.DataFrame
        What `table` and `pairs` return.
    origin : str
        What kind of data these are where they were not measured; else empty.
    """

    dv: Hashable
    conditions: tuple
    n: int
    tests: pd.DataFrame
    differences: pd.DataFrame
    origin: str

    def table(self) -> pd.DataFrame:
        """
        Return the tests, each effect adjusted for all others within subjects; sequences are compared between subjects.

        Returns
        -------
        pandas.DataFrame
            Rows sequence, position, condition, carry_over and condition_without_carry_over (condition adjusted for position only);
            columns effect, ss, df1, df2, F, p, note. NaN where the orders do not separate an effect from others; the note
            says so.
        """
        return self.tests.copy()

    def pairs(self) -> pd.DataFrame:
        """
        Return differences between conditions, adjusted for position and carry-over (as far as the orders separate them).

        Returns
        -------
        pandas.DataFrame
            Columns a, b, mean_difference, ci_low, ci_high (95 %, unadjusted), t, df, p, p_holm.
        """
        return self.differences.copy()

    def _repr_html_(self) -> str:
        text = f"{self.origin} {self.n} subjects, {len(self.conditions)} conditions".strip()
        return as_html(text, self.tests, self.differences, title=f"Order effects on {self.dv}")


def order_effects(
    frame: pd.DataFrame,
    dv: Hashable,
    condition: Hashable,
    position: Hashable,
    sequence: Hashable | None = None,
    subject: Hashable = "subject",
    *,
    order: Sequence | None = None,
) -> OrderEffects:
    """
    Test period, sequence and first-order carry-over in Latin squares and Williams designs.

    Within subjects, score = subject + position + condition + carry-over of the condition before (none at the first position), by
    least squares; the sequence is tested on the subjects' means.

    Parameters
    ----------
    frame : pandas.DataFrame
        A row per subject and position.
    dv, condition, position, subject : hashable
        Columns with the score, the condition, the position (1, 2 …) and the subject.
    sequence : hashable, optional
        Column with the name of the subject's order; by default it is read from the order itself.
    order : sequence, optional
        Conditions in the order wanted.

    Returns
    -------
    OrderEffects

    Raises
    ------
    ValueError
        If a column is unknown, positions of a subject are not 1, 2 …, a score is missing, or nothing is left to estimate the
        error from.

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
    of_class("frame", frame, pd.DataFrame, "with a row per subject and position")
    scores = read_scores(frame, dv, position, subject)
    if np.isnan(scores.values).any():
        i, j = np.argwhere(np.isnan(scores.values))[0]
        raise ValueError(f"dv: subject {scores.subjects[i]!r} has no score at position {scores.conditions[j]!r}")
    n, k = scores.values.shape
    if list(scores.conditions) != list(range(1, k + 1)):
        raise ValueError(f"position: column {position!r} must hold 1 to {k}, found {list(scores.conditions)}")
    conditions = levels_of(column_of(frame, "condition", condition), "condition", order)
    where = {
        (who, place): what
        for who, place, what in zip(*(frame[x].tolist() for x in (subject, position, condition)), strict=True)
    }
    codes = np.array([[conditions.index(where[who, place]) for place in scores.conditions] for who in scores.subjects])
    names = [tuple(row) for row in codes.tolist()]
    if sequence is not None:
        column_of(frame, "sequence", sequence)
        given = frame.drop_duplicates([subject, sequence]).set_index(subject)[sequence]
        if twice := given.index[given.index.duplicated()].tolist():
            raise ValueError(f"sequence: subject {twice[0]!r} has two sequences in column {sequence!r}")
        names = [given[who] for who in scores.subjects]
    tests = _within_tests(scores.values, codes, len(conditions))
    tests.insert(0, _sequence_test(scores.values.mean(axis=1) * np.sqrt(k), names))
    columns = ["effect", "ss", "df1", "df2", "F", "p", "note"]
    table, pairs = pd.DataFrame(tests, columns=columns), _differences(scores.values, codes, conditions)
    for part in (table, pairs):
        part.attrs |= {"origin": scores.origin} if scores.origin else {}
    return OrderEffects(dv, tuple(conditions), n, table, pairs, scores.origin)


def _regressors(codes: np.ndarray, count: int) -> dict[str, np.ndarray]:
    """Return the columns of every effect, a row per subject and position; sums to zero, but for the subjects."""
    n, k = codes.shape

    def coded(values: np.ndarray, levels: int) -> np.ndarray:
        rows = np.vstack([np.eye(levels - 1), -np.ones(levels - 1), np.zeros(levels - 1)])
        return rows[values.ravel()]

    before = np.column_stack(
        [np.full(n, count), codes[:, :-1]]
    )  # before the first position there is nothing to carry over
    return {
        "subject": np.repeat(np.eye(n), k, axis=0),
        "position": coded(np.broadcast_to(np.arange(k), (n, k)), k),
        "condition": coded(codes, count),
        "carry_over": coded(before, count),
    }


def _residual(y: np.ndarray, parts: Sequence[np.ndarray]) -> tuple[float, int]:
    """Return residual sum of squares and degrees of freedom of a regression on some columns, which may be dependent."""
    x = np.column_stack(parts)
    beta, _, rank, _ = np.linalg.lstsq(x, y, rcond=1e-10)
    return float(((y - x @ beta) ** 2).sum()), y.size - int(rank)


def _within_tests(values: np.ndarray, codes: np.ndarray, count: int) -> list[tuple]:
    """Return the tests of position, condition and carry-over by full and reduced regressions."""
    y = (values - values.mean()).ravel()
    parts = _regressors(codes, count)
    rows = []
    for effect, without in (
        ("position", ("position",)),
        ("condition", ("condition",)),
        ("carry_over", ("carry_over",)),
        ("condition_without_carry_over", ("condition",)),
    ):
        full = {
            name: x for name, x in parts.items() if effect != "condition_without_carry_over" or name != "carry_over"
        }
        rss, df = _residual(y, list(full.values()))
        if df < 1 or rss <= df * (4.0 * np.finfo(float).eps * np.abs(values).max()) ** 2:
            raise ValueError(
                f"dv: {values.size} scores leave no error variance beside subjects, positions, conditions and carry-over"
            )
        reduced, df_reduced = _residual(y, [x for name, x in full.items() if name not in without])
        rows.append(_row(effect, reduced - rss, df_reduced - df, rss, df, full[without[0]].shape[1]))
    return rows


def _row(effect: str, ss: float, df1: int, rss: float, df2: int, wanted: int) -> tuple:
    """Return one row of the table."""
    if df1 == 0:
        return (
            effect,
            np.nan,
            0,
            df2,
            np.nan,
            np.nan,
            "not estimable: these orders do not separate it from the other effects",
        )
    note = "" if df1 == wanted else f"only {df1} of {wanted} contrasts are estimable from these orders"
    f = (ss / df1) / (rss / df2)
    return effect, ss, df1, df2, f, float(special.fdtrc(df1, df2, f)), note


def _sequence_test(means: np.ndarray, names: list) -> tuple:
    """Return the test of the sequence between subjects."""
    codes = pd.factorize(pd.Series(names, dtype=object))[0]
    groups = int(codes.max()) + 1
    df1, df2 = groups - 1, means.size - groups
    if df1 < 1 or df2 < 1:
        why = "one sequence only" if df1 < 1 else "every sequence has one subject"
        return "sequence", np.nan, df1, df2, np.nan, np.nan, f"not testable: {why}"
    own = np.array([means[codes == g].mean() for g in range(groups)])[codes]
    rss = float(((means - own) ** 2).sum())
    return _row("sequence", float(((own - means.mean()) ** 2).sum()), df1, rss, df2, df1)


def _differences(values: np.ndarray, codes: np.ndarray, conditions: list) -> pd.DataFrame:
    """Return the differences of conditions in the full model, or without carry-over where the orders do not separate it."""
    y = (values - values.mean()).ravel()
    parts = _regressors(codes, len(conditions))
    full = np.column_stack(list(parts.values()))
    if np.linalg.matrix_rank(full) < full.shape[1]:
        del parts["carry_over"]
    start = parts["subject"].shape[1] + parts["position"].shape[1]
    x = np.column_stack(list(parts.values()))
    inverse = np.linalg.pinv(x.T @ x)
    beta = inverse @ x.T @ y
    rss, df = _residual(y, [x])
    rows, k = [], len(conditions)
    coding = np.vstack([np.eye(k - 1), -np.ones(k - 1)])
    for i in range(k):
        for j in range(i + 1, k):
            row = np.zeros(x.shape[1])
            row[start : start + k - 1] = coding[i] - coding[j]
            estimable = np.allclose(row @ inverse @ x.T @ x, row, atol=1e-8)
            mean, error = row @ beta if estimable else np.nan, np.sqrt(rss / df * (row @ inverse @ row))
            half = special.stdtrit(df, 0.975) * error
            p = 2.0 * special.stdtr(df, -abs(mean / error))
            rows.append((conditions[i], conditions[j], mean, mean - half, mean + half, mean / error, df, p))
    table = pd.DataFrame(rows, columns=["a", "b", "mean_difference", "ci_low", "ci_high", "t", "df", "p"])
    return table.assign(p_holm=holm(table["p"].to_numpy()))
