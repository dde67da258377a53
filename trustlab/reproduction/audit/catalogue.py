"""Every printed number under an id of its own, from data/published/."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache

import pandas as pd

from trustlab.models.checks import did_you_mean, shown, table_of, whole_number
from trustlab.models.published import printed_pilot, published_folder
from trustlab.reproduction.printed import half_unit, printed_interval
from trustlab.reproduction.published import (
    PublishedStudy,
    published_facts,
    published_studies,
    published_table,
)

PARTICIPANTS = ("1", "2", "3", "4", "5")
TABLES = ("2.1", "2.2", "2.3", "2.4", "2.5", "2.6", "3.1")

# Printed words that stand for a number or a rank.
WORDS = published_facts("words")


@dataclass(frozen=True)
class PrintedNumber:
    """
    One number of the dissertation, or a word that stands where a number could.

    `id` is for example "table_2.1/delta_TSC/2", `where` the table, section, remark or caption,
    `quantity` what it is, `printed` its text with all trailing zeros; `exact` marks a count, which
    has no rounding.
    """

    id: str
    where: str
    quantity: str
    printed: str
    exact: bool = False

    @property
    def is_word(self) -> bool:
        """Whether a word is printed that stands for a number or a rank."""
        return self.printed.lower() in WORDS

    @property
    def is_bound(self) -> bool:
        """Whether a bound is printed, such as "<.0005" or ">.05"."""
        return self.printed.startswith(("<", ">"))

    @property
    def value(self) -> float:
        """The number; NaN for a word that stands for none."""
        try:
            return WORDS.get(self.printed.lower()) or float(self.printed.lstrip("<>"))
        except ValueError:
            return math.nan

    @property
    def half(self) -> float:
        """
        Half a unit of the last printed digit; 0 for counts.

        Words that stand for a number have 0, other words NaN.
        """
        if self.exact or self.is_word:
            return 0.0
        if not math.isfinite(self.value):
            return math.nan
        return half_unit(self.printed.lstrip("<>"))

    @property
    def shown(self) -> str:
        """The printed text, of a word with the number that it stands for."""
        return f"“{self.printed}”, that is {self.value:g}" if self.is_word else self.printed

    @property
    def decimals(self) -> int:
        """Decimals as printed, of the mantissa where there is an exponent."""
        return len(self.printed.lower().split("e")[0].partition(".")[2])

    @property
    def compatible(self) -> tuple[float, float]:
        """Least and greatest value that rounds to the number, or obeys the bound."""
        if self.is_bound:
            return printed_interval(self.printed)
        reach = self.half * (1.0 + 1e-9)  # a value on the edge may miss it by its own rounding
        return self.value - reach, self.value + reach


def _tables() -> Iterator[PrintedNumber]:
    for number in TABLES:
        for row, cells in published_table(number).iterrows():
            name = ".".join(row) if isinstance(row, tuple) else str(row)
            for column, text in cells.items():
                where, quantity = f"Table {number}, {name}", str(column)
                if str(column).isdigit():
                    where, quantity = f"Table {number}, participant {column}", name
                yield PrintedNumber(f"table_{number}/{name}/{column}", where, quantity, text)


def _pilot() -> Iterator[PrintedNumber]:
    for key, text in printed_pilot().items():
        where = "Section 2.2.2" if key.startswith(("a_p", "b_p", "P_r")) else "Section 2.2.3"
        yield PrintedNumber(f"pilot/{key}", where, f"{key} of the pilot operator", text)


@cache
def studies() -> Mapping[str, PublishedStudy]:
    """Return the printed studies, read once."""
    return published_studies()


def _studies() -> Iterator[PrintedNumber]:
    for name, study in studies().items():
        where, title = study.where.split(" (")[0], study.title
        # Of the UAV study no n is printed, but the degrees of freedom.
        n = "df 140" if name.startswith("uav.") else str(study.n)
        yield PrintedNumber(f"{name}/n", where, "n", n, exact=True)
        for statistic, text in study.table()["printed"].items():
            quantity = f"{title}: {statistic.replace('.', ' ')}"
            degrees = statistic.startswith(("mauchly.", "anova.")) and text.isdecimal()
            yield PrintedNumber(f"{name}/{statistic}", where, quantity, text, degrees)
        for pair in study.significant_without_p:
            id, quantity = f"{name}/significant.{pair}", f"{title}: {pair}"
            yield PrintedNumber(id, where, quantity, "significantly")


@cache
def rows_of(name: str) -> list[tuple[str, ...]]:
    """
    Return the rows of a table of data/published, read once.

    Those of "statements": id, where, what is stated, its text, and, of a claim that compares two
    means, its reading and their ids. Readings: "relative", a change in % of the mean before;
    "points", a difference on a scale from 0 to 100; "share", one of shares between 0 and 1;
    "range", a difference in % of the range of robot performance, (2.39).
    """
    table = pd.read_csv(published_folder() / f"{name}.csv", dtype=str, keep_default_na=False)
    return list(table.itertuples(index=False))


def _statements() -> Iterator[PrintedNumber]:
    for id, where, statement, printed, reading, _, _ in rows_of("statements"):
        exact = printed.isdecimal() and not reading
        yield PrintedNumber(id, where, statement, printed, exact)


def why_unchecked(id: str) -> str:
    """Return why a number cannot be checked: the first pattern of unchecked.csv that matches."""
    return next(reason for pattern, reason in rows_of("unchecked") if fnmatchcase(id, pattern))


@cache
def _all_numbers() -> dict[str, PrintedNumber]:
    """Return every printed number by id, read once."""
    numbers = [*_tables(), *_pilot(), *_studies(), *_statements()]
    return {number.id: number for number in numbers}


def printed_numbers(changes: Mapping[str, str] | None = None) -> dict[str, PrintedNumber]:
    """
    Return every printed number by id: tables, studies and statements.

    `changes` puts other values in place of printed ones, by id.
    """
    numbers = dict(_all_numbers())
    for id, text in table_of("changes", {} if changes is None else changes).items():
        numbers[id] = _changed(numbers, id, text)
    return numbers


def _changed(numbers: Mapping[str, PrintedNumber], id: str, text: str) -> PrintedNumber:
    """Return a printed number with another text."""
    if id not in numbers:
        meant = did_you_mean(id, numbers)
        raise ValueError(f"no printed number has the id {shown(id)}{meant} (audit() lists all ids)")
    changed = replace(numbers[id], printed=str(text).strip())
    is_number = math.isfinite(changed.value) or not math.isfinite(numbers[id].value)
    if not isinstance(text, str) or not is_number:
        raise ValueError(
            f"the change of {id!r} must be a number as printed, in quotes, for example '0.390', "
            f"got {shown(text)}"
        )
    if id.endswith("/n"):
        whole_number(f"n of {id[:-2]!r}", changed.value, least=3)
    return changed
