"""What goes wrong with a log, and where."""

from __future__ import annotations

__all__ = ["RecipeError", "SessionError"]


class SessionError(ValueError):
    """
    A log or a table that is not a session.

    Parameters
    ----------
    message : str
        What was found and what to do about it.
    source : str, optional
        The file it was found in; put in front of the message.
    """

    def __init__(self, message: str, source: str | None = None):
        super().__init__(f"{source}: {message}" if source else message)
        self.source = source


class RecipeError(SessionError):
    """A recipe that is not there or cannot be followed; takes the same arguments as SessionError."""
