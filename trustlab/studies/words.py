"""Numbers, tables and sentences of a results section, as the APA manual requires."""

import re
from collections.abc import Iterable
from decimal import ROUND_HALF_UP, Decimal, localcontext
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import between, counted, one_of
from trustlab.studies.table import mark

# Column of p-values and its name in the sentence.
_ADJUSTMENTS = {
    "holm": ("p_holm", "Holm-adjusted p"),
    "bonferroni": ("p_bonferroni", "Bonferroni-adjusted p"),
    "none": ("p", "unadjusted p"),
}
# Heads of columns and names of parameters; others are written with blanks for underlines.
_HEADS = {
    "mean": "M",
    "sd": "SD",
    "ci_low": "95% CI low",
    "ci_high": "95% CI high",
    "stderr": "standard error",
    "se": "standard error",
    "p_corrected": "p",
    "p_gg": "p (Greenhouse–Geisser)",
    "p_hf": "p (Huynh–Feldt)",
    "p_holm": "p (Holm)",
    "p_bonferroni": "p (Bonferroni)",
    "df1_corrected": "df1",
    "df2_corrected": "df2",
    "d_z_low": "d_z, 95% CI low",
    "d_z_high": "d_z, 95% CI high",
    "eta2_partial": "ηp²",
    "eta2_partial_low": "ηp², 90% CI low",
    "eta2_partial_high": "ηp², 90% CI high",
    "eta2_generalized": "ηG²",
    "epsilon_gg": "ε (Greenhouse–Geisser)",
    "epsilon_hf": "ε (Huynh–Feldt)",
    "greenhouse-geisser": "Greenhouse–Geisser",
    "huynh-feldt": "Huynh–Feldt",
    "human_beta": "human β",
    "robot_beta": "robot β",
    "time_constant": "time constant [s]",
    "human_time_constant": "human τ [s]",
    "robot_time_constant": "robot τ [s]",
} | {name: name for name in ("d_z", "TSC_l", "TSC_u")}
# Columns in the unit of what was measured: as many decimals as show their error.
_ESTIMATES = {"value", "estimate", "mean", "mean_difference", "stderr", "se", "sd"}
_ESTIMATES |= {"ci_low", "ci_high"}
# Columns of levels, which are not rounded where they are numbers.
_LEVELS = ["a", "b", "level", "condition"]
# Columns of p-values, and their heads.
P_VALUE = re.compile(
    r"p|p, .*|mauchly_p|shapiro_p"
    r"|p[ _](gg|hf|holm|bonferroni|corrected|adjusted|uncorrected|value|mauchly|anova|friedman"
    r"|mixed|shapiro_least|simulated|chi2|low|high)"
)


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
    with localcontext(prec=400, rounding=ROUND_HALF_UP):
        text = f"{Decimal(f'{value:.12g}'):z.{digits}f}".replace("-", "−")
    return re.sub(r"^(−?)0\.", r"\1.", text) if below_one else text


def apa_p(p: float) -> str:
    """
    Return "p = .012", "p < .001" or "p > .999".

    Parameters
    ----------
    p : float
        A p-value.
    """
    if not (isinstance(p, float) and np.isnan(p)):
        between("p", p, 0.0, 1.0)
    if p < 0.001:
        return "p < .001"
    return "p > .999" if p >= 0.9995 else f"p = {apa_number(p, 3, below_one=True)}"


def printed(table: pd.DataFrame) -> pd.DataFrame:
    """
    Return a table of texts with the heads and roundings of a paper; NaN is an empty text.

    Intervals have the level of a column `confidence` or of the table's attrs, 95 % without; none
    in the head where rows differ. Estimates have as many decimals, at least
    two, as show two digits of their standard error, or else of the interval's half width or the
    standard deviation; other numbers as many as show two digits of a typical one.

    Parameters
    ----------
    table : pandas.DataFrame
        Results; an index with a name is printed, too.
    """
    frame = table if table.index.names == [None] else table.reset_index()
    heads = [name if isinstance(name, tuple) else (name,) for name in frame]
    frame = frame.set_axis([" ".join(map(str, head)).strip() for head in heads], axis=1)
    texts = frame.astype(object).where(frame.notna(), "").map(str)
    for name in frame.select_dtypes("float").columns.difference(_LEVELS):
        texts[name] = np.where(frame[name].isna(), "", _rounded(frame, name))
    for name in texts.columns.intersection(["parameter", "correction"]):
        texts[name] = texts[name].map(in_words)
    words = texts.columns.map(in_words)
    # Two columns of one head, such as corrected and uncorrected p, keep their own names.
    own = texts.columns.str.replace("_", " ")
    texts.columns = words.where(~words.duplicated(keep=False), own)
    levels = {*frame.get("confidence", [table.attrs.get("confidence", 0.95)])}
    level = f"{100.0 * levels.pop():g}% " if len(levels) == 1 else ""
    texts.columns = texts.columns.str.replace("95% ", level)
    return texts


