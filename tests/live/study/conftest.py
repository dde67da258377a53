"""A small study and its server."""

import warnings
from contextlib import contextmanager

import pytest

import trustlab as tl
from tests.live.cases import DrivingPage, ask, recorded, written
from trustlab.live.study.server import StudyServer

SHORT = {"laps": 1, "training": 10.0, "identification": [(1, 20.0), (0, 20.0)]}


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
