"""
A whole study with simulated operators, from its design to its statistics, and its folder, laid out
like a lab's.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence

from trustlab.campaign.folder import folder_path, refuse, writing_in
from trustlab.campaign.run import run_campaign, where_to_run
from trustlab.models.checks import (
    finite_number,
    flag,
    not_negative,
    of_class,
    one_of,
    warn,
    whole_number,
)
from trustlab.models.html import as_html
from trustlab.operators.ground_robot import checked_assumptions
from trustlab.sessions.writers import write_session
from trustlab.studies.analysis.plots import panels
from trustlab.studies.analysis.repeated_measures import RepeatedMeasures, repeated_measures
from trustlab.studies.designs import LatinSquareDesign, latin_square_design, participants_needed
from trustlab.studies.planning.populations import GroundRobotPopulation, TeleoperatorPopulation
from trustlab.teleoperation.loop.schemes import SCHEMES
from trustlab.testbeds.deciding import (
    CONDITIONS,
    KNOWN,
    SAMPLE_TIME,
    suggested_by_tsc,
    warn_if_too_short,
)
from trustlab.testbeds.ground_robot.conditions import MOST_LAPS, measured_condition, run_condition
from trustlab.testbeds.teleoperation_measures import teleoperation_measures
from trustlab.testbeds.uav_following.people import FollowingPopulation
from trustlab.testbeds.uav_following.run import measured_flight
from trustlab.testbeds.uav_tracking import simulate_teleoperation

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
TESTBEDS = {"ground_robot": tuple(KNOWN), "uav": tuple(SCHEMES), "uav_following": tuple(KNOWN)}
MAIN_SCHEMES = ("M", "OMI", "MMI", "TMIG")
PRINTED_N = {"ground_robot": 20, "uav": 32, "uav_following": 20}
POPULATIONS: dict[str, type] = {
    "ground_robot": GroundRobotPopulation,
    "uav": TeleoperatorPopulation,
    "uav_following": FollowingPopulation,
}
FILES = ("participants.csv", "orders.csv", "measures.csv", "about.txt")


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
        A row per session: participant, position, condition, synthetic, and every measure of the
        testbed.
    failures : pandas.DataFrame
        Participants whose sessions could not be run: participant, error. They have no rows in
        `measures`.
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
            A row per measure: measure, conditions (that have it for everyone), n, k, F, df1, df2, p
            (corrected as `correction` says), correction, epsilon_gg, eta2_partial,
            eta2_partial_low, eta2_partial_high, note. NaN where a test is not defined; the note
            says why.
        """
        rows = []
        for name in self.names:
            there = self.measures[name].notna().groupby(self.measures["condition"]).all()
            own = [condition for condition in self.conditions if there[condition]]
            row: dict[str, Any] = dict.fromkeys([*TEST, *EFFECT], np.nan)
            try:
                if len(own) < 2:
                    raise ValueError(
                        "fewer than two conditions have this measure for every participant"
                    )
                result = self.analysis(name, own)
            except ValueError as error:
                row |= {"correction": "", "note": str(error)}
            else:
                row |= {key: getattr(result, key) for key in row}
                row |= {
                    "df1": result.df1_corrected,
                    "df2": result.df2_corrected,
                    "p": result.p_corrected,
                }
                gone = [c for c in self.conditions if c not in own]
                row["note"] = (
                    f"without {', '.join(gone)}, which do not have it for everyone" if gone else ""
                )
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
        measures = USUAL[self.testbed] if measures is None else measures
        names = [measures] if isinstance(measures, str) else list(measures)
        results = [self.analysis(name) for name in names]
        axes = panels(
            len(names), 3.2, f"{ORIGIN}, n = {len(self.participants) - len(self.failures)}"
        )
        for axis, result in zip(axes, results, strict=True):
            result.plot(kind, axes=axis)
            axis.set(title="", xlabel="")
        return axes

    @property
    def summary(self) -> str:
        """What was simulated, in a sentence or two."""
        setting = ", ".join(
            f"{name} {value}" for name, value in self.settings.items() if value is not None
        )
        assumed = self.settings.get("assumptions", {})
        carried, rest = (
            "Every session begins with the same utilization",
            ": orders have no effect on results.",
        )
        if self.settings.get("rest") is not None:
            carried, rest = (
                "Utilization is carried over from session to session by (2.5)",
                "; nothing else is.",
            )
        if assumed.get("learning") or assumed.get("fatigue"):
            rest = "; people learn or tire from session to session."
        failed = (
            f" {len(self.failures)} participant(s) failed and are left out."
            if len(self.failures)
            else ""
        )
        return (
            f"Virtual study on {WORDS[self.testbed]}: {len(self.participants)} simulated "
            f"operators ({self.population.origin}), conditions {', '.join(self.conditions)}; "
            f"{setting}. No person took part. {carried}{rest}{failed}"
        )

    def __repr__(self) -> str:
        conditions = ", ".join(self.conditions)
        return (
            f"VirtualStudy({self.testbed}, {len(self.participants)} simulated operators, "
            f"{conditions})"
        )

    def _repr_html_(self) -> str:
        means = self.measures.groupby("condition", observed=True)[list(self.names)].mean().T
        return as_html(self.summary, self.table()) + as_html(
            f"Means ({ORIGIN})", means[list(self.conditions)]
        )


