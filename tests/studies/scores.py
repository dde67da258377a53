"""Scores of people as long tables, and values by R: what tests of statistics share."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import trustlab as tl

approx, parametrize = pytest.approx, pytest.mark.parametrize
COLUMNS = {"dv": "score", "within": "mode", "subject": "person"}


def reference(name):
    """What R gives for published data; the script of the same name has made the file."""
    return json.loads((Path(__file__).parent / "reference" / f"{name}.json").read_text())


def analysed_set(own):
    """The analysis of a published data set, rows in scrambled order."""
    frame = pd.DataFrame(own["columns"]).sample(frac=1.0, random_state=0)
    between = {"between": own["between"], "covariates": own["covariate"]}
    return tl.repeated_measures(frame, own["dv"], own["within"], own["id"], **between)


def long(values, labels="abcdefghij"):
    """Scores, shape (people, modes), as a long table."""
    n, k = np.shape(values)
    frame = pd.DataFrame({"person": np.repeat(range(n), k), "mode": list(labels[:k]) * n})
    return frame.assign(score=np.ravel(values))


def drawn(n=12, seed=0, people=1.0, **factors):
    """
    Scores of people who differ, in all cells of these factors, or in modes a, b and c; the first
    half of the people are novices.
    """
    factors = factors or {"mode": "abc"}
    levels = [range(n), *map(list, factors.values())]
    frame = pd.MultiIndex.from_product(levels, names=["person", *factors]).to_frame(index=False)
    rng = np.random.default_rng(seed)
    noise = people * rng.standard_normal(n)[frame["person"]] + rng.standard_normal(len(frame))
    return frame.assign(score=noise, group=np.where(frame["person"] < n // 2, "novice", "expert"))