def _rounded(frame: pd.DataFrame, name: str) -> list[str]:
    """Return the numbers of a column as texts."""
    values = frame[name].to_numpy()
    if P_VALUE.fullmatch(name):
        return [apa_p(value).removeprefix("p ").removeprefix("= ") for value in values]
    if name.startswith(("eta2_", "epsilon_")):
        return [*map(share, values)]
    if name.startswith("bf"):  # Bayes factors, of any size
        return [f"{value:.3g}" for value in values]
    counts = name.startswith("df") or name in ("n", "k")
    if counts and not (values[~np.isnan(values)] % 1.0).any():
        return [f"{value:.0f}" for value in values]
    sizes: Any = [values]
    if name in _ESTIMATES:
        errors = frame.get("stderr", frame.get("se"))
        if errors is not None:
            sizes = errors  # of each row
        elif {"ci_low", "ci_high"} <= {*frame}:
            sizes = [(frame["ci_high"] - frame["ci_low"]) / 2.0]
        else:
            sizes = [frame.get("sd", 0.0)]
    decimals = np.resize([decimals_of(size, 2, 2) for size in sizes], len(values))
    return [*map(apa_number, values, decimals.tolist())]


def decimals_of(values: Any, digits: int, least: int = 0) -> int:
    """Return the decimals, at least so many, that show some digits of a typical number."""
    sizes = np.abs(np.ravel(values).astype(float))
    sizes = sizes[(sizes > 0.0) & (sizes < np.inf)]
    typical = np.median(sizes) if sizes.size else 1.0
    return int(np.clip(digits - 1 - np.floor(np.log10(typical)), least, 12))


def in_words(name: str) -> str:
    """Return the head of a column, or the name of a parameter, as a paper prints it."""
    return _HEADS.get(name, name.replace("_", " "))


def listed(labels: Iterable) -> str:
    """Return labels with commas between them."""
    return ", ".join(map(str, labels))


def df_text(value: float) -> str:
    """Return degrees of freedom, with decimals where they are no whole number."""
    return f"{value:.2f}" if abs(value - round(value)) > 1e-6 else f"{round(value)}"


def share(value: float) -> str:
    """Return a number that cannot exceed 1, such as an effect size, with two decimals."""
    return apa_number(value, below_one=True)


def interval(low: float, high: float, digits: int = 2, *, level: float = 95.0) -> str:
    """Return "95% CI [0.12, 0.34]"."""
    return f"{level:g}% CI [{apa_number(low, digits)}, {apa_number(high, digits)}]"


def effect_text(row: Any, end: str = "", alpha: float = 0.05) -> str:
    """
    Return "mode was significant, F(2, 22) = 5.31, p = .013 …" of a row of tests; `end` is that of
    the names of its degrees of freedom and p.
    """
    p, df1, df2 = (row[f"{name}{end}"] for name in ("p", "df1", "df2"))
    ends = f"[{share(row['eta2_partial_low'])}, {share(row['eta2_partial_high'])}]"
    text = (
        f"{row['effect']} {'was' if p < alpha else 'was not'} significant, F({df_text(df1)}, "
        f"{df_text(df2)}) = {apa_number(row['F'])}, {apa_p(p)}, ηp² = "
        f"{share(row['eta2_partial'])}, 90% CI {ends}"
    )
    return f"{text}, ηG² = {share(row['eta2_generalized'])}" if "eta2_generalized" in row else text


