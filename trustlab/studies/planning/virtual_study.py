"""A whole study with simulated operators: from its design to its statistics."""

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from trustlab.campaign.run import run_campaign, where_to_run
from trustlab.models.checks import finite_number, flag, not_negative, of_class, one_of, whole_number
from trustlab.operators.ground_robot import checked_assumptions
from trustlab.studies.designs import LatinSquareDesign, latin_square_design, participants_needed
from trustlab.studies.planning.populations import GroundRobotPopulation, TeleoperatorPopulation
from trustlab.studies.planning.virtual_folder import Folder
from trustlab.studies.planning.virtual_participant import run_participant
from trustlab.studies.planning.virtual_report import KEYS, ORIGIN, WORDS, Population, VirtualStudy
from trustlab.teleoperation.loop.schemes import SCHEMES
from trustlab.testbeds.deciding import CONDITIONS, KNOWN, warn_if_too_short
from trustlab.testbeds.ground_robot.conditions import MOST_LAPS
from trustlab.testbeds.uav_following.people import FollowingPopulation

TESTBEDS = {"ground_robot": tuple(KNOWN), "uav": tuple(SCHEMES), "uav_following": tuple(KNOWN)}
MAIN_SCHEMES = ("M", "OMI", "MMI", "TMIG")
PRINTED_N = {"ground_robot": 20, "uav": 32, "uav_following": 20}
POPULATIONS: dict[str, type] = {
    "ground_robot": GroundRobotPopulation,
    "uav": TeleoperatorPopulation,
    "uav_following": FollowingPopulation,
}


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
    cluster: Any = None,
    executor: Any = None,
    out: str | os.PathLike | None = None,
    progress: bool | None = None,
    fresh: bool = False,
    other_versions: Sequence[str] = (),
) -> VirtualStudy:
    """
    Simulate a within-subject study from its design to its statistics.

    Operators are drawn from a population and run every condition in the orders of a Latin square; their measures are
    analysed. Given the operator, sessions are independent: orders have no effect unless `rest` is given.

    Parameters
    ----------
    design : "latin_square" or LatinSquareDesign
        Orders of conditions: a complete balanced Latin square drawn from the seed, or a design with its conditions and
        participants (numbered from 1).
    n : int, optional
        Participants; they must fill whole squares, or, for an odd number of conditions, half of the last one, which leaves carry-over
        unbalanced. As many as the dissertation's study invited, or the next whole squares.
    conditions : sequence of str, optional
        C1 to C5 and the controls "own" and "random" of `run_condition` (ground robot, or a UAV that follows a leader), or M, MI, MMI, TMIG, TMIS, OMI (teleoperation of a UAV); C1 to
        C5, or M, OMI, MMI and TMIG for a `TeleoperatorPopulation`.
    population : GroundRobotPopulation, FollowingPopulation or TeleoperatorPopulation, optional
        From whom operators are drawn; `GroundRobotPopulation.published()`, `FollowingPopulation()` or `TeleoperatorPopulation()` by
        default.
    seed : int
        Of the design, of the people and of all runs. With the same seed, the people of a smaller study are the first of a
        larger one.
    testbed : {"ground_robot", "uav"}, optional
        Where C1 to C5 are run, the testbed of Section 2.4.1 (by default) or of Section 2.4.2; schemes of Chapter 3 are of "uav".
    assumptions : mapping of str to float, optional
        For C1 to C5, what is assumed of all operators: any of `trustlab.operators.ASSUMPTIONS` by name.
    laps : int, optional
        Laps of each run of the ground robot; 8, as printed.
    duration : float, optional
        Length of each run of teleoperation [s]; 120.
    rest : float, optional
        C1 to C5 only: pause between sessions [s], in which utilization decays by (2.5) from its value at the end of the
        session before. When it is left out, every session begins with the operator's r0, 0 unless assumed otherwise.
    n_jobs, cluster, executor : int, object, Executor, optional
        Where participants are simulated, as in `run_campaign`; by default in this process. They have no effect on results.
    out : path-like, optional
        A folder for sessions/ (Parquet, one file per session, for `read_sessions`), participants.csv, orders.csv, measures.csv, about.txt
        and campaign/; a call with the same arguments goes on where a killed one stopped. Eight laps are about 1 MB.
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
        If a condition is unknown or of another testbed, the population does not fit, n is too small or fills no whole squares, or an
        argument would have no effect.

    Warns
    -----
    CampaignWarning
        If participants' runs failed; they are listed in `.failures`.
    UserWarning
        If the design leaves carry-over unbalanced, if sessions of C1 to C5 are too short for anybody to switch, or if nobody did.

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
    fixed = {"testbed": testbed, "settings": settings | own, "folder": folder and str(folder.sessions)}
    runs = people.assign(order=design.table().agg(" ".join, axis=1).to_numpy())
    done = run_campaign(
        run_participant,
        [fixed | run for run in runs.to_dict("records")],
        seed=seed,
        out=None if folder is None else folder.campaign,
        progress=progress,
        fresh=fresh,
        other_versions=other_versions,
        **where_to_run(n_jobs, cluster, executor),
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
        warnings.warn("nobody switched in any session: the conditions differ by noise only", stacklevel=3)


def _named(conditions: object, design: object, population: object) -> tuple[str, ...]:
    """Return the conditions, all of one testbed."""
    if conditions is not None and not isinstance(conditions, list | tuple | pd.Index | pd.Series):
        raise ValueError(f"conditions must be a list of names, got {conditions!r:.60}")
    if isinstance(design, LatinSquareDesign):
        if conditions is not None and tuple(conditions) != design.conditions:
            raise ValueError(f"design has the conditions {design.conditions}, but conditions= says {tuple(conditions)}")
        conditions = design.conditions
    else:
        one_of("design", design, ["latin_square"], "a LatinSquareDesign")
    if conditions is None:
        return MAIN_SCHEMES if isinstance(population, TeleoperatorPopulation) else tuple(CONDITIONS)
    known = [*KNOWN, *SCHEMES]
    names = tuple(one_of("condition", name, known) for name in conditions)
    if len(names) < 2 or len(set(names)) < len(names):
        raise ValueError(f"conditions must be two or more, each once, got {', '.join(names) or 'none'}")
    if 0 < sum(name in SCHEMES for name in names) < len(names):
        raise ValueError(f"a study runs on one testbed, but conditions {', '.join(names)} are of two; make two studies")
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
        return GroundRobotPopulation.published() if testbed == "ground_robot" else POPULATIONS[testbed]()
    return of_class("population", population, POPULATIONS[testbed], f"the conditions are of {WORDS[testbed]}")


def _designed(design: object, n: int | None, conditions: tuple, seed: int, testbed: str) -> LatinSquareDesign:
    """Return a design whose participants are numbered and enough for repeated measures."""
    n = None if n is None else whole_number("n", n)
    if isinstance(design, LatinSquareDesign):
        count = len(design.participants)
        if n is not None and n != count:
            raise ValueError(f"design is for {count} participants, but n = {n}")
        if design.participants != tuple(range(1, count + 1)):
            raise ValueError("the participants of a virtual study are numbered: make the design with their number")
        if count < 3:
            raise ValueError(f"{count} participants are too few for the design: repeated measures need at least 3")
        return design
    least = participants_needed(len(conditions), 3)
    if n is None:
        n = participants_needed(len(conditions), PRINTED_N[testbed])
    if n < max(3, len(conditions)):
        square = f"a balanced Latin square of {len(conditions)} conditions"
        raise ValueError(f"n = {n} is too small for the design: {square} needs {least} participants")
    k = len(conditions)
    if k % 2 == 0 or n % (2 * k) != k:
        return latin_square_design(conditions, n, seed=seed)
    # The first k orders of a square for odd k are a Latin square by themselves: every condition once at every position.
    whole = latin_square_design(conditions, n + k, seed=seed)
    half = tuple(row for row in whole.rows[n - k :] if row <= k)
    warnings.warn(
        f"{n} participants fill half of the last square: each of the {k} conditions stands equally often at every position, but does "
        f"not follow every other one equally often; {n + k} participants would balance both",
        stacklevel=3,
    )
    return replace(whole, participants=tuple(range(1, n + 1)), rows=whole.rows[: n - k] + half)


def _settings(testbed: str, laps: int | None, duration: float | None, rest: float | None, assumptions: Any) -> dict:
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
    return settings | {"rest": None if rest is None else not_negative("rest", rest), "assumptions": assumed}


def _tidy(done: pd.DataFrame, design: LatinSquareDesign, conditions: tuple[str, ...]) -> pd.DataFrame:
    """Return a row per session from a row per participant."""
    prefix = f"{conditions[0]}/"
    names = [column.removeprefix(prefix) for column in done.columns if column.startswith(prefix)]
    wide = done.set_index(done["participant"].astype(int))
    parts = [wide[[f"{c}/{name}" for name in names]].set_axis(names, axis=1) for c in conditions]
    long = pd.concat(parts, keys=conditions, names=["condition"]).astype(float).reset_index()
    frame = design.orders().merge(long, on=["participant", "condition"], validate="one_to_one")
    frame["condition"] = pd.Categorical(frame["condition"], categories=list(conditions), ordered=False)
    frame["synthetic"] = True
    frame = frame[[*KEYS, *names]].sort_values(["participant", "position"], ignore_index=True)
    frame.attrs = {"origin": ORIGIN}
    return frame
