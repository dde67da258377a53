"""
What reports are made of: the finder, figures and tables in words, their origin; block diagrams in
which no text is cut or covered.
"""

import ast
import inspect
import re
import runpy
from functools import cache
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import matplotlib as mpl
import nbformat
import numpy as np
import pandas as pd
import pytest
from docutils import nodes
from docutils.utils import new_document
from IPython.core.interactiveshell import InteractiveShell
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.transforms import Bbox
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from scipy import optimize

import trustlab as tl
from notebooks import diagrams
from tests.cases import refused
from tests.publishing.world import ROOT, tagged
from trustlab.allocation.bounds import performance_as_printed, utilization_as_printed
from trustlab.publishing import figures, only_parameters, required_data
from trustlab.publishing.chapter import chapter, empty_chapter
from trustlab.publishing.tables import table_html
from trustlab.reproduction import published_table
from trustlab.reproduction.printed import half_unit
from trustlab.reproduction.published import VERDICTS

parametrize = pytest.mark.parametrize

# --- reports --------------------------------------------------------------------------------------


@cache
def extension():
    return runpy.run_path(str(ROOT / "docs" / "extension.py"))


NOTEBOOKS = ROOT / "notebooks"
REPORTS = {path.stem.partition("_")[2]: path for path in NOTEBOOKS.glob("*.ipynb")}
CHECK = "tl.publishing.only_parameters(globals())"
CLAIMS, STUDIES = tl.reproduction.verdicts(), tl.published_studies()


def says(claim, words):
    assert words in CLAIMS.loc[claim, "why"], claim


def test_every_claim_of_the_text_has_a_verdict():
    last = {"Fig. 1.": 2, "Fig. 2.": 18, "Fig. 3.": 22, "Fig. 4.": 5, "Table 2.": 6, "Table 3.": 1}
    last |= {"Theorem ": 6, "Lemma ": 8, "Proposition ": 3, "Algorithm ": 3, "Remark ": 13}
    last |= {"Assumption ": 4, "Definition ": 4}
    text = {f"{kind}{n + 1}" for kind, count in last.items() for n in range(count)}
    text |= {*STUDIES}
    assert text <= {*CLAIMS.index}
    others = ("Abstract", "Chapter 1", "Section", "(", "Appendix A")
    assert all(claim.startswith(others) for claim in {*CLAIMS.index} - text)


def test_verdicts_have_reasons_and_sections_of_reports_that_read_them():
    assert {*CLAIMS["verdict"]} <= {*VERDICTS}
    judged = CLAIMS[CLAIMS["verdict"] != "diagram"]
    assert judged["why"].all()
    for report, claims in CLAIMS[CLAIMS["report"] != ""].groupby("report"):
        text = REPORTS[report].read_text(encoding="utf-8")
        cells = nbformat.reads(text, 4).cells
        words = [cell.source for cell in cells if cell.cell_type == "markdown"]
        heads = {line.lstrip("# ") for source in words for line in source.splitlines()}
        assert {*claims["section"]} <= heads, report
        if report in {*judged["report"]}:
            assert f'verdicts(\\"{report}\\")' in text, report


def test_verdicts_are_those_of_the_audit_and_of_the_reconstructions():
    """
    Oracles: what of a table or study differs in the audit; which printed statistics no
    reconstructed data have.
    """
    audit = tl.audit()
    found = audit["verdict"].groupby(audit["id"].str.partition("/")[0]).agg(set)
    for claim, verdict in CLAIMS["verdict"].items():
        if claim.startswith("Table"):
            rows = found[claim.lower().replace(" ", "_")]
            held = "reproduced" if "reproduced" in rows else "not checkable"
            assert verdict == ("differs" if "differs" in rows else held), claim
        elif claim in STUDIES:
            assert verdict == ("differs" if "differs" in found[claim] else "reproduced"), claim
            if verdict == "reproduced":
                data = tl.reconstruct(STUDIES[claim], p_adjust="bonferroni")
                assert not data.attrs["left_out"]


