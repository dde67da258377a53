"""Power of designs with several factors, groups, or shares of trials: simulated studies, analysed as real ones are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import array_between, not_negative, whole_number
from trustlab.models.html import as_html
from trustlab.studies.analysis.repeated_measures import repeated_measures
from trustlab.studies.analysis.sphericity import CORRECTIONS, greenhouse_geisser
from trustlab.studies.factors.effects import (
    BetweenDesign,
    between_design,
    effect_tests,
    subsets,
    tested,
    within_contrasts,
)
from trustlab.studies.factors.logistic_model import Logistic
from trustlab.studies.planning.closed_form_power import clopper_pearson
from trustlab.studies.planning.covariances import checked_covariance
from trustlab.studies.planning.power_simulation import run_counts

_CHUNK = 1 << 20
"""Scores drawn at a time."""


@dataclass(frozen=True, eq=False)
class FactorialPower:
    """
    Power of every effect of a design with factors, or of conditions on shares, by simulation.

    Parameters
    ----------
    effects : pandas.DataFrame
        What `table` returns.
    alpha, level : float
        Of the tests, and of the Monte-Carlo intervals (Clopper–Pearson).
    origin : str
        Where these numbers come from.
    """

    effects: pd.DataFrame
    alpha: float
    level: float
    origin: str

    def table(self) -> pd.DataFrame:
        """
        Return the power of every effect.

        Returns
        -------
        pandas.DataFrame
            A row per n, effect and test: n (in each group), effect, test ("none", "greenhouse-geisser", "huynh-feldt": corrections of
            F; "likelihood ratio" of shares), eta2_partial (of the population; NaN for shares), power, ci_low, ci_high, replicates,
            closed_form (noncentral F; NaN where sphericity does not hold or the test is corrected).
        """
        return self.effects.copy()

    def plot(self, axes=None):
        """
        Plot the power of every effect against n, corrected by Greenhouse and Geisser where F is; crosses mark the closed form.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw.

        Returns
        -------
        matplotlib.axes.Axes
        """
        import matplotlib.pyplot as plt

        if axes is None:
            _, axes = plt.subplots(figsize=(6.0, 3.8), layout="constrained")
        for effect, own in self.effects.groupby("effect", sort=False):
            usual = own[own["test"].isin(["greenhouse-geisser", "likelihood ratio"])]
            bars = np.maximum([usual["power"] - usual["ci_low"], usual["ci_high"] - usual["power"]], 0.0)
            drawn = axes.errorbar(usual["n"], usual["power"], bars, fmt="o-", ms=4, lw=1.3, capsize=3, label=effect)
            axes.plot(own["n"], own["closed_form"], "x", ms=8, color=drawn[0].get_color())
        axes.axhline(self.alpha, color="0.6", lw=0.8, ls=":")
        axes.set(xlabel="participants in each group", ylabel="power", ylim=(-0.02, 1.02))
        what = f"level {self.alpha:g}, {100 * self.level:g} % Monte-Carlo intervals"
        axes.set_title(f"{self.origin}: {what}", fontsize="small")
        axes.legend(fontsize="x-small")
        return axes

    def _repr_html_(self) -> str:
        return as_html(f"{self.origin}, level {self.alpha:g}", self.effects, title="Power")


@dataclass(frozen=True, eq=False)
class NormalCells:
    """Normal scores by group and cell, means of shape (groups, cells), one covariance; the last factor varies fastest in both."""

    within: Mapping[str, tuple]
    between: Mapping[str, tuple]
    mean: np.ndarray
    covariance: np.ndarray
    origin: str = ""

    def _design(self, n: int) -> tuple[np.ndarray, BetweenDesign, dict[str, int]]:
        """Return the group number of each participant, n in each group, their design, and how many levels factors have."""
        groups = np.repeat(np.arange(len(self.mean)), n)
        codes = np.unravel_index(groups, [len(levels) for levels in self.between.values()] or [1])
        sizes = {name: len(levels) for name, levels in self.within.items()}
        return groups, between_design(len(groups), dict(zip(self.between, codes, strict=False))), sizes

    def expected(self, n: int, alpha: float) -> Iterator[tuple[str, str, float, float]]:
        """Yield effect, test, population partial η² and power in closed form, which needs sphericity."""
        groups, design, sizes = self._design(n)
        for names, (block, columns) in product(subsets(list(sizes)), design.blocks.items()):
            contrasts = within_contrasts(sizes, names)
            d, variances = contrasts.shape[1], contrasts.T @ self.covariance @ contrasts
            rows = np.eye(design.matrix.shape[1])[columns]
            ss, _ = tested((self.mean[groups] @ contrasts)[None], design, rows)
            strength = float(ss[0]) * d / np.trace(variances)
            df1, df2 = d * len(columns), d * design.df_error
            power = 1.0 - special.ncfdtr(df1, df2, strength, special.fdtri(df1, df2, 1.0 - alpha))
            spherical = d == 1 or greenhouse_geisser(variances) > 1.0 - 1e-9
            for test in CORRECTIONS if block or names else ():
                closed = power if spherical and test == "none" else np.nan
                yield " × ".join(filter(None, (block, *names))), test, strength / (strength + len(groups) * d), closed

    def counts(self, n: int, rng: np.random.Generator, replicates: int, alpha: float) -> dict[str, int]:
        """Draw studies and count significant effects, "effect/test"."""
        found: Counter = Counter()
        groups, design, sizes = self._design(n)
        root = np.linalg.cholesky(self.covariance).T
        step = max(1, _CHUNK // (len(groups) * len(root)))
        for first in range(0, replicates, step):
            shape = (min(step, replicates - first), len(groups), len(root))
            tests = effect_tests(rng.standard_normal(shape) @ root + self.mean[groups], sizes, design)
            for test, column in zip(CORRECTIONS, ("p", "p_gg", "p_hf"), strict=True):
                hits = (tests[column] < alpha).groupby(level="effect").sum()
                found.update({f"{effect}/{test}": int(count) for effect, count in hits.items()})
        return dict(found)


@dataclass(frozen=True, eq=False)
class Shares:
    """Counts out of trials by condition: logits of the participant in the middle, SD of the participants' intercepts."""

    logits: np.ndarray
    trials: int
    sd: float
    origin: str = ""

    def expected(self, n: int, alpha: float) -> Iterator[tuple[str, str, float, float]]:
        """Yield the effect and its test, which has no closed form."""
        yield "condition", "likelihood ratio", np.nan, np.nan

    def counts(self, n: int, rng: np.random.Generator, replicates: int, alpha: float) -> dict[str, int]:
        """Draw studies, and count those whose likelihood ratio finds the conditions different."""
        k, found = len(self.logits), 0
        model = Logistic(np.repeat(np.arange(n), k), np.full(n * k, float(self.trials)), 9)
        conditions, common = np.tile(np.eye(k), (n, 1)), np.ones((n * k, 1))
        for _ in range(replicates):
            chance = special.expit(self.logits + self.sd * rng.standard_normal((n, 1))).ravel()
            counts = rng.binomial(self.trials, chance).astype(float)
            chi2 = 2.0 * (model.fit(counts, conditions).llf - model.fit(counts, common).llf)
            found += special.chdtrc(k - 1, max(chi2, 0.0)) < alpha
        return {"condition/likelihood ratio": int(found)}


