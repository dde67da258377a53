"""Tables of numbers: which columns of a file are read, and what becomes of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trustlab.sessions.column_rules import ColumnRule
from trustlab.sessions.errors import SessionError, nearest
from trustlab.sessions.log import Log
from trustlab.sessions.recipes import Recipe
from trustlab.sessions.rules import NUMBER, TimeRule
from trustlab.sessions.session import Metadata
from trustlab.sessions.vocabulary import VOCABULARY

__all__ = ["Cell", "select_cells", "some", "table_log"]


@dataclass(frozen=True)
class Cell:
    """
    One column of the file that is read.

    Parameters
    ----------
    name : str
        The session's column, or "t".
    position : int
        Where it stands in the file, from 0.
    label : str
        What errors call it.
    rule : ColumnRule, optional
        What is done to it.
    """

    name: str
    position: int
    label: str
    rule: ColumnRule | None = None

    @property
    def map(self) -> Mapping[str, float] | None:
        """Texts to numbers."""
        return self.rule.map if self.rule else None


def select_cells(
    names: Sequence[str], recipe: Recipe | None, wanted: Sequence[str] | None, source: str, where: str
) -> list[Cell]:
    """
    Return the columns to read.

    Parameters
    ----------
    names : sequence of str
        The file's columns; an empty text for each where it has no header.
    recipe : Recipe, optional
        Which columns are which; without, names are the vocabulary's.
    wanted : sequence of str, optional
        Session columns to read; all when not given.
    source : str
        The file, for the error.
    where : str
        The place of the names in it, for the error.

    Raises
    ------
    SessionError
        If a name is missing, unknown or there twice.
    """
    if recipe is not None:
        rules = {name: recipe.columns[name] for name in wanted if recipe.columns[name].kind == "column"}
        keys = {"t": recipe.time.column} | {name: rule.key for name, rule in rules.items()}
    else:
        rules = {}
        twice = [name for k, name in enumerate(names) if name in names[:k]]
        if wanted is None:
            _check_names_are_names(names, source, where)
            if twice and twice[0]:
                raise SessionError(
                    f"{where}: column {twice[0]!r} is there twice; rename or remove one", source
                )
            _check_names(names, source, where)
            wanted = [name for name in names if name != "t"]
        keys = {name: name for name in ["t", *wanted]}
    cells = []
    for name, key in keys.items():
        if isinstance(key, int):
            if key >= len(names):
                raise SessionError(
                    f"{where}: has {len(names)} columns; the recipe takes {name} from column {key} (from 0)",
                    source,
                )
            cells.append(Cell(name, key, f"{key} ({name})", rules.get(name)))
            continue
        if names.count(key) != 1:
            what = "is there twice; rename or remove one" if key in names else "is missing"
            hint = nearest(key, names) or _time_hint(key, names) if key not in names else ""
            raise SessionError(
                f"{where}: column {key!r} {what}{hint} (the file has: {some(names)})",
                source,
            )
        label = repr(key) if key == name else f"{key!r} ({name})"
        cells.append(Cell(name, names.index(key), label, rules.get(name)))
    return cells


def some(names: Sequence[str]) -> str:
    """
    Return names for an error, cut where there are many.

    Parameters
    ----------
    names : sequence of str
        The names.
    """
    return ", ".join(str(name)[:40] for name in names[:30]) + (" …" if len(names) > 30 else "")


def _time_hint(key: str, names: Sequence[str]) -> str:
    if key != "t":
        return ""
    likely = [name for name in names if re.match(r"(?i)(t|time|stamp|secs?|clock)([^a-z]|$|stamp)", name)]
    return f"; if {likely[0]!r} is time in seconds, rename it to t" if likely else ""


def _check_names_are_names(names: Sequence[str], source: str, where: str) -> None:
    if all(NUMBER.fullmatch(name.strip()) for name in names):
        raise SessionError(
            f"{where}: numbers stand where the column names should; add a line of names, or read the file with a "
            "recipe that says [table] header = false",
            source,
        )


def _check_names(names: Sequence[str], source: str, where: str) -> None:
    for k, name in enumerate(names):
        if name in VOCABULARY or name == "t":
            continue
        if not name:
            raise SessionError(
                f"{where}: column {k} (from 0) has no name; name it, or remove it (pandas writes one so unless told "
                "index=False)",
                source,
            )
        near = nearest(name, VOCABULARY) or _time_hint("t", [name])
        raise SessionError(
            f"{where}: column {name[:100]!r} is not in the vocabulary{near} (map it with a recipe, leave it out with "
            "columns=[...], or rename it; see trustlab.sessions.vocabulary())",
            source,
        )


def table_log(
    source: str,
    cells: Sequence[Cell],
    raw: Mapping[str, np.ndarray],
    time: TimeRule,
    place: Callable[[int], str],
    metadata: Metadata | None,
    fault: SessionError | None = None,
) -> Log:
    """
    Return the log that the columns of a table make.

    Parameters
    ----------
    source : str
        The file.
    cells : sequence of Cell
        The columns read.
    raw : mapping of str to numpy.ndarray
        Their numbers, by the session's names, in the file's units.
    time : TimeRule
        The unit of time, and where it starts.
    place : callable
        Names the place of sample k in the file.
    metadata : Metadata, optional
        What the file says of itself.
    fault : SessionError, optional
        Why reading stopped.
    """
    columns = {
        cell.name: cell.rule.convert(raw[cell.name]) if cell.rule else raw[cell.name] for cell in cells
    }
    t, notes = columns.pop("t"), {}
    with np.errstate(over="ignore", invalid="ignore"):
        if time.from_zero and t.size and np.isfinite(t[0]):
            notes["start_time"] = float(t[0]) * time.factor
            t = t - t[0]
        t = np.asarray(t, dtype=float)
        t = t * time.factor if time.factor != 1.0 else t
    return Log(source, t, columns, place, metadata, fault, notes)
