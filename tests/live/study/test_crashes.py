"""
The server is killed with −9 at random moments and torn lines are planted: what was acknowledged is
there, once and in order.

Oracle: the client's own list of the rows it sent and of the acknowledgements it got.
"""

import json
import random
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from trustlab.live.log import read_log
from trustlab.live.study.plan import file_origin, read_tokens
from trustlab.live.trial import read_record, stepped
from trustlab.trust.dynamics import MODELS


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Server:
    """The server as a lab runs it, in a process of its own."""

    def __init__(self, folder):
        self.folder, self.port = folder, free_port()

    def start(self):
        command = [
            sys.executable,
            "-m",
            "trustlab.live.study",
            str(self.folder),
            "--port",
            str(self.port),
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert "experimenter's page" in self.process.stdout.readline()

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()


def plant_torn_line(path, rng):
    """
    Add the beginning of another line, as a machine that loses power in mid-write would leave it.
    """
    line = json.dumps(["0" * 16, {"commands": [[rng.random()] * 3] * 9, "at": 1.0, "seen": 0}])
    with path.open("a") as file:
        file.write(line[: rng.randrange(1, len(line))])


def steered(rng):
    """A command to the ground robot."""
    return [0.5 * rng.random(), rng.uniform(-0.5, 0.5), rng.randrange(2)]


def led(rng):
    """A command to a team."""
    return [rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), rng.randrange(1, 5)]


def connected(link, driving_page):
    """A page that has begun, as soon as the server is there."""
    for _ in range(200):
        with suppress(OSError):
            page = driving_page(link)
            return page, page.begin()["k"]
        time.sleep(0.05)
    raise TimeoutError(link)


def kills(plan, client, driving_page, count, seed, command):
    """
    Send commands as a browser does while the server is killed and started again; return those made
    and how many were acknowledged.
    """
    rng, server = random.Random(seed), Server(plan.folder)
    link = f"http://127.0.0.1:{server.port}/p/{read_tokens(plan.folder)['P01']}"
    folder = plan.folder / "P01"
    made = []
    killed = 0
    server.start()
    client(f"{link}/answers", {"page": 0, "answers": {"consent": True}})
    page, acknowledged = connected(link, driving_page)
    until = time.monotonic() + rng.uniform(0.05, 0.6)
    while killed < count or acknowledged < len(made):
        if killed < count:
            made += [command(rng) for _ in range(rng.randrange(1, 8))]
        message = {"k": acknowledged, "commands": made[acknowledged:], "seen": acknowledged}
        if killed < count and time.monotonic() > until:
            server.process.send_signal(signal.SIGKILL)  # not waited for: a message is under way
            with suppress(Exception):  # whatever a connection says that breaks
                acknowledged = max(acknowledged, page.say(**message).get("k", 0))
            server.kill()
            for torn in (folder / "01-training.jsonl", folder / "events.jsonl"):
                plant_torn_line(torn, rng)
            killed += 1
            server.start()
            page, there = connected(link, driving_page)
            assert there >= acknowledged  # nothing that was acknowledged is gone
            acknowledged = there
            until = time.monotonic() + rng.uniform(0.05, 0.6)
            continue
        acknowledged = page.say(**message)["k"]
        time.sleep(0.05)
    server.kill()
    return made, acknowledged


@pytest.mark.parametrize("count", [2, pytest.param(20, marks=pytest.mark.long)])
@pytest.mark.parametrize("command", [steered, led])
def test_kills_at_random_moments_lose_nothing(
    make_plan, make_team_plan, client, driving_page, command, count
):
    if command is steered:
        plan = make_plan(training=600.0)
    else:  # with a model of trust of another kind than the printed one
        trust = MODELS["asymmetric"]()
        plan = make_team_plan(training=300.0, rehearsal=False, trust=trust)
    made, acknowledged = kills(plan, client, driving_page, count, count, command)
    path = plan.folder / "P01" / "01-training.jsonl"
    record, _, fault = read_record(path, file_origin(plan.digest, "P01", path.stem))
    assert fault == ""
    assert record.commands == made
    assert acknowledged == len(made)
    task = plan.task
    rows = list(stepped(task.begin(record.settings), made))
    assert record.rows == rows[: len(record.rows)]
    assert len(record.rows) > 0
    assert record.fault(task) == ""
    events = read_log(
        plan.folder / "P01" / "events.jsonl", file_origin(plan.digest, "P01", "events")
    )
    assert events.fault == ""
    torn = [event["file"] for event in events.entries if event["kind"] == "torn"]
    assert torn.count("01-training.jsonl") == torn.count("events.jsonl") == count
    kinds = [event["kind"] for event in events.entries if event["kind"] != "torn"]
    assert kinds == ["page", "begin"]
    assert len(record.pauses) == count
