"""Panels: what many people saw, did and rated, in rows of people and columns of events."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from trustlab.models.checks import array_between, of_class, positive
from trustlab.trust.interface import Event

# Columns of a panel in a table, beside person and trial.
SIGNALS = Event._fields


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

    def event(self, k: int) -> Event:
        """
        Return everybody's event of one trial; where a person had none, one of length 0 with the
        defaults of `Event`, which still moves models that count events.

        Parameters
        ----------
        k : int
            The trial, from 0.
        """
        signals = [signal[:, k] for signal in self.events]
        absent = np.isnan(Event(*signals).dt)
        nothing = Event(dt=0.0)
        return Event(*map(np.where, [absent] * len(signals), nothing, signals))

    def of(self, rows) -> "Panel":
        """
        Return a panel of some people.

        Parameters
        ----------
        rows : array_like of int
            Their rows; a row may occur several times.
        """
        rows = np.asarray(rows)
        events = Event(*(signal[rows] for signal in self.events))
        people = tuple(self.people[i] for i in rows)
        return replace(self, people=people, events=events, ratings=self.ratings[rows])


def panel_from_table(
    table: pd.DataFrame,
    *,
    low: float = 0.0,
    high: float = 1.0,
    resolution: float | None = None,
    source: str = "",
    cautions: tuple[str, ...] = (),
) -> Panel:
    """
    Return a panel from rows of people and trials.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns person, trial and rating, and those of `Event` that there are (dt p_r p_h fault mode
        followed seen). The first row of a person has the rating before the first event; the signals
        of later rows are those that led to their rating.
    low, high : float
        Ends of the scale of ratings.
    resolution : float, optional
        Step of the scale; the least difference of two ratings when not given.
    source : str
        Where the data are from.
    cautions : tuple of str
        What must be said of them.

    Returns
    -------
    Panel

    Raises
    ------
    ValueError
        If a column is missing, a rating is off the scale or p_r is missing or not in [0, 1].

    Examples
    --------
    >>> import pandas as pd, trustlab as tl
    >>> rows = pd.DataFrame({"person": ["P1"] * 3, "trial": [0, 1, 2], "p_r": [None, 1.0, 0.0],
    ...                      "rating": [4, 5, 3]})
    >>> tl.trust.panel_from_table(rows, low=1, high=7).ratings.round(2).tolist()
    [[0.5, 0.67, 0.33]]
    """
    of_class("table", table, pd.DataFrame, "with columns person, trial, rating")
    for name in ("person", "trial", "rating", "p_r"):
        if name not in table:
            raise ValueError(f"table has no column {name!r} (there are {', '.join(table)})")
    span = positive("high - low", high - low)
    # People stay in the order of the table, their trials are put in order.
    table = table.assign(place=pd.factorize(table["person"])[0])
    table = table.sort_values(["place", "trial"], kind="stable", ignore_index=True)
    number = table.groupby("place").cumcount().rename("number")
    # A signal that is not in the table, or missing there, has its usual value.
    signals = table.reindex(columns=["rating", *SIGNALS]).astype(float)
    signals = signals.fillna(Event()._asdict())
    # Rows of people; NaN where a person has no such trial.
    wide = signals.set_index([table["place"], number]).unstack()  # noqa: PD010 (no repeats)
    ratings = (wide["rating"].to_numpy() - low) / span
    outside = (ratings < 0.0) | (ratings > 1.0)
    if outside.any():
        raise ValueError(
            f"{outside.sum()} ratings are outside the scale from {low:g} to {high:g}; low and high "
            "are its ends"
        )
    array_between("p_r", table["p_r"].to_numpy(dtype=float)[number > 0], 0.0, 1.0, "performance")
    if resolution is None:
        levels = np.unique(np.round(ratings[np.isfinite(ratings)], 9))
        resolution = float(np.diff(levels).min()) if levels.size > 1 else 0.01
    return Panel(
        tuple(table["person"].unique()),
        Event(*(wide[name].to_numpy()[:, 1:] for name in SIGNALS)),
        ratings,
        positive("resolution", resolution),
        source,
        cautions,
    )
