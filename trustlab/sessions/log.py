"""What a file holds on its way to a session, and the text that metadata are written as."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trustlab.sessions.errors import SessionError
from trustlab.sessions.session import Metadata

__all__ = ["MAX_SAMPLES", "Log", "check_sqlite_path", "metadata_from_json", "metadata_to_json"]

MAX_SAMPLES = 20_000_000
"""The longest log that is read or made by resampling (five and a half hours at 1 kHz)."""


@dataclass
class Log:
    """
    Columns of one file, in SI units, not yet checked.

    Parameters
    ----------
    source : str
        The file.
    t : numpy.ndarray, shape (N,)
        Time [s].
    columns : dict of str to numpy.ndarray
        Session column to its samples, shape (N,).
    place : callable
        Names the place of sample k in the file.
    metadata : Metadata, optional
        What the file says of itself.
    fault : SessionError, optional
        Why reading stopped after the samples there are.
    notes : dict
        Metadata that reading gives: start_time, resampled.
    """

    source: str
    t: np.ndarray
    columns: dict[str, np.ndarray]
    place: Callable[[int], str]
    metadata: Metadata | None = None
    fault: SessionError | None = None
    notes: dict[str, object] = field(default_factory=dict)


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not a plain value")


def metadata_to_json(metadata: Metadata, **extra: object) -> str:
    """
    Return metadata as one line of JSON.

    Parameters
    ----------
    metadata : Metadata
        What to write; the source is left out, as it will be the new file.
    **extra : object
        What else to put beside.

    Raises
    ------
    SessionError
        If a value would not read back the same (write plain numbers, texts, lists and tables of them).
    """
    content = metadata.as_dict() | {"more": dict(metadata.more)}
    content = {name: content[name] for name in ("participant", "condition", "synthetic", "more")}
    for name, value in [*content.items(), *metadata.more.items()]:
        try:
            same = json.loads(json.dumps(value, default=_plain)) == value
        except (TypeError, ValueError, RecursionError):
            same = False
        if not (same if isinstance(same, bool) else False) and name != "more":
            raise SessionError(
                f"metadata {name!r} cannot be written so that it reads back the same: {value!r}; "
                "use plain numbers, texts, lists or dictionaries with text keys",
                metadata.source,
            )
    return json.dumps(content | extra, default=_plain)


def metadata_from_json(text: str, source: str) -> tuple[Metadata, dict]:
    """
    Return the metadata written by `metadata_to_json`, and what was put beside.

    Parameters
    ----------
    text : str
        The JSON.
    source : str
        The file it was found in.

    Raises
    ------
    SessionError
        If it is damaged.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SessionError(
            f"the trustlab metadata are damaged ({error}); write the file again", source
        ) from error
    kinds = {
        "participant": (str, int, type(None)),
        "condition": (str, int, float, type(None)),
        "synthetic": (bool,),
        "more": (dict,),
    }
    if not isinstance(content, dict):
        raise SessionError(
            f"the trustlab metadata must be a JSON object, found {type(content).__name__}", source
        )
    found = {}
    for name, kind in kinds.items():
        value = content.pop(name, {"synthetic": False, "more": {}}.get(name))
        if not isinstance(value, kind):
            raise SessionError(f"the trustlab metadata give {name} as {str(value)[:100]!r}", source)
        found[name] = value
    return Metadata(source=source, **found), content


def check_sqlite_path(path: Path) -> None:
    """
    Raise where a sqlite3 recording cannot be opened because its path would be read as a URI with a query.

    Parameters
    ----------
    path : Path
        The recording.

    Raises
    ------
    SessionError
        If its absolute path has one of ? # %.
    """
    for mark in "?#%":
        if mark in str(path.absolute()):
            raise SessionError(
                f"a sqlite3 recording cannot stand under a path with {mark!r} in it; rename the folder, or use .mcap",
                str(path),
            )