def virtual_study(
    design: str | LatinSquareDesign = "latin_square",
    n: int | None = None,
    conditions: Sequence[str] | None = None,
    population: Population | None = None,
    seed: int = 0,
    *,
    testbed: str | None = None,
    assumptions: Mapping[str, float] | None = None,
    laps: int | None = None,
    duration: float | None = None,
    rest: float | None = None,
    n_jobs: int | None = None,
    executor: Any = None,
    out: str | os.PathLike | None = None,
    progress: bool | None = None,
    fresh: bool = False,
    other_versions: Sequence[str] = (),
) -> VirtualStudy:
    """
    Simulate a within-subject study from its design to its statistics.

    Operators are drawn from a population and run every condition in the orders of a Latin square;
    their measures are analysed. Given the operator, sessions are independent: orders have no effect
    unless `rest` is given.

    Parameters
    ----------
    design : "latin_square" or LatinSquareDesign
        Orders of conditions: a complete balanced Latin square drawn from the seed, or a design with
        its conditions and participants (numbered from 1).
    n : int, optional
        Participants; they must fill whole squares, or, for an odd number of conditions, half of the
        last one, which leaves carry-over unbalanced. As many as the dissertation's study invited,
        or the next whole squares.
    conditions : sequence of str, optional
        C1 to C5 and the controls "own" and "random" of `run_condition` (ground robot, or a UAV that
        follows a leader), or M, MI, MMI, TMIG, TMIS, OMI (teleoperation of a UAV); C1 to C5, or M,
        OMI, MMI and TMIG for a `TeleoperatorPopulation`.
    population : GroundRobotPopulation, FollowingPopulation or TeleoperatorPopulation, optional
        From whom operators are drawn; `GroundRobotPopulation.published()`, `FollowingPopulation()`
        or `TeleoperatorPopulation()` by default.
    seed : int
        Of the design, of the people and of all runs. With the same seed, the people of a smaller
        study are the first of a larger one.
    testbed : {"ground_robot", "uav"}, optional
        Where C1 to C5 are run, the testbed of Section 2.4.1 (by default) or of Section 2.4.2;
        schemes of Chapter 3 are of "uav".
    assumptions : mapping of str to float, optional
        For C1 to C5, what is assumed of all operators: any of `trustlab.operators.ASSUMPTIONS` by
        name.
    laps : int, optional
        Laps of each run of the ground robot; 8, as printed.
    duration : float, optional
        Length of each run of teleoperation [s]; 120.
    rest : float, optional
        C1 to C5 only: pause between sessions [s], in which utilization decays by (2.5) from its
        value at the end of the session before. When it is left out, every session begins with the
        operator's r0, 0 unless assumed otherwise.
    n_jobs, executor : int, Executor, optional
        Where participants are simulated, as in `run_campaign`; by default in this process. They
        have no effect on results.
    out : path-like, optional
        A folder for sessions/ (Parquet, one file per session, for `read_sessions`),
        participants.csv, orders.csv, measures.csv, about.txt and campaign/; a call with the same
        arguments goes on where a killed one stopped. Eight laps are about 1 MB.
    progress : bool, optional
        Whether to show progress, as for `run_campaign`.
    fresh : bool
        Whether to remove an earlier virtual study, with its sessions, from `out`.
    other_versions : sequence of str
        Programs that may have another version than the runs in `out` have, as for `run_campaign`.

    Returns
    -------
    VirtualStudy

    Raises
    ------
    ValueError
        If a condition is unknown or of another testbed, the population does not fit, n is too small
        or fills no whole squares, or an argument would have no effect.

    Warns
    -----
    CampaignWarning
        If participants' runs failed; they are listed in `.failures`.
    UserWarning
        If the design leaves carry-over unbalanced, if sessions of C1 to C5 are too short for
        anybody to switch, or if nobody did.

    Examples
    --------
    >>> import trustlab as tl
    >>> study = tl.virtual_study(n=5, conditions=["C1", "C2", "C3", "C4", "C5"], laps=2, seed=1)
    >>> study.table()[["measure", "F", "p"]].shape
    (13, 3)
    """
    seed = whole_number("seed", seed, least=0)
    conditions = _named(conditions, design, population)
    testbed = _testbed(testbed, conditions, population)
    population = _fitting(population, testbed)
    design = _designed(design, n, conditions, seed, testbed)
    settings = _settings(testbed, laps, duration, rest, assumptions)
    people = population.draw(len(design.participants), seed)
    folder = None if out is None else Folder(out, design, flag("fresh", fresh))
    own = {"study": population.study} if isinstance(population, TeleoperatorPopulation) else {}
    fixed = {
        "testbed": testbed,
        "settings": settings | own,
        "folder": folder and str(folder.sessions),
    }
    runs = people.assign(order=design.table().agg(" ".join, axis=1).to_numpy())
    done = run_campaign(
        run_participant,
        [fixed | run for run in runs.to_dict("records")],
        seed=seed,
        out=None if folder is None else folder.campaign,
        progress=progress,
        fresh=fresh,
        other_versions=other_versions,
        **where_to_run(n_jobs, executor),
    )
    failed = done["failed"].to_numpy(dtype=bool)
    if failed.all():
        raise ValueError(f"every participant's run failed; the first: {done['error'].iloc[0]}")
    study = VirtualStudy(
        testbed,
        conditions,
        design,
        population,
        people,
        _tidy(done[~failed], design, conditions),
        done.loc[failed, ["participant", "error"]].reset_index(drop=True),
        {"seed": seed} | {name: value for name, value in settings.items() if value != {}},
        None if folder is None else folder.path,
    )
    if testbed != "uav":
        _warn_of_idle_sessions(study)
    if folder is not None:
        folder.finish(study)
    return study


