"""How results show themselves: as text, in a notebook, and on axes."""

import html
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from trustlab.models.checks import shown

# Rows of a table that a result shows of itself; `table()` returns all. A single row with more
# columns than a page is wide stands upright.
MOST_ROWS = 60
MOST_COLUMNS = 12


class Result:
    """
    What an analysis returns: `title` names it, `message` says what follows from it, `table()` holds
    its numbers, and `plot()` draws those that people look at.

    Printed, it is a line of title and message; a notebook adds the table.
    """

    if TYPE_CHECKING:  # fields of some classes, properties of others

        @property
        def title(self) -> str:
            """What names the result."""

        @property
        def message(self) -> str:
            """What follows from it, in a sentence or two."""

    def table(self) -> pd.DataFrame:
        """Return the numbers, one row for each thing, nothing rounded."""
        raise NotImplementedError

    def __repr__(self) -> str:
        text = textwrap.shorten(f"{self.title}: {self.message}", 180, placeholder=" …")
        return f"<{text}>"

    def _repr_html_(self) -> str:
        return as_html(self.message, self.table(), title=self.title)


def as_html(text: str, *tables: pd.DataFrame, title: str = "") -> str:
    """
    Return a result as a title in bold, a sentence, and tables; nothing in them is read as markup or
    as a formula.
    """
    bold = f"<b>{html.escape(title)}</b>: " if title else ""
    parts = []
    for table in tables:
        if len(table) == 1 and table.shape[1] > MOST_COLUMNS:
            table = table.astype(object).T.set_axis([""], axis=1)
        parts.append(
            table.to_html(
                index=not isinstance(table.index, pd.RangeIndex),
                float_format="{:.6g}".format,
                na_rep="–",
                max_rows=MOST_ROWS,
            )
        )
    return f'<div class="tex2jax_ignore"><p>{bold}{html.escape(text)}</p>{"".join(parts)}</div>'


def axes_or_new(
    axes: Any = None, rows: int = 1, columns: int = 1, title: str = "", **options: Any
) -> Any:
    """
    Return the Matplotlib axes that a user hands over, or those of a new figure with this title;
    options are those of `plt.subplots`. Axes of another number are refused.
    """
    if axes is not None:
        given = [each for each in np.ravel(axes) if hasattr(each, "plot")]
        if not len(given) == np.size(axes) == rows * columns:
            raise ValueError(f"axes must be {rows * columns} in number, got {shown(axes)}")
        return given[0] if len(given) == 1 else axes
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(rows, columns, layout="constrained", **options)
    if title:
        figure.suptitle(title, fontsize="medium")
    return axes
