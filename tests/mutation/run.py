"""
Change operators, numbers and conditions one at a time, and see which changes no test notices.

`python tests/mutation/run.py [module …] [--sample N] [--seed S]` needs cosmic-ray, and works
in a copy of the repository, where what a changed module is compiled into is compiled anew. Prints
every change that survives, but for those in `survivors.toml`, which says why each of them changes
nothing that a test should see. Fails where fewer than 97 % are noticed or have a reason.
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
from collections import Counter
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[2]
LEAST = 0.97

# A change of `room/module` should be noticed by `tests/room/test_module.py`, and by these tests.
NOTICED_BY = {
    "models/test_equations.py": "models/trust models/tsc models/uav",
    "models/test_results.py": "models/checks models/display",
    "campaign/test_run.py": "campaign/parameters",
    "campaign/test_resume.py": "campaign/run",
    "sessions/test_bags.py": "sessions/patterns",
    "sessions/test_recipes.py": "sessions/columns sessions/drafting sessions/patterns "
    "sessions/reading sessions/recipe",
    "sessions/test_times.py": "sessions/columns sessions/reading",
    "sessions/test_remedies.py": "sessions/columns sessions/reading sessions/recipe "
    "sessions/tables",
    "sessions/test_real_logs.py": "sessions/folders",
    "sessions/test_writing.py": "sessions/bags",
    "identification/test_fit_result.py": "identification/log identification/result",
    "identification/test_limits.py": "identification/fit identification/model identification/tsc",
    "identification/test_logged.py": "identification/fit identification/log "
    "identification/problem identification/tsc",
    "identification/test_model.py": "identification/log",
    "identification/test_regression.py": "identification/transfer_function",
    "identification/posterior/test_likelihood.py": "identification/log "
    "identification/posterior/density",
    "identification/posterior/test_sample_posterior.py": "identification/posterior/result "
    "identification/posterior/sampling",
    "allocation/test_bounds.py": "allocation/limits",
    "allocation/test_correction_casadi.py": "allocation/casadi_correction",
    "allocation/test_correction_exhaustive.py": "allocation/correction",
    "allocation/test_correction_runs.py": "allocation/correction_run",
    "allocation/test_invariant_bounds.py": "allocation/invariant",
    "allocation/test_limit_cycle.py": "allocation/steady",
    "allocation/test_rules.py": "allocation/rules",
    "allocation/test_guarantees.py": "allocation/rules",
    "allocation/test_thresholds.py": "allocation/estimates",
    "allocation/test_posterior_choice.py": "allocation/steady allocation/thresholds",
    "trust/test_models.py": "trust/fitting",
    "trust/test_people.py": "trust/panel",
    "trust/test_models.py -k 'beta or not (ends or intervals or below or return)'": (
        "trust/dynamics/* trust/interface trust/likelihood trust/panel"
    ),
    "teleoperation/test_channel.py": "teleoperation/delays teleoperation/ports",
    "teleoperation/test_haptic_device.py": "teleoperation/ports",
    "teleoperation/test_leader_policies.py": "teleoperation/team/decisions",
    "teleoperation/test_ledger.py": "teleoperation/channel teleoperation/ports",
    "teleoperation/test_passivity.py": "teleoperation/ports teleoperation/stability",
    "operators/test_operators.py": "operators/*",
    "testbeds/test_conditions.py": "testbeds/condition_run testbeds/deciding testbeds/populations "
    "testbeds/testbed testbeds/uav_following allocation/estimates",
    "testbeds/test_deciding.py": "testbeds/ground_robot/kernel",
    "testbeds/test_ground_robot.py": "testbeds/ground_robot/*",
    "testbeds/test_guidance.py": "testbeds/teleoperation_measures",
    "testbeds/test_refusals.py": "operators/ground_robot teleoperation/delays "
    "teleoperation/team/graphs testbeds/ground_robot/course",
    "testbeds/test_robot_team.py": "teleoperation/team/graphs teleoperation/team/kernel "
    "teleoperation/team/settings testbeds/team_run",
    "testbeds/test_team.py": "models/simulation teleoperation/team/settings testbeds/team_run "
    "testbeds/team_testbed",
    "testbeds/test_teleoperation_loop.py": "teleoperation/loop/* testbeds/teleoperation_measures",
    "testbeds/test_uav_tracking.py": "teleoperation/loop/* teleoperation/ports",
    "studies/test_against_r.py": "studies/mixed studies/repeated_measures",
    "studies/test_designs.py": "studies/order_effects",
    "studies/test_factorial.py": "studies/anova studies/words",
    "studies/test_pairs.py": "studies/anova",
    "studies/test_power.py": "studies/population",
    "studies/test_repeated_measures.py": "studies/table studies/words",
    "reproduction/test_printed.py": "models/published reproduction/printed reproduction/published",
    "reproduction/audit/test_audit.py": "reproduction/audit/*",
    "reproduction/audit/test_verdict.py": "reproduction/audit/*",
    "reproduction/reconstruction/test_feasibility.py": "reproduction/reconstruction/*",
    "reproduction/reconstruction/test_reconstruction.py": "reproduction/reconstruction/*",
    "publishing/test_hostile.py": "publishing/tables",
    "publishing/test_publish.py": "publishing/chapter publishing/run",
    "publishing/test_reports.py": "publishing/chapter publishing/parameters publishing/tables",
    "live/test_trial.py": "live/log",
    "live/study/test_features.py": "live/study/participant",
    "live/study/test_plan.py": "live/condition",
    "live/study/test_recorded.py": "live/fit",
    "live/tasks/test_ground_robot.py": "live/hands",
    "live/tasks/test_tasks.py": "live/hands live/task live/tasks/*",
    "ros/test_decision.py": "ros/core",
    "ros/test_node.py": "ros/recorded ros/run",
}
# Only settings, pages, servers or caches, though they have tests of their own.
LEFT_OUT = {
    "live/study/pages",
    "live/study/server",
    "live/widget",
    "models/compiled",
    "ros/node",
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
timeout = 300.0
excluded-modules = []
test-command = "{command}"
[cosmic-ray.distributor]
name = "local"
"""
# The mark of arguments that are given by keyword alone is no product.
MARK = re.compile(r"^\+.*[(\s]/,", re.M)
DIFFERENT_LINE = re.compile(r"^([-+])(?!--|\+\+)\s*(.*)$", re.M)


