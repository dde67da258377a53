"""
Simulated operators of the UAV that follows a leader: twenty by number, and the population that they
are drawn from.
"""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pandas as pd
from scipy import special

from trustlab.allocation.limits import threshold_limits
from trustlab.models.checks import whole_number
from trustlab.models.published import published_models, published_table
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator, model_of, person_of, share_drawn

# How many operators go by a number; as many people took part in the study of Section 2.4.2.
PARTICIPANTS = 20

# Mixed into the seed, so that people and their runs have different streams.
PEOPLE = 0x7561766C

# Means and standard deviations of what Section 2.4.2 does not print of anyone: of the size of its
# means over people and conditions (P_r 0.55, P_h 0.81) and of its spreads. No difference between
# conditions went into them.
LEVELS = {
    "p_h_max": (0.86, 0.04),
    "ln (p_h_max - p_h_min)": (np.log(0.3), 0.2),
    "p_r_max": (0.62, 0.05),
}

P_R_MIN = 0.30
# Mean and standard deviation of the shares of suggestions followed, Section 2.4.2.4.
FOLLOWED = {"follow_tsc": (0.6416, 0.2991), "follow_performance": (0.4074, 0.3751)}

MOST_TRIES = 1000


@cache
def _borrowed() -> dict[str, tuple[float, float]]:
    """
    Return means and spreads borrowed from the five of Section 2.4.1; thresholds by their place
    between the limits (2.9)-(2.10).
    """
    rows = []
    own, chosen = published_table("2.3"), published_table("2.2")
    for label in "12345":
        model, printed = published_models()[label], own[label].astype(float)
        limits = threshold_limits(model, 0.0)
        places = {
            "own lower": printed["TSC_l", "mean"],
            "own upper": printed["TSC_u", "mean"],
            "TSC_l": float(chosen.loc["TSC_l", label]),
            "TSC_u": float(chosen.loc["TSC_u", label]),
        }
        row = {
            name: (value - limits.lower) / (limits.upper - limits.lower)
            for name, value in places.items()
        }
        row |= {"ln tau_r": -np.log(1.0 - model.human.a), "ln tau_pr": -np.log(1.0 - model.robot.a)}
        row |= {"logit beta": special.logit(model.human.beta)}
        row |= {
            f"ln {side} spread": np.log(printed[f"TSC_{side[0]}", "sd"])
            for side in ("lower", "upper")
        }
        rows.append(row)
    frame = pd.DataFrame(rows)
    return {name: (float(frame[name].mean()), float(frame[name].std())) for name in frame}


@dataclass(frozen=True)
class FollowingPopulation:
    """
    Operators of the UAV that follows a leader: independent normal coordinates, truncated to valid
    models.

    Time constants, β and thresholds (by their place between the limits of Theorem 1) have the means
    and spreads of the five participants of Section 2.4.1; shares of suggestions followed those of
    Section 2.4.2.4. Ranges of performance are not printed for this study: they are of the size of
    its means, and no difference between conditions went into them. Thresholds of TSC come from the
    operator's own model: identification without error.

    Parameters
    ----------
    testbed : str
        "uav_following"; not an argument.
    """

    testbed: str = field(default="uav_following", init=False)

    @property
    def origin(self) -> str:
        """Where the numbers come from."""
        return "Tables 2.1-2.3 and Section 2.4.2.4; ranges of performance plausible, not measured"

    def table(self) -> pd.DataFrame:
        """Return the distribution: columns quantity, distribution, mean, sd."""
        normal = [
            (name, "normal, truncated to valid models", *pair)
            for name, pair in (_borrowed() | LEVELS).items()
        ]
        shares = [(name, "beta", *pair) for name, pair in FOLLOWED.items()]
        return pd.DataFrame([*normal, *shares], columns=["quantity", "distribution", "mean", "sd"])

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
            tsc_l, tsc_u.
        """
        root = [whole_number("seed", seed, least=0), PEOPLE]
        streams = (
            np.random.SeedSequence(root, spawn_key=(who,))
            for who in range(1, whole_number("n", n) + 1)
        )
        rows = [
            {"participant": i} | _one(np.random.default_rng(one))
            for i, one in enumerate(streams, start=1)
        ]
        frame = pd.DataFrame(rows)
        frame.attrs["synthetic"] = True
        return frame

    @staticmethod
    def person(values: dict[str, float]) -> tuple[Operator, TscModel, tuple[float, float]]:
        """
        Return the simulated operator, model and thresholds of TSC of one row of `draw`.

        Parameters
        ----------
        values : dict
            The row.
        """
        return person_of(values)


def _one(rng: np.random.Generator) -> dict[str, float]:
    """
    Return the parameters of one operator, drawn until they make a model and thresholds in order.
    """
    known = _borrowed() | LEVELS
    shares = {name: share_drawn(*pair, rng) for name, pair in FOLLOWED.items()}
    for _ in range(MOST_TRIES):
        z = {name: float(mean + sd * rng.standard_normal()) for name, (mean, sd) in known.items()}
        values = {"a_r": 1.0 - np.exp(-z["ln tau_r"]), "beta": special.expit(z["logit beta"])}
        values |= {
            "p_h_min": z["p_h_max"] - np.exp(z["ln (p_h_max - p_h_min)"]),
            "p_h_max": z["p_h_max"],
        }
        values |= {
            "a_pr": 1.0 - np.exp(-z["ln tau_pr"]),
            "p_r_min": P_R_MIN,
            "p_r_max": z["p_r_max"],
        }
        if not (
            values["p_h_min"] > 0.1
            and values["p_h_max"] < 0.98
            and P_R_MIN + 0.05 < values["p_r_max"] < 0.95
        ):
            continue
        limits = threshold_limits(model_of(values), 0.0)
        at = {
            name: limits.lower + z[name] * (limits.upper - limits.lower)
            for name in z
            if name[:3] in ("own", "TSC")
        }
        inside = limits.lower < at["TSC_l"] < at["TSC_u"] < limits.upper
        if inside and -1.0 <= at["own lower"] < at["own upper"] <= 1.0:
            values |= {"lower": at["own lower"], "upper": at["own upper"]}
            values |= {
                f"{side}_spread": np.exp(z[f"ln {side} spread"]) for side in ("lower", "upper")
            }
            numbers = values | {"tsc_l": at["TSC_l"], "tsc_u": at["TSC_u"]}
            return {name: float(value) for name, value in numbers.items()} | shares
    raise ValueError(f"none of {MOST_TRIES} draws is a valid model")


@cache
def following_operator(participant: int | str) -> tuple[Operator, TscModel, tuple[float, float]]:
    """
    Return one of the twenty seeded operators with their model and thresholds of TSC.

    Parameters
    ----------
    participant : int or str
        1 to 20, or "1" to "20".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    given = (
        int(participant)
        if isinstance(participant, str) and participant.isdecimal()
        else participant
    )
    who = whole_number("participant", given, most=PARTICIPANTS)
    return FollowingPopulation.person(
        FollowingPopulation().draw(who, seed=0).to_dict("records")[-1]
    )
