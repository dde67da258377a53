"""
Links and figures of README, CONTRIBUTING and the documentation's sources are there, and their code
runs.
"""

import re
import tomllib

import matplotlib as mpl
import pytest
from matplotlib import pyplot as plt

import trustlab as tl
from tests.house.documents import DOCUMENTS, ROOT, blocks, name_of, python, write_files
from trustlab.sessions import load_recipe


@pytest.mark.parametrize("path", [*DOCUMENTS, ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_links_and_figures_are_there(path):
    targets = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", path.read_text())
    missing = [
        place
        for place in targets
        if not place.startswith("api/")
        and not (path.parent / place).exists()
        # Executed notebooks become chapters beside the book's first page.
        and not (path.name == "index.md" and (ROOT / "notebooks" / place).exists())
    ]
    missing += [
        place for place in targets if place.startswith("api/") and path.parent.name != "docs"
    ]
    named = re.findall(r"`((?:data|notebooks|reports|tests|trustlab)/[\w./]+)`", path.read_text())
    missing += [place for place in named if not (ROOT / place).exists()]
    # what users fetch by hand, and what `make reports` and `make session` write
    made = ("data/external", "reports/index", "reports/my_session")
    assert [place for place in missing if not place.startswith(made)] == []


SCRIPTS = [path for path in DOCUMENTS if python(path)]


# One worker runs them all, so that what they compile and read is there for all.
@pytest.mark.xdist_group("docs")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", SCRIPTS, ids=name_of)
def test_code_runs(path, tmp_path, monkeypatch, capsys):
    write_files(path, tmp_path)
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    with mpl.rc_context({"backend": "Agg"}):
        exec(compile(python(path), name_of(path), "exec"), {"__name__": "__main__"})
        plt.close("all")
    assert capsys.readouterr().out.strip()


def words_of(path):
    """Words of a page with its blocks of code, without the markup of tables and signs."""
    return [word for word in path.read_text().split() if re.search(r"\w", word)]


def test_documentation_is_short():
    assert sum(len(words_of(path)) for path in DOCUMENTS[1:]) <= 10_000
    assert len(words_of(ROOT / "CONTRIBUTING.md")) <= 600


def test_names_of_the_state_on_the_page_are_its_own():
    page = (ROOT / "docs" / "how_to" / "own_parts.md").read_text()
    listed = re.findall(r"^\| (`.*?) \|", page, re.M)
    names = re.findall(r"`(\w+)`", " ".join(listed))
    assert len(names) > 10
    state = tl.TeleoperationLoop().state
    logged = [
        re.sub("_[xyz]$", "", name) for name in tl.simulate_teleoperation("M", duration=2.0).data
    ]
    assert [name for name in [*names, *logged] if not hasattr(state, name)] == []


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_code_that_does_not_run_is_python_and_needs_what_tests_lack(path):
    for language, _, runs, code in blocks(path):
        if language == "python" and not runs:
            compile(code, name_of(path), "exec")
            # a server, ROS, a cluster, readers of other formats
            assert path.name in {"live_study.md", "robot.md", "reproducible.md", "logs.md"}


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_recipes_can_be_followed(path, tmp_path):
    for language, caption, _, code in blocks(path):
        if language == "toml" and "kind = " in code and "[columns]" in code:  # of logs
            (tmp_path / caption).write_text(code)
            load_recipe(tmp_path / caption)


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_targets_of_make_are_there(path):
    phony = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.M)[1].split()
    shell = "".join(code for language, _, _, code in blocks(path) if language == "sh")
    assert set(re.findall(r"^make (\S+)", shell, re.M)) <= set(phony)


def test_every_equation_is_shown():
    printed = tomllib.loads((ROOT / "data" / "published" / "equations.toml").read_text())
    page = (ROOT / "docs" / "concepts" / "equations.md").read_text()
    assert sorted(" ".join(re.findall(r"^```\{equation\} (.*)$", page, re.M)).split()) == sorted(
        printed
    )


def test_readme_is_one_page():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 70


def test_the_checks_see_what_they_should(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "```python\nx = 1\n```\n```{code-block} python\n:class: not-run\n\nx = 2\n```\n"
        "```{code-block} toml\n:caption: a.toml\n\ny = 3\n```\n"
    )
    assert list(blocks(page)) == [
        ("python", "", True, "x = 1\n"),
        ("python", "", False, "x = 2\n"),
        ("toml", "a.toml", True, "y = 3\n"),
    ]
    assert python(page) == "x = 1\n"