def test_numbers_in_the_reasons_are_computed_again():
    """Oracles: exact cycles, closed forms and the printed tables."""
    models, table = tl.published_models(), published_table("2.2")
    pairs = {who: table.loc[["TSC_l", "TSC_u"], who].astype(float) for who in table}
    cycles = {who: tl.limit_cycle(models[who], *pair) for who, pair in pairs.items()}
    steps = published_table("2.1").loc["delta_TSC"].astype(float)
    bound = tl.steady_state_bounds(models["3"], *pairs["3"], steps["3"]).r_high
    r_low, r_high = cycles["3"].r_low, cycles["3"].r_high
    cycle = f"the limit cycle of r is {r_low:.3f} to {r_high:.3f}"
    says("Theorem 2", f"{cycle}, and (2.33) gives {bound:.3f}")
    by_hand, earned = [], []
    for who, cycle in cycles.items():
        robot, human = models[who].robot, models[who].human
        by_hand.append(100 * human.p_min / human.p_max)
        earned.append(100 * (cycle.mean_p_r - robot.p_min) / (robot.p_max - robot.p_min))
    says("Section 2.2.4", f"{min(by_hand):.0f} to {max(by_hand):.0f} % of the range")
    says("Section 2.2.4", f"the {min(earned):.0f} to {max(earned):.0f} % under the printed thr")
    fifth = published_table("2.1")["5"].astype(float)
    robot = tl.RobotModel(
        fifth["a_pr"], fifth["P_r_min"], fifth["P_r_max"], fifth["P_h_max"], b=fifth["b_pr"]
    )
    human = tl.HumanModel(0.999, 0.5, fifth["P_h_min"], fifth["P_h_max"])
    for model in (tl.TscModel(robot, human), models["5"]):
        upper = tl.threshold_limits(model, fifth["delta_P_h"]).upper
        says("Section 2.4.1.2", f"{upper:.3f}")
    performed = published_table("2.5").loc["C4"]
    people = [models[who].human for who in pairs]
    best = optimize.minimize(
        lambda r: -np.mean([who.performance(x) for who, x in zip(people, r, strict=True)]),
        [0.739] * 5,
        bounds=[(0.1, 0.99)] * 5,
        constraints={"type": "eq", "fun": lambda r: r.mean() - float(performed["r_mean"])},
    )
    says("Table 2.5", f"utilization, {performed['r_mean']}: {-best.fun:.4f} at most")
    says("Table 2.5", f"under C4, {performed['P_h_mean']},")
    heaviest = tl.HapticDevice(0.005, 0.55, 100.0, 60.0).largest_mass()
    says("(3.10)", f"{1000 * heaviest:.1f} g")


def test_theorem_2_fails_for_participant_3_with_the_printed_gain_too():
    """And for most models whose parameters round to the printed ones."""
    thresholds = 0.0, 0.27
    printed = published_table("2.1")["3"]
    names = ["a_pr", "P_r_min", "P_r_max", "P_h_max", "a_r", "beta", "P_h_min", "delta_TSC"]

    def steady(values, **gain):
        robot, human = tl.RobotModel(*values[:4], **gain), (*values[4:7], values[3])
        model = tl.TscModel(robot, tl.HumanModel(*human))
        # (2.20) with the same gain: how far performance rises under the operator's best.
        rise = model.robot.b * values[3] / (1.0 - values[0])
        p = performance_as_printed(model.constants(), *thresholds, values[7], rise)
        manual = p.dwell_manual_low, p.dwell_manual_high
        _, bound = utilization_as_printed(values[4], *manual, p.dwell_autonomous_high)
        return tl.limit_cycle(model, *thresholds).r_high, bound

    values = printed[names].astype(float).to_numpy()
    cycle, bound = steady(values, b=float(printed["b_pr"]))
    says("Theorem 2", f"the cycle ends at {cycle:.3f} and the bound is {bound:.3f}")
    half, rng = printed[names].map(half_unit).to_numpy(float), np.random.default_rng(0)
    sets = [steady(values + half * rng.uniform(-1.0, 1.0, 8)) for _ in range(150)]
    share = np.mean([cycle > bound for cycle, bound in sets])
    assert share == pytest.approx(0.85, abs=0.06)
    says("Theorem 2", "about 85 % of the sets")


def test_assumption_3_and_algorithm_2_fail_where_the_page_says():
    """At full load, or with it at rest, TSC_ub lies below TSC_lb; P_r stays below its maximum."""
    table, at_rest = published_table("2.2"), []
    for who in table:
        model = tl.published_models()[who]
        cycle = tl.limit_cycle(model, *table.loc[["TSC_l", "TSC_u"], who].astype(float))

        def room(low, high, model=model):
            change = tl.allocation.step_bounds(model, low, high).delta_p_h
            limits = tl.threshold_limits(model, change)
            return limits.upper - limits.lower

        assert room(cycle.r_low, cycle.r_high) > 0.0 > room(cycle.r_low, 1.0)
        at_rest += [who] * (room(0.0, cycle.r_high) < 0.0)
        manual = tl.simulate_allocation(model, 0.98, 0.99, steps=20_000, r0=model.human.beta)
        assert manual["p_r"].max() < 0.9986 * model.robot.p_max
    assert at_rest == ["4", "5"]
    says("Assumption 3", "for participants 4 and 5 from rest")
    says("Algorithm 2", "stays below its maximum")


