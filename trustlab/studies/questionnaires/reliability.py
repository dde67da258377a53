"""Cronbach's alpha with Feldt's interval."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, open_unit


@dataclass(frozen=True, eq=False)
class Reliability:
    """
    Internal consistency of a scale.

    Parameters
    ----------
    alpha : float
        Cronbach's alpha.
    ci_low, ci_high : float
        Its interval (Feldt's F interval, unrounded).
    confidence : float
        The interval's level.
    n, items : int
        How many subjects and items.
    without : pandas.Series
        Alpha of the scale less each item; NaN where one item is left.
    """

    alpha: float
    ci_low: float
    ci_high: float
    confidence: float
    n: int
    items: int
    without: pd.Series

    def table(self) -> pd.DataFrame:
        """Return one row: n, items, alpha, ci_low, ci_high."""
        names = ("n", "items", "alpha", "ci_low", "ci_high")
        return pd.DataFrame([{name: getattr(self, name) for name in names}])


def cronbach_alpha(items: pd.DataFrame, confidence: float = 0.95) -> Reliability:
    """
    Return Cronbach's alpha of items scored in the same direction, α = k/(k − 1) · (1 − Σ s_i²/s²), by pingouin.

    Parameters
    ----------
    items : pandas.DataFrame
        A row per subject, a column per item, reversed items already recoded; no missing values.
    confidence : float
        Level of the interval.

    Returns
    -------
    Reliability

    Raises
    ------
    ValueError
        If there are fewer than two items or three subjects, an answer is missing or not a number, or the sum of the items
        is the same for all subjects.

    References
    ----------
    L. S. Feldt, D. J. Woodruff, F. A. Salih, Statistical inference for coefficient alpha, Applied Psychological
    Measurement 11 (1987) 93-103.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> items = pd.DataFrame({"q1": [1, 2, 4, 5], "q2": [2, 2, 5, 4], "q3": [1, 3, 4, 5]})
    >>> round(tl.cronbach_alpha(items).alpha, 3)
    0.946
    """
    from pingouin import cronbach_alpha as alpha_of
    from scipy.stats import f

    of_class("items", items, pd.DataFrame, "give a column per item")
    confidence = open_unit("confidence", confidence)
    n, k = items.shape
    if k < 2:
        raise ValueError(f"alpha needs at least two items, got {k}")
    if n < 3:
        raise ValueError(f"alpha needs at least three subjects who answered every item, got {n}")
    for j, name in enumerate(items.columns):
        if name in items.columns[:j]:
            raise ValueError(f"item {name!r} occurs twice; keep or rename one of the columns")
        column = items.iloc[:, j]
        if column.dtype.kind not in "iuf" or not np.isfinite(column).all():
            raise ValueError(f"item {name!r} must hold only finite numbers (dtype {column.dtype})")
    numbers = items.astype(float).set_axis(range(k), axis=1).reset_index(drop=True)
    if np.abs(numbers.to_numpy()).max() > 1e100:
        raise ValueError("items are so large that their squares overflow; change their unit")
    numbers /= np.ldexp(1.0, np.frexp(np.abs(numbers.to_numpy()).max())[1])  # squares of tiny numbers underflow
    if np.ptp(numbers.sum(axis=1)) == 0.0:
        raise ValueError("the items' sum is the same for all subjects: alpha is not defined")
    alpha = float(alpha_of(data=numbers)[0])
    df1, df2, tail = n - 1, (n - 1) * (k - 1), (1.0 - confidence) / 2.0
    low, high = (1.0 - (1.0 - alpha) * float(f.isf(p, df1, df2)) for p in (tail, 1.0 - tail))
    rest = {}
    for j, name in enumerate(items.columns):
        left = numbers.drop(columns=j)
        rest[name] = float(alpha_of(data=left)[0]) if k > 2 and np.ptp(left.sum(axis=1)) > 0.0 else np.nan
    return Reliability(alpha, low, high, confidence, n, k, pd.Series(rest, name="alpha_without"))
