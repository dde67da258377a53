"""Chunks as Arrow tables, and the one table of a campaign."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from trustlab.campaign.worker import Outcome, plain

# Characters that a file keeps of a parameter that is not a plain value.
LONGEST = 1000

KINDS = {
    type(None): "none",
    bool: "bool",
    np.bool_: "bool",
    float: "float",
    np.float64: "float",
    str: "str",
}
ARROW = {
    "none": pa.null(),
    "bool": pa.bool_(),
    "float": pa.float64(),
    "str": pa.string(),
    "int": pa.int64(),
}
KIND = b"kind"


def _kind(value: object) -> str:
    """Return the kind of a value; integers are classed by the types that hold them exactly."""
    if type(value) is int or isinstance(value, np.integer):
        size = abs(int(value))
        return "int" if size <= 2**53 else "long" if size < 2**63 else "huge"
    return KINDS.get(type(value), "object")


def _column(name: str, values: list) -> tuple[pa.Field, pa.Array]:
    """Return plain values as one column: of their own type if they share one, else each as JSON."""
    kinds = {_kind(value) for value in values} - {"none"}
    if kinds <= {"int", "long"} or (len(kinds) == 1 and "huge" not in kinds):
        kind = ARROW["none" if not kinds else "int" if "long" in kinds else kinds.pop()]
        return pa.field(name, kind), pa.array(values, kind)
    texts = [None if value is None else json.dumps(value) for value in values]
    return pa.field(name, pa.string(), metadata={KIND: b"mixed"}), pa.array(texts, pa.string())


def _written(value: object) -> bool | int | float | str | None:
    """Return a parameter as it is written to files: plain values as they are, others as text."""
    try:
        value = plain(value)
    except TypeError:
        value = repr(value)[:LONGEST]
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def encoded(first: int, parameters: list[Mapping], outcomes: list[Outcome]) -> pa.Table:
    """
    Return a chunk as a table: run, parameters, results, failed, error, traceback, returned (names
    as JSON).
    """
    results = [outcome.results or {} for outcome in outcomes]
    returned = dict.fromkeys(name for own in results for name in own)
    columns: dict[str, list] = {
        "run": list(range(first, first + len(outcomes))),
        **{name: [_written(values[name]) for values in parameters] for name in parameters[0]},
        **{name: [own.get(name) for own in results] for name in returned},
        "failed": [not own for own in results],
        "error": [outcome.error for outcome in outcomes],
        "traceback": [outcome.traceback for outcome in outcomes],
        "returned": [json.dumps(list(own)) if own else None for own in results],
    }
    fields, arrays = zip(*(_column(name, values) for name, values in columns.items()), strict=True)
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def assembled(
    chunks: Iterable[pa.Table], names: list[str], parameters: Mapping[str, list] | None
) -> pd.DataFrame:
    """
    Return the table of a campaign, in the order of runs, whatever the chunks were.

    `parameters` are columns by name for all runs; None takes them from the chunks, where some are
    text.
    """
    chunks = sorted(chunks, key=lambda chunk: chunk["run"][0].as_py())
    run = np.concatenate([chunk["run"].to_numpy() for chunk in chunks])
    failed = np.concatenate([chunk["failed"].to_numpy(zero_copy_only=False) for chunk in chunks])
    once: dict = {}  # equal texts are kept once
    returned, error, trace = (
        np.array(
            [once.setdefault(x, x) for chunk in chunks for x in chunk[name].to_pylist()],
            dtype=object,
        )
        for name in ("returned", "error", "traceback")
    )
    results = _usual(returned)
    for text in dict.fromkeys(returned):
        if text is not None and set(json.loads(text)) != set(results):
            odd = returned == text
            failed[odd] = True
            error[odd] = (
                f"CampaignError: returned {', '.join(json.loads(text))}, where most runs returned "
                f"{', '.join(results)}; return the same names from every run, NaN or None where "
                "undefined"
            )
    columns: dict[str, Any] = {"run": run}
    whole = np.zeros(run.size, dtype=bool)
    for name in names:
        columns[name] = (
            _gathered(chunks, name, whole)
            if parameters is None
            else _narrowest(parameters[name], whole)
        )
    columns |= {name: _gathered(chunks, name, failed) for name in results}
    columns |= {"failed": failed, "error": _texts(error), "traceback": _texts(trace)}
    return pd.DataFrame(columns, copy=False)


def _usual(returned: Iterable[str | None]) -> list[str]:
    """Return the names that most runs returned, in the order of the first of them."""
    texts = [text for text in returned if text is not None]
    names = {text: frozenset(json.loads(text)) for text in set(texts)}
    counts = Counter(names[text] for text in texts)
    if not counts:
        return []
    usual = counts.most_common(1)[0][0]
    return json.loads(next(text for text in texts if names[text] == usual))


def _texts(values: Iterable) -> pd.Series:
    texts = list(values)
    try:
        return pd.Series(texts, dtype="str")
    except UnicodeEncodeError:  # lone surrogates, which only parameters can hold
        return pd.Series(texts, dtype=object)


def _gathered(chunks: list[pa.Table], name: str, missing: np.ndarray) -> np.ndarray | pd.Series:
    """
    Return one column over all chunks; where every chunk holds floats, without a list of Python
    values.
    """
    if all(
        name in chunk.column_names and pa.types.is_floating(chunk[name].type) for chunk in chunks
    ):
        return np.where(
            missing, np.nan, np.concatenate([chunk[name].to_numpy() for chunk in chunks])
        )
    values: list = []
    for chunk in chunks:
        if name not in chunk.column_names:
            values += [None] * len(chunk)
            continue
        own = chunk[name].to_pylist()
        if (chunk.schema.field(name).metadata or {}).get(KIND) == b"mixed":
            own = [None if text is None else json.loads(text) for text in own]
        values += own
    return _narrowest(values, missing)


def _narrowest(values: list, missing: np.ndarray) -> np.ndarray | pd.Series:
    """Return a column of the narrowest type that holds all values exactly; objects as they are."""
    values = [None if gone else value for gone, value in zip(missing, values, strict=True)]
    kinds = {_kind(value) for value in values}
    if kinds == {"bool"}:
        return np.array(values, dtype=bool)
    if kinds <= {"int", "long"}:
        return np.array(values, dtype=np.int64)
    if kinds <= {"int", "float", "none"}:
        return np.array(values, dtype=float)  # None becomes NaN
    if kinds <= {"str", "none"}:
        return _texts(values)
    return pd.Series([np.nan if value is None else value for value in values], dtype=object)
