"""An executed notebook to one HTML page: no script, nothing fetched, formulas as MathML."""

import base64
import html
import re
from pathlib import Path

from trustlab.publishing.figures import CAPTION_ID
from trustlab.publishing.mathml import MathError, MathMask, equation_html
from trustlab.publishing.page_check import page_faults

__all__ = ["ReportError", "markdown_html", "report_html"]

TEMPLATES = Path(__file__).parent / "templates"
HIDDEN = {"hide", "hide-input", "hide_input", "remove-input", "remove_input"}
TOC_FROM = 5
PRIORITY = (
    "text/html",
    "text/markdown",
    "image/svg+xml",
    "text/latex",
    "image/png",
    "image/jpeg",
    "text/plain",
)
NOISE = re.compile(r"^\[?(<Axes|<matplotlib\.|<Figure|Text\(|\(?array\(\[<Axes)|^\[?<[\w. ]+ at 0x[0-9a-f]+>")
ANSI = re.compile(r"\x1b\[[0-9;?]*[ -/]*[@-~]")


class ReportError(ValueError):
    """A notebook that ran but cannot be published.

    Parameters
    ----------
    words : str
        What is wrong and what to change.
    cell : int, optional
        Index of the cell in the executed notebook, where it is one cell's fault.
    """

    def __init__(self, words, cell=None):
        super().__init__(words)
        self.cell = cell


