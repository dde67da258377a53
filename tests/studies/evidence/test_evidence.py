"""
Equivalence, Bayes factors, simultaneous intervals, agreement. Oracles: R (BayesFactor, t.test;
reference/evidence.R), printed figures (Rouder and others 2009; Shrout and Fleiss 1979), closed
forms, simulation.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from trustlab.studies import intraclass_correlation, simultaneous_intervals
from trustlab.studies.evidence import log_jzs_bayes_factor

SETS = json.loads((Path(__file__).parents[1] / "reference" / "evidence.json").read_text())["sets"]
# Shrout and Fleiss (1979), Table 2: six targets, four judges.
RATINGS = np.array(
    [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]],
    dtype=float,
)
COLUMNS = {"dv": "v", "within": "c", "subject": "s"}


def long(values, labels="ABCDEFGH"):
    n, k = np.shape(values)
    frame = pd.DataFrame({"s": np.repeat(range(n), k), "c": list(labels[:k]) * n})
    return frame.assign(v=np.asarray(values, dtype=float).ravel())


def pair_of(name):
    return long(np.column_stack([SETS[name]["a"], SETS[name]["b"]]))


@pytest.mark.parametrize("name", SETS)
def test_equivalence_agrees_with_r(name):
    row = tl.equivalence(pair_of(name), **COLUMNS, bound=0.5).iloc[0]
    for number in ("t_low", "p_low", "t_high", "p_high", "ci_low", "ci_high"):
        assert row[number] == pytest.approx(SETS[name][number], rel=1e-9, abs=1e-14), number
    assert row["p"] == max(row["p_low"], row["p_high"])
    assert row["equivalent"] == (row["ci_low"] > -0.5 and row["ci_high"] < 0.5)


def test_bounds_in_standard_deviations_and_several_pairs():
    values = np.random.default_rng(0).standard_normal((30, 3))
    found = tl.equivalence(long(values), **COLUMNS, bound=0.6, units="d_z")
    assert found[["a", "b"]].to_numpy().tolist() == [["A", "B"], ["A", "C"], ["B", "C"]]
    d = values[:, 0] - values[:, 1]
    oracle = stats.ttest_1samp(d, -0.6 * d.std(ddof=1), alternative="greater")
    assert found.loc[0, ["t_low", "p_low"]].tolist() == pytest.approx(list(oracle))
    assert (found["p_holm"] >= found["p"]).all()


def test_equivalence_is_claimed_in_five_percent_at_the_bound():
    rng = np.random.default_rng(4)
    claims = [
        tl.equivalence(
            long(rng.standard_normal((20, 2)) + np.array([0.9, 0.0])), **COLUMNS, bound=0.9
        )["equivalent"].item()
        for _ in range(300)
    ]
    assert abs(np.mean(claims) - 0.05) < 4.0 * np.sqrt(0.05 * 0.95 / 300)


@pytest.mark.parametrize("name", SETS)
def test_bayes_factors_agree_with_r(name):
    found = tl.bayes_factor(pair_of(name), **COLUMNS).iloc[0]
    assert found["bf10"] == pytest.approx(SETS[name]["bf10"], rel=1e-6)
    assert found["bf01"] == pytest.approx(1.0 / found["bf10"])
    wide = tl.bayes_factor(pair_of(name), **COLUMNS, scale=1.0)["bf10"].item()
    assert wide == pytest.approx(SETS[name]["bf10_wide"], rel=1e-6)


@pytest.mark.parametrize(
    ("t", "n", "scale", "expected"),
    [
        (0.0, 10, 2**-0.5, -1.1750823266311887),
        (0.5, 3, 2**-0.5, -0.6576984390669531),
        (2.5, 20, 2**-0.5, 0.9940459629939761),
        (2.5, 20, 1.0, 0.8363147795400806),
        (-4.2, 36, 2**-0.5, 5.015231518611739),
        (30.0, 200, 2**-0.5, 166.06039418808658),
        (80.0, 1000, 2**-0.5, 995.2161017634046),
        (500.0, 10, 2**-0.5, 39.42762053607319),
        (1000.0, 36, 2**-0.5, 172.11641002455337),
        (1e6, 5, 0.2, 37.237967534704296),
        (3.0, 2, 5.0, -0.13969377894660898),
    ],
)
def test_bayes_factors_of_any_t(t, n, scale, expected):
    """Oracle: the integral with 40 digits, by adaptive quadrature (mpmath)."""
    assert log_jzs_bayes_factor(t, n, scale) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_a_bayes_factor_too_large_for_a_number_has_its_logarithm():
    values = np.random.default_rng(5).standard_normal((600, 2)) * 1e-3 + np.array([9.0, 0.0])
    factor = tl.bayes_factor(long(values), **COLUMNS).iloc[0]
    assert factor["log_bf10"] > 709.0
    assert factor["bf10"] == np.inf
    assert factor["bf01"] == 0.0


def test_bayes_factor_by_bic_is_the_closed_form():
    """
    Masson (2011): ΔBIC = N ln(SSE1/SSE0) + (k1 − k0) ln N with N = n (k − 1); sums of squares
    written out.
    """
    x = np.random.default_rng(1).standard_normal((15, 4)) + np.array([0.0, 0.2, 0.4, 0.9])
    rest = x - x.mean(0) - x.mean(1, keepdims=True) + x.mean()
    sse1, sse0 = (rest**2).sum(), ((x - x.mean(1, keepdims=True)) ** 2).sum()
    delta = 45 * np.log(sse1 / sse0) + 3 * np.log(45)
    found = tl.bayes_factor(long(x), **COLUMNS).iloc[0]
    assert found["method"] == "bic"
    assert found["bf10"] == pytest.approx(np.exp(-delta / 2))
    assert len(tl.bayes_factor(long(x), **COLUMNS, method="jzs")) == 6


def test_intraclass_correlations_as_printed():
    found = intraclass_correlation(long(RATINGS), dv="v", rater="c", subject="s")
    assert [f"{x:.2f}" for x in found["icc"]] == ["0.17", "0.29", "0.71", "0.44", "0.62", "0.91"]
    f = found["F"][2] / stats.f.ppf(0.975, 5, 15)  # Shrout and Fleiss, ICC(3,1)
    assert found["ci_low"][2] == pytest.approx((f - 1.0) / (f + 3.0), rel=1e-9)


def test_simultaneous_intervals():
    """
    Two conditions: the paired interval. With k, max-t lies between one pair's t and Bonferroni's;
    same seed, same table.
    """
    two = tl.repeated_measures(long(np.random.default_rng(2).standard_normal((12, 2))), **COLUMNS)
    found = simultaneous_intervals(two, draws=20_000)
    assert found["critical_t"].item() == pytest.approx(stats.t.ppf(0.975, 11), rel=0.03)
    exact = simultaneous_intervals(two, "bonferroni")
    assert exact[["ci_low", "ci_high"]].to_numpy() == pytest.approx(
        two.pairs()[["ci_low", "ci_high"]].to_numpy()
    )
    five = tl.repeated_measures(long(np.random.default_rng(3).standard_normal((12, 5))), **COLUMNS)
    greatest, bonferroni = simultaneous_intervals(five), simultaneous_intervals(five, "bonferroni")
    assert stats.t.ppf(0.975, 11) < greatest["critical_t"][0] < bonferroni["critical_t"][0]
    pd.testing.assert_frame_equal(greatest, simultaneous_intervals(five))
    inside = (greatest["ci_low"] <= 0) & (greatest["ci_high"] >= 0)
    assert (inside == (greatest["p_simultaneous"] > 0.05)).all()


def test_simultaneous_coverage():
    """All intervals together hold the true differences in 95 % of studies without sphericity."""
    rng, held = np.random.default_rng(5), 0
    for _ in range(150):
        x = rng.standard_normal((15, 4)) * [1.0, 1.0, 2.0, 4.0] + rng.standard_normal((15, 1))
        found = simultaneous_intervals(tl.repeated_measures(long(x), **COLUMNS), draws=1000)
        held += bool(((found["ci_low"] <= 0.0) & (found["ci_high"] >= 0.0)).all())
    assert abs(held / 150 - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / 150)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: tl.equivalence(f, **COLUMNS, bound=0.0), "bound must be positive"),
        (lambda f: tl.equivalence(f, **COLUMNS, bound=1.0, units="sd"), "units must be one of"),
        (lambda f: tl.equivalence(f, **COLUMNS, bound=1.0, alpha=0.6), "alpha must be below 0.5"),
        (
            lambda f: tl.equivalence(
                f.assign(v=f["c"].map({"A": 0, "B": 1}) + f["s"]), **COLUMNS, bound=1.0
            ),
            "error variance",
        ),
        (lambda f: tl.bayes_factor(f, **COLUMNS, scale=-1.0), "scale must be positive"),
        (lambda f: tl.bayes_factor(f, **COLUMNS, method="aic"), "method must be one of"),
        (lambda f: tl.bayes_factor(f.iloc[1:], **COLUMNS), "missing cells in 'v': subject 0"),
        (lambda f: intraclass_correlation(f.iloc[1:], "v", "c", "s"), "missing cells"),
        (
            lambda f: simultaneous_intervals(tl.repeated_measures(f, **COLUMNS), "tukey"),
            "method must be one of",
        ),
        (
            lambda f: simultaneous_intervals(tl.repeated_measures(f, **COLUMNS), draws=10),
            "draws must be a whole number",
        ),
    ],
)
def test_bad_arguments(call, message):
    frame = long(np.random.default_rng(0).standard_normal((6, 2)))
    with pytest.raises(ValueError, match=message):
        call(frame)


def test_synthetic_data_say_so():
    frame = long(np.random.default_rng(0).standard_normal((6, 2)))
    frame.attrs["synthetic"] = True
    result = tl.repeated_measures(frame, **COLUMNS)
    tables = (
        tl.equivalence(frame, **COLUMNS, bound=1.0),
        tl.bayes_factor(frame, **COLUMNS),
        simultaneous_intervals(result),
    )
    assert [table.attrs["origin"] for table in tables] == ["synthetic data"] * 3
