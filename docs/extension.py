"""
What the book adds to Sphinx: API pages, equations as MathML and links to them, the finder, sortable
tables, a policy.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
import shutil
import tomllib
from collections import Counter
from pathlib import Path

import itables
from docutils import nodes
from docutils.statemachine import StringList
from latex2mathml.converter import convert
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from sphinx.writers.html5 import HTML5Translator

import trustlab
from trustlab.models.digest import ROOMS

ROOT = Path(__file__).parents[1]
EQUATIONS_PAGE = "concepts/equations"
GLOSSARY_PAGE = "concepts/glossary"
PRINTED = ROOT / "data" / "published" / "equations.toml"
EQUATIONS = tomllib.loads(PRINTED.read_text(encoding="utf-8"))
BETWEEN_EQUATIONS = re.compile(r"(?<=,)\s*\\quad\s")
# (2.3), report “allocation”, or Table 03-1.
CITED = re.compile(r"(\((?:\d|A)\.\d+\)|\b[Rr]eport “[a-z ]+”|\b(?:Figure|Table) \d\d[a-z]?-\d+\b)")
LABEL = re.compile(r"(?:Figure|Table) (\d\d[a-z]?)-\d+")
STUDIES = {"uav": "UAV study", "teleop": "teleoperation study"}
REPORT = re.compile(r"(\d\d[a-z]?|p\d)_")  # a chapter, or the primer of one
VERDICTS = ROOT / "data" / "published" / "verdicts.toml"
CLAIMS = tomllib.loads(VERDICTS.read_text(encoding="utf-8"))
# What does not simply hold.
IN_DOUBT = ("fails", "holds with a condition", "differs")

# The theme's scripts, styles and fonts lie beside the pages; nothing else is loaded, from wherever.
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; font-src 'self'; form-action 'self'; base-uri 'none'"
)


# The pages of the API are written as sources before Sphinx reads them.


def _described(module: str, name: str) -> str:
    """Return the directive that shows one object's docstring."""
    found = getattr(importlib.import_module(module), name)
    if inspect.isclass(found):
        kind = "exception" if issubclass(found, Exception) else "class"
        return f".. auto{kind}:: {module}.{name}\n   :members:\n"
    if inspect.ismodule(found):
        return f".. automodule:: {module}.{name}\n   :members:\n"
    # Compiled functions are called as functions are, and documented as such.
    kind = "function" if callable(found) else "data"
    return f".. auto{kind}:: {module}.{name}\n"


def api_pages(only: str = "") -> dict[str, str]:
    """
    Return the sources of the API: a page for each name of ``trustlab``, one for each room, and the
    page above them.

    `only` is a regular expression that names are chosen by, for tests that need few pages.
    """
    names = [name for name in trustlab.__all__ if not inspect.ismodule(getattr(trustlab, name))]
    names = [name for name in names if re.match(only, name)]
    rooms = [name for name in ROOMS if name in trustlab.__all__]
    by_room = {room: [name for name in names if _room(name) == room] for room in rooms}
    pages = {name: f"{name}\n{'=' * len(name)}\n\n{_described('trustlab', name)}" for name in names}
    for room, own in by_room.items():
        module = f"trustlab.{room}"
        more = [name for name in importlib.import_module(module).__all__ if name not in names]
        listed = "".join(f"   trustlab.{name}\n" for name in own)
        page = f"{module}\n{'=' * len(module)}\n\n.. automodule:: {module}\n   :no-members:\n\n"
        if own:
            page += (
                f"As ``tl.…``\n-------------\n\n.. autosummary::\n   :nosignatures:\n\n{listed}\n"
            )
            page += ".. toctree::\n   :hidden:\n\n" + "".join(f"   {name}\n" for name in own) + "\n"
        if more and not only:
            described = "\n".join(_described(module, name) for name in more)
            page += f"More, in ``{module}``\n{'-' * (len(module) + 14)}\n\n{described}"
        pages[f"room_{room}"] = page
    lines = [f"   room_{room}\n" for room in rooms]
    pages["index"] = (
        "API\n===\n\nEvery public name, from its docstring: what it does, its equations by "
        "number, arguments with shapes and\n"
        "units, errors, and an example that runs in ``make test``. After ``import trustlab as "
        "tl`` the names of the\n"
        "first list of each room are ``tl.name``; those of the second are imported from the "
        "room. A room imports only\n"
        "from rooms above it.\n\n"
        + ".. autosummary::\n\n"
        + "".join(f"   trustlab.{room}\n" for room in rooms)
        + "\n.. toctree::\n   :hidden:\n\n"
        + "".join(lines)
    )
    return pages


