"""Printed numbers of one study that contradict each other by arithmetic alone, whatever the data."""

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from trustlab.reproduction.printed_number import printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import Constraint, constraints, size_interval

# Printed numbers that fix one statistic: kind to its name and theirs; those first believed come first.
COMPARED = {
    "epsilon": ("epsilon", ("epsilon", "anova.df2", "anova.df1")),
    "f_ratio": ("F", ("anova.F", "anova.eta2")),
    "chi2": ("chi-square", ("mauchly.chi2", "mauchly.p")),
}


def _largest_agreement(group: Sequence[Constraint]) -> list[Constraint]:
    """Return the most constraints whose intervals have a point in common; the first named win a tie."""
    # If intervals have a common point, the lower end of one of them is one.
    ends = [s.low if math.isfinite(s.low) else s.high for s in group]
    return max(([s for s in group if s.low <= end <= s.high] for end in ends), key=len)


def arithmetic_conflicts(study: PublishedStudy) -> dict[str, str]:
    """
    Return the printed numbers that contradict others, by name with the reason.

    Partial eta² against F, degrees of freedom against ε and n, p against F and its degrees of freedom, Mauchly's p against
    its chi-square. Of numbers that disagree, the fewest are named; of two, the one that is computed from the other.
    """
    found = {s.name: s for s in constraints(study)}
    conflicts, ranges = {}, {}
    for kind, (label, names) in COMPARED.items():
        group = [found[name] for name in names if name in found]
        if not group:
            continue
        agreeing = _largest_agreement(group)
        low, high = max(s.low for s in agreeing), min(s.high for s in agreeing)
        ranges[kind] = low, high
        believed = " and ".join(f"{s.name} = {s.text}" for s in agreeing)
        for s in group:
            if s not in agreeing:
                conflicts[s.name] = (
                    f"{s.name} = {s.text} needs {label} from {s.low:.6g} to {s.high:.6g}, but {believed}"
                    f" needs {low:.6g} to {high:.6g}"
                )
    if "p" in study.anova and "f_ratio" in ranges:
        p = _p_of_f(study, ranges["f_ratio"], ranges.get("epsilon"))
        conflicts |= _contradicted("anova.p", study.anova["p"], p, "F and its degrees of freedom give")
    if {"t", "p"} <= set(study.t_test):
        p = 2.0 * special.stdtr(study.n - 1, -np.array(size_interval(study.t_test["t"])))
        conflicts |= _contradicted("t_test.p", study.t_test["p"], p, "t gives")
    return conflicts | _wrong_degrees(study)


def _p_of_f(study: PublishedStudy, f_ratio: tuple[float, float], epsilon: tuple | None) -> np.ndarray:
    """Return p at the ends of the intervals of F and, where degrees of freedom are corrected, of epsilon."""
    d, least = study.k - 1, 1.0 / (study.k - 1)
    factor = np.clip(epsilon or (least, 1.0), least, 1.0) if study.corrected else np.ones(2)
    df = d * factor[:, None]
    return special.fdtrc(df, df * (study.n - 1), np.maximum(f_ratio, 0.0))


def _contradicted(name: str, text: str, p: np.ndarray, source: str) -> dict[str, str]:
    """Return the conflict of a printed p with those computed at the ends of other intervals, if there is one."""
    low, high = printed_interval(text)
    if p.min() <= high and p.max() >= low:
        return {}
    return {name: f"{name} = {text}, but {source} {p.min():.4g} to {p.max():.4g}"}


def _wrong_degrees(study: PublishedStudy) -> dict[str, str]:
    """Return degrees of freedom that follow from n and k and are printed otherwise."""
    n, k, conflicts = study.n, study.k, {}
    df2, df = study.anova.get("df2"), study.t_test.get("df")
    if df2 and not study.corrected and float(df2) != (k - 1) * (n - 1):
        conflicts["anova.df2"] = f"anova.df2 = {df2}, but (k − 1)(n − 1) = {(k - 1) * (n - 1)}"
    if df and float(df) != n - 1:
        conflicts["t_test.df"] = f"t_test.df = {df}, but n − 1 = {n - 1}"
    return conflicts
