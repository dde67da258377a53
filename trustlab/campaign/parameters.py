"""Parameters of many runs: grids and draws."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trustlab.campaign.worker import RESERVED
from trustlab.models.checks import in_order, whole_number


class ParameterGrid(Sequence):
    """
    Every combination of values, each made when it is asked for: the last name varies fastest,
    repeats faster still.

    Parameters
    ----------
    axes : dict of list
        Values by name.
    repeats : int
        How often each combination stands in a row: runs that differ only by their seed.
    """

    def __init__(self, axes: Mapping[str, Iterable], repeats: int = 1):
        if not isinstance(axes, Mapping) or not axes:
            raise ValueError(
                "a grid needs values by name, such as parameter_grid(lower=[0.0, 0.1])"
            )
        self.axes = {name: _values(name, values) for name, values in axes.items()}
        self.repeats = whole_number("repeats", repeats)
        self.shape = tuple(len(values) for values in self.axes.values())

    def __len__(self) -> int:
        return math.prod(self.shape) * self.repeats

    def __getitem__(self, i: Any) -> Any:
        runs = range(len(self))[i]
        if isinstance(runs, range):  # a slice
            return [self[run] for run in runs]
        at = np.unravel_index(runs // self.repeats, self.shape)
        return {name: values[k] for (name, values), k in zip(self.axes.items(), at, strict=True)}


def _values(name: str, values: Iterable) -> list:
    if (
        isinstance(values, str | bytes)
        or not isinstance(values, Iterable)
        or isinstance(values, Mapping)
    ):
        raise ValueError(
            f"{name} must be a list or array of values, got {values!r}; write [{values!r}] for one"
        )
    array = values.tolist() if isinstance(values, np.ndarray) and values.ndim == 1 else list(values)
    if not array:
        raise ValueError(f"{name} has no values; give at least one")
    return array


def parameter_grid(repeats: int = 1, **axes: Iterable) -> ParameterGrid:
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
    ParameterGrid
        A sequence of dicts; the last name varies fastest.

    Raises
    ------
    ValueError
        If a name has no values or a single value that is not in a list.

    Examples
    --------
    >>> list(parameter_grid(lower=[0.0, 0.1], upper=[0.4, 0.5]))[1]
    {'lower': 0.0, 'upper': 0.5}
    """
    return ParameterGrid(axes, repeats)


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
    # A parameter of the task may be called n too: parameter_draws(100, n=(5, 20)).
    named = distributions.get("n")
    if n is None and not isinstance(named, tuple | list) and not hasattr(named, "rvs"):
        n = distributions.pop("n", None)
    n = whole_number("n", n)
    if not distributions:
        raise ValueError("give at least one parameter, such as beta=(0.6, 0.8)")
    if not isinstance(seed, np.random.SeedSequence):
        seed = np.random.SeedSequence(whole_number("seed", seed, least=0))
    columns = {}
    for name, kind in distributions.items():
        key = (
            *seed.spawn_key,
            *name.encode(),
        )  # the stream follows from the name, not from the order
        child = np.random.SeedSequence(seed.entropy, spawn_key=key, pool_size=seed.pool_size)
        columns[name] = _drawn(name, kind, n, np.random.default_rng(child))
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def interval(name: str, pair: tuple) -> tuple[float, float]:
    """Return the ends of a range as floats, low < high."""
    if len(pair) != 2:
        raise ValueError(f"{name} must be (low, high), got {pair}")
    return in_order(f"{name}[0]", pair[0], f"{name}[1]", pair[1])


def _drawn(name: str, kind: Any, n: int, rng: np.random.Generator) -> list:
    if isinstance(kind, tuple):
        return rng.uniform(*interval(name, kind), n).tolist()
    if isinstance(kind, list) and kind:
        return [kind[k] for k in rng.integers(len(kind), size=n)]
    if callable(getattr(kind, "rvs", None)):
        draws = np.asarray(kind.rvs(size=n, random_state=rng))
        if draws.shape != (n,) or not np.all(np.isfinite(draws)):
            raise ValueError(
                f"the distribution of {name} must give {n} finite numbers, got shape {draws.shape}"
            )
        return draws.tolist()
    raise ValueError(
        f"{name} must be (low, high), a list of values or a SciPy distribution, got "
        f"{type(kind).__name__}"
    )


def checked_names(parameters: Sequence[Mapping]) -> list[str]:
    """
    Return the names of the parameters; raise unless there is a dict per run, with the same names in
    each.
    """
    if isinstance(parameters, Mapping):
        raise ValueError(
            "parameters must be a list of dicts, one per run, got one dict; for every "
            "combination of its values use parameter_grid(**parameters)"
        )
    frame = hasattr(parameters, "columns")
    listed = hasattr(parameters, "__len__") and hasattr(parameters, "__getitem__")
    if frame or not listed or isinstance(parameters, str | bytes):
        remedy = "; use frame.to_dict('records')" if frame else ""
        raise ValueError(
            "parameters must be a list of dicts, one per run, got "
            f"{type(parameters).__name__}{remedy}"
        )
    if len(parameters) == 0:
        raise ValueError("parameters is empty: there is nothing to run")
    # Every run of a grid has the names of its axes; a grid of a million runs need not be made to
    # see that.
    first = parameters[0]
    runs = [first] if isinstance(parameters, ParameterGrid) else parameters
    for run, values in enumerate(runs):
        if not isinstance(values, Mapping):
            raise ValueError(f"parameters of run {run} must be a dict, got {type(values).__name__}")
        if values.keys() != first.keys():
            raise ValueError(
                f"run {run} has parameters {', '.join(map(str, values)) or 'none'}, run 0 has "
                f"{', '.join(map(str, first)) or 'none'}; give every run the same names"
            )
    names = list(first)
    for name in names:
        if not isinstance(name, str) or not name:
            raise ValueError(f"names of parameters must be text, got {name!r} in run 0")
        if name in RESERVED:
            reason = (
                "every run is given a seed of its own"
                if name == "seed"
                else "the table has a column of that name"
            )
            raise ValueError(
                f"a parameter cannot be called {name!r}: {reason}; remove or rename it"
            )
    return names
