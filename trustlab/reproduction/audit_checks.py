"""How a verdict is made: a formula of printed numbers, its range within their rounding, and what is printed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from trustlab.reproduction.audit_numbers import PrintedNumber

__all__ = ["COLUMNS", "VERDICTS", "Check", "Formula", "Possible", "Remark", "Row", "reach", "show"]

VERDICTS = ("reproduced", "within rounding", "differs", "not checkable")
COLUMNS = (
    "id",
    "where",
    "quantity",
    "printed",
    "recomputed",
    "low",
    "high",
    "verdict",
    "reason",
    "formula",
    "inputs",
)

Numbers = Mapping[str, PrintedNumber]
Compute = Callable[[dict[str, np.ndarray]], np.ndarray]


@dataclass(frozen=True)
class Row:
    """
    One row of the audit.

    Parameters
    ----------
    id, where, quantity, printed : str
        Which printed number.
    recomputed, low, high : float
        What follows from other printed numbers, and its range within their rounding; NaN where nothing does.
    verdict : str
        One of `VERDICTS`.
    reason : str
        Why, with the arithmetic; begins with "Suspicious" where a slip is likely but not certain.
    formula, inputs : str
        What was computed, and the printed numbers that went into it.
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


@dataclass(frozen=True)
class Formula:
    """
    A way to compute one printed number from others.

    Parameters
    ----------
    text : str
        The formula as one reads it.
    inputs : mapping of str to str
        Symbol to id of a printed number.
    compute : callable
        Takes the symbols as arrays, returns an array.
    label : str
        Name of the convention, or what an explanation says.
    changed : mapping of str to float
        Symbols put in place of printed values, without rounding: the change that an explanation tries.
    as_printed : tuple of str
        Symbols used with the printed digits as they stand.
    """

    text: str
    inputs: Mapping[str, str]
    compute: Compute
    label: str = ""
    changed: Mapping[str, float] = field(default_factory=dict)
    as_printed: tuple[str, ...] = ()

    def range(self, numbers: Numbers) -> tuple[float, float, float]:
        """
        Return the value, and its least and greatest when every input varies within its rounding.

        Parameters
        ----------
        numbers : mapping of str to PrintedNumber
            All printed numbers.
        """
        middle = {symbol: numbers[id].value for symbol, id in self.inputs.items()} | dict(self.changed)
        half = {
            symbol: 0.0 if symbol in self.changed or symbol in self.as_printed else numbers[id].half
            for symbol, id in self.inputs.items()
        }
        return reach(self.compute, middle, half)

    def listing(self, numbers: Numbers) -> str:
        """
        Return the inputs as "symbol = printed (id)".

        Parameters
        ----------
        numbers : mapping of str to PrintedNumber
            All printed numbers.
        """
        return "; ".join(f"{symbol} = {numbers[id].printed} ({id})" for symbol, id in self.inputs.items())


def reach(
    compute: Compute, middle: Mapping[str, float], half: Mapping[str, float]
) -> tuple[float, float, float]:
    """
    Return a function's value at the middle of a box, and its least and greatest over the box.

    Evaluated at the corners, the middles of the faces (up to 6 inputs) or 3000 fixed random points (more), which is
    exact for functions that are monotone in each input, as nearly all here are.

    Parameters
    ----------
    compute : callable
        Takes names as arrays, returns an array; NaN where an input is impossible.
    middle, half : mapping of str to float
        Middle and half-width by name.
    """
    names = [name for name in middle if half.get(name, 0.0) > 0.0]
    if len(names) <= 6:
        points = np.array(list(product((0.0, -1.0, 1.0), repeat=len(names)))).reshape(3 ** len(names), -1)
    else:
        corners = np.array(list(product((-1.0, 1.0), repeat=len(names))))
        inside = np.random.default_rng(0).uniform(-1.0, 1.0, (3000, len(names)))
        points = np.concatenate([np.zeros((1, len(names))), corners, inside])
    values = {name: np.full(len(points), float(value)) for name, value in middle.items()}
    for i, name in enumerate(names):
        values[name] = middle[name] + half[name] * points[:, i]
    with np.errstate(all="ignore"):
        found = np.broadcast_to(np.asarray(compute(values), dtype=float), (len(points),))
    known = found[~np.isnan(found)]
    if known.size == 0:
        return np.nan, np.nan, np.nan
    return float(found[0]), float(known.min()), float(known.max())


def show(value: float, like: PrintedNumber | None = None, more: int = 0) -> str:
    """
    Return a number as it would be printed.

    Parameters
    ----------
    value : float
        The number.
    like : PrintedNumber, optional
        Its decimals are used; four significant digits when not given.
    more : int
        Decimals beyond them.
    """
    if not np.isfinite(value):
        return str(value)
    if like is None or like.half != like.half or like.half == 0.0:
        return f"{value:.4g}"
    if "e" in like.printed.lower() or abs(value) < 0.5 * 10.0 ** -(like.decimals + more):
        return f"{value:.{2 + more}e}"
    return f"{value:.{like.decimals + more}f}"


