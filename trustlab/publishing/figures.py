"""
The house style of figures: readable, distinguishable without colour vision, honest about synthetic
data.
"""

from __future__ import annotations

import os
import textwrap
from pathlib import Path
from typing import Any

import pandas as pd

from trustlab.publishing.tables import table_html

# Okabe and Ito's colours (2008), told apart with any colour vision; yellow is left out, too pale on
# white.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")

CAPTION_ID = "trustlab-caption"
MARK_ID = "trustlab-synthetic"
SYNTHETIC = "Synthetic data"
REPORT = "TRUSTLAB_REPORT"  # set where a notebook runs for the book


def use_house_style() -> None:
    """
    Set Matplotlib's defaults to the house style, and how a notebook shows figures and tables.

    The book shows figures as SVG; JupyterLab, which draws SVG in trusted notebooks only, gets PNG.
    """
    import matplotlib as mpl
    from cycler import cycler

    sheet = Path(__file__).parent / "templates" / "house.mplstyle"
    mpl.rcParams.update(mpl.rc_params_from_file(sheet, use_default_template=False))
    mpl.rcParams["axes.prop_cycle"] = cycler(color=PALETTE)
    try:
        from IPython import get_ipython
        from matplotlib_inline.backend_inline import set_matplotlib_formats
    except ImportError:
        return
    shell = get_ipython()
    if shell is None:
        return
    name = "svg" if REPORT in os.environ else "png"
    set_matplotlib_formats(name, dpi=150)
    kind = {"svg": "image/svg+xml", "png": "image/png"}[name]
    _caption_figures(shell.display_formatter.formatters[kind])
    shell.display_formatter.formatters["text/html"].for_type(pd.DataFrame, table_html)
    if mpl.get_backend().endswith("inline"):
        _draw_once(mpl.get_backend())


def _draw_once(backend: str) -> None:
    """Keep pyplot from drawing after each cell what the notebook then draws for itself."""
    from matplotlib import pyplot

    # before the first figure does, which asks for those drawings again
    pyplot.switch_backend(backend)
    pyplot.uninstall_repl_displayhook()


def _caption_figures(formatter: Any) -> None:
    """Let a notebook keep a figure's caption, which the book sets in type, beside it."""
    from matplotlib.figure import Figure

    draw = formatter.lookup_by_type(Figure)

    def drawn(figure) -> tuple[str, dict[str, Any]]:
        words = [text for text in figure.texts if text.get_gid() == CAPTION_ID]
        for text in words:
            text.set_visible(REPORT not in os.environ)
        picture = draw(figure)
        picture, about = picture if isinstance(picture, tuple) else (picture, {})
        return picture, about | {"caption": " ".join(text.get_text() for text in words)}

    formatter.for_type(Figure, drawn)


def _figure(where):
    return where.figure.figure  # axes -> (sub)figure -> figure; a figure is its own


def _remove(where, gid: str) -> None:
    for old in [artist for artist in where.texts if artist.get_gid() == gid]:
        old.remove()


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
    if synthetic:
        text = f"{label}. {text}"
    if isinstance(where, pd.DataFrame):
        table = where.copy(deep=False)
        table.attrs = {"caption": text}
        return table
    figure = _figure(where)
    if synthetic:
        _mark(figure, label)
    _remove(figure, CAPTION_ID)
    words = textwrap.fill(text, max(30, int(figure.get_figwidth() * 14)))
    return figure.text(
        0.01, -0.02, words, ha="left", va="top", fontsize=9, color="#555555", gid=CAPTION_ID
    )


def _mark(figure, words: str) -> None:
    """Mark a figure as made from synthetic data, in its upper right corner."""
    _remove(figure, MARK_ID)
    figure.text(
        0.995, 1.01, words, fontsize=8, color="#8a5a00", ha="right", va="bottom", gid=MARK_ID
    )
