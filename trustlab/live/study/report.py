"""The report of a live study: its notebook, run in the study's folder, as one page."""

from __future__ import annotations

from pathlib import Path

from trustlab.live.study.plan import PLAN
from trustlab.models.extras import extra
from trustlab.models.files import write_atomically

PACKAGE = Path(__file__).parents[2]
NOTEBOOK = Path(__file__).with_name("report.ipynb")
# What the page may do: show what it brings, run nothing and fetch nothing.
POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; form-action 'none'; "
    "base-uri 'none'"
)
HEAD = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>Report of a live study</title><style>
:root {{ color-scheme: light dark; }}
body {{ max-width: 62rem; margin: auto; padding: 1rem; font: 1rem/1.5 sans-serif; }}
table {{ border-collapse: collapse; font-size: .85rem; }}
td, th {{ padding: .1rem .5rem; text-align: right; border-bottom: 1px solid #8885; }}
.jp-OutputArea-output, .jp-RenderedMarkdown {{ overflow-x: auto; }}
.jp-InputPrompt, .jp-OutputPrompt, .anchor-link {{ display: none; }}
img {{ max-width: 100%; background: #fff; }} h1, h2, h3 {{ line-height: 1.2; }}
</style></head><body><main>
"""


def write_report(folder: Path, codes: list[str], path: Path) -> Path:
    """Run the notebook on what a folder holds of these participants, and write its page."""
    from trustlab.publishing.chapter import chapter
    from trustlab.publishing.run import anonymous, execute, provenance

    with extra("reports"):
        import nbformat
        from nbconvert import HTMLExporter

    run = execute(NOTEBOOK, {}, folder)
    origin = provenance(PACKAGE.parent, NOTEBOOK, run) | {"Data": ", ".join([PLAN, *codes])}
    page = nbformat.reads(chapter(run, origin), as_version=4)
    exporter = HTMLExporter(template_name="basic", embed_images=True, exclude_input=True)
    body, _ = exporter.from_notebook_node(page)
    page = f"{HEAD.format(policy=POLICY)}{body}</main></body></html>"
    page = anonymous(page.replace(str(folder), folder.name), PACKAGE.parent)
    write_atomically(path.absolute(), page)
    return path
