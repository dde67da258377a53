"""Parameters of many runs: grids and draws."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence, Set
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import in_order, shown, whole_number, whole_seed

# Columns of the table, and the argument of the seed: names of neither parameters nor results.
RESERVED = {"run", "seed", "failed", "error", "traceback"}

# Streams of draws begin with this key, those of runs with the index of a run, which is smaller.
DRAWS = 2**32 - 1

# The longest campaign whose parameters fit into memory.
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
        If a name has no values, a set, dict or table of them, or a single one that is in no list.

    Examples
    --------
    >>> import trustlab as tl
    >>> list(tl.parameter_grid(lower=[0.0, 0.1], upper=[0.4, 0.5]))[1]
    {'lower': 0.0, 'upper': 0.5}
    """
    for name, values in axes.items():
        # Sets have no order; a dict or a table would give its names.
        single = isinstance(values, str | bytes | Set | Mapping | pd.DataFrame)
        if single or not np.iterable(values):
            raise ValueError(
                f"{name} must be a list of values, got {shown(values)}; write [{shown(values)}] "
                "for one"
            )
    lists = [v.tolist() if isinstance(v, np.ndarray) else list(v) for v in axes.values()]
    if not axes or not all(lists):
        raise ValueError(f"give at least one value for each name, got {shown(axes)}")
    lists.append([None] * whole_number("repeats", repeats, most=MOST_RUNS))
    whole_number("the number of runs", math.prod(map(len, lists)), most=MOST_RUNS)
    return [dict(zip(axes, values, strict=False)) for values in itertools.product(*lists)]


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
        If a distribution is of none of these kinds, a range is empty, or `rvs` returns anything but
        n finite numbers.

    Examples
    --------
    >>> from scipy import stats
    >>> import trustlab as tl
    >>> draws = tl.parameter_draws(3, seed=0, upper=stats.uniform(0.2, 0.2), laps=[4, 8])
    >>> [round(draw["upper"], 3) for draw in draws]
    [0.304, 0.35, 0.353]
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
        rng = np.random.default_rng(child_of(seed, DRAWS, *name.encode()))
        if isinstance(kind, list) and kind:
            columns.append([kind[k] for k in rng.integers(len(kind), size=n)])
        else:
            draws = np.asarray(distribution(name, kind).rvs(size=n, random_state=rng))
            if draws.shape != (n,) or not np.isfinite(draws).all():
                raise ValueError(f"{name} must be drawn as {n} finite numbers, got {shown(draws)}")
            columns.append(draws.tolist())
    return [dict(zip(distributions, row, strict=True)) for row in zip(*columns, strict=True)]


def distribution(name: str, kind: Any) -> Any:
    """Return a distribution of SciPy, of a range (low, high) the uniform one."""
    from scipy import stats

    if isinstance(kind, tuple) and len(kind) == 2:
        low, high = in_order(f"{name}[0]", kind[0], f"{name}[1]", kind[1])
        return stats.uniform(low, high - low)
    if not hasattr(kind, "rvs"):
        raise ValueError(f"{name} must be (low, high) or a SciPy distribution, got {shown(kind)}")
    return kind


def seed_sequence(seed: Any) -> np.random.SeedSequence:
    """Return a seed as a SeedSequence."""
    if isinstance(seed, np.random.SeedSequence):
        return seed
    return np.random.SeedSequence(whole_seed(seed))


def child_of(seed: np.random.SeedSequence, *key: int) -> np.random.SeedSequence:
    """Return the child of a seed at a place, whatever children it has given away."""
    key = (*seed.spawn_key, *key)
    return np.random.SeedSequence(seed.entropy, spawn_key=key, pool_size=seed.pool_size)


def check_parameters(parameters: Any) -> None:
    """Raise unless every run has a dict with the same names."""
    of_dicts = isinstance(parameters, Sequence) and all(isinstance(x, Mapping) for x in parameters)
    if not of_dicts or not parameters:
        raise ValueError(
            f"parameters must be a list of dicts, one per run, got {shown(parameters)}; of a "
            "table, use frame.to_dict('records')"
        )
    first = parameters[0]
    for run, values in enumerate(parameters):
        if values.keys() != first.keys():
            raise ValueError(
                f"every run needs the same names, but run 0 has {shown(dict(first))} and run {run} "
                f"has {shown(dict(values))}"
            )
    if RESERVED & first.keys():
        raise ValueError(
            f"a parameter cannot be called {min(RESERVED & first.keys())!r}: a campaign uses "
            f"{', '.join(sorted(RESERVED))} itself"
        )
