"""Logs and people that the tests of identification share."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import trustlab as tl

ROOT = Path(__file__).parents[2]
MODELS = tl.published_models()
PILOT = MODELS["pilot"]
SWITCHING = np.repeat([1.0, 0.0] * 4, 2500)
NOISE = 0.003
FITS = {"robot": tl.fit_robot, "human": tl.fit_human, "tsc": tl.fit_tsc}


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


def truth(model=PILOT, who="tsc"):
    """The parameters by the names of `fit_tsc`, or of `fit_human` or `fit_robot`."""
    human, robot = (
        pd.Series({name: getattr(part, name) for name in names.split()})
        for part, names in ((model.human, "a beta p_min p_max b"), (model.robot, "a p_min p_max b"))
    )
    if who == "tsc":
        return pd.concat([human.add_prefix("human_"), robot.add_prefix("robot_")])
    return human if who == "human" else pd.concat([robot, pd.Series({"p_h_max": human["p_max"]})])


def fits_giving_back(exact, model=PILOT):
    """The fits of exact data by name, which must give the model's parameters back."""
    fits = {}
    for who, fit_of in FITS.items():
        fits[who] = fit = fit_of(exact)
        assert fit.success, fit.message
        expected = truth(model, who)
        assert_allclose(fit.table().loc[expected.index, "value"], expected, rtol=1e-6)
    return fits


def scores(tables, expected):
    """z scores of the estimates, and whether intervals hold the truth: a row per table."""
    tables = [table.loc[expected.index] for table in tables]
    z = [(table["value"] - expected) / table["stderr"] for table in tables]
    inside = [expected.between(table["ci_low"], table["ci_high"]) for table in tables]
    return pd.DataFrame(z), pd.DataFrame(inside)


def undetermined(words):
    """A block whose call must find that the data tell too little, with an error that says this."""
    return pytest.raises(tl.IdentificationError, match=words)
