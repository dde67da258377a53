"""Public data of real people as panels; where they are from stands in data/people/."""

import hashlib
import json
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import did_you_mean, one_of
from trustlab.models.published import data_folder
from trustlab.sessions.folders import external_data
from trustlab.trust.panel import Panel, panel_from_table

HYBRID = (
    "Following advice is nearly a step function of trust at .5 (r is above .9 between trust above "
    ".5 and following): draw no conclusion on reliance from these data."
)
FILES = {
    "hybrid_real": "hybrid_trust_du2026/Real_World_data.json",
    "hybrid_vr": "hybrid_trust_du2026/VR_Based_data.json",
    "trust_transfer": "trust_transfer_soh2018/trust_transfer_household_cleaned.csv",
    "btm": "btm_azevedo2021/MatDataset.mat",
}
# SHA-256 of each file as its authors published it.
DIGESTS = {
    "Real_World_data.json": "19a50834eaed45535f78decf6612741e5febd1b6b8bf028f76cce13b9f4d0f3c",
    "VR_Based_data.json": "57d9add2e9290609214f63183224be88372c19f70da974d4a805f4e13ce4b4d8",
    "trust_transfer_household_cleaned.csv": (
        "fadb8d79d62c5b5a4a4880da99c927569f4adfaf92accd2870bdb5715698e552"
    ),
    "MatDataset.mat": "787eca1ffaecf4ed4d3a9d002743675cebb9e67d004e44d33a3302a884b1db39",
}
# The published VR file is no valid JSON: a comma is missing at the end of this line.
REPAIRS = {"VR_Based_data.json": (3325, "0.88")}

RECIPE = (
    "columns",
    "low",
    "high",
    "performance",
    "before",
    "resolution",
    "source",
    "cautions",
)
# Of a live study: trust by the checklist after every drive.
STUDY_RECIPE = {
    "columns": {"person": "participant", "trial": "position", "rating": "trust_mean", "p_r": "p_r"},
    "low": 1.0,
    "high": 7.0,
    "before": False,
}
AUTONOMY = "autonomy_cl_trust"
# Errors of 6 cm are greater than any of these people's.
AUTONOMY_RECIPE = {
    "columns": {"person": "pid", "rating": "p_trust", "p_r": "traj_err", "mode": "manual"},
    "low": 1.0,
    "high": 10.0,
    "performance": (6.0, 0.0),
    "before": False,
    "resolution": 1.0 / 9.0,
    "source": "Pan and others 2024, AutonomyCLTrust",
    "cautions": (
        "Four ratings of a person: they show little of how trust goes on.",
        "The error is that of person and robot together, and autonomy changes with the trial.",
    ),
}


def read_people(name: Any, recipe: Mapping | str | os.PathLike | None = None) -> Panel:
    """
    Return trust that people rated, and what they had seen, as a panel.

    Parameters
    ----------
    name : str, path, pandas.DataFrame or RecordedStudy
        A public set that comes with trustlab, "hybrid_real", "hybrid_vr", "trust_transfer" or
        "btm"; "autonomy_cl_trust", where TRUSTLAB_DATA has it; a CSV file or a table with a row per
        person and trial; or a live study, `tl.read_live_study(folder)`.
    recipe : mapping or path, optional
        Of a file, table or study, or a TOML file that holds it: `columns`, which maps person,
        trial, rating, p_r and further signals of `Event` to the table's names; `low` and `high`,
        the ends of the scale; `performance`, the values of p_r that are worst and best, 0 and 1
        when not given; `before`, whether the first row of a person is the rating before the first
        event; `resolution`; `source`; `cautions`.

    Returns
    -------
    Panel
        `cautions` say what these data cannot show.

    Raises
    ------
    ValueError
        If there is no such set or file, a file has changed, or a column is missing.

    Notes
    -----
    Y. Du and others, hybrid trust dataset, 2026: 100 people with a real robot and 100 in virtual
    reality, ten trials each. H. Soh and others, RSS 2018: 32 people, a task before and after two
    observed performances. H. Azevedo-Sa and others, RA-L 2021: trust after three observed tasks,
    852 answers. All under the MIT licence, which lies beside each. J. Pan and others, RA-L 2024
    (AutonomyCLTrust): 24 people at five levels of autonomy; no licence, so not part of trustlab.

    Examples
    --------
    >>> import trustlab as tl
    >>> panel = tl.read_people("hybrid_vr")
    >>> len(panel), panel.trials
    (100, 10)
    """
    if isinstance(name, str) and name in FILES:
        return _published(name)
    settings = _recipe(recipe)
    if isinstance(name, str) and name == AUTONOMY:
        return _from_table(_autonomy(), AUTONOMY_RECIPE | settings, AUTONOMY)
    if isinstance(name, pd.DataFrame):
        return _from_table(name, settings, "table")
    # A live study is known by its measures: its room is below this one.
    if hasattr(name, "measures"):
        settings = STUDY_RECIPE | {"source": repr(name)} | settings
        return _from_table(name.measures, settings, "measures")
    path = Path(name)
    if not path.is_file():
        known = [*FILES, AUTONOMY]
        raise ValueError(
            f"no set or file {str(name)!r}{did_you_mean(name, known)} (sets: {', '.join(known)})"
        )
    return _from_table(pd.read_csv(path), {"source": str(path)} | settings, str(path))


def _published(name: str) -> Panel:
    """Return a set that comes with trustlab, if its file is the published one."""
    path = data_folder("people") / FILES[name]
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    if digest != DIGESTS[path.name]:
        raise ValueError(
            f"{path} is not the published file (SHA-256 {digest}, expected {DIGESTS[path.name]}); "
            "restore it from the repository"
        )
    readers = {"trust_transfer": _transfer, "btm": _capabilities}
    return readers.get(name, _hybrid)(path, content)


