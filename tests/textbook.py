"""Statistics of a within-subject study by textbook definitions, and as a paper prints them."""

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
