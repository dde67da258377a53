"""
Data that have all statistics printed for a study.

All printed statistics of a one-way within-subject study are functions of the means and the
covariance matrix. A reconstruction therefore finds these moments first (`moment_search`), with
every statistic within its rounding, and then draws n subjects with exactly these moments inside the
scale of the measure (`sample_with_moments`). The values are continuous: they do not follow the
steps of a questionnaire. They are not measurements, and everything made from them says so.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.display import Result
from trustlab.models.linear_algebra import polar_factor, products, transposed
from trustlab.reproduction.printed_number import printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import (
    ADJUSTMENTS,
    ALPHA,
    Constraint,
    constraints,
    degrees,
    reading_of,
    size_interval,
)
from trustlab.reproduction.reconstruction.feasibility import (
    Verdict,
    decide,
    feasibility,
    generator,
    prepared,
)
from trustlab.reproduction.reconstruction.moment_search import MomentProblem, Moments
from trustlab.studies.anova import repeated_measures_batch
from trustlab.studies.pairs import bonferroni, condition_pairs, holm

NOTE = "Reconstructed data: not measurements, but values that have the printed statistics."
# The mark that every table made from such data carries in its `attrs`.
RECONSTRUCTED = {"reconstructed": True, "note": NOTE}


class ReconstructionError(ValueError):
    """No data with the printed statistics were found; the message says what to try."""


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Result):
    """
    Data that have the statistics printed for a study.

    Parameters
    ----------
    study : PublishedStudy
        The study.
    p_adjust : str
        How its printed pairwise p-values are adjusted in these data.
    seed : int
        Seed.
    values : numpy.ndarray, shape (n, k)
        The data, one row per subject.
    left_out : mapping of str to str
        Printed statistics that these data need not have, with the reason.
    """

    study: PublishedStudy
    p_adjust: str
    seed: int
    values: np.ndarray
    left_out: Mapping[str, str]

    message = NOTE

    @property
    def title(self) -> str:
        """The study."""
        return f"Reconstruction of {self.study.name}"

    @property
    def frame(self) -> pd.DataFrame:
        """
        The data: columns subject (1 … n), condition, value; `attrs` marks them as reconstructed.
        """
        subjects = pd.RangeIndex(1, len(self.values) + 1, name="subject")
        wide = pd.DataFrame(self.values, subjects, list(self.study.conditions))
        long = wide.melt(var_name="condition", value_name="value", ignore_index=False)
        frame = long.sort_index(kind="stable").reset_index()
        about = {"study": self.study.name, "p_adjust": self.p_adjust, "seed": self.seed}
        frame.attrs = {**RECONSTRUCTED, **about, "left_out": dict(self.left_out)}
        return frame

    def table(self) -> pd.DataFrame:
        """
        Return every printed statistic beside the one recomputed from these data.

        Returns
        -------
        pandas.DataFrame
            Index statistic; columns printed, low, high (what agrees with it), reconstructed
            (recomputed from the data), agrees, left_out (the reason; empty where the statistic had
            to hold). Pairwise p-values are adjusted.
        """
        again = reanalyse(self.values, self.study, self.p_adjust)
        rows = []
        for s in [*constraints(self.study, self.p_adjust), *degrees(self.study)]:
            value, reason = again[s.name], self.left_out.get(s.name, "")
            rows.append((s.name, s.text, *printed_ends(s), value, agrees(s, value), reason))
        columns = ["statistic", "printed", "low", "high", "reconstructed", "agrees", "left_out"]
        table = pd.DataFrame(rows, columns=columns).set_index("statistic")
        table.attrs = dict(RECONSTRUCTED)
        return table


def reconstruct(
    study: PublishedStudy, seed: int = 0, p_adjust: str | None = None, without: Iterable[str] = ()
) -> pd.DataFrame:
    """
    Return data that have the statistics printed for a study.

    Parameters
    ----------
    study : PublishedStudy
        The study, for example `published_studies()["uav.tlx"]`.
    seed : int
        Seed; each draws its own means and covariance within the printed rounding, and its own
        subjects.
    p_adjust : {"bonferroni", "holm", "sidak", "none"}, optional
        How the printed pairwise p-values were adjusted; the first of these under which all can
        hold, unless given.
    without : iterable of str
        Statistics that the data need not have, by name ("anova.F", "pairs.C1-C3") or group
        ("mauchly", "pairs").

    Returns
    -------
    pandas.DataFrame
        Columns subject, condition, value; `attrs` marks the data as reconstructed and says what was
        left out and why.

    Raises
    ------
    ValueError
        If an argument is wrong.
    ReconstructionError
        If no data were found.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> frame.groupby("condition")["value"].mean().round(1).to_dict()
    {'C1': 54.3, 'C2': 50.1, 'C3': 44.2, 'C4': 51.9, 'C5': 52.8}
    """
    return reconstruct_study(study, seed, p_adjust, without).frame


def reconstruct_study(
    study: PublishedStudy, seed: int = 0, p_adjust: str | None = None, without: Iterable[str] = ()
) -> Reconstruction:
    """
    Return data that have the statistics printed for a study, together with checks of them.

    Statistics that contradict others by arithmetic are left out. Where the rest cannot hold
    together, the first remedy that `feasibility` finds is left out too. The result lists both in
    `left_out`.

    Parameters
    ----------
    study : PublishedStudy
        The study.
    seed : int
        Seed.
    p_adjust : {"bonferroni", "holm", "sidak", "none"}, optional
        As for `reconstruct`.
    without : iterable of str
        As for `reconstruct`.

    Returns
    -------
    Reconstruction

    Raises
    ------
    ValueError
        If an argument is wrong.
    ReconstructionError
        If no data were found.

    Examples
    --------
    >>> import trustlab as tl
    >>> found = tl.reconstruct_study(tl.published_studies()["uav.tlx"], seed=0)
    >>> bool(found.table()["agrees"].all())
    True
    """
    without = tuple(without) if not isinstance(without, str) else without
    for candidate in ADJUSTMENTS if p_adjust is None else (p_adjust,):
        problem, left_out = prepared(study, candidate, without)
        verdict = decide(problem, generator(seed))
        if verdict.status == "solved":
            break
    else:
        candidate = p_adjust or ADJUSTMENTS[0]
        problem, verdict, left_out = _remedied(study, candidate, tuple(without), seed)
    draws = generator(seed).spawn(1)[0]
    values = _draw(problem, verdict.moments, draws)
    for _ in range(5):  # no values within the scale have these moments: try others
        if values is not None:
            break
        verdict = decide(problem, draws, branches=0, enough=8)
        values = _draw(problem, verdict.moments, draws) if verdict.status == "solved" else None
    if values is None:
        raise ReconstructionError(
            f"{study.name}: no {study.n} values within the scale {study.scale} were found that "
            "have a solution's means and covariances; try another seed, or leave out a standard "
            "deviation"
        )
    result = Reconstruction(study, candidate, int(seed), values, left_out)
    table = result.table()
    wrong = table.index[~table["agrees"] & (table["left_out"] == "")]
    if len(wrong):
        raise ReconstructionError(
            f"{study.name}: the data found do not have {', '.join(wrong)}; try another seed"
        )
    return result


def _draw(problem: MomentProblem, moments: Moments, rng: np.random.Generator) -> np.ndarray | None:
    """Return values that have the first moments for which there are any within the scale."""
    for mean, factor in zip(moments.mean, moments.factor, strict=True):
        values = sample_with_moments(mean, factor, problem.n, problem.scale, rng)
        if values is not None:
            return values
    return None


def _remedied(
    study: PublishedStudy, p_adjust: str, without: tuple[str, ...], seed: int
) -> tuple[MomentProblem, Verdict, dict[str, str]]:
    """Leave out conflicting statistics, one at a time, until the rest can hold together."""
    names = list(without)
    reasons: dict[str, str] = {}
    for _ in range(4):
        result = feasibility(study, p_adjust, names, seed)
        if result.rest_feasible:
            problem, left_out = prepared(study, p_adjust, names)
            return problem, result.verdict, left_out | reasons
        name = next(iter((*reversed(result.remedies), *reversed(result.conflict))), None)
        if name is None:
            break
        against = ", ".join(x for x in result.conflict if x != name)
        reasons[name] = (
            f"cannot hold together with {against}"
            if result.conflict_proved
            else f"no data were found that have it together with {against} (not proved impossible)"
        )
        names.append(name)
    raise ReconstructionError(
        f"{study.name}: the printed numbers cannot hold together under p_adjust={p_adjust!r}, nor "
        f"when {', '.join(reasons)} are left out; feasibility() names the conflict, `without` "
        "leaves statistics out"
    )


def _sidak(p: np.ndarray) -> np.ndarray:
    return -np.expm1(len(p) * np.log1p(-p))


def adjusted(p: np.ndarray, p_adjust: str) -> np.ndarray:
    """Return p-values adjusted for their number."""
    ways = {"bonferroni": bonferroni, "holm": holm, "sidak": _sidak, "none": lambda p: p}
    return ways[p_adjust](p)


def reanalyse(values: np.ndarray, study: PublishedStudy, p_adjust: str) -> dict[str, float]:
    """
    Return the statistics of data, shape (n, k), by the names of a study's constraints.

    They are in the units in which they are printed.

    The study names the conditions; whether degrees of freedom and p are corrected says its reading.
    Mauchly's p has the second-order term.
    """
    names = study.conditions
    omnibus = repeated_measures_batch(values[None]).iloc[0]
    pairs = condition_pairs(values[None])
    reading = reading_of(study)
    factor = omnibus["epsilon_gg"] if reading.df else 1.0
    p = omnibus["p_gg"] if reading.p else omnibus["p"]
    if reading.rounded is not None:
        factor = reading.rounded
        df1 = factor * omnibus["df1"]
        p = special.fdtrc(df1, df1 * (len(values) - 1), omnibus["F"])
    analysed = {f"mean.{c}": x for c, x in zip(names, values.mean(axis=0), strict=True)}
    analysed |= {f"sd.{c}": x for c, x in zip(names, values.std(axis=0, ddof=1), strict=True)}
    analysed |= {"anova.F": omnibus["F"], "anova.p": p, "anova.eta2": omnibus["eta2_partial"]}
    analysed |= {"anova.df1": factor * omnibus["df1"], "anova.df2": factor * omnibus["df2"]}
    analysed |= {"epsilon": omnibus["epsilon_gg"], "mauchly.chi2": omnibus["mauchly_chi2"]}
    analysed |= {"mauchly.df": study.k * (study.k - 1) // 2 - 1}
    analysed |= {"mauchly.p": omnibus["mauchly_p"], "mauchly.violated": omnibus["mauchly_p"]}
    analysed |= {"t_test.t": pairs.t[0, 0], "t_test.p": pairs.p[0, 0], "t_test.df": pairs.df}
    for (a, b), value in zip(combinations(names, 2), adjusted(pairs.p[0], p_adjust), strict=True):
        analysed[f"pairs.{a}-{b}"] = analysed[f"pairs.{b}-{a}"] = value
    return {name: float(value) for name, value in analysed.items()}


def printed_ends(s: Constraint) -> tuple[float, float]:
    """Return the values that agree with a constraint, in the units in which it is printed."""
    if s.text == "not significant":
        return ALPHA, 1.0
    if s.text in ("significant", "sphericity violated, p < 0.05"):
        return 0.0, ALPHA
    low, high = printed_interval(s.text)
    is_p = s.name.startswith("pairs.") or s.name.endswith(".p")
    return (max(low, 0.0), min(high, 1.0)) if is_p else (low, high)


def agrees(s: Constraint, value: float) -> bool:
    """Return whether a value rounds to what is printed, or obeys its inequality; of t the size."""
    low, high = printed_ends(s)
    if s.name == "t_test.t":
        (low, high), value = size_interval(s.text), abs(value)
    if s.text == "not significant":
        return low < value <= high
    if s.text == "significant" or s.text.strip().startswith("<") or s.name == "mauchly.violated":
        return value < high
    return low <= value <= high


def sample_with_moments(
    mean: np.ndarray,
    factor: np.ndarray,
    n: int,
    scale: tuple[float, float],
    rng: np.random.Generator,
    iterations: int = 2000,
) -> np.ndarray | None:
    """
    Draw values, shape (n, k), with given means and covariance GG' within a scale.

    The covariance has n − 1 in its denominator.

    Normal draws are given the moments exactly, X = 1m' + √(n − 1) U G' with UᵀU = I, Uᵀ1 = 0. While
    values lie outside the scale they are moved to its ends, and the nearest values with the exact
    moments are taken: U is the orthogonal polar factor of the centred values times G (orthogonal
    Procrustes problem, Schönemann 1966; alternating projections).

    `factor` is G, of which only the first n − 1 columns may differ from 0; the ends of the scale
    may be infinite. None where `iterations` projections find none.
    """
    factor = np.ascontiguousarray(factor[:, : n - 1])
    low, high = scale
    inset = 1e-4 * (high - low) if np.isfinite(high - low) else 1e-3 * float(np.abs(factor).max())
    draws = rng.standard_normal((1, n, factor.shape[1]))
    values = mean + products(draws, transposed(factor)[None])[0]
    for _ in range(iterations):
        values = _with_moments(values, mean, factor)
        if values.min() >= low and values.max() <= high:
            return values
        values = np.clip(values, low + inset, high - inset)
    return None


def _with_moments(values: np.ndarray, mean: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the nearest values with exactly these moments."""
    n = len(values)
    (projected,) = products((values - values.mean(axis=0))[None], factor[None])
    whitened = polar_factor(projected)
    whitened = whitened - whitened.mean(axis=0)
    return mean + np.sqrt(n - 1.0) * products(whitened[None], transposed(factor)[None])[0]
