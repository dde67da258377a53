"""The house style of figures: readable, distinguishable without colour vision, honest about synthetic data."""

import os
import textwrap
from pathlib import Path
from typing import Any

from trustlab.models.checks import one_of

# Okabe and Ito's colours (2008), told apart with any colour vision; yellow is left out, too pale on white.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")

CAPTION_ID = "trustlab-caption"
MARK_ID = "trustlab-synthetic"
SYNTHETIC = "Synthetic data"


def use_house_style(inline: str = "svg") -> None:
    """Set Matplotlib's defaults to the house style, and how a notebook embeds its figures.

    Parameters
    ----------
    inline : {"svg", "png"}
        Format in which a notebook keeps its figures: ``"svg"`` stays sharp; ``"png"`` (150 dpi) stays small where a figure
        has more than some ten thousand marks.

    Raises
    ------
    ValueError
        If ``inline`` is neither.
    """
    one_of("inline", inline, ("svg", "png"))
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
    if shell is not None:
        set_matplotlib_formats(inline, **({"dpi": 150} if inline == "png" else {}))
        _describe_figures(shell.display_formatter.formatters["image/png" if inline == "png" else "image/svg+xml"])


def _describe_figures(formatter: Any) -> None:
    """Let a notebook keep with each figure what one sees in it."""
    from matplotlib.figure import Figure

    from trustlab.publishing.descriptions import calibrate, describe

    draw = formatter.lookup_by_type(Figure)

    def drawn(figure) -> tuple[str, dict[str, str]]:
        calibrate(figure)
        words = [text for text in figure.texts if text.get_gid() == CAPTION_ID]
        for text in words:
            text.set_visible("TRUSTLAB_REPORT" not in os.environ)  # a report sets it in type
        picture = draw(figure)  # first: drawing settles ticks and ranges
        return picture, {"drawn": describe(figure), "caption": " ".join(text.get_text() for text in words)}

    formatter.for_type(Figure, drawn)


def _figure(where):
    return where.figure.figure  # axes -> (sub)figure -> figure; a figure is its own


def _remove(where, gid: str) -> None:
    for old in [artist for artist in where.texts if artist.get_gid() == gid]:
        old.remove()


def caption(where, text: str, synthetic: bool | str = False):
    """Write a caption below a figure; it becomes the alternative text of the figure in a report.

    Parameters
    ----------
    where : matplotlib.figure.Figure or matplotlib.axes.Axes
        The figure, or any of its axes.
    text : str
        What the figure shows, in a sentence.
    synthetic : bool or str
        Whether the figure is made from synthetic or reconstructed data; a string says which.

    Returns
    -------
    matplotlib.text.Text
        The caption.
    """
    figure = _figure(where)
    if synthetic:
        text = f"{_label(synthetic)}. {text}"
        label_synthetic(figure, synthetic)
    _remove(figure, CAPTION_ID)
    words = textwrap.fill(text, max(30, int(figure.get_figwidth() * 14)))
    return figure.text(0.01, -0.02, words, ha="left", va="top", fontsize=9, color="#555555", gid=CAPTION_ID)


def _label(synthetic: bool | str) -> str:
    return SYNTHETIC if synthetic is True else f"{SYNTHETIC}: {synthetic}"


def label_synthetic(where, synthetic: bool | str = True):
    """Mark a figure as made from synthetic or reconstructed data, in its upper right corner.

    Parameters
    ----------
    where : matplotlib.figure.Figure or matplotlib.axes.Axes
        The figure, or the axes to mark.
    synthetic : bool or str
        ``True`` for the plain mark; a string says which data.

    Returns
    -------
    matplotlib.text.Text
        The mark.
    """
    _remove(where, MARK_ID)
    style: dict[str, Any] = {"fontsize": 8, "color": "#8a5a00", "ha": "right", "va": "bottom", "gid": MARK_ID}
    if hasattr(where, "transAxes"):
        return where.text(1.0, 1.01, _label(synthetic), transform=where.transAxes, **style)
    return where.text(0.995, 1.0, _label(synthetic), **style)
