"""What reports are made of: the finder, figures in words, tables in words, and their origin."""

import ast
import re
import runpy
from types import SimpleNamespace

import matplotlib as mpl
import nbformat
import numpy as np
import pandas as pd
import pytest
from docutils import nodes
from docutils.utils import new_document
from IPython.core.interactiveshell import InteractiveShell

import trustlab as tl
from tests.publishing.world import ROOT, make
from trustlab.publishing import figures, only_parameters
from trustlab.publishing.chapter import empty_chapter
from trustlab.publishing.figures import describe
from trustlab.publishing.provenance import provenance, read_files, shared_digest
from trustlab.publishing.tables import cell, table_html
from trustlab.reproduction.published import VERDICTS

NOTEBOOKS = ROOT / "notebooks"
CHECK = "tl.publishing.only_parameters(globals())"
CLAIMS = tl.reproduction.verdicts()


def heads_of(report):
    path = next(NOTEBOOKS.glob(f"[0-9]*_{report}.ipynb"))
    cells = nbformat.read(path, as_version=4).cells
    texts = [cell.source for cell in cells if cell.cell_type == "markdown"]
    return [line.lstrip("# ") for text in texts for line in text.splitlines()]


def test_every_claim_of_the_text_has_a_verdict():
    text = {
        f"Fig. {chapter}.{n}"
        for chapter, last in ((1, 2), (2, 18), (3, 22), (4, 5))
        for n in range(1, last + 1)
    }
    numbered = {"Theorem": 6, "Lemma": 8, "Proposition": 3, "Algorithm": 3, "Remark": 13}
    numbered |= {"Assumption": 4, "Definition": 4}
    text |= {f"{kind} {n}" for kind, last in numbered.items() for n in range(1, last + 1)}
    text |= {f"Table 2.{n}" for n in range(1, 7)} | {"Table 3.1", *tl.published_studies()}
    assert text <= {*CLAIMS.index}
    others = ("Abstract", "Chapter 1", "Section", "(", "Appendix A")
    assert all(claim.startswith(others) for claim in {*CLAIMS.index} - text)


@pytest.mark.parametrize("claim", CLAIMS.index)
def test_a_verdict_has_its_reason_and_a_section_that_is_there(claim):
    about = CLAIMS.loc[claim]
    assert about["verdict"] in VERDICTS
    assert about["why"] or about["verdict"] == "diagram"
    assert not about["report"] or about["section"] in heads_of(about["report"])


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
        elif claim in tl.published_studies():
            assert verdict == ("differs" if claim in differ else "reproduced"), claim
            if verdict == "reproduced":
                assert not tl.reconstruct(
                    tl.published_studies()[claim], p_adjust="bonferroni"
                ).attrs["left_out"]


def test_numbers_in_the_reasons_are_computed_again():
    """Oracles: exact cycles, closed forms and the printed tables."""
    models, table = tl.published_models(), tl.published_table("2.2")
    pairs = {who: table.loc[["TSC_l", "TSC_u"], who].astype(float) for who in table}
    cycles = {who: tl.limit_cycle(models[who], *pair) for who, pair in pairs.items()}
    steps = tl.published_table("2.1").loc["delta_TSC"].astype(float)
    bound = tl.steady_state_bounds(models["3"], *pairs["3"], steps["3"]).r_high
    third = cycles["3"]
    said = f"the steady cycle of r is {third.r_low:.3f} to {third.r_high:.3f}, and (2.33) gives"
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
    fifth = tl.published_table("2.1")["5"].astype(float)
    robot = tl.RobotModel(
        fifth["a_pr"], fifth["P_r_min"], fifth["P_r_max"], fifth["P_h_max"], b=fifth["b_pr"]
    )
    human = tl.HumanModel(0.999, 0.5, fifth["P_h_min"], fifth["P_h_max"])
    upper = tl.threshold_limits(tl.TscModel(robot, human), fifth["delta_P_h"]).upper
    assert pairs["5"]["TSC_u"] > upper
    assert f"{upper:.3f}" in CLAIMS.loc["Section 2.4.1.2", "why"]
    greatest = tl.published_table("2.1").loc["P_h_max"].astype(float).mean()
    performed = tl.published_table("2.5").loc[["C4", "C5"], "P_h_mean"]
    said = CLAIMS.loc["Table 2.5", "why"]
    assert f"{greatest:.3f}" in said
    assert f"{performed.iloc[0]} and {performed.iloc[1]}" in said
    heaviest = tl.HapticDevice(0.005, 0.55, 100.0, 60.0).largest_mass()
    assert f"{1000 * heaviest:.1f} g" in CLAIMS.loc["(3.10)", "why"]
    least = tl.teleoperation.passivity_margin([2.0], [1.0, 2.0]).least_product
    assert least == pytest.approx(0.25)


