"""Orders of conditions: period, sequence, carry-over, and effects adjusted for them."""

import warnings
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class
from trustlab.models.display import as_html
from trustlab.studies.pairs import holm
from trustlab.studies.table import column_of, labelled, levels_of, read_scores


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
        Return the tests, each effect adjusted for all others within subjects; sequences are
        compared between subjects.

        Returns
        -------
        pandas.DataFrame
            Rows sequence, position, condition, carry_over and condition_without_carry_over
            (condition adjusted for position only); columns effect, ss, df1, df2, F, p, note. NaN
            where the orders do not separate an effect from others; the note says so.
        """
        return self.tests.copy()

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

    Within subjects, score = subject + position + condition + carry-over of the condition before
    (none at the first position), by least squares; the sequence is tested on the subjects' means.

    Parameters
    ----------
    frame : pandas.DataFrame
        A row per subject and position.
    dv, condition, position, subject : hashable
        Columns with the score, the condition, the position (1, 2 …) and the subject.
    sequence : hashable, optional
        Column with the name of the subject's order; by default it is read from the order itself.
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
    of_class("frame", frame, pd.DataFrame, "with a row per subject and position")
    scores = read_scores(frame, dv, position, subject)
    if np.isnan(scores.values).any():
        i, j = np.argwhere(np.isnan(scores.values))[0]
        raise ValueError(
            f"dv: subject {scores.subjects[i]!r} has no score at position {scores.conditions[j]!r}"
        )
    n, k = scores.values.shape
    if list(scores.conditions) != list(range(1, k + 1)):
        raise ValueError(
            f"position: column {position!r} must hold 1 to {k}, found {list(scores.conditions)}"
        )
    conditions = levels_of(column_of(frame, "condition", condition), "condition", order)
    labels = frame.set_index([subject, position])[condition].to_dict()
    places = [[labels[row, place] for place in scores.conditions] for row in scores.subjects]
    codes = np.array([[conditions.index(label) for label in row] for row in places])
    names = [tuple(row) for row in codes.tolist()]
    if sequence is not None:
        column_of(frame, "sequence", sequence)
        sequences = frame.drop_duplicates([subject, sequence]).set_index(subject)[sequence]
        if twice := sequences.index[sequences.index.duplicated()].tolist():
            raise ValueError(
                f"sequence: subject {twice[0]!r} has two sequences in column {sequence!r}"
            )
        names = [sequences[label] for label in scores.subjects]
    tests = _within_tests(scores.values, codes, len(conditions))
    tests.insert(0, _sequence_test(scores.values.mean(axis=1) * np.sqrt(k), names))
    table = pd.DataFrame(tests, columns=["effect", "ss", "df1", "df2", "F", "p", "note"])
    pairs = _differences(scores.values, codes, conditions)
    return OrderEffects(
        dv,
        tuple(conditions),
        n,
        labelled(table, scores.origin),
        labelled(pairs, scores.origin),
        scores.origin,
    )


def _regressors(codes: np.ndarray, count: int) -> dict[str, np.ndarray]:
    """
    Return the columns of every effect, a row per subject and position; all but the subjects' are
    coded to sum to zero.
    """
    n, k = codes.shape

    def coded(values: np.ndarray, levels: int) -> np.ndarray:
        rows = np.vstack([np.eye(levels - 1), -np.ones(levels - 1), np.zeros(levels - 1)])
        return rows[values.ravel()]

    # Before the first position there is nothing to carry over.
    before = np.column_stack([np.full(n, count), codes[:, :-1]])
    return {
        "subject": np.repeat(np.eye(n), k, axis=0),
        "position": coded(np.broadcast_to(np.arange(k), (n, k)), k),
        "condition": coded(codes, count),
        "carry_over": coded(before, count),
    }


def _least_squares(y: np.ndarray, parts: Iterable[np.ndarray]):
    """Return the regression on some columns, which may be dependent."""
    from statsmodels.regression.linear_model import OLS

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rank deficiency; reported in df and notes
        return OLS(y, np.column_stack(list(parts))).fit()


def _within_tests(values: np.ndarray, codes: np.ndarray, count: int) -> list[tuple]:
    """Return the tests of position, condition and carry-over by full and reduced regressions."""
    y = (values - values.mean()).ravel()
    parts = _regressors(codes, count)
    rounding = 4.0 * np.finfo(float).eps * np.abs(values).max()
    rows = []
    for effect in ("position", "condition", "carry_over", "condition_without_carry_over"):
        without, _, left_out = effect.partition("_without_")
        full = {name: x for name, x in parts.items() if name != left_out}
        fit = _least_squares(y, full.values())
        if fit.df_resid < 1 or fit.ssr <= fit.df_resid * rounding**2:
            raise ValueError(
                f"dv: {values.size} scores leave no error variance beside subjects, positions, "
                "conditions and carry-over"
            )
        reduced = _least_squares(y, (x for name, x in full.items() if name != without))
        rows.append(_row(effect, fit, reduced, full[without].shape[1]))
    return rows


def _row(effect: str, fit, reduced, contrasts: int) -> tuple:
    """Return one row of the table: a regression against the one without the effect."""
    df1, df2 = int(reduced.df_resid - fit.df_resid), int(fit.df_resid)
    if df1 == 0:
        why = "not estimable: these orders do not separate it from the other effects"
        return effect, np.nan, 0, df2, np.nan, np.nan, why
    note = ""
    if df1 < contrasts:
        note = f"only {df1} of {contrasts} contrasts are estimable from these orders"
    f, p, _ = fit.compare_f_test(reduced)
    return effect, reduced.ssr - fit.ssr, df1, df2, float(f), float(p), note


def _sequence_test(means: np.ndarray, names: list) -> tuple:
    """Return the test of the sequence between subjects."""
    codes = pd.factorize(pd.Series(names, dtype=object))[0]
    indicators = (codes[:, None] == np.arange(codes.max() + 1)).astype(float)
    df1, df2 = indicators.shape[1] - 1, means.size - indicators.shape[1]
    if df1 < 1 or df2 < 1:
        why = "one sequence only" if df1 < 1 else "every sequence has one subject"
        return "sequence", np.nan, df1, df2, np.nan, np.nan, f"not testable: {why}"
    y = means - means.mean()
    full = _least_squares(y, [indicators])
    return _row("sequence", full, _least_squares(y, [np.ones((y.size, 1))]), df1)


def _differences(values: np.ndarray, codes: np.ndarray, conditions: list) -> pd.DataFrame:
    """
    Return the differences of conditions in the full model, or without carry-over where the orders
    do not separate it.
    """
    y = (values - values.mean()).ravel()
    parts = _regressors(codes, len(conditions))
    k = len(conditions)
    fit = _least_squares(y, parts.values())
    if y.size - fit.df_resid < sum(x.shape[1] for x in parts.values()):
        fit = _least_squares(y, (x for name, x in parts.items() if name != "carry_over"))
    start = parts["subject"].shape[1] + parts["position"].shape[1]
    coding = np.vstack([np.eye(k - 1), -np.ones(k - 1)])
    pairs = list(combinations(range(k), 2))
    weights = np.zeros((len(pairs), fit.model.exog.shape[1]))
    weights[:, start : start + k - 1] = [coding[i] - coding[j] for i, j in pairs]
    # Estimable weights are combinations of rows of the regressors.
    projected = weights @ np.linalg.pinv(fit.model.exog) @ fit.model.exog
    estimable = np.isclose(projected, weights, atol=1e-8).all(axis=1)
    tests = fit.t_test(weights).summary_frame().reset_index(drop=True)
    columns = {"coef": "mean_difference", "Conf. Int. Low": "ci_low", "Conf. Int. Upp.": "ci_high"}
    columns |= {"t": "t", "P>|t|": "p"}
    table = tests[[*columns]].rename(columns=columns)
    table[~estimable] = np.nan
    table.insert(4, "df", int(fit.df_resid))
    for place, name in enumerate("ab"):
        table.insert(place, name, [conditions[pair[place]] for pair in pairs])
    return table.assign(p_holm=holm(table["p"].to_numpy()))
