"""
What reports are made of: the finder, figures and tables in words, their origin; block diagrams in
which no text is cut or covered.
"""

import ast
import inspect
import re
import runpy
import subprocess
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
from nbformat import from_dict
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from scipy import optimize

import trustlab as tl
from notebooks import diagrams
from tests.publishing.world import ROOT, make
from trustlab import published_studies
from trustlab.allocation.bounds import performance_as_printed, utilization_as_printed
from trustlab.publishing import figures, only_parameters
from trustlab.publishing.chapter import chapter, empty_chapter
from trustlab.publishing.run import anonymous, commit, provenance
from trustlab.publishing.tables import table_html
from trustlab.reproduction import published_table
from trustlab.reproduction.printed import half_unit
from trustlab.reproduction.published import VERDICTS

parametrize = pytest.mark.parametrize
approx = pytest.approx

# --- reports --------------------------------------------------------------------------------------


NOTEBOOKS = ROOT / "notebooks"
REPORTS = {path.stem.partition("_")[2]: path for path in NOTEBOOKS.glob("*.ipynb")}
CHECK = "tl.publishing.only_parameters(globals())"
CLAIMS = tl.reproduction.verdicts()


def heads_of(report):
    cells = nbformat.read(REPORTS[report], 4).cells
    texts = [cell.source for cell in cells if cell.cell_type == "markdown"]
    return [line.lstrip("# ") for text in texts for line in text.splitlines()]


def test_every_claim_of_the_text_has_a_verdict():
    last = {"Fig. 1.": 2, "Fig. 2.": 18, "Fig. 3.": 22, "Fig. 4.": 5, "Table 2.": 6, "Table 3.": 1}
    last |= {"Theorem ": 6, "Lemma ": 8, "Proposition ": 3, "Algorithm ": 3, "Remark ": 13}
    last |= {"Assumption ": 4, "Definition ": 4}
    text = {f"{kind}{n + 1}" for kind, count in last.items() for n in range(count)}
    text |= {*published_studies()}
    assert text <= {*CLAIMS.index}
    others = ("Abstract", "Chapter 1", "Section", "(", "Appendix A")
    assert all(claim.startswith(others) for claim in {*CLAIMS.index} - text)


@parametrize("claim", CLAIMS.index)
def test_a_verdict_has_its_reason_and_a_section_that_is_there(claim):
    about = CLAIMS.loc[claim]
    assert about["verdict"] in VERDICTS
    assert about["why"] or about["verdict"] == "diagram"
    assert not about["report"] or about["section"] in heads_of(about["report"])


def test_every_report_with_a_claim_reads_its_verdicts():
    shown = CLAIMS[CLAIMS["verdict"] != "diagram"]["report"]
    for report in {*shown} - {""}:
        assert f'verdicts(\\"{report}\\")' in REPORTS[report].read_text(encoding="utf-8"), report


def test_verdicts_are_those_of_the_audit_and_of_the_reconstructions():
    """
    Oracles: what of a table or study differs in the audit; which printed statistics no
    reconstructed data have.
    """
    audit = tl.audit()
    differ = set(audit.loc[audit["verdict"] == "differs", "id"].str.partition("/")[0])
    for claim, verdict in CLAIMS["verdict"].items():
        if claim.startswith("Table"):
            rows = audit[audit["id"].str.startswith(claim.lower().replace(" ", "_") + "/")]
            held = "reproduced" if rows["verdict"].eq("reproduced").any() else "not checkable"
            assert verdict == ("differs" if rows["verdict"].eq("differs").any() else held), claim
        elif claim in published_studies():
            assert verdict == ("differs" if claim in differ else "reproduced"), claim
            if verdict == "reproduced":
                assert not tl.reconstruct(published_studies()[claim], p_adjust="bonferroni").attrs[
                    "left_out"
                ]