def _room(name: str) -> str:
    """Return the room that a name of ``trustlab`` comes from."""
    rooms = [room for room in ROOMS if room in trustlab.__all__]
    return next(
        room for room in rooms if name in importlib.import_module(f"trustlab.{room}").__all__
    )


def write_api(app: Sphinx) -> None:
    """Write the pages of the API that have changed, and remove those whose names are gone."""
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    pages = {f"{name}.rst": text for name, text in api_pages(app.config.api_only).items()}
    for path in folder.iterdir():
        if path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def known_name(role, rawtext: str, text: str, lineno: int, inliner, options=None, content=()):
    """
    Link a name in single backticks to its page where it is one of the API's, and else show it as
    code.
    """
    name = text.removeprefix("trustlab.").removeprefix("tl.").removesuffix("()")
    if name not in trustlab.__all__ and not text.startswith("trustlab."):
        return [nodes.literal(rawtext, text)], []
    target = {
        "refdomain": "py",
        "reftype": "obj",
        "reftarget": f"trustlab.{name}",
        "refexplicit": True,
    }
    link = addnodes.pending_xref(rawtext, nodes.literal(rawtext, text), refwarn=False, **target)
    link["refdoc"] = inliner.document.settings.env.docname
    return [link], []


# Equations.


def equation_id(number: str) -> str:
    """Return the anchor of an equation on the page of equations."""
    return "eq-" + number.lower().replace(".", "-")


