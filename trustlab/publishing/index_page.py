"""
The records of reports, and the page that leads to all: a card each, with a picture, a sentence and
the time taken.
"""

import contextlib
import html
import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from trustlab.models.extras import extra
from trustlab.models.html import policy
from trustlab.publishing.mathml import to_mathml
from trustlab.publishing.provenance import Checkout, duration, input_digest
from trustlab.publishing.report_page import (
    TEMPLATES,
    check_page,
    linker,
    page_faults,
    read_equations,
    read_finder,
    script,
    stylesheet,
)

with extra("reports"):
    from jinja2 import Environment, FileSystemLoader


# What a record of a report that was built holds.
KINDS: dict[str, type] = dict.fromkeys(
    ("digest", "sources", "started", "title", "sentence", "thumbnail"), str
)
KINDS |= {"seconds": float, "parameters": dict}


@contextlib.contextmanager
def held(checkout: Checkout, say: Callable[[str], object]) -> Iterator[None]:
    """Keep other commands out of the folder of reports, after waiting for one that is there.

    The system lets the next one in however this process ends.
    """
    import fcntl

    records = checkout.reports / ".build"
    records.mkdir(parents=True, exist_ok=True)
    folder = os.open(records, os.O_RDONLY)
    try:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(f"another command is writing {checkout.reports}: waiting for its end")
            fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


def record_path(checkout: Checkout, name: str) -> Path:
    """
    Return where the record of a report is kept: digests of its inputs, title, sentence, thumbnail,
    or its failure.
    """
    return checkout.reports / ".build" / f"{name}.json"


def read_record(checkout: Checkout, name: str) -> dict:
    """
    Return the record of a report; empty where there is none, or none that a report leaves: it is
    built again then.
    """
    try:
        record = json.loads(record_path(checkout, name).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    if isinstance(record, dict) and isinstance(record.get("failure"), dict):
        return record
    built = isinstance(record, dict) and all(
        isinstance(record.get(key), kind) for key, kind in KINDS.items()
    )
    return (
        record
        if built and not page_faults(f"{record['sentence']}{record.get('headline', '')}")
        else {}
    )


def replace_file(path: Path, text: str) -> None:
    """Write a file at once: whoever reads it meanwhile sees the old one or the new one."""
    written = path.with_name(f".{path.name}.partial")
    try:
        written.write_text(text, encoding="utf-8")
        os.replace(written, path)
    finally:
        written.unlink(missing_ok=True)


def _card(checkout: Checkout, notebook: Path, shared: str) -> dict:
    """Return what the index shows of one notebook."""
    name = notebook.stem
    record = read_record(checkout, name)
    page = checkout.reports / f"{name}.html"
    card = {
        "title": record.get("title", name),
        "mark": name[:2],
        "thumbnail": record.get("thumbnail", ""),
    }
    if failure := record.get("failure"):
        return card | {"failure": failure, "facts": name}
    if not record or not page.is_file():
        return {"title": name, "mark": name[:2], "facts": name}
    facts = [name, duration(record["seconds"]), f"{record['started'][:16].replace('T', ' ')} UTC"]
    facts += [f"{key} = {value}" for key, value in record.get("parameters", {}).items()]
    card |= {key: record.get(key, "") for key in ("sentence", "headline", "data", "finding")}
    return card | {
        "link": page.name,
        "facts": " · ".join(facts),
        "stale": record.get("sources") != input_digest(checkout, notebook, shared=shared),
    }


def _others(checkout: Checkout, names: set[str]) -> list[tuple[str, str]]:
    """Return link and title of every other page among the reports."""
    pages = []
    for page in sorted([*checkout.reports.glob("*.html"), *checkout.reports.glob("*/index.html")]):
        place = page.relative_to(checkout.reports).as_posix()
        if page.stem not in names and place != "index.html":
            text = page.read_text(encoding="utf-8", errors="replace")
            title = re.search(r"<title>\s*(.*?)\s*</title>", text, re.DOTALL)
            pages.append((place, html.unescape(title[1] if title else "") or page.stem))
    return pages


def write_index(checkout: Checkout, notebooks: list[Path], shared: str) -> None:
    """
    Write ``index.html`` with a card for every notebook; `shared` is the `shared_digest` of the
    checkout.
    """
    cards = [_card(checkout, notebook, shared) for notebook in notebooks]
    failed = sum("failure" in card for card in cards)
    built = [
        notebook.stem for notebook, card in zip(notebooks, cards, strict=True) if "link" in card
    ]
    # titles are escaped in the template; sentences and style sheet are HTML and CSS of our own
    templates = Environment(loader=FileSystemLoader(TEMPLATES), autoescape=False, trim_blocks=True)
    equations = [
        row | {"number": number} for number, row in read_equations(checkout.notebooks).items()
    ]
    page = templates.get_template("index.html.j2").render(
        policy=policy(script()),
        script=script(),
        finder=[row | {"shown": row["report"] in built} for row in read_finder(checkout.notebooks)],
        equations=equations,
        math=to_mathml,
        css=stylesheet(),
        cards=cards,
        docs=(checkout.reports / "docs" / "index.html").is_file(),
        others=_others(checkout, {notebook.stem for notebook in notebooks}),
        summary=f"{len(built)} of {len(cards)} notebooks published"
        + (f"; {failed} failed." if failed else "."),
    )
    page = linker(checkout.notebooks, "")(page)
    check_page(page, "index")
    replace_file(checkout.reports / "index.html", page)
