"""What steady motions or bounds are over the draws of a posterior: intervals and a probability."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import open_unit
from trustlab.models.display import Result

# Draws of a posterior that are followed.
DRAWS = 200


@dataclass(frozen=True, eq=False, repr=False)
class RangeIntervals(Result):
    """
    Ranges of a motion under one pair of thresholds, over the draws of a posterior.

    Parameters
    ----------
    results : list
        A `LimitCycle` or `InvariantBounds` of each draw that was followed.
    holds : numpy.ndarray of bool
        For which draws the rule keeps switching, or the bounds are guaranteed.
    """

    title = "Ranges over draws"

    results: list
    holds: np.ndarray

    @property
    def probability(self) -> float:
        """Share of the draws for which the rule keeps switching, or bounds are guaranteed."""
        return float(self.holds.mean())

    @property
    def message(self) -> str:
        """How probable the motion is, and over how many draws."""
        words = f"exists with probability {self.probability:.2f}; medians and 95 % intervals"
        return f"{words} over {len(self.results)} draws"

    def table(self, level: float = 0.95) -> pd.DataFrame:
        """
        Return intervals of every quantity, over the draws for which the motion exists.

        Parameters
        ----------
        level : float
            Level of the intervals, in (0, 1).

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; for each column of a single result its median and its ends ci_low and
            ci_high, as in `low`, `low_ci_low`, `low_ci_high`; NaN without a motion.

        Raises
        ------
        ValueError
            If `level` is outside (0, 1).
        """
        level = open_unit("level", level)
        ends = [0.5, 0.5 - 0.5 * level, 0.5 + 0.5 * level]
        pairs = zip(self.results, self.holds, strict=True)
        tables = [result.table() for result, holds in pairs if holds]
        template = self.results[0].table()
        columns = {}
        for column in template.columns:
            values = np.array([table[column] for table in tables])
            shape = (3, len(template))
            found = np.quantile(values, ends, axis=0) if len(tables) else np.full(shape, np.nan)
            columns |= dict(
                zip((column, f"{column}_ci_low", f"{column}_ci_high"), found, strict=True)
            )
        return pd.DataFrame(columns, index=template.index)


def over_draws(models: list, result: Any, condition: str) -> RangeIntervals:
    """Return the result of every draw, and for which the named condition holds."""
    results = [result(tsc) for tsc in models[:DRAWS]]
    return RangeIntervals(results, np.array([bool(getattr(each, condition)) for each in results]))
