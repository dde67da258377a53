"""
Populations from which simulated operators are drawn: the people who are printed, and a spread about
them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.allocation.limits import threshold_limits
from trustlab.models.checks import (
    of_class,
    one_of,
    whole_number,
    whole_seed,
)
from trustlab.models.published import printed_pilot, published_table
from trustlab.operators.ground_robot import (
    Operator,
    checked_assumptions,
    model_of,
    person_of,
)
from trustlab.operators.teleoperator import (
    RANGES,
    REACH,
    TELEOPERATOR_ASSUMPTIONS,
    Teleoperator,
    assumed,
)
from trustlab.testbeds.deciding import SAMPLE_TIME, Driver

# Mixed into the seed, so that people and their runs have different streams.
TELEOPERATORS = 0x70656F70
PEOPLE = {"ground_robot": TELEOPERATORS, "uav_following": 0x7561766C}

MOST_TRIES = 1000

# How many operators of the UAV go by a number; as many people took part in the study of Section
# 2.4.2.
PARTICIPANTS = 20

# Means and standard deviations of what Section 2.4.2 does not print of anyone: of the size of its
# means over people and conditions (P_r 0.55, P_h 0.81) and of its spreads. No difference between
# conditions went into them.
LEVELS = {"p_h_max": (0.86, 0.04), "p_h_min": (np.log(0.3), 0.2), "p_r_max": (0.62, 0.05)}
P_R_MIN = 0.30
# Means and standard deviations of the shares of suggestions followed, Section 2.4.2.4: by TSC and
# by performance.
FOLLOWED = ((0.6416, 0.2991), (0.4074, 0.3751))


def drawn_people(n: int, seed: int, people: int, draw: Callable) -> pd.DataFrame:
    """
    Return a row of draw(participant, rng) for each of so many people.

    Each has a random stream of their own, so that a smaller sample is the beginning of a larger
    one; `people` is mixed into the seed.
    """
    root = [whole_seed(seed), people]
    rows = []
    for number in range(1, whole_number("n", n) + 1):
        rng = np.random.default_rng(np.random.SeedSequence(root, spawn_key=(number,)))
        rows.append({"participant": number} | draw(number, rng))
    frame = pd.DataFrame(rows)
    frame.attrs["synthetic"] = True
    return frame


# --- people as printed ----------------------------------------------------------------------------

# The numbers of a person, in the order of `OperatorPopulation.draw`.
MODEL = ["a_r", "beta", "p_h_min", "p_h_max", "a_pr", "p_r_min", "p_r_max"]
# The same as `fit_population` names them, time constants [s] in place of a.
IDENTIFIED = ["human_time_constant", "human_beta", "human_p_min", "human_p_max"]
IDENTIFIED += ["robot_time_constant", "robot_p_min", "robot_p_max"]
OWN = ["lower", "upper", "lower_spread", "upper_spread"]
THRESHOLDS = ["tsc_l", "tsc_u"]
FOLLOW = ["follow_tsc", "follow_performance"]

PRINTED = ["1", "2", "3", "4", "5"]

# Of the pilot operator only the model and TSC_l(0) and TSC_u(0) are printed, in Sections 2.2 and
# 2.5. The own thresholds are these; their spreads and the shares followed are an operator's usual
# ones.
PILOT = {"lower": 0.02, "upper": 0.45, "lower_spread": 0.1, "upper_spread": 0.1}
PILOT |= {"tsc_l": 0.02, "tsc_u": 0.45, "follow_tsc": 0.7857, "follow_performance": 0.6389}


@cache
def printed_people() -> pd.DataFrame:
    """Return the numbers that Tables 2.1, 2.2, 2.3 and 2.6 print of people, a row for each."""
    models = published_table("2.1").assign(pilot=pd.Series(printed_pilot()))
    tables = [models.rename(index=str.lower).loc[MODEL]]
    tables += [published_table("2.3").set_axis(["lower", "lower_spread", "upper", "upper_spread"])]
    tables += [published_table("2.2").rename(index=str.lower).loc[THRESHOLDS]]
    tables += [published_table("2.6").set_axis(FOLLOW)]
    people = pd.concat(tables)[["pilot", *PRINTED]].astype(float).T
    people[FOLLOW] /= 100.0
    people.loc["pilot", list(PILOT)] = PILOT
    return people.assign(participant=people.index)


def printed_person(participant: int | str) -> Driver:
    """Return the operator, the model and the thresholds of TSC that are printed of someone."""
    people = printed_people()
    name = str(participant).strip().lower().removesuffix(".0")
    label = one_of("participant", name, people.index, "an Operator with model=")
    return person_of(people.loc[label])


def published_operator(participant: int | str) -> Operator:
    """
    Return the simulated stand-in for a participant, made of what is printed of them.

    Utilization and performance are those of Table 2.1, own thresholds (mean and SD) those of Table
    2.3, and the shares of suggestions followed those of Table 2.6. Of the pilot operator only the
    model is printed (Sections 2.2.2 and 2.2.3): own thresholds have the means printed as decision
    thresholds in Section 2.5, their spread and the shares are the defaults of `Operator`. How the
    hand drives and reacts is not printed of anyone and is that of `Operator`.

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    return printed_person(participant)[0]


