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
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import NotComparedError, Row, tail

# Scripted people without a browser, and for how long they send commands [s].
PEOPLE, SECONDS = 100, 20.0
# Scripted people at full rate beside one page in Chromium, and the length of its drive [s].
CLIENTS, DRIVE = 9, 30.0
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def rows() -> Iterator[Row]:
    """Yield how long commands take to be done and kept, and what a page beside others shows."""
    with Served(PEOPLE, SECONDS + 1.0) as served:
        waits, done = asyncio.run(everybody(list(served.links.values())))
        lost = done - sum(len(served.heard(code)) for code in served.links)
    work = f"Commands of {PEOPLE} people, five every .5 s each, until on the disk, done and told"
    yield tail(work, waits, 50.0, ", none lost", not lost, f"{done} commands, {lost} lost")
    periods, fps, delay = page_beside_others()
    work = f"A page that commands every 100 ms beside {CLIENTS} people, period of its log"
    note = f"{fps:.0f} frames/s; pictures {delay:.0f} ms late"
    yield tail(work, periods, 120.0, ", ≥ 58 frames/s", fps >= 58.0, note)


class Served:
    """A study served in a process of its own, as a lab serves it, from a temporary folder."""

    def __init__(self, participants: int, training: float):
        import trustlab as tl
        from trustlab.live.study.plan import read_tokens

        self.place = tempfile.TemporaryDirectory()
        self.folder = Path(self.place.name) / "study"
        with warnings.catch_warnings():
            # So many participants need not fill whole squares here.
            warnings.simplefilter("ignore", UserWarning)
            plan = tl.LiveStudy(
                self.folder, ["C1", "C3"], participants, training=training, whole_squares=False
            )
        command = [sys.executable, "-m", "trustlab.live.study", str(self.folder), "--port", "0"]
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


async def person(link: str, after: float, seconds: float, count: int) -> tuple[list[float], int]:
    """
    Send so many commands at once as often as their time has passed, as a page does; return the
    waits for answers [ms], and how many were acknowledged.
    """
    from tornado.httpclient import AsyncHTTPClient, HTTPRequest
    from tornado.websocket import websocket_connect

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
    while done < 10 * seconds:
        began = time.perf_counter()
        done = (await say(k=done, commands=[[0.3, 0.1, 1]] * count, seen=max(done - 2, 0)))["k"]
        waits.append(1e3 * (time.perf_counter() - began))
        due += 0.1 * count
        await asyncio.sleep(max(0.0, due - time.perf_counter()))
    return waits, done


async def everybody(links: list[str]) -> tuple[list[float], int]:
    """Let scripted people drive; return all waits [ms], and how many commands were acknowledged."""
    # All have begun before the first sends: beginning reads and writes more than a command.
    people = (person(link, 10.0 + 0.5 * i / len(links), SECONDS, 5) for i, link in enumerate(links))
    waits, done = zip(*await asyncio.gather(*people), strict=True)
    return [wait for each in waits for wait in each], sum(done)


async def others(links: list[str]) -> None:
    """Let scripted people drive at full rate for as long as the page does."""
    await asyncio.gather(*(person(link, 0.1, DRIVE + 5.0, 1) for link in links))


def page_beside_others() -> tuple[list[float], float, float]:
    """
    Drive in Chromium beside scripted people.

    Return the periods of the log [ms], frames per second, and how late pictures are shown [ms].
    """
    from playwright.sync_api import sync_playwright

    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise NotComparedError("there is no Chromium on this machine")
    options = {"executable_path": browser, "args": ["--no-sandbox", "--disable-gpu"]}
    with Served(CLIENTS + 1, DRIVE + 10.0) as served, sync_playwright() as playwright:
        (code, link), *rest = served.links.items()
        crowd = threading.Thread(target=lambda: asyncio.run(others([each for _, each in rest])))
        crowd.start()
        page = playwright.chromium.launch(**options).new_page(
            viewport={"width": 1000, "height": 760}
        )
        page.goto(link)
        page.click("input[type=checkbox]")
        page.click("form button")
        page.click("main > button")
        while page.evaluate("self.study.rows") < 20:  # pages evaluate no text of their own
            time.sleep(0.1)
        page.keyboard.down("ArrowUp")
        time.sleep(DRIVE)
        told = page.evaluate("self.study.run.telemetry()")
        page.close()
        crowd.join()
        periods = 1e3 * np.diff(np.unique(served.heard(code)))
    return periods.tolist(), told["fps"], float(told["delay"])
