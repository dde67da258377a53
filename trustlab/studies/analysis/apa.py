"""The sentences of a results section, with numbers rounded as the APA manual requires."""

from decimal import ROUND_HALF_UP, Context, Decimal
from numbers import Number

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of
from trustlab.studies.analysis.score_table import ScoreTable, same_for_all

# Column of p-values and its name in the sentence.
_ADJUSTMENTS = {
    "holm": ("p_holm", "Holm-adjusted p"),
    "bonferroni": ("p_bonferroni", "Bonferroni-adjusted p"),
    "none": ("p", "unadjusted p"),
}


def apa_number(value: float, digits: int = 2, *, below_one: bool = False) -> str:
    """
    Return a number as text, halves rounded away from zero, with a true minus sign.

    The number is taken to twelve significant digits first, so that a mean of 6.875 that rounding
    errors made one ulp too small becomes 6.88.

    Parameters
    ----------
    value : float
        The number.
    digits : int
        Decimals.
    below_one : bool
        Whether it cannot exceed 1, so that APA omits the leading zero.
    """
    if not np.isfinite(value):
        return str(value)
    step = Decimal(1).scaleb(-digits)
    rounded = Decimal(f"{abs(value):.12g}").quantize(
        step, rounding=ROUND_HALF_UP, context=Context(prec=400)
    )
    text = f"{rounded:f}"
    if below_one:
        text = text.removeprefix("0")
    return f"−{text}" if value < 0.0 and rounded != 0 else text


def _share(value: float) -> str:
    """Return a number that cannot exceed 1, such as an effect size, with two decimals."""
    return apa_number(value, below_one=True)


def apa_p(p: float) -> str:
    """
    Return "p = .012", "p < .001" or "p > .999".

    Parameters
    ----------
    p : float
        A p-value.
    """
    if p < 0.001:
        return "p < .001"
    return "p > .999" if p > 0.9995 else f"p = {apa_number(p, 3, below_one=True)}"


def apa_table(frame: pd.DataFrame, digits: int = 2) -> pd.DataFrame:
    """
    Return a table for reading: numbers rounded, p-values as a paper prints them, NaN as empty text.

    Parameters
    ----------
    frame : pandas.DataFrame
        Results; columns p, ``p_…`` and ``mauchly_p…`` hold p-values, columns a, b and condition
        hold labels and stay.
    digits : int
        Least number of decimals. Estimates have as many as show two digits of their standard error,
        or else of the interval's half width or the standard deviation; other columns as many as
        show two digits of a typical number.
    """
    frame = frame.copy()
    columns = frame.select_dtypes("float").columns.difference(["a", "b", "condition"], sort=False)
    by_error = _decimals_by_error(frame, digits)
    for name in columns:
        values = frame[name].to_numpy()
        if name == "p" or name.startswith(("p_", "mauchly_p")):
            texts = [apa_p(value).removeprefix("p ").removeprefix("= ") for value in values]
        else:
            decimals = by_error if name in _ESTIMATES else _decimals_of(values, digits)
            texts = [
                apa_number(value, int(count))
                for value, count in zip(values, np.resize(decimals, len(values)), strict=True)
            ]
        frame[name] = np.where(np.isnan(values), "", texts)
    return frame


# Columns in the unit of what was measured, and how wide each estimate's error is.
_LOW, _HIGH = ("ci_low", "95% CI low"), ("ci_high", "95% CI high")
_SPREADS = ("sd", "SD")
_ESTIMATES = {"value", "estimate", "mean", "M", "mean_difference", "stderr", "se"}
_ESTIMATES |= {*_LOW, *_HIGH, *_SPREADS}


def _decimals_by_error(frame: pd.DataFrame, digits: int) -> np.ndarray:
    """Return the decimals of each row's estimates: rows with a standard error differ in unit."""
    for name in ("stderr", "se"):
        if name in frame:
            return np.array([_decimals_of(np.array([error]), digits) for error in frame[name]])
    for low, high in zip(_LOW, _HIGH, strict=True):
        if low in frame and high in frame:
            return np.array([_decimals_of((frame[high] - frame[low]).to_numpy() / 2.0, digits)])
    spread = [frame[name].to_numpy() for name in _SPREADS if name in frame]
    return np.array([_decimals_of(spread[0] if spread else np.zeros(0), digits)])


def _decimals_of(values: np.ndarray, digits: int) -> int:
    """Return the decimals that show two digits of a typical number, at least `digits`."""
    sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
    if not sizes.size:
        return digits
    return int(np.clip(1 - np.floor(np.log10(np.median(sizes))), digits, 12))


def _df(value: float) -> str:
    return f"{value:.2f}" if abs(value - round(value)) > 1e-6 else f"{round(value)}"


def apa_decimals(sd: np.ndarray) -> int:
    """
    Return how many decimals show means to three digits of a typical standard deviation of the
    conditions.
    """
    typical = float(np.median(sd[sd > 0.0])) if (sd > 0.0).any() else 1.0
    return int(np.clip(2 - np.floor(np.log10(typical)), 0, 12))


def _omnibus(result) -> str:
    verb = "differed" if result.p_corrected < result.alpha else "did not differ"
    statistic = (
        f"F({_df(result.df1_corrected)}, {_df(result.df2_corrected)}) = {apa_number(result.F)}, "
        f"{apa_p(result.p_corrected)}, ηp² = {_share(result.eta2_partial)}, 90% CI "
        f"[{_share(result.eta2_partial_low)}, {_share(result.eta2_partial_high)}], ηG² = "
        f"{_share(result.eta2_generalized)}"
    )
    within = str(result.scores.within)
    of_what = "" if within.lower() in ("condition", "conditions") else f" of {within}"
    return (
        f"A one-way repeated-measures ANOVA (N = {result.n}) showed that {result.dv} {verb} "
        f"significantly between the {result.k} conditions{of_what}, {statistic}."
    )


