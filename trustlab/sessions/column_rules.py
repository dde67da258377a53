"""Rules for columns: where each column of a session comes from."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trustlab.sessions.errors import RecipeError, nearest
from trustlab.sessions.rules import check_keys, check_resample, check_type, text_map
from trustlab.sessions.units import to_si
from trustlab.sessions.vocabulary import VOCABULARY

__all__ = ["ColumnRule", "FieldPath"]

_STEP = re.compile(r"([A-Za-z_]\w*)((?:\[\d{1,9}\])*)")


@dataclass(frozen=True)
class FieldPath:
    """
    Where a number stands inside a message: ``twist.twist.linear.x``, ``axes[1]``, ``yaw(pose.pose.orientation)``.

    Parameters
    ----------
    text : str
        The path.
    where : str
        What it belongs to, for the error.
    source : str, optional
        The recipe, for the error.
    """

    text: str
    where: str = "field"
    source: str | None = None

    def __post_init__(self):
        path, yaw = self.text, False
        if isinstance(path, str) and path.startswith("yaw(") and path.endswith(")"):
            path, yaw = path[4:-1], True
        steps: list[str | int] = []
        for part in path.split(".") if isinstance(path, str) else [""]:
            found = _STEP.fullmatch(part)
            if found is None:
                raise RecipeError(
                    f"{self.where}: cannot read the field path {self.text!r}; write for example "
                    "'twist.twist.linear.x', 'axes[1]' or 'yaw(pose.pose.orientation)'",
                    self.source,
                )
            steps += [found.group(1), *(int(index) for index in re.findall(r"\d+", found.group(2)))]
        object.__setattr__(self, "steps", tuple(steps))
        object.__setattr__(self, "yaw", yaw)


_KINDS = {
    "column": ("column", "unit", "scale", "offset", "absolute", "map", "resample"),
    "topic": ("topic", "field", "unit", "scale", "offset", "absolute", "map", "resample", "hold"),
    "value": ("value", "unit"),
    "from": ("from", "map", "unit", "scale", "offset"),
    "distance": ("distance", "axes"),
    "travelled": ("travelled", "axes"),
}


@dataclass(frozen=True)
class ColumnRule:
    """
    Where one column of the session comes from.

    Parameters
    ----------
    name : str
        The column, from the vocabulary.
    kind : str
        column, topic, value, from, distance or travelled.
    key : object
        The lab's column (name or index), the topic, the constant, the metadata name, or the position stems.
    field : FieldPath, optional
        Where in the message.
    factor, scale, offset : float
        The value is (scale · raw + offset) · factor; the factor is the unit's.
    map : mapping, optional
        Texts or codes to numbers.
    axes : tuple of str
        The axes a distance counts.
    resample : str, optional
        A way of resampling for this column alone.
    hold : bool
        True when the last message of the topic holds until the log ends.
    absolute : bool
        True when the size of the value counts, without its sign.
    """

    name: str
    kind: str
    key: object
    field: FieldPath | None = None
    factor: float = 1.0
    scale: float = 1.0
    offset: float = 0.0
    map: Mapping[str, float] | None = None
    axes: tuple[str, ...] = ()
    resample: str | None = None
    hold: bool = False
    absolute: bool = False

    @classmethod
    def parse(cls, name: str, table: object, source: str | None) -> ColumnRule:
        """
        Return the rule that one entry of ``[columns]`` spells.

        Parameters
        ----------
        name : str
            The column.
        table : mapping
            The entry.
        source : str, optional
            The recipe, for errors.
        """
        where = f"[columns] {name}"
        if name not in VOCABULARY:
            raise RecipeError(
                f"{where}: not in the vocabulary{nearest(name, VOCABULARY)}"
                f"{' (time goes under [time])' if name == 't' else ''}",
                source,
            )
        everything = dict.fromkeys(key for keys in _KINDS.values() for key in keys)
        table = check_keys(table, everything, where, source)
        kinds = [kind for kind in _KINDS if kind in table]
        if len(kinds) != 1:
            raise RecipeError(f"{where}: needs exactly one of {', '.join(_KINDS)}, has {len(kinds)}", source)
        kind = kinds[0]
        check_keys(table, _KINDS[kind], f"{where} (by {kind})", source)
        key = table[kind]
        if kind in ("distance", "travelled"):
            return cls(name, kind, *cls._positions(kind, key, table, where, source))
        what = {
            "column": ((str, int), "a column name or index"),
            "value": ((int, float), "a number"),
        }.get(kind, (str, "a name"))
        check_type(key, *what, f"{where}: {kind}", source)
        if kind == "column" and isinstance(key, int) and not 0 <= key < 1_000_000:
            raise RecipeError(f"{where}: column counts from 0, got {key}", source)
        path = None
        if kind == "topic":
            if "field" not in table:
                raise RecipeError(
                    f"{where}: needs field, the place in the message ('data', 'axes[1]' …)", source
                )
            path = FieldPath(table["field"], where, source)
        wanted = "rad" if path and path.yaw else VOCABULARY[name].unit
        if path and path.yaw and "unit" not in table:
            table["unit"] = "rad"
        if "unit" not in table and wanted not in ("1", "measure"):
            raise RecipeError(f"{where}: needs its unit (the session holds {wanted})", source)
        for number in ("scale", "offset"):
            if number in table:
                check_type(table[number], (int, float), "a finite number", f"{where}: {number}", source)
        for switch in ("hold", "absolute"):
            if switch in table:
                check_type(table[switch], bool, "true or false", f"{where}: {switch}", source)
        check_resample(table.get("resample", "linear"), where, source)
        if table.get("hold") and table.get("resample", "previous") != "previous":
            raise RecipeError(
                f"{where}: hold keeps the previous value, resample = {table['resample']!r}", source
            )
        mapping = None
        if "map" in table:
            mapping = text_map(table["map"], where, source, (int, float), "a number")
        return cls(
            name,
            kind,
            key,
            field=path,
            factor=to_si(table.get("unit", "1"), VOCABULARY[name].unit, where, source),
            scale=float(table.get("scale", 1.0)),
            offset=float(table.get("offset", 0.0)),
            map=mapping,
            resample=table.get("resample"),
            hold=table.get("hold", False),
            absolute=table.get("absolute", False),
        )

    @staticmethod
    def _positions(kind, key, table, where, source) -> tuple:
        stems = [key] if kind == "travelled" else key
        count = 1 if kind == "travelled" else 2
        positions = [name[:-2] for name, c in VOCABULARY.items() if name.endswith("_x") and c.unit == "m"]
        if not isinstance(stems, list) or len(stems) != count:
            raise RecipeError(f"{where}: {kind} needs {count} of {', '.join(positions)}, got {key!r}", source)
        for stem in stems:
            if stem not in positions:
                raise RecipeError(f"{where}: {stem!r} is not a position{nearest(stem, positions)}", source)
        axes = table.get("axes")
        if not isinstance(axes, list) or not axes or any(axis not in ("x", "y", "z") for axis in axes):
            raise RecipeError(f'{where}: needs axes, some of ["x", "y", "z"], got {axes!r}', source)
        if len(set(axes)) != len(axes):
            raise RecipeError(f"{where}: axes names an axis twice", source)
        return tuple(stems), None, 1.0, 1.0, 0.0, None, tuple(axes)

    @property
    def needs(self) -> list[str]:
        """The session columns that this one is computed from."""
        if self.kind not in ("distance", "travelled"):
            return []
        return [f"{stem}_{axis}" for stem in self.key for axis in self.axes]

    def convert(self, values: np.ndarray) -> np.ndarray:
        """
        Return raw numbers in the session's unit.

        Parameters
        ----------
        values : array_like
            Raw numbers.
        """
        values = np.asarray(values, dtype=float)
        with np.errstate(over="ignore", invalid="ignore"):
            if (self.scale, self.offset) != (1.0, 0.0):
                values = self.scale * values + self.offset
            values = np.abs(values) if self.absolute else values
            return values if self.factor == 1.0 else values * self.factor
