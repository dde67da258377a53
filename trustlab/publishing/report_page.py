"""
An executed notebook to one HTML page by nbconvert: no script, nothing fetched, formulas as MathML.
"""

import contextlib
import csv
import html
import re
import tomllib
from collections.abc import Callable
from itertools import chain, repeat
from pathlib import Path
from typing import Any

from trustlab.models.extras import extra
from trustlab.models.html import policy
from trustlab.publishing.execution import CellError
from trustlab.publishing.figures import IMAGES, image_uri, said_of
from trustlab.publishing.mathml import MathError, to_mathml
from trustlab.publishing.provenance import duration

with extra("reports"):
    from bs4 import BeautifulSoup, Tag
    from nbconvert import HTMLExporter, TemplateExporter
    from nbconvert.filters import Highlight2HTML, strip_ansi
    from nbconvert.filters.markdown_mistune import (
        IPythonRenderer,
        MarkdownWithMath,
        MathInlineParser,
    )
    from nbformat import NotebookNode
    from pygments.formatters import HtmlFormatter
    from traitlets.config import Config

Heading = tuple[int, str, str]  # level, anchor, HTML
TEMPLATES = Path(__file__).parent / "templates"
# Number of headings from which a page has a list of contents.
CONTENTS_FROM = 5

# Forms of an output, the best first: a page shows one of them.
SHOWN = (
    "text/html",
    "text/markdown",
    "text/latex",
    *IMAGES,
    "application/javascript",
    "text/plain",
)

# What a cell that ends with a call of Matplotlib returns: no reader wants to see it.
LEFT_OVER = re.compile(
    r"\[?(<Axes|<matplotlib\.|<Figure|Text\(|\(?array\(\[<Axes|<[\w. ]+ at 0x[0-9a-f]+>)"
)
# $5 and $6 are prices: a dollar that opens a formula is not followed by a space; one that closes it
# is neither preceded by a space nor followed by a digit.
FORMULA = (
    r"(?s:(?<![\\$])\$(?![\s$])"
    r"(?P<math_inline_tex>(?:\\\$|(?!\n\s*\n)[^$`])+?)"
    r"(?<![\s\\])\$(?![\d$]))"
)
FETCHED = ("src", "srcset", "poster", "data", "background", "xlink:href", "action", "formaction")
# A backslash may spell any of the others; within a picture "<" ends a style.
ELSEWHERE = re.compile(r"@import|image-set|\\|<|url\(\s*['\"]?\s*(?!data:|#)", re.IGNORECASE)
# Sought in the text, not in the tree: parsers disagree about what is within a comment or a style.
REFUSED = re.compile(r"<(script|iframe|frame|object|embed|base|meta|link|form)\b", re.IGNORECASE)


class ReportError(CellError):
    """
    A notebook that ran but cannot be published: what is wrong, and the index of its cell where it
    is one cell's.
    """


class _Inline(MathInlineParser):
    SPECIFICATION = MathInlineParser.SPECIFICATION | {"inline_math_tex": FORMULA}


class _Renderer(IPythonRenderer):
    """
    nbconvert's Markdown, with MathML in place of formulas for a script, and anchors that are noted.
    """

    def __init__(self, headings: list[Heading], attachments: dict, folder: str | Path):
        super().__init__(escape=False, embed_images=True, attachments=attachments, path=str(folder))
        self.headings = headings

    def inline_math(self, body: str) -> str:
        return to_mathml(body)

    def block_math(self, body: str) -> str:
        return f'<span class="equation">{to_mathml(body, display=True)}</span>'

    def latex_environment(self, name: str, body: str) -> str:
        return self.block_math(f"\\begin{{{name}}}{body}\\end{{{name}}}")

    def heading(self, text: str, level: int, **_: Any) -> str:
        anchor = slug(plain(text))
        repeated = sum(
            re.fullmatch(re.escape(anchor) + r"(-\d+)?", known) is not None
            for _, known, _ in self.headings
        )
        anchor += f"-{repeated + 1}" if repeated else ""
        self.headings.append((level, anchor, text))
        link = f'<a class="anchor" href="#{anchor}" aria-hidden="true" tabindex="-1">#</a>'
        return f'<h{level} id="{anchor}">{text}{link}</h{level}>\n'


