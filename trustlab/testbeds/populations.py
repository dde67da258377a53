"""
Populations from which simulated operators are drawn: stand-ins for people, with the identified
spread.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import linalg, special

from trustlab.allocation.limits import threshold_limits
from trustlab.identification.posterior.population import Population
from trustlab.models.checks import (
    finite_array,
    finite_number,
    of_class,
    one_of,
    positive,
    whole_number,
)
from trustlab.models.display import axes_or_new
from trustlab.models.published import published_models, published_table
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator, model_of, person_of, share_drawn
from trustlab.operators.teleoperator import (
    RANGES,
    REACH,
    Teleoperator,
    assumed,
    checked_teleoperation,
)
from trustlab.testbeds.covariance import checked_covariance
from trustlab.testbeds.deciding import SAMPLE_TIME

# Mixed into the seed, so that people and their runs have different streams.
PEOPLE = 0x70656F70
PEOPLE_OF_UAV = 0x7561766C

MOST_TRIES = 1000

# The participants of Tables 2.1 to 2.3.
PRINTED = ("1", "2", "3", "4", "5")

# How many operators of the UAV go by a number; as many people took part in the study of Section
# 2.4.2.
PARTICIPANTS = 20

# Means and standard deviations of what Section 2.4.2 does not print of anyone: of the size of its
# means over people and conditions (P_r 0.55, P_h 0.81) and of its spreads. No difference between
# conditions went into them.
LEVELS = {
    "p_h_max": (0.86, 0.04),
    "ln (p_h_max - p_h_min)": (np.log(0.3), 0.2),
    "p_r_max": (0.62, 0.05),
}
P_R_MIN = 0.30
# Means and standard deviations of the shares of suggestions followed, Section 2.4.2.4: by TSC and
# by performance.
FOLLOWED = ((0.6416, 0.2991), (0.4074, 0.3751))


def person_stream(seed: int, people: int, number: int) -> np.random.Generator:
    """
    Return the random numbers of one person, so that a smaller sample is the beginning of a larger
    one.
    """
    root = [whole_number("seed", seed, least=0), people]
    return np.random.default_rng(np.random.SeedSequence(root, spawn_key=(number,)))


def _checked_thresholds(values: dict[str, float], limits, low: float, high: float) -> dict:
    """Return the values with thresholds of TSC, unless own or suggested ones are out of order."""
    inside = limits.lower < low < high < limits.upper
    if not (inside and -1.0 <= values["lower"] < values["upper"] <= 1.0):
        raise ValueError("thresholds lie outside their limits")
    return values | {"tsc_l": low, "tsc_u": high}


def _ground_robot_values(z: Mapping[str, float], p_r_min: float) -> dict[str, float]:
    """
    Return the parameters that coordinates stand for; raise `ValueError` if they make no model.
    """
    values = {
        "a_r": 1.0 - float(np.exp(-z["ln tau_r"])),
        "beta": float(special.expit(z["logit beta"])),
        "p_h_min": z["p_h_min"],
        "p_h_max": z["p_h_min"] + float(np.exp(z["ln (p_h_max - p_h_min)"])),
        "a_pr": 1.0 - float(np.exp(-z["ln tau_pr"])),
        "p_r_min": p_r_min,
        "p_r_max": p_r_min + float(np.exp(z["ln (p_r_max - p_r_min)"])),
        "lower": z["own lower"],
        "upper": z["own lower"] + float(np.exp(z["ln (own upper - own lower)"])),
        "lower_spread": float(np.exp(z["ln own lower spread"])),
        "upper_spread": float(np.exp(z["ln own upper spread"])),
    }
    limits = threshold_limits(model_of(values))
    low = limits.lower + float(special.expit(z["logit place of TSC_l"])) * (
        limits.upper - limits.lower
    )
    high = low + float(special.expit(z["logit place of TSC_u"])) * (limits.upper - low)
    return _checked_thresholds(values, limits, low, high)


def _uav_values(z: Mapping[str, float], p_r_min: float) -> dict[str, float]:
    """
    Return the parameters that coordinates stand for; raise `ValueError` if they make no model.
    """
    values = {
        "a_r": 1.0 - float(np.exp(-z["ln tau_r"])),
        "beta": float(special.expit(z["logit beta"])),
        "p_h_min": z["p_h_max"] - float(np.exp(z["ln (p_h_max - p_h_min)"])),
        "p_h_max": z["p_h_max"],
        "a_pr": 1.0 - float(np.exp(-z["ln tau_pr"])),
        "p_r_min": p_r_min,
        "p_r_max": z["p_r_max"],
    }
    if values["p_h_min"] <= 0.1 or values["p_h_max"] >= 0.98:
        raise ValueError("human performance lies outside its range")
    if not p_r_min + 0.05 < values["p_r_max"] < 0.95:
        raise ValueError("robot performance lies outside its range")
    limits = threshold_limits(model_of(values))
    places = ("own lower", "own upper", "TSC_l", "TSC_u")
    lower, upper, low, high = (
        float(limits.lower + z[name] * (limits.upper - limits.lower)) for name in places
    )
    values |= {"lower": lower, "upper": upper}
    values |= {"lower_spread": float(np.exp(z["ln lower spread"]))}
    values |= {"upper_spread": float(np.exp(z["ln upper spread"]))}
    return _checked_thresholds(values, limits, low, high)


class Coordinates(NamedTuple):
    """What is normally distributed, and the parameters that it stands for."""

    names: tuple[str, ...]
    values: Callable[[Mapping[str, float], float], dict[str, float]]
    people: int


# τ = 1/(1 − a) in samples. A place is a share of a range: of the limits (2.9)-(2.10) at δ_Ph = 0,
# or, for TSC_u of the ground robot, of what lies between TSC_l and the upper limit.
COORDINATES = {
    "ground_robot": Coordinates(
        (
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
        ),
        _ground_robot_values,
        PEOPLE,
    ),
    "uav_following": Coordinates(
        (
            "own lower",
            "own upper",
            "TSC_l",
            "TSC_u",
            "ln tau_r",
            "ln tau_pr",
            "logit beta",
            "ln lower spread",
            "ln upper spread",
            *LEVELS,
        ),
        _uav_values,
        PEOPLE_OF_UAV,
    ),
}


class Printed(NamedTuple):
    """What Tables 2.1, 2.2 and 2.3 print of a participant."""

    model: TscModel
    lower: float
    upper: float
    lower_spread: float
    upper_spread: float
    tsc_l: float
    tsc_u: float


def _printed(label: str) -> Printed:
    """Return what is printed of a participant."""
    habits = published_table("2.3")[label].astype(float)
    thresholds = published_table("2.2")[label]
    return Printed(
        published_models()[label],
        habits["TSC_l", "mean"],
        habits["TSC_u", "mean"],
        habits["TSC_l", "sd"],
        habits["TSC_u", "sd"],
        float(thresholds["TSC_l"]),
        float(thresholds["TSC_u"]),
    )


def _ground_robot_coordinates(label: str) -> np.ndarray:
    """Return a printed participant's coordinates."""
    printed = _printed(label)
    human, robot = printed.model.human, printed.model.robot
    limits = threshold_limits(printed.model)
    low, high = printed.tsc_l, printed.tsc_u
    return np.array(
        [
            -np.log(human.b),
            special.logit(human.beta),
            human.p_min,
            np.log(human.p_max - human.p_min),
            -np.log(1.0 - robot.a),
            np.log(robot.p_max - robot.p_min),
            printed.lower,
            np.log(printed.upper - printed.lower),
            np.log(printed.lower_spread),
            np.log(printed.upper_spread),
            special.logit((low - limits.lower) / (limits.upper - limits.lower)),
            special.logit((high - low) / (limits.upper - low)),
        ]
    )


