"""How a verdict is made: a formula of printed numbers, its range, and what is printed."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from fnmatch import filter as matching
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from trustlab.reproduction.audit.catalogue import PARTICIPANTS, PrintedNumber, conditions_of

# Names of printed numbers that formulas write as letters.
LETTERS = {"epsilon": "ε", "chi2": "χ2", "beta": "β"}

VERDICTS = ("reproduced", "within rounding", "differs", "not checkable")

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
    return "; ".join(f"{symbol} = {numbers[id].printed} ({id})" for symbol, id in inputs.items())


class NotPrintedError(LookupError):
    """A formula uses a symbol for which no number is printed."""


class Values:
    """
    Printed numbers by the symbols of a formula, as attributes; notes which are used.

    A symbol that stands for several numbers, x for x_1, x_2 …, is their stack along a new first
    axis. `value` gives the value of a symbol and its id; those that are `fixed` are no inputs.
    """

    def __init__(
        self,
        ids: Mapping[str, str],
        value: Callable[[str, str], Any],
        fixed: Mapping[str, float],
    ) -> None:
        self._ids, self._value, self._fixed = ids, value, fixed
        self.used: dict[str, str] = {}

    def __getattr__(self, symbol: str) -> Any:
        """Return the value of a symbol, or the values of the numbers that it stands for."""
        if symbol in self._fixed:
            return self._fixed[symbol]
        family = {x: id for x, id in self._ids.items() if x.startswith(f"{symbol}_")}
        named = {symbol: self._ids[symbol]} if symbol in self._ids else family
        if not named:
            raise NotPrintedError(symbol)
        self.used |= named
        values = [self._value(x, id) for x, id in named.items()]
        return values[0] if symbol in named else np.stack(values)


@dataclass(frozen=True)
class Formula:
    """
    A way to compute one printed number from others.

    `text` is the formula as one reads it; `compute` takes `Values`; `label` names the convention,
    or says what an explanation assumes; `ids` maps symbols to ids of printed numbers. `as_printed`
    names symbols that are used with the printed digits as they stand; `fixed` has symbols that no
    printed number stands for, such as k, or that an explanation puts in place of one.
    """

    text: str
    compute: Callable[[Any], Any]
    label: str = ""
    ids: Mapping[str, str] = field(default_factory=dict)
    as_printed: tuple[str, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)

    def inputs(self, numbers: Numbers) -> dict[str, str]:
        """Return the ids of the numbers that the formula uses, by symbol."""
        values = Values(self.ids, lambda _, id: np.asarray(numbers[id].value), self.fixed)
        with np.errstate(all="ignore"):
            self.compute(values)
        return values.used

    def at(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the value of the formula at arrays of its inputs."""
        return self.compute(Values(self.ids, lambda symbol, _: values[symbol], self.fixed))

    def range(self, numbers: Numbers) -> Span:
        """
        Return the value, and its least and greatest when every input varies within its rounding.
        """
        inputs = self.inputs(numbers)
        middle = {symbol: numbers[id].value for symbol, id in inputs.items()}
        free = inputs.keys() - set(self.as_printed)
        half = {symbol: numbers[inputs[symbol]].half for symbol in free}
        return reach(self.at, middle, half)

    def result(self, value: float, number: PrintedNumber) -> str:
        """Return the formula with its value, and its label."""
        return f"{self.text} = {show(value, number, 2)}" + (
            f" ({self.label})" if self.label else ""
        )


def reach(compute: Callable, middle: Mapping[str, float], half: Mapping[str, float]) -> Span:
    """
    Return a function's value at the middle of a box, and its least and greatest over the box.

    Exact for functions that are monotone in each input, as nearly all here are; NaN (an impossible
    input) is passed over.
    """
    names = [name for name in middle if half.get(name, 0.0) > 0.0]
    # The middle, all corners, and points inside, the same at every call, where a function that is
    # not monotone may turn.
    corners = np.array(list(product((-1.0, 1.0), repeat=len(names))))
    inside = np.random.default_rng(0).uniform(-1.0, 1.0, (INSIDE, len(names)))
    points = np.concatenate([np.zeros((1, len(names))), corners, inside])
    values = {name: np.full(len(points), float(value)) for name, value in middle.items()}
    for name, offsets in zip(names, points.T, strict=True):
        values[name] = middle[name] + half[name] * offsets
    with np.errstate(all="ignore"):
        reached = np.broadcast_to(np.asarray(compute(values), dtype=float), (len(points),))
    known = reached[~np.isnan(reached)]
    return (float(reached[0]), float(known.min()), float(known.max())) if known.size else NOTHING


