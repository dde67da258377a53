"""The page that leads to all reports: a card each, with a picture, a sentence and the time taken."""

import html
import json
import os
import re
from pathlib import Path

from trustlab.publishing.html_report import TEMPLATES, ReportError, duration, stylesheet
from trustlab.publishing.inputs import input_digest
from trustlab.publishing.page_check import page_faults

__all__ = ["read_sidecar", "sidecar_path", "write_index"]


def sidecar_path(checkout, name):
    """Return where the record of a report is kept.

    Parameters
    ----------
    checkout : Checkout
        The folders.
    name : str
        Name of the report.

    Returns
    -------
    pathlib.Path
        A JSON file: digest of the inputs, title, sentence, thumbnail, start, time taken; or the failure.
    """
    return checkout.reports / ".build" / f"{name}.json"


def read_sidecar(checkout, name):
    """Return the record of a report.

    Parameters
    ----------
    checkout : Checkout
        The folders.
    name : str
        Name of the report.

    Returns
    -------
    dict
        Empty where there is none, or none that can be read.
    """
    try:
        found = json.loads(sidecar_path(checkout, name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _given(record):
    import ast

    return {name: ast.literal_eval(text) for name, text in record.get("parameters", {}).items()}


def _card(checkout, notebook, shared):
    name = notebook.stem
    record = read_sidecar(checkout, name)
    failure = record.get("failure")
    page = checkout.reports / f"{name}.html"
    card = {"title": record.get("title", name), "mark": name[:2], "thumbnail": record.get("thumbnail", "")}
    if failure:
        cell = failure.get("cell")
        return card | {
            "failure": failure | {"where": "failed" + (f" in cell {cell}" if cell else "")},
            "facts": name,
        }
    if not record or not page.is_file():
        return {"title": name, "mark": name[:2], "facts": name}
    facts = [name, duration(record["seconds"]), f"{record['started'][:16].replace('T', ' ')} UTC"]
    facts += [f"{key} = {value}" for key, value in record.get("parameters", {}).items()]
    return card | {
        "link": page.name,
        "sentence": record.get("sentence", ""),
        "facts": " · ".join(facts),
        "stale": record.get("digest") != input_digest(checkout, notebook, _given(record), shared),
    }


def _others(checkout, names):
    """Return link and title of every other page among the reports."""
    found = []
    for page in sorted(checkout.reports.glob("*.html")):
        if page.stem not in names and page.name != "index.html":
            title = re.search(
                r"<title>(.*?)</title>", page.read_text(encoding="utf-8", errors="replace"), re.DOTALL
            )
            found.append(
                (page.name, html.unescape(title[1]).strip() if title and title[1].strip() else page.stem)
            )
    return found


def write_index(checkout, notebooks, shared):
    """Write ``index.html``.

    Parameters
    ----------
    checkout : Checkout
        The folders.
    notebooks : iterable of pathlib.Path
        Every notebook there is, in order.
    shared : str
        What `trustlab.publishing.inputs.shared_digest` returns.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    ReportError
        If the page would need a script or the network.
    """
    from jinja2 import Environment, FileSystemLoader

    cards = [_card(checkout, notebook, shared) for notebook in notebooks]
    failed = sum("failure" in card for card in cards)
    built = sum("link" in card for card in cards)
    summary = f"{built} of {len(cards)} notebooks published" + (f"; {failed} failed." if failed else ".")
    # titles are escaped in the template; sentences and style sheet are HTML and CSS of our own
    templates = Environment(loader=FileSystemLoader(Path(TEMPLATES)), autoescape=False, trim_blocks=True)
    others = _others(checkout, {notebook.stem for notebook in notebooks})
    page = templates.get_template("index.html.j2").render(
        css=stylesheet(), cards=cards, others=others, summary=summary
    )
    faults = page_faults(page)
    if faults:
        raise ReportError("the index would not be self-contained: " + "; ".join(faults))
    written = checkout.reports / ".build" / f"index-{os.getpid()}.html"
    written.write_text(page, encoding="utf-8")
    target = checkout.reports / "index.html"
    os.replace(written, target)
    return target
