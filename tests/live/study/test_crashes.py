"""
The server is killed with −9 at random moments and torn lines are planted: what was acknowledged is
there, once and in order.

Oracle: the client's own list of the rows it sent and of the acknowledgements it got.
"""

import random
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from tests.live.cases import DrivingPage, ask, commands_for, events, record, recorded
from trustlab.live.study.plan import drive_of, read_tokens
from trustlab.live.trial import stepped
from trustlab.trust.dynamics import MODELS


class Server:
    """The server as a lab runs it, in a process of its own."""

    def __init__(self, folder):
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        options = [str(folder), "--port", str(port)]
        self.command = [sys.executable, "-m", "trustlab.live.study", *options]
        self.link = f"http://127.0.0.1:{port}/p/{read_tokens(folder)['P01']}"

    def start(self):
        self.process = subprocess.Popen(self.command, stdout=subprocess.PIPE, text=True)
        assert "experimenter's page" in self.process.stdout.readline()

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


LINE = '["0000000000000000", {"commands": [[0.5, 0.25, 1]], "at": 1.0, "seen": 0}]'


def plant_torn_line(path, rng):
    """
    Add the beginning of another line, as a machine that loses power in mid-write would leave it.
    """
    with path.open("a") as file:
        file.write(LINE[: rng.randrange(1, len(LINE))])


def connected(link):
    """A page that has begun, as soon as the server is there."""
    for _ in range(200):
        with suppress(OSError):
            page = DrivingPage(link)
            return page, page.begin()["k"]
        time.sleep(0.05)
    raise TimeoutError(link)


def kills(plan, count):
    """
    Send commands as a browser does while the server is killed and started again; return those made,
    all of which were acknowledged in the end.
    """
    rng, server = random.Random(count), Server(plan.folder)
    all_commands = commands_for(drive_of(plan.content, "training"))
    made, killed = [], 0
    server.start()
    ask(f"{server.link}/answers", {"page": 0, "answers": {"consent": True}})
    page, acknowledged = connected(server.link)
    until = time.monotonic() + rng.uniform(0.05, 0.6)
    while killed < count or acknowledged < len(made):
        if killed < count:
            made = all_commands[: len(made) + rng.randrange(1, 8)]
        message = {"k": acknowledged, "commands": made[acknowledged:], "seen": acknowledged}
        if killed == count or time.monotonic() < until:
            acknowledged = page.say(**message)["k"]
            time.sleep(0.05)
            continue
        server.process.kill()  # not waited for: a message is under way
        with suppress(Exception):  # whatever a connection says that breaks
            acknowledged = max(acknowledged, page.say(**message).get("k", 0))
        server.kill()
        for torn in ("01-training.jsonl", "events.jsonl"):
            plant_torn_line(plan.folder / "P01" / torn, rng)
        killed += 1
        server.start()
        page, there = connected(server.link)
        assert there >= acknowledged  # nothing that was acknowledged is gone
        acknowledged = there
        until = time.monotonic() + rng.uniform(0.05, 0.6)
    server.kill()
    return made


@pytest.mark.parametrize("count", [2, pytest.param(20, marks=pytest.mark.long)])
@pytest.mark.parametrize("task", ["ground_robot", "team"])
def test_kills_at_random_moments_lose_nothing(make_plan, make_team_plan, task, count):
    if task == "team":  # with a model of trust of another kind than the printed one
        trust = MODELS["asymmetric"]()
        plan = make_team_plan(training=600.0, rehearsal=False, trust=trust)
    else:
        plan = make_plan(training=600.0)
    made = kills(plan, count)
    log = record(plan)
    assert log.commands == made
    rows = list(stepped(plan.task.begin(log.settings), made))
    assert log.rows == rows[: len(log.rows)] != []
    assert len(log.pauses) == count
    happened = events(plan)
    torn = [event["file"] for event in happened if event["kind"] == "torn"]
    assert torn.count("01-training.jsonl") == torn.count("events.jsonl") == count
    kinds = [event["kind"] for event in happened if event["kind"] != "torn"]
    assert kinds == ["page", "begin"]
    assert recorded(plan).faults().empty
