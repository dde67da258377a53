"""Whether a study's printed numbers can belong to one data set, and what conflicts if not."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from trustlab.models.checks import whole_number
from trustlab.models.display import Result
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import (
    ADJUSTMENTS,
    Constraint,
    arithmetic_conflicts,
    constraints,
    degrees,
    reading_of,
    select,
)
from trustlab.reproduction.reconstruction.moment_search import MomentProblem, Moments
from trustlab.reproduction.reconstruction.readings import ONLY_P, fitting_epsilon, uncorrected_p
from trustlab.reproduction.reconstruction.relaxation import proves_infeasible

# How far inside the printed intervals solutions are sought, as shares of their half-widths, one
# after the other.
MARGINS = (0.3, 0.1, 0.02)

REQUESTED = "left out on request"

# What the deletion filter leaves out first: numbers that follow from others, or that rarely matter.
LEAST_MISSED = (
    "sd",
    "anova.eta2",
    "anova.df2",
    "anova.df1",
    "anova.p",
    "epsilon",
    "mauchly.p",
    "mauchly",
)


@dataclass(frozen=True, eq=False)
class Verdict:
    """
    What is known about a set of constraints.

    `status` is "solved" (a solution was found), "proved" (there is none) or "not found" (neither);
    `moments` are the solutions, or the candidates that come closest, least violated first; `starts`
    is how many starts were tried.
    """

    status: str
    moments: Moments
    starts: int


def moment_problem(
    study: PublishedStudy, rows: Sequence[Constraint], p_adjust: str
) -> MomentProblem:
    """Return constraints of a study as a system of inequalities."""
    corrected = reading_of(study).p
    return MomentProblem(rows, study.n, study.k, p_adjust, corrected, study.scale)


def decide(
    problem: MomentProblem,
    rng: np.random.Generator,
    starts: int = 512,
    branches: int = 80,
    enough: int = 2,
) -> Verdict:
    """
    Search for `enough` solutions and, if none is found at once, for a proof that there is none.

    A proof may solve up to `branches` relaxations (0: no proof is attempted): one after the first
    starts, because it is cheap, and all of them after 256 starts.
    """
    tried = 0
    best = None
    count = 32
    efforts = {count: min(1, branches), 8 * count: branches}
    while tried < starts:
        margin = MARGINS[(tried // 64) % len(MARGINS)]
        moments = problem.search(*problem.starts(count, rng), margin, enough=enough)
        tried += count
        if 0.0 < moments.violation[0] < 1.0:  # nearly there: go on from the nearest
            again = problem.search(
                moments.mean[:8], moments.factor[:8], margin, (0.0, 0.0, 0.0), enough
            )
            moments = again if again.violation[0] < moments.violation[0] else moments
        if moments.solved[0]:
            return Verdict("solved", moments.select(moments.solved), tried)
        if best is None or moments.violation[0] < best.violation[0]:
            best = moments
        if efforts.get(tried, 0) and proves_infeasible(problem, efforts[tried]):
            return Verdict("proved", best, tried)
    return Verdict("not found", best, tried)


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
    status : {"solved", "proved", "not found"}
        Of what is not left out: a solution was found; it is proved that there is none; or none was
        found from many starts.
    conflict : tuple of str
        The smallest set found of statistics that cannot hold together. Without any one of them this
        is no longer proved (if `conflict_proved`), or a solution was found (otherwise). Empty when
        feasible.
    conflict_proved : bool
        Whether it is proved that the conflict cannot hold together.
    remedies : tuple of str
        Statistics any one of which can be left out so that all others hold.
    left_out : mapping of str to str
        Reasons for statistics left out beforehand, by name: those asked for, and those that
        contradict others by arithmetic.
    violation : float
        Largest violation of the closest candidate, in half-widths of printed intervals; 0 when
        feasible.
    verdict : Verdict
        The solutions, or the closest candidates.
    """

    study: PublishedStudy
    p_adjust: str
    status: str
    conflict: tuple[str, ...]
    conflict_proved: bool
    remedies: tuple[str, ...]
    left_out: Mapping[str, str]
    violation: float
    verdict: Verdict = field(repr=False)

    def __bool__(self) -> bool:
        return self.feasible

    @property
    def feasible(self) -> bool:
        """Whether one data set can have everything that is printed; False if any is left out."""
        return self.rest_feasible and not self.left_out

    @property
    def rest_feasible(self) -> bool:
        """Whether one data set can have all that is not left out."""
        return self.status == "solved"

    @property
    def reading(self) -> str:
        """How p and the degrees of freedom of F were read: what was corrected by ε."""
        return reading_of(self.study).words

    @property
    def epsilon(self) -> tuple[float, float] | None:
        """Least and greatest ε with which a corrected p fits F; None where none does."""
        return fitting_epsilon(self.study)

    @property
    def message(self) -> str:
        """The answer in words: what contradicts what, and the reading with its ε."""
        outcome = {"solved": "can", "proved": "cannot", "not found": "could not be found to"}
        subject = "The rest" if self.left_out else "All that is printed"
        parts = [f"Left out: {reason}." for reason in self._contradictions()]
        requested = [name for name, why in self.left_out.items() if why == REQUESTED]
        parts += [f"Left out on request: {', '.join(requested)}."] if requested else []
        parts.append(f"{subject} {outcome[self.status]} hold together.")
        parts += [f"In conflict: {', '.join(self.conflict)}."] if self.conflict else []
        if {"F", "p"} <= set(self.study.anova) and self.study.k > 2:
            parts.append(f"Read as {self.reading}.")
            doubtful = reading_of(self.study) == ONLY_P or "anova.p" in self.left_out
            if self.epsilon and doubtful:
                low, high = self.epsilon
                uncorrected = f"{uncorrected_p(self.study):.3f}".removeprefix("0")
                parts.append(
                    f"A corrected p fits F with ε from {low:.3f} to {high:.3f}; uncorrected, p "
                    f"would be {uncorrected}."
                )
        return " ".join(parts)

    def _contradictions(self) -> list[str]:
        return [why for why in self.left_out.values() if why != REQUESTED]

    @property
    def title(self) -> str:
        """The study."""
        return f"Feasibility of {self.study.name}"

    def table(self) -> pd.DataFrame:
        """
        Return what is printed, what it allows, and its part in a conflict.

        Index statistic; columns printed, low, high (of the statistic itself), in_conflict, remedy,
        left_out (the reason, or empty).
        """
        rows = []
        for s in [*constraints(self.study, self.p_adjust), *degrees(self.study)]:
            low, high = s.low, s.high
            if s.kind.startswith("log"):
                low, high = float(np.exp(low)), float(np.exp(min(high, 0.0)))
            marks = s.name in self.conflict, s.name in self.remedies
            rows.append((s.name, s.text, low, high, *marks, self.left_out.get(s.name, "")))
        columns = ["statistic", "printed", "low", "high", "in_conflict", "remedy", "left_out"]
        return pd.DataFrame(rows, columns=columns).set_index("statistic")


