"""Conditions to look at: means with intervals, rainclouds, a line per subject."""

from __future__ import annotations

import textwrap

import numpy as np

__all__ = ["plot_conditions"]

_BLUE, _GREY = "#1f5a8c", "0.6"


def _means(result, axes, interval: str) -> None:
    stats = result.descriptives()
    end = "" if interval == "between" else "_within"
    mean = stats["mean"].to_numpy()
    low, high = stats[f"ci_low{end}"].to_numpy(), stats[f"ci_high{end}"].to_numpy()
    axes.errorbar(
        np.arange(mean.size),
        mean,
        [mean - low, high - mean],
        fmt="o",
        color=_BLUE,
        capsize=5,
        lw=1.5,
        zorder=3,
    )


def _title(origin: str, what: str, axes) -> str:
    """Return the title in lines as wide as the axes, the origin on lines of its own where one line is not enough."""
    width = axes.bbox.width / axes.figure.dpi
    letters = max(16, int(15.0 * width))  # of size "small" per inch
    whole = f"{origin}: {what}" if origin else what
    if len(whole) <= letters:
        return whole
    parts = [f"{origin}:", what] if origin else [what]
    parts = [part.replace("N = ", "N\xa0=\xa0") for part in parts]  # which textwrap keeps together
    return "\n".join(textwrap.fill(part, letters) for part in parts).replace("\xa0", " ")


def _clouds(result, axes) -> None:
    from scipy.stats import gaussian_kde

    jitter = np.random.default_rng(0).uniform(-0.05, 0.05, result.scores.values.shape)
    for j, values in enumerate(result.scores.values.T):
        axes.plot(j - 0.22 + jitter[:, j], values, "o", ms=3, color=_BLUE, alpha=0.5, mew=0)
        axes.boxplot(
            values,
            positions=[j],
            widths=0.12,
            manage_ticks=False,
            showfliers=False,
            medianprops={"color": "k"},
        )
        spread = np.ptp(values)
        if spread > 1e-9 * np.abs(values).max():
            grid = np.linspace(values.min(), values.max(), 200)  # no density where there is no score
            density = gaussian_kde(values)(grid)
            axes.fill_betweenx(
                grid, j + 0.12, j + 0.12 + 0.3 * density / density.max(), color=_BLUE, alpha=0.3, lw=0
            )


def plot_conditions(result, kind: str = "means", interval: str = "between", axes=None):
    """
    Draw the conditions of one analysis side by side.

    Parameters
    ----------
    result : RepeatedMeasures
        The analysis.
    kind : {"means", "raincloud", "paired"}
        Means with 95 % intervals; scores, boxes and densities (from the least to the greatest score); or a line per subject
        under the means.
    interval : {"between", "within"}
        Which interval the means carry.
    axes : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If `kind` or `interval` is none of those.
    """
    import matplotlib.pyplot as plt

    if kind not in ("means", "raincloud", "paired"):
        raise ValueError(f"kind must be 'means', 'raincloud' or 'paired', got {kind!r}")
    if interval not in ("between", "within"):
        raise ValueError(f"interval must be 'between' or 'within', got {interval!r}")
    if axes is None:
        _, axes = plt.subplots(figsize=(max(4.2, 1.6 + 0.9 * result.k), 3.6), layout="constrained")
    if kind == "raincloud":
        _clouds(result, axes)
    else:
        if kind == "paired":
            axes.plot(
                np.arange(result.k), result.scores.values.T, color=_GREY, lw=0.7, alpha=0.6, marker=".", ms=3
            )
        _means(result, axes, interval)
    axes.set_xticks(np.arange(result.k), [str(condition) for condition in result.conditions])
    axes.set_xlim(-0.6, result.k - 0.4)
    axes.set_xlabel(str(result.within))
    axes.set_ylabel(str(result.dv))
    what = {
        "means": f"means, 95 % intervals {interval} subjects",
        "raincloud": "scores, quartiles, densities",
        "paired": f"subjects; means, 95 % intervals {interval} subjects",
    }[kind]
    axes.set_title(_title(result.origin, f"{what} (N = {result.n})", axes), fontsize="small")
    return axes
