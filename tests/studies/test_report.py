"""
The Results section: oracle, the numbers of the analysis; files are read again by independent
readers.
"""

import dataclasses
import html
import re
from functools import partial

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import approx, drawn, parametrize
from trustlab.publishing.tables import table_html
from trustlab.studies.words import printed

TASKS = ["easy", "hard_#1"]


def frame_of():
    frame = drawn(10, scheme=["M", "TMIG"], task=TASKS)
    frame["score"] += frame["scheme"] == "M"
    frame.attrs["synthetic"] = True
    return frame


ONE = frame_of()[lambda f: f["task"] == "easy"]
PART = {"dv": "score", "within": "scheme", "subject": "person"}
BOTH = PART | {"within": ["scheme", "task"]}


def one_way(**more):
    return tl.report(ONE, **PART, **more)


def two_way(**levels):
    return tl.report(frame_of().replace(levels).infer_objects(), **BOTH)


@parametrize("make", [one_way, two_way])
def test_text_and_tables_are_those_of_the_analysis(make, tmp_path):
    found = make()
    assert found.message == found.result.apa()
    assert_frame_equal(found.table(), found.result.table())
    assert html.escape(found.message) in found._repr_html_()
    for ending in ("html", "tex"):
        text = found.write(tmp_path / f"results.{ending}").read_text()
        drawn = ending == "html"
        assert text.count("[synthetic data]") == 1 + len(found.tables) + drawn
        # Heads have no internal names.
        words = re.findall(r"[a-z]\w*_\w+", text.replace(r"\_", "_").partition("<svg")[0])
        assert set(words) <= {"d_z", "hard_", "eta_p", "eta_G"}
        assert "greenhouse" not in text
    for interval in (r"$\eta_p^2$, 90\% CI low", r"$d_z$, 95\% CI low"):
        assert interval in text


def read_again(study, folder):
    return pd.read_html(study.write(folder / "results.html"))


def test_a_place_that_cannot_be_written_to_is_named(tmp_path):
    with refused(r"cannot write .*nowhere.*: No such file or directory"):
        one_way().write(tmp_path / "nowhere" / "results.html")


def test_html_is_read_again_and_levels_that_are_numbers_stay_as_they_are(tmp_path):
    study = two_way(M=0.0, TMIG=0.125)
    tables = read_again(study, tmp_path)
    means = [f"{mean:.2f}".replace("-", "−") for mean in study.result.descriptives()["mean"]]
    assert tables[0]["M"].astype(str).tolist() == means
    assert tables[0]["scheme"].tolist() == [0.0, 0.0, 0.125, 0.125]
    assert tables[1]["effect"].tolist() == ["scheme", "task", "scheme × task"]


def test_the_comparison_of_two_groups_is_a_row(tmp_path):
    table = read_again(one_way(between="group"), tmp_path)[-1]
    assert table[["a", "b"]].to_numpy().tolist() == [["expert", "novice"]]


ESTIMATES = pd.DataFrame({"value": [1.0], "stderr": [0.1]}, ["a"])
PILOT = tl.read_session("data/sessions/pilot.csv")
PLAN = tl.latin_square_design([*"ABC"], 6)
RESULTS = {
    "one wide row": lambda: tl.paired_t_test(ONE, **PART),
    "a table": lambda: tl.equivalence(ONE, **PART, bound=0.5),
    "a table with an index": lambda: tl.mixed_model(frame_of(), **BOTH).means,
    "a plan": lambda: tl.design_balance(PLAN.orders()),
    "a mixed model": lambda: tl.mixed_model(frame_of(), **BOTH),
    "a printed study": lambda: tl.published_studies()["uav.tlx"],
}


@parametrize("name", RESULTS)
def test_any_result_is_written_and_read_again(name, tmp_path):
    result = RESULTS[name]()
    table = result if isinstance(result, pd.DataFrame) else result.table()
    written = tl.report(result)
    assert_frame_equal(written.table(), table)
    (page,), (own,) = read_again(written, tmp_path), written.tables.values()
    assert len(page) == len(own)
    if name == "one wide row":
        assert page.columns.tolist() == ["statistic", "value"]
        assert {"a", "mean difference", "95% CI low", "p", "t"} <= set(page["statistic"])
    latex = written.write(tmp_path / "r.tex").read_text(encoding="utf-8")
    assert latex.count(r"\begin{tabular}") == 1
    assert ("[synthetic data]" in latex) == (name not in {"a plan", "a printed study"})


@pytest.fixture(scope="module")
def fit():
    return tl.fit_tsc(PILOT)


