"""
The power of within-subject, factorial and mixed designs by studies drawn from populations of
conditions, and the smallest n that reaches a power.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence
from numpy.typing import ArrayLike
from scipy import special

from trustlab.models.checks import (
    list_of,
    of_class,
    one_of,
    open_unit,
    set_checked,
    shown,
    whole_number,
    whole_seed,
)
from trustlab.models.display import axes_or_new
from trustlab.studies.anova import effect_name, effects, orthonormal_contrasts, regress
from trustlab.studies.designs import participants_needed
from trustlab.studies.pairs import bonferroni, differences, holm, level_pairs
from trustlab.studies.population import (
    USUAL_COLUMNS,
    Conditions,
    StudyColumns,
    factors_of,
    population_of,
)
from trustlab.studies.table import Tested, labelled
from trustlab.studies.words import apa_number, share

# What power is computed against, and how a figure labels it.
AXES = {
    "n": "participants n",
    "effect": "effect",
    "effect_size": "population partial η²",
    "epsilon": "ε of the population",
}
# Corrections of the omnibus F by the name of their p-value, and adjustments of the pairs.
TESTS = {"none": "p", "greenhouse-geisser": "p_gg", "huynh-feldt": "p_hf"}
ADJUSTMENTS: dict[str, Any] = {"none": np.asarray, "bonferroni": bonferroni, "holm": holm}
# The correction that `repeated_measures` makes by default.
USUAL_TEST = "greenhouse-geisser"
MOST_N = 100_000
# Scores drawn at once.
SCORES = 1 << 20


@dataclass(frozen=True)
class Simulation:
    """
    How studies are simulated and tested.

    Parameters
    ----------
    replicates : int
        Simulated studies per cell, at least 100.
    seed : int
        Seed of the draws. All populations of a size share their draws, whatever their place in
        a grid.
    alpha : float
        Level of all tests, in (0, 1).
    level : float
        Coverage of the Monte-Carlo intervals (Clopper–Pearson), in (0, 1).

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    replicates: int = 10_000
    seed: int = 0
    alpha: float = 0.05
    level: float = 0.95

    def __post_init__(self):
        set_checked(self, open_unit, "alpha", "level")
        replicates = whole_number("replicates", self.replicates, least=100, most=10_000_000)
        self.__dict__.update(replicates=replicates, seed=whole_seed(self.seed))


USUAL_SIMULATION = Simulation()


# --- studies --------------------------------------------------------------------------------------


def clopper_pearson(count: ArrayLike, total: int, level: float = 0.95) -> tuple[Any, Any]:
    """
    Return the exact interval of a share of which `count` in `total` draws were found (Clopper and
    Pearson, 1934).

    Parameters
    ----------
    count : array_like of int
        How often, from 0 to `total`.
    total : int
        Draws.
    level : float
        Coverage.

    Returns
    -------
    low, high : float or numpy.ndarray
        Limits, of the shape of `count`.

    Raises
    ------
    ValueError
        If a count is not whole or lies outside 0 to `total`.
    """
    total, level = whole_number("total", total, most=10**15), open_unit("level", level)
    counts = np.asarray(count)
    if counts.dtype.kind not in "iu" or ((counts < 0) | (counts > total)).any():
        raise ValueError(f"count must hold whole numbers from 0 to {total}, got {count!r:.60}")
    from statsmodels.stats.proportion import proportion_confint

    return proportion_confint(counts, total, alpha=1.0 - level, method="beta")


