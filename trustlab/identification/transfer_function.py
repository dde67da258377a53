"""Continuous-time transfer functions of order 1 and 2 from a logged command and velocity, as (A.1) was found."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import linalg, optimize, signal, special

from trustlab.identification.errors import IdentificationError
from trustlab.identification.residuals import hac_lags, hac_matrix, ljung_box, pooled_autocorrelation
from trustlab.models.checks import finite_array, finite_number, open_unit
from trustlab.models.uav import TransferFunction

__all__ = ["TransferFunctionFit", "fit_transfer_function"]

LAGS = 25
RANK = 1e-9


@dataclass(frozen=True, eq=False)
class TransferFunctionFit:
    """
    An identified transfer function with its uncertainty.

    Parameters
    ----------
    model : TransferFunction
        gain/(s + d_0) or gain/(s² + d_1 s + d_0).
    parameters : pandas.DataFrame
        Index `parameter` (gain, d_1, d_0); columns value, stderr.
    covariance : pandas.DataFrame
        Covariance of the parameters.
    measured, fitted : list of numpy.ndarray
        Velocity as logged and as simulated, per run.
    sample_time : float
        T [s].
    sigma : float
        Standard deviation of the residuals.
    noise : {"white", "hac"}
        What the standard errors allow for.
    degrees_of_freedom : int
        For the t intervals.
    """

    model: TransferFunction
    parameters: pd.DataFrame
    covariance: pd.DataFrame
    measured: list[np.ndarray]
    fitted: list[np.ndarray]
    sample_time: float
    sigma: float
    noise: str
    degrees_of_freedom: int

    @property
    def fit_percent(self) -> float:
        """100 (1 − ‖v − v̂‖/‖v − mean v‖)."""
        error = np.concatenate([a - b for a, b in zip(self.measured, self.fitted, strict=True)])
        spread = np.concatenate([a - a.mean() for a in self.measured])
        return float(100.0 * (1.0 - np.linalg.norm(error) / np.linalg.norm(spread)))

    def table(self, level: float = 0.95) -> pd.DataFrame:
        """
        Return parameters, standard errors and t intervals.

        Parameters
        ----------
        level : float
            Level of the intervals, in (0, 1).

        Returns
        -------
        pandas.DataFrame
            Index `parameter`; columns value, stderr, ci_low, ci_high.
        """
        half = special.stdtrit(self.degrees_of_freedom, 0.5 + open_unit("level", level) / 2.0)
        value, error = self.parameters["value"], self.parameters["stderr"]
        return self.parameters.assign(ci_low=value - half * error, ci_high=value + half * error)

    def plot(self, ax=None):
        """
        Plot the first run, measured and simulated.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes
            The axes.
        """
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots()[1]
        t = self.sample_time * np.arange(self.measured[0].size)
        ax.plot(t, self.measured[0], color="0.6", label="measured")
        ax.plot(t, self.fitted[0], label=f"fitted, {self.fit_percent:.1f} %")
        ax.set(xlabel="t [s]", ylabel="velocity [m/s]")
        ax.legend()
        return ax

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def _responses(denominator, u: np.ndarray, sample_time: float) -> np.ndarray:
    """Return velocity per unit gain and per unit of each initial state, shape (N, 1 + n), for a held command."""
    n, dtype = len(denominator), np.result_type(np.asarray(denominator), float)
    a, b = np.zeros((n, n), dtype), np.zeros(n, dtype)
    a[:-1, 1:], a[-1], b[-1] = np.eye(n - 1), -np.asarray(denominator)[::-1], 1.0
    block = np.zeros((n + 1, n + 1), dtype)
    block[:n, :n], block[:n, n] = a, b
    whole = linalg.expm(block * sample_time)
    phi, gamma = whole[:n, :n], whole[:n, n]
    pulse = np.zeros(u.size)
    pulse[0] = 1.0
    if n == 1:
        poles = np.array([1.0, -phi[0, 0]])
        forced = signal.lfilter(np.array([0.0, gamma[0]]), poles, u)
        return np.column_stack([forced, signal.lfilter(np.array([1.0, 0.0]), poles, pulse)])
    trace, determinant = phi[0, 0] + phi[1, 1], phi[0, 0] * phi[1, 1] - phi[0, 1] * phi[1, 0]
    poles = np.array([1.0, -trace, determinant])
    forced = np.array([0.0, gamma[0], phi[0, 1] * gamma[1] - phi[1, 1] * gamma[0]])
    from_v = np.array([1.0, -phi[1, 1], 0.0])
    from_a = np.array([0.0, phi[0, 1], 0.0])
    columns = [signal.lfilter(top, poles, x) for top, x in ((forced, u), (from_v, pulse), (from_a, pulse))]
    return np.column_stack(columns)


def _design(denominator, inputs, sample_time) -> np.ndarray:
    """Return all runs' responses: one shared gain, own initial states for each run."""
    n, total = len(denominator), sum(u.size for u in inputs)
    design = np.zeros((total, 1 + n * len(inputs)), np.result_type(np.asarray(denominator), float))
    row = 0
    for j, u in enumerate(inputs):
        part = _responses(denominator, u, sample_time)
        design[row : row + u.size, 0] = part[:, 0]
        design[row : row + u.size, 1 + n * j : 1 + n * (j + 1)] = part[:, 1:]
        row += u.size
    return design


