"""
Power of designs with several factors, groups, or shares of trials: simulated studies, analysed as
real ones are.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.random import SeedSequence
from scipy import special

from trustlab.models.checks import (
    array_between,
    not_negative,
    whole_number,
)
from trustlab.studies.anova import (
    CORRECTIONS,
    Design,
    chunks,
    effect_name,
    effects,
    regress,
    sphericity,
)
from trustlab.studies.ordinal import Cumulative
from trustlab.studies.planning.closed_form_power import clopper_pearson
from trustlab.studies.planning.settings import Simulation, StudyColumns
from trustlab.studies.repeated_measures import repeated_measures
from trustlab.testbeds.covariance import checked_covariance


@dataclass(frozen=True, eq=False)
class NormalCells:
    """
    Normal scores by group and cell, means of shape (groups, cells), one covariance; the last factor
    varies fastest in both.
    """

    within: Mapping[str, Sequence]
    between: Mapping[str, Sequence]
    mean: np.ndarray
    covariance: np.ndarray
    simulated_origin: str = "simulated studies"

    def _design(self, n: int) -> tuple[np.ndarray, Design]:
        """Return the group number of each participant, n in each group, and their design."""
        groups = np.repeat(np.arange(len(self.mean)), n)
        codes = np.unravel_index(groups, [len(levels) for levels in self.between.values()] or [1])
        numbers = dict(zip(self.between, codes, strict=False))
        return groups, Design(len(groups), self.within, self.between, numbers)

    def expected(self, n: int, alpha: float) -> Iterator[tuple[str, str, float, float]]:
        """
        Yield effect, test, population partial η² and power in closed form, which needs sphericity.
        """
        groups, design = self._design(n)
        regression = regress(self.mean[groups][None], design)
        for block, names in design.effects:
            contrasts, rows = design.contrasts(names), design.rows(block)
            d, variances = contrasts.shape[1], contrasts.T @ self.covariance @ contrasts
            ss = regression.sum_of_squares(contrasts, rows)
            strength = float(ss[0]) * d / np.trace(variances)
            df1, df2 = d * len(rows), d * design.df_error
            power = 1.0 - special.ncfdtr(df1, df2, strength, special.fdtri(df1, df2, 1.0 - alpha))
            spherical = sphericity(variances, design.df_error)["epsilon_gg"] > 1.0 - 1e-9
            for test in CORRECTIONS:
                closed = power if spherical and test == "none" else np.nan
                yield (
                    effect_name(block, names),
                    test,
                    strength / (strength + len(groups) * d),
                    closed,
                )

    def counts(
        self, n: int, rng: np.random.Generator, replicates: int, alpha: float
    ) -> dict[str, int]:
        """Draw studies and count significant effects, "effect/test"."""
        found: Counter = Counter()
        groups, design = self._design(n)
        root = np.linalg.cholesky(self.covariance).T
        for part in chunks(replicates, len(groups) * len(root)):
            shape = (len(part), len(groups), len(root))
            scores = rng.standard_normal(shape) @ root + self.mean[groups]
            tests = effects(scores, design)
            for test, column in zip(CORRECTIONS, ("p", "p_gg", "p_hf"), strict=True):
                significant = (tests[column] < alpha).groupby("effect").sum()
                for effect, count in significant.items():
                    found[f"{effect}/{test}"] += int(count)
        return dict(found)


class _Answers:
    """Population of answers; conditions are compared by the likelihood ratio of a mixed model."""

    simulated_origin: ClassVar[str] = "simulated studies"

    def studies(self, n: int, rng: np.random.Generator) -> Iterator[tuple[float, int]]:
        """Yield χ² and its degrees of freedom, study by study."""
        raise NotImplementedError

    def expected(self, n: int, alpha: float) -> Iterator[tuple[str, str, float, float]]:
        """
        Yield the effect and its test, which has no closed form.

        Parameters
        ----------
        n : int
            Participants.
        alpha : float
            Level of the test.
        """
        yield "condition", "likelihood ratio", np.nan, np.nan

    def counts(
        self, n: int, rng: np.random.Generator, replicates: int, alpha: float
    ) -> dict[str, int]:
        """
        Draw studies, and count those whose likelihood ratio finds the conditions different.

        Parameters
        ----------
        n : int
            Participants.
        rng : numpy.random.Generator
            Source of the draws.
        replicates : int
            Studies.
        alpha : float
            Level of the test.
        """
        studies = islice(self.studies(n, rng), replicates)
        significant = sum(special.chdtrc(df, max(chi2, 0.0)) < alpha for chi2, df in studies)
        return {"condition/likelihood ratio": int(significant)}


@dataclass(frozen=True, eq=False)
class Proportions(_Answers):
    """
    Population of counts of successes: conditions are compared by the logistic mixed model.

    Parameters
    ----------
    probabilities : mapping, Series or sequence of float
        Probability of a success by condition, for a median participant.
    trials : int
        Trials of each participant and condition.
    sd : float
        Standard deviation of participants' intercepts, in logits.

    Raises
    ------
    ValueError
        If fewer than two probabilities are given, or a number is out of range.

    Notes
    -----
    Simulating and analysing one study, by the likelihood ratio, takes some milliseconds.
    """

    probabilities: Any
    trials: int
    sd: float

    def __post_init__(self):
        values = list(pd.Series(self.probabilities))
        chances = array_between("probabilities", values, 1e-6, 1.0 - 1e-6, "probabilities")
        if chances.size < 2:
            raise ValueError(
                f"proportions need the probabilities of at least two conditions, got {chances.size}"
            )
        whole_number("trials", self.trials)
        not_negative("sd", self.sd)

    @property
    def logits(self) -> np.ndarray:
        """Logits of the participant in the middle."""
        return special.logit(pd.Series(self.probabilities).to_numpy(float))

    def studies(self, n: int, rng: np.random.Generator) -> Iterator[tuple[float, int]]:
        """
        Yield χ² and its degrees of freedom, study by study.

        Parameters
        ----------
        n : int
            Participants.
        rng : numpy.random.Generator
            Source of the draws.
        """
        logits = self.logits
        k = len(logits)
        people = np.repeat(np.arange(n), 2 * k)
        outcome = np.tile([0, 1], n * k)
        conditions = np.tile(np.repeat(np.eye(k)[:, 1:], 2, axis=0), (n, 1))
        while True:
            chance = special.expit(logits + self.sd * rng.standard_normal((n, 1))).ravel()
            counts = rng.binomial(self.trials, chance).astype(float)
            model = Cumulative(
                people, 2, 9, np.column_stack([self.trials - counts, counts]).ravel()
            )
            chi2 = 2.0 * model.fit(outcome, conditions).llf
            yield chi2 - 2.0 * model.fit(outcome, conditions[:, :0]).llf, k - 1


@dataclass(frozen=True, eq=False)
class Ratings(_Answers):
    """
    Population of ratings: conditions are compared by the cumulative-link mixed model.

    Parameters
    ----------
    probabilities : array_like, shape (conditions, categories)
        Probability of every rating by condition, for a median participant.
    sd : float
        Standard deviation of participants' intercepts, in logits.
    repeats : int
        Ratings of each participant and condition.

    Raises
    ------
    ValueError
        If there are fewer than two conditions or categories, a row does not sum to one, or a number
        is out of range.
    """

    probabilities: Any
    sd: float
    repeats: int = 1

    def __post_init__(self):
        chances = array_between(
            "probabilities", np.ravel(self.probabilities), 1e-6, 1.0 - 1e-6, "probabilities"
        )
        shape = np.shape(self.probabilities)
        if len(shape) != 2 or min(shape) < 2:
            raise ValueError(
                f"probabilities need a row per condition and a column per rating, got {shape}"
            )
        totals = chances.reshape(shape).sum(axis=1)
        worst = int(np.argmax(np.abs(totals - 1.0)))
        if abs(totals[worst] - 1.0) > 1e-6:
            raise ValueError(f"probabilities: row {worst} sums to {totals[worst]:g}, not to 1")
        not_negative("sd", self.sd)
        whole_number("repeats", self.repeats)

    def studies(self, n: int, rng: np.random.Generator) -> Iterator[tuple[float, int]]:
        """
        Yield χ² and its degrees of freedom, study by study.

        Parameters
        ----------
        n : int
            Participants.
        rng : numpy.random.Generator
            Source of the draws.
        """
        below = np.cumsum(np.asarray(self.probabilities, dtype=float), axis=1)[:, :-1]
        k = len(below)
        thresholds = np.tile(np.repeat(special.logit(below), self.repeats, axis=0), (n, 1))
        people = np.repeat(np.arange(n), k * self.repeats)
        conditions = np.tile(np.repeat(np.eye(k)[:, 1:], self.repeats, axis=0), (n, 1))
        while True:
            answers = self.sd * rng.standard_normal(n)[people]
            answers += special.logit(rng.random(people.size))
            ratings = (answers[:, None] > thresholds).sum(axis=1)
            # A rating that nobody gave has no threshold.
            levels, category = np.unique(ratings, return_inverse=True)
            chi2 = 0.0
            if levels.size > 1:
                model = Cumulative(people, levels.size, 9)
                chi2 = 2.0 * model.fit(category, conditions).llf
                chi2 -= 2.0 * model.fit(category, conditions[:, :0]).llf
            yield chi2, k - 1


def population_of(mean: Any, covariance: Any, data: Any, columns: StudyColumns) -> NormalCells:
    """
    Return the population of a pilot study, or of means indexed by the factors' levels and a
    covariance of the cells.
    """
    within, between = columns.factors, columns.groups
    if data is not None:
        pilot = repeated_measures(
            data,
            columns.dv,
            within,
            columns.subject,
            between=between,
            order=columns.order,
        )
        matrix = checked_covariance("covariance of data", pilot.residual_covariance())
        rows = pilot.descriptives()["mean"].to_numpy()
        means = rows.reshape(-1, pilot.k)
        factors = {str(name): levels for name, levels in pilot.within.items()}
        groups = {str(name): levels for name, levels in pilot.between.items()}
        origin = f"simulated studies, from {pilot.origin}" if pilot.origin else "simulated studies"
        return NormalCells(factors, groups, means, matrix, origin)
    names, series = [*map(str, between), *map(str, within)], pd.Series(mean, dtype=float)
    if series.index.nlevels != len(names):
        raise ValueError(
            f"mean must be indexed by {', '.join(names)}, got {series.index.nlevels} level(s)"
        )
    levels = {name: tuple(series.index.unique(i)) for i, name in enumerate(names)}
    cells = series.reindex(pd.MultiIndex.from_product(levels.values()))
    if cells.isna().any():
        raise ValueError(
            f"mean: no number for cell {cells.index[cells.isna()][0]!r} of {' × '.join(names)}"
        )
    groups = {name: levels.pop(name) for name in names[: len(between)]}
    means = cells.to_numpy().reshape(int(np.prod([len(x) for x in groups.values()])), -1)
    return NormalCells(
        levels, groups, means, checked_covariance("covariance", covariance, means.shape[1])
    )


def effects_power(
    population: NormalCells | Proportions | Ratings,
    sizes: Sequence[int],
    counted: Sequence[dict],
    simulation: Simulation,
) -> pd.DataFrame:
    """
    Return the power of every effect with n participants in each group, for every n, from the counts
    of simulated studies.
    """
    rows = []
    for n, counts in zip(sizes, counted, strict=True):
        for effect, test, eta2, closed in population.expected(n, simulation.alpha):
            count = counts[f"{effect}/{test}"]
            low, high = clopper_pearson(count, simulation.replicates, simulation.level)
            row = {"n": n, "effect": effect, "eta2_partial": eta2, "test": test}
            row |= {"power": count / simulation.replicates, "ci_low": float(low)}
            row |= {"ci_high": float(high), "replicates": simulation.replicates}
            rows.append(row | {"closed_form": closed})
    return pd.DataFrame(rows)


def count_effects(
    population: NormalCells | Proportions | Ratings,
    n: int,
    draws: SeedSequence,
    replicates: int,
    alpha: float,
    seed: SeedSequence,
) -> dict[str, int]:
    """Count the significant effects of one population and n: a task of `run_campaign`."""
    return population.counts(n, np.random.default_rng(draws), replicates, alpha)
