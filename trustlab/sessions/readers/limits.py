"""How much a compressed file may unpack to: one of a few kilobytes can be made to fill the memory.

Each reader refuses by the sizes that the headers of a file state, before anything is unpacked.
"""

from pathlib import Path

from trustlab.sessions.errors import SessionError

# How many bytes a file may unpack to, unless ten times its own size is more.
MAX_BYTES = 2**28


class Budget:
    """The bytes that a file may still unpack to."""

    def __init__(self, most: int):
        self.most = most
        self.left = most

    def take(self, size: int) -> None:
        """Count bytes that stay in memory together; raise where they are too many."""
        self.left -= size
        if self.left < 0:
            reason = "so it is damaged or made to fill the memory"
            raise SessionError(
                f"unpacks to more than {self.most} bytes, {reason}; "
                "if it is as large as that, allow for it with max_bytes=…"
            )

    def check(self, size: int) -> None:
        """Raise where a block that is in memory alone is too large."""
        Budget(self.most).take(size)


def budget_of(path: Path, max_bytes: int | None) -> Budget:
    """Return the budget of a file, or of a folder of files."""
    files = [path] if path.is_file() else list(path.iterdir())
    return Budget(max_bytes or max(MAX_BYTES, 10 * sum(file.stat().st_size for file in files)))