@parametrize(
    ("answer", "said"),
    [
        ("Does it? **Yes: 3 of 4.** What to doubt: **all**.", "Yes: 3 of 4."),
        ("**Skipped: no data.** Put them there.", "Skipped: no data."),
        ("It was not run yet.", "It was not run yet."),
    ],
)
def test_first_page_quotes_what_a_report_says_in_bold(answer, said):
    path = REPORTS["audit"]
    page = empty_chapter(path, answer)
    title = "Audit: which printed numbers follow from which"
    assert extension()["headline"](nbformat.reads(page, 4)) == (title, said)
    assert "```" not in page
    assert "```text" in empty_chapter(path, answer, "NameError")


def test_a_reason_begins_with_a_capital_unless_with_a_symbol():
    said = map(extension()["sentence"], ["b ≤ a: otherwise", "the sum", "df1 = 2", "δ_TSC is"])
    assert [*said] == ["b ≤ a: otherwise.", "The sum.", "df1 = 2.", "δ_TSC is."]
    begun = CLAIMS.loc[CLAIMS["verdict"].isin({"fails", "holds with a condition"}), "why"]
    assert not begun.str.startswith("a ").any()


def test_search_lists_the_section_of_a_table_first():
    """Sphinx shows an entry of the index that is what was asked for before every other result."""
    row = CLAIMS.loc["Table 2.1"]
    document = new_document("page")
    document.settings.env = SimpleNamespace(docname=f"03_{row['report']}")
    for title in (row["section"], "Another section"):
        document += nodes.section("", nodes.title(text=title), ids=["a"])
    extension()["FinderEntries"](document).apply()
    ours, other = [section[1]["entries"] for section in document.children]
    assert ("single", "Table 2.1", "a", "main", None) in ours
    assert other == []


def test_captions_say_that_data_are_synthetic():
    figure = mpl.figure.Figure()
    for _ in range(2):
        figures.caption(figure.subplots(), "What it shows.", synthetic="pilot, seed 1")
    mark = "Synthetic data: pilot, seed 1"
    assert [text.get_text() for text in figure.texts] == [mark, f"{mark}. What it shows."]


def test_code_that_shows_nothing_is_folded_with_the_code_after_it():
    code = [new_code_cell(c, metadata={"tags": []}) for c in "abc"]
    code[1].outputs = [new_output("stream", text="1")]
    run = new_notebook(cells=[new_markdown_cell("# T"), *code, new_markdown_cell("words")])
    sources = [cell.source for cell in nbformat.reads(chapter(run, {}), 4).cells]
    assert sources[:-1] == ["# T", "a\n\nb", "c", "words"]


def test_minus_and_percent_signs_are_set_in_prose_alone():
    words = "From -0.2 to 82% (`-5%`, $-1$) in 1-5, 95\n% and -3 % (95% CI) of 2026-11-29"
    output = new_output("display_data", {"text/markdown": words})
    html = {"text/html": f"<table><caption>{words}</caption></table>"}
    answer, shown = tagged("-1", "answer"), tagged("-1")
    answer.outputs, shown.outputs = [output], [output, new_output("display_data", html)]
    cells = [new_markdown_cell("# T"), new_markdown_cell(words), shown, answer]
    laid_out = nbformat.reads(chapter(new_notebook(cells=cells), {}), 4).cells
    _, answer, prose, cell, table, *_ = laid_out
    said = "From −0.2 to 82_% (`-5%`, $-1$) in 1-5, 95_% and −3_% (95% CI) of 2026-11-29"
    said = said.replace("_", "\u00a0")
    caption = table.metadata["mystnb"]["figure"]["caption"]
    assert prose.source == cell.outputs[0].data["text/markdown"] == caption == said
    assert said in answer.source


@parametrize("book", [True, False])
def test_lab_gets_a_png_with_its_caption_and_the_book_an_svg_without(book, monkeypatch):
    if book:
        monkeypatch.setenv("TRUSTLAB_REPORT", "1")
    shell = InteractiveShell.instance()
    try:
        with mpl.rc_context():
            figures.use_house_style()
            figure = mpl.figure.Figure()
            figure.subplots().plot([1, 2, 3], [3, 4, 5], label="rise")
            words = figures.caption(figure, "What it means.")
            data, about = shell.display_formatter.format(figure)
        table, _ = shell.display_formatter.format(pd.DataFrame({"eta2_partial": [0.5]}, ["first"]))
    finally:
        InteractiveShell.clear_instance()
    kind = "image/svg+xml" if book else "image/png"
    assert set(data) == {kind, "text/plain"}
    assert words.get_visible() is not book
    assert about.get(kind, {}).get("caption") == ("What it means." if book else None)
    for head in ("partial η²", "first"):
        assert head in table["text/html"]


