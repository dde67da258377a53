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

import pytest

from tests.house.documents import ROOT
from trustlab.models.digest import ROOMS

# --- layers ---------------------------------------------------------------------------------------


PACKAGE = ROOT / "trustlab"
HEAVY = {
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
}


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@functools.cache
def imported(source):
    """Return the dotted names of all modules that a file imports, wherever in it."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def faults(room, source):
    others = (name.split(".")[1] for name in imported(source) if name.startswith("trustlab."))
    below = ROOMS[ROOMS.index(room) + 1 :]
    return [f"{room} imports {other}" for other in others if other in below]


def test_rooms_are_listed_and_import_upwards_only():
    paths = [*PACKAGE.glob("*/**/*.py"), *PACKAGE.glob("[!_]*.py")]
    assert {room_of(path) for path in paths} == set(ROOMS)
    assert [fault for path in paths for fault in faults(room_of(path), path.read_text())] == []


def test_the_check_sees_what_it_should():
    assert faults("models", "def f():\n    from trustlab.sessions.session import Session") == [
        "models imports sessions"
    ]
    assert faults("models", "from trustlab import sessions") == ["models imports sessions"]
    assert faults("sessions", "import trustlab.models.tsc") == []


def printed(code, folder=ROOT):
    """Return the lines that code prints in a Python of its own."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_import_is_light():
    assert printed(f"import sys, trustlab; print({HEAVY} & sys.modules.keys())") == ["set()"]


# --- dependencies ---------------------------------------------------------------------------------


SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT, GROUPS = SETTINGS["project"], SETTINGS["dependency-groups"]
EXTRAS = PROJECT["optional-dependencies"]
# Declared although no file imports them: JupyterLab is started by `make lab`, ipykernel by
# papermill; docs/conf.py names extensions and a theme; a Dask client is the user's own.
NOT_IMPORTED = {"jupyter", "ipykernel", "dask", "distributed"}
NOT_IMPORTED |= {"myst-nb", "numpydoc", "pydata-sphinx-theme"}


def names(requirements):
    return {re.match(r"[\w.-]+", line)[0].lower().replace("_", "-") for line in requirements}


OURS = {"trustlab", "tests", "benchmarks", "notebooks", "data"}
CORE = names(PROJECT["dependencies"])
OPTIONAL = set().union(*(names(lines) for extra, lines in EXTRAS.items() if extra != "all"))


def sources_of(folder):
    return [p for p in (ROOT / folder).rglob("*.py") if ".venv" not in p.parts]


@functools.cache
def distributions(folder):
    """Distributions that the files of a folder import."""
    known = packages_distributions()
    tops = {name.partition(".")[0] for p in sources_of(folder) for name in imported(p.read_text())}
    others = tops - sys.stdlib_module_names - OURS
    return names(name for top in others for name in known.get(top, [top]))


def test_what_trustlab_imports_is_declared():
    assert distributions("trustlab") - CORE - OPTIONAL == {"rclpy"}  # of a lab's own ROS 2


def test_what_is_declared_is_imported():
    imported = distributions("trustlab") | distributions("docs")
    assert (CORE | OPTIONAL) - imported == NOT_IMPORTED


@pytest.mark.parametrize("folder", ["tests", "data"])
def test_what_tests_import_is_declared(folder):
    beside = {path.stem for path in sources_of(folder)}
    declared = CORE | OPTIONAL | names(GROUPS["dev"]) | names(GROUPS["robot"])
    assert distributions(folder) - declared - beside == set()


# --- extras ---------------------------------------------------------------------------------------


NO_EXTRAS = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"anywidget", "papermill", "rosbags", "tornado", "traitlets"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
import inspect
import trustlab as tl

def said(code):
    try:
        exec(code)
    except (ModuleNotFoundError, AttributeError) as error:
        print(type(error).__name__, error)

"""


def test_missing_extras_are_named(tmp_path):
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\\n")
    (tmp_path / "notebooks").mkdir()
    code = """
said("tl.read_session('run.bag')")
said("tl.write_session(tl.sessions.example(), 'new.mcap')")
said("import trustlab.publishing.run")
"""
    words = 'ModuleNotFoundError {} is not installed; install it with: pip install "trustlab[{}]"'
    rosbags, papermill = words.format("rosbags", "ros"), words.format("papermill", "reports")
    assert printed(NO_EXTRAS + code, tmp_path) == [rosbags, rosbags, papermill]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notebooks", "run.bag"]


def test_names_of_a_missing_extra_are_absent_and_asking_for_one_says_what_to_install():
    """Oracle: the protocol of hasattr and inspect.getmembers, which pass over AttributeError."""
    code = """
for module in (tl, tl.live):
    names = [name for name, _ in inspect.getmembers(module)]
    for name in ("LiveGroundRobot", "DriveSettings"):
        print(hasattr(module, name), name in names)
    said("module.LiveGroundRobot")
"""
    lines = printed(NO_EXTRAS + code)
    for absent, there, words in (lines[:3], lines[3:]):
        assert (absent, there) == ("False False", "True True")
        assert words.startswith("AttributeError anywidget is not installed")
        assert 'pip install "trustlab[live]"' in words


def test_the_lock_has_every_dependency_and_names_no_registry():
    lock = (ROOT / "environment.lock").read_text()
    locked = {line.partition("==")[0] for line in lock.splitlines() if line[:1].isalpha()}
    assert (CORE | OPTIONAL) - locked == set()
    assert "://" not in lock


# --- wheel and sdist ------------------------------------------------------------------------------


def test_wheel_and_sdist_are_whole(tmp_path):
    source = tmp_path / "source"
    subprocess.run(["git", "checkout-index", "-a", f"--prefix={source}/"], cwd=ROOT, check=True)
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