@dataclass(frozen=True)
class Check:
    """
    Whether a printed number follows from others.

    Parameters
    ----------
    number : str
        Id of the printed number.
    formula : Formula
        How it is defined.
    conventions : tuple of Formula
        Other readings of the definition, tried in turn.
    explanations : tuple of Formula
        Mistakes that could have led to the printed number; named only if they give it.
    note : str
        What else the reader should know.
    suffix : str
        Appended to the id where a number is checked more than once.
    quantity : str
        In place of the number's own description.
    binding : str
        Where not empty, why the formula need not hold exactly; it replaces "differs" by "not checkable".
    target : tuple of float, optional
        What counts as the printed value where a word is printed.
    """

    number: str
    formula: Formula
    conventions: tuple[Formula, ...] = ()
    explanations: tuple[Formula, ...] = ()
    note: str = ""
    suffix: str = ""
    quantity: str = ""
    binding: str = ""
    target: tuple[float, float] | None = None

    def row(self, numbers: Numbers) -> Row:
        """
        Return the verdict.

        Parameters
        ----------
        numbers : mapping of str to PrintedNumber
            All printed numbers.
        """
        number = numbers[self.number]
        least, most = self.target or number.compatible
        ways = [(way, *way.range(numbers)) for way in (self.formula, *self.conventions)]
        hit = next((w for w in ways if least <= w[1] <= most), None)
        near = next((w for w in ways if w[2] <= most and w[3] >= least), None)
        way, value, low, high = hit or near or ways[0]
        name = f" ({way.label})" if way.label else ""
        got = show(value, number, 2)
        if hit:
            verdict, reason = "reproduced", f"{way.text} = {got}{name}."
        elif near:
            verdict = "within rounding"
            reason = (
                f"{way.text} = {got}{name}; from {show(low, number, 2)} to {show(high, number, 2)} as the printed inputs "
                f"vary within their rounding, which takes in the printed {number.printed}."
            )
            if found := self._explained(numbers, least, most):
                reason = f"Suspicious: {reason} {found}"
        else:
            verdict, reason = self._missed(numbers, ways, least, most)
        return Row(
            self.number + self.suffix,
            number.where,
            self.quantity or number.quantity,
            number.printed,
            value,
            low,
            high,
            verdict,
            f"{reason} {self.note}".strip(),
            way.text,
            way.listing(numbers),
        )

    def _missed(self, numbers: Numbers, ways: list, least: float, most: float) -> tuple[str, str]:
        """Return verdict and reason where no convention reaches the printed number."""
        number, tried = numbers[self.number], []
        for way, value, low, high in ways:
            label = f" ({way.label})" if way.label else ""
            span = f", from {show(low, number, 2)} to {show(high, number, 2)} within rounding"
            tried.append(f"{way.text} = {show(value, number, 2)}{label}{span if high > low else ''}")
        word = f"“{number.printed}”, that is {number.value:g}" if number.is_word else number.printed
        should = show(ways[0][1], number)
        reason = f"{'; '.join(tried)}. Printed is {word}."
        if self.binding:
            reason = f"Suspicious: {reason} But {self.binding}"
        elif self.target is None:
            reason += f" It should be {should}."
            if len(should) == len(number.printed):
                changed = sum(a != b for a, b in zip(should, number.printed, strict=True))
                reason += " One digit differs." if changed == 1 else ""
        else:
            reason += " It does not hold."
        verdict = "not checkable" if self.binding else "differs"
        return verdict, f"{reason} {self._explained(numbers, least, most)}".strip()

    def _explained(self, numbers: Numbers, least: float, most: float) -> str:
        number = numbers[self.number]
        for way in self.explanations:
            value = way.range(numbers)[0]
            if least <= value <= most:
                return f"Probably {way.label}: {way.text} = {show(value, number, 2)}."
        return ""


@dataclass(frozen=True)
class Possible:
    """
    Whether a printed number lies in the range that others leave it.

    Parameters
    ----------
    number : str
        Id of the printed number.
    least, most : Formula
        Least and greatest possible value.
    note, suffix, quantity : str
        As for `Check`.
    """

    number: str
    least: Formula
    most: Formula
    note: str = ""
    suffix: str = ""
    quantity: str = ""

    def row(self, numbers: Numbers) -> Row:
        """
        Return the verdict: "not checkable" inside the range, "differs" outside.

        Parameters
        ----------
        numbers : mapping of str to PrintedNumber
            All printed numbers.
        """
        number = numbers[self.number]
        low, high = self.least.range(numbers)[1], self.most.range(numbers)[2]
        least, most = number.compatible
        span = f"from {show(low)} to {show(high)}"
        if most < low or least > high:
            verdict = "differs"
            reason = f"Impossible: other printed numbers allow it {span} only, whatever their rounding."
        elif np.isnan(low) or np.isnan(high):
            verdict, reason = "not checkable", "Other printed numbers leave it open."
        else:
            verdict, reason = (
                "not checkable",
                f"Not determined by other printed numbers, which allow it {span}.",
            )
        return Row(
            self.number + self.suffix,
            number.where,
            self.quantity or number.quantity,
            number.printed,
            np.nan,
            low,
            high,
            verdict,
            (
                f"{self.note} {reason}" if self.note.startswith("Suspicious") else f"{reason} {self.note}"
            ).strip(),
            f"{self.least.text} … {self.most.text}",
            (self.most if self.most.inputs else self.least).listing(numbers),
        )


@dataclass(frozen=True)
class Remark:
    """
    A printed number that no other determines.

    Parameters
    ----------
    number : str
        Id of the printed number.
    reason : str
        Why it cannot be checked, or what is odd about it.
    suffix, quantity : str
        As for `Check`.
    """

    number: str
    reason: str
    suffix: str = ""
    quantity: str = ""

    def row(self, numbers: Numbers) -> Row:
        """
        Return the verdict "not checkable" with the reason.

        Parameters
        ----------
        numbers : mapping of str to PrintedNumber
            All printed numbers.
        """
        number = numbers[self.number]
        nan = float("nan")
        return Row(
            self.number + self.suffix,
            number.where,
            self.quantity or number.quantity,
            number.printed,
            nan,
            nan,
            nan,
            "not checkable",
            self.reason,
        )
