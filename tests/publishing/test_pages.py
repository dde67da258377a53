"""Pages, inputs and figures, without running anything."""

import base64
import csv
import dataclasses
import os
import re
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import nbformat
import pytest
from IPython.core.interactiveshell import InteractiveShell
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

import trustlab as tl
from trustlab.models.compiled import NOTICE
from trustlab.publishing import figures
from trustlab.publishing.figures import describe
from trustlab.publishing.notebooks import (
    declared_parameters,
    find_notebooks,
    parameters_for,
    parse_value,
)
from trustlab.publishing.provenance import Checkout, commit, input_digest, provenance
from trustlab.publishing.report_page import (
    ReportError,
    markdown_html,
    output_html,
    page_faults,
    report_html,
)

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"

ORIGIN = {
    "notebook": "01_a.ipynb",
    "notebook_sha256": "0" * 64,
    "commit": "abc",
    "environment_lock": "1" * 12,
    "inputs": {},
    "external_data": "absent",
    "parameters": {"seed": 3},
    "seeds": {"seed": 3},
    "versions": {"python": "3.11"},
    "platform": "Linux x86_64",
    "started": "2026-01-01T00:00:00+00:00",
    "seconds": 1.0,
}


def page_of(*cells, **metadata):
    return report_html(new_notebook(cells=list(cells), metadata=metadata), "01_a", ORIGIN)


def shown(**data):
    kinds = {
        "html": "text/html",
        "markdown": "text/markdown",
        "latex": "text/latex",
        "plain": "text/plain",
        "js": "application/javascript",
    }
    output = new_output("display_data", data={kinds[name]: value for name, value in data.items()})
    return new_code_cell("x", outputs=[output])


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    monkeypatch.delenv("TRUSTLAB_DATA", raising=False)
    for name in (
        "notebooks",
        "trustlab/__pycache__",
        "data/published",
        "data/external",
        "elsewhere",
    ):
        (tmp_path / name).mkdir(parents=True)
    for name in (
        "trustlab/a.py",
        "trustlab/__pycache__/a.pyc",
        "data/published/t.csv",
        "data/external/x",
        "elsewhere/y",
        "environment.lock",
    ):
        (tmp_path / name).write_text("1")
    return Checkout.find(tmp_path)


@pytest.mark.parametrize(
    "markup",
    [
        "<script>1</script>",
        "<img src='http://a/b.png'>",
        "<img src='b.png'>",
        "<link rel=stylesheet href='//a/b.css'>",
        "<style>@import 'a.css'</style>",
        "<p style=\"background: url('http://a')\">",
        "<p onclick='x()'>",
        "<iframe src='data:x'></iframe>",
        "<svg><image xlink:href='a.png'/></svg>",
        "<a href='javascript:x()'>",
    ],
)
def test_page_that_runs_or_fetches_is_refused(markup):
    assert page_faults(markup)
    with pytest.raises(ReportError, match="self-contained"):
        page_of(shown(html=markup))


def test_links_and_embedded_pictures_are_allowed():
    assert not page_faults(
        "<a href='https://doi.org/1'>d</a><img src='data:image/png;base64,AA' alt=''><a "
        "href='#x'>x</a>"
    )


def test_javascript_is_refused_with_its_cell():
    with pytest.raises(ReportError, match="JavaScript") as caught:
        page_of(new_markdown_cell("# A"), shown(js="1", plain="<Javascript>"))
    assert caught.value.cell == 1


def test_outputs_of_every_kind_have_their_formulas():
    page, _ = page_of(
        shown(html="<table><tr><td>$R^2$</td><td><code>$x$</code></td></tr></table>"),
        shown(markdown="$a_b$"),
        shown(latex=r"\begin{align*} a &= b \end{align*}"),
        shown(latex="$$c$$", plain="plain"),
    )
    assert page.count("<math") == 4
    assert "<code>$x$</code>" in page


def test_code_is_folded_and_hidden_where_tagged():
    cells = [new_code_cell("visible = 1"), new_code_cell("secret = 1")]
    cells[1].metadata["tags"] = ["hide"]
    cells[1].outputs = [new_output("stream", name="stderr", text="\x1b[31mwatch out\x1b[0m")]
    page, _ = page_of(*cells)
    assert page.count("<summary>Code of this section</summary>") == 1
    assert "visible" in page
    assert "secret" not in page
    assert '<aside class="note">' in page
    assert "watch out</pre>" in page