def markdown_html(
    source: str,
    headings: list | None = None,
    attachments: dict | None = None,
    folder: str | Path = "",
) -> str:
    """
    Return Markdown as HTML with formulas and pictures embedded; `headings` gets (level, anchor,
    HTML) of each.
    """
    renderer = _Renderer([] if headings is None else headings, attachments or {}, folder)
    rendered = MarkdownWithMath(renderer, inline=_Inline()).render(source)
    # Browsers would break a line between a formula and the parenthesis or stop beside it.
    return re.sub(r"(?s)\(?<math.*?</math>[).,;:]*", r'<span class="whole">\g<0></span>', rendered)


def output_html(markup: str) -> str:
    """Return an HTML output with its formulas as MathML and its tables in the style of the page."""
    soup = BeautifulSoup(markup, "html.parser")
    for style in soup.select("style[scoped]"):  # pandas sends it along with every table
        style.decompose()
    for text in soup.find_all(string=re.compile(FORMULA)):
        if not text.find_parent(_is_verbatim):
            words = html.escape(str(text), quote=False)
            words = re.sub(FORMULA, lambda found: to_mathml(html.unescape(found[1])), words)
            text.replace_with(BeautifulSoup(words, "html.parser"))
    for image in soup.select("img:not([alt])"):
        image["alt"] = ""
    for table in soup.find_all("table"):
        style_table(table)
        attributes = {"class": "scroll", "tabindex": "0", "role": "region", "aria-label": "table"}
        table.wrap(soup.new_tag("div", attrs=attributes))
    return str(soup)


def _is_verbatim(tag: Tag) -> bool:
    """Whether dollars within an element open no formula."""
    names = ("code", "pre", "style", "script", "textarea", "math")
    return tag.name in names or "tex2jax_ignore" in tag.get_attribute_list("class")


def result(text: str) -> str:
    """Return the text of a cell's last value, or nothing where it is an object of Matplotlib."""
    return "" if LEFT_OVER.match(text) else strip_ansi(text)


class Page:
    """What the template asks for while nbconvert lays out a notebook, cell by cell."""

    def __init__(self, notebook: NotebookNode, name: str, folder: str | Path):
        self.notebook = notebook
        self.name = name
        self.folder = folder
        self.headings: list[Heading] = []
        self.code: list[str] = []  # kept for the fold at the end of its section
        self.answers: list[
            str
        ] = []  # outputs of cells tagged ``answer``, for the box below the title
        self.figures = 0
        self.index: int | None = None
        self.attachments = None

    def __deepcopy__(
        self, memo: dict
    ) -> "Page":  # nbconvert copies what it passes on to the template
        return self

    def enter(self, index: int) -> str:
        """Note which cell is laid out, for errors."""
        self.index = index
        self.attachments = self.notebook.cells[index].get("attachments")
        return ""

    def markdown(self, source: str) -> str:
        """Return Markdown as HTML, its headings noted for the contents."""
        return markdown_html(source, self.headings, self.attachments, self.folder)

    def figure(self, output: NotebookNode) -> dict[str, str]:
        """Return picture, words for who does not see it, and numbered caption of a figure."""
        self.figures += 1
        above = plain(self.headings[-1][2]) if self.headings else "Result"
        words = said_of(output, "alt") or said_of(output, "caption")
        seen = said_of(output, "drawn") or words or f"Figure: {above}"
        return {
            "uri": image_uri(output),
            "alt": seen,
            "caption": f"Figure {self.figures}. {words or above}",
        }

    def fold(self, source: str = "# ") -> str:
        """
        Return the code kept so far, folded, where a section ends: before a heading, and at the end
        of the page.
        """
        if not self.code or not re.match("#{1,3} ", source.lstrip()):
            return ""
        code, self.code = "".join(self.code), []
        return f"<details class='code'><summary>Code of this section</summary>{code}</details>"

    def opened(self, content: str, contents: str) -> str:
        """Return the page's content with the answer and the list of contents below its title."""
        box = (
            f'<section class="answer" aria-label="In short">{"".join(self.answers)}</section>'
            if self.answers
            else ""
        )
        title, end, rest = content.partition("</h1>")
        linked = linker(Path(self.folder), self.name)(f"{box}{contents}{rest or title}")
        return f"{title}{end}{linked}" if end else linked

    def refuse_script(self) -> None:
        """Refuse an output that needs JavaScript."""
        raise MathError(
            "it shows JavaScript, which a report cannot hold; show a figure or a table instead"
        )

    @property
    def title(self) -> str:
        """The text of the first main heading."""
        titles = sorted(self.headings, key=lambda heading: heading[0] != 1)
        return plain(titles[0][2]) if titles else ""

    @property
    def contents(self) -> list[Heading]:
        """
        The headings of levels 2 and 3, where there are enough of them for a table of contents.
        """
        if len(self.headings) < CONTENTS_FROM:
            return []
        listed = [heading for heading in self.headings if heading[0] in (2, 3)]
        return [
            (level, anchor, re.sub(r"</?a\b[^>]*>", "", text)) for level, anchor, text in listed
        ]

    @property
    def thumbnail(self) -> str:
        """The picture of the cell tagged ``thumbnail``, else the first there is, as a data URI."""
        cells = [cell for cell in self.notebook.cells if cell.cell_type == "code"]
        cells.sort(key=lambda cell: "thumbnail" not in cell.metadata.get("tags", []))
        return next(
            (uri for cell in cells for output in cell.outputs if (uri := image_uri(output))), ""
        )

    @property
    def sentence(self) -> str:
        """The first sentence below the title as HTML."""
        first = next(
            (cell.source for cell in self.notebook.cells if cell.cell_type == "markdown"), ""
        )
        paragraphs = re.split(r"\n\s*\n", re.sub(r"(?m)^#.*$", "\n", first).strip())
        words = re.split(
            r"(?<!e\.g\.)(?<!i\.e\.)(?<!\bcf\.)(?<!Fig\.)(?<=[.!?])\s+(?=[A-Z“])", paragraphs[0]
        )[0]
        return re.sub(r"</?(p|a)\b[^>]*>", "", markdown_html(words, folder=self.folder)).strip()


