"""
Ratings over many studies. Oracles: rejections counted by clmm of R's ordinal on studies that R drew
(reference/ordinal_power.R), and probabilities integrated over people.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import special, stats

import trustlab as tl

R = json.loads((Path(__file__).parents[0] / "reference" / "ordinal_power.json").read_text())
BELOW = special.logit(np.cumsum(R["first"])[:-1])


@pytest.mark.long
@pytest.mark.parametrize("case", R["cases"], ids=str)
def test_power_is_the_share_of_rejections_in_r(case):
    """
    Two binomial counts of one probability, within four standard errors. A study whose likelihood
    has no maximum is refused here; clmm stops somewhere.
    """
    rng = np.random.default_rng(3)
    n, count, rejected, refused = case["n"], 300, 0, 0
    frame = pd.DataFrame({"person": np.repeat(np.arange(n), 2), "condition": ["a", "b"] * n})
    for _ in range(count):
        answers = case["sd"] * np.repeat(rng.standard_normal(n), 2) + rng.logistic(size=2 * n)
        answers += np.tile([0.0, case["shift"]], n)
        frame["rating"] = np.searchsorted(BELOW, answers)
        try:
            model = tl.ordinal_model(frame, "rating", "condition", "person")
        except ValueError as error:
            if "the likelihood has no maximum" not in str(error):
                raise
            refused += 1
            continue
        rejected += model.table()["p_chi2"].item() < 0.05
    assert refused <= 0.01 * count
    power, other = rejected / (count - refused), case["rejected"] / R["replicates"]
    middle = 0.5 * (power + other)
    error = np.sqrt(middle * (1.0 - middle) * (1.0 / count + 1.0 / R["replicates"]))
    assert abs(power - other) <= 4.0 * error


@pytest.mark.long
def test_intervals_of_probabilities_cover_as_they_say():
    """30 people, two conditions, two ratings in each; the truth is an integral over people."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    weights = weights / weights.sum()
    sd = 1.2
    shifts = {"a": 0.0, "b": 0.8}
    truth = {}
    for condition, shift in shifts.items():
        below = special.expit(BELOW[:, None] - shift - sd * nodes) @ weights
        truth[condition] = np.diff(below, prepend=0.0, append=1.0)
    rng = np.random.default_rng(0)
    hits = []
    studies = 150
    for _ in range(studies):
        person = np.repeat(np.arange(30), 4)
        condition = np.tile(["a", "a", "b", "b"], 30)
        shift = np.array([shifts[name] for name in condition])
        answers = sd * rng.standard_normal(30)[person] + shift + rng.logistic(size=120)
        frame = pd.DataFrame({"person": person, "condition": condition})
        frame["rating"] = np.searchsorted(BELOW, answers)
        cells = tl.ordinal_model(frame, "rating", "condition", "person").probabilities()
        for name, rows in cells.groupby("condition", observed=True):
            right = truth[str(name)][rows["category"].to_numpy(dtype=int)]
            hits.extend((rows["ci_low"] <= right) & (right <= rows["ci_high"]))
    share = np.mean(hits)
    print("covered", share, len(hits))
    # Ten intervals of a study depend on each other; studies do not.
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], studies, 0.95) / studies
    assert low <= share <= high