# --- what is normally distributed -----------------------------------------------------------------


# From a number of a person to one that is normally distributed, and back. τ = 1/(1 − a) is a time
# constant in samples.
SAME = (lambda x: x, lambda z: z)
LOG = (np.log, np.exp)
LOG_BELOW = (lambda x: np.log(-x), lambda z: -np.exp(z))
LOG_TAU = (lambda a: -np.log(1.0 - a), lambda z: 1.0 - np.exp(-z))
LOGIT = (lambda x: np.log(x / (1.0 - x)), lambda z: 1.0 / (1.0 + np.exp(-z)))


class PersonCoordinate(NamedTuple):
    """
    One of the normally distributed numbers of a person.

    It stands for `quantity`, which is counted from the quantity `low`, where that is named, and as
    a share of the way to `high`. tsc_lb and tsc_ub are the limits (2.9)-(2.10) at δ_Ph = 0.
    """

    quantity: str
    scale: tuple[Callable, Callable] = SAME
    low: str = ""
    high: str = ""

    def range(self, person: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return where the quantity is counted from, and its unit."""
        low = person[self.low] if self.low else 0.0
        return low, person[self.high] - low if self.high else 1.0

    def of(self, person: Mapping[str, Any]) -> Any:
        """Return the coordinate of a person, or of a table of people."""
        low, unit = self.range(person)
        return self.scale[0]((person[self.quantity] - low) / unit)

    def quantity_at(self, z: float, person: Mapping[str, Any]) -> float:
        """Return the quantity of the person, whose other quantities are known, by a coordinate."""
        low, unit = self.range(person)
        return float(low + self.scale[1](z) * unit)


BETWEEN_LIMITS = SAME, "tsc_lb", "tsc_ub"
COORDINATES = {
    "ground_robot": (
        PersonCoordinate("a_r", LOG_TAU),
        PersonCoordinate("beta", LOGIT),
        PersonCoordinate("p_h_min"),
        PersonCoordinate("p_h_max", LOG, "p_h_min"),
        PersonCoordinate("a_pr", LOG_TAU),
        PersonCoordinate("p_r_max", LOG, "p_r_min"),
        PersonCoordinate("lower"),
        PersonCoordinate("upper", LOG, "lower"),
        PersonCoordinate("lower_spread", LOG),
        PersonCoordinate("upper_spread", LOG),
        PersonCoordinate("tsc_l", LOGIT, "tsc_lb", "tsc_ub"),
        PersonCoordinate("tsc_u", LOGIT, "tsc_l", "tsc_ub"),
    ),
    "uav_following": (
        PersonCoordinate("lower", *BETWEEN_LIMITS),
        PersonCoordinate("upper", *BETWEEN_LIMITS),
        PersonCoordinate("tsc_l", *BETWEEN_LIMITS),
        PersonCoordinate("tsc_u", *BETWEEN_LIMITS),
        PersonCoordinate("a_r", LOG_TAU),
        PersonCoordinate("a_pr", LOG_TAU),
        PersonCoordinate("beta", LOGIT),
        PersonCoordinate("lower_spread", LOG),
        PersonCoordinate("upper_spread", LOG),
        PersonCoordinate("p_h_max"),
        PersonCoordinate("p_h_min", LOG_BELOW, "p_h_max"),
        PersonCoordinate("p_r_max"),
    ),
}


def with_limits(person: Mapping[str, Any]) -> dict[str, Any]:
    """Return a person with the limits of thresholds of TSC, as `PersonCoordinate` names them."""
    limits = threshold_limits(model_of(person))
    return {**person, "tsc_lb": limits.lower, "tsc_ub": limits.upper}


def printed_coordinates(testbed: str) -> pd.DataFrame:
    """Return the coordinates of the printed participants, a row for each."""
    people = pd.DataFrame(map(with_limits, printed_people().loc[PRINTED].to_dict("records")))
    return pd.DataFrame({each.quantity: each.of(people) for each in COORDINATES[testbed]})


def person_at(z: np.ndarray, testbed: str, p_r_min: float) -> dict[str, float]:
    """Return the numbers of the person at coordinates; `ValueError` if they make no model."""
    person = {"p_r_min": p_r_min}
    # places between the limits of thresholds come after the model that the limits follow from
    for placed in (False, True):
        if placed:
            person = with_limits(person)
        for coordinate, number in zip(COORDINATES[testbed], z.tolist(), strict=True):
            if bool(coordinate.high) == placed:
                person[coordinate.quantity] = coordinate.quantity_at(number, person)
    valid = person["tsc_lb"] < person["tsc_l"] < person["tsc_u"] < person["tsc_ub"]
    valid &= -1.0 <= person["lower"] < person["upper"] <= 1.0
    if testbed == "uav_following":  # where performance is a share
        valid &= person["p_h_min"] > 0.1 and person["p_h_max"] < 0.98
        valid &= p_r_min + 0.05 < person["p_r_max"] < 0.95
    if not valid:
        raise ValueError("thresholds or performance lie outside their limits")
    return {name: person[name] for name in (*MODEL, *OWN, *THRESHOLDS)}


# --- populations ----------------------------------------------------------------------------------


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

    A population is made by `ground_robot`, `of_people` or `uav_following`.

    Parameters
    ----------
    mean : numpy.ndarray, shape (12,)
        Of the coordinates.
    covariance : numpy.ndarray, shape (12, 12)
        Of the coordinates.
    follow : ((float, float), (float, float))
        Mean and standard deviation of the shares of suggestions followed, by TSC and by
        performance.
    p_r_min : float
        Least robot performance.
    origin : str
        Where the numbers come from.
    testbed : {"ground_robot", "uav_following"}
        Whose coordinates these are.

    Notes
    -----
    Five people identify no distribution of twelve numbers: means and spreads are rough,
    correlations hardly known.
    """

    mean: np.ndarray
    covariance: np.ndarray
    follow: Any
    p_r_min: float
    origin: str
    testbed: str = "ground_robot"

    @classmethod
    def ground_robot(cls) -> "OperatorPopulation":
        """
        Return the population with the means and spreads of the five participants of Tables 2.1,
        2.2, 2.3 and 2.6.

        The sample covariance of the five alone is singular: correlations are halved, variances
        stay.
        """
        rows = printed_coordinates("ground_robot").to_numpy()
        sample = np.cov(rows.T)
        matrix = 0.5 * sample + 0.5 * np.diag(np.diag(sample))
        shares = published_table("2.6").loc[["C2", "C4"], ["mean", "sd"]].astype(float) / 100.0
        origin = "Tables 2.1, 2.2, 2.3 and 2.6"
        return cls(rows.mean(axis=0), matrix, shares.to_numpy(), 0.24, origin)

    @classmethod
    def of_people(cls, people: Any) -> "OperatorPopulation":
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
        from scipy.linalg import block_diag

        from trustlab.identification.posterior.population import Population

        rest = cls.ground_robot()
        new = of_class("people", people, Population, Population.how_to_get).new_person
        person = new[IDENTIFIED].set_axis(MODEL, axis=1)
        person[["a_r", "a_pr"]] = np.exp(-SAMPLE_TIME / person[["a_r", "a_pr"]])
        model = [each for each in COORDINATES[rest.testbed] if each.quantity in MODEL]
        rows = np.column_stack([coordinate.of(person) for coordinate in model])
        habits = slice(len(model), None)
        mean = np.r_[rows.mean(axis=0), rest.mean[habits]]
        covariance = block_diag(np.cov(rows.T), rest.covariance[habits, habits])
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
        printed = printed_coordinates("uav_following").agg(["mean", "std"])
        mean, sd = printed.assign(**LEVELS).to_numpy()
        origin = "Tables 2.1-2.3 and Section 2.4.2.4; ranges of performance plausible, not measured"
        return cls(mean, np.diag(sd**2), FOLLOWED, P_R_MIN, origin, "uav_following")

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
            What is assumed of all operators: any of `trustlab.operators.ASSUMPTIONS`.

        Returns
        -------
        pandas.DataFrame
            A row per operator: participant (from 1), a_r, beta, p_h_min, p_h_max, a_pr, p_r_min,
            p_r_max, lower, upper, lower_spread, upper_spread, tsc_l, tsc_u, follow_tsc,
            follow_performance, redrawn (how many draws were invalid), and what is assumed.

        Raises
        ------
        ValueError
            If hardly any draw is a valid model.
        """
        people = checked_assumptions(assumptions)
        frame = drawn_people(n, seed, PEOPLE[self.testbed], self._drawn)
        return frame.assign(**people)

    def _drawn(self, number: int, rng: np.random.Generator) -> dict[str, float]:
        """Return the row of one operator."""
        shares = {}
        for name, (mean, sd) in zip(FOLLOW, self.follow, strict=True):
            total = mean * (1.0 - mean) / sd**2 - 1.0
            shares[name] = rng.beta(mean * total, (1.0 - mean) * total)
        root = np.linalg.cholesky(self.covariance)
        for redrawn in range(MOST_TRIES):
            z = self.mean + root @ rng.standard_normal(len(self.mean))
            try:
                row = person_at(z, self.testbed, self.p_r_min) | shares
                person_of({"participant": number} | row)
            except ValueError:
                continue
            return row | {"redrawn": redrawn}
        raise ValueError(
            f"none of {MOST_TRIES} draws for participant {number} is a valid model; check means "
            "and spreads of this population"
        )

    person = staticmethod(person_of)


@cache
def seeded_people() -> list[dict[str, Any]]:
    """Return the operators of the UAV who go by a number."""
    return OperatorPopulation.uav_following().draw(PARTICIPANTS, seed=0).to_dict("records")


def following_operator(participant: int | str) -> Driver:
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
    name = str(participant).removesuffix(".0")
    number = int(name) if name.isdecimal() else participant
    return person_of(seeded_people()[whole_number("participant", number, most=PARTICIPANTS) - 1])


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

    Raises
    ------
    ValueError
        If the study is unknown.
    """

    origin = "plausible ranges, not measured"

    study: str = "main"

    def __post_init__(self):
        one_of("study", self.study, REACH)

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
        people = checked_assumptions(assumptions, TELEOPERATOR_ASSUMPTIONS)

        def draw(number: int, rng: np.random.Generator) -> dict:
            skill, last, *draws = rng.uniform(size=len(RANGES) + 2).tolist()
            row = {"skill": skill}
            for (name, (low, high)), u in zip(RANGES.items(), draws, strict=True):
                row[name] = low + (high - low) * 0.5 * (skill + u)
            row |= {"patience": 2.0 + 2.0 * last, "reach": REACH[self.study]}
            return assumed(row, people, rng.uniform())

        return drawn_people(n, seed, TELEOPERATORS, draw)

    @staticmethod
    def person(values: Mapping[str, Any]) -> Teleoperator:
        """
        Return the simulated operator of one row of `draw`.

        Parameters
        ----------
        values : dict
            The row.
        """
        names = Teleoperator.__match_args__
        return Teleoperator(**{name: values[name] for name in names if name in values})
