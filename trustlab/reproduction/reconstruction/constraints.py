"""
What a study prints as intervals, and the same statistics of any means and covariance.

All statistics of a one-way within-subject study are functions of its means and covariance matrix.
What a paper multiplies by the ε of Greenhouse and Geisser, which may have been rounded before, says
a `Reading`.
"""

from collections.abc import Iterator
from decimal import Decimal
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy import special

from trustlab.reproduction.printed import printed_decimal, printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.studies.anova import orthonormal_contrasts, sphericity
from trustlab.studies.pairs import bonferroni, holm

# Adjustments of pairwise p-values for the number of comparisons.
ADJUSTMENTS = ("bonferroni", "holm", "sidak", "none")

ALPHA = 0.05


class Constraint(NamedTuple):
    """One printed number: its name, such as "anova.F", its text, and what agrees with it."""

    name: str
    text: str
    low: float
    high: float

    @property
    def is_p(self) -> bool:
        """Whether it is a p-value."""
        tests = "anova.p", "mauchly.p", "mauchly.violated", "t_test.p", "pairs."
        return self.name.startswith(tests)

    @property
    def size(self) -> "Constraint":
        """The constraint on its magnitude."""
        least, most = sorted((abs(self.low), abs(self.high)))
        return self._replace(low=0.0 if self.low < 0.0 < self.high else least, high=most)


class Reading(NamedTuple):
    """
    What was multiplied by ε: the printed degrees of freedom (`df`), those of the printed p (`p`).

    `rounded` is the ε that both were multiplied by, where it is another than that of the data.
    """

    words: str
    df: bool
    p: bool
    rounded: float | None = None


NEITHER = Reading("uncorrected p and degrees of freedom", False, False)
BOTH = Reading("corrected p and degrees of freedom", True, True)
ONLY_P = Reading("corrected p, uncorrected degrees of freedom", False, True)
ONLY_DF = Reading("uncorrected p, corrected degrees of freedom", True, False)


def readings(study: PublishedStudy) -> Iterator[Reading]:
    """Return the readings of a study, the usual one first."""
    usual = BOTH if study.corrected else NEITHER
    yield usual
    if study.k == 2:  # ε is 1
        return
    # No ε makes degrees of freedom larger: where too many are printed, none was applied to them.
    plain = {"df1": study.k - 1, "df2": (study.k - 1) * (study.n - 1)}
    ends = [(*printed_interval(study.anova[df]), plain[df]) for df in plain.keys() & study.anova]
    too_many = any(low > df for low, _, df in ends) and not any(high < df for _, high, df in ends)
    for reading in (ONLY_P, ONLY_DF, BOTH, NEITHER):
        if reading != usual and not (too_many and reading.df):
            yield reading
    if not study.epsilon:
        return
    epsilon = printed_decimal(study.epsilon)
    for unit in (Decimal("0.01"), Decimal("0.1")):
        rounded = epsilon.quantize(unit)
        if rounded != epsilon and rounded * (study.k - 1) >= 1:
            words = f"p and degrees of freedom corrected by ε rounded to {rounded}"
            yield Reading(words, True, True, float(rounded))


def constraints(study: PublishedStudy) -> list[Constraint]:
    """
    Return a constraint per printed number.

    A pair without a p-value was reported as not significant, p > 0.05, unless the study's
    `listed_only` is set.
    """
    rows = [Constraint(*row) for row in study.table().itertuples(name=None)]
    # Which condition of a t-test is first is not printed.
    rows = [row.size if row.name == "t_test.t" else row for row in rows]
    if study.not_spherical and 2 < study.k <= study.n and not {"chi2", "p"} & study.mauchly.keys():
        text = f"sphericity violated, p < {ALPHA}"
        rows.append(Constraint("mauchly.violated", text, 0.0, ALPHA))
    for name in study.significant_without_p:
        rows.append(Constraint(f"pairs.{name}", "significant", 0.0, ALPHA))
    named = {study.pair(name) for name in (*study.pairs, *study.significant_without_p)}
    for pair in combinations(range(study.k), 2):
        if named and pair not in named and not study.listed_only:
            name = "-".join(study.conditions[i] for i in pair)
            rows.append(Constraint(f"pairs.{name}", "not significant", ALPHA, 1.0))
    return rows


def statistics(
    study: PublishedStudy,
    reading: Reading,
    p_adjust: str,
    scores: np.ndarray,
) -> dict[str, np.ndarray]:
    """
    Return the statistics of scores (B, n, k) by the names of constraints.

    With A the covariance of k − 1 orthonormal contrasts: F = n Σ(m − m̄)²/tr A, and t_ij = (m_i −
    m_j)/√(V_ij/n) with V_ij the variance of a difference; of t the size.
    """
    n, k = study.n, study.k
    d = k - 1
    mean = scores.mean(axis=1)
    centred = scores - mean[:, None]
    covariance = centred.swapaxes(1, 2) @ centred / (n - 1)
    contrasts = orthonormal_contrasts(k)
    errors = contrasts.T @ covariance @ contrasts
    sphere = sphericity(errors, n - 1)
    f_ratio = n * k * mean.var(axis=1) / np.trace(errors, axis1=1, axis2=2)
    one, epsilon = np.ones(len(mean)), sphere["epsilon_gg"]
    factor = one * (reading.rounded or epsilon)
    df, df_of_p = (d * (factor if corrected else one) for corrected in (reading.df, reading.p))
    i, j = np.triu_indices(k, 1)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    of_difference = variance[:, i] + variance[:, j] - 2.0 * covariance[:, i, j]
    t = np.abs(mean[:, i] - mean[:, j]) / np.sqrt(of_difference / n)
    p = 2.0 * special.stdtr(n - 1, -t)
    values = {
        "anova.F": f_ratio,
        "anova.p": special.fdtrc(df_of_p, df_of_p * (n - 1), f_ratio),
        "anova.eta2": f_ratio / (f_ratio + n - 1),
        "anova.df1": df,
        "anova.df2": df * (n - 1),
        "epsilon": epsilon,
        "mauchly.chi2": sphere["mauchly_chi2"],
        "mauchly.df": sphere["mauchly_df"] * one,
        "mauchly.p": sphere["mauchly_p"],
        "mauchly.violated": sphere["mauchly_p"],
        "t_test.t": t[:, 0],
        "t_test.p": p[:, 0],
        "t_test.df": (n - 1) * one,
    }
    for c, name in enumerate(study.conditions):
        values |= {f"mean.{name}": mean[:, c], f"sd.{name}": np.sqrt(variance[:, c])}
    named = combinations(study.conditions, 2)
    for (a, b), p_value in zip(named, adjusted(p, p_adjust).T, strict=True):
        values[f"pairs.{a}-{b}"] = values[f"pairs.{b}-{a}"] = p_value
    return values


def adjusted(p: np.ndarray, p_adjust: str) -> np.ndarray:
    """Return p-values adjusted for their number along the last axis."""
    if p_adjust == "sidak":
        return -np.expm1(p.shape[-1] * np.log1p(-p))
    if p_adjust == "none":
        return p
    return holm(p) if p_adjust == "holm" else bonferroni(p)
