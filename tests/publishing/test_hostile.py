"""Names, logs and outputs that attack: a real browser runs nothing of them and fetches nothing.

Chromium is the oracle: what fires is counted by a variable of the window and by dialogs, what is
fetched by the requests that are routed. The same markup without escaping and without a policy does
fire.
"""

import ast
import html
import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from nbformat.v4 import new_code_cell

import trustlab as tl
from tests.publishing.world import ROOT, chromium, make, publish, write_book
from trustlab.models.display import as_html
from trustlab.publishing.tables import table_html

FIRE = "window.top.fired=(window.top.fired||0)+1"
AWAY = "https://attacker.invalid/"
ATTACKS = {
    "image": f'<img src=x onerror="{FIRE}">',
    "comment": f'<!--><img src=x onerror="{FIRE}">-->',
    "script": f"</script></style></title></textarea><script>{FIRE}</script>",
    "form": f'<form action="{AWAY}form"><button id=go>go</button></form>',
    "formaction": f'<form><button id=go formaction="{AWAY}formaction">go</button></form>',
    "link": f'<a id=go href="java&#9;script:{FIRE}">go</a>',
    "refresh": f'<meta http-equiv="Refresh" content="0; url={AWAY}refresh">',
    "image set": f"<p style=\"background: image-set('{AWAY}set.png' 1x)\">",
    "escaped url": rf"<p style='background: u\72l({AWAY}url.png)'>",
    "style in a picture": f'<svg><style><img src=x onerror="{FIRE}"></style></svg>',
    "preconnect": f'<link rel=stylesheet href="{AWAY}a.css">',
    "base": f'<base href="{AWAY}"><img src=b.png>',
    "frame": f'<iframe srcdoc="<script>{FIRE}</script>"></iframe>',
    "handler": f'" onfocus="{FIRE}" autofocus tabindex="1" x="',
    "comment and script": f"<!--<script>{FIRE}",
    "template": "$DATA $TITLE {{ 7 * 7 }} $\\nosuch{x}$",
}
NAME = " ".join(ATTACKS.values())


@pytest.fixture(scope="module")
def browser():
    yield from chromium()


@pytest.fixture(scope="module")
def visit(browser):
    """
    Return a function that shows a page in Chromium, presses what can be pressed, and tells what
    fired and was fetched.
    """
    page = browser.new_page()
    asked, dialogs = [], []
    # "No content" leaves the page where it is, so that what came of a press can be read.
    page.route("**/*", lambda route: (asked.append(route.request.url), route.fulfill(status=204)))
    page.on("dialog", lambda dialog: (dialogs.append(dialog.message), dialog.dismiss()))

    def visit(text):
        page.goto("about:blank")
        asked.clear(), dialogs.clear()
        page.evaluate("window.fired = 0")
        page.set_content(text, wait_until="load")
        page.evaluate("document.querySelectorAll('#go').forEach(one => one.click())")
        page.wait_for_timeout(30)
        fired = page.evaluate("window.fired")
        return SimpleNamespace(fired=fired, asked=[*asked], dialogs=[*dialogs], page=page)

    return visit


def unescaped(text):
    """The same page with its words as markup; what loads another page would end the walk."""
    return html.unescape(text).replace(ATTACKS["refresh"], "")


def unmoved(seen):
    return not seen.fired and not seen.asked and not seen.dialogs


# results
# --------------------------------------------------------------------------------------------------


def scores():
    rng = np.random.default_rng(1)
    frame = pd.DataFrame([(f"{NAME} {i}", f"{NAME} {j}") for i in range(5) for j in range(3)])
    frame["score"] = rng.normal(size=len(frame))
    frame = frame.set_axis([f"{name} {NAME}" for name in ("subject", "condition", "score")], axis=1)
    frame.attrs.update(reconstructed=True, note=NAME)
    return frame


RESULTS = {
    "all parts": lambda: as_html(NAME, scores(), scores().T.set_index(0), title=NAME),
    "report": lambda: tl.report(
        scores(), **dict(zip(("subject", "within", "dv"), scores(), strict=True))
    )._repr_html_(),
}


@pytest.mark.parametrize("name", RESULTS)
def test_results_show_hostile_names_as_words(visit, name):
    text = RESULTS[name]()
    seen = visit(text)
    assert unmoved(seen), seen
    found = seen.page.evaluate(
        "document.querySelectorAll('img, script, form, button, meta, link, base, svg').length"
    )
    assert found == 0
    assert "onerror" in seen.page.evaluate("document.body.textContent")
    # Negative control: the same words fire where nothing is escaped.
    seen = visit(unescaped(text))
    assert seen.fired
    assert seen.asked


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
    assert len(shown) >= 5
    assert {stem for stem, call in shown if call != "as_html"} <= {"report"}


# reports
# --------------------------------------------------------------------------------------------------


def test_a_table_shows_hostile_names_as_words(visit):
    frame = pd.DataFrame({NAME: [NAME], "n": [1.5]}, index=pd.Index([NAME], name=NAME))
    frame.columns.name = NAME
    seen = visit(table_html(frame))
    assert unmoved(seen), seen
    assert visit(unescaped(table_html(frame))).fired


def test_a_report_shows_what_a_cell_prints_as_words(visit, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    cell = new_code_cell(f"name = {NAME!r}\nprint(name)\nname")
    root = make(tmp_path, n01_a=["# A", cell])
    publish(root)
    assert write_book(root).returncode == 0
    page = (root / "reports" / "01_a.html").read_text()
    body = re.sub(r"<script[^>]*>.*?</script>|<link[^>]*>", "", page, flags=re.S)
    assert "attacker.invalid" in body
    assert visit(body).fired == 0
