"""Every printed number under an id of its own, from data/published/."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from difflib import get_close_matches

import pandas as pd

from trustlab.reproduction.published import PILOT, published_folder, published_table

__all__ = ["CONDITIONS", "PrintedNumber", "printed_numbers"]

TABLES = ("2.1", "2.2", "2.3", "2.4", "2.5", "2.6", "3.1")
COLUMN_NAMES = {
    "2.1": "participant",
    "2.2": "participant",
    "2.3": "participant",
    "2.6": "participant",
}
CONDITIONS = {"uav": ("C1", "C2", "C3", "C4", "C5"), "teleop": ("M", "OMI", "MMI", "TMIG")}
"""Conditions of the studies of Sections 2.4.2 and 3.9, also where a mean is not printed."""

WORDS = {
    "one": 1.0,
    "two": 2.0,
    "three": 3.0,
    "four": 4.0,
    "five": 5.0,
    "six": 6.0,
    "seven": 7.0,
    "eight": 8.0,
    "thirty two": 32.0,
    "4 and 5": 2.0,
    "4 and 11": 2.0,
    "smallest": 1.0,
    "lowest": 1.0,
    "highest": 1.0,
    "worst": 1.0,
    "third best": 3.0,
}
"""Printed words that stand for a number or a rank."""


@dataclass(frozen=True)
class PrintedNumber:
    """
    One printed number, or a word that stands where a number could.

    Parameters
    ----------
    id : str
        For example "table_2.1/delta_TSC/2".
    where : str
        Table, section, remark or caption.
    quantity : str
        What it is.
    printed : str
        As printed, trailing zeros kept.
    exact : bool
        A count, which has no rounding.
    """

    id: str
    where: str
    quantity: str
    printed: str
    exact: bool = False

    @property
    def value(self) -> float:
        """The number; NaN for a word that stands for none."""
        text = self.printed.strip().lower().lstrip("<")
        if text in WORDS:
            return WORDS[text]
        try:
            return float(Decimal(text))
        except InvalidOperation:
            return float("nan")

    @property
    def is_word(self) -> bool:
        """Whether a word is printed that stands for a number or a rank."""
        return self.printed.strip().lower() in WORDS

    @property
    def half(self) -> float:
        """Half a unit of the last printed digit; 0 for counts and words."""
        text = self.printed.strip().lower().lstrip("<")
        if self.exact or text in WORDS:
            return 0.0
        try:
            return 0.5 * float(Decimal(1).scaleb(Decimal(text).as_tuple().exponent))
        except InvalidOperation:
            return float("nan")

    @property
    def decimals(self) -> int:
        """Decimals as printed, of the mantissa where there is an exponent."""
        mantissa = self.printed.lower().split("e")[0]
        return len(mantissa.split(".")[1]) if "." in mantissa else 0

    @property
    def compatible(self) -> tuple[float, float]:
        """What rounds to the printed number; below it for "<.0005"."""
        if self.printed.strip().startswith("<"):
            return float("-inf"), self.value
        reach = self.half * (1.0 + 1e-9)
        return self.value - reach, self.value + reach


def _count(text: str) -> bool:
    return bool(re.fullmatch(r"\d+", text.strip()))


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text.lower().replace("[%]", "")).strip("_")


def _tables() -> list[PrintedNumber]:
    found = []
    for number in TABLES:
        table = published_table(number)
        for row, cells in table.iterrows():
            name = ".".join(row) if isinstance(row, tuple) else str(row)
            for column, text in cells.items():
                label = COLUMN_NAMES.get(number)
                if label and str(column).isdigit():
                    where, quantity = f"Table {number}, {label} {column}", name
                else:
                    where, quantity = f"Table {number}, {name}", str(column)
                found.append(PrintedNumber(f"table_{number}/{name}/{column}", where, quantity, text))
    return found


def _pilot() -> list[PrintedNumber]:
    return [
        PrintedNumber(
            f"pilot/{key}",
            "Section 2.2.2" if key.startswith(("a_p", "b_p", "P_r")) else "Section 2.2.3",
            f"{key} of the pilot operator",
            text,
        )
        for key, text in PILOT.items()
    ]


def _studies() -> list[PrintedNumber]:
    with (published_folder() / "studies.toml").open("rb") as file:
        chapters = tomllib.load(file)
    found = []
    for chapter, studies in chapters.items():
        for key, study in studies.items():
            name, where = f"{chapter}.{key}", study["where"].split(" (")[0]
            found.append(PrintedNumber(f"{name}/n", where, "n", str(study["n"]), True))
            for field in ("mean", "sd", "mauchly", "anova", "pairs", "t_test"):
                for entry, text in study.get(field, {}).items():
                    found.append(
                        PrintedNumber(
                            f"{name}/{field}.{entry}",
                            where,
                            f"{study['title']}: {field} {entry}",
                            text,
                            field in ("mauchly", "anova") and _count(text),
                        )
                    )
            for pair in study.get("significant_without_p", []):
                found.append(
                    PrintedNumber(
                        f"{name}/significant.{pair}", where, f"{study['title']}: {pair}", "significantly"
                    )
                )
            if "epsilon" in study:
                found.append(
                    PrintedNumber(f"{name}/epsilon", where, f"{study['title']}: epsilon", study["epsilon"])
                )
    return found


def _claims() -> list[PrintedNumber]:
    table = pd.read_csv(published_folder() / "claims.csv", dtype=str)
    found = []
    for where, claim, printed in table[["where", "claim", "printed"]].itertuples(index=False):
        parts = [part.strip() for part in printed.split("/")]
        against = re.findall(r"C\d", claim.split(" over ")[-1])
        for i, text in enumerate(parts):
            tail = f"/{against[i]}" if len(parts) > 1 else ""
            name = claim.split(" over ")[0] + " over " + against[i] + " [%]" if tail else claim
            found.append(PrintedNumber(f"claim/{_slug(where)}/{_slug(name)}", where, name, text))
    return found


def _statements() -> list[PrintedNumber]:
    table = pd.read_csv(published_folder() / "statements.csv", dtype=str)
    return [
        PrintedNumber(id, where, statement, printed, _count(printed))
        for id, where, statement, printed in table.itertuples(index=False)
    ]


def printed_numbers(changes: Mapping[str, str] | None = None) -> dict[str, PrintedNumber]:
    """
    Return every printed number by id: Tables 2.1-2.6 and 3.1, the studies, the claims and the statements.

    Parameters
    ----------
    changes : mapping of str to str, optional
        Other values to put in place of printed ones, by id.

    Returns
    -------
    dict of str to PrintedNumber

    Raises
    ------
    ValueError
        If an id occurs twice, or a change names no printed number or is no text.
    """
    numbers = {}
    for number in [*_tables(), *_pilot(), *_studies(), *_claims(), *_statements()]:
        if number.id in numbers:
            raise ValueError(f"the id {number.id!r} stands for two printed numbers in data/published")
        numbers[number.id] = number
    if changes is not None and not isinstance(changes, Mapping):
        raise ValueError(
            f"changes must map ids to texts of numbers, for example {{'table_2.1/a_r/1': '0.9992'}}, got {changes!r:.60}; "
            'to select rows of the audit: verdicts[verdicts["verdict"] == "differs"]'
        )
    for id, text in (changes or {}).items():
        if id not in numbers:
            near = get_close_matches(id[:100], numbers, n=1) if isinstance(id, str) else []
            meant = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"no printed number has the id {id!r:.100}{meant} (audit() lists all ids)")
        if not isinstance(text, str) or not text.strip():
            raise ValueError(
                f"the change of {id!r} must be a text as it would be printed, for example '0.390', got {text!r}"
            )
        changed = replace(numbers[id], printed=text.strip())
        if math.isfinite(numbers[id].value) and not math.isfinite(changed.value):
            raise ValueError(f"the change of {id!r} must be a number as printed, got {text!r}")
        numbers[id] = changed
    return numbers
