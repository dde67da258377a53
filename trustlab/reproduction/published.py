"""What the dissertation prints, as strings, and the models with the printed parameters."""

import tomllib
from functools import cache

import pandas as pd

from trustlab.models.checks import one_of
from trustlab.models.published import (
    published_folder,
    published_models as published_models,
    published_table as published_table,
)


@cache
def published_facts(name: str) -> dict:
    """Return what a TOML file of data/published says; it is read once and must not be changed."""
    return tomllib.loads((published_folder() / f"{name}.toml").read_text(encoding="utf-8"))


# What became of a claim; data/published/verdicts.toml says what each word means.
VERDICTS = (
    "holds",
    "holds with a condition",
    "fails",
    "reproduced",
    "within rounding",
    "differs",
    "reconstructed",
    "not explained by the models",
    "not checkable",
    "diagram",
)


def verdicts(report: str | None = None) -> pd.DataFrame:
    """
    Return what became of every claim of the dissertation.

    Parameters
    ----------
    report : str, optional
        Only the claims that a report shows, such as "allocation"; without diagrams.

    Returns
    -------
    pandas.DataFrame
        Index `claim` in the order of the text: theorems, equations, figures, tables, studies and
        statements; columns says, verdict, why, instead, report and section, empty where there is
        nothing to say.

    Raises
    ------
    ValueError
        If no claim is shown in a report of this name.

    Examples
    --------
    >>> from trustlab.reproduction import verdicts
    >>> verdicts().loc["Theorem 2", "verdict"]
    'fails'
    """
    table = pd.DataFrame.from_dict(published_facts("verdicts"), orient="index").fillna("")
    table = table.rename_axis("claim")
    if report is None:
        return table
    one_of("report", report, sorted({*table["report"]} - {""}))
    return table[(table["report"] == report) & (table["verdict"] != "diagram")]
