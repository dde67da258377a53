"""Sobol' indices: the share of a result's variance that each uncertain parameter contributes."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from trustlab.campaign.parameters import distribution
from trustlab.campaign.run import CampaignError, run_campaign
from trustlab.models.checks import open_unit, shown, whole_number, whole_seed

COLUMNS = ("first_order", "first_low", "first_high", "total", "total_low", "total_high")

# Resamples of the bootstrap.
RESAMPLES = 400


def sobol_indices(
    task: Callable[..., Mapping],
    ranges: Mapping[str, object],
    n: int = 256,
    *,
    seed: int = 0,
    level: float = 0.95,
    **campaign: Any,
) -> pd.DataFrame:
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
    seed : int
        Seed of the points, of the bootstrap and of the runs.
    level : float
        Level of the intervals, in (0, 1).
    **campaign : object
        n_jobs, out and progress, as in `run_campaign`.

    Returns
    -------
    pandas.DataFrame
        Columns result, parameter, first_order, first_low, first_high, total, total_low,
        total_high; a row for each parameter of each result that is a number, NaN where the result
        did not vary. Estimates may fall below 0 or above 1 by their error, and are not cut.

    Raises
    ------
    ValueError
        If an argument is not of its kind, a run failed, or a number among the results is not
        finite at some point.

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
    >>> indices[["parameter", "first_order", "total"]].round(1)
      parameter  first_order  total
    0         x          1.0    1.0
    1         y          0.0    0.0
    """
    from scipy import stats

    n = whole_number("n", n, least=8)
    if n & (n - 1):
        raise ValueError(f"n must be a power of 2, such as {2 ** n.bit_length()}, got {n}")
    level, seed = open_unit("level", level), whole_seed(seed)
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
    results, values = _outcomes(table, names)
    values = values.reshape(len(results), d + 2, n)

    def indices(k: np.ndarray) -> np.ndarray:
        """Return first-order and total indices from the points k."""
        f_a, f_b = values[:, 0, k], values[:, 1, k]
        outputs = {"f_A": f_a, "f_B": f_b, "f_AB": values[:, 2:, k].swapaxes(0, 1)}
        estimate = stats.sobol_indices(func=outputs, n=n)
        return np.reshape([estimate.first_order, estimate.total_order], (2, -1, d))

    # SciPy's own bootstrap takes no seed.
    again = [indices(draws.integers(n, size=n)) for _ in range(RESAMPLES)]
    ends = np.quantile(again, [(1.0 - level) / 2.0, (1.0 + level) / 2.0], axis=0)
    # By estimate and ends, order, result and parameter.
    shares = np.stack([indices(np.arange(n)), *ends])
    shares[:, :, np.ptp(values, axis=(1, 2)) == 0.0] = np.nan
    index = pd.MultiIndex.from_product([results, names], names=["result", "parameter"])
    columns = shares.swapaxes(0, 1).reshape(len(COLUMNS), -1).T
    return pd.DataFrame(columns, index, COLUMNS).reset_index()


def _outcomes(table: pd.DataFrame, names: list[str]) -> tuple[list[str], np.ndarray]:
    """Return the names of the results that are numbers, and their values by result and run."""
    if table.attrs["failed"]:
        remedy = "; narrow the ranges" * (table.attrs["failed"] < len(table))
        raise CampaignError(f"indices need every point: {table.attrs['summary']}{remedy}")
    numbers = table.drop(columns=["run", "failed", *names]).select_dtypes(["number", "bool"])
    if numbers.empty:
        raise CampaignError("no result is a number; return at least one from the task")
    values = numbers.to_numpy(dtype=float)
    gaps = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if gaps.size:
        raise ValueError(
            f"indices need every point, but at {gaps.size} of {len(table)} a result is not finite, "
            f"first at {table.loc[gaps[0], [*names, *numbers]].to_dict()}; narrow the ranges"
        )
    return list(numbers), values.T
