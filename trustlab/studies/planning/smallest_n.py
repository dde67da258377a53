"""
The smallest study of a given power: bisection on simulated power, begun at the closed form.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence

from trustlab.models.checks import of_class, one_of, open_unit, whole_number
from trustlab.models.display import Result
from trustlab.studies.designs import participants_needed
from trustlab.studies.planning.closed_form_power import (
    clopper_pearson,
    noncentral_f_power,
    noncentrality,
)
from trustlab.studies.planning.covariances import Conditions, conditions_from
from trustlab.studies.planning.power import (
    ADJUSTMENTS,
    MOST_N,
    TESTS,
    USUAL_TEST,
    claims_mask,
    count_findings,
    run_counts,
)
from trustlab.studies.planning.settings import (
    USUAL_COLUMNS,
    USUAL_SIMULATION,
    Simulation,
    StudyColumns,
)
from trustlab.studies.words import apa_number

# How many n are simulated at the same time where there are workers for it.
AHEAD = 4


@dataclass(frozen=True, eq=False, repr=False)
class SmallestN(Result):
    """
    The smallest number of subjects whose simulated power reaches what was wanted.

    Parameters
    ----------
    n : int
        Subjects.
    power, ci_low, ci_high : float
        Simulated power there and its Monte-Carlo interval.
    wanted : float
        Power wanted.
    test : str
        Which test.
    whole_squares : int
        The next number that fills whole Latin squares of the conditions.
    n_by_spread : dict of str to int
        By noncentral F: what "half" and "twice" the standard deviations would ask for.
    population : Conditions
        Means and covariance that were assumed.
    simulation : Simulation
        How studies were simulated.
    evaluations : pandas.DataFrame
        Every n that was simulated: n, power, ci_low, ci_high; n − 1 is among them, unless n is the
        least possible, 3.
    origin : str
        Where the numbers come from, for headers and captions.
    """

    title = "Smallest number of participants"

    n: int
    power: float
    ci_low: float
    ci_high: float
    wanted: float
    test: str
    whole_squares: int
    n_by_spread: dict[str, int | None]
    population: Conditions
    simulation: Simulation
    evaluations: pd.DataFrame
    origin: str

    @property
    def message(self) -> str:
        """Where the numbers come from."""
        return self.origin

    def table(self) -> pd.DataFrame:
        """Return one row: test, wanted, n, power, ci_low, ci_high, whole_squares."""
        names = ("test", "wanted", "n", "power", "ci_low", "ci_high", "whole_squares")
        frame = pd.DataFrame([{name: getattr(self, name) for name in names}])
        frame.attrs["origin"] = self.origin
        return frame

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
            f"(95% CI [{apa_number(self.ci_low, below_one=True)}, "
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
        As for `power_analysis`. With workers several n are simulated at the same time; the answer
        is the same.

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
    if len(columns.factors) > 1 or columns.groups:
        raise ValueError(
            "smallest_n takes one factor within subjects; for several factors or groups compare "
            "values of n by power_analysis"
        )
    population = conditions_from(mean, covariance, data, columns)
    if effect_size is not None:
        population = population.with_effect(effect_size)
    target = open_unit("power", power)
    alpha = simulation.alpha
    replicates = simulation.replicates
    most = whole_number("most", most, least=3, most=MOST_N)
    index, test, key, name = _chosen_test(population, pair, test)
    if target <= alpha:
        raise ValueError(
            f"power = {target:g} must exceed alpha = {alpha:g}, its value without any effect"
        )
    spreads = {
        name: _closed_form(population, index, target, alpha, test, scale)
        for name, scale in (("half", 0.5), ("once", 1.0), ("twice", 2.0))
    }
    expected = spreads.pop("once")
    by_spread = {name: _bisect(enough, 3, MOST_N) for name, enough in spreads.items()}

    def simulated(sizes: list[int]) -> dict[int, int]:
        cells = [(population, n, SeedSequence(simulation.seed, spawn_key=(n,))) for n in sizes]
        counted = run_counts(count_findings, cells, simulation, claims=None)
        return {n: counts[key] for n, counts in zip(sizes, counted, strict=True)}

    ahead = 1 if simulation.n_jobs == 1 else AHEAD
    n, findings = _search(simulated, expected, target * replicates, most, ahead)
    if n is None:
        share = findings[most] / replicates
        raise _out_of_reach(population, index, by_spread["half"], share, target, most)
    low, high = clopper_pearson(list(findings.values()), replicates, simulation.level)
    shares = [count / replicates for count in findings.values()]
    rows = pd.DataFrame({"n": list(findings), "power": shares, "ci_low": low, "ci_high": high})
    power, low, high = rows.set_index("n").loc[n]
    squares = participants_needed(len(population.mean), n)
    return SmallestN(
        n=n,
        power=power,
        ci_low=low,
        ci_high=high,
        wanted=target,
        test=name,
        whole_squares=squares,
        n_by_spread=by_spread,
        population=population,
        simulation=simulation,
        evaluations=rows,
        origin=population.simulated_origin,
    )


def _chosen_test(
    population: Conditions, pair: tuple | None, test: str | None
) -> tuple[int | None, str, str, str]:
    """Return the pair's index, correction or adjustment, key among the findings, and name."""
    if pair is None:
        test = one_of("test", USUAL_TEST if test is None else test, TESTS)
        return None, test, f"F {test}", f"F, {test}"
    index = int(np.flatnonzero(claims_mask([pair], population))[0])
    test = one_of("test of a pair", "holm" if test is None else test, ADJUSTMENTS)
    return index, test, f"pair {index} {test}", f"{pair[0]} – {pair[1]}, {test}"


