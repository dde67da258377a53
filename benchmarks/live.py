"""
A live study under load: commands of scripted people without a browser, and a page in Chromium
beside others.
"""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import NotComparedError, Row, tail

# Scripted people without a browser, and for how long they send commands [s].
PEOPLE, SECONDS = 100, 20.0
# Scripted people at full rate beside one page in Chromium, and the length of its run [s].
CLIENTS, RUN = 9, 30.0
# How late a slow disk is [s].
SLOW = 0.005
# Of each task: how long a command holds [s], a command, and what a study of it is set to; so many
# conditions fill whole squares.
TASKS = {
    "ground_robot": (0.1, [0.3, 0.1, 1], {}),
    "team": (0.05, [0.3, 0.1, 0], {"goals": 20, "conditions": ["by_hand", "hysteresis"]}),
}
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# Keeps in the page how long after each command the picture came that shows it [ms].
STOPWATCH = """const Socket = WebSocket, sent = [];
self.waits = [];
self.WebSocket = class extends Socket {
  constructor(...all) {
    super(...all);
    this.addEventListener("message", ({ data }) => {
      const { k } = JSON.parse(data);
      while (sent.length && sent[0][0] <= k) waits.push(performance.now() - sent.shift()[1]);
    });
  }
  send(text) {
    const { k, commands } = JSON.parse(text);
    if (commands) sent.push([k + commands.length, performance.now()]);
    super.send(text);
  }
};"""
SERVER = """import os, sys, time
sync = os.fsync
os.fsync = lambda handle: (time.sleep(float(sys.argv[1])), sync(handle))
from trustlab.live.study.__main__ import main
main(sys.argv[2:])"""


def rows() -> Iterator[Row]:
    """Yield how long commands take to be done and kept, and what a page beside others shows."""
    for people, task, count, slow, goal in (
        (PEOPLE, "ground_robot", 5, 0.0, 50.0),
        (CLIENTS + 1, "team", 1, SLOW, 60.0),
    ):
        with Served(task, people, SECONDS + 1.0, slow) as served:
            waits, done = asyncio.run(everybody(served, list(served.links), SECONDS, count))
            lost = done - sum(len(served.heard(code)) for code in served.links)
        work = f"Commands of {people} people, {count} every {served.period * count:g} s each"
        work += f", to a disk slower by {1e3 * slow:g} ms" if slow else ""
        note = f"{done} commands, {lost} lost"
        work += ", until kept, done and shown"
        yield tail(work, waits, goal, ", none lost", not lost, note)
    periods, waits, fps, delay = page_beside_others()
    work = f"A page that commands every 50 ms beside {CLIENTS} people, "
    note = f"{fps:.0f} frames/s"
    yield tail(work + "period of its log", periods, 60.0, ", ≥ 58 frames/s", fps >= 58.0, note)
    note = f"drawn with a delay of {delay:.0f} ms"
    yield tail(work + "from a command to its picture", waits, 60.0, note=note)


