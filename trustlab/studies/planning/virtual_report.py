"""The result of a virtual study: its design, people, measures, statistics and figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of
from trustlab.models.html import as_html
from trustlab.studies.analysis.repeated_measures import RepeatedMeasures, repeated_measures
from trustlab.studies.designs import LatinSquareDesign
from trustlab.studies.planning.populations import GroundRobotPopulation, TeleoperatorPopulation
from trustlab.testbeds.uav_following.people import FollowingPopulation

Population = GroundRobotPopulation | FollowingPopulation | TeleoperatorPopulation

# How messages call the testbeds.
WORDS = {
    "ground_robot": "the ground-robot testbed",
    "uav": "the UAV testbed",
    "uav_following": "the testbed of the UAV that follows a leader",
}

# Where the measures come from, for headers and captions.
ORIGIN = "simulated operators"

# Columns of the table of measures that identify a session.
KEYS = ("participant", "position", "condition", "synthetic")

TEST = ("n", "k", "F", "df1", "df2", "p", "correction", "epsilon_gg")
EFFECT = ("eta2_partial", "eta2_partial_low", "eta2_partial_high")
USUAL = {
    **dict.fromkeys(("ground_robot", "uav_following"), ("p_r", "p_h", "r", "path_error")),
    "uav": ("tracking_error", "p_r", "p_h", "hand_force"),
}


@dataclass(frozen=True, eq=False)
class VirtualStudy:
    """
    A study of simulated operators; no person took part.

    Parameters
    ----------
    testbed : {"ground_robot", "uav", "uav_following"}
        The testbed; "uav_following" is that of C1 to C5 on the UAV.
    conditions : tuple of str
        Its conditions, as given.
    design : LatinSquareDesign
        The order of conditions of every participant.
    population : GroundRobotPopulation, FollowingPopulation or TeleoperatorPopulation
        The population from which operators were drawn.
    participants : pandas.DataFrame
        Their parameters as drawn, a row each.
    measures : pandas.DataFrame
        A row per session: participant, position, condition, synthetic, and every measure of the testbed.
    failures : pandas.DataFrame
        Participants whose sessions could not be run: participant, error. They have no rows in `measures`.
    settings : dict
        seed, laps or duration [s], rest [s], assumptions, where given.
    folder : pathlib.Path or None
        Where sessions, measures and participants were written.
    """

    testbed: str
    conditions: tuple[str, ...]
    design: LatinSquareDesign
    population: Population
    participants: pd.DataFrame
    measures: pd.DataFrame
    failures: pd.DataFrame
    settings: dict
    folder: Path | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the measures."""
        return tuple(name for name in self.measures.columns if name not in KEYS)

    def analysis(self, dv: str, conditions: Sequence[str] | None = None, **options: Any) -> RepeatedMeasures:
        """
        Return the repeated-measures analysis of one measure.

        Parameters
        ----------
        dv : str
            The measure.
        conditions : sequence of str, optional
            Those to compare, all by default; a measure that some conditions do not have needs this.
        **options : object
            Passed on to `repeated_measures`.

        Raises
        ------
        ValueError
            If the measure or a condition is unknown, or the measure has missing values or no variance.
        """
        one_of("dv", dv, self.names)
        wanted = self.conditions if conditions is None else tuple(conditions)
        for condition in wanted:
            one_of("condition", condition, self.conditions)
        rows = self.measures[self.measures["condition"].isin(wanted)]
        return repeated_measures(rows, dv, "condition", "participant", order=wanted, **options)

    def table(self) -> pd.DataFrame:
        """
        Return the omnibus test of every measure.

        Returns
        -------
        pandas.DataFrame
            A row per measure: measure, conditions (that have it for everyone), n, k, F, df1, df2, p (corrected as `correction` says),
            correction, epsilon_gg, eta2_partial, eta2_partial_low, eta2_partial_high, note. NaN where a test is not defined; the note
            says why.
        """
        rows = []
        for name in self.names:
            there = self.measures[name].notna().groupby(self.measures["condition"]).all()
            own = [condition for condition in self.conditions if there[condition]]
            row: dict[str, Any] = dict.fromkeys([*TEST, *EFFECT], np.nan)
            try:
                if len(own) < 2:
                    raise ValueError("fewer than two conditions have this measure for every participant")
                result = self.analysis(name, own)
            except ValueError as error:
                row |= {"correction": "", "note": str(error)}
            else:
                row |= {key: getattr(result, key) for key in row}
                row |= {"df1": result.df1_corrected, "df2": result.df2_corrected, "p": result.p_corrected}
                gone = [c for c in self.conditions if c not in own]
                row["note"] = f"without {', '.join(gone)}, which do not have it for everyone" if gone else ""
            rows.append({"measure": name, "conditions": " ".join(own)} | row)
        frame = pd.DataFrame(rows)
        frame.attrs["origin"] = ORIGIN
        return frame

    def sessions(self):
        """
        Read the sessions again from the folder.

        Returns
        -------
        list of Session

        Raises
        ------
        ValueError
            If the study was run without a folder.
        """
        from trustlab.sessions.readers import read_sessions

        if self.folder is None:
            raise ValueError("this study kept no sessions; run it with out= the name of a folder")
        return read_sessions(self.folder / "sessions")

    def plot(self, measures: Sequence[str] | None = None, kind: str = "means"):
        """
        Plot measures by condition, a panel each.

        Parameters
        ----------
        measures : sequence of str, optional
            Which; four of the testbed's by default.
        kind : {"means", "raincloud", "paired"}
            As for `RepeatedMeasures.plot`.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes
        """
        import matplotlib.pyplot as plt

        measures = USUAL[self.testbed] if measures is None else measures
        names = [measures] if isinstance(measures, str) else list(measures)
        results = [self.analysis(name) for name in names]
        columns = min(4, len(names))
        rows = -(-len(names) // columns)
        size = (3.2 * columns, 3.2 * rows)
        figure, axes = plt.subplots(rows, columns, squeeze=False, layout="constrained", figsize=size)
        for axis, result in zip(axes.flat, results, strict=False):
            result.plot(kind, axes=axis)
            axis.set(title="", xlabel="")
        for axis in axes.flat[len(names) :]:
            axis.axis("off")
        figure.suptitle(f"{ORIGIN}, n = {len(self.participants) - len(self.failures)}", fontsize="small")
        return axes.ravel()[: len(names)]

    @property
    def summary(self) -> str:
        """What was simulated, in a sentence or two."""
        setting = ", ".join(f"{name} {value}" for name, value in self.settings.items() if value is not None)
        assumed = self.settings.get("assumptions", {})
        carried, rest = "Every session begins with the same utilization", ": orders have no effect on results."
        if self.settings.get("rest") is not None:
            carried, rest = "Utilization is carried over from session to session by (2.5)", "; nothing else is."
        if assumed.get("learning") or assumed.get("fatigue"):
            rest = "; people learn or tire from session to session."
        failed = f" {len(self.failures)} participant(s) failed and are left out." if len(self.failures) else ""
        return (
            f"Virtual study on {WORDS[self.testbed]}: {len(self.participants)} simulated operators ({self.population.origin}), "
            f"conditions {', '.join(self.conditions)}; {setting}. No person took part. {carried}{rest}{failed}"
        )

    def __repr__(self) -> str:
        return (
            f"VirtualStudy({self.testbed}, {len(self.participants)} simulated operators, {', '.join(self.conditions)})"
        )

    def _repr_html_(self) -> str:
        means = self.measures.groupby("condition", observed=True)[list(self.names)].mean().T
        return as_html(self.summary, self.table()) + as_html(f"Means ({ORIGIN})", means[list(self.conditions)])
