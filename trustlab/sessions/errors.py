"""Errors of logs and recipes, and the parts that their messages share."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from trustlab.models.checks import did_you_mean


class SessionError(ValueError):
    """
    A log or a table that is not a valid session.

    Parameters
    ----------
    message : str
        What was found and what to do about it.
    source : str, optional
        The file in which it was found; it precedes the message.
    row : int, optional
        The sample at which it was found, from 0; decides which of two faults comes first in the
        file.

    Examples
    --------
    >>> import trustlab as tl
    >>> try:
    ...     tl.read_session("data/sessions/pilot.csv").require("r")
    ... except tl.SessionError as error:
    ...     print(error.source)
    data/sessions/pilot.csv
    """

    def __init__(self, message: str, source: str | None = None, row: int | None = None):
        super().__init__(f"{source}: {message}" if source else message)
        self.source = source
        self.row = row
        self.faults = [message]


class RecipeError(SessionError):
    """A recipe that does not exist or cannot be followed; arguments as for SessionError."""


def raise_together(faults: list[str], kind: type[SessionError] = RecipeError) -> None:
    """Raise one error that lists all faults; nothing where there are none."""
    if faults:
        each = "\n- ".join(faults)
        error = kind(faults[0] if len(faults) == 1 else f"{len(faults)} faults:\n- {each}")
        error.faults = faults
        raise error


def all_or_faults(calls: Iterable[Callable], kind: type[SessionError] = RecipeError) -> list[Any]:
    """Return what all calls return; where some raise, one error with the faults of all."""
    results = []
    faults = []
    for call in calls:
        try:
            results.append(call())
        except SessionError as error:
            kind = type(error)
            faults += error.faults
    raise_together(faults, kind)
    return results


@contextmanager
def source_named(source: str | None) -> Iterator[None]:
    """Put the name of the file in front of every error raised inside that names no file yet."""
    try:
        yield
    except SessionError as error:
        if source and error.source is None:
            error.source = source
            error.args = (f"{source}: {error}",)
        raise


@contextmanager
def damage_named(damage: str, remedy: str) -> Iterator[None]:
    """Turn any error of a decoder into a SessionError that names the damage and the remedy."""
    # Decoders meet damaged files with errors of their own, struct.error, KeyError, AssertionError,
    # zlib and database errors, MemoryError … There is no common base, so that this one place,
    # around calls into a decoder and little else, takes every Exception and hands on the cause.
    try:
        yield
    except (SessionError, ModuleNotFoundError):
        raise  # the second says what to install, and nothing of the file
    except Exception as error:
        reason = (str(error) or "no reason given").splitlines()[0][:200]
        raise SessionError(f"{damage} ({type(error).__name__}: {reason}); {remedy}") from error


def listed(names: Iterable[object]) -> str:
    """Return names for an error message, separated by commas and cut to 30 short ones."""
    names = list(names)
    return ", ".join(str(name)[:40] for name in names[:30]) + (" …" if len(names) > 30 else "")


def alternatives(name: object, known: Iterable[object], words: str = "known") -> str:
    """Return the end of an error about an unknown name: the nearest known name, then all."""
    known = list(known)
    return f"{did_you_mean(name, known)} ({words}: {listed(known)})"


def nearest_file(path: Path, suffix: str = "") -> str:
    """Return "; did you mean …?" for a missing file, from names beside it with this suffix."""
    try:
        beside = [each.name for each in path.parent.iterdir() if each.name.lower().endswith(suffix)]
    except (OSError, ValueError):
        beside = []
    return did_you_mean(path.name, beside)
