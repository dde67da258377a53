"""The package as a whole: layers of rooms, dependencies, extras, and what is shipped."""

import ast
import functools
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions
from types import ModuleType

import pytest

import trustlab as tl
from tests.house.documents import ROOT
from trustlab.models.digest import ROOMS

# --- layers ---------------------------------------------------------------------------------------


PACKAGE = ROOT / "trustlab"
HEAVY = [
    "pandas",
    "scipy",
    "numba",
    "matplotlib",
    "statsmodels",
    "pingouin",
    "casadi",
    "emcee",
    "rosbags",
    "pyarrow",
    "papermill",
]


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(source):
    """Yield the dotted names of all modules that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def faults(room, source):
    if room not in ROOMS:
        return [f"{room} is no room"]
    others = (name.split(".")[1] for name in imported(source) if name.startswith("trustlab."))
    return [
        f"{room} imports {other}"
        for other in others
        if other in ROOMS and ROOMS.index(other) > ROOMS.index(room)
    ]


def test_rooms_import_upwards_only():
    found = []
    for path in PACKAGE.rglob("*.py"):
        if path.parent != PACKAGE or path.name != "__init__.py":
            found += [f"{path.name}: {fault}" for fault in faults(room_of(path), path.read_text())]
    assert found == []


def test_the_check_sees_what_it_should():
    assert faults("models", "def f():\n    from trustlab.sessions.session import Session") == [
        "models imports sessions"
    ]
    assert faults("models", "from trustlab import sessions") == ["models imports sessions"]
    assert faults("helpers", "") == ["helpers is no room"]
    assert faults("sessions", "import trustlab.models.tsc") == []


def test_import_is_light():
    code = f"import sys, trustlab; print([name for name in {HEAVY} if name in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_every_public_name_is_there():
    rooms = [getattr(tl, name) for name in tl.__all__]
    modules = [room for room in rooms if isinstance(room, ModuleType)]
    assert [
        f"{room.__name__}.{name}"
        for room in modules
        for name in room.__all__
        if not hasattr(room, name)
    ] == []
    assert len(rooms) > 15
    assert len(modules) >= 10


# --- dependencies ---------------------------------------------------------------------------------


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PROJECT["project"]["optional-dependencies"]
# Declared although no file imports them: JupyterLab is started by `make lab`, ipykernel by
# papermill; docs/conf.py names extensions and a theme; a Dask client is the user's own.
NOT_IMPORTED = {"jupyter", "ipykernel", "dask", "distributed"}
NOT_IMPORTED |= {"myst-nb", "numpydoc", "pydata-sphinx-theme"}


def names(requirements):
    return {re.match(r"[\w.-]+", line)[0].lower().replace("_", "-") for line in requirements}


CORE = names(PROJECT["project"]["dependencies"])
OPTIONAL = set().union(*(names(lines) for extra, lines in EXTRAS.items() if extra != "all"))
DEV = names(PROJECT["dependency-groups"]["dev"])


ROS = names(PROJECT["dependency-groups"]["robot"])


def sources_of(folder):
    return [p for p in (ROOT / folder).rglob("*.py") if ".venv" not in p.parts]


@functools.cache
def distributions(folder):
    """Distributions that the files of a folder import."""
    known = packages_distributions()
    tops = {name.partition(".")[0] for p in sources_of(folder) for name in imported(p.read_text())}
    others = (
        tops - sys.stdlib_module_names - {"trustlab", "tests", "benchmarks", "notebooks", "data"}
    )
    found = (name for top in others for name in known.get(top, [top]))
    return {name.lower().replace("_", "-") for name in found}


def test_what_trustlab_imports_is_declared():
    assert distributions("trustlab") - CORE - OPTIONAL == {"rclpy"}  # of a lab's own ROS 2


def test_what_is_declared_is_imported():
    imported = distributions("trustlab") | distributions("docs")
    assert (CORE | OPTIONAL) - imported == NOT_IMPORTED


@pytest.mark.parametrize("folder", ["tests", "data"])
def test_what_tests_import_is_declared(folder):
    beside = {path.stem for path in sources_of(folder)}
    assert distributions(folder) - CORE - OPTIONAL - DEV - ROS - beside == set()


# --- extras ---------------------------------------------------------------------------------------


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

USES = {
    "read a bag": ("ros", "rosbags.highlevel", "tl.read_session('run.bag')"),
    "write a bag": ("ros", "rosbags", "tl.write_session(session, 'new.mcap')"),
    "publish": ("reports", "papermill", "import trustlab.publishing.run"),
}


@pytest.mark.parametrize("use", USES)
def test_missing_extra_is_named(use, tmp_path):
    extra, package, call = USES[use]
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "notebooks").mkdir()
    code = (
        f"import sys; sys.modules[{package!r}] = None\n"
        "import numpy as np, pandas as pd, trustlab as tl\n"
        "frame = pd.DataFrame({'mode': [1.0, 0.0]}, index=pd.Index([0.0, 0.1], name='t'))\n"
        f"session = tl.Session(frame)\n{call}\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert f'pip install "trustlab[{extra}]"' in done.stderr.splitlines()[-1]
    assert package.partition(".")[0] in done.stderr.splitlines()[-1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notebooks", "run.bag"]


NO_LIVE = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"anywidget", "tornado", "traitlets"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
"""


@pytest.mark.parametrize("module", ["tl", "tl.live"])
def test_names_of_a_missing_extra_are_absent_and_asking_for_one_says_what_to_install(module):
    """Oracle: the protocol of hasattr and inspect.getmembers, which pass over AttributeError."""
    code = (
        f"{NO_LIVE}\nimport inspect\nimport trustlab as tl\n"
        f"names = [name for name, _ in inspect.getmembers({module})]\n"
        f"print(hasattr({module}, 'LiveGroundRobot'), 'LiveGroundRobot' in names)\n"
        f"print(hasattr({module}, 'DriveSettings'), 'DriveSettings' in names)\n"
        f"{module}.LiveGroundRobot\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["False", "False", "True", "True"], done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith("AttributeError: anywidget is not installed")
    assert 'pip install "trustlab[live]"' in last


def test_the_lock_has_every_dependency_and_names_no_registry():
    lock = (ROOT / "environment.lock").read_text()
    locked = {line.partition("==")[0] for line in lock.splitlines() if line[:1].isalpha()}
    needed = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    names = {
        line.partition(">")[0].replace("_", "-")
        for group in needed
        for line in group
        if "[" not in line
    }
    assert names - locked == set()
    assert "://" not in lock


# --- wheel and sdist ------------------------------------------------------------------------------


def test_wheel_and_sdist_are_whole(tmp_path):
    source = tmp_path / "source"
    command = ["git", "checkout-index", "--all", f"--prefix={source}/"]
    subprocess.run(command, cwd=ROOT, check=True)
    tracked = [str(p.relative_to(source)) for p in source.rglob("*") if p.is_file()]
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,), (sdist,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    names = set(zipfile.ZipFile(wheel).namelist())
    published = [name for name in tracked if name.startswith("data/published/")]
    expected = {name for name in tracked if name.startswith("trustlab/")}
    expected |= {f"trustlab/{name}" for name in [*published, "data/sessions/pilot.csv"]}
    assert expected - names == set()
    assert not any(name.startswith(("tests/", "benchmarks/")) for name in names)
    with tarfile.open(sdist) as archive:
        shipped = {name.split("/", 1)[-1] for name in archive.getnames()}
    files = "pyproject.toml LICENSE README.md environment.lock Makefile tests/conftest.py"
    assert {*files.split(), "docs/conf.py", *published} <= shipped
