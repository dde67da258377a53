"""Pictures in a report: embedded, with what they show in words."""

import base64

from trustlab.models.extras import extra

with extra("reports"):
    from nbformat import NotebookNode

IMAGES = ("image/svg+xml", "image/png", "image/jpeg")


def image_uri(output: NotebookNode) -> str:
    """Return an output's picture as a data URI, or an empty string."""
    data = output.get("data", {})
    kind = next((kind for kind in IMAGES if kind in data), None)
    if kind is None:
        return ""
    if "svg" not in kind:
        return f"data:{kind};base64,{''.join(data[kind].split())}"
    return f"data:{kind};base64,{base64.b64encode(data[kind].encode()).decode()}"


def said_of(output: NotebookNode, what: str) -> str:
    """Return what is noted with a picture: its author's words, "alt"; its "caption"; or "drawn", what one sees in it."""
    noted = [output.metadata, *(output.metadata.get(kind, {}) for kind in IMAGES)]
    return " ".join(next((entry[what] for entry in noted if entry.get(what)), "").split())
