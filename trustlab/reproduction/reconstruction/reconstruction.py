"""
Data that have all statistics printed for a study.

A reconstruction first finds means and a covariance matrix with every statistic within its rounding,
and then draws n subjects with exactly these moments inside the scale of the measure. The values are
continuous: they do not follow the steps of a questionnaire. They are not measurements, and
everything made from them says so.
"""

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import ADJUSTMENTS
from trustlab.reproduction.reconstruction.contradictions import contradictions
from trustlab.reproduction.reconstruction.feasibility import Feasibility, feasibility
from trustlab.reproduction.reconstruction.moments import sample_with_moments

# The mark that data carry in their `attrs`.
RECONSTRUCTED = {
    "reconstructed": True,
    "note": "Reconstructed data: not measurements, but values that have the printed statistics.",
}
MOST_DRAWS = 6  # solutions for which values within the scale are sought


class ReconstructionError(ValueError):
    """No data with the printed statistics were found; the message says what to try."""


def reconstruct(study: PublishedStudy, seed: int = 0, p_adjust: str | None = None) -> pd.DataFrame:
    """
    Return data that have the statistics printed for a study.

    Statistics that contradict others by arithmetic are left out.

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
    of_class("study", study, PublishedStudy)
    # Where none is given, first what the fewest numbers contradict.
    fewest = sorted(ADJUSTMENTS, key=lambda each: len(contradictions(study, each)))
    for candidate in fewest if p_adjust is None else [p_adjust]:
        answer = feasibility(study, candidate, seed)
        if answer.rest_feasible:
            break
    else:
        raise ReconstructionError(f"{study.name}, p_adjust={candidate!r}: {answer.message}")
    values = _draw(answer, np.random.default_rng(int(seed)).spawn(1)[0])
    subjects = pd.RangeIndex(1, len(values) + 1, name="subject")
    wide = pd.DataFrame(values, subjects, list(study.conditions))
    long = wide.melt(var_name="condition", value_name="value", ignore_index=False)
    frame = long.sort_index(kind="stable").reset_index()
    about = {"study": study.name, "p_adjust": candidate, "seed": int(seed)}
    frame.attrs = {**RECONSTRUCTED, **about, "left_out": answer.left_out}
    return frame


def _draw(answer: Feasibility, rng: np.random.Generator) -> np.ndarray:
    """Return values within the scale that have the moments found, or others that hold as well."""
    study, moments = answer.problem.study, answer.moments
    for _ in range(MOST_DRAWS):
        values = sample_with_moments(moments.mean, moments.factor, study.n, study.scale, rng)
        if values is not None:
            return values
        moments = answer.problem.solve(rng)
        if moments.violation:
            break
    raise ReconstructionError(
        f"{study.name}: no {study.n} values within the scale {study.scale} were found that have a "
        "solution's means and covariances; try another seed, or leave out a standard deviation"
    )
