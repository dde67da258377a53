"""
The smallest study with a wanted power: bisection on simulated power, begun at the closed form.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.campaign.run import where_to_run
from trustlab.models.checks import one_of, open_unit, whole_number
from trustlab.models.html import as_html
from trustlab.studies.designs import participants_needed
from trustlab.studies.planning.closed_form_power import (
    clopper_pearson,
    noncentral_f_power,
    noncentrality,
)
from trustlab.studies.planning.covariances import Conditions, conditions_from
from trustlab.studies.planning.power import (
    ADJUSTMENTS,
    LEAST_REPLICATES,
    MOST_N,
    TESTS,
    USUAL_TEST,
    claims_mask,
    count_findings,
    run_counts,
)

# How many n are simulated at the same time where there are workers for it.
AHEAD = 4


@dataclass(frozen=True, eq=False)
class SmallestN:
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
    evaluations : pandas.DataFrame
        Every n that was simulated: n, power, ci_low, ci_high; n − 1 is among them, unless n is the
        least possible, 3.
    origin : str
        Where the numbers come from, for headers and captions.
    """

    n: int
    power: float
    ci_low: float
    ci_high: float
    wanted: float
    test: str
    whole_squares: int
    evaluations: pd.DataFrame
    origin: str

    def table(self) -> pd.DataFrame:
        """Return one row: test, wanted, n, power, ci_low, ci_high, whole_squares."""
        names = ("test", "wanted", "n", "power", "ci_low", "ci_high", "whole_squares")
        frame = pd.DataFrame([{name: getattr(self, name) for name in names}])
        frame.attrs["origin"] = self.origin
        return frame

    def _repr_html_(self) -> str:
        return as_html(self.origin, self.table())


def smallest_n(
    power: float = 0.8,
    mean: Sequence[float] | None = None,
    covariance: np.ndarray | None = None,
    *,
    labels: Sequence[Hashable] | None = None,
    effect_size: float | None = None,
    data: pd.DataFrame | None = None,
    dv: Hashable = "value",
    within: Hashable = "condition",
    subject: Hashable = "subject",
    order: Sequence | None = None,
    pair: tuple | None = None,
    test: str = USUAL_TEST,
    adjust: str = "holm",
    alpha: float = 0.05,
    replicates: int = 10_000,
    level: float = 0.95,
    seed: int = 0,
    most: int = 2000,
    n_jobs: int | None = None,
    executor: Any = None,
) -> SmallestN:
    """
    Return the smallest n whose simulated power reaches `power` while that of n − 1 does not.

    Every n has draws of its own from the seed, so that the answer is the same at every call. Within
    the Monte-Carlo error neighbouring n can be as good.

    Parameters
    ----------
    power : float
        Wanted, in (0, 1).
    mean, covariance, data, dv, within, subject, order, labels : object
        The population, as for `power_analysis`.
    effect_size : float, optional
        Partial η² of the population; as given when left out.
    pair : (a, b), optional
        Two conditions: the power of their comparison instead of that of F.
    test : {"greenhouse-geisser", "huynh-feldt", "none", "auto"}
        Correction of F.
    adjust : {"holm", "bonferroni", "none"}
        Adjustment of the pair's p-value.
    alpha : float
        Level of the test.
    replicates : int
        Studies per n; at least 100.
    level : float
        Coverage of the Monte-Carlo interval.
    seed : int
        Of the draws.
    most : int
        The largest n to try.
    n_jobs, executor : int, Executor, optional
        Where studies are simulated, as in `run_campaign`; by default in this process. Several n are
        then simulated at the same time; the answer is the same.

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
    >>> from trustlab.studies import graded_covariance
    >>> plan = tl.smallest_n(0.8, [0.0, 0.3, 0.6], graded_covariance(3, correlation=0.5), replicates=500)
    >>> plan.n
    30
    """
    population = conditions_from(mean, covariance, data, dv, within, subject, order, labels)
    if effect_size is not None:
        population = population.with_effect(effect_size)
    wanted = open_unit("power", power)
    alpha = open_unit("alpha", alpha)
    level = open_unit("level", level)
    replicates = whole_number("replicates", replicates, least=LEAST_REPLICATES, most=10_000_000)
    seed, most = (
        whole_number("seed", seed, least=0),
        whole_number("most", most, least=3, most=MOST_N),
    )
    one_of("test", test, TESTS)
    one_of("adjust", adjust, ADJUSTMENTS)
    if wanted <= alpha:
        raise ValueError(
            f"power = {wanted:g} must exceed alpha = {alpha:g}, its value without any effect"
        )
    which = None if pair is None else int(np.flatnonzero(claims_mask([pair], population))[0])
    key = f"F {test}" if which is None else f"pair {which} {adjust}"
    expected = _closed_form(population, which, wanted, alpha, adjust)
    where = where_to_run(n_jobs, executor)

    def simulated(sizes: list[int]) -> dict[int, int]:
        cells = [(population, n, np.random.SeedSequence(seed, spawn_key=(n,))) for n in sizes]
        fixed = {"replicates": replicates, "alpha": alpha, "claims": None}
        counted = run_counts(count_findings, cells, fixed, where)
        return {n: counts[key] for n, counts in zip(sizes, counted, strict=True)}

    ahead = 1 if where["n_jobs"] == 1 else AHEAD
    n, found = _search(simulated, expected, wanted * replicates, most, ahead)
    if n is None:
        share = found[most] / replicates
        what = f"{most} subjects reach a power of {share:.3g} only, {wanted:g} was wanted"
        raise ValueError(
            f"{what}: the effect is too small for the design; raise most=, or change the design"
        )
    low, high = clopper_pearson(list(found.values()), replicates, level)
    shares = [count / replicates for count in found.values()]
    rows = pd.DataFrame({"n": list(found), "power": shares, "ci_low": low, "ci_high": high})
    power, low, high = rows.set_index("n").loc[n]
    name = f"F, {test}" if pair is None else f"{pair[0]} – {pair[1]}, {adjust}"
    squares = participants_needed(len(population.mean), n)
    return SmallestN(n, power, low, high, wanted, name, squares, rows, population.simulated_origin)


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
    found: dict[int, int] = {}
    asked: set[int] = set()
    missing: list[int] = []

    def enough(n: int) -> bool:
        asked.add(n)
        if n in found:
            return found[n] >= least
        missing.append(n)
        return expected(n)

    start = _bisect(expected, 3, most) or most
    while True:
        asked.clear()
        missing.clear()
        n = _bisect(enough, start, most)
        if not missing:
            return n, {size: found[size] for size in sorted(asked)}
        found |= simulated(list(dict.fromkeys(missing))[:ahead])


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
    population: Conditions, which: Any, wanted: float, alpha: float, adjust: str
) -> Callable[[int], bool]:
    """
    Return whether n subjects are enough by noncentral F with Box's ε, or by noncentral t for a
    pair.
    """
    k, epsilon = len(population.mean), population.epsilon
    if which is not None:
        d_z = population.d_z[which]
        k = 2
        epsilon = 1.0
        # Holm's first step is Bonferroni's; its later steps have no closed form.
        alpha = alpha if adjust == "none" else alpha / len(population.d_z)

    def expected(n: int) -> bool:
        strength = n * d_z**2 if which is not None else noncentrality(population.eta2_partial, n, k)
        return noncentral_f_power(n, k, strength, alpha, epsilon) >= wanted

    return expected
