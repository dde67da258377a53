"""Pictures in a report: embedded, with what they show in words, read from the drawing."""

import base64
import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterator
from xml.etree import ElementTree

from trustlab.models.extras import extra
from trustlab.publishing.figures import CAPTION_ID

with extra("reports"):
    from nbformat import NotebookNode

IMAGES = ("image/svg+xml", "image/png", "image/jpeg")
GREEK = ("alpha", "beta", "gamma", "delta", "zeta", "theta", "mu", "sigma", "tau", "phi", "omega")
GROUP = re.compile(r"<g\b[^>]*>|</g>")


def image_uri(output: NotebookNode) -> str:
    """Return an output's picture as a data URI, or an empty string; its caption stands below it on the page."""
    data = output.get("data", {})
    kind = next((kind for kind in IMAGES if kind in data), None)
    if kind is None:
        return ""
    if "svg" not in kind:
        return f"data:{kind};base64,{''.join(data[kind].split())}"
    before, _, after = around_caption(data[kind])
    return f"data:{kind};base64,{base64.b64encode((before + after).encode()).decode()}"


def around_caption(svg: str) -> tuple[str, str, str]:
    """Return what stands before a figure's caption, the caption with all groups inside it, and what comes after."""
    start, depth = svg.find(f'<g id="{CAPTION_ID}">'), 0
    for tag in GROUP.finditer(svg, start) if start >= 0 else ():
        depth += -1 if tag[0] == "</g>" else not tag[0].endswith("/>")
        if depth == 0:
            return svg[:start], svg[start : tag.end()], svg[tag.end() :]
    return svg, "", ""


def given_words(output: NotebookNode) -> str:
    """Return what the author says that a picture shows: by its metadata, or by `caption`; else nothing."""
    given = [output.metadata, *(output.metadata.get(kind, {}) for kind in IMAGES)]
    words = next((entry["alt"] for entry in given if entry.get("alt")), "")
    if not words:
        # Matplotlib writes each line of text as a comment beside its outlines
        drawn = around_caption(output.data.get("image/svg+xml", ""))[1]
        words = " ".join(re.findall(r"<!--(.*?)-->", drawn, re.DOTALL))
    return " ".join(words.split())


def drawn_words(output: NotebookNode) -> str:
    """Return what one sees in a figure of Matplotlib: its panels, their axes, and what is drawn in them; else nothing."""
    try:
        parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
        root = ElementTree.fromstring(output.data.get("image/svg+xml", ""), parser)
    except ElementTree.ParseError:
        return ""
    panels: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for panel, part, words in _texts(root, "", ""):
        if words not in panels[panel][part]:
            panels[panel][part].append(words)
    axes = [found for panel, found in panels.items() if panel]
    told = [_panel_words(found) for found in axes if set(found) - {"text"} or len(axes) == 1]
    count = f"{len(told)} panels. " if len(told) > 1 else ""
    return count + " ".join(dict.fromkeys(filter(None, told)))


def _texts(element: ElementTree.Element, panel: str, part: str) -> Iterator[tuple[str, str, str]]:
    """Yield panel, part of it, and words of every text that is drawn; ticks are left out."""
    for child in element:
        if child.tag is ElementTree.Comment:
            words = re.sub(r"\\([A-Za-z]+)", _greek, child.text or "")
            words = re.sub(r"[${}\\]", "", words).strip()
            if words:
                yield panel, part or "text", words
            continue
        name = child.get("id", "")
        axis = re.fullmatch(r"matplotlib\.axis_(\d+)", name)
        if name.startswith(("xtick", "ytick", CAPTION_ID)):
            continue
        inner = ("x", "y")[int(axis[1]) % 2 == 0] if axis else "legend" if name.startswith("legend") else part
        yield from _texts(child, name if name.startswith("axes_") else panel, inner)


def _greek(command: re.Match[str]) -> str:
    """Return the letter that a command of mathematics writes, or nothing."""
    return unicodedata.lookup(f"GREEK SMALL LETTER {command[1]}") if command[1] in GREEK else ""


def _panel_words(found: dict[str, list[str]]) -> str:
    """Return one panel in a sentence: title, axes, legend."""
    axes = " against ".join(" ".join(found[part]) for part in ("y", "x") if part in found)
    legend = f"showing {', '.join(found['legend'])}" if "legend" in found else ""
    title = " ".join(found["text"][-1:])
    return "; ".join(filter(None, (title, axes, legend))) + "." if axes or legend or title else ""
