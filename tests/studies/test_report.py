"""
The Results section: oracle, the numbers of the analysis; files are read again by independent
readers.
"""

import dataclasses
import html
import io
import re

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import drawn
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


def two_way(frame=None):
    return tl.report(frame_of() if frame is None else frame, **BOTH)


@pytest.mark.parametrize("make", [one_way, two_way])
def test_text_and_tables_are_those_of_the_analysis(make, tmp_path):
    found = make()
    assert found.message.startswith(found.result.apa())
    pd.testing.assert_frame_equal(found.table(), found.result.table())
    assert html.escape(found.result.apa()) in found._repr_html_()
    assert "synthetic data" in found._repr_html_()
    for ending in ("html", "tex"):
        text = found.write(tmp_path / f"results.{ending}").read_text()
        drawn = ending == "html"
        assert text.count("[synthetic data]") == 1 + len(found.tables) + drawn
        # Heads have no internal names.
        words = re.findall(r"[a-z]\w*_\w+", text.replace(r"\_", "_").partition("<svg")[0])
        assert set(words) <= {"d_z", "hard_", "eta_p", "eta_G"}, set(words)
        assert "greenhouse" not in text
    for interval in (r"$\eta_p^2$, 90\% CI low", r"$d_z$, 95\% CI low"):
        assert interval in text
    assert "90% CI [" in found.message


def read_again(study, folder):
    page = study.write(folder / "results.html").read_text()
    return pd.read_html(io.StringIO(page)), page


def test_html_is_read_again(tmp_path):
    tables, page = read_again(two_way(), tmp_path)
    means = [f"{mean:.2f}".replace("-", "−") for mean in two_way().result.descriptives()["mean"]]
    assert tables[0]["M"].astype(str).tolist() == means
    assert tables[1]["effect"].tolist() == ["scheme", "task", "scheme × task"]
    assert "<svg" in page


def test_a_place_that_cannot_be_written_to_is_named(tmp_path):
    with refused(r"cannot write .*nowhere.*: No such file or directory"):
        one_way().write(tmp_path / "nowhere" / "results.html")


def test_levels_that_are_numbers_stay_as_they_are(tmp_path):
    frame = frame_of().replace({"M": 0.0, "TMIG": 0.125}).infer_objects()
    tables, _ = read_again(two_way(frame), tmp_path)
    assert tables[0]["scheme"].tolist() == [0.0, 0.0, 0.125, 0.125]


def test_the_comparison_of_two_groups_is_a_row(tmp_path):
    tables, _ = read_again(one_way(between="group"), tmp_path)
    assert tables[-1][["a", "b"]].to_numpy().tolist() == [["expert", "novice"]]
    assert "statistic" not in tables[-1]


NOISE = np.random.default_rng(0).normal(size=(4, 9, 1))
ANSWERS = pd.DataFrame(60, range(9), tl.NASA_TLX.items).assign(subject=range(9))
RESULTS = {
    "one wide row": lambda: tl.paired_t_test(ONE, **PART),
    "a table": lambda: tl.equivalence(ONE, **PART, bound=0.5),
    "a table with an index": lambda: tl.repeated_measures_batch(NOISE ** [1, 2, 3]),
    "a plan": lambda: tl.latin_square_design(["A", "B", "C"], 6),
    "counts under two heads": lambda: tl.design_balance(
        tl.latin_square_design(["A", "B", "C"], 6).orders()
    ),
    "a mixed model": lambda: tl.mixed_model(frame_of(), **BOTH),
    "scores": lambda: tl.score(ANSWERS, tl.NASA_TLX),
    "a printed study": lambda: tl.published_studies()["uav.tlx"],
}


@pytest.mark.parametrize("name", RESULTS)
def test_any_result_is_written_and_read_again(name, tmp_path):
    result = RESULTS[name]()
    table = result if isinstance(result, pd.DataFrame) else result.table()
    written = tl.report(result)
    pd.testing.assert_frame_equal(written.table(), table)
    (page,), _ = read_again(written, tmp_path)
    (own,) = written.tables.values()
    assert len(page) == len(own)
    if name == "one wide row":
        assert page.columns.tolist() == ["statistic", "value"]
        assert {"a", "mean difference", "95% CI low", "p", "t"} <= set(page["statistic"])
    latex = written.write(tmp_path / "r.tex").read_text(encoding="utf-8")
    assert latex.count(r"\begin{tabular}") == 1
    assert written.origin in latex


@pytest.fixture(scope="module")
def pilot():
    return tl.read_session("data/sessions/pilot.csv")


@pytest.fixture(scope="module")
def fit(pilot):
    return tl.fit_tsc(pilot)


def test_small_differences_are_not_rounded_away():
    frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    frame["value"] *= 1e-5
    small = tl.report(frame, dv="value", within="condition", subject="subject")
    for row in printed(small.tables["Pairwise comparisons"]).to_dict("records"):
        ends = [float(row[f"95% CI {end}"].replace("−", "-")) for end in ("low", "high")]
        assert ends[0] < ends[1]


