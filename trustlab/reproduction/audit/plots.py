"""Figures of the audit: how many verdicts of each kind, ranges within rounding, and how far slips lie outside them."""

import tomllib
from functools import cache

import pandas as pd

from trustlab.models.axes import axes_or_new
from trustlab.models.checks import shown
from trustlab.reproduction.audit.verdict import VERDICTS
from trustlab.reproduction.published import published_folder

COLOURS = dict(zip(VERDICTS, ("C2", "C5", "C1", "#bbbbbb"), strict=True))


@cache
def parts() -> dict[str, list[str]]:
    """Return the parts of the dissertation, and how the places of their numbers begin."""
    return tomllib.loads((published_folder() / "parts.toml").read_text(encoding="utf-8"))


def part_of(where: str) -> str:
    """
    Return the part of the dissertation that a printed number belongs to.

    Parameters
    ----------
    where : str
        Column `where` of the audit, for example "Table 2.1, participant 2".

    Raises
    ------
    ValueError
        If the place is in no part.
    """
    for part, starts in parts().items():
        if where.startswith(tuple(starts)):
            return part
    raise ValueError(f"no part of the dissertation for {shown(where)}")


def verdict_counts(verdicts: pd.DataFrame) -> pd.DataFrame:
    """
    Count the audit's verdicts, part by part.

    Parameters
    ----------
    verdicts : pandas.DataFrame
        What `audit` returns.

    Returns
    -------
    pandas.DataFrame
        Index part; a column per verdict, and all.
    """
    parts = verdicts["where"].map(part_of).rename("part")
    counts = pd.crosstab(parts, verdicts["verdict"]).reindex(columns=list(VERDICTS), fill_value=0)
    return counts.assign(all=counts.sum(axis=1))


def plot_verdicts(verdicts: pd.DataFrame, ax=None):
    """
    Draw how many numbers have each verdict, part by part.

    Parameters
    ----------
    verdicts : pandas.DataFrame
        What `audit` returns.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure when not given.
    """
    ax, counts = axes_or_new(ax, figsize=(7.2, 3.0)), verdict_counts(verdicts)[list(VERDICTS)]
    counts.plot.barh(stacked=True, color=COLOURS, width=0.8, ax=ax, xlabel="numbers and statements", ylabel="")
    ax.invert_yaxis()
    ax.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.35, 1.0), frameon=False)
    return ax


def plot_ranges(rows: pd.DataFrame, ax=None):
    """
    Draw recomputed values, their ranges within rounding, and the printed numbers.

    Parameters
    ----------
    rows : pandas.DataFrame
        Rows of the audit about one quantity, with a range.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure when not given.
    """
    ax = axes_or_new(ax, figsize=(7.2, 0.3 + 0.5 * len(rows)))
    for i, row in enumerate(rows.itertuples()):
        ax.plot([row.low, row.high], [i, i], color="#999999", lw=6, solid_capstyle="butt", zorder=1)
        ax.plot(row.recomputed, i, "o", color="black", zorder=2)
        ax.plot(float(row.printed), i, "D", color=COLOURS[row.verdict], zorder=3)
    ax.set_yticks(range(len(rows)), [where.partition(", ")[2] for where in rows["where"]])
    ax.invert_yaxis()
    ax.set_xlabel("recomputed (dot), its range within rounding (bar), printed (diamond)")
    return ax


def plot_slips(rows: pd.DataFrame, ax=None):
    """
    Draw how far printed numbers lie outside their ranges within rounding, in half-widths of the range.

    Parameters
    ----------
    rows : pandas.DataFrame
        Rows of the audit with a range; those without one are left out.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure when not given.
    """
    rows = rows[rows["high"] > rows["low"]]
    ax = axes_or_new(ax, figsize=(7.2, 0.5 + 0.5 * len(rows)))
    middle, half = 0.5 * (rows["low"] + rows["high"]), 0.5 * (rows["high"] - rows["low"])
    places = (rows["printed"].astype(float) - middle) / half
    for i, (place, verdict) in enumerate(zip(places, rows["verdict"], strict=True)):
        ax.plot([-1, 1], [i, i], color="#999999", lw=6, solid_capstyle="butt")
        ax.plot(place, i, "D", color=COLOURS[verdict])
    names = rows["where"] + ": " + rows["quantity"].str.replace(" [%]", "", regex=False)
    ax.set_yticks(range(len(rows)), names, fontsize=8)
    ax.set_xscale("symlog", linthresh=2)
    ax.set_xlim(min(1.3 * places.min(), -3), max(1.3 * places.max(), 3))
    ax.invert_yaxis()
    ax.set_xlabel("printed (diamond), range within rounding (bar); unit: half the range")
    return ax
