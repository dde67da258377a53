"""What counts as another task, and what does not."""

import functools
import importlib
import json
import linecache
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import trustlab as tl
from trustlab.campaign import CampaignError
from trustlab.campaign.identity import code_text, differences, task_identity, value_text


def define(source, name="task", file="<notebook cell 1>"):
    """Run a cell as a notebook does: its source is in linecache, its module is __main__."""
    linecache.cache[file] = (len(source), None, source.splitlines(True), file)
    space = {"__name__": "__main__", "np": np}
    exec(compile(source, file, "exec"), space)
    return space[name]


BASE = """
SCALE = 2.0

def inner(x):
    return x + 1

def task(x, seed, power=2):
    return {"y": SCALE * inner(x) ** power + sum(OFFSET for _ in range(2))}

OFFSET = 1
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("** power", "* power", "source of __main__.task changed"),
        ("x + 1", "x + 2", r"source of __main__.inner changed"),
        ("SCALE = 2.0", "SCALE = 2.5", "SCALE in __main__.task was 2.0, is 2.5"),
        ("OFFSET = 1", "OFFSET = 3", "OFFSET in __main__.task was 1, is 3"),
        ("power=2", "power=3", "source of __main__.task changed"),
    ],
)
def test_a_change_is_seen_and_named(old, new, said):
    before = task_identity(define(BASE))
    assert len(differences(before, task_identity(define(BASE.replace(old, new))))) >= 1
    text = "; ".join(differences(before, task_identity(define(BASE.replace(old, new)))))
    import re

    assert re.search(said, text)


@pytest.mark.parametrize(
    "changed",
    [
        BASE,
        BASE.replace("return x + 1", "return (x   +  1)  # one more"),
        BASE.replace("def inner", "\n\n# about it\ndef inner"),
        BASE + "\nOTHER = 5\ndef unused(): return 1\n",
    ],
)
def test_layout_comments_and_what_is_not_used_do_not_count(changed):
    assert task_identity(define(BASE)) == task_identity(define(changed))


def test_a_task_of_a_notebook_runs_in_processes_and_is_known_again(tmp_path):
    runs = tl.parameter_grid(x=range(8))
    table = tl.run_campaign(define(BASE), runs, n_jobs=2, out=tmp_path)
    assert list(table["y"]) == [2.0 * (x + 1) ** 2 + 2 for x in range(8)]
    assert tl.run_campaign(define(BASE), runs, n_jobs=2, out=tmp_path).attrs["resumed"] == 8
    with pytest.raises(CampaignError, match=r"source of __main__.inner changed"):
        tl.run_campaign(define(BASE.replace("x + 1", "x + 3")), runs, n_jobs=2, out=tmp_path)


def test_what_a_task_carries_counts():
    def make(value):
        return lambda x, seed: {"y": x * value}

    assert task_identity(make(1)) == task_identity(make(1))
    for a, b in [
        (1, 2),
        (1, 1.0),
        (np.arange(3), np.arange(4)),
        ({"a": 1}, {"a": 2}),
        (make(1), make(2)),
    ]:
        assert task_identity(make(a)) == task_identity(make(a))
        assert differences(task_identity(make(a)), task_identity(make(b)))
    bound = [functools.partial(make(1), x=x) for x in (1, 1, 2)]
    assert task_identity(bound[0]) == task_identity(bound[1])
    assert differences(task_identity(bound[0]), task_identity(bound[2]))[0].startswith(
        "task: arguments bound was"
    )
    one, other = (lambda x, seed: {"y": x}), (lambda x, seed: {"y": -x})
    assert differences(task_identity(one), task_identity(other))

    class Task:
        def __init__(self, k):
            self.k = k

        def __call__(self, seed):
            return {"y": self.k}

        def method(self, seed):
            return {"y": self.k}

    assert task_identity(Task(1)) == task_identity(Task(1))
    assert differences(task_identity(Task(1)), task_identity(Task(2)))
    assert differences(task_identity(Task(1).method), task_identity(Task(2).method))

    def wrapped(k):
        @functools.wraps(make)
        def wrapper(**kwargs):
            return {"y": k}

        return wrapper

    assert differences(task_identity(wrapped(1)), task_identity(wrapped(2)))


def recursive(x, seed):
    return {"y": 1 if x == 0 else recursive(x - 1, seed)["y"]}


def test_a_task_that_calls_itself_is_no_trouble():
    assert len(task_identity(recursive)) == 2


@given(
    st.recursive(
        st.one_of(
            st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(max_size=3)
        ),
        lambda inner: st.one_of(
            st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=2), inner, max_size=3)
        ),
        max_leaves=6,
    ),
    st.data(),
)
@settings(max_examples=100)
def test_texts_of_values_are_equal_where_values_are(value, data):
    import copy

    assert value_text(value) == value_text(copy.deepcopy(value))
    assert value_text([value]) != value_text(value)


def test_texts_tell_numbers_apart_to_the_last_bit():
    assert value_text(0.1) != value_text(np.nextafter(0.1, 1))
    assert value_text(1) != value_text(1.0)
    assert value_text(True) != value_text(1)
    assert value_text("1") != value_text(1)
    assert value_text(np.float64(0.1)) == value_text(0.1)
    assert value_text(np.int64(3)) == value_text(3)
    assert value_text(-0.0) != value_text(0.0)


def test_equal_objects_have_equal_texts_in_every_process():
    """Which strings are one object, and the order of sets, differ between processes."""
    words = ["".join(["al", "pha"]), "".join(["al", "pha"])]
    shared = [words[0], words[0]]
    assert value_text(functools.partial(max, words)) == value_text(functools.partial(max, shared))
    long = [*words, *range(30)]
    assert value_text(long) == value_text([*shared, *range(30)])
    script = (
        "import numpy as np; from trustlab.campaign.identity import value_text as t; import "
        "trustlab as tl; print(t(set(map(str, range(50)))), t({'m': tl.published_models()['1'], "
        "'a': np.arange(99.0), 's': {'x', 'y', 'z'}}))"
    )
    texts = {
        subprocess.run(
            [sys.executable, "-c", script],
            env=os.environ | {"PYTHONHASHSEED": str(seed)},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for seed in (1, 2)
    }
    assert len(texts) == 1


MODULE = "def task(seed):\n    return {{'y': {value}}}\n"


def test_processes_that_imported_an_earlier_version_of_a_task_are_not_used(tmp_path, monkeypatch):
    """loky keeps processes for the next campaign. Oracle: the task called in this process."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    file = tmp_path / "campaign_task_of_a_test.py"
    for value in (1, 2):
        file.write_text(MODULE.format(value=value))
        os.utime(file, (value * 1_000_000, value * 1_000_000))
        importlib.invalidate_caches()
        sys.modules.pop("campaign_task_of_a_test", None)
        module = importlib.import_module("campaign_task_of_a_test")
        table = tl.run_campaign(module.task, [{}, {}], n_jobs=2)
        assert list(table["y"]) == [module.task(None)["y"]] * 2 == [value] * 2


