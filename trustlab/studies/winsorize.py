"""Winsorizing: outlying values are replaced by an explicit rule, and every change is listed."""

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of, positive
from trustlab.models.display import Result
from trustlab.studies.table import numbers_of, read_cells, read_factors

# Which values count as outlying, by the name of the rule and its k.
OUTLIER_RULES = {
    "sd": "values outside mean ± {k:g} standard deviations",
    "mad": "values outside median ± {k:g} scaled median absolute deviations",
    "iqr": "values outside the quartiles ± {k:g} interquartile ranges",
    "quantile": "values outside the quantiles {k:g} and {rest:g}",
    "extremes": "the {k:g} lowest and {k:g} highest values",
}

_TARGETS = {"limit": "set to that limit", "next": "set to the next most extreme value"}

# 1/Φ⁻¹(3/4): times the median absolute deviation it estimates the standard deviation of normal
# values.
_MAD_TO_SD = 1.482602218505602


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
        return self.changes

    def apa(self) -> str:
        """
        Return the sentence for a paper: how many values were changed, of whom, and by which rule.
        """
        total = int(self.limits["n"].sum())
        if self.changes.empty:
            return f"None of {total} values was winsorized (rule: {self.rule})."
        parts = []
        for condition, rows in self.changes.groupby("condition", sort=False):
            parts.append(f"{condition}, subject {', '.join(map(str, rows['subject']))}")
        verb = "was" if len(self.changes) == 1 else "were"
        return (
            f"{len(self.changes)} of {total} values {verb} winsorized ({'; '.join(parts)}). "
            f"Rule: {self.rule}."
        )


def _limits(x: np.ndarray, outside: str, k: float) -> np.ndarray:
    """Return the two limits beyond which values are outlying."""
    if outside == "extremes":
        return np.sort(x)[[int(k), -1 - int(k)]]
    if outside == "quantile":
        return np.quantile(x, [k, 1.0 - k])
    centre, spread = x.mean(), x.std(ddof=1)
    if outside == "iqr":
        centre = np.quantile(x, [0.25, 0.75])
        spread = np.ptp(centre)
    elif outside == "mad":
        centre = np.median(x)
        spread = _MAD_TO_SD * np.median(np.abs(x - centre))
    if spread == 0.0 and np.ptp(x) > 0.0:
        spread = np.nan
    return centre + k * spread * np.array([-1.0, 1.0])


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
    outside : {"sd", "mad", "iqr", "quantile", "extremes"}
        Which values count as outlying: beyond k standard deviations from the mean, k scaled median
        absolute deviations from the median, k interquartile ranges from the quartiles, the
        quantiles k and 1 − k, or the k most extreme values at each end.
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
        If the table is refused (see `repeated_measures`), a rule is unknown or
        cannot apply to so few or so many equal values.

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
    one_of("outside", outside, OUTLIER_RULES)
    one_of("to", to, _TARGETS)
    k = positive("k", k)
    if (outside == "quantile" and k >= 0.5) or (outside == "extremes" and (k % 1 or to != "next")):
        raise ValueError(
            f'k = {k:g}, to = {to!r}: outside="quantile" needs a k below 0.5, outside="extremes" a '
            'whole k and to="next"'
        )
    (levels,) = read_factors(data, dv, [within], subject)[0].values()
    read_cells(data, dv, {within: levels}, subject)
    subjects, scores = data[subject].to_numpy(), numbers_of(data[dv], "dv")
    changes, limits = [], []
    for condition in levels:
        rows = np.flatnonzero((data[within] == condition) & np.isfinite(scores))
        old = scores[rows]
        if old.size < 3 or (outside == "extremes" and 2 * k >= old.size):
            raise ValueError(f"dv: {old.size} values of {condition!r} are too few for this rule")
        low, high = _limits(old, outside, k).tolist()
        inside = old[(old >= low) & (old <= high)]
        if not inside.size:
            raise ValueError(
                f"dv: by this rule no value of {condition!r} lies inside {low:g} to {high:g}; so "
                "many are equal that their spread is 0, or k does not fit"
            )
        new = np.clip(old, *((low, high) if to == "limit" else (inside.min(), inside.max())))
        moved = np.flatnonzero(new != old)
        changes += [(subjects[rows[i]], condition, old[i], new[i]) for i in moved]
        limits.append((condition, old.size, low, high, moved.size))
        scores[rows] = new
    result = data.copy()
    result[dv] = scores
    moves = pd.DataFrame(changes, columns=["subject", "condition", "old", "new"])
    return Winsorized(
        data=result,
        changes=moves.astype({"old": float, "new": float}),
        limits=pd.DataFrame(limits, columns=["condition", "n", "low", "high", "changed"]),
        rule=f"{OUTLIER_RULES[outside].format(k=k, rest=1.0 - k)} by condition, {_TARGETS[to]}",
    )
