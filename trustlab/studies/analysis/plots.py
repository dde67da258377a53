"""Figures of analyses: means with intervals, rainclouds, lines of subjects, paired differences."""

import textwrap

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from trustlab.models.checks import one_of
from trustlab.models.display import axes_or_new
from trustlab.studies.analysis.score_table import ScoreTable

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
    places = np.arange(len(scores.conditions))
    axes.plot(places, scores.values.T, color=_GREY, lw=0.7, alpha=0.6, marker=".", ms=3)


def _means(stats: pd.DataFrame, axes, suffix: str = "") -> None:
    """Draw means with the intervals in columns ci_low and ci_high with a suffix."""
    mean = stats["mean"]
    reach = [mean - stats[f"ci_low{suffix}"], stats[f"ci_high{suffix}"] - mean]
    axes.errorbar(
        np.arange(mean.size), mean, reach, fmt="o", color=_BLUE, capsize=5, lw=1.5, zorder=3
    )


def _label_conditions(scores: ScoreTable, axes) -> None:
    k = len(scores.conditions)
    axes.set_xticks(np.arange(k), [str(condition) for condition in scores.conditions])
    axes.set(xlim=(-0.6, k - 0.4), xlabel=str(scores.within), ylabel=str(scores.dv))


def _title(origin: str, text: str, axes) -> str:
    """
    Return the title in lines as wide as the axes; the origin has its own line if one is too short.
    """
    width = axes.bbox.width / axes.figure.dpi
    letters = max(16, int(15.0 * width))  # of size "small" per inch
    whole = f"{origin}: {text}" if origin else text
    if len(whole) <= letters:
        return whole
    parts = [f"{origin}:", text] if origin else [text]
    parts = [part.replace("N = ", "N\xa0=\xa0") for part in parts]  # which textwrap keeps together
    return "\n".join(textwrap.fill(part, letters) for part in parts).replace("\xa0", " ")


def _clouds(scores: ScoreTable, axes) -> None:
    """Draw every score, a box of quartiles and a density per condition."""
    from scipy.stats import gaussian_kde

    jitter = np.random.default_rng(0).uniform(-0.05, 0.05, scores.values.shape)
    for j, values in enumerate(scores.values.T):
        axes.plot(j - 0.22 + jitter[:, j], values, "o", ms=3, color=_BLUE, alpha=0.5, mew=0)
        box = {
            "widths": 0.12,
            "manage_ticks": False,
            "showfliers": False,
            "medianprops": {"color": "k"},
        }
        axes.boxplot(values, positions=[j], **box)
        spread = np.ptp(values)
        if spread > 1e-9 * np.abs(values).max():
            # no density beyond the scores
            grid = np.linspace(values.min(), values.max(), 200)
            density = gaussian_kde(values)(grid)
            right = j + 0.12 + 0.3 * density / density.max()
            axes.fill_betweenx(grid, j + 0.12, right, color=_BLUE, alpha=0.3, lw=0)


def plot_conditions(result, kind: str = "means", interval: str = "between", axes=None):
    """
    Draw the conditions of one analysis side by side; the arguments are those of
    `RepeatedMeasures.plot`.
    """
    one_of("kind", kind, ("means", "raincloud", "paired"))
    one_of("interval", interval, ("between", "within"))
    axes = axes_or_new(axes, figsize=(max(4.2, 1.6 + 0.9 * result.k), 3.6))
    if kind == "raincloud":
        _clouds(result.scores, axes)
    else:
        if kind == "paired":
            _subjects(result.scores, axes)
        _means(result.descriptives(), axes, "" if interval == "between" else "_within")
    _label_conditions(result.scores, axes)
    title = {
        "means": f"means, 95 % intervals {interval} subjects",
        "raincloud": "scores, quartiles, densities",
        "paired": f"subjects; means, 95 % intervals {interval} subjects",
    }[kind]
    axes.set_title(_title(result.origin, f"{title} (N = {result.n})", axes), fontsize="small")
    return axes


def plot_cells(result, axes=None):
    """
    Draw the cell means of several factors: the first along the axis, a line per other cell.
    """
    axes = axes_or_new(axes, figsize=(6.0, 3.8))
    first = next(iter(result.within))
    lines = [name for name in (*result.between, *result.within) if name != first]
    table = result.descriptives()
    groups = table.groupby(lines, sort=False) if lines else [((), table)]
    for i, (cell, rows) in enumerate(groups):
        reach = stdtrit(rows["n"] - 1, 0.975) * rows["se"]
        places = np.arange(len(rows)) + 0.06 * i
        label = ", ".join(map(str, cell)) or None
        axes.errorbar(places, rows["mean"], reach, fmt="o-", capsize=4, lw=1.3, label=label)
    levels = result.within[first]
    axes.set_xticks(range(len(levels)), [str(level) for level in levels])
    axes.set(xlabel=str(first), ylabel=str(result.dv))
    title = f"means, 95 % intervals between subjects (N = {result.n})"
    axes.set_title(f"{result.origin}: {title}" if result.origin else title, fontsize="small")
    axes.legend(fontsize="small", title=", ".join(map(str, lines)))
    return axes


def plot_pair(result, axes=None) -> np.ndarray:
    """
    Draw both conditions of a paired t-test subject by subject, and the differences beside them.
    """
    left, right = axes_or_new(axes, columns=2, figsize=(7.2, 3.6), width_ratios=[2, 1])
    _subjects(result.scores, left)
    _means(result.descriptives(), left)
    _label_conditions(result.scores, left)
    differences = result.scores.values[:, 0] - result.scores.values[:, 1]
    jitter = np.random.default_rng(0).uniform(-0.12, 0.12, differences.size)
    right.plot(jitter, differences, "o", color=_GREY, ms=4, zorder=1)
    half = result.ci_high - result.mean_difference
    right.errorbar(
        [0], [result.mean_difference], [half], fmt="o", color="C1", capsize=5, lw=1.8, zorder=3
    )
    right.axhline(0.0, color="k", lw=0.8, ls=":")
    right.set(xlim=(-0.6, 0.6), xticks=[], ylabel=f"difference {result.a} − {result.b}")
    if result.scores.origin:
        left.set_title(result.scores.origin, fontsize="small", color="#8a5a00")
    return np.array([left, right])