def test_edits_of_other_modules_of_the_tasks_package_are_seen(tmp_path):
    """Each state of the package is identified by a process of its own, as after a restart."""
    package = tmp_path / "labmodels"
    files = {
        "__init__.py": "",
        "task.py": "from . import plant\n\ndef task(x, seed):\n    return {'y': "
        "plant.step(x)}\n\ndef unused():\n    pass\n",
        "plant.py": "def step(x):\n    from labmodels.deep.gains import GAIN as g\n    return g "
        "* x\n",
        "deep/__init__.py": "",
        "deep/gains.py": "from ..constants import BASE\nGAIN = 2 * BASE\n",
        "constants.py": "import numpy\nimport labmodels.task\nBASE = 1.0\n",  # and back: a circle
        "other.py": "UNRELATED = 1\n",
    }

    def identity(**changed):
        for name, text in (files | changed).items():
            (package / name).parent.mkdir(parents=True, exist_ok=True)
            (package / name).write_text(text)
        script = (
            "import json; from labmodels.task import task; from trustlab.campaign.identity "
            "import task_identity; print(json.dumps(task_identity(task)))"
        )
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        return json.loads(
            subprocess.check_output([sys.executable, "-c", script], env=environment, text=True)
        )

    before = identity()
    assert {key for key in before if key.startswith("module")} == {
        f"module labmodels/{name}.py"
        for name in ("__init__", "plant", "deep/gains", "constants", "deep/__init__")
    }
    changed = {
        "deep/gains.py": files["deep/gains.py"].replace("2", "3"),
        "other.py": "UNRELATED = 2\n",
    }
    assert differences(before, identity(**changed)) == ["module labmodels/deep/gains.py changed"]
    commented = {
        "constants.py": files["constants.py"] + "# a comment\n",
        "task.py": files["task.py"] + "\nX = 1\n",
    }
    assert differences(before, identity(**commented)) == []


def test_code_is_the_same_wherever_it_stands():
    a, b = define(BASE), define("\n\n\n" + BASE, file="<notebook cell 2>")
    assert code_text(a.__code__) == code_text(b.__code__)
    assert code_text(a.__code__) != code_text(recursive.__code__)
