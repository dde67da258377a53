"""
The paired t-test, equivalence and Bayes factors. Oracles: R (t.test, BayesFactor;
reference/paired_t_test.R, reference/evidence.R), pingouin, mpmath, brute force, closed forms,
simulation.
"""

import itertools
import json
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.studies.paired import log_jzs_bayes_factor, paired_t_test

mpl.use("Agg")
FOLDER = Path(__file__).parent / "reference"
REFERENCE = json.loads((FOLDER / "paired_t_test.json").read_text())["sets"]
SETS = json.loads((FOLDER / "evidence.json").read_text())["sets"]
COLUMNS = {"dv": "v", "within": "c", "subject": "s"}
SAME = [
    "mean_difference",
    "sd_difference",
    "ci_low",
    "ci_high",
    "t",
    "df",
    "p",
    "d_z",
    "d_av",
    "correlation",
    "wilcoxon_v",
    "wilcoxon_p",
    "shapiro_w",
    "shapiro_p",
]


def frame_of(a, b, names=("A", "B")):
    n = len(a)
    return pd.DataFrame(
        {"who": list(range(n)) * 2, "which": [names[0]] * n + [names[1]] * n, "score": [*a, *b]}
    )


def run(frame, **more):
    return paired_t_test(frame, dv="score", within="which", subject="who", **more)


@pytest.mark.parametrize("name", REFERENCE)
def test_agrees_with_r(name):
    wanted = REFERENCE[name]
    found = run(frame_of(wanted["a"], wanted["b"]))
    for key in SAME:
        loose = {"shapiro_p": 1e-6, "shapiro_w": 1e-7}.get(key, 1e-9)
        assert getattr(found, key) == pytest.approx(wanted[key], rel=loose, abs=1e-13), key
    assert ("exact" in found.wilcoxon_method) == ("exact" in wanted["wilcoxon_method"])
    narrow = run(frame_of(wanted["a"], wanted["b"]), confidence=0.9)
    assert narrow.ci_low == pytest.approx(wanted["ci90_low"], rel=1e-9, abs=1e-12)
    assert narrow.ci_high == pytest.approx(wanted["ci90_high"], rel=1e-9, abs=1e-12)


def test_wilcoxon_is_exact_by_brute_force():
    """Oracle: all 2^9 signs."""
    d = np.array([0.3, -1.1, 2.4, 3.1, -0.7, 4.9, 1.6, -2.0, 5.5])
    ranks = np.argsort(np.argsort(np.abs(d))) + 1
    v = ranks[d > 0].sum()
    every = [ranks[np.array(signs)].sum() for signs in itertools.product([False, True], repeat=9)]
    p = 2 * min(np.mean(np.array(every) >= v), np.mean(np.array(every) <= v))
    found = run(frame_of(d, np.zeros(9)))
    assert (found.wilcoxon_v, found.wilcoxon_p) == (v, pytest.approx(p, rel=1e-12))
    assert found.rank_biserial == pytest.approx((v - (45 - v)) / 45)
    assert np.isnan(found.correlation)


def test_tables_sentence_and_plot():
    import matplotlib.pyplot as plt

    x = REFERENCE["followed"]
    found = run(frame_of(x["a"], x["b"], ("C2", "C4")))
    assert found.table().shape[0] == 1
    rows = found.descriptives()
    assert rows["mean"].tolist() == pytest.approx([np.mean(x["a"]), np.mean(x["b"])])
    assert rows["sd"].tolist() == pytest.approx([np.std(x["a"], ddof=1), np.std(x["b"], ddof=1)])
    text = found.apa()
    assert f"t(35) = {found.t:.2f}" in text
    assert (
        f"C2 (M = {np.mean(x['a']):.1f}" in text
    )  # as many decimals as a standard deviation of some tens needs
    interval = f"[{found.d_z_low:.2f}, {found.d_z_high:.2f}]".replace("-", "−")
    assert text.endswith(f"d_z = {found.d_z:.2f}, 95% CI {interval}.")
    assert "t(35)" in found._repr_html_()
    axes = found.plot()
    assert axes.shape == (2,)
    assert len(axes[0].get_lines()) >= 36
    plt.close("all")
    made = frame_of(x["a"], x["b"])
    made.attrs["reconstructed"] = True
    found = run(made)
    assert "reconstructed data" in found.apa()
    assert found.plot()[0].get_title() == "reconstructed data"
    plt.close("all")


