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

import numpy as np
import pytest

import trustlab as tl
from trustlab.live.hand import IdealHand, scripted_drive
from trustlab.live.runs import drive_config, replay
from trustlab.live.tasks.task import task_named

pytestmark = pytest.mark.long
pytest.importorskip("jupyterlab", reason="JupyterLab is not installed")
pytest.importorskip("notebook", reason="Notebook 7 is not installed")

DRIVE = """import trustlab as tl
live = tl.LiveGroundRobot("C1", model=tl.published_models()["2"], laps=1)
live"""
ASK = """import time
session = live.session
fastest = session["v_command"].max()
pauses = session.metadata.more["pauses"]
print("asked", len(session), live.verified, fastest, pauses, time.time(), "end")"""
FLY = """import trustlab as tl
live = tl.LiveTracking("TMIG", seed=0, task=tl.TrackingTask(view=1.0))
live"""
ASK_FLIGHT = """session = live.session
notes = session.metadata.more["notes"]
print("asked", len(session), live.verified, session["hand_x"].max(), notes, "end")"""
LEAD = """import trustlab as tl
from trustlab.live import LeadingSettings
live = tl.LiveTeam("by_hand", LeadingSettings(duration=60.0), seed=1)
live"""
ASK_LED = """session = live.session
chosen = int(session["leader_choice"][-1])
print("asked", len(session), live.verified, chosen, session.metadata.more["pauses"], "end")"""
LED = "(document.querySelector('.tl-track')?.driving?.now?.t ?? -1)"
CELL = """async (i) => {
  const notebook = jupyterapp.shell.currentWidget.content, cell = notebook.widgets[i];
  notebook.activeCellIndex = i;
  cell.model.executionCount = null;
  await jupyterapp.commands.execute("notebook:run-cell");
  return cell.model.executionCount !== null;
}"""
FLOWN = "(document.querySelector('.tl-track')?.drawn?.now.t ?? -1)"
MADE = "document.querySelector('.tl-drive')?.driving?.physics.k ?? -1"


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """
    Compile, here and once, what the notebooks' kernels will find on disk: on a fresh machine it
    takes longer than a page waits.
    """
    live = tl.LiveTracking("TMIG", seed=0, task=tl.TrackingTask(view=1.0))
    for k in range(3):
        live.hear({"hand": [0.1, 0.0], "time": k / 30})
    assert live.verified
    task = task_named("team")
    leading = task.config(task.settings(duration=1.0).as_json(), "by_hand", {}, 1)
    assert len(task.scripted_rows(leading, np.random.default_rng(0))) == 20
    config = drive_config("C1", tl.published_models()["2"], laps=1)
    assert replay(config, scripted_drive(config, IdealHand(config))[0][:20]) is True


@pytest.fixture(scope="module", params=["lab", "notebook"])
def lab(request, compiled, tmp_path_factory):
    """The application's name and address, and its folder."""
    home = tmp_path_factory.mktemp(request.param)
    own = {f"JUPYTER_{name}_DIR": str(home / name) for name in ("CONFIG", "DATA", "RUNTIME")}
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
        notebook = {
            "nbformat": 4,
            "nbformat_minor": 5,
            "metadata": {"kernelspec": {"name": "python3", "display_name": "Python 3"}},
        }
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


def test_a_drive_in_jupyterlab(browser, lab):
    one = Opened(browser, lab, "drive", [DRIVE, ASK])
    page = one.page

    def start():
        one.run(0)
        page.click("text=Start driving", timeout=60_000)
        page.wait_for_function(f"{MADE} >= 0")

    def row():
        return page.evaluate(
            "[0, 9, 10].map((i) => document.querySelector('.tl-drive').driving.row[i])"
        )

    start()
    seen = []
    for key, slot, sign in (
        ("ArrowUp", 1, 1),
        ("KeyW", 1, 1),
        ("ArrowLeft", 2, 1),
        ("KeyA", 2, 1),
        ("ArrowRight", 2, -1),
        ("KeyD", 2, -1),
    ):
        page.keyboard.down(key)
        page.wait_for_timeout(700)
        seen.append(sign * row()[slot] > 0.0)
        page.keyboard.up(key)
        page.wait_for_timeout(300)
    assert all(seen), "keys are the driver's"
    cells, place = (
        one.cells(),
        page.evaluate("document.querySelector('.tl-drive').getBoundingClientRect().top"),
    )
    for key in (
        "Space",
        "KeyS",
        "ArrowDown",
        "x",
        "c",
        "v",
        "z",
        "b",
        "d",
        "d",
        "q",
        "e",
        "f",
        "m",
        "Enter",
        "Delete",
        "0",
        "0",
    ):
        page.keyboard.press(
            key
        )  # in a notebook: scroll, cut the cell, undo, delete it, restart the kernel …
    page.wait_for_timeout(300)
    assert one.cells() == cells
    assert page.locator("dialog").count() == 0
    assert page.evaluate("document.querySelector('.tl-drive').getBoundingClientRect().top") == place
    page.keyboard.down("ArrowUp")
    for _ in range(20):  # as a key repeats that is held
        page.keyboard.down("ArrowUp")
        page.wait_for_timeout(50)
    made = page.evaluate(MADE)
    rows, verified, fastest, _ = one.asked(1)  # in mid-run
    assert int(rows) >= made - 10
    assert (verified, fastest) == ("True", "0.5")
    page.wait_for_timeout(500)
    assert page.evaluate(MADE) > made
    assert row()[1] == 0.0, "who works in another cell lets go of the keys"
    assert "focus lost" in one.asked(1)[3]
    page.locator(".tl-drive canvas").first.click()
    page.keyboard.up("ArrowUp")
    page.keyboard.down("ArrowUp")
    page.evaluate("jupyterapp.commands.execute('kernelmenu:restart'); 0")
    page.click("dialog button.jp-mod-accept")
    page.wait_for_timeout(3000)
    made = page.evaluate(MADE)
    start()
    assert page.evaluate(MADE) >= made, "rows of the time without a kernel have come back"
    rows, verified, *_ = one.asked(1)
    assert int(rows) >= made
    assert verified == "True"
    telemetry = page.evaluate("document.querySelector('.tl-drive').driving.telemetry()")
    print(f"a drive in JupyterLab: {telemetry}")
    assert one.faults == []
    page.close()


