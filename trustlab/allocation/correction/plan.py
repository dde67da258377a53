"""A planned correction: actions, predicted effect, and a bound on their distance from optimal."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
import pandas as pd

from trustlab.models.display import axes_or_new

# Rows of arrays that hold both thresholds.
LOWER, UPPER = 0, 1


class CorrectionStatus(Enum):
    """How a plan was obtained, and what to do where it is not optimal."""

    OPTIMAL = (
        "Optimal among plans that keep each threshold between its value now and its target: "
        "every mode sequence that they can produce was searched or ruled out."
    )
    BOUNDED = (
        "The search exhausted its budget before it had ruled out all mode sequences; the gap "
        "bounds how much cheaper another plan can be. Raise budget=, or shorten the horizon, to "
        "close it."
    )
    CONVERGED = (
        "The solver converged, and rule (2.8) produces the mode sequence that it assumed. The "
        "plan is a local optimum for that sequence and not proved optimal among all: compare "
        "with engine='exact' where the cost is (2.43)."
    )
    FAILED = (
        "The solver failed, so the thresholds are held: the actions are 0. See the plan's "
        "message, rescale or soften the costs and constraints that were added, or use "
        "engine='exact'."
    )
    MISSING = (
        "A measurement is missing (NaN), so the thresholds are held and nothing is suggested. "
        "Check the sensor; the correction resumes when data return."
    )
    OUTSIDE = (
        "A measurement lies outside the model's range by more than rounding, so the thresholds "
        "are held. Identify the model anew from this operator's sessions, or pass "
        "outside='nearest'."
    )
    SETTLING = (
        "The window of measured performance is not full yet, so the thresholds are held "
        "until it is."
    )
    NEAREST = (
        "A measurement lies outside the model's range; the plan uses the nearest value in the "
        "range, as requested. Identify the model anew if this happens often."
    )

    @property
    def held(self) -> bool:
        """Whether the thresholds are held because nothing could be planned."""
        return self.name in ("FAILED", "MISSING", "OUTSIDE", "SETTLING")


@dataclass(frozen=True, eq=False, slots=True)
class CorrectionPlan:
    """
    Corrections of both thresholds over the horizon, and their effect under the hard switch (2.8).

    Parameters
    ----------
    c_l, c_u : float
        The action now: added to TSC_l and TSC_u, (2.40).
    suggestion : int
        What Algorithm 3 suggests now: 0 autonomous, 1 manual, −1 nothing.
    tsc : float
        TSC now (2.1).
    actions_l, actions_u : numpy.ndarray, shape (N,)
        The whole plan, c_l(0..N−1) and c_u(0..N−1).
    r, p_r : numpy.ndarray, shape (N + 1,)
        Utilization and robot performance (2.44), from now on.
    lower, upper : numpy.ndarray, shape (N + 1,)
        TSC_l and TSC_u, from now on.
    mode : numpy.ndarray, shape (N,)
        M(0..N−1) by (2.8): 1 manual, 0 autonomous.
    cost : float
        The cost (2.43) of these actions under the hard switch (2.8).
    cost_lower_bound : float
        No admissible actions that keep each threshold between its value now and its target cost
        less than this; NaN where the engine proves nothing. (2.42)-(2.44) do not ask for that, and
        without it a plan can cost less: see `ThresholdCorrector`.
    status : CorrectionStatus
        How the plan was obtained.
    engine : str
        The engine's name.
    solve_time : float
        Computing time [s]; NaN where not measured.
    message : str
        The solver's own message, if any.
    added_cost : float
        What the user's own cost adds to (2.43); 0 where there is none, NaN where no plan was found.
    """

    c_l: float
    c_u: float
    suggestion: int
    tsc: float
    actions_l: np.ndarray
    actions_u: np.ndarray
    r: np.ndarray
    p_r: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    mode: np.ndarray
    cost: float
    cost_lower_bound: float
    status: CorrectionStatus
    engine: str
    solve_time: float = float("nan")
    message: str = ""
    added_cost: float = 0.0

    @property
    def cost_with_additions(self) -> float:
        """The cost (2.43) plus what the user's own cost adds to it."""
        return self.cost + self.added_cost

    @property
    def gap(self) -> float:
        """Cost − cost_lower_bound: by how much a plan in the same intervals can be cheaper."""
        return self.cost - self.cost_lower_bound

    @property
    def relative_gap(self) -> float:
        """The gap as a share of the cost; 0 where the cost is 0."""
        return self.gap / self.cost if self.cost > 0.0 else 0.0 * self.gap

    def table(self) -> pd.DataFrame:
        """
        Return the plan, step by step.

        Returns
        -------
        pandas.DataFrame
            Index `step` (0..N); columns r, p_r, lower, upper, mode, c_l, c_u, the last three NaN at
            step N.
        """
        columns = {"r": self.r, "p_r": self.p_r, "lower": self.lower, "upper": self.upper}
        columns |= {"mode": self.mode, "c_l": self.actions_l, "c_u": self.actions_u}
        # As series, so that pandas fills step N of the last three, which have one value less, with
        # NaN.
        return pd.DataFrame(
            {name: pd.Series(values) for name, values in columns.items()}
        ).rename_axis("step")

    def plot(self, sample_time: float = 0.1):
        """
        Plot thresholds, and utilization and mode, over the horizon.

        Parameters
        ----------
        sample_time : float
            Time between samples [s].

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (2,)
        """
        time = np.arange(self.r.size) * sample_time
        axes = axes_or_new(rows=2, sharex=True, figsize=(8, 4.5))
        for values, name in ((self.upper, "$TSC_u$"), (self.lower, "$TSC_l$")):
            axes[0].plot(time, values - values[0], label=f"{name} from {values[0]:.4g}")
        axes[0].set(ylabel="change of threshold", title=f"plan of the engine {self.engine!r}")
        axes[0].legend(fontsize="small")
        axes[1].plot(time, self.r, label="r")
        axes[1].step(time[:-1], self.mode, where="post", lw=0.8, color="0.5", label="mode M")
        axes[1].set(xlabel="time [s]", ylabel="r, M")
        axes[1].legend(fontsize="small")
        return axes

    def __repr__(self) -> str:
        return (
            f"CorrectionPlan(c_l={self.c_l:.6g}, c_u={self.c_u:.6g}, cost={self.cost:.9g}, "
            f"cost_lower_bound={self.cost_lower_bound:.9g}, {self.status.name}, "
            f"engine={self.engine!r})"
        )
