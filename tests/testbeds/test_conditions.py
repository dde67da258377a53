"""Conditions of the ground robot and of UAV following, and their participants."""

from dataclasses import replace
from threading import Lock

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trustlab as tl
from tests.cases import driver, refused
from trustlab import run_condition
from trustlab.allocation.rules import performance_suggestion
from trustlab.models.tsc import threshold_mode
from trustlab.testbeds import GroundRobot, OperatorPopulation, published_operator
from trustlab.testbeds.deciding import CONDITIONS, SETTLING
from trustlab.testbeds.ground_robot.kernel import drive_modes
from trustlab.testbeds.populations import printed_person
from trustlab.testbeds.uav_following import DURATION, E_MAX, U_MAX

# --- conditions -----------------------------------------------------------------------------------


FLIGHT = {"measure": "uav_tracking", "e_max": E_MAX, "u_max": U_MAX, "axes": "xy"}
# How performance is measured, and at which performances a rule switches, beginning in which mode.
BEDS = {"ground_robot": ({}, 0.28, 0.32, 1), "uav_following": (FLIGHT, 0.45, 0.52, 0)}
each_bed = pytest.mark.parametrize("bed", BEDS)
each_condition = pytest.mark.parametrize("condition", CONDITIONS)


@each_bed
@each_condition
def test_log_suggestions_and_measures_agree_with_models_and_rules(bed, condition):
    run = run_condition(condition, participant=2, testbed=bed, seed=0)
    session, model, measures = run.session, run.model, run.measures
    assert session.metadata.synthetic
    used = model.human.simulate(session["mode"])[0]
    assert_allclose(session["r"], used, atol=1e-12)
    again = session.with_performance(window=100.0, **BEDS[bed][0])
    for name in ("p_r", "p_h"):
        assert_allclose(session[name], again[name], atol=1e-11)
    tsc = model.value(session["p_r"], session["p_h"])
    assert_allclose(session["tsc"], tsc, atol=1e-12)
    apart = [session[f"reference_{axis}"] - session[f"robot_{axis}"] for axis in "xy"]
    assert_allclose(session["path_error"], np.hypot(*apart), atol=1e-12)

    algorithm, forced = CONDITIONS[condition]
    expected, now = np.full(len(session), -1.0), 1
    for k in np.flatnonzero(session.t >= SETTLING):
        if algorithm == 2:
            expected[k] = now = threshold_mode(session["tsc"][k], *run.thresholds, now)
        elif algorithm == 3:
            bounds = model.robot.p_min, model.robot.p_max
            expected[k] = performance_suggestion(session["p_r"][k], *bounds)
    assert_array_equal(session["suggested_mode"], expected)
    if bed == "ground_robot" and condition != "C1":
        assert {0.0, 1.0} <= set(expected)
    if forced:
        assert set(run.suggestions()["state"]) <= {"followed", "open", "withdrawn"}

    assert measures["p_r"] == session["p_r"].mean()
    assert measures["switches"] == np.abs(np.diff(session["mode"])).sum()
    assert np.isnan(measures["followed_percent"]) == (condition == "C1")
    if bed == "uav_following":
        assert len(session) == 10 * DURATION
    else:
        laps = np.diff(run.lap_times, prepend=0.0)
        assert measures["laps"] == laps.size == 8
        assert measures["duration"] == pytest.approx(run.lap_times[-1])
        assert measures["lap_time"] == pytest.approx(laps.mean())


@pytest.mark.parametrize("load", [{"load_utilization": 0.5}, {"load_switching": 0.1}, {}])
def test_who_feels_a_load_answers(load):
    run = run_condition("C1", replace(driver(), **load), tl.published_models()["2"], laps=2)
    assert ("tlx" in run.measures) == bool(load)


@each_condition
def test_run_condition_as_typed(operators, condition):
    thresholds = printed_person("2")[2] if condition in ("C2", "C3") else None
    run, named, typed = (
        run_condition(condition, *who, laps=2, seed=7)
        for who in ([2], ["2"], [published_operator("2"), operators["2"], thresholds])
    )
    assert run.session == named.session == typed.session
    assert run.thresholds == thresholds


