"""The relations of data/published/relations.toml, each with its ids for a set of numbers."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from trustlab.reproduction.audit.arithmetic import FUNCTIONS, evaluate
from trustlab.reproduction.audit.catalogue import PARTICIPANTS, conditions_of, study_names
from trustlab.reproduction.audit.verdict import SYMBOL, Check, Formula, Numbers, Possible
from trustlab.reproduction.published import published_facts


def _contexts(row: Mapping, numbers: Numbers) -> Iterator[dict]:
    """Return what a row's placeholders stand for, one after the other."""
    id = row["number"] + row.get("suffix", "") + row.get("quantity", "")
    if "{p}" in id:
        yield from ({"p": p} for p in row.get("p", PARTICIPANTS))
    elif "{study}" in id:
        for study in study_names(numbers):
            if fnmatchcase(study, row.get("study", "*")):
                yield from _of_study(study, numbers, pairs="{a}" in id)
    else:
        yield {}


def _of_study(study: str, numbers: Numbers, pairs: bool) -> Iterator[dict]:
    k = len(conditions_of(study))
    context = {"study": study, "k": k, "d": k - 1, "m": k * (k - 1) // 2}
    if not pairs:
        yield context
        return
    start = f"{study}/pairs."
    for id in numbers:
        if id.startswith(start):
            a, b = id.removeprefix(start).split("-")
            yield context | {"a": a, "b": b}


def _filled(value: Any, context: Mapping) -> Any:
    """Return a row's value with its placeholders replaced, however deep they are."""
    if isinstance(value, str):
        return value.format_map(context)
    if isinstance(value, dict):
        return {key: _filled(entry, context) for key, entry in value.items()}
    if isinstance(value, list):
        return [_filled(entry, context) for entry in value]
    return value


def _ids(row: Mapping, context: Mapping, numbers: Numbers) -> dict[str, str]:
    """Return symbol to id of what a row's formulas name and numbers have."""
    listed = published_facts("relations")
    folder, _, _ = row["number"].rpartition("/")
    group = next((key for key in ("p", "study") if key in context), "")
    places = listed["places"].get(group, [f"{folder}/{{symbol}}"])
    if "place" in row:
        places = [row["place"]]
    ids: dict[str, str] = {}
    for symbol in dict.fromkeys(SYMBOL.findall(" ".join(_formulas(row)))):
        written = listed["symbols"].get(symbol, symbol)
        for place in places:
            id = place.format_map({**context, "symbol": written})
            if id in numbers:
                ids.setdefault(symbol, id)
    return ids


def _formulas(row: Any) -> Iterator[str]:
    """Return all formulas of a row, those of its conventions and explanations among them."""
    for key, value in row.items():
        if key == "formula":
            yield value
        rows = value if isinstance(value, list) else [value]
        for inner in rows:
            if isinstance(inner, dict):
                yield from _formulas(inner)


def _expanded(inputs: Mapping[str, str], numbers: Numbers) -> dict[str, str]:
    """Return the ids of `inputs`; a pattern gives a symbol for each number that matches."""
    ids = {}
    for symbol, pattern in inputs.items():
        start = re.split(r"[*\[]", pattern)[0]
        for id in numbers:
            if id == pattern:
                ids[symbol] = id
            elif fnmatchcase(id, pattern):
                name, _, _ = id.removeprefix(start).partition("/")
                ids[f"{symbol}_{name}"] = id
    return ids


def _formula(row: Mapping, ids: Mapping[str, str], numbers: Numbers) -> Formula:
    """Return a formula from its row, whose own inputs go before those of the check."""
    ids = {**ids, **_expanded(row.get("inputs", {}), numbers)}
    formula = Formula.of(row["formula"], ids, row.get("label", ""), row.get("text", ""))
    return replace(formula, as_printed=tuple(row.get("as_printed", ())))


def _ends(row: Mapping, ids: Mapping, numbers: Numbers) -> tuple[float, float] | None:
    """Return the ends of a target; formulas in it may use the inputs and what is printed."""
    number, target = numbers[row["number"]], row.get("target")
    if target is None:
        return None
    if isinstance(target, Mapping):
        target = target[number.printed]
    values = {symbol: np.asarray(numbers[id].value) for symbol, id in ids.items()}
    values["printed"] = np.asarray(number.value)
    low, high = (float(evaluate(end, values)) if isinstance(end, str) else end for end in target)
    return low, high


def _applies(row: Mapping, context: Mapping, numbers: Numbers) -> bool:
    """Return whether the number and what its row asks for are printed."""
    if "where" in row and row["where"].format_map(context) not in numbers:
        return False
    if row.get("of_all") and any(
        f"{context['study']}/mean.{condition}" not in numbers
        for condition in conditions_of(context["study"])
    ):
        return False
    return row.get("unless", "").format_map(context) not in numbers


def _missing(row: Mapping, ids: Mapping[str, str]) -> list[str]:
    """Return the symbols of the formulas that define a check for which no number is printed."""
    defining = [row[key] for key in ("least", "most") if key in row] or [row]
    text = " ".join(formula["formula"] for formula in defining)
    names = [name for name in SYMBOL.findall(text) if name not in FUNCTIONS]
    return [
        name
        for name in names
        if name not in ids and not any(symbol.startswith(f"{name}_") for symbol in ids)
    ]


def relations(numbers: Numbers, pattern: str = "*") -> Iterator[Check | Possible]:
    """
    Return every relation about a number whose id matches a pattern.

    A study need not print everything that its relations use; elsewhere an input that is not
    printed is a fault of the list.
    """
    texts = {id: number.printed for id, number in numbers.items()}
    for kind, made in (("follows", _check), ("allows", _range)):
        for listed in published_facts("relations")[kind]:
            for context in _contexts(listed, numbers):
                number = listed["number"].format_map(context)
                applies = number in numbers and _applies(listed, context, numbers)
                if not (applies and fnmatchcase(number, pattern)):
                    continue
                row = _filled(listed, {**context, "printed": texts, "symbol": "{symbol}"})
                ids = _ids(row, context, numbers) | _expanded(row.get("inputs", {}), numbers)
                missing = _missing(row, ids)
                if not missing:
                    yield made(row, ids, numbers)
                elif "study" not in context:
                    raise ValueError(f"relations.toml: {number} has no input {missing[0]}")


def _check(row: Mapping, ids: Mapping[str, str], numbers: Numbers) -> Check:
    about = {key: row[key] for key in ("note", "suffix", "quantity", "binding") if key in row}
    return Check(
        row["number"],
        _formula({**row, "inputs": {}}, ids, numbers),
        tuple(_formula(way, ids, numbers) for way in row.get("conventions", ())),
        tuple(_formula(way, ids, numbers) for way in row.get("explanations", ())),
        target=_ends(row, ids, numbers),
        **about,
    )


def _range(row: Mapping, ids: Mapping[str, str], numbers: Numbers) -> Possible:
    least, most = (_formula(row[end], ids, numbers) for end in ("least", "most"))
    return Possible(row["number"], least, most, row.get("note", ""))