def _plain(markup):
    """Return the text of markup, each formula as its LaTeX."""
    markup = re.sub(r'<math[^>]*alttext="([^"]*)".*?</math>', r"\1", markup, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", "", markup)).split())


def _slug(text, taken):
    slug = re.sub(r"[^\w]+", "-", text.lower()).strip("-") or "section"
    number = sum(slug == one or re.fullmatch(re.escape(slug) + r"-\d+", one) is not None for one in taken)
    return f"{slug}-{number + 1}" if number else slug


def markdown_html(source, headings=None, attachments=None, folder=""):
    """Return Markdown as HTML, its formulas as MathML and its pictures embedded.

    Parameters
    ----------
    source : str
        The Markdown.
    headings : list, optional
        Gets a tuple of level, anchor and HTML for every heading.
    attachments : dict, optional
        Attachments of the cell.
    folder : path-like
        Where relative paths of pictures start.

    Returns
    -------
    str
        HTML.

    Raises
    ------
    MathError
        If a formula cannot be converted.
    """
    import mistune
    from nbconvert.filters.markdown_mistune import IPythonRenderer

    headings = [] if headings is None else headings
    mask = MathMask(source)

    class Renderer(IPythonRenderer):
        def codespan(self, text):
            return super().codespan(mask.as_written(text))

        def block_code(self, code, info=None):
            return super().block_code(mask.as_written(code), info)

        def image(self, text, url, title=None):
            return super().image(mask.as_written(text), mask.as_written(url), title)

        def heading(self, text, level, **_):
            text = mask.as_mathml(text)
            anchor = _slug(_plain(text), [one for _, one, _ in headings])
            headings.append((level, anchor, text))
            return f'<h{level} id="{anchor}">{text}<a class="anchor" href="#{anchor}" aria-hidden="true">#</a></h{level}>\n'

    renderer = Renderer(escape=False, embed_images=True, attachments=attachments or {}, path=str(folder))
    plugins = ["table", "strikethrough", "footnotes", "url", "def_list", "task_lists"]
    return mask.as_mathml(mistune.create_markdown(renderer=renderer, plugins=plugins)(mask.text))


def _latex_html(text):
    """Return a LaTeX output: a formula, or words with formulas among them."""
    mask = MathMask(text)
    if not mask.formulas:
        return f"<p>{equation_html(text)}</p>"
    return f"<p>{mask.as_mathml(html.escape(mask.text))}</p>"


def _html_output(markup):
    """Return an HTML output with the formulas in its text as MathML and without the styles pandas sends along."""
    from bs4 import BeautifulSoup

    soup = BeautifulSoup(markup, "html.parser")
    for style in soup.select("style[scoped]"):
        style.decompose()
    for text in soup.find_all(string=lambda words: "$" in words):
        if any(
            parent.name in ("code", "pre", "style", "script", "textarea", "math") for parent in text.parents
        ):
            continue
        mask = MathMask(str(text))
        if mask.formulas:
            text.replace_with(
                BeautifulSoup(mask.as_mathml(html.escape(mask.text, quote=False)), "html.parser")
            )
    for image in soup.select("img:not([alt])"):
        image["alt"] = ""
    return str(soup)


def _alt(output, kind, data, heading):
    """Return what a figure shows, in words: from its metadata, its caption, or the heading it stands under."""
    given = output.metadata.get("alt") or output.metadata.get(kind, {}).get("alt")
    if not given and kind == "image/svg+xml":
        group = re.search(rf'<g id="{CAPTION_ID}">(.*?)</g>\s*(?:</g>|</svg>)', data, re.DOTALL)
        given = " ".join(re.findall(r"<!--(.*?)-->", group[1], re.DOTALL)) if group else ""
    return " ".join((given or f"Figure: {heading}").split())


def _image(output, heading):
    """Return the data URI and the alternative text of an output's image, or None."""
    for kind in ("image/svg+xml", "image/png", "image/jpeg"):
        if kind in output.get("data", {}):
            data = output.data[kind]
            encoded = (
                base64.b64encode(data.encode()).decode() if kind == "image/svg+xml" else "".join(data.split())
            )
            return f"data:{kind};base64,{encoded}", _alt(output, kind, data, heading)
    return None


def _output_html(output, heading, with_image):
    """Return one output as HTML, or an empty string where there is nothing to see."""
    if output.output_type == "stream":
        text = html.escape(ANSI.sub("", output.text).rstrip())
        if output.name == "stderr":
            return f'<aside class="note"><span>note on standard error</span><pre>{text}</pre></aside>'
        return f"<pre>{text}</pre>" if text else ""
    if output.output_type == "error":
        return f"<pre>{html.escape(ANSI.sub('', chr(10).join(output.traceback)))}</pre>"
    data = output.data
    kind = next((kind for kind in PRIORITY if kind in data), None)
    if "application/javascript" in data and kind in (None, "text/plain"):
        raise MathError("it shows JavaScript, which a report cannot hold; show a figure or a table instead")
    if kind == "text/html":
        return _html_output(data[kind])
    if kind == "text/markdown":
        return markdown_html(data[kind])
    if kind == "text/latex":
        return _latex_html(data[kind])
    if kind == "text/plain":
        if with_image and NOISE.match(data[kind]):
            return ""
        return f"<pre>{html.escape(ANSI.sub('', data[kind]))}</pre>"
    if kind is None:
        return ""
    source, alt = _image(output, heading)
    return f'<figure><img src="{source}" alt="{html.escape(alt)}"></figure>'


def _cells(notebook, folder, headings):
    """Return the cells as dicts for the template."""
    found, heading = [], "result"
    for index, cell in enumerate(notebook.cells):
        tags = set(cell.metadata.get("tags", []))
        try:
            if cell.cell_type == "markdown":
                body = markdown_html(cell.source, headings, cell.get("attachments"), folder)
                heading = _plain(headings[-1][2]) if headings else heading
                found.append({"kind": "markdown", "body": body})
            elif cell.cell_type == "code":
                with_image = any(_image(output, heading) for output in cell.outputs)
                outputs = [_output_html(output, heading, with_image) for output in cell.outputs]
                outputs = [_tables(output) for output in outputs if output]
                source = "" if tags & HIDDEN or "injected-parameters" in tags else cell.source.strip()
                found.append({"kind": "code", "tags": tags, "source": source, "outputs": outputs})
        except MathError as error:
            raise ReportError(str(error), index) from error
    return found


def _tables(markup):
    """Return HTML whose tables scroll within the page and whose columns of numbers line up."""
    from bs4 import BeautifulSoup

    if "<table" not in markup:
        return markup
    number = re.compile(
        r"(?:[<>]\s*)?[-+\u2212]?(\d[\d,\u202f ]*)?\.?\d*([eE][-+]?\d+)?\s*%?|nan|NaN|[-+]?inf|\u2013|-"
    )
    soup = BeautifulSoup(markup, "html.parser")
    for table in soup.find_all("table"):
        for old in ("border", "style"):
            table.attrs.pop(old, None)
        for row in table.find_all("tr"):
            row.attrs.pop("style", None)
        for cell in table.find_all("td"):
            if number.fullmatch(cell.get_text(strip=True)):
                cell["class"] = [*cell.get("class", []), "number"]
        body = [row for row in table.find_all("tr") if row.find("td")]
        heads = [row for row in table.find_all("tr") if not row.find("td")]
        if body:
            numeric = ["number" in cell.get("class", []) for cell in body[0].find_all(["td", "th"])]
            for row in heads:
                names = row.find_all("th")
                if len(names) == len(numeric) and not any(name.get("colspan") for name in names):
                    for name, right in zip(names, numeric, strict=True):
                        name["class"] = [*name.get("class", []), *(["number"] if right else [])]
        table.wrap(soup.new_tag("div", attrs={"class": "scroll", "tabindex": "0"}))
    return str(soup)


def _sentence(notebook, folder):
    """Return the HTML of the sentence that stands for the report in the index."""
    given = notebook.metadata.get("trustlab", {}).get("sentence")
    paragraphs = [given] if given else []
    for cell in notebook.cells if not given else []:
        if cell.cell_type == "markdown":
            blocks = re.split(r"\n[ \t]*\n", re.sub(r"(?m)^(#.*)$", r"\1\n", cell.source))
            paragraphs += [block.strip() for block in blocks if re.match(r"\s*[\w*_\[`$(\"“]", block)]
            if paragraphs:
                break
    if not paragraphs:
        return ""
    mask = MathMask(paragraphs[0])
    end = (
        r"(?<!e\.g\.)(?<!i\.e\.)(?<!\bcf\.)(?<!\bvs\.)(?<!Fig\.)(?<!Sec\.)(?<!Eq\.)(?<=[.!?])\s+(?=[A-Z\"“])"
    )
    first = mask.as_written(re.split(end, mask.text, maxsplit=1)[0])
    return re.sub(r"</?(p|a)\b[^>]*>", "", markdown_html(first, folder=folder)).strip()


def _thumbnail(notebook):
    """Return a small picture as a data URI: of the cell tagged ``thumbnail``, else the first there is."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    for cell in sorted(cells, key=lambda cell: "thumbnail" not in cell.metadata.get("tags", [])):
        for output in cell.outputs:
            found = _image(output, "")
            if found:
                return found[0] if "svg" in found[0][:20] else shrink(found[0])
    return ""


def shrink(uri, width=640):
    """Return a picture made small.

    Parameters
    ----------
    uri : str
        A PNG or JPEG as a data URI.
    width : int
        Greatest width, pixels.

    Returns
    -------
    str
        A PNG as a data URI.
    """
    from io import BytesIO

    from PIL import Image

    picture = Image.open(BytesIO(base64.b64decode(uri.partition(",")[2]))).convert("RGBA")
    picture.thumbnail((width, width))
    white = Image.new("RGBA", picture.size, "white")
    white.alpha_composite(picture)
    small = BytesIO()
    white.convert("RGB").save(small, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(small.getvalue()).decode()


def duration(seconds):
    """Return a time taken as people write it.

    Parameters
    ----------
    seconds : float
        The time, s.

    Returns
    -------
    str
        ``"0.8 s"``, ``"12.3 s"``, ``"3 min 07 s"``.
    """
    if round(seconds, 1) < 60:
        return f"{seconds:.1f} s"
    return f"{round(seconds) // 60} min {round(seconds) % 60:02d} s"


def report_html(notebook, name, origin, given=None, folder=""):
    """Return an executed notebook as one self-contained page, and what the index shows of it.

    Parameters
    ----------
    notebook : nbformat.NotebookNode
        The executed notebook.
    name : str
        Name of the report.
    origin : dict
        What `trustlab.publishing.provenance.provenance` returns.
    given : dict, optional
        Parameters given for this run.
    folder : path-like
        Where relative paths of pictures start.

    Returns
    -------
    tuple of str and dict
        The HTML; ``title``, ``sentence`` (HTML) and ``thumbnail`` (a data URI, or empty).

    Raises
    ------
    ReportError
        If a formula cannot be shown, or the page would need a script or the network.
    """
    from nbconvert import HTMLExporter
    from traitlets.config import Config

    headings = []
    cells = _cells(notebook, folder, headings)
    title = next((_plain(text) for level, _, text in headings if level == 1), None)
    title = title or (_plain(headings[0][2]) if headings else name)
    toc = [one for one in headings if one[0] in (2, 3)] if len(headings) >= TOC_FROM else []
    toc = [(level, anchor, re.sub(r"</?a\b[^>]*>", "", text)) for level, anchor, text in toc]
    exporter = HTMLExporter(
        template_name="report",
        extra_template_basedirs=[str(TEMPLATES)],
        config=Config({"HTMLExporter": {"embed_images": True}}),
    )
    exporter.register_filter("duration", duration)
    resources = {
        "page": {
            "name": name,
            "title": title,
            "toc": toc,
            "cells": cells,
            "origin": origin,
            "given": given or {},
            "css": stylesheet(),
        }
    }
    page, _ = exporter.from_notebook_node(notebook, resources)
    faults = page_faults(page)
    if faults:
        raise ReportError("the report would not be self-contained: " + "; ".join(faults))
    return page, {"title": title, "sentence": _sentence(notebook, folder), "thumbnail": _thumbnail(notebook)}


def stylesheet():
    """Return the style sheet of reports and index, with the colours of code.

    Returns
    -------
    str
        CSS.
    """
    from pygments.formatters import HtmlFormatter

    own = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    return own + HtmlFormatter(style="friendly", nobackground=True).get_style_defs(".highlight")
