"""
Runs of the three tasks for tests, what the files of a study say, and a client that asks as a
browser does, or as one should not.
"""

import json
from contextlib import closing
from http.client import HTTPConnection
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest

import trustlab as tl
from trustlab.live.study.plan import file_origin
from trustlab.live.task import task_named
from trustlab.live.trial import read_record

# --- runs -----------------------------------------------------------------------------------------


CHOSEN = {"ground_robot": "training", "team": "suggested", "teleoperation": "MMI"}


def configured(name, condition="", **settings):
    """The settings of a run as a log holds them; without a condition one in which all is chosen."""
    task = task_named(name)
    short = {"training": 8.0} if name == "ground_robot" else {"duration": 4.0}
    content = task.settings(**settings or short).as_json()
    return json.loads(json.dumps(task.config(content, condition or CHOSEN[name], 3)))


def commands_for(config, hold=1):
    """Random commands of a whole run, each for so many periods."""
    rng = np.random.default_rng(0)
    low, high = np.array([config["limits"][name] for name in config["commands"]]).T
    drawn = rng.uniform(low, high, (config["samples"] // hold + 1, len(low)))
    if config["commands"][-1] != "alpha_choice":
        drawn[:, -1] = np.round(drawn[:, -1])
    return np.repeat(drawn, hold, axis=0)[: config["samples"]].tolist()


def stepped(config, commands):
    """The rows of a run by these commands, without a log."""
    run = task_named(config["live_task"]).begin(config)
    return np.array([run.step(*command) for command in commands if not run.done])


def session_of(config, commands):
    return task_named(config["live_task"]).session(config, stepped(config, commands))


# --- files ----------------------------------------------------------------------------------------


def written(folder, pages):
    """A file of pages in a folder."""
    path = folder / "pages.toml"
    path.write_text(pages, encoding="utf-8")
    return path


def recorded(plan):
    """What a study has recorded so far."""
    return tl.read_live_study(plan.folder)


def record(plan, code="P01", name="01-training"):
    """What the log of a drive says."""
    origin = file_origin(plan.digest, code, name)
    return read_record(plan.folder / code / f"{name}.jsonl", origin)[0]


def entries(path):
    """The entries of a log, without the digests before them."""
    return [json.loads(line)[1] for line in path.read_text().splitlines()]


def events(plan, code="P01"):
    path = plan.folder / code / "events.jsonl"
    return entries(path) if path.exists() else []


def advance(participant, name):
    """Have every page before the first of this name done; return that page's number."""
    page = next(step.index for step in participant.steps if step.page.name == name)
    for index in set(range(page)) - set(participant.progress.done):
        participant.add("page", page=index, name="x", attempt=0, link="")
    return page


# --- a browser ------------------------------------------------------------------------------------


def ask(url, body=None, path=None, **headers):
    """
    One request, as a page of the study would send it but for what is given; returns status, headers
    and JSON or bytes.
    """
    place = urlsplit(url)
    data = None if body is None else json.dumps(body)
    own = {"Content-Type": "application/json", "Origin": f"http://{place.netloc}"} if data else {}
    sent = {name: value for name, value in (own | headers).items() if value}
    with closing(HTTPConnection(place.netloc, timeout=60)) as link:
        link.request("POST" if data else "GET", path or place.path, data, sent)
        answer = link.getresponse()
        content = answer.read()
    given = json.loads(content) if "json" in answer.headers["Content-Type"] else {}
    return SimpleNamespace(
        status=answer.status, headers=answer.headers, content=content, json=given
    )


class DrivingPage:
    """A page that drives over a WebSocket; `origin` and `host` as a browser would say them."""

    def __init__(self, link, page=1, window="a", **options):
        websocket = pytest.importorskip("websocket")
        place = urlsplit(link)
        url = f"ws://{place.netloc}{place.path}/drive/{page}"
        options = {"origin": f"http://{place.netloc}", "timeout": 60} | options
        self.window, self.socket = window, websocket.create_connection(url, **options)

    def send(self, **message):
        self.socket.send(json.dumps({"window": self.window} | message))

    def hear(self):
        return json.loads(self.socket.recv())

    def say(self, **message):
        """Send a message, and return its answer."""
        self.send(**message)
        return self.hear()

    def begin(self):
        return self.say(begin=True)

    def drive(self, k, count, command=(0.3, 0.1, 1)):
        return self.say(k=k, commands=[command] * count, seen=max(k - 2, 0))
