"""
Whether a campaign sees that its task has changed, in a package, a script and a notebook.

Oracle: each state of the sources runs in a process of its own, which can only give its own values.
"""

import functools
import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import trustlab as tl
from tests.cases import refused
from trustlab.campaign.identity import sources

ROOT = str(Path(tl.__file__).parents[1])

# A class of the task's module, whose method calls functions of the module and has a base class.
TASK = """
import abc, enum, functools
import numba
{imports}

KNOWN = {{"alpha", "beta", "gamma", "delta"}}

def gain():
    return 1.0

@functools.cache
def stored():
    return 0.0

def gap(low, high):
    return high - low

class Rule:
    def __init__(self, weight):
        self.weight = weight

    @functools.cache
    def weighed(self):
        return self.weight * (self in RULES)

RULES = {{Rule(-2.0), Rule(2.0)}}

class Order(enum.Enum):
    FIRST = 1

class Base(abc.ABC):
    @property
    def doubled(self):
        return 2 * helper.VALUE

class Plant(Base):
    def run(self, x):
        y = gain() * x + self.doubled + len(KNOWN) + Order.FIRST.value
        return y + stored() + gap(low=x, high=x) + sum(rule.weighed() for rule in RULES)

@numba.njit
def compiled(x):
    return x + 1.0

plant = Plant()

def task(x, seed):
    return {{"y": plant.run(x) + compiled(x)}}
"""
CALL = """
import trustlab as tl
try:
    table = tl.run_campaign(task, tl.parameter_grid(x=[1.0, 2.0]), n_jobs=1, out="out")
    print(table["y"].tolist(), table.attrs["resumed"])
except tl.campaign.CampaignError as error:
    print(error)
"""
HELPER = "VALUE = 0\n"
CHANGES = [
    ("return 1.0", "return 5.0"),
    ("return 2 * helper", "return 3 * helper"),
    ("FIRST = 1", "FIRST = 4"),
    ('"delta"', '"epsilon"'),
    ("return 0.0", "return 0.5"),
    ("gap(low, high)", "gap(high, low)"),
    ("self.weight * ", "-self.weight * "),
    ("Rule(2.0)", "Rule(3.0)"),
    ("x + 1.0", "x + 2.0"),
    ("@numba.njit", "@numba.njit(fastmath=True)"),
    ("VALUE = 0", "VALUE = 1"),
]
# Runs each set of files in a child of its own, which has imported nothing but trustlab and numba.
DRIVER = """
import json, os, pathlib, runpy, sys
import numba
import trustlab.campaign.run
sys.path.insert(0, "")
for files in json.load(sys.stdin):
    if not os.fork():
        for name, text in files.items():
            pathlib.Path(name).parent.mkdir(exist_ok=True)
            pathlib.Path(name).write_text(text)
        runpy.run_path("script.py", run_name="__main__")
        sys.stdout.flush()
        os._exit(0)
    os.wait()
"""


def drive(folder, states):
    command = [sys.executable, "-B", "-c", DRIVER]
    env, given = os.environ | {"PYTHONPATH": ROOT}, json.dumps(states)
    output = subprocess.check_output(command, cwd=folder, env=env, text=True, input=given)
    return output.splitlines()


def in_package(task, helper):
    return {
        "lab/__init__.py": "",
        "lab/task.py": task.format(imports="from lab import helper"),
        "lab/helper.py": helper,
        "script.py": "from lab.task import task\n" + CALL,
    }


def in_script(task, helper):
    return {"script.py": task.format(imports="import helper") + CALL, "helper.py": helper}


def in_notebook(folder, states):
    nbformat = pytest.importorskip("nbformat")
    preprocessors = pytest.importorskip("nbconvert.preprocessors")
    sources = [f"import sys; sys.path.insert(0, {ROOT!r})"]
    for task, helper in states:
        sources.append(f"open('helper.py', 'w').write({helper!r})")
        sources += re.split(r"\n\n(?=\S)", task.format(imports="import helper"))
        sources += ["1 + 1", CALL]
    cells = [nbformat.v4.new_code_cell(source) for source in sources]
    notebook = nbformat.v4.new_notebook(cells=cells)
    executor = preprocessors.ExecutePreprocessor(timeout=120)
    executor.preprocess(notebook, {"metadata": {"path": str(folder)}})
    calls = [cell for cell in cells if cell.source == CALL]
    # What is printed at once may come in parts.
    return ["".join(part["text"] for part in cell.outputs).strip() for cell in calls]


