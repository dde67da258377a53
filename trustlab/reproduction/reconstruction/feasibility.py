"""Whether a study's printed numbers can belong to one data set, and what conflicts if not."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, one_of, whole_number
from trustlab.models.display import Result
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import ADJUSTMENTS, constraints
from trustlab.reproduction.reconstruction.contradictions import contradictions, reading_of
from trustlab.reproduction.reconstruction.moments import MomentProblem, Moments


@dataclass(frozen=True, eq=False, repr=False)
class Feasibility(Result):
    """
    Whether printed numbers can belong to one data set.

    Parameters
    ----------
    problem : MomentProblem
        The study, what was corrected by ε, how pairwise p-values were adjusted, and what must hold.
    left_out : mapping of str to str
        Statistics left out beforehand as others contradict them by arithmetic, with the reason.
    moments : Moments
        Means and covariance that were found, or the closest ones.
    """

    problem: MomentProblem
    left_out: Mapping[str, str]
    moments: Moments

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
    def conflict(self) -> tuple[str, ...]:
        """Where no data were found: the statistics that the closest ones do not have."""
        return tuple(name for name, beyond in self.moments.outside.items() if beyond > 0.0)

    @property
    def reading(self) -> str:
        """How p and the degrees of freedom of F were read: what was corrected by ε."""
        return self.problem.reading.words

    @property
    def message(self) -> str:
        """The answer in words: what contradicts what, and the reading."""
        parts = [f"Left out: {reason}." for reason in self.left_out.values()]
        subject = "the rest" if self.left_out else "all that is printed"
        if self.rest_feasible:
            parts.append(f"{subject.capitalize()} can hold together.")
        else:
            parts.append(
                f"No data with {subject} were found from {self.moments.starts} starts; the closest "
                f"miss {', '.join(self.conflict) or 'the scale'}."
            )
        study = self.problem.study
        if {"F", "p"} <= study.anova.keys() and study.k > 2:
            parts.append(f"Read as {self.reading}.")
        return " ".join(parts)

    @property
    def title(self) -> str:
        """The study."""
        return f"Feasibility of {self.problem.study.name}"

    def table(self) -> pd.DataFrame:
        """
        Return what is printed, what agrees with it, and its part in a conflict.

        Index statistic; columns printed, low, high, in_conflict, left_out (the reason, or empty).
        """
        rows = [
            (*s, s.name in self.conflict, self.left_out.get(s.name, ""))
            for s in constraints(self.problem.study)
        ]
        columns = ["statistic", "printed", "low", "high", "in_conflict", "left_out"]
        return pd.DataFrame(rows, columns=columns).set_index("statistic")


def feasibility(study: PublishedStudy, p_adjust: str = "bonferroni", seed: int = 0) -> Feasibility:
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
    >>> answer = tl.feasibility(tl.published_studies()["uav.tlx"])
    >>> answer.feasible, answer.left_out
    (True, {})
    """
    of_class("study", study, PublishedStudy)
    one_of("p_adjust", p_adjust, ADJUSTMENTS)
    rng = np.random.default_rng(whole_number("seed", seed, least=0))
    left_out = contradictions(study, p_adjust)
    rows = [s for s in constraints(study) if s.name not in left_out]
    problem = MomentProblem(study, reading_of(study), p_adjust, rows)
    return Feasibility(problem, left_out, problem.solve(rng))
