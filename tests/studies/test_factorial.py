"""
Several factors. Oracles: R (afex, car, emmeans) on published data sets, values in
reference/factorial.json made by factorial.R; figures printed in books and manuals; sums of squares
by cell means written out, to 1e-9; simulation.
"""

import json
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from trustlab.studies import repeated_measures_batch

mpl.use("Agg")
SETS = json.loads((Path(__file__).parent / "reference" / "factorial.json").read_text())["sets"]
SAME = [
    "F",
    "df1",
    "df2",
    "p",
    "eta2_generalized",
    "eta2_partial",
    "ss_effect",
    "ss_error",
    "mauchly_w",
    "mauchly_p",
]
SAME += ["epsilon_gg", "p_gg", "epsilon_hf_untruncated", "p_hf"]


def analysed(name, **more):
    given = SETS[name]
    frame = pd.DataFrame(given["columns"])
    columns = {"dv": given["dv"], "within": given["within"], "subject": given["id"]}
    columns |= {"between": given["between"] or None}
    return tl.repeated_measures(frame.sample(frac=1.0, random_state=0), **columns, **more)


def label(text):
    """A level before R made a name of it: "X0.2" was 0.2, "Golden.Rain" had a blank."""
    return re.sub(r"^X(?=\d)", "", text).replace("Golden.Rain", "Golden Rain")


def key(effect, mark):
    return frozenset(effect.split(mark))


@pytest.mark.parametrize("name", SETS)
def test_every_effect_agrees_with_r(name):
    if len(SETS[name]["within"]) + len(SETS[name]["between"]) < 2:
        pytest.skip("one factor: test_against_r.py")
    rows = {key(row["effect"], " × "): row for row in analysed(name).table().to_dict("records")}
    assert len(rows) == len(SETS[name]["effects"])
    for theirs in SETS[name]["effects"]:
        ours = rows[key(theirs["effect"], ":")]
        for number in SAME:
            if number in ("p_gg", "p_hf") and not theirs["epsilon_gg"]:
                continue  # one degree of freedom: car has no row, or zeros
            if theirs[number] is not None and not (
                number == "p_hf" and theirs["epsilon_hf_untruncated"] > 1.0
            ):
                assert ours[number] == pytest.approx(theirs[number], rel=1e-8, abs=1e-11), (
                    theirs["effect"],
                    number,
                )


@pytest.mark.parametrize("name", [name for name in SETS if SETS[name]["pairs"]])
def test_pairs_agree_with_emmeans(name):
    result = analysed(name)
    for theirs in SETS[name]["pairs"]:
        ours = result.pairs(theirs["factor"], theirs["at"])
        levels = (
            theirs["level"] if isinstance(theirs["level"], list) else [theirs["level"]] * len(ours)
        )
        for i, contrast in enumerate(np.atleast_1d(theirs["contrast"])):
            a, b = (label(x.removeprefix(theirs["factor"])) for x in contrast.split(" - "))
            here = (ours["a"].astype(str) == a) & (ours["b"].astype(str) == b)
            if theirs["at"] is not None:
                here &= ours["level"].astype(str) == label(levels[i])
            row = ours[here].iloc[0]
            for number in ("mean_difference", "ci_low", "ci_high", "t", "df", "p", "p_holm"):
                wanted = np.atleast_1d(theirs[number])[i]
                assert row[number] == pytest.approx(wanted, rel=1e-8, abs=1e-10), (
                    theirs["factor"],
                    contrast,
                    number,
                )


@pytest.mark.parametrize(
    ("name", "effect", "printed"),
    [
        # Maxwell and Delaney (2004), Chapter 12: angle, noise and their interaction.
        ("Maxwell", "angle", {"F": "40.72", "df1": "2", "df2": "18"}),
        ("Maxwell", "noise", {"F": "33.77", "df1": "1", "df2": "9"}),
        ("Maxwell", "angle × noise", {"F": "45.31", "df1": "2", "df2": "18"}),
        # afex, manual page of aov_car: treatment * gender between, phase and hour within
        # (Greenhouse–Geisser).
        (
            "O'Brien and Kaiser (1985), two",
            "treatment",
            {"F": "3.94", "ss_effect": "179.73", "ss_error": "228.06"},
        ),
        (
            "O'Brien and Kaiser (1985), two",
            "phase",
            {"F": "16.13", "df1_corrected": "1.60", "df2_corrected": "15.99"},
        ),
        (
            "O'Brien and Kaiser (1985), two",
            "hour",
            {"F": "16.69", "df1_corrected": "1.84", "df2_corrected": "18.41"},
        ),
    ],
)
def test_figures_printed_in_books_and_manuals(name, effect, printed):
    table = analysed(next(x for x in SETS if x.startswith(name))).table().set_index("effect")
    for number, text in printed.items():
        digits = len(text.partition(".")[2])
        assert f"{table.loc[effect, number]:.{digits}f}" == text, number


