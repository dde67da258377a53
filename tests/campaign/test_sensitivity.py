"""Sobol' indices against the Ishigami function's closed form."""

import math

import numpy as np
import pytest
from scipy import stats

import trustlab as tl

PI = math.pi
BOX = {"x1": (-PI, PI), "x2": (-PI, PI), "x3": (-PI, PI)}


def ishigami(a=7.0, b=0.1):
    def task(x1, x2, x3, seed):
        y = math.sin(x1) + a * math.sin(x2) ** 2 + b * x3**4 * math.sin(x1)
        return {"y": y, "double": 2.0 * y + 5.0, "constant": 1.0, "word": "w"}

    return task


def closed_form(a=7.0, b=0.1):
    """First-order and total indices (Ishigami and Homma 1990)."""
    v1, v2 = 0.5 * (1.0 + b * PI**4 / 5.0) ** 2, a**2 / 8.0
    v13 = b**2 * PI**8 * (1.0 / 18.0 - 1.0 / 50.0)
    v = v1 + v2 + v13
    return np.array([v1, v2, 0.0]) / v, np.array([v1 + v13, v2, v13]) / v


def test_indices_of_the_ishigami_function(tmp_path):
    found = tl.sobol_indices(
        ishigami(),
        BOX,
        1024,
        results=["y", "double", "constant"],
        n_jobs=1,
        resamples=100,
        seed=2,
        out=tmp_path,
    )
    table = found.table().set_index("result")
    first, total = closed_form()
    for name in ("y", "double"):  # indices do not change with scale and origin
        rows = table.loc[name]
        np.testing.assert_allclose(rows["first_order"], first, atol=0.05)
        np.testing.assert_allclose(rows["total"], total, atol=0.05)
        assert (rows["first_low"] <= first + 0.02).all()
        assert (first - 0.02 <= rows["first_high"]).all()
        assert (rows["total_high"] - rows["total_low"] < 0.3).all()
    assert table.loc["constant"].drop(columns="parameter").isna().all(axis=None)
    assert len(tl.read_campaign(tmp_path)) == 1024 * 5  # one campaign holds all points
    again = tl.sobol_indices(
        ishigami(),
        BOX,
        1024,
        results=["y", "double", "constant"],
        n_jobs=1,
        resamples=100,
        seed=2,
        out=tmp_path,
    )
    assert again.table().equals(found.table())


def test_other_distributions():
    """y = a x1 + b x2 with normal x: shares a² σ1², b² σ2² in closed form."""

    def linear(x1, x2, seed):
        return {"y": 3.0 * x1 + 1.0 * x2}

    ranges = {"x1": stats.norm(5.0, 1.0), "x2": stats.norm(0.0, 2.0)}
    table = tl.sobol_indices(linear, ranges, 512, n_jobs=1, resamples=50).table()
    np.testing.assert_allclose(table["first_order"], [9 / 13, 4 / 13], atol=0.03)
    np.testing.assert_allclose(table["total"], [9 / 13, 4 / 13], atol=0.03)


def test_noise_is_independent_between_points():
    """
    y = x + ε with equal variances: S_x = 1/2, and ε is an interaction with nothing, so that S_Tx =
    1, S_Tz = 1/2.
    """

    def noisy(x, z, seed):
        return {"y": x + np.random.default_rng(seed).normal()}

    ranges = {"x": (0.0, math.sqrt(12.0)), "z": (0.0, 1.0)}
    table = tl.sobol_indices(noisy, ranges, 4096, n_jobs=1, resamples=20).table()
    np.testing.assert_allclose(table["first_order"], [0.5, 0.0], atol=0.06)
    np.testing.assert_allclose(table["total"], [1.0, 0.5], atol=0.06)


def test_estimates_are_those_of_scipy_with_its_own_sampling():
    def values(x):
        y = np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])
        return np.array([y, 2.0 * y + 5.0])

    points = np.random.SeedSequence(3, spawn_key=(2**31,)).spawn(2)[0]
    box = [stats.uniform(-PI, 2.0 * PI)] * 3
    want = stats.sobol_indices(func=values, n=256, dists=box, rng=np.random.default_rng(points))
    table = tl.sobol_indices(
        ishigami(), BOX, 256, results=["y", "double"], n_jobs=1, resamples=20, seed=3
    ).table()
    np.testing.assert_allclose(
        table["first_order"], want.first_order.ravel(), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(table["total"], want.total_order.ravel(), rtol=1e-9, atol=1e-12)


def test_the_plot_has_a_panel_per_result():
    import matplotlib.pyplot as plt

    axes = tl.sobol_indices(
        ishigami(), BOX, 16, results=["y", "double"], n_jobs=1, resamples=20
    ).plot()
    assert [panel.get_title() for panel in axes] == ["y", "double"]
    assert [t.get_text() for t in axes[0].get_yticklabels()] == ["x1", "x2", "x3"]
    plt.close("all")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"n": 100}, "power of 2, such as 128, got 100"),
        ({"n": 4}, "n must be a whole number, 8 or more"),
        ({"level": 1.0}, "level must lie strictly between"),
        ({"resamples": 3}, "resamples must be"),
        ({"seed": -1}, "seed must be"),
        ({"ranges": {}}, "ranges must be a dict"),
        ({"ranges": {"x1": (0, 1)}}, "give at least two, got x1 alone"),
        ({"ranges": BOX | {"x1": (1, 1)}}, "must be below"),
        (
            {"ranges": BOX | {"x1": 5}},
            r"ranges\['x1'\] must be \(low, high\) or a SciPy distribution, got int",
        ),
        ({"results": ["z"]}, "results names 'z', but the task returns y, double, constant, word"),
        ({"results": ["word"]}, "'word' is not a number"),
        (
            {"task": lambda x1, x2, x3, seed: {"y": math.nan if x1 > 0 else 1.0}},
            "result 'y' is nan at .* of 40 points",
        ),
        ({"task": lambda x1, x2, x3, seed: {"w": "a"}}, "none of the results w is a number"),
    ],
)
def test_bad_input_is_refused(change, said):
    arguments = {"task": ishigami(), "ranges": BOX, "n": 8, "n_jobs": 1} | change
    with pytest.raises(ValueError, match=said):
        tl.sobol_indices(**arguments)


@pytest.mark.filterwarnings("ignore::trustlab.campaign.CampaignWarning")
def test_a_failed_run_is_refused():
    def task(x, z, seed):
        if x > 0.5:
            raise ArithmeticError("too far")
        return {"y": x}

    with pytest.raises(
        ValueError,
        match=r"indices need every point, but 16 of 32 runs failed.*ArithmeticError: too far",
    ):
        tl.sobol_indices(task, {"x": (0, 1), "z": (0, 1)}, 8, n_jobs=1)
