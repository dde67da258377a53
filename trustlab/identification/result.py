"""The result of a fit: the model, its uncertainty and its residuals, in tables and plots."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.log import ljung_box, pooled_correlation
from trustlab.models.checks import counted, one_of, open_unit, whole_number
from trustlab.models.display import Result, axes_or_new
from trustlab.sessions.plots import shade_manual

# Runs that a plot shows.
MOST_RUNS = 6

LABELS = {
    "p_r": "robot performance $P_r$",
    "p_h": "human performance $P_h$",
    "velocity": "velocity [m/s]",
}


def with_intervals(table: pd.DataFrame, level: float, degrees_of_freedom: float) -> pd.DataFrame:
    """Add columns ci_low and ci_high to a table with columns value and stderr: t intervals."""
    level = open_unit("level", level)
    half = special.stdtrit(degrees_of_freedom, 0.5 + level / 2.0) * table["stderr"]
    table = table.assign(ci_low=table["value"] - half, ci_high=table["value"] + half)
    table.attrs["confidence"] = level
    return table


@dataclass(frozen=True, eq=False)
class RunFit:
    """
    One run, measured and fitted: time [s], inputs and outputs by name, shape (N,) each.

    `errors` are what a noise model leaves of measured minus fitted, in the values that a window
    averages where the noise is in these; 0 for samples left out, which are not `known`.
    """

    label: str
    synthetic: bool
    t: np.ndarray
    inputs: dict[str, np.ndarray]
    measured: dict[str, np.ndarray]
    fitted: dict[str, np.ndarray]
    errors: dict[str, np.ndarray]
    known: dict[str, np.ndarray]


@dataclass(frozen=True, eq=False, repr=False)
class FitResult(Result):
    """
    A fitted model with its uncertainty and diagnostics.

    Parameters
    ----------
    model : RobotModel, HumanModel, TscModel or what the model builds
        The identified model. It does not know of `success`: what takes the model alone, such as
        `limit_cycle`, `run_condition` and `Operator`, cannot warn; `choose_thresholds` takes the
        fit, and warns where `success` is False.
    parameters : pandas.DataFrame
        Index `parameter`; columns value, stderr, unit and status: estimated, weak, fixed, derived,
        at bound.
    covariance : pandas.DataFrame
        Covariance of the parameters that were estimated.
    initial_states : pandas.DataFrame
        Index run; for each initial state its value and stderr.
    runs : list of RunFit
        Measured and fitted outputs.
    noise : {"white", "correlated", "hac"}
        What the standard errors allow for; see `fit`.
    sigma : dict of float
        Standard deviation of the noise, by output, without samples left out; in the values that a
        window averages where the message says so.
    cost : float
        ½ Σ e².
    success : bool
        Whether the search converged and every parameter is determined by the data.
    message : str
        What to know before using the numbers.
    degrees_of_freedom : float
        For the t intervals.
    """

    model: object
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
        """The columns that the model explains."""
        return tuple(self.sigma)

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
            Index `parameter`; columns value, stderr, ci_low, ci_high, unit, status. NaN where a
            parameter was not estimated; intervals are not cut at bounds. A share such as `a`
            belongs to the time step in its unit, which is the log's sample time.

        Raises
        ------
        ValueError
            If `level` is outside (0, 1).
        """
        table = with_intervals(self.parameters, level, self.degrees_of_freedom)
        return table[["value", "stderr", "ci_low", "ci_high", "unit", "status"]]

    def correlations(self) -> pd.DataFrame:
        """Return the correlations of the estimated parameters."""
        scale = np.sqrt(np.diag(self.covariance))
        return self.covariance.div(scale, axis="index").div(scale, axis="columns")

    @property
    def fit_percent(self) -> float | pd.Series:
        """
        100(1 − ‖y − ŷ‖/‖y − ȳ‖) of the simulated output, without samples left out; a Series if
        there are several.
        """
        percent = {}
        for name in self.outputs:
            known = np.concatenate([run.known[name] for run in self.runs])
            y = np.concatenate([run.measured[name] for run in self.runs])[known]
            error = np.concatenate(self.residuals(name))[known]
            spread = np.linalg.norm(y - y.mean())
            percent[name] = 100.0 * (1.0 - np.linalg.norm(error) / spread)
        return float(percent[name]) if len(percent) == 1 else pd.Series(percent, name="fit_percent")

    def residuals(self, output: str | None = None) -> list[np.ndarray]:
        """
        Return measured minus fitted, one array per run.

        Parameters
        ----------
        output : str, optional
            Which output; the first when not given.
        """
        name = self._output(output)
        return [run.measured[name] - run.fitted[name] for run in self.runs]

    def _output(self, name: str | None) -> str:
        """Return a checked name of an output, by default the first."""
        return self.outputs[0] if name is None else one_of("output", name, self.outputs)

    def _errors_for(self, lags: int, output: str | None) -> list[np.ndarray]:
        """Return the prediction errors of an output whose runs are all longer than `lags`."""
        errors = [run.errors[self._output(output)] for run in self.runs]
        shortest = min(map(len, errors))
        whole_number("lags (below the length of the shortest run)", lags, 1, shortest - 1)
        return errors

    def residual_correlations(self, lags: int = 25, output: str | None = None) -> pd.DataFrame:
        """
        Return auto- and cross-correlation of the prediction errors with their 99 % bands.

        Parameters
        ----------
        lags : int
            Largest lag [samples].
        output : str, optional
            Which output; the first when not given.

        Returns
        -------
        pandas.DataFrame
            Index `lag` from −lags to lags; columns autocorrelation (with itself), cross_correlation
            (of e(k) with the first input at k − lag: mode for the models of the dissertation) and
            band: ± 2.58/√n for white residuals.
        """
        residuals = self._errors_for(lags, output)
        auto = pooled_correlation(residuals, residuals, lags)
        inputs = [next(iter(run.inputs.values())) for run in self.runs]
        before = pooled_correlation(inputs, residuals, lags)[:0:-1]
        columns = {
            "autocorrelation": np.r_[auto[:0:-1], auto],
            "cross_correlation": np.r_[before, pooled_correlation(residuals, inputs, lags)],
            "band": special.ndtri(0.995) / np.sqrt(sum(run.size for run in residuals)),
        }
        return pd.DataFrame(columns, index=pd.RangeIndex(-lags, lags + 1, name="lag"))

    def whiteness(self, lags: int = 25) -> pd.DataFrame:
        """
        Test the prediction errors for whiteness (Ljung–Box).

        Parameters
        ----------
        lags : int
            Number of lags in the sum.

        Returns
        -------
        pandas.DataFrame
            Index `output`; columns statistic, df, p.
        """
        rows = [ljung_box(self._errors_for(lags, name), lags) for name in self.outputs]
        index = pd.Index(self.outputs, name="output")
        return pd.DataFrame(rows, index, columns=["statistic", "df", "p"])

    def plot(self):
        """
        Plot measured and fitted outputs against time, as Fig. 2.3 does; of many runs the first six.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (outputs, runs shown)
        """
        runs = self.runs[:MOST_RUNS]
        shown = f"{len(runs)} of {len(self.runs)} runs" if len(self.runs) > len(runs) else ""
        rows, columns = len(self.outputs), len(runs)
        size = (max(6.5, 3.0 * columns), 0.8 + 2.4 * rows)
        options = {"figsize": size, "squeeze": False, "sharey": "row", "sharex": "col"}
        axes = axes_or_new(None, rows, columns, shown, **options)
        for column, run in zip(axes.T, runs, strict=True):
            for panel, name in zip(column, self.outputs, strict=True):
                panel.plot(run.t, run.measured[name], lw=0.8, color="0.55", label="measured")
                panel.plot(run.t, run.fitted[name], lw=1.6, ls="--", color="C1", label="fitted")
                if "mode" in run.inputs:
                    shade_manual(panel, run.t, run.inputs["mode"])
            column[0].set_title(run.label, fontsize="small")
            column[-1].set_xlabel("time [s]")
        for panel, name in zip(axes[:, 0], self.outputs, strict=True):
            panel.set_ylabel(LABELS.get(name, name))
        shaded = "manual phases shaded" if "mode" in runs[0].inputs else None
        axes[0, 0].legend(fontsize="small", loc="best", title=shaded, title_fontsize="small")
        return axes

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
        rows = len(self.outputs)
        title = "residual correlations, 99 % bands" + (", synthetic data" if self.synthetic else "")
        size = (8, 0.6 + 2.2 * rows)
        axes = axes_or_new(None, rows, 2, title, squeeze=False, figsize=size)
        for (auto, cross), name in zip(axes, self.outputs, strict=True):
            frame = self.residual_correlations(lags, name)
            band = frame["band"].iloc[0]
            parts = (frame.loc[1:, "autocorrelation"], frame["cross_correlation"])
            for panel, part in zip((auto, cross), parts, strict=True):
                panel.axhspan(-band, band, alpha=0.15, lw=0)
                panel.vlines(part.index, 0.0, part)
                panel.axhline(0.0, color="0.4", lw=0.8)
                panel.set_xlabel("lag [samples]")
            auto.set_ylabel(f"residual of\n{LABELS.get(name, name)}")
            auto.set_title("autocorrelation", fontsize="small")
            cross.set_title(f"with {next(iter(self.runs[0].inputs))}", fontsize="small")
        return axes

    @property
    def title(self) -> str:
        """What was fitted, and how well."""
        numbers = " and ".join(f"{value:.2f} %" for value in np.atleast_1d(self.fit_percent))
        origin = ", synthetic data" if self.synthetic else ""
        samples = sum(run.t.size for run in self.runs)
        return (
            f"{type(self.model).__name__}, {counted(len(self.runs), 'run')}, {samples} samples, "
            f"fit {numbers}{origin}"
        )