def test_missing_scores_only_when_asked_for():
    frame = frame_of([1.0, 2, 4, 9, 7], [2.0, 2, 3, 5, 1])
    frame.loc[6, "score"] = np.nan
    with pytest.raises(ValueError, match="subject 1 has no score in condition 'B'"):
        run(frame)
    found = run(frame, missing="listwise")
    assert found.excluded == (1,)
    assert found.n == 4
    assert found.t == pytest.approx(run(frame[frame["who"] != 1]).t)
    assert "1 participant with missing scores was left out (1)." in found.apa()


GOOD = frame_of([1.0, 2, 4, 9], [2.0, 2, 3, 5])


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (GOOD.assign(score=1.0), "error variance is zero"),
        (pd.concat([GOOD, GOOD.iloc[:1]]), "more than one row"),
        (GOOD.assign(score=GOOD["score"] * 1e300), "use another unit"),
        (None, "frame must be of class DataFrame, got NoneType"),
    ],
)
def test_bad_input_is_refused(frame, words):
    with pytest.raises(ValueError, match=words):
        run(frame)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_repeated_measures_of_two_conditions(seed):
    """Theorem: with two conditions F = t², and the only pair is the t-test."""
    frame = frame_of(*np.random.default_rng(seed).normal(size=(2, 11)))
    ours, anova = run(frame), tl.repeated_measures(frame, dv="score", within="which", subject="who")
    assert pytest.approx(ours.t**2, rel=1e-12) == anova.F
    assert anova.p == pytest.approx(ours.p, rel=1e-12)
    (pair,) = anova.pairs().to_dict("records")
    for name in ("a", "b", "mean_difference", "t", "df", "p", "d_z"):
        assert pair[name] == getattr(ours, name)
    assert pair["d_av"] == pytest.approx(ours.d_av, rel=1e-14)
    assert [pair["ci_low"], pair["ci_high"]] == pytest.approx(
        [ours.ci_low, ours.ci_high], rel=1e-14
    )
    pd.testing.assert_frame_equal(anova.descriptives(), ours.descriptives())


def test_ties_do_not_depend_on_the_unit():
    """
    0.3 − 0.2 and 0.2 − 0.1 differ in floating point, and are a tie; so are their tenfolds. Oracle:
    whole numbers.
    """
    a, b = np.array([3, 2, 4, 7, 9, 11, 20]), np.array([2, 1, 1, 3, 8, 7, 14])
    whole = run(frame_of(a, b))
    for unit in (0.1, 0.01, 1e-20, 0.7e5):
        found = run(frame_of(a * unit, b * unit))
        assert found.wilcoxon_p == pytest.approx(whole.wilcoxon_p, rel=1e-12)
        assert found.wilcoxon_v == whole.wilcoxon_v
    assert "twelve digits" in run(frame_of(a * 0.1, b * 0.1)).wilcoxon_method
    assert "twelve digits" not in whole.wilcoxon_method


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


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: tl.equivalence(f, **COLUMNS, bound=0.0), "bound must be positive"),
        (
            lambda f: tl.equivalence(
                f.assign(v=f["c"].map({"A": 0, "B": 1}) + f["s"]), **COLUMNS, bound=1.0
            ),
            "error variance",
        ),
        (lambda f: tl.bayes_factor(f.iloc[1:], **COLUMNS), "missing cells in 'v': subject 0"),
    ],
)
def test_bad_arguments(call, message):
    frame = long(np.random.default_rng(0).standard_normal((6, 2)))
    with pytest.raises(ValueError, match=message):
        call(frame)
