"""Draws of θ as parameters in their own units, and as models."""

import math

import numpy as np
import pandas as pd

from trustlab.identification.posterior.likelihood import (
    BETA,
    DELAY,
    H_MIN,
    H_NOISE,
    H_SPAN,
    MEMORY,
    P_MIN,
    P_NOISE,
    P_SPAN,
    SLOW,
    STATES,
    TAU_P,
    TAU_R,
    WHITE,
)
from trustlab.models.tsc import HumanModel, RobotModel, TscModel

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


def physical(thetas: np.ndarray, step: float) -> pd.DataFrame:
    """Return rows of θ as parameters in their own units; `step` [s] is that of the models."""
    columns = {
        "human_time_constant": np.exp(thetas[:, TAU_R]),
        "human_a": np.exp(-step / np.exp(thetas[:, TAU_R])),
        "human_beta": 1.0 / (1.0 + np.exp(-thetas[:, BETA])),
        "human_p_min": thetas[:, H_MIN],
        "human_p_max": thetas[:, H_MIN] + np.exp(thetas[:, H_SPAN]),
        "robot_time_constant": np.exp(thetas[:, TAU_P]),
        "robot_a": np.exp(-step / np.exp(thetas[:, TAU_P])),
        "robot_p_min": thetas[:, P_MIN],
        "robot_p_max": thetas[:, P_MIN] + np.exp(thetas[:, P_SPAN]),
        "mode_delay": thetas[:, DELAY],
    }
    runs = (thetas.shape[1] - STATES) // 2
    for run in range(runs):
        label = f"[{run}]" if runs > 1 else ""
        place = STATES + 2 * run
        columns[f"r0{label}"] = 1.0 / (1.0 + np.exp(-thetas[:, place]))
        columns[f"p_r0{label}"] = thetas[:, P_MIN] + thetas[:, place + 1]
    for output, place in (("p_h", H_NOISE), ("p_r", P_NOISE)):
        columns[f"{output}_white"] = np.exp(thetas[:, place + WHITE])
        columns[f"{output}_slow"] = np.exp(thetas[:, place + SLOW])
        columns[f"{output}_slow_time"] = np.exp(thetas[:, place + MEMORY])
    return pd.DataFrame(columns)


def tsc_models(draws: pd.DataFrame) -> list[TscModel]:
    """Return the model of every draw."""
    models = []
    for row in draws.to_dict("records"):
        human = HumanModel(
            row["human_a"], row["human_beta"], row["human_p_min"], row["human_p_max"]
        )
        robot = RobotModel(
            row["robot_a"], row["robot_p_min"], row["robot_p_max"], row["human_p_max"]
        )
        models.append(TscModel(robot, human))
    return models


def summary(draws: pd.DataFrame, level: float) -> pd.DataFrame:
    """Return mean, sd and interval of every column."""
    low, high = draws.quantile([0.5 - 0.5 * level, 0.5 + 0.5 * level]).to_numpy()
    columns = {"mean": draws.mean(), "sd": draws.std(), "ci_low": low, "ci_high": high}
    return pd.DataFrame(columns).rename_axis("parameter")


def interval_words(row: pd.Series) -> str:
    """Return mean and interval with as many digits as the interval's width leaves sensible."""
    width = max(row["ci_high"] - row["ci_low"], 1e-12)
    places = max(0, 1 - math.floor(math.log10(width)))
    return f"{row['mean']:.{places}f} ({row['ci_low']:.{places}f} to {row['ci_high']:.{places}f})"