def _recipe(recipe: Mapping | str | os.PathLike | None) -> dict[str, Any]:
    """Return a recipe, read from its file where it has one."""
    if isinstance(recipe, str | os.PathLike):
        recipe = tomllib.loads(Path(recipe).read_text(encoding="utf-8"))
    settings = dict(recipe or {})
    for key in settings:
        one_of("a recipe's key", key, RECIPE)
    return settings


def _from_table(table: pd.DataFrame, recipe: Mapping, place: str) -> Panel:
    """Return the panel of a table by a recipe; `place` says where the table is from."""
    settings = dict(recipe)
    columns = settings.pop("columns", {})
    worst, best = settings.pop("performance", (0.0, 1.0))
    before = settings.pop("before", True)
    missing = [column for column in columns.values() if column not in table]
    if missing:
        raise ValueError(f"{place}: no column {missing[0]!r} (there are {', '.join(table)})")
    table = table.rename(columns={column: signal for signal, column in columns.items()})
    if "p_r" in table:
        table["p_r"] = (table["p_r"] - worst) / (best - worst)
    if not before:
        first = table[["person"]].drop_duplicates().assign(trial=-np.inf)
        table = pd.concat([first, table], ignore_index=True)
    if "cautions" in settings:
        settings["cautions"] = tuple(settings["cautions"])
    return panel_from_table(table, **settings)


def _autonomy() -> pd.DataFrame:
    """Return ratings and errors of AutonomyCLTrust in the order in which they were made."""
    folder = external_data(AUTONOMY)
    if folder is None:
        raise ValueError(
            f"the data set {AUTONOMY!r} is not here: put it into data/external, or set "
            "TRUSTLAB_DATA to the folder that contains it (docs/reports.md)"
        )
    people = ["pid", "order", "autonomy"]
    table = pd.read_csv(folder / "measures" / "traj_err_all_levels.csv")
    rated = pd.read_csv(folder / "measures" / "p_trust.csv")
    table = table.merge(rated[[*people, "p_trust"]], how="left", on=people)
    first_half = (table["autonomy"] > 0.4) == (table["order"] == "dec")
    block = np.where(table["autonomy"] == 0.4, 0, np.where(first_half, 1, 2))
    # Within a half autonomy rises.
    table["trial"] = block + table["autonomy"] / 10.0
    table["manual"] = 1.0 - table["autonomy"]
    return table


def _hybrid(path: Path, content: bytes) -> Panel:
    """Return the panel of a file of the hybrid set, repaired where that is known to be needed."""
    lines = content.decode().splitlines()
    if path.name in REPAIRS:
        number, before = REPAIRS[path.name]
        if lines[number - 1].strip() == before:
            lines[number - 1] += ","
    rows = []
    for person in json.loads("\n".join(lines)):
        rows.append({"person": person["human_id"], "trial": 0, "rating": person["trust"][0]})
        signals = ("state", "robot_decision_making", "human_decision_making")
        trials = zip(*(person[signal] for signal in signals), person["trust"][1:], strict=True)
        for k, (state, advice, decision, rating) in enumerate(trials, 1):
            outcome = {"p_r": float(advice == state), "p_h": float(decision == state)}
            more = {"followed": float(advice == decision), "rating": rating}
            rows.append({"person": person["human_id"], "trial": k} | outcome | more)
    source = f"Du and others 2026, {path.stem}, MIT"
    return panel_from_table(pd.DataFrame(rows), resolution=0.01, source=source, cautions=(HYBRID,))


def _transfer(path: Path, content: bytes) -> Panel:
    """Return trust in three tasks before and after two observed ones; a row per person and task."""
    table = pd.read_csv(path)
    rows = []
    for person, answers in enumerate(table.to_dict("records")):
        for task in ("C", "D", "E"):
            name = f"P{person:02d} {task}"
            seen = {"p_r": float(answers["B_SF"]), "dt": 2.0}
            rows.append({"person": name, "trial": 0, "rating": answers[f"{task}1_rating"]})
            rows.append({"person": name, "trial": 1, "rating": answers[f"{task}2_rating"]} | seen)
    cautions = (
        "Two times only: these data show how far trust moves, not how it goes on.",
        "Three rows are one person's, for three tasks; the task observed is another one.",
    )
    frame = pd.DataFrame(rows)
    source = "Soh and others 2018, household, MIT"
    return panel_from_table(
        frame, low=1.0, high=7.0, resolution=1.0 / 6.0, source=source, cautions=cautions
    )


def _capabilities(path: Path, content: bytes) -> Panel:
    """Return trust after three observed tasks; there are no ratings before."""
    from scipy.io import loadmat

    data = loadmat(path)
    # Pairs (failure, success), by position in the sequence of observed tasks; (0, 0) for none.
    outcome = data["obs_task_perf_seq"].astype(float)
    # The file has the logistic of 7-point answers less 4.
    rated = np.round(special.logit(data["trust_pred"].ravel())) + 4.0
    rows = []
    for i, rating in enumerate(rated):
        name = f"A{i:03d}"
        rows.append({"person": name, "trial": 0})
        observed = [pair for pair in outcome[:, i] if pair.any()]
        for k, pair in enumerate(observed, 1):
            last = k == len(observed)
            rows.append(
                {"person": name, "trial": k, "p_r": pair[1], "rating": rating if last else np.nan}
            )
    cautions = (
        "A row is an answer, not a person: three answers are one person's.",
        "The task rated is another one than those observed.",
    )
    source = "Azevedo-Sa and others 2021, MIT"
    return panel_from_table(
        pd.DataFrame(rows),
        low=1.0,
        high=7.0,
        resolution=1.0 / 6.0,
        source=source,
        cautions=cautions,
    )
