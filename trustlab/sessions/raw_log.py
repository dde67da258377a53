"""What a reader takes from one file, before anything is checked or resampled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from trustlab.sessions.errors import SessionError
from trustlab.sessions.metadata import Metadata

__all__ = ["MAX_SAMPLES", "RawLog", "Stream"]

MAX_SAMPLES = 20_000_000
"""The longest log that is read or made by resampling (five and a half hours at 1 kHz)."""


@dataclass
class Stream:
    """
    Samples that share their times: the columns of a table, or what is read from one topic of a bag.

    `t` [s] and every array of `columns` have shape (N,), in SI units; `place(k)` says where sample k stands in the
    file. `held` is True where the last sample holds until the log ends; `remedy` is what to do about times that do
    not rise, beside sorting and splitting the log.
    """

    t: np.ndarray
    columns: dict[str, np.ndarray]
    place: Callable[[int], str]
    topic: str = ""
    held: bool = False
    remedy: str = ""


@dataclass
class RawLog:
    """
    The streams of one file, not yet checked.

    `metadata` is what the file says about itself, `fault` why reading stopped after the samples there are, and
    `notes` are metadata that reading adds (start_time, resampled).
    """

    source: str
    streams: list[Stream]
    metadata: Metadata | None = None
    fault: SessionError | None = None
    notes: dict[str, object] = field(default_factory=dict)
