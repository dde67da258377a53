"""Notebooks are committed without outputs; prose with numbers is produced by code."""

import json
import re
from pathlib import Path

import pytest

# Of a cell, with lines of 100 columns that the formatter lays out.
MOST_LINES = 60
# Of a notebook, blank ones not counted.
MOST_CODE = 250
NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
QUOTED = re.compile(r"“[^”]*”|```.*?```|`[^`]*`", re.S)
DECIMAL = re.compile(r"(?<![\w.()\-])\d+\.\d+(?![\w.)])")
EQUATION = re.compile(
    r"\(\d\.\d+\)(?:[-–]\(\d\.\d+\))?"
    r"|(?:Fig|Figs|Table|Tables|Section|Sections|Chapter|Algorithm)\.?\s+"
    r"[\d.]+(?:(?:, | and |[-–])[\d.]+)*"
)


def decimals(text):
    """
    Decimal literals in prose: not equation, figure, table or section numbers, not quoted or in
    code.
    """
    return DECIMAL.findall(EQUATION.sub("", QUOTED.sub("", text)))


def load(path):
    return json.loads(path.read_text())["cells"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_no_outputs(path):
    for cell in load(path):
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_no_decimal_literals_in_prose(path):
    found = {}
    for i, cell in enumerate(load(path)):
        if cell["cell_type"] == "markdown" and (numbers := decimals("".join(cell["source"]))):
            found[i] = numbers
    assert found == {}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_code_cells_are_short(path):
    cells = ["".join(cell["source"]) for cell in load(path) if cell["cell_type"] == "code"]
    assert [source for source in cells if len(source.splitlines()) > MOST_LINES] == []
    lines = [line for source in cells for line in source.splitlines() if line.strip()]
    assert len(lines) <= MOST_CODE


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_begins_with_a_title_and_a_sentence(path):
    first = "".join(load(path)[0]["source"])
    assert re.match(r"# .+\n\n\w.+", first)
