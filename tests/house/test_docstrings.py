"""Every exported function, method and class says what it does and documents every argument."""

import ast
import importlib
import re
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "trustlab"


def documented(doc):
    """Names in the Parameters section of a numpydoc docstring."""
    section = re.search(
        r"^\s*Parameters\n\s*-{10}\n(.*?)(?=^\s*\w[\w ]*\n\s*-{3,}\n|\Z)", doc or "", re.M | re.S
    )
    if not section:
        return set()
    names = re.findall(r"^\s*([*\w, ]+?) : ", section[1], re.M)
    return {name.strip().lstrip("*") for line in names for name in line.split(",")}


def arguments(node):
    args = node.args
    names = [a.arg for a in args.posonlyargs + args.args + args.kwonlyargs]
    names += [a.arg for a in (args.vararg, args.kwarg) if a]
    return [name for name in names if name not in ("self", "cls")]


def fields(node):
    return [
        item.target.id
        for item in node.body
        if isinstance(item, ast.AnnAssign)
        and not item.target.id.startswith("_")
        and "ClassVar" not in ast.unparse(item.annotation)
    ]


def compiled(node):
    return any("njit" in ast.unparse(decorator) for decorator in node.decorator_list)


def exported(path):
    """Names that the room of a file exports: what a user can find and call."""
    room = path.relative_to(PACKAGE).parts[0]
    return (
        set() if room == "__init__.py" else set(importlib.import_module(f"trustlab.{room}").__all__)
    )


def undocumented(source, exported):
    """Exported names without a docstring, and their arguments that it leaves out."""
    found = []

    def visit(body, inside):
        for node in body:
            if not isinstance(node, (ast.FunctionDef, ast.ClassDef)) or node.name.startswith("_"):
                continue
            if any(ast.unparse(d) == "overload" for d in node.decorator_list):
                continue
            doc = ast.get_docstring(node)
            name = f"{inside}{node.name}"
            if not inside and node.name not in exported:
                continue
            if not doc:
                found.append(name)
            elif isinstance(node, ast.ClassDef):
                is_data = any("dataclass" in ast.unparse(d) for d in node.decorator_list)
                init = next(
                    (
                        n
                        for n in node.body
                        if isinstance(n, ast.FunctionDef) and n.name == "__init__"
                    ),
                    None,
                )
                wanted = fields(node) if is_data else arguments(init) if init else []
                found.extend(f"{name}({a})" for a in wanted if a not in documented(doc))
            elif not compiled(node):
                found.extend(f"{name}({a})" for a in arguments(node) if a not in documented(doc))
            if isinstance(node, ast.ClassDef):
                visit(node.body, f"{name}.")

    visit(ast.parse(source).body, "")
    return found


def test_every_public_argument_is_documented():
    files = sorted(PACKAGE.rglob("*.py"))
    found = {
        str(path.relative_to(PACKAGE)): undocumented(path.read_text(), exported(path))
        for path in files
    }
    assert {name: missing for name, missing in found.items() if missing} == {}
