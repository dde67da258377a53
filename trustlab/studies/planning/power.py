"""
Power of within-subject, factorial and mixed designs by simulated studies, against n, effect size,
correlation and sphericity.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence

from trustlab.models.checks import of_class, one_of, shown, whole_number
from trustlab.models.display import axes_or_new
from trustlab.studies.anova import CORRECTIONS, effect_name, effects, regress, sphericity
from trustlab.studies.pairs import condition_pairs
from trustlab.studies.planning.conditions import (
    USUAL_COLUMNS,
    USUAL_SIMULATION,
    Conditions,
    Simulation,
    StudyColumns,
    clopper_pearson,
    conditions_from,
    exceeds_critical,
)
from trustlab.studies.table import Tested

# What power is computed against, and how a figure labels it.
AXES = {
    "n": "participants n",
    "effect": "effect",
    "effect_size": "population partial η²",
    "correlation": "correlation of conditions",
    "epsilon": "ε of the population",
}

MOST_N = 100_000

# Scores drawn at once.
SCORES = 1 << 20

# Corrections of the omnibus F; "auto" is Greenhouse–Geisser where Mauchly's test rejects.
TESTS = (*CORRECTIONS, "auto")

# The correction that `repeated_measures` makes by default.
USUAL_TEST = "greenhouse-geisser"

# Adjustments of the pairs' p-values, and their names in `Pairs`.
ADJUSTMENTS = {"none": "p", "bonferroni": "p_bonferroni", "holm": "p_holm"}


# --- simulated studies ----------------------------------------------------------------------------


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

    Keys: "effect/test"; of one factor also "pair i adjustment", pairs a < b in order; and where
    `claims` says which pairs are claimed, "claims adjustment" (F under `USUAL_TEST` and every
    claimed pair in the claimed direction) and "claimed adjustment" (claimed pairs found, summed
    over studies). `draws` is the seed: which one belongs to which study size is the caller's
    choice.
    """
    rng = np.random.default_rng(draws)
    groups, design = population.design(n)
    root = np.linalg.cholesky(population.covariance).T
    mean = np.atleast_2d(population.mean)[groups]
    counts: Counter = Counter()
    # In parts, so that memory does not grow with the number of studies.
    step = max(1, SCORES // mean.size)
    for first in range(0, replicates, step):
        size = (min(step, replicates - first), *mean.shape)
        scores = rng.standard_normal(size) @ root + mean
        tests = effects(scores, design)
        # An undefined p of Mauchly's test (n ≤ k − 1) counts as a rejection, as in
        # `repeated_measures`; of two conditions all p are the same.
        tests["p_auto"] = np.where(tests["mauchly_p"] >= alpha, tests["p"], tests["p_gg"])
        names = ("p", "p_gg", "p_hf", "p_auto")
        significant = (tests[[*names]] < alpha).set_axis(TESTS, axis=1)
        for effect, row in significant.groupby("effect").sum().iterrows():
            counts.update({f"{effect}/{test}": int(count) for test, count in row.items()})
        if not population.several:
            usual = significant[USUAL_TEST].to_numpy()
            counts.update(_pairs_found(scores, population, usual, alpha, claims))
    return dict(counts)


def _pairs_found(
    scores: np.ndarray, population: Conditions, usual: np.ndarray, alpha: float, claims: Any
) -> dict[str, int]:
    """Count significant pairs, and studies that find all claimed ones with F."""
    counts = {}
    pairs = condition_pairs(scores)
    a, b = np.triu_indices(len(population.labels), 1)
    right_way = np.sign(pairs.mean_difference) == np.sign(population.mean[a] - population.mean[b])
    for name, attribute in ADJUSTMENTS.items():
        hits = getattr(pairs, attribute) < alpha
        for i, count in enumerate(hits.sum(axis=0)):
            counts[f"pair {i} {name}"] = int(count)
        if claims is not None:
            right = (hits & right_way)[:, claims]
            counts[f"claims {name}"] = int((right.all(axis=1) & usual).sum())
            counts[f"claimed {name}"] = int(right.sum())
    return counts


def counted(
    cells: Sequence[tuple[int, Conditions]], simulation: Simulation, claims: Any = None
) -> list[dict]:
    """Return what `count_findings` counts in each cell, n and population."""
    from trustlab.campaign import CampaignError, run_campaign

    # A key of whole numbers, not of computed moments, whose last bits differ between machines: all
    # populations of a size share their draws, which also makes them easier to compare.
    parameters = [
        {
            "population": population,
            "n": n,
            "draws": SeedSequence(simulation.seed, spawn_key=(n,)),
            "replicates": simulation.replicates,
            "alpha": simulation.alpha,
            "claims": claims,
        }
        for n, population in cells
    ]
    done = run_campaign(count_findings, parameters, n_jobs=simulation.n_jobs)
    if done["failed"].any():
        raise CampaignError(
            f"studies could not be simulated: {done.loc[done['failed'], 'error'].iloc[0]}"
        )
    return done.to_dict("records")


# --- power ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class PowerAnalysis(Tested):
    """
    Power of the omnibus F, and of F with all claimed pairs, by simulation.

    Parameters
    ----------
    conditions : Conditions
        The population.
    simulation : Simulation
        Replicates, seed and levels.
    varied : tuple of str
        Axes of the grid for which several values were given; of several factors n and effect.
    tests, together : pandas.DataFrame
        What `table()` and `claims()` return.
    """

    conditions: Conditions
    simulation: Simulation
    varied: tuple[str, ...]
    tests: pd.DataFrame
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
            test: n (in each group), effect, eta2_partial (of the population), test, power ….
        """
        return super().table()

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

    @property
    def title(self) -> str:
        """What was simulated."""
        return f"Power, {self.origin}"

    @property
    def message(self) -> str:
        """How many studies, at which level."""
        of = self.simulation
        return (
            f"{of.replicates} per cell, level {of.alpha:g}, {100 * of.level:g} % Monte-Carlo "
            "intervals"
        )

    def plot(self, test: str | Sequence[str] = USUAL_TEST, axes=None):
        """
        Plot the power of the omnibus F with its Monte-Carlo intervals against the first axis that
        takes several values, a line per combination of the others; crosses mark the closed form.

        Parameters
        ----------
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
            If a test is none of those.
        """
        tests = [
            one_of("test", name, TESTS) for name in ([test] if isinstance(test, str) else test)
        ]
        against, *others = self.varied or ("n",)
        # Values as computed differ in the last bits between the cells of one line.
        table = self.tests.round(dict.fromkeys(others, 9)).sort_values(against)
        axes = axes_or_new(axes, figsize=(6.0, 3.8))
        for values, part in table[table["test"].isin(tests)].groupby([*others, "test"]):
            label = ", ".join(
                value if isinstance(value, str) else f"{AXES[axis]} {value + 0.0:.3g}"
                for axis, value in zip([*others, "test"], values, strict=True)
            )
            power = part["power"]
            bars = np.maximum([power - part["ci_low"], part["ci_high"] - power], 0.0)
            drawn = axes.errorbar(part[against], power, bars, fmt="o-", capsize=3, label=label)
            axes.plot(part[against], part["closed_form"], "x", ms=8, color=drawn[0].get_color())
        axes.set(xlabel=AXES[against], ylabel="power of F", ylim=(-0.02, 1.02))
        axes.set_title(f"{self.origin}; level {self.simulation.alpha:g}", fontsize="small")
        axes.legend(fontsize="small")
        return axes


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
    mean : array_like, shape (k,), mapping or Series, optional
        Means of the conditions, named by a mapping or Series. With several factors or groups
        (`columns`) it is a Series indexed by their levels.
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
        With several factors or groups effect_size, correlation, epsilon and claims have no effect
        and are refused.

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
    axes: dict[str, Any] = {
        "effect_size": effect_size,
        "correlation": correlation,
        "epsilon": epsilon,
    }
    if columns.several:
        for name, value in (axes | {"claims": claims}).items():
            if value is not None:
                raise ValueError(f"{name} has no effect here; leave it out")
    population = conditions_from(mean, covariance, data, columns)
    mask = claims_mask(claims, population)
    # None, a text or a dict are one value, which is refused where it is used.
    grid = {
        name: list(value) if np.ndim(value) else [value] for name, value in {"n": n, **axes}.items()
    }
    sizes = [whole_number("n", size, least=3, most=MOST_N) for size in grid["n"]]
    shapes = product(grid["effect_size"], grid["correlation"], grid["epsilon"])
    populations = [population.varied(*shape) for shape in shapes]
    cells = list(product(sizes, populations))
    if not cells:
        raise ValueError("n, effect_size, correlation or epsilon is empty: give a number")
    counts = counted(cells, simulation, mask)
    tables = []
    for rows_of in (_omnibus, _together):
        rows = [
            row
            for cell, of_cell in zip(cells, counts, strict=True)
            for row in rows_of(*cell, of_cell, mask, simulation)
        ]
        tables.append(with_intervals(rows, simulation))
        tables[-1].attrs["origin"] = population.simulated_origin
    varied = tuple(name for name, values in grid.items() if len(values) > 1)
    if columns.several:
        varied = ("n", "effect")
    return PowerAnalysis(population, simulation, varied, *tables)


def with_intervals(rows: list[dict], simulation: Simulation) -> pd.DataFrame:
    """Return a table with power and its interval in the place of counts."""
    table = pd.DataFrame(rows)
    if table.empty:
        return table
    names = list(table)
    place = names.index("count")
    names[place : place + 1] = ["power", "ci_low", "ci_high", "replicates"]
    count, total = table["count"].to_numpy(), simulation.replicates
    low, high = clopper_pearson(count, total, simulation.level)
    return table.assign(power=count / total, ci_low=low, ci_high=high, replicates=total)[names]


def _axes_of(n: int, cell: Conditions) -> dict[str, float]:
    """Return where in the grid a cell lies."""
    return {
        "n": n,
        "effect_size": cell.eta2_partial,
        "correlation": cell.correlation,
        "epsilon": cell.epsilon,
    }


def _omnibus(
    n: int, cell: Conditions, counts: dict, mask: Any, simulation: Simulation
) -> Iterator[dict]:
    """Yield the rows of F, by effect and test; closed forms need sphericity."""
    groups, design = cell.design(n)
    regression = regress(np.atleast_2d(cell.mean)[groups][None], design)
    for block, names in design.effects:
        contrasts, rows = design.contrasts(names), design.rows(block)
        d, variances = contrasts.shape[1], contrasts.T @ cell.covariance @ contrasts
        squares = float(regression.sum_of_squares(contrasts, rows)[0])
        strength = squares * d / np.trace(variances)
        closed = exceeds_critical(d * len(rows), d * design.df_error, strength, simulation.alpha)
        spherical = sphericity(variances, design.df_error)["epsilon_gg"] > 1.0 - 1e-9
        effect, eta2 = effect_name(block, names), strength / (strength + len(groups) * d)
        where = {"n": n, "effect": effect, "eta2_partial": eta2}
        if not cell.several:
            where = _axes_of(n, cell) | {"noncentrality": strength}
        for test in CORRECTIONS if cell.several else TESTS:
            form = closed if spherical and test == "none" else np.nan
            yield {**where, "test": test, "count": counts[f"{effect}/{test}"], "closed_form": form}


def _together(
    n: int, cell: Conditions, counts: dict, mask: Any, simulation: Simulation
) -> Iterator[dict]:
    """Yield the rows of all claims together, by adjustment."""
    for name in ADJUSTMENTS if mask is not None else ():
        row = _axes_of(n, cell) | {"adjust": name, "claims": int(mask.sum())}
        expected = counts[f"claimed {name}"] / simulation.replicates
        yield row | {"count": counts[f"claims {name}"], "expected_found": expected}


def claims_mask(claims: Sequence[tuple] | None, conditions: Conditions) -> np.ndarray | None:
    """Return which pairs are claimed, over all pairs a < b; None without claims."""
    if claims is None:
        return None
    labels = conditions.labels
    pairs = [{a, b} for a, b in combinations(labels, 2)]
    mask = np.zeros(len(pairs), dtype=bool)
    for pair in claims if isinstance(claims, list | tuple) else [claims]:
        if not isinstance(pair, list | tuple) or set(pair) not in pairs or len(pair) > 2:
            raise ValueError(f"claims must be pairs (a, b) of {[*labels]}, got {shown(pair)}")
        if mask[pairs.index(set(pair))]:
            raise ValueError(f"pair {pair!r} is claimed twice")
        mask[pairs.index(set(pair))] = True
    if not mask.any():
        raise ValueError("claims is empty: give pairs of conditions, or leave it out")
    return mask
