"""The units that recipes may name, and their size in SI units."""

from __future__ import annotations

import math

from trustlab.sessions.errors import RecipeError, nearest

__all__ = ["UNITS", "to_si"]

UNITS: dict[str, tuple[str, float]] = {
    "1": ("1", 1.0),
    "%": ("1", 0.01),
    "percent": ("1", 0.01),
    "m": ("m", 1.0),
    "cm": ("m", 0.01),
    "mm": ("m", 0.001),
    "km": ("m", 1000.0),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "min": ("s", 60.0),
    "h": ("s", 3600.0),
    "m/s": ("m/s", 1.0),
    "cm/s": ("m/s", 0.01),
    "mm/s": ("m/s", 0.001),
    "km/h": ("m/s", 1.0 / 3.6),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180.0),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180.0),
}
"""Name of a unit: the SI unit it measures in, and how many of those it is."""


def to_si(unit: str, wanted: str, where: str = "unit", source: str | None = None) -> float:
    """
    Return the factor that turns a unit into the SI unit wanted.

    Parameters
    ----------
    unit : str
        A name from UNITS.
    wanted : str
        The SI unit of the column; "measure" takes any.
    where : str
        What the unit belongs to, for the error.
    source : str, optional
        The recipe, for the error.

    Raises
    ------
    RecipeError
        If the unit is unknown (the nearest name is suggested) or measures something else.
    """
    if not isinstance(unit, str) or unit not in UNITS:
        raise RecipeError(
            f"{where}: unknown unit {unit!r}{nearest(unit, UNITS)} (known: {', '.join(UNITS)})", source
        )
    base, factor = UNITS[unit]
    if wanted not in (base, "measure"):
        raise RecipeError(f"{where}: {unit!r} measures {base}, but {wanted} is needed", source)
    return factor
