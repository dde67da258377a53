"""Logs and people that the tests of identification share."""

from pathlib import Path

import numpy as np
import pandas as pd

import trustlab as tl
from notebooks import noise_settings

ROOT = Path(__file__).parents[2]
MODELS = tl.published_models()
PILOT = MODELS["pilot"]
SWITCHING = np.repeat([1.0, 0.0] * 4, 2500)
NOISE = 0.003


def log(step=0.1, **columns):
    """A simulated session of these columns."""
    frame = pd.DataFrame(columns)
    t = pd.Index(step * np.arange(len(frame)), name="t")
    return tl.Session(frame.set_axis(t), tl.Metadata(participant=1, synthetic=True))


def session(mode=SWITCHING, noise=NOISE, seed=0, model=PILOT, r0=0.3, p_r0=0.3, step=0.1):
    """A session of an operator with white noise on both performances."""
    rng = np.random.default_rng(seed)
    run = model.simulate(mode, r0, p_r0)
    noisy = {y: run[y] + noise * rng.standard_normal(len(run)) for y in ("p_r", "p_h")}
    return log(step, mode=mode, **noisy)


def of_setting(name, seed):
    """A session of a setting of the notebook's, said to be simulated, and its options."""
    make, options = noise_settings.SETTINGS[name]
    return tl.Session(make(np.random.default_rng(seed)), tl.Metadata(synthetic=True)), options


def truth(model=PILOT, who="tsc"):
    """The parameters by the names of `fit_tsc`, or of `fit_human` or `fit_robot`."""
    human, robot = model.human, model.robot
    of_human = pd.Series(
        {name: getattr(human, name) for name in ("a", "beta", "p_min", "p_max", "b")}
    )
    of_robot = pd.Series({name: getattr(robot, name) for name in ("a", "p_min", "p_max", "b")})
    if who == "tsc":
        return pd.concat([of_human.add_prefix("human_"), of_robot.add_prefix("robot_")])
    return (
        of_human if who == "human" else pd.concat([of_robot, pd.Series({"p_h_max": human.p_max})])
    )


def scores(tables, expected):
    """z scores of the estimates, and whether intervals hold the truth: a row per table."""
    tables = [table.loc[expected.index] for table in tables]
    z = pd.DataFrame([(table["value"] - expected) / table["stderr"] for table in tables])
    inside = [(table["ci_low"] <= expected) & (expected <= table["ci_high"]) for table in tables]
    return z, pd.DataFrame(inside)