def _warn_of_idle_sessions(study: VirtualStudy) -> None:
    """Warn where sessions were too short for anybody to switch, or nobody did."""
    warn_if_too_short(float(study.measures["duration"].max()))
    if not study.measures["switches"].any():
        warn("nobody switched in any session: the conditions differ by noise only")


def _named(conditions: object, design: object, population: object) -> tuple[str, ...]:
    """Return the conditions, all of one testbed."""
    if conditions is not None and not isinstance(conditions, list | tuple | pd.Index | pd.Series):
        raise ValueError(f"conditions must be a list of names, got {conditions!r:.60}")
    if isinstance(design, LatinSquareDesign):
        if conditions is not None and tuple(conditions) != design.conditions:
            raise ValueError(
                f"design has the conditions {design.conditions}, but conditions= says "
                f"{tuple(conditions)}"
            )
        conditions = design.conditions
    else:
        one_of("design", design, ["latin_square"], "a LatinSquareDesign")
    if conditions is None:
        return MAIN_SCHEMES if isinstance(population, TeleoperatorPopulation) else tuple(CONDITIONS)
    known = [*KNOWN, *SCHEMES]
    names = tuple(one_of("condition", name, known) for name in conditions)
    if len(names) < 2 or len(set(names)) < len(names):
        raise ValueError(
            f"conditions must be two or more, each once, got {', '.join(names) or 'none'}"
        )
    if 0 < sum(name in SCHEMES for name in names) < len(names):
        raise ValueError(
            f"a study runs on one testbed, but conditions {', '.join(names)} are of two; make two "
            "studies"
        )
    return names


