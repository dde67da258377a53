"""Errors of logs and recipes, and the parts that their messages share."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

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

    Examples
    --------
    >>> import trustlab as tl
    >>> try:
    ...     tl.read_session("data/sessions/pilot.csv").require("r")
    ... except tl.SessionError as error:
    ...     print(error.source)
    data/sessions/pilot.csv
    """

    def __init__(self, message: str, source: str | None = None):
        super().__init__(f"{source}: {message}" if source else message)
        self.source = source


class RecipeError(SessionError):
    """A recipe that does not exist or cannot be followed; arguments as for SessionError."""


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
    # Decoders meet damaged files with errors of their own: struct.error, KeyError, AssertionError,
    # zlib and database errors, MemoryError … They have no common base, so that this one place,
    # around calls into a decoder and little else, takes every Exception and hands on the cause.
    try:
        yield
    except (SessionError, ModuleNotFoundError):
        raise  # the second says what to install, and nothing of the file
    except Exception as error:
        reason = (str(error) or "no reason given").splitlines()[0][:200]
        raise SessionError(f"{damage} ({type(error).__name__}: {reason}); {remedy}") from error


def alternatives(name: object, known: Iterable[object], words: str = "known") -> str:
    """Return the end of an error about an unknown name: the nearest known name, then all."""
    known = list(known)
    listing = ", ".join(str(each)[:40] for each in known[:30])
    more = " …" if len(known) > 30 else ""
    return f"{did_you_mean(name, known)} ({words}: {listing}{more})"
