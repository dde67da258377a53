"""
Data that have all statistics printed for a study.

All printed statistics of a one-way within-subject study are functions of the means and the
covariance matrix. A reconstruction therefore finds these moments first, with every statistic within
its rounding, and then draws n subjects with exactly these moments inside the scale of the measure.
The values are continuous: they do not follow the steps of a questionnaire. They are not
measurements, and everything made from them says so.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.display import Result
from trustlab.reproduction.printed_number import printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import (
    ADJUSTMENTS,
    ALPHA,
    Constraint,
    constraints,
    size_interval,
)
from trustlab.reproduction.reconstruction.contradictions import reading_of
from trustlab.reproduction.reconstruction.feasibility import (
    Feasibility,
    feasibility,
    moment_problem,
)
from trustlab.reproduction.reconstruction.moments import sample_with_moments
from trustlab.studies.anova import repeated_measures_batch
from trustlab.studies.pairs import bonferroni, condition_pairs, holm

NOTE = "Reconstructed data: not measurements, but values that have the printed statistics."
# The mark that every table made from such data carries in its `attrs`.
RECONSTRUCTED = {"reconstructed": True, "note": NOTE}

MOST_LEFT_OUT = 4  # statistics without which data are sought
MOST_DRAWS = 6  # solutions for which values within the scale are sought


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
        for s in constraints(self.study, self.p_adjust, reading_of(self.study)):
            value, (low, high) = again[s.name], agreeing(s)
            reason = self.left_out.get(s.name, "")
            rows.append((s.name, s.text, low, high, value, low <= value <= high, reason))
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
    answer = _most_feasible(study, p_adjust, without, seed)
    missed: dict[str, str] = {}
    while answer.status != "solved" and answer.conflict and len(missed) < MOST_LEFT_OUT:
        name = (answer.remedies or answer.conflict)[0]
        against = ", ".join(x for x in answer.conflict if x != name) or "the rest"
        missed[name] = f"no data were found that have it together with {against}"
        answer = feasibility(study, answer.p_adjust, (*without, *missed), seed)
    left_out = {**answer.left_out, **missed}
    if answer.status != "solved":
        raise ReconstructionError(
            f"{study.name}: no data were found under p_adjust={answer.p_adjust!r}, nor when "
            f"{', '.join(left_out)} are left out; feasibility() says what the closest data miss, "
            "`without` leaves statistics out"
        )
    values = _draw(answer, (*without, *missed), np.random.default_rng(int(seed)).spawn(1)[0])
    result = Reconstruction(study, answer.p_adjust, int(seed), values, left_out)
    table = result.table()
    wrong = table.index[~table["agrees"] & (table["left_out"] == "")]
    if len(wrong):
        raise ReconstructionError(
            f"{study.name}: the data found do not have {', '.join(wrong)}; try another seed"
        )
    return result


def _most_feasible(
    study: PublishedStudy, p_adjust: str | None, without: Iterable[str], seed: int
) -> Feasibility:
    """Return the answer of the first adjustment under which data are found, else of the first."""
    candidates = ADJUSTMENTS if p_adjust is None else (p_adjust,)
    for candidate in sorted(candidates, key=lambda c: len(moment_problem(study, c, without)[1])):
        answer = feasibility(study, candidate, without, seed, explain=False)
        if answer.status == "solved":
            return answer
    return feasibility(study, candidates[0], without, seed)


def _draw(answer: Feasibility, without: Iterable[str], rng: np.random.Generator) -> np.ndarray:
    """Return values within the scale that have the moments found, or others that hold as well."""
    study = answer.study
    problem, _ = moment_problem(study, answer.p_adjust, without)
    moments = answer.moments
    for _ in range(MOST_DRAWS):
        mean, factor = moments.mean, moments.factor
        values = sample_with_moments(mean, factor, study.n, study.scale, rng)
        if values is not None:
            return values
        moments = problem.solve(rng)
        if moments.violation:
            break
    raise ReconstructionError(
        f"{study.name}: no {study.n} values within the scale {study.scale} were found that have a "
        "solution's means and covariances; try another seed, or leave out a standard deviation"
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
    omnibus = repeated_measures_batch(values[None]).iloc[0]
    pairs = condition_pairs(values[None])
    reading, factor = reading_of(study), 1.0
    p = omnibus["p_gg"] if reading.p else omnibus["p"]
    if reading.rounded is not None:
        factor = reading.rounded
        df1 = factor * omnibus["df1"]
        p = special.fdtrc(df1, df1 * (len(values) - 1), omnibus["F"])
    elif reading.df:
        factor = omnibus["epsilon_gg"]
    analysed = {
        "anova.F": omnibus["F"],
        "anova.p": p,
        "anova.eta2": omnibus["eta2_partial"],
        "anova.df1": factor * omnibus["df1"],
        "anova.df2": factor * omnibus["df2"],
        "epsilon": omnibus["epsilon_gg"],
        "mauchly.chi2": omnibus["mauchly_chi2"],
        "mauchly.df": study.k * (study.k - 1) // 2 - 1,
        "mauchly.p": omnibus["mauchly_p"],
        "mauchly.violated": omnibus["mauchly_p"],
        # Which condition is first is not printed.
        "t_test.t": abs(pairs.t[0, 0]),
        "t_test.p": pairs.p[0, 0],
        "t_test.df": pairs.df,
    }
    for c, mean, sd in zip(study.conditions, values.mean(0), values.std(0, ddof=1), strict=True):
        analysed |= {f"mean.{c}": mean, f"sd.{c}": sd}
    named = combinations(study.conditions, 2)
    for (a, b), p_value in zip(named, adjusted(pairs.p[0], p_adjust), strict=True):
        analysed[f"pairs.{a}-{b}"] = analysed[f"pairs.{b}-{a}"] = p_value
    return {name: float(value) for name, value in analysed.items()}


def agreeing(s: Constraint) -> tuple[float, float]:
    """Return the values that agree with a constraint, in the units in which it is printed."""
    if s.text == "not significant":
        return ALPHA, 1.0
    if s.text == "significant" or s.name == "mauchly.violated":
        return 0.0, ALPHA
    low, high = size_interval(s.text) if s.name == "t_test.t" else printed_interval(s.text)
    is_p = s.name.startswith("pairs.") or s.name.endswith(".p")
    return (max(low, 0.0), min(high, 1.0)) if is_p else (low, high)