def test_fits_by_participant_are_one_table(fit, pilot, tmp_path):
    failed = dataclasses.replace(fit, success=False, message="no optimum was found")
    study = tl.report({"P1": fit, "P2": failed})
    assert study.message == (
        "P2: The fit failed, and its estimates are not to be used: no optimum was found"
    )
    (table,) = study.tables.values()
    assert table["of"].tolist() == ["P1", "P2 (the fit failed)"]
    estimate, error = table.loc[0, "human β"].split(" ± ")
    row = fit.table().loc["human_beta"]
    assert float(estimate) == pytest.approx(row["value"], abs=float(error))
    assert float(error) == pytest.approx(row["stderr"], rel=0.05)
    assert list(table)[1:3] == ["human τ [s]", "human β"]
    assert not [head for head in table if "_b" in head and "beta" not in head]
    # Oracle: the posterior's time constants, which are drawn as such.
    seconds, error = map(float, table.loc[0, "robot τ [s]"].split(" ± "))
    drawn = tl.sample_posterior(pilot, n=500).table().loc["robot_time_constant"]
    assert seconds == pytest.approx(drawn["mean"], abs=3 * drawn["sd"])
    assert error == pytest.approx(drawn["sd"], rel=0.2)
    assert len(study.table()) == 2 * len(fit.table())
    text = study.write(tmp_path / "fits.tex").read_text()
    assert r"$\pm$" in text
    assert r"human $\tau$ [s] & human $\beta$ & human p min" in text
    page = tl.report(fit).write(tmp_path / "fit.html").read_text()
    assert page.count("synthetic data") == 1
    assert "human_" not in page


def test_results_of_one_kind_are_one_table():
    both = {name: tl.paired_t_test(frame_of().query("task == @name"), **PART) for name in TASKS}
    found = tl.report(both)
    assert found.table()["t"].tolist() == [both[name].t for name in TASKS]
    assert found.message.startswith(f"easy: {both['easy'].apa()}")


def test_every_head_names_the_level_of_its_intervals(fit, tmp_path):
    """They said 95 % whatever it was."""
    analysis = tl.repeated_measures(ONE, **PART)
    simulation = tl.studies.Simulation(replicates=100, level=0.8)
    population = [0.0, 1.0], np.eye(2)
    plan = tl.smallest_n(0.5, *population, simulation=simulation)
    power = tl.power_analysis(*population, simulation=simulation)
    tables = {
        80: [analysis.pairs(confidence=0.8), plan.table(), power.table(), fit.table(0.8)],
        90: [
            tl.equivalence(ONE, **PART, bound=1.0),
            tl.paired_t_test(ONE, **PART, confidence=0.9).table(),
        ],
        95: [analysis.pairs(), fit.table()],
    }
    for level, of_level in tables.items():
        for table in of_level:
            assert f"{level}% CI low" in printed(table), table
            assert f"{level} % CI, from" in table_html(table)
    assert r"at $\alpha$ = 0.05" in tl.report(plan).write(tmp_path / "n.tex").read_text()
    both = {name: tl.paired_t_test(ONE, **PART, confidence=name) for name in (0.8, 0.9)}
    (mixed,) = tl.report(both).tables.values()
    assert "CI low" in printed(mixed)


def test_several_analyses_have_the_columns_of_one():
    """Corrected and uncorrected df and p stood under the same heads."""
    frame = frame_of()
    both = {name: tl.repeated_measures(frame.query("task == @name"), **PART) for name in TASKS}
    found = tl.report(both)
    (table,) = found.tables.values()
    (_, single, _) = one_way().tables.values()
    assert [*printed(table)] == ["of", *printed(single)]
    assert found.table()["p_gg"].tolist() == [both[name].tests["p_gg"].item() for name in TASKS]
    (pair,) = tl.report({"x": tl.paired_t_test(ONE, **PART)}).tables.values()
    assert [*printed(pair)][:2] == ["of", "a"]


def test_no_two_columns_have_one_head():
    """The corrected p stood under "p", beside p."""
    heads = [*printed(one_way().table())]
    assert len({*heads}) == len(heads)
    assert {"p", "p corrected", "df1", "df1 corrected"} <= {*heads}


def test_who_was_left_out_is_named_beside_a_table():
    """Equivalence and Bayes factors did not say it."""
    frame = ONE.assign(score=ONE["score"].where(ONE["person"] != 3))
    for test, more in ((tl.equivalence, {"bound": 1.0}), (tl.bayes_factor, {})):
        found = tl.report(test(frame, **PART, missing="listwise", **more))
        assert found.message == "Left out for missing scores: 1 participant (3)."
        assert tl.report(test(ONE, **PART, **more)).message == ""


@pytest.mark.parametrize(
    ("frame", "more", "words"),
    [
        (lambda: one_way().result, {"alpha": 0.01, "within": "scheme"}, "within, alpha: a result"),
        (lambda: {"a": one_way().result}, {"dv": "score"}, "dv: a result is printed as it is"),
        (frame_of, {"subject": "person"}, "subject: a result"),
    ],
)
def test_what_has_no_effect_on_a_result_is_refused(frame, more, words):
    with refused(words):
        tl.report(frame(), **more)


def test_tables_stand_side_by_side_and_what_is_no_result_is_named():
    table = pd.DataFrame({"bf10": [2.0]})
    shown = tl.report({"P1": table, "P2": table}).table()
    assert shown["bf10"].tolist() == [2.0, 2.0]
    with pytest.raises(ValueError, match="or a result, got int"):
        tl.report({"P1": 3})
