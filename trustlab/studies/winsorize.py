"""Winsorizing: outlying values are replaced by an explicit rule, and every change is listed."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from trustlab.models.checks import one_of, positive
from trustlab.models.display import Result
from trustlab.studies.table import (
    labelled,
    labels_index,
    levels_of,
    mark,
    numbers_of,
    one_row_a_cell,
    origin_of,
    roles_of,
)

# Which values count as outlying: words for the rule and its k; the middle, or two, and the spread.
_RULES: dict[str, tuple[str, Callable]] = {
    "sd": ("mean ± {} standard deviations", lambda x: (x.mean(), x.std(ddof=1))),
    "mad": (
        "median ± {} scaled median absolute deviations",
        lambda x: (np.median(x), stats.median_abs_deviation(x, scale="normal")),
    ),
    "iqr": (
        "the quartiles ± {} interquartile ranges",
        lambda x: (np.quantile(x, [0.25, 0.75]), stats.iqr(x)),
    ),
}
_TARGETS = {"limit": "set to that limit", "next": "set to the next most extreme value"}


@dataclass(frozen=True, eq=False, repr=False)
class Winsorized(Result):
    """
    Data after winsorizing, and what was changed.

    Parameters
    ----------
    data : pandas.DataFrame
        The data with outlying values replaced; rows, order and other columns are unchanged.
    changes : pandas.DataFrame
        Values changed: subject, condition, old, new.
    limits : pandas.DataFrame
        One row per condition looked at: condition, n, low, high, changed.
    rule : str
        The rule in words.
    """

    title = "Winsorizing"

    data: pd.DataFrame
    changes: pd.DataFrame
    limits: pd.DataFrame
    rule: str

    @property
    def message(self) -> str:
        """The sentence for a paper."""
        return self.apa()

    def table(self) -> pd.DataFrame:
        """Return the values changed: subject, condition, old, new."""
        return self.changes.copy()

    def apa(self) -> str:
        """
        Return the sentence for a paper: how many values were changed, of whom, and by which rule.
        """
        changes = [f"{row.condition}, subject {row.subject}" for row in self.changes.itertuples()]
        where = f" ({'; '.join(changes)})" if changes else ""
        origin, total = mark(origin_of(self.changes)), self.limits["n"].sum()
        return f"{origin}Values winsorized: {len(changes)} of {total}{where}. Rule: {self.rule}."


def winsorize(
    data: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    outside: str,
    k: float,
    to: str,
) -> Winsorized:
    """
    Replace outlying values, condition by condition, and list every change.

    Section 3.9.4.1 winsorizes two outliers of one condition and does not say by which rule; here
    every part of the rule is an argument without a default.

    Parameters
    ----------
    data : pandas.DataFrame
        A long table with a row per subject and condition. Missing cells stay missing.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject.
    outside : {"sd", "mad", "iqr"}
        Which values count as outlying: beyond k standard deviations from the mean, k scaled median
        absolute deviations from the median, or k interquartile ranges from the quartiles.
        (`scipy.stats.mstats.winsorize` sets the k most extreme values at each end.)
    k : float
        The rule's number.
    to : {"limit", "next"}
        What an outlying value becomes: the limit itself, or the most extreme value that is not
        outlying.

    Returns
    -------
    Winsorized

    Raises
    ------
    ValueError
        If a column is unknown or named twice, a label is missing, a score is not a finite number, a
        cell has two rows, or a rule is unknown or cannot apply to so few or so many equal values.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> values = {"subject": range(5), "mode": ["A"] * 5, "error": [1.0, 1.2, 0.9, 1.1, 9.0]}
    >>> frame = pd.concat([pd.DataFrame(values), pd.DataFrame(values).assign(mode="B")])
    >>> rule = {"outside": "mad", "k": 3.0, "to": "limit"}
    >>> tl.winsorize(frame, "error", "mode", "subject", **rule).table()
       subject condition  old       new
    0        4         A  9.0  1.544781
    1        4         B  9.0  1.544781
    """
    words, middle_and_spread = _RULES[one_of("outside", outside, _RULES)]
    one_of("to", to, _TARGETS)
    k = positive("k", k)
    roles_of("data", data, dv=[dv], within=[within], subject=[subject])
    people, scores, conditions = data[subject], numbers_of(data[dv], "dv"), data[within]
    one_row_a_cell(data, [subject, within], dv)
    changes, limits, levels = [], [], levels_of(conditions, "within")
    codes = pd.Categorical(conditions.tolist(), labels_index(levels)).codes
    for number, condition in enumerate(levels):
        rows = np.flatnonzero((codes == number) & np.isfinite(scores))
        old = scores[rows]
        middle, spread = middle_and_spread(old) if old.size > 2 else (np.nan, np.nan)
        # A spread of 0 where not all values are equal tells nothing.
        spread = np.nan if spread == 0.0 < np.ptp(old) else spread
        low, high = middle + k * spread * np.array([-1.0, 1.0])
        inside = old[(old >= low) & (old <= high)]
        if not inside.size:
            raise ValueError(
                f"dv: by this rule no value of {condition!r} lies inside {low:g} to {high:g}: its "
                f"{old.size} values are too few, or so many are equal that their spread is 0"
            )
        new = np.clip(old, *((low, high) if to == "limit" else (inside.min(), inside.max())))
        moves = {"subject": people.iloc[rows], "condition": [condition] * old.size}
        moves |= {"old": old, "new": new}
        changes.append(pd.DataFrame(moves).query("old != new"))
        limits.append((condition, old.size, low, high, len(changes[-1])))
        scores[rows] = new
    result = data.copy()
    result[dv] = scores
    return Winsorized(
        data=result,
        changes=labelled(pd.concat(changes, ignore_index=True), origin_of(data)),
        limits=pd.DataFrame(limits, columns=["condition", "n", "low", "high", "changed"]),
        rule=f"values outside {words.format(f'{k:g}')} by condition, {_TARGETS[to]}",
    )
