"""Rooms import only rooms above them; importing trustlab loads nothing heavy."""

import ast
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import trustlab as tl
from trustlab.models.digest import ROOMS

PACKAGE = Path(__file__).parents[2] / "trustlab"
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
    """Every trustlab room that a module imports, wherever in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names = [node.module] + [
                f"{node.module}.{alias.name}" for alias in node.names if node.module == "trustlab"
            ]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] == "trustlab" and len(parts) > 1:
                yield parts[1]


def faults(room, source):
    if room not in ROOMS:
        return [f"{room} is no room"]
    return [
        f"{room} imports {other}"
        for other in imported(source)
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
