"""What a fit hands back: the model, how sure it is, and how well it explains the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.residuals import ljung_box, pooled_autocorrelation, pooled_cross_correlation
from trustlab.models.checks import open_unit

__all__ = ["FitResult", "RunFit"]


def _check_lags(lags: int, residuals: list[np.ndarray]) -> None:
    shortest = min(run.size for run in residuals)
    if int(lags) != lags or not 1 <= lags < shortest:
        raise ValueError(
            f"lags must be a whole number from 1 to below the shortest run, {shortest}, got {lags}"
        )


@dataclass(frozen=True, eq=False)
class RunFit:
    """
    One run, measured and fitted.

    Parameters
    ----------
    label : str
        The run in a few words.
    synthetic : bool
        Whether the run was simulated.
    t, mode : numpy.ndarray, shape (N,)
        Time [s] and manual share.
    measured, fitted : dict of numpy.ndarray
        Outputs by name.
    """

    label: str
    synthetic: bool
    t: np.ndarray
    mode: np.ndarray
    measured: dict[str, np.ndarray]
    fitted: dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class FitResult:
    """
    A fitted model with its uncertainty and diagnostics.

    Parameters
    ----------
    model : RobotModel, HumanModel or TscModel
        The identified model.
    method : {"output_error", "arx"}
        How it was identified.
    parameters : pandas.DataFrame
        Index `parameter`; columns value, stderr, status (estimated, weak, fixed, given, derived, at bound).
    covariance : pandas.DataFrame
        Covariance of the parameters that were estimated.
    initial_states : pandas.DataFrame
        Index run; for each initial state its value and stderr.
    runs : list of RunFit
        Measured and fitted outputs.
    noise : {"white", "hac"}
        What the standard errors allow for: white residuals, or autocorrelated ones too.
    sigma : dict of float
        Standard deviation of the residuals, by output.
    cost : float
        ½ Σ e².
    success : bool
        Whether the search converged and every parameter is determined by the data.
    message : str
        What a reader should know before using the numbers.
    degrees_of_freedom : float
        For the t intervals.
    """

    model: object
    method: str
    parameters: pd.DataFrame
    covariance: pd.DataFrame
    initial_states: pd.DataFrame
    runs: list[RunFit]
    noise: str
    sigma: dict[str, float]
    cost: float
    success: bool
    message: str
    degrees_of_freedom: float = 1e9

    @property
    def outputs(self) -> tuple[str, ...]:
        """The columns the model explains."""
        return tuple(self.runs[0].measured)

    @property
    def synthetic(self) -> bool:
        """Whether any of the data were simulated."""
        return any(run.synthetic for run in self.runs)

    def table(self, level: float = 0.95) -> pd.DataFrame:
        """
        Return the parameters with standard errors and t intervals.

        Parameters
        ----------
        level : float
            Level of the intervals, in (0, 1).

        Returns
        -------
        pandas.DataFrame
            Index `parameter`; columns value, stderr, ci_low, ci_high, status. NaN where a parameter was not
            estimated; intervals are not cut at bounds.

        Raises
        ------
        ValueError
            If `level` is outside (0, 1).
        """
        level = open_unit("level", level)
        half = special.stdtrit(self.degrees_of_freedom, 0.5 + level / 2.0) * self.parameters["stderr"]
        value = self.parameters["value"]
        return self.parameters.assign(ci_low=value - half, ci_high=value + half)[
            ["value", "stderr", "ci_low", "ci_high", "status"]
        ]

    def correlations(self) -> pd.DataFrame:
        """Return the correlations of the estimated parameters."""
        scale = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(scale, scale)

    @property
    def fit_percent(self) -> float | pd.Series:
        """100(1 − ‖y − ŷ‖/‖y − ȳ‖) of the simulated output; a Series by output for a model with several."""
        percent = {}
        for name in self.outputs:
            y = np.concatenate([run.measured[name] for run in self.runs])
            error = np.concatenate([run.measured[name] - run.fitted[name] for run in self.runs])
            spread = np.linalg.norm(y - y.mean())
            percent[name] = 100.0 * (1.0 - np.linalg.norm(error) / spread) if spread > 0.0 else np.nan
        return float(percent[name]) if len(percent) == 1 else pd.Series(percent, name="fit_percent")

    def residuals(self, output: str | None = None) -> list[np.ndarray]:
        """
        Return measured minus fitted, one array per run.

        Parameters
        ----------
        output : str, optional
            Which output; the first when not given.
        """
        name = self.outputs[0] if output is None else output
        if name not in self.outputs:
            raise ValueError(f"output must be one of {', '.join(self.outputs)}, got {output!r}")
        return [run.measured[name] - run.fitted[name] for run in self.runs]

    def residual_correlations(self, lags: int = 25, output: str | None = None) -> pd.DataFrame:
        """
        Return auto- and cross-correlation of the residuals with their 99 % bands.

        Parameters
        ----------
        lags : int
            Largest lag [samples].
        output : str, optional
            Which output; the first when not given.

        Returns
        -------
        pandas.DataFrame
            Index `lag` from −lags to lags; columns autocorrelation (with itself), cross_correlation (of e(k) with
            mode(k − lag)) and band: ± 2.58/√n for white residuals.
        """
        residuals = self.residuals(output)
        _check_lags(lags, residuals)
        auto = pooled_autocorrelation(residuals, lags)
        cross = pooled_cross_correlation(residuals, [run.mode for run in self.runs], lags)
        band = special.ndtri(0.995) / np.sqrt(sum(run.size for run in residuals))
        columns = {"autocorrelation": np.r_[auto[:0:-1], auto], "cross_correlation": cross, "band": band}
        return pd.DataFrame(columns, index=pd.RangeIndex(-lags, lags + 1, name="lag"))

    def whiteness(self, lags: int = 25) -> pd.DataFrame:
        """
        Test the residuals for whiteness (Ljung–Box).

        Parameters
        ----------
        lags : int
            Number of lags in the sum.

        Returns
        -------
        pandas.DataFrame
            Index `output`; columns statistic, df, p.
        """
        rows = {}
        for name in self.outputs:
            residuals = self.residuals(name)
            _check_lags(lags, residuals)
            rows[name] = ljung_box(
                pooled_autocorrelation(residuals, lags), sum(run.size for run in residuals)
            )
        return pd.DataFrame.from_dict(rows, orient="index", columns=["statistic", "df", "p"]).rename_axis(
            "output"
        )

    def plot(self, most: int = 6):
        """
        Plot measured and fitted outputs against time, as Fig. 2.3 does.

        Parameters
        ----------
        most : int
            Most runs to show; the title says how many there are.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (outputs, runs shown)
        """
        from trustlab.identification.plots import plot_fit

        return plot_fit(self, most)

    def plot_residuals(self, lags: int = 25):
        """
        Plot auto- and cross-correlation of the residuals with their 99 % bands.

        Parameters
        ----------
        lags : int
            Largest lag [samples].

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (outputs, 2)
        """
        from trustlab.identification.plots import plot_residuals

        return plot_residuals(self, lags)

    def __repr__(self) -> str:
        return f"FitResult({self.model!r}, method={self.method!r}, success={self.success}: {self.message})"

    def _repr_html_(self) -> str:
        fit = self.fit_percent
        percent = f"{fit:.2f} %" if np.isscalar(fit) else ", ".join(f"{k} {v:.2f} %" for k, v in fit.items())
        origin = " Synthetic data." if self.synthetic else ""
        samples = sum(run.t.size for run in self.runs)
        return (
            f"<p><b>{type(self.model).__name__}</b> by {self.method}: {len(self.runs)} run(s), {samples} samples, "
            f"fit {percent}.{origin} {self.message}</p>{self.table().to_html(float_format='%.6g')}"
        )
