"""
Sobol' indices: how much each uncertain parameter of a task contributes to the variance of its
results.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.parameters import interval
from trustlab.campaign.run import run_campaign
from trustlab.models.checks import open_unit, whole_number
from trustlab.models.display import axes_or_new


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
        results = list(dict.fromkeys(self.indices["result"]))
        names = list(dict.fromkeys(self.indices["parameter"]))
        size = (max(4.0, 3.2 * len(results)), 1.4 + 0.4 * len(names))
        axes = axes_or_new(
            columns=len(results), squeeze=False, sharey=True, sharex=True, figsize=size
        )
        at = np.arange(len(names))
        for panel, result in zip(axes[0], results, strict=True):
            rows = self.indices[self.indices["result"] == result]
            for shift, value, low, high, color, label in (
                (-0.12, "first_order", "first_low", "first_high", "#0072b2", "alone (first order)"),
                (0.12, "total", "total_low", "total_high", "#d55e00", "with interactions (total)"),
            ):
                middle = rows[value].to_numpy()
                spread = np.abs(np.vstack([middle - rows[low], rows[high] - middle]))
                panel.errorbar(
                    middle,
                    at + shift,
                    xerr=spread,
                    fmt="o",
                    ms=4,
                    capsize=3,
                    color=color,
                    label=label,
                )
            panel.axvline(0.0, color="0.8", lw=0.8, zorder=0)
            panel.set_title(result, fontsize="medium")
            panel.set_xlabel("share of variance")
        axes[0, 0].set_yticks(at, names)
        axes[0, 0].invert_yaxis()
        handles, labels = axes[0, 0].get_legend_handles_labels()
        axes[0, 0].figure.legend(
            handles, labels, loc="outside lower center", ncols=2, fontsize="small", frameon=False
        )
        axes[0, 0].figure.suptitle(
            f"Sobol' indices, {100 * self.level:g} % intervals", fontsize="medium"
        )
        return axes[0]


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
        n_jobs, out, executor, progress, fresh and other_versions, as in `run_campaign`.

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
    from scipy.stats import sobol_indices as scipy_indices

    n = whole_number("n", n, least=8)
    if n & (n - 1):
        raise ValueError(f"n must be a power of 2, such as {2 ** n.bit_length()}, got {n}")
    level, resamples = open_unit("level", level), whole_number("resamples", resamples, least=20)
    seed = whole_number("seed", seed, least=0)
    distributions = _distributions(ranges)
    names, d = list(ranges), len(distributions)
    # Runs take the children 0, 1, … of the seed; points and bootstrap those of another child far
    # from them.
    points, draws = np.random.SeedSequence(seed, spawn_key=(2**31,)).spawn(2)
    parameters = [
        dict(zip(names, map(float, point), strict=True))
        for point in _points(distributions, n, points)
    ]
    table = run_campaign(task, parameters, seed=seed, **campaign)
    names_of_results = _numeric(table, names, results)
    values = (
        table[names_of_results].to_numpy(dtype=float).T.reshape(len(names_of_results), d + 2, n)
    )
    f_a = values[:, 0]
    f_b = values[:, 1]
    f_ab = values[:, 2:].swapaxes(0, 1)

    def indices(k: np.ndarray) -> np.ndarray:
        """Return first-order and total indices from the points k; SciPy drops axes of length 1."""
        estimate = scipy_indices(
            func={"f_A": f_a[:, k], "f_B": f_b[:, k], "f_AB": f_ab[..., k]}, n=n
        )
        return np.stack([estimate.first_order, estimate.total_order]).reshape(2, -1, d)

    rng = np.random.default_rng(draws)
    with np.errstate(
        invalid="ignore", divide="ignore"
    ):  # a result that does not vary has no shares
        whole = indices(np.arange(n))
        again = [indices(rng.integers(n, size=n)) for _ in range(resamples)]
    low, high = np.nanquantile(again, [(1.0 - level) / 2.0, (1.0 + level) / 2.0], axis=0)
    # Axes: estimate and its two ends, first order and total, results, parameters.
    shares = np.stack([whole, low, high])
    shares[:, :, np.ptp(values[:, :2].reshape(len(names_of_results), -1), axis=1) == 0.0] = np.nan
    index = pd.MultiIndex.from_product([names_of_results, names], names=["result", "parameter"])
    columns = [f"{order}_{end}" for order in ("first", "total") for end in ("order", "low", "high")]
    frame = pd.DataFrame(shares.transpose(2, 3, 1, 0).reshape(len(index), 6), index, columns)
    return SobolIndices(frame.rename(columns={"total_order": "total"}).reset_index(), n, level)


def _points(distributions: dict[str, Any], n: int, seed: np.random.SeedSequence) -> np.ndarray:
    """
    Return the points of Saltelli's design, shape (n (d + 2), d): A, B, then for each parameter A
    with B's column.

    A and B are the halves of one scrambled Sobol' sequence of 2 d dimensions, as in
    `scipy.stats.sobol_indices`.
    """
    from scipy.stats import qmc

    d = len(distributions)
    unit = qmc.Sobol(2 * d, rng=np.random.default_rng(seed), bits=64).random(n)
    a, b = (
        np.column_stack(
            [
                distribution.ppf(u)
                for distribution, u in zip(distributions.values(), half.T, strict=True)
            ]
        )
        for half in np.hsplit(unit, 2)
    )
    mixed = [np.where(np.arange(d) == j, b, a) for j in range(d)]
    return np.concatenate([a, b, *mixed])


def _distributions(ranges: Any) -> dict[str, Any]:
    from scipy import stats

    if not isinstance(ranges, Mapping) or not ranges:
        raise ValueError(
            "ranges must be a dict of (low, high) by parameter, such as {'beta': (0.6, 0.8)}"
        )
    if len(ranges) < 2:
        raise ValueError(
            "indices divide variance among parameters: give at least two, got "
            f"{', '.join(ranges)} alone"
        )
    distributions = {}
    for name, kind in ranges.items():
        if isinstance(kind, tuple):
            low, high = interval(f"ranges[{name!r}]", kind)
            distributions[name] = stats.uniform(low, high - low)
        elif callable(getattr(kind, "ppf", None)):
            distributions[name] = kind
        else:
            raise ValueError(
                f"ranges[{name!r}] must be (low, high) or a SciPy distribution, got "
                f"{type(kind).__name__}"
            )
    return distributions


def _numeric(table: pd.DataFrame, names: list[str], selected: list[str] | None) -> list[str]:
    """Return the results to analyse, finite in every run."""
    if table["failed"].any():
        bad = table[table["failed"]].iloc[0]
        raise CampaignError(
            f"indices need every point, but {int(table['failed'].sum())} of {len(table)} runs "
            f"failed, first {bad[names].to_dict()}: {bad['error']}; narrow the ranges or mend the "
            "task"
        )
    known = [c for c in table.columns if c not in ("run", *names, "failed", "error", "traceback")]
    if selected is None:
        selected = [c for c in known if pd.api.types.is_numeric_dtype(table[c])]
        if not selected:
            raise ValueError(f"none of the results {', '.join(known)} is a number")
    for name in selected:
        if name not in known:
            raise ValueError(f"results names {name!r}, but the task returns {', '.join(known)}")
        if not pd.api.types.is_numeric_dtype(table[name]):
            raise ValueError(
                f"result {name!r} is not a number in every run, so that it has no variance"
            )
        bad = ~np.isfinite(table[name].to_numpy(dtype=float))
        if bad.any():
            row = table.iloc[int(np.argmax(bad))]
            raise ValueError(
                f"indices need every point, but result {name!r} is {row[name]} at "
                f"{int(bad.sum())} of {len(table)} points, first at {row[names].to_dict()}; "
                "narrow the ranges, or choose results that are defined there"
            )
    return list(selected)
