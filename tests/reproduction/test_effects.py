"""Printed, predicted and simulated effects.

Oracles: numbers read off the printed tables by hand; the exact limit cycle; differences of a
virtual study's measures.
"""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from tests.cases import refused
from trustlab import simulated_effects
from trustlab.reproduction.effects import COLUMNS, SILENT
from trustlab.testbeds import TeleoperatorPopulation

approx = pytest.approx

BY_HAND = {
    # contrast: printed, least and greatest that rounding allows, p
    "table_2.5/p_r/C3-C1": (0.011, 0.010, 0.012, np.nan),  # 0.329 − 0.318
    "table_2.5/r/C2-C1": (-0.015, -0.016, -0.014, np.nan),
    "table_2.4/satisfaction/C2-C1": (0.05, -0.005, 0.105, np.nan),  # 3.9 has one decimal
    "table_2.6/followed_percent/C2-C4": (14.68, 14.67, 14.69, np.nan),
    "uav/p_r/C3-C1": (0.058, 0.057, 0.059, 0.0005),
    "uav/tlx/C3-C1": (-10.083, -10.084, -10.082, 0.003),
    "uav/followed_percent/C2-C4": (23.42, 23.41, 23.43, 0.001),
    "teleop/error/TMIG-MMI": (-0.078, -0.0835, -0.0725, 0.002),  # 0.51 − 0.588
    "table_3.1/tlx/TMIG-M": (-23.91, -23.92, -23.90, np.nan),
    "abstract/p_r/C3-C1": (np.nan, 0.0, np.inf, np.nan),
}
ASSUMED = {"attention_cost": 0.05}


def test_printed_effects_are_those_read_by_hand():
    frame = tl.printed_effects()
    assert 70 <= len(frame) <= 90
    assert frame["id"].is_unique
    found = frame.set_index("id").loc[[*BY_HAND], ["printed", "low", "high", "p"]].astype(float)
    np.testing.assert_allclose(found, [*BY_HAND.values()], atol=1e-12)
    sized = frame[frame["printed"].notna()]
    assert ((sized["low"] < sized["printed"]) & (sized["printed"] < sized["high"])).all()


def test_all_three_have_the_same_rows():
    simulated = simulated_effects(ASSUMED, n=4, seed=1)
    printed, model = tl.printed_effects(), tl.model_effects()
    pd.testing.assert_frame_equal(model[COLUMNS], printed)
    assert list(printed["id"]) == list(simulated["id"])
    for frame, value in ((model, "model"), (simulated, "simulated")):
        assert (frame["reason"].eq("") == frame[value].notna()).all()
    assert simulated.attrs["origin"] == "simulated operators"
    silent = simulated[simulated["simulated"].isna()]
    assert len(simulated) - len(silent) >= 40
    assert (silent["reason"] == SILENT).all()
    assert silent["agrees"].isna().all()


def test_the_model_predicts_what_its_exact_cycles_are():
    rows = tl.model_effects().set_index("id")
    own, chosen = tl.published_table("2.3").T, tl.published_table("2.2").T
    thresholds = (own[[("TSC_l", "mean"), ("TSC_u", "mean")]], chosen[["TSC_l", "TSC_u"]])
    means = []
    for label in "12345":
        model = tl.published_models()[label]
        cycles = [tl.limit_cycle(model, *map(float, table.loc[label])) for table in thresholds]
        means.append([(cycle.mean_p_r, cycle.mean_r) for cycle in cycles])
    p_r, r = np.diff(means, axis=1)[:, 0].T
    found = rows.loc["table_2.5/p_r/C3-C1"]
    assert found["model"] == approx(p_r.mean(), abs=3e-4)
    assert rows.loc["table_2.5/r/C3-C1", "model"] == approx(r.mean(), abs=3e-3)
    # Suggested thresholds give four of five people a lower mean than their own.
    assert (p_r < 0.0).sum() == 4
    assert found["model"] < 0.0 < found["low"]
    assert "which suggestions people follow" in rows.loc["table_2.5/p_r/C2-C1", "reason"]


