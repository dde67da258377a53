"""
A whole study with simulated operators, from its design to its statistics, and its folder, laid out
like a lab's.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from numpy.random import SeedSequence

from trustlab.campaign.run import run_campaign
from trustlab.models.checks import (
    counted,
    list_of,
    of_class,
    one_of,
    shown,
    warn,
    whole_number,
    whole_seed,
)
from trustlab.models.display import Result, axes_or_new
from trustlab.models.files import path_of, writing
from trustlab.models.simulation import asked
from trustlab.sessions.writing import write_session
from trustlab.studies.designs import LatinSquareDesign, latin_square_design, participants_needed
from trustlab.studies.repeated_measures import RepeatedMeasures, repeated_measures
from trustlab.studies.table import labelled, labels_of
from trustlab.studies.words import listed
from trustlab.testbeds.deciding import warn_if_too_short
from trustlab.testbeds.testbed import ConditionTestbed, Testbed, named_testbed

# Where the measures come from, for headers and captions.
ORIGIN = "simulated operators"

# Columns of the table of measures that identify a session.
KEYS = ("participant", "position", "condition", "synthetic")

TEST = ["n", "k", "F", "df1_corrected", "df2_corrected", "p_corrected", "correction"]
TEST += ["epsilon_gg", "eta2_partial", "eta2_partial_low", "eta2_partial_high"]


@dataclass(frozen=True, eq=False, repr=False)
class VirtualStudy(Result):
    """
    A study of simulated operators; no person took part.

    Parameters
    ----------
    testbed : Testbed
        The testbed with its settings.
    conditions : tuple of str
        The conditions that were run.
    design : LatinSquareDesign
        The order of conditions of every participant.
    participants : pandas.DataFrame
        Their parameters as drawn, and what was assumed of all, a row each.
    measures : pandas.DataFrame
        A row per session: participant, position, condition, synthetic, and every measure of the
        testbed.
    failures : pandas.DataFrame
        Participants whose sessions could not be run: participant, error. They have no rows in
        `measures`.
    settings : dict
        seed, settings of the testbed, and assumptions, where given.
    folder : pathlib.Path or None
        Where sessions, measures and participants were written.
    """

    testbed: Testbed
    conditions: tuple[str, ...]
    design: LatinSquareDesign
    participants: pd.DataFrame
    measures: pd.DataFrame
    failures: pd.DataFrame
    settings: dict
    folder: Path | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the measures."""
        return tuple(self.measures.columns.drop([*KEYS]))

    @property
    def origin(self) -> str:
        """Where the measures come from, for heads and captions."""
        return ORIGIN if self.measures["synthetic"].all() else f"{ORIGIN} and recorded runs"

    def joined(self, measures: pd.DataFrame) -> "VirtualStudy":
        """
        Return the study with rows of measures added, for its table, analyses and figures.

        Parameters
        ----------
        measures : pandas.DataFrame
            Of other participants under the study's conditions: participant, position, condition,
            synthetic and measures by name, as `trustlab.ros.measures_table` returns them. Measures
            that they lack are NaN.

        Raises
        ------
        ValueError
            If a column is missing or unknown, a condition is not the study's, or a participant is.
        """
        if not {*KEYS} <= {*measures.columns} <= {*self.measures.columns}:
            raise ValueError(
                f"measures must have the columns {KEYS}, and of {self.names} those that were "
                f"measured, got {[*measures.columns]}"
            )
        for condition in measures["condition"].unique():
            one_of("condition", condition, self.conditions)
        if twice := {*measures["participant"]} & {*self.measures["participant"]}:
            raise ValueError(f"participant {twice.pop()!r} is in the study already; rename theirs")
        joint = pd.concat([self.measures, measures], ignore_index=True)
        joint["condition"] = pd.Categorical(joint["condition"], self.conditions)
        return replace(self, measures=joint)

    def analysis(
        self, dv: str, conditions: Sequence[str] | None = None, **options: Any
    ) -> RepeatedMeasures:
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
            If the measure or a condition is unknown, or the measure has missing values or no
            variance.
        """
        one_of("dv", dv, self.names)
        given = self.conditions if conditions is None else conditions
        compared = list_of("conditions", given)
        rows = self.measures.query("condition in @compared")
        scored = rows.loc[rows[dv].notna(), "condition"].unique()
        if lacking := [name for name in compared if name not in scored]:
            raise ValueError(f"{dv} has no values in {listed(lacking)}; give `conditions` without")
        return repeated_measures(rows, dv, "condition", "participant", order=compared, **options)

    def table(self) -> pd.DataFrame:
        """
        Return the omnibus test of every measure.

        Returns
        -------
        pandas.DataFrame
            A row per measure: measure, conditions (that have it for everyone), n, k, F, df1, df2, p
            (corrected as `correction` says), correction, epsilon_gg, eta2_partial,
            eta2_partial_low, eta2_partial_high, note. NaN where a test is not defined; the note
            says why.
        """
        rows = []
        for name in self.names:
            complete = self.measures[name].notna().groupby(self.measures["condition"]).all()
            measured = [*complete.index[complete]]
            row = {"measure": name, "conditions": " ".join(measured), "correction": "", "note": ""}
            if lacking := ", ".join(complete.index[~complete]):
                row["note"] = f"without {lacking}, which do not have it for everyone"
            try:
                row |= self.analysis(name, measured).tests.loc[0, TEST].to_dict()
            except ValueError as error:
                row["note"] = str(error)
            rows.append(row)
        table = pd.DataFrame(rows, columns=["measure", "conditions", *TEST, "note"])
        table.columns = table.columns.str.removesuffix("_corrected")
        return labelled(table, self.origin)

    def plot(self, measures: Sequence[str] | None = None):
        """
        Plot measures by condition, a panel each.

        Parameters
        ----------
        measures : sequence of str, optional
            Which; four of the testbed's by default.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes
        """
        names = self.testbed.measures if measures is None else measures
        names = [names] if isinstance(names, str) else list_of("measures", names)
        for name in names or [None]:
            one_of("measures", name, self.names)
        title = f"{self.origin}, n = {self.measures['participant'].nunique()}"
        size = (2.5 * len(names), 3.2)
        axes = axes_or_new(None, 1, len(names), title, squeeze=False, figsize=size)[0]
        for axis, name in zip(axes, names, strict=True):
            self.analysis(name).plot(axis).set(title="", xlabel="")
        return axes

    @property
    def title(self) -> str:
        """The testbed."""
        return f"Virtual study on {self.testbed.title}"

    @property
    def message(self) -> str:
        """What was simulated, and who is not in it."""
        settings = [f"{name} {value}" for name, value in self.settings.items() if value is not None]
        text = (
            f"{len(self.participants)} simulated operators ({self.testbed.origin}), conditions "
            f"{listed(self.conditions)}; {listed(settings)}. No person took part in "
            "it."
        )
        if len(self.failures):
            text += f" Failed and left out: {counted(len(self.failures), 'participant')}."
        more = self.measures["participant"].nunique() + len(self.failures) - len(self.participants)
        return text + (f" {counted(more, 'participant')} of recorded runs joined." if more else "")


def virtual_study(
    n: int | None = None,
    conditions: Sequence[Any] | None = None,
    seed: int = 0,
    *,
    design: LatinSquareDesign | None = None,
    testbed: str | Testbed = "ground_robot",
    assumptions: Mapping[str, float] | None = None,
    laps: int | None = None,
    n_jobs: int = 1,
    out: str | os.PathLike | None = None,
    progress: bool | None = None,
) -> VirtualStudy:
    """
    Simulate a within-subject study from its design to its statistics.

    Operators are drawn from a population and run every condition in the orders of a Latin square;
    their measures are analysed. Given the operator, sessions are independent: orders have no effect
    unless the testbed has a `rest`.

    Parameters
    ----------
    n : int, optional
        Participants, whose orders are those of a `latin_square_design` with this seed; where they
        do not fill whole squares, a warning says how many would. By default as many as the
        dissertation's study invited, or the next whole squares.
    conditions : sequence of str, (str, callable) or LeaderPolicy, optional
        C1 to C5 and the controls "own" and "random" of `run_condition` (ground robot, or a UAV that
        follows a leader), or M, MI, MMI, TMIG, TMIS, OMI (teleoperation of a UAV); those of the
        dissertation's study by default; or leader policies of a team. A pair ("mine", make) is a
        rule of one's own beside C1 to C5, made for each run by `make()`, or by `make(model)` of the
        operator's model; a policy of one's own for a team is given as it is.
    seed : int
        Of the design, of the people and of all runs. With the same seed, the people of a smaller
        study are the first of a larger one.
    design : LatinSquareDesign, optional
        Orders that are drawn already, of participants numbered from 1, in the place of `n` and
        `conditions`.
    testbed : {"ground_robot", "uav_following", "uav_tracking", "robot_team"} or Testbed, optional
        Where conditions are run: on the testbed of Section 2.4.1, of Section 2.4.2, of Chapter 3
        (for its schemes), or of Chapter 4 (for its policies). A `GroundRobot`,
        `UavFollowing`, `UavTracking` or `RobotTeam` of `trustlab.testbeds` has settings:
        population, laps, rest, duration; any object with the protocol `Testbed` will do.
    assumptions : mapping of str to float, optional
        What is assumed of all operators, by name: any of `trustlab.operators.ASSUMPTIONS` for C1 to
        C5, of `TELEOPERATOR_ASSUMPTIONS` for "uav_tracking".
    laps : int, optional
        Laps of each run of the ground robot; 8, as printed.
    n_jobs : int
        How many processes simulate participants, as in `run_campaign`; no effect on results.
    out : path-like, optional
        A folder for sessions/ (Parquet, one file per session, for `read_sessions`),
        participants.csv, orders.csv, measures.csv, about.txt and campaign/; a call with the same
        arguments goes on where a killed one stopped. Eight laps are about 1 MB.
    progress : bool, optional
        Whether to show progress on stderr; by default where it is a terminal.

    Returns
    -------
    VirtualStudy

    Raises
    ------
    ValueError
        If a condition is unknown or of another testbed, a rule cannot be made or called, n is too
        small, or an argument would have no effect.

    Warns
    -----
    CampaignWarning
        If participants' runs failed; they are listed in `.failures`.
    UserWarning
        If the design is not balanced, if sessions of C1 to C5 are too short for
        anybody to switch, or if nobody did.

    Examples
    --------
    >>> import trustlab as tl
    >>> study = tl.virtual_study(n=5, conditions=["C1", "C2", "C3", "C4", "C5"], laps=2, seed=1)
    >>> study.table()[["measure", "F", "p"]].shape
    (13, 3)
    """
    seed = whole_seed(seed)
    if design is not None:
        if n is not None or conditions is not None:
            raise ValueError("n and conditions have no effect beside a design; leave them out")
        plan = of_class("design", design, LatinSquareDesign).table()
        n, conditions = len(plan), sorted(plan.iloc[0])
        if [*plan.index] != [*range(1, n + 1)]:
            raise ValueError("design: make it with the number of participants, without names")
    bed, names = _fitting(testbed, conditions, laps)
    usual = participants_needed(len(labels_of("conditions", names, 2)), bed.printed_n)
    n = whole_number("n", usual if n is None else n, least=max(3, len(names)), most=1_000_000)
    if design is None:
        design = latin_square_design(names, n, seed=seed, whole_squares=False)
    people = bed.people(n, assumptions, seed)
    if [*people.get("participant", ())] != [*range(1, n + 1)]:
        raise ValueError(
            f"people of {bed.title} must be numbered from 1 to {n} in a column participant"
        )
    for name in bed.rules if bed.takes_rules else ():  # a rule is refused before anybody runs
        asked(f"condition {name!r}", bed.rule_of, name, people.iloc[0].to_dict())
    folder = None
    if out is not None:
        folder = path_of("out", out)
        begun = (folder / "campaign").exists()
        if not begun and any(path.is_file() for path in folder.rglob("*")):
            raise ValueError(
                f"out: {folder} holds files that are not known to be of this study; give a new or "
                "empty folder"
            )
        with writing(folder):
            (folder / "sessions").mkdir(parents=True, exist_ok=True)
    fixed = {"testbed": bed, "folder": folder and str(folder / "sessions")}
    orders = ["/".join(order) for order in design.table().to_numpy()]
    done = run_campaign(
        run_participant,
        [fixed | person for person in people.assign(order=orders).to_dict("records")],
        seed=seed,
        n_jobs=n_jobs,
        out=folder and folder / "campaign",
        progress=progress,
    )
    failed = done["failed"].to_numpy(dtype=bool)
    if failed.all():
        raise ValueError(f"every participant's run failed; the first: {done['error'].iloc[0]}")
    assumed = {"assumptions": dict(assumptions)} if assumptions else {}
    study = VirtualStudy(
        testbed=bed,
        conditions=names,
        design=design,
        participants=people,
        measures=_tidy(done[~failed], design, names),
        failures=done.loc[failed, ["participant", "error"]].reset_index(drop=True),
        settings={"seed": seed, **bed.settings} | assumed,
        folder=folder,
    )
    if isinstance(bed, ConditionTestbed):
        warn_if_too_short(float(study.measures["duration"].max()))
        if not study.measures["switches"].any():
            warn("nobody switched in any session: the conditions differ by noise only")
    if folder is not None:
        _finish(folder, study)
    return study


def _fitting(testbed: Any, conditions: Any, laps: int | None) -> tuple[Any, tuple[str, ...]]:
    """Return the testbed with rules of the user's own, and the conditions that it runs."""
    bed = named_testbed(testbed, laps)
    conditions = bed.printed_conditions if conditions is None else conditions
    # A set has another order, and so other draws, in each process.
    if not isinstance(conditions, list | tuple):
        raise ValueError(f"conditions must be a list of names, got {shown(conditions)}")
    rules: dict[str, Callable] = {}
    names = []
    for condition in conditions:
        if hasattr(condition, "leader"):  # a policy has its name with it
            condition = (condition.title, partial(copy, condition))
        if isinstance(condition, tuple):
            if len(condition) != 2:
                raise ValueError(f"conditions: a rule is a pair (name, rule), got {condition}")
            rules[condition[0]] = condition[1]
            condition = condition[0]
        names.append(condition)
    if any("/" in str(name) for name in names):  # it becomes part of file names
        raise ValueError(f"conditions must be names without /, got {names}")
    if rules:
        if not getattr(bed, "takes_rules", False):
            raise ValueError(f"on {bed.title} no rule decides; conditions are names alone")
        bed = replace(bed, rules={**bed.rules, **rules})
    for name in names:
        one_of(f"a condition on {bed.title}", name, bed.conditions)
    return bed, tuple(names)


