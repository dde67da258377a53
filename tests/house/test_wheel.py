"""
The package as people install it: wheel and sdist are whole; README and some pages of the
documentation run from the wheel.
"""

import os
import subprocess
import sys
import tarfile
import zipfile

import pytest

from tests.house.documents import ROOT, python, write_files

# Not all pages: `test_readme.py` runs them from the sources. These read files, ask functions of
# one's own, and plot.
PAGES = [
    "README.md",
    "docs/start.md",
    "docs/how_to/logs.md",
    "docs/how_to/own_parts.md",
    "docs/how_to/studies.md",
]
# One worker runs them all, so that the package is built once, and what it compiles is compiled
# once.
pytestmark = pytest.mark.xdist_group("wheel")


def test_the_wheel_has_everything_that_the_package_reads(built):
    names = set(zipfile.ZipFile(built[".whl"]).namelist())
    tracked = [path.relative_to(ROOT) for path in (ROOT / "trustlab").rglob("*") if path.is_file()]
    expected = {path.as_posix() for path in tracked if "__pycache__" not in path.parts}
    expected |= {
        f"trustlab/data/published/{path.name}" for path in (ROOT / "data" / "published").iterdir()
    }
    expected.add("trustlab/data/sessions/pilot.csv")
    assert expected - names == set()
    assert not any(name.startswith(("tests/", "benchmarks/")) for name in names)


def test_the_sdist_can_be_tested(built):
    with tarfile.open(built[".gz"]) as sdist:
        names = {name.split("/", 1)[-1] for name in sdist.getnames()}
    assert {
        "pyproject.toml",
        "LICENSE",
        "README.md",
        "environment.lock",
        "Makefile",
        "tests/conftest.py",
        "docs/conf.py",
    } <= names
    assert {
        f"data/published/{path.name}" for path in (ROOT / "data" / "published").iterdir()
    } <= names


@pytest.mark.long
def test_pages_run(installed, tmp_path):
    """
    Each page in a namespace of its own and a folder with nothing but the files that it shows, all
    in one process, which imports and loads what they need once.
    """
    code = (
        "import contextlib, io, os, trustlab\nassert "
        f"trustlab.__file__.startswith({str(installed)!r}), trustlab.__file__\n"
    )
    for number, page in enumerate(PAGES):
        folder = tmp_path / str(number)
        folder.mkdir()
        write_files(ROOT / page, folder)
        code += (
            f"os.chdir({str(folder)!r})\nwith contextlib.redirect_stdout(io.StringIO()) as said:\n"
        )
        code += (
            f"    exec(compile({python(ROOT / page)!r}, {page!r}, 'exec'), {{'__name__': "
            "'__main__'})\n"
        )
        code += f"assert said.getvalue().strip(), {page!r}\n"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