def test_assumptions_enter_the_studies_that_they_are_about():
    def error(assumptions):
        frame = simulated_effects(assumptions, n=3, seed=2, only="table_3.1", n_jobs=1)
        return frame.set_index("id").loc["table_3.1/error/MI-M", "simulated"]

    assert error({"adapting": 1.0}) != error({})
    people = TeleoperatorPopulation("preliminary")
    rows = people.draw(3, 2, {"compensation": 2.0}).to_dict("records")
    gaps = []
    for row, stream in zip(rows, np.random.SeedSequence(2).spawn(3), strict=True):
        after, before = (
            tl.simulate_teleoperation(scheme, people.person(row), "preliminary", seed=stream)
            for scheme in ("MI", "M")
        )
        gaps.append(after["path_error"].mean() - before["path_error"].mean())
    assert error({"compensation": 2.0}) == approx(np.mean(gaps), rel=1e-12)


@pytest.mark.parametrize(
    ("only", "arguments", "message"),
    [
        ("table_2.6", {"assumptions": {"fatigue_of_hand": 0.3}}, "'attention_cost'"),
        ("table_3.1", {"assumptions": {"attention_cost": 0.2}}, "'fatigue_of_hand'"),
        ("table_2.6", {"trust": tl.trust.MODELS["beta"]()}, "trust has no effect"),
        ("table_3.1", {"trust": "nonsense"}, "trust must be of class TrustInLoop"),
    ],
)
def test_what_has_no_effect_on_the_chosen_studies_is_refused(only, arguments, message):
    """It was taken, and named in the origin of the table."""
    with refused(message):
        simulated_effects(**arguments, n=3, only=only)


def test_the_table_says_how_many_operators_were_run():
    """It said 3 where 5 were run, so that every condition comes first equally often."""
    frame = simulated_effects(n=3, only="table_2.6")
    assert frame.attrs["n"] == {"ground_robot": 5}
    assert frame["operators"].tolist() == [5]


UAV = {"conditions": ["C1", "C2", "C3", "C4", "C5"], "testbed": "uav_following"}
WORKLOAD = {"load_utilization": 0.5, "load_switching": 0.05}


@pytest.mark.parametrize(
    ("id", "bed", "assumed", "scale"),
    [
        ("uav/p_r/C3-C1", UAV, ASSUMED, 1.0),
        ("uav/followed_percent/C2-C4", UAV, ASSUMED, 1.0),
        # With workload people answer; the small studies asked from 1 to 5, not 7.
        ("table_2.4/satisfaction/C3-C1", {}, WORKLOAD, 4.0 / 6.0),
    ],
)
def test_simulated_effects_are_those_of_a_virtual_study(id, bed, assumed, scale):
    printed_in, measure, contrast = id.split("/")
    effects = simulated_effects(assumed, n=10, seed=1, only=printed_in).set_index("id")
    study = tl.virtual_study(n=10, seed=1, assumptions=assumed, **bed)
    wide = scale * study.measures.pivot_table(measure, "participant", "condition", observed=True)
    after, before = wide[contrast.split("-")].dropna().to_numpy().T
    mean, se = (after - before).mean(), stats.sem(after - before)
    row = effects.loc[id]
    expected = [after.size, mean, se, stats.ttest_rel(after, before).pvalue]
    assert row[["operators", "simulated", "se", "p_simulated"]].tolist() == approx(expected)
    gap = abs(mean - row["printed"])
    assert row["agrees"] == (gap <= row["high"] - row["printed"] + 2.0 * se)
    if assumed is WORKLOAD:
        assert effects["simulated"].notna().all()


def test_models_of_trust_change_what_follows_trust_and_nothing_else():
    quick = tl.trust.TrustInLoop(tl.trust.MODELS["performance"](a=5.0, gain=1.0), every=0.5)
    usual, changed = (
        simulated_effects(n=3, only="teleop", n_jobs=1, trust=trust).set_index("id")["simulated"]
        for trust in (None, quick)
    )
    assert usual["teleop/error/OMI-M"] == changed["teleop/error/OMI-M"]
    assert abs(usual["teleop/error/TMIG-M"] - changed["teleop/error/TMIG-M"]) > 1e-3
