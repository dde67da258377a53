"""Corrections over several consecutive tests, as in Fig. 2.18, on the model or on a testbed."""

from dataclasses import dataclass
from string import ascii_lowercase

import numpy as np
import pandas as pd

from trustlab.allocation.correction.corrector import ThresholdCorrector, threshold_pair
from trustlab.allocation.correction.model_tests import ModelTests
from trustlab.allocation.correction.setting import CorrectionSetting, CorrectionTest
from trustlab.models.checks import of_class, one_of, whole_number
from trustlab.models.display import Result, axes_or_new

# Columns of the data, with their order.
COLUMNS = [
    *["test", "t", "r", "p_r", "p_h", "tsc", "mode", "suggestion"],
    *["lower", "upper", "c_l", "c_u"],
    *["cost", "cost_lower_bound", "status", "latency"],
]

# Columns of the thresholds, each with that of its corrections.
SIDES = (("lower", "c_l"), ("upper", "c_u"))


@dataclass(frozen=True, eq=False, repr=False)
class CorrectionRun(Result):
    """
    Consecutive tests during which the thresholds of the suggestions are corrected.

    Parameters
    ----------
    data : pandas.DataFrame
        One row per sample: test, t [s] from the start of its test, then r, p_r, p_h, tsc, mode,
        suggestion, lower, upper, c_l, c_u, cost, cost_lower_bound, status, latency [s].
    start, target : (float, float)
        TSC_l and TSC_u at the beginning, and their targets.
    operator : str
        How the operator responds to suggestions.
    source : str
        Where the data come from: simulated, and by which model or testbed.
    sessions : tuple of Session
        The sessions that the data were taken from, one per test; on a testbed only.
    """

    title = "Correction run"

    data: pd.DataFrame
    start: tuple[float, float]
    target: tuple[float, float]
    operator: str
    source: str
    sessions: tuple = ()

    @property
    def message(self) -> str:
        """How many tests, of which operator, and where the data come from."""
        tests = self.data["test"].nunique()
        return f"{tests} tests, operator {self.operator}; {self.source}"

    def table(self) -> pd.DataFrame:
        """
        Return one row per test.

        Returns
        -------
        pandas.DataFrame
            Columns test, lower, upper (thresholds at its end), remaining (share of the distance to
            the target that is left, summed over both thresholds; NaN where they began there), p_r,
            r, manual_share (means), switches, held (samples without a plan), largest_gap (of all
            plans, relative), latency_median, latency_p99 [s].
        """
        data = self.data
        tests = self.data.groupby("test", sort=True)
        table = pd.DataFrame(
            {side: (data[side] + data[c]).groupby(data["test"]).last() for side, c in SIDES}
        )
        way = abs(self.target[0] - self.start[0]) + abs(self.target[1] - self.start[1])
        left = abs(self.target[0] - table["lower"]) + abs(self.target[1] - table["upper"])
        table["remaining"] = left / way if way > 0.0 else np.nan
        table[["p_r", "r", "manual_share"]] = tests[["p_r", "r", "mode"]].mean()
        table["switches"] = tests["mode"].agg(lambda mode: np.count_nonzero(np.diff(mode)))
        table["held"] = tests["cost"].agg(lambda cost: cost.isna().sum())
        gap = (data["cost"] - data["cost_lower_bound"]) / data["cost"].where(
            data["cost"] > 0.0, 1.0
        )
        table["largest_gap"] = gap.groupby(data["test"]).max()
        table["latency_median"] = tests["latency"].median()
        table["latency_p99"] = tests["latency"].quantile(0.99)
        return table.reset_index()

    def plot(self, target: tuple[float, float] | None = None):
        """
        Plot TSC, thresholds and targets of every test, as Fig. 2.18 does.

        Parameters
        ----------
        target : (float, float), optional
            Targets to draw, if not those of this run.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (tests,)
        """
        tests = self.data["test"].unique()
        size = (min(3 * tests.size + 0.5, 10.0), 3.2)
        axes = axes_or_new(columns=tests.size, sharey=True, squeeze=False, figsize=size)
        for axis, test, letter in zip(axes[0], tests, ascii_lowercase * tests.size, strict=False):
            part = self.data[self.data["test"] == test]
            axis.plot(part["t"], part["tsc"], lw=0.8, color="C0", label="TSC")
            # One label for both thresholds, and one for both targets: the second line has none.
            for side, label in (("lower", "thresholds"), ("upper", None)):
                axis.plot(part["t"], part[side], "--", color="C3", label=label)
            for value, label in zip(target or self.target, ("target", None), strict=True):
                axis.axhline(value, ls="-.", lw=1, color="0.4", label=label)
            axis.set(xlabel="time [s]", title=f"({letter}) test {test}")
        axes[0, 0].set(ylabel="TSC")
        axes[0, 0].figure.legend(
            *axes[0, 0].get_legend_handles_labels(),
            title=f"operator {self.operator}; {self.source}",
            loc="outside upper center",
            ncols=3,
            fontsize="small",
            title_fontsize="small",
            frameon=False,
        )
        return axes[0]