def test_a_run_that_ends_before_anybody_may_switch_is_warned_of():
    with pytest.warns(UserWarning, match="no run lasts longer than 92 s"):
        run_condition("C1", 2, laps=1)


# Rules of one's own


class Relay:
    def __init__(self, low, high, mode):
        self.low, self.high, self.mode = low, high, mode
        self.calls = 0

    def step(self, *, tsc, p_r):
        Relay.last = self  # the run's own copy
        self.calls += 1
        return 1 if p_r < self.low else 0 if p_r > self.high else None


@each_bed
def test_a_rule_decides_from_what_is_measured(bed):
    _, low, high, first = BEDS[bed]
    rule = Relay(low, high, first)
    run = run_condition(rule=rule, participant=2, testbed=bed, seed=3)
    log, now = run.session, first
    decides = log.t > SETTLING - 0.05
    modes = []
    for p_r, decided in zip(log["p_r"], decides, strict=True):
        if decided:
            now = 1 if p_r < low else 0 if p_r > high else now
        modes.append(now)
    assert_array_equal(log["mode"], modes)
    assert Relay.last.calls == decides.sum()
    assert rule.calls == 0
    assert np.count_nonzero(np.diff(modes)) >= 2
    assert log.metadata.condition == "rule Relay"
    assert run.measures["followed_percent"] == 100.0
    if bed == "ground_robot":  # these modes, driven as given, give the same log
        again = drive_modes(np.array(modes), published_operator(2), seed=3)
        for name in ("p_r", "p_h", "r", "path_error", "robot_x", "yaw"):
            assert_array_equal(again[name], log[name])


class Late:
    def step(self, tsc, p_r):
        raise RuntimeError("out of data")


class Locked(Late):
    def __init__(self):
        self.lock = Lock()


@pytest.mark.parametrize(
    ("rule", "more", "words"),
    [
        (Late(), {}, "rule.step failed at t = 100.0 s, with TSC = .*RuntimeError: out of data"),
        (Locked(), {}, "rule must be one that copy.deepcopy can copy.*cannot pickle"),
        (Late(), {"condition": "C3"}, "no effect beside rule="),
    ],
)
def test_rules_that_fail_say_when(rule, more, words):
    with refused(words):
        run_condition(rule=rule, participant=2, **more)


# --- participants ---------------------------------------------------------------------------------


PEOPLE = "12345"


@pytest.mark.parametrize("name", PEOPLE)
def test_operators_are_what_the_tables_print(operators, name):
    who, model, thresholds = printed_person(name)
    own, shares, pair = (
        tl.published_table(number)[name].astype(float) for number in ("2.3", "2.6", "2.2")
    )
    assert who.participant == name
    assert who.human == operators[name].human == model.human
    assert [who.lower, who.lower_spread, who.upper, who.upper_spread] == own.tolist()
    followed = 100.0 * who.follow_tsc, 100.0 * who.follow_performance
    assert followed == pytest.approx((shares["C2"], shares["C4"]))
    assert thresholds == (pair["TSC_l"], pair["TSC_u"])


@pytest.mark.parametrize("name", ["pilot", *PEOPLE])
def test_performance_under_manual_control_is_the_models(operators, name):
    """
    Oracle: (2.6) and the steady state of (2.3); a hand that drove equally well for all missed P_r
    by up to 0.03.
    """
    model, who = operators[name], published_operator(name)
    runs = [
        drive_modes(np.ones(4000, int), who, seed, r0=0.8 * model.human.beta) for seed in range(4)
    ]
    r, p_h, p_r = (np.array([run[name][2000:] for run in runs]) for name in ("r", "p_h", "p_r"))
    skill = model.human.performance(r).mean()
    assert p_h.mean() == pytest.approx(skill, abs=0.007)
    assert p_r.mean() == pytest.approx(model.robot.steady_state(1.0, skill), abs=0.009)


