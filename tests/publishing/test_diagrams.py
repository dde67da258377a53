"""Block diagrams of the primers: no text is cut, crossed or covered, and all are large enough."""

import inspect
from itertools import combinations, pairwise

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Circle, FancyBboxPatch
from matplotlib.transforms import Bbox

from notebooks import diagrams

PICTURES = [
    draw
    for _, draw in inspect.getmembers(diagrams, inspect.isfunction)
    if draw.__module__ == diagrams.__name__
]


def touching(diagram):
    """What touches what: texts each other, the edges of blocks, wires, and the edge of the page."""
    page = FigureCanvasAgg(diagram.figure).get_renderer()
    boxes = {
        f"{text.get_text()} {i}": text.get_window_extent(page)
        for i, text in enumerate(diagram.axis.texts)
        if text.get_text()
    }
    found = [(a, b) for a, b in combinations(boxes, 2) if boxes[a].overlaps(boxes[b])]
    blocks = [p for p in diagram.axis.patches if isinstance(p, FancyBboxPatch | Circle)]
    for name, box in boxes.items():
        if Bbox.intersection(box, diagram.figure.bbox).bounds != box.bounds:
            found.append((name, "the page"))
        for block in blocks:
            edge = block.get_window_extent(page)
            if box.overlaps(edge) and Bbox.intersection(box, edge).bounds != box.bounds:
                found.append((name, "the edge of a block"))
        for line in diagram.axis.lines:
            ends = line.get_transform().transform(line.get_path().vertices)
            legs = pairwise(ends)
            if any(box.overlaps(Bbox([a, b]).padded(0.5)) for a, b in legs):
                found.append((name, "a wire"))
    return found


@pytest.mark.parametrize("draw", PICTURES, ids=lambda draw: draw.__name__)
def test_nothing_touches_a_text(draw):
    diagram = draw()
    assert touching(diagram) == []
    assert min(text.get_fontsize() for text in diagram.axis.texts) >= 9.0
    assert diagram.figure.get_figwidth() <= 6.5


def test_what_touches_is_found():
    diagram = diagrams.Diagram(1.0, 3.0)
    diagram.block("a", "A", 0.7, 0.5)
    diagram.block("b", "B", 2.3, 0.5)
    diagram.signal("$u$", "a.e", "b.w")
    assert touching(diagram) == []
    diagram.text("across", 1.0, 0.45)
    assert {what for _, what in touching(diagram)} == {"the edge of a block", "a wire"}
