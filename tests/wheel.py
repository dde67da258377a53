"""The package as people install it: built once for all tests that need it."""

import os
import shutil
import subprocess
import sys
import zipfile

import pytest
from numba.core.caching import _CacheLocator

from tests.house.documents import ROOT
from trustlab.models import compiled


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """Wheel and sdist, built from what git would ship."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    skip = shutil.ignore_patterns("__pycache__", "external", ".ipynb_checkpoints")
    for name in ("trustlab", "data", "tests", "notebooks", "benchmarks", "docs"):
        shutil.copytree(
            ROOT / name,
            source / name,
            ignore=shutil.ignore_patterns("__pycache__", "external", ".venv"),
        )
    shutil.copytree(ROOT / "reports" / "figures", source / "reports" / "figures", ignore=skip)
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, source / path.name)
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", str(out)],
        cwd=source,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return {path.suffix: path for path in out.iterdir()}


@pytest.fixture(scope="session")
def installed(built, tmp_path_factory):
    """A folder with nothing but the wheel's content, installed without dependencies."""
    site = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(built[".whl"]) as wheel:
        wheel.extractall(site)
    bring_compiled(site)
    return site


def bring_compiled(site):
    """
    Copy what this checkout has compiled to where the installed package, of the same sources, looks
    for it.
    """
    place = site / "trustlab" / "__pycache__" / "compiled"
    # numba knows a source file by its time, and names folders by the place of the source.
    for ours in (ROOT / "trustlab").rglob("*.py"):
        theirs = site / ours.relative_to(ROOT)
        os.utime(theirs, ns=(ours.stat().st_atime_ns, ours.stat().st_mtime_ns))
        own, new = (_CacheLocator.get_suitable_cache_subpath(str(path)) for path in (ours, theirs))
        for cache in compiled._cache_root().iterdir():
            if (cache / own).is_dir() and not (place / cache.name / new).exists():
                shutil.copytree(cache / own, place / cache.name / new)
