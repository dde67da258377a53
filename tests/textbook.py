"""Statistics of a within-subject study by textbook definitions, and as a paper prints them."""

from decimal import Decimal
from itertools import combinations

import numpy as np
from scipy import stats


def analysed(x):
    """
    Statistics of data (n, k): F by sums of squares, ε and Mauchly's χ² by orthonormal contrasts,
    pairs by SciPy's paired t-test.
    """
    n, k = x.shape
    d = k - 1
    total = ((x - x.mean()) ** 2).sum()
    between = k * ((x.mean(axis=1) - x.mean()) ** 2).sum()
    effect = n * ((x.mean(axis=0) - x.mean()) ** 2).sum()
    error = total - between - effect
    contrasts = np.linalg.qr(np.column_stack([np.ones(k), np.eye(k)[:, 1:]]))[0][:, 1:]
    a = contrasts.T @ np.cov(x.T) @ contrasts
    out = {
        "mean": x.mean(axis=0),
        "sd": x.std(axis=0, ddof=1),
        "F": (effect / d) / (error / (d * (n - 1))),
        "eta2": effect / (effect + error),
        "epsilon": np.trace(a) ** 2 / (d * np.trace(a @ a)),
        "pairs": [stats.ttest_rel(x[:, i], x[:, j]) for i, j in combinations(range(k), 2)],
    }
    if k > 2:
        # Mauchly's W; singular where there are fewer people than contrasts.
        log_w = np.linalg.slogdet(a).logabsdet - d * np.log(np.trace(a) / d)
        factor = n - 1 - (2 * d * d + d + 2) / (6 * d)
        weight = (d + 2) * (d - 1) * (d - 2) * (2 * d**3 + 6 * d * d + 3 * k + 2)
        weight /= 288 * (d * factor) ** 2
        out["chi2"] = -factor * log_w
        plain, shifted = (stats.chi2.sf(out["chi2"], k * d / 2 - 1 + more) for more in (0, 4))
        out["mauchly_p"] = plain + weight * (shifted - plain)
    return out


def degrees(shape, factor=1.0):
    """Degrees of freedom of F for data (n, k), times a correction."""
    n, k = shape
    return factor * (k - 1), factor * (k - 1) * (n - 1)


def text_of_p(p):
    return f"{p:.3f}" if p >= 0.001 else "<.001"


def printed_cells(found, decimals, sd_decimals=None):
    """Means and standard deviations of conditions A, B, …"""
    places = {"mean": decimals, "sd": decimals if sd_decimals is None else sd_decimals}
    return {
        key: {c: f"{x:.{digits}f}" for c, x in zip("ABCDEF", found[key], strict=False)}
        for key, digits in places.items()
    }


def printed_anova(found, shape, df=1.0, p=1.0, places=0):
    """F, its degrees of freedom and p, corrected by these factors."""
    df1, df2 = degrees(shape, df)
    return {
        "F": f"{found['F']:.2f}",
        "df1": f"{df1:.{places}f}",
        "df2": f"{df2:.{places}f}",
        "p": text_of_p(stats.f.sf(found["F"], *degrees(shape, p))),
    }


def rounded(text):
    """The least and greatest number that prints so; p below a bound from 0 on."""
    if text.strip()[0] in "<>":
        bound = float(text.strip()[1:])
        return (0.0, bound) if "<" in text else (bound, np.inf)
    half = float(Decimal(1).scaleb(Decimal(text).as_tuple().exponent)) / 2
    return float(text) - half, float(text) + half


def misses(study, values, df=1.0, p=1.0):
    """
    Names of what a study prints and data (n, k) do not have; degrees of freedom and those of p are
    multiplied by `df` and `p`, p-values of pairs by their number. Pairs not listed are no
    difference.
    """
    found = analysed(values)
    has = {f"mean.{c}": x for c, x in zip(study.conditions, found["mean"], strict=True)}
    has |= {f"sd.{c}": x for c, x in zip(study.conditions, found["sd"], strict=True)}
    has |= {f"anova.{name}": found[name] for name in ("F", "eta2")}
    has["anova.df1"], has["anova.df2"] = degrees(values.shape, df)
    has["anova.p"] = stats.f.sf(found["F"], *degrees(values.shape, p))
    has |= {"epsilon": found["epsilon"], "mauchly.df": study.k * (study.k - 1) / 2 - 1}
    has |= {"mauchly.chi2": found.get("chi2"), "mauchly.p": found.get("mauchly_p")}
    has |= {"t_test.t": abs(found["pairs"][0].statistic), "t_test.p": found["pairs"][0].pvalue}
    printed = {name: rounded(text) for name, text in study.table()["printed"].items()}
    if study.t_test:
        printed["t_test.t"] = rounded(study.t_test["t"].lstrip("-"))
    if study.not_spherical:
        has["violated"], printed["violated"] = found["mauchly_p"], (0.0, 0.05)
    significant = {frozenset(name.split("-")) for name in study.significant_without_p}
    listed = {frozenset(name.split("-")) for name in study.pairs}
    for named, test in zip(combinations(study.conditions, 2), found["pairs"], strict=True):
        name, pair = f"pairs.{'-'.join(named)}", frozenset(named)
        has[name] = has[f"pairs.{'-'.join(named[::-1])}"] = min(
            len(found["pairs"]) * test.pvalue, 1.0
        )
        if listed | significant and pair not in listed:
            printed[name] = (0.0, 0.05) if pair in significant else (0.05, 1.0)
    return {name for name, (low, high) in printed.items() if not low <= has[name] <= high}
