"""Where the tests of a correction take place: what the loop over tests asks of a setting."""

from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import pandas as pd

from trustlab.allocation.correction.corrector import ThresholdCorrector


class CorrectionTest(NamedTuple):
    """
    How one test begins.

    Parameters
    ----------
    number : int
        From 1.
    habit : str
        How the operator responds to suggestions.
    start : (float, float)
        The operator's thresholds before any correction.
    thresholds : (float, float)
        Those of the suggestions now.
    stream : object
        An item of `CorrectionSetting.streams`.
    """

    number: int
    habit: str
    start: tuple[float, float]
    thresholds: tuple[float, float]
    stream: Any


class CorrectionSetting(Protocol):
    """
    A setting of consecutive tests: the model itself, or a testbed.

    `habits` are the habits of operators that it has, `source` says where its data come from.
    """

    habits: ClassVar[tuple[str, ...]]
    source: ClassVar[str]

    def printed_thresholds(self) -> tuple[float, float] | None:
        """Return the printed thresholds of a printed participant, if there is one."""

    def streams(self, seed: int | np.random.SeedSequence, tests: int) -> list:
        """
        Return the random numbers of each test.

        Parameters
        ----------
        seed : int or numpy.random.SeedSequence
            Of all that is random.
        tests : int
            How many tests.
        """

    def run(
        self, corrector: ThresholdCorrector, test: CorrectionTest
    ) -> tuple[pd.DataFrame, tuple[float, float], Any]:
        """
        Run one test.

        Parameters
        ----------
        corrector : ThresholdCorrector
            What plans the corrections.
        test : CorrectionTest
            How the test begins.

        Returns
        -------
        data : pandas.DataFrame
            Its samples, with all columns of a `CorrectionRun` but "test".
        thresholds : (float, float)
            Those at its end.
        session : Session or None
        """
