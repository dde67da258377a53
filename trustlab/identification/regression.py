"""Linear regression with covariance: ARX models (Section 2.2.2) and linear structures."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from trustlab.identification.fit_result import (
    FitResult,
    gradient,
    parameter_table,
    run_fits,
    state_table,
    with_intervals,
)
from trustlab.identification.runs import Run
from trustlab.identification.structure import IdentificationError, Structure
from trustlab.models.checks import flag, whole_number
from trustlab.models.display import Result

# Up to this condition number (equilibrated) the normal equations are used, beyond it a singular
# value decomposition.
CONDITION_LIMIT = 1e5


@dataclass(frozen=True, eq=False, repr=False)
class ArxResult(Result):
    """
    A fitted ARX model, y(k) + a_1 y(k−1) + … + a_na y(k−na) = b_1 u(k−nk) + … + b_nb u(k−nk−nb+1) +
    c + e(k).

    Parameters
    ----------
    names : tuple of str
        Names of the coefficients: a1 … , b1 … (b1_1 … for several inputs: input, then lag), c.
    coefficients : numpy.ndarray, shape (p,)
        Estimates, in the order of `names`.
    covariance : numpy.ndarray, shape (p, p)
        Covariance of the estimates, s² (XᵀX)⁻¹.
    residuals : numpy.ndarray, shape (n,)
        One-step prediction errors.
    na : int
        Number of output lags.
    nb, nk : tuple of int
        Number of lags and delay of every input.
    intercept : bool
        Whether c was estimated.
    """

    title = "ARX"

    names: tuple[str, ...]
    coefficients: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    na: int
    nb: tuple[int, ...]
    nk: tuple[int, ...]
    intercept: bool

    @property
    def stderr(self) -> np.ndarray:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sigma(self) -> float:
        """Standard deviation of the prediction error, √(Σ e²/(n − p))."""
        return float(np.sqrt(self.residuals @ self.residuals / self.degrees_of_freedom))

    @property
    def degrees_of_freedom(self) -> int:
        """Equations less coefficients, n − p."""
        return self.residuals.size - self.coefficients.size

    @property
    def message(self) -> str:
        """How many equations were solved."""
        return f"{self.residuals.size} equations"

    def table(self, level: float = 0.95):
        """
        Return estimates with standard errors and t intervals.

        Parameters
        ----------
        level : float
            Level of the intervals, in (0, 1).

        Returns
        -------
        pandas.DataFrame
            Index `parameter`; columns value, stderr, ci_low, ci_high.
        """
        columns = {"value": self.coefficients, "stderr": self.stderr}
        table = pd.DataFrame(columns, index=pd.Index(self.names, name="parameter"))
        return with_intervals(table, level, self.degrees_of_freedom)


class LeastSquares(NamedTuple):
    """Estimates of a regression with covariance, residuals, and equations less coefficients."""

    values: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    degrees_of_freedom: int


def regression(design: np.ndarray, target: np.ndarray, names: tuple[str, ...]) -> LeastSquares:
    """
    Solve a least-squares problem; the covariance is s² (XXᵀ)⁻¹.

    `design` holds one regressor per row, shape (p, n); `names` are those of the coefficients, for
    the errors.
    """
    p, n = design.shape
    if n <= p:
        raise IdentificationError(f"{p} coefficients need more than {p} equations, got {n}", names)
    # Row by row: BLAS takes longer for the few, long rows of a product with its own transpose.
    gram = np.stack([design @ row for row in design])
    moment = design @ target
    scale = np.sqrt(np.diag(gram))
    if not np.isfinite(gram.sum() + moment.sum()):
        raise ValueError("the data are too large to square; scale them")
    if not (scale > 0.0).all():
        lost = names[int(np.argmin(scale))]
        raise IdentificationError(
            f"coefficient {lost} is not identifiable: its regressor is identically zero", (lost,)
        )
    # Regressors scaled to unit length: their units have no part in what counts as nearly collinear.
    sizes = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(gram / sizes)
    if values[0] > 0.0 and values[-1] < CONDITION_LIMIT * values[0]:
        inverse = (vectors / values) @ vectors.T / sizes
        coefficients = inverse @ moment
        # Normal equations square the condition number; one step of refinement with the residuals
        # wins the digits back.
        coefficients += inverse @ (design @ (target - coefficients @ design))
    else:
        # Singular values of the regressors themselves, whose condition number is the root of that
        # of their products.
        vectors, values, across = np.linalg.svd(design / scale[:, None], full_matrices=False)
        if values[-1] <= n * np.finfo(float).eps * values[0]:
            lost = names[int(np.argmax(np.abs(vectors[:, -1])))]
            raise IdentificationError(
                f"coefficient {lost} is not identifiable: its regressor is a linear combination "
                "of the others (does the input move?)",
                (lost,),
            )
        coefficients = vectors @ (across @ target / values) / scale
        inverse = (vectors / values**2) @ vectors.T / sizes
    residuals = target - coefficients @ design
    variance = residuals @ residuals / (n - p)
    return LeastSquares(coefficients, inverse * variance, residuals, n - p)


def arx(y, u, na: int = 1, nb=1, nk=1, intercept: bool = False) -> ArxResult:
    """
    Fit an ARX model by least squares.

    y(k) + a_1 y(k−1) + … + a_na y(k−na) = b_1 u(k−nk) + … + b_nb u(k−nk−nb+1) + c + e(k). With
    white noise on the measured output (rather than e(k) inside the recursion) the estimates are
    biased; `fit` and `fit_robot` simulate the model instead.

    Parameters
    ----------
    y : array_like, shape (N,), or list of such
        Output; a list holds one array per run, and no equation crosses from one run to the next.
    u : array_like, shape (N,) or (N, m), or list of such
        Inputs.
    na : int
        Number of output lags, ≥ 0.
    nb, nk : int or sequence of int
        Number of lags and delay (in samples) per input.
    intercept : bool
        Whether to estimate a constant c.

    Returns
    -------
    ArxResult

    Raises
    ------
    ValueError
        If shapes or orders do not fit, or a sample is not finite.
    IdentificationError
        If the data do not determine a coefficient.

    Notes
    -----
    Ljung, *System Identification: Theory for the User*, 2nd ed., Section 10.1.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> u = np.random.default_rng(0).normal(size=200)
    >>> y = np.zeros(200)
    >>> for k in range(199):
    ...     y[k + 1] = 0.9 * y[k] + 0.5 * u[k]
    >>> tl.arx(y, u).table()["value"].round(6).to_dict()
    {'a1': -0.9, 'b1': 0.5}
    """
    pairs = [(y, u)]
    if isinstance(y, (list, tuple)) and len(y) > 0 and np.ndim(y[0]) == 1:
        if len(y) != len(u):
            raise ValueError(
                f"y has {len(y)} runs and u has {len(u)}; give one input array for every run"
            )
        pairs = list(zip(y, u, strict=True))
    na, intercept = whole_number("na", na, least=0), flag("intercept", intercept)
    parts = []
    for y_run, u_run in pairs:
        y_run = np.ascontiguousarray(y_run, dtype=float)
        u_run = np.asarray(u_run, dtype=float)
        u_run = u_run[:, None] if u_run.ndim == 1 else u_run
        if y_run.ndim != 1 or u_run.ndim != 2 or len(u_run) != y_run.size:
            raise ValueError(
                f"y must be (N,) and u (N,) or (N, m), got {y_run.shape} and {u_run.shape}"
            )
        if not (np.isfinite(y_run).all() and np.isfinite(u_run).all()):
            raise ValueError("y and u must be finite; a sample is NaN or infinite")
        inputs = u_run.shape[1]
        lags = _per_input("nb", nb, inputs, least=1)
        delays = _per_input("nk", nk, inputs, least=0)
        parts.append(equations(y_run, u_run, na, lags, delays, intercept))
    names = _names(na, lags, intercept)
    values, covariance, residuals, _ = regression(*_stacked(parts), names)
    return ArxResult(names, values, covariance, residuals, na, lags, delays, bool(intercept))


def equations(
    y: np.ndarray, u: np.ndarray, na: int, nb: tuple[int, ...], nk: tuple[int, ...], intercept: bool
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return regressors, one per row, and left-hand sides of one run's ARX equations.

    `u` has shape (N, m).
    """
    first = max([na] + [delay + lags - 1 for delay, lags in zip(nk, nb, strict=True)])
    size = y.size - first
    if size < 1:
        raise IdentificationError(f"a run of {y.size} samples is too short for lags up to {first}")
    design = np.empty((na + sum(nb) + bool(intercept), size))
    for lag in range(1, na + 1):
        np.negative(y[first - lag : y.size - lag], out=design[lag - 1])
    delayed = [(i, lag) for i in range(len(nb)) for lag in range(nk[i], nk[i] + nb[i])]
    for row, (i, lag) in enumerate(delayed, start=na):
        design[row] = u[first - lag : y.size - lag, i]
    if intercept:
        design[-1] = 1.0
    return design, y[first:]


