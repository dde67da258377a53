"""Winsorizing: outlying values are moved in by a rule that is named, and every change is listed."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import did_you_mean, finite_array, finite_number
from trustlab.studies.analysis.score_table import read_scores

__all__ = ["OUTLIER_RULES", "Winsorized", "winsorize"]

OUTLIER_RULES = {
    "sd": "outside mean ± {k:g} standard deviations",
    "mad": "outside median ± {k:g} scaled median absolute deviations",
    "iqr": "outside the quartiles ± {k:g} interquartile ranges",
    "quantile": "outside the quantiles {k:g} and {rest:g}",
    "extremes": "the {k:g} lowest and {k:g} highest values",
}
"""Which values count as outlying, by the name of the rule and its k."""

_TARGETS = {"limit": "set to that limit", "next": "set to the next most extreme value"}


@dataclass(frozen=True, eq=False)
class Winsorized:
    """
    Data after winsorizing, and what was changed.

    Parameters
    ----------
    data : pandas.DataFrame or numpy.ndarray
        What was given, with outlying values moved in; rows, order and other columns as they were.
    changes : pandas.DataFrame
        Values changed: subject (position from 0 for an array), condition (NaN for an array), old, new.
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
        """Return the sentence a paper needs: how many values of how many, whose, and by which rule."""
        of = int(self.limits["n"].sum())
        if self.changes.empty:
            return f"None of {of} values was winsorized (rule: {self.rule})."
        parts = []
        for condition, own in self.changes.groupby("condition", sort=False, dropna=False):
            who = ", ".join(map(str, own["subject"]))
            where = "" if pd.isna(condition) else f" in {condition}"
            parts.append(f"{len(own)}{where} ({'position' if pd.isna(condition) else 'subject'} {who})")
        word = "values was" if len(self.changes) == 1 else "values were"
        return f"{len(self.changes)} of {of} {word} winsorized: {'; '.join(parts)}. Rule: {self.rule}."

    def _repr_html_(self) -> str:
        return f"<p>{self.apa()}</p>{self.changes._repr_html_()}"


