"""Files that are there whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from trustlab.models.checks import shown

# Part of the name of a file that is being written; what a killed process leaves has it too.
PARTIAL = ".partial-"


def path_of(name: str, value: object) -> Path:
    """Return a path that a user has given; `name` is the argument."""
    if not isinstance(value, str | os.PathLike) or not str(value) or "\0" in str(value):
        raise ValueError(f"{name} must be a path, got {shown(value)}")
    return Path(value)


@contextlib.contextmanager
def writing(path: str | os.PathLike, kind: type[Exception] = ValueError) -> Iterator[None]:
    """Turn an error of the system into one of this kind, which names the path and the remedy."""
    try:
        yield
    except OSError as error:
        raise kind(
            f"cannot write {path}: {error.strerror or error}; give a folder that is there and that "
            "you may write to, with room"
        ) from error


def write_atomically(path: str | os.PathLike, content: bytes | str, mode: int = 0o666) -> None:
    """
    Write a file so that readers find it complete or as it was before, whenever the process stops.

    The content is on the disk when this returns. Text is encoded as UTF-8. `mode` says who may read
    and write a new file, less what the process's umask takes away; one that is there keeps what its
    owner has allowed, and a link leads to it.
    """
    file = Path(os.path.realpath(path))
    data = content.encode() if isinstance(content, str) else content
    partial = file.with_name(f"{file.name}{PARTIAL}{os.getpid()}")
    try:
        handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode)
        with os.fdopen(handle, "wb") as new:
            with contextlib.suppress(FileNotFoundError):
                os.fchmod(handle, mode & file.stat().st_mode)
            new.write(data)
            new.flush()
            os.fsync(handle)
        os.replace(partial, file)
    except OSError as error:
        error.filename = str(path)  # the name that the user knows
        with contextlib.suppress(OSError):
            partial.unlink()
        raise
