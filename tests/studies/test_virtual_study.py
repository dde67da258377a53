"""
Virtual studies: populations beside the printed tables, studies on all testbeds beside their runs
one by one, folders read again.
"""

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal
from scipy import special, stats

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import approx, parametrize
from trustlab.allocation.limits import threshold_limits
from trustlab.campaign import CampaignError, CampaignWarning
from trustlab.operators.ground_robot import person_of
from trustlab.testbeds import GroundRobot, OperatorPopulation, UavTracking
from trustlab.testbeds.populations import COORDINATES, person_at

# Sessions are short here, and people few.
pytestmark = [
    pytest.mark.filterwarnings("ignore:nobody (may switch|switched):UserWarning"),
    pytest.mark.filterwarnings("ignore:participants. 3 do not fill:UserWarning"),
]

PUBLISHED = OperatorPopulation.ground_robot()
CONDITIONS = ["C1", "C2", "C3", "C4", "C5"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Ten simulated operators, two laps, written to a folder."""
    folder = tmp_path_factory.mktemp("virtual") / "study"
    return tl.virtual_study(n=10, seed=3, laps=2, out=folder)


ASSUMED = {"attention_cost": 0.1, "load_utilization": 0.5, "load_switching": 0.1}
UAV = {"testbed": "uav_following"}


def follow(n, seed, **more):
    return tl.virtual_study(n, CONDITIONS, seed, **UAV, **more)


@pytest.fixture(scope="module")
def following():
    return follow(10, 0, assumptions=ASSUMED)


@pytest.fixture(scope="module")
def tracking():
    schemes = ["TMIG", "M", "MI", "OMI"]
    return tl.virtual_study(n=4, conditions=schemes, seed=2, testbed=UavTracking(duration=4.0))


# --- populations ----------------------------------------------------------------------------------


def test_the_published_population_has_the_printed_means_and_spreads():
    table = tl.published_table("2.1").astype(float).T
    expected = {
        "a_r": -np.log(1.0 - table["a_r"]),
        "beta": special.logit(table["beta"]),
        "p_h_min": table["P_h_min"],
        "p_h_max": np.log(table["P_h_max"] - table["P_h_min"]),
        "a_pr": -np.log(1.0 - table["a_pr"]),
        "p_r_max": np.log(table["P_r_max"] - table["P_r_min"]),
        "lower": tl.published_table("2.3").loc[("TSC_l", "mean")].astype(float),
    }
    names = [coordinate.quantity for coordinate in COORDINATES["ground_robot"]]
    spread = np.sqrt(np.diag(PUBLISHED.covariance))
    for name, values in expected.items():
        found = [numbers[names.index(name)] for numbers in (PUBLISHED.mean, spread)]
        assert found == approx([values.mean(), values.std()], rel=1e-9)
    assert PUBLISHED.follow[0] == approx([0.7857, 0.2945])


def test_thresholds_of_the_second_participant_are_at_their_place():
    limits = threshold_limits(tl.published_models()["2"], 0.0)
    places = [-limits.lower / (limits.upper - limits.lower), 0.35 / limits.upper]
    z = PUBLISHED.mean.copy()
    z[:3] = [-np.log(1 - 0.9995), special.logit(0.81), 0.365]
    z[3:6] = [np.log(0.407 - 0.365), -np.log(1 - 0.9953), np.log(0.35 - 0.24)]
    z[10:] = special.logit(places)
    values = person_at(z, "ground_robot", 0.24)
    assert values["p_h_max"] == approx(0.407)
    assert [values["tsc_l"], values["tsc_u"]] == approx([0.0, 0.35], abs=1e-12)


def test_draws_have_the_distribution_and_all_are_models():
    drawn = PUBLISHED.draw(2000, seed=1)
    assert (drawn["redrawn"] > 0).mean() < 0.05
    z = -np.log(1.0 - drawn["a_r"]) - PUBLISHED.mean[0]
    normal = stats.norm(scale=np.sqrt(PUBLISHED.covariance[0, 0]))
    assert stats.kstest(z, normal.cdf).pvalue > 0.01
    total = 0.7857 * 0.2143 / 0.2945**2 - 1.0
    beta = stats.beta(0.7857 * total, 0.2143 * total)
    assert stats.kstest(drawn["follow_tsc"], beta.cdf).pvalue > 0.01
    for values in drawn.to_dict("records")[:200]:
        operator, model, (low, high) = PUBLISHED.person(values)
        limits = threshold_limits(model, 0.0)
        assert limits.lower < low < high < limits.upper
        assert operator.lower < operator.upper
    assert drawn.attrs["synthetic"] is True


# --- studies --------------------------------------------------------------------------------------


@parametrize("name", ["kept", "tracking"])
def test_measures_are_those_of_the_runs_one_by_one(name, request):
    study = request.getfixturevalue(name)
    seed, people = study.settings["seed"], len(study.participants)
    person = study.testbed.people(people, seed=seed).iloc[3].to_dict()
    seeds = np.random.SeedSequence(seed).spawn(people)[3].spawn(len(study.conditions))
    rows = study.measures.query("participant == 4").set_index("condition")
    for condition, stream in zip(sorted(study.conditions), seeds, strict=True):
        run = study.testbed.run(condition, person, stream)
        np.testing.assert_equal(rows.loc[condition, [*run.measures]].to_dict(), run.measures)
    assert study.analysis(study.testbed.measures[0]).n == people


def test_assumptions_and_answers_are_those_of_the_operator(following):
    """Oracle: `run_condition` with the operator's own parameters and what is assumed."""
    fourth = OperatorPopulation.uav_following().draw(10, seed=0).loc[3].to_dict()
    operator, model, _ = person_of(fourth)
    person = tl.Operator(**vars(operator) | ASSUMED)
    stream = np.random.SeedSequence(0).spawn(10)[3].spawn(5)[3]
    run = tl.run_condition("C4", person, model, **UAV, seed=stream)
    row = following.measures.query("participant == 4 and condition == 'C4'").iloc[0]
    np.testing.assert_equal(row[[*run.measures]].to_dict(), run.measures)
    assert {"tlx", "satisfaction", "trust", "followed_percent"} <= {*row.dropna().index}


def test_sessions_are_read_again_and_have_the_measures(kept):
    rows = kept.measures.set_index(["participant", "position", "condition"])["p_r"].to_dict()
    found = {}
    for session in tl.read_sessions(kept.folder / "sessions"):
        about = session.metadata
        found[about.participant, about.more["trial"], about.condition] = session["p_r"].mean()
        assert about.synthetic
        assert "simulated" in about.more["note"]
    assert found == rows
    assert (kept.folder / "about.txt").read_text().startswith("SIMULATED.")
    tables = {"measures": kept.measures, "participants": kept.participants}
    for name, frame in (tables | {"orders": kept.design.orders()}).items():
        again = pd.read_csv(kept.folder / f"{name}.csv")
        assert_frame_equal(again, frame, check_dtype=False, check_categorical=False)


def test_analyses_are_those_of_repeated_measures(kept):
    direct = tl.repeated_measures(kept.measures, "p_r", "condition", "participant")
    assert kept.analysis("p_r", ["C1", "C3"]).k == 2
    table = kept.table().set_index("measure")
    assert table.loc["p_r", ["F", "p"]].tolist() == [direct.F, direct.p_corrected]
    assert np.isnan(table.loc["laps", "F"])
    assert table.loc["laps", "note"].startswith("dv: the error variance is zero for condition (")
    assert [axis.get_ylabel() for axis in kept.plot("p_r")] == ["p_r"]
    assert table.loc["followed_percent", "conditions"] == "C2 C3"
    with refused("followed_percent has no values in C1; give"):
        kept.analysis("followed_percent")
    with refused("p_r has no values in C9; give"):
        kept.analysis("p_r", ["C1", "C9"])
    assert set(table.index) == set(kept.names)
    assert kept.table().attrs["origin"] == kept.analysis("p_r").origin == "simulated operators"


def test_rest_carries_utilization_over_by_2_5(tmp_path):
    bed = GroundRobot(laps=1, rest=120.0)
    study = tl.virtual_study(n=4, conditions=["C1", "C5"], seed=1, testbed=bed, out=tmp_path)
    logs = tl.read_sessions(tmp_path / "sessions")
    r = {(s.metadata.participant, s.metadata.more["trial"]): s["r"] for s in logs}
    for who, a in study.participants[["participant", "a_r"]].to_numpy():
        assert r[who, 1][0] == 0.0
        assert 0.0 < r[who, 2][0] == approx(r[who, 1][-1] * a**1200, rel=1e-12)
    assert "rest 120.0" in study.message


def test_same_seed_same_table_serial_or_parallel(following):
    again = follow(10, 0, assumptions=ASSUMED, n_jobs=2)
    assert_frame_equal(following.measures, again.measures, check_exact=True)


def test_half_a_square_is_said_to_be_unbalanced():
    said = "5 participants fill half of the last square.*10 participants would balance both"
    with pytest.warns(UserWarning, match=said):
        half = follow(5, 1)
    balance = tl.design_balance(half.design.orders())
    assert balance.message == "positions balanced, first-order carry-over not balanced"
    with pytest.warns(UserWarning, match="participants: 7 do not fill whole squares.*10 would do"):
        tl.latin_square_design(CONDITIONS, 7, whole_squares=False)


# --- failures and folders -------------------------------------------------------------------------


QUICK = {"n": 4, "conditions": ["C1", "C4"], "seed": 1, "laps": 1}


def test_a_participant_who_fails_is_listed_and_left_out(monkeypatch):
    whole = GroundRobot.run

    def failing(self, condition, person, seed):
        if person["participant"] == 2 and condition == "C4":
            raise ValueError("the joystick came off")
        return whole(self, condition, person, seed)

    monkeypatch.setattr(GroundRobot, "run", failing)
    with pytest.warns(CampaignWarning, match="condition 'C4': ValueError: the joystick came off"):
        study = tl.virtual_study(**QUICK)
    (failure,) = study.failures.to_dict("records")
    assert failure["participant"] == 2
    assert "joystick" in failure["error"]
    assert study.analysis("p_r").scores.index.tolist() == [1, 3, 4]
    assert "left out: 1 participant." in study.message


def test_people_of_a_testbed_are_numbered_from_one(monkeypatch):
    people = pd.DataFrame({"participant": range(10, 14)})
    monkeypatch.setattr(GroundRobot, "people", lambda *_: people)
    with refused("people of .* must be numbered from 1 to 4 in a column participant"):
        tl.virtual_study(**QUICK)


def test_orders_may_be_drawn_already():
    bed = UavTracking(duration=4.0)
    design = tl.latin_square_design(["MI", "M"], 4, seed=5)
    study = tl.virtual_study(design=design, testbed=bed, seed=2)
    positions = study.measures[["participant", "condition", "position"]]
    drawn = design.orders()[[*positions]]
    assert_frame_equal(positions, drawn, check_dtype=False, check_categorical=False)
    with refused("n and conditions have no effect beside a design"):
        tl.virtual_study(4, design=design)
    named = tl.latin_square_design(["M", "MI"], ["A", "B"])
    with refused("the number of participants, without names"):
        tl.virtual_study(design=named)


def test_a_study_goes_on_where_it_stopped_and_is_not_mixed_up(tmp_path):
    def state():
        files = [path for path in tmp_path.rglob("*") if path.is_file()]
        return {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in files}

    first = tl.virtual_study(**QUICK | {"laps": 1.0}, out=tmp_path)
    before = state()
    again = tl.virtual_study(**QUICK, out=tmp_path)
    assert_frame_equal(first.measures, again.measures)
    sessions = [path for path in before if path.parent.name == "sessions"]
    before, first = state(), before
    assert [before[path] for path in sessions] == [first[path] for path in sessions]
    for changes in ({"seed": 2}, {"conditions": ["C1", "C5"]}):
        with pytest.raises(CampaignError):
            tl.virtual_study(**QUICK | changes, out=tmp_path)
    for message, changes in {
        "not known to be of this study; give a new": {"out": tmp_path / "sessions"},
        "cannot write .*: Not a directory": {"out": tmp_path / "about.txt"},
        r"_00004_trial_2_C\d.parquet is of a study of more people": {"n": 3},
    }.items():
        with refused(message):
            tl.virtual_study(**QUICK | {"out": tmp_path} | changes)
    assert state() == before
    min(sessions).unlink()
    with refused(f"1 of {len(sessions)} sessions are missing"):
        tl.virtual_study(**QUICK, out=tmp_path)


def test_a_participant_is_joined_once(kept):
    others = kept.measures.assign(participant=kept.measures["participant"] + 100)
    joined = kept.joined(others)
    assert (len(joined.measures), joined.analysis("p_r").n) == (100, 20)
    with refused(r"participant 10\d is in the study already"):
        joined.joined(others.query("participant > 100"))
    with refused(r"condition must be one of 'C1', .*, got 'C9'"):
        kept.joined(others.assign(condition="C9"))


@parametrize(
    ("arguments", "message"),
    [
        ({"assumptions": {"atention_cost": 0.1}}, "did you mean 'attention_cost'"),
        ({"conditions": ["C1", ("C2", None)]}, "'C2' must be a name of its own"),
        ({"conditions": ["C1", ("in turns",)]}, r"a rule is a pair .*, got \('in turns',\)"),
        ({"conditions": {"C1", "C4"}}, "conditions must be a list of names"),
        ({"conditions": ["C1", "a/b"]}, "must be names without /, got .*'a/b'"),
    ],
)
def test_arguments_that_no_study_takes_are_refused(arguments, message):
    with refused(message):
        tl.virtual_study(**QUICK | arguments)


class Alternating:
    """A rule with a memory: every 200 calls it changes the mode, if TSC or P_r let it."""

    mode = 1

    def __init__(self, model=None):
        self.calls = 0
        self.lower = 0.0 if model is None else model.robot.p_min

    def step(self, *, tsc, p_r):
        self.calls += 1
        return int(self.calls // 200 % 2 == 0) if p_r > self.lower else None


def test_own_rules_beside_printed_conditions():
    """Oracle: `run_condition` with the same rule, operator and seed; each run has a new rule."""
    conditions = ["C1", "C3", ("in turns", Alternating)]
    study = tl.virtual_study(n=6, conditions=conditions, laps=2, seed=4)
    operator, model, _ = person_of(study.participants.iloc[2].to_dict())
    stream = np.random.SeedSequence(4).spawn(6)[2].spawn(3)[2]
    alone = tl.run_condition(
        participant=operator, model=model, rule=Alternating(model), laps=2, seed=stream
    )
    own = study.measures.query("condition == 'in turns'").set_index("participant")
    assert own.loc[3, [*alone.measures]].to_dict() == alone.measures
    assert (own["switches"] > 2).all()
    named = study.measures["condition"].unique()  # an array, as pandas gives it
    f, g = (study.analysis("p_r", names).F for names in (named, None))
    assert f == approx(g)
