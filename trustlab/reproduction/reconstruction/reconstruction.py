"""
Data that have all statistics printed for a study.

A reconstruction first finds means and a covariance matrix with every statistic within its rounding,
and then draws n subjects with exactly these moments inside the scale of the measure. The values are
continuous: they do not follow the steps of a questionnaire. They are not measurements, and
everything made from them says so.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.display import Result
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import ADJUSTMENTS, constraints, statistics
from trustlab.reproduction.reconstruction.contradictions import contradictions
from trustlab.reproduction.reconstruction.feasibility import (
    Feasibility,
    check_study,
    feasibility,
    search,
)
from trustlab.reproduction.reconstruction.moments import MomentProblem, sample_with_moments

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
    answer : Feasibility
        The study, its reading and what the data need not have.
    seed : int
        Seed.
    values : numpy.ndarray, shape (n, k)
        The data, one row per subject.
    """

    answer: Feasibility
    seed: int
    values: np.ndarray

    message = NOTE

    @property
    def title(self) -> str:
        """The study."""
        return f"Reconstruction of {self.answer.study.name}"

    @property
    def left_out(self) -> dict[str, str]:
        """Printed statistics that these data need not have, with the reason."""
        return dict(self.answer.left_out)

    @property
    def frame(self) -> pd.DataFrame:
        """
        The data: columns subject (1 … n), condition, value; `attrs` marks them as reconstructed.
        """
        study = self.answer.study
        subjects = pd.RangeIndex(1, len(self.values) + 1, name="subject")
        wide = pd.DataFrame(self.values, subjects, list(study.conditions))
        long = wide.melt(var_name="condition", value_name="value", ignore_index=False)
        frame = long.sort_index(kind="stable").reset_index()
        about = {"study": study.name, "p_adjust": self.answer.p_adjust, "seed": self.seed}
        frame.attrs = {**RECONSTRUCTED, **about, "left_out": self.left_out}
        return frame

    def table(self) -> pd.DataFrame:
        """
        Return every printed statistic beside the one recomputed from these data.

        Returns
        -------
        pandas.DataFrame
            Index statistic; columns printed, low, high (what agrees with it), reconstructed
            (recomputed from the data), agrees, left_out (the reason; empty where the statistic had
            to hold). Pairwise p-values are adjusted; of t the size is compared.
        """
        answer, values = self.answer, self.values
        moments = values.mean(axis=0)[None], np.cov(values.T)[None]
        with np.errstate(all="ignore"):
            again = statistics(answer.study, answer.read_as, answer.p_adjust, *moments)
        table = answer.table()
        table["reconstructed"] = [float(again[name][0]) for name in table.index]
        table["agrees"] = table["reconstructed"].between(table["low"], table["high"])
        table = table[["printed", "low", "high", "reconstructed", "agrees", "left_out"]]
        table.attrs = dict(RECONSTRUCTED)
        return table


def reconstruct(study: PublishedStudy, seed: int = 0, p_adjust: str | None = None) -> pd.DataFrame:
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
    return reconstruct_study(study, seed, p_adjust).frame


def reconstruct_study(
    study: PublishedStudy, seed: int = 0, p_adjust: str | None = None
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
    answer = _most_feasible(study, p_adjust, seed)
    missed: dict[str, str] = {}
    while not answer.rest_feasible and answer.conflict and len(missed) < MOST_LEFT_OUT:
        name = (answer.remedies or answer.conflict)[0]
        against = ", ".join(x for x in answer.conflict if x != name) or "the rest"
        missed[name] = f"no data were found that have it together with {against}"
        answer = search(study, answer.p_adjust, seed, True, missed)
    if not answer.rest_feasible:
        raise ReconstructionError(
            f"{study.name}: no data were found under p_adjust={answer.p_adjust!r}, nor when "
            f"{', '.join(answer.left_out)} are left out; feasibility() says what the closest data "
            "miss"
        )
    values = _draw(answer, np.random.default_rng(int(seed)).spawn(1)[0])
    return Reconstruction(answer, int(seed), values)


def _most_feasible(study: PublishedStudy, p_adjust: str | None, seed: int) -> Feasibility:
    """Return the answer of the first adjustment under which data are found, else of the first."""
    check_study(study)
    candidates = [p_adjust]
    if p_adjust is None:
        candidates = sorted(ADJUSTMENTS, key=lambda each: len(contradictions(study, each)))
    for candidate in candidates:
        answer = feasibility(study, candidate, seed, explain=False)
        if answer.rest_feasible:
            return answer
    return feasibility(study, candidates[0], seed)


def _draw(answer: Feasibility, rng: np.random.Generator) -> np.ndarray:
    """Return values within the scale that have the moments found, or others that hold as well."""
    study, moments = answer.study, answer.moments
    rows = [s for s in constraints(study) if s.name not in answer.left_out]
    problem = MomentProblem(study, answer.read_as, answer.p_adjust, rows)
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