def report_html(
    notebook: NotebookNode,
    name: str,
    origin: dict,
    given: dict | None = None,
    folder: str | Path = "",
) -> tuple[str, dict[str, Any]]:
    """Return an executed notebook as one self-contained page, and what the index shows of it."""
    page = Page(notebook, name, folder)
    filters = {
        "duration": duration,
        "image_uri": image_uri,
        "output_html": output_html,
        "result": result,
    }
    exporter = HTMLExporter(
        template_file="report.html.j2",
        extra_template_paths=[str(TEMPLATES)],
        filters=filters | {"highlight_code": Highlight2HTML(pygments_lexer="ipython3")},
        config=Config({"NbConvertBase": {"display_data_priority": list(SHOWN)}}),
    )
    resources = {"page": page, "name": name, "origin": origin, "given": given or {}}
    resources |= {"css": stylesheet(), "script": script(), "policy": policy(script())}
    try:
        # Not HTMLExporter's own, which would parse the finished page once more for what our
        # template has written already.
        text, _ = TemplateExporter.from_notebook_node(exporter, notebook, resources)
    except MathError as error:
        raise ReportError(str(error), page.index) from error
    check_page(text, "report")
    about = notebook.metadata.get("trustlab", {})
    headline = re.search(r"<strong>(.*?)</strong>", "".join(page.answers), re.DOTALL)
    card = {"title": page.title or name, "sentence": page.sentence, "thumbnail": page.thumbnail}
    card["headline"] = headline[1] if headline else ""
    return text, card | {"data": str(about.get("data", "")), "finding": bool(about.get("finding"))}


def stylesheet() -> str:
    """Return the style sheet of reports and index, with the colours of code."""
    own = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    light, dark = (
        HtmlFormatter(style=style, nobackground=True) for style in ("xcode", "github-dark")
    )
    defs = dark.get_style_defs(".highlight")
    return (
        f"{own}{light.get_style_defs('.highlight')}\n@media screen and (prefers-color-scheme: "
        f"dark) {{{defs}}}"
    )


def script() -> str:
    """
    Return the script of reports and index: tables are sorted, filtered, unfolded and saved, figures
    are explored.
    """
    return "".join(
        (TEMPLATES / name).read_text(encoding="utf-8") for name in ("tables.js", "figures.js")
    )


