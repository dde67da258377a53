"""
Peers in an environment of their own: the process that asks, and the loop of the one that answers.

Run as a script, by the peers' interpreter: ``worker.py <peer> <descriptor>``, where the peer is a
module beside this one whose ``ways(arrays)`` returns named calls.
"""

import gc
import importlib
import subprocess
import sys
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from time import perf_counter

PYTHON = Path(__file__).parents[1] / ".venv" / "bin" / "python"


class Seconds(float):
    """What a call took in a peer's process."""


class Worker:
    """A peer's process: names of calls in, seconds and results out."""

    def __init__(self, peer: str, arrays: dict):
        if not PYTHON.exists():
            raise RuntimeError("the peers are not installed; `make bench` does it")
        self.connection, theirs = Pipe()
        self.process = subprocess.Popen(
            [str(PYTHON), __file__, peer, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        theirs.close()  # so that its end is heard here
        self.connection.send(arrays)

    def ask(self, way: str) -> tuple[float, list[float]]:
        """Return how long a call took, and what it gives."""
        self.connection.send(way)
        answer = self.connection.recv()
        if isinstance(answer, str):
            raise RuntimeError(answer)
        return answer

    def timed(self, way: str):
        """Return a call that returns its seconds in the peer's process."""
        return lambda: Seconds(self.ask(way)[0])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()


def main(peer: str, descriptor: str) -> None:
    """Answer until nobody asks."""
    import numpy as np

    connection = Connection(int(descriptor))
    try:
        ways = importlib.import_module(peer).ways(connection.recv())
        while True:
            way = ways[connection.recv()]
            gc.collect()
            gc.disable()
            began = perf_counter()
            result = way()
            seconds = perf_counter() - began
            gc.enable()
            connection.send((seconds, np.ravel(result).tolist()))
    except Exception as error:
        connection.send(f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main(*sys.argv[1:])
