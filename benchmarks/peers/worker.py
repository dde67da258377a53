"""
Peers in an environment of their own: the process that asks, and the loop of the one that answers.

Run as a script, by the peers' interpreter: ``worker.py <peer> <arrays.npz>``, where the peer is a
module beside this one whose ``ways(arrays)`` returns named calls.
"""

import gc
import importlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

FOLDER = Path(__file__).parent
PYTHON = FOLDER.parent / ".venv" / "bin" / "python"


class Worker:
    """A peer's process: names of calls in, results and seconds out, as lines of JSON."""

    def __init__(self, peer: str, arrays: dict):
        import numpy as np

        if not PYTHON.exists():
            raise RuntimeError("the peers are not installed; `make bench` does it")
        self.folder = tempfile.TemporaryDirectory()
        path = Path(self.folder.name) / "arrays.npz"
        np.savez(path, **arrays)
        self.process = subprocess.Popen(
            [str(PYTHON), __file__, peer, str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def ask(self, way: str) -> dict:
        """Return what a call gives and how long it took."""
        self.process.stdin.write(way + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline() or '{"error": "its process ended"}')
        if "error" in answer:
            raise RuntimeError(answer["error"])
        return answer

    def timed(self, way: str):
        """Return a call that returns its seconds in the peer's process."""
        return lambda: self.ask(way)["seconds"]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.communicate()
        self.folder.cleanup()


def answer(peer: str, arrays: str) -> None:
    """Answer until the input closes."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the peer prints must not end up among the answers
    import numpy as np

    try:
        with np.load(arrays) as data:
            ways = importlib.import_module(peer).ways({name: data[name] for name in data.files})
    except Exception as error:
        answers.write(json.dumps({"error": f"{type(error).__name__}: {error}"}) + "\n")
        answers.flush()
        return
    for line in sys.stdin:
        gc.collect()
        gc.disable()
        began = perf_counter()
        try:
            result = ways[line.strip()]()
            reply = {"seconds": perf_counter() - began, "result": np.ravel(result).tolist()}
        except Exception as error:
            reply = {"error": f"{type(error).__name__}: {error}"}
        gc.enable()
        answers.write(json.dumps(reply) + "\n")
        answers.flush()


if __name__ == "__main__":
    answer(*sys.argv[1:])
