"""The rules a recipe is made of, but for its columns: one class per table of the TOML file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from trustlab.sessions.errors import RecipeError, nearest

__all__ = [
    "NUMBER",
    "RESAMPLING",
    "HeaderRule",
    "MetadataRule",
    "TableRule",
    "TimeRule",
    "check_keys",
    "check_resample",
    "check_type",
    "plain_key",
    "text_map",
]

RESAMPLING = ("previous", "linear", "nearest")
"""Ways to resample, by name."""

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
"""How a number is written in a table."""


def check_keys(table: object, known, where: str, source: str | None) -> dict:
    """
    Return a table of the recipe as a dictionary when every key in it is known.

    Parameters
    ----------
    table : mapping
        What the file has there.
    known : iterable of str
        The keys there may be.
    where : str
        Name of the table, for the error.
    source : str, optional
        The recipe, for the error.

    Raises
    ------
    RecipeError
        If it is not a table, or a key is unknown (the nearest one is suggested).
    """
    if not isinstance(table, Mapping):
        raise RecipeError(f"{where} must be a table, got {table!r}", source)
    known = list(known)
    for key in table:
        if key not in known:
            raise RecipeError(
                f"{where}: unknown key {key!r}{nearest(key, known)} (known: {', '.join(known)})", source
            )
    return dict(table)


def check_type(value: object, kinds: type | tuple, what: str, where: str, source: str | None) -> None:
    """
    Raise unless a value of the recipe has the type it should.

    Parameters
    ----------
    value : object
        What the file has there.
    kinds : type or tuple of types
        What it may be; a boolean passes only as bool, a number only when finite.
    what : str
        The same in words, for the error.
    where : str
        Name of the key, for the error.
    source : str, optional
        The recipe, for the error.
    """
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    good = isinstance(value, kinds) and (bool in kinds or not isinstance(value, bool))
    if good and isinstance(value, float):
        good = math.isfinite(value)
    if not good:
        raise RecipeError(f"{where} must be {what}, got {value!r}", source)


def plain_key(value: object) -> object:
    """
    Return what a value is looked up by in a map: "1", 1 and 1.0 are the same, "MANUAL" stays a text.

    Parameters
    ----------
    value : object
        A value of a log, or a key of a TOML map.
    """
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    text = str(value).strip()
    if NUMBER.fullmatch(text):
        number = float(text)
        return str(int(number)) if number.is_integer() and abs(number) < 1e15 else str(number)
    return text


def text_map(table: object, where: str, source: str | None, kinds: tuple, what: str) -> dict:
    """
    Return a map of the recipe with its keys made plain.

    Parameters
    ----------
    table : mapping
        What the file has there.
    where : str
        Name of the entry, for the error.
    source : str, optional
        The recipe, for the error.
    kinds : tuple of types
        What its values may be.
    what : str
        The same in words.
    """
    if not isinstance(table, Mapping) or not table:
        raise RecipeError(f"{where}: map must be a table such as {{ MANUAL = 1, AUTO = 0 }}", source)
    for key, value in table.items():
        check_type(value, kinds, what, f"{where}: map entry {key!r}", source)
    plain = {plain_key(key): value for key, value in table.items()}
    if len(plain) < len(table):
        raise RecipeError(f"{where}: two keys of the map mean the same value", source)
    return plain


def check_resample(value: object, where: str, source: str | None) -> None:
    """
    Raise unless the name is a way of resampling.

    Parameters
    ----------
    value : str
        The name.
    where : str
        What asked for it, for the error.
    source : str, optional
        The recipe or file, for the error.
    """
    if not isinstance(value, str) or value not in RESAMPLING:
        raise RecipeError(
            f"{where}: unknown resampling {value!r}{nearest(value, RESAMPLING)} (known: {', '.join(RESAMPLING)})",
            source,
        )


@dataclass(frozen=True)
class MetadataRule:
    """
    Where one entry of the metadata comes from.

    Parameters
    ----------
    name : str
        participant, condition, synthetic, or any other name.
    origin : str, optional
        A path field, ``header.<column>``, or a metadata name given before.
    value : object
        A constant instead.
    map : mapping, optional
        Values to values.
    default : object
        For values that the map does not list.
    keep : bool
        True to keep values that the map does not list.
    bins : tuple of float, optional
        Upper limits: the result is the number of limits below the value.
    """

    name: str
    origin: str | None = None
    value: object = None
    map: Mapping[str, object] | None = None
    default: object = None
    keep: bool = False
    bins: tuple[float, ...] | None = None

    @classmethod
    def parse(cls, name: str, table: object, source: str | None) -> MetadataRule:
        """
        Return the rule that one entry of ``[metadata]`` spells.

        Parameters
        ----------
        name : str
            The entry's name.
        table : mapping
            The entry.
        source : str, optional
            The recipe, for errors.
        """
        where = f"[metadata] {name}"
        if name in ("source", "t") or not name:
            raise RecipeError(f"{where}: this name is taken; choose another", source)
        table = check_keys(table, ("from", "value", "map", "default", "keep", "bins"), where, source)
        plain = (str, int, float, bool)
        if ("from" in table) == ("value" in table):
            raise RecipeError(f"{where}: needs either from or value", source)
        if "value" in table:
            check_keys(table, ("value",), f"{where} (a constant)", source)
            check_type(table["value"], plain, "a plain value", f"{where}: value", source)
            return cls(name, value=table["value"])
        check_type(table["from"], str, "a name", f"{where}: from", source)
        if "default" in table:
            check_type(table["default"], plain, "a plain value", f"{where}: default", source)
        if "keep" in table:
            check_type(table["keep"], bool, "true or false", f"{where}: keep", source)
        mapping = bins = None
        if "map" in table:
            mapping = text_map(table["map"], where, source, plain, "a plain value")
        elif "default" in table or "keep" in table:
            raise RecipeError(f"{where}: default and keep go with a map", source)
        if "bins" in table:
            bins = table["bins"]
            check_type(bins, list, "a list of rising numbers", f"{where}: bins", source)
            for limit in bins:
                check_type(limit, (int, float), "a number", f"{where}: bins", source)
            if mapping or not bins or any(a >= b for a, b in pairwise(bins)):
                raise RecipeError(f"{where}: bins must be rising numbers, and go without a map", source)
            bins = tuple(bins)
        return cls(name, table["from"], None, mapping, table.get("default"), table.get("keep", False), bins)


@dataclass(frozen=True)
class TableRule:
    """
    How a table of numbers is written.

    Parameters
    ----------
    header : bool
        Whether the first line names the columns; else they are named by index, from 0.
    delimiter : str
        What stands between cells: one character.
    decimal : str
        The decimal mark, "." or ",".
    skip_lines : int
        How many lines stand before the table.
    """

    header: bool = True
    delimiter: str = ","
    decimal: str = "."
    skip_lines: int = 0


@dataclass(frozen=True)
class TimeRule:
    """
    Where time comes from.

    Parameters
    ----------
    column : str or int, optional
        The column of a table.
    factor : float
        Its unit, in seconds.
    from_zero : bool
        Whether to count from the first sample; the start then goes to the metadata as start_time.
    stamp : str
        For bags: "receive" or "header".
    topics : mapping
        For bags: topics that use the other stamp.
    """

    column: str | int | None = "t"
    factor: float = 1.0
    from_zero: bool = False
    stamp: str = "receive"
    topics: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class HeaderRule:
    """
    A table beside the sessions with one row for each.

    Parameters
    ----------
    file : str
        Its path pattern, from the same folder as the sessions' pattern.
    keys : mapping
        Path fields to the header's columns that name them.
    """

    file: str
    keys: Mapping[str, str]
