"""
HTML that shows what others wrote: their words are escaped, and a page runs and fetches nothing but
what it brings.
"""

import base64
import hashlib
import html

import pandas as pd

# Rows of a table that a result shows of itself; `table()` returns all.
MOST_ROWS = 60

POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; form-action 'none'; "
    "base-uri 'none'"
)


def as_html(text: str, *tables: pd.DataFrame, title: str = "") -> str:
    """
    Return a result as a title in bold, a sentence, and tables; nothing in them is read as markup or
    as a formula.
    """
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


def policy(*scripts: str) -> str:
    """
    Return the element of a page's head that lets it run these scripts, to the letter, and fetch
    nothing.
    """
    hashes = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    ]
    allowed = "".join(f" 'sha256-{found}'" for found in hashes)
    more = f"; script-src{allowed}" if scripts else ""
    return f'<meta http-equiv="Content-Security-Policy" content="{POLICY}{more}">'
