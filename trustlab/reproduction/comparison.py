"""Computed numbers beside printed ones, digit by digit."""

from collections.abc import Mapping
from decimal import Decimal, localcontext

import numpy as np
import pandas as pd

from trustlab.models.checks import not_negative, table_of
from trustlab.reproduction.printed import ROUNDINGS, half_unit, printed_decimal


def matching_digits(value: float, printed: str) -> int:
    """
    Return how many significant digits of a printed number ours has, counted from the first.

    Parameters
    ----------
    value : float
        The value found here.
    printed : str
        The number as printed, trailing zeros kept; it cannot match in more digits than it has.

    Returns
    -------
    int
        The largest d up to the number of printed digits for which both round to the same d
        significant digits.
    """
    target = printed_decimal(printed)
    if not np.isfinite(value):
        return 0
    exact = Decimal(float(value))
    with localcontext(prec=400):  # of the greatest float to many decimals
        for digits in range(len(target.as_tuple().digits), 0, -1):
            unit = Decimal(1).scaleb(target.adjusted() - digits + 1)
            if any(exact.quantize(unit, rule) == target.quantize(unit, rule) for rule in ROUNDINGS):
                return digits
    return 0


def compare(
    values: Mapping[str, float],
    printed: Mapping[str, str],
    stderr: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """
    Put our values beside the printed ones.

    Parameters
    ----------
    values : mapping of str to float
        Values found here, by quantity.
    printed : mapping of str to str
        Values as printed, by the same quantities; it is an error if one side lacks any.
    stderr : mapping of str to float, optional
        Standard errors of our values.

    Returns
    -------
    pandas.DataFrame
        Index `quantity`; columns ours, stderr, printed, matching_digits, printed_digits, verdict:
        "reproduced" when ours rounds to the printed number, "within 2 s.e." when half a unit of its
        last digit and twice the standard error cover the difference, else "differs".

    Raises
    ------
    ValueError
        If the quantities differ, a printed value is not text or not a number, or a standard error
        is negative or of none of the quantities.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.compare({"a_pr": 0.99598, "beta": 0.74}, {"a_pr": "0.996", "beta": "0.74"}).T
    quantity               a_pr        beta
    ours                0.99598        0.74
    stderr                  NaN         NaN
    printed               0.996        0.74
    matching_digits           3           2
    printed_digits            3           2
    verdict          reproduced  reproduced
    """
    stderr = {} if stderr is None else stderr
    for name, table in {"values": values, "printed": printed, "stderr": stderr}.items():
        table_of(name, table)
    if set(values) != set(printed):
        only = sorted(set(values) ^ set(printed))
        raise ValueError(
            "values and printed must have the same quantities; only on one side: "
            f"{', '.join(map(str, only))}"
        )
    for name, error in stderr.items():
        if name not in values:
            raise ValueError(f"stderr: {name!r} is none of the quantities")
        if not (isinstance(error, float) and np.isnan(error)):  # none, beside a bound
            not_negative(f"stderr of {name}", error)
    rows = []
    for name, value in values.items():
        target = printed_decimal(printed[name])
        text = printed[name].strip()
        error = float(stderr.get(name, np.nan))
        counts = matching_digits(value, text), len(target.as_tuple().digits)
        verdict = "differs"
        if counts[0] == counts[1]:
            verdict = "reproduced"
        elif abs(float(value) - float(target)) <= half_unit(text) + 2.0 * error < np.inf:
            verdict = "within 2 s.e."
        rows.append((name, float(value), error, text, *counts, verdict))
    counted = "matching_digits", "printed_digits"
    columns = ["quantity", "ours", "stderr", "printed", *counted, "verdict"]
    return pd.DataFrame(rows, columns=columns).set_index("quantity")