def feasibility(
    study: PublishedStudy,
    p_adjust: str = "bonferroni",
    without: Iterable[str] = (),
    seed: int = 0,
    explain: bool = True,
) -> Feasibility:
    """
    Determine whether printed numbers can belong to one data set, and if not, what conflicts.

    Feasibility is shown by means and a covariance matrix that have all statistics within rounding;
    infeasibility is proved by a linear relaxation wherever that suffices (`status`). The conflict
    is an irreducible infeasible subset, by a deletion filter (Chinneck & Dravnieks 1991) in several
    orders, the smallest found.

    Parameters
    ----------
    study : PublishedStudy
        The study.
    p_adjust : {"bonferroni", "holm", "sidak", "none"}
        How the printed pairwise p-values were adjusted for the number of comparisons.
    without : iterable of str
        Statistics to leave out, by name ("anova.F", "pairs.C1-C3") or group ("mauchly", "pairs").
    seed : int
        Seed of the search.
    explain : bool
        Whether to look for the conflict.

    Returns
    -------
    Feasibility

    Raises
    ------
    ValueError
        If an argument is wrong or nothing is left.

    Examples
    --------
    >>> import trustlab as tl
    >>> answer = tl.feasibility(tl.published_studies()["uav.tlx"], explain=False)
    >>> answer.feasible, answer.left_out
    (True, {})
    """
    problem, left_out = prepared(study, p_adjust, without)
    rng = generator(seed)
    verdict = decide(problem, rng)
    solved = verdict.status == "solved"
    conflict: tuple[str, ...] = ()
    remedies: tuple[str, ...] = ()
    proved = explain and verdict.status == "proved"
    if not solved and explain:
        conflict = _smallest_conflict(problem, proved, rng)
        remedies = tuple(name for name in conflict if _holds(_less(problem, name), rng))
    violation = float(verdict.moments.violation[0])
    outcome = verdict.status, conflict, proved, remedies
    return Feasibility(study, p_adjust, *outcome, left_out, violation, verdict)


