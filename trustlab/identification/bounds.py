"""What the user holds fixed or within bounds."""

from __future__ import annotations

import difflib
from collections.abc import Mapping

from trustlab.identification.greybox import Structure
from trustlab.models.checks import finite_number

__all__ = ["check_method", "limits_of"]


def check_method(method: str, fixed: Mapping, bounds: Mapping, noise: str) -> None:
    """
    Raise unless the method is known and is given only what it has a use for.

    Parameters
    ----------
    method : str
        "output_error" or "arx".
    fixed, bounds : mapping
        What is held or bounded; nothing for "arx".
    noise : str
        What standard errors allow for; "auto" for "arx".

    Raises
    ------
    ValueError
        If not.
    """
    if method not in ("output_error", "arx"):
        raise ValueError(f'method must be "output_error" or "arx", got {method!r}')
    if method == "arx" and (fixed or bounds or noise != "auto"):
        raise ValueError(
            'method "arx" is plain least squares; to fix or bound a parameter, or choose its noise, use "output_error"'
        )


def _check_names(structure: Structure, given: Mapping, what: str) -> None:
    known = structure.shared + structure.initial
    for name in given:
        if name not in known:
            if name == "p_h_max":
                raise ValueError(
                    "p_h_max is not a parameter of the search; give it as fit_robot(..., p_h_max=...)"
                )
            close = [own for own in known if own.endswith(f"_{name}")]
            close = close or difflib.get_close_matches(str(name), known, n=1)
            hint = f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
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
    for what, given in (("fixed", fixed), ("bounds", bounds)):
        if not isinstance(given, Mapping):
            raise ValueError(
                f"{what} must be a dictionary by parameter, for example {{'a': ...}}, got {given!r}"
            )
        _check_names(structure, given, what)
    for name in set(fixed) & set(bounds):
        raise ValueError(f"{name} is both fixed and bounded; say one of them")
    out = {}
    for name in structure.shared + structure.initial:
        low, high = structure.bounds(name)
        if name in bounds:
            pair = bounds[name]
            if not isinstance(pair, (tuple, list)) or len(pair) != 2:
                raise ValueError(
                    f"bounds of {name} must be a pair (low, high), None for an open side, got {pair!r}"
                )
            own_low = low if pair[0] is None else finite_number(f"lower bound of {name}", pair[0])
            own_high = high if pair[1] is None else finite_number(f"upper bound of {name}", pair[1])
            if not own_low < own_high:
                raise ValueError(f"bounds of {name} must be (low, high) with low < high, got {bounds[name]}")
            if own_high <= low or own_low >= high:
                raise ValueError(f"bounds of {name}, {bounds[name]}, lie outside [{low:g}, {high:g}]")
            low, high = max(low, own_low), min(high, own_high)
        if name in fixed:
            value = finite_number(f"fixed {name}", fixed[name])
            if not low <= value <= high:
                raise ValueError(f"{name} is fixed at {value}, outside ({low:.3g}, {high:.9g})")
            low = high = value
        out[name] = (low, high)
    for prefix in ("", "human_", "robot_"):
        least, most = (fixed.get(f"{prefix}{name}") for name in ("p_min", "p_max"))
        if least is not None and most is not None and not least < most:
            raise ValueError(f"{prefix}p_min is fixed at {least}, not below {prefix}p_max at {most}")
    return out
