"""Names and logs that attack: results, reports and tables show them as words alone.

Oracle: the parser of the standard library, which finds the same words, no tag and no attribute of
theirs; where they are not escaped it does.
"""

import ast
import html
from html.parser import HTMLParser

import pandas as pd
import pytest

import trustlab as tl
from tests.cases import scores
from tests.publishing.world import ROOT
from trustlab.models.display import as_html
from trustlab.publishing.tables import table_html

ATTACKS = [
    '<img src=x onerror="fire()">',
    "<!--><img src=x onerror='fire()'>-->",
    "</script></style></title></textarea><script>fire()</script>",
    '<a href="java&#9;script:fire()">go</a>',
    '" onfocus="fire()" autofocus tabindex="1" x="',
    "<!--<script>fire()",
]
NAME = " ".join(ATTACKS)


class Markup(HTMLParser):
    """Tags, attributes and words of a page."""

    def __init__(self, text):
        super().__init__()
        self.parts, self.words = set(), ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.parts |= {tag, *(name for name, _ in attrs)}

    def handle_comment(self, data):
        self.parts.add("comment")

    def handle_data(self, data):
        self.words += data


HOSTILE = {"img", "script", "a", "comment", "onerror", "onfocus", "autofocus"}


def hostile_scores():
    frame = (scores().astype(str) + NAME).assign(value=scores()["value"])
    frame = frame.rename(columns=lambda name: f"{name} {NAME}")
    frame.attrs.update(reconstructed=True, note=NAME)
    return frame


def table():
    frame = pd.DataFrame({NAME: [NAME], "n": [1.5]}, index=pd.Index([NAME], name=NAME))
    return frame.rename_axis(columns=NAME)


def report():
    subject, within, dv = (f"{name} {NAME}" for name in ("subject", "condition", "value"))
    return tl.report(hostile_scores(), subject=subject, within=within, dv=dv)


@pytest.mark.parametrize(
    "show",
    [
        lambda: as_html(NAME, hostile_scores(), hostile_scores().T.set_index(0), title=NAME),
        lambda: report()._repr_html_(),
        lambda: table_html(table()),
    ],
    ids=["result", "report", "table"],
)
def test_hostile_names_are_words(show):
    text = show()
    page = Markup(text)
    assert NAME in page.words
    assert page.parts & HOSTILE == set()
    assert Markup(html.unescape(text)).parts & HOSTILE  # negative control


def returned_calls(function):
    """What a function returns the results of."""
    returns = [node.value for node in ast.walk(function) if isinstance(node, ast.Return)]
    return [ast.unparse(value.func) if isinstance(value, ast.Call) else None for value in returns]


def test_every_result_is_shown_by_what_escapes():
    """So that what holds for `as_html` holds for each; a report is walked above."""
    shown = {
        (path.stem, call)
        for path in (ROOT / "trustlab").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef) and node.name == "_repr_html_"
        for call in returned_calls(node)
    }
    assert ("display", "as_html") in shown
    assert {stem for stem, call in shown if call != "as_html"} <= {"report"}
