"""Whether a study's printed numbers can belong to one data set, and what conflicts if not."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import of_class, one_of, whole_number
from trustlab.models.display import Result
from trustlab.reproduction.printed_number import printed_interval
from trustlab.reproduction.published_study import PublishedStudy, published_studies
from trustlab.reproduction.reconstruction.constraints import (
    ADJUSTMENTS,
    ONLY_P,
    constraints,
    select,
)
from trustlab.reproduction.reconstruction.contradictions import contradictions, reading_of
from trustlab.reproduction.reconstruction.moments import MomentProblem, Moments

REQUESTED = "left out on request"

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
        Reasons for statistics left out beforehand, by name: those asked for, and those that
        contradict others by arithmetic.
    conflict : tuple of str
        Where no data were found: the statistics that the closest ones do not have.
    remedies : tuple of str
        Statistics any one of which can be left out so that data with all others are found.
    moments : Moments
        Means and covariance that were found, or the closest ones.
    """

    study: PublishedStudy
    p_adjust: str
    left_out: Mapping[str, str]
    conflict: tuple[str, ...]
    remedies: tuple[str, ...]
    moments: Moments = field(repr=False)

    def __bool__(self) -> bool:
        return self.feasible is True

    @property
    def feasible(self) -> bool | None:
        """
        True if data with everything that is printed were found; False if arithmetic contradicts
        it; None if it was not decided: none were found, or something was left out on request.
        """
        if any(why != REQUESTED for why in self.left_out.values()):
            return False
        return None if self.left_out else self.rest_feasible

    @property
    def rest_feasible(self) -> bool | None:
        """True if data with all that is not left out were found, None if none were."""
        return True if self.status == "solved" else None

    @property
    def status(self) -> str:
        """Of what is not left out: "solved" if data were found, otherwise "not found"."""
        return "not found" if self.violation else "solved"

    @property
    def violation(self) -> float:
        """Largest violation of the closest data, in half-widths of printed intervals; 0: none."""
        return self.moments.violation

    @property
    def reading(self) -> str:
        """How p and the degrees of freedom of F were read: what was corrected by ε."""
        return reading_of(self.study).words

    @property
    def epsilon(self) -> tuple[float, float] | None:
        """Least and greatest ε, of 2,001, with which a corrected p fits F; None where none does."""
        study = self.study
        if study.k == 2 or not {"F", "p"} <= study.anova.keys():
            return None
        least, most = printed_interval(study.anova["p"])
        f_ratio = np.maximum(printed_interval(study.anova["F"]), 0.0)
        epsilon = np.linspace(1.0 / (study.k - 1), 1.0, 2001)
        df = (study.k - 1) * epsilon[:, None]
        p = special.fdtrc(df, df * (study.n - 1), f_ratio)
        fits = epsilon[(p.min(axis=1) <= most) & (p.max(axis=1) >= least)]
        return (float(fits[0]), float(fits[-1])) if fits.size else None

    @property
    def message(self) -> str:
        """The answer in words: what contradicts what, and the reading with its ε."""
        study = self.study
        wrong = [why for why in self.left_out.values() if why != REQUESTED]
        requested = [name for name, why in self.left_out.items() if why == REQUESTED]
        parts = [f"Left out: {reason}." for reason in wrong]
        parts += [f"Left out on request: {', '.join(requested)}."] if requested else []
        subject = "the rest" if self.left_out else "all that is printed"
        if self.status == "solved":
            parts.append(f"{subject.capitalize()} can hold together.")
        else:
            parts.append(
                f"No data with {subject} were found from {self.moments.starts} starts; the closest "
                f"miss {', '.join(self.conflict) or 'the scale'}."
            )
        if self.remedies:
            parts.append(f"Found without any one of {', '.join(self.remedies)}.")
        if {"F", "p"} <= study.anova.keys() and study.k > 2:
            parts.append(f"Read as {self.reading}.")
            doubtful = reading_of(study) == ONLY_P or "anova.p" in self.left_out
            if self.epsilon and doubtful:
                low, high = self.epsilon
                f_ratio = np.maximum(printed_interval(study.anova["F"]), 0.0).mean()
                df = study.k - 1
                uncorrected = f"{special.fdtrc(df, df * (study.n - 1), f_ratio):.3f}"
                parts.append(
                    f"A corrected p fits F with ε from {low:.3f} to {high:.3f}; uncorrected, p "
                    f"would be {uncorrected.removeprefix('0')}."
                )
        return " ".join(parts)

    @property
    def title(self) -> str:
        """The study."""
        return f"Feasibility of {self.study.name}"

    def table(self) -> pd.DataFrame:
        """
        Return what is printed, what it allows, and its part in a conflict.

        Index statistic; columns printed, low, high (of the statistic itself; p before adjustment,
        but for Holm's), in_conflict, remedy, left_out (the reason, or empty).
        """
        rows = []
        for s in constraints(self.study, self.p_adjust, reading_of(self.study)):
            marks = s.name in self.conflict, s.name in self.remedies
            rows.append((s.name, s.text, s.low, s.high, *marks, self.left_out.get(s.name, "")))
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
    infeasibility by arithmetic (`left_out`). Where neither is found the answer is None: no
    accusation.

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
        Whether to look for remedies where no data are found.

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
    rng = np.random.default_rng(whole_number("seed", seed, least=0))
    problem, left_out = moment_problem(study, p_adjust, without)
    moments = problem.solve(rng)
    conflict = tuple(s.name for s in problem.constraints if moments.outside[s.name] > 0.0)
    # What presses on the closest data, most first.
    pressing = sorted(moments.outside, key=lambda name: -moments.outside[name])
    remedies = tuple(
        name
        for name in pressing
        if explain
        and name in conflict
        and len(problem.constraints) > 1
        and problem.without(name).solve(rng, FEW_STARTS).violation == 0.0
    )
    return Feasibility(study, p_adjust, left_out, conflict, remedies, moments)


def moment_problem(
    study: PublishedStudy, p_adjust: str, without: Iterable[str]
) -> tuple[MomentProblem, dict[str, str]]:
    """Return the constraints that are to hold, and the reasons for those that are left out."""
    hint = ""
    if isinstance(study, str):
        near = get_close_matches(study, published_studies(), n=1) or ["uav.tlx"]
        hint = f"a printed one is published_studies()[{near[0]!r}]"
    of_class("study", study, PublishedStudy, hint)
    one_of("p_adjust", p_adjust, ADJUSTMENTS)
    reading = reading_of(study)
    printed = constraints(study, p_adjust, reading)
    rows = select(printed, without)
    requested = {s.name: REQUESTED for s in printed if s not in rows}
    if requested and not any(s.kind != "fixed" for s in rows):
        raise ValueError(f"without: nothing of {study.name} is left")
    reasons = contradictions(study, p_adjust) | requested
    rows = [s for s in rows if s.name not in reasons and s.kind != "fixed"]
    return MomentProblem(rows, study.n, study.k, reading.p, study.scale), reasons


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
            left_out = ", ".join(result.left_out)
            possible = result.feasible, result.rest_feasible
            rows.append((name, p_adjust, *possible, result.status, result.violation, left_out))
    columns = ["study", "p_adjust", "feasible", "rest_feasible", "status", "violation", "left_out"]
    return pd.DataFrame(rows, columns=columns).set_index(["study", "p_adjust"])
