"""
Compiled functions whose cache on disk never goes stale.

numba compiles a function again when its own file changes, but not when a function that it calls
changes in another file. So each room has a cache whose name carries a digest of numba's version and
of all sources that the room may use: its own and those of the rooms above it.
"""

import atexit
import contextlib
import functools
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from trustlab.models.checks import warn
from trustlab.models.digest import PACKAGE, digest, room_digest

# A cache that no process has opened for so long [s] belongs to sources that are gone.
UNUSED = 24 * 3600.0


def njit(function: Callable | None = None, **options: Any) -> Any:
    """
    Compile a function in numba's nopython mode and cache it on disk; options are those of
    `numba.njit`.
    """
    if function is None:
        return functools.partial(njit, **options)
    # numba decides here where it caches; what the user has set for other packages stays.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_room_cache(function.__module__.split(".")[1]))
    try:
        # Without the wrapper for C, which would take a tenth of the time of compilation.
        return numba.njit(cache=True, no_cfunc_wrapper=True, **options)(function)
    finally:
        numba.config.CACHE_DIR = before


# For what only compiled functions call: without the wrapper for Python, which takes a fifth of the
# time of compilation, and made part of its caller, as a call copies all constants, a fifth of the
# time of a drive. Called from Python it ends the process; tests call `.py_func`.
inner = functools.partial(njit, no_cpython_wrapper=True, forceinline=True)


@functools.cache
def _room_cache(room: str) -> Path:
    """Return the folder for a room's compiled functions; those of older sources are removed."""
    root = _cache_root()
    folder = root / f"{room}-{digest(numba.__version__, room_digest(room))}"
    if not folder.exists():
        _announce()
    folder.mkdir(exist_ok=True)
    os.utime(folder)
    for cache in root.glob(f"{room}-*"):
        # A process that began before an edit may still use the cache of the sources it read.
        with contextlib.suppress(OSError):
            if time.time() - cache.stat().st_mtime > UNUSED:
                shutil.rmtree(cache)
    return folder


@functools.cache
def _announce() -> None:
    print(
        "trustlab is compiling each function that is called for the first time, which can take up "
        "to a minute; later calls and sessions find it on disk.",
        file=sys.stderr,
    )


@functools.cache
def _cache_root() -> Path:
    """
    Return the first folder that can be written: the one named by the user, the package's own, the
    user's, a temporary one.
    """
    home = os.environ.get("LOCALAPPDATA") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    own = PACKAGE / "__pycache__" / "compiled"
    named = os.environ.get("TRUSTLAB_CACHE_DIR") or own
    for folder in (named, own, Path(home, "trustlab")):
        with contextlib.suppress(OSError, RuntimeError):  # not writable, or the user has no home
            root = Path(folder).expanduser()
            root.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=root).close()
            return root
    root = Path(tempfile.mkdtemp(prefix="trustlab-"))
    atexit.register(shutil.rmtree, root, ignore_errors=True)
    warn(
        "trustlab finds no folder that it can write to, so compiled functions are kept for this "
        "process only and every start compiles them again; name a folder in the environment "
        "variable TRUSTLAB_CACHE_DIR",
        RuntimeWarning,
    )
    return root
