"""
Whether a campaign sees that its task has changed, in a package, a script and a notebook.

Oracle: each state of the sources runs in processes of its own, which can only give its own values.
"""

import functools
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import trustlab as tl

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(tl.__file__).parents[1])}

# A class of the task's module, whose method calls a function of the module and has a base class.
TASK = """
import dataclasses, enum, functools
import numba
{imports}

GAIN = 1.0
KNOWN = {{"alpha", "beta", "gamma", "delta"}}

def gain():
    return GAIN

class Order(enum.Enum):
    FIRST = 1

@dataclasses.dataclass
class Base:
    offset: float = 0.0

    @property
    def doubled(self):
        return 2 * self.offset

class Plant(Base):
    @staticmethod
    def scale():
        return 1.0

    def run(self, x):
        return gain() * self.scale() * x + self.doubled + len(KNOWN) + Order.FIRST.value

@numba.njit
def compiled(x):
    return x + 1.0

plant = Plant()
square = lambda x: x * x

def task(x, seed):
    import lazy
    return {{"y": plant.run(x) + compiled(x) + square(x) + helper.constant() + lazy.VALUE}}
"""
CALL = """
import trustlab as tl
try:
    table = tl.run_campaign(task, tl.parameter_grid(x=[1.0, 2.0]), n_jobs=1, out="out")
    print(table["y"].tolist(), table.attrs["resumed"])
except tl.campaign.CampaignError as error:
    print(error)
"""
HELPER = "def constant():\n    return 0.0\n"
CHANGES = [
    ("GAIN = 1.0", "GAIN = 5.0"),
    ("return GAIN", "return 5.0 * GAIN"),
    ("offset: float = 0.0", "offset: float = 50.0"),
    ("return 2 * self.offset", "return 3 * self.offset"),
    ("return 1.0", "return 2.0"),
    ("FIRST = 1", "FIRST = 4"),
    ('"delta"', '"epsilon"'),
    ("x + 1.0", "x + 2.0"),
    ("x * x", "x * x * x"),
    ("    return 0.0", "    return 100.0"),
    ("VALUE = 0", "VALUE = 1"),
]


def in_package(folder, task, helper, lazy):
    (folder / "lab").mkdir(exist_ok=True)
    task = task.format(imports="from lab import helper").replace(
        "import lazy", "from . import lazy"
    )
    files = {"__init__": "", "task": task, "helper": helper, "lazy": lazy}
    for name, text in files.items():
        (folder / "lab" / f"{name}.py").write_text(text)
    return run(folder, "from lab.task import task\n" + CALL)


def in_script(folder, task, helper, lazy):
    (folder / "helper.py").write_text(helper)
    (folder / "lazy.py").write_text(lazy)
    return run(folder, task.format(imports="import helper") + CALL)


def run(folder, script):
    (folder / "script.py").write_text(script)
    environment = ENVIRONMENT | {"PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.check_output(
        [sys.executable, "script.py"], cwd=folder, env=environment, text=True
    )


def in_notebook(folder, task, helper, lazy):
    nbformat = pytest.importorskip("nbformat")
    preprocessors = pytest.importorskip("nbconvert.preprocessors")
    (folder / "helper.py").write_text(helper)
    (folder / "lazy.py").write_text(lazy)
    path = "import sys; sys.path.insert(0, %r); sys.dont_write_bytecode = True"
    sources = [path % ENVIRONMENT["PYTHONPATH"]]
    # One cell each; the call stands twice, with a cell between that shows the results.
    sources += re.split(r"\n\n(?=\S)", task.format(imports="import helper"))
    sources += [CALL, "print(table)", CALL]
    cells = [nbformat.v4.new_code_cell(source) for source in sources]
    notebook = nbformat.v4.new_notebook(cells=cells)
    executor = preprocessors.ExecutePreprocessor(timeout=120, allow_errors=True)
    executor.preprocess(notebook, {"metadata": {"path": str(folder)}})
    return notebook.cells[-1].outputs[0]["text"]


