"""Where results come from: data, commit and parameters, and no path of this machine."""

import re
import subprocess

from nbformat.v4 import new_notebook

from tests.publishing.world import ROOT, make
from trustlab.publishing.run import anonymous, commit, provenance


def test_provenance_lists_what_a_notebook_reads_and_names_no_path(tmp_path):
    told = {"start_time": "2026-11-27T13:48:22.1+00:00", "duration": 1.26}
    run = new_notebook(metadata={"papermill": told | {"parameters": {"seed": 5}}})
    read = provenance(ROOT, ROOT / "notebooks/01_identification.ipynb", run)
    assert read["Data"] == "data/coverage, data/published, data/sessions"
    assert (read["Started"], read["Time taken"]) == ("2026-11-27 13:48 UTC", "1.3 s")
    assert (read["Parameter seed"], read["Parameter runs"]) == ("5", "40")
    root = make(tmp_path, n01_a=["# A"])
    origin = provenance(root, root / "notebooks" / "01_a.ipynb", run)
    assert origin["Commit"] == "not a git checkout"
    assert str(tmp_path) not in str(origin)


def test_pages_stay_whole_where_there_is_no_home(monkeypatch):
    monkeypatch.setenv("HOME", "/")
    monkeypatch.setenv("TRUSTLAB_DATA", "/lab")
    assert anonymous("<p>a/b</p> /lab/x", ROOT) == "<p>a/b</p> TRUSTLAB_DATA/x"


def test_the_commit_is_marked_where_a_file_is_changed_or_new(tmp_path):
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a"]
    for words in ("init -q", "commit -q --allow-empty -m first"):
        subprocess.run([*git, *words.split()], check=True)
    clean = commit(tmp_path)
    assert re.fullmatch("[0-9a-f]{40}", clean)
    (tmp_path / "new.py").touch()
    assert commit(tmp_path) == clean + " + uncommitted changes"
    (tmp_path / "inside").mkdir()
    assert commit(tmp_path / "inside") == "not a git checkout"