def _uav_coordinates(label: str) -> np.ndarray:
    """Return the coordinates of a printed participant that the UAV's operators share with them."""
    printed = _printed(label)
    human, robot = printed.model.human, printed.model.robot
    limits = threshold_limits(printed.model)
    thresholds = (printed.lower, printed.upper, printed.tsc_l, printed.tsc_u)
    width = limits.upper - limits.lower
    return np.array(
        [
            *((value - limits.lower) / width for value in thresholds),
            -np.log(1.0 - human.a),
            -np.log(1.0 - robot.a),
            special.logit(human.beta),
            np.log(printed.lower_spread),
            np.log(printed.upper_spread),
        ]
    )


@dataclass(frozen=True, eq=False)
class OperatorPopulation:
    """
    Operators under C1 to C5: a normal distribution of twelve coordinates, truncated to valid
    models.

    The coordinates (`COORDINATES` of the module, by testbed) are mostly logarithms of positive
    numbers and logits of shares, so that nearly every draw is a valid model; draws with utilization
    or performance out of range, or thresholds outside the limits of Theorem 1, are repeated. Shares
    of suggestions followed have beta distributions, independent of all else. The least robot
    performance is the same for all. Thresholds of TSC come from the operator's own model:
    identification without error.

    Parameters
    ----------
    mean : array_like, shape (12,)
        Of the coordinates.
    covariance : array_like, shape (12, 12)
        Of the coordinates; positive definite.
    follow : ((float, float), (float, float))
        Mean and standard deviation of the shares of suggestions followed, by TSC and by
        performance, in [0, 1].
    p_r_min : float
        Least robot performance.
    origin : str
        Where the numbers come from.
    testbed : {"ground_robot", "uav_following"}
        Whose coordinates these are.

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
    testbed: str = "ground_robot"

    def __post_init__(self):
        one_of("testbed", self.testbed, COORDINATES)
        size = len(self.coordinates.names)
        object.__setattr__(self, "mean", finite_array("mean", self.mean, length=size))
        object.__setattr__(
            self, "covariance", checked_covariance("covariance", self.covariance, size)
        )
        object.__setattr__(self, "p_r_min", finite_number("p_r_min", self.p_r_min))
        try:
            tsc, performance = self.follow
            pairs = tuple(
                (finite_number("follow", average), finite_number("follow", sd))
                for average, sd in (tsc, performance)
            )
        except (TypeError, ValueError):
            raise ValueError(
                f"follow must be two pairs of numbers (mean, SD), got {self.follow!r:.100}"
            ) from None
        for average, sd in pairs:
            if not (0.0 < average < 1.0 and 0.0 < sd < np.sqrt(average * (1.0 - average))):
                raise ValueError(
                    f"shares with mean {average:g} and SD {sd:g} have no beta distribution: the "
                    "mean must lie in (0, 1) and the SD below √(mean (1 − mean))"
                )
        object.__setattr__(self, "follow", pairs)

    @property
    def coordinates(self) -> Coordinates:
        """What is normally distributed."""
        return COORDINATES[self.testbed]

    @classmethod
    def ground_robot(cls, shrinkage: float = 0.5, spread: float = 1.0) -> "OperatorPopulation":
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
        rows = np.array([_ground_robot_coordinates(label) for label in PRINTED])
        sample = np.cov(rows.T)
        matrix = spread**2 * ((1.0 - shrinkage) * sample + shrinkage * np.diag(np.diag(sample)))
        shares = published_table("2.6")[["mean", "sd"]].astype(float) / 100.0
        tsc, performance = (
            (float(shares.loc[c, "mean"]), float(shares.loc[c, "sd"])) for c in ("C2", "C4")
        )
        return cls(
            rows.mean(axis=0), matrix, (tsc, performance), 0.24, "Tables 2.1, 2.2, 2.3 and 2.6"
        )

    @classmethod
    def of_people(cls, people: Population) -> "OperatorPopulation":
        """
        Return operators of the ground robot who resemble people that `fit_population` was given.

        Their models are drawn from what is predicted of a new person. Logs of a task do not show
        how people answer suggestions: own thresholds and shares of suggestions followed are those
        of `ground_robot()`.

        Parameters
        ----------
        people : Population
            Performance in m/s, by (2.4) and (2.7).
        """
        rest = cls.ground_robot()
        new = of_class("people", people, Population, Population.how_to_get).new_person
        seconds = new[["human_time_constant", "robot_time_constant"]].to_numpy()
        tau = -1.0 / np.expm1(-SAMPLE_TIME / seconds)
        columns = [
            np.log(tau[:, 0]),
            special.logit(new["human_beta"]),
            new["human_p_min"],
            np.log(new["human_p_max"] - new["human_p_min"]),
            np.log(tau[:, 1]),
            np.log(new["robot_p_max"] - new["robot_p_min"]),
        ]
        rows = np.column_stack(columns)
        size = len(columns)
        mean = np.r_[rows.mean(axis=0), rest.mean[size:]]
        covariance = linalg.block_diag(np.cov(rows.T), rest.covariance[size:, size:])
        origin = f"{len(people)} people by fit_population; answers by {rest.origin}"
        return cls(mean, covariance, rest.follow, float(new["robot_p_min"].mean()), origin)

    @classmethod
    def uav_following(cls) -> "OperatorPopulation":
        """
        Return the population of the UAV that follows a leader: independent coordinates.

        Time constants, β and thresholds (by their place between the limits of Theorem 1) have the
        means and spreads of the five participants of Section 2.4.1; shares of suggestions followed
        those of Section 2.4.2.4. Ranges of performance are not printed for this study: they are of
        the size of its means, and no difference between conditions went into them.
        """
        rows = pd.DataFrame([_uav_coordinates(label) for label in PRINTED])
        mean, sd = np.transpose([*zip(rows.mean(), rows.std(), strict=True), *LEVELS.values()])
        origin = "Tables 2.1-2.3 and Section 2.4.2.4; ranges of performance plausible, not measured"
        return cls(mean, np.diag(sd**2), FOLLOWED, P_R_MIN, origin, "uav_following")

    def table(self) -> pd.DataFrame:
        """
        Return the distribution: columns quantity, distribution, mean, sd, of the coordinate as
        named.
        """
        names = self.coordinates.names
        mean, sd = np.transpose(self.follow)
        return pd.DataFrame(
            {
                "quantity": [*names, "follow_tsc", "follow_performance"],
                "distribution": ["normal, truncated to valid models"] * len(names) + ["beta"] * 2,
                "mean": np.r_[self.mean, mean],
                "sd": np.r_[np.sqrt(np.diag(self.covariance)), sd],
            }
        )

    def plot(self, n: int = 400, seed: int = 0) -> np.ndarray:
        """
        Plot operators drawn from the population; of the ground robot beside the participants of
        Tables 2.1 and 2.3.

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
        axes = axes_or_new(columns=3, figsize=(10, 3.4))
        layers = [(self.draw(n, seed), {"marker": ".", "ms": 3, "alpha": 0.5}, "drawn")]
        if self.testbed == "ground_robot":
            rows = [self._values(_ground_robot_coordinates(label)) for label in PRINTED]
            crosses = {"marker": "x", "ms": 8, "color": "black"}
            layers.append((pd.DataFrame(rows), crosses, "the five printed"))
        for frame, style, label in layers:
            seconds = SAMPLE_TIME / (1.0 - frame[["a_r", "a_pr"]])
            axes[0].plot(frame["beta"], frame["p_h_max"], ls="", label=label, **style)
            axes[1].plot(seconds["a_r"], seconds["a_pr"], ls="", **style)
            axes[2].plot(frame["lower"], frame["upper"], ls="", **style)
        unit = " [m/s]" if self.testbed == "ground_robot" else ""
        axes[0].set(xlabel="β", ylabel=f"best human performance{unit}")
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
            p_r_max, lower, upper, lower_spread, upper_spread, tsc_l, tsc_u, follow_tsc,
            follow_performance, redrawn (how many draws were invalid).

        Raises
        ------
        ValueError
            If hardly any draw is a valid model.
        """
        root = np.linalg.cholesky(self.covariance)
        numbers = range(1, whole_number("n", n) + 1)
        frame = pd.DataFrame([self._drawn(number, seed, root) for number in numbers])
        frame.attrs["synthetic"] = True
        return frame

    def _drawn(self, number: int, seed: int, root: np.ndarray) -> dict:
        rng = person_stream(seed, self.coordinates.people, number)
        tsc, performance = (share_drawn(average, sd, rng) for average, sd in self.follow)
        shares = {"follow_tsc": tsc, "follow_performance": performance}
        for tries in range(MOST_TRIES):
            z = self.mean + root @ rng.standard_normal(len(self.mean))
            try:
                values = {"participant": number} | self._values(z) | shares | {"redrawn": tries}
                self.person(values)
            except ValueError:
                continue
            return values
        raise ValueError(
            f"none of {MOST_TRIES} draws for participant {number} is a valid model; check means "
            "and spreads of this population"
        )

    def _values(self, z: np.ndarray) -> dict[str, float]:
        named = dict(zip(self.coordinates.names, z.tolist(), strict=True))
        return self.coordinates.values(named, self.p_r_min)

    @staticmethod
    def person(values: Mapping[str, Any]) -> tuple[Operator, TscModel, tuple[float, float]]:
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


@cache
def following_operator(participant: int | str) -> tuple[Operator, TscModel, tuple[float, float]]:
    """
    Return one of the twenty seeded operators of the UAV with their model and thresholds of TSC.

    Parameters
    ----------
    participant : int or str
        1 to 20, or "1" to "20".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    if isinstance(participant, str) and participant.isdecimal():
        participant = int(participant)
    number = whole_number("participant", participant, most=PARTICIPANTS)
    rows = OperatorPopulation.uav_following().draw(number, seed=0).to_dict("records")
    return person_of(rows[-1])