@pytest.mark.parametrize("name", "1245")
def test_captured_thresholds_lie_one_reaction_beyond_the_operators_own(name):
    """
    Oracle: own thresholds, and how far TSC runs on in the reaction; before the window was full it
    was far too high.
    """
    who = published_operator(name)
    runs = [run_condition("C1", name, seed=seed, r0=0.5).session for seed in range(6)]
    found = tl.estimate_thresholds(runs)
    assert found.distinguishable
    assert -0.14 < found.lower - who.lower < 0.0
    assert -0.05 < found.upper - who.upper < 0.1


# --- UAV following --------------------------------------------------------------------------------


FOLLOWERS = [
    OperatorPopulation.person(row)
    for row in OperatorPopulation.uav_following().draw(12, seed=1).to_dict("records")
]


def test_ranges_of_performance_are_of_the_size_of_the_printed_means():
    table = OperatorPopulation.uav_following().draw(200, seed=0)[["p_h_max", "p_r_max"]]
    assert_allclose(table.agg(["mean", "std"]), [[0.86, 0.62], [0.04, 0.05]], atol=0.01)


def flown(operator, model, mode, seed):
    """A flight in one mode after the first 100 s by hand: own thresholds that no TSC meets."""
    lower = 8.0 if mode else -9.0
    fixed = {"lower": lower, "upper": lower + 1.0, "lower_spread": 0.0, "upper_spread": 0.0}
    who = replace(operator, reaction_lag=0.0, **fixed)
    session = run_condition("C1", who, model, testbed="uav_following", seed=seed).session
    assert (session["mode"][1001:] == mode).all()
    return session


def test_hands_are_as_good_as_their_model_says():
    short, late = [], slice(1000, None)
    for who, model, _ in FOLLOWERS:
        for seed in range(2):
            session = flown(replace(who, r0=who.human.beta), model, 1.0, seed)
            skill = who.human.performance(session["r"])[late].mean()
            missed = sum(np.abs(session[f"u_i_{a}"] - session[f"u_h_{a}"]) for a in "xy")[late]
            assert 1.0 - missed.mean() / U_MAX == pytest.approx(skill, abs=0.012)
            near = 1.0 - session["path_error"][late].mean() / E_MAX
            short.append(near - (who.robot_floor + who.robot_gain * skill))
    assert abs(np.mean(short)) < 0.06


def test_left_alone_the_autopilot_drifts_away():
    who, model, _ = FOLLOWERS[0]
    errors = [flown(who, model, 0.0, seed)["path_error"] for seed in range(40)]
    near = 1.0 - np.mean(errors, axis=0) / E_MAX
    course = [near[k : k + 300].mean() for k in (950, 1300, 1700)]
    assert course == sorted(course, reverse=True)
    assert near[2600:].mean() == pytest.approx(who.robot_floor, abs=0.08)


def test_who_makes_a_rule_is_given_the_model_only_where_an_argument_is_needed():
    """A default was overwritten by the model."""

    class Relay:
        def __init__(self, low=0.26):
            self.low = low

        def step(self, tsc, p_r):
            return int(p_r < self.low)

    person = GroundRobot().people(1, {}, 0).iloc[0].to_dict()
    bed = GroundRobot(rules={"relay": Relay, "of model": lambda tsc: Relay(tsc.robot.p_min)})
    assert bed.rule_of("relay", person).low == 0.26
    assert bed.rule_of("of model", person).low == person["p_r_min"] != 0.26


def test_rest_is_that_of_who_drove_not_of_the_model_behind_suggestions():
    bed = GroundRobot(laps=2, rest=10.0)
    tsc = tl.published_models()
    me = tl.Operator("me", replace(tsc["2"].human, a=0.99), delay=0.2)
    run = run_condition("C4", operator=me, model=tsc["2"], testbed=bed)
    rested = bed.next_session({"participant": "me"}, run)
    assert rested["r0"] == run.log["r"][-1] * 0.99**100