def _testbed(testbed: str | None, conditions: tuple[str, ...], population: object) -> str:
    """Return the testbed that conditions, population and argument agree on."""
    known = [name for name, group in TESTBEDS.items() if conditions[0] in group]
    if testbed is None:
        return "uav_following" if isinstance(population, FollowingPopulation) else known[0]
    one_of("testbed", testbed, TESTBEDS)
    found = [name for name in known if testbed in (name, name.partition("_following")[0])]
    if not found:
        where = f"the testbed {testbed!r}, but on {' or '.join(known)}"
        raise ValueError(f"conditions {', '.join(conditions)} do not run on {where}")
    return found[0]


def _fitting(population: object, testbed: str) -> Population:
    """Return a population of operators of the testbed."""
    if population is None:
        return (
            GroundRobotPopulation.published()
            if testbed == "ground_robot"
            else POPULATIONS[testbed]()
        )
    return of_class(
        "population", population, POPULATIONS[testbed], f"the conditions are of {WORDS[testbed]}"
    )


def _designed(
    design: object, n: int | None, conditions: tuple, seed: int, testbed: str
) -> LatinSquareDesign:
    """Return a design whose participants are numbered and enough for repeated measures."""
    n = None if n is None else whole_number("n", n)
    if isinstance(design, LatinSquareDesign):
        count = len(design.participants)
        if n is not None and n != count:
            raise ValueError(f"design is for {count} participants, but n = {n}")
        if design.participants != tuple(range(1, count + 1)):
            raise ValueError(
                "the participants of a virtual study are numbered: make the design with their "
                "number"
            )
        if count < 3:
            raise ValueError(
                f"{count} participants are too few for the design: repeated measures need at "
                "least 3"
            )
        return design
    least = participants_needed(len(conditions), 3)
    if n is None:
        n = participants_needed(len(conditions), PRINTED_N[testbed])
    if n < max(3, len(conditions)):
        square = f"a balanced Latin square of {len(conditions)} conditions"
        raise ValueError(
            f"n = {n} is too small for the design: {square} needs {least} participants"
        )
    k = len(conditions)
    if k % 2 == 0 or n % (2 * k) != k:
        return latin_square_design(conditions, n, seed=seed)
    # The first k orders of a square for odd k are a Latin square by themselves: every condition
    # once at every position.
    whole = latin_square_design(conditions, n + k, seed=seed)
    half = tuple(row for row in whole.rows[n - k :] if row <= k)
    warn(
        f"{n} participants fill half of the last square: each of the {k} conditions stands "
        "equally often at every position, but does not follow every other one equally often; "
        f"{n + k} participants would balance both"
    )
    return replace(whole, participants=tuple(range(1, n + 1)), rows=whole.rows[: n - k] + half)


