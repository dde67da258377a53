"""ARX models by least squares, Section 2.2.2."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.identification.log import scaled_roots
from trustlab.identification.model import IdentificationError
from trustlab.identification.result import with_intervals
from trustlab.models.checks import finite_array, flag, whole_number
from trustlab.models.display import Result

# Condition number of the normal equations (equilibrated) from which on regressors count as
# collinear: below it, refinement wins back the digits that squaring costs.
COLLINEAR = 1e13


@dataclass(frozen=True, eq=False, repr=False)
class ArxResult(Result):
    """
    A fitted ARX model, y(k) + a_1 y(k−1) + … + a_na y(k−na) = b_1 u(k−nk) + … + b_nb u(k−nk−nb+1) +
    c + e(k).

    Parameters
    ----------
    names : tuple of str
        Names of the coefficients: a1 … , b1 … , c.
    coefficients : numpy.ndarray, shape (p,)
        Estimates, in the order of `names`.
    covariance : numpy.ndarray, shape (p, p)
        Covariance of the estimates, s² (XᵀX)⁻¹.
    residuals : numpy.ndarray, shape (n,)
        One-step prediction errors.
    """

    title = "ARX"

    names: tuple[str, ...]
    coefficients: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray

    @property
    def stderr(self) -> np.ndarray:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

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


def regression(
    design: np.ndarray, target: np.ndarray, names: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return coefficients, their covariance s² (XXᵀ)⁻¹, and residuals of a least-squares problem.

    `design` holds one regressor per row, shape (p, n); `names` are those of the coefficients, for
    the errors.
    """
    p, n = design.shape
    if n <= p:
        raise IdentificationError(f"{p} coefficients need more than {p} equations, got {n}", names)
    # Row by row: BLAS takes longer for the few, long rows of a product with its own transpose.
    gram = np.stack([design @ row for row in design])
    moment = design @ target
    if not np.isfinite(gram.sum() + moment.sum()):
        raise ValueError("the data are too large to square; scale them")
    scale, values, vectors = scaled_roots(gram)
    if values[0] * COLLINEAR < values[-1]:
        lost = int(np.argmax(np.abs(vectors[:, 0])))
        cause = "a linear combination of the others (does the input move?)"
        if not design[lost].any():
            cause = "identically zero"
        raise IdentificationError(
            f"coefficient {names[lost]} is not identifiable: its regressor is {cause}",
            (names[lost],),
        )
    inverse = (vectors / values) @ vectors.T / np.outer(scale, scale)
    coefficients = inverse @ moment
    for _ in range(3):
        coefficients = coefficients + inverse @ (design @ (target - coefficients @ design))
    residuals = target - coefficients @ design
    return coefficients, inverse * (residuals @ residuals / (n - p)), residuals


def arx(y, u, na: int = 1, nb: int = 1, nk: int = 1, intercept: bool = False) -> ArxResult:
    """
    Fit an ARX model by least squares.

    y(k) + a_1 y(k−1) + … + a_na y(k−na) = b_1 u(k−nk) + … + b_nb u(k−nk−nb+1) + c + e(k). With
    white noise on the measured output (rather than e(k) inside the recursion) the estimates are
    biased. Of the robot's model (2.3), y is p_r and u is M·P_h, with a constant: a = −a1, b = b1,
    and (1 − a) P_r,min = c.

    Parameters
    ----------
    y : array_like, shape (N,), or list of such
        Output; a list holds one array per run, and no equation crosses from one run to the next.
    u : array_like, shape (N,), or list of such
        Input.
    na : int
        Number of output lags, ≥ 0.
    nb, nk : int
        Number of lags of the input, ≥ 1, and its delay in samples, ≥ 0.
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
    na, nb = whole_number("na", na, least=0), whole_number("nb", nb)
    nk, intercept = whole_number("nk", nk, least=0), flag("intercept", intercept)
    first = max(na, nk + nb - 1)
    parts = []
    for y_run, u_run in paired_runs(y=y, u=u):
        size = y_run.size - first
        if size < 1:
            raise IdentificationError(
                f"a run of {y_run.size} samples is too short for lags up to {first}"
            )
        rows = [-y_run[first - lag :][:size] for lag in range(1, na + 1)]
        rows += [u_run[first - lag :][:size] for lag in range(nk, nk + nb)]
        rows += [np.ones(size)] * intercept
        parts.append((np.stack(rows), y_run[first:]))
    names = [*(f"a{lag + 1}" for lag in range(na)), *(f"b{lag + 1}" for lag in range(nb))]
    names += ["c"] * intercept
    # One run is not copied.
    design, target = parts[0] if len(parts) == 1 else map(np.hstack, zip(*parts, strict=True))
    return ArxResult(tuple(names), *regression(design, target, tuple(names)))


def paired_runs(**signals) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return two signals of one run, or lists of them by run, as pairs of arrays of equal size."""
    (first, values), (second, others) = signals.items()
    if not (isinstance(values, list | tuple) and values and np.ndim(values[0]) == 1):
        values, others = [values], [others]
    if len(values) != len(others):
        raise ValueError(f"there are {len(values)} runs of {first} but {len(others)} of {second}")
    pairs = []
    for value, other in zip(values, others, strict=True):
        array = finite_array(first, value)
        pairs.append((array, finite_array(second, other, length=array.size)))
    return pairs
