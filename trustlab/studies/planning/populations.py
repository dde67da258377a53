"""
Populations from which simulated operators are drawn: stand-ins for people, with the identified
spread.
"""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy import special

from trustlab.allocation.limits import threshold_limits
from trustlab.models.axes import axes_or_new
from trustlab.models.checks import finite_array, finite_number, one_of, positive, whole_number
from trustlab.models.published import published_models, published_table
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator, model_of, person_of, share_drawn
from trustlab.operators.teleoperator import RANGES, REACH, Teleoperator
from trustlab.studies.planning.covariances import checked_covariance

# What is normally distributed. τ = 1/(1 − a) in samples. A place is a share of a range: for TSC_l,
# of the limits (2.9)-(2.10) at δ_Ph = 0; for TSC_u, of what lies between TSC_l and the upper limit.
COORDINATES = (
    "ln tau_r",
    "logit beta",
    "p_h_min",
    "ln (p_h_max - p_h_min)",
    "ln tau_pr",
    "ln (p_r_max - p_r_min)",
    "own lower",
    "ln (own upper - own lower)",
    "ln own lower spread",
    "ln own upper spread",
    "logit place of TSC_l",
    "logit place of TSC_u",
)

# Mixed into the seed, so that people and their runs have different streams.
PEOPLE = 0x70656F70

MOST_TRIES = 1000

# The participants of Tables 2.1 to 2.3.
PRINTED = ("1", "2", "3", "4", "5")


def _stream(seed: int, who: int) -> np.random.Generator:
    """
    Return the random numbers of one person, so that a smaller sample is the beginning of a larger
    one.
    """
    root = [whole_number("seed", seed, least=0), PEOPLE]
    return np.random.default_rng(np.random.SeedSequence(root, spawn_key=(who,)))


def _coordinates(label: str) -> np.ndarray:
    """Return a printed participant's coordinates, from Tables 2.1, 2.2 and 2.3."""
    model = published_models()[label]
    own, chosen = published_table("2.3")[label].astype(float), published_table("2.2")[label]
    limits = threshold_limits(model, 0.0)
    low, high = float(chosen["TSC_l"]), float(chosen["TSC_u"])
    human, robot = model.human, model.robot
    lower, upper = own["TSC_l", "mean"], own["TSC_u", "mean"]
    return np.array(
        [
            -np.log(human.b),
            special.logit(human.beta),
            human.p_min,
            np.log(human.p_max - human.p_min),
            -np.log(1.0 - robot.a),
            np.log(robot.p_max - robot.p_min),
            lower,
            np.log(upper - lower),
            np.log(own["TSC_l", "sd"]),
            np.log(own["TSC_u", "sd"]),
            special.logit((low - limits.lower) / (limits.upper - limits.lower)),
            special.logit((high - low) / (limits.upper - low)),
        ]
    )


