"""Public data of real people as panels; where they are from stands in data/people/."""

import json
import os
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import did_you_mean, one_of
from trustlab.models.files import path_of
from trustlab.models.published import data_folder
from trustlab.sessions.errors import damage_named
from trustlab.trust.panel import Panel, panel_of

SEVEN_POINTS: dict[str, Any] = {"low": 1.0, "high": 7.0, "resolution": 1.0 / 6.0}
# Of a live study: trust by the checklist after every drive.
STUDY_RECIPE: dict[str, Any] = {
    "columns": {"person": "participant", "trial": "position", "rating": "trust_mean", "p_r": "p_r"},
    "low": 1.0,
    "high": 7.0,
    "before": False,
}


def read_people(name: Any, recipe: Mapping | str | os.PathLike | None = None) -> Panel:
    """
    Return trust that people rated, and what they had seen, as a panel.

    Parameters
    ----------
    name : str, path, pandas.DataFrame or RecordedStudy
        A public set that comes with trustlab, "hybrid_real", "hybrid_vr", "trust_transfer" or
        "btm"; a CSV file or a table with a row per person and trial; or a live study,
        `tl.read_live_study(folder)`.
    recipe : mapping or path, optional
        Of a file, table or study, or a TOML file that holds it: `columns`, which maps person,
        trial (a number, which only orders rows: keep those without a rating), rating, p_r and
        further signals of `Event` to the table's names; `low` and `high`, the ends of the scale;
        `performance`, the values of p_r that are worst and best, 0 and 1 when not given; `before`,
        whether the first row of a person is the rating before the first event; `resolution`, a
        point as a share of the scale (1/6 of 1 to 7); `source`; `cautions`.

    Returns
    -------
    Panel
        `cautions` say what these data cannot show.

    Raises
    ------
    ValueError
        If there is no such set or file, a column is missing, or a row is no trial of a person with
        numbers on their scales; also for a recipe beside a public set.

    Notes
    -----
    Y. Du and others, hybrid trust dataset, 2026: 100 people with a real robot and 100 in virtual
    reality, ten trials each. H. Soh and others, RSS 2018: 32 people, a task before and after two
    observed performances. H. Azevedo-Sa and others, RA-L 2021: trust after three observed tasks,
    852 answers. All under the MIT licence, which lies beside each.

    Examples
    --------
    >>> import trustlab as tl
    >>> panel = tl.read_people("hybrid_vr")
    >>> len(panel), panel.trials
    (100, 10)
    """
    if isinstance(name, str) and name in SETS:
        if recipe is not None:
            raise ValueError(f"recipe: {name!r} has a recipe of its own; leave this one out")
        file, read = SETS[name]
        return read(data_folder("people") / file)
    if isinstance(recipe, str | os.PathLike):
        with damage_named(f"{recipe}: no recipe", "give a file in TOML"):
            recipe = tomllib.loads(Path(recipe).read_text(encoding="utf-8"))
    settings = dict(recipe or {})
    for key in settings:
        one_of("a recipe's key", key, panel_of.__kwdefaults__)
    if isinstance(name, pd.DataFrame):
        return panel_of(name, **settings)
    # A live study is known by its measures: its room is below this one.
    if hasattr(name, "measures"):
        return panel_of(name.measures, **STUDY_RECIPE | {"source": repr(name)} | settings)
    path = path_of("name, where it is no set, table or study,", name)
    if not path.is_file():
        meant = did_you_mean(name, SETS)
        raise ValueError(f"name: no set or file {str(name)!r}{meant} (sets: {', '.join(SETS)})")
    with damage_named(f"{path}: no table", "save it with commas and decimal points, in UTF-8"):
        table = pd.read_csv(path)
        if table.shape[1] == 1:
            raise ValueError(f"one column, {table.columns[0]!r}")
    return panel_of(table, **{"source": str(path), **settings})


def _hybrid(path: Path) -> Panel:
    """Return the panel of a file of the hybrid set."""
    # The published VR file is no valid JSON: between two numbers a comma is missing.
    text = re.sub(r"(\d)(\s*\n\s*\d)", r"\1,\2", path.read_text(encoding="utf-8"))
    tables = []
    for person in json.loads(text):
        signals = ("state", "robot_decision_making", "human_decision_making")
        state, advice, decision = (np.array(person[signal]) for signal in signals)
        seen = {"p_r": advice == state, "p_h": decision == state, "followed": advice == decision}
        table = pd.DataFrame({name: np.append(np.nan, values) for name, values in seen.items()})
        trial, who = table.index, person["human_id"]
        tables.append(table.assign(person=who, trial=trial, rating=person["trust"]))
    source = f"Du and others 2026, {path.stem}, MIT"
    return panel_of(pd.concat(tables), resolution=0.01, source=source, cautions=(HYBRID,))


def _transfer(path: Path) -> Panel:
    """Return trust in three tasks before and after two observed ones; a row per person and task."""
    rows = [
        (f"P{person:02d} {task}", trial, answers[f"{task}{trial + 1}_rating"], answers["B_SF"], 2.0)
        for person, answers in enumerate(pd.read_csv(path).to_dict("records"))
        for task in "CDE"
        for trial in (0, 1)
    ]
    cautions = (
        "Two times only: these data show how far trust moves, not how it goes on.",
        "Three rows are one person's, for three tasks; the task observed is another one.",
    )
    table = pd.DataFrame(rows, columns=["person", "trial", "rating", "p_r", "dt"])
    source = "Soh and others 2018, household, MIT"
    return panel_of(table, **SEVEN_POINTS, source=source, cautions=cautions)


def _capabilities(path: Path) -> Panel:
    """Return trust after three observed tasks; there are no ratings before."""
    from scipy.io import loadmat

    data = loadmat(path)
    # The file has the logistic of 7-point answers less 4.
    rated = np.round(special.logit(data["trust_pred"].ravel())) + 4.0
    rows = []
    for i, rating in enumerate(rated):
        # Pairs (failure, success) in the order in which tasks were observed; (0, 0) for none.
        success = [pair[1] for pair in data["obs_task_perf_seq"][:, i] if pair.any()]
        performances, ratings = [np.nan, *success], [*(np.nan for _ in success), rating]
        for trial, seen in enumerate(zip(performances, ratings, strict=True)):
            rows.append((f"A{i:03d}", trial, *seen))
    cautions = (
        "A row is an answer, not a person: three answers are one person's.",
        "The task rated is another one than those observed.",
    )
    table = pd.DataFrame(rows, columns=["person", "trial", "p_r", "rating"])
    source = "Azevedo-Sa and others 2021, MIT"
    return panel_of(table, **SEVEN_POINTS, source=source, cautions=cautions)


HYBRID = (
    "Following advice is nearly a step function of trust at .5 (r is above .9 between trust above "
    ".5 and following): draw no conclusion on reliance from these data."
)
# The file of each set, as its authors published it, and what reads it.
SETS: dict[str, tuple[str, Callable[[Path], Panel]]] = {
    "hybrid_real": ("hybrid_trust_du2026/Real_World_data.json", _hybrid),
    "hybrid_vr": ("hybrid_trust_du2026/VR_Based_data.json", _hybrid),
    "trust_transfer": ("trust_transfer_soh2018/trust_transfer_household_cleaned.csv", _transfer),
    "btm": ("btm_azevedo2021/MatDataset.mat", _capabilities),
}
