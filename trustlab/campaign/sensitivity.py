"""Sobol' indices: the share of a result's variance that each uncertain parameter contributes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.campaign.parameters import distribution
from trustlab.campaign.run import CampaignError, run_campaign
from trustlab.models.checks import open_unit, shown, whole_number, whole_seed
from trustlab.models.display import axes_or_new

COLUMNS = ("first_order", "first_low", "first_high", "total", "total_low", "total_high")


@dataclass(frozen=True, eq=False)
class SobolIndices:
    """
    Shares of the variance of each result.

    Parameters
    ----------
    indices : pandas.DataFrame
        Columns result, parameter, first_order, first_low, first_high, total, total_low, total_high.
    n : int
        Points in each of the two samples; the task was run n (parameters + 2) times.
    level : float
        Level of the intervals.
    """

    indices: pd.DataFrame
    n: int
    level: float

    def table(self) -> pd.DataFrame:
        """
        Return the indices with bootstrap intervals.

        Returns
        -------
        pandas.DataFrame
            Columns result, parameter, first_order, first_low, first_high, total, total_low,
            total_high; NaN for a result that did not vary. Estimates may fall below 0 or above 1 by
            their error, and are not cut.
        """
        return self.indices.copy()

    def plot(self):
        """
        Plot first-order and total indices with their intervals, one panel per result.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (results,)
        """
        groups = self.indices.groupby("result", sort=False)
        axes = axes_or_new(columns=len(groups), squeeze=False, sharey=True)[0]
        for panel, (result, rows) in zip(axes, groups, strict=True):
            for value, order, shift in (("first_order", "first", -0.1), ("total", "total", 0.1)):
                ends = [rows[value] - rows[f"{order}_low"], rows[f"{order}_high"] - rows[value]]
                places = np.arange(len(rows)) + shift
                panel.errorbar(rows[value], places, xerr=np.abs(ends), fmt="o", label=value)
            panel.set(title=result, xlabel=f"share of variance, {100 * self.level:g} % intervals")
        axes[0].set_yticks(range(len(rows)), rows["parameter"])
        axes[0].legend()
        return axes


def sobol_indices(
    task: Callable[..., Mapping],
    ranges: Mapping[str, object],
    n: int = 256,
    *,
    results: list[str] | None = None,
    seed: int = 0,
    level: float = 0.95,
    resamples: int = 400,
    **campaign: Any,
) -> SobolIndices:
    """
    Estimate first-order and total Sobol' indices of a task's results from one campaign of runs.

    The first-order index of a parameter is the share of a result's variance that knowing it would
    remove; the total index counts its interactions too. Points are a scrambled Sobol' sequence, the
    estimators those of `scipy.stats.sobol_indices` (Saltelli et al. 2010), intervals are
    percentiles of a bootstrap over points.

    Parameters
    ----------
    task : callable
        As in `run_campaign`. Where its results depend on the seed too, every run has a seed of its
        own, so that the noise is independent between points: its share of variance is in all total
        indices and in no first-order index.
    ranges : dict
        By name of the parameter: (low, high) for a uniform distribution, or a scipy.stats frozen
        distribution; taken as independent.
    n : int
        Points in each of two samples, a power of 2; the task is run n (parameters + 2) times.
    results : list of str, optional
        Which results; all that are numbers when not given.
    seed : int
        Seed of the points, of the bootstrap and of the runs.
    level : float
        Level of the intervals, in (0, 1).
    resamples : int
        Resamples of the bootstrap.
    **campaign : object
        n_jobs, out and progress, as in `run_campaign`.

    Returns
    -------
    SobolIndices
        `.table()` and `.plot()`.

    Raises
    ------
    ValueError
        If an argument is not of its kind, a run failed, or a result is not a finite number at some
        point.

    Notes
    -----
    Saltelli, A., et al. "Variance based sensitivity analysis of model output." *Computer Physics
    Communications* 181(2), 2010, 259-270.

    Examples
    --------
    >>> import trustlab as tl
    >>> def task(x, y, seed):
    ...     return {"z": x + 0.1 * y}
    >>> indices = tl.sobol_indices(task, {"x": (0.0, 1.0), "y": (0.0, 1.0)}, n=64, n_jobs=1)
    >>> indices.table()[["parameter", "first_order", "total"]].round(1)
      parameter  first_order  total
    0         x          1.0    1.0
    1         y          0.0    0.0
    """
    from scipy import stats

    n = whole_number("n", n, least=8)
    if n & (n - 1):
        raise ValueError(f"n must be a power of 2, such as {2 ** n.bit_length()}, got {n}")
    level, resamples = open_unit("level", level), whole_number("resamples", resamples, 20, 100_000)
    seed = whole_seed(seed)
    if not isinstance(ranges, Mapping) or len(ranges) < 2:
        raise ValueError(
            "ranges must be a dict of (low, high) by name of at least two parameters, such as "
            f"{{'beta': (0.6, 0.8), 'upper': (0.2, 0.4)}}, got {shown(ranges)}"
        )
    names, d = list(ranges), len(ranges)
    # Runs take the children 0, 1, … of the seed; points and bootstrap those of a child far off.
    points, draws = map(
        np.random.default_rng, np.random.SeedSequence(seed, spawn_key=(2**31,)).spawn(2)
    )
    unit = stats.qmc.Sobol(2 * d, rng=points, bits=64).random(n)
    quantiles = [distribution(x, ranges[x]).ppf(u) for x, u in zip(2 * names, unit.T, strict=True)]
    a, b = np.reshape(quantiles, (2, d, n))
    # Both samples, and for each parameter the first with values of the second.
    designs = [a, b, *(np.where(np.arange(d)[:, None] == j, b, a) for j in range(d))]
    rows = np.concatenate(designs, axis=1).T.tolist()
    parameters = [dict(zip(names, row, strict=True)) for row in rows]
    table = run_campaign(task, parameters, seed=seed, **campaign)
    chosen, values = _outcomes(table, names, results)
    values = values.reshape(len(chosen), d + 2, n)

    def indices(k: np.ndarray) -> np.ndarray:
        """Return first-order and total indices from the points k."""
        f_a, f_b = values[:, 0, k], values[:, 1, k]
        outputs = {"f_A": f_a, "f_B": f_b, "f_AB": values[:, 2:, k].swapaxes(0, 1)}
        estimate = stats.sobol_indices(func=outputs, n=n)
        return np.reshape([estimate.first_order, estimate.total_order], (2, -1, d))

    # SciPy's own bootstrap takes no seed.
    again = [indices(draws.integers(n, size=n)) for _ in range(resamples)]
    ends = np.quantile(again, [(1.0 - level) / 2.0, (1.0 + level) / 2.0], axis=0)
    shares = np.stack(
        [indices(np.arange(n)), *ends]
    )  # of estimate and ends, order, result, parameter
    shares[:, :, np.ptp(values, axis=(1, 2)) == 0.0] = np.nan
    index = pd.MultiIndex.from_product([chosen, names], names=["result", "parameter"])
    columns = shares.swapaxes(0, 1).reshape(len(COLUMNS), -1).T
    return SobolIndices(pd.DataFrame(columns, index, COLUMNS).reset_index(), n, level)


def _outcomes(
    table: pd.DataFrame, names: list[str], results: list[str] | None
) -> tuple[list[str], np.ndarray]:
    """Return the names of the results to analyse, and their values by result and run."""
    if table.attrs["failed"]:
        remedy = "; narrow the ranges" * (table.attrs["failed"] < len(table))
        raise CampaignError(f"indices need every point: {table.attrs['summary']}{remedy}")
    numbers = table.drop(columns=["run", "failed", *names]).select_dtypes(["number", "bool"])
    chosen = list(numbers) if results is None else results
    if not isinstance(chosen, list) or not chosen or not {*chosen} <= {*numbers}:
        raise ValueError(
            f"results must be among those that are numbers, {', '.join(numbers)}, got "
            f"{shown(chosen)}"
        )
    values = numbers[chosen].to_numpy(dtype=float).T
    gaps = np.flatnonzero(~np.isfinite(values).all(axis=0))
    if gaps.size:
        raise ValueError(
            f"indices need every point, but at {gaps.size} of {len(table)} a result is not finite, "
            f"first at {table.loc[gaps[0], [*names, *chosen]].to_dict()}; narrow the ranges"
        )
    return chosen, values
