"""Digests of sources: oracle, packages written for the test, whose imports are known."""

import pytest

from trustlab.models.digest import digest, forget_sources, imported_files, source_digest

FILES = {
    "__init__.py": "",
    "a.py": "from pkg import b\nimport json, pkg.sub.c as see\n",
    "b.py": "def f():\n    from .sub import (\n        d,  # the second\n    )\n",
    "sub/__init__.py": "",
    "sub/c.py": "from ..e import x\n",
    "sub/d.py": "from other.b import y\nimport e\n",
    "e.py": "x = 1\n",
    "alone.py": "",
}


@pytest.fixture
def package(tmp_path):
    root = tmp_path / "pkg"
    for name, text in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


def test_imports_are_followed_however_they_are_written(package):
    files = imported_files([package / "a.py"], package)
    names = {path.relative_to(package).as_posix() for path in files}
    assert names == set(FILES) - {"alone.py"}


def test_a_digest_changes_with_every_imported_file_and_no_other(package):
    before = source_digest(package / "a.py", root=package)
    for name in FILES:
        forget_sources()
        (package / name).write_text(FILES[name] + "# changed\n")
        changed = source_digest(package / "a.py", root=package) != before
        assert changed is (name != "alone.py")
        (package / name).write_text(FILES[name])


def test_parts_do_not_run_together():
    assert digest("ab", "c") != digest("a", "bc")
    assert digest("a", "b") != digest("b", "a")
    assert digest("ü") == digest("ü".encode())