def _start(order: int, inputs, outputs, sample_time: float) -> list[np.ndarray]:
    """Return denominators to start from: instrumental variables on a discrete model, and a coarse set of time constants."""
    rows, targets, instruments = [], [], []
    for u, v in zip(inputs, outputs, strict=True):
        columns = [v[order - 1 - i : v.size - 1 - i] for i in range(order)]
        columns += [u[order - 1 - i : u.size - 1 - i] for i in range(order)]
        rows.append(np.column_stack(columns))
        targets.append(v[order:])
        lagged = np.column_stack([np.r_[np.zeros(2 * order + i), u][: u.size] for i in range(2 * order)])
        instruments.append(lagged[order:])
    starts = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for weight in (np.vstack(instruments), np.vstack(rows)):
            try:
                found = np.linalg.lstsq(
                    weight.T @ np.vstack(rows), weight.T @ np.concatenate(targets), rcond=None
                )[0]
                poles = np.log(np.roots(np.r_[1.0, -found[:order]]).astype(complex)) / sample_time
            except np.linalg.LinAlgError:
                continue
            if np.isfinite(poles).all():
                starts.append(np.real(np.poly(poles))[1:])
    length = sample_time * max(u.size for u in inputs)
    for constant in np.geomspace(5.0 * sample_time, length / 2.0, 5):
        rate = 1.0 / constant
        starts += (
            [np.array([rate])] if order == 1 else [np.array([2.0 * z * rate, rate**2]) for z in (0.2, 1.0)]
        )
    return starts