def two_way(n=10, a=2, b=3, seed=0):
    cells = pd.MultiIndex.from_product(
        [range(n), [f"a{i}" for i in range(a)], [f"b{i}" for i in range(b)]]
    )
    frame = cells.to_frame(index=False, name=["who", "A", "B"])
    return frame.assign(
        v=np.random.default_rng(seed).standard_normal(len(frame)),
        side=np.where(frame["who"] < 5, "l", "r"),
    )


def run(frame, **more):
    return tl.repeated_measures(
        frame, **({"dv": "v", "within": ["A", "B"], "subject": "who"} | more)
    )


def by_cell_means(x):
    """
    Sums of squares of a two-way study, shape (n, a, b), as textbooks write them: sums over means of
    cells and margins.
    """
    n, a, b = x.shape
    m = x.mean()
    ma = x.mean((0, 2))
    mb = x.mean((0, 1))
    ms = x.mean((1, 2))
    mab = x.mean(0)
    msa = x.mean(2)
    msb = x.mean(1)
    effect = {
        "A": n * b * ((ma - m) ** 2).sum(),
        "B": n * a * ((mb - m) ** 2).sum(),
        "A × B": n * ((mab - ma[:, None] - mb + m) ** 2).sum(),
    }
    rest = x - mab - msa[:, :, None] - msb[:, None, :] + ma[:, None] + mb + ms[:, None, None] - m
    error = {
        "A": b * ((msa - ma - ms[:, None] + m) ** 2).sum(),
        "B": a * ((msb - mb - ms[:, None] + m) ** 2).sum(),
        "A × B": (rest**2).sum(),
    }
    return effect, error, a * b * ((ms - m) ** 2).sum()


@pytest.mark.parametrize("seed", range(5))
def test_sums_of_squares_written_out(seed):
    x = np.random.default_rng(seed).standard_normal((9, 3, 4)) * 10.0 ** (seed - 2) + 5.0
    effect, error, subjects = by_cell_means(x)
    found = repeated_measures_batch(np.stack([x, x + 1.0])).loc[1]
    for name, ss in effect.items():
        row = found.loc[name]
        np.testing.assert_allclose(
            [row["ss_effect"], row["ss_error"]], [ss, error[name]], rtol=1e-9
        )
        np.testing.assert_allclose(
            row["eta2_generalized"], ss / (ss + sum(error.values()) + subjects), rtol=1e-9
        )


def test_batch_and_table_agree_and_pieces_do_not_matter(monkeypatch):
    frames = [two_way(seed=seed) for seed in range(5)]
    array = np.stack([frame["v"].to_numpy().reshape(10, 2, 3) for frame in frames])
    groups = (np.arange(10) >= 5).astype(int)
    batch = repeated_measures_batch(array, groups=groups)
    monkeypatch.setattr("trustlab.studies.anova._CHUNK", 120)
    pd.testing.assert_frame_equal(repeated_measures_batch(array, groups=groups), batch)
    for s, frame in enumerate(frames):
        own = run(frame, between="side").table()
        theirs = batch.loc[s].rename(index=lambda x: x.replace("group", "side")).loc[own["effect"]]
        for number in ("F", "p", "p_gg", "p_hf", "eta2_generalized"):
            np.testing.assert_allclose(own[number], theirs[number], rtol=1e-10)


