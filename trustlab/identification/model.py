"""A model: equations with unknowns, and the coordinates in which these are searched."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.checks import (
    Checked,
    between,
    did_you_mean,
    finite_number,
    of_class,
    one_of,
    open_unit,
    table_of,
)

# How close to 0 and 1 an unknown in (0, 1) may come during the search.
UNIT_MARGIN = 1e-9


class IdentificationError(ValueError):
    """
    The data do not identify a model.

    Parameters
    ----------
    message : str
        The reason and the remedy.
    parameters : tuple of str
        The parameters that are not identifiable.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv").between(0.0, 100.0)
    >>> try:
    ...     tl.fit_robot(session)
    ... except tl.IdentificationError as error:
    ...     print(error.parameters)
    ('p_min', 'p_max')
    """

    def __init__(self, message: str, parameters: tuple[str, ...] = ()):
        super().__init__(message)
        self.parameters = tuple(parameters)


class Coordinate(NamedTuple):
    """How an unknown is transformed for the search: there and back, and its widest bounds."""

    to: Callable
    back: Callable
    low: float = -np.inf
    high: float = np.inf
    # Greatest half-width of a 95 % interval that still tells something of a value, whose bounds
    # are so far apart.
    useful: Callable = lambda value, span: np.inf


# (2.6) goes as r^β at r = 0 and as (1 − r)^(1 − β) at r = 1, with infinite slopes there: a power of
# the odds makes them less steep.
POWER = 0.7

COORDINATES = {
    "plain": Coordinate(lambda v: v, lambda x: x, useful=lambda v, span: 0.25 * span),
    # −ln(1 − a) is the logarithm of the time constant: equal steps are equal ratios.
    "rate": Coordinate(
        lambda v: -np.log1p(-v),
        lambda x: -np.expm1(-x),
        UNIT_MARGIN,
        1.0 - UNIT_MARGIN,
        lambda v, _: 0.5 * (1.0 - v),
    ),
    "odds": Coordinate(
        lambda v: np.log(v) - np.log1p(-v),
        lambda x: 1.0 / (1.0 + np.exp(-x)),
        UNIT_MARGIN,
        1.0 - UNIT_MARGIN,
        lambda v, _: min(0.25, v, 1.0 - v),
    ),
    "load": Coordinate(
        lambda v: v**POWER / (v**POWER + (1.0 - v) ** POWER),
        lambda x: x ** (1 / POWER) / (x ** (1 / POWER) + (1.0 - x) ** (1 / POWER)),
        0.0,
        1.0,
    ),
}


@dataclass(frozen=True, eq=False)
class Model(Checked):
    """
    Equations with unknowns: what `fit` identifies.

    Parameters
    ----------
    names : sequence of str
        Unknowns that all runs share.
    states : sequence of str
        Initial states; every run has its own.
    outputs : sequence of str
        Columns of a session that the model explains.
    low, high : sequence of float
        Bounds of the names, then of the states; −∞ and ∞ when not given.
    size : sequence of float, or callable
        Largest half-width of the 95 % interval at which each name still counts as determined; or a
        function of the dictionary of estimates that returns some of these by name. Else a quarter
        of the range, or what suits the coordinate.
    simulate : callable
        ``simulate(run, **values)``, with names and states as numbers; ``run["mode"]`` is a column,
        shape (N,), `run.t` [s] its time. It returns the output, shape (N,), or a tuple of outputs.
    starts : callable, optional
        ``starts(runs, limits)`` returns dictionaries of values from which to search, the best
        first; a state may have one value per run. The middle of the bounds when not given.
    inputs : sequence of str
        Columns that the simulation reads, by default mode. Residuals are tested for correlation
        with the first.
    lanes : bool
        Whether `simulate` takes arrays, shape (L,), and returns outputs of shape (N, L): many
        simulations in one call.
    coordinates : mapping, optional
        How unknowns are searched, by name: "rate", for the share kept over one sample, in (0, 1);
        "odds", for a share in (0, 1); "load", for a utilization in [0, 1]; else "plain".
    build : callable, optional
        ``build(**values)`` makes `FitResult.model` from the estimates; a dictionary of them when
        not given.
    derived : mapping, optional
        Further rows of the table, by name: functions of the estimates, ``f(**values)``, analytic
        ones, which are called with complex numbers for their derivatives.
    hints : mapping, optional
        What to record where an unknown is weak, by name.
    check : callable, optional
        ``check(runs, limits)`` raises `IdentificationError` if no search can succeed.

    Raises
    ------
    ValueError
        If names are repeated, or a field does not fit the others.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> def decay(run, rate, start):
    ...     return 0.24 + start * np.exp(-rate * (run.t - run.t[0]))
    >>> model = tl.Model(["rate"], ["start"], "p_r", [0.0, 0.0], [0.2, 1.0], simulate=decay)
    >>> session = tl.read_session("data/sessions/pilot.csv").between(600.0, 700.0)
    >>> round(1.0 / tl.fit(model, session).model["rate"])
    25
    """

    names: tuple[str, ...]
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    low: Sequence[float] = ()
    high: Sequence[float] = ()
    size: Any = ()
    simulate: Callable = None
    starts: Callable | None = None
    inputs: tuple[str, ...] = ("mode",)
    lanes: bool = False
    coordinates: Mapping[str, str] = field(default_factory=dict)
    build: Callable | None = None
    derived: Mapping[str, Callable] = field(default_factory=dict)
    hints: Mapping[str, str] = field(default_factory=dict)
    check: Callable | None = None

    how_to_get = "build one with trustlab.Model(names, states, outputs, …, simulate=…)"

    def __post_init__(self):
        super().__post_init__()
        for name in ("names", "states", "outputs", "inputs"):
            value = getattr(self, name)
            self._set(name, (value,) if isinstance(value, str) else value, str)
        for name in ("coordinates", "derived", "hints"):
            of_class(name, getattr(self, name), dict)
        if not (self.names and self.outputs and self.inputs):
            raise ValueError("a model needs names, outputs and inputs")
        repeated = [name for name in self.unknowns if self.unknowns.count(name) > 1]
        if repeated:
            raise ValueError(f"a model has two unknowns called {repeated[0]!r}")
        for name in ("coordinates", "hints"):
            self.check_names(getattr(self, name), name)
        for name, kind in self.coordinates.items():
            one_of(f"coordinate of {name}", kind, COORDINATES)
        if not callable(self.size):
            self._set("size", self.size, Real, len(self.names))
        for side, unbounded in (("low", -np.inf), ("high", np.inf)):
            count = len(self.unknowns)
            self._set(side, getattr(self, side), Real, count)
            self.__dict__[side] = getattr(self, side) or (unbounded,) * count
        for name, (low, high) in self.limits().items():
            if not low < high:
                raise ValueError(f"{name} needs bounds with low < high, got ({low}, {high})")

    def _set(self, name: str, values: Any, kind: type, size: int = 0) -> None:
        """Set a field to a tuple of items of one kind, of this size where it is not empty."""
        sequence = isinstance(values, (list, tuple, np.ndarray))
        if not sequence or not all(isinstance(value, kind) for value in values):
            words = "texts" if kind is str else "numbers"
            raise ValueError(f"{name} must be a list of {words}, got {values!r}")
        if size and len(values) not in (0, size):
            raise ValueError(f"{name} must have {size} numbers, got {len(values)}")
        self.__dict__[name] = tuple(values)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The names, then the states."""
        return (*self.names, *self.states)

    def coordinate(self, name: str) -> Coordinate:
        """
        Return the coordinate in which an unknown is searched.

        Parameters
        ----------
        name : str
            Which unknown.
        """
        return COORDINATES[self.coordinates.get(name, "plain")]

    def limits(
        self, fixed: Mapping[str, float] | None = None, bounds: Mapping[str, tuple] | None = None
    ) -> dict[str, tuple[float, float]]:
        """
        Return the lowest and the highest value of every unknown; equal values for a fixed one.

        Parameters
        ----------
        fixed : mapping, optional
            Unknowns to hold fixed: values by name.
        bounds : mapping, optional
            (low, high) by name; None for an open side.
        """
        fixed = table_of("fixed", {} if fixed is None else fixed)
        bounds = table_of("bounds", {} if bounds is None else bounds)
        self.check_names(fixed, "fixed")
        self.check_names(bounds, "bounds")
        for name in set(fixed) & set(bounds):
            raise ValueError(f"{name} is both fixed and bounded; give one of them")
        limits = {}
        for name, *ends in zip(self.unknowns, self.low, self.high, strict=True):
            coordinate = self.coordinate(name)
            low, high = np.clip(ends, coordinate.low, coordinate.high).tolist()
            if name in fixed:
                if coordinate.low > 0.0:
                    open_unit(f"fixed {name}", fixed[name])
                low = high = between(f"fixed {name}", fixed[name], low, high)
            if name in bounds:
                low, high = _narrowed(name, bounds[name], low, high)
            limits[name] = (low, high)
        return limits

    def check_names(self, values: Sequence[str] | Mapping, argument: str) -> None:
        """
        Refuse a name that is no unknown, and suggest the one that was meant.

        Parameters
        ----------
        values : sequence or mapping
            Names, or values by name.
        argument : str
            What they were given as.

        Raises
        ------
        ValueError
            If a name is no unknown.
        """
        for name in values:
            if name not in self.unknowns:
                raise ValueError(
                    f"{argument} names {name!r}, which is no parameter here "
                    f"({', '.join(self.unknowns)}){did_you_mean(name, self.unknowns)}"
                )

    def outputs_of(self, run: Any, values: Mapping[str, np.ndarray]) -> tuple:
        """
        Return the simulated outputs of a run, shape (N, L) each.

        Parameters
        ----------
        run : Run
            The run.
        values : mapping
            Names and states, shape (L,) each.
        """
        rows = [*zip(*values.values(), strict=True)]
        if self.lanes:
            return self._checked(self.simulate(run, **values), run.size, len(rows))
        lanes = [dict(zip(values, map(float, row), strict=True)) for row in rows]
        outputs = [self._checked(self.simulate(run, **lane), run.size) for lane in lanes]
        return tuple(map(np.column_stack, zip(*outputs, strict=True)))

    def _checked(self, outputs: Any, *shape: int) -> tuple:
        """Return one output or several as a tuple of arrays of this shape."""
        outputs = outputs if isinstance(outputs, tuple) else (outputs,)
        shapes = [np.shape(output) for output in outputs]
        if shapes != [shape] * len(self.outputs):
            raise ValueError(
                f"simulate must return {' and '.join(self.outputs)}, shape {shape} each, got "
                f"{' and '.join(map(str, shapes))}"
            )
        return tuple(np.asarray(output, dtype=float) for output in outputs)

    def useful(self, values: Mapping[str, float]) -> dict[str, float]:
        """
        Return the largest half-width of the 95 % interval at which a name counts as determined.

        Parameters
        ----------
        values : mapping
            Estimates by name.
        """
        rows = zip(self.names, self.low, self.high, strict=False)
        widths = {n: self.coordinate(n).useful(values[n], high - low) for n, low, high in rows}
        size = self.size
        return widths | dict(
            size(values) if callable(size) else zip(self.names, size, strict=False)
        )


def _narrowed(name: str, pair: tuple, low: float, high: float) -> tuple[float, float]:
    """Return the user's bounds within those of the unknown."""
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        raise ValueError(
            f"bounds of {name} must be a pair (low, high), None for an open side, got {pair!r}"
        )
    least, most = pair
    least = low if least is None else finite_number(f"lower bound of {name}", least)
    most = high if most is None else finite_number(f"upper bound of {name}", most)
    ends = max(low, least), min(high, most)
    if not ends[0] < ends[1]:
        raise ValueError(
            f"bounds of {name} must be (low, high) with low < high, partly within "
            f"[{low:g}, {high:g}], got {pair}"
        )
    return ends