class Equation(SphinxDirective):
    """
    ``{equation} 2.3 2.5`` shows equations of ``data/published/equations.toml``, each with an anchor
    and what computes it.
    """

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Return a block for each number."""
        self.env.note_dependency(str(PRINTED))
        self.env.note_dependency(str(VERDICTS))
        return [self._shown(number) for number in self.arguments[0].split()]

    def _shown(self, number: str) -> nodes.Node:
        entry = EQUATIONS[number]
        block = nodes.container(classes=["equation"], ids=[equation_id(number)])
        block += nodes.inline(text=f"({number})", classes=["equation-number"])
        block += nodes.math_block(
            entry["latex"], entry["latex"], nowrap=False, number=None, label=None
        )
        words = nodes.paragraph("", entry["says"] + " ", classes=["equation-says"])
        if "computed_by" in entry:
            name = entry["computed_by"]
            target = {
                "refdomain": "py",
                "reftype": "obj",
                "reftarget": f"trustlab.{name}",
                "refexplicit": True,
            }
            words += addnodes.pending_xref(
                "", nodes.literal("", name), refwarn=True, refdoc=self.env.docname, **target
            )
        block += words
        for claim, about in CLAIMS.items():
            if about["verdict"] in IN_DOUBT and f"({number})" in f"{claim} {about['says']}":
                said = f"{claim} {about['verdict']}: {about['why']}."
                block += nodes.paragraph("", said, classes=["equation-differs"])
        return block


def mathml(latex: str, display: str) -> str:
    """Return a formula as MathML; what the converter does not know is refused."""
    # latex2mathml knows aligned by the name of split only.
    math = convert(latex.strip().replace("{aligned}", "{split}"), display=display)
    if "\\" in math:
        raise ValueError(f"the formula {latex!r} has a command that cannot be shown")
    # Else browsers set a bar small and far above its letter.
    return math.replace("<mover>", '<mover accent="true">')


def visit_formula(translator, node: nodes.math) -> None:
    """Write a formula within a line as MathML, which needs no script."""
    translator.body.append(mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def visit_equation(translator, node: nodes.math_block) -> None:
    """
    Write a formula on a line of its own, broken between its equations where the page is narrow; a
    wide equation scrolls.
    """
    equations = BETWEEN_EQUATIONS.split(node.astext())
    written = "".join(f"<span>{mathml(equation, 'block')}</span>" for equation in equations)
    translator.body.append(f'<div class="formula" tabindex="0">{written}</div>')
    raise nodes.SkipNode


def link_names(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """
    Make numbers of equations, reports, and figures and tables of reports in text links; a figure or
    table that a report with others does not have is a warning, which fails the book.
    """
    if docname == EQUATIONS_PAGE:
        return
    page = app.builder.get_relative_uri(docname, EQUATIONS_PAGE)
    places = {f"({number})": f"{page}#{equation_id(number)}" for number in EQUATIONS}
    numbered = set()
    chapters = [path.stem for path in Path(app.srcdir).glob("*.ipynb")]
    for report in filter(REPORT.match, chapters):
        # What lacked its data is no page of its own.
        shown = report if report in app.env.found_docs else "real_sessions"
        uri = app.builder.get_relative_uri(docname, shown)
        if report != docname:
            places[f"report “{report.partition('_')[2].replace('_', ' ')}”"] = uri
        for kind, numbers in app.env.toc_fignumbers.get(report, {}).items():
            numbered.add(REPORT.match(report)[1])
            for anchor, (number,) in numbers.items():
                places[f"{kind.capitalize()} {number}"] = f"{uri}#{anchor}"
    for text in list(doctree.findall(nodes.Text)):
        parts = CITED.split(text.astext())
        if len(parts) == 1 or _is_literal(text):
            continue
        new: list[nodes.Node] = []
        for part in filter(None, parts):
            place = places.get(part.replace("Report", "report"))
            cited = LABEL.fullmatch(part)
            if "eport “" in part and place is None:
                logging.getLogger(__name__).warning("there is no %s", part, location=docname)
            if cited and not place and cited[1] in numbered:
                logging.getLogger(__name__).warning(
                    "%s is cited, which report %s does not have", part, cited[1], location=docname
                )
            new.append(
                nodes.reference("", part, refuri=place, internal=True)
                if place
                else nodes.Text(part)
            )
        text.parent.replace(text, new)


def _is_literal(node: nodes.Node) -> bool:
    kinds = (
        nodes.literal,
        nodes.literal_block,
        nodes.reference,
        nodes.title,
        nodes.math,
        nodes.math_block,
        nodes.raw,
    )
    parent = node.parent
    while parent is not None:
        if isinstance(parent, kinds):
            return True
        parent = parent.parent
    return False


# The reports.


class FinderEntries(SphinxTransform):
    """
    Index what the finder leads to, "Table 2.1", at its section, "own robot" at the section about
    it, and the terms of the glossary: a search for just this lists the section, or the term, first.
    """

    default_priority = 400  # before Sphinx collects the index

    def apply(self) -> None:
        """Add the claims of a page."""
        report = self.env.docname.partition("_")[2]
        shown = {claim: about for claim, about in CLAIMS.items() if about.get("report") == report}
        for section in self.document.findall(nodes.section):
            title = section.next_node(nodes.title).astext()
            names = [claim for claim, about in shown.items() if about["section"] == title]
            if title.startswith("Your own "):
                names.append(title.removeprefix("Your "))
            section.insert(1, _indexed(names, section["ids"][0]))
        if self.env.docname == GLOSSARY_PAGE:
            for term in self.document.findall(nodes.term):
                names = term.astext().split(", ")
                term["ids"].append(slug(term.astext()))
                term.append(_indexed(names, term["ids"][0]))


def keep_entries(app: Sphinx) -> list:
    """Give the search the entries of all pages: Sphinx knows those of pages written now."""
    entries = app.env.domains["index"].entries if hasattr(app.builder, "indexer") else {}
    for name, found in entries.items():
        kept = [(value, place, main) for _, value, place, main, _ in found]
        app.builder.indexer._index_entries.setdefault(name, kept)
    return []


def _indexed(names: list[str], place: str) -> nodes.Node:
    return addnodes.index(entries=[("single", name, place, "main", None) for name in names])


class Finder(SphinxDirective):
    """
    ``{finder}`` lists every claim with its verdict and the reason; ``{finder} Theorem Table`` those
    whose names begin so, in this order.
    """

    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Return a table whose places are links."""
        self.env.note_dependency(str(VERDICTS))
        names = " ".join(self.arguments).split() or [""]
        chosen = [claim for name in names for claim in CLAIMS if claim.startswith(name)]
        lines = ["| | What | Verdict | Why | Section |", "|---|---|---|---|---|"]
        for claim in chosen:
            about = CLAIMS[claim]
            name = STUDIES.get(claim.partition(".")[0], claim)
            why = about.get("why", "")
            cells = [name, about["says"], badge(about["verdict"]), why, place(self, about)]
            lines.append(f"| {' | '.join(cells)} |")
        return [_parsed(self, lines, "finder")]


