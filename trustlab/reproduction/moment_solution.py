"""Whether statements have a common solution: search from many starts, then a proof that there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trustlab.reproduction.certificate import proves_infeasible
from trustlab.reproduction.covariance_search import MomentProblem, Moments
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.statements import Statement

__all__ = ["MARGINS", "Verdict", "decide", "moment_problem"]

MARGINS = (0.3, 0.1, 0.02)
"""How far inside the printed intervals solutions are sought, as shares of their half-widths, one after the other."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """
    What is known about a set of statements.

    Parameters
    ----------
    status : {"solved", "proved", "not found"}
        A solution was found; it is proved that there is none; or neither.
    moments : Moments
        The solutions, or the candidates that come closest, least violated first.
    starts : int
        How many starts were tried.
    """

    status: str
    moments: Moments
    starts: int


def moment_problem(study: PublishedStudy, found: Sequence[Statement], p_adjust: str) -> MomentProblem:
    """
    Return the statements of a study as a system of inequalities.

    Parameters
    ----------
    study : PublishedStudy
        The study.
    found : sequence of Statement
        Its statements, less those left out.
    p_adjust : str
        How pairwise p-values were adjusted.
    """
    return MomentProblem(found, study.n, study.k, p_adjust, study.corrected, study.scale)


def decide(
    problem: MomentProblem, rng: np.random.Generator, starts: int = 512, branches: int = 80, enough: int = 2
) -> Verdict:
    """
    Look for a solution, and where none turns up at once, for a proof that there is none.

    Parameters
    ----------
    problem : MomentProblem
        The statements.
    rng : numpy.random.Generator
        Source of the starts.
    starts : int
        Most starts.
    branches : int
        Most relaxations to solve for a proof; 0 for none. One is tried after the first starts, the others after 256.
    enough : int
        How many solutions to stop at.
    """
    known = problem.found, problem.n, problem.k, problem.p_adjust, problem.scale
    tried, best, count = 0, None, 32
    while tried < starts:
        margin = MARGINS[(tried // 64) % len(MARGINS)]
        moments = problem.search(*problem.starts(count, rng), margin, enough=enough)
        tried += count
        if 0.0 < moments.violation[0] < 1.0:
            again = problem.search(moments.mean[:8], moments.factor[:8], margin, (0.0, 0.0, 0.0), enough)
            moments = again if again.violation[0] < moments.violation[0] else moments
        if moments.solved[0]:
            solved = moments.solved
            return Verdict(
                "solved",
                Moments(moments.mean[solved], moments.factor[solved], moments.violation[solved]),
                tried,
            )
        best = moments if best is None or moments.violation[0] < best.violation[0] else best
        efforts = {count: min(1, branches), 8 * count: branches}
        if efforts.get(tried, 0) and proves_infeasible(*known, efforts[tried]):
            return Verdict("proved", best, tried)
    return Verdict("not found", best, tried)
