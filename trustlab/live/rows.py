"""Which rows a browser may send: numbers that a drive with its settings can have."""

from collections.abc import Mapping
from typing import Any

from trustlab.live.tasks.task import sent_columns
from trustlab.models.checks import shown

LARGEST = 1e15
"""Size of a number in a row, in a message from a page, that no measure has."""

WHOLE = {"mode": (0, 1), "suggested_mode": (-1, 0, 1), "leader_choice": range(7)}
"""Columns with few values."""


def is_number(x: Any) -> bool:
    """
    Whether a value is a finite number of a size that any measure has; a whole number in JSON may
    have any number of digits.
    """
    return type(x) in (int, float) and -LARGEST <= x <= LARGEST


def check_row(config: Mapping[str, Any], row: Any) -> None:
    """Refuse a row, [number, ms, values …], that no drive with these settings can have."""
    columns = sent_columns(config)
    if not isinstance(row, list) or len(row) != 2 + len(columns) or not all(map(is_number, row)):
        raise ValueError(f"a row is {2 + len(columns)} finite numbers, got {shown(row)}")
    number, _, *values = row
    if type(number) is not int or not 0 <= number < config["samples"]:
        raise ValueError(f"rows of this drive have numbers 0 to {config['samples'] - 1}")
    for name, value in zip(columns, values, strict=True):
        low, high = config["limits"].get(name, (-LARGEST, LARGEST))
        if not low <= value <= high or value not in WHOLE.get(name, (value,)):
            raise ValueError(f"row {number}: {name} cannot be {value!r}")