class InDoubt(SphinxDirective):
    """``{in-doubt}`` lists what does not simply hold as printed: why, and what to use instead."""

    def run(self) -> list[nodes.Node]:
        """Return a list of definitions."""
        self.env.note_dependency(str(VERDICTS))
        lines = []
        said = Counter(about.get("why") for about in CLAIMS.values())
        shown = set()
        for claim, about in CLAIMS.items():
            why = about.get("why", "")
            if about["verdict"] in IN_DOUBT and why not in shown:
                name = STUDIES.get(claim.partition(".")[0], claim)
                more = f", and {said[why] - 1} more" * (name != claim and said[why] > 1)
                lines += [f"{name}: {about['says']}{more} {badge(about['verdict'])}"]
                shown.add(why)
                instead = f"*Instead*: {about['instead']}." if "instead" in about else ""
                lines += [f": {sentence(why)} {instead} {place(self, about)}", ""]
        return [_parsed(self, lines, "in-doubt")]


def sentence(words: str) -> str:
    """Return words as a sentence; symbols, such as b, df1 and δ_TSC, get no capital."""
    return re.sub(r"^[a-z]{2,}(?!\S)", lambda word: word[0].capitalize(), words) + "."


def place(directive: SphinxDirective, about: dict[str, str]) -> str:
    """Return a link to where a claim is shown."""
    if "report" not in about:
        return ""
    chapters = Path(directive.env.srcdir).glob("*.ipynb")
    named = (path for path in chapters if path.stem.partition("_")[2] == about["report"])
    chapter = next(named, None)
    link = f"[{about['section']}]({f'/{chapter.name}' if chapter else ''}"
    if chapter:
        directive.env.note_dependency(str(chapter))
        # Where a notebook was not run, or failed, the sections are missing.
        if about["section"] in chapter.read_text(encoding="utf-8"):
            link += f"#{slug(about['section'])}"
    return f"{link})"


