"""Settings of simulated studies and of power: where they run, how they draw, what columns are."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

from trustlab.models.checks import open_unit, whole_number

LEAST_REPLICATES = 100
MOST_REPLICATES = 10_000_000


@dataclass(frozen=True)
class Simulation:
    """
    How studies are simulated and tested.

    Parameters
    ----------
    replicates : int
        Simulated studies per cell, at least 100.
    seed : int
        Seed of the draws. All populations of a size share their draws, whatever their place in
        a grid.
    alpha : float
        Level of all tests, in (0, 1).
    level : float
        Coverage of the Monte-Carlo intervals (Clopper–Pearson), in (0, 1).
    n_jobs : int
        How many processes simulate studies, as in `run_campaign`; no effect on results.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    replicates: int = 10_000
    seed: int = 0
    alpha: float = 0.05
    level: float = 0.95
    n_jobs: int = 1

    def __post_init__(self):
        open_unit("alpha", self.alpha)
        open_unit("level", self.level)
        whole_number("replicates", self.replicates, least=LEAST_REPLICATES, most=MOST_REPLICATES)
        whole_number("seed", self.seed, least=0)


@dataclass(frozen=True)
class StudyColumns:
    """
    Columns of a pilot study's table, or levels of the index of its means.

    Parameters
    ----------
    dv, subject : hashable
        Columns of the measure and of the participants.
    within : hashable or list of hashable
        The factor or factors within subjects.
    between : hashable or list of hashable, optional
        Factors between subjects, which come first in the index of the means.
    order : sequence or dict, optional
        Order of the conditions; of several factors, a dict of factor to levels.
    """

    dv: Hashable = "value"
    within: Hashable | list[Hashable] = "condition"
    subject: Hashable = "subject"
    between: Hashable | list[Hashable] | None = None
    order: Any = None

    @property
    def factors(self) -> list:
        """The factors within subjects."""
        return self.within if isinstance(self.within, list) else [self.within]

    @property
    def groups(self) -> list:
        """The factors between subjects."""
        if self.between is None:
            return []
        return self.between if isinstance(self.between, list) else [self.between]


USUAL_SIMULATION = Simulation()
USUAL_COLUMNS = StudyColumns()
