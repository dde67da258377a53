"""
Compare results of public functions with those of the repository, on any machine: `make digest`.

`expected.json` has, for each case of `cases.py`, each column of its result: the values of a short
column; of a long one some rows, their number, and the mean, least and greatest of all.
Computed numbers agree to 1e-7, estimates to 1e-3 of their standard error (means of a posterior: of
its standard deviation), and decisions exactly: whole numbers, flags and words.

`python data/digests/make_digests.py --write [case ...]` stores what this machine computes.
"""

import argparse
import json
import math
import sys
import warnings
import zlib
from pathlib import Path

import numpy as np
import pandas as pd
from cases import CASES

EXPECTED = Path(__file__).parent / "expected.json"
MOST_ROWS = 20
COMPUTED = 1e-7
ESTIMATED = 1e-3
# Of the largest number in a column: what is left of larger ones that cancel.
CANCELLED = 1e-13
# Of anything: an energy of so many joules is none.
ROUNDING = 1e-15


def tabled(result):
    """Return a result as a table with the names of its rows in columns."""
    if isinstance(result, pd.DataFrame):
        named = result.index.name or result.index.nlevels > 1
        return result.reset_index() if named else result
    if isinstance(result, np.ndarray):
        result = result.ravel()
    return pd.DataFrame(result if isinstance(result, dict) else {"value": list(result)})


def stored(value):
    """Return a value as JSON holds it, numbers with ten digits."""
    if isinstance(value, float):
        return float(f"{value:.10g}")
    if value is None or isinstance(value, bool | int | str):
        return value
    raise TypeError(f"{value!r:.60} is neither a number nor a word")


def summary(column):
    """Return row → value of a short column; of a long one some rows, and what sums up the rest."""
    values = column.tolist()
    step = math.ceil(len(values) / MOST_ROWS) or 1
    cells = {str(row): values[row] for row in range(0, len(values), step)} | {"rows": len(values)}
    if step > 1:
        numbers = [x for x in values if isinstance(x, float) and math.isfinite(x)]
        decisions = [x for x in values if not isinstance(x, float)]
        if numbers:
            mean = math.fsum(numbers) / len(numbers)
            cells |= {"mean": mean, "least": min(numbers), "greatest": max(numbers)}
        if decisions:
            cells["checksum"] = zlib.crc32(repr(decisions).encode())
    return {row: stored(value) for row, value in cells.items()}


def computed(name):
    """Return the columns of a case's result, as this machine computes it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = tabled(CASES[name]())
    return {str(column): summary(table[column]) for column in table}


def tolerance(columns, column, row):
    """Return how far a number may lie from the expected one."""
    if "standard_error" in columns:
        return ESTIMATED * columns["standard_error"][row]
    numbers = [abs(x) for x in columns[column].values() if isinstance(x, float)]
    largest = max(filter(math.isfinite, numbers), default=0.0)
    return COMPUTED * abs(columns[column][row]) + CANCELLED * largest + ROUNDING


def differences(columns, expected):
    """Yield column, row, value and expected value of every place where a result differs."""
    for column in expected | columns:
        cells, targets = columns.get(column, {}), expected.get(column, {})
        for row in targets | cells:
            value, target = cells.get(row, "nothing"), targets.get(row, "nothing")
            if type(value) is type(target) is float:
                close = value == target or (math.isnan(value) and math.isnan(target))
                close = close or abs(value - target) <= tolerance(expected, column, row)
            else:
                close = type(value) is type(target) and value == target
            if not close:
                yield column, row, value, target


def main():
    """Compare this machine's results with those of the repository, or store them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="cases; all by default")
    parser.add_argument("--write", action="store_true", help="store what this machine computes")
    options = parser.parse_args()
    names = options.names or list(CASES)
    expected = json.loads(EXPECTED.read_text(encoding="utf-8")) if EXPECTED.is_file() else {}
    if options.write:
        expected |= {name: computed(name) for name in names}
        lines = [f"{json.dumps(name)}: {json.dumps(expected[name])}" for name in CASES]
        EXPECTED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        return 0
    agree = True
    for name in names:
        places = list(differences(computed(name), expected[name]))
        print(f"{name:33} {'DIFFERS' if places else 'agrees'}", flush=True)
        for column, row, value, target in places:
            print(f"    {column}, row {row}: {value} here, {target} expected")
        agree &= not places
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
