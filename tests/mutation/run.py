"""
Change operators, numbers and conditions one at a time, and see which changes no test notices.

`python tests/mutation/run.py [module …] [--sample N] [--seed S]` needs cosmic-ray, and works
in a copy of the repository. Prints every change that survives, but for those in `survivors.toml`,
which says why each of them changes nothing that a test could see. Fails below 95 %.
"""

import argparse
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
LEAST = 0.95

# Module of the package, and the tests that should notice a change of it.
MODULES = {
    "models/human": "tests/models/test_human.py",
    "models/robot": "tests/models/test_robot.py",
    "models/tsc": "tests/models/test_tsc.py",
    "models/trust": "tests/models/test_trust.py",
    "allocation/limits": "tests/allocation/test_bounds_as_printed.py tests/house/test_remedies.py "
    "tests/allocation/test_thresholds.py",
    "allocation/rules": "tests/allocation/test_rules.py",
    "allocation/steady_state": "tests/allocation/test_bounds_as_printed.py",
    "teleoperation/ports/ledger": "tests/teleoperation/test_ledger.py "
    "tests/teleoperation/test_channel.py",
    "teleoperation/ports/passivity": "tests/teleoperation/test_passivity.py",
    "teleoperation/ports/waves": "tests/teleoperation/test_channel.py "
    "tests/teleoperation/test_transparency.py",
    "sessions/metrics": "tests/sessions/test_metrics.py",
    "studies/analysis/sphericity": "tests/studies/analysis/test_repeated_measures.py "
    "tests/studies/analysis/test_against_r.py",
}

# Changes that say nothing: of types (`X | None`), of decorators, of names of errors, and exotic
# operators; a sum becomes a difference, a product a quotient, a bound open or closed.
KEPT = (
    r"core/(ReplaceBinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|Pow_Mul)"
    r"|ReplaceComparisonOperator_(Lt_LtE|LtE_Lt|Gt_GtE|GtE_Gt|Lt_Gt|Gt_Lt|Eq_NotEq|NotEq_Eq)"
    r"|ReplaceUnaryOperator_USub_UAdd|NumberReplacer|AddNot|ZeroIterationForLoop"
    r"|Replace(AndWithOr|OrWithAnd|TrueWithFalse|FalseWithTrue))"
)
CONFIGURATION = """
[cosmic-ray]
module-path = "trustlab/{module}.py"
timeout = 300.0
excluded-modules = []
test-command = "{python} -m pytest -x -q -p no:cacheprovider -m 'not long' {tests}"
[cosmic-ray.distributor]
name = "local"
[cosmic-ray.filters.operators-filter]
exclude-operators = ['^(?!{kept}$).*']
"""


def cosmic_ray(*arguments, folder):
    """Run a command of cosmic-ray in a folder."""
    subprocess.run([sys.executable, "-m", *map(str, arguments)], cwd=folder, check=True)


def changes_of(module, copy, python, sample, seed):
    """Return what became of each change of a module: where, which, and whether it survived."""
    session = copy.parent / f"{Path(module).name}.sqlite"
    configuration = session.with_suffix(".toml")
    content = CONFIGURATION.format(module=module, python=python, tests=MODULES[module], kept=KEPT)
    configuration.write_text(content, encoding="utf-8")
    cosmic_ray(
        "cosmic_ray.cli", "baseline", configuration, folder=copy
    )  # nothing changed: all pass
    cosmic_ray("cosmic_ray.cli", "init", configuration, session, folder=copy)
    cosmic_ray("cosmic_ray.tools.filters.operators_filter", session, configuration, folder=copy)
    database = sqlite3.connect(session)
    left = "SELECT job_id FROM work_items WHERE job_id NOT IN (SELECT job_id FROM work_results)"
    jobs = [row[0] for row in database.execute(left)]
    chosen = random.Random(seed).sample(sorted(jobs), min(sample or len(jobs), len(jobs)))
    for job in set(jobs) - set(chosen):
        database.execute("DELETE FROM mutation_specs WHERE job_id = ?", (job,))
        database.execute("DELETE FROM work_items WHERE job_id = ?", (job,))
    database.commit()
    cosmic_ray("cosmic_ray.cli", "exec", configuration, session, folder=copy)
    query = (
        "SELECT start_pos_row, operator_name, occurrence, test_outcome, diff FROM work_results "
        "JOIN mutation_specs USING (job_id) WHERE worker_outcome = 'NORMAL'"
    )
    return list(database.execute(query))


def main():
    """Run the modules asked for, and print what survived."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", help="such as models/human; all by default")
    parser.add_argument("--sample", type=int, help="changes tried of each module; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--python", default=str(ROOT / ".venv" / "bin" / "python"))
    options = parser.parse_args()
    known = tomllib.loads((ROOT / "tests" / "mutation" / "survivors.toml").read_text())
    tried = noticed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "trustlab"
        ignore = shutil.ignore_patterns(".git", ".venv", "__pycache__", "reports", ".*_cache")
        shutil.copytree(ROOT, copy, ignore=ignore)
        for module in options.modules or MODULES:
            rows = changes_of(module, copy, options.python, options.sample, options.seed)
            reasons = known.get(module, {})
            for line, operator, occurrence, outcome, diff in rows:
                name = f"{operator.removeprefix('core/')}:{occurrence}"
                if name in reasons and outcome == "SURVIVED":
                    continue
                tried += 1
                noticed += outcome == "KILLED"
                if outcome == "SURVIVED":
                    print(f"\n{module}.py:{line} {name}\n{diff}", flush=True)
            print(f"{module}: {len(rows)} changes; so far {noticed} of {tried} noticed", flush=True)
    return 0 if noticed >= LEAST * tried else 1


if __name__ == "__main__":
    sys.exit(main())
