"""The loop of a worker: load arrays once, then fit or time as asked, one JSON line per request."""

import gc
import importlib.metadata
import json
import os
import sys
from time import perf_counter


def serve(package, ways):
    """
    Answer requests from standard input until it closes.

    Parameters
    ----------
    package : str
        Name of the distribution, for its version.
    ways : callable
        Takes the loaded arrays and returns named fits: callables without arguments that return
        lists of numbers.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the peer prints must not end up among the answers
    fits = {}
    for line in sys.stdin:
        request = json.loads(line)
        try:
            if "data" in request:
                import numpy as np

                with np.load(request["data"]) as arrays:
                    fits = ways({name: arrays[name] for name in arrays.files})
                reply = {"versions": {package: importlib.metadata.version(package)}}
            elif "calls" in request:
                reply = {"seconds": seconds_per_call(fits[request["way"]], request["calls"])}
            else:
                reply = {"result": [float(x) for x in fits[request["way"]]()]}
        except ImportError as error:
            reply = {"error": f"not installed: {package} ({str(error).split(' (')[0]})"}
        except Exception as error:
            reply = {"error": f"{package} failed: {type(error).__name__}: {str(error)[:200]}"}
        answers.write(json.dumps(reply) + "\n")
        answers.flush()


def seconds_per_call(call, calls):
    """
    Return the mean time of consecutive calls, garbage collection held off, as benchmarks.timing
    does.

    Parameters
    ----------
    call : callable
        What is timed.
    calls : int
        How often.
    """
    gc.collect()
    gc.disable()
    try:
        began = perf_counter()
        for _ in range(calls):
            call()
        return (perf_counter() - began) / calls
    finally:
        gc.enable()
