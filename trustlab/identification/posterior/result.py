"""The posterior of one person as draws: tables, models, plots, and a sentence."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from trustlab.identification.log import NOT_WHITE
from trustlab.identification.posterior.density import SHARED, Prior, Target, simulate
from trustlab.identification.tsc import TSC, build_tsc
from trustlab.models.checks import open_unit
from trustlab.models.display import Result, axes_or_new
from trustlab.models.tsc import TscModel

# Share of the prior's range below which a posterior would be a mere line in it.
NARROW = 0.15

# Greatest shape of the weights' tail by which draws may be trusted (Vehtari et al. 2024).
MOST_K = 0.7

# Width of an interval, as a share of the prior's, up to which data count as telling the value.
DETERMINED = 0.5

# Distance from the prior's mean, in its standard deviations, from which on it is in doubt.
UNEXPECTED = 3.0

WORDS = {
    "human_time_constant": "operator's time constant [s]",
    "human_beta": "operator's best utilization β",
    "human_p_min": "least human performance",
    "human_p_max": "greatest human performance",
    "robot_time_constant": "robot's time constant [s]",
    "robot_p_min": "least robot performance",
    "robot_p_max": "greatest robot performance",
}
"""The model's parameters in words."""

MODEL = tuple(WORDS)


def tsc_models(draws: pd.DataFrame) -> list[TscModel]:
    """Return the model of every draw."""
    return [build_tsc(**row) for row in draws[list(TSC.names)].to_dict("records")]


def summary(draws: pd.DataFrame, level: float) -> pd.DataFrame:
    """Return mean, sd and interval of every column."""
    low, high = draws.quantile([0.5 - 0.5 * level, 0.5 + 0.5 * level]).to_numpy()
    columns = {"mean": draws.mean(), "sd": draws.std(), "ci_low": low, "ci_high": high}
    table = pd.DataFrame(columns).rename_axis("parameter")
    table.attrs["confidence"] = level
    return table