def test_numbers_in_the_reasons_are_computed_again():
    """Oracles: exact cycles, closed forms and the printed tables."""
    models, table = tl.published_models(), published_table("2.2")
    pairs = {who: table.loc[["TSC_l", "TSC_u"], who].astype(float) for who in table}
    cycles = {who: tl.limit_cycle(models[who], *pair) for who, pair in pairs.items()}
    steps = published_table("2.1").loc["delta_TSC"].astype(float)
    bound = tl.steady_state_bounds(models["3"], *pairs["3"], steps["3"]).r_high
    third = cycles["3"]
    said = f"the limit cycle of r is {third.r_low:.3f} to {third.r_high:.3f}, and (2.33) gives"
    assert f"{said} {bound:.3f}" in CLAIMS.loc["Theorem 2", "why"]
    people = [models[who] for who in pairs]
    by_hand = [100 * model.human.p_min / model.human.p_max for model in people]
    ranges = [(model.robot.p_min, model.robot.p_max) for model in people]
    earned = [
        100 * (cycle.mean_p_r - low) / (high - low)
        for cycle, (low, high) in zip(cycles.values(), ranges, strict=True)
    ]
    said = CLAIMS.loc["Section 2.2.4", "why"]
    assert f"{min(by_hand):.0f} to {max(by_hand):.0f} % of the range" in said
    assert f"the {min(earned):.0f} to {max(earned):.0f} % under the printed thresholds" in said
    fifth = published_table("2.1")["5"].astype(float)
    robot = tl.RobotModel(
        fifth["a_pr"], fifth["P_r_min"], fifth["P_r_max"], fifth["P_h_max"], b=fifth["b_pr"]
    )
    human = tl.HumanModel(0.999, 0.5, fifth["P_h_min"], fifth["P_h_max"])
    upper = tl.threshold_limits(tl.TscModel(robot, human), fifth["delta_P_h"]).upper
    assert pairs["5"]["TSC_u"] > upper
    by_formula = tl.threshold_limits(models["5"], fifth["delta_P_h"]).upper
    said = CLAIMS.loc["Section 2.4.1.2", "why"]
    assert f"{upper:.3f}" in said
    assert f"{by_formula:.3f}" in said
    performed = published_table("2.5").loc["C4"]
    said = CLAIMS.loc["Table 2.5", "why"]
    people = [models[who].human for who in "12345"]
    best = optimize.minimize(
        lambda r: -np.mean([who.performance(x) for who, x in zip(people, r, strict=True)]),
        [0.739] * 5,
        bounds=[(0.1, 0.99)] * 5,
        constraints={"type": "eq", "fun": lambda r: r.mean() - float(performed["r_mean"])},
    )
    assert f"utilization, {performed['r_mean']}: {-best.fun:.4f} at most" in said
    assert f"under C4, {performed['P_h_mean']}," in said
    heaviest = tl.HapticDevice(0.005, 0.55, 100.0, 60.0).largest_mass()
    assert f"{1000 * heaviest:.1f} g" in CLAIMS.loc["(3.10)", "why"]
    least = tl.teleoperation.passivity_margin([2.0], [1.0, 2.0]).least_product
    assert least == approx(0.25)


def test_theorem_2_fails_for_participant_3_with_the_printed_gain_too():
    """And for most models whose parameters round to the printed ones."""
    thresholds, said = (0.0, 0.27), CLAIMS.loc["Theorem 2", "why"]
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
    assert f"the cycle ends at {cycle:.3f} and the bound is {bound:.3f}" in said
    half, rng = printed[names].map(half_unit).to_numpy(float), np.random.default_rng(0)
    sets = [steady(values + half * rng.uniform(-1.0, 1.0, 8)) for _ in range(150)]
    share = np.mean([cycle > bound for cycle, bound in sets])
    assert share == approx(0.85, abs=0.06)
    assert "about 85 % of the sets" in said


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
    assert "for participants 4 and 5 from rest" in CLAIMS.loc["Assumption 3", "why"]
    assert "stays below its maximum" in CLAIMS.loc["Algorithm 2", "why"]


@parametrize(
    ("answer", "said"),
    [
        ("Does it? **Yes: 3 of 4.** What to doubt: **all**.", "Yes: 3 of 4."),
        ("**Skipped: no data.** Put them there.", "Skipped: no data."),
        ("It was not run yet.", "It was not run yet."),
    ],
)
def test_first_page_quotes_what_a_report_says_in_bold(answer, said):
    headline = runpy.run_path(str(ROOT / "docs" / "extension.py"))["headline"]
    path = NOTEBOOKS / "06_audit.ipynb"
    title = "Audit: which printed numbers follow from which"
    page = empty_chapter(path, answer)
    assert headline(nbformat.reads(page, 4)) == (title, said)
    assert "```" not in page
    assert "```text" in empty_chapter(path, answer, "NameError")


