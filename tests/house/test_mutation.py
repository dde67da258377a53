"""The run of changes knows its modules, their tests, and lines that still stand."""

import tomllib
from pathlib import Path

from tests.mutation.run import MODULES

ROOT = Path(__file__).parents[2]
SURVIVORS = tomllib.loads((ROOT / "tests" / "mutation" / "survivors.toml").read_text())


def test_every_module_and_its_tests_are_there():
    for module, tests in MODULES.items():
        assert (ROOT / "trustlab" / f"{module}.py").is_file()
        assert all((ROOT / "tests" / name).is_file() for name in tests.split())


def test_every_listed_survivor_is_a_line_of_its_module_with_a_reason():
    for module, entries in SURVIVORS.items():
        assert module in MODULES
        source = (ROOT / "trustlab" / f"{module}.py").read_text().splitlines()
        lines = {line.strip() for line in source}
        for entry in entries:
            assert entry["line"] in lines, (module, entry["line"])
            assert entry["reason"]
            assert entry["line"] not in entry.get("changes", ())
