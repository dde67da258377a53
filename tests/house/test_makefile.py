"""
The Makefile's recipes and `.ci/run` run where only BSD's tools are, as on macOS.

Stand-ins for the tools refuse what POSIX and BSD do not have and pass the rest on; python3 and uv
are replaced by scripts that write down what they were asked for. Nothing else is on the PATH.
"""

import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
if os.name != "posix" or shutil.which("make") is None:
    pytest.skip("needs make", allow_module_level=True)

# What each tool must not be given: options of GNU alone, and GNU's extensions of regular
# expressions and awk.
GNU = {
    "find": (
        r"^-(printf|fprintf|regextype|readable|writable|executable|daystart|xtype|files0-from)$"
        r"|^--"
    ),
    "sed": r"^--|^-[a-zA-Z]*[rsuz]|^-i$|\\[+?|wbsS<>tU]|\b[0-9]~[0-9]|/[gpI]*I$",
    "expand": r"^--|^-i",
    "xargs": r"^--|^-[a-zA-Z]*[rda]$",
    "cp": r"^--|^-[a-zA-Z]*[tuTdbS]",
    "mv": r"^--|^-[a-zA-Z]*[tuTbS]",
    "rm": r"^--",
    "mkdir": r"^--",
    "touch": r"^--|^-d$",
    "awk": r"^--|gensub|strftime|systime|asort|PROCINFO|IGNORECASE|\\[ywsS<>]|length\([a-z]+\[",
    "grep": r"^--|^-[a-zA-Z]*P",
    "dirname": r"^-",
}
AS_THEY_ARE = ["sh", "bash", "make", "env", "cat", "echo", "chmod", "cmp", "getconf"]

STAND_IN = """#!{python} -I
import os, re, sys
for given in sys.argv[1:]:
    if re.search({refused!r}, given):
        sys.exit("{name}: illegal option or expression: " + given)
if {name!r} == "find" and (len(sys.argv) < 2 or sys.argv[1].startswith("-")):
    # GNU alone takes the current folder for granted.
    sys.exit("usage: find [-H | -L | -P] path ... [expression]")
os.execv({real!r}, [{name!r}, *sys.argv[1:]])
"""

# Stands for python3, uv and every program of the environment: it says what it was asked for, and
# makes an environment.
PROGRAM = """#!{shell}
echo "${{0##*/}} $*" >> "{log}"
case "$*" in
  venv*|*"-m venv"*)
    for place; do :; done
    mkdir -p "$place/bin"
    for name in python ruff mypy jupyter; do cp "{program}" "$place/bin/$name"; done ;;
esac
"""


@pytest.fixture
def house(tmp_path):
    """A tree with the Makefile, and a PATH on which only the stand-ins are."""
    tools, tree = tmp_path / "tools", tmp_path / "tree"
    tools.mkdir()
    for name in AS_THEY_ARE:
        (tools / name).symlink_to(shutil.which(name))

    def program(path, text):
        path.write_text(text)
        path.chmod(path.stat().st_mode | stat.S_IXUSR)

    for name, refused in GNU.items():
        real = shutil.which(name)
        program(
            tools / name,
            STAND_IN.format(python=sys.executable, name=name, refused=refused, real=real),
        )
    log = tmp_path / "log"
    text = PROGRAM.format(shell=shutil.which("sh"), log=log, program=tmp_path / "program")
    for path in (tmp_path / "program", tools / "python3", tools / "uv"):
        program(path, text)
    for name in (
        "Makefile",
        ".ci/run",
        "pyproject.toml",
        "environment.lock",
        "benchmarks/environment.lock",
        "tests/ros/environment.lock",
    ):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tree / name)
    for name in (
        "trustlab/__pycache__/a.pyc",
        "tests/__pycache__/a.pyc",
        "data/a.csv",
        "notebooks/01_a.ipynb",
        "docs/api/a.rst",
        "docs/01_a.ipynb",
    ):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).touch()
    for name in ("README.md", "figures/a.png", "index.html", ".build/a", "a b.html"):
        (tree / "reports" / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / "reports" / name).touch()

    def run(*command):
        log.write_text("")
        done = subprocess.run(
            command,
            cwd=tree,
            env={"PATH": str(tools), "HOME": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        return done, log.read_text().splitlines()

    return tools, tree, run


def test_help_lists_every_target(house):
    done, _ = house[2]("make")
    assert done.returncode == 0, done.stderr
    listed = {line.split()[1]: line.split(maxsplit=2)[2] for line in done.stdout.splitlines()}
    phony = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.M)[1].split()
    assert set(listed) == set(phony)
    assert all(len(said) > 5 for said in listed.values())


@pytest.mark.parametrize("uv", [True, False])
def test_the_environment_is_built_once_and_every_recipe_runs(house, uv):
    tools, tree, run = house
    if not uv:
        (tools / "uv").unlink()
    done, asked = run("make", "test")
    assert done.returncode == 0, done.stderr
    installs = [line for line in asked if "install" in line]
    assert len(installs) == 3
    assert "--no-deps --require-hashes -r environment.lock" in installs[0]
    assert "--no-deps --require-hashes -r tests/ros/environment.lock" in installs[2]
    assert all(line.startswith("uv" if uv else "python -m pip") for line in installs)
    assert any(re.match(r"python -m pytest .*not long", line) for line in asked)
    for target, said in {
        "test": "pytest",
        "test-long": "pytest",
        "coverage": "--cov",
        "reports": "python -m sphinx",
        "bench": "python -m benchmarks",
        "lab": "jupyter lab",
        "data": "make_sessions",
    }.items():
        done, asked = run("make", target)
        assert done.returncode == 0, done.stderr
        assert said in asked[-1]
        assert uv or not any("install" in line for line in asked if target != "bench")
    done, asked = run("make", "lock")
    assert (done.returncode == 0) is uv
    done, _ = run("make", "clean")
    assert done.returncode == 0, done.stderr
    assert not (tree / ".venv").exists()
    left = {path.relative_to(tree).as_posix() for path in tree.rglob("*") if path.is_file()}
    assert {name for name in left if name.startswith("reports")} == {
        "reports/README.md",
        "reports/figures/a.png",
    }
    assert not any("__pycache__" in name or name.startswith("docs") for name in left)
    assert {"data/a.csv", "notebooks/01_a.ipynb", "environment.lock"} <= left


@pytest.mark.parametrize("broken", ["", "trustlab.publishing", "pytest"])
def test_continuous_integration_runs_reports_then_tests_and_stops_at_a_failure(house, broken):
    _, tree, run = house
    run("make", ".venv/.stamp")
    program = tree / ".venv" / "bin" / "python"
    failure = f'case "$*" in *"-m {broken or "nothing"}"*) exit 1 ;; esac\n'
    program.write_text(program.read_text() + failure)
    done, asked = run(".ci/run")
    modules = ["trustlab.publishing", "pytest"]
    ran = [name for line in asked for name in modules if f"python -m {name}" in line]
    assert ran == (modules[:1] if broken == modules[0] else modules)
    assert (done.returncode == 0) is (not broken)
