"""
README and the sources of the documentation: their blocks of code, and the files that these read.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TARGETS = {*re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.M)[1].split()}
FENCE = re.compile(r"^```(?P<head>[^\n]*)\n(?P<body>.*?)^```$", re.M | re.S)


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def blocks(path):
    """(language, caption, whether it runs, code) of every fenced block of a page."""
    for found in FENCE.finditer(path.read_text()):
        head = found["head"].removeprefix("{code-block} ").strip()
        options = dict(re.findall(r"^:(\w+): (.*)\n", found["body"], re.M))
        code = re.sub(r"\A(:\w+: .*\n)*\n?", "", found["body"])
        yield head, options.get("caption", ""), options.get("class") != "not-run", code


def python(path):
    """
    The Python of a page that runs, as one script: first its files, which have captions; what one
    block defines, later ones use.
    """
    found = [
        (caption, code) for name, caption, runs, code in blocks(path) if name == "python" and runs
    ]
    return "\n".join(code for _, code in sorted(found, key=lambda block: not block[0]))


def write_files(path, folder):
    """Write what a page's captioned blocks hold, which is what its code reads."""
    for _, caption, _, code in blocks(path):
        if caption:
            (folder / caption).parent.mkdir(parents=True, exist_ok=True)
            (folder / caption).write_text(code)