def population_of(
    mean: Any, covariance: Any, data: Any, dv: Hashable, within: list, between: list, subject: Hashable, order: Any
) -> NormalCells:
    """Return the population of a pilot study, or of means indexed by the factors' levels and a covariance of the cells."""
    if data is not None:
        pilot = repeated_measures(data, dv, within, subject, between=between, order=order)
        x, scores = pilot.design.matrix, pilot.scores.values
        residual = scores - x @ np.linalg.lstsq(x, scores)[0]
        matrix = checked_covariance("covariance of data", residual.T @ residual / pilot.design.df_error)
        means = np.array([scores[who].mean(axis=0) for _, who in pilot.members()])
        own = {str(name): levels for name, levels in pilot.within.items()}
        groups = {str(name): levels for name, levels in pilot.between.items()}
        return NormalCells(own, groups, means, matrix, pilot.origin)
    names, series = [*map(str, between), *map(str, within)], pd.Series(mean, dtype=float)
    if series.index.nlevels != len(names):
        found = f"{series.index.nlevels} level(s) in its index"
        raise ValueError(f"mean must be indexed by the levels of {', '.join(names)}, got {found}")
    levels = {name: tuple(series.index.unique(i)) for i, name in enumerate(names)}
    cells = dict(zip(map(tuple, series.index.to_frame().to_numpy().tolist()), series, strict=True))
    wanted = list(product(*levels.values()))
    if missing := [cell for cell in wanted if not np.isfinite(cells.get(cell, np.nan))]:
        raise ValueError(f"mean: no number for cell {missing[0]!r} of {' × '.join(names)}")
    groups = {name: levels.pop(name) for name in names[: len(between)]}
    means = np.array([cells[cell] for cell in wanted]).reshape(int(np.prod([len(x) for x in groups.values()])), -1)
    return NormalCells(levels, groups, means, checked_covariance("covariance", covariance, means.shape[1]))


def shares_of(probabilities: Any, trials: int | None, sd: float | None) -> Shares:
    """Return the population of shares with these probabilities, of the participant in the middle, by condition."""
    if trials is None or sd is None:
        raise ValueError(
            'family="binomial" needs trials= of each participant and condition, and sd= of their intercepts in logits'
        )
    chances = array_between("mean", list(pd.Series(probabilities)), 1e-6, 1.0 - 1e-6, "probabilities")
    if chances.size < 2:
        raise ValueError(f"mean must have the probabilities of at least two conditions, got {chances.size}")
    return Shares(special.logit(chances), whole_number("trials", trials), not_negative("sd", sd))


def factorial_power(
    population: NormalCells | Shares,
    sizes: Sequence[int],
    alpha: float,
    replicates: int,
    level: float,
    seed: int,
    where: Mapping,
) -> FactorialPower:
    """Simulate studies with n participants in each group, for every n; the arguments are those of `power_analysis`, checked."""
    cells = [{"population": population, "n": n, "draws": np.random.SeedSequence(seed, spawn_key=(n,))} for n in sizes]
    counted = run_counts(count_effects, cells, {"replicates": replicates, "alpha": alpha}, where)
    rows = []
    for n, counts in zip(sizes, counted, strict=True):
        for effect, test, eta2, closed in population.expected(n, alpha):
            count = counts[f"{effect}/{test}"]
            low, high = clopper_pearson(count, replicates, level)
            rows.append((n, effect, test, eta2, count / replicates, float(low), float(high), replicates, closed))
    columns = ["n", "effect", "test", "eta2_partial", "power", "ci_low", "ci_high", "replicates", "closed_form"]
    origin = "simulated studies" + (f", from {population.origin}" if population.origin else "")
    table = pd.DataFrame(rows, columns=columns)
    table.attrs["origin"] = origin
    return FactorialPower(table, alpha, level, origin)


def count_effects(
    population: NormalCells | Shares,
    n: int,
    draws: np.random.SeedSequence,
    replicates: int,
    alpha: float,
    seed: np.random.SeedSequence,
) -> dict[str, int]:
    """Count the significant effects of one population and n: a task of `run_campaign`."""
    return population.counts(n, np.random.default_rng(draws), replicates, alpha)