def apa_report(result: Any, adjust: str = "holm") -> str:
    """Return the sentences of an analysis of variance: of one factor with means and pairs."""
    one_of("adjust", adjust, _ADJUSTMENTS)
    rows = result.table().to_dict("records")
    sizes = [len(levels) for levels in (*result.between.values(), *result.within.values())]
    size = "one-way" if len(sizes) == 1 else " × ".join(map(str, sizes))
    names = [*result.design.covariates]
    beside = f" with {listed(names)} as {'covariates' if names[1:] else 'a covariate'}"
    corrected = any(row["correction"] != "none" for row in rows)
    rule = in_words(result.correction_rule) if corrected else ""
    kind = "mixed" if result.between else "repeated-measures"
    effects = "; ".join(effect_text(row, "_corrected", result.alpha) for row in rows)
    text = (
        f"{mark(result.origin)}A {size} {kind} ANOVA of {result.dv}{beside * bool(names)} (N = "
        f"{result.n}{f', α = {result.alpha:g}' * (result.alpha != 0.05)}"
        f"{', correction of degrees of freedom: ' * corrected}{rule}): {effects}."
    )
    if not result.one_way:
        return text + left_out(result.excluded)
    row = rows[0]
    if np.isnan(row["mauchly_p"]) and row["df1"] > 1:
        text += " Mauchly's test of sphericity is not defined."
    elif row["df1"] > 1:
        verdict = "was violated" if row["mauchly_p"] < result.alpha else "was not rejected"
        text += (
            f" Sphericity {verdict} (Mauchly's W = {share(row['mauchly_w'])}, "
            f"χ²({row['mauchly_df']}) = {apa_number(row['mauchly_chi2'])}, "
            f"{apa_p(row['mauchly_p'])}; Greenhouse–Geisser's ε = {share(row['epsilon_gg'])})."
        )
    text += f" By condition: {listed(condition_means(result.descriptives()))}."
    column, kind = _ADJUSTMENTS[adjust]
    significant, rest = [], []
    for row in result.pairs().to_dict("records"):
        a, b, p = row["a"], row["b"], row[column]
        if p < result.alpha:
            significant.append(
                f"{'higher' if row['mean_difference'] > 0.0 else 'lower'} in {a} than in {b}, "
                f"t({row['df']}) = {apa_number(row['t'])}, {apa_p(p)}, d_z = "
                f"{apa_number(row['d_z'])}, {interval(row['d_z_low'], row['d_z_high'])}"
            )
        else:
            rest.append(f"{a} and {b} ({'no test: one difference' if np.isnan(p) else apa_p(p)})")
    found = f" {'; '.join(significant)}." if significant else ""
    none = f" No significant difference between {listed(rest)}." if rest else ""
    return f"{text} Paired t-tests ({kind}):{found}{none}{left_out(result.excluded)}"


def condition_means(stats: pd.DataFrame) -> list[str]:
    """Return "C1 (M = 3.21, SD = 0.80)" for each row of descriptive statistics."""
    digits = decimals_of(stats["sd"], 3)
    return [
        f"{condition} (M = {apa_number(mean, digits)}, SD = {apa_number(sd, digits)})"
        for condition, mean, sd in zip(stats["condition"], stats["mean"], stats["sd"], strict=True)
    ]


def left_out(excluded: tuple) -> str:
    """Return the sentence, after a blank, about subjects left out; "" without any."""
    if not excluded:
        return ""
    people = counted(len(excluded), "participant")
    return f" Left out for missing scores: {people} ({listed(excluded)})."


def apa_pair(result: Any) -> str:
    """Return a paired t-test as a sentence."""
    analysis, stats = result.analysis, result.descriptives()
    a, b = condition_means(stats)
    digits = decimals_of((result.ci_high - result.ci_low) / 2.0, 2, 2)
    alpha = round(1.0 - result.confidence, 12)
    verb = "differed significantly" if result.p < alpha else "did not differ significantly"
    at = "" if alpha == 0.05 else f" (α = {alpha:g})"
    difference = interval(result.ci_low, result.ci_high, digits, level=100 * result.confidence)
    d_z = interval(result.d_z_low, result.d_z_high, level=100 * result.confidence)
    return (
        f"{mark(analysis.origin)}{analysis.dv} {verb}{at} between {a} and {b}, "
        f"t({result.df}) = {apa_number(result.t)}, {apa_p(result.p)}, mean difference "
        f"{apa_number(result.mean_difference, digits)}, {difference}, d_z = "
        f"{apa_number(result.d_z)}, {d_z}.{left_out(analysis.excluded)}"
    )