@parametrize(
    ("columns", "texts"),
    [
        (
            {"value": [0.995998, 0.31], "stderr": [4.2e-5, 0.012]},
            "0.995998 0.000042 0.310 0.012",
        ),
        ({"estimate": [1.2345], "ci_low": [1.2], "ci_high": [1.3]}, "1.23 1.20 1.30"),
        ({"x": [100.01, 100.02]}, "100.01 100.02"),
        ({"x": [9999.7, 0.1]}, "10000 0.1"),
    ],
    ids=["standard error", "half of an interval", "difference", "sizes"],
)
def test_a_number_has_the_decimals_that_its_error_or_a_difference_needs(columns, texts):
    table = table_html(pd.DataFrame(columns))
    assert re.findall("<data[^>]*>([^<]*)", table) == texts.split()


def test_required_data_are_a_folder(tmp_path, monkeypatch):
    """Where they are absent a report says so: `test_publish.py`."""
    monkeypatch.setenv("TRUSTLAB_DATA", str(tmp_path))
    (tmp_path / "mine").mkdir()
    assert required_data("mine") == tmp_path / "mine"


def stored(source):
    """The names that code sets."""
    names = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name))
    return {node.id for node in names if isinstance(node.ctx, ast.Store)}


NAMES = 'session_file = "run.csv"\nwindow = 0.0  # seconds'


def test_a_parameter_that_a_notebook_lacks_is_refused():
    only_parameters({"In": ["", NAMES, "# Parameters\nwindow = 100\n", "import os"]})
    only_parameters({"In": ["", "import os", "# Parameters\nrate = 3\n"]})  # a cell of its author
    only_parameters({})  # not a notebook
    with refused("got 'sesion_file'; did you mean 'session_file'"):
        only_parameters({"In": ["", NAMES, '# Parameters\nsesion_file = "mine.csv"\n']})


@parametrize("path", sorted(NOTEBOOKS.glob("[0-9]*.ipynb")), ids=lambda path: path.stem)
def test_every_notebook_refuses_parameters_it_lacks(path):
    code = [cell for cell in nbformat.read(path, 4).cells if cell.cell_type == "code"]
    assert code[0].metadata["tags"] == ["parameters"]
    source = "\n".join(re.sub("^%", "#", cell.source, flags=re.M) for cell in code[1:])
    before, found, _ = source.partition(f"\n{CHECK}\n")
    assert found
    # Nothing is computed before, and a parameter is what it was set to.
    assert {type(node) for node in ast.parse(before).body} <= {ast.Import, ast.ImportFrom}
    assert not stored(code[0].source) & stored(source)


def test_parameters_of_the_page_on_ones_own_log_win_or_are_refused(tmp_path):
    """A window was ignored where the log has one, minutes below 0; few draws blamed the log."""
    pilot = tl.sessions.example("pilot").with_metadata(performance_window=5.0)
    log = tl.write_session(pilot, tmp_path / "run.csv")
    page = nbformat.read(REPORTS["my_session"], 4).cells
    code = [cell.source for cell in page if cell.cell_type == "code"]

    def run(*cells, **parameters):
        unseen = dict.fromkeys(("caption", "display", "Markdown"), lambda *_, **__: None)
        names = {"tl": tl, "pd": pd, "Path": Path} | unseen
        exec(code[0], names)
        names |= {"session_file": log} | parameters
        for cell in cells:
            exec(code[cell], names)
        return names["log"]

    assert run(2) == tl.read_session(log)
    for window in (100, 0):
        assert run(2, window=window).metadata.more["performance_window"] == window
    assert run(2, minutes=2).duration == pytest.approx(120)
    with pytest.raises(tl.SessionError, match="start first"):
        run(2, minutes=-5)
    with refused("n must be a whole number, from 100"):
        run(2, 5, draws=50)


# --- diagrams -------------------------------------------------------------------------------------


PICTURES = [
    draw
    for _, draw in inspect.getmembers(diagrams, inspect.isfunction)
    if draw.__module__ == diagrams.__name__
]


def covered(diagram):
    """Texts that overlap each other, or that the edge of the page cuts."""
    page = FigureCanvasAgg(diagram.figure).get_renderer()
    texts = [text for text in diagram.axis.texts if text.get_text()]
    boxes = [(text.get_text(), text.get_window_extent(page)) for text in texts]
    pairs = combinations(boxes, 2)
    found = [(one, other) for (one, a), (other, b) in pairs if a.overlaps(b)]
    edge = diagram.figure.bbox
    cut = [one for one, a in boxes if Bbox.intersection(a, edge).bounds != a.bounds]
    return found + cut


@parametrize("draw", PICTURES, ids=lambda draw: draw.__name__)
def test_no_text_of_a_diagram_is_covered_or_cut(draw):
    diagram = draw()
    assert covered(diagram) == []
    assert diagram.figure.get_figwidth() <= 6.5
    # Negative control: a text over another one.
    first = next(text for text in diagram.axis.texts if text.get_text())
    diagram.text("across", *first.get_position())
    assert covered(diagram) != []
