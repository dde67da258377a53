"""ARX models by least squares, with covariance: the dissertation's own method (Section 2.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, special

from trustlab.identification.errors import IdentificationError
from trustlab.models.checks import open_unit

__all__ = ["ArxResult", "arx", "regression"]

CONDITION_LIMIT = 1e5
"""Up to this condition number (equilibrated) the normal equations are used, beyond it a QR factorisation."""


@dataclass(frozen=True, eq=False)
class ArxResult:
    """
    A fitted ARX model, y(k) + a_1 y(k−1) + … + a_na y(k−na) = b_1 u(k−nk) + … + b_nb u(k−nk−nb+1) + c + e(k).

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
        import pandas as pd

        level = open_unit("level", level)
        half = special.stdtrit(self.degrees_of_freedom, 0.5 + level / 2.0) * self.stderr
        columns = {
            "value": self.coefficients,
            "stderr": self.stderr,
            "ci_low": self.coefficients - half,
            "ci_high": self.coefficients + half,
        }
        return pd.DataFrame(columns, index=pd.Index(self.names, name="parameter"))

    def _repr_html_(self) -> str:
        return f"<p><b>ARX</b>, {self.residuals.size} equations</p>{self.table().to_html()}"


def regression(design: np.ndarray, target: np.ndarray, names: tuple[str, ...]):
    """
    Solve a least-squares problem and give the covariance of its solution.

    Columns are scaled to unit length. A well-conditioned problem goes through its normal equations with one
    step of iterative refinement, any other through QR.

    Parameters
    ----------
    design : numpy.ndarray, shape (p, n)
        Regressors, one per row.
    target : numpy.ndarray, shape (n,)
        What they explain.
    names : tuple of str
        Names of the regressors, for the error.

    Returns
    -------
    coefficients : numpy.ndarray, shape (p,)
    covariance : numpy.ndarray, shape (p, p)
    residuals : numpy.ndarray, shape (n,)

    Raises
    ------
    IdentificationError
        If there are too few equations, or a regressor is zero or follows from the others.
    ValueError
        If a sample is not finite.
    """
    p, n = design.shape
    if n <= p:
        raise IdentificationError(f"{p} coefficients need more than {p} equations, got {n}", names)
    # Row by row: BLAS takes longer for the few, long rows of a product with its own transpose.
    gram, moment = np.stack([design @ row for row in design]), design @ target
    scale = np.sqrt(np.diag(gram))
    if not np.isfinite(gram.sum() + moment.sum()):
        raise ValueError("the data are too large to square; scale them")
    if not (scale > 0.0).all():
        dead = names[int(np.argmin(scale))]
        raise IdentificationError(
            f"coefficient {dead} cannot be told: its regressor is zero throughout", (dead,)
        )
    sizes = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(gram / sizes)
    if values[0] > 0.0 and values[-1] < CONDITION_LIMIT * values[0]:
        inverse = (vectors / values) @ vectors.T / sizes
        coefficients = inverse @ moment
        coefficients += inverse @ (design @ (target - coefficients @ design))
    else:
        q, r, order = linalg.qr((design / scale[:, None]).T, mode="economic", pivoting=True)
        diagonal = np.abs(np.diag(r))
        if diagonal[-1] <= n * np.finfo(float).eps * diagonal[0]:
            free = names[order[-1]]
            raise IdentificationError(
                f"coefficient {free} cannot be told: its regressor follows from the others (does the input move?)",
                (free,),
            )
        coefficients = np.empty(p)
        coefficients[order] = linalg.solve_triangular(r, q.T @ target)
        half = np.empty((p, p))
        half[order] = linalg.solve_triangular(r, np.eye(p))
        coefficients /= scale
        inverse = half @ half.T / sizes
    residuals = target - coefficients @ design
    return coefficients, inverse * (residuals @ residuals / (n - p)), residuals


def _per_input(name: str, value, inputs: int) -> tuple[int, ...]:
    values = (value,) * inputs if np.ndim(value) == 0 else tuple(value)
    if len(values) != inputs:
        raise ValueError(f"{name} names {len(values)} inputs, u has {inputs}")
    if any(int(v) != v or v < (1 if name == "nb" else 0) for v in values):
        raise ValueError(f"{name} must hold whole numbers ({'≥ 1' if name == 'nb' else '≥ 0'}), got {value}")
    return tuple(int(v) for v in values)


def arx(y, u, na: int = 1, nb=1, nk=1, intercept: bool = False) -> ArxResult:
    """
    Fit an ARX model by least squares.

    y(k) + a_1 y(k−1) + … + a_na y(k−na) = b_1 u(k−nk) + … + b_nb u(k−nk−nb+1) + c + e(k). With white noise on the
    measured output (rather than e(k) inside the recursion) the estimates are biased; see `fit_robot`.

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
    """
    several = isinstance(y, (list, tuple)) and len(y) > 0 and np.ndim(y[0]) == 1
    if several and len(y) != len(u):
        raise ValueError(f"y has {len(y)} runs and u has {len(u)}; give one input array for every run")
    runs = list(zip(y, u, strict=True)) if several else [(y, u)]
    if int(na) != na or na < 0:
        raise ValueError(f"na must be a whole number ≥ 0, got {na}")
    na, designs, targets = int(na), [], []
    names: tuple[str, ...] = ()
    for y_run, u_run in runs:
        y_run = np.ascontiguousarray(y_run, dtype=float)
        u_run = np.asarray(u_run, dtype=float)
        u_run = u_run[:, None] if u_run.ndim == 1 else u_run
        if y_run.ndim != 1 or u_run.ndim != 2 or len(u_run) != y_run.size:
            raise ValueError(f"y must be (N,) and u (N,) or (N, m), got {y_run.shape} and {u_run.shape}")
        if not (np.isfinite(y_run).all() and np.isfinite(u_run).all()):
            raise ValueError("y and u must be finite; a sample is NaN or infinite")
        inputs = u_run.shape[1]
        nb_, nk_ = _per_input("nb", nb, inputs), _per_input("nk", nk, inputs)
        first = max([na] + [delay + lags - 1 for delay, lags in zip(nk_, nb_, strict=True)])
        size = y_run.size - first
        if size < 1:
            raise IdentificationError(f"a run of {y_run.size} samples is too short for lags up to {first}")
        rows = na + sum(nb_) + bool(intercept)
        design = np.empty((rows, size))
        for lag in range(1, na + 1):
            np.negative(y_run[first - lag : y_run.size - lag], out=design[lag - 1])
        row = na
        for i in range(inputs):
            for lag in range(nk_[i], nk_[i] + nb_[i]):
                design[row] = u_run[first - lag : y_run.size - lag, i]
                row += 1
        if intercept:
            design[row] = 1.0
        designs.append(design)
        targets.append(y_run[first:])
        if not names:
            b_names = [
                f"b{j + 1}" if inputs == 1 else f"b{i + 1}_{j + 1}"
                for i in range(inputs)
                for j in range(nb_[i])
            ]
            names = (*(f"a{lag}" for lag in range(1, na + 1)), *b_names, *(("c",) if intercept else ()))
    design = designs[0] if len(designs) == 1 else np.concatenate(designs, axis=1)
    target = targets[0] if len(targets) == 1 else np.concatenate(targets)
    coefficients, covariance, residuals = regression(design, target, names)
    return ArxResult(names, coefficients, covariance, residuals, na, nb_, nk_, bool(intercept))
