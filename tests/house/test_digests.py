"""
The same digits on every machine: results as another CPU would compute them, beside those stored.

Each setting runs in a process of its own, because linear algebra, NumPy and numba choose their code
when they are loaded.
"""

import copy
import importlib.util
import json
import math
import os
import platform
import subprocess
import sys

import pytest

from tests.house.documents import ROOT

SCRIPT = ROOT / "data" / "digests" / "make_digests.py"
RARE = [
    {"OPENBLAS_CORETYPE": "Sandybridge"},
    {"OPENBLAS_CORETYPE": "Haswell"},
    {"OPENBLAS_NUM_THREADS": "2"},
    {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"},
    {"NUMBA_CPU_NAME": "generic", "OPENBLAS_CORETYPE": "Prescott"},
]


@pytest.mark.skipif(
    (platform.system(), platform.machine()) != ("Linux", "x86_64"),
    reason="the settings choose code for x86-64 on Linux",
)
@pytest.mark.parametrize(
    "setting",
    [
        {"OPENBLAS_CORETYPE": "Nehalem"},
        *(pytest.param(setting, marks=pytest.mark.long) for setting in RARE),
    ],
    ids=lambda setting: "-".join(setting.values()),
)
def test_another_cpu_computes_the_same_digits_and_decisions(setting):
    environment = os.environ | setting | {"PYTHONWARNINGS": "ignore", "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, str(SCRIPT)], env=environment, cwd=ROOT, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr[-2000:]


@pytest.fixture(scope="module")
def digests():
    """The script as a module."""
    sys.path.insert(0, str(SCRIPT.parent))
    try:
        spec = importlib.util.spec_from_file_location("make_digests", SCRIPT)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(SCRIPT.parent))
    return module


@pytest.mark.parametrize("case", ["published_models", "limit_cycle", "incentive_bounds"])
def test_every_number_is_told_from_one_a_millionth_away(digests, case):
    expected = json.loads(digests.EXPECTED.read_text())[case]
    numbers = [
        (column, row, value)
        for column, cells in expected.items()
        for row, value in cells.items()
        if isinstance(value, float) and math.isfinite(value)
    ]
    assert len(numbers) > 1
    for column, row, value in numbers:
        moved = copy.deepcopy(expected)
        moved[column][row] = value * (1.0 + 1e-8)
        assert list(digests.differences(moved, expected)) == []
        moved[column][row] = value * (1.0 + 1e-6)
        assert list(digests.differences(moved, expected)) == [
            (column, row, moved[column][row], value)
        ]


def test_estimates_are_told_by_their_standard_errors_and_decisions_exactly(digests):
    expected = {
        "parameter": {"0": "beta", "rows": 1},
        "estimate": {"0": 0.7, "rows": 1},
        "standard_error": {"0": 0.02, "rows": 1},
        "determined": {"0": True, "rows": 1},
    }

    def told(column, value):
        return list(digests.differences(expected | {column: {"0": value, "rows": 1}}, expected))

    assert told("estimate", 0.7 + 1e-4 * 0.02) == told("standard_error", 0.02 + 1e-4 * 0.02) == []
    assert told("estimate", 0.7 + 1e-2 * 0.02) == [("estimate", "0", 0.7 + 1e-2 * 0.02, 0.7)]
    assert told("standard_error", 0.0201)
    assert told("estimate", float("nan"))
    assert told("parameter", "Beta")
    assert told("determined", False)
    assert told("determined", 1)
    fewer = {column: cells for column, cells in expected.items() if column != "determined"}
    assert ("determined", "0", "nothing", True) in list(digests.differences(fewer, expected))
