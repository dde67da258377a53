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

import pytest

from trustlab.live.study.live_study import LiveStudy
from trustlab.live.study.store import read_tokens
from trustlab.live.tasks.task import ServedRun
from trustlab.trust.dynamics import MODELS

WIDTH = 15


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
    line = json.dumps(["0" * 16, [999, *[rng.random()] * (WIDTH + 1)]])
    with path.open("a") as file:
        file.write(line[: rng.randrange(1, len(line))])


def driven(rng):
    """A row of a drive, which the browser computes."""
    return [1, -1, *[0.4 * rng.random()] * (WIDTH - 2)]


def led(rng):
    """A command to a team, which the server computes."""
    return [rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), rng.randrange(1, 5)]


def kills(plan, client, count, seed, values):
    """
    Send rows as a browser does while the server is killed and started again; return rows made and
    acknowledged.
    """
    rng, server = random.Random(seed), Server(plan.folder)
    url = f"http://127.0.0.1:{server.port}/p/{read_tokens(plan.folder)['P01']}"
    about = {"page": 1, "attempt": 0, "tab": "a"}
    path = plan.folder / "P01" / "01-training.0.jsonl"
    made = []
    acknowledged = 0
    killed = 0
    server.start()
    client(f"{url}/answers", {"page": 0, "answers": {"consent": True}})
    assert client(f"{url}/begin", {"page": 1, "tab": "a"}).status == 200
    until = time.monotonic() + rng.uniform(0.05, 0.6)
    while killed < count or acknowledged < len(made):
        if killed < count:
            k = len(made)
            made += [[j, 100.0 * j, *values(rng)] for j in range(k, k + rng.randrange(1, 8))]
        if killed < count and time.monotonic() > until:
            server.process.send_signal(signal.SIGKILL)  # not waited for: a request may be under way
            answer = client(f"{url}/rows", about | {"rows": made[acknowledged:]})
            acknowledged = max(acknowledged, answer.json.get("have", 0))
            server.kill()
            for torn in (path, plan.folder / "P01" / "events.jsonl"):
                plant_torn_line(torn, rng)
            killed += 1
            server.start()
            until = time.monotonic() + rng.uniform(0.05, 0.6)
        answer = client(f"{url}/rows", about | {"rows": made[acknowledged : acknowledged + 600]})
        assert answer.status == 200, answer
        assert answer.json["have"] >= acknowledged  # nothing that was acknowledged is gone
        acknowledged = answer.json["have"]
        time.sleep(0.05)
    server.kill()
    return made, acknowledged, path


def entries(path):
    return [json.loads(line)[1] for line in path.read_text().splitlines()]


def check(plan, client, count, seed, values=driven):
    made, acknowledged, path = kills(plan, client, count, seed, values)
    header, *rows = entries(path)
    expected = made if values is driven else ServedRun(header["config"], []).complete(made)
    assert rows == expected
    assert acknowledged == len(made)
    assert set(header) == {"condition", "source", "why", "config"}
    events = entries(plan.folder / "P01" / "events.jsonl")
    torn = [event["file"] for event in events if event["kind"] == "torn"]
    assert torn.count("01-training.0.jsonl") >= count
    assert torn.count("events.jsonl") == count
    assert [event["kind"] for event in events if event["kind"] != "torn"] == ["page", "begin"]


def test_two_kills_lose_nothing(make_plan, client):
    check(make_plan(training=600.0), client, 2, seed=1)


def team_plan(folder):
    """A study of a team with a model of trust in Python, which the server computes."""
    conditions = ["by_hand", "suggested"]
    trust = MODELS["asymmetric"]()
    return LiveStudy(folder, conditions, 2, task="team", training=300.0, trust=trust)


def test_a_team_goes_on_bit_for_bit_after_a_kill(tmp_path, client):
    check(team_plan(tmp_path / "s"), client, 1, 3, led)


@pytest.mark.long
def test_a_team_goes_on_bit_for_bit_after_twenty_kills(tmp_path, client):
    check(team_plan(tmp_path / "s"), client, 20, 4, led)


@pytest.mark.long
def test_twenty_kills_at_random_moments_lose_nothing(make_plan, client):
    check(make_plan(training=600.0), client, 20, seed=2)
