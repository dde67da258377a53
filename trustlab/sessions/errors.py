"""What goes wrong with a log, and where."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

__all__ = ["RecipeError", "SessionError", "nearest", "nearest_file"]


def nearest(name: object, known: Iterable[object]) -> str:
    """
    Return "; did you mean …?" for a misspelt name, or nothing when no known name is near.

    Parameters
    ----------
    name : str
        What was found.
    known : iterable of str
        What could have been meant.
    """
    known = {str(word).lower(): str(word) for word in known}
    close = difflib.get_close_matches(str(name)[:100].lower(), known, n=1, cutoff=0.6)
    return f"; did you mean {known[close[0]]!r}?" if close else ""


def nearest_file(path: Path, suffix: str = "") -> str:
    """
    Return "; did you mean …?" for the path of a file that is not there, from the names beside it.

    Parameters
    ----------
    path : pathlib.Path
        Where nothing is.
    suffix : str
        How the names end that can have been meant, for example ".toml".
    """
    try:
        beside = [each.name for each in path.parent.iterdir() if each.name.lower().endswith(suffix)]
    except (OSError, ValueError):
        beside = []
    return nearest(path.name, beside)


class SessionError(ValueError):
    """
    A log or a table that is not a session.

    Parameters
    ----------
    message : str
        What was found and what to do about it.
    source : str, optional
        The file it was found in; put in front of the message.
    row : int, optional
        The sample it was found at, from 0; tells which of two faults comes first.
    """

    def __init__(self, message: str, source: str | None = None, row: int | None = None):
        super().__init__(f"{source}: {message}" if source else message)
        self.source = source
        self.row = row


class RecipeError(SessionError):
    """A recipe that is not there or cannot be followed; takes the same arguments as SessionError."""
