"""Chunks as Arrow tables, and the one table of a campaign."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from numbers import Integral

import numpy as np
import pandas as pd
import pyarrow as pa

__all__ = ["assembled", "encoded"]

EXACT = 2**53
"""Whole numbers up to this are floats without loss."""
WIDEST = 2**63
LONGEST = 1000
"""Characters that a parameter which is no plain value takes in a file."""

TYPES = {"bool": pa.bool_(), "int": pa.int64(), "float": pa.float64(), "str": pa.string(), "none": pa.null()}
MIXED = {b"kind": b"mixed"}


def _kind(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, str):
        return "str"
    if isinstance(value, float):
        return "float"
    return "int" if -WIDEST <= value < WIDEST else "wide"


def _column(name: str, values: list) -> tuple[pa.Field, pa.Array]:
    """Return plain values as one column: of their own type if they share one, else each as JSON."""
    kinds = {_kind(value) for value in values} - {"none"}
    if len(kinds) <= 1 and "wide" not in kinds:
        kind = TYPES[kinds.pop() if kinds else "none"]
        return pa.field(name, kind), pa.array(values, kind)
    texts = [None if value is None else json.dumps(value) for value in values]
    return pa.field(name, pa.string(), metadata=MIXED), pa.array(texts, pa.string())


def shown(value: object) -> bool | int | float | str | None:
    """
    Return a parameter as it is written to files: plain values as they are, others as text.

    Parameters
    ----------
    value : object
        Any value.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value)
    text = value if isinstance(value, str) else repr(value)[:LONGEST]
    return text.encode("utf-8", "backslashreplace").decode()


def encoded(first: int, parameters: list[Mapping], outcomes: list[tuple]) -> pa.Table:
    """
    Return a chunk as a table.

    Parameters
    ----------
    first : int
        Index of its first run.
    parameters : list of dict
        Parameters of its runs.
    outcomes : list of tuple
        What `worker.run_chunk` returned.

    Returns
    -------
    pyarrow.Table
        Columns run, parameters, results, failed, error, traceback, returned (names of the results, as JSON).
    """
    n = len(outcomes)
    columns = [(pa.field("run", pa.int64()), pa.array(range(first, first + n), pa.int64()))]
    columns += [_column(name, [shown(values[name]) for values in parameters]) for name in parameters[0]]
    names = dict.fromkeys(name for result, _, _ in outcomes for name in result or ())
    columns += [_column(name, [(result or {}).get(name) for result, _, _ in outcomes]) for name in names]
    columns.append((pa.field("failed", pa.bool_()), pa.array([result is None for result, _, _ in outcomes])))
    returned = [None if result is None else json.dumps(list(result)) for result, _, _ in outcomes]
    for name, texts in (
        ("error", [error for _, error, _ in outcomes]),
        ("traceback", [trace for _, _, trace in outcomes]),
        ("returned", returned),
    ):
        columns.append((pa.field(name, pa.string()), pa.array(texts, pa.string())))
    return pa.Table.from_arrays([column for _, column in columns], schema=pa.schema([f for f, _ in columns]))


def assembled(
    chunks: Iterable[pa.Table], names: list[str], parameters: Mapping[str, list] | None
) -> pd.DataFrame:
    """
    Return the table of a campaign, in the order of runs, whatever the chunks were.

    Parameters
    ----------
    chunks : iterable of pyarrow.Table
        What `encoded` returned, in any order.
    names : list of str
        Names of the parameters.
    parameters : dict of list or None
        Parameters by name, for all runs; None to take them from the chunks.
    """
    chunks = sorted(chunks, key=lambda chunk: chunk["run"][0].as_py())
    run = np.concatenate([chunk["run"].to_numpy() for chunk in chunks])
    failed = np.concatenate([chunk["failed"].to_numpy(zero_copy_only=False) for chunk in chunks])
    once: dict = {}  # equal texts are kept once
    returned, error, trace = (
        np.array([once.setdefault(x, x) for chunk in chunks for x in chunk[name].to_pylist()], dtype=object)
        for name in ("returned", "error", "traceback")
    )
    results = _usual(returned)
    wanted = set(results)
    differs: dict[str, bool] = {}
    for i, names_then in enumerate(returned):
        if names_then is None:
            continue
        if names_then not in differs:
            differs[names_then] = set(json.loads(names_then)) != wanted
        if differs[names_then]:
            error[i] = (
                f"CampaignError: returned {_listed(json.loads(names_then))}, where most runs returned "
                f"{_listed(results)}; return the same names from every run, NaN or None where undefined"
            )
            failed[i] = True
    columns = {"run": run}
    for name in names:
        if parameters is not None:
            columns[name] = _from_values(list(parameters[name]), np.zeros(run.size, dtype=bool))
        else:
            columns[name] = _gathered(chunks, name, np.zeros(run.size, dtype=bool))
    for name in results:
        columns[name] = _gathered(chunks, name, failed)
    columns["failed"] = failed
    columns["error"] = _texts(error)
    columns["traceback"] = _texts(trace)
    return pd.DataFrame(columns, copy=False)


