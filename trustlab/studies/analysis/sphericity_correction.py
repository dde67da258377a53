"""Which correction for sphericity applies to an analysis, and why."""

from __future__ import annotations

import numpy as np

from trustlab.studies.analysis.batch import RepeatedMeasuresBatch

__all__ = ["CORRECTIONS", "decide_correction", "why_no_mauchly"]

CORRECTIONS = ("none", "greenhouse-geisser", "huynh-feldt")


def why_no_mauchly(batch: RepeatedMeasuresBatch) -> str:
    """
    Return why Mauchly's test is not defined; an empty text where it is.

    Parameters
    ----------
    batch : RepeatedMeasuresBatch
        One study; the first counts.
    """
    if batch.k == 2:
        return "With two conditions sphericity holds by itself; there is nothing for Mauchly's test to test."
    if batch.n <= batch.k - 1:
        return (
            f"Mauchly's test is not defined: {batch.n} subjects are too few for {batch.k} conditions "
            f"(at least {batch.k} are needed)."
        )
    if np.isnan(batch.mauchly_w[0]):
        return "Mauchly's test is not defined: the contrasts' covariance is singular (a condition is a combination of others)."
    return ""


def decide_correction(
    correction: str, alpha: float, batch: RepeatedMeasuresBatch, why_not: str
) -> tuple[str, str]:
    """
    Return the correction that applies and the reason in a sentence or two.

    Parameters
    ----------
    correction : {"auto", "none", "greenhouse-geisser", "huynh-feldt"}
        What was asked for. "auto": Greenhouse–Geisser where Mauchly's test rejects or is not defined, else none.
    alpha : float
        Level of Mauchly's test.
    batch : RepeatedMeasuresBatch
        One study; the first counts.
    why_not : str
        Why Mauchly's test is not defined; empty where it is.
    """
    if correction != "auto":
        return correction, f"Correction “{correction}” was asked for." + (f" {why_not}" if why_not else "")
    if batch.k == 2:
        return "none", why_not
    if why_not:
        return "greenhouse-geisser", f"{why_not} Sphericity cannot be tested and is not assumed."
    p = batch.mauchly_p[0]
    if p < alpha:
        reason = f"Mauchly's test rejects sphericity (p = {p:.3g} < {alpha:g})."
        if batch.epsilon_gg[0] > 0.75:
            reason += " Greenhouse–Geisser ε is above 0.75, where Huynh–Feldt's is less conservative."
        return "greenhouse-geisser", reason
    return "none", f"Mauchly's test does not reject sphericity (p = {p:.3g} ≥ {alpha:g})."
