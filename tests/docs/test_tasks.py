"""
The six tasks of a researcher run as their pages say, from the built wheel, outside the repository.
"""

import json
import math
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbformat.v4 import new_code_cell, new_notebook
from scipy import stats

import trustlab as tl
from tests.house.documents import ROOT, blocks, python

FOLDER = ROOT / "docs" / "how_to" / "tasks"
PAGES = sorted(FOLDER.glob("*.md"))
HTML = FOLDER / "html_page.md"
SLIP, RIGHT = "2,38,.010", "2,34,.010"
NUMBER = re.compile(r"(?<![\w.])-?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?")
# As the other tests of the wheel: one worker builds it once.
pytestmark = pytest.mark.xdist_group("wheel")


def files(page):
    return {caption: code for _, caption, _, code in blocks(page) if caption}


def user_code(page):
    return [code for name, caption, _, code in blocks(page) if name == "python" and not caption]


@pytest.fixture(scope="module")
def environment(installed):
    programs = Path(sys.executable).parent
    paths = {"PYTHONPATH": str(installed), "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    return os.environ | paths | {"MPLBACKEND": "Agg"}


@pytest.fixture(scope="module")
def ran(environment, tmp_path_factory):
    """A folder for each page, with what it wrote and printed."""
    place = tmp_path_factory.mktemp("tasks")
    pages = {
        page.stem: {"files": files(page), "code": python(page)} for page in PAGES if page != HTML
    }
    table = pages["check_table"]
    corrected = {name: text.replace(SLIP, RIGHT) for name, text in table["files"].items()}
    pages["corrected"] = table | {"files": corrected}
    command = [sys.executable, ROOT / "tests" / "docs" / "run_pages.py", place]
    done = subprocess.run(
        command, cwd=place, env=environment, input=json.dumps(pages), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return place


def printed(ran, name):
    return (ran / name / "printed.txt").read_text()


def assert_latex(text):
    """A fragment is well formed: environments close, rows have as many cells as columns."""
    opened = re.findall(r"\\begin\{(\w+)\}", text)
    assert sorted(opened) == sorted(re.findall(r"\\end\{(\w+)\}", text))
    assert text.replace(r"\$", "").count("$") % 2 == 0
    assert text.count("{") == text.count("}")
    words = re.sub(r"\$[^$]*\$", "", text)  # outside mathematics
    assert not re.search(r"(?<!\\)[_^#%]|[−×²ηεχ±]", words)
    for columns, body in re.findall(r"\\begin\{tabular\}\{(l+)\}(.*?)\\end\{tabular\}", text, re.S):
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert {len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows} == {len(columns)}


def table_rows(text):
    """The cells of every row of the last table of a LaTeX fragment, without its head."""
    lines = text.rpartition(r"\midrule")[2].partition(r"\bottomrule")[0].strip().splitlines()
    return [[cell.strip() for cell in line.removesuffix(r"\\").split("&")] for line in lines]


def numbers(text):
    return [float(number) for number in NUMBER.findall(text.replace("−", "-"))]


def test_the_pages_are_from_the_wheel_alone(ran, installed):
    assert Path((ran / "installed.txt").read_text()).is_relative_to(installed)
    assert not ran.is_relative_to(ROOT)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_user_writes_fifteen_lines_at_most(page):
    lines = [line for code in user_code(page) for line in code.splitlines() if line.strip()]
    assert 0 < len(lines) <= 15


@pytest.mark.parametrize("page", [page for page in PAGES if page != HTML], ids=lambda p: p.stem)
def test_pages_show_what_their_code_prints(ran, page):
    """Words are the same; numbers but for what another machine's optimiser leaves open."""
    (shown,) = [code for name, caption, _, code in blocks(page) if name == "none"]
    found = printed(ran, page.stem)
    assert NUMBER.sub("#", shown).split() == NUMBER.sub("#", found).split()
    assert numbers(shown) == pytest.approx(numbers(found), rel=0.03, abs=0.01)


def test_four_people(ran):
    folder = ran / "four_people"
    text = (folder / "fits.tex").read_text()
    assert_latex(text)
    rows = table_rows(text)
    assert [row[0] for row in rows] == ["P1", "P2", "P3", "P4"]
    for name, *cells in rows:  # the parameters that the logs were made with
        human = tl.published_models()[name[1:]].human
        for cell, truth in zip(
            cells[:4],
            (0.1 * human.time_constant, human.beta, human.p_min, human.p_max),
            strict=True,
        ):
            value, error = map(float, cell.split(r" $\pm$ "))
            assert abs(value - truth) <= 4.0 * error
    assert printed(ran, "four_people").count("Thresholds") == 4
    assert (folder / "fit.png").read_bytes().startswith(b"\x89PNG")


def test_sample_size(ran):
    """Oracle: the noncentral t distribution of a paired test, by SciPy."""
    said = printed(ran, "sample_size")
    n = int(said.split()[0])
    moments = re.search(r"C1 (\S+) \((\S+)\), C3 (\S+) \((\S+)\), with .* of (\S+) between", said)
    low, sd_low, high, sd_high, correlation = map(float, moments.groups())
    assert high == pytest.approx(1.05 * low, rel=1e-3)
    spread = math.sqrt(sd_low**2 + sd_high**2 - 2.0 * correlation * sd_low * sd_high)

    def power(people):
        limit = stats.t.ppf(0.975, people - 1)
        return stats.nct.sf(limit, people - 1, (high - low) / spread * math.sqrt(people))

    assert power(n + 1) >= 0.8 >= power(n - 2)


def test_own_rule(ran):
    text = (ran / "own_rule" / "relay.tex").read_text()
    assert_latex(text)
    pairs = table_rows(text)
    assert len(pairs) == 15
    means = dict(re.findall(r"^(C\d|relay) & 20 & ([\d.]+) &", text, re.M))
    for a, b, difference, *_ in pairs:
        expected = float(means[a]) - float(means[b])
        assert float(difference.replace("$-$", "-")) == pytest.approx(expected, abs=0.0011)
    assert "simulated operators" in text


def test_jittered_scheme(ran):
    rows = np.reshape(numbers(printed(ran, "jittered_scheme")), (2, 4))
    (_, felt, energy, guarded), (_, felt_alone, energy_alone, off) = rows
    assert energy == 0.0
    assert energy_alone < -0.1  # not passive by itself
    assert felt < 0.5 * felt_alone
    assert guarded > 0.9
    assert off == 0.0
    assert (ran / "jittered_scheme" / "energies.png").read_bytes().startswith(b"\x89PNG")


def test_planted_contradiction_is_named_and_nothing_else(ran):
    verdicts = dict(re.findall(r"^(\w+): (True|False)", printed(ran, "check_table"), re.M))
    assert verdicts == {"trust": "True", "workload": "False", "satisfaction": "True"}
    assert "df2 = 38" in printed(ran, "check_table")
    assert "False" not in printed(ran, "corrected")  # negative control: the slip mended


def test_html_page(ran, environment):
    folder = ran / "four_people"
    cells = [new_code_cell(code) for code in user_code(HTML)]
    cells[0].metadata["tags"] = ["parameters"]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    asked = new_code_cell("print('installed in', tl.__file__)")
    notebook = new_notebook(cells=[*cells, asked], metadata={"kernelspec": kernel})
    nbformat.write(notebook, folder / "four.ipynb")
    drawn = environment | {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    (commands,) = [code for name, *_, code in blocks(HTML) if name == "sh"]
    for line in commands.replace("\\\n", "").splitlines():
        done = subprocess.run(
            shlex.split(line), cwd=folder, env=drawn, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr[-2000:]
    page = (folder / "four_run.html").read_text()
    assert len(re.findall(r"<img[^>]*src=\"data:image/png;base64", page)) == 4
    descriptions = re.findall(r'<img alt="([^"]*)', page)
    assert len(descriptions) == 4
    assert all("measured goes from" in words for words in descriptions)
    assert not re.search(r'(?:src|href)="https?:', page)
    assert page.count("<td>yes</td>") == 4  # thresholds are offered
    assert re.findall(r"<td>(P\d)</td>", page) == ["P1", "P2", "P3", "P4"]
    assert "fit_tsc" not in page  # no code
    assert f"installed in {environment['PYTHONPATH']}" in page
