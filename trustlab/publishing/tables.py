"""Tables of a report: headed by words, numbers aligned and written as papers do; what is saved as CSV keeps what was there."""

import contextlib
import re
import tomllib
from itertools import chain, repeat
from pathlib import Path

from trustlab.models.extras import extra

with extra("reports"):
    from bs4 import Tag

NUMBER = re.compile(r"(?:[<>]\s*)?[-+\u2212]?(\d[\d,\u202f ]*)?\.?\d*([eE][-+]?\d+)?\s*%?|nan|NaN|[-+]?inf|\u2013|-")
P_VALUE = re.compile(
    r"p|p, .*|mauchly_p"
    r"|p[ _](gg|hf|holm|bonferroni|corrected|adjusted|uncorrected|value|mauchly|anova|friedman|mixed|shapiro_least)"
)
LEAST_P = 0.001
# Significant digits that are shown as they are; of more, one less than that is shown.
MOST_DIGITS = 6

# Characters from which a cell's text goes over several lines.
LONG = 60

# Names in code, and what a table is headed by instead.
COLUMNS = tomllib.loads((Path(__file__).parent / "templates" / "columns.toml").read_text(encoding="utf-8"))


def style_table(table: Tag) -> None:
    """Head a table by words, and mark and write its numbers."""
    heads = [row for row in table.find_all("tr") if row.find("th") and not row.find("td")]
    # pandas writes the names of the rows below those of the columns, in a row that is empty but for them.
    if len(heads) > 1 and not heads[-1].find_all("th")[-1].get_text(strip=True):
        _join_names(heads[-2], heads.pop())
    names = [name.get_text(strip=True) for name in heads[-1].find_all("th")] if heads else []
    for row in table.find_all("tr"):
        # From the right, as the first cells of a row may be those of a row above.
        for cell, name in zip(reversed(row.find_all(["th", "td"])), chain(reversed(names), repeat("")), strict=False):
            _write_cell(cell, P_VALUE.fullmatch(name) is not None)
    first = next((row.find_all(["th", "td"]) for row in table.find_all("tr") if row not in heads), [])
    for head in heads if not table.select("thead [colspan]") else heads[-1:]:
        for title, cell in zip(reversed(head.find_all("th")), reversed(first), strict=False):
            if "number" in cell.get_attribute_list("class"):
                _mark(title, "number")
    for title in table.find_all("th", string=lambda text: text in COLUMNS):
        code = title.get_text()
        title["title"] = title["data-value"] = code
        title.string = COLUMNS[code]


def _join_names(above: Tag, last: Tag) -> None:
    """Put the names of the rows into the row of the head above them."""
    for name, cell in zip(last.find_all("th"), above.find_all("th"), strict=False):
        if words := name.get_text(strip=True):
            of_columns = cell.get_text(strip=True)
            cell.string = f"{words}, by {of_columns}" if of_columns else words
    last.decompose()


def _write_cell(cell: Tag, is_p: bool) -> None:
    """Mark a cell by what is in it, and write a number as papers do."""
    text = cell.get_text(strip=True)
    if cell.name == "td" and len(text) > LONG:
        _mark(cell, "long")
    if cell.name == "td" and len(text) < LONG and NUMBER.fullmatch(text):
        _mark(cell, "number")
        if (written := _as_papers_write(text, is_p)) != text:
            cell["data-value"], cell.string = text, written


def _as_papers_write(text: str, is_p: bool) -> str:
    """Return a small p-value as a bound, a long fraction rounded, and a zero without a minus."""
    with contextlib.suppress(ValueError):
        if is_p and float(text) < LEAST_P:
            return "< .001"
        digits = re.sub(r"[eE].*|\D", "", text).lstrip("0")
        if re.search("[.e]", text) and len(digits) > MOST_DIGITS:
            return f"{float(text):.{MOST_DIGITS - 1}g}"
    return re.sub(r"^[-\u2212](?=0(\.0*)?$)", "", text)


def _mark(cell: Tag, name: str) -> None:
    cell["class"] = " ".join(filter(None, [*cell.get_attribute_list("class"), name]))
