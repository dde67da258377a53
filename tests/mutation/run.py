"""
Change operators, numbers and conditions one at a time, and see which changes no test notices.

`python tests/mutation/run.py [module …] [--sample N] [--seed S]` needs cosmic-ray, and works
in a copy of the repository, where each changed module and all that it is compiled into are compiled
anew. Prints every change that survives, but for those in `survivors.toml`, which says why each of
them changes nothing that a test should see. Fails below 95 %.
"""

import argparse
import ast
import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
LEAST = 0.95

# Module of the package, and the tests that should notice a change of it, quick ones first.
MODULES = {
    "models/tsc": "models/test_equations.py",
    "models/simulation": "models/test_simulation.py",
    "models/trust": "models/test_equations.py",
    "models/uav": "models/test_equations.py",
    "allocation/blending": "allocation/test_blending.py",
    "allocation/estimates": "allocation/test_thresholds.py testbeds/test_conditions.py",
    "allocation/simulation": "allocation/test_rules.py allocation/test_guarantees.py",
    "allocation/correction": "allocation/test_correction.py "
    "allocation/test_correction_exhaustive.py",
    "allocation/invariant": "allocation/test_invariant_bounds.py",
    "allocation/optimum": "allocation/test_optimum.py",
    "allocation/limits": "allocation/test_bounds.py",
    "allocation/rules": "allocation/test_rules.py",
    "allocation/bounds": "allocation/test_bounds.py",
    "allocation/steady": "allocation/test_limit_cycle.py",
    "allocation/thresholds": "allocation/test_thresholds.py allocation/test_posterior_choice.py",
    "teleoperation/ports/device": "teleoperation/test_haptic_device.py "
    "teleoperation/test_passivity.py",
    "teleoperation/ports/waves": "teleoperation/test_ledger.py teleoperation/test_channel.py",
    "sessions/metrics": "sessions/test_metrics.py",
    "studies/anova": "studies/test_anova.py studies/test_factorial.py studies/test_pairs.py",
}

# Kinds of changes: a sum becomes a difference, a product a quotient, a bound open or closed, a
# number one more or less. Left out are changes that say nothing: of types (`X | None`), of names of
# errors, exotic operators, and decorators, which say how to compile.
KINDS = (
    r"core/(ReplaceBinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|Pow_Mul)"
    r"|ReplaceComparisonOperator_(Lt_LtE|LtE_Lt|Gt_GtE|GtE_Gt|Lt_Gt|Gt_Lt|Eq_NotEq|NotEq_Eq)"
    r"|ReplaceUnaryOperator_USub_UAdd|NumberReplacer|AddNot|ZeroIterationForLoop"
    r"|Replace(AndWithOr|OrWithAnd|TrueWithFalse|FalseWithTrue))"
)
# Functions that only show: looked at, not tested to the digit.
SHOWING = re.compile(r"_?plot|__str__|__repr__|_repr_html_|_qualified")
CONFIGURATION = """
[cosmic-ray]
module-path = "trustlab/{module}.py"
timeout = 120.0
excluded-modules = []
test-command = "{command}"
[cosmic-ray.distributor]
name = "local"
"""
DIFFERENT_LINE = re.compile(r"^([-+])(?!--|\+\+)\s*(.*)$", re.M)


def cosmic_ray(*arguments, folder):
    """Run a command of cosmic-ray in a folder."""
    command = [sys.executable, "-m", "cosmic_ray.cli", *map(str, arguments)]
    subprocess.run(command, cwd=folder, check=True)


def lines_left_out(file):
    """Return the lines of functions that only show a result, of decorators and of types."""
    nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    left_out = [node for node in functions if SHOWING.match(node.name)]
    for node in nodes:
        left_out += getattr(node, "decorator_list", [])
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            left_out.append(node)
    return {row for node in left_out for row in range(node.lineno, node.end_lineno + 1)}


def changes_of(module, copy, python, sample, seed):
    """Return what became of each change of a module: its line, the difference, the outcome."""
    tests = " ".join(f"tests/{file}" for file in MODULES[module].split())
    command = f"{python} -m pytest -x -q -p no:cacheprovider -p no:xdist -m 'not long' {tests}"
    # Nothing changed: all must pass. Bytecode and compiled functions of all other modules stay.
    subprocess.run(command, shell=True, cwd=copy, check=True, stdout=subprocess.DEVNULL)
    session = copy.parent / f"{module.replace('/', '_')}.sqlite"
    configuration = session.with_suffix(".toml")
    content = CONFIGURATION.format(module=module, command=command)
    configuration.write_text(content, encoding="utf-8")
    cosmic_ray("init", configuration, session, folder=copy)
    database = sqlite3.connect(session)
    left_out = lines_left_out(copy / "trustlab" / f"{module}.py")
    # In a fixed order: the names of jobs are drawn at random.
    jobs = database.execute(
        "SELECT job_id, operator_name, start_pos_row FROM mutation_specs "
        "ORDER BY operator_name, occurrence"
    ).fetchall()
    telling = [job for job, kind, row in jobs if re.fullmatch(KINDS, kind) and row not in left_out]
    chosen = random.Random(seed).sample(telling, min(sample or len(telling), len(telling)))
    for job in {job for job, _, _ in jobs} - set(chosen):
        database.execute("DELETE FROM mutation_specs WHERE job_id = ?", (job,))
        database.execute("DELETE FROM work_items WHERE job_id = ?", (job,))
    database.commit()
    cosmic_ray("exec", configuration, session, folder=copy)
    query = (
        "SELECT start_pos_row, diff, test_outcome FROM work_results "
        "JOIN mutation_specs USING (job_id) WHERE worker_outcome = 'NORMAL'"
    )
    return list(database.execute(query))


def is_known(diff, reasons):
    """Return whether a change is listed with a reason why no test should notice it."""
    lines = {sign: "".join(line.split()) for sign, line in DIFFERENT_LINE.findall(diff)}
    for entry in reasons:
        if "".join(entry["line"].split()) == lines.get("-"):
            changes = ["".join(change.split()) for change in entry.get("changes", ())]
            if not changes or lines.get("+") in changes:
                return True
    return False


def main():
    """Run the modules asked for, and print what survived."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", help="such as models/tsc; all by default")
    parser.add_argument("--sample", type=int, help="changes tried of each module; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--python", default=str(ROOT / ".venv" / "bin" / "python"))
    options = parser.parse_args()
    known = tomllib.loads((ROOT / "tests" / "mutation" / "survivors.toml").read_text())
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    tried = noticed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "trustlab"
        ignore = shutil.ignore_patterns(".git", ".venv", "__pycache__", "reports", ".*_cache")
        shutil.copytree(ROOT, copy, ignore=ignore)
        os.environ["PYTHONPATH"] = str(copy)  # before the installed package
        os.environ["NUMBA_BOUNDSCHECK"] = "1"  # a loop that goes on too far shows
        for module in options.modules or MODULES:
            rows = changes_of(module, copy, options.python, options.sample, options.seed)
            reasons = known.get(module, [])
            rows = [row for row in rows if row[2] == "KILLED" or not is_known(row[1], reasons)]
            survivors = [row for row in rows if row[2] == "SURVIVED"]
            for line, diff, _ in survivors:
                print(f"\n{module}.py:{line}\n{diff}", flush=True)
            tried += len(rows)
            noticed += len(rows) - len(survivors)
            print(
                f"{module}: {len(rows) - len(survivors)} of {len(rows)} changes noticed", flush=True
            )
    print(f"{noticed} of {tried} changes noticed")
    return 0 if noticed >= LEAST * tried else 1


if __name__ == "__main__":
    sys.exit(main())
