"""The columns a session can have, and the units in which a log may hold them."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from trustlab.models.checks import did_you_mean, shown
from trustlab.sessions.errors import SessionError, alternatives


@dataclass(frozen=True)
class Column:
    """One column; `unit` is SI, "1" for a pure number, or "measure" (that of the measure)."""

    name: str
    unit: str
    meaning: str
    low: float | None = None
    high: float | None = None


def _rows(name: str) -> list[list[str]]:
    """Return the rows of a file beside this one, without the names of its columns."""
    with (Path(__file__).parent / name).open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))[1:]


def _columns() -> Iterator[Column]:
    """Yield the columns of vocabulary.csv; a name that ends with * stands for three axes."""
    for name, unit, low, high, meaning in _rows("vocabulary.csv"):
        limits = (float(low) if low else None, float(high) if high else None)
        for axis in "xyz" if name.endswith("*") else ("",):
            words = f"{meaning}, {axis} axis" if axis else meaning
            yield Column(name.replace("*", axis), unit, words, *limits)


VOCABULARY: dict[str, Column] = {column.name: column for column in _columns()}


def known_column(name: str) -> Column:
    """Return a column of the vocabulary by its name."""
    if name not in VOCABULARY:
        hint = did_you_mean(str(name), VOCABULARY)
        remedy = "map it with a recipe, rename it, or leave it out with columns=[…]"
        raise SessionError(
            f"column {shown(name)} is not in the vocabulary{hint} ({remedy}; see "
            "trustlab.sessions.vocabulary())"
        )
    return VOCABULARY[name]


def vocabulary():
    """
    Return the vocabulary of session columns as a table.

    Returns
    -------
    pandas.DataFrame
        Index `column`; columns unit, low, high, meaning. The index of a session, t, is in seconds.
    """
    import pandas as pd

    table = pd.DataFrame(VOCABULARY.values()).rename(columns={"name": "column"}).set_index("column")
    return table[["unit", "low", "high", "meaning"]]


# Name of a unit: its SI unit, and how many of those it is (km/h: 1/3.6 m/s; deg: π/180 rad).
UNITS = {unit: (si, float(size)) for unit, si, size in _rows("units.csv")}


def to_si(unit: str, target: str) -> float:
    """Return the factor that converts a unit to the SI unit wanted; "measure" takes any unit."""
    if not isinstance(unit, str) or unit not in UNITS:
        raise ValueError(f"unknown unit {shown(unit)}{alternatives(unit, UNITS)}")
    base, factor = UNITS[unit]
    if target not in (base, "measure"):
        remedy = "; leave the unit out" if target == "1" else ""
        raise ValueError(f"{unit!r} measures {base}, but {target} is needed{remedy}")
    return factor