def test_simple_effects_are_analyses_of_one_level():
    """Oracle: one-way analyses of the rows of a level, and SciPy's F between groups."""
    frame = two_way()
    found = run(frame).simple_effects("B", at="A").set_index("level")
    for level, own in frame.groupby("A"):
        alone = tl.repeated_measures(own, dv="v", within="B", subject="who")
        row = found.loc[level]
        np.testing.assert_allclose(
            row[["F", "p", "p_gg"]].astype(float), [alone.F, alone.p, alone.p_gg], rtol=1e-9
        )
    found = run(frame, between="side").simple_effects("side", at="A").set_index("level")
    for level, own in frame.groupby("A"):
        means = own.groupby(["side", "who"])["v"].mean()
        oracle = stats.f_oneway(means["l"], means["r"])
        np.testing.assert_allclose(found.loc[level, ["F", "p"]].astype(float), oracle, rtol=1e-9)
    assert run(frame, between="side").simple_effects("B", at="side")["df2"].tolist() == [16, 16]


def test_what_a_reader_sees():
    frame = two_way()
    frame.attrs["synthetic"] = True
    result = run(frame, between="side")
    assert (
        "2 × 2 × 3 mixed ANOVA of v (N = 10, degrees of freedom Greenhouse–Geisser corrected)"
        in result.apa()
    )
    assert result.apa().startswith("[synthetic data]")
    for view in (
        result.table(),
        result.pairs("A"),
        result.descriptives(),
        result.simple_effects("A", "B"),
    ):
        assert view.attrs["origin"] == "synthetic data"
    assert "synthetic data" in result._repr_html_()
    axes = result.plot()
    assert "synthetic data" in axes.get_title()
    assert len(axes.get_legend().get_texts()) == 6
    assert result.descriptives()["n"].tolist() == [5] * 12
    levels = run(frame, order={"B": ["b2", "b0", "b1"]}).descriptives()["B"].tolist()
    assert levels[:3] == ["b2", "b0", "b1"]


def put(frame, row, column, value):
    frame = frame.astype({column: object})
    frame.loc[row, column] = value
    return frame


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (
            lambda f: f.drop(index=7),
            {},
            r"missing cells in 'v': subject 1 has no score in condition \('a0', 'b1'\)",
        ),
        (lambda f: f.assign(A="a0"), {}, "within: column 'A' has one condition only, 'a0'"),
        (lambda f: f, {"order": {"C": ["a0"]}}, "order: 'C' is not a factor"),
        (lambda f: f, {"within": ["A", "A"]}, "'A' is named twice"),
        (lambda f: put(f, 7, "v", "x"), {}, "dv: column 'v' holds 'x' for subject 1"),
        (
            lambda f: f,
            {"order": {"side": ["l", "q"]}, "between": "side"},
            "order must list every condition in column 'side'",
        ),
        (
            lambda f: f.assign(
                one=np.where(f["who"] < 5, "a", "b"), two=np.where(f["who"] < 5, "c", "d")
            ),
            {"between": ["one", "two"]},
            r"some combination of \['one', 'two'\] has no participant",
        ),
    ],
)
def test_bad_tables_are_refused(change, arguments, message):
    with pytest.raises(ValueError, match=message):
        run(change(two_way()), **arguments)


def test_every_design_gives_one_class_with_the_same_columns():
    frame = two_way()
    designs = [{"within": "B"}, {"within": ["B"], "between": "side"}, {}, {"between": "side"}]
    results = [
        run(frame if "within" not in more else frame[frame["A"] == "a0"], **more)
        for more in designs
    ]
    assert {type(result) for result in results} == {tl.studies.RepeatedMeasures}
    assert len({tuple(result.table().columns) for result in results}) == 1
    assert [list(result.within) for result in results] == [["B"], ["B"], ["A", "B"], ["A", "B"]]


def test_groups_are_compared_within_groups():
    """Oracle: the unweighted means of the cells of two factors between subjects."""
    frame = two_way(n=12).assign(sex=lambda f: np.where(f["who"] % 2, "f", "m"))
    pairs = run(frame, between=["side", "sex"]).pairs("side", at="sex")
    means = frame.groupby(["side", "sex"])["v"].mean().unstack("side")  # noqa: PD010
    expected = (means["l"] - means["r"]).loc[pairs["level"]]
    np.testing.assert_allclose(pairs["mean_difference"], expected, rtol=1e-9)
