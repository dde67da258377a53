"""What a notebook asks for at its beginning: known parameters, and data."""

import re
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from trustlab.models.checks import one_of
from trustlab.sessions import external_data

# How the cell begins that papermill puts behind the one with the tag "parameters".
INJECTED = "# Parameters\n"
# A name that a line of a cell sets.
ASSIGNED = re.compile(r"^(\w+) *=(?!=)", re.MULTILINE)


def only_parameters(space: Mapping[str, Any]) -> None:
    """
    Refuse a parameter that a notebook does not have: papermill only warns and runs without it.

    Parameters
    ----------
    space : mapping
        `globals()` of the notebook, in a cell after its parameters; `In` has what was run.

    Raises
    ------
    ValueError
        If papermill sets a name that the cell of the parameters does not set; the message suggests
        the nearest.
    """
    for before, cell in pairwise(space.get("In", ())):
        declared = ASSIGNED.findall(before)
        if declared and cell.startswith(INJECTED):
            for name in ASSIGNED.findall(cell):
                one_of("a parameter of this notebook", name, declared)


class DataAbsentError(FileNotFoundError):
    """Third-party data are not here; a chapter that needs them is left out of the book."""


def required_data(name: str) -> Path:
    """
    Return the folder of third-party data that a notebook cannot do without.

    Parameters
    ----------
    name : str
        The folder, as `trustlab.sessions.external_data` looks for it.

    Raises
    ------
    DataAbsentError
        If it is absent, with where to put it.
    """
    folder = external_data(name)
    if folder is None:
        raise DataAbsentError(
            f"the data set {name} is not here. It is public but has no licence, so this project "
            f"does not ship it. Put it in data/external/{name}, or set TRUSTLAB_DATA to the folder "
            "above it, and run make reports again."
        )
    return folder
