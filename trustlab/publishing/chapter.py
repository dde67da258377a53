"""An executed notebook as a chapter: its answer first, figures with captions and words, origin."""

import html
import re
from pathlib import Path

from trustlab.models.extras import extra

with extra("reports"):
    import nbformat
    from nbformat import NotebookNode
    from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

PICTURES = {"image/svg+xml", "image/png"}
WORDS = ("text/markdown", "text/html")
# HTML, as it shows in JupyterLab, too.
BOX = '<section class="answer" aria-label="In short">\n\n{}\n\n</section>'
# Code, formulas and tags, which stay as they are; a minus and a percent sign of a number, but for
# "95% CI", as papers print it.
TYPED = re.compile(r"(`[^`]*`|\$[^$]*\$|<\w[^>]*>)|(?<![\w.)-])-(?=\d)|(?<=\d)\s?%(?!\d| CI)")
CAPTION = re.compile("<caption>(.*?)</caption>", re.DOTALL)
# What nobody wants to read: what a call of Matplotlib returns, and that a function was compiled.
NOISE = re.compile(
    r"\[?\(?(<Axes|<matplotlib|<Figure|Text\(|array\(\[<Axes|<[\w. ]+ at 0x)|trustlab is compiling"
)


def chapter(run: NotebookNode, origin: dict[str, str]) -> str:
    """Lay out an executed notebook for the book: its answer first, and at its end its origin."""
    title, *cells = run.cells
    boxes, body = [], []
    for cell in cells:
        if cell.cell_type != "code":
            cell.source = typeset(cell.source)
            body.append(cell)
        elif "answer" in cell.metadata.tags:
            shown = [output.get("data", {}) for output in cell.outputs]
            words = [data[kind] for data in shown for kind in WORDS if kind in data]
            boxes += [new_markdown_cell(BOX.format(typeset(answer))) for answer in words]
        else:
            for part in _parts(cell):
                # Code that shows nothing is folded with the code after it.
                if body and _folds(part) and _folds(body[-1]) and not body[-1].outputs:
                    part.source = f"{body.pop().source}\n\n{part.source}"
                body.append(part)
    rows = "\n".join(f"| {name} | `{value}` |" for name, value in origin.items())
    end = f"## Provenance\n\n| of | this report |\n| --- | --- |\n{rows}"
    about = {"language_info": {"name": "python", "pygments_lexer": "ipython3"}}
    cells = [title, *boxes, *body, new_markdown_cell(end)]
    return nbformat.writes(new_notebook(cells=cells, metadata=about))


def typeset(text: str) -> str:
    """Return prose whose numbers have minus signs, and stay on a line with their percent sign."""
    return TYPED.sub(lambda sign: sign[1] or ("−" if sign[0] == "-" else "\u00a0%"), text)


def empty_chapter(path: Path, words: str, failure: str = "") -> str:
    """Return the chapter of a notebook that has no results: its title, why, and its failure."""
    title = nbformat.read(path, as_version=4).cells[0].source.partition("\n")[0]
    code = f"```````text\n{failure}\n```````" if failure else ""
    text = "\n\n".join([title, BOX.format(words), code])
    return nbformat.writes(new_notebook(cells=[new_markdown_cell(text)]))


def _parts(cell: NotebookNode) -> list[NotebookNode]:
    """Return a cell as cells whose figures and tables stand alone: a caption belongs to a cell."""
    cell.metadata.tags.append("remove-input" if "hide" in cell.metadata.tags else "hide-input")
    outputs, cell.outputs = cell.outputs, []
    parts = [cell]
    for output in outputs:
        data = output.get("data", {"text/plain": output.get("text", "")})
        data |= {kind: typeset(data[kind]) for kind in WORDS if kind in data}
        if shown := _shown(output, data):
            parts += [_silent([output], mystnb=shown), _silent([])]
        elif len(data) > 1 or not NOISE.match(data.get("text/plain", "")):
            parts[-1].outputs.append(output)
    return [part for part in parts if part.outputs or _folds(part)]


def _shown(output: NotebookNode, data: dict[str, str]) -> dict[str, dict]:
    """Return how a picture, or a table with a caption, is shown; nothing for other outputs."""
    for kind in PICTURES & set(data):
        words = output.metadata.get(kind, {}).get("caption", "").split()
        caption = typeset(" ".join(words)) or "Result of this section."
        return {"image": {"alt": caption}, "figure": {"caption": caption}}
    table = CAPTION.search(data.get("text/html", ""))
    if table is None:
        return {}
    data["text/html"] = CAPTION.sub("", data["text/html"], 1)
    text = html.unescape(table[1])
    return {"figure": {"caption": text, "caption_before": True, "classes": "captioned-table"}}


def _silent(outputs: list[NotebookNode], **metadata: dict) -> NotebookNode:
    # MyST-NB passes over a cell without a source.
    return new_code_cell("...", outputs=outputs, metadata={"tags": ["remove-input"], **metadata})


def _folds(cell: NotebookNode) -> bool:
    return "hide-input" in cell.metadata.get("tags", [])
