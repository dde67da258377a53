"""
Compiled functions whose cache on disk never goes stale.

numba keeps a compiled function beside its source file and compiles it again when that file changes,
but not when a function that it calls changes in another file: after an update of the package it
would go on returning the old numbers without a word. Here the place of a module's cache carries a
digest of the module's source, of all modules of trustlab that it imports, directly or not, and of
numba's version; so it is found again only while all of them are unchanged.
"""

from __future__ import annotations

import atexit
import functools
import multiprocessing
import os
import shutil
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
from numba.core import event

from trustlab.models.digest import PACKAGE, digest, source_digest

NOTICE = (
    "trustlab is compiling what this call needs. It happens once; later calls and sessions "
    "find it on disk."
)


class _Notice(event.Listener):
    """
    Says once, on stderr, that compilation is what takes the time, when it has taken two seconds.

    Functions of users, which numba announces as well, do not count.
    """

    def __init__(self):
        self.begun: list[float] = []  # of the functions being compiled, one inside the other
        self.spent, self.timer = 0.0, None

    def on_start(self, event: Any) -> None:
        if not _of_trustlab(event):
            return
        self.begun.append(time.monotonic())
        if len(self.begun) == 1 and self.spent < 2.0:
            self.timer = threading.Timer(
                2.0 - self.spent, print, [NOTICE], {"file": sys.stderr, "flush": True}
            )
            self.timer.daemon = True
            self.timer.start()

    def on_end(self, event: Any) -> None:
        if not _of_trustlab(event):
            return
        taken = time.monotonic() - self.begun.pop()
        if not self.begun:
            self.timer.cancel()
            self.spent += taken


def _of_trustlab(event: Any) -> bool:
    module = event.data["dispatcher"].py_func.__module__ or ""  # none in code from exec
    return module.partition(".")[0] == "trustlab"


if multiprocessing.parent_process() is None:  # the workers of a campaign are silent
    event.register("numba:compile", _Notice())


def njit(function: Callable | None = None, **options: Any) -> Any:
    """
    Compile a function in numba's nopython mode and cache it on disk; options are those of
    `numba.njit`.
    """
    if function is None:
        return functools.partial(njit, **options)
    folder = _cache_folder(Path(function.__code__.co_filename))
    if folder is None:
        return numba.njit(**options)(function)
    with _numba_caches_in(folder):
        # no second wrapper, for C: it would take a tenth of the time, and `cfunc` makes one where
        # it is wanted
        return numba.njit(cache=True, no_cfunc_wrapper=True, **options)(function)


def cfunc(signature: Any, function: Callable, **options: Any) -> Any:
    """
    Compile a function to one that C can call, and cache it on disk; options are those of
    `numba.cfunc`.
    """
    folder = _cache_folder(Path(function.__code__.co_filename))
    if folder is None:
        return numba.cfunc(signature, **options)(function)
    with _numba_caches_in(folder):
        return numba.cfunc(signature, cache=True, **options)(function)


@contextmanager
def _numba_caches_in(folder: Path):
    """
    Point numba to `folder` while it decides where to cache; whatever the user has set for other
    packages stays.
    """
    settings = {"CACHE_DIR": str(folder), "CACHE_LOCATOR_CLASSES": ""}
    before = {name: getattr(numba.config, name) for name in settings if hasattr(numba.config, name)}
    for name in before:
        setattr(numba.config, name, settings[name])
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(numba.config, name, value)


@functools.cache
def _cache_folder(path: Path) -> Path | None:
    """
    Return the folder for compiled functions of a module, without what older versions of it left
    there.
    """
    if not path.is_file():  # a package in a zip archive has no files: compile in every process
        return None
    name = ".".join(path.resolve().relative_to(PACKAGE).with_suffix("").parts)
    sources = source_digest(path.resolve())
    folder = _cache_root() / f"{name}-{digest(numba.__version__, sources)}"
    if not folder.is_dir():
        for old in folder.parent.glob(f"{name}-*"):
            shutil.rmtree(old, ignore_errors=True)
    return folder


@functools.cache
def _cache_root() -> Path:
    """
    Return the first folder that can be written: the one named by the user, the package's own, the
    user's, a temporary one.
    """
    named = os.environ.get("TRUSTLAB_CACHE_DIR")
    if sys.platform == "darwin":
        home = "~/Library/Caches"
    elif sys.platform == "win32":
        home = os.environ.get("LOCALAPPDATA", "~/AppData/Local")
    else:
        home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    # In the user's folder several installations meet: each has a place of its own, else they would
    # sweep each other's.
    installation = digest(str(PACKAGE))[:12]
    candidates = [
        PACKAGE / "__pycache__" / "compiled",
        Path(os.path.expanduser(home)) / "trustlab" / installation,
    ]
    for root in ([Path(named)] if named else []) + candidates:
        if _writable(root):
            return root
    root = Path(tempfile.mkdtemp(prefix="trustlab-"))
    atexit.register(shutil.rmtree, root, ignore_errors=True)
    warnings.warn(
        "trustlab finds no folder that it can write to, so compiled functions are kept for this "
        "process only and every start compiles them again; name a folder in the environment "
        "variable TRUSTLAB_CACHE_DIR",
        RuntimeWarning,
        stacklevel=2,
    )
    return root


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError):
        return False
    return True
