"""
Every result of studies has .table() and is written to HTML and LaTeX; files are read again by
independent readers.
"""

import io

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.studies.scores import COLUMNS, drawn
from trustlab import studies

mpl.use("Agg")
RNG = np.random.default_rng(0)
LONG = drawn(mode="ABC", task="xy")
ONE = LONG[LONG["task"] == "x"]
TWO = {"dv": "score", "within": ["mode", "task"], "subject": "person"}
ANSWERS = pd.DataFrame(RNG.integers(1, 8, (12, 12)), columns=tl.TRUST_CHECKLIST.items).assign(
    who=range(12)
)
DESIGN = tl.latin_square_design(["A", "B", "C"], 12)
QUICK = studies.Simulation(replicates=100)
COVARIANCE = studies.graded_covariance(3)
ORDERED = DESIGN.orders().assign(error=RNG.standard_normal(36))

# Every class of trustlab.studies with a table, and every function that returns one.
RESULTS = {
    "RepeatedMeasures": lambda: tl.repeated_measures(ONE, **COLUMNS),
    "RepeatedMeasures of several factors": lambda: tl.repeated_measures(LONG, **TWO),
    "repeated_measures_batch": lambda: studies.repeated_measures_batch(
        RNG.standard_normal((4, 9, 3))
    ),
    "MixedModel": lambda: tl.mixed_model(ONE, **COLUMNS),
    "FormulaModel": lambda: tl.formula_model("score ~ mode", LONG, groups="person"),
    "OrdinalModel": lambda: tl.ordinal_model(
        ONE.assign(score=pd.qcut(ONE["score"], 4, labels=False)), **COLUMNS
    ),
    "PairedTTest": lambda: studies.paired_t_test(ONE[ONE["mode"] != "C"], **COLUMNS),
    "OrderEffects": lambda: tl.order_effects(
        ORDERED, "error", "condition", "position", subject="participant"
    ),
    "Winsorized": lambda: studies.winsorize(ONE, **COLUMNS, outside="extremes", k=1, to="next"),
    "StudyReport": lambda: tl.report(ONE, **COLUMNS),
    "DesignBalance": lambda: DESIGN.balance(),
    "LatinSquareDesign": lambda: DESIGN,
    "PowerAnalysis": lambda: tl.power_analysis(
        [0.0, 0.4, 0.8], COVARIANCE, n=[8, 10], simulation=QUICK
    ),
    "PowerAnalysis of several factors": lambda: tl.power_analysis(
        {("g", c): 0.0 for c in "abc"} | {("h", c): 1.0 for c in "abc"},
        COVARIANCE,
        columns=studies.StudyColumns(within="c", between="g"),
        n=6,
        simulation=QUICK,
    ),
    "SmallestN": lambda: studies.smallest_n(0.5, [0.0, 0.8, 1.2], COVARIANCE, simulation=QUICK),
    "VirtualStudy": lambda: tl.virtual_study(n=4, conditions=["C1", "C5"], laps=1),
    "Questionnaire": lambda: tl.TRUST_CHECKLIST,
    "ScaleScores": lambda: tl.score(ANSWERS, tl.TRUST_CHECKLIST, subject="who"),
    "Reliability": lambda: studies.cronbach_alpha(ANSWERS.drop(columns="who")),
    "equivalence": lambda: tl.equivalence(ONE, **COLUMNS, bound=0.5),
    "bayes_factor": lambda: tl.bayes_factor(ONE, **COLUMNS),
    "friedman": lambda: tl.repeated_measures(ONE, **COLUMNS).friedman(),
    "aligned_ranks": lambda: tl.repeated_measures(LONG, **TWO).aligned_ranks(),
}


def test_no_class_with_a_table_is_missing():
    exported = [name for name in dir(studies) if isinstance(getattr(studies, name), type)]
    assert {name for name in exported if hasattr(getattr(studies, name), "table")} <= set(RESULTS)


@pytest.mark.filterwarnings("ignore:nobody")
@pytest.mark.parametrize("name", RESULTS)
def test_it_is_written_and_read_again(name, tmp_path):
    result = RESULTS[name]()
    table = result if isinstance(result, pd.DataFrame) else result.table()
    assert isinstance(table, pd.DataFrame)
    assert len(table)
    written = tl.report(result)
    pd.testing.assert_frame_equal(written.table(), table)
    html = pd.read_html(io.StringIO(written.write(tmp_path / "r.html").read_text(encoding="utf-8")))
    latex = written.write(tmp_path / "r.tex").read_text(encoding="utf-8")
    assert len(html) == latex.count(r"\begin{tabular}") == len(written.tables) > 0
    for page, own in zip(html, written.tables.values(), strict=True):
        assert len(page) == len(own)
    if written.origin:
        assert written.origin.split(",")[0] in latex


def test_one_wide_row_is_printed_as_a_column(tmp_path):
    written = tl.report(RESULTS["PairedTTest"]())
    page = written.write(tmp_path / "r.html").read_text(encoding="utf-8")
    own = pd.read_html(io.StringIO(page))[0]
    assert own.columns.tolist() == ["statistic", "value"]
    assert len(own) == len(written.table().columns)
    assert {"a", "mean difference", "95% CI low", "p", "t"} <= set(own["statistic"])