@pytest.mark.parametrize(
    ("place", "changes"),
    [(in_package, CHANGES[1:3] + CHANGES[-2:]), (in_script, CHANGES), (in_notebook, CHANGES)],
)
def test_a_changed_task_is_refused_and_the_same_goes_on(tmp_path, place, changes):
    sources = (TASK, HELPER, "VALUE = 0\n")
    values = "[9.0, 14.0]"
    assert place(tmp_path, *sources).startswith(values)
    assert place(tmp_path, *sources) == f"{values} 2\n"  # in another process
    for old, new in changes:
        assert any(old in source for source in sources)
        said = place(tmp_path, *(source.replace(old, new) for source in sources))
        assert "out holds another campaign" in said, (old, said)
        if place is in_package:
            name = {"    return 0.0": "helper", "VALUE = 0": "lazy"}.get(old, "task")
            assert f"lab/{name}.py changed. Use another folder" in said
    assert place(tmp_path, *sources) == f"{values} 2\n"


@pytest.mark.parametrize("package", ["", "site-packages/lab/"])
def test_modules_that_are_imported_later_count_also_of_an_installed_package(tmp_path, package):
    folder = tmp_path / package
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "__init__.py").touch()
    prefix = "lab." if package else ""
    helper = f"def task(x, seed):\n    import {prefix}deeper as d\n    return {{'y': d.VALUE}}"
    (folder / "helper.py").write_text(helper)
    script = (
        f"import sys; sys.path.append('site-packages')\nfrom {prefix}helper import task\n{CALL}"
    )
    said = []
    for value in (1, 1, 2):
        (folder / "deeper.py").write_text(f"VALUE = {value}")
        said.append(run(tmp_path, script))
    name = f"{prefix.replace('.', '/')}deeper.py"
    assert said[:2] == ["[1, 1] 0\n", "[1, 1] 2\n"]
    assert f"another campaign: {name} changed. Use" in said[2]


def scaled(x, seed, factor=1):
    return {"y": factor * x}


def closed_over(factor):
    return lambda x, seed: {"y": factor * x}


class Scaled:
    def __init__(self, factor):
        self.factor = factor

    def __call__(self, x, seed):
        return {"y": self.factor * x}

    def method(self, x, seed):
        return self(x, seed)


@pytest.mark.parametrize(
    "make",
    [
        lambda factor: functools.partial(scaled, factor=factor),
        closed_over,
        Scaled,
        lambda factor: Scaled(factor).method,
        lambda factor: functools.partial(closed_over(factor)),
    ],
)
@pytest.mark.parametrize("pair", [(1, 2), (1, 1.0), (1, True)])
def test_values_that_a_task_carries_count(tmp_path, make, pair):
    for _ in range(2):
        table = tl.run_campaign(make(pair[0]), [{"x": 1}], n_jobs=1, out=tmp_path)
    assert table.attrs["resumed"] == 1
    with pytest.raises(ValueError, match="the task or a value it uses changed"):
        tl.run_campaign(make(pair[1]), [{"x": 1}], n_jobs=1, out=tmp_path)


def test_processes_that_imported_an_earlier_version_are_not_used(tmp_path):
    """joblib keeps its processes. Oracle: the task called in this process."""
    script = """
import importlib, json, os
from pathlib import Path
import trustlab as tl
file = Path("edited.py")
for value in (1, 2):
    file.write_text(f"def task(x, seed): return {{'y': {value}}}")
    os.utime(file, (value * 10**6, value * 10**6))
    edited = importlib.reload(edited) if value > 1 else importlib.import_module("edited")
    table = tl.run_campaign(edited.task, [{"x": 1}, {"x": 2}], n_jobs=2)
    print(json.dumps([*table["y"], edited.task(1, 0)["y"]]))
"""
    printed = run(tmp_path, script).splitlines()
    assert [json.loads(line) for line in printed] == [[1, 1, 1], [2, 2, 2]]
