"""How a verdict is made: a formula of printed numbers, its range, and what is printed."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from fnmatch import filter as matching
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.checks import one_of
from trustlab.reproduction.audit.catalogue import PARTICIPANTS, PrintedNumber, studies

# Names of printed numbers that formulas write as letters.
LETTERS = {"ε": "epsilon", "χ2": "chi2", "β": "beta"}

INSIDE = 1000  # points inside a box of rounding

Numbers = Mapping[str, PrintedNumber]
Span = tuple[float, float, float]
NOTHING = (np.nan, np.nan, np.nan)


class Row(NamedTuple):
    """
    One row of the audit; the fields are the columns of its table.

    `recomputed`, `low` and `high` are what follows from other printed numbers and its range within
    their rounding, NaN where nothing does; `reason` begins with "Suspicious" where a slip is likely
    but not certain.
    """

    id: str
    where: str
    quantity: str
    printed: str
    recomputed: float
    low: float
    high: float
    verdict: str
    reason: str
    formula: str = ""
    inputs: str = ""


def row_about(
    number: PrintedNumber,
    reason: str,
    verdict: str = "not checkable",
    span: Span = NOTHING,
    **columns: Any,
) -> Row:
    """
    Return the row of a printed number; `columns` that are not empty stand in place of its own.

    `span` is the recomputed value, its least and its greatest.
    """
    about = number.id, number.where, number.quantity, number.printed
    row = Row(*about, *span, verdict, reason.strip())
    return row._replace(**{name: text for name, text in columns.items() if text})


def listing(inputs: Mapping[str, str], numbers: Numbers) -> str:
    """Return inputs as "symbol = printed (id)"."""
    return "; ".join(f"{symbol} = {numbers[id].shown} ({id})" for symbol, id in inputs.items())


class NotPrintedError(AttributeError):
    """A formula uses a symbol for which no number is printed."""


class Values:
    """
    Printed numbers by the symbols of a formula, as attributes; `used` has the ids of those used.

    They are looked for beside the number that is checked, in its study, or among those of its
    participant, and in the folder that the relation names; `ids` say where a symbol stands
    otherwise. A symbol that stands for several numbers is their stack along a new first axis.
    `arrays` by symbol take the place of printed values. k is the number of conditions of a study.
    """

    def __init__(
        self,
        relation: "Follows | Allows",
        numbers: Numbers,
        ids: Mapping[str, str],
        arrays: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        self._numbers, self._ids, self._arrays = numbers, {**relation.ids, **ids}, arrays or {}
        self._folder, _, _ = relation.of.rpartition("/")
        _, _, last = f"{relation.of}{relation.suffix}".rpartition("/")
        tests = ("", "anova.", "mauchly.", "t_test.")
        self._beside, self._end = [f"{self._folder}/{test}" for test in tests], ""
        if last in PARTICIPANTS:
            self._beside, self._end = ["table_2.1/", "table_2.2/"], f"/{last}"
        self._beside.append(f"{relation.beside}/")
        self.used: dict[str, str] = {}

    def _where(self, symbol: str) -> dict[str, str]:
        """Return the id of a symbol, or by x_1, x_2 … those of several."""
        if symbol not in self._ids:
            name = f"{LETTERS.get(symbol, symbol)}{self._end}"
            beside = [id for x in self._beside if (id := f"{x}{name}") in self._numbers]
            return {symbol: beside[0]} if beside else {}
        pattern = self._ids[symbol].replace("./", f"{self._folder}/", 1)
        if pattern in self._numbers:
            return {symbol: pattern}
        start = min(pattern.partition(sign)[0] for sign in "*[")
        found = matching(self._numbers, pattern)
        return {f"{symbol}_{id.removeprefix(start).partition('/')[0]}": id for id in found}

    def __getattr__(self, symbol: str) -> Any:
        """Return the value of a symbol, or the values of the numbers that it stands for."""
        if symbol == "k":
            return len(studies()[self._folder].conditions)
        named = self._where(symbol)
        if not named:
            raise NotPrintedError(symbol)
        self.used |= named
        values = [
            np.asarray(self._arrays.get(x, self._numbers[id].value)) for x, id in named.items()
        ]
        return values[0] if symbol in named else np.stack(values)


@dataclass(frozen=True)
class Formula:
    """
    A way to compute one printed number from others.

    `text` is the formula as one reads it; `compute` takes `Values`; `label` names the convention,
    or says what an explanation assumes; `ids` says where symbols stand. `as_printed` names symbols
    that are used with the printed digits as they stand.
    """

    text: str
    compute: Callable[[Any], Any]
    label: str = ""
    ids: Mapping[str, str] = field(default_factory=dict)
    as_printed: tuple[str, ...] = ()

    def at(
        self, relation: "Follows | Allows", numbers: Numbers, arrays: Mapping | None = None
    ) -> tuple[Any, dict[str, str]]:
        """
        Return the value in a relation, at arrays of inputs unless as printed, and the ids of the
        inputs.
        """
        values = Values(relation, numbers, self.ids, arrays)
        with np.errstate(all="ignore"):
            return self.compute(values), values.used

    def range(self, relation: "Follows | Allows", numbers: Numbers) -> Span:
        """
        Return the value, and its least and greatest when every input varies within its rounding.

        Exact for functions that are monotone in each input, as nearly all here are; NaN (an
        impossible input) is passed over.
        """
        inputs = {x: numbers[id] for x, id in self.at(relation, numbers)[1].items()}
        vary = [x for x, number in inputs.items() if number.half > 0 and x not in self.as_printed]
        # The middle, all corners, and points inside, the same at every call, where a function that
        # is not monotone may turn.
        corners = list(product((-1.0, 1.0), repeat=len(vary)))
        inside = np.random.default_rng(0).uniform(-1.0, 1.0, (INSIDE, len(vary)))
        points = np.vstack([np.zeros(len(vary)), corners, inside])
        arrays = {x: np.full(len(points), number.value) for x, number in inputs.items()}
        for x, offsets in zip(vary, points.T, strict=True):
            arrays[x] += inputs[x].half * offsets
        value, _ = self.at(relation, numbers, arrays)
        reached = np.broadcast_to(np.asarray(value, float), len(points))
        known = reached[~np.isnan(reached)]
        return (
            (float(reached[0]), float(known.min()), float(known.max())) if known.size else NOTHING
        )

    def result(self, span: Span, number: PrintedNumber) -> str:
        """Return the formula with its label, its value and the ends of its range."""
        value, low, high = (show(each, number, 2) for each in span)
        label = f" ({self.label})" if self.label else ""
        ends = f", from {low} to {high} within rounding" if span[2] > span[1] else ""
        return f"{self.text} = {value}{label}{ends}"


def show(value: float, like: PrintedNumber | None = None, more: int = 0) -> str:
    """
    Return a number with the decimals of a printed one, and `more`; or 4 significant digits, and
    `more`.
    """
    if not np.isfinite(value):
        return str(value)
    if like is None or np.isnan(like.half) or like.half == 0.0:
        return f"{value:.{4 + more}g}"
    if "e" in like.printed.lower() or abs(value) < 0.5 * 10.0 ** -(like.decimals + more):
        return f"{value:.{2 + more}e}"
    return f"{value:.{like.decimals + more}f}"


def between(low: float, high: float) -> str:
    """Return a range in words, of which the upper end may be infinite."""
    return f"from {show(low)} to {show(high)}" if np.isfinite(high) else f"at least {show(low)}"


@dataclass(frozen=True)
class Relation:
    """
    What other printed numbers say of the number `of`, or of all that match it.

    `suffix` is appended to the id where a number is checked more than once. Where `binding` is
    given, it says why the relation need not hold exactly, and "not checkable" replaces "differs".
    `beside` names another folder in which symbols stand.
    """

    of: str
    _: KW_ONLY
    suffix: str = ""
    binding: str = ""
    beside: str = ""


@dataclass(frozen=True)
class Follows(Formula, Relation):
    """
    A formula that a printed number follows from.

    `convention` is another reading of the definition, tried in turn; `explanations` are mistakes
    that could have led to the printed number, named only if they give it. `target` has the ends
    that the result must lie between where they are not those of the printed number, or those of
    each word that may be printed. `quantity` is what a row with a suffix is about. In the `note`,
    {0}, {1} … stand for the value of the formula and that of its convention.
    """

    _: KW_ONLY
    note: str = ""
    quantity: str = ""
    convention: Formula | None = None
    explanations: tuple[Formula, ...] = ()
    target: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None

    def row(self, numbers: Numbers) -> Row:
        """
        Return the verdict: "reproduced" if some convention gives the printed number, "within
        rounding" if only its range reaches it, else "differs".
        """
        number = numbers[self.of]
        target = self.target or number.compatible
        if isinstance(target, Mapping):
            target = target[one_of(number.id, number.printed, target)]
        least, most = target
        ways = [(way, way.range(self, numbers)) for way in filter(None, (self, self.convention))]
        hit = [(way, span) for way, span in ways if least <= span[0] <= most]
        near = [(way, span) for way, span in ways if span[1] <= most and span[2] >= least]
        way, span = (hit or near or ways)[0]
        verdict = "reproduced" if hit else "within rounding"
        reason, cause = f"{way.result(span, number)}.", ""
        if not near:
            verdict, should = "differs", f"It should be {show(ways[0][1][0], number)}."
            if self.target:
                should = "It does not hold."
            if self.binding:
                verdict, should = "not checkable", f"But {self.binding}"
            tried = "; ".join(way.result(span, number) for way, span in ways)
            reason = f"{tried}. Printed is {number.shown}. {should}"
        for x in () if hit else self.explanations:
            value, _ = x.at(self, numbers)
            if not cause and least <= value <= most:
                cause = f"Probably {x.label}: {x.text} = {show(value, number, 2)}."
        note = self.note.format(*(span[0] for _, span in ways))
        doubt = "Suspicious:" if (cause if near else self.binding) else ""
        return row_about(
            number,
            " ".join(filter(None, (doubt, reason, cause, note))),
            verdict,
            span,
            id=number.id + self.suffix,
            quantity=self.quantity,
            formula=way.text,
            inputs=listing(way.at(self, numbers)[1], numbers),
        )


@dataclass(frozen=True)
class Allows(Formula, Relation):
    """
    The range that other printed numbers leave a number: the formula gives its two ends.

    Where `binding` is given, a number may lie beyond it, and `binding` says what that means.
    """

    def row(self, numbers: Numbers) -> Row:
        """Return the verdict: "not checkable" inside the range, "differs" outside."""
        number = numbers[self.of]

        def reached(end: int) -> Span:
            return replace(self, compute=lambda v: self.compute(v)[end]).range(self, numbers)

        (at_least, low, _), (at_most, _, high) = reached(0), reached(1)
        doubtful = not at_least <= number.value < at_most
        least, most = number.compatible
        verdict, start = "not checkable", "Not determined"
        if most < low or least > high:
            start = self.binding
            if not self.binding:
                verdict, start = "differs", "Impossible, however rounded"
        elif doubtful and not self.binding:
            start = "Suspicious: not determined"
        reason = f"{start}; by other printed numbers it is {between(low, high)}."
        if doubtful and verdict != "differs":
            exact = between(at_least, at_most)
            reason += f" As these are printed, it is {exact}, the upper end excluded."
        return row_about(
            number,
            reason,
            verdict,
            (np.nan, low, high),
            formula=self.text,
            inputs=listing(self.at(self, numbers)[1], numbers),
        )