@dataclass(frozen=True, eq=False)
class GroundRobotPopulation:
    """
    Operators of the ground robot: a normal distribution of twelve coordinates, truncated to valid
    models.

    The coordinates (`COORDINATES` in the module) are logarithms of positive numbers and logits of
    shares, so that nearly every draw is a valid model; draws with utilization or performance out of
    range, or thresholds outside the limits of Theorem 1, are repeated. Shares of suggestions
    followed have beta distributions with the printed means and standard deviations, independent of
    all else. The least robot performance is the same for all. Thresholds of TSC come from the
    operator's own model: identification without error.

    Parameters
    ----------
    mean : array_like, shape (12,)
        Of `COORDINATES`.
    covariance : array_like, shape (12, 12)
        Of `COORDINATES`; positive definite.
    follow : ((float, float), (float, float))
        Mean and standard deviation of the shares of suggestions followed, by TSC and by
        performance, in [0, 1].
    p_r_min : float
        Least robot performance [m/s].
    origin : str
        Where the numbers come from.
    testbed : str
        "ground_robot"; not an argument.

    Raises
    ------
    ValueError
        If sizes differ, the covariance is not positive definite, or no beta distribution has such a
        mean and spread.

    Notes
    -----
    Five people identify no distribution of twelve numbers: means and spreads are rough,
    correlations hardly known.
    """

    mean: np.ndarray
    covariance: np.ndarray
    follow: tuple[tuple[float, float], tuple[float, float]]
    p_r_min: float = 0.24
    origin: str = "own numbers"
    testbed: str = field(default="ground_robot", init=False)

    def __post_init__(self):
        size = len(COORDINATES)
        object.__setattr__(self, "mean", finite_array("mean", self.mean, length=size))
        object.__setattr__(
            self, "covariance", checked_covariance("covariance", self.covariance, size)
        )
        object.__setattr__(self, "p_r_min", finite_number("p_r_min", self.p_r_min))
        try:
            tsc, performance = self.follow
            pairs = tuple(
                (finite_number("follow", a), finite_number("follow", b))
                for a, b in (tsc, performance)
            )
        except (TypeError, ValueError):
            raise ValueError(
                f"follow must be two pairs of numbers (mean, SD), got {self.follow!r:.100}"
            ) from None
        for average, sd in pairs:
            if not (0.0 < average < 1.0 and 0.0 < sd < np.sqrt(average * (1.0 - average))):
                need = "the mean must lie in (0, 1) and the SD below √(mean (1 − mean))"
                raise ValueError(
                    f"shares with mean {average:g} and SD {sd:g} have no beta distribution: {need}"
                )
        object.__setattr__(self, "follow", pairs)

    @classmethod
    def published(cls, shrinkage: float = 0.5, spread: float = 1.0) -> "GroundRobotPopulation":
        """
        Return the population with the means and spreads of the five participants of Tables 2.1,
        2.2, 2.3 and 2.6.

        Parameters
        ----------
        shrinkage : float
            λ in (0, 1] of (1 − λ) S + λ diag S, S the sample covariance of the five, which alone is
            singular: correlations are shrunk towards zero, variances stay.
        spread : float
            Factor on all standard deviations of the coordinates; positive.

        Raises
        ------
        ValueError
            If a number is out of range.
        """
        shrinkage, spread = finite_number("shrinkage", shrinkage), positive("spread", spread)
        if not 0.0 < shrinkage <= 1.0:
            raise ValueError(
                f"shrinkage must lie in (0, 1], got {shrinkage}: at 0 the covariance of five is "
                "singular"
            )
        rows = np.array([_coordinates(label) for label in PRINTED])
        sample = np.cov(rows.T)
        matrix = spread**2 * ((1.0 - shrinkage) * sample + shrinkage * np.diag(np.diag(sample)))
        shares = published_table("2.6")[["mean", "sd"]].astype(float) / 100.0
        tsc, performance = (
            (float(shares.loc[c, "mean"]), float(shares.loc[c, "sd"])) for c in ("C2", "C4")
        )
        return cls(
            rows.mean(axis=0), matrix, (tsc, performance), 0.24, "Tables 2.1, 2.2, 2.3 and 2.6"
        )

    def table(self) -> pd.DataFrame:
        """
        Return the distribution: columns quantity, distribution, mean, sd, of the coordinate as
        named.
        """
        size = len(COORDINATES)
        mean, sd = np.transpose(self.follow)
        return pd.DataFrame(
            {
                "quantity": [*COORDINATES, "follow_tsc", "follow_performance"],
                "distribution": ["normal, truncated to valid models"] * size + ["beta"] * 2,
                "mean": np.r_[self.mean, mean],
                "sd": np.r_[np.sqrt(np.diag(self.covariance)), sd],
            }
        )

    def plot(self, n: int = 400, seed: int = 0) -> np.ndarray:
        """
        Plot operators drawn from the population, beside the participants of Tables 2.1 and 2.3.

        Parameters
        ----------
        n : int
            How many to draw.
        seed : int
            Seed of the draws.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (3,)
        """
        from trustlab.testbeds.deciding import SAMPLE_TIME

        printed = pd.DataFrame([self._values(_coordinates(label)) for label in PRINTED])
        axes = axes_or_new(columns=3, figsize=(10, 3.4))
        for frame, style, label in (
            (self.draw(n, seed), {"marker": ".", "ms": 3, "alpha": 0.5}, "drawn"),
            (printed, {"marker": "x", "ms": 8, "color": "black"}, "the five printed"),
        ):
            seconds = SAMPLE_TIME / (1.0 - frame[["a_r", "a_pr"]])
            axes[0].plot(frame["beta"], frame["p_h_max"], ls="", label=label, **style)
            axes[1].plot(seconds["a_r"], seconds["a_pr"], ls="", **style)
            axes[2].plot(frame["lower"], frame["upper"], ls="", **style)
        axes[0].set(xlabel="β", ylabel="best human performance [m/s]")
        axes[1].set(xlabel="time constant of utilization [s]", ylabel="of robot performance [s]")
        axes[2].set(xlabel="own lower threshold of TSC", ylabel="own upper threshold")
        axes[0].legend()
        return axes

    def draw(self, n: int, seed: int = 0) -> pd.DataFrame:
        """
        Draw operators; those of a smaller n are the first of a larger one.

        Parameters
        ----------
        n : int
            How many.
        seed : int
            Each operator has a random stream of its own.

        Returns
        -------
        pandas.DataFrame
            A row per operator: participant (from 1), a_r, beta, p_h_min, p_h_max, a_pr, p_r_min,
            p_r_max, lower, upper, lower_spread, upper_spread, follow_tsc, follow_performance,
            tsc_l, tsc_u, redrawn (how many draws were invalid).

        Raises
        ------
        ValueError
            If hardly any draw is a valid model.
        """
        root = np.linalg.cholesky(self.covariance)
        rows = [
            self._one(who, _stream(seed, who), root) for who in range(1, whole_number("n", n) + 1)
        ]
        frame = pd.DataFrame(rows)
        frame.attrs["synthetic"] = True
        return frame

    def _one(self, who: int, rng: np.random.Generator, root: np.ndarray) -> dict:
        shares = [share_drawn(average, sd, rng) for average, sd in self.follow]
        more = {"follow_tsc": shares[0], "follow_performance": shares[1]}
        for tries in range(MOST_TRIES):
            coordinates = self.mean + root @ rng.standard_normal(len(COORDINATES))
            try:
                values = (
                    {"participant": who} | self._values(coordinates) | more | {"redrawn": tries}
                )
                self.person(values)
            except ValueError:
                continue
            return values
        found = f"none of {MOST_TRIES} draws for participant {who} is a valid model"
        raise ValueError(f"{found}; check means and spreads of this population")

    def _values(self, z: np.ndarray) -> dict[str, float]:
        """
        Return the parameters that coordinates stand for; raise `ValueError` if they make no model.
        """
        p_h_min, lower = float(z[2]), float(z[6])
        values = {
            "a_r": 1.0 - float(np.exp(-z[0])),
            "beta": float(special.expit(z[1])),
            "p_h_min": p_h_min,
            "p_h_max": p_h_min + float(np.exp(z[3])),
            "a_pr": 1.0 - float(np.exp(-z[4])),
            "p_r_min": self.p_r_min,
            "p_r_max": self.p_r_min + float(np.exp(z[5])),
            "lower": lower,
            "upper": lower + float(np.exp(z[7])),
            "lower_spread": float(np.exp(z[8])),
            "upper_spread": float(np.exp(z[9])),
        }
        limits = threshold_limits(model_of(values), 0.0)
        low = limits.lower + float(special.expit(z[10])) * (limits.upper - limits.lower)
        high = low + float(special.expit(z[11])) * (limits.upper - low)
        own = -1.0 <= values["lower"] < values["upper"] <= 1.0
        if not (own and limits.lower < low < high < limits.upper):
            raise ValueError("thresholds lie outside their limits")
        return values | {"tsc_l": low, "tsc_u": high}

    @staticmethod
    def person(values: dict[str, float]) -> tuple[Operator, TscModel, tuple[float, float]]:
        """
        Return the simulated operator, model and thresholds of TSC of one row of `draw`.

        Parameters
        ----------
        values : dict
            The row.

        Raises
        ------
        ValueError
            If they make no model or operator.
        """
        return person_of(values)


