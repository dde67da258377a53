"""Calibration of assumptions about people.

Oracles: simulation-based calibration (Talts et al. 2018: with truths drawn from the prior, their ranks in the posterior are uniform), on
a linear model; the campaign's own files.
"""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from trustlab.reproduction import read_calibration, write_calibration
from trustlab.reproduction.calibration import posterior_sample

RANGES = {"a": (0.0, 1.0), "b": (-1.0, 1.0), "c": (0.0, 2.0)}
TWO = {"attention_cost": (0.0, 0.3), "r0": (0.0, 1.0)}


def ranks(drawn, simulated, ranges, accepted, rows):
    """The place of every truth in the posterior made from all other simulations, in [0, 1]."""
    found = []
    for i in rows:
        others = np.arange(len(drawn)) != i
        sample, _ = posterior_sample(drawn[others], simulated[others], simulated[i], ranges, accepted, int(i))
        found.append((sample < drawn.iloc[i]).mean())
    return pd.DataFrame(found)


def linear_model(count=1200, seed=0):
    rng = np.random.default_rng(seed)
    low, high = np.transpose(list(RANGES.values()))
    drawn = pd.DataFrame(rng.uniform(low, high, (count, 3)), columns=list(RANGES))
    mixing = rng.normal(size=(3, 8))
    return drawn, drawn.to_numpy() @ mixing + rng.normal(0.0, 0.5, (count, 8))


def test_ranks_of_the_truth_are_uniform_on_a_linear_model():
    drawn, simulated = linear_model()
    found = ranks(drawn, simulated, RANGES, 0.15, range(200))
    for name in RANGES:
        assert stats.kstest(found[name], "uniform").pvalue > 0.01, name
        covered = int(((found[name] - 0.5).abs() < 0.4).sum())
        assert stats.binomtest(covered, 200, 0.8).pvalue > 0.01, name


def test_a_posterior_that_is_too_narrow_is_found_out():
    drawn, simulated = linear_model()
    found = ranks(drawn, simulated, RANGES, 0.15, range(200))
    narrow = 0.5 + 2.0 * (found - 0.5)  # as if the spread were half
    assert all(stats.kstest(narrow[name].clip(0.0, 1.0), "uniform").pvalue < 0.01 for name in RANGES)


def test_a_calibration_goes_on_where_it_stopped_and_is_read_again(tmp_path):
    arguments = {"simulations": 20, "n": 10, "priors": TWO, "accepted": 0.8, "out": tmp_path / "campaign"}
    first = tl.calibrate("uav", **arguments)
    kept = sorted((tmp_path / "campaign").rglob("*.parquet"))
    stamps = [file.stat().st_mtime_ns for file in kept]
    again = tl.calibrate("uav", **arguments)
    assert [file.stat().st_mtime_ns for file in kept] == stamps
    pd.testing.assert_frame_equal(first.posterior, again.posterior, check_exact=True)
    write_calibration(first, tmp_path / "data")
    read = read_calibration("uav", tmp_path / "data")
    pd.testing.assert_frame_equal(first.simulations, read.simulations, rtol=1e-12)
    pd.testing.assert_frame_equal(first.posterior, read.posterior, rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"priors": {"atention_cost": (0.0, 0.1)}}, "an assumption must be one of"),
        (
            {"priors": {"attention_cost": (0.1, 0.1)}},
            "the prior's low end of attention_cost must be below its high end",
        ),
        ({"priors": {"attention_cost": (0.0, 2.0)}}, r"attention_cost must lie in \[0, 0.5\], got 2.0"),
        ({"priors": {"attention_cost": 0.1}}, "must be two numbers, low and high"),
        ({"priors": {}}, "priors must map at least one assumption"),
        ({"simulations": 50}, "50 simulations are too few for accepted = 0.15.*35 simulations.*234 in all.*are kept"),
        ({"study": "teleop"}, "study must be one of"),
        ({"accepted": 1.5}, r"accepted must lie in \[0, 1\]"),
    ],
)
def test_bad_input(arguments, says):
    with pytest.raises(ValueError, match=says):
        tl.calibrate(**arguments)


def test_a_missing_calibration_is_said_to_be_missing(tmp_path):
    with pytest.raises(ValueError, match="holds no calibration of 'uav': `make calibration`"):
        read_calibration("uav", tmp_path)