@pytest.mark.parametrize("place", [in_package, in_script, in_notebook])
def test_a_changed_task_is_refused_and_the_same_goes_on(tmp_path, place):
    def printed(states):
        if place is in_notebook:
            return in_notebook(tmp_path, states)
        return drive(tmp_path, [place(*state) for state in states])

    same = (TASK, HELPER)
    changed = [tuple(text.replace(*change) for text in same) for change in CHANGES]
    assert printed([same]) == ["[8.0, 10.0] 0"]
    resumed, *refusals, again = printed([same, *changed, same])
    assert resumed == again == "[8.0, 10.0] 2"
    for change, said in zip(CHANGES, refusals, strict=True):
        assert "out holds another campaign" in said, change
        if place is in_package:
            name = "helper" if "VALUE = 0" in change else "task"
            assert f"another campaign: lab/{name}.py changed. Use another folder" in said


def test_modules_that_are_imported_later_count_also_of_an_installed_package(tmp_path):
    package = "site-packages/lab"
    task = "def task(x, seed):\n    import lab.deeper\n    return {'y': lab.deeper.VALUE}"
    files = {f"{package}/__init__.py": "", f"{package}/task.py": task}
    files["script.py"] = (
        f"import sys; sys.path.append('site-packages')\nfrom lab.task import task\n{CALL}"
    )
    (tmp_path / package).mkdir(parents=True)
    states = [files | {f"{package}/deeper.py": f"VALUE = {value}"} for value in (1, 1, 2)]
    first, resumed, refused = drive(tmp_path, states)
    assert [first, resumed] == ["[1, 1] 0", "[1, 1] 2"]
    assert "another campaign: lab/deeper.py changed. Use" in refused


def test_environments_and_locks_of_editors_within_a_package_are_no_part_of_it(
    tmp_path, monkeypatch
):
    """
    A package with its own environment beside its modules hashed thousands of files; a lock leads
    nowhere.
    """
    package = tmp_path / "lab"
    other = package / ".venv" / "lib" / "site-packages" / "other" / "__init__.py"
    other.parent.mkdir(parents=True)
    for file in (other, package / "__init__.py", package / "task.py"):
        file.write_text("def task(x, seed):\n    return {'y': x}\n")
    (package / ".#task.py").symlink_to("user@host.1")
    monkeypatch.syspath_prepend(tmp_path)
    task = importlib.import_module("lab.task").task
    found = [name for name in sources(task) if name.startswith("lab/")]
    assert sorted(found) == ["lab/__init__.py", "lab/task.py"]


def test_modules_beside_a_script_count_whoever_imports_them_but_not_the_rest_of_the_script(
    tmp_path,
):
    task = "def task(x, seed):\n    import later\n    return {'y': later.VALUE}\n"
    states = [
        {"script.py": task + call, "later.py": f"VALUE = {value}"}
        for call, value in [(CALL, 1), (CALL.replace("2.0", "2.0, 3.0"), 1), (CALL, 2)]
    ]
    first, grown, refused = drive(tmp_path, states)
    assert [first, grown] == ["[1, 1] 0", "[1, 1, 1] 2"]
    assert "another campaign: later.py changed. Use" in refused


def scaled(x, seed, factor=1):
    return {"y": factor * x}


def closed_over(factor):
    return lambda x, seed: {"y": factor * x}


class Scaled:
    def __init__(self, factor):
        self.factor = factor

    def __call__(self, x, seed):
        return {"y": self.factor * x}


def generated(factor):
    """What exec defines belongs to no module."""
    names = {}
    exec(f"def task(x, seed): return {{'y': {factor} * x}}", names)
    return names["task"]


@pytest.mark.parametrize(
    "make",
    [lambda factor: functools.partial(scaled, factor=factor), closed_over, Scaled, generated],
)
def test_values_and_code_that_a_task_carries_count(tmp_path, make):
    def go(factor):
        return tl.run_campaign(make(factor), [{"x": 1}, {"x": 2}], n_jobs=2, out=tmp_path)

    assert go(2)["y"].tolist() == [2, 4]
    assert go(2).attrs["resumed"] == 2
    for other in (3, 2.0, True):
        with refused("the task or a value it uses or fills changed"):
            go(other)