def _listed(names: list[str]) -> str:
    return ", ".join(names)


def _usual(returned: np.ndarray) -> list[str]:
    """Return the names that most runs returned, in the order of the first of them."""
    order: dict[frozenset, list] = {}
    sets: dict[str, frozenset] = {}
    for text in returned:
        if text is None:
            continue
        if text not in sets:
            names = json.loads(text)
            sets[text] = frozenset(names)
            order.setdefault(sets[text], [0, names])
        order[sets[text]][0] += 1
    return max(order.values(), key=lambda entry: entry[0])[1] if order else []


def _texts(values: Iterable) -> pd.Series:
    texts = list(values)
    try:
        return pd.Series(texts, dtype="str")
    except UnicodeEncodeError:  # lone surrogates, which only parameters can hold
        return pd.Series(texts, dtype=object)


def _gathered(chunks: list[pa.Table], name: str, missing: np.ndarray) -> np.ndarray | pd.Series:
    """Return one column over all chunks; where every chunk holds floats, without a list of Python values."""
    parts = []
    for chunk in chunks:
        if name not in chunk.column_names:
            parts.append([None] * len(chunk))
            continue
        field, column = chunk.schema.field(name), chunk[name]
        if field.metadata and field.metadata.get(b"kind") == b"mixed":
            parts.append([None if x is None else json.loads(x) for x in column.to_pylist()])
        elif pa.types.is_floating(field.type):
            parts.append(column.to_numpy())
        else:
            parts.append(column.to_pylist())
    if all(isinstance(part, np.ndarray) for part in parts):
        out = np.concatenate(parts)
        if missing.any():
            out = np.where(missing, np.nan, out)
        return out
    return _from_values(
        [x for part in parts for x in (part.tolist() if isinstance(part, np.ndarray) else part)], missing
    )


def _from_values(values: list, missing: np.ndarray) -> np.ndarray | pd.Series:
    """Return a column of the narrowest type that holds all values exactly; objects as they are."""
    gaps = missing.copy()
    kinds = set()
    for i, value in enumerate(values):
        if gaps[i]:
            continue
        if value is None:
            gaps[i] = True
        elif type(value) in (bool, int, float, str):
            kind = _kind(value)
            kinds.add("wide" if kind == "int" and abs(value) > EXACT else kind)
        elif isinstance(value, np.bool_):
            kinds.add("bool")
        elif isinstance(value, np.integer):
            kinds.add("wide" if abs(int(value)) > EXACT else "int")
        elif isinstance(value, np.float64):
            kinds.add("float")
        else:
            kinds.add("object")
    some = bool(gaps.any())
    if kinds == {"bool"} and not some:
        return np.array(values, dtype=bool)
    if kinds and kinds <= {"int", "wide"} and not some and all(_kind(int(x)) == "int" for x in values):
        return np.array(values, dtype=np.int64)
    if kinds <= {"int", "float"}:
        return np.array([np.nan if gap else x for x, gap in zip(values, gaps, strict=True)], dtype=float)
    if kinds == {"str"}:
        return _texts([None if gap else x for x, gap in zip(values, gaps, strict=True)])
    out = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):
        out[i] = np.nan if gaps[i] else value
    return pd.Series(out, dtype=object)
