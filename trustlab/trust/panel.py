"""Panels: what many people saw, did and rated, in rows of people and columns of events."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    finite_array,
    finite_number,
    flag,
    in_order,
    list_of,
    one_of,
    positive,
    shown,
    table_of,
)
from trustlab.trust.interface import Event

# Columns of a panel in a table, beside person and trial.
SIGNALS = Event._fields
NEEDED = "person", "trial", "rating", "p_r"
KNOWN = *NEEDED[:3], *SIGNALS


@dataclass(frozen=True, eq=False)
class Panel:
    """
    Events and ratings of people who did the same kind of task.

    Parameters
    ----------
    people : tuple
        Names, N of them.
    events : Event
        Arrays of shape (N, K); NaN in dt where a person had fewer events.
    ratings : numpy.ndarray, shape (N, K + 1)
        Trust from 0 to 1 before the first event and after each; NaN where nobody asked.
    resolution : float
        Step of the scale that people rated on, as a share of it.
    source : str
        Where the data are from.
    cautions : tuple of str
        What must be said of them.
    """

    people: tuple
    events: Event
    ratings: np.ndarray
    resolution: float
    source: str = ""
    cautions: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.people)

    @property
    def trials(self) -> int:
        """The greatest number of events of a person."""
        return self.ratings.shape[1] - 1

    def of(self, rows) -> "Panel":
        """
        Return a panel of some people.

        Parameters
        ----------
        rows : array_like of int
            Their rows; a row may occur several times.
        """
        rows = np.asarray(rows)
        whole = rows.ndim == 1 and rows.dtype.kind in "iu"
        if not (whole and np.isin(rows, np.arange(len(self))).all()):
            raise ValueError(f"rows must be whole numbers below {len(self)}, got {shown(rows)}")
        events = Event(*(signal[rows] for signal in self.events))
        people = tuple(self.people[i] for i in rows)
        return replace(self, people=people, events=events, ratings=self.ratings[rows])


def panel_until(panel: Panel, event: int | np.ndarray) -> Panel:
    """Return a panel without the ratings and reliance after an event (each person's), from 1."""
    later = np.arange(panel.trials) >= np.reshape(event, (-1, 1))
    ratings = np.where(np.pad(later, ((0, 0), (1, 0))), np.nan, panel.ratings)
    followed = np.where(later, np.nan, panel.events.followed)
    return replace(panel, ratings=ratings, events=panel.events._replace(followed=followed))


def panel_of(
    table: pd.DataFrame,
    *,
    columns: Mapping[str, str] = MappingProxyType({}),
    low: float = 0.0,
    high: float = 1.0,
    performance: tuple[float, float] = (0.0, 1.0),
    before: bool = True,
    resolution: float | None = None,
    source: str = "",
    cautions: Sequence[str] = (),
) -> Panel:
    """
    Return a panel from rows of people and trials, by the recipe of `read_people`.

    Signals of `Event` that the table lacks have their usual values; without a resolution it is the
    least difference of two ratings.
    """
    for signal in table_of("columns", columns):
        one_of("a signal of columns", signal, KNOWN)
    wanted = {name: name for name in KNOWN if name in table or name in NEEDED} | dict(columns)
    for column in wanted.values():
        if column not in table:
            raise ValueError(f"the table has no column {column!r} (there are {', '.join(table)})")
    table = pd.DataFrame({signal: table[column] for signal, column in wanted.items()})
    low, high = in_order("low", low, "high", high)
    span, (worst, best) = high - low, finite_array("performance", performance, length=2)
    positive("what lies between the two ends of performance", abs(best - worst))
    table = table.assign(trial=pd.to_numeric(table["trial"], errors="coerce"))
    whose = table[["person", "trial"]]
    for row in table.index[whose.isna().any(axis=1) | whose.duplicated()]:
        raise ValueError(
            f"row {row!r} of the table has no person, or no number of a trial, or a person's trial "
            "a second time"
        )
    # People stay in the order of the table, their trials are put in order.
    person, people = pd.factorize(table["person"])
    table = table.assign(person=person).sort_values("trial", kind="stable")
    number = table.groupby("person").cumcount().rename("number") + (not flag("before", before))
    if not number.max() > 0:
        raise ValueError("no event: a person's first row is the rating before it, or before=False")
    signals = table.reindex(columns=["rating", *SIGNALS])
    ends = {"rating": (low, high), "p_r": sorted((worst, best))}
    ends |= dict.fromkeys(("dt", "fault"), (0.0, np.inf))
    for name, column in signals.items():
        signals[name] = values = pd.to_numeric(column, errors="coerce").astype(float)
        least, most = ends.get(name, (0.0, 1.0))
        right = values.between(least, most) | (column.isna() & (name != "p_r"))
        # Before the first event there is nothing but a rating.
        for row, value in column[~right & ((number > 0) | (name == "rating"))].items():
            raise ValueError(
                f"row {row!r} of the table has {name} {shown(value)}, which must be a number from "
                f"{least:g} to {most:g}; a recipe has the ends of ratings as low and high, and "
                "those of p_r as performance"
            )
    signals["p_r"] = (signals["p_r"] - worst) / (best - worst)
    # A signal that is not in the table, or missing there, has its usual value.
    signals = signals.fillna(Event()._asdict())
    # Rows of people; NaN where a person has no such trial.
    wide = signals.set_index([table["person"], number]).unstack()  # noqa: PD010 (no repeats)
    wide = wide.reindex(columns=pd.MultiIndex.from_product([signals, range(number.max() + 1)]))
    ratings = (wide["rating"].to_numpy() - low) / span
    if resolution is None:
        levels = np.unique(np.round(ratings[np.isfinite(ratings)], 9))
        resolution = float(np.diff(levels).min()) if levels.size > 1 else 0.01
    elif not 0.0 < finite_number("resolution", resolution) <= 0.5:
        raise ValueError(
            f"resolution {resolution} must be a share of the scale, above 0 and at most .5; one "
            f"point of this one is {shown(1.0 / span)}"
        )
    return Panel(
        tuple(people),
        Event(*(wide[name].to_numpy()[:, 1:] for name in SIGNALS)),
        ratings,
        resolution,
        source,
        tuple(list_of("cautions", cautions)),
    )