def _names(na: int, nb: tuple[int, ...], intercept: bool) -> tuple[str, ...]:
    """
    Return the names of the coefficients: a1, …, b1, … (input, then lag, for several inputs), c.
    """
    names = [f"a{lag}" for lag in range(1, na + 1)]
    for i, lags in enumerate(nb, start=1):
        prefix = "b" if len(nb) == 1 else f"b{i}_"
        names += [f"{prefix}{lag}" for lag in range(1, lags + 1)]
    return (*names, "c") if intercept else tuple(names)


def _per_input(name: str, value, inputs: int, least: int) -> tuple[int, ...]:
    """Return an order for every input."""
    values = (value,) * inputs if np.ndim(value) == 0 else tuple(value)
    if len(values) != inputs:
        raise ValueError(f"{name} names {len(values)} inputs, u has {inputs}")
    return tuple(whole_number(name, order, least=least) for order in values)


def _stacked(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Join the equations of all runs."""
    if len(parts) == 1:
        return parts[0]
    designs, targets = zip(*parts, strict=True)
    return np.concatenate(designs, axis=1), np.concatenate(targets)


def regress(structure: Structure, runs: list[Run]) -> FitResult:
    """Fit a structure's linear form and turn the coefficients into its parameters."""
    form = structure.linear
    if form is None:
        raise ValueError(
            f'structure {structure.name!r} has no linear form; use method="output_error"'
        )
    design, target = _stacked([form.equations(run) for run in runs])
    estimate = regression(design, target, form.coefficients)
    values, slopes = gradient(
        lambda at: form.parameters(*at.values()), form.coefficients, estimate.values
    )
    for parameter, value in zip(structure.parameters, values, strict=True):
        if not parameter.low <= value <= parameter.high:
            raise IdentificationError(
                f"least squares gives {parameter.name} = {value:.6g}, outside ({parameter.low:g}, "
                f"{parameter.high:g}); use output_error",
                (parameter.name,),
            )
    covariance = slopes @ estimate.covariance @ slopes.T
    estimate = estimate._replace(values=values, covariance=covariance)
    initial = [form.initial(run) for run in runs]
    return simulated_result(structure, runs, estimate, initial, form.caution)


def simulated_result(
    structure: Structure,
    runs: list[Run],
    estimate: LeastSquares,
    initial: list,
    caution: str,
) -> FitResult:
    """Simulate every run with a regression's estimates from its initial states; return the fit."""
    names = structure.names[: estimate.values.size]
    values = dict(zip(names, estimate.values.tolist(), strict=True))
    statuses = ["estimated"] * len(names)
    table, covariance = parameter_table(
        names, estimate.values, estimate.covariance, statuses, structure.derived
    )
    predicted = []
    for run, states in zip(runs, initial, strict=True):
        start = dict(zip(structure.names, (*estimate.values, *states), strict=True))
        predicted.append(structure.predict(run, start)[0])
    fits = run_fits(structure, runs, predicted)
    states = np.array(initial, dtype=float).reshape(len(runs), -1)
    degrees_of_freedom = estimate.degrees_of_freedom
    squares = estimate.residuals @ estimate.residuals
    sigma = float(np.sqrt(squares / max(degrees_of_freedom, 1)))
    simulated = sum(np.sum(run.residual(name) ** 2) for run in fits for name in structure.outputs)
    fit = FitResult(
        model=values if structure.model is None else structure.model(**values),
        method="regression",
        parameters=table,
        covariance=covariance,
        initial_states=state_table(structure, runs, states, np.full(states.shape, np.nan)),
        runs=fits,
        noise="white",
        sigma=dict.fromkeys(structure.outputs, sigma),
        cost=0.5 * float(simulated),
        success=True,
        message=caution,
        degrees_of_freedom=float(degrees_of_freedom),
    )
    if any(run.window > 1 for run in runs):
        doubt = (
            "Performance is logged as means over a window, which these equations take for "
            "the values themselves; use output_error."
        )
    elif not np.all(fit.fit_percent > 0.0):
        doubt = "The simulated model explains less than the mean does; do not use the numbers."
    else:
        return fit
    return replace(fit, success=False, message=f"{caution} {doubt}")
