"""
Numbers as printed: text whose last digit says how far they were rounded, the greatest standard
deviation beside a printed mean, and computed numbers beside printed ones, digit by digit.
"""

import math
import re
from collections.abc import Mapping
from decimal import ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal, InvalidOperation, localcontext
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import not_negative, shown, table_of

Interval = tuple[float, float]

# Both conventions for a 5 that is rounded off; which one a printed number followed is not known.
ROUNDINGS = (ROUND_HALF_EVEN, ROUND_HALF_UP)


def _parsed(text: str, name: str) -> tuple[str, Decimal]:
    """Return the inequality sign, or an empty text, and the number of a printed text."""
    match = re.fullmatch(r"\s*([<>]?)\s*(\S+)\s*", text) if isinstance(text, str) else None
    try:
        value = Decimal(match[2]) if match else None
    except InvalidOperation:
        value = None
    if value is None or not value.is_finite():
        raise ValueError(
            f"{name} must be a number as printed, in quotes and with a decimal point, for example "
            f"'0.390', got {shown(text)}"
        )
    return match[1], value


def printed_decimal(text: str, name: str = "a printed value") -> Decimal:
    """Return a printed number with the digits it was printed with; inequalities are refused."""
    sign, value = _parsed(text, name)
    if sign:
        raise ValueError(f"{name} must be a number as printed, not the inequality {text!r}")
    return value


def _half(value: Decimal) -> Decimal:
    """Return half a unit of a number's last digit."""
    return Decimal(5).scaleb(int(value.as_tuple().exponent) - 1)


def half_unit(printed: str) -> float:
    """
    Return half a unit of a printed number's last digit: 0.0005 for "0.320", 5e-8 for "5.44e-5".
    """
    return float(_half(printed_decimal(printed)))


def printed_interval(text: str, name: str = "a printed value") -> tuple[float, float]:
    """
    Return what rounds to a printed number, or what a printed inequality such as "<.0005" allows.
    """
    sign, value = _parsed(text, name)
    if sign == "<":
        return -math.inf, float(value)
    if sign == ">":
        return float(value), math.inf
    # In decimals, so that 0.50 gives 0.495 and 0.505 and not what binary fractions make of them.
    half = _half(value)
    return float(value - half), float(value + half)


def greatest_sd(mean: tuple[Any, Any], n: Any, scale: Interval) -> Any:
    """
    Return the greatest standard deviation of n values within a scale, with a mean between two ends;
    takes numbers or arrays.
    """
    low, high = scale
    if math.isinf(low):
        return math.inf
    if math.isinf(high):  # all values but one are the lowest
        return (mean[1] - low) * np.sqrt(n)
    # All values lie at the ends of the scale, and the mean as near its middle as can be.
    middle = np.clip(0.5 * (low + high), *mean)
    return np.sqrt(np.maximum((middle - low) * (high - middle), 0.0) * n / (n - 1))


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
    if alone := (values.keys() ^ printed.keys()) | (stderr.keys() - values.keys()):
        raise ValueError(
            "values and printed must have the same quantities, and stderr none but these; not so: "
            f"{', '.join(sorted(map(str, alone)))}"
        )
    for name, error in stderr.items():
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
