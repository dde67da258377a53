"""Links within and between reports: from an equation's number, a figure's or table's name and "report 05" to what they mean."""

import csv
import html
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

LINKABLE = re.compile(
    r"(?s)<(?:a|pre|code|math|h\d)\b.*?</(?:a|pre|code|math|h\d)>|<[^>]*>"
    r"|\b[Rr]eport (?P<report>\d\d)\b|\((?P<equation>[2-4A]\.\d+)\)"
    # A figure or table is linked where a cell or paragraph begins with it: in a list of places, not in running prose.
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
    """Return what became of each figure, table, theorem and study, with the address of the section that shows it."""
    listed = notebooks / "finder.csv"
    if not listed.is_file():
        return []
    with listed.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [row | {"link": row["report"] and f"{row['report']}.html#{slug(row['section'])}"} for row in rows]


def read_equations(notebooks: Path) -> dict[str, dict[str, str]]:
    """Return the dissertation's equations by number."""
    listed = notebooks.parent / "data" / "published" / "equations.toml"
    return tomllib.loads(listed.read_text(encoding="utf-8")) if listed.is_file() else {}


def linker(notebooks: Path, name: str) -> Callable[[str], str]:
    """Return what links, in the markup of the page `name`, what it names; places on the page itself are not linked."""
    reports = {path.name[:2]: f"{path.stem}.html" for path in notebooks.glob("[0-9][0-9]_*.ipynb")}
    equations = {number: f"index.html#eq-{number.replace('.', '-')}" for number in read_equations(notebooks)}
    shown = {row["entry"]: row["link"] for row in read_finder(notebooks)}

    def link(found: re.Match[str]) -> str:
        known = {"report": reports, "equation": equations, "entry": shown}.get(found.lastgroup or "", {})
        address = known.get(found[found.lastgroup] if found.lastgroup else "", "")
        return f'<a href="{address}">{found[0]}</a>' if address and not address.startswith(f"{name}.") else found[0]

    return lambda markup: LINKABLE.sub(link, markup)