def simulated(
    population: Conditions, n: int, simulation: Simulation, claims: np.ndarray | None
) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """
    Draw studies from a normal population, and return power and its interval: of F by effect and
    test, its correction; of claimed pairs, if there are any, by what is found and adjust.

    "pairs" are found where all are significant, "claims" where they are so in the population's
    direction, and F as well.
    """
    # By n alone: all populations of a size share their draws, which makes them easier to compare.
    rng = np.random.default_rng(SeedSequence(simulation.seed, spawn_key=(n,)))
    shape = (n * population.groups, len(population.labels))
    rejected, found = [], []
    # In parts, so that memory does not grow with the number of studies.
    step = max(1, SCORES // math.prod(shape))
    for first in range(0, simulation.replicates, step):
        size = (min(step, simulation.replicates - first), *shape)
        scores, design = population.study(rng.standard_normal(size))
        tests = effects(scores, design)[[*TESTS.values()]] < simulation.alpha
        rejected.append(tests.to_numpy().reshape(len(scores), -1).sum(axis=0))
        if claims is None:
            continue
        _, *weights = level_pairs(design, *design.within)
        difference, se, _ = differences(regress(scores, design), *weights)
        p = 2.0 * special.stdtr(n - 1, -np.abs(difference / se))
        right = difference * (population.mean @ weights[1]) > 0.0
        right &= tests[[TESTS[USUAL_TEST]]].to_numpy()
        pairs = np.array([adjusted(p) < simulation.alpha for adjusted in ADJUSTMENTS.values()])
        hits = np.array([pairs, pairs & right])[..., claims].all(axis=-1)
        found.append(hits.sum(axis=-1).ravel())
    names = {"effect": map(effect_name, design.hypotheses), "test": TESTS}
    of_claims = {"found": ["pairs", "claims"], "adjust": ADJUSTMENTS}
    return (
        _shares(sum(rejected), simulation, names),
        _shares(sum(found), simulation, of_claims) if found else None,
    )


def _shares(hits: Any, simulation: Simulation, names: dict[str, Any]) -> pd.DataFrame:
    """Return the shares of hits and their intervals, a row for each combination of names."""
    low, high = clopper_pearson(hits, simulation.replicates, simulation.level)
    columns = {"power": hits / simulation.replicates, "ci_low": low, "ci_high": high}
    return pd.DataFrame(columns, pd.MultiIndex.from_product(names.values(), names=names))


def exact_tests(population: Conditions, n: int, alpha: float) -> pd.DataFrame:
    """
    Return the effects of a study that has exactly the means and covariance of the population, and
    the power of F by the noncentral F, which holds under sphericity; elsewhere it is NaN.
    """
    k = len(population.labels)
    # Orthogonal noise: the covariance within a group is the population's.
    noise = np.tile(np.sqrt(k) * orthonormal_contrasts(k + 1), (population.groups, 1))
    scores, design = population.study(noise)
    tests = effects(scores[None], design).loc[0].reset_index()
    df1, df2, epsilon = tests["df1"], tests["df2"] * (n - 1) / k, tests["epsilon_gg"]
    strength = tests["F"] * df1 * n / (k + 1)
    strength = strength.where(strength > 1e-12, 0.0)  # less is the rounding of no effect
    critical = special.fdtri(df1, df2, 1.0 - alpha)
    power = 1.0 - special.ncfdtr(df1, df2, strength, critical)
    columns = {
        "n": n,
        "effect": tests["effect"],
        "effect_size": strength / (strength + tests["df2"] * n / k),
        "correlation": population.correlation,
        "epsilon": epsilon,
        "noncentrality": strength,
        "closed_form": power.where(epsilon > 1.0 - 1e-9),
    }
    return pd.DataFrame(columns)


def claims_mask(argument: str, claims: Any, population: Conditions) -> np.ndarray | None:
    """Return which pairs are claimed, over all pairs a < b; None without claims."""
    if claims is None:
        return None
    given = claims if isinstance(claims, list | tuple) else [claims]
    claimed = [tuple(pair) for pair in given if isinstance(pair, list | tuple)]
    pairs = combinations(zip(population.labels, population.mean, strict=True), 2)
    # Between equal means there is no direction.
    mask = [m != n and ((a, b) in claimed or (b, a) in claimed) for (a, m), (b, n) in pairs]
    if not 0 < len(given) == sum(mask):
        raise ValueError(
            f"{argument}: {shown(claims)} is no list of different pairs (a, b) of "
            f"{[*population.labels]} whose means differ"
        )
    return np.array(mask)


# --- power ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class PowerAnalysis(Tested):
    """
    Power of every F, and of F with all claimed pairs, by simulation.

    Parameters
    ----------
    population : Conditions
        The population, before it is varied.
    simulation : Simulation
        Replicates, seed and levels.
    tests : pandas.DataFrame
        The power of every F, which `table()` returns: a row per cell, effect and test: n (in each
        group), effect, effect_size (partial η² of the population), correlation, epsilon,
        noncentrality, test ("none", "greenhouse-geisser", "huynh-feldt"), power, ci_low, ci_high,
        replicates, closed_form (noncentral F; NaN where sphericity does not hold or the test is
        corrected).
    together : pandas.DataFrame
        What `claims()` returns.
    """

    population: Conditions
    simulation: Simulation
    tests: pd.DataFrame
    together: pd.DataFrame

    def claims(self) -> pd.DataFrame:
        """
        Return the probability that one study finds F and all claimed pairs, each in the
        population's direction.

        Returns
        -------
        pandas.DataFrame
            A row per cell and adjustment: n, effect_size, epsilon, adjust, power, ci_low, ci_high,
            claims (how many pairs). No rows without claims.
        """
        return self.together.copy()

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
        Plot the power of F with its Monte-Carlo intervals against the first column that takes
        several values, a line per combination of the others; crosses mark the closed form.

        Parameters
        ----------
        test : {"greenhouse-geisser", "huynh-feldt", "none"} or sequence of them
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
        tests = [test] if isinstance(test, str) else list_of("test", test)
        for name in tests:
            one_of("test", name, TESTS)
        # Values as computed differ in the last bits between the cells of one line.
        table = self.tests.round(9)
        several = len({*table["effect"]}) > 1
        counts = table[["n", "effect"] if several else ["n", "effect_size", "epsilon"]].nunique()
        against, *others = [*counts.index[counts > 1]] or ["n"]
        table = table[table["test"].isin(tests)].sort_values(against, kind="stable")
        axes = axes_or_new(axes, figsize=(6.0, 3.8))
        for values, part in table.groupby([*others, "test"]):
            x, power, label = part[against], part["power"], ", ".join(map(str, values))
            ends = [power - part["ci_low"], part["ci_high"] - power]
            drawn = axes.errorbar(x, power, ends, fmt="o-", capsize=3, label=label)
            axes.plot(x, part["closed_form"], "x", ms=8, color=drawn[0].get_color())
        axes.set(xlabel=AXES[against], ylabel="power of F", ylim=(-0.02, 1.02))
        axes.set_title(f"{self.origin}; level {self.simulation.alpha:g}", fontsize="small")
        axes.legend(fontsize="small", title=", ".join([*map(AXES.get, others), "test"]))
        return axes


def power_analysis(
    mean: Any = None,
    covariance: Any = None,
    *,
    data: pd.DataFrame | None = None,
    columns: StudyColumns = USUAL_COLUMNS,
    n: int | Sequence[int] = 36,
    effect_size: float | Sequence[float] | None = None,
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
    epsilon : float or sequence of float, optional
        Replaces the covariance by `graded_covariance` of the same mean variance and correlation.
    claims : sequence of (a, b), optional
        Pairs that must be found together with F, in the direction of the population's difference,
        of which each has one.
    simulation : Simulation
        Replicates, seed and levels.

    Returns
    -------
    PowerAnalysis
        With several factors or groups effect_size, epsilon and claims have no effect
        and are refused.

    Raises
    ------
    ValueError
        If means and covariance do not fit together, the covariance is not positive definite (the
        eigenvalue is named), n is too small, or another argument is out of range.

    Examples
    --------
    >>> import trustlab as tl
    >>> from trustlab.studies import Simulation, graded_covariance
    >>> quick = Simulation(replicates=1000)
    >>> power = tl.power_analysis([0.0, 0.3, 0.6], graded_covariance(3), n=20, simulation=quick)
    >>> power.table()["test"].tolist()
    ['none', 'greenhouse-geisser', 'huynh-feldt']
    """
    of_class("simulation", simulation, Simulation)
    population = population_of(mean, covariance, data, columns)
    options = (effect_size, epsilon, claims)
    if len(factors_of(columns)) > 1 and any(option is not None for option in options):
        raise ValueError("effect_size, epsilon and claims are for one factor; leave them out")
    mask = claims_mask("claims", claims, population)
    # None, a text or a dict are one value, which is refused where it is used.
    grid: Any = [value if np.ndim(value) else [value] for value in (n, effect_size, epsilon)]
    tables, together = [], [pd.DataFrame()]
    for size, eta2, eps in product(*grid):
        size = whole_number("n", size, least=3, most=MOST_N)
        people = population if eps is None else population.with_epsilon(eps)
        people = people if eta2 is None else people.with_effect(eta2)
        of_f, of_claims = simulated(people, size, simulation, mask)
        exact = exact_tests(people, size, simulation.alpha)
        table = exact.merge(of_f.reset_index(), on="effect")
        closed = table.pop("closed_form").where(table["test"] == "none")
        tables.append(table.assign(replicates=simulation.replicates, closed_form=closed))
        if of_claims is not None:
            claimed = of_claims.loc["claims"].reset_index().assign(claims=len(claims))
            together.append(exact[["n", "effect_size", "epsilon"]].merge(claimed, how="cross"))
    if not tables:
        raise ValueError("n, effect_size or epsilon is empty: give a number")
    origin, level = population.simulated_origin, simulation.level
    return PowerAnalysis(
        population,
        simulation,
        labelled(pd.concat(tables, ignore_index=True), origin, confidence=level),
        labelled(pd.concat(together, ignore_index=True), origin, confidence=level),
    )


# --- the smallest n -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class SmallestN(Tested):
    """
    The smallest number of subjects whose simulated power reaches what was wanted.

    Columns of `table` are attributes too: test, which one; wanted, the power to reach; n, subjects;
    power, ci_low and ci_high, simulated power there and its Monte-Carlo interval; whole_squares,
    the next number that fills whole Latin squares of the conditions.

    Parameters
    ----------
    tests : pandas.DataFrame
        What `table` returns, a row.
    population : Conditions
        Means and covariance that were assumed.
    simulation : Simulation
        How studies were simulated.
    """

    title = "Smallest number of participants"

    tests: pd.DataFrame
    population: Conditions
    simulation: Simulation

    def apa(self) -> str:
        """
        Return the sentences of a methods section: the number, and all that was assumed for it.
        """
        people, simulation = self.population, self.simulation
        sds = np.sqrt(np.diag(people.covariance))
        rows = zip(people.labels, people.mean, sds, strict=True)
        conditions = ", ".join(f"{label} {mean:.4g} ({sd:.3g})" for label, mean, sd in rows)
        source = f" The covariance is that of {people.origin}." if people.origin else ""
        return (
            f"A sample of {self.n} participants ({self.whole_squares} to fill whole Latin squares) "
            f"has a power of {share(self.power)} "
            f"({100 * simulation.level:g}% CI [{share(self.ci_low)}, "
            f"{share(self.ci_high)}]) in {simulation.replicates} simulated "
            f"studies (seed {simulation.seed}), for the test {self.test} at α = "
            f"{simulation.alpha:g}. Assumed means (SDs) are {conditions}, with a mean correlation "
            f"of {apa_number(people.correlation)} between conditions.{source} Standard deviations "
            "twice as large would ask for about four times as many."
        )


def smallest_n(
    power: float = 0.8,
    mean: Any = None,
    covariance: Any = None,
    *,
    data: pd.DataFrame | None = None,
    columns: StudyColumns = USUAL_COLUMNS,
    effect_size: float | None = None,
    pair: tuple | None = None,
    test: str | None = None,
    most: int = 2000,
    simulation: Simulation = USUAL_SIMULATION,
) -> SmallestN:
    """
    Return an n whose simulated power reaches `power` while that of n − 1 does not, by bisection.

    Every n has draws of its own from the seed, so that the answer is the same at every call. Within
    the Monte-Carlo error neighbouring n can be as good.

    Parameters
    ----------
    power : float
        The power to reach, in (0, 1).
    mean, covariance, data, columns : object
        The population, as for `power_analysis`, with one factor. Means given beside `data` replace
        those of the conditions that they name: an improvement of your own with a pilot's spread.
    effect_size : float, optional
        Partial η² of the population; as given when left out.
    pair : (a, b), optional
        Two conditions: the power of their comparison instead of that of F.
    test : str, optional
        Correction of F, "greenhouse-geisser" (by default), "huynh-feldt" or "none"; of a pair, the
        adjustment of its p-value, "holm" (by default), "bonferroni" or "none".
    most : int
        The largest n to try.
    simulation : Simulation
        As for `power_analysis`.

    Returns
    -------
    SmallestN

    Raises
    ------
    ValueError
        If an argument is out of range, or even `most` subjects do not reach the power.

    Examples
    --------
    >>> import trustlab as tl
    >>> from trustlab.studies import Simulation, graded_covariance
    >>> quick = Simulation(replicates=500)
    >>> plan = tl.smallest_n(0.8, [0.0, 0.3, 0.6], graded_covariance(3), simulation=quick)
    >>> plan.n
    30
    """
    of_class("simulation", simulation, Simulation)
    if len(factors_of(columns)) > 1:
        raise ValueError(
            "columns: smallest_n takes one factor within subjects; for several factors or groups "
            "compare values of n by power_analysis"
        )
    population = population_of(mean, covariance, data, columns)
    if effect_size is not None:
        population = population.with_effect(effect_size)
    target = open_unit("power", power)
    most = whole_number("most", most, least=3, most=MOST_N)
    mask = None if pair is None else claims_mask("pair", [pair], population)
    usual, tests = (USUAL_TEST, TESTS) if pair is None else ("holm", ADJUSTMENTS)
    test = one_of("test", usual if test is None else test, tests)
    effect, name = effect_name(population.within), "F"
    if pair is not None:
        effect, name = "pairs", f"{pair[0]} – {pair[1]}"

    @cache
    def found(n: int) -> dict[str, float]:
        of_f, of_pairs = simulated(population, n, simulation, mask)
        return (of_f if of_pairs is None else of_pairs).loc[(effect, test)].to_dict()

    low, high = 2, 3
    while found(high)["power"] < target:
        if high == most:
            raise ValueError(
                f"power: {most} subjects reach {found(most)['power']:.3g} only, "
                f"{target:g} was wanted. Raise most=, measure each condition more often, which "
                "makes people differ less, or look for a greater effect"
            )
        low, high = high, min(2 * high, most)
    while high - low > 1:
        n = (low + high) // 2
        low, high = (low, n) if found(n)["power"] >= target else (n, high)
    row = {"test": f"{name}, {test}", "wanted": target, "n": high, **found(high)}
    row["whole_squares"] = participants_needed(len(population.labels), high)
    origin, level = population.simulated_origin, simulation.level
    table = labelled(pd.DataFrame([row]), origin, confidence=level)
    return SmallestN(table, population, simulation)
