"""Sobol' indices. Oracles: the closed form of the Ishigami function, of sums, and SciPy's own."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from tests.cases import refused
from trustlab import read_campaign, sobol_indices

PI = math.pi
ORDERS, COLUMNS = ["first", "total"], ["first_order", "total"]
BOX = {"x1": (-PI, PI), "x2": (-PI, PI), "x3": (-PI, PI)}


def ishigami(x1, x2, x3, seed):
    y = np.sin(x1) + 7.0 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)
    return {"y": y, "double": 2.0 * y + 5.0, "constant": 1.0, "word": "w"}


def indices(task, ranges, n, resamples=20, **options):
    return sobol_indices(task, ranges, n, resamples=resamples, n_jobs=1, **options).table()


def closed_form():
    """First-order and total indices (Ishigami and Homma 1990)."""
    v1, v2 = 0.5 * (1.0 + 0.1 * PI**4 / 5.0) ** 2, 7.0**2 / 8.0
    v13 = 0.1**2 * PI**8 * (1.0 / 18.0 - 1.0 / 50.0)
    v = v1 + v2 + v13
    return np.array([v1, v2, 0.0]) / v, np.array([v1 + v13, v2, v13]) / v


def test_indices_of_the_ishigami_function(tmp_path):
    arguments = {"resamples": 100, "seed": 2, "out": tmp_path}
    table = indices(ishigami, BOX, 1024, **arguments)
    assert indices(ishigami, BOX, 1024, **arguments).equals(table)
    assert len(read_campaign(tmp_path)) == 1024 * 5  # one campaign holds all points
    table = table.set_index("result")
    assert list(table.index.unique()) == ["y", "double", "constant"]
    for name in ("y", "double"):  # scale and origin have no effect
        rows = table.loc[name]
        for order, column, exact in zip(ORDERS, COLUMNS, closed_form(), strict=True):
            estimate, low, high = (rows[each] for each in (column, f"{order}_low", f"{order}_high"))
            assert_allclose(estimate, exact, atol=0.05)
            assert ((low <= exact + 0.02) & (exact - 0.02 <= high)).all()
            assert ((low < estimate) & (high - low < 0.3)).all()
    assert table.loc["constant"].drop(columns="parameter").isna().all(axis=None)


def test_estimates_are_those_of_scipy_with_its_own_points():
    def values(x):
        return ishigami(*x, seed=None)["y"]

    points = np.random.SeedSequence(3, spawn_key=(2**31,)).spawn(2)[0]
    box = [stats.uniform(-PI, 2.0 * PI)] * 3
    exact = stats.sobol_indices(func=values, n=256, dists=box, rng=np.random.default_rng(points))
    estimates = indices(ishigami, BOX, 256, results=["y"], seed=3)
    expected = np.column_stack([exact.first_order, exact.total_order])
    assert_allclose(estimates[COLUMNS], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.filterwarnings("ignore::trustlab.campaign.CampaignWarning")
def test_narrower_ranges_are_advised_only_where_some_runs_went_well():
    for most, said in ((2.0, r"0\.\d+$"), (0.5, "narrow the ranges$")):

        def failing(x, y, seed, most=most):
            if x < most:
                raise ValueError(x)
            return {"z": x}

        with refused(said):
            indices(failing, {"x": (0, 1), "y": (0, 1)}, 8)


def test_noise_is_independent_between_points_and_distributions_may_differ():
    """
    y = 2 x + ε, x normal with σ = 1/2, ε normal with σ = 1: S_x = 1/2, and ε is in all total
    indices.
    """

    def noisy(x, z, seed):
        return {"y": 2.0 * x + np.random.default_rng(seed).normal()}

    table = indices(noisy, {"x": stats.norm(5.0, 0.5), "z": (0.0, 1.0)}, 4096)
    assert_allclose(table[COLUMNS], [[0.5, 1.0], [0.0, 0.5]], atol=0.06)


def test_intervals_have_their_level_on_both_sides():
    """Half of a nearly normal distribution lies within 0.674 sd, 95 % within 1.96 sd."""
    half, most = (
        indices(ishigami, BOX, 1024, resamples=1000, results=["y"], level=level).iloc[:2]
        for level in (0.5, 0.95)
    )
    for order, column in zip(ORDERS, COLUMNS, strict=True):
        for end in (f"{order}_low", f"{order}_high"):
            widths = (np.abs(table[end] - table[column]) for table in (half, most))
            assert_allclose(np.divide(*widths), 0.674 / 1.96, rtol=0.35)
