"""Tables as people read them: heads in words, numbers as papers write them, in book and Lab."""

import functools
import html
import numbers
import re
import tomllib
from pathlib import Path

import pandas as pd

P_VALUE = re.compile(
    r"p|p, .*|mauchly_p"
    r"|p[ _](gg|hf|holm|bonferroni|corrected|adjusted|uncorrected|value|mauchly|anova|friedman"
    r"|mixed|shapiro_least|simulated|chi2)"
)
LEAST_P = 0.001
# Significant digits that are shown; the book saves all of them.
DIGITS = 5
MOST_ROWS = 1000


@functools.cache
def words() -> dict[str, dict[str, str]]:
    """Return names in code and what a table shows instead: in heads (th), in cells too (td)."""
    text = (Path(__file__).parent / "templates" / "columns.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def table_html(frame: pd.DataFrame) -> str:
    """
    Return a table as HTML: the names of rows as columns of their own, so that all of them sort;
    numbers with few digits, their full value beside them in ``<data value>``.
    """
    by_column = frame.columns.nlevels == 1
    if by_column and not (isinstance(frame.index, pd.RangeIndex) and frame.index.name is None):
        above = f", by {frame.columns.name}" if frame.columns.name else ""
        rows = frame.index.to_frame(index=False)
        rows.columns = pd.Index([f"{_word(name or '')}{above}" for name in frame.index.names])
        frame = pd.concat([rows, frame.reset_index(drop=True)], axis=1)
    formats = [functools.partial(cell, p=_is_p(name)) for name in frame.columns]
    shown = frame.copy(deep=False)
    shown.columns = shown.columns.map(
        lambda name: tuple(map(_head, name)) if isinstance(name, tuple) else _head(name)
    )
    return shown.to_html(
        index=not by_column,
        formatters=formats,
        escape=False,
        border=0,
        sparsify=by_column,
        na_rep="–",
        max_rows=MOST_ROWS,
    )


def _word(name: object) -> str:
    return (words()["th"] | words()["td"]).get(str(name), str(name))


def _head(name: object) -> str:
    return html.escape(_word(name))


def _is_p(name: object) -> bool:
    return P_VALUE.fullmatch(str(name[-1] if isinstance(name, tuple) else name)) is not None


def cell(value: object, p: bool = False) -> str:
    """Return a value as a table shows it; a p-value with three decimals or as a bound."""
    if isinstance(value, bool) or type(value).__name__ == "bool":
        return "yes" if value else "no"
    if pd.api.types.is_scalar(value) and pd.isna(value):
        return "–"
    if not isinstance(value, numbers.Real):
        return html.escape(words()["td"].get(str(value), str(value)))
    if isinstance(value, numbers.Integral):
        return str(value)
    number = float(value) + 0.0  # without the minus of a zero
    text = f"{number:.{DIGITS}g}" if abs(number) < 10**DIGITS else f"{number:.0f}"
    if p:
        text = "&lt; .001" if number < LEAST_P else f"{number:.3f}".removeprefix("0")
    return f'<data value="{number!r}">{text}</data>'
