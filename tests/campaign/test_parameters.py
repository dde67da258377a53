"""Grids against itertools.product; draws against their distributions."""

import itertools

import numpy as np
import pytest
from scipy import stats

import trustlab as tl


def test_a_grid_is_the_product_of_its_axes():
    grid = tl.parameter_grid(a=[1, 2], b=np.array([0.1, 0.2, 0.3]), repeats=2)
    want = [
        {"a": a, "b": b} for a, b in itertools.product([1, 2], [0.1, 0.2, 0.3]) for _ in range(2)
    ]
    assert list(grid) == want
    assert len(grid) == 12
    assert grid[-1] == want[-1]
    assert grid[2:5] == want[2:5]
    assert type(grid[0]["b"]) is float
    with pytest.raises(IndexError):
        grid[12]


def test_a_large_grid_takes_no_memory():
    grid = tl.parameter_grid(a=range(1000), b=range(1000), c=range(1000))
    assert len(grid) == 10**9
    assert grid[123_456_789] == {"a": 123, "b": 456, "c": 789}


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ({}, "values by name"),
        ({"a": []}, "a has no values"),
        ({"a": 5}, r"write \[5\] for one"),
        ({"a": "xy"}, "write"),
        ({"a": {"b": 1}}, "must be a list"),
        ({"a": [1], "repeats": 0}, "repeats must be"),
    ],
)
def test_bad_grids_are_refused(axes, said):
    with pytest.raises(ValueError, match=said):
        tl.parameter_grid(**axes)


def test_draws_follow_their_distributions_and_their_names():
    draws = tl.parameter_draws(4000, seed=1, a=(2.0, 4.0), b=stats.norm(1.0, 0.5), c=["x", "y"])
    a, b = np.array([d["a"] for d in draws]), np.array([d["b"] for d in draws])
    assert stats.kstest(a, stats.uniform(2.0, 2.0).cdf).pvalue > 1e-3
    assert stats.kstest(b, stats.norm(1.0, 0.5).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.05
    assert abs(sum(d["c"] == "x" for d in draws) - 2000) < 200
    again = tl.parameter_draws(4000, seed=1, b=stats.norm(1.0, 0.5), z=(0, 1))
    assert [d["b"] for d in again] == b.tolist()  # neither order nor company matters
    assert tl.parameter_draws(3, seed=2, a=(2.0, 4.0)) != draws[:3]


def test_a_parameter_may_be_called_n():
    draws = tl.parameter_draws(50, seed=1, n=[5, 20], a=(0.0, 1.0))
    assert {d["n"] for d in draws} == {5, 20}
    assert [d["a"] for d in draws] == [
        d["a"] for d in tl.parameter_draws(n=50, seed=1, a=(0.0, 1.0))
    ]
    assert len(tl.parameter_draws(50, 1, n=stats.norm())) == 50
    with pytest.raises(ValueError, match="n must be a whole number"):
        tl.parameter_draws(n=[5, 20])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"n": 0, "a": (0, 1)}, "n must be"),
        ({"n": 3}, "at least one parameter"),
        ({"n": 3, "a": (1, 1)}, "must be below"),
        ({"n": 3, "a": (0, np.nan)}, "finite"),
        ({"n": 3, "a": 5}, "got int"),
        ({"n": 3, "a": []}, "got list"),
        ({"n": 3, "a": stats.norm(np.nan)}, "finite numbers"),
        ({"n": 3, "a": (0, 1), "seed": None}, "seed must be"),
    ],
)
def test_bad_draws_are_refused(arguments, said):
    with pytest.raises(ValueError, match=said):
        tl.parameter_draws(**arguments)