def tests_of(module):
    """Return the tests that should notice a change of a module, its own first."""
    room, _, name = module.rpartition("/")
    files = [f"{room}/test_{name}.py"]
    for file, modules in NOTICED_BY.items():
        if file not in files and any(fnmatch(module, part) for part in modules.split()):
            files.append(file)
    return [f"tests/{file}" for file in files if (ROOT / "tests" / file.split()[0]).exists()]


def modules_with_tests():
    """Return the modules that compute something, in the order of their names."""
    package = ROOT / "trustlab"
    files = sorted(package.rglob("[!_]*.py"))
    modules = [file.relative_to(package).with_suffix("").as_posix() for file in files]
    return [module for module in modules if module not in LEFT_OUT and tests_of(module)]


def keep_compiled(copy):
    """Let the caches of compiled functions in a copy depend on what is compiled alone."""
    models = copy / "trustlab" / "models"
    content = (models / "digest.py").read_text(encoding="utf-8")
    compiled = '(word in file.read_bytes() for word in (b"njit", b"inner", b"record("))'
    content = content.replace("parts += [", f"if any{compiled}: parts += [")
    (models / "digest_of_compiled.py").write_text(content, encoding="utf-8")
    content = (models / "compiled.py").read_text(encoding="utf-8")
    content = content.replace("trustlab.models.digest", "trustlab.models.digest_of_compiled")
    (models / "compiled.py").write_text(content, encoding="utf-8")


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
    tests = " ".join(tests_of(module))
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
    return [row for row in database.execute(query) if not MARK.search(row[1])]


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
    tried, noticed, explained = Counter(), Counter(), Counter()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "trustlab"
        ignore = shutil.ignore_patterns(".git", ".venv", "__pycache__", "reports", ".*_cache")
        shutil.copytree(ROOT, copy, ignore=ignore)
        keep_compiled(copy)
        os.environ["PYTHONPATH"] = str(copy)  # before the installed package
        os.environ["NUMBA_BOUNDSCHECK"] = "1"  # a loop that goes on too far shows
        for module in options.modules or modules_with_tests():
            rows = changes_of(module, copy, options.python, options.sample, options.seed)
            survivors = [row for row in rows if row[2] == "SURVIVED"]
            gaps = [row for row in survivors if not is_known(row[1], known.get(module, []))]
            for line, diff, _ in gaps:
                print(f"\n{module}.py:{line}\n{diff}", flush=True)
            room = module.split("/")[0]
            tried[room] += len(rows)
            noticed[room] += len(rows) - len(survivors)
            explained[room] += len(survivors) - len(gaps)
            print(f"{module}: {len(rows) - len(gaps)} of {len(rows)}", flush=True)
    print(f"seed {options.seed}, of each module {options.sample or 'all'} changes")
    for room in tried:
        print(f"{room}: {noticed[room]} noticed, {explained[room]} with a reason, of {tried[room]}")
    kept = noticed.total() + explained.total()
    print(f"all: {kept} of {tried.total()} changes noticed or with a reason")
    return 0 if kept >= LEAST * tried.total() else 1


if __name__ == "__main__":
    sys.exit(main())