class Headlines(SphinxDirective):
    """
    Each line ``05 real reconstructed`` shows a report: its title, the kinds of data that it rests
    on, and the headline of its answer, as it was computed when the report was run.
    """

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return a list with an item for each line."""
        lines = []
        for line in self.content:
            number, *kinds = line.split()
            path = next(Path(self.env.srcdir).glob(f"{number}_*.ipynb"))
            self.env.note_dependency(str(path))
            chapter = json.loads(path.read_text(encoding="utf-8"))
            title, said = headline(chapter)
            if said.startswith(("Skipped", "It was not run", "This report failed")):
                kinds = ["skipped"]
            shown = f"{' '.join(map(badge, kinds))} {question(chapter)} {said}"
            lines.append(f"- {number} [{title}]({path.name}) {shown}")
        return [_parsed(self, lines, "headlines")]


def headline(chapter: dict) -> tuple[str, str]:
    """Return the title of an executed notebook, and what its answer says in bold."""
    title = "".join(chapter["cells"][0]["source"]).partition("\n")[0].removeprefix("# ")
    said = answer(chapter)
    bold = re.search(r"\*\*(.+?)\*\*", said, re.DOTALL)
    return title, bold[1] if bold else said


def question(chapter: dict) -> str:
    """Return the question that the answer of an executed notebook begins with, or ""."""
    asked = re.match(r"([^*?]+\?)\s", answer(chapter))
    return f"*{asked[1]}*" if asked else ""


def answer(chapter: dict) -> str:
    """Return the answer of an executed notebook."""
    text = "\n".join("".join(cell["source"]) for cell in chapter["cells"])
    found = re.search(r'class="answer".*?>(.*?)</section>', text, re.DOTALL)
    return found[1].strip() if found else ""


def badge(kind: str) -> str:
    """Return a word as a badge, coloured by what it says."""
    return f"[{kind}]{{.badge .{kind.replace(' ', '-')}}}"


def _parsed(directive: SphinxDirective, lines: list[str], name: str) -> nodes.Node:
    """Return lines of Markdown as a block of a class."""
    block = nodes.container(classes=[name])
    directive.state.nested_parse(StringList(lines, source=str(VERDICTS)), 0, block)
    return block


def slug(heading: str) -> str:
    """Return the anchor of a heading."""
    return re.sub(r"\W+", "-", heading.lower()).strip("-")


def copy_tables(app: Sphinx) -> None:
    """Put DataTables, which itables brings, among the scripts: pages on a disk load no modules."""
    bundle = Path(itables.__file__).parent / "html"
    script = (bundle / "dt_bundle.js").read_text(encoding="utf-8")
    names = re.search(r"export\{.*?(\w+) as default.*?\}", script)
    code = script.replace(names[0], f"window.DataTable={names[1]};")
    folder = Path(app.outdir) / "_static"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "dt_bundle.js").write_text(f"(()=>{{{code}\n}})()", encoding="utf-8")
    shutil.copy(bundle / "dt_bundle.css", folder)


class NumberedTable(nodes.figure):
    """A table with its caption, numbered apart from figures."""


def number_tables(app: Sphinx, doctree: nodes.document) -> None:
    """Take figures of class "captioned-table" for tables."""
    for figure in list(doctree.findall(nodes.figure)):
        if "captioned-table" in figure["classes"]:
            table = NumberedTable("", *figure.children, **figure.attributes)
            figure.replace_self(table)


def number_by_report(app: Sphinx, env) -> list[str]:
    """
    Number figures, tables and titles of reports by report: Figure 03-1 is the first of 03, which
    is told from the dissertation's Fig. 3.1.
    """
    for name, kinds in env.toc_fignumbers.items():
        if not REPORT.match(name):
            continue
        label = REPORT.match(name)[1]
        for kind, places in kinds.items():
            kinds[kind] = {
                place: (f"{label.upper() if label[0] == 'p' else label}-{n}",)
                for n, place in enumerate(places, 1)
            }
        entry = next(env.tocs[name].findall(nodes.reference))
        for title in (env.titles[name], entry):
            if label[0] != "p" and not title.astext().startswith(label):
                title.insert(0, nodes.Text(f"{label} "))
    return []


def set_policy(
    app: Sphinx, pagename: str, templatename: str, context: dict, doctree: object
) -> None:
    """Let a page load nothing but what lies beside it."""
    policy = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
    context["metatags"] = policy + context.get("metatags", "")


def name_folds(
    app: Sphinx, pagename: str, templatename: str, context: dict, doctree: object
) -> None:
    """Give what unfolds a branch of the sidebar a name; the theme gives it an arrow."""
    made = context["generate_toctree_html"]
    named = '<summary aria-label="what is below">'
    context["generate_toctree_html"] = lambda *kind, **how: str(made(*kind, **how)).replace(
        "<summary>", named
    )


def setup(app: Sphinx) -> dict[str, object]:
    """Add all this to Sphinx."""
    app.add_config_value("api_only", "", "env")
    app.connect("builder-inited", write_api)
    app.connect("builder-inited", copy_tables)
    app.connect("doctree-read", number_tables)
    app.connect("env-get-updated", number_by_report, priority=900)  # after Sphinx has numbered
    app.connect("doctree-resolved", link_names)
    app.connect("html-collect-pages", keep_entries)
    app.connect("html-page-context", set_policy)
    app.connect("html-page-context", name_folds, priority=600)  # after the theme has its own
    visitors = (HTML5Translator.visit_figure, HTML5Translator.depart_figure)
    app.add_enumerable_node(NumberedTable, "table", html=visitors)
    app.add_directive("equation", Equation)
    app.add_directive("finder", Finder)
    app.add_directive("in-doubt", InDoubt)
    app.add_transform(FinderEntries)
    app.add_directive("headlines", Headlines)
    app.add_role("known_name", known_name)
    app.add_html_math_renderer("mathml", (visit_formula, None), (visit_equation, None))
    return {"env_version": 8, "parallel_read_safe": True, "parallel_write_safe": True}
