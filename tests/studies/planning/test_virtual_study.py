"""
Virtual studies: populations beside the printed tables, studies beside their runs one by one,
folders read again.
"""

import json
import pickle

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from trustlab.allocation.limits import threshold_limits
from trustlab.campaign import CampaignError, CampaignWarning
from trustlab.operators.ground_robot import person_of
from trustlab.studies.planning import virtual_study as one_participant
from trustlab.testbeds import GroundRobot, OperatorPopulation, UavTracking
from trustlab.testbeds.populations import COORDINATES, person_at

PUBLISHED = OperatorPopulation.ground_robot()


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Ten simulated operators, two laps, written to a folder."""
    folder = tmp_path_factory.mktemp("virtual") / "study"
    return tl.virtual_study(n=10, seed=3, laps=2, out=folder)


# --- populations ----------------------------------------------------------------------------------


def test_the_published_population_has_the_printed_means_and_spreads():
    table = tl.published_table("2.1").astype(float)
    tau = 1.0 / (1.0 - table.loc["a_r"])
    rows = PUBLISHED.table().set_index("quantity")
    expected = {
        "ln tau_r": np.log(tau),
        "logit beta": np.log(table.loc["beta"] / (1 - table.loc["beta"])),
        "p_h_min": table.loc["P_h_min"],
        "ln (p_h_max - p_h_min)": np.log(table.loc["P_h_max"] - table.loc["P_h_min"]),
        "ln tau_pr": -np.log(1.0 - table.loc["a_pr"]),
        "ln (p_r_max - p_r_min)": np.log(table.loc["P_r_max"] - table.loc["P_r_min"]),
        "own lower": tl.published_table("2.3").loc[("TSC_l", "mean")].astype(float),
    }
    for name, values in expected.items():
        assert rows.loc[name, "mean"] == pytest.approx(values.mean(), rel=1e-12)
        assert rows.loc[name, "sd"] == pytest.approx(values.std(), rel=1e-9)
    assert list(rows.index) == [
        *(coordinate.name for coordinate in COORDINATES["ground_robot"]),
        "follow_tsc",
        "follow_performance",
    ]
    assert rows.loc["follow_tsc", ["mean", "sd"]].tolist() == pytest.approx([0.7857, 0.2945])


def test_thresholds_of_the_second_participant_are_at_their_place():
    limits = threshold_limits(tl.published_models()["2"], 0.0)
    place = (0.0 - limits.lower) / (limits.upper - limits.lower)
    above = (0.35 - 0.0) / (limits.upper - 0.0)
    z = PUBLISHED.mean.copy()
    printed = tl.published_table("2.1")["2"].astype(float)
    z[:6] = [
        np.log(1 / (1 - 0.9995)),
        np.log(0.81 / 0.19),
        0.365,
        np.log(0.407 - 0.365),
        np.log(1 / (1 - 0.9953)),
        np.log(0.35 - 0.24),
    ]
    z[10:] = [np.log(place / (1 - place)), np.log(above / (1 - above))]
    values = person_at(z, "ground_robot", 0.24)
    assert values["p_h_max"] == pytest.approx(printed["P_h_max"])
    assert [values["tsc_l"], values["tsc_u"]] == pytest.approx([0.0, 0.35], abs=1e-12)


def test_draws_have_the_distribution_and_all_are_models():
    drawn = PUBLISHED.draw(2000, seed=1)
    assert (drawn["redrawn"] > 0).mean() < 0.05
    z = stats.norm.cdf(
        (np.log(1.0 / (1.0 - drawn["a_r"])) - PUBLISHED.mean[0])
        / np.sqrt(PUBLISHED.covariance[0, 0])
    )
    assert stats.kstest(z, "uniform").pvalue > 0.01
    total = 0.7857 * 0.2143 / 0.2945**2 - 1.0
    assert (
        stats.kstest(drawn["follow_tsc"], stats.beta(0.7857 * total, 0.2143 * total).cdf).pvalue
        > 0.01
    )
    for values in drawn.to_dict("records")[:200]:
        operator, model, (low, high) = PUBLISHED.person(values)
        limits = threshold_limits(model, 0.0)
        assert limits.lower < low < high < limits.upper
        assert operator.lower < operator.upper
    assert drawn.attrs["synthetic"] is True


# --- studies --------------------------------------------------------------------------------------


def test_measures_are_those_of_the_runs_one_by_one(kept):
    who = 4
    values = kept.participants.to_dict("records")[who - 1]
    operator, model, thresholds = PUBLISHED.person(values)
    seeds = np.random.SeedSequence(3).spawn(10)[who - 1].spawn(5)
    for place, condition in enumerate(("C1", "C2", "C3", "C4", "C5")):
        given = thresholds if condition in ("C2", "C3") else None
        run = tl.run_condition(condition, operator, model, given, laps=2, seed=seeds[place])
        row = kept.measures.query("participant == @who and condition == @condition").iloc[0]
        for name, value in run.measures.items():
            assert row[name] == value or np.isnan(value), name


def test_sessions_are_read_again_and_have_the_measures(kept):
    sessions = kept.sessions()
    assert len(sessions) == 50
    read = pd.DataFrame(
        [
            (
                s.metadata.participant,
                s.metadata.more["trial"],
                s.metadata.condition,
                s["p_r"].mean(),
                s["r"].mean(),
            )
            for s in sessions
        ],
        columns=["participant", "position", "condition", "p_r", "r"],
    )
    both = kept.measures.merge(
        read, on=["participant", "position", "condition"], suffixes=("", "_read")
    )
    assert len(both) == 50
    np.testing.assert_array_equal(both["p_r"], both["p_r_read"])
    np.testing.assert_array_equal(both["r"], both["r_read"])
    assert all(s.metadata.synthetic for s in sessions)
    assert "simulated" in sessions[0].metadata.more["note"]
    table = pd.read_csv(kept.folder / "measures.csv")
    np.testing.assert_allclose(table["p_r"], kept.measures["p_r"], rtol=1e-12)
    assert (kept.folder / "about.txt").read_text().startswith("SIMULATED.")
    assert {"participants.csv", "orders.csv"} <= {item.name for item in kept.folder.iterdir()}


def test_a_participant_is_a_function_of_their_row_and_seed_that_any_process_can_run(kept):
    task = pickle.loads(pickle.dumps(one_participant.run_participant))
    order = json.dumps(kept.design.table().loc[7].tolist())
    fixed = {"testbed": GroundRobot(laps=2), "folder": None}
    values = kept.participants.to_dict("records")[6]
    found = task(**fixed, order=order, **values, seed=np.random.SeedSequence(3).spawn(7)[6])
    for row in kept.measures.query("participant == 7").to_dict("records"):
        for name in kept.names:
            np.testing.assert_equal(found[f"{row['condition']}/{name}"], row[name])


def test_analyses_are_those_of_repeated_measures(kept):
    direct = tl.repeated_measures(kept.measures, "p_r", "condition", "participant")
    assert kept.analysis("p_r").F == direct.F
    assert kept.analysis("p_r").origin == "simulated operators"
    assert "simulated operators" in kept.analysis("p_r").apa()
    assert kept.analysis("p_r", ["C1", "C3"]).k == 2
    table = kept.table().set_index("measure")
    assert table.loc["p_r", "F"] == direct.F
    assert table.loc["p_r", "p"] == direct.p_corrected
    assert np.isnan(table.loc["laps", "F"])
    assert "the error variance is zero" in table.loc["laps", "note"]
    assert "C1" not in table.loc["followed_percent", "conditions"]
    assert set(table.index) == set(kept.names)
    assert kept.table().attrs["origin"] == "simulated operators"


def test_rest_carries_utilization_over_by_2_5(tmp_path):
    study = tl.virtual_study(
        n=4,
        conditions=["C1", "C5"],
        seed=1,
        testbed=GroundRobot(laps=1, rest=120.0),
        out=tmp_path / "s",
    )
    a = study.participants.set_index("participant")["a_r"]
    sessions = {(s.metadata.participant, s.metadata.more["trial"]): s for s in study.sessions()}
    for who in range(1, 5):
        end, begin = sessions[who, 1]["r"][-1], sessions[who, 2]["r"][0]
        assert sessions[who, 1]["r"][0] == 0.0
        assert begin == pytest.approx(end * a[who] ** 1200, rel=1e-12)
        assert begin > 0.0
    assert "carried over" in study.message


def test_the_uav_testbed_measures_what_teleoperation_measures_does():
    study = tl.virtual_study(
        n=4, conditions=["TMIG", "M", "MI", "OMI"], seed=2, testbed=UavTracking(duration=12.0)
    )
    assert study.conditions == ("TMIG", "M", "MI", "OMI")
    operator = study.testbed.population.person(study.participants.to_dict("records")[2])
    seeds = dict(
        zip(["M", "MI", "OMI", "TMIG"], np.random.SeedSequence(2).spawn(4)[2].spawn(4), strict=True)
    )
    for scheme in study.conditions:
        run = tl.simulate_teleoperation(scheme, operator, seed=seeds[scheme], duration=12.0)
        expected = tl.teleoperation_measures(run).iloc[0]
        row = study.measures.query("participant == 3 and condition == @scheme").iloc[0]
        assert all(row[name] == expected[name] for name in study.names)
    assert study.analysis("tracking_error").k == 4
    default = tl.studies.virtual_study
    assert default is tl.virtual_study


# --- failures and folders -------------------------------------------------------------------------


def test_a_participant_who_fails_is_listed_and_left_out(monkeypatch):
    whole = GroundRobot.run

    def failing(self, condition, person, seed):
        if person["participant"] == 2 and condition == "C4":
            raise ValueError("the joystick came off")
        return whole(self, condition, person, seed)

    monkeypatch.setattr(GroundRobot, "run", failing)
    with pytest.warns(CampaignWarning, match="joystick came off"):
        study = tl.virtual_study(n=4, conditions=["C1", "C4"], seed=1, laps=1)
    assert study.failures["participant"].tolist() == [2]
    assert "joystick" in study.failures["error"].item()
    assert set(study.measures["participant"]) == {1, 3, 4}
    assert study.analysis("p_r").n == 3
    assert "left out: 1 participant." in study.message


def test_a_study_goes_on_where_it_stopped_and_is_not_mixed_up(tmp_path):
    arguments = {"n": 4, "conditions": ["C1", "C4"], "seed": 1, "laps": 1, "out": tmp_path / "s"}
    first = tl.virtual_study(**arguments)
    stamps = {file: file.stat().st_mtime_ns for file in (tmp_path / "s" / "sessions").iterdir()}
    again = tl.virtual_study(**arguments)
    pd.testing.assert_frame_equal(first.measures, again.measures)
    assert stamps == {file: file.stat().st_mtime_ns for file in stamps}
    with pytest.raises(CampaignError, match="seed was 1, is 2"):
        tl.virtual_study(**(arguments | {"design": first.design, "conditions": None, "seed": 2}))
    with pytest.raises(
        ValueError, match=r"sessions holds .*, which is not known to be of this study"
    ):
        tl.virtual_study(**(arguments | {"conditions": ["C1", "C5"]}))
    next(iter(stamps)).unlink()
    with pytest.raises(ValueError, match="1 of 8 sessions are missing from"):
        tl.virtual_study(**arguments)


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"conditions": ["C1", "C6"]}, "condition must be one of 'C1', .*, got 'C6'"),
        ({"conditions": []}, "two or more, each once, got none"),
        (
            {"n": 2, "conditions": ["C1", "C2"]},
            "n = 2 is too small for the design: .* 2 conditions needs 4",
        ),
        ({"design": None}, "design must be one of 'latin_square'"),
        ({"testbed": "everyone"}, "testbed must be one of"),
        ({"n_jobs": 0}, "n_jobs must be a whole number"),
    ],
)
def test_virtual_study_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        tl.virtual_study(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mean": PUBLISHED.mean[:5]}, "mean must have 12 samples"),
        (
            {"covariance": np.ones((12, 12))},
            "covariance is not positive definite: its least eigenvalue",
        ),
        ({"follow": (0.5, 0.1)}, "follow must be two pairs"),
        ({"p_r_min": None}, "p_r_min must be a number"),
    ],
)
def test_populations_refuse(arguments, message):
    given = {"mean": PUBLISHED.mean, "covariance": PUBLISHED.covariance, "follow": PUBLISHED.follow}
    with pytest.raises(ValueError, match=message):
        OperatorPopulation(**(given | arguments))


@pytest.mark.filterwarnings("ignore:nobody")
def test_the_folder_of_another_study_is_left_alone(tmp_path):
    arguments = {"n": 4, "conditions": ["C1", "C5"], "laps": 1, "out": tmp_path}
    tl.virtual_study(**arguments, seed=1)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match="not known to be of this study; give a new"):
        tl.virtual_study(**arguments, seed=2)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


class Alternating:
    """A rule with a memory: every 200 calls it changes the mode, if TSC or P_r let it."""

    mode = 1

    def __init__(self, model=None):
        self.calls = 0
        self.lower = 0.0 if model is None else model.robot.p_min

    def step(self, *, tsc, p_r):
        self.calls += 1
        return int(self.calls // 200 % 2 == 0) if p_r > self.lower else None


def test_own_rules_beside_printed_conditions(tmp_path):
    """Oracle: `run_condition` with the same rule, operator and seed; each run has a new rule."""
    conditions = ["C1", "C3", ("in turns", Alternating)]
    study = tl.virtual_study(n=6, conditions=conditions, laps=2, seed=4, out=tmp_path / "study")
    assert study.conditions == ("C1", "C3", "in turns")
    rows = study.measures.set_index(["participant", "condition"])
    bed = tl.testbeds.GroundRobot(laps=2, rules={"in turns": Alternating})
    person = bed.people(6, None, 4).iloc[2].to_dict()
    for seed in (0, 1):
        run = bed.run("in turns", person, seed)
        operator, model, _ = person_of(person)
        alone = tl.run_condition(
            participant=operator, model=model, rule=Alternating(model), laps=2, seed=seed
        )
        assert run.measures == alone.measures
    plain = tl.virtual_study(n=6, conditions=["C1", "C3"], laps=2, seed=4)
    assert (rows.xs("in turns", level="condition")["switches"] > 2).all()
    assert set(plain.names) == set(study.names)
    again = tl.virtual_study(n=6, conditions=conditions, laps=2, seed=4, out=tmp_path / "study")
    pd.testing.assert_frame_equal(again.measures, study.measures)
    assert study.table()["n"].max() == 6
