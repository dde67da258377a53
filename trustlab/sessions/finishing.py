"""From a log to a session: metadata, constants, checks, resampling and derived columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from trustlab.sessions.checks import check_columns, check_time
from trustlab.sessions.errors import RecipeError, SessionError
from trustlab.sessions.log import Log
from trustlab.sessions.patterns import PathMatch
from trustlab.sessions.recipes import Recipe
from trustlab.sessions.resampling import resample_log
from trustlab.sessions.rules import MetadataRule, plain_key
from trustlab.sessions.session import Metadata, Session

__all__ = ["finish", "metadata_values"]


def metadata_values(
    recipe: Recipe, match: PathMatch | None, header: Mapping[str, object], source: str
) -> dict[str, object]:
    """
    Return what a recipe says of one session: path fields, header cells (``header.<column>``) and metadata by name.

    Parameters
    ----------
    recipe : Recipe
        The recipe.
    match : PathMatch, optional
        The session's path, taken apart.
    header : mapping
        The header's row of the session.
    source : str
        The session's file, for the error.

    Raises
    ------
    SessionError
        If something is missing, or has a value that a map or the bins do not know.
    """
    values = dict(match.fields) if match else {}
    values |= {f"header.{name}": value for name, value in header.items()}
    for name, rule in recipe.metadata.items():
        values[name] = _metadata(rule, values, source)
    return values


def _metadata(rule: MetadataRule, values: Mapping[str, object], source: str) -> object:
    if rule.origin is None:
        return rule.value
    value = _lookup(rule.origin, values, f"metadata {rule.name!r}", source)
    if rule.map is not None:
        if plain_key(value) in rule.map:
            return rule.map[plain_key(value)]
        if rule.keep:
            return value
        if rule.default is not None:
            return rule.default
        raise SessionError(
            f"metadata {rule.name!r}: {rule.origin} is {value!r}, which the recipe's map does not list "
            f"({', '.join(rule.map)})",
            source,
        )
    if rule.bins is not None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise SessionError(f"metadata {rule.name!r}: {rule.origin} is {value!r}, not a number", source)
        return sum(value > limit for limit in rule.bins)
    return value


def _lookup(origin: str, values: Mapping[str, object], where: str, source: str) -> object:
    if origin not in values:
        columns = [name for name in values if name.startswith("header.")]
        raise SessionError(f"{where}: there is no {origin} (known: {', '.join(columns or values)})", source)
    if values[origin] == "":
        raise SessionError(f"{where}: {origin} is empty in the header", source)
    return values[origin]


def finish(
    log: Log,
    recipe: Recipe | None,
    values: Mapping[str, object],
    wanted: Sequence[str] | None,
    method: str | None,
    sample_time: float | None,
) -> Session:
    """
    Return the session that a log makes.

    Parameters
    ----------
    log : Log
        What was read.
    recipe : Recipe, optional
        The recipe it was read with.
    values : mapping
        What `metadata_values` gave.
    wanted : sequence of str, optional
        Session columns to keep; all when not given.
    method : str, optional
        How to resample; a log that is resampled already says so in its notes.
    sample_time : float, optional
        To which sample time [s].

    Raises
    ------
    SessionError
        The first fault of the log.
    """
    resample = method is not None and "resampled" not in log.notes
    _check(log, uniform=not resample)
    rules = recipe.columns if recipe else {}
    if resample:
        resample_log(log, method, sample_time, rules)
    columns = dict(log.columns)
    for name, rule in rules.items():
        if rule.kind == "value":
            columns[name] = np.full(log.t.size, rule.convert(rule.key))
        elif rule.kind == "from":
            columns[name] = np.full(log.t.size, _constant(rule, values, log.source))
    with np.errstate(over="ignore"):
        for name, rule in rules.items():
            if wanted is not None and name not in wanted:
                continue
            if rule.kind == "distance":
                first, second = rule.key
                steps = [columns[f"{first}_{axis}"] - columns[f"{second}_{axis}"] for axis in rule.axes]
                columns[name] = _norm(steps)
            elif rule.kind == "travelled":
                steps = [np.diff(columns[f"{rule.key[0]}_{axis}"], prepend=np.nan) for axis in rule.axes]
                moved = _norm(steps)
                columns[name] = np.r_[moved[1:2], moved[1:]]
    names = [name for name in (wanted or (rules or columns)) if name != "t"]
    frame = pd.DataFrame({name: columns[name] for name in names}, index=pd.Index(log.t, name="t"))
    return Session(frame, _describe(log, recipe, values))


def _norm(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.abs(parts[0]) if len(parts) == 1 else np.sqrt(sum(part * part for part in parts))


def _constant(rule, values: Mapping[str, object], source: str) -> float:
    where = f"column {rule.name!r}"
    value = _lookup(rule.key, values, where, source)
    if rule.map is not None:
        if plain_key(value) not in rule.map:
            raise SessionError(
                f"{where}: {rule.key} is {value!r}, which the recipe's map does not list ({', '.join(rule.map)})",
                source,
            )
        value = rule.map[plain_key(value)]
    if not isinstance(value, int | float):
        raise RecipeError(f"{where}: {rule.key} is {value!r}, not a number; give it a map", source)
    return float(rule.convert(value))


def _describe(log: Log, recipe: Recipe | None, values: Mapping[str, object]) -> Metadata:
    metadata = log.metadata or Metadata()
    own = {name: values[name] for name in (recipe.metadata if recipe else ())}
    known = {name: own.pop(name) for name in ("participant", "condition", "synthetic") if name in own}
    if not isinstance(known.get("synthetic", False), bool):
        raise RecipeError(
            f"metadata 'synthetic' must be true or false, got {known['synthetic']!r}", log.source
        )
    return replace(metadata, **known, source=log.source, more={**metadata.more, **log.notes, **own})


def _check(log: Log, uniform: bool) -> None:
    """Raise the fault that stands first in the file."""
    faults: list[SessionError] = []
    short = log.t.size < 2
    if log.fault is None or not short:
        try:
            check_time(log.t, log.source, log.place, uniform=uniform and log.fault is None)
        except SessionError as error:
            faults.append(error)
    index = pd.Index(log.t, name="t")
    for name, samples in log.columns.items():
        try:
            check_columns(pd.DataFrame({name: samples}, index=index), log.source, log.place)
        except SessionError as error:
            faults.append(error)
    if log.fault is not None:
        faults.append(log.fault)
    if faults:
        raise min(faults, key=lambda fault: log.t.size if fault.row is None else fault.row)