@pytest.mark.parametrize(
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
    assert headline(nbformat.reads(empty_chapter(path, answer), 4)) == (title, said)


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


@pytest.mark.parametrize("book", [True, False])
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
    assert about[kind]["caption"] == "What it means."
    assert "rise goes from 3 to 5" in about[kind]["alt"]
    assert "partial η²" in table["text/html"]


def test_panels_are_described_by_names_ranges_and_colours():
    figure = mpl.figure.Figure()
    left, right = figure.subplots(1, 2)
    left.bar(["C1", "C2"], [1.0, 2.0], label="means")
    left.set(ylabel="share")
    left.legend()
    drawn = right.pcolormesh([[0.0, 1.0], [2.0, 3.0]])
    right.set(xscale="log", xlim=(1, 100), ylim=(0, 1), title=r"$\alpha$")
    figure.colorbar(drawn, label="error [m]")
    figure.canvas.draw()
    assert describe(figure) == (
        "2 panels. share from 0 to 2.1 against horizontal axis (C1, C2); also shown: means. α; "
        "vertical axis from 0 to 1 against horizontal axis from 1 to 100. Colours show error [m]."
    )


@pytest.mark.parametrize(
    ("p", "value", "shown"),
    [
        (True, 0.0, "&lt;\u00a0.001"),
        (True, 4e-5, "&lt;\u00a0.001"),
        (True, 0.0296, ".030"),
        (False, 0.0296, "0.0296"),
        (False, 0.123456789, "0.1235"),
        (False, 123456789.0, "123456789"),
        (False, -0.5, "−0.5"),
        (False, -0.0, "0"),
        (False, 12, "12"),
        (False, np.bool_(True), "yes"),
        (False, float("nan"), "–"),
        (False, None, "–"),
        (False, "p_r", "robot performance P_r"),
        (False, "<b>$x$</b>", "&lt;b&gt;$x$&lt;/b&gt;"),
    ],
)
def test_a_value_is_written_as_papers_do_and_keeps_its_digits(p, value, shown):
    text = cell(value, p)
    assert re.sub(r"</?data[^>]*>", "", text) == shown
    if isinstance(value, float) and value == value:
        assert float(re.search('value="([^"]*)"', text)[1]) == value


def test_heads_of_rows_and_columns_are_words():
    frame = pd.DataFrame({"p_holm": [0.01], "<i>": [1]}, index=pd.Index(["a"], name="dv"))
    assert re.findall("<th>(.*)</th>", table_html(frame)) == ["measure", "p, Holm", "&lt;i&gt;"]
    assert re.findall("<th>(.*)</th>", table_html(frame.rename_axis(columns="x")))[0] == (
        "measure, by x"
    )
    pairs = frame.set_axis(pd.MultiIndex.from_product([["C1"], ["p", "n"]]), axis=1)
    assert ".010" in table_html(pairs)
    assert table_html(pd.DataFrame({"a": range(3)})).count("<tr") == 4


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ([0.9991, 0.9995, 0.998], ["0.9991", "0.9995", "0.9980"]),
        ([72.31, 91.84], ["72.3", "91.8"]),
        ([0.5, 2.0, np.nan], ["0.5", "2.0", "–"]),
        ([0.0022, 0.517], ["0.0022", "0.517"]),
        ([3.0, 12.0], ["3", "12"]),
        ([1e-7, 250.0], ["1e−07", "250"]),
    ],
)
def test_numbers_of_a_column_have_the_decimals_that_tell_them_apart(values, shown):
    assert (
        re.findall("<td>(?:<data[^>]*>)?([^<]*)", table_html(pd.DataFrame({"x": values}))) == shown
    )


def test_an_estimate_has_the_decimals_of_its_standard_error():
    frame = pd.DataFrame({"value": [0.995998, 0.31], "stderr": [4.2e-5, 0.012]})
    texts = re.findall("<data[^>]*>([^<]*)", table_html(frame))
    assert texts == ["0.995998", "0.000042", "0.310", "0.012"]


def test_provenance_lists_what_a_notebook_reads_and_names_no_path(tmp_path):
    notebook = NOTEBOOKS / "01_identification.ipynb"
    files = [path.relative_to(ROOT).as_posix() for path in read_files(ROOT, notebook)]
    assert "data/published/table_2_1.csv" in files
    assert any(name.startswith("data/sessions/") for name in files)
    assert not any(name.startswith("data/external/") for name in files)
    root = make(tmp_path, n01_a=["# A"])
    path = root / "notebooks" / "01_a.ipynb"
    origin = provenance(root, path, {"seed": 5}, read_files(root, path))
    assert origin["Commit"] == "not a git checkout"
    assert origin["Parameter seed"] == "5"
    assert str(tmp_path) not in str(origin)


def test_digest_follows_data_modules_lock_and_external_files(tmp_path, monkeypatch):
    root = make(tmp_path)
    monkeypatch.setenv("TRUSTLAB_DATA", str(tmp_path / "elsewhere"))
    (tmp_path / "elsewhere").mkdir()
    digests = [shared_digest(root)]
    for name in (
        "data/published/a.csv",
        "notebooks/a.py",
        "environment.lock",
        "elsewhere/log.csv",
    ):
        (root / name).write_text("1")
        digests.append(shared_digest(root))
    assert len(set(digests)) == 5
    for name in ("data/external/a", "notebooks/a.txt", "data/published/__pycache__/a.pyc", "b"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("1")
    assert shared_digest(root) == digests[-1]


NAMES = 'session_file = "run.csv"\nwindow = 0.0  # seconds'


def test_a_parameter_that_a_notebook_lacks_is_refused():
    only_parameters({"In": ["", NAMES, "# Parameters\nwindow = 100\n", "import os"]})
    only_parameters({"In": ["", "import os", "# Parameters\nrate = 3\n"]})  # a cell of its author
    only_parameters({})  # not a notebook
    with pytest.raises(ValueError, match="no parameter 'sesion_file'; did you mean 'session_file'"):
        only_parameters({"In": ["", NAMES, '# Parameters\nsesion_file = "mine.csv"\n']})


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_every_notebook_refuses_parameters_it_lacks(path):
    code = [cell for cell in nbformat.read(path, 4).cells if cell.cell_type == "code"]
    assert code[0].metadata["tags"] == ["parameters"]
    checked = next(i for i, cell in enumerate(code) if CHECK in cell.source.splitlines())
    for early in code[1:checked]:  # nothing is computed before
        assert {type(node) for node in ast.parse(early.source).body} <= {ast.Import, ast.ImportFrom}
    lines = code[checked].source.partition(CHECK)[0]
    assert {type(node) for node in ast.parse(lines).body} <= {ast.Import, ast.ImportFrom}
