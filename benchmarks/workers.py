"""
Peers that live in an environment of their own, each in a process that fits and times when told to.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

FOLDER = Path(__file__).parent
PYTHON = FOLDER / ".venv" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


class PeerMissingError(Exception):
    """A peer that cannot be run; the message says why."""


class Worker:
    """
    One peer's process: JSON lines in, JSON lines out.

    Parameters
    ----------
    script : str
        File under benchmarks/peers/.
    data : pathlib.Path
        An .npz file with the arrays it fits.

    Raises
    ------
    PeerMissingError
        If the environment or the package is not installed.
    """

    def __init__(self, script: str, data: Path):
        if not PYTHON.exists():
            raise PeerMissingError("not installed: benchmarks/.venv is not there; run `make bench`")
        self.process = subprocess.Popen(
            [str(PYTHON), str(FOLDER / "peers" / script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        try:
            self.versions = self.ask(data=str(data))["versions"]
        except PeerMissingError:
            self.close()
            raise

    def ask(self, **request) -> dict:
        """
        Send a request and return the answer.

        Parameters
        ----------
        **request
            What to send.

        Raises
        ------
        PeerMissingError
            If the process ended or reports an error.
        """
        try:
            self.process.stdin.write(json.dumps(request) + "\n")
            self.process.stdin.flush()
            answer = self.process.stdout.readline()
        except OSError:
            answer = ""
        if not answer:
            raise PeerMissingError("its process ended without an answer")
        reply = json.loads(answer)
        if "error" in reply:
            raise PeerMissingError(reply["error"])
        return reply

    def side(self, way: str):
        """
        Return a side for `timing.in_turns`.

        Parameters
        ----------
        way : str
            Which of the worker's ways of fitting.
        """
        return lambda calls: self.ask(way=way, calls=calls)["seconds"]

    def result(self, way: str) -> list[float]:
        """
        Return what one way of fitting gives.

        Parameters
        ----------
        way : str
            Which of the worker's ways of fitting.
        """
        return self.ask(way=way)["result"]

    def close(self) -> None:
        """End the process."""
        self.process.stdin.close()
        try:
            self.process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
