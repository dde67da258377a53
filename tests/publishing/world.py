"""A small book of its own: what `make reports` reads, in a folder."""

import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

ROOT = Path(__file__).parents[2]
SETTINGS = """
api_only = "Session$"
suppress_warnings += ["ref.obj", "ref.mod"]
"""
INDEX = """# A small book

```{toctree}
reports
concepts/equations
api/index
```
"""
REPORTS = """# Reports

```{toctree}
:glob:

[0-9][0-9]_*
```
"""


def tagged(source, *tags):
    return new_code_cell(source, metadata={"tags": list(tags)})


def make(root, **notebooks):
    """Make a repository with these notebooks, given as lists of cells; words are Markdown."""
    docs = root / "docs"
    for name in ("notebooks", "data/published", "docs/concepts", "docs/static"):
        (root / name).mkdir(parents=True, exist_ok=True)
    for name in ("docs/conf.py", "docs/extension.py", "docs/concepts/equations.md"):
        shutil.copy(ROOT / name, root / name)
    shutil.copytree(ROOT / "docs" / "static", docs / "static", dirs_exist_ok=True)
    shutil.copy(ROOT / "data/published/equations.toml", root / "data/published")
    shutil.copy(ROOT / "data/published/verdicts.toml", root / "data/published")
    with (docs / "conf.py").open("a") as file:
        file.write(SETTINGS)
    page = docs / "concepts" / "equations.md"
    page.write_text(page.read_text().replace("[another page](does_not_hold.md)", "another page"))
    (docs / "index.md").write_text(INDEX)
    (docs / "reports.md").write_text(REPORTS)
    for name, cells in notebooks.items():
        cells = [new_markdown_cell(cell) if isinstance(cell, str) else cell for cell in cells]
        about = {"kernelspec": {"name": "python3", "display_name": "Python", "language": "python"}}
        notebook = new_notebook(cells=cells, metadata=about)
        nbformat.write(notebook, root / "notebooks" / f"{name[1:]}.ipynb")
    return root


def publish(root, *names, parameters=""):
    """Let Make run the notebooks of these names, or all; return what it did."""
    names = names or [path.stem for path in sorted((root / "notebooks").glob("*.ipynb"))]
    lock = root / "environment.lock"
    if not lock.exists():
        lock.touch()
    command = ["make", "-f", ROOT / "Makefile", f"VENV={sys.prefix}", "-k", "-j", "3"]
    chapters = [f"docs/{name}.ipynb" for name in names]
    return subprocess.run(
        [*command, f"PARAMS={parameters}", *chapters], cwd=root, capture_output=True, text=True
    )


def write_book(root):
    """Let Sphinx write the book; return what it did."""
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "docs", "reports"]
    return subprocess.run(command, cwd=root, capture_output=True, text=True)