def _tidy(
    done: pd.DataFrame, design: LatinSquareDesign, conditions: tuple[str, ...]
) -> pd.DataFrame:
    """Return a row per session from a row per participant."""
    wide = done.set_index(done["participant"].astype(int)).filter(like="/").astype(float)
    wide.columns = wide.columns.str.split("/", n=1, expand=True).set_names(["condition", None])
    # Melting would lose the second level.
    long = wide.stack(0, future_stack=True)  # noqa: PD013
    frame = design.orders().merge(long.reset_index())
    frame["condition"] = pd.Categorical(frame["condition"], conditions)
    return labelled(frame.assign(synthetic=True)[[*KEYS, *long]], ORIGIN)


def _finish(folder: Path, study: VirtualStudy) -> None:
    """Check that every session is there, and no others, and write the tables beside them."""
    place = folder / "sessions"
    rows = study.measures[["participant", "position", "condition"]].itertuples(index=False)
    files = [session_file(place, *row) for row in rows]
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise ValueError(
            f"out: {len(missing)} of {len(files)} sessions are missing from {place} "
            f"({missing[0]} first), although the campaign beside it says that they were run; "
            "remove the folder and run the study again"
        )
    last = max(place.glob("participant_*.parquet"))
    if last > session_file(place, len(study.participants) + 1, 0, ""):
        raise ValueError(f"out: {last} is of a study of more people; give another folder")
    about = (
        f"SIMULATED. {study.title}: {study.message}\nOne file per session in sessions/: "
        "trustlab.read_sessions reads them.\n"
    )
    study.participants.to_csv(folder / "participants.csv", index=False)
    study.design.orders().to_csv(folder / "orders.csv", index=False)
    study.measures.to_csv(folder / "measures.csv", index=False)
    (folder / "about.txt").write_text(about, encoding="utf-8")


