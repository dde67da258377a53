"""
Power of a within-subject design by simulated studies, against n, effect size, correlation and
sphericity.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, product
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence

from trustlab.models.checks import did_you_mean, of_class, one_of, whole_number
from trustlab.models.display import as_html, axes_or_new
from trustlab.studies.anova import CORRECTIONS, Design, chunks, effects
from trustlab.studies.pairs import condition_pairs
from trustlab.studies.planning.closed_form_power import (
    clopper_pearson,
    noncentral_f_power,
    noncentrality,
)
from trustlab.studies.planning.covariances import Conditions, conditions_from
from trustlab.studies.planning.factorial_power import (
    NormalCells,
    Proportions,
    Ratings,
    count_effects,
    effects_power,
    population_of,
)
from trustlab.studies.planning.settings import (
    USUAL_COLUMNS,
    USUAL_SIMULATION,
    Simulation,
    StudyColumns,
)

# What power is computed against, and how a figure labels it.
AXES = {
    "n": "participants n",
    "effect_size": "population partial η²",
    "correlation": "correlation of conditions",
    "epsilon": "ε of the population",
}

ENDS = ("power", "ci_low", "ci_high", "replicates")
# What the tables of F, of pairs and of claims have after `AXES`.
COLUMNS = (
    ("noncentrality", "test", *ENDS, "closed_form"),
    ("a", "b", "d_z", "adjust", *ENDS, "closed_form"),
    ("adjust", "claims", *ENDS, "expected_found"),
)

MOST_CELLS = 10_000
MOST_N = 100_000

# Corrections of the omnibus F; "auto" is Greenhouse–Geisser where Mauchly's test rejects.
TESTS = (*CORRECTIONS, "auto")

# The correction that `repeated_measures` makes by default.
USUAL_TEST = "greenhouse-geisser"

# Adjustments of the pairs' p-values, and their names in `Pairs`.
ADJUSTMENTS = {"none": "p", "bonferroni": "p_bonferroni", "holm": "p_holm"}


@dataclass(frozen=True, eq=False)
class PowerAnalysis:
    """
    Power of the omnibus F and of every pair, by simulation.

    Parameters
    ----------
    conditions : Conditions, NormalCells, Proportions or Ratings
        The population; `NormalCells` with several factors or groups.
    alpha : float
        Level of every test.
    replicates : int
        Simulated studies per cell.
    level : float
        Coverage of the Monte-Carlo intervals (Clopper–Pearson).
    seed : int
        Of the draws.
    varied : tuple of str
        Axes of the grid for which several values were given.
    omnibus, pairwise, together : pandas.DataFrame
        What `table()`, `pairs()` and `claims()` return.
    """

    conditions: Conditions | NormalCells | Proportions | Ratings
    alpha: float
    replicates: int
    level: float
    seed: int
    varied: tuple[str, ...]
    omnibus: pd.DataFrame
    pairwise: pd.DataFrame
    together: pd.DataFrame

    def table(self) -> pd.DataFrame:
        """
        Return the power of the omnibus F.

        Returns
        -------
        pandas.DataFrame
            A row per cell and test: n, effect_size (population partial η²), correlation, epsilon,
            noncentrality, test ("none", "greenhouse-geisser", "huynh-feldt", "auto"), power,
            ci_low, ci_high, replicates, closed_form (noncentral F; NaN where sphericity does not
            hold or the test is corrected). With several factors or groups a row per n, effect and
            test: n (in each group), effect, eta2_partial (of the population), test, power …; of
            shares the test is "likelihood ratio".
        """
        return self.omnibus.copy()

    def pairs(self) -> pd.DataFrame:
        """
        Return the power of each pairwise comparison, two-sided.

        Returns
        -------
        pandas.DataFrame
            A row per cell, pair and adjustment: n, effect_size, correlation, epsilon, a, b, d_z,
            adjust ("none", "bonferroni", "holm"), power, ci_low, ci_high, replicates, closed_form
            (noncentral t; NaN for Holm's).
        """
        return self.pairwise.copy()

    def claims(self) -> pd.DataFrame:
        """
        Return the probability that one study finds F and all claimed pairs, each in the
        population's direction.

        Returns
        -------
        pandas.DataFrame
            A row per cell and adjustment: n, effect_size, correlation, epsilon, adjust, claims (how
            many pairs), power, ci_low, ci_high, replicates, expected_found (mean number of claimed
            pairs found). No rows without claims.
        """
        return self.together.copy()

    @property
    def origin(self) -> str:
        """Where these numbers come from, for headers and captions."""
        return self.conditions.simulated_origin

    def plot(self, against: str | None = None, test: str | Sequence[str] = USUAL_TEST, axes=None):
        """
        Plot the power of the omnibus F with its Monte-Carlo intervals; crosses mark the closed
        form.

        Parameters
        ----------
        against : {"n", "effect_size", "correlation", "epsilon"}, optional
            The horizontal axis; by default the first that takes several values. A line per
            combination of the others.
        test : {"greenhouse-geisser", "huynh-feldt", "none", "auto"} or sequence of them
            Which test, or several to compare.
        axes : matplotlib.axes.Axes, optional
            Where to draw.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ValueError
            If an argument is none of those.
        """
        tests = [test] if isinstance(test, str) else list(test)
        for name in tests:
            one_of("test", name, TESTS)
        tests = (
            ["likelihood ratio"] if isinstance(self.conditions, Proportions | Ratings) else tests
        )
        against = against or (self.varied[0] if self.varied else "n")
        one_of("against", against, AXES)
        axes = axes_or_new(axes, figsize=(6.0, 3.8))
        others = [name for name in self.varied if name != against]
        table = self.omnibus[self.omnibus["test"].isin(tests)]
        # Values as computed differ in the last bits between the cells of one line.
        keys = table[others].round(9).assign(test=table["test"])
        for (*values, name), part in table.groupby(keys.apply(tuple, axis=1), sort=False):
            part = part.sort_values(against)
            words = [
                value if axis == "effect" else f"{AXES[axis]} {value + 0.0:.3g}"
                for axis, value in zip(others, values, strict=True)
            ]
            label = ", ".join(words + [name] * (len(tests) > 1))
            x, power = part[against].to_numpy(), part["power"].to_numpy()
            bars = np.maximum([power - part["ci_low"], part["ci_high"] - power], 0.0)
            drawn = axes.errorbar(
                x, power, bars, fmt="o-", ms=4, lw=1.3, capsize=3, label=label or None
            )
            if part["closed_form"].notna().any():
                axes.plot(x, part["closed_form"], "x", ms=8, color=drawn[0].get_color())
        axes.axhline(self.alpha, color="0.6", lw=0.8, ls=":")
        axes.set(xlabel=AXES[against], ylabel="power", ylim=(-0.02, 1.02))
        axes.set_title(
            f"{self.origin}: F, correction “{', '.join(tests)}”, level {self.alpha:g}, "
            f"{100 * self.level:g} % Monte-Carlo intervals",
            fontsize="small",
        )
        if others or len(tests) > 1:
            axes.legend(fontsize="small")
        return axes

    def __repr__(self) -> str:
        cells = len(self.omnibus) // len(TESTS)
        return (
            f"PowerAnalysis({cells} cell(s) of {self.replicates} {self.origin}, alpha "
            f"{self.alpha:g})"
        )

    def _repr_html_(self) -> str:
        words = (
            f"{self.replicates} per cell, level {self.alpha:g}, {100 * self.level:g} % "
            "Monte-Carlo intervals"
        )
        parts = [part for part in (self.omnibus, self.pairwise, self.together) if len(part)]
        return as_html(words, *parts, title=f"Power, {self.origin}")


def power_analysis(
    mean: Any = None,
    covariance: Any = None,
    *,
    data: pd.DataFrame | None = None,
    columns: StudyColumns = USUAL_COLUMNS,
    n: int | Sequence[int] = 36,
    effect_size: float | Sequence[float] | None = None,
    correlation: float | Sequence[float] | None = None,
    epsilon: float | Sequence[float] | None = None,
    claims: Sequence[tuple] | None = None,
    simulation: Simulation = USUAL_SIMULATION,
) -> PowerAnalysis:
    """
    Simulate studies drawn from a normal population and count how many find its effects.

    The population has the given means and covariance, or those of `data`: a pilot study, a virtual
    study, or data reconstructed from printed statistics. Each study is analysed as
    `repeated_measures` does. Power at the effect that a study itself has estimated ("observed
    power") restates its p-value and says nothing more about it.

    Parameters
    ----------
    mean : array_like, shape (k,), mapping, Series, Proportions or Ratings, optional
        Means of the conditions, named by a mapping or Series. With several factors or groups
        (`columns`) it is a Series indexed by their levels. `Proportions` of trials and `Ratings`
        in ordered categories stand for populations that need no covariance.
    covariance : array_like, shape (k, k), optional
        Their covariance; `graded_covariance` makes one with a chosen correlation and ε.
    data : pandas.DataFrame, optional
        A long table, from which both are estimated; only the covariance where means are given too.
    columns : StudyColumns
        Columns of `data`; factors within and between subjects.
    n : int or sequence of int
        Subjects; at least 3. With groups, in each of them.
    effect_size : float or sequence of float, optional
        Partial η² of the population: means keep their pattern and are scaled about their mean. When
        left out, means are used as given.
    correlation, epsilon : float or sequence of float, optional
        Replace the covariance by `graded_covariance` of the same mean variance; what is left out
        stays as it is.
    claims : sequence of (a, b), optional
        Pairs that must be found together with F, in the direction of the population's difference.
    simulation : Simulation
        Replicates, seed, levels, and where studies are simulated.

    Returns
    -------
    PowerAnalysis
        With several factors, groups or proportions, effect_size, correlation, epsilon and claims
        have no effect and are refused.

    Raises
    ------
    ValueError
        If means and covariance do not fit together, the covariance is not positive definite (the
        eigenvalue is named), n is too small, or another argument is out of range.

    Examples
    --------
    >>> from trustlab.studies import Simulation, graded_covariance
    >>> quick = Simulation(replicates=1000)
    >>> power = power_analysis([0.0, 0.3, 0.6], graded_covariance(3), n=20, simulation=quick)
    >>> power.table()["test"].tolist()
    ['none', 'greenhouse-geisser', 'huynh-feldt', 'auto']
    """
    of_class("columns", columns, StudyColumns)
    of_class("simulation", simulation, Simulation)
    proportions = isinstance(mean, Proportions | Ratings)
    if proportions or len(columns.factors) > 1 or columns.groups:
        idle = {
            "effect_size": effect_size,
            "correlation": correlation,
            "epsilon": epsilon,
            "claims": claims,
        }
        if proportions:
            idle |= {"covariance": covariance, "data": data}
        _refuse_idle(idle)
        several = mean if proportions else population_of(mean, covariance, data, columns)
        return _power_of_effects(several, _listed("n", n), simulation)
    population = conditions_from(mean, covariance, data, columns)
    mask = claims_mask(claims, population)
    axes = zip(AXES, (n, effect_size, correlation, epsilon), strict=True)
    grid = [_listed(name, values) for name, values in axes]
    studies = _cells(population, grid)
    # A key of whole numbers, not of computed moments, whose last bits differ between machines: all
    # populations of a size share their draws, which also makes them easier to compare.
    cells = [
        (cell, size, SeedSequence(simulation.seed, spawn_key=(size,))) for size, cell in studies
    ]
    counted = run_counts(count_findings, cells, simulation, claims=mask)
    parts = [
        _rows(cell, size, counts, simulation, mask)
        for (size, cell), counts in zip(studies, counted, strict=True)
    ]
    tables = _tables(parts, population.simulated_origin)
    varied = tuple(name for name, values in zip(AXES, grid, strict=True) if len(values) > 1)
    return _power(population, simulation, varied, *tables)


def _power(population, simulation: Simulation, varied: tuple, *tables) -> PowerAnalysis:
    """Return the result with its settings beside its tables."""
    s = simulation
    return PowerAnalysis(population, s.alpha, s.replicates, s.level, s.seed, varied, *tables)


def _listed(name: str, value: Any) -> list:
    """Return one value or a sequence of them as a list; None stays None."""
    if np.ndim(value) == 0:  # as of None, a text or a dict, which are refused where they are used
        return [value]
    values = list(value)
    if not values:
        raise ValueError(f"{name} is empty: give a number or several")
    return values


def _tables(parts: list[tuple], origin: str) -> list[pd.DataFrame]:
    """Return the tables of F, of pairs and of claims from the rows of every cell."""
    tables = []
    for rows, names in zip(zip(*parts, strict=True), COLUMNS, strict=True):
        tables.append(pd.DataFrame(list(chain.from_iterable(rows)), columns=[*AXES, *names]))
        tables[-1].attrs["origin"] = origin
    return tables


def _power_of_effects(
    population: NormalCells | Proportions | Ratings, n: list, simulation: Simulation
) -> PowerAnalysis:
    """Return the power of every effect with each n participants in a group."""
    sizes = _sizes(n)
    cells = [(population, size, SeedSequence(simulation.seed, spawn_key=(size,))) for size in sizes]
    counted = run_counts(count_effects, cells, simulation)
    table = effects_power(population, sizes, counted, simulation)
    table.attrs["origin"] = population.simulated_origin
    empty = pd.DataFrame()
    return _power(population, simulation, ("n", "effect"), table, empty, empty)


def _refuse_idle(arguments: dict[str, Any]) -> None:
    """Refuse arguments that would have no effect on this kind of power."""
    for name, value in arguments.items():
        if value is not None:
            raise ValueError(f"{name} has no effect here; leave it out")


def _sizes(values: list) -> list[int]:
    """Return numbers of subjects that a design can have."""
    sizes = [whole_number("n", size, most=MOST_N) for size in values]
    if min(sizes) < 3:
        raise ValueError(
            f"n = {min(sizes)} is too small for the design: repeated measures need at least 3 "
            "subjects"
        )
    return sizes


def _cells(population: Conditions, grid: list[list]) -> list[tuple[int, Conditions]]:
    """Return subjects and population of every cell of n × effect_size × correlation × epsilon."""
    sizes = _sizes(grid[0])
    shapes = [population.with_structure(*pair) for pair in product(*grid[2:])]
    effects = [
        shape if effect is None else shape.with_effect(effect)
        for effect, shape in product(grid[1], shapes)
    ]
    cells = list(product(sizes, effects))
    if len(cells) > MOST_CELLS:
        raise ValueError(
            f"{len(cells)} cells are too many for one call, at most {MOST_CELLS}; split the grid"
        )
    return cells


def _rows(cell: Conditions, n: int, counts: dict, simulation: Simulation, mask: Any) -> tuple:
    """
    Return the rows of the three tables for one cell, from the counts of its simulated studies.
    """
    k = len(cell.mean)
    alpha = simulation.alpha
    replicates = simulation.replicates
    axes = (n, cell.eta2_partial, cell.correlation, cell.epsilon)
    strength = noncentrality(cell.eta2_partial, n, k)
    exact = noncentral_f_power(n, k, strength, alpha) if cell.epsilon > 1.0 - 1e-9 else np.nan

    # All limits at once: one call takes a quarter of a millisecond, however many counts it gets.
    keys = [key for key in counts if key.startswith(("F ", "pair ", "claims "))]
    totals = [counts[key] for key in keys]
    ends = np.transpose(clopper_pearson(totals, replicates, simulation.level))
    limits = dict(zip(keys, ends.tolist(), strict=True))

    def power(key: str) -> tuple[float, float, float, int]:
        return counts[key] / replicates, *limits[key], replicates

    omnibus = [
        (*axes, strength, test, *power(f"F {test}"), exact if test == "none" else np.nan)
        for test in TESTS
    ]
    pairs, together = [], []
    levels = {"none": alpha, "bonferroni": alpha / len(cell.d_z)}  # Holm's has no closed form
    for i, (pair, d_z) in enumerate(zip(combinations(cell.labels, 2), cell.d_z, strict=True)):
        for name in ADJUSTMENTS:
            closed = (
                noncentral_f_power(n, 2, n * d_z**2, levels[name]) if name in levels else np.nan
            )
            pairs.append((*axes, *pair, d_z, name, *power(f"pair {i} {name}"), closed))
    if mask is not None:
        for name in ADJUSTMENTS:
            expected = counts[f"claimed {name}"] / replicates
            together.append((*axes, name, int(mask.sum()), *power(f"claims {name}"), expected))
    return omnibus, pairs, together


def run_counts(
    task: Callable, cells: Sequence[tuple], simulation: Simulation, **more: Any
) -> list[dict]:
    """
    Return what a task counts in each cell (population, n, draws), with the same further arguments
    for all.
    """
    from trustlab.campaign import CampaignError, run_campaign

    fixed = {"replicates": simulation.replicates, "alpha": simulation.alpha, **more}
    parameters = [
        {"population": population, "n": n, "draws": draws, **fixed}
        for population, n, draws in cells
    ]
    done = run_campaign(task, parameters, n_jobs=simulation.n_jobs)
    if done["failed"].any():
        raise CampaignError(
            f"studies could not be simulated: {done.loc[done['failed'], 'error'].iloc[0]}"
        )
    return done.to_dict("records")


def count_findings(
    population: Conditions,
    n: int,
    draws: SeedSequence,
    replicates: int,
    alpha: float,
    claims: Any,
    seed: SeedSequence,
) -> dict[str, int]:
    """
    Draw studies from a normal population, analyse each, and count those that are significant: a
    task of `run_campaign`.

    Keys: "F test" by `TESTS`; "pair i adjustment", pairs a < b in order; and where `claims` says
    which pairs are claimed, "claims adjustment" (F under `USUAL_TEST` and every claimed pair in the
    claimed direction) and "claimed adjustment" (claimed pairs found, summed over studies). `draws`
    is the seed: which one belongs to which study size is the caller's choice.
    """
    rng = np.random.default_rng(draws)
    k = len(population.mean)
    root = np.linalg.cholesky(population.covariance).T
    a, b = np.triu_indices(k, 1)
    expected = np.sign(population.mean[a] - population.mean[b])
    counts: Counter = Counter()
    for part in chunks(replicates, n * k):
        scores = rng.standard_normal((len(part), n, k)) @ root + population.mean
        tests = effects(scores, Design(n, {"condition": population.labels}))
        pairs = condition_pairs(scores)
        # An undefined p of Mauchly's test (n ≤ k − 1) counts as a rejection, as in
        # `repeated_measures`; of two conditions all p are the same.
        p, mauchly_p, p_gg, p_hf = tests[["p", "mauchly_p", "p_gg", "p_hf"]].to_numpy().T
        p_values = (p, p_gg, p_hf, np.where(mauchly_p >= alpha, p, p_gg))
        findings = {test: p < alpha for test, p in zip(TESTS, p_values, strict=True)}
        for test, found in findings.items():
            counts[f"F {test}"] += int(found.sum())
        for name, attribute in ADJUSTMENTS.items():
            hits = getattr(pairs, attribute) < alpha
            for i, found in enumerate(hits.sum(axis=0)):
                counts[f"pair {i} {name}"] += int(found)
            if claims is not None:
                right = hits & (np.sign(pairs.mean_difference) == expected)
                counts[f"claims {name}"] += int(
                    (right[:, claims].all(axis=1) & findings[USUAL_TEST]).sum()
                )
                counts[f"claimed {name}"] += int(right[:, claims].sum())
    return dict(counts)


def claims_mask(claims: Sequence[tuple] | None, conditions: Conditions) -> np.ndarray | None:
    """Return which pairs are claimed, over all pairs a < b; None without claims."""
    if claims is None:
        return None
    labels = list(conditions.labels)
    pairs = list(combinations(labels, 2))
    mask = np.zeros(len(pairs), dtype=bool)
    if isinstance(claims, str | bytes) or not hasattr(claims, "__iter__"):
        raise ValueError(f"claims must be a list of pairs of conditions, got {claims!r:.60}")
    for pair in claims:
        if (
            isinstance(pair, str)
            or not hasattr(pair, "__len__")
            or len(pair) != 2
            or pair[0] == pair[1]
        ):
            raise ValueError(f"a comparison is a pair of two conditions (a, b), got {pair!r:.60}")
        for label in pair:
            if label not in labels:
                there = ", ".join(map(str, labels))
                raise ValueError(
                    f"unknown condition {label!r}{did_you_mean(label, labels)} (there are {there})"
                )
        where = pairs.index(tuple(sorted(pair, key=labels.index)))
        if mask[where]:
            raise ValueError(f"pair {pair!r} is claimed twice")
        mask[where] = True
    if not mask.any():
        raise ValueError("claims is empty: give pairs of conditions, or leave it out")
    return mask
