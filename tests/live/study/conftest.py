"""A small study, its server, and a client that asks as a browser does, or as one should not."""

import json
import warnings
from contextlib import closing, contextmanager
from http.client import HTTPConnection
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

import trustlab as tl
from tests.live.cases import recorded, written
from trustlab.live.study.server import StudyServer

SHORT = {"laps": 1, "training": 10.0, "identification": [(1, 20.0), (0, 20.0)]}


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


@pytest.fixture(scope="session")
def driving_page():
    return DrivingPage


@pytest.fixture
def make_plan(tmp_path):
    """
    A function that plans a small study, with pages of one's own: two conditions, three
    participants, short drives.
    """

    def make(conditions=("C1", "C3"), participants=3, pages="", short=SHORT, **options):
        options = {"whole_squares": False, "pages": written(tmp_path, pages), **short, **options}
        with warnings.catch_warnings(action="ignore"):
            return tl.LiveStudy(tmp_path / "mystudy", list(conditions), participants, **options)

    return make


@pytest.fixture
def make_team_plan(make_plan):
    """A function that plans a rehearsal: two conditions, teams that are led for two seconds."""

    def make(participants=2, **options):
        conditions = ["by_hand", "most_trusted"]
        short = {"duration": 2.0, "training": 1.0, "rehearsal": True, "task": "team"}
        return make_plan(conditions, participants, short=short, **options)

    return make


class Served:
    """A study that is being served, and what its people and the experimenter ask."""

    def __init__(self, plan, server):
        self.plan, self.server = plan, server
        self.base, self.links = server.base, server.links()
        self.link = self.links.get("P01")

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

    @property
    def study(self):
        return recorded(self.plan)


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