def prepared(
    study: PublishedStudy, p_adjust: str, without: Iterable[str]
) -> tuple[MomentProblem, dict[str, str]]:
    """Return the constraints that are to hold, and the reasons for those that are left out."""
    printed = constraints(study, p_adjust)
    printed += degrees(study)
    rows = select(printed, without)
    reasons = {s.name: REQUESTED for s in printed if s not in rows}
    reasons |= {
        name: why for name, why in arithmetic_conflicts(study).items() if name not in reasons
    }
    rows = [s for s in rows if s.name not in reasons and s.kind != "degrees"]
    if not rows:
        raise ValueError(f"without: nothing of {study.name} is left")
    return moment_problem(study, rows, p_adjust), reasons


def generator(seed: int) -> np.random.Generator:
    """Return the generator of a seed."""
    return np.random.default_rng(np.random.SeedSequence(whole_number("seed", seed, least=0)))


def _less(problem: MomentProblem, name: str) -> MomentProblem:
    return replace(problem, constraints=[s for s in problem.constraints if s.name != name])


def _holds(problem: MomentProblem, rng: np.random.Generator) -> bool:
    """Return whether a solution is found; refuted first where that is quick."""
    if proves_infeasible(problem, branches=1):
        return False
    return decide(problem, rng, starts=64, branches=0).status == "solved"


def _smallest_conflict(
    problem: MomentProblem, proved: bool, rng: np.random.Generator
) -> tuple[str, ...]:
    """
    Delete what is not needed for a conflict, in several orders, and return the smallest conflict.

    Where the conflict is proved, what remains is proved to conflict at every deletion; otherwise no
    solution is found.
    """

    def rank(s: Constraint) -> int:
        hits = [q for q, key in enumerate(LEAST_MISSED) if key in (s.name, s.name.split(".")[0])]
        return (
            hits[0]
            if hits
            else len(LEAST_MISSED) + (s.text != "not significant") + (s.kind == "mean")
        )

    branches = 1 if proves_infeasible(problem, branches=1) else 16

    def conflicting(fewer: MomentProblem) -> bool:
        return proves_infeasible(fewer, branches) if proved else not _holds(fewer, rng)

    order, best = sorted(problem.constraints, key=rank), problem
    orders = [
        order,
        order[::-1],
        *([order[q] for q in rng.permutation(len(order))] for _ in range(2)),
    ]
    quick = proved and branches == 1  # otherwise one order is all there is time for
    for order in orders if quick else orders[:1]:
        subset = problem
        for s in order:
            fewer = _less(subset, s.name)
            if fewer.constraints and conflicting(fewer):
                subset = fewer
        best = min(best, subset, key=lambda p: len(p.constraints))
    return tuple(s.name for s in best.constraints)


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
        Index study, p_adjust; columns feasible (nothing left out), rest_feasible (of what is not
        left out), status (solved, proved, not found), violation (of the closest candidate, in
        half-widths of printed intervals), left_out.
    """
    rows = []
    for name, study in studies.items():
        for p_adjust in ADJUSTMENTS:
            result = feasibility(study, p_adjust, seed=seed, explain=False)
            left_out = ", ".join(result.left_out)
            possible = result.feasible, result.rest_feasible
            rows.append((name, p_adjust, *possible, result.status, result.violation, left_out))
    columns = ["study", "p_adjust", "feasible", "rest_feasible", "status", "violation", "left_out"]
    return pd.DataFrame(rows, columns=columns).set_index(["study", "p_adjust"])
