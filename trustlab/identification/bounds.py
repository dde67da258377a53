"""What the user holds fixed or within bounds."""

from __future__ import annotations

import difflib
from collections.abc import Mapping

from trustlab.identification.greybox import Structure

__all__ = ["limits_of"]


def _check_names(structure: Structure, given: Mapping, what: str) -> None:
    known = structure.shared + structure.initial
    for name in given:
        if name not in known:
            close = difflib.get_close_matches(str(name), known, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise ValueError(f"{what} names {name!r}, which is no parameter here ({', '.join(known)}){hint}")


def limits_of(structure: Structure, fixed: Mapping, bounds: Mapping) -> dict[str, tuple[float, float]]:
    """
    Return lowest and highest value by parameter; equal values for a fixed one.

    Parameters
    ----------
    structure : Structure
        The model structure.
    fixed : mapping
        Values to hold, by name.
    bounds : mapping
        (low, high) by name; None for an open side.
    """
    _check_names(structure, fixed, "fixed")
    _check_names(structure, bounds, "bounds")
    out = {}
    for name in structure.shared + structure.initial:
        low, high = structure.bounds(name)
        if name in bounds:
            own_low, own_high = bounds[name]
            own_low = low if own_low is None else float(own_low)
            own_high = high if own_high is None else float(own_high)
            if not own_low < own_high:
                raise ValueError(f"bounds of {name} must be (low, high) with low < high, got {bounds[name]}")
            if own_high <= low or own_low >= high:
                raise ValueError(f"bounds of {name}, {bounds[name]}, lie outside [{low:g}, {high:g}]")
            low, high = max(low, own_low), min(high, own_high)
        if name in fixed:
            value = float(fixed[name])
            if not low <= value <= high:
                raise ValueError(f"{name} is fixed at {value}, outside [{low:g}, {high:g}]")
            low = high = value
        out[name] = (low, high)
    return out