def test_that_kernels_were_compiled_is_no_word_of_a_report():
    told = new_output("stream", name="stderr", text=f"{NOTICE}\n")
    page, _ = page_of(new_code_cell("x", outputs=[told]))
    assert "standard error" not in page
    assert NOTICE not in page
    told["text"] += "watch out"
    page, _ = page_of(new_code_cell("x", outputs=[told]))
    assert "standard error" in page
    assert "watch out" in page
    assert NOTICE not in page


def test_title_sentence_anchors_and_contents():
    source = (
        "# A *title* with $x$\n\nOne sentence, e.g. This one. And another.\n\n## B\n\n## "
        "B\n\n### C\n\n## D"
    )
    page, card = page_of(new_markdown_cell(source))
    assert card["title"] == "A title with x"
    assert card["sentence"] == "One sentence, e.g. This one."
    assert 'id="b"' in page
    assert 'id="b-2"' in page
    assert 'class="toc"' in page
    assert '<html lang="en">' in page
    assert 'href="index.html"' in page
    short, _ = page_of(new_markdown_cell("# A\n\nText."))
    assert 'class="toc"' not in short


def test_formula_that_fails_names_itself_and_its_cell():
    with pytest.raises(ReportError, match="nosuch") as caught:
        page_of(new_markdown_cell("# A"), new_markdown_cell(r"$\nosuch$"))
    assert caught.value.cell == 1


def test_wide_table_scrolls_and_numbers_line_up():
    page, _ = page_of(
        shown(
            html="<table "
            'border="1"><thead><tr><th>a</th><th>b</th></tr></thead><tr><td>x</td><td>-1.5e-3</td></tr></table>'
        )
    )
    assert (
        '<div aria-label="table" class="scroll" role="region" tabindex="0"><table border="1">'
        in page
    )
    assert '<td class="number">-1.5e-3</td>' in page
    assert '<th class="number">b</th>' in page


@pytest.mark.parametrize(
    ("text", "right"), [("&lt; .001", True), ("&gt; .999", True), (".014", True), ("&lt; b", False)]
)
def test_bounds_line_up_with_numbers(text, right):
    page, _ = page_of(shown(html=f"<table><tr><td>{text}</td></tr></table>"))
    assert (f'<td class="number">{text}</td>' in page) is right


@pytest.mark.parametrize(
    "text", ["True", "False", "None", "3", "-0.5", "1e-5", "abc", "1_000", "true", ""]
)
def test_values_are_read_as_papermill_reads_them(text):
    from papermill.cli import _resolve_type

    assert parse_value(text) == _resolve_type(text)
    assert type(parse_value(text)) is type(_resolve_type(text))


def write(checkout, name, source):
    cell = new_code_cell(source)
    cell.metadata["tags"] = ["parameters"]
    path = checkout.notebooks / f"{name}.ipynb"
    kernel = {"name": "python3", "language": "python", "display_name": "Python 3"}
    nbformat.write(new_notebook(cells=[cell], metadata={"kernelspec": kernel}), path)
    return path


def test_declared_parameters_agree_with_papermill(checkout):
    from papermill import inspect_notebook

    path = write(
        checkout,
        "01_a",
        "seed = 3  # of the noise\nnoise: float = 0.003\nname = 'x'\nmany = [1, 2]",
    )
    assert declared_parameters(path) == {"seed": 3, "noise": 0.003, "name": "x", "many": [1, 2]}
    assert list(declared_parameters(path)) == list(inspect_notebook(str(path)))


def test_parameters_go_where_they_are_declared(checkout):
    a, b = write(checkout, "01_a", "seed = 3\nname = 'x'"), write(checkout, "02_b", "noise = 0.5")
    got = parameters_for([a, b], {"seed": "4", "name": "7", "noise": "1"})
    assert got == {a: {"seed": 4, "name": "7"}, b: {"noise": 1}}
    with pytest.raises(
        ValueError, match=r"(?s)'sede'; did you mean 'seed'\?.*01_a: seed, name.*02_b: noise"
    ):
        parameters_for([a, b], {"sede": "4"})
    with pytest.raises(ValueError, match="another kind"):
        parameters_for([a, b], {"seed": "four"})


