"""Tables of numbers: which columns of a file are read, and the raw log that they make."""

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np

from trustlab.models.checks import did_you_mean
from trustlab.sessions.errors import SessionError, listed
from trustlab.sessions.readers.mending import fill_blanks
from trustlab.sessions.recipe import NUMBER, Recipe, TableColumn, TableTime, looked_up
from trustlab.sessions.resampling import Stream
from trustlab.sessions.vocabulary import VOCABULARY, to_si


@dataclass(frozen=True)
class SourceColumn:
    """
    One column of the file: its name in the session (or "t"), its position from 0, its label in errors, its rule.

    `text` makes a number of a cell that is no number, and raises ValueError; `blank` is how blank cells are filled.
    """

    name: str
    position: int
    label: str
    rule: TableColumn | None = None
    text: Callable[[object], float] | None = None
    blank: str | None = None


def select_columns(
    names: Sequence[str], recipe: Recipe | None, wanted: Sequence[str] | None, where: str
) -> list[SourceColumn]:
    """Return the columns to read from a file whose columns have these names, empty ones if it has no header."""
    rules: dict[str, TableColumn] = {}
    if recipe is not None:
        chosen = {name: recipe.columns[name] for name in wanted}
        rules = {name: rule for name, rule in chosen.items() if isinstance(rule, TableColumn)}
        keys = {"t": recipe.time.column} | {name: rule.column for name, rule in rules.items()}
    else:
        if wanted is None:
            _check_names(names, where)
            wanted = [name for name in names if name != "t"]
        keys = {name: name for name in ["t", *wanted]}
    time = recipe.time.unit if recipe else "s"
    texts = {"t": {"iso": _iso_time, "clock": _clock_time}.get(time)}
    for name, rule in rules.items():
        texts[name] = partial(_item, rule.item) if rule.item is not None else None
        texts[name] = partial(looked_up, rule.map) if rule.map else texts[name]
    blanks = {name: rule.blank for name, rule in rules.items()}
    return [
        SourceColumn(own, *_find(own, key, names, where), rules.get(own), texts.get(own), blanks.get(own))
        for own, key in keys.items()
    ]


def _iso_time(text: object) -> float:
    """Return the seconds since 1970 of a date and time; without a time zone, as if it were UTC."""
    try:
        time = datetime.fromisoformat(str(text).strip())
    except ValueError:
        raise ValueError(f"{str(text)[:60]!r} is not a time such as 2026-03-01T12:00:00.5") from None
    time = time if time.tzinfo else time.replace(tzinfo=UTC)
    return (time - datetime.fromtimestamp(0, UTC)) / timedelta(seconds=1)


def _clock_time(text: object) -> float:
    """Return the seconds since midnight."""
    found = re.fullmatch(r"\s*(\d{1,2}):(\d{2}):(\d{2}(?:\.\d{1,12})?)\s*", str(text), re.ASCII)
    if not found:
        raise ValueError(f"{str(text)[:60]!r} is not a time of the day such as 12:00:00.5")
    hours, minutes, seconds = map(float, found.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


def _item(index: int, text: object) -> float:
    """Return one of the numbers in a cell such as "(x, y, z)"."""
    parts = re.split(r"[\s,;]+", str(text).strip(" ()[]"))
    if index >= len(parts) or not NUMBER.fullmatch(parts[index]) or not math.isfinite(float(parts[index])):
        raise ValueError(f"{str(text)[:60]!r} has no number {index} (from 0)")
    return float(parts[index])


def _find(name: str, key: str | int, names: Sequence[str], where: str) -> tuple[int, str]:
    """Return where a column stands, and its label in errors."""
    if isinstance(key, int):
        if key >= len(names):
            what = f"the recipe takes {name} from column {key} (from 0)"
            raise SessionError(f"{where}: has {len(names)} columns; {what}")
        return key, f"{key} ({name})"
    if names.count(key) != 1:
        what = "occurs twice; rename or remove one"
        if key not in names:
            what = f"is missing{did_you_mean(key, names) or _time_hint(key, names)}"
        raise SessionError(f"{where}: column {key!r} {what} (the file has: {listed(names)})")
    return names.index(key), repr(key) if key == name else f"{key!r} ({name})"


def _time_hint(key: str, names: Sequence[str]) -> str:
    likely = [name for name in names if re.match(r"(?i)(t|time|stamp|secs?|clock)([^a-z]|$|stamp)", name)]
    return f"; if {likely[0]!r} is time in seconds, rename it to t" if key == "t" and likely else ""


def _check_names(names: Sequence[str], where: str) -> None:
    """Raise unless all names of a file that is read without a recipe belong to the vocabulary and none occurs twice."""
    if 2 * sum(bool(NUMBER.fullmatch(name.strip())) for name in names) > len(names):  # dates may stand among them
        remedy = "add a line of names, or read the file with a recipe that says [table] header = false"
        raise SessionError(f"{where}: found numbers instead of column names; {remedy}")
    counts = Counter(names)
    twice = [name for name in names if counts[name] > 1]
    if twice and twice[0]:
        raise SessionError(f"{where}: column {twice[0]!r} occurs twice; rename or remove one")
    for k, name in enumerate(names):
        if not name:
            hint = "name it, or remove it (pandas writes one so unless told index=False)"
            raise SessionError(f"{where}: column {k} (from 0) has no name; {hint}")
        if name not in VOCABULARY and name != "t":
            hint = did_you_mean(name, VOCABULARY) or _time_hint("t", [name])
            remedy = "map it with a recipe, leave it out with columns=[...], or rename it"
            what = f"column {name[:100]!r} is not in the vocabulary{hint}"
            raise SessionError(f"{where}: {what} ({remedy}; see trustlab.sessions.vocabulary())")


def table_stream(
    selected: Sequence[SourceColumn], raw: Mapping[str, np.ndarray], recipe: Recipe | None, place: Callable[[int], str]
) -> tuple[Stream, dict[str, object]]:
    """Return the stream that the columns of a table make, and notes; `raw` are their numbers in the file's units."""
    notes: dict[str, object] = {}
    if blanks := [(own.name, own.blank) for own in selected if own.blank]:
        raw, place, notes = fill_blanks(blanks, dict(raw), place)
    columns = {own.name: own.rule.convert(raw[own.name]) if own.rule else raw[own.name] for own in selected}
    t = columns.pop("t")
    time = recipe.time if recipe else TableTime(unit="s")
    factor = 1.0 if time.unit in ("iso", "clock") else to_si(time.unit, "s")
    with np.errstate(over="ignore", invalid="ignore"):
        if time.from_zero and t.size and np.isfinite(t[0]):
            notes["start_time"] = float(t[0]) * factor
            t = t - t[0]  # before the conversion to float, which would round large integer stamps
        t = np.asarray(t, dtype=float)
        t = t * factor if factor != 1.0 else t
    return Stream(t, columns, place), notes
