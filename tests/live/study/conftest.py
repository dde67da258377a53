"""A small study, its server, and a client that asks as a browser does, or as one should not."""

import http.client
import json
import warnings
from contextlib import contextmanager
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

import trustlab as tl
from trustlab.live.study.server import StudyServer

SHORT = {"laps": 1, "training": 10.0, "identification": [(1, 20.0), (0, 20.0)]}


def ask(url, body=None, *, host=None, path=None, **headers):
    """
    One request, as a page of the study would send it but for what is given; returns status, headers
    and JSON or bytes.
    """
    place = urlsplit(url)
    link = http.client.HTTPConnection(place.hostname, place.port, timeout=60)
    own, data = {"Host": host or place.netloc}, None
    if body is not None:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        own |= {"Content-Type": "application/json", "Origin": f"http://{place.netloc}"}
    own |= {name.replace("_", "-"): value for name, value in headers.items()}
    sent = {name: value for name, value in own.items() if value is not None}
    try:
        link.request("GET" if data is None else "POST", path or place.path, data, sent)
        answer = link.getresponse()
        content = answer.read()
    except (ConnectionError, http.client.HTTPException):
        return SimpleNamespace(status=0, headers={}, content=b"", json={})
    finally:
        link.close()
    json_sent = content and "json" in answer.headers.get("Content-Type", "")
    return SimpleNamespace(
        status=answer.status,
        headers=answer.headers,
        content=content,
        json=json.loads(content) if json_sent else {},
    )


@pytest.fixture(scope="session")
def client():
    return ask


class DrivingPage:
    """A page that drives over a WebSocket; `origin` and `host` as a browser would say them."""

    def __init__(self, link, page=1, window="a", **options):
        websocket = pytest.importorskip("websocket")
        place = urlsplit(link)
        url = f"ws://{place.netloc}{place.path}/drive/{page}"
        options = {"origin": f"http://{place.netloc}", "timeout": 60} | options
        self.window, self.socket = window, websocket.create_connection(url, **options)

    def say(self, **message):
        """Send a message, and return its answer."""
        self.socket.send(json.dumps({"window": self.window} | message))
        return json.loads(self.socket.recv())

    def begin(self):
        return self.say(begin=True)

    def drive(self, k, count, command=(0.3, 0.1, 1)):
        return self.say(k=k, commands=[list(command)] * count, seen=max(k - 2, 0))


@pytest.fixture(scope="session")
def driving_page():
    return DrivingPage


@pytest.fixture
def make_plan(tmp_path):
    """A function that plans a small study: two conditions, three participants, short drives."""

    def make(conditions=("C1", "C3"), participants=3, name="mystudy", **options):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            options = {"whole_squares": False, **SHORT, **options}
            return tl.LiveStudy(tmp_path / name, list(conditions), participants, **options)

    return make


@pytest.fixture
def make_team_plan(tmp_path):
    """A function that plans a rehearsal: two conditions, teams that are led for two seconds."""

    def make(participants=2, **options):
        conditions = ["by_hand", "most_trusted"]
        options = {"duration": 2.0, "training": 1.0, "rehearsal": True, **options}
        return tl.LiveStudy(tmp_path / "team", conditions, participants, task="team", **options)

    return make


class Served:
    """A study that is being served, and what its people and the experimenter ask."""

    def __init__(self, plan, server):
        self.plan, self.server = plan, server
        self.base, self.links = server.base, server.links()

    def state(self, code="P01"):
        return ask(f"{self.links[code]}/state")

    def consent(self, code="P01", **headers):
        answers = {"page": 0, "answers": {"consent": True}}
        return ask(f"{self.links[code]}/answers", answers, **headers)

    def withdraw(self, code="P01"):
        return ask(f"{self.links[code]}/withdraw", {})

    def act(self, action, **about):
        act = {"participant": "P01", "action": action}
        return ask(f"{self.server.experimenter}/act", act | about)

    def overview(self):
        return ask(f"{self.server.experimenter}/state").json


@pytest.fixture
def serving():
    """A function that serves a plan."""

    @contextmanager
    def begin(plan, *arguments, **options):
        with StudyServer(plan, *arguments, **options) as server:
            yield Served(plan, server)

    return begin


@pytest.fixture
def served(make_plan, serving):
    """A small study that is being served."""
    with serving(make_plan()) as study:
        yield study


@pytest.fixture
def page(served):
    """The first participant's page, which has consented and begun the training drive."""
    served.consent()
    begun = DrivingPage(served.links["P01"])
    assert begun.begin()["k"] == 0
    return begun