def run_correction(
    corrector: ThresholdCorrector,
    start: tuple[float, float] | None = None,
    tests: int = 4,
    habit: str = "following",
    seed: int | np.random.SeedSequence = 0,
    setting: CorrectionSetting | None = None,
) -> CorrectionRun:
    """
    Correct thresholds over several consecutive tests, Section 2.5 and Fig. 2.18.

    Every test begins in the manual mode; thresholds carry over from test to test. No plan
    anticipates how the operator will respond to suggestions.

    Parameters
    ----------
    corrector : ThresholdCorrector
        Model, target, horizon, largest correction and engine.
    start : (float, float), optional
        The operator's thresholds TSC_l and TSC_u; may be left out for a printed participant on a
        testbed.
    tests : int
        How many tests.
    habit : {"following", "lagging", "ignoring", "free", "adopting"}
        How the operator responds to suggestions. "following": follows all, on a testbed after a
        reaction; "lagging": follows those that still stand after a lag; "ignoring": decides by the
        thresholds of `start`, on a testbed by the operator's own. On a testbed also "free":
        follows as many as the operator does in C2; and "adopting": decides by the operator's own
        thresholds, which move by the same corrections.
    seed : int or numpy.random.SeedSequence
        Of all that is random; on a testbed one child is spawned from it per test.
    setting : ModelTests or trustlab.testbeds.GroundRobotTests, optional
        Where the tests take place, how long they are, and from where they test; on the model,
        `ModelTests()`, when not given.

    Returns
    -------
    CorrectionRun
        With `.data`, `.table()` and `.plot()`.

    Raises
    ------
    ValueError
        If an argument is of the wrong kind or out of range, or the setting does not have the habit.

    Notes
    -----
    Simulated: no person took part.

    Examples
    --------
    >>> import trustlab as tl
    >>> corrector = tl.ThresholdCorrector(tl.published_models()["2"], target=(0.05, 0.4))
    >>> setting = tl.allocation.ModelTests(duration=60.0)
    >>> run = tl.run_correction(corrector, (0.0, 0.35), tests=1, setting=setting)
    >>> run.table().columns.tolist()[:5]
    ['test', 'lower', 'upper', 'remaining', 'p_r']
    """
    of_class("corrector", corrector, ThresholdCorrector)
    setting = ModelTests() if setting is None else setting
    start = threshold_pair("start", setting.printed_thresholds() if start is None else start)
    one_of("habit", habit, setting.habits)
    tests = whole_number("tests", tests, most=1000)
    corrector.engine.reset()
    thresholds = start
    parts = []
    sessions = []
    for number, stream in enumerate(setting.streams(seed, tests), start=1):
        test = CorrectionTest(number, habit, start, thresholds, stream)
        data, thresholds, session = setting.run(corrector, test)
        parts.append(data.assign(test=number))
        if session is not None:
            sessions.append(session)
    frame = pd.concat(parts, ignore_index=True)[COLUMNS]
    return CorrectionRun(
        frame, start, corrector.target, habit, setting.source, sessions=tuple(sessions)
    )
