"""An executed notebook as a chapter: its answer first, figures with captions and words, origin."""

import html
import re
from collections.abc import Iterator
from pathlib import Path

from trustlab.models.extras import extra

with extra("reports"):
    import nbformat
    from nbformat import NotebookNode
    from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

PICTURES = ("image/svg+xml", "image/png")
# What nobody wants to read: what a call of Matplotlib returns, and that a function was compiled.
NOISE = re.compile(r"\[?\(?(<Axes|<matplotlib|<Figure|Text\(|array\(\[<Axes|<[\w. ]+ at 0x)")
# HTML, as it shows in JupyterLab, too.
BOX = '<section class="answer" aria-label="In short">\n\n{}\n\n</section>'
COMPILING = "trustlab is compiling"
CAPTION = re.compile("<caption>(.*?)</caption>", re.DOTALL)


def chapter(run: NotebookNode, origin: dict[str, str]) -> str:
    """Lay out an executed notebook for the book: its answer first, and at its end its origin."""
    title, *cells = run.cells
    answers = []
    body = []
    for cell in cells:
        if cell.cell_type != "code":
            body.append(cell)
            continue
        tags = cell.metadata.setdefault("tags", [])
        outputs = [output for output in cell.outputs if not _noise(output)]
        if "answer" in tags:
            kinds = ("text/markdown", "text/html")
            answers += [
                output.data[kind] for output in outputs for kind in kinds if kind in output.data
            ]
            outputs = []
        if "injected-parameters" in tags:
            body.append(new_markdown_cell("Parameters given for this run:"))
        else:
            tags.append("remove-input" if "hide" in tags else "hide-input")
        body += _split(cell, outputs)
    boxes = [new_markdown_cell(BOX.format(answer)) for answer in answers]
    rows = "\n".join(f"| {name} | `{value}` |" for name, value in origin.items())
    end = f"## Provenance\n\n| of | this report |\n| --- | --- |\n{rows}"
    cells = [title, *boxes, *_joined(body), new_markdown_cell(end)]
    about = {"language_info": {"name": "python", "pygments_lexer": "ipython3"}}
    return nbformat.writes(new_notebook(cells=cells, metadata=about))


def empty_chapter(path: Path, words: str, failure: str = "") -> str:
    """Return the chapter of a notebook that has no results: its title, why, and its failure."""
    first = nbformat.read(path, as_version=4).cells[:1]
    title = next((cell.source.partition("\n")[0] for cell in first), f"# {path.stem}")
    code = f"```````text\n{failure}\n```````" if failure else ""
    text = "\n\n".join([title, BOX.format(words), code])
    return nbformat.writes(new_notebook(cells=[new_markdown_cell(text)]))


def _noise(output: NotebookNode) -> bool:
    if output.output_type == "stream":
        return output.name == "stderr" and output.text.startswith(COMPILING)
    data = output.get("data", {})
    return set(data) == {"text/plain"} and NOISE.match(data["text/plain"]) is not None


def _split(cell: NotebookNode, outputs: list[NotebookNode]) -> Iterator[NotebookNode]:
    """Yield a cell as cells whose figures and tables stand alone: a caption belongs to a cell."""
    cell.outputs = []
    for output in outputs:
        shown = _shown(output)
        if not shown:
            cell.outputs.append(output)
            continue
        if cell.outputs or "remove-input" not in cell.metadata["tags"]:
            yield cell
        yield _silent([output], mystnb=shown)
        cell = _silent([])
    if cell.outputs or "remove-input" not in cell.metadata["tags"]:
        yield cell


def _joined(cells: list[NotebookNode]) -> list[NotebookNode]:
    """Return cells where code without outputs is folded with the code after it."""
    joined: list[NotebookNode] = []
    for cell in cells:
        before = joined[-1] if joined else cell
        folded = all("hide-input" in each.metadata.get("tags", []) for each in (before, cell))
        if before is not cell and folded and not before.outputs:
            joined.pop()
            cell.source = f"{before.source}\n\n{cell.source}"
        joined.append(cell)
    return joined


def _silent(outputs: list[NotebookNode], **metadata: dict) -> NotebookNode:
    # MyST-NB passes over a cell without a source.
    return new_code_cell("...", outputs=outputs, metadata={"tags": ["remove-input"], **metadata})


def _shown(output: NotebookNode) -> dict[str, dict]:
    """Return how a picture, or a table with a caption, is shown; nothing for other outputs."""
    data = output.get("data", {})
    kind = next((kind for kind in PICTURES if kind in data), None)
    if kind:
        about = output.metadata.get(kind, {})
        caption = " ".join(about.get("caption", "").split()) or "Result of this section."
        return {"image": {"alt": caption}, "figure": {"caption": caption}}
    said = CAPTION.search(data.get("text/html", ""))
    if said is None:
        return {}
    data["text/html"] = CAPTION.sub("", data["text/html"], 1)
    text = html.unescape(said[1])
    return {"figure": {"caption": text, "caption_before": True, "classes": "captioned-table"}}
