"""The one table of a campaign, from the outcomes of its runs."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from trustlab.campaign.worker import Outcome, plain

# Characters that a file keeps of a parameter that is not a plain value.
LONGEST = 1000


def assembled(
    runs: Sequence[int], outcomes: Sequence[Outcome], parameters: Mapping[str, Sequence]
) -> pd.DataFrame:
    """Return the table of a campaign: outcomes in the order of runs, parameters by name."""
    names = _usual_names(outcomes)
    outcomes = [_with_usual_names(outcome, names) for outcome in outcomes]
    columns: dict[str, Any] = {"run": np.array(runs, dtype=np.int64)}
    columns |= {name: _narrowest(values) for name, values in parameters.items()}
    for name in names:
        columns[name] = _narrowest([(o.results or {}).get(name) for o in outcomes])
    columns["failed"] = np.array([outcome.results is None for outcome in outcomes], dtype=bool)
    columns["error"] = _texts([outcome.error for outcome in outcomes])
    columns["traceback"] = _texts([outcome.traceback for outcome in outcomes])
    return pd.DataFrame(columns, copy=False)


def _usual_names(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the names that most runs returned, in the order of the first of them."""
    counts = Counter(frozenset(o.results) for o in outcomes if o.results is not None)
    if not counts:
        return []
    usual = counts.most_common(1)[0][0]
    return next(list(o.results) for o in outcomes if o.results and o.results.keys() == usual)


def _with_usual_names(outcome: Outcome, names: list[str]) -> Outcome:
    """Return an outcome; one with other names than most runs have is a failure."""
    if outcome.results is None or outcome.results.keys() == set(names):
        return outcome
    return Outcome(
        None,
        f"CampaignError: returned {', '.join(outcome.results)}, where most runs returned "
        f"{', '.join(names)}; return the same names from every run, NaN or None where undefined",
    )


def _narrowest(values: Sequence) -> np.ndarray | pd.Series:
    """Return a column of the narrowest type that holds all values exactly; objects as they are."""
    kinds = {type(value) for value in values}
    whole = [int(v) for v in values if isinstance(v, int | np.integer) and not isinstance(v, bool)]
    integers = {kind for kind in kinds if issubclass(kind, int | np.integer)} - {bool}
    floats = {float, np.float64}
    if kinds <= {bool, np.bool_}:
        return np.array(values, dtype=bool)
    if kinds == integers and all(-(2**63) <= value < 2**63 for value in whole):
        return np.array(values, dtype=np.int64)
    # Greater integers are not all floats; None becomes NaN.
    if kinds <= integers | floats | {type(None)} and all(abs(value) <= 2**53 for value in whole):
        return np.array(values, dtype=float)
    if kinds <= {str, type(None)}:
        return _texts(values)
    return pd.Series([np.nan if value is None else value for value in values], dtype=object)


def _texts(values: Sequence) -> pd.Series:
    try:
        return pd.Series(values, dtype="str")
    except UnicodeEncodeError:  # lone surrogates
        return pd.Series(values, dtype=object)


def encoded(parameters: Sequence[Mapping], outcomes: Sequence[Outcome]) -> bytes:
    """Return a chunk as JSON, which keeps every bit of numbers; other parameters become text."""
    rows = [
        {
            "parameters": {name: _written(value) for name, value in values.items()},
            **outcome._asdict(),
        }
        for values, outcome in zip(parameters, outcomes, strict=True)
    ]
    return json.dumps(rows).encode()


def decoded(data: bytes) -> tuple[list[dict], list[Outcome]]:
    """Return parameters and outcomes of the runs of a chunk."""
    rows = json.loads(data)
    parameters = [row.pop("parameters") for row in rows]
    return parameters, [Outcome(**row) for row in rows]


def _written(value: object) -> bool | int | float | str | None:
    """Return a parameter as it is written to files: plain values as they are, others as text."""
    try:
        return plain(value)
    except TypeError:
        return repr(value)[:LONGEST]