def test_notebooks_are_found_by_name(checkout):
    a, b = write(checkout, "01_first", "x = 1"), write(checkout, "02_second", "x = 1")
    write(checkout, "scratch", "x = 1")
    assert find_notebooks(checkout) == [a, b]
    assert find_notebooks(checkout, ["02"]) == [b]
    with pytest.raises(ValueError, match="did you mean '01_first'"):
        find_notebooks(checkout, ["01_frist"])


@pytest.mark.parametrize(
    ("name", "matters"),
    [
        ("trustlab/a.py", True),
        ("trustlab/recipe.toml", True),
        ("data/published/t.csv", True),
        ("data/calibration/uav.csv", True),
        ("data/simulated/checks.csv", True),
        ("data/coverage/fits.csv", True),
        ("data/live_demo/measured.csv", True),
        ("notebooks/noise_settings.py", True),
        ("notebooks/finder.csv", True),
        ("environment.lock", True),
        ("data/external/x", True),
        ("notebooks/01_a.ipynb", True),
        ("trustlab/__pycache__/a.pyc", False),
        ("notebooks/02_b.ipynb", False),
        ("elsewhere/y", False),
    ],
)
def test_digest_follows_the_inputs_and_nothing_else(checkout, name, matters):
    path = write(checkout, "01_a", "x = 1")
    before = input_digest(checkout, path)
    assert input_digest(checkout, path) == before
    (checkout.root / name).parent.mkdir(exist_ok=True)
    (checkout.root / name).write_text("changed")
    assert (input_digest(checkout, path) != before) == matters


def test_digest_follows_parameters_and_external_folder(checkout):
    path = write(checkout, "01_a", "x = 1")
    before = input_digest(checkout, path)
    assert input_digest(checkout, path, {"x": 2}) != before
    assert (
        input_digest(dataclasses.replace(checkout, external=checkout.root / "none"), path) != before
    )
    os.utime(checkout.external / "x", (1, 1))
    assert input_digest(checkout, path) != before


def test_provenance_outside_git_names_no_path(checkout):
    path = write(checkout, "01_a", "seed = 1")
    found = provenance(checkout, path, {"my_seed": 1, "n": 2})
    assert found["commit"] == commit(checkout.root) == "not a git checkout"
    assert found["seeds"] == {"my_seed": 1}
    assert list(found["inputs"]) == ["data/published/t.csv"]
    assert str(checkout.root) not in repr(found)


READ = {
    "01": {"data/coverage", "data/sessions", "notebooks/noise_settings.py"},
    "03": {"data/simulated"},
    "05": {"data/simulated"},
    "07": {"data/simulated"},
    "10": {"data/calibration", "data/simulated"},
    "11": {"data/live_demo", "notebooks/live_pictures.py"},
}


@pytest.mark.parametrize(
    "notebook", find_notebooks(Checkout.find(NOTEBOOKS.parent)), ids=lambda path: path.stem
)
def test_provenance_lists_what_the_notebook_reads(notebook):
    names = provenance(Checkout.find(NOTEBOOKS.parent), notebook)["inputs"]
    found = {name if name.startswith("notebooks/") else name.rpartition("/")[0] for name in names}
    assert found == {"data/published"} | READ.get(notebook.stem[:2], set())


def test_folder_without_notebooks_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no folder of notebooks"):
        Checkout.find(tmp_path)


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
    with pytest.raises(ValueError, match="svg"):
        figures.use_house_style("pdf")


VERDICTS = {"reproduced", "differs", "reconstructed", "simulated", "not checkable", "diagram only"}


