"""Numbers as printed: text whose last digit says how far they were rounded."""

import math
import re
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal, InvalidOperation

from trustlab.models.checks import shown
from trustlab.reproduction.published import published_facts

# Both conventions for a 5 that is rounded off; which one a printed number followed is not known.
ROUNDINGS = (ROUND_HALF_EVEN, ROUND_HALF_UP)

# Printed words that stand for a number or a rank.
WORDS = published_facts("words")


def _parsed(text: str, name: str) -> tuple[str, Decimal]:
    """Return the inequality sign, or an empty text, and the number of a printed text."""
    match = re.fullmatch(r"\s*([<>]?)\s*(\S+)\s*", text) if isinstance(text, str) else None
    try:
        value = Decimal(match[2]) if match else None
    except InvalidOperation:
        value = None
    if value is None or not value.is_finite():
        lost = f" ({type(text).__name__}): it has lost its trailing zeros"
        if isinstance(text, str):
            lost = "; write a decimal point" if "," in text else ""
        raise ValueError(
            f"{name} must be a number as printed, in quotes, for example '0.390', got "
            f"{shown(text)}{lost}"
        )
    return match[1], value


def printed_decimal(text: str, name: str = "a printed value") -> Decimal:
    """Return a printed number with the digits it was printed with; inequalities are refused."""
    sign, value = _parsed(text, name)
    if sign:
        raise ValueError(f"{name} must be a number as printed, not the inequality {text!r}")
    return value


def last_unit(value: Decimal) -> Decimal:
    """Return one unit of a number's last digit."""
    return Decimal(1).scaleb(int(value.as_tuple().exponent))


def half_unit(printed: str) -> float:
    """
    Return half a unit of a printed number's last digit: 0.0005 for "0.320", 5e-8 for "5.44e-5".
    """
    return 0.5 * float(last_unit(printed_decimal(printed)))


def printed_interval(text: str, name: str = "a printed value") -> tuple[float, float]:
    """
    Return what rounds to a printed number, or what a printed inequality such as "<.0005" allows.
    """
    sign, value = _parsed(text, name)
    if sign == "<":
        return -math.inf, float(value)
    if sign == ">":
        return float(value), math.inf
    # In decimals, so that 0.50 gives 0.495 and 0.505 and not what binary fractions make of them.
    half = last_unit(value) / 2
    return float(value - half), float(value + half)


def rounds_to(value: float, target: Decimal) -> bool:
    """Return whether a value rounds to a printed number, by either convention for a final 5."""
    exact, unit = Decimal(float(value)), last_unit(target)
    return any(exact.quantize(unit, rule) == target for rule in ROUNDINGS)


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
        return self.printed.strip().lower() in WORDS

    @property
    def is_bound(self) -> bool:
        """Whether a bound is printed, such as "<.0005" or ">.05"."""
        return self.printed.strip().startswith(("<", ">"))

    def _decimal(self) -> Decimal:
        try:
            return Decimal(self.printed.strip().lstrip("<>"))
        except InvalidOperation:
            return Decimal("nan")

    @property
    def value(self) -> float:
        """The number; NaN for a word that stands for none."""
        return WORDS[self.printed.strip().lower()] if self.is_word else float(self._decimal())

    @property
    def half(self) -> float:
        """
        Half a unit of the last printed digit; 0 for counts.

        Words that stand for a number have 0, other words NaN.
        """
        value = self._decimal()
        if self.exact or self.is_word:
            return 0.0
        return 0.5 * float(last_unit(value)) if value.is_finite() else math.nan

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