def test_small_differences_are_not_rounded_away():
    small = tl.report(ONE.assign(score=1e-5 * ONE["score"]), **PART)
    (row,) = printed(small.tables["Pairwise comparisons"]).to_dict("records")
    low, high = (float(row[f"95% CI {end}"].replace("−", "-")) for end in ("low", "high"))
    assert low < high


def test_fits_by_participant_are_one_table(fit, tmp_path):
    failed = dataclasses.replace(fit, success=False, message="no optimum was found")
    study = tl.report({"P1": fit, "P2": failed})
    assert study.message == (
        "P2: The fit failed, and its estimates are not to be used: no optimum was found"
    )
    (table,) = study.tables.values()
    assert table["of"].tolist() == ["P1", "P2 (the fit failed)"]
    # Oracle: the posterior, which is drawn in these coordinates.
    drawn = tl.sample_posterior(PILOT, n=500).table()
    for name, head in (("human_beta", "human β"), ("robot_time_constant", "robot τ [s]")):
        estimate, error = map(float, table.loc[0, head].split(" ± "))
        assert estimate == approx(drawn.loc[name, "mean"], abs=3 * error)
        assert error == approx(drawn.loc[name, "sd"], rel=0.2)
    assert len(study.table()) == 2 * len(fit.table())
    text = study.write(tmp_path / "fits.tex").read_text()
    assert r"$\pm$" in text
    assert r"human $\tau$ [s] & human $\beta$ & human p min" in text
    page = tl.report(fit).write(tmp_path / "fit.html").read_text()
    assert page.count("synthetic data") == 1
    assert "human_" not in page


def test_every_head_names_the_level_of_its_intervals(fit):
    """They said 95 % whatever it was."""
    analysis = tl.repeated_measures(ONE, **PART)
    given = {"mean": [0.0, 1.0], "covariance": np.eye(2)}
    given["simulation"] = tl.studies.Simulation(replicates=100, level=0.8)
    plan, power = tl.smallest_n(0.5, **given), tl.power_analysis(**given)
    two = {level: tl.paired_t_test(ONE, **PART, confidence=level) for level in (0.8, 0.9)}
    tables = {
        80: [analysis.pairs(confidence=0.8), plan.table(), power.table(), fit.table(0.8)],
        90: [tl.equivalence(ONE, **PART, bound=1.0), two[0.9].table()],
        95: [analysis.pairs(), fit.table()],
    }
    for level, of_level in tables.items():
        for table in of_level:
            assert f"{level}% CI low" in printed(table)
            assert f"{level} % CI, from" in table_html(table)
    found = tl.report(two)
    (mixed,) = found.tables.values()
    assert {"of", "a", "CI low"} <= {*printed(mixed)}
    assert found.message.startswith(f"0.8: {two[0.8].apa()}")


def test_several_analyses_have_the_columns_of_one():
    """Corrected and uncorrected df and p stood under the same heads."""
    frame = frame_of()
    both = {name: tl.repeated_measures(frame.query("task == @name"), **PART) for name in TASKS}
    found = tl.report(both)
    (table,) = found.tables.values()
    (_, single, _) = one_way().tables.values()
    assert [*printed(table)] == ["of", *printed(single)]
    assert found.table()["p_gg"].tolist() == [both[name].p_gg for name in TASKS]


def test_no_two_columns_have_one_head():
    """The corrected p stood under "p", beside p."""
    heads = printed(one_way().table()).columns
    assert heads.is_unique
    assert {"p", "p corrected", "df1", "df1 corrected"} <= {*heads}


def test_who_was_left_out_is_named_beside_a_table():
    """Equivalence and Bayes factors did not say it."""
    frame = ONE.assign(score=ONE["score"].where(ONE["person"] != 3))
    for test in (partial(tl.equivalence, bound=1.0), tl.bayes_factor):
        found = tl.report(test(frame, **PART, missing="listwise"))
        assert found.message == "Left out for missing scores: 1 participant (3)."
        assert tl.report(test(ONE, **PART)).message == ""


@parametrize(
    ("frame", "more", "words"),
    [
        (ONE, {"alpha": 0.01, "within": "scheme"}, "within, alpha: a result is printed as it is"),
        ({"a": ONE}, {"dv": "score"}, "dv: a result is printed as it is"),
        ({"P1": 3}, {}, "or a result, got int"),
        # They were left out without a word.
        ({"a": tl.repeated_measures(ONE, **PART)}, {"thresholds": {"a": 3}}, "beside fits; frame"),
        ({"a": ESTIMATES}, {"thresholds": {"a": 3}}, "thresholds must be of class ThresholdChoice"),
    ],
)
def test_what_is_no_result_or_has_no_effect_on_one_is_refused(frame, more, words):
    with refused(words):
        tl.report(frame, **more)