def _sphericity(result) -> str:
    if result.k == 2:
        return ""
    applied = {
        "none": "not corrected",
        "greenhouse-geisser": f"Greenhouse–Geisser corrected, ε = {_share(result.epsilon_gg)}",
        "huynh-feldt": f"Huynh–Feldt corrected, ε = {_share(result.epsilon_hf)}",
    }[result.correction]
    applied = f"degrees of freedom are {applied}"
    if result.mauchly_reason:
        return f" {result.mauchly_reason.removesuffix('.')}; {applied}."
    verdict = "was violated" if result.mauchly_p < result.alpha else "was not rejected"
    return (
        f" Sphericity {verdict} (Mauchly's W = {_share(result.mauchly_w)}, χ²({result.mauchly_df}) "
        f"= {apa_number(result.mauchly_chi2)}, {apa_p(result.mauchly_p)}); {applied}."
    )


def _condition_means(stats: pd.DataFrame) -> list[str]:
    """Return "C1 (M = 3.21, SD = 0.80)" for each row of descriptive statistics."""
    digits = apa_decimals(stats["sd"].to_numpy())
    return [
        f"{condition} (M = {apa_number(mean, digits)}, SD = {apa_number(sd, digits)})"
        for condition, mean, sd in zip(stats["condition"], stats["mean"], stats["sd"], strict=True)
    ]


def _means(result) -> str:
    constant = ", ".join(map(str, same_for_all(result.scores)))
    same = f" Every subject had the same score in {constant} (SD = 0)." if constant else ""
    return f" By condition: {', '.join(_condition_means(result.descriptives()))}.{same}"


def _left_out(result, missing: str) -> str:
    if not result.excluded:
        return ""
    labels = ", ".join(map(str, result.excluded))
    return f" {len(result.excluded)} subject(s) with missing {missing} were left out ({labels})."


def _origin(scores: ScoreTable) -> str:
    return f"[{scores.origin}] " if scores.origin else ""


def _compared(a: object, b: object, higher: bool) -> str:
    if isinstance(a, Number) or isinstance(b, Number):  # “0.0 > 0.2” would read as arithmetic
        return f"{'higher' if higher else 'lower'} at {a} than at {b}"
    return f"{a} {'>' if higher else '<'} {b}"


def _pairs(result, adjust: str) -> str:
    pairs = result.pairs()
    column, kind = _ADJUSTMENTS[adjust]
    p = pairs[column].to_numpy()
    tests = f"Paired t-tests ({kind})" if len(pairs) > 1 else "A paired t-test"
    significant = []
    rest = []
    for i, (a, b) in enumerate(zip(pairs["a"], pairs["b"], strict=True)):
        if p[i] < result.alpha:
            t, d_z = apa_number(pairs["t"][i]), apa_number(pairs["d_z"][i])
            order = _compared(a, b, pairs["mean_difference"][i] > 0.0)
            significant.append(f"{order}, t({result.n - 1}) = {t}, {apa_p(p[i])}, d_z = {d_z}")
        else:
            reason = "no test: one difference" if np.isnan(p[i]) else apa_p(p[i])
            rest.append(f"{a} and {b} ({reason})")
    if not significant:
        return f" {tests} found no significant difference: {', '.join(rest)}."
    end = f"; no significant difference between {', '.join(rest)}" if rest else ""
    return f" {tests}: {'; '.join(significant)}{end}."


def apa_report(result, adjust: str = "holm") -> str:
    """Return omnibus test, sphericity and significant pairs of repeated measures as sentences."""
    one_of("adjust", adjust, _ADJUSTMENTS)
    sentences = _omnibus(result) + _sphericity(result) + _means(result) + _pairs(result, adjust)
    return _origin(result.scores) + sentences + _left_out(result, "cells")


def apa_pair(result) -> str:
    """Return a paired t-test as a sentence."""
    stats = result.descriptives()
    a, b = _condition_means(stats)
    digits = apa_decimals(stats["sd"].to_numpy())
    words = "differed significantly" if result.p < 0.05 else "did not differ significantly"
    return (
        f"{_origin(result.scores)}{result.scores.dv} {words} between {a} and {b}, t({result.df}) "
        f"= {apa_number(result.t)}, {apa_p(result.p)}, mean difference "
        f"{apa_number(result.mean_difference, digits)}, {100 * result.confidence:g}% CI "
        f"[{apa_number(result.ci_low, digits)}, {apa_number(result.ci_high, digits)}], d_z = "
        f"{apa_number(result.d_z)}.{_left_out(result, 'scores')}"
    )


def apa_effects(result) -> str:
    """Return the test of every effect of a factorial analysis as a sentence."""
    sentences = []
    for row in result.tests:
        verb = "was" if row["p_corrected"] < result.alpha else "was not"
        sentences.append(
            f"{row['effect']} {verb} significant, F({_df(row['df1_corrected'])}, "
            f"{_df(row['df2_corrected'])}) = {apa_number(row['F'])}, {apa_p(row['p_corrected'])}, "
            f"ηp² = {_share(row['eta2_partial'])}, ηG² = {_share(row['eta2_generalized'])}"
        )
    factors = [len(levels) for levels in (*result.between.values(), *result.within.values())]
    kind = "mixed" if result.between else "repeated-measures"
    return (
        f"{_origin(result.scores)}A {' × '.join(map(str, factors))} {kind} ANOVA of "
        f"{result.scores.dv} (N = {len(result.scores.subjects)}, correction: "
        f"{result.correction_rule}): {'; '.join(sentences)}.{_left_out(result, 'cells')}"
    )