def test_a_reason_begins_with_a_capital_unless_with_a_symbol():
    sentence = runpy.run_path(str(ROOT / "docs" / "extension.py"))["sentence"]
    said = ["b ≤ a: otherwise", "the sum", "df1 = 2", "δ_TSC is"]
    assert [*map(sentence, said)] == ["b ≤ a: otherwise.", "The sum.", "df1 = 2.", "δ_TSC is."]
    begun = CLAIMS.loc[CLAIMS["verdict"].isin({"fails", "holds with a condition"}), "why"]
    assert not begun.str.startswith("a ").any()


def test_search_lists_the_section_of_a_table_first():
    """Sphinx shows an entry of the index that is what was asked for before every other result."""
    entries = runpy.run_path(str(ROOT / "docs" / "extension.py"))["FinderEntries"]
    row = CLAIMS.loc["Table 2.1"]
    document = new_document("page")
    document.settings.env = SimpleNamespace(docname=f"03_{row['report']}")
    for title in (row["section"], "Another section"):
        document += nodes.section("", nodes.title(text=title), ids=["a"])
    entries(document).apply()
    ours, other = [section[1]["entries"] for section in document.children]
    assert ("single", "Table 2.1", "a", "main", None) in ours
    assert other == []


def test_captions_say_that_data_are_synthetic():
    with mpl.rc_context():
        figures.use_house_style()
        figure = mpl.figure.Figure()
        axes = figure.subplots()
        text = figures.caption(axes, "What it shows.", synthetic="pilot, seed 1")
        figures.caption(axes, "What it shows.", synthetic="pilot, seed 1")
    assert text.get_text() == "Synthetic data: pilot, seed 1. What it shows."
    marks = [
        artist.get_text() for artist in figure.texts if artist.get_gid() == "trustlab-synthetic"
    ]
    assert marks == ["Synthetic data: pilot, seed 1"]


def test_code_that_shows_nothing_is_folded_with_the_code_after_it():
    shown = {"b": [new_output("stream", text="1")]}
    code = [new_code_cell(c, outputs=shown.get(c, []), metadata={"tags": []}) for c in "abc"]
    run = new_notebook(cells=[new_markdown_cell("# T"), *code, new_markdown_cell("words")])
    sources = [cell.source for cell in nbformat.reads(chapter(run, {}), 4).cells]
    assert sources[:-1] == ["# T", "a\n\nb", "c", "words"]


def test_minus_and_percent_signs_are_set_in_prose_alone():
    words = "From -0.2 to 82% (`-5%`, $-1$) in 1-5, 95\n% and -3 % (95% CI) of 2026-11-29"
    output = new_output("display_data", {"text/markdown": words})
    metadata = {"text/html": f"<table><caption>{words}</caption></table>"}
    outputs = [output, new_output("display_data", metadata)]
    run = new_notebook(
        cells=[
            new_markdown_cell("# T"),
            new_markdown_cell(words),
            new_code_cell("-1", outputs=outputs, metadata={"tags": []}),
            new_code_cell("-1", outputs=[output], metadata={"tags": ["answer"]}),
        ]
    )
    _, answer, prose, cell, table, *_ = nbformat.reads(chapter(run, {}), 4).cells
    said = "From −0.2 to 82_% (`-5%`, $-1$) in 1-5, 95_% and −3_% (95% CI) of 2026-11-29"
    said = said.replace("_", "\u00a0")
    shown = [prose.source, cell.outputs[0].data["text/markdown"]]
    assert [*shown, table.metadata["mystnb"]["figure"]["caption"]] == [said] * 3
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
        table, _ = shell.display_formatter.format(pd.DataFrame({"eta2_partial": [0.5]}))
    finally:
        InteractiveShell.clear_instance()
    kind = "image/svg+xml" if book else "image/png"
    assert set(data) == {kind, "text/plain"}
    assert words.get_visible() is not book
    assert not book or about[kind]["caption"] == "What it means."
    assert "partial η²" in table["text/html"]


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


