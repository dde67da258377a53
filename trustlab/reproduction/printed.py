"""
Numbers as printed: text whose last digit says how far they were rounded; and what printed means and
standard deviations allow, whatever the data.
"""

import math
import re
from decimal import ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal, InvalidOperation
from typing import Any

import numpy as np
from scipy import optimize

from trustlab.models.checks import shown

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
        lost = f" ({type(text).__name__}): it has lost its trailing zeros"
        if isinstance(text, str):
            lost = "; write a decimal point" if "," in text else ""
        raise ValueError(
            f"{name} must be a number as printed, in quotes, for example '0.390', got "
            f"{shown(text)}{lost}"
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


def possible_f(mean: np.ndarray, sd: np.ndarray, n: float) -> Interval:
    """
    Return bounds of F over boxes (k, 2) of means and standard deviations, at any correlations.

    With T = tr(PS), F = n Σ(m − m̄)²/T. An end that is open allows everything.
    """
    largest = np.maximum(sd[:, 1], 0.0)
    # T is least where all correlations are 1, and greatest where the sum of conditions is constant.
    least_error = _least_spread(np.maximum(sd, 0.0))
    most_error = 0.5 * largest.sum() ** 2 if len(sd) == 2 else (largest**2).sum()
    most_effect = (np.abs(mean - mean.mean()).max(axis=1) ** 2).sum()
    return np.divide(n * _least_spread(mean), most_error), np.divide(n * most_effect, least_error)


def _least_spread(boxes: np.ndarray) -> float:
    """Return a lower bound of Σ(m − m̄)², the least of Σ(m − c)² by c, over intervals (k, 2)."""
    low, high = boxes.T
    if low.max() <= high.min():
        return 0.0

    def spread(c: float) -> float:
        return float((np.maximum(np.maximum(low - c, c - high), 0.0) ** 2).sum())

    return optimize.minimize_scalar(spread, (high.min(), low.max())).fun * (1.0 - 1e-6)
