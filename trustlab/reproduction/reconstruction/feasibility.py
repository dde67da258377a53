"""
Whether a study's printed numbers can belong to one data set, what conflicts if not, and such data.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, one_of, whole_seed
from trustlab.models.display import Result
from trustlab.reproduction.published import PublishedStudy
from trustlab.reproduction.reconstruction.contradictions import (
    ADJUSTMENTS,
    constraints,
    contradictions,
    reading_of,
)
from trustlab.reproduction.reconstruction.search import STARTS, Search


@dataclass(frozen=True, eq=False, repr=False)
class Feasibility(Result):
    """
    Whether printed numbers can belong to one data set.

    Parameters
    ----------
    study : PublishedStudy
        The study.
    reading : str
        How p and the degrees of freedom of F were read: what was corrected by ε.
    p_adjust : str
        How pairwise p-values were adjusted.
    left_out : mapping of str to str
        Statistics left out beforehand as others contradict them by arithmetic, with the reason.
    scores : numpy.ndarray, shape (n, k)
        Data that were found, or the closest ones.
    conflict : tuple of str
        Where no data were found: the statistics that the closest ones do not have.
    """

    study: PublishedStudy
    reading: str
    p_adjust: str
    left_out: Mapping[str, str]
    scores: np.ndarray
    conflict: tuple[str, ...]

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
        return None if self.conflict else True

    @property
    def message(self) -> str:
        """The answer in words: what contradicts what, and the reading."""
        parts = [f"Left out: {reason}." for reason in self.left_out.values()]
        subject = "the rest" if self.left_out else "all that is printed"
        if self.rest_feasible:
            parts.append(f"{subject.capitalize()} can hold together.")
        else:
            parts.append(
                f"No data with {subject} were found from {STARTS} starts; the closest "
                f"miss {', '.join(self.conflict)}."
            )
        if self.study.anova and self.study.k > 2:
            parts.append(f"Read as {self.reading}.")
        return " ".join(parts)

    @property
    def title(self) -> str:
        """The study."""
        return f"Feasibility of {self.study.name}"

    def table(self) -> pd.DataFrame:
        """
        Return what is printed, what agrees with it, and its part in a conflict.

        Index statistic; columns printed, low, high, in_conflict, left_out (the reason, or empty).
        """
        rows = [
            (*s, s.name in self.conflict, self.left_out.get(s.name, ""))
            for s in constraints(self.study)
        ]
        columns = ["statistic", "printed", "low", "high", "in_conflict", "left_out"]
        return pd.DataFrame(rows, columns=columns).set_index("statistic")


def feasibility(study: PublishedStudy, p_adjust: str = "bonferroni", seed: int = 0) -> Feasibility:
    """
    Determine whether printed numbers can belong to one data set, and if not, what conflicts.

    Feasibility is shown by data that have all statistics within rounding; infeasibility by
    arithmetic (`left_out`). Where neither is found the answer is None: no accusation.

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
    rng = np.random.default_rng(whole_seed(seed))
    left_out = contradictions(study, p_adjust)
    rows = [s for s in constraints(study) if s.name not in left_out]
    reading = reading_of(study)
    scores, missed = Search(study, reading, p_adjust, rows).solve(rng)
    return Feasibility(study, reading.words, p_adjust, left_out, scores, missed)


class ReconstructionError(ValueError):
    """No data with the printed statistics were found; the message says what to try."""


# The mark that data carry in their `attrs`.
RECONSTRUCTED = {
    "reconstructed": True,
    "note": "Reconstructed data: not measurements, but values that have the printed statistics.",
}


def reconstruct(study: PublishedStudy, seed: int = 0, p_adjust: str | None = None) -> pd.DataFrame:
    """
    Return data that have the statistics printed for a study.

    Statistics that contradict others by arithmetic are left out. The values are continuous: they do
    not follow the steps of a questionnaire. They are not measurements, and say so.

    Parameters
    ----------
    study : PublishedStudy
        The study, for example `published_studies()["uav.tlx"]`.
    seed : int
        Seed; each draws its own subjects.
    p_adjust : {"bonferroni", "holm", "sidak", "none"}, optional
        How the printed pairwise p-values were adjusted; the first of these under which all can
        hold, unless given.

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
    of_class("study", study, PublishedStudy)
    candidates = [p_adjust]
    if p_adjust is None:  # first what the fewest numbers contradict; without pairs all are the same
        among = ADJUSTMENTS if study.pairs or study.significant_without_p else ADJUSTMENTS[:1]
        candidates = sorted(among, key=lambda each: len(contradictions(study, each)))
    for candidate in candidates:
        answer = feasibility(study, candidate, seed)
        if answer.rest_feasible:
            break
    else:
        raise ReconstructionError(f"{study.name}, p_adjust={candidate!r}: {answer.message}")
    subjects = pd.RangeIndex(1, study.n + 1, name="subject")
    conditions = pd.Index(study.conditions, name="condition")
    wide = pd.DataFrame(answer.scores, subjects, conditions)
    frame = wide.stack().reset_index(name="value")  # noqa: PD013 (melting would lose the order)
    about = {"study": study.name, "p_adjust": candidate, "seed": int(seed)}
    frame.attrs = {**RECONSTRUCTED, **about, "left_out": answer.left_out}
    return frame