def show(value: float, like: PrintedNumber | None = None, more: int = 0) -> str:
    """Return a number with the decimals of a printed one, and `more`; or 4 significant digits."""
    if not np.isfinite(value):
        return str(value)
    if like is None or np.isnan(like.half) or like.half == 0.0:
        return f"{value:.4g}"
    if "e" in like.printed.lower() or abs(value) < 0.5 * 10.0 ** -(like.decimals + more):
        return f"{value:.{2 + more}e}"
    return f"{value:.{like.decimals + more}f}"


@dataclass(frozen=True)
class Relation:
    """
    What other printed numbers say of the number `of`, or of all that match it.

    `suffix` is appended to the id where a number is checked more than once, with a `quantity` of
    its own. Of those that match, `printed` chooses by the text, and where the name `unless` is
    printed beside a number nothing is said.
    """

    of: str
    _: KW_ONLY
    note: str = ""
    suffix: str = ""
    quantity: str = ""
    printed: str = ""
    unless: str = ""


@dataclass(frozen=True)
class Follows(Formula, Relation):
    """
    A formula that a printed number follows from.

    `conventions` are other readings of the definition, tried in turn; `explanations` are mistakes
    that could have led to the printed number, named only if they give it. `target` has the ends
    that the result must lie between where they are not those of the printed number. Where `binding`
    is given, it says why the formula need not hold exactly, and "not checkable" replaces "differs".
    """

    _: KW_ONLY
    conventions: tuple[Formula, ...] = ()
    explanations: tuple[Formula, ...] = ()
    binding: str = ""
    target: tuple[float, float] | None = None

    def row(self, numbers: Numbers) -> Row:
        """Return the verdict."""
        number = numbers[self.of]
        least, most = self.target or number.compatible
        ways = [(way, way.range(numbers)) for way in (self, *self.conventions)]
        hit = [w for w in ways if least <= w[1][0] <= most]
        near = [w for w in ways if w[1][1] <= most and w[1][2] >= least]
        way, span = (hit or near or ways)[0]
        value, low, high = span
        reason = f"{way.result(value, number)}."
        if hit:
            verdict = "reproduced"
        elif near:
            verdict = "within rounding"
            reason = (
                f"{reason[:-1]}; from {show(low, number, 2)} to {show(high, number, 2)} as the "
                "printed inputs vary within their rounding, which takes in the printed "
                f"{number.printed}."
            )
            explanation = self._explained(numbers, least, most)
            if explanation:
                reason = f"Suspicious: {reason} {explanation}"
        else:
            verdict = "not checkable" if self.binding else "differs"
            reason = f"{self._missed(number, ways)} {self._explained(numbers, least, most)}".strip()
        return row_about(
            number,
            f"{reason} {self.note}",
            verdict,
            span,
            id=number.id + self.suffix,
            quantity=self.quantity,
            formula=way.text,
            inputs=listing(way.inputs(numbers), numbers),
        )

    def _missed(self, number: PrintedNumber, ways: list) -> str:
        """Return the reason where no convention reaches the printed number."""
        tried = []
        for way, (value, low, high) in ways:
            span = f", from {show(low, number, 2)} to {show(high, number, 2)} within rounding"
            tried.append(f"{way.result(value, number)}{span if high > low else ''}")
        word = f"“{number.printed}”, that is {number.value:g}" if number.is_word else number.printed
        reason = f"{'; '.join(tried)}. Printed is {word}."
        if self.binding:
            return f"Suspicious: {reason} But {self.binding}"
        if self.target is not None:
            return f"{reason} It does not hold."
        _, (value, _, _) = ways[0]
        should = show(value, number)
        reason += f" It should be {should}."
        same_length = len(should) == len(number.printed)
        changed = sum(a != b for a, b in zip(should, number.printed, strict=False))
        return f"{reason} One digit differs." if same_length and changed == 1 else reason

    def _explained(self, numbers: Numbers, least: float, most: float) -> str:
        """Name the first explanation that gives the printed number."""
        for way in self.explanations:
            value, _, _ = way.range(numbers)
            if least <= value <= most:
                return f"Probably {way.label}: {way.text} = {show(value, numbers[self.of], 2)}."
        return ""