def fit_transfer_function(
    command, velocity, sample_time: float, order: int = 2, noise: str = "auto"
) -> TransferFunctionFit:
    """
    Identify gain/(s + d_0) or gain/(s² + d_1 s + d_0) by output error, the command being held over each sample.

    Gain and initial states enter linearly and are solved for exactly; the search is over the denominator alone, from
    instrumental variables and several time constants. Derivatives are exact (complex steps).

    Parameters
    ----------
    command, velocity : array_like, shape (N,), or lists of them
        Logged command and velocity [m/s] per run; every run has initial states of its own.
    sample_time : float
        T [s].
    order : {1, 2}
        Order of the denominator.
    noise : {"auto", "white", "hac"}
        What the standard errors allow for: white residuals, autocorrelated ones (Newey–West), or the second where a
        Ljung–Box test rejects the first at 0.001.

    Returns
    -------
    TransferFunctionFit
        With `.model`, `.table()`, `.fit_percent`, `.plot()`.

    Raises
    ------
    IdentificationError
        If the command does not move, or the data do not determine the parameters.
    ValueError
        If arguments are not understood, lengths differ or samples are not finite.
    """
    inputs, outputs = _runs(command, velocity)
    sample_time = finite_number("sample_time", sample_time)
    if not sample_time > 0.0:
        raise ValueError(f"sample_time must be positive, got {sample_time}")
    if isinstance(order, bool) or order not in (1, 2):
        raise ValueError(f"order must be 1 or 2, got {order!r}")
    if noise not in ("auto", "white", "hac"):
        raise ValueError(f'noise must be "auto", "white" or "hac", got {noise!r}')
    if max(np.ptp(u) for u in inputs) == 0.0:
        raise IdentificationError("the command never changes: nothing can be identified from it")
    names = ["gain", "d_0"] if order == 1 else ["gain", "d_1", "d_0"]
    linear = 1 + order * len(inputs)
    target = np.concatenate(outputs)
    if target.size < 2 * (order + linear):
        raise IdentificationError(
            f"{target.size} samples are too few for {order + linear} unknowns; record longer runs"
        )

    def parts(denominator):
        design = _design(denominator, inputs, sample_time)
        if not np.isfinite(design).all():
            return None
        return design, np.linalg.lstsq(design, target, rcond=None)[0]

    def left_over(denominator):
        with np.errstate(all="ignore"):
            found = parts(denominator)
        return np.full(target.size, 1e6) if found is None else found[0] @ found[1] - target

    best = None
    starts = _start(order, inputs, outputs, sample_time)
    for start in sorted(starts, key=lambda d: float(np.sum(left_over(d) ** 2)))[:2]:
        done = optimize.least_squares(
            left_over, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=200
        )
        if best is None or done.cost < best.cost * (1.0 - 1e-9):
            best = done
    design, weights = parts(best.x)
    error = target - design @ weights
    jacobian = np.empty((target.size, order + linear))
    jacobian[:, 0], jacobian[:, 1 + order :] = design[:, 0], design[:, 1:]
    for i in range(order):
        size = 1e-30 * max(1.0, abs(best.x[i]))
        moved = best.x.astype(complex)
        moved[i] += 1j * size
        jacobian[:, 1 + i] = (_design(moved, inputs, sample_time) @ weights).imag / size
    scale = np.linalg.norm(jacobian, axis=0)
    if (scale[: 1 + order] == 0.0).any() or np.linalg.svd(
        jacobian / np.where(scale, scale, 1.0), compute_uv=False
    )[-1] < RANK:
        raise IdentificationError(
            "the data do not determine the transfer function; command more, with steps of different lengths"
        )
    free = target.size - order - linear
    sigma2 = float(error @ error) / free
    bread = np.linalg.inv((jacobian / scale).T @ (jacobian / scale)) / np.outer(scale, scale)
    ends = np.cumsum([u.size for u in inputs])[:-1]
    residuals = np.split(error, ends)
    exact = np.sqrt(sigma2) < 1e-10 * np.abs(target).max()
    whiteness = 1.0 if exact else ljung_box(pooled_autocorrelation(residuals, LAGS), target.size)[2]
    robust = noise == "hac" or (noise == "auto" and whiteness < 1e-3)
    covariance = sigma2 * bread
    if robust:
        lags = hac_lags(residuals)
        meat = sum(hac_matrix(scores, lags) for scores in np.split(jacobian * error[:, None], ends))
        covariance = bread @ meat @ bread
    covariance = covariance[: 1 + order, : 1 + order]
    values = np.r_[weights[0], best.x]
    parameters = pd.DataFrame(
        {"value": values, "stderr": np.sqrt(np.diag(covariance))}, index=pd.Index(names, name="parameter")
    )
    return TransferFunctionFit(
        TransferFunction(values[0], tuple(values[1:])),
        parameters,
        pd.DataFrame(covariance, index=names, columns=names),
        outputs,
        np.split(design @ weights, ends),
        sample_time,
        float(np.sqrt(sigma2)),
        "hac" if robust else "white",
        free,
    )


def _runs(command, velocity) -> tuple[list[np.ndarray], list[np.ndarray]]:
    lists = [
        value if isinstance(value, list | tuple) and np.ndim(value[0] if value else 0) else [value]
        for value in (command, velocity)
    ]
    if len(lists[0]) != len(lists[1]):
        raise ValueError(f"there are {len(lists[0])} runs of command but {len(lists[1])} of velocity")
    inputs = [finite_array(f"command of run {j}", u) for j, u in enumerate(lists[0])]
    outputs = [finite_array(f"velocity of run {j}", v, length=inputs[j].size) for j, v in enumerate(lists[1])]
    return inputs, outputs
