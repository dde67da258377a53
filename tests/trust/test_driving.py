"""Models of trust that drive loops and teams: their course on the performance that was logged."""

from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from tests.cases import graph
from trustlab import simulate_team, simulate_teleoperation
from trustlab.teleoperation import PartError, TeamRobot, TeamSettings, TeamTrial
from trustlab.trust import TrustInLoop
from trustlab.trust.driving import TrustCourse
from trustlab.trust.dynamics import MODELS

parametrize = pytest.mark.parametrize
approx = pytest.approx


@parametrize("name", ["asymmetric", "beta", "optimo"])
def test_trust_in_the_loop_is_the_models_on_the_loops_performance(name):
    model = MODELS[name]()
    driver = TrustInLoop(model, every=0.5, start=0.4)
    run = simulate_teleoperation("TMIG", trust=driver, seed=0, duration=4.0)
    trust, belief = run["trust_hr"], model.start(np.array([0.4]))
    trials = np.clip(run["p_r"], 0.0, 1.0)[:350].reshape(-1, 50).mean(axis=1)
    for p, found in zip(trials, trust[52::50], strict=False):
        belief = model.step(belief, tl.trust.Event(p_r=np.array([p])))
        expected = np.clip(model.rating(belief).mean[0], 0.0, 1.0)
        assert found == approx(expected, abs=0.02)
    assert np.ptp(trust) > 0.01


def test_loops_do_not_share_their_memory_and_a_bare_model_is_one_trial_a_second():
    model = MODELS["asymmetric"]()
    driver = TrustInLoop(model)
    first, again, bare, usual = (
        simulate_teleoperation("TMIG", trust=trust, seed=0, duration=2.5)
        for trust in (driver, driver, model, None)
    )
    assert first == again == bare
    assert bare != usual


TEAM = {"graph": graph(), "goal": (0.5, -1.0, 0.2), "seed": 4}
TEAM["trial"] = TeamTrial(0.01, record_every=0.01)


@parametrize("performance", ["motion", "random"])
def test_trust_in_a_team_is_the_models_on_each_robots_performance(performance):
    """(4.1) as a model is the team's own (4.1); a slower one is not."""
    robots = (TeamRobot(loss=1.0), *(TeamRobot(),) * 3)
    settings = TeamSettings(human_to_robot=tl.TrustModel(a=0.1, b=0.1), robots=robots)
    arguments = {"performance": performance, "settings": settings, "duration": 12.0} | TEAM
    models = (MODELS["performance"](a=rate, gain=1.0) for rate in (0.01, 0.002))
    same, slow = (
        simulate_team(trust=TrustInLoop(model, every=0.1), **arguments) for model in models
    )
    usual = simulate_team(**arguments)
    # Drawn performance has a drawn start, which is forgotten at the rate of (4.1).
    decision = np.floor(usual.t / 0.1 + 1e-6)[:, None]
    expected = usual.trust - (usual.trust[0] - 0.5) * np.exp(-0.01 * decision)
    assert_allclose(same.trust, expected, atol=1e-9)
    if performance == "motion":
        assert_allclose(same.positions, usual.positions, atol=1e-9)
    assert np.abs(slow.trust - expected).max() > 0.05
    assert (usual.facts["trust"], same.facts["trust"]) == ("(4.1)", "performance, (3.2)")


def test_a_team_stepped_is_the_team_run():
    options = {"trust": MODELS["beta"](), "duration": 3.0} | TEAM
    loop = tl.TeamLoop(**options)
    for _ in range(120):
        loop.step()
    run = loop.run()
    assert run.data.equals(simulate_team(**options).data)
    assert np.ptp(run.trust, axis=0).max() > 0.01


def test_a_trial_without_anything_to_judge_by_is_none():
    driver = TrustInLoop(MODELS["beta"](anchor=0.0), every=0.3, start=0.4)
    course = TrustCourse(driver, 0.1)
    shares = [course.step(p) for p in (np.nan, np.nan, np.nan, 1.0, np.nan, 0.5)]
    assert shares[:5] == [0.4] * 5
    assert shares[5] == approx((0.4 * 10.0 + 0.75) / 11.0, abs=1e-14)


@dataclass(frozen=True)
class Half(tl.trust.LinearTrust):
    """A model as a user writes one: trust goes half the way to the performance."""

    def transition(self, event):
        return 0.5, 0.5 * np.asarray(event.p_r)


def test_a_model_of_ones_own_drives_loops_and_teams():
    course = TrustCourse(TrustInLoop(Half(), every=0.1, start=0.2), 0.1)
    shares = [course.step(p) for p in (1.0, 0.0, 3.0, -9.0)]
    assert shares == approx([0.6, 0.3, 1.0, 0.0], abs=1e-14)
    ends = tl.TrustModel(a=0.1, b=0.1, p_min=0.2, p_max=0.6, t_min=1.0, t_max=3.0)
    part = TrustInLoop(Half(), every=0.1, start=0.2).part(ends, ends, 0.1)
    state = SimpleNamespace(p_r=0.4, p_h=0.4, trust_rh=2.0)
    assert part(state) == approx((1.7, 2.0))  # (.2 + .5)/2 of the range, and what does not change
    run = simulate_teleoperation("TMIG", trust=TrustInLoop(Half(), every=0.5), duration=2.0)
    team = simulate_team(graph(), trust=Half(), duration=3.0)
    for trust in (run["trust_hr"], team.trust):
        assert np.ptp(trust, axis=0).max() > 0.01
    assert team.facts["trust"] == "Half"


@parametrize("run", [simulate_teleoperation, partial(simulate_team, graph())])
@parametrize(
    ("fault", "words"),
    [
        ({"start": lambda self, rating: 1 / 0}, "0 s: ZeroDivisionError: division by zero"),
        ({"transition": lambda self, event: 1 / 0}, "1 s: ZeroDivisionError: division by zero"),
        ({"transition": lambda self, event: (np.nan, 0.0)}, "must be finite, got nan"),
        (  # of two people
            {"rating": lambda *_: tl.trust.BetaRating(np.ones(2), np.ones(2))},
            "must be a number, got array",
        ),
    ],
)
def test_a_model_that_fails_is_named_with_the_time(run, fault, words):
    with pytest.raises(PartError, match=f"the trust .*, at t = .*{words}"):
        run(trust=type("Faulty", (Half,), fault)(), duration=3.0)
