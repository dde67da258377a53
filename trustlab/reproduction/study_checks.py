"""What a printed study must satisfy before anything is computed from it."""

from __future__ import annotations

import math
import re
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trustlab.reproduction.published_study import PublishedStudy

__all__ = ["PublishedStudyError", "check_study", "printed_interval"]

MEASURE_FIELDS = {
    "mauchly": ("chi2", "df", "p"),
    "anova": ("F", "df1", "df2", "p", "eta2"),
    "t_test": ("t", "df", "p"),
}


class PublishedStudyError(ValueError):
    """A printed study that cannot be: the message names the field."""


def printed_interval(text: str) -> tuple[float, float]:
    """
    Return the interval of values that round to a printed number, or that a printed inequality allows.

    Parameters
    ----------
    text : str
        For example "0.016" (0.0155 to 0.0165), "<.0005" (−∞ to 0.0005) or ">0.05" (0.05 to ∞).

    Raises
    ------
    ValueError
        If the text is no number and no inequality.
    """
    match = re.fullmatch(r"\s*([<>]?)\s*(\S+)\s*", text) if isinstance(text, str) else None
    try:
        value = Decimal(match[2]) if match else None
    except InvalidOperation:
        value = None
    if value is None or not value.is_finite():
        raise ValueError(
            f"must be a number as printed, in quotes, for example '0.50' or '<.0005', got {text!r}"
        )
    if match[1]:
        return (float("-inf"), float(value)) if match[1] == "<" else (float(value), float("inf"))
    half = Decimal(1).scaleb(value.as_tuple().exponent) / 2
    return float(value - half), float(value + half)


def check_study(study: PublishedStudy) -> None:
    """
    Refuse a study that cannot be.

    Parameters
    ----------
    study : PublishedStudy
        The study.

    Raises
    ------
    PublishedStudyError
        If a field is missing, is no printed number, or is impossible; the message names it.
    """
    _check_design(study)
    _check_scale(study)
    _check_cells(study)
    _check_tests(study)
    _check_pairs(study)


def _fault(study: PublishedStudy, message: str) -> PublishedStudyError:
    return PublishedStudyError(f"{study.name}: {message}")


def _interval(study: PublishedStudy, name: str, text: str, inequality: bool = False) -> tuple[float, float]:
    try:
        low, high = printed_interval(text)
    except ValueError as error:
        raise _fault(study, f"{name} {error}") from None
    if not inequality and math.isinf(high - low):
        raise _fault(study, f"{name} must be a number, not the inequality {text!r}")
    return low, high


def _check_p(study: PublishedStudy, name: str, text: str) -> None:
    low, high = _interval(study, name, text, inequality=True)
    value = high if math.isinf(low) else low if math.isinf(high) else 0.5 * (low + high)
    inside = (
        0.0 < value <= 1.0 if math.isinf(low) else 0.0 <= value < 1.0 if math.isinf(high) else 0 <= value <= 1
    )
    if not inside:
        raise _fault(study, f"{name} = {text!r} is no p-value; it must lie between 0 and 1")


def _check_design(study: PublishedStudy) -> None:
    if not isinstance(study.name, str) or not study.name:
        raise PublishedStudyError(f"name must be a text, got {study.name!r}")
    if isinstance(study.n, bool) or not isinstance(study.n, int):
        raise _fault(study, f"n must be a whole number of subjects, got {study.n!r}")
    if study.n < 3:
        raise _fault(study, f"n must be at least 3, got {study.n}")
    if not isinstance(study.listed_only, bool):
        raise _fault(study, f"listed_only must be true or false, got {study.listed_only!r}")
    if len(set(study.conditions)) != study.k:
        raise _fault(study, f"conditions must differ, got {', '.join(study.conditions)}")
    if study.k < 2:
        raise _fault(study, f"at least two conditions are needed, got {study.k}")
    if study.n <= study.k:
        raise _fault(
            study, f"n = {study.n} subjects are too few for {study.k} conditions; n must exceed them"
        )
    for key in ("mean", "sd"):
        for condition in getattr(study, key):
            if condition not in study.conditions:
                raise _fault(
                    study, f"{key}.{condition} is none of the conditions {', '.join(study.conditions)}"
                )
    if not study.mean:
        raise _fault(study, "mean has no condition")