def page_faults(page: str) -> list[str]:
    """
    Return what the body of a page would run or fetch, one phrase each; nothing where it is complete
    in itself.

    The page's policy keeps browsers from all of it but from loading another page; here the author
    is told.
    """
    # Without its embedded pictures the page is small.
    body = re.sub(
        r"""(["'])data:image/[^"'>]*\1""", '"data:"', page[max(page.find("</head>"), 0) :]
    )
    faults = [f"it has a <{name.lower()}> element" for name in REFUSED.findall(body)]
    for tag in BeautifulSoup(body, "html.parser").find_all(True):
        for name, value in tag.attrs.items():
            value = re.sub(r"[\0-\x20]", "", "".join(value))  # as browsers read addresses
            fetched = name in FETCHED or (name == "href" and tag.name not in ("a", "area"))
            if fetched and value and not value.startswith(("data:", "#")):
                faults.append(f"its <{tag.name}> would fetch {value[:80]!r}; embed it")
            if name.startswith("on") or value.lower().startswith("javascript:"):
                faults.append(f"its <{tag.name}> has a script in {name}")
        if ELSEWHERE.search(f"{tag.get('style', '')} {tag.string if tag.name == 'style' else ''}"):
            faults.append(f"a style of its <{tag.name}> could fetch something")
    return list(dict.fromkeys(faults))


def check_page(page: str, what: str) -> None:
    """Refuse a page that would run or fetch anything."""
    if faults := page_faults(page):
        raise ReportError(f"the {what} would not be self-contained: {'; '.join(faults)}")


NUMBER = re.compile(
    r"[<>]?\s*[-+\u2212]?(\d[\d,\u202f ]*)?\.?\d*([eE][-+]?\d+)?\s*%?"
    r"|nan|NaN|<NA>|[-+]?inf|\u2013|-"
)
P_VALUE = re.compile(
    r"p|p, .*|mauchly_p"
    r"|p[ _](gg|hf|holm|bonferroni|corrected|adjusted|uncorrected|value|mauchly|anova|friedman"
    r"|mixed|shapiro_least|simulated|chi2)"
)
LEAST_P = 0.001
# Significant digits that are shown as they are; of more, one less than that is shown.
MOST_DIGITS = 6

# Characters from which the text of a cell, and of a row's head, goes over several lines.
LONG = {"td": 60, "th": 30}

# Names in code, and what stands in a cell (td), or also heads a row or a column (th), instead.
WORDS = tomllib.loads((TEMPLATES / "columns.toml").read_text(encoding="utf-8"))


def style_table(table: Tag) -> None:
    """Head a table by words, and mark and write its numbers."""
    heads = [row for row in table.find_all("tr") if row.find("th") and not row.find("td")]
    # pandas writes the names of the rows below those of the columns, in a row that is empty but for
    # them.
    if len(heads) > 1 and not heads[-1].find_all("th")[-1].get_text(strip=True):
        _join_names(heads[-2], heads.pop())
    names = [name.get_text(strip=True) for name in heads[-1].find_all("th")] if heads else []
    for row in table.find_all("tr"):
        # From the right, as the first cells of a row may be those of a row above.
        for cell, name in zip(
            reversed(row.find_all(["th", "td"])), chain(reversed(names), repeat("")), strict=False
        ):
            _write_cell(cell, P_VALUE.fullmatch(name) is not None)
    first = next(
        (row.find_all(["th", "td"]) for row in table.find_all("tr") if row not in heads), []
    )
    for head in heads if not table.select("thead [colspan]") else heads[-1:]:
        for title, cell in zip(reversed(head.find_all("th")), reversed(first), strict=False):
            if "number" in cell.get_attribute_list("class"):
                _mark(title, "number")
    for cell in table.find_all(["th", "td"]):
        code = cell.get_text()
        if words := (WORDS["td"] | WORDS[cell.name]).get(code):
            cell["title"] = code
            cell["data-value"] = code
            cell.string = words


