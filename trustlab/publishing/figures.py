"""
The house style of figures: readable, distinguishable without colour vision, honest about synthetic
data.
"""

from __future__ import annotations

import os
import textwrap
from pathlib import Path

import pandas as pd

from trustlab.publishing.tables import table_html

# Okabe and Ito's colours (2008), told apart with any colour vision; yellow is left out, too pale on
# white.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")

GID = "trustlab-caption"  # what texts of an earlier call are known by
SYNTHETIC = "Synthetic data"
REPORT = "TRUSTLAB_REPORT"  # set where a notebook runs for the book


def use_house_style() -> None:
    """
    Set Matplotlib's defaults to the house style, and how a notebook shows figures and tables.

    The book shows figures as SVG; JupyterLab, which draws SVG in trusted notebooks only, gets PNG.
    """
    from cycler import cycler
    from matplotlib import pyplot
    from matplotlib.figure import Figure

    pyplot.style.use(Path(__file__).parent / "templates" / "house.mplstyle")
    pyplot.rcParams["axes.prop_cycle"] = cycler(color=PALETTE)
    try:
        from IPython import get_ipython
        from matplotlib_inline.backend_inline import set_matplotlib_formats
    except ImportError:
        return
    shell = get_ipython()
    if shell is None:
        return
    formatters = shell.display_formatter.formatters
    formatters["text/html"].for_type(pd.DataFrame, table_html)
    book = REPORT in os.environ
    set_matplotlib_formats("svg" if book else "png", dpi=150)
    if book:
        svg = formatters["image/svg+xml"]
        draw = svg.lookup_by_type(Figure)
        svg.for_type(Figure, lambda figure: (draw(figure), {"caption": figure.get_label()}))
    backend = pyplot.get_backend()
    if backend.endswith("inline"):
        # Or pyplot would draw after each cell what the notebook then draws for itself. It is told
        # before the first figure, which would ask for those drawings again.
        pyplot.switch_backend(backend)
        pyplot.uninstall_repl_displayhook()


def caption(where, text: str, synthetic: bool | str = False):
    """Write a caption below a figure, or give one to a table; reports number both.

    Parameters
    ----------
    where : matplotlib.figure.Figure, matplotlib.axes.Axes or pandas.DataFrame
        The figure, any of its axes, or the table.
    text : str
        What is shown, and what the heads of a table's columns mean.
    synthetic : bool or str
        Whether it is made from synthetic or reconstructed data; a string says which.

    Returns
    -------
    matplotlib.text.Text or pandas.DataFrame
        The caption of a figure; the table with its caption in ``attrs``.
    """
    label = SYNTHETIC if synthetic is True else f"{SYNTHETIC}: {synthetic}"
    text = f"{label}. {text}" if synthetic else text
    if isinstance(where, pd.DataFrame):
        table = where.copy(deep=False)
        table.attrs = {"caption": text}
        return table
    figure = where.figure.figure  # axes -> (sub)figure -> figure; a figure is its own
    for old in [words for words in figure.texts if words.get_gid() == GID]:
        old.remove()
    if synthetic:  # marked in the upper right corner, too
        style = {"fontsize": 8, "color": "#8a5a00", "ha": "right", "va": "bottom"}
        figure.text(0.995, 1.01, label, gid=GID, **style)
    lines = textwrap.fill(text, max(30, int(figure.get_figwidth() * 14)))
    figure.set_label(lines)
    style = {"fontsize": 9, "color": "#555555", "ha": "left", "va": "top"}
    style["visible"] = REPORT not in os.environ  # the book sets it in type
    return figure.text(0.01, -0.02, lines, gid=GID, **style)