def _out_of_reach(
    population: Conditions,
    pair: int | None,
    n_by_half: int | None,
    share: float,
    target: float,
    most: int,
) -> ValueError:
    """Return the error of a plan that cannot reach its power: it names what drives the number."""
    d_z = np.abs(population.d_z)
    largest = d_z.max() if pair is None else d_z[pair]
    return ValueError(
        f"{most} subjects reach a power of {share:.3g} only, {target:g} was wanted: means differ "
        f"by at most {largest:.3g} standard deviations of a difference, which drives n; with half "
        f"the spread, or means twice as far apart, n is {n_by_half or 'still more'}. Raise most=, "
        "measure each condition more often, or look for a greater effect"
    )


def _search(
    simulated: Callable[[list[int]], dict],
    expected: Callable[[int], bool],
    least: float,
    most: int,
    ahead: int,
) -> tuple[int | None, dict[int, int]]:
    """
    Return the smallest n with `least` findings, and the findings of every n that the search asked
    for.

    The search needs one n after the other. Workers simulate up to `ahead` at the same time, along
    the path on which the closed form leads the search; where the simulation leads elsewhere, some
    were simulated for nothing.
    """
    findings: dict[int, int] = {}
    sizes: set[int] = set()
    missing: list[int] = []

    def enough(n: int) -> bool:
        sizes.add(n)
        if n in findings:
            return findings[n] >= least
        missing.append(n)
        return expected(n)

    start = _bisect(expected, 3, most) or most
    while True:
        sizes.clear()
        missing.clear()
        n = _bisect(enough, start, most)
        if not missing:
            return n, {size: findings[size] for size in sorted(sizes)}
        findings |= simulated(list(dict.fromkeys(missing))[:ahead])


def _bisect(enough, start: int, most: int) -> int | None:
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


def _closed_form(
    population: Conditions,
    pair: int | None,
    target: float,
    alpha: float,
    adjust: str,
    scale: float = 1.0,
) -> Callable[[int], bool]:
    """
    Return whether n subjects are enough by noncentral F with Box's ε, or by noncentral t for a
    pair; with all standard deviations times `scale`.
    """
    k, epsilon = len(population.mean), population.epsilon
    if pair is not None:
        d_z = population.d_z[pair]
        k = 2
        epsilon = 1.0
        # Holm's first step is Bonferroni's; its later steps have no closed form.
        alpha = alpha if adjust == "none" else alpha / len(population.d_z)

    def expected(n: int) -> bool:
        strength = n * d_z**2 if pair is not None else noncentrality(population.eta2_partial, n, k)
        return noncentral_f_power(n, k, strength / scale**2, alpha, epsilon) >= target

    return expected
