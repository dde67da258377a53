"""
How much a compressed file may unpack to: a file of a few kilobytes can be made to fill the memory.
"""

import bz2
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from trustlab.models.extras import extra
from trustlab.sessions.errors import SessionError

# How many bytes a file may unpack to where it says nothing else, if these are more than ten times
# its own size.
MAX_BYTES = 2**28


class Budget:
    """The bytes that a file may still unpack to."""

    def __init__(self, most: int):
        self.most = self.left = most

    def take(self, size: int) -> None:
        """
        Count bytes that were unpacked, or that the file claims; raise where they are too many.
        """
        self.left -= size
        if self.left < 0:
            what = (
                f"unpacks to more than {self.most} bytes, so it is damaged or made to fill the "
                "memory"
            )
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
    """
    Return a function that unpacks a block within the budget of the file being read; `kept` where
    blocks add up.
    """

    def unpack(data: bytes, *_: object) -> bytes:
        budget = _budget.get() or Budget(sys.maxsize - 1)  # outside trustlab, rosbags has no limit
        if not kept:
            budget.left = budget.most
        return budget.unpack(decompressor, data)

    return unpack


def _counted(opened: Callable[..., Any]) -> Callable[..., Any]:
    """
    Return a function that opens a compressed file, whose reads count against the budget of the file
    being read.
    """

    @contextmanager
    def open_counted(*arguments: object) -> Iterator[SimpleNamespace]:
        budget = _budget.get() or Budget(sys.maxsize)

        def read(size: int) -> bytes:
            data = file.read(size)
            budget.take(len(data))
            return data

        with opened(*arguments) as file:
            yield SimpleNamespace(read=read)

    return open_counted


@contextmanager
def bags_within(budget: Budget) -> Iterator[None]:
    """Have rosbags unpack within a budget."""
    with extra("ros"):
        import lz4.frame
        from rosbags.rosbag1 import reader as ros1
        from rosbags.rosbag2 import reader as ros2, storage_mcap as mcap

    # rosbags unpacks a block as a whole, of whatever size, and has no argument to limit it. Its
    # functions are replaced for good, as others may be reading at the same time; the budget belongs
    # to this call alone.
    if not isinstance(ros2.zstd, SimpleNamespace):
        lz4_frame, zstd = lz4.frame.LZ4FrameDecompressor, mcap.zstd.ZstdDecompressor
        mcap.DECOMPRESSORS.update(lz4=_bounded(lz4_frame), zstd=_bounded(zstd))
        ros1.decompressors.update(
            bz2=_bounded(bz2.BZ2Decompressor, kept=False), lz4=_bounded(lz4_frame, kept=False)
        )
        ros2.zstd = SimpleNamespace(
            decompress=_bounded(zstd, kept=False), open=_counted(ros2.zstd.open)
        )
    token = _budget.set(budget)
    try:
        yield
    finally:
        _budget.reset(token)


def feather_size(data: bytes | memoryview) -> int:
    """
    Return how many bytes the compressed batches of an Arrow file say that they unpack to.

    pyarrow unpacks a batch as a whole and has no limit. The layout is that of Arrow's Columnar
    Format, in tables of FlatBuffers: Footer (2 dictionaries, 3 record batches), Message (1 kind, 2
    header), RecordBatch (2 buffers, 3 compression). A compressed buffer begins with the size it
    unpacks to, −1 where it is not compressed after all.
    """
    data = memoryview(data)
    unread = len(data)

    def number(kind: str, at: int) -> int:
        return struct.unpack_from(f"<{kind}", data, at)[0]

    def field(table: int, index: int) -> int | None:
        """Return where a field of a table stands; None where it is left out."""
        slots = table - number("i", table)
        distance = number("H", slots + 4 + 2 * index) if 4 + 2 * index < number("H", slots) else 0
        return table + distance if distance else None

    def inner(table: int, index: int) -> int:
        at = field(table, index)
        return at + number("I", at)

    def entries(table: int, index: int, size: int) -> range:
        nonlocal unread
        if field(table, index) is None:
            return range(0)
        at = inner(table, index)
        length = size * number("I", at)
        unread -= length
        if (
            unread < 0
        ):  # one damaged number can claim 4·10⁹ entries, and lists that overlap their product
            raise ValueError("its lists of blocks say that they are longer than the file")
        return range(at + 4, at + 4 + length, size)

    footer = len(data) - 10 - number("i", len(data) - 10)
    footer += number("I", footer)
    total = 0
    for block in (*entries(footer, 2, 24), *entries(footer, 3, 24)):
        start = number("q", block)
        start += (
            8 if number("i", start) == -1 else 4
        )  # versions before 0.15 lack the mark −1 before the length
        message, body = start + number("I", start), number("q", block) + number("i", block + 8)
        batch = inner(message, 2)
        if number("B", field(message, 1)) == 2:  # a dictionary, which has its batch inside
            batch = inner(batch, 1)
        if field(batch, 3) is not None:
            buffers = ((number("q", at), number("q", at + 8)) for at in entries(batch, 2, 16))
            total += sum(max(number("q", body + at), 0) for at, size in buffers if size)
    return total
