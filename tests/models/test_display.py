"""Results show themselves: nothing in them is read as markup, and one line says what they are."""

from dataclasses import dataclass

import pandas as pd

from trustlab.models.display import Result, as_html


@dataclass(frozen=True, repr=False)
class Found(Result):
    message: str
    numbers: tuple

    title = "A <b>"

    def table(self):
        return pd.DataFrame({"x": self.numbers}, index=pd.Index(["$y$", "<i>"], name="name"))


def test_a_result_is_one_line_and_in_a_notebook_its_table_too():
    result = Found("1 < 2 & more", (1.23456789, None))
    assert repr(result) == "<A <b>: 1 < 2 & more>"
    assert len(repr(Found("long " * 100, (1, 2)))) < 200
    assert repr(Found("long " * 100, (1, 2))).endswith("long …>")
    shown = result._repr_html_()
    assert shown.startswith(
        '<div class="tex2jax_ignore"><p><b>A &lt;b&gt;</b>: 1 &lt; 2 &amp; more'
    )
    assert "<td>1.23457</td>" in shown
    assert "<td>–</td>" in shown
    assert "&lt;i&gt;" in shown


def test_a_plain_index_is_not_shown_nor_more_than_sixty_rows():
    shown = as_html("", pd.DataFrame({"x": range(1000)}), pd.DataFrame({"y": [1]}))
    assert shown.count("<tr>") < 70
    assert shown.count("<table") == 2
    assert "<th>0</th>" not in shown


def test_a_single_row_that_is_wider_than_a_page_stands_upright():
    row = pd.DataFrame([{f"column {i}": i / 3 for i in range(13)} | {"words": "of it"}])
    shown = as_html("", row)
    assert shown.count("<tr") >= 14
    assert "<th>column 12</th>" in shown
    assert "<td>0.333333</td>" in shown
    assert "<td>of it</td>" in shown
    assert as_html("", row.iloc[:, :12]).count("<tr") == 2