def _settings(
    testbed: str, laps: int | None, duration: float | None, rest: float | None, assumptions: Any
) -> dict:
    """Return the settings of all runs; raise where one would have no effect."""
    idle: dict[str, object] = {"laps": laps, "rest": rest, "assumptions": assumptions}
    if testbed != "uav":
        idle = {"duration": duration, "laps": None if testbed == "ground_robot" else laps}
    for name, value in idle.items():
        if value is not None:
            raise ValueError(f"{name} has no effect on {WORDS[testbed]}; leave it out")
    if testbed == "uav":
        return {"duration": 120.0 if duration is None else finite_number("duration", duration)}
    laps = 8 if laps is None else whole_number("laps", laps, most=MOST_LAPS)
    settings = {"laps": laps} if testbed == "ground_robot" else {}
    assumed = checked_assumptions({} if assumptions is None else assumptions)
    return settings | {
        "rest": None if rest is None else not_negative("rest", rest),
        "assumptions": assumed,
    }


def _tidy(
    done: pd.DataFrame, design: LatinSquareDesign, conditions: tuple[str, ...]
) -> pd.DataFrame:
    """Return a row per session from a row per participant."""
    prefix = f"{conditions[0]}/"
    names = [column.removeprefix(prefix) for column in done.columns if column.startswith(prefix)]
    wide = done.set_index(done["participant"].astype(int))
    parts = [wide[[f"{c}/{name}" for name in names]].set_axis(names, axis=1) for c in conditions]
    long = pd.concat(parts, keys=conditions, names=["condition"]).astype(float).reset_index()
    frame = design.orders().merge(long, on=["participant", "condition"], validate="one_to_one")
    frame["condition"] = pd.Categorical(
        frame["condition"], categories=list(conditions), ordered=False
    )
    frame["synthetic"] = True
    frame = frame[[*KEYS, *names]].sort_values(["participant", "position"], ignore_index=True)
    frame.attrs = {"origin": ORIGIN}
    return frame


class Folder:
    """
    Where a virtual study is written; refused if it holds other things, or sessions not known to be
    of this study.
    """

    def __init__(self, path: str | os.PathLike, design: LatinSquareDesign, fresh: bool = False):
        self.path = folder_path(path)
        self.sessions, self.campaign = self.path / "sessions", self.path / "campaign"
        with writing_in(self.path):
            present = {item.name for item in self.path.iterdir()} if self.path.exists() else set()
            refuse(self.path, "other things", present - {"sessions", "campaign", *FILES})
            self.sessions.mkdir(parents=True, exist_ok=True)
        held = {item.name for item in self.sessions.iterdir() if not item.name.startswith(".")}
        known = set()
        if (self.campaign / "campaign.json").is_file():
            known = {session_file(*row) for row in design.orders().itertuples(index=False)}
            if fresh:
                known = {
                    name for name in held if fnmatchcase(name, "participant_*_trial_*.parquet")
                }
        refuse(self.sessions, "sessions that are not known to be of this study", held - known)
        if fresh:
            for name in known & held:
                (self.sessions / name).unlink()

    def finish(self, study: VirtualStudy) -> None:
        """Check that every session is there, and write the tables beside them."""
        failed = set(study.failures["participant"])
        orders = study.design.orders()
        rows = orders[~orders["participant"].isin(failed)].itertuples(index=False)
        wanted = [session_file(*row) for row in rows]
        missing = [name for name in wanted if not (self.sessions / name).is_file()]
        if missing:
            raise ValueError(
                f"{len(missing)} of {len(wanted)} sessions are missing from {self.sessions} "
                f"({missing[0]} first), although the campaign beside it says that they were run; "
                "remove the folder and run the study again"
            )
        about = (
            f"SIMULATED. {study.summary}\nOne file per session in sessions/: "
            "trustlab.read_sessions reads them.\n"
        )
        with writing_in(self.path):
            study.participants.to_csv(self.path / "participants.csv", index=False)
            orders.to_csv(self.path / "orders.csv", index=False)
            study.measures.to_csv(self.path / "measures.csv", index=False)
            (self.path / "about.txt").write_text(about, encoding="utf-8")


# What makes an operator of a row of the population's draw, by testbed.
PERSONS = {
    "ground_robot": GroundRobotPopulation.person,
    "uav_following": FollowingPopulation.person,
}


