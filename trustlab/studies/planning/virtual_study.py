"""A whole study with simulated operators: from its design to its statistics."""

import os
from collections.abc import Sequence
from typing import Any

import pandas as pd

from trustlab.campaign.run import run_campaign, where_to_run
from trustlab.models.checks import finite_number, not_negative, of_class, one_of, whole_number
from trustlab.studies.designs import LatinSquareDesign, latin_square_design, participants_needed
from trustlab.studies.planning.populations import GroundRobotPopulation, TeleoperatorPopulation
from trustlab.studies.planning.virtual_folder import Folder
from trustlab.studies.planning.virtual_participant import run_participant
from trustlab.studies.planning.virtual_report import KEYS, ORIGIN, WORDS, VirtualStudy
from trustlab.teleoperation.loop.schemes import SCHEMES
from trustlab.testbeds.ground_robot.conditions import CONDITIONS, MOST_LAPS

TESTBEDS = {"ground_robot": tuple(CONDITIONS), "uav": tuple(SCHEMES)}
MAIN_SCHEMES = ("M", "OMI", "MMI", "TMIG")
PRINTED_N = {"ground_robot": 20, "uav": 32}


def virtual_study(
    design: str | LatinSquareDesign = "latin_square",
    n: int | None = None,
    conditions: Sequence[str] | None = None,
    population: GroundRobotPopulation | TeleoperatorPopulation | None = None,
    seed: int = 0,
    *,
    laps: int | None = None,
    duration: float | None = None,
    rest: float | None = None,
    n_jobs: int | None = None,
    cluster: Any = None,
    executor: Any = None,
    out: str | os.PathLike | None = None,
    progress: bool | None = None,
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
        Participants; they must fill whole squares. As many as the dissertation's study invited, or the next whole squares.
    conditions : sequence of str, optional
        C1 to C5 on the ground-robot testbed, or M, MI, MMI, TMIG, TMIS, OMI on the UAV testbed; all of the former, or the latter's
        M, OMI, MMI and TMIG for a `TeleoperatorPopulation`.
    population : GroundRobotPopulation or TeleoperatorPopulation, optional
        From whom operators are drawn; `GroundRobotPopulation.published()` or `TeleoperatorPopulation()` by default.
    seed : int
        Of the design, of the people and of all runs. With the same seed, the people of a smaller study are the first of a
        larger one.
    laps : int, optional
        Laps of each run of the ground robot; 8, as printed.
    duration : float, optional
        Length of each run of the UAV [s]; 120.
    rest : float, optional
        Ground robot only: pause between sessions [s], in which utilization decays by (2.5) from its value at the end of the
        session before. When it is left out, every session begins with r = 0.
    n_jobs, cluster, executor : int, object, Executor, optional
        Where participants are simulated, as in `run_campaign`; by default in this process. They have no effect on results.
    out : path-like, optional
        A folder for sessions/ (Parquet, one file per session, for `read_sessions`), participants.csv, orders.csv, measures.csv, about.txt
        and campaign/; a call with the same arguments goes on where a killed one stopped. Eight laps are about 1 MB.
    progress : bool, optional
        Whether to show progress, as for `run_campaign`.

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
    """
    seed = whole_number("seed", seed, least=0)
    conditions = _named(conditions, design, population)
    testbed = next(name for name, known in TESTBEDS.items() if conditions[0] in known)
    population = _fitting(population, testbed)
    design = _designed(design, n, conditions, seed, testbed)
    settings = _settings(testbed, laps, duration, rest)
    people = population.draw(len(design.participants), seed)
    folder = None if out is None else Folder(out, design)
    own = {"study": population.study} if isinstance(population, TeleoperatorPopulation) else {}
    sessions = None if folder is None else str(folder.sessions)
    fixed = {"testbed": testbed, "settings": settings | own, "folder": sessions}
    runs = people.assign(order=design.table().agg(" ".join, axis=1).to_numpy())
    done = run_campaign(
        run_participant,
        [fixed | run for run in runs.to_dict("records")],
        seed=seed,
        out=None if folder is None else folder.campaign,
        progress=progress,
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
        {"seed": seed} | settings,
        None if folder is None else folder.path,
    )
    if folder is not None:
        folder.finish(study)
    return study


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
        return MAIN_SCHEMES if isinstance(population, TeleoperatorPopulation) else TESTBEDS["ground_robot"]
    known = [name for group in TESTBEDS.values() for name in group]
    names = tuple(one_of("condition", name, known) for name in conditions)
    if len(names) < 2 or len(set(names)) < len(names):
        raise ValueError(f"conditions must be two or more, each once, got {', '.join(names) or 'none'}")
    own = {testbed: [name for name in names if name in group] for testbed, group in TESTBEDS.items()}
    if all(own.values()):
        mixed = " and ".join(f"{', '.join(group)} of {WORDS[testbed]}" for testbed, group in own.items())
        raise ValueError(f"a study runs on one testbed, but conditions are {mixed}; make two studies")
    return names


def _fitting(population: object, testbed: str) -> GroundRobotPopulation | TeleoperatorPopulation:
    """Return a population of operators of the testbed."""
    if population is None:
        return GroundRobotPopulation.published() if testbed == "ground_robot" else TeleoperatorPopulation()
    wanted = {"ground_robot": GroundRobotPopulation, "uav": TeleoperatorPopulation}[testbed]
    return of_class("population", population, wanted, f"the conditions are of {WORDS[testbed]}")


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
    if n < max(3, participants_needed(len(conditions))):
        raise ValueError(
            f"n = {n} is too small for the design: a balanced Latin square of {len(conditions)} conditions needs {least} "
            "participants"
        )
    return latin_square_design(conditions, n, seed=seed)


def _settings(testbed: str, laps: int | None, duration: float | None, rest: float | None) -> dict:
    """Return the settings of all runs; raise where one would have no effect."""
    idle = {"laps": laps, "rest": rest} if testbed == "uav" else {"duration": duration}
    for name, value in idle.items():
        if value is not None:
            raise ValueError(f"{name} has no effect on {WORDS[testbed]}; leave it out")
    if testbed == "uav":
        return {"duration": 120.0 if duration is None else finite_number("duration", duration)}
    laps = 8 if laps is None else whole_number("laps", laps, most=MOST_LAPS)
    return {"laps": laps, "rest": None if rest is None else not_negative("rest", rest)}


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
