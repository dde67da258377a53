"""Winsorizing: outlying values are replaced by an explicit rule, and every change is listed."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import did_you_mean, finite_array, one_of, positive, rounded_down
from trustlab.models.display import as_html
from trustlab.studies.table import ScoreTable, labels_of, read_scores

# Which values count as outlying, by the name of the rule and its k.
OUTLIER_RULES = {
    "sd": "values outside mean ± {k:g} standard deviations",
    "mad": "values outside median ± {k:g} scaled median absolute deviations",
    "iqr": "values outside the quartiles ± {k:g} interquartile ranges",
    "quantile": "values outside the quantiles {k:g} and {rest:g}",
    "extremes": "the {k:g} lowest and {k:g} highest values",
}

_TARGETS = {"limit": "set to that limit", "next": "set to the next most extreme value"}
_SPREADS = {
    "sd": "standard deviation",
    "mad": "median absolute deviation",
    "iqr": "interquartile range",
}

# 1/Φ⁻¹(3/4): times the median absolute deviation it estimates the standard deviation of normal
# values.
_MAD_TO_SD = 1.482602218505602


@dataclass(frozen=True, eq=False)
class Winsorized:
    """
    Data after winsorizing, and what was changed.

    Parameters
    ----------
    data : pandas.DataFrame or numpy.ndarray
        The data with outlying values replaced; rows, order and other columns are unchanged.
    changes : pandas.DataFrame
        Values changed: subject (position from 0 for an array), condition (NaN for an array), old,
        new.
    limits : pandas.DataFrame
        One row per condition looked at: condition, n, low, high, changed.
    rule : str
        The rule in words.
    """

    data: pd.DataFrame | np.ndarray
    changes: pd.DataFrame
    limits: pd.DataFrame
    rule: str

    @property
    def frame(self) -> pd.DataFrame | np.ndarray:
        """The data after winsorizing."""
        return self.data

    def table(self) -> pd.DataFrame:
        """Return the values changed: subject, condition, old, new."""
        return self.changes

    def apa(self) -> str:
        """
        Return the sentence for a paper: how many values were changed, of whom, and by which rule.
        """
        of = int(self.limits["n"].sum())
        if self.changes.empty:
            return f"None of {of} values was winsorized (rule: {self.rule})."
        parts = []
        for condition, rows in self.changes.groupby("condition", sort=False, dropna=False):
            labels = ", ".join(map(str, rows["subject"]))
            plain = pd.isna(condition)
            where = f" (position {labels})" if plain else f" in {condition} (subject {labels})"
            parts.append(f"{len(rows)}{where}")
        word = "values was" if len(self.changes) == 1 else "values were"
        return (
            f"{len(self.changes)} of {of} {word} winsorized: {'; '.join(parts)}. Rule: {self.rule}."
        )

    def _repr_html_(self) -> str:
        return as_html(self.apa(), self.changes)


def _limits(x: np.ndarray, outside: str, k: float, where: str) -> tuple[float, float]:
    """
    Return the limits beyond which values are outlying; not finite where the spread overflows.
    """
    n = x.size
    if n < 3:
        raise ValueError(f"{where}: {n} values; winsorizing needs at least three")
    if np.ptp(x) == 0.0:
        return float(x[0]), float(x[0])
    if outside == "extremes":
        if 2 * k >= n:
            raise ValueError(
                f"{where}: {k:g} values at each end are all of the {n}; use a smaller k"
            )
        ordered = np.sort(x)
        return float(ordered[int(k)]), float(ordered[n - 1 - int(k)])
    if outside == "quantile":
        low, high = np.quantile(x, [k, 1.0 - k])
        return float(low), float(high)
    if outside == "sd":
        reach = (n - 1) / np.sqrt(n)  # no value of n lies more standard deviations from their mean
        if k >= reach:
            raise ValueError(
                f"{where}: none of {n} values can lie {k:g} standard deviations from their mean "
                f'(at most {rounded_down(reach):g}); use a smaller k or outside="mad" or "iqr"'
            )
        low = high = x.mean()
        spread = x.std(ddof=1)
    elif outside == "mad":
        low = high = np.median(x)
        spread = _MAD_TO_SD * np.median(np.abs(x - low))
    else:
        low, high = np.quantile(x, [0.25, 0.75])
        spread = high - low
    if spread == 0.0:
        raise ValueError(
            f"{where}: so many values are equal that their {_SPREADS[outside]} is 0; choose "
            "another rule"
        )
    return float(low - k * spread), float(high + k * spread)


def _replace_outliers(x: np.ndarray, low: float, high: float, to: str, where: str) -> np.ndarray:
    """Return the values with those outside [low, high] replaced."""
    if not np.isfinite([low, high]).all():
        raise ValueError(
            f"{where}: values are so large that their spread overflows; change their unit"
        )
    inside = x[(x >= low) & (x <= high)]
    if inside.size == 0:
        raise ValueError(f"{where}: every value is outside {low:g} to {high:g}; use a larger k")
    if to == "next":
        low, high = inside.min(), inside.max()
    return np.clip(x, low, high)


def _check_rule(outside: str, k: float, to: str) -> float:
    """Return k as a float, if the three parts of the rule fit each other."""
    one_of("outside", outside, OUTLIER_RULES)
    one_of("to", to, _TARGETS)
    k = positive("k", k)
    if outside == "quantile" and k >= 0.5:
        raise ValueError(f"k must be below 0.5 for quantiles, got {k:g}")
    if outside == "extremes" and (k != int(k) or to != "next"):
        raise ValueError(
            'outside="extremes" needs a whole number k and to="next" (there is no other limit), '
            f"got k={k:g} and to={to!r}"
        )
    return k


def _conditions(conditions: Sequence[Hashable] | None, table: ScoreTable) -> list:
    """Return the conditions to look at: all by default."""
    if conditions is None:
        return list(table.conditions)
    chosen = labels_of("conditions", conditions, 1)
    for condition in chosen:
        if condition not in table.conditions:
            hint = (
                f"{did_you_mean(condition, table.conditions)} (there are "
                f"{', '.join(map(str, table.conditions))})"
            )
            raise ValueError(f"conditions: {condition!r} is not in column {table.within!r}{hint}")
    return list(chosen)


def _cells(
    frame: pd.DataFrame, dv: Hashable, within: Hashable, subject: Hashable, conditions: Any
) -> tuple:
    """
    Return a table's scores and subjects, and the rows with a score of each condition.
    """
    chosen = _conditions(conditions, read_scores(frame, dv, within, subject))
    scores = pd.to_numeric(frame[dv]).to_numpy(dtype=float, na_value=np.nan).copy()
    labels = list(frame[within])
    rows = {
        condition: np.flatnonzero([label == condition for label in labels] & np.isfinite(scores))
        for condition in chosen
    }
    return scores, frame[subject].to_numpy(), rows


def winsorize(
    data: pd.DataFrame | Sequence[float] | np.ndarray,
    dv: Hashable | None = None,
    within: Hashable | None = None,
    subject: Hashable | None = None,
    *,
    outside: str,
    k: float,
    to: str,
    conditions: Sequence[Hashable] | None = None,
) -> Winsorized:
    """
    Replace outlying values, condition by condition, and list every change.

    Section 3.9.4.1 winsorizes two outliers of one condition and does not say by which rule; here
    every part of the rule is an argument without a default.

    Parameters
    ----------
    data : pandas.DataFrame or array_like, shape (N,)
        A long table with a row per subject and condition, or plain values. Missing cells of a table
        stay missing.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject; for a table only.
    outside : {"sd", "mad", "iqr", "quantile", "extremes"}
        Which values count as outlying: beyond k standard deviations from the mean, k scaled median
        absolute deviations from the median, k interquartile ranges from the quartiles, the
        quantiles k and 1 − k, or the k most extreme values at each end.
    k : float
        The rule's number.
    to : {"limit", "next"}
        What an outlying value becomes: the limit itself, or the most extreme value that is not
        outlying.
    conditions : sequence, optional
        The conditions to look at; all by default.

    Returns
    -------
    Winsorized

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.table`), a rule is unknown or
        cannot apply to so few or so many equal values, or a condition is unknown.

    Examples
    --------
    >>> import trustlab as tl
    >>> winsorized = tl.winsorize([1.0, 1.2, 0.9, 1.1, 9.0], outside="mad", k=3.0, to="limit")
    >>> winsorized.table()
       subject  condition  old       new
    0        4        NaN  9.0  1.544781
    """
    k = _check_rule(outside, k, to)
    words = OUTLIER_RULES[outside].format(k=k, rest=1.0 - k)
    if isinstance(data, pd.DataFrame):
        scores, subjects, groups = _cells(data, dv, within, subject, conditions)
        words += " of each condition" if outside == "extremes" else ", per condition"
    else:
        if any(argument is not None for argument in (dv, within, subject, conditions)):
            raise ValueError(
                "dv, within, subject and conditions are for a DataFrame; plain values have none"
            )
        if np.asarray(data).dtype.kind not in "iuf":
            raise ValueError(f"data must be numbers, got {np.asarray(data).dtype}")
        scores = finite_array("data", data).copy()
        subjects = np.arange(scores.size)
        groups = {np.nan: subjects}
    changes, limits = [], []
    for condition, rows in groups.items():
        x = scores[rows]
        where = "data" if dv is None else f"condition {condition!r} of {dv!r}"
        # _replace_outliers refuses a spread that overflows
        with np.errstate(over="ignore", invalid="ignore"):
            low, high = _limits(x, outside, k, where)
        new = _replace_outliers(x, low, high, to, where)
        moved = np.flatnonzero(new != x)
        changes += [(subjects[rows[i]], condition, x[i], new[i]) for i in moved]
        limits.append((condition, x.size, low, high, moved.size))
        scores[rows] = new
    result = scores
    if isinstance(data, pd.DataFrame):
        result = data.copy()
        result[dv] = scores
    moves = pd.DataFrame(changes, columns=["subject", "condition", "old", "new"])
    return Winsorized(
        data=result,
        changes=moves.astype({"old": float, "new": float}),
        limits=pd.DataFrame(limits, columns=["condition", "n", "low", "high", "changed"]),
        rule=f"{words}, {_TARGETS[to]}",
    )