@dataclass(frozen=True)
class TeleoperatorPopulation:
    """
    Operators of the haptic device: skill uniform in [0, 1], properties about it as in
    `graded_teleoperators`.

    Each property lies at the share ½ (g + u) of its range in
    `trustlab.operators.teleoperator.RANGES`, where g is the skill and u is uniform in [0, 1] and
    drawn separately for each property; patience is uniform in 2 to 4 s. These ranges are plausible,
    not measured: the dissertation identifies no model of its teleoperators.

    Parameters
    ----------
    study : {"preliminary", "main"}
        Study whose settings and target are used: that of Section 3.8 or 3.9.
    testbed : str
        "uav"; not an argument.
    origin : str
        Where the numbers come from; not an argument.

    Raises
    ------
    ValueError
        If the study is unknown.
    """

    study: str = "main"
    testbed: str = field(default="uav", init=False)
    origin: str = field(default="plausible ranges, not measured", init=False)

    def __post_init__(self):
        one_of("study", self.study, REACH)

    def table(self) -> pd.DataFrame:
        """Return the distribution: columns quantity, distribution, mean, sd."""
        share = np.sqrt(2.0 / 12.0) / 2.0
        rows = [
            (
                name,
                f"between {low:g} and {high:g} by skill",
                0.5 * (low + high),
                abs(high - low) * share,
            )
            for name, (low, high) in RANGES.items()
        ]
        rows.append(("patience", "uniform, 2 to 4 s", 3.0, 2.0 / np.sqrt(12.0)))
        return pd.DataFrame(rows, columns=["quantity", "distribution", "mean", "sd"])

    def draw(self, n: int, seed: int = 0) -> pd.DataFrame:
        """
        Draw operators; those of a smaller n are the first of a larger one.

        Parameters
        ----------
        n : int
            How many.
        seed : int
            Each operator has a random stream of its own.

        Returns
        -------
        pandas.DataFrame
            A row per operator: participant (from 1), skill, proportional, derivative, reaction,
            lag, noise, patience, reach.
        """
        rows = []
        for who in range(1, whole_number("n", n) + 1):
            skill, last, *draws = _stream(seed, who).uniform(size=len(RANGES) + 2).tolist()
            row = {"participant": who, "skill": skill}
            for (name, (low, high)), u in zip(RANGES.items(), draws, strict=True):
                row[name] = low + (high - low) * 0.5 * (skill + u)
            rows.append(row | {"patience": 2.0 + 2.0 * last, "reach": REACH[self.study]})
        frame = pd.DataFrame(rows)
        frame.attrs["synthetic"] = True
        return frame

    @staticmethod
    def person(values: dict[str, float]) -> Teleoperator:
        """
        Return the simulated operator of one row of `draw`.

        Parameters
        ----------
        values : dict
            The row.
        """
        own = {name: values[name] for name in (*RANGES, "patience", "reach")}
        return Teleoperator(int(values["participant"]), **own)
