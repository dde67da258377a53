"""What the numbers were measured on, without names of hosts or people."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path

VERSIONS: dict[str, str] = {}
"""Versions of peers in other environments, filled in as they answer."""

PACKAGES = ("numpy", "scipy", "pandas", "numba", "statsmodels", "casadi")


def facts() -> dict[str, str]:
    """Return processor, cores, memory, system and versions."""
    out = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "memory": _memory(),
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
    }
    return out | {name: importlib.metadata.version(name) for name in PACKAGES} | VERSIONS


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"


def _memory() -> str:
    try:
        return f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.1f} GiB"
    except (AttributeError, OSError, ValueError):
        return "unknown"
