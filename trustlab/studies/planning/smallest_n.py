"""The smallest study of a given power: bisection on simulated power, begun at the closed form."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, one_of, open_unit, whole_number
from trustlab.studies.designs import participants_needed
from trustlab.studies.planning.conditions import (
    USUAL_COLUMNS,
    USUAL_SIMULATION,
    Conditions,
    Simulation,
    StudyColumns,
    conditions_from,
    exceeds_critical,
)
from trustlab.studies.planning.power import (
    ADJUSTMENTS,
    MOST_N,
    TESTS,
    USUAL_TEST,
    claims_mask,
    counted,
    with_intervals,
)
from trustlab.studies.table import Tested, labelled
from trustlab.studies.words import apa_number


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
    n_by_spread : dict of str to int
        By noncentral F: what "half" and "twice" the standard deviations would ask for.
    population : Conditions
        Means and covariance that were assumed.
    simulation : Simulation
        How studies were simulated.
    evaluations : pandas.DataFrame
        Every n that was simulated: n, power, ci_low, ci_high; n − 1 is among them, unless n is the
        least possible, 3.
    """

    title = "Smallest number of participants"

    tests: pd.DataFrame
    n_by_spread: dict[str, int | None]
    population: Conditions
    simulation: Simulation
    evaluations: pd.DataFrame

    @property
    def origin(self) -> str:
        """Where the numbers come from, for headers and captions."""
        return self.population.simulated_origin

    @property
    def message(self) -> str:
        """Where the numbers come from."""
        return self.origin

    def apa(self) -> str:
        """
        Return the sentences of a methods section: the number, and all that was assumed for it.
        """
        people, simulation = self.population, self.simulation
        sds = np.sqrt(np.diag(people.covariance))
        rows = zip(people.labels, people.mean, sds, strict=True)
        conditions = ", ".join(f"{label} {mean:.4g} ({sd:.3g})" for label, mean, sd in rows)
        half, twice = (n or "too many" for n in self.n_by_spread.values())
        source = f" The covariance is that of {people.origin}." if people.origin else ""
        return (
            f"A sample of {self.n} participants ({self.whole_squares} to fill whole Latin squares) "
            f"has a power of {apa_number(self.power, below_one=True)} "
            f"({100 * simulation.level:g}% CI [{apa_number(self.ci_low, below_one=True)}, "
            f"{apa_number(self.ci_high, below_one=True)}]) in {simulation.replicates} simulated "
            f"studies (seed {simulation.seed}), for the test {self.test} at α = "
            f"{simulation.alpha:g}. Assumed means (SDs) are {conditions}, with a mean correlation "
            f"of {apa_number(people.correlation)} between conditions.{source} With standard "
            f"deviations half or twice as large, n would be about {half} or {twice} (noncentral F)."
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
    Return the smallest n whose simulated power reaches `power` while that of n − 1 does not.

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
        Correction of F, "greenhouse-geisser" (by default), "huynh-feldt", "none" or "auto"; of a
        pair, the adjustment of its p-value, "holm" (by default), "bonferroni" or "none".
    most : int
        The largest n to try.
    simulation : Simulation
        As for `power_analysis`. One n is simulated after the other.

    Returns
    -------
    SmallestN

    Raises
    ------
    ValueError
        If an argument is out of range, power does not exceed alpha, or even `most` subjects do not
        reach it.

    Examples
    --------
    >>> import trustlab as tl
    >>> from trustlab.studies import Simulation, graded_covariance
    >>> quick = Simulation(replicates=500)
    >>> plan = tl.smallest_n(0.8, [0.0, 0.3, 0.6], graded_covariance(3), simulation=quick)
    >>> plan.n
    30
    """
    of_class("columns", columns, StudyColumns)
    of_class("simulation", simulation, Simulation)
    if columns.several:
        raise ValueError(
            "smallest_n takes one factor within subjects; for several factors or groups compare "
            "values of n by power_analysis"
        )
    population = conditions_from(mean, covariance, data, columns)
    population = population.varied(effect_size, None, None)
    target = open_unit("power", power)
    most = whole_number("most", most, least=3, most=MOST_N)
    if target <= simulation.alpha:
        raise ValueError(
            f"power = {target:g} must exceed alpha = {simulation.alpha:g}, its value without any "
            "effect"
        )
    key, name, closed_form = _test(population, pair, test, simulation.alpha)
    half, once, twice = (
        lambda n, spread=spread: closed_form(n, spread) >= target for spread in (0.5, 1.0, 2.0)
    )
    by_spread = {"half": _bisect(half, 3, MOST_N), "twice": _bisect(twice, 3, MOST_N)}
    findings: dict[int, int] = {}

    def enough(size: int) -> bool:
        if size not in findings:
            findings[size] = counted([(size, population)], simulation)[0][key]
        return findings[size] >= target * simulation.replicates

    n = _bisect(enough, _bisect(once, 3, most) or most, most)
    if n is None:
        raise ValueError(
            f"{most} subjects reach a power of {findings[most] / simulation.replicates:.3g} only, "
            f"{target:g} was wanted; with half the spread, or means twice as far apart, n is "
            f"{by_spread['half'] or 'still more'}. Raise most=, measure each condition more often, "
            "or look for a greater effect"
        )
    rows = [{"n": size, "count": findings[size]} for size in sorted(findings)]
    table = with_intervals(rows, simulation).drop(columns="replicates")
    row = table[table["n"] == n].assign(
        test=name, wanted=target, whole_squares=participants_needed(len(population.labels), n)
    )
    names = ["test", "wanted", "n", "power", "ci_low", "ci_high", "whole_squares"]
    tests = labelled(row[names].reset_index(drop=True), population.simulated_origin)
    return SmallestN(tests, by_spread, population, simulation, table)


def _test(
    population: Conditions, pair: tuple | None, test: str | None, alpha: float
) -> tuple[str, str, Callable[[int, float], float]]:
    """
    Return the key of a test among the findings, its name, and its power by noncentral F with Box's
    ε, for a number of subjects whose standard deviations are multiplied.
    """
    if pair is None:
        test = one_of("test", USUAL_TEST if test is None else test, TESTS)
        key, name = f"condition/{test}", f"F, {test}"
        epsilon = population.epsilon
        d, eta2 = len(population.labels) - 1, population.eta2_partial
        strength = d * eta2 / (1.0 - eta2)
    else:
        mask = claims_mask([pair], population)
        test = one_of("test of a pair", "holm" if test is None else test, ADJUSTMENTS)
        key, name = f"pair {int(np.argmax(mask))} {test}", f"{pair[0]} – {pair[1]}, {test}"
        d, epsilon = 1, 1.0
        strength = float(population.d_z[mask][0]) ** 2
        # Holm's first step is Bonferroni's; its later steps have no closed form.
        alpha = alpha if test == "none" else alpha / len(population.d_z)

    def closed_form(n: int, spread: float) -> float:
        df = epsilon * d
        return exceeds_critical(df, df * (n - 1), epsilon * n * strength / spread**2, alpha)

    return key, name, closed_form


def _bisect(enough: Callable[[int], bool], start: int, most: int) -> int | None:
    """Return an n at which `enough` begins to hold, at least 3; None where `most` is not enough."""
    low, high = 2, most + 1  # sizes that are never tried stand for the ends until they are found
    n, step = max(start, 3), 1
    while high - low > 1:
        if enough(n):
            high, n = n, max(n - step, 3)
        else:
            low, n = n, min(n + step, most)
        step *= 2
        if low > 2 and high <= most:
            n = (low + high) // 2
    return high if high <= most else None