def test_a_flight_in_jupyterlab(browser, lab):
    one = Opened(
        browser,
        lab,
        "flight",
        [FLY, ASK_FLIGHT, "import time; time.sleep(2.0); print('slept end')"],
    )
    page = one.page
    one.run(0)
    page.click(".tl-track button", timeout=60_000)
    box = page.locator(".tl-track canvas.pad").bounding_box()
    for i, share in enumerate((0.5, 0.6, 0.7, 0.75)):
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.4 * box["height"])
        page.wait_for_function(f"{FLOWN} > {0.5 * i + 0.5}")
    samples, verified, furthest, _ = one.asked(1)
    assert int(samples) > 100
    assert verified == "True"
    assert float(furthest) > 0.05
    one.asked(2)  # a kernel that is busy
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.wait_for_timeout(1000)
    before = int(one.asked(1)[0])
    assert before > int(samples)
    cells = one.cells()
    page.focus(".tl-track button")
    for key in ("x", "d", "d", "0", "0"):
        page.keyboard.press(key)
    page.wait_for_timeout(300)
    assert one.cells() == cells, "keys are no shortcuts of the notebook's"
    flown = page.evaluate(FLOWN)
    page.evaluate("jupyterapp.commands.execute('kernelmenu:restart'); 0")
    page.click("dialog button.jp-mod-accept")
    page.wait_for_function(
        "document.querySelector('.tl-track .status').textContent.includes('does not answer')"
    )
    one.run(0)
    page.wait_for_function("document.querySelector('.tl-track button').textContent === 'Start'")
    page.click(".tl-track button")
    page.wait_for_function(f"{FLOWN} > {flown} + 0.5")
    assert int(one.asked(1)[0]) > before, "the flight goes on where it was"
    page.click(".tl-track >> text=Stop")
    page.wait_for_function("document.querySelector('.tl-track button').disabled")
    _, verified, _, notes = one.asked(1)
    print(f"a flight in JupyterLab: {notes}")
    assert verified == "True"
    assert "taken up again by a new kernel" in notes
    assert "stopped by the person" in notes
    assert one.faults == []
    page.close()


def test_a_team_in_jupyterlab(browser, lab):
    one = Opened(browser, lab, "team", [LEAD, ASK_LED])
    page = one.page
    one.run(0)
    page.click("text=Start driving", timeout=60_000)
    page.wait_for_function(f"{LED} > 0.5", timeout=60_000)
    cells = one.cells()
    box = page.locator(".tl-track canvas.pad").bounding_box()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.4 * box["height"])
    for key in ("2", "x", "d", "d", "0", "0", "3"):  # in a notebook: a heading, cut, delete …
        page.keyboard.press(key)
    page.wait_for_function(f"{LED} > 2.0")
    assert one.cells() == cells
    rows, verified, chosen, _ = one.asked(1)
    assert int(rows) > 30
    assert (verified, chosen) == ("True", "3")
    page.evaluate("jupyterapp.commands.execute('kernelmenu:restart'); 0")
    page.click("dialog button.jp-mod-accept")
    page.wait_for_timeout(3000)
    one.run(0)
    page.click("text=Start driving", timeout=60_000)
    page.wait_for_function(f"{LED} > {int(rows) * 0.05} + 0.5", timeout=60_000)
    more, verified, *_ = one.asked(1)
    assert int(more) > int(rows), "the run goes on where it was"
    assert verified == "True"
    assert one.faults == []
    page.close()
