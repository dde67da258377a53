"""Computed numbers beside printed ones: digits, and the least change that explains."""

from collections.abc import Callable, Mapping
from decimal import Decimal

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of, shown, whole_number
from trustlab.reproduction.printed_number import ROUNDINGS, half_unit, printed_decimal, rounds_to

Compute = Callable[[dict[str, float]], Mapping[str, float]]


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
    if target == 0:
        return int(rounds_to(value, target))
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
        If the quantities differ, or a printed value is not text or not a number.

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
    if set(values) != set(printed):
        only = sorted(set(values) ^ set(printed))
        raise ValueError(
            "both sides must have the same quantities; only on one side: "
            f"{', '.join(map(str, only))}"
        )
    rows = []
    for name, value in values.items():
        target = printed_decimal(printed[name])
        text = printed[name].strip()
        error = float((stderr or {}).get(name, np.nan))
        verdict = "differs"
        if np.isfinite(value) and rounds_to(value, target):
            verdict = "reproduced"
        elif abs(float(value) - float(target)) <= half_unit(text) + 2.0 * error < np.inf:
            verdict = "within 2 s.e."
        counts = matching_digits(value, text), len(target.as_tuple().digits)
        rows.append((name, float(value), error, text, *counts, verdict))
    counted = "matching_digits", "printed_digits"
    columns = ["quantity", "ours", "stderr", "printed", *counted, "verdict"]
    return pd.DataFrame(rows, columns=columns).set_index("quantity")


def smallest_change(
    compute: Compute,
    inputs: Mapping[str, str] | pd.Series,
    output: str,
    printed: str,
    units: int = 400,
) -> pd.DataFrame:
    """
    Find which single printed input, changed least, makes an output round to its printed value.

    Parameters
    ----------
    compute : callable
        Takes inputs as a dictionary of floats and returns outputs by name; may raise ValueError
        where inputs are impossible, which is passed over.
    inputs : mapping of str to str, or pandas.Series
        Numbers as printed.
    output : str
        The output to explain.
    printed : str
        Its printed value.
    units : int
        Greatest change to try, in units of an input's last digit.

    Returns
    -------
    pandas.DataFrame
        One row per input that can explain it, least change first: input, printed, needed, units (of
        its last digit).

    Raises
    ------
    ValueError
        If the output is not computed, or an argument is not understood.
    """
    if not isinstance(inputs, Mapping | pd.Series) or not len(inputs):
        raise ValueError(f"inputs must map names to numbers as printed, got {shown(inputs)}")
    units_of = {name: 2.0 * half_unit(text) for name, text in inputs.items()}
    reach, units = half_unit(printed), whole_number("units", units, most=10**5)
    middle = {name: float(text) for name, text in inputs.items()}
    if not callable(compute):
        raise ValueError(f"compute must be a function of a dictionary, got {shown(compute)}")
    one_of("output", output, compute(dict(middle)))
    target, rows = float(printed), []
    for name, unit in units_of.items():
        for k in sorted(range(-units, units + 1), key=abs):
            try:
                value = compute(middle | {name: middle[name] + k * unit})[output]
            except ValueError:
                continue
            if abs(value - target) <= reach:
                rows.append((name, inputs[name], middle[name] + k * unit, k))
                break
    table = pd.DataFrame(rows, columns=["input", "printed", "needed", "units"])
    return table.sort_values("units", key=np.abs, ignore_index=True)
