"""Ours | printed | matching digits | verdict."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal, InvalidOperation

import numpy as np
import pandas as pd

__all__ = ["compare", "matching_digits"]


def _printed(text: str) -> Decimal:
    if not isinstance(text, str):
        raise ValueError(
            f"a printed value must be text in quotes, as printed, for example '0.390', got {text!r:.60} "
            f"({type(text).__name__}): a number has lost its trailing zeros"
        )
    try:
        value = Decimal(text.strip())
    except InvalidOperation:
        raise ValueError(
            f"a printed value must be a number as printed, for example '0.390', got {text!r}"
        ) from None
    if not value.is_finite():
        raise ValueError(f"a printed value must be finite, got {text!r}")
    return value


def matching_digits(ours: float, printed: str) -> int:
    """
    Return how many significant digits of a printed number ours has, counted from the first.

    Parameters
    ----------
    ours : float
        The value found here.
    printed : str
        The number as printed, trailing zeros kept; it cannot match in more digits than it has.

    Returns
    -------
    int
        The largest d up to the number of printed digits for which both round to the same d significant digits.
    """
    target = _printed(printed)
    if not np.isfinite(ours):
        return 0
    value = Decimal(float(ours))
    if target == 0:
        return int(_rounds_to(value, target))
    digits, top = len(target.normalize().as_tuple().digits), target.adjusted()
    digits = max(digits, top - target.as_tuple().exponent + 1)
    for d in range(digits, 0, -1):
        unit = Decimal(1).scaleb(top - d + 1)
        if any(
            value.quantize(unit, rule) == target.quantize(unit, rule)
            for rule in (ROUND_HALF_EVEN, ROUND_HALF_UP)
        ):
            return d
    return 0


def _rounds_to(value: Decimal, target: Decimal) -> bool:
    unit = Decimal(1).scaleb(target.as_tuple().exponent)
    return any(value.quantize(unit, rule) == target for rule in (ROUND_HALF_EVEN, ROUND_HALF_UP))


def compare(
    ours: Mapping[str, float], printed: Mapping[str, str], stderr: Mapping[str, float] | None = None
) -> pd.DataFrame:
    """
    Put our values beside the printed ones.

    Parameters
    ----------
    ours : mapping of str to float
        Values found here, by quantity.
    printed : mapping of str to str
        Values as printed, by the same quantities; what only one side has is an error.
    stderr : mapping of str to float, optional
        Standard errors of our values.

    Returns
    -------
    pandas.DataFrame
        Index `quantity`; columns ours, stderr, printed, matching_digits, printed_digits, verdict: "rounds to it"
        when ours rounds to the printed number, "within 2 s.e." when half a unit of its last digit and twice the
        standard error cover the difference, else "differs".

    Raises
    ------
    ValueError
        If the quantities differ, or a printed value is not text or no number.
    """
    if set(ours) != set(printed):
        only = sorted(set(ours) ^ set(printed))
        raise ValueError(
            f"both sides must have the same quantities; only on one side: {', '.join(map(str, only))}"
        )
    rows = []
    for name, value in ours.items():
        target = _printed(printed[name])
        text = printed[name].strip()
        error = float((stderr or {}).get(name, np.nan))
        half = 0.5 * float(Decimal(1).scaleb(target.as_tuple().exponent))
        verdict = "differs"
        if np.isfinite(value) and _rounds_to(Decimal(float(value)), target):
            verdict = "rounds to it"
        elif np.isfinite(error) and abs(float(value) - float(target)) <= half + 2.0 * error:
            verdict = "within 2 s.e."
        digits = max(
            len(target.normalize().as_tuple().digits), target.adjusted() - target.as_tuple().exponent + 1
        )
        rows.append((name, float(value), error, text, matching_digits(value, text), digits, verdict))
    columns = ["quantity", "ours", "stderr", "printed", "matching_digits", "printed_digits", "verdict"]
    return pd.DataFrame(rows, columns=columns).set_index("quantity")
