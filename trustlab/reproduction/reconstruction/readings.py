"""
How a paper may have computed the degrees of freedom and the p that it prints beside an F.

Degrees of freedom, p, both or neither may be corrected by the ε of Greenhouse and Geisser, and the
ε may have been rounded before.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from scipy import special

from trustlab.reproduction.printed_number import printed_decimal, printed_interval
from trustlab.reproduction.published_study import PublishedStudy


@dataclass(frozen=True)
class Reading:
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
    rest = [NEITHER, ONLY_P] if _too_many_degrees(study) else [ONLY_P, ONLY_DF, BOTH, NEITHER]
    yield from (reading for reading in rest if reading != usual)
    if not study.epsilon:
        return
    epsilon = printed_decimal(study.epsilon)
    for unit in (Decimal("0.01"), Decimal("0.1")):
        rounded = epsilon.quantize(unit)
        if rounded != epsilon and rounded * (study.k - 1) >= 1:
            words = f"p and degrees of freedom corrected by ε rounded to {rounded}"
            yield Reading(words, True, True, float(rounded))


def _too_many_degrees(study: PublishedStudy) -> bool:
    """Return whether degrees of freedom exceed the uncorrected ones, which no ε makes them."""
    limits = {"df1": study.k - 1, "df2": (study.k - 1) * (study.n - 1)}
    printed = {
        name: printed_interval(study.anova[name])[0] for name in limits.keys() & study.anova.keys()
    }
    return any(low > limits[name] for name, low in printed.items())


def uncorrected_p(study: PublishedStudy) -> float:
    """Return the p of the printed F without any correction."""
    f_ratio = float(np.maximum(printed_interval(study.anova["F"]), 0.0).mean())
    return float(special.fdtrc(study.k - 1, (study.k - 1) * (study.n - 1), f_ratio))


def fitting_epsilon(study: PublishedStudy) -> tuple[float, float] | None:
    """
    Return the least and greatest ε with which p, corrected, fits F; None where none does.

    Both ends are those of a grid of 2,000 steps.
    """
    if study.k == 2 or not {"F", "p"} <= set(study.anova):
        return None
    least, most = printed_interval(study.anova["p"])
    f_ratio = np.maximum(printed_interval(study.anova["F"]), 0.0)
    epsilon = np.linspace(1.0 / (study.k - 1), 1.0, 2001)
    df = (study.k - 1) * epsilon[:, None]
    p = special.fdtrc(df, df * (study.n - 1), f_ratio)
    fits = epsilon[(p.min(axis=1) <= most) & (p.max(axis=1) >= least)]
    return (float(fits[0]), float(fits[-1])) if fits.size else None
