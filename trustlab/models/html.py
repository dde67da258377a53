"""Results as HTML: whatever comes from a log, a file name or a user is escaped here, once for all of them."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

MOST_ROWS = 60
"""Rows of a table that a result shows of itself; `table()` returns all."""


def as_html(text: str, *tables: pd.DataFrame, title: str = "") -> str:
    """Return a result as a title in bold, a sentence, and tables; nothing in them is read as markup or as a formula."""
    import pandas as pd

    bold = f"<b>{html.escape(title)}</b>: " if title else ""
    parts = [
        table.to_html(
            index=not isinstance(table.index, pd.RangeIndex),
            float_format="{:.6g}".format,
            na_rep="–",
            max_rows=MOST_ROWS,
        )
        for table in tables
    ]
    return f'<div class="tex2jax_ignore"><p>{bold}{html.escape(text)}</p>{"".join(parts)}</div>'