def test_provenance_lists_what_a_notebook_reads_and_names_no_path(tmp_path):
    papermill = {"start_time": "2026-11-27T13:48:22.1+00:00", "duration": 1.26}
    run = from_dict({"metadata": {"papermill": papermill | {"parameters": {"seed": 5}}}})
    read = provenance(ROOT, NOTEBOOKS / "01_identification.ipynb", run)
    assert read["Data"] == "data/coverage, data/published, data/sessions"
    assert (read["Started"], read["Time taken"]) == ("2026-11-27 13:48 UTC", "1.3 s")
    assert (read["Parameter seed"], read["Parameter runs"]) == ("5", "40")
    root = make(tmp_path, n01_a=["# A"])
    origin = provenance(root, root / "notebooks" / "01_a.ipynb", run)
    assert origin["Commit"] == "not a git checkout"
    assert str(tmp_path) not in str(origin)


def test_pages_stay_whole_where_there_is_no_home(monkeypatch):
    monkeypatch.setenv("HOME", "/")
    assert anonymous("<p>a/b</p>", ROOT) == "<p>a/b</p>"


def test_the_commit_is_marked_where_a_file_is_changed_or_new(tmp_path):
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a"]
    for words in ("init -q", "commit -q --allow-empty -m first"):
        subprocess.run([*git, *words.split()], check=True)
    clean = commit(tmp_path)
    assert re.fullmatch("[0-9a-f]{40}", clean)
    (tmp_path / "new.py").touch()
    assert commit(tmp_path) == clean + " + uncommitted changes"
    (tmp_path / "inside").mkdir()
    assert commit(tmp_path / "inside") == "not a git checkout"


NAMES = 'session_file = "run.csv"\nwindow = 0.0  # seconds'


def test_a_parameter_that_a_notebook_lacks_is_refused():
    only_parameters({"In": ["", NAMES, "# Parameters\nwindow = 100\n", "import os"]})
    only_parameters({"In": ["", "import os", "# Parameters\nrate = 3\n"]})  # a cell of its author
    only_parameters({})  # not a notebook
    with pytest.raises(ValueError, match="got 'sesion_file'; did you mean 'session_file'"):
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
    parameters = {n.targets[0].id for n in ast.parse(code[0].source).body if hasattr(n, "targets")}
    names = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name))
    assert not parameters & {node.id for node in names if isinstance(node.ctx, ast.Store)}


def test_parameters_of_the_page_on_ones_own_log_win_or_are_refused(tmp_path):
    """A window was ignored where the log has one, minutes below 0; few draws blamed the log."""
    pilot = tl.sessions.example("pilot")
    log = tl.write_session(pilot.with_metadata(performance_window=5.0), tmp_path / "run.csv")
    page = nbformat.read(NOTEBOOKS / "00_my_session.ipynb", 4).cells
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
    assert run(2, window=100).metadata.more["performance_window"] == 100
    assert run(2, window=0).metadata.more["performance_window"] == 0
    assert run(2, minutes=2).duration == approx(120)
    with pytest.raises(tl.SessionError, match="start first"):
        run(2, minutes=-5)
    with pytest.raises(ValueError, match="n must be a whole number, from 100"):
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
    boxes = {
        f"{text.get_text()} {i}": text.get_window_extent(page)
        for i, text in enumerate(diagram.axis.texts)
        if text.get_text()
    }
    found = [(a, b) for a, b in combinations(boxes, 2) if boxes[a].overlaps(boxes[b])]
    inside = {name: Bbox.intersection(box, diagram.figure.bbox) for name, box in boxes.items()}
    cut = (name for name, box in boxes.items() if inside[name].bounds != box.bounds)
    return found + [(name, "the page") for name in cut]


@parametrize("draw", PICTURES, ids=lambda draw: draw.__name__)
def test_no_text_of_a_diagram_is_covered_or_cut(draw):
    diagram = draw()
    assert covered(diagram) == []
    assert diagram.figure.get_figwidth() <= 6.5
    # Negative control: a text over another one.
    first = next(text for text in diagram.axis.texts if text.get_text())
    diagram.text("across", *first.get_position())
    assert covered(diagram) != []
