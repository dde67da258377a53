"""
The widgets in JupyterLab and Notebook 7 themselves: their pages, their shortcuts, their kernel that
is asked in mid-run and restarted.

Oracle: numba's replay of what was logged, the rows that the page has made, and the notebook's own
list of cells.
"""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.long
pytest.importorskip("jupyterlab", reason="JupyterLab is not installed")
pytest.importorskip("notebook", reason="Notebook 7 is not installed")

DRIVE = """import trustlab as tl
live = tl.LiveGroundRobot("C1", model=tl.published_models()["2"], laps=1)
live"""
FLY = """import trustlab as tl
live = tl.LiveTracking("TMIG", seed=0, task=tl.TrackingTask(view=1.0))
live"""
LEAD = """import trustlab as tl
from trustlab.live import LeadingSettings
live = tl.LiveTeam("by_hand", LeadingSettings(duration=60.0), seed=1)
live"""
ASK = """session = live.session
command = live.trial.record.commands[-1]
pauses = [pause["why"] for pause in session.metadata.more["pauses"]]
print("asked", len(session), live.verified, command[-1], pauses, "end")"""
BUSY = "import time; time.sleep(2.0); print('slept end')"
CELL = """async (i) => {
  const notebook = jupyterapp.shell.currentWidget.content, cell = notebook.widgets[i];
  notebook.activeCellIndex = i;
  cell.model.executionCount = null;
  await jupyterapp.commands.execute("notebook:run-cell");
  return cell.model.executionCount !== null;
}"""
RUNS = "[...document.querySelectorAll('div')].filter((part) => part.run)"
HAVE = f"({RUNS}.at(-1)?.run.state().have ?? -1)"


@pytest.fixture(scope="module", params=["lab", "notebook"])
def lab(request, tmp_path_factory):
    """The application's name and address, and its folder."""
    home = tmp_path_factory.mktemp(request.param)
    own = {f"JUPYTER_{name}_DIR": str(home / name) for name in ("CONFIG", "DATA", "RUNTIME")}
    own["XDG_STATE_HOME"] = str(home / "state")
    root = str(Path(__file__).parents[2])
    environment = os.environ | own | {"IPYTHONDIR": str(home / "ipython"), "PYTHONPATH": root}
    options = [
        "--no-browser",
        "--port=0",
        "--allow-root",
        "--expose-app-in-browser",
        f"--ServerApp.root_dir={home}",
    ]
    module = {"lab": "jupyterlab", "notebook": "notebook"}[request.param]
    command = [sys.executable, "-m", module, *options, "--IdentityProvider.token=secret"]
    with (home / "log").open("w") as log:
        server = subprocess.Popen(command, cwd=home, env=environment, stdout=log, stderr=log)
    try:
        for _ in range(600):
            found = re.search(
                r"http://(?:localhost|127\.0\.0\.1):(\d+)/", (home / "log").read_text()
            )
            if found:
                break
            assert server.poll() is None, (home / "log").read_text()
            time.sleep(0.1)
        yield request.param, f"http://127.0.0.1:{found[1]}", home
    finally:
        server.terminate()
        server.wait(30)


class Opened:
    """A notebook that is open in JupyterLab or Notebook 7."""

    def __init__(self, browser, lab, name, cells):
        application, address, home = lab
        kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
        notebook = {"nbformat": 4, "nbformat_minor": 5, "metadata": kernel}
        code = {"cell_type": "code", "metadata": {}, "execution_count": None, "outputs": []}
        notebook["cells"] = [
            code | {"id": f"cell-{i}", "source": source} for i, source in enumerate(cells)
        ]
        (home / f"{name}.ipynb").write_text(json.dumps(notebook))
        self.page, self.faults = browser.new_page(viewport={"width": 1280, "height": 900}), []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on(
            "console", lambda said: self.faults.append(said.text) if said.type == "error" else None
        )
        path = {"lab": "lab/tree", "notebook": "notebooks"}[application]
        self.page.goto(f"{address}/{path}/{name}.ipynb?token=secret&reset")
        self.page.wait_for_selector(".jp-Notebook .jp-Cell", timeout=60_000)
        self.page.wait_for_function(
            f"jupyterapp.shell.currentWidget?.context?.path === '{name}.ipynb'"
        )
        self.page.evaluate("jupyterapp.shell.currentWidget.sessionContext.ready.then(() => 0)")
        self.page.wait_for_function(
            "jupyterapp.shell.currentWidget.sessionContext.session?.kernel?.status === 'idle'",
            timeout=60_000,
        )
        self.faults.clear()  # what the application says of itself as it starts

    def run(self, i):
        """Run a cell; JupyterLab, when it is not ready yet, runs nothing and says nothing."""
        for _ in range(20):
            if self.page.evaluate(CELL, i):
                return
            self.page.wait_for_timeout(500)
        raise AssertionError(f"cell {i} does not run")

    def asked(self, i):
        """Run a cell that prints, and return its words."""
        output = self.page.locator(".jp-Cell").nth(i).locator(".jp-OutputArea-output")
        before = output.inner_text() if output.count() else ""
        self.run(i)
        for _ in range(300):
            self.page.wait_for_timeout(100)
            now = output.inner_text() if output.count() else ""
            if now != before and now.strip().endswith("end"):
                return now.split(maxsplit=4)[1:]
        raise AssertionError(f"cell {i} says {now!r}; faults {self.faults}")

    def cells(self):
        return self.page.locator(".jp-Cell").count()


@pytest.mark.parametrize(
    ("name", "source"), [("drive", DRIVE), ("flight", FLY), ("team", LEAD)], ids="dft"
)
def test_a_run_in_jupyterlab(browser, lab, name, source):
    one = Opened(browser, lab, name, [source, ASK, BUSY])
    page, cells = one.page, one.cells()

    def until(rows):
        page.wait_for_function(f"{HAVE} > {rows}", timeout=60_000)

    one.run(0)
    page.click("text=Start driving", timeout=300_000)  # the first kernel compiles
    until(3)
    if name == "drive":
        page.keyboard.down("ArrowUp")
    else:
        box = page.locator("canvas.pad").bounding_box()
        page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.4 * box["height"])
    before = page.evaluate(HAVE)
    # in a notebook: scroll, cut the cell, undo, delete it, restart the kernel …
    for key in ["Space", *"xcvzbddqefm", "Enter", "Delete", "0", "0", "3"]:
        page.keyboard.press(key)
    until(before + 10)
    assert one.cells() == cells, "keys are no shortcuts of the notebook's"
    assert page.locator("dialog").count() == 0
    rows, verified, last, _ = one.asked(1)  # in mid-run
    assert (int(rows) > before, verified) == (True, "True")
    assert name != "team" or last == "3"
    one.asked(2)  # a kernel that is busy
    until(int(rows) + 10)
    page.evaluate("jupyterapp.commands.execute('kernelmenu:restart'); 0")
    page.click("dialog button.jp-mod-accept")
    page.wait_for_timeout(3000)
    page.evaluate(f"{RUNS}.forEach((part) => delete part.run)")
    one.run(0)
    page.click("text=Start driving", timeout=60_000)
    until(int(rows) + 5)  # it has begun
    until(page.evaluate(HAVE) + 5)  # and was commanded, which is when a pause is over
    more, verified, _, pauses = one.asked(1)
    assert (int(more) > int(rows), verified) == (True, "True"), "the run goes on where it was"
    assert "begun again" in pauses
    assert one.faults == []
    page.close()
