"""A model structure: its parameters, simulation and sensitivities; the error of identification."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.checks import between, did_you_mean, finite_number, one_of, shown

# How close to 0 and 1 a parameter of (0, 1) may come during the search.
UNIT_MARGIN = 1e-9

# Relative step of central differences: errors of truncation (∝ step²) and rounding (∝ 1/step) are
# about equal.
DIFFERENCE = float(np.cbrt(np.finfo(float).eps))

# Step [s] of the dissertation's models.
MODEL_STEP = 0.1


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
    """The coordinate in which a parameter is searched, and the widest interval of use."""

    to: Callable
    back: Callable
    # Derivative of the parameter by the coordinate.
    slope: Callable
    low: float = -np.inf
    high: float = np.inf
    # Greatest half-width of a 95 % interval at a value of the parameter; wider ones mark it as
    # weak.
    useful: Callable = lambda value: np.inf


COORDINATES = {
    "plain": Coordinate(lambda v: v, lambda x: x, lambda x: 1.0),
    # −ln(1 − a) is the logarithm of the time constant 1/(1 − a): equal steps are equal ratios of
    # time constants.
    "rate": Coordinate(
        lambda v: -np.log1p(-v),
        lambda x: -np.expm1(-x),
        lambda x: np.exp(-x),
        UNIT_MARGIN,
        1.0 - UNIT_MARGIN,
        lambda v: 0.5 * (1.0 - v),
    ),
    "logit": Coordinate(
        lambda v: np.log(v) - np.log1p(-v),
        lambda x: 1.0 / (1.0 + np.exp(-x)),
        lambda x: (1.0 / (1.0 + np.exp(-x))) * (1.0 - 1.0 / (1.0 + np.exp(-x))),
        UNIT_MARGIN,
        1.0 - UNIT_MARGIN,
        lambda v: min(0.25, v, 1.0 - v),
    ),
}


@dataclass(frozen=True)
class Parameter:
    """
    A parameter, or the initial state of a run, of a `Structure`.

    Parameters
    ----------
    name : str
        Its name: the argument of `Structure.simulate`.
    low, high : float
        Bounds; −∞ and ∞ when not given.
    guess : float, optional
        Where the search starts; the middle of the bounds when not given.
    search : {"plain", "rate", "logit"} or callable
        The coordinate of the search: the parameter itself; −ln(1 − a), for the share kept over one
        sample, in (0, 1); the log odds, for a share in (0, 1). Or a function of the initial guess
        that returns a `Coordinate`.
    span : tuple of str, optional
        Two parameters whose difference is the scale of this one: if its 95 % interval exceeds ±
        half that difference, the parameter is reported as weak.
    hint : str
        What to record when the data determine the parameter weakly.
    ends : mapping of float to str
        For a bound at which an estimate is legitimate: what it means. An estimate there is no
        reason for doubt.

    Raises
    ------
    ValueError
        If the name is no Python name, or the bounds are empty.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.Parameter("rise", 0.0, 0.1, guess=0.01).low
    0.0
    """

    name: str
    low: float = -np.inf
    high: float = np.inf
    guess: float | None = None
    search: str | Callable[[Mapping], Coordinate] = "plain"
    span: tuple[str, str] | None = None
    hint: str = "record phases that move the model more"
    ends: Mapping[float, str] = field(default_factory=dict)

    def __post_init__(self):
        if not isinstance(self.name, str) or not self.name.isidentifier():
            raise ValueError(
                f"the name of a parameter must be a Python name, got {shown(self.name)}"
            )
        if not callable(self.search):
            one_of(f"search of {self.name}", self.search, COORDINATES, "a function")
            coordinate = COORDINATES[self.search]
            object.__setattr__(self, "low", max(float(self.low), coordinate.low))
            object.__setattr__(self, "high", min(float(self.high), coordinate.high))
        if not self.low < self.high:
            raise ValueError(
                f"{self.name} needs bounds with low < high, got ({self.low}, {self.high})"
            )
        if self.guess is not None:
            between(f"guess of {self.name}", self.guess, self.low, self.high)

    def coordinate(self, guess: Mapping) -> Coordinate:
        """
        Return the coordinate of the search.

        Parameters
        ----------
        guess : mapping
            The initial guess, by name.
        """
        return self.search(guess) if callable(self.search) else COORDINATES[self.search]

    def useful_half_width(self, values: Mapping) -> float:
        """
        Return the greatest half-width of a 95 % interval that does not mark the parameter as weak.

        Parameters
        ----------
        values : mapping
            The estimates, by name.
        """
        if self.span is not None:
            low, high = self.span
            return 0.5 * abs(values[high] - values[low])
        useful = self.coordinate(values).useful(values[self.name])
        # As for a share in (0, 1): an interval over half the allowed range tells nothing.
        return min(useful, 0.25 * (self.high - self.low)) if self.search == "plain" else useful


@dataclass(frozen=True, eq=False)
class LinearForm:
    """
    The one-step equations of a structure that is linear in some coefficients.

    `fit(..., method="regression")` solves them.

    Parameters
    ----------
    coefficients : tuple of str
        Names of the coefficients.
    equations : callable
        From a run to the regressors, shape (p, n), and the left-hand sides, shape (n,).
    parameters : callable
        From the coefficients to the structure's parameters, in order. It is differentiated by
        complex steps, so it must be built from arithmetic.
    initial : callable
        From a run to its initial states, in order: where the fitted model is simulated from.
    caution : str
        What a reader must know of these estimates.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> form = tl.LinearForm(
    ...     coefficients=("c", "d"),
    ...     equations=lambda run: (np.stack([run["p_r"][:-1], run["mode"][:-1]]), run["p_r"][1:]),
    ...     parameters=lambda c, d: (c, d / (1 - c)),
    ...     initial=lambda run: (run["p_r"][0],),
    ... )
    >>> form.coefficients
    ('c', 'd')
    """

    coefficients: tuple[str, ...]
    equations: Callable
    parameters: Callable
    initial: Callable
    caution: str = (
        "Least squares on one-step predictions: noise in the regressors biases the parameters."
    )


# The remedy of the dissertation's own models.
POSTERIOR = (
    "From columns mode, p_h and p_r, trustlab.sample_posterior says what these data do determine."
)


@dataclass(frozen=True, eq=False)
class Structure:
    """
    A model structure that `fit` can identify: the unknowns, the outputs, and their simulation.

    Parameters
    ----------
    name : str
        What the model is called in results and errors.
    parameters : sequence of Parameter
        Parameters that all runs share.
    outputs : sequence of str
        Columns of a session that the model explains.
    simulate : callable
        ``simulate(run, **values)``, with the parameters and initial states by name; ``run["mode"]``
        is a column, shape (N,). It returns the output, shape (N,), or a tuple of outputs. Not
        needed where `sensitivities` is given.
    initial : sequence of Parameter
        Initial states; every run has its own.
    inputs : sequence of str
        Columns that the simulation reads. Residuals are tested for correlation with the first.
    sensitivities : callable, optional
        ``sensitivities(run, **values)`` returns the outputs and, for each, its derivatives, shape
        (N, number of names in `affected_by`). Central differences of `simulate` when not given.
    affected_by : mapping, optional
        Names of the parameters and initial states that affect each output, by output; all by
        default.
    guess : callable, optional
        ``guess(runs, limits)`` returns starting values by name, or several such mappings, best
        first, where the likelihood has several optima; an initial state may have one value per
        run.
    model : callable, optional
        ``model(**parameters)`` makes `FitResult.model` from the estimates; a dictionary of them
        when not given.
    derived : mapping, optional
        Further rows of the table, by name: functions of the dictionary of estimates, built from
        arithmetic.
    check : callable, optional
        ``check(runs, limits)`` raises `IdentificationError` if the data cannot identify the
        structure.
    linear : LinearForm, optional
        The structure as a linear regression.
    step : float, optional
        Time step of the model [s]: a fit to a log with a longer sample time is reported as doubtful
        unless it is given a step.
    remedy : str
        What to do instead where a fit has success = False; a sentence at the end of its message.

    Raises
    ------
    ValueError
        If a name is repeated, or a field does not fit the others.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> def simulate(run, rate, p_r0):
    ...     return 0.24 + (p_r0 - 0.24) * np.exp(-rate * np.arange(len(run["mode"])))
    >>> rate, start = tl.Parameter("rate", 0.0, 1.0), tl.Parameter("p_r0", 0.0, 1.0)
    >>> decay = tl.Structure("decay", [rate], outputs="p_r", simulate=simulate, initial=[start])
    >>> decay.name, decay.outputs
    ('decay', ('p_r',))
    """

    name: str
    parameters: Sequence[Parameter]
    outputs: Sequence[str]
    simulate: Callable = None
    initial: Sequence[Parameter] = ()
    inputs: Sequence[str] = ("mode",)
    sensitivities: Callable | None = None
    affected_by: Mapping[str, Sequence[str]] | None = None
    guess: Callable | None = None
    model: Callable | None = None
    derived: Mapping[str, Callable] = field(default_factory=dict)
    check: Callable | None = None
    linear: LinearForm | None = None
    step: float | None = None
    remedy: str = ""

    how_to_get = "build one with trustlab.Structure(name, parameters=…, outputs=…, simulate=…)"

    def __post_init__(self):
        for name in ("outputs", "inputs", "parameters", "initial"):
            value = getattr(self, name)
            value = (value,) if isinstance(value, str) else tuple(value)
            object.__setattr__(self, name, value)
        for name in ("parameters", "initial"):
            if not all(isinstance(parameter, Parameter) for parameter in getattr(self, name)):
                raise ValueError(
                    f"{name} of {self.name!r} must be a sequence of trustlab.Parameter"
                )
        if not self.parameters or not self.outputs:
            raise ValueError(f"structure {self.name!r} needs at least one parameter and one output")
        if not callable(self.simulate) and not callable(self.sensitivities):
            raise ValueError(f"structure {self.name!r} needs a function simulate or sensitivities")
        repeated = {name for name in self.names if self.names.count(name) > 1}
        if repeated:
            raise ValueError(
                f"structure {self.name!r} has two parameters called {sorted(repeated)[0]!r}"
            )

    @cached_property
    def unknowns(self) -> tuple[Parameter, ...]:
        """The parameters, then the initial states."""
        return (*self.parameters, *self.initial)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, then of the initial states."""
        return tuple(parameter.name for parameter in self.unknowns)

    def columns_of(self, output: str) -> list[int]:
        """
        Return the indices, in `names`, of what affects an output: the columns of its derivatives.

        Parameters
        ----------
        output : str
            One of `outputs`.
        """
        moving = self.names if self.affected_by is None else self.affected_by[output]
        return [self.names.index(name) for name in moving]

    def predict(
        self, run: Any, values: Mapping[str, float]
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """
        Return the simulated outputs of a run and their derivatives.

        Parameters
        ----------
        run : Run
            The run.
        values : mapping
            Parameters and the run's initial states, by name.
        """
        if self.sensitivities is not None:
            return self.sensitivities(run, **values)
        outputs = self._simulated(run, values)
        columns = [self.columns_of(name) for name in self.outputs]
        jacobians = [np.empty((run.size, len(numbers))) for numbers in columns]
        for number, parameter in enumerate(self.unknowns):
            low, high = _around(parameter, values[parameter.name])
            below = self._simulated(run, {**values, parameter.name: low})
            above = self._simulated(run, {**values, parameter.name: high})
            for j, numbers in enumerate(columns):
                if number in numbers:
                    slope = (above[j] - below[j]) / (high - low)
                    jacobians[j][:, numbers.index(number)] = slope
        return outputs, jacobians

    def _simulated(self, run, values: Mapping[str, float]) -> list[np.ndarray]:
        """Simulate by the user's function and check what it returns."""
        outputs = self.simulate(run, **values)
        outputs = outputs if isinstance(outputs, tuple) else (outputs,)
        arrays = [np.array(output, dtype=float) for output in outputs]
        self._check_shapes("simulate", arrays, [(run.size,)] * len(self.outputs))
        return arrays

    def check_sensitivities(
        self, run: Any, outputs: Sequence[np.ndarray], jacobians: Sequence[np.ndarray]
    ) -> None:
        """
        Refuse what `sensitivities` returns unless each output has arrays of the right shape.

        Parameters
        ----------
        run : Run
            The run that was simulated.
        outputs, jacobians : sequence of numpy.ndarray
            What was returned.
        """
        self._check_shapes("sensitivities", outputs, [(run.size,)] * len(self.outputs))
        shapes = [(run.size, len(self.columns_of(name))) for name in self.outputs]
        self._check_shapes("the derivatives of sensitivities", jacobians, shapes)

    def _check_shapes(
        self, function: str, arrays: Sequence[np.ndarray], expected: list[tuple]
    ) -> None:
        """Refuse what a user's function returns unless each output has an array of its shape."""
        shapes = [array.shape for array in arrays]
        if shapes != expected:
            raise ValueError(
                f"{function} of structure {self.name!r} must return {' and '.join(self.outputs)} "
                f"in the shapes {expected}, got {shapes}"
            )

    def limits(
        self, fixed: Mapping[str, float] | None = None, bounds: Mapping[str, tuple] | None = None
    ) -> dict[str, tuple[float, float]]:
        """
        Return the lowest and the highest value of every parameter; equal values for a fixed one.

        Parameters
        ----------
        fixed : mapping, optional
            Parameters to hold fixed: values by name.
        bounds : mapping, optional
            (low, high) by name; None for an open side.

        Raises
        ------
        ValueError
            If a name or a value is not possible.
        """
        fixed = {} if fixed is None else fixed
        bounds = {} if bounds is None else bounds
        for argument, values in (("fixed", fixed), ("bounds", bounds)):
            if not isinstance(values, Mapping):
                raise ValueError(
                    f"{argument} must be a dictionary by parameter, {{'a': ...}}, got {values!r}"
                )
            self.check_names(values, argument)
        for name in set(fixed) & set(bounds):
            raise ValueError(f"{name} is both fixed and bounded; give one of them")
        limits = {}
        for parameter in self.unknowns:
            name = parameter.name
            low, high = parameter.low, parameter.high
            if name in bounds:
                low, high = _narrowed(parameter, bounds[name])
            if name in fixed:
                value = finite_number(f"fixed {name}", fixed[name])
                if not low <= value <= high:
                    raise ValueError(f"{name} is fixed at {value}, outside ({low:.3g}, {high:.9g})")
                low = high = value
            limits[name] = (low, high)
        for span in {parameter.span for parameter in self.parameters if parameter.span}:
            least, greatest = (fixed.get(name) for name in span)
            if least is not None and greatest is not None and not least < greatest:
                raise ValueError(
                    f"{span[0]} is fixed at {least}, not below {span[1]} at {greatest}"
                )
        return limits

    def check_names(self, values: Mapping, argument: str) -> None:
        """
        Refuse a name that is no parameter, and suggest the one that was meant.

        Parameters
        ----------
        values : mapping
            Values by name.
        argument : str
            The argument, for the error.
        """
        for name in values:
            if name not in self.names:
                # "a" is meant for human_a or robot_a where a structure has both.
                longer = [known for known in self.names if known.endswith(f"_{name}")]
                hint = f"; did you mean {' or '.join(map(repr, longer))}?" if longer else ""
                raise ValueError(
                    f"{argument} names {name!r}, which is no parameter here "
                    f"({', '.join(self.names)}){hint or did_you_mean(name, self.names)}"
                )


def _narrowed(parameter: Parameter, pair: tuple) -> tuple[float, float]:
    """Return the user's bounds within those of the parameter."""
    name = parameter.name
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        raise ValueError(
            f"bounds of {name} must be a pair (low, high), None for an open side, got {pair!r}"
        )
    low, high = pair
    low = parameter.low if low is None else finite_number(f"lower bound of {name}", low)
    high = parameter.high if high is None else finite_number(f"upper bound of {name}", high)
    if not low < high:
        raise ValueError(f"bounds of {name} must be (low, high) with low < high, got {pair}")
    if high <= parameter.low or low >= parameter.high:
        raise ValueError(
            f"bounds of {name}, {pair}, lie outside [{parameter.low:g}, {parameter.high:g}]"
        )
    return max(parameter.low, low), min(parameter.high, high)


def _around(parameter: Parameter, value: float) -> tuple[float, float]:
    """Return a value on each side, for central differences; at a bound, the value itself."""
    coordinate = COORDINATES["plain" if callable(parameter.search) else parameter.search]
    x = coordinate.to(value)
    width = coordinate.to(parameter.high) - coordinate.to(parameter.low)
    # A parameter near 0 has no scale of its own: a thousandth of its range, or of 1, takes its
    # place.
    step = DIFFERENCE * max(abs(x), 1e-3 * min(width, 1.0))
    low, high = coordinate.back(x - step), coordinate.back(x + step)
    return max(low, parameter.low), min(high, parameter.high)
