"""When data cannot tell a parameter."""

from __future__ import annotations

__all__ = ["IdentificationError"]


class IdentificationError(ValueError):
    """
    The data do not identify a model.

    Parameters
    ----------
    message : str
        The reason and the remedy.
    parameters : tuple of str
        The parameters that cannot be told.
    """

    def __init__(self, message: str, parameters: tuple[str, ...] = ()):
        super().__init__(message)
        self.parameters = tuple(parameters)
