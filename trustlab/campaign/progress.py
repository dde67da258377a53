"""One line on stderr: done, failed, rate, time left."""

from __future__ import annotations

import sys
from time import monotonic

__all__ = ["Progress"]

EVERY = 0.2
"""Seconds between two updates of the line."""
WINDOW = 30.0
"""Seconds over which the rate forgets the past."""


class Progress:
    """
    A bar that rewrites its line; nothing at all where it is not wanted.

    Parameters
    ----------
    total : int
        Runs of the campaign.
    done, failed : int
        Runs that were done, and had failed, before.
    shown : bool or None
        Whether to show it; None: where stderr is a terminal.
    """

    def __init__(self, total: int, done: int, failed: int, shown: bool | None):
        self.stream = sys.stderr
        terminal = bool(getattr(self.stream, "isatty", lambda: False)())
        self.shown = terminal if shown is None else shown
        self.total, self.done, self.failed, self.before = total, done, failed, done
        self.began = self.written = monotonic()
        self.rate, self.last, self.width = 0.0, (self.began, done), 0
        self._write()

    def add(self, runs: int, failed: int) -> None:
        """
        Count runs that were done.

        Parameters
        ----------
        runs, failed : int
            How many, and how many of them failed.
        """
        self.done += runs
        self.failed += failed
        now = monotonic()
        if now - self.written >= EVERY:
            elapsed = now - self.last[0]
            rate = (self.done - self.last[1]) / elapsed
            weight = min(1.0, max(elapsed / WINDOW, elapsed / (now - self.began)))
            self.rate += weight * (rate - self.rate)
            self.last, self.written = (now, self.done), now
            self._write()

    def close(self) -> None:
        """End the line."""
        self._write(last=True)

    def text(self) -> str:
        """Return the line."""
        share = self.done / self.total if self.total else 1.0
        bar = ("█" * int(20 * share)).ljust(20, "░")
        parts = [f"{bar} {self.done:,}/{self.total:,} runs"]
        if self.failed:
            parts.append(f"{self.failed:,} failed")
        elapsed, finished = monotonic() - self.began, self.done >= self.total
        rate = (self.done - self.before) / max(elapsed, 1e-9) if finished else self.rate
        if rate > 0.0:
            parts.append(f"{rate:,.0f} runs/s" if rate >= 10 else f"{rate:.2g} runs/s")
            parts.append(clock(elapsed) if finished else f"{clock((self.total - self.done) / rate)} left")
        return ", ".join(parts)

    def _write(self, last: bool = False) -> None:
        if not self.shown:
            return
        line = self.text()
        padded = line.ljust(self.width)
        self.width = len(line)
        try:
            self.stream.write("\r" + padded + ("\n" if last else ""))
            self.stream.flush()
        except (OSError, ValueError):  # the stream was closed: the campaign goes on
            self.shown = False


def clock(seconds: float) -> str:
    """
    Return a duration as hours, minutes and seconds.

    Parameters
    ----------
    seconds : float
        Duration [s].
    """
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    return (
        f"{hours} h {minutes:02d} min"
        if hours
        else f"{minutes} min {whole % 60:02d} s"
        if minutes
        else f"{whole} s"
    )
