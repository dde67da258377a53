"""
Optional dependencies: a missing one is an error that names the extra of trustlab that brings it.
"""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def extra(name: str) -> Iterator[None]:
    """
    Wrap the imports that an extra brings: where one is missing, the error says what to install.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = error.name or "a package"
        if missing.partition(".")[0] == "trustlab":  # a mistake of ours, which no extra mends
            raise
        raise ModuleNotFoundError(
            f'{missing} is not installed; install it with: pip install "trustlab[{name}]"',
            name=error.name,
        ) from error