def finder():
    with (NOTEBOOKS / "finder.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_finder_has_every_figure_table_theorem_and_study():
    from trustlab.reproduction.published_study import published_studies

    wanted = {
        f"Fig. {chapter}.{n}"
        for chapter, last in ((2, 18), (3, 22), (4, 5))
        for n in range(1, last + 1)
    }
    wanted |= {f"Table 2.{n}" for n in range(1, 7)} | {"Table 3.1"}
    wanted |= (
        {f"Theorem {n}" for n in range(1, 7)}
        | {f"Proposition {n}" for n in range(1, 4)}
        | set(published_studies())
    )
    wanted |= {
        "Abstract",
        "Section 2.4.1.3",
        "Section 2.4.2.4",
    }  # claims of what suggestions do for people
    wanted |= {"Section 3.7.1", "Section 3.8.1", "Appendix A"}  # what else does not hold as printed
    entries = [row["entry"] for row in finder()]
    assert set(entries) == wanted
    assert len(entries) == len(wanted)


@pytest.mark.parametrize("row", finder(), ids=lambda row: row["entry"])
def test_finder_leads_to_a_section_and_says_why(row):
    assert row["verdict"] in VERDICTS
    assert row["why"] or row["verdict"] in ("reproduced", "diagram only")
    cells = nbformat.read(NOTEBOOKS / f"{row['report']}.ipynb", as_version=4).cells
    heads = [
        line.lstrip("# ")
        for cell in cells
        if cell.cell_type == "markdown"
        for line in cell.source.splitlines()
    ]
    assert row["section"] in heads


def test_finder_has_the_verdicts_of_the_audit_and_of_the_reconstructions():
    """
    Oracles: what of a table or study differs in the audit; which printed statistics no
    reconstructed data have.
    """
    audit = tl.audit()
    differ = set(audit.loc[audit["verdict"] == "differs", "id"].str.partition("/")[0])
    differ |= {
        id.rpartition("/")[2]
        for id in audit.loc[audit["verdict"] == "differs", "id"]
        if "/scale/" in id
    }
    found = {row["entry"]: row["verdict"] for row in finder()}
    for entry, verdict in found.items():
        if entry.startswith("Table"):
            rows = audit[audit["id"].str.startswith(entry.lower().replace(" ", "_") + "/")]
            held = "reproduced" if rows["verdict"].eq("reproduced").any() else "not checkable"
            assert verdict == ("differs" if rows["verdict"].eq("differs").any() else held), entry
        elif entry in tl.published_studies():
            assert verdict == ("differs" if entry in differ else "reproduced"), entry
            if verdict == "reproduced":
                assert not tl.reconstruct(
                    tl.published_studies()[entry], p_adjust="bonferroni"
                ).attrs["left_out"]


def test_answer_is_on_top_headline_on_the_index_and_reports_are_linked():
    answer = shown(markdown="**It holds.** See report 06 and report 77, not `report 06`.")
    answer.metadata["tags"] = ["answer"]
    notebook = new_notebook(
        cells=[new_markdown_cell("# A\n\nWords."), new_markdown_cell("## B"), answer]
    )
    page, card = report_html(notebook, "01_a", ORIGIN, None, NOTEBOOKS)
    assert page.index("It holds.") < page.index("Words.")
    assert card["headline"] == "It holds."
    assert '<a href="06_audit.html">report 06</a> and report 77' in page
    assert "<code>report 06</code>" in page
    assert ' id="b"' in page


def test_what_is_not_there_is_a_dash_and_a_formula_keeps_its_parentheses():
    cells = "".join(f"<td>{text}</td>" for text in ("NaN", "&lt;NA&gt;", "nan", "-0.0", "Nancy"))
    page = output_html(f"<table><tr>{cells}</tr></table>")
    assert re.findall(r"<td[^>]*>([^<]*)</td>", page) == ["\u2013"] * 3 + ["0.0", "Nancy"]
    assert re.findall('data-value="([^"]*)"', page) == ["NaN", "&lt;NA&gt;", "nan", "-0.0"]
    words = markdown_html("left alone ($M = 0$), so $x$ is $y$.")
    whole = re.findall(r'<span class="whole">(.*?)<math.*?</math>(.*?)</span>', words)
    assert whole == [("(", "),"), ("", ""), ("", ".")]


def drawn_as_in_a_notebook(figure, monkeypatch):
    """
    What a notebook keeps of a figure: `use_house_style` sets the formatter of IPython's that draws
    it.
    """
    shell = InteractiveShell.instance()
    try:
        figures.use_house_style()
        monkeypatch.setenv("TRUSTLAB_REPORT", "1")
        picture, about = shell.display_formatter.formatters["image/svg+xml"](figure)
    finally:
        InteractiveShell.clear_instance()
    return new_output(
        "display_data", data={"image/svg+xml": picture}, metadata={"image/svg+xml": about}
    )


@pytest.mark.parametrize(("styled", "before"), [(True, 0), (False, 1)])
def test_pyplot_does_not_draw_what_a_notebook_draws_for_itself(styled, before, monkeypatch):
    drawn, own = [], FigureCanvasAgg.draw
    monkeypatch.setattr(FigureCanvasAgg, "draw", lambda canvas: (drawn.append(canvas), own(canvas)))
    monkeypatch.setattr(
        pyplot, "_REPL_DISPLAYHOOK", pyplot._ReplDisplayHook.NONE
    )  # not that of another test's shell
    shell, backend = InteractiveShell.instance(), mpl.get_backend()
    pyplot.close("all")  # nor its figures
    try:
        with mpl.rc_context():
            pyplot.switch_backend("module://matplotlib_inline.backend_inline")
            pyplot.ion()
            if styled:
                figures.use_house_style()
            shell.run_cell("from matplotlib import pyplot\npyplot.subplots()").raise_error()
    finally:
        pyplot.close("all")
        pyplot.ioff()
        pyplot.switch_backend(backend)
        InteractiveShell.clear_instance()
    assert len(drawn) == before


@pytest.mark.parametrize("words", ["What it means.", "What it means, at some length. " * 12])
def test_figure_has_a_numbered_caption_and_says_what_is_drawn(words, monkeypatch):
    with mpl.rc_context():
        figure = mpl.figure.Figure()
        axes = figure.subplots()
        axes.plot([0, 1, 3], [5, 1, 2], label="measured")
        axes.set(
            xlabel="time [s]",
            ylabel=r"performance $P_r$ [m/s]",
            title="one run",
            xlim=(0, 4),
            ylim=(0, 6),
        )
        axes.legend()
        figures.caption(axes, words)
        output = drawn_as_in_a_notebook(figure, monkeypatch)
    page, _ = page_of(new_code_cell("x", outputs=[output]), new_code_cell("x", outputs=[output]))
    assert f"<figcaption>Figure 1. {words.strip()}</figcaption>" in page
    assert f"<figcaption>Figure 2. {words.strip()}</figcaption>" in page
    pictures = [
        base64.b64decode(data)
        for data in re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', page)
    ]
    assert len(pictures) == 2
    for (
        picture
    ) in pictures:  # a picture that is not well-formed is not shown, and the browser says nothing
        groups = {
            group.get("id")
            for group in ElementTree.fromstring(picture).iter("{http://www.w3.org/2000/svg}g")
        }
        assert {"axes_1", "legend_1", "line:measured"} <= groups
        assert (
            '{"x": [0.0, 4.0, "linear", "time [s]"], "y": [0.0, 6.0, "linear", "performance P_r '
            '[m/s]"]}' in groups
        )
        assert figures.CAPTION_ID not in groups
    seen = (
        "one run; performance P_r [m/s] from 0 to 6 against time [s] from 0 to 4; measured "
        "goes from 5 to 2, between 1 and 5."
    )
    assert page.count(f'alt="{seen}"') == 2


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
    ("name", "value", "written"),
    [
        ("p", "0.0", "&lt; .001"),
        ("p_holm", "4e-5", "&lt; .001"),
        ("p, means (Welch)", "0.0", "&lt; .001"),
        ("p", "0.032", "0.032"),
        ("p", "0.0296", ".030"),
        ("p_holm", "0.251465", ".251"),
        ("p_r", "0.0296", "0.0296"),
        ("p_r", "0.0", "0.0"),
        ("change", "-0.000", "0.000"),
    ],
)
def test_p_is_written_as_papers_do(name, value, written):
    page, _ = page_of(
        shown(
            html=f"<table><thead><tr><th>{name}</th></tr></thead><tbody><tr><td>{value}</td></tr></tbody></table>"
        )
    )
    cell = page[page.index("<td") : page.index("</td>")]
    assert cell.endswith(f">{written}")
    assert written == value or f'data-value="{value}"' in cell


def test_columns_are_headed_by_words_and_keep_their_names():
    page, _ = page_of(
        shown(
            html="<table><thead><tr><th>eta2_partial</th></tr></thead><tbody><tr><td>1</td></tr></tbody></table>"
        )
    )
    assert re.search('<th[^>]*data-value="eta2_partial"[^>]*>partial η²</th>', page)