def _join_names(above: Tag, last: Tag) -> None:
    """Put the names of the rows into the row of the head above them."""
    for name, cell in zip(last.find_all("th"), above.find_all("th"), strict=False):
        if words := name.get_text(strip=True):
            of_columns = cell.get_text(strip=True)
            cell.string = f"{words}, by {of_columns}" if of_columns else words
    last.decompose()


def _write_cell(cell: Tag, is_p: bool) -> None:
    """Mark a cell by what is in it, and write a number as papers do."""
    text = cell.get_text(strip=True)
    if len(text) > LONG[cell.name]:
        _mark(cell, "long")
    elif cell.name == "td" and NUMBER.fullmatch(text):
        _mark(cell, "number")
        if (written := _as_papers_write(text, is_p)) != text:
            cell["data-value"], cell.string = text, written


def _as_papers_write(text: str, is_p: bool) -> str:
    """
    Return a p-value with three decimals or as a bound, a long fraction rounded, a zero without a
    minus, and a dash for no value.
    """
    with contextlib.suppress(ValueError):
        if is_p and float(text) < LEAST_P:
            return "< .001"
        if is_p and re.fullmatch(r"0?\.\d{4,}", text):  # what has fewer is as it was printed
            return f"{float(text):.3f}".removeprefix("0")
        digits = re.sub(r"[eE].*|\D", "", text).lstrip("0")
        if re.search("[.e]", text) and len(digits) > MOST_DIGITS:
            return f"{float(text):.{MOST_DIGITS - 1}g}"
    return re.sub(r"^(nan|NaN|<NA>)$", "\u2013", re.sub(r"^[-\u2212](?=0(\.0*)?$)", "", text))


def _mark(cell: Tag, name: str) -> None:
    cell["class"] = " ".join(filter(None, [*cell.get_attribute_list("class"), name]))


LINKABLE = re.compile(
    r"(?s)<(?:a|pre|code|math|h\d)\b.*?</(?:a|pre|code|math|h\d)>|<[^>]*>"
    r"|\b[Rr]eport (?P<report>\d\d)\b|\((?P<equation>[2-4A]\.\d+)\)"
    # A figure or table is linked where a cell or paragraph begins with it: in a list of places, not
    # in running prose.
    r"|(?<=>)(?:Section [\d.]+, )?(?P<entry>(?:Fig\.|Table) \d\.\d+)(?=\W)"
)


def plain(markup: str) -> str:
    """Return the text of markup, each formula as its LaTeX."""
    markup = re.sub(r'<math[^>]*alttext="([^"]*)".*?</math>', r"\1", markup, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", "", markup)).split())


def slug(words: str) -> str:
    """Return the anchor of a heading that has these words."""
    return re.sub(r"\W+", "-", words.lower()).strip("-") or "section"


def read_finder(notebooks: Path) -> list[dict[str, str]]:
    """
    Return what became of each figure, table, theorem and study, with the address of the section
    that shows it.
    """
    listed = notebooks / "finder.csv"
    if not listed.is_file():
        return []
    with listed.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        row | {"link": row["report"] and f"{row['report']}.html#{slug(row['section'])}"}
        for row in rows
    ]


def read_equations(notebooks: Path) -> dict[str, dict[str, str]]:
    """Return the dissertation's equations by number."""
    listed = notebooks.parent / "data" / "published" / "equations.toml"
    return tomllib.loads(listed.read_text(encoding="utf-8")) if listed.is_file() else {}


def linker(notebooks: Path, name: str) -> Callable[[str], str]:
    """
    Return what links, in the markup of the page `name`, what it names; places on the page itself
    are not linked.
    """
    reports = {path.name[:2]: f"{path.stem}.html" for path in notebooks.glob("[0-9][0-9]_*.ipynb")}
    equations = {
        number: f"index.html#eq-{number.replace('.', '-')}" for number in read_equations(notebooks)
    }
    shown = {row["entry"]: row["link"] for row in read_finder(notebooks)}

    def link(match: re.Match[str]) -> str:
        known = {"report": reports, "equation": equations, "entry": shown}.get(
            match.lastgroup or "", {}
        )
        address = known.get(match[match.lastgroup] if match.lastgroup else "", "")
        return (
            f'<a href="{address}">{match[0]}</a>'
            if address and not address.startswith(f"{name}.")
            else match[0]
        )

    return lambda markup: LINKABLE.sub(link, markup)
