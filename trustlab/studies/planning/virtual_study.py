"""A whole study with simulated operators: from its design to its statistics."""

from __future__ import annotations

import os
from collections.abc import Sequence

import pandas as pd

from trustlab.models.checks import finite_number, whole_number
from trustlab.studies.designs import LatinSquareDesign, latin_square_design, participants_needed
from trustlab.studies.planning.populations import GroundRobotPopulation, TeleoperatorPopulation
from trustlab.studies.planning.virtual_folder import Folder
from trustlab.studies.planning.virtual_participant import run_participant
from trustlab.studies.planning.virtual_report import KEYS, ORIGIN, WORDS, VirtualStudy
from trustlab.teleoperation.loop.schemes import SCHEMES
from trustlab.testbeds.ground_robot import CONDITIONS, MOST_LAPS

__all__ = ["virtual_study"]

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
    n_jobs: int = 1,
    out: str | os.PathLike | None = None,
    progress: bool | None = None,
) -> VirtualStudy:
    """
    Simulate a within-subject study from its design to its statistics.

    Operators are drawn from a population, come in the orders of a Latin square, run every condition, are measured, and the
    measures are analysed. Sessions are independent given the operator: orders and carry-over have no effect unless `rest` is given.

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
        Whom operators are drawn from; `GroundRobotPopulation.published()` or `TeleoperatorPopulation()` by default.
    seed : int
        Of the design, of the people and of all runs. With the same seed the people of a smaller study are the first of a larger.
    laps : int, optional
        Laps of each run of the ground robot; 8, as printed.
    duration : float, optional
        Length of each run of the UAV [s]; 120.
    rest : float, optional
        Ground robot only: pause between sessions [s], in which utilization decays by (2.5) from where the session before it ended. When not
        given every session begins with r = 0.
    n_jobs : int
        Processes, as for `run_campaign`.
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
    folder = None if out is None else Folder(out)
    plan = design.table()
    fixed = {
        "testbed": testbed,
        "study": getattr(population, "study", ""),
        "laps": settings.get("laps", 0),
        "length": settings.get("duration", 0.0),
        "rest": settings.get("rest"),
        "folder": None if folder is None else str(folder.sessions),
    }
    parameters = [
        fixed | {"order": " ".join(plan.loc[person["participant"]])} | person
        for person in people.to_dict("records")
    ]
    from trustlab.campaign import run_campaign

    if folder is not None:
        folder.prepare(design)
    done = run_campaign(
        run_participant,
        parameters,
        seed=seed,
        n_jobs=n_jobs,
        out=None if folder is None else folder.campaign,
        progress=progress,
    )
    failed = done["failed"].to_numpy(dtype=bool)
    if failed.all():
        raise ValueError(f"every participant's run failed; the first: {done['error'].iloc[0]}")
    measures = _tidy(done[~failed], design, conditions)
    failures = done.loc[failed, ["participant", "error"]].reset_index(drop=True)
    study = VirtualStudy(
        testbed,
        conditions,
        design,
        population,
        people,
        measures,
        failures,
        {"seed": seed} | settings,
        None if folder is None else folder.path,
    )
    if folder is not None:
        folder.finish(study)
    return study


def _named(conditions, design, population) -> tuple[str, ...]:
    """Return the conditions, all of one testbed."""
    if conditions is not None and not isinstance(conditions, list | tuple | pd.Index | pd.Series):
        raise ValueError(f"conditions must be a list of names, got {conditions!r:.60}")
    if isinstance(design, LatinSquareDesign):
        if conditions is not None and tuple(conditions) != design.conditions:
            raise ValueError(
                f"design has the conditions {design.conditions}, but conditions= says {tuple(conditions)}"
            )
        conditions = design.conditions
    elif not isinstance(design, str) or design != "latin_square":
        raise ValueError(f"design must be 'latin_square' or a LatinSquareDesign, got {design!r:.60}")
    if conditions is None:
        return MAIN_SCHEMES if isinstance(population, TeleoperatorPopulation) else TESTBEDS["ground_robot"]
    from difflib import get_close_matches

    names = tuple(conditions)
    known = [name for group in TESTBEDS.values() for name in group]
    for name in names:
        if not isinstance(name, str) or name not in known:
            near = get_close_matches(str(name).upper(), known, n=1, cutoff=0.4)
            meant = f"; did you mean {near[0]!r}?" if near else ""
            there = "; ".join(
                f"{WORDS[testbed]} has {', '.join(group)}" for testbed, group in TESTBEDS.items()
            )
            raise ValueError(f"unknown condition {name!r:.60}{meant} ({there})")
    if len(names) < 2 or len(set(names)) < len(names):
        raise ValueError(f"conditions must be two or more, each once, got {', '.join(names) or 'none'}")
    beds = {testbed: [c for c in names if c in group] for testbed, group in TESTBEDS.items()}
    if all(beds.values()):
        mixed = " and ".join(f"{', '.join(own)} of {WORDS[testbed]}" for testbed, own in beds.items())
        raise ValueError(f"a study runs on one testbed, but conditions are {mixed}; make two studies")
    return names


def _fitting(population, testbed: str):
    if population is None:
        return GroundRobotPopulation.published() if testbed == "ground_robot" else TeleoperatorPopulation()
    if not isinstance(population, GroundRobotPopulation | TeleoperatorPopulation):
        raise ValueError(
            "population must be a GroundRobotPopulation or a TeleoperatorPopulation, got "
            f"{type(population).__name__}; trustlab.studies.GroundRobotPopulation.published() is one"
        )
    if population.testbed != testbed:
        raise ValueError(
            f"population {type(population).__name__} is of {WORDS[population.testbed]}, but the conditions are of {WORDS[testbed]}"
        )
    return population


def _designed(design, n, conditions, seed, testbed) -> LatinSquareDesign:
    k = len(conditions)
    if n is not None:
        n = whole_number("n", n)
    if isinstance(design, LatinSquareDesign):
        count = len(design.participants)
        if n is not None and n != count:
            raise ValueError(f"design is for {count} participants, but n = {n}")
        if design.participants != tuple(range(1, count + 1)):
            raise ValueError(
                "the participants of a virtual study are numbered: make the design with their number"
            )
        if count < 3:
            raise ValueError(
                f"{count} participants are too few for the design: repeated measures need at least 3"
            )
        return design
    if n is None:
        n = participants_needed(k, PRINTED_N[testbed])
    if n < max(3, participants_needed(k)):
        raise ValueError(
            f"n = {n} is too small for the design: a balanced Latin square of {k} conditions needs "
            f"{participants_needed(k, 3)} participants"
        )
    return latin_square_design(conditions, n, seed=seed)


def _settings(testbed: str, laps, duration, rest) -> dict:
    if testbed == "uav":
        for name, value in (("laps", laps), ("rest", rest)):
            if value is not None:
                raise ValueError(f"{name} has no effect on {WORDS[testbed]}; leave it out")
        return {"duration": 120.0 if duration is None else finite_number("duration", duration)}
    if duration is not None:
        raise ValueError(
            f"duration has no effect on {WORDS[testbed]}, where runs last laps= laps; leave it out"
        )
    laps = 8 if laps is None else whole_number("laps", laps, most=MOST_LAPS)
    if rest is not None:
        rest = finite_number("rest", rest)
        if rest < 0.0:
            raise ValueError(f"rest cannot be negative, got {rest}")
    return {"laps": laps, "rest": rest}


def _tidy(done: pd.DataFrame, design: LatinSquareDesign, conditions: tuple[str, ...]) -> pd.DataFrame:
    """Return a row per session from a row per participant."""
    prefix = f"{conditions[0]}/"
    names = [column.removeprefix(prefix) for column in done.columns if column.startswith(prefix)]
    parts = []
    for condition in conditions:
        part = done[[f"{condition}/{name}" for name in names]].set_axis(names, axis=1).astype(float)
        part.insert(0, "participant", done["participant"].astype(int))
        part.insert(1, "condition", condition)
        parts.append(part)
    orders = design.orders()
    frame = orders.merge(
        pd.concat(parts), on=["participant", "condition"], how="inner", validate="one_to_one"
    )
    frame["condition"] = pd.Categorical(frame["condition"], categories=list(conditions), ordered=False)
    frame["synthetic"] = True
    frame = frame[[*KEYS, *names]].sort_values(["participant", "position"], ignore_index=True)
    frame.attrs = {"origin": ORIGIN}
    return frame