def session_file(participant: int, position: int, condition: str) -> str:
    """
    Return the name of the file that holds one session; participants and positions count from 1.
    """
    return f"participant_{participant:05d}_trial_{position}_{condition}.parquet"


def run_participant(
    testbed: str,
    participant: int,
    order: str,
    settings: dict,
    folder: str | None,
    seed: SeedSequence,
    **operator: float,
) -> dict[str, float]:
    """
    Run all conditions for one simulated operator, and return measures as "condition/measure": a
    task of `run_campaign`.

    `order` holds the conditions in their order, separated by blanks; `settings` assumptions of
    C1–C5, laps of the ground robot and rest [s] (the pause between sessions, or None where each
    begins with the operator's r0), or study and duration [s] of teleoperation; `operator` is a row
    of the population's draw.
    """
    conditions = order.split()
    # Each condition has a seed by its place in the alphabet, so that the order has no effect on its
    # noise.
    streams = dict(zip(sorted(conditions), seed.spawn(len(conditions)), strict=True))
    values, found = operator | {"participant": participant}, {}
    run = (
        _Allocated(testbed, values, settings)
        if testbed in PERSONS
        else _Teleoperated(values, settings)
    )
    for position, condition in enumerate(conditions, start=1):
        if folder is None:
            measures = run.measures(condition, position, streams[condition])
        else:
            session, measures = run.session(condition, position, streams[condition])
            named = session.with_metadata(trial=position, testbed=testbed)
            write_session(named, Path(folder) / session_file(participant, position, condition))
        found |= {f"{condition}/{name}": float(value) for name, value in measures.items()}
    return found


class _Teleoperated:
    """A teleoperator's runs."""

    def __init__(self, values: dict[str, float], settings: dict):
        self.person, self.settings = TeleoperatorPopulation.person(values), settings

    def session(self, scheme: str, position: int, seed: SeedSequence):
        study, duration = self.settings["study"], self.settings["duration"]
        session = simulate_teleoperation(scheme, self.person, study, seed=seed, duration=duration)
        measures = teleoperation_measures(session).iloc[0].drop(["participant", "scheme"]).to_dict()
        return session, measures

    def measures(self, scheme: str, position: int, seed: SeedSequence) -> dict[str, float]:
        return self.session(scheme, position, seed)[1]


class _Allocated:
    """
    An operator's runs under C1–C5; utilization is carried over where sessions have a rest between
    them.
    """

    def __init__(self, testbed: str, values: dict[str, float], settings: dict):
        self.testbed = testbed
        self.settings = settings
        self.carried = None
        someone, self.model, self.thresholds = PERSONS[testbed](values)
        self.person = replace(someone, **settings.get("assumptions", {}))

    def _arguments(self, condition: str, position: int) -> dict:
        person = replace(self.person, sessions=position - 1)
        return {"condition": condition, "operator": person, "model": self.model, "r0": self.carried}

    def _rested(self, last: float) -> None:
        if self.settings["rest"] is not None:
            self.carried = last * self.model.human.a ** (self.settings["rest"] / SAMPLE_TIME)

    def session(self, condition: str, position: int, seed: SeedSequence):
        own = {} if self.testbed != "ground_robot" else {"laps": self.settings["laps"]}
        if suggested_by_tsc(condition):
            own["thresholds"] = self.thresholds
        run = run_condition(
            **self._arguments(condition, position), seed=seed, testbed=self.testbed, **own
        )
        self._rested(float(run.session["r"][-1]))
        return run.session, run.measures

    def measures(self, condition: str, position: int, seed: SeedSequence) -> dict[str, float]:
        arguments = self._arguments(condition, position) | {
            "thresholds": self.thresholds,
            "seed": seed,
        }
        if self.testbed == "ground_robot":
            measures, last = measured_condition(**arguments, laps=self.settings["laps"])
        else:
            measures, last = measured_flight(**arguments)
        self._rested(last)
        return measures