def interval_words(row: pd.Series) -> str:
    """Return mean and interval with as many digits as the interval's width leaves sensible."""
    width = max(row["ci_high"] - row["ci_low"], 1e-12)
    places = max(0, 1 - math.floor(math.log10(width)))
    return f"{row['mean']:.{places}f} ({row['ci_low']:.{places}f} to {row['ci_high']:.{places}f})"


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Result):
    """
    What a log says of a person and a robot, as equally likely draws of all parameters.

    Parameters
    ----------
    draws : pandas.DataFrame
        One row per draw: parameters as `fit_tsc` names them, time constants [s], initial states of
        each run, and the noise of each output: standard deviations per sample of its white and its
        slow part, and the time constant [s] of the latter.
    prior_draws : pandas.DataFrame
        Draws of the prior, with the same columns.
    prior : Prior
        The prior.
    k_hat : float
        Shape of the tail of the importance weights; above 0.7, or infinite, the draws are not to be
        trusted. 0 for walkers that moved for long enough.
    effective : float
        How many independent draws the sample is worth.
    method : {"importance", "adapted mixture", "ensemble", "population"}
        How it was made.
    whiteness : dict of float
        p value of the Ljung–Box test of each output's prediction errors, at the mean of the draws.
    labels : tuple of str
        The runs.
    synthetic : bool
        Whether any of the data were simulated.
    thetas : numpy.ndarray
        The draws in unbounded coordinates.
    target : Target
        The data as the likelihood reads them.
    """

    draws: pd.DataFrame
    prior_draws: pd.DataFrame
    prior: Prior
    k_hat: float
    effective: float
    method: str
    whiteness: dict[str, float]
    labels: tuple[str, ...]
    synthetic: bool
    thetas: np.ndarray
    target: Target

    how_to_get = "trustlab.sample_posterior(sessions) returns one"

    def __len__(self) -> int:
        return len(self.draws)

    @cached_property
    def models(self) -> list[TscModel]:
        """One `TscModel` per draw."""
        return tsc_models(self.draws)

    @property
    def reliable(self) -> bool:
        """Whether the draws may be trusted and the noise model fits the residuals."""
        return self.k_hat <= MOST_K and min(self.whiteness.values()) >= NOT_WHITE

    @property
    def title(self) -> str:
        """How many draws, and how well they follow the posterior."""
        origin = ", synthetic data" if self.synthetic else ""
        return f"Posterior, {len(self)} draws, k_hat {self.k_hat:.2g} ({self.method}){origin}"

    def table(self, level: float = 0.95) -> pd.DataFrame:
        """
        Return every parameter's posterior, and how much narrower than the prior it is.

        Parameters
        ----------
        level : float
            Level of the intervals, in (0, 1).

        Returns
        -------
        pandas.DataFrame
            Index `parameter`; columns mean, sd, ci_low, ci_high, narrower (1 less the width of the
            interval over that of the prior's) and k_hat.

        Raises
        ------
        ValueError
            If `level` is outside (0, 1).
        """
        table = summary(self.draws, open_unit("level", level))
        before = summary(self.prior_draws, level)
        widths = [each["ci_high"] - each["ci_low"] for each in (table, before)]
        return table.assign(narrower=1.0 - widths[0] / widths[1], k_hat=self.k_hat)

    @cached_property
    def message(self) -> str:
        """What these data determine, what they leave to the prior, and what to doubt."""
        table = self.table().loc[list(MODEL)]
        told = table["narrower"] >= 1.0 - DETERMINED
        values = [f"{WORDS[name]} {interval_words(row)}" for name, row in table[told].iterrows()]
        unknown = [WORDS[name] for name in table.index[~told]]
        sentences = [f"These data determine: {'; '.join(values)}."] if values else []
        if unknown:
            sentences.append(f"They leave mostly to the prior: {', '.join(unknown)}.")
        return " ".join(sentences + self.doubts())

    def doubts(self) -> list[str]:
        """Return reasons not to trust the draws."""
        doubts = []
        if not self.k_hat <= MOST_K:
            doubts.append(
                "Few draws agree with what the others show; raise n."
                if self.method == "population"
                else "The draws are not to be trusted: no proposal fits the posterior; record "
                "more, or state a narrower prior."
            )
        for output, p in self.whiteness.items():
            if p < NOT_WHITE:
                doubts.append(
                    f"No noise of a white and a first-order part explains {output} (Ljung–Box p = "
                    f"{p:.2g}): intervals may be too narrow."
                )
        apart = (self.thetas.mean(axis=0) - self.target.mean) / self.target.deviation
        if np.abs(apart[:SHARED]).max() > UNEXPECTED:
            doubts.append(
                "The data lie far from what the prior expects; if your measure has another unit or "
                "scale, state prior=trustlab.Prior(…)."
            )
        return doubts

    def plot(self):
        """
        Plot marginals beside the prior, and measured performance with the band of fitted curves.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes
            Seven marginals, then human and robot performance of the first run.
        """
        title = "Posterior, synthetic data" if self.synthetic else ""
        axes = axes_or_new(rows=3, columns=3, title=title, figsize=(8.2, 7))
        *panels, human, robot = axes.ravel()
        for panel, name in zip(panels, MODEL, strict=True):
            (low, high), (least, most) = (
                draws[name].quantile([0.01, 0.99]) for draws in (self.prior_draws, self.draws)
            )
            bins = np.linspace(low, high, 40)
            panel.hist(self.prior_draws[name], bins, density=True, color="0.8", label="prior")
            panel.hist(self.draws[name], 30, density=True, color="C0", alpha=0.7, label="posterior")
            if most - least < NARROW * (high - low):
                panel.set_xlim(2.0 * least - most, 2.0 * most - least)
                panel.locator_params(axis="x", nbins=4)
                panel.set_title(f"prior: {low:.3g} to {high:.3g}", fontsize="small")
            panel.set(xlabel=WORDS[name], yticks=[])
        panels[0].legend(fontsize="small")
        blocks = self.target.blocks
        first_run = slice(blocks.first_block[1])
        length = blocks.step * blocks.samples
        t = blocks.start + (np.arange(blocks.first_block[1]) + 0.5) * length
        curves = [simulate(theta, blocks)[:, first_run] for theta in self.thetas[:200]]
        bands = np.quantile(curves, [0.025, 0.5, 0.975], axis=0)
        for j, (panel, label) in enumerate([(human, "$P_h$"), (robot, "$P_r$")]):
            low, middle, high = bands[:, j]
            measured = blocks.measured[j, first_run]
            panel.plot(t, measured, lw=0.5, color="0.6", label=f"measured, {length:g}-s means")
            panel.fill_between(t, low, high, color="C1", alpha=0.5, label="95 % of fitted curves")
            panel.plot(t, middle, color="C1", lw=1.2)
            panel.set(xlabel="time [s]", ylabel=label)
            panel.set_title(self.labels[0], fontsize="small")
        human.legend(fontsize="x-small")
        return axes
