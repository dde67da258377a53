"""Digests of content, and of the sources that a result comes from."""

import functools
import hashlib
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
# From top to bottom: a room imports only rooms above it.
ROOMS = (
    "models",
    "campaign",
    "sessions",
    "identification",
    "allocation",
    "trust",
    "teleoperation",
    "operators",
    "testbeds",
    "studies",
    "reproduction",
    "publishing",
    "live",
    "ros",
)


def digest(*parts: str | bytes) -> str:
    """Return 32 hexadecimal digits that change with every byte and with the order of the parts."""
    state = hashlib.sha256()
    for part in parts:
        data = part.encode("utf-8", "backslashreplace") if isinstance(part, str) else part
        state.update(f"{len(data)}:".encode() + data)
    return state.hexdigest()[:32]


@functools.cache
def room_digest(room: str) -> str:
    """Return a digest of the sources of a room and of all rooms above it: all that it imports."""
    place = ROOMS.index(room)
    parts: list[str | bytes] = [room_digest(ROOMS[place - 1])] if place else []
    for file in sorted(filter(Path.is_file, (PACKAGE / room).rglob("*.py"))):
        parts += [file.relative_to(PACKAGE).as_posix(), file.read_bytes()]
    return digest(*parts)
