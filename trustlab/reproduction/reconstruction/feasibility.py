"""Whether a study's printed numbers can belong to one data set, and what conflicts if not."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, one_of, whole_number
from trustlab.models.display import Result
from trustlab.reproduction.printed import printed_interval
from trustlab.reproduction.published_study import PublishedStudy, published_studies
from trustlab.reproduction.reconstruction.constraints import (
    ADJUSTMENTS,
    ONLY_P,
    Reading,
    constraints,
    p_of_f,
)
from trustlab.reproduction.reconstruction.contradictions import contradictions, reading_of
from trustlab.reproduction.reconstruction.moments import MomentProblem, Moments

# Starts from which data without one of the printed numbers are sought.
FEW_STARTS = 8


@dataclass(frozen=True, eq=False, repr=False)
class Feasibility(Result):
    """
    Whether printed numbers can belong to one data set.

    Parameters
    ----------
    study : PublishedStudy
        The study.
    p_adjust : str
        How the printed pairwise p-values were taken to be adjusted.
    left_out : mapping of str to str
        Statistics left out beforehand as others contradict them by arithmetic, with the reason.
    conflict : tuple of str
        Where no data were found: the statistics that the closest ones do not have.
    remedies : tuple of str
        Statistics any one of which can be left out so that data with all others are found.
    moments : Moments
        Means and covariance that were found, or the closest ones.
    read_as : Reading
        What was corrected by ε.
    """

    study: PublishedStudy
    p_adjust: str
    left_out: Mapping[str, str]
    conflict: tuple[str, ...]
    remedies: tuple[str, ...]
    moments: Moments
    read_as: Reading

    def __bool__(self) -> bool:
        return self.feasible is True

    @property
    def feasible(self) -> bool | None:
        """
        True if data with everything that is printed were found; False if arithmetic contradicts
        it; None if none were found, which decides nothing.
        """
        return False if self.left_out else self.rest_feasible

    @property
    def rest_feasible(self) -> bool | None:
        """True if data with all that is not left out were found, None if none were."""
        return None if self.moments.violation else True

    @property
    def reading(self) -> str:
        """How p and the degrees of freedom of F were read: what was corrected by ε."""
        return self.read_as.words

    @property
    def epsilon(self) -> tuple[float, float] | None:
        """Least and greatest ε, of 2,001, with which a corrected p fits F; None where none does."""
        study = self.study
        if study.k == 2 or not {"F", "p"} <= study.anova.keys():
            return None
        least, most = printed_interval(study.anova["p"])
        epsilon = np.linspace(1.0 / (study.k - 1), 1.0, 2001)
        p = p_of_f(study, self._f_ratio, epsilon)
        fits = epsilon[(p.min(axis=1) <= most) & (p.max(axis=1) >= least)]
        return (float(fits[0]), float(fits[-1])) if fits.size else None

    @property
    def _f_ratio(self) -> np.ndarray:
        """The ends of the printed F."""
        return np.maximum(printed_interval(self.study.anova["F"]), 0.0)

    @property
    def message(self) -> str:
        """The answer in words: what contradicts what, and the reading with its ε."""
        parts = [f"Left out: {reason}." for reason in self.left_out.values()]
        subject = "the rest" if self.left_out else "all that is printed"
        if self.rest_feasible:
            parts.append(f"{subject.capitalize()} can hold together.")
        else:
            parts.append(
                f"No data with {subject} were found from {self.moments.starts} starts; the closest "
                f"miss {', '.join(self.conflict) or 'the scale'}."
            )
        if self.remedies:
            parts.append(f"Found without any one of {', '.join(self.remedies)}.")
        if {"F", "p"} <= self.study.anova.keys() and self.study.k > 2:
            parts.append(f"Read as {self.reading}.")
            doubtful = self.read_as == ONLY_P or "anova.p" in self.left_out
            if self.epsilon and doubtful:
                low, high = self.epsilon
                plain = p_of_f(self.study, self._f_ratio, 1.0).mean()
                uncorrected = f"{plain:.3f}".removeprefix("0")
                parts.append(
                    f"A corrected p fits F with ε from {low:.3f} to {high:.3f}; uncorrected, p "
                    f"would be {uncorrected}."
                )
        return " ".join(parts)

    @property
    def title(self) -> str:
        """The study."""
        return f"Feasibility of {self.study.name}"

    def table(self) -> pd.DataFrame:
        """
        Return what is printed, what agrees with it, and its part in a conflict.

        Index statistic; columns printed, low, high, in_conflict, remedy, left_out (the reason, or
        empty).
        """
        rows = [
            (*s, s.name in self.conflict, s.name in self.remedies, self.left_out.get(s.name, ""))
            for s in constraints(self.study)
        ]
        columns = ["statistic", "printed", "low", "high", "in_conflict", "remedy", "left_out"]
        return pd.DataFrame(rows, columns=columns).set_index("statistic")


def feasibility(
    study: PublishedStudy, p_adjust: str = "bonferroni", seed: int = 0, explain: bool = True
) -> Feasibility:
    """
    Determine whether printed numbers can belong to one data set, and if not, what conflicts.

    Feasibility is shown by means and a covariance matrix that have all statistics within rounding;
    infeasibility by arithmetic (`left_out`). Where neither is found the answer is None: no
    accusation.

    Parameters
    ----------
    study : PublishedStudy
        The study.
    p_adjust : {"bonferroni", "holm", "sidak", "none"}
        How the printed pairwise p-values were adjusted for the number of comparisons.
    seed : int
        Seed of the search.
    explain : bool
        Whether to look for remedies where no data are found.

    Returns
    -------
    Feasibility

    Raises
    ------
    ValueError
        If an argument is wrong.

    Examples
    --------
    >>> import trustlab as tl
    >>> answer = tl.feasibility(tl.published_studies()["uav.tlx"], explain=False)
    >>> answer.feasible, answer.left_out
    (True, {})
    """
    check_study(study)
    one_of("p_adjust", p_adjust, ADJUSTMENTS)
    return search(study, p_adjust, whole_number("seed", seed, least=0), explain, {})


def check_study(study: object) -> None:
    """Refuse what is no printed study; a name is answered with where the study is."""
    hint = ""
    if isinstance(study, str):
        near = get_close_matches(study, published_studies(), n=1) or ["uav.tlx"]
        hint = f"a printed one is published_studies()[{near[0]!r}]"
    of_class("study", study, PublishedStudy, hint)


def search(
    study: PublishedStudy, p_adjust: str, seed: int, explain: bool, aside: Mapping[str, str]
) -> Feasibility:
    """Return the answer about all statistics but some that are put aside with a reason."""
    rng = np.random.default_rng(seed)
    reading = reading_of(study)
    left_out = contradictions(study, p_adjust) | dict(aside)
    rows = [s for s in constraints(study) if s.name not in left_out]
    moments = MomentProblem(study, reading, p_adjust, rows).solve(rng)
    # What presses on the closest data, most first.
    pressing = sorted(moments.outside, key=lambda name: -moments.outside[name])
    conflict = tuple(s.name for s in rows if moments.outside[s.name] > 0.0)

    def found_without(name: str) -> bool:
        rest = [s for s in rows if s.name != name]
        return MomentProblem(study, reading, p_adjust, rest).solve(rng, FEW_STARTS).violation == 0.0

    remedies = tuple(
        name for name in pressing if explain and name in conflict and found_without(name)
    )
    return Feasibility(study, p_adjust, left_out, conflict, remedies, moments, reading)


def compare_adjustments(studies: Mapping[str, PublishedStudy], seed: int = 0) -> pd.DataFrame:
    """
    Determine under which adjustments of p-values the numbers of each study can hold together.

    Parameters
    ----------
    studies : mapping of str to PublishedStudy
        Studies by name, such as `published_studies()`.
    seed : int
        Seed of the search.

    Returns
    -------
    pandas.DataFrame
        Index study, p_adjust; columns feasible (True, False or None, as of `Feasibility`),
        rest_feasible (of what is not left out), status (solved, not found), violation (of the
        closest data, in half-widths of printed intervals), left_out.
    """
    rows = []
    for name, study in studies.items():
        for p_adjust in ADJUSTMENTS:
            result = feasibility(study, p_adjust, seed=seed, explain=False)
            status = "solved" if result.rest_feasible else "not found"
            possible = result.feasible, result.rest_feasible, status, result.moments.violation
            rows.append((name, p_adjust, *possible, ", ".join(result.left_out)))
    columns = ["study", "p_adjust", "feasible", "rest_feasible", "status", "violation", "left_out"]
    return pd.DataFrame(rows, columns=columns).set_index(["study", "p_adjust"])
