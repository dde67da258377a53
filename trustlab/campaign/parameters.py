"""Parameters of many runs: grids and draws."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from trustlab.models.checks import in_order, shown, whole_number

# Columns of the table, and the argument of the seed: names of neither parameters nor results.
RESERVED = ("run", "seed", "failed", "error", "traceback")

# As many parameters as fit into memory.
MOST_RUNS = 10_000_000


def parameter_grid(repeats: int = 1, **axes: Iterable) -> list[dict]:
    """
    Return every combination of values, as parameters of a campaign.

    Parameters
    ----------
    repeats : int
        How often each combination is run, each time with another seed.
    **axes : list or numpy.ndarray
        Values by name of the parameter.

    Returns
    -------
    list of dict
        One per run; the last name varies fastest, repeats faster still.

    Raises
    ------
    ValueError
        If a name has no values or a single value that is not in a list.

    Examples
    --------
    >>> list(parameter_grid(lower=[0.0, 0.1], upper=[0.4, 0.5]))[1]
    {'lower': 0.0, 'upper': 0.5}
    """
    for name, values in axes.items():
        if isinstance(values, str | bytes | Mapping) or not np.iterable(values):
            raise ValueError(
                f"{name} must be a list of values, got {shown(values)}; write [{shown(values)}] "
                "for one"
            )
    lists = [v.tolist() if isinstance(v, np.ndarray) else list(v) for v in axes.values()]
    repeated = range(whole_number("repeats", repeats, most=MOST_RUNS))
    grid = [
        dict(zip(axes, row, strict=True)) for row in itertools.product(*lists) for _ in repeated
    ]
    if not axes or not grid:
        raise ValueError(f"give at least one value for each name, got {shown(axes)}")
    return grid


def parameter_draws(
    n: int | None = None, /, seed: int | np.random.SeedSequence = 0, **distributions: Any
) -> list[dict]:
    """
    Return independent random draws of parameters.

    Parameters
    ----------
    n : int
        How many. `n=100` by name works too; a range, list or distribution called n is a parameter.
    seed : int or numpy.random.SeedSequence
        Seed of the draws; each parameter has a child of its own, so that adding one leaves the
        others as they were.
    **distributions : tuple, scipy.stats frozen distribution, list
        By name: (low, high) for a uniform distribution, a distribution with `rvs`, or a list of
        values drawn with equal chances.

    Returns
    -------
    list of dict
        One per run.

    Raises
    ------
    ValueError
        If a distribution is of none of these kinds, its draws are not finite, or a range is empty.

    Examples
    --------
    >>> from scipy import stats
    >>> import trustlab as tl
    >>> draws = tl.parameter_draws(3, seed=0, upper=stats.uniform(0.2, 0.2), laps=[4, 8])
    >>> [round(draw["upper"], 3) for draw in draws]
    [0.39, 0.278, 0.242]
    """
    if n is None and isinstance(distributions.get("n"), Real):
        n = distributions.pop("n")
    n = whole_number("n", n, most=MOST_RUNS)
    if not distributions:
        raise ValueError("give at least one parameter, such as beta=(0.6, 0.8)")
    seed = seed_sequence(seed)
    columns = []
    for name, kind in distributions.items():
        # The stream follows from the name, whatever other parameters there are.
        key = (*seed.spawn_key, *name.encode())
        child = np.random.SeedSequence(seed.entropy, spawn_key=key, pool_size=seed.pool_size)
        columns.append(_drawn(name, kind, n, np.random.default_rng(child)))
    return [dict(zip(distributions, row, strict=True)) for row in zip(*columns, strict=True)]


def _drawn(name: str, kind: Any, n: int, rng: np.random.Generator) -> list:
    if isinstance(kind, tuple):
        return rng.uniform(*interval(name, kind), n).tolist()
    if isinstance(kind, list) and kind:
        return [kind[k] for k in rng.integers(len(kind), size=n)]
    if not hasattr(kind, "rvs"):
        raise ValueError(
            f"{name} must be (low, high), a list of values or a SciPy distribution, got "
            f"{shown(kind)}"
        )
    draws = np.asarray(kind.rvs(size=n, random_state=rng))
    if draws.shape != (n,) or not np.isfinite(draws).all():
        raise ValueError(f"the distribution of {name} must give {n} finite numbers")
    return draws.tolist()


def interval(name: str, ends: tuple) -> tuple[float, float]:
    """Return the ends of a range as floats, low < high."""
    if len(ends) != 2:
        raise ValueError(f"{name} must be (low, high), got {shown(ends)}")
    return in_order(f"{name}[0]", ends[0], f"{name}[1]", ends[1])


def seed_sequence(seed: Any) -> np.random.SeedSequence:
    """Return a seed as a SeedSequence."""
    if isinstance(seed, np.random.SeedSequence):
        return seed
    return np.random.SeedSequence(whole_number("seed", seed, least=0))


def checked_names(parameters: Any) -> list[str]:
    """Return the names of the parameters; raise unless every run has a dict with the same."""
    if not isinstance(parameters, Sequence) or isinstance(parameters, str) or not parameters:
        remedy = "; use frame.to_dict('records')" if hasattr(parameters, "columns") else ""
        raise ValueError(
            f"parameters must be a list of dicts, one per run, got {shown(parameters)}{remedy}"
        )
    first = parameters[0]
    for run, values in enumerate(parameters):
        if not isinstance(values, Mapping) or values.keys() != first.keys():
            raise ValueError(
                f"every run needs a dict with the same names, but run 0 has {shown(first)} and "
                f"run {run} has {shown(values)}"
            )
    for name in first:
        if not isinstance(name, str) or name in RESERVED:
            raise ValueError(
                f"a parameter cannot be called {name!r}: names are text and not among "
                f"{', '.join(RESERVED)}, which a campaign uses"
            )
    return list(first)


def plain(value: Any) -> bool | int | float | str | None:
    """Return a plain value as Python's own type; raise `TypeError` for anything else."""
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    if value is None or isinstance(value, int | float | str):  # a bool is an int
        return value
    raise TypeError(f"{type(value).__name__} is no plain value")