def session_file(folder: str | Path, participant: int, position: int, condition: str) -> Path:
    """Return the file that holds one session; participants and positions count from 1."""
    return Path(folder) / f"participant_{participant:05d}_trial_{position}_{condition}.parquet"


def run_participant(
    testbed: Testbed,
    participant: int,
    order: str,
    folder: str | None,
    seed: SeedSequence,
    **numbers: float,
) -> dict[str, float]:
    """
    Run all conditions for one simulated operator, and return measures as "condition/measure": a
    task of `run_campaign`.

    `order` has the conditions, with / between them; `numbers` are a row of the testbed's people.
    """
    conditions = order.split("/")
    # Each condition has a seed by its place in the alphabet, so that the order has no effect on its
    # noise.
    streams = dict(zip(sorted(conditions), seed.spawn(len(conditions)), strict=True))
    person: Mapping[str, Any] = numbers | {"participant": participant}
    measures = {}
    for position, condition in enumerate(conditions, start=1):
        stream = streams[condition]
        run = asked(f"condition {condition!r}", testbed.run, condition, person, stream)
        if folder is not None:
            session = run.session.with_metadata(trial=position, testbed=testbed.name)
            write_session(session, session_file(folder, participant, position, condition))
        measures |= {f"{condition}/{name}": float(x) for name, x in run.measures.items()}
        person = testbed.next_session(person, run)
    return measures