class Served:
    """A study, served in a process of its own from a temporary folder."""

    def __init__(self, task: str, participants: int, training: float, slow: float = 0.0):
        import trustlab as tl
        from trustlab.live.study.plan import read_tokens

        self.place = tempfile.TemporaryDirectory()
        self.folder = Path(self.place.name) / "study"
        self.period, self.command, settings = TASKS[task]
        settings = {"participants": participants, "task": task, "training": training, **settings}
        plan = tl.LiveStudy(self.folder, **settings)
        command = [sys.executable, "-c", SERVER, str(slow), str(self.folder), "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        base = self.process.stdout.readline().split()[-1].partition("/experimenter/")[0]
        tokens = read_tokens(self.folder)
        self.links = {code: f"{base}/p/{tokens[code]}" for code in plan.orders}

    def heard(self, code: str) -> list[float]:
        """Return when each command of a training drive reached the disk [s]."""
        lines = (self.folder / code / "01-training.jsonl").read_text().splitlines()
        entries = [json.loads(line)[1] for line in lines[1:]]
        return [entry["at"] for entry in entries for _ in entry.get("commands", ())]

    def __enter__(self) -> Served:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self.place.cleanup()


async def person(
    served: Served, code: str, after: float, seconds: float, count: int
) -> tuple[list[float], int]:
    """
    Send so many commands at once as often as their time has passed, as a page does; return the
    waits for answers [ms], and how many were acknowledged.
    """
    from tornado.httpclient import AsyncHTTPClient, HTTPRequest
    from tornado.websocket import websocket_connect

    link = served.links[code]
    commands = [served.command] * count
    origin = {"Origin": link.partition("/p/")[0]}
    headers = origin | {"Content-Type": "application/json"}
    consent = json.dumps({"page": 0, "answers": {"consent": True}})
    request = HTTPRequest(f"{link}/answers", "POST", body=consent, headers=headers)
    await AsyncHTTPClient().fetch(request, raise_error=False)
    socket = HTTPRequest(link.replace("http", "ws", 1) + "/drive/1", headers=origin)
    page = await websocket_connect(socket)

    async def say(**message: Any) -> dict[str, Any]:
        await page.write_message(json.dumps({"window": "a", **message}))
        return json.loads(await page.read_message())

    await say(begin=True)
    await asyncio.sleep(after)
    waits: list[float] = []
    done, due = 0, time.perf_counter()
    while served.period * done < seconds:
        began = time.perf_counter()
        done = (await say(k=done, commands=commands, seen=max(done - 2, 0)))["k"]
        waits.append(1e3 * (time.perf_counter() - began))
        due += served.period * count
        await asyncio.sleep(max(0.0, due - time.perf_counter()))
    return waits, done


async def everybody(
    served: Served, codes: list[str], seconds: float, count: int
) -> tuple[list[float], int]:
    """Let scripted people command; return all waits [ms], and how many commands were told done."""
    # All have begun before the first sends: beginning reads and writes more than a command.
    begun, shift = 0.1 * len(codes), served.period * count / len(codes)
    people = (person(served, c, begun + shift * i, seconds, count) for i, c in enumerate(codes))
    waits, done = zip(*await asyncio.gather(*people), strict=True)
    return [wait for each in waits for wait in each], sum(done)


def page_beside_others() -> tuple[list[float], list[float], float, float]:
    """
    Lead in Chromium beside scripted people.

    Return the periods of the log [ms], how long after each command its picture came [ms], frames
    per second, and with which delay pictures are drawn [ms].
    """
    from playwright.sync_api import sync_playwright

    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise NotComparedError("there is no Chromium on this machine")
    options = {"executable_path": browser, "args": ["--no-sandbox", "--disable-gpu"]}
    with Served("team", CLIENTS + 1, RUN + 15.0) as served, sync_playwright() as playwright:
        code, *rest = served.links
        others = everybody(served, rest, RUN + 10.0, 1)
        crowd = threading.Thread(target=lambda: asyncio.run(others))
        crowd.start()
        page = playwright.chromium.launch(**options).new_page(
            viewport={"width": 1000, "height": 760}
        )
        page.add_init_script(STOPWATCH)
        page.goto(served.links[code])
        page.click("input[type=checkbox]")
        page.click("form button")
        page.click("main > button")
        while page.evaluate("self.study.rows") < 20:  # pages evaluate no text of their own
            time.sleep(0.1)
        box = page.locator("canvas.pad").bounding_box()
        page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.4 * box["height"])
        time.sleep(RUN)
        told = page.evaluate("self.study.run.telemetry()")
        waits = page.evaluate("self.waits")
        page.close()
        crowd.join()
        periods = 1e3 * np.diff(np.unique(served.heard(code)))
    return periods.tolist(), waits, told["fps"], float(told["delay"])