@dataclass(frozen=True)
class Allows(Relation):
    """
    The range, from `least` to `most`, that other printed numbers leave a number.

    Where `binding` is given, a number may lie beyond it, and `binding` says what that means.
    """

    least: Formula
    most: Formula
    binding: str = ""

    def row(self, numbers: Numbers) -> Row:
        """Return the verdict: "not checkable" inside the range, "differs" outside."""
        number, note = numbers[self.of], self.note
        at_least, low, _ = self.least.range(numbers)
        at_most, _, high = self.most.range(numbers)
        if not at_least <= number.value < at_most:
            note = (
                f"As printed they give {show(at_least)} to {show(at_most)}, the upper end excluded."
            )
            note = note if self.binding else f"Suspicious: {note}"
        text = f"{self.least.text} … {self.most.text}"
        inputs = self.least.inputs(numbers) | self.most.inputs(numbers)
        return row_within(number, (low, high), text, inputs, numbers, note, self.binding)


def row_within(
    number: PrintedNumber,
    allowed: tuple[float, float],
    formula: str,
    inputs: Mapping[str, str],
    numbers: Numbers,
    note: str = "",
    binding: str = "",
) -> Row:
    """Return the row of a number of which others say only within which ends it lies."""
    low, high = allowed
    least, most = number.compatible
    between, verdict = f"from {show(low)} to {show(high)}", "not checkable"
    if most < low or least > high:
        verdict, reason = "not checkable", f"{binding} Other printed numbers give {between}."
        if not binding:
            verdict = "differs"
            reason = f"Impossible: other printed numbers allow it {between}, however rounded."
    elif np.isnan(low) or np.isnan(high):
        reason = "Other printed numbers leave it open."
    else:
        reason = f"Not determined by other printed numbers, which allow it {between}."
        if binding:
            reason = f"Not determined by other printed numbers; their limits are {between}."
    first = note.startswith("Suspicious")
    return row_about(
        number,
        f"{note} {reason}" if first else f"{reason} {note}",
        verdict,
        (np.nan, low, high),
        formula=formula,
        inputs=listing(inputs, numbers),
    )


def beside(place: str, end: str, numbers: Numbers) -> dict[str, str]:
    """Return the ids of numbers in a place or of a participant by the names that formulas use."""
    starts: tuple[str, ...] = (f"{place}/",)
    if f"{place}/n" in numbers:
        starts = tuple(f"{place}/{test}" for test in ("t_test.", "mauchly.", "anova.", ""))
    if end:
        starts = ("table_2.2/", "table_2.1/")
    ids = {}
    for start in starts:
        for id in numbers:
            if id.startswith(start) and id.endswith(end):
                name = id.removeprefix(start).removesuffix(end)
                ids[LETTERS.get(name, name)] = id
    return ids


def completed(relation: Follows | Allows, numbers: Numbers) -> Follows | Allows:
    """Return a relation whose formulas say where all their symbols stand."""
    place, _, _ = relation.of.rpartition("/")
    _, _, last = f"{relation.of}{relation.suffix}".rpartition("/")
    names = beside(place, f"/{last}" if last in PARTICIPANTS else "", numbers)
    if relation.unless in names:
        raise NotPrintedError(relation.unless)
    fixed = {"k": len(conditions_of(place))} if f"{place}/n" in numbers else {}

    def formula(way: Any, ids: Mapping[str, str]) -> Any:
        listed = _listed(way.ids, place, numbers)
        way = replace(way, ids={**ids, **listed}, fixed={**fixed, **way.fixed})
        way.inputs(numbers)  # all of them are printed
        return way

    if isinstance(relation, Allows):
        ends = formula(relation.least, names), formula(relation.most, names)
        return replace(relation, least=ends[0], most=ends[1])
    first = formula(relation, names)
    return replace(
        first,
        conventions=tuple(formula(way, first.ids) for way in relation.conventions),
        explanations=tuple(formula(way, first.ids) for way in relation.explanations),
    )


def _listed(ids: Mapping[str, str], place: str, numbers: Numbers) -> dict[str, str]:
    """Return ids by symbol; a pattern gives a symbol for each number that matches."""
    listed = {}
    for symbol, where in ids.items():
        pattern = where.replace("./", f"{place}/", 1) if where.startswith("./") else where
        if pattern in numbers:
            listed[symbol] = pattern
            continue
        start = pattern.partition("*")[0].partition("[")[0]
        for id in matching(numbers, pattern):
            name, _, _ = id.removeprefix(start).partition("/")
            listed[f"{symbol}_{name}"] = id
    return listed


# What a maker of checks returns: a row, or what gives one.
Finding = Follows | Allows | Row


def rows_of(checks: Iterable[Finding], numbers: Numbers) -> list[Row]:
    """Return the rows of checks; what is a row already stays as it is."""
    return [check if isinstance(check, Row) else check.row(numbers) for check in checks]
