"""How much a compressed file may unpack to: a file of a few kilobytes can be made to fill the memory."""

import bz2
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from trustlab.models.extras import extra
from trustlab.sessions.errors import SessionError

MAX_BYTES = 2**28
"""How many bytes a file may unpack to where it says nothing else, if these are more than ten times its own size."""


class Budget:
    """The bytes that a file may still unpack to."""

    def __init__(self, most: int):
        self.most = self.left = most

    def take(self, size: int) -> None:
        """Count bytes that were unpacked, or that the file claims; raise where they are too many."""
        self.left -= size
        if self.left < 0:
            what = f"unpacks to more than {self.most} bytes, so it is damaged or made to fill the memory"
            raise SessionError(f"{what}; if it is as large as that, allow for it with max_bytes=…")

    def unpack(self, decompressor: Callable[[], Any], data: bytes) -> bytes:
        """Return data unpacked by a decompressor of the interface of bz2.BZ2Decompressor."""
        parts = []
        while data:
            stream = decompressor()
            parts.append(stream.decompress(data, self.left + 1))
            self.take(len(parts[-1]))
            if not stream.eof:
                raise EOFError("the compressed data end too early")
            data = stream.unused_data
        return b"".join(parts)


def budget_of(path: Path, max_bytes: int | None) -> Budget:
    """Return the budget of a file, or of a folder of files."""
    files = [path] if path.is_file() else list(path.iterdir())
    return Budget(max_bytes or max(MAX_BYTES, 10 * sum(file.stat().st_size for file in files)))


_budget: ContextVar[Budget | None] = ContextVar("budget", default=None)


def _bounded(decompressor: Callable[[], Any], kept: bool = True) -> Callable[..., bytes]:
    """Return a function that unpacks a block within the budget of the file being read; `kept` where blocks add up."""

    def unpack(data: bytes, *_: object) -> bytes:
        budget = _budget.get() or Budget(sys.maxsize - 1)  # outside trustlab, rosbags has no limit
        if not kept:
            budget.left = budget.most
        return budget.unpack(decompressor, data)

    return unpack


@contextmanager
def bags_within(budget: Budget) -> Iterator[None]:
    """Have rosbags unpack within a budget."""
    with extra("ros"):
        import lz4.frame
        from rosbags.rosbag1 import reader as ros1
        from rosbags.rosbag2 import reader as ros2, storage_mcap as mcap

    # rosbags unpacks a block as a whole, of whatever size, and has no argument to limit it. Its functions are replaced for
    # good, as others may be reading at the same time; the budget belongs to this call alone.
    if not isinstance(ros2.zstd, SimpleNamespace):
        lz4_frame, zstd = lz4.frame.LZ4FrameDecompressor, mcap.zstd.ZstdDecompressor
        mcap.DECOMPRESSORS.update(lz4=_bounded(lz4_frame), zstd=_bounded(zstd))
        ros1.decompressors.update(bz2=_bounded(bz2.BZ2Decompressor, kept=False), lz4=_bounded(lz4_frame, kept=False))
        ros2.zstd = SimpleNamespace(decompress=_bounded(zstd, kept=False), open=ros2.zstd.open)
    token = _budget.set(budget)
    try:
        yield
    finally:
        _budget.reset(token)