@dataclass(frozen=True)
class TeleoperatorPopulation:
    """
    Operators of the haptic device: skill uniform in [0, 1], and properties about it.

    Each property lies at the share ½ (g + u) of its range in
    `trustlab.operators.teleoperator.RANGES`, where g is the skill and u is uniform in [0, 1] and
    drawn separately for each property; patience is uniform in 2 to 4 s. These ranges are plausible,
    not measured: the dissertation identifies no model of its teleoperators.

    Parameters
    ----------
    study : {"preliminary", "main"}
        Study whose settings and target are used: that of Section 3.8 or 3.9.
    testbed : str
        "uav_tracking"; not an argument.
    origin : str
        Where the numbers come from; not an argument.

    Raises
    ------
    ValueError
        If the study is unknown.
    """

    study: str = "main"
    testbed: str = field(default="uav_tracking", init=False)
    origin: str = field(default="plausible ranges, not measured", init=False)

    def __post_init__(self):
        one_of("study", self.study, REACH)

    def table(self) -> pd.DataFrame:
        """Return the distribution: columns quantity, distribution, mean, sd."""
        share = np.sqrt(2.0 / 12.0) / 2.0
        rows = []
        for name, (low, high) in RANGES.items():
            words = f"between {low:g} and {high:g} by skill"
            rows.append((name, words, 0.5 * (low + high), abs(high - low) * share))
        rows.append(("patience", "uniform, 2 to 4 s", 3.0, 2.0 / np.sqrt(12.0)))
        return pd.DataFrame(rows, columns=["quantity", "distribution", "mean", "sd"])

    def draw(
        self, n: int, seed: int = 0, assumptions: Mapping[str, float] | None = None
    ) -> pd.DataFrame:
        """
        Draw operators; those of a smaller n are the first of a larger one.

        Parameters
        ----------
        n : int
            How many.
        seed : int
            Each operator has a random stream of its own.
        assumptions : mapping of str to float, optional
            What is assumed of all operators: any of `trustlab.operators.TELEOPERATOR_ASSUMPTIONS`.

        Returns
        -------
        pandas.DataFrame
            A row per operator: participant (from 1), skill, proportional, derivative, reaction,
            lag, noise, patience, reach, crossover, compensation, allocation_cost, fatigue, law.
        """
        people = checked_teleoperation({} if assumptions is None else assumptions)
        rows = []
        for number in range(1, whole_number("n", n) + 1):
            rng = person_stream(seed, PEOPLE, number)
            skill, last, *draws = rng.uniform(size=len(RANGES) + 2).tolist()
            row = {"participant": number, "skill": skill}
            for (name, (low, high)), u in zip(RANGES.items(), draws, strict=True):
                row[name] = low + (high - low) * 0.5 * (skill + u)
            row |= {"patience": 2.0 + 2.0 * last, "reach": REACH[self.study]}
            rows.append(assumed(row, people, rng.uniform()))
        frame = pd.DataFrame(rows)
        frame.attrs["synthetic"] = True
        return frame

    @staticmethod
    def person(values: Mapping[str, Any]) -> Teleoperator:
        """
        Return the simulated operator of one row of `draw`.

        Parameters
        ----------
        values : dict
            The row.
        """
        names = [field.name for field in fields(Teleoperator)[1:] if field.name in values]
        return Teleoperator(int(values["participant"]), **{name: values[name] for name in names})
