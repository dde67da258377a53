"""Figures of analyses: means with intervals, rainclouds, lines of subjects, paired differences."""

import textwrap

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of
from trustlab.models.display import axes_or_new
from trustlab.studies.table import ScoreTable

_BLUE, _GREY = "#1f5a8c", "0.6"


def panels(count: int, height: float, title: str = "") -> np.ndarray:
    """Return axes of a new figure, at most four in a row."""
    columns = min(4, count)
    rows = -(-count // columns)
    axes = axes_or_new(
        None, rows, columns, title, squeeze=False, figsize=(2.5 * columns, height * rows)
    )
    for axis in axes.flat[count:]:
        axis.axis("off")
    return axes.ravel()[:count]


def _subjects(scores: ScoreTable, axes) -> None:
    """Draw a line per subject."""
    axes.plot(scores.values.T, color=_GREY, lw=0.7, alpha=0.6, marker=".", ms=3)


def _means(stats: pd.DataFrame, axes, suffix: str = "", shift: float = 0.0, **style) -> None:
    """Draw means with the intervals in columns ci_low and ci_high with a suffix."""
    mean = stats["mean"]
    reach = [mean - stats[f"ci_low{suffix}"], stats[f"ci_high{suffix}"] - mean]
    style = {"fmt": "o", "capsize": 5, "lw": 1.5, "zorder": 3} | style
    axes.errorbar(np.arange(mean.size) + shift, mean, reach, **style)


def _label(levels: tuple, factor: object, dv: object, axes) -> None:
    axes.set_xticks(range(len(levels)), [str(level) for level in levels])
    axes.set(xlim=(-0.6, len(levels) - 0.4), xlabel=str(factor), ylabel=str(dv))


def _title(origin: str, text: str, axes) -> None:
    """Write the title in lines as wide as the axes; an origin has its own if one is too short."""
    letters = max(16, int(15.0 * axes.bbox.width / axes.figure.dpi))  # of size "small" per inch
    whole = f"{origin}: {text}" if origin else text
    parts = [f"{origin}:", text] if origin and len(whole) > letters else [whole]
    axes.set_title("\n".join(textwrap.fill(part, letters) for part in parts), fontsize="small")


def _clouds(scores: ScoreTable, axes) -> None:
    """Draw every score, a box of quartiles and a density per condition."""
    from scipy.stats import gaussian_kde

    jitter = np.random.default_rng(0).uniform(-0.05, 0.05, scores.values.shape)
    places = np.arange(len(scores.conditions))
    style = {"color": _BLUE, "alpha": 0.5, "mew": 0}
    axes.plot(places - 0.22 + jitter, scores.values, "o", ms=3, **style)
    axes.boxplot(
        scores.values,
        positions=places,
        widths=0.12,
        manage_ticks=False,
        showfliers=False,
        medianprops={"color": "k"},
    )
    for place, values in zip(places + 0.12, scores.values.T, strict=True):
        if np.ptp(values) > 1e-9 * np.abs(values).max():
            # no density beyond the scores
            grid = np.linspace(values.min(), values.max(), 200)
            density = gaussian_kde(values)(grid)
            right = place + 0.3 * density / density.max()
            axes.fill_betweenx(grid, place, right, color=_BLUE, alpha=0.3, lw=0)


def plot_conditions(result, kind: str = "means", interval: str = "between", axes=None):
    """Draw an analysis of variance; the arguments are those of `RepeatedMeasures.plot`."""
    one_of("kind", kind, ("means", "raincloud", "paired") if result.one_way else ("means",))
    one_of("interval", interval, ("between", "within"))
    factor, levels = next(iter(result.within.items()))
    axes = axes_or_new(axes, figsize=(max(4.2, 1.6 + 0.9 * len(levels)), 3.6))
    suffix = "" if interval == "between" else "_within"
    stats = result.descriptives()
    lines = [name for name in (*result.between, *result.within) if name != factor]
    if kind == "raincloud":
        _clouds(result.scores, axes)
    elif lines:
        for i, (cell, rows) in enumerate(stats.groupby(lines, sort=False, observed=True)):
            style = {"fmt": "o-", "label": ", ".join(map(str, cell))}
            _means(rows, axes, suffix, 0.06 * i, **style)
        axes.legend(fontsize="small", title=", ".join(map(str, lines)))
    else:
        if kind == "paired":
            _subjects(result.scores, axes)
        _means(stats, axes, suffix, color=_BLUE)
    _label(levels, factor, result.dv, axes)
    title = {
        "means": f"means, 95 % intervals {interval} subjects",
        "raincloud": "scores, quartiles, densities",
        "paired": f"subjects; means, 95 % intervals {interval} subjects",
    }[kind]
    _title(result.origin, f"{title} (N = {result.n})", axes)
    return axes


def plot_pair(result, axes=None) -> np.ndarray:
    """
    Draw both conditions of a paired t-test subject by subject, and the differences beside them.
    """
    left, right = axes_or_new(axes, columns=2, figsize=(7.2, 3.6), width_ratios=[2, 1])
    scores = result.scores
    _subjects(scores, left)
    _means(result.descriptives(), left, color=_BLUE)
    _label(scores.conditions, scores.within, scores.dv, left)
    differences = scores.values[:, 0] - scores.values[:, 1]
    jitter = np.random.default_rng(0).uniform(-0.12, 0.12, differences.size)
    right.plot(jitter, differences, "o", color=_GREY, ms=4, zorder=1)
    half = result.ci_high - result.mean_difference
    right.errorbar(
        [0], [result.mean_difference], [half], fmt="o", color="C1", capsize=5, lw=1.8, zorder=3
    )
    right.axhline(0.0, color="k", lw=0.8, ls=":")
    right.set(xlim=(-0.6, 0.6), xticks=[], ylabel=f"difference {result.a} − {result.b}")
    if scores.origin:
        left.set_title(scores.origin, fontsize="small", color="#8a5a00")
    return np.array([left, right])
