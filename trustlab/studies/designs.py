"""Orders of conditions: balanced Latin squares (Williams 1949), and the balance of orders."""

import numbers
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import flag, spawned, warn, whole_number, whole_seed
from trustlab.models.display import Result
from trustlab.studies.table import labels_of, roles_of


def williams_square(n: int) -> np.ndarray:
    """
    Return a Williams design: each condition equally often at each position and after each other.

    The first row zigzags, 0, 1, n − 1, 2, n − 2 …, so that its steps (modulo n) are all different;
    the others are that row plus 1, 2 … (modulo n). For odd n the same rows read backwards are
    added.

    Parameters
    ----------
    n : int
        How many conditions; at least 2.

    Returns
    -------
    numpy.ndarray of int, shape (n, n) for even n, (2 n, n) for odd n
        Condition numbers from 0, a row per order.

    References
    ----------
    E. J. Williams, Experimental designs balanced for the estimation of residual effects of
    treatments, Australian Journal of Scientific Research A 2 (1949) 149-168.
    """
    steps = np.arange(n)
    zigzag = np.where(steps % 2 == 1, (steps + 1) // 2, -(steps // 2)) % n
    square = (zigzag + steps[:, None]) % n
    return square if n % 2 == 0 else np.vstack([square, square[:, ::-1]])


def participants_needed(conditions: int, at_least: int = 1) -> int:
    """
    Return the smallest number of participants that fills whole squares.

    Parameters
    ----------
    conditions : int
        How many conditions.
    at_least : int
        The fewest participants wanted, for example from a power analysis.

    Raises
    ------
    ValueError
        If there are fewer than two conditions, or `at_least` is not a whole number of at least 1.
    """
    k = whole_number("conditions", conditions, least=2)
    size = k * (1 + k % 2)  # a square for an odd number is read backwards as well
    return -(-whole_number("at_least", at_least) // size) * size


@dataclass(frozen=True, eq=False, repr=False)
class DesignBalance(Result):
    """
    How often each condition stands at each position and follows each other condition.

    Parameters
    ----------
    positions : pandas.DataFrame
        Counts; a row per condition, a column per position from 1.
    carry_over : pandas.DataFrame
        Counts of the row's condition directly before the column's condition; the diagonal is NaN.
    """

    title = "Balance of orders"

    positions: pd.DataFrame
    carry_over: pd.DataFrame

    @property
    def _even(self) -> list[bool]:
        counts = self.positions, self.carry_over
        return [len({*table.melt()["value"].dropna()}) == 1 for table in counts]

    @property
    def message(self) -> str:
        """Whether positions, and first-order carry-over, are balanced."""
        positions, follows = ("balanced" if even else "not balanced" for even in self._even)
        return f"positions {positions}, first-order carry-over {follows}"

    @property
    def balanced(self) -> bool:
        """
        Whether every condition stands equally often at every position and after every other one.
        """
        return all(self._even)

    def table(self) -> pd.DataFrame:
        """Return all counts: of every condition by position, and by the condition that follows."""
        counts = {"position": self.positions, "followed by": self.carry_over}
        return pd.concat(counts, axis=1).rename_axis(index="condition")


def design_balance(
    orders: pd.DataFrame,
    participant: str = "participant",
    position: str = "position",
    condition: str = "condition",
) -> DesignBalance:
    """
    Count positions and first-order carry-over in any set of orders, such as those of the remaining
    participants.

    Parameters
    ----------
    orders : pandas.DataFrame
        A row per participant and position.
    participant, position, condition : str
        Its columns; positions count from 1.

    Raises
    ------
    ValueError
        If a column or a value is missing, or a participant has not had each condition once, at
        positions 1, 2 ….

    Examples
    --------
    >>> import trustlab as tl
    >>> orders = tl.latin_square_design(["C1", "C2", "C3", "C4"], participants=8, seed=0).orders()
    >>> tl.design_balance(orders).balanced
    True
    """
    roles_of(
        "orders", orders, participant=[participant], position=[position], condition=[condition]
    )
    labels = labels_of("condition", orders[condition].drop_duplicates(), 2)
    rows = orders.reset_index(drop=True).sort_values(position)
    people = rows.groupby(participant, sort=False)
    lists = people[[position, condition]].agg(list)
    for label, places, names in lists.itertuples():
        if {*names} != {*labels} or places != [*range(1, len(labels) + 1)]:
            raise ValueError(
                f"participant {label!r} had {names} at {places}; each of {[*labels]} is needed "
                "once, at positions 1, 2 …"
            )
    after, before = rows[condition], people[condition].shift()
    places = pd.crosstab(after, rows[position])
    follows = pd.crosstab(before, after).reindex(index=places.index, columns=places.index)
    # Nothing follows itself.
    follows = follows.fillna(0).where(~np.eye(len(places), dtype=bool))
    return DesignBalance(
        places.rename_axis(index="condition", columns="position"),
        follows.rename_axis(index="before", columns="after"),
    )


@dataclass(frozen=True, eq=False, repr=False)
class LatinSquareDesign(Result):
    """
    The order of conditions for each participant.

    Parameters
    ----------
    plan : pandas.DataFrame
        The condition of every participant (in the order in which they come to the lab), a column
        per position.
    seed : int
        The seed of the labels and of the order of rows.
    """

    title = "Latin square"

    plan: pd.DataFrame
    seed: int

    @property
    def message(self) -> str:
        """Who is in it, and the seed of its draw."""
        people, conditions = self.plan.shape
        return f"{people} participants, {conditions} conditions, seed {self.seed}"

    def table(self) -> pd.DataFrame:
        """Return the plan for the lab: a row per participant, a column per position."""
        return self.plan.copy()

    def orders(self) -> pd.DataFrame:
        """Return the plan as a tidy table: participant, position, condition."""
        rows = self.plan.stack()  # noqa: PD013  melt would sort the rows by position
        return rows.rename("condition").reset_index().infer_objects()


def latin_square_design(
    conditions: Sequence[Hashable],
    participants: int | Sequence[Hashable],
    seed: int = 0,
    *,
    whole_squares: bool = True,
) -> LatinSquareDesign:
    """
    Assign participants to the orders of a complete balanced Latin square, in whole squares.

    Which condition gets which label of the square, and the order of its rows for each batch of
    participants, are drawn from the seed; participants added later do not change the orders of
    those before them, but of those who fill half a square.

    Parameters
    ----------
    conditions : sequence of str
        Names of the conditions; at least two, all different.
    participants : int or sequence
        How many, numbered from 1, or their names in the order in which they come.
    seed : int
        Seed of the draws; report it with the design.
    whole_squares : bool
        Whether to refuse a number of participants that leaves a square incomplete; False only
        warns. The design is then balanced at most in positions, where half a square is filled.

    Returns
    -------
    LatinSquareDesign

    Raises
    ------
    ValueError
        If conditions or participants are missing or repeat, the seed is not a whole number ≥ 0, or
        the participants do not fill whole squares; the error says how many would.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.latin_square_design(["M", "OMI", "MMI", "TMIG"], participants=8, seed=1).table().head(4)
    position        1     2     3     4
    participant
    1             MMI  TMIG     M   OMI
    2             OMI     M  TMIG   MMI
    3            TMIG   OMI   MMI     M
    4               M   MMI   OMI  TMIG
    """
    conditions = labels_of("conditions", conditions, 2)
    if isinstance(participants, numbers.Number):
        count = whole_number("participants", participants, most=1_000_000)
        participants = tuple(range(1, count + 1))
    else:
        participants = labels_of("participants", participants, 1)
    whole_squares = flag("whole_squares", whole_squares)
    seed = whole_seed(seed)
    k, n = len(conditions), len(participants)
    size = participants_needed(k)
    half = n % size == k < size
    if n % size:
        below, above = n // size * size, participants_needed(k, n)
        text = (
            f"participants: {n} do not fill whole squares, as {k} conditions need a multiple of "
            f"{size}; {above} would do{f', or {below}' if below else ''}"
        )
        if whole_squares:
            raise ValueError(
                f"{text}; whole_squares=False takes {n} all the same, in a design that is not "
                "balanced"
            )
        warn(
            f"{n} participants fill half of the last square: each of the {k} conditions stands "
            "equally often at every position, but does not follow every other one equally often; "
            f"{above} participants would balance both"
            if half
            else f"{text}; this design is not balanced"
        )
    labels, *batches = spawned(seed, 1 - (-n // size))
    drawn = np.random.default_rng(labels).permutation(k)[williams_square(k)]
    square = pd.Series(conditions, dtype=object).to_numpy()[drawn]
    order = np.concatenate([np.random.default_rng(batch).permutation(size) for batch in batches])
    if half:
        # The first k orders of a square for odd k are a Latin square by themselves: every
        # condition once at every position.
        order = np.r_[order[: n - k], [row for row in order[n - k :] if row < k]]
    people = pd.Index(participants, name="participant", tupleize_cols=False)
    positions = pd.RangeIndex(1, k + 1, name="position")
    return LatinSquareDesign(pd.DataFrame(square[order[:n]], people, positions), seed)