def _limits(x: np.ndarray, outside: str, k: float, where: str) -> tuple[float, float]:
    """Return the lowest and highest value that is not outlying; not finite where the spread overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        return _limits_by_rule(x, outside, k, where)


def _limits_by_rule(x: np.ndarray, outside: str, k: float, where: str) -> tuple[float, float]:
    n = x.size
    if n < 3:
        raise ValueError(f"{where}: {n} values; winsorizing needs at least three")
    if np.ptp(x) == 0.0:
        return float(x[0]), float(x[0])
    if outside == "sd":
        reach = (n - 1) / np.sqrt(n)
        if k >= reach:
            raise ValueError(
                f"{where}: none of {n} values can lie {k:g} standard deviations from their mean (at most {reach:.3g}); "
                'use a smaller k or outside="mad" or "iqr"'
            )
        return float(x.mean() - k * x.std(ddof=1)), float(x.mean() + k * x.std(ddof=1))
    if outside == "extremes":
        if 2 * k >= n:
            raise ValueError(f"{where}: {k:g} values at each end are all of the {n}; use a smaller k")
        ordered = np.sort(x)
        return float(ordered[int(k)]), float(ordered[n - 1 - int(k)])
    if outside == "quantile":
        low, high = np.quantile(x, [k, 1.0 - k])
        return float(low), float(high)
    if outside == "mad":
        centre = np.median(x)
        spread = 1.482602218505602 * float(np.median(np.abs(x - centre)))
        low = high = float(centre)
    else:
        low, high = (float(q) for q in np.quantile(x, [0.25, 0.75]))
        spread = high - low
    if spread == 0.0:
        raise ValueError(
            f"{where}: so many values are the same that their {'median absolute deviation' if outside == 'mad' else 'interquartile range'} "
            "is 0, and every other value would count as outlying; choose another rule"
        )
    return low - k * spread, high + k * spread


def _moved(x: np.ndarray, low: float, high: float, to: str, where: str) -> np.ndarray:
    if not np.isfinite([low, high]).all():
        raise ValueError(f"{where}: values are so large that their spread overflows; change their unit")
    inside = x[(x >= low) & (x <= high)]
    if inside.size == 0:
        raise ValueError(f"{where}: every value is outside {low:g} to {high:g}; use a larger k")
    if to == "next":
        low, high = inside.min(), inside.max()
    return np.clip(x, low, high)


def _check_rule(outside: str, k: float, to: str) -> float:
    if not isinstance(outside, str) or outside not in OUTLIER_RULES:
        raise ValueError(f"outside must be one of {', '.join(OUTLIER_RULES)}; got {outside!r}")
    if not isinstance(to, str) or to not in _TARGETS:
        raise ValueError(f'to must be "limit" or "next", got {to!r}')
    if isinstance(k, bool):
        raise ValueError(f"k must be a number, got {k!r}")
    k = finite_number("k", k)
    if k <= 0.0 or (outside == "quantile" and k >= 0.5):
        raise ValueError(f"k must be above 0{' and below 0.5' if outside == 'quantile' else ''}, got {k:g}")
    if outside == "extremes" and (k != int(k) or to != "next"):
        raise ValueError(
            f'outside="extremes" needs a whole number k and to="next" (there is no other limit), got k={k:g} and to={to!r}'
        )
    return k


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
    Move outlying values in, condition by condition, and list what was changed.

    Section 3.9.4.1 winsorizes two outliers of one condition and does not say by which rule; here every part of the
    rule is an argument without a default.

    Parameters
    ----------
    data : pandas.DataFrame or array_like, shape (N,)
        A long table with a row per subject and condition, or plain values. Missing cells of a table stay missing.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject; for a table only.
    outside : {"sd", "mad", "iqr", "quantile", "extremes"}
        Which values count as outlying: beyond k standard deviations from the mean, k scaled median absolute deviations
        from the median, k interquartile ranges from the quartiles, the quantiles k and 1 − k, or the k most extreme
        values at each end.
    k : float
        The rule's number.
    to : {"limit", "next"}
        What an outlying value becomes: the limit itself, or the most extreme value that is not outlying.
    conditions : sequence, optional
        The conditions to look at; all by default.

    Returns
    -------
    Winsorized

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.analysis.score_table`), a rule is unknown or cannot apply to so few or so
        many equal values, or a condition is unknown.
    """
    k = _check_rule(outside, k, to)
    rule = f"values {OUTLIER_RULES[outside].format(k=k, rest=1.0 - k)}, per condition, {_TARGETS[to]}"
    if outside == "extremes":
        rule = f"{OUTLIER_RULES[outside].format(k=k)} of each condition, {_TARGETS[to]}"
    if not isinstance(data, pd.DataFrame):
        if any(argument is not None for argument in (dv, within, subject, conditions)):
            raise ValueError("dv, within, subject and conditions are for a DataFrame; plain values have none")
        if np.asarray(data).dtype.kind not in "iuf":
            raise ValueError(f"data must be numbers, got {np.asarray(data).dtype}")
        x = finite_array("data", data)
        low, high = _limits(x, outside, k, "data")
        new = _moved(x, low, high, to, "data")
        at = np.flatnonzero(new != x)
        changes = pd.DataFrame({"subject": at, "condition": np.nan, "old": x[at], "new": new[at]})
        limits = pd.DataFrame([(np.nan, x.size, low, high, at.size)], columns=_LIMIT_COLUMNS)
        return Winsorized(
            new, changes, limits, rule.replace(", per condition", "").replace(" of each condition", "")
        )

    table = read_scores(data, dv, within, subject)
    chosen = list(table.conditions) if conditions is None else conditions
    if isinstance(chosen, str) or not isinstance(chosen, Sequence | np.ndarray) or len(chosen) == 0:
        raise ValueError(f"conditions must be a list of conditions, got {conditions!r}")
    for condition in chosen:
        if condition not in table.conditions:
            raise ValueError(
                f"conditions: {condition!r} is not in column {within!r}{did_you_mean(condition, table.conditions)} "
                f"(there are {', '.join(map(str, table.conditions))})"
            )
    if len(set(chosen)) < len(chosen):
        raise ValueError(f"conditions lists one twice: {list(chosen)}")
    frame = data.copy()
    scores = pd.to_numeric(frame[dv]).to_numpy(dtype=float, na_value=np.nan).copy()
    labels, who = list(frame[within]), frame[subject].to_numpy()
    changes, limits = [], []
    for condition in chosen:
        rows = np.flatnonzero([label == condition for label in labels] & np.isfinite(scores))
        x, where = scores[rows], f"condition {condition!r} of {dv!r}"
        low, high = _limits(x, outside, k, where)
        new = _moved(x, low, high, to, where)
        moved = new != x
        changes += [
            (who[row], condition, old, value)
            for row, old, value in zip(rows[moved], x[moved], new[moved], strict=True)
        ]
        limits.append((condition, x.size, low, high, int(moved.sum())))
        scores[rows] = new
    frame[dv] = scores
    return Winsorized(
        frame,
        pd.DataFrame(changes, columns=["subject", "condition", "old", "new"]),
        pd.DataFrame(limits, columns=_LIMIT_COLUMNS),
        rule,
    )


_LIMIT_COLUMNS = ["condition", "n", "low", "high", "changed"]