def _check_scale(study: PublishedStudy) -> None:
    scale = study.scale
    numbers = isinstance(scale, tuple | list) and len(scale) == 2
    numbers = numbers and all(isinstance(x, int | float) and not isinstance(x, bool) for x in scale)
    if not numbers or not scale[0] < scale[1]:
        raise _fault(study, f"scale must be the lowest and the highest value, in this order, got {scale!r}")
    object.__setattr__(study, "scale", (float(scale[0]), float(scale[1])))
    if study.missing and math.isinf(scale[1] - scale[0]):
        raise _fault(
            study,
            f"scale must have both ends, because mean and SD of {', '.join(study.missing)} are not printed;"
            f" got {scale}",
        )


def _check_cells(study: PublishedStudy) -> None:
    low, high = study.scale
    for condition, text in study.mean.items():
        first, last = _interval(study, f"mean.{condition}", text)
        if last < low or first > high:
            raise _fault(study, f"mean.{condition} = {text} lies outside the scale {low:g} to {high:g}")
    for condition, text in study.sd.items():
        first, last = _interval(study, f"sd.{condition}", text)
        if 0.5 * (first + last) <= 0.0:
            raise _fault(study, f"sd.{condition} = {text} must be positive")
        if condition not in study.mean or math.isinf(high - low):
            continue
        m = printed_interval(study.mean[condition])
        middle = min(max(0.5 * (low + high), m[0]), m[1])
        largest = math.sqrt(max((middle - low) * (high - middle), 0.0) * study.n / (study.n - 1))
        if first > largest:
            raise _fault(
                study,
                f"sd.{condition} = {text} is more than {study.n} values from {low:g} to {high:g} with mean"
                f" {study.mean[condition]} can have ({largest:.4g})",
            )


def _check_tests(study: PublishedStudy) -> None:
    k = study.k
    for key, allowed in MEASURE_FIELDS.items():
        for name, text in getattr(study, key).items():
            if name not in allowed:
                raise _fault(study, f"{key}.{name} is unknown; there are {', '.join(allowed)}")
            if name == "p":
                _check_p(study, f"{key}.p", text)
            elif name != "t":
                low, high = _interval(study, f"{key}.{name}", text)
                if 0.5 * (low + high) < 0.0:
                    raise _fault(study, f"{key}.{name} = {text} must not be negative")
            else:
                _interval(study, f"{key}.t", text)
    if "eta2" in study.anova and printed_interval(study.anova["eta2"])[0] >= 1.0:
        raise _fault(study, f"anova.eta2 = {study.anova['eta2']} must lie between 0 and 1")
    if study.epsilon:
        low, high = _interval(study, "epsilon", study.epsilon)
        if high < 1.0 / (k - 1) or low > 1.0:
            raise _fault(
                study,
                f"epsilon = {study.epsilon} must lie between 1/(k − 1) = {1.0 / (k - 1):.4g} and 1 for {k} conditions",
            )
    if study.mauchly and k < 3:
        raise _fault(study, "mauchly: sphericity is no question for two conditions")
    if "df" in study.mauchly and float(study.mauchly["df"]) != k * (k - 1) // 2 - 1:
        raise _fault(
            study,
            f"mauchly.df = {study.mauchly['df']} does not belong to {k} conditions ({k * (k - 1) // 2 - 1})",
        )
    if "df1" in study.anova:
        low, high = printed_interval(study.anova["df1"])
        if high < 1.0 or low > k - 1 or (not study.corrected and not low <= k - 1 <= high):
            wanted = f"between 1 and {k - 1}" if study.corrected else f"{k - 1}"
            raise _fault(study, f"anova.df1 = {study.anova['df1']} must be {wanted} for {k} conditions")
    if study.t_test and k != 2:
        raise _fault(study, f"t_test needs two conditions, got {k}")


def _check_pairs(study: PublishedStudy) -> None:
    seen = {}
    for name in (*study.pairs, *study.significant_without_p):
        pair = study.pair(name)
        if pair in seen:
            raise _fault(study, f"pairs: {name} was given already, as {seen[pair]}")
        seen[pair] = name
    for name, text in study.pairs.items():
        _check_p(study, f"pairs.{name}", text)
