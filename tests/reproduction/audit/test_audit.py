"""
The audit's verdicts: against arithmetic by hand, with printed numbers spoiled and slips corrected,
and complete.

Oracles: exact fractions of the printed decimals; closed forms of the F distribution with 4 degrees
of freedom; the printed files themselves, read here without the audit's own reader.
"""

import csv
import tomllib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import trustlab as tl
from tests.cases import refused
from trustlab.reproduction.audit.audit import audit, checked_rows
from trustlab.reproduction.audit.catalogue import printed_numbers
from trustlab.reproduction.audit.check import Follows
from trustlab.reproduction.audit.consistency import study_conflicts
from trustlab.reproduction.audit.relations import relations

parametrize = pytest.mark.parametrize
approx = pytest.approx

PUBLISHED = Path(__file__).parents[3] / "data" / "published"


@pytest.fixture(scope="module")
def verdicts():
    return audit().set_index("id")


def quick(changes=None):
    """Rows by id of everything but the numbers that nothing determines."""
    numbers = printed_numbers(changes)
    return {row.id: row for row in checked_rows(numbers, study_conflicts(numbers))}


# Slips that stand however the inputs were rounded.
SLIPS = {
    "table_2.1/delta_TSC/2",
    "table_2.1/delta_TSC/4",
    "table_2.1/delta_TSC/5",
    "table_2.1/TSC_ub/5",
    "table_2.2/r_l/3",
    "teleop.tracking_error/anova.df1",
    "claim/section_2_1/c3_lowers_perceived_workload_against_c1_by",
    "section_2_4_2_4/anovas",
    "figure_2_18/TSC_ud",
    "section_3_8_3/MI_tlx",
    "appendix_a/state/x_damping",
    *(f"{name}/n" for name in tl.published_studies() if name.startswith("uav.")),
    "section_2_2_2/weights",
    "section_2_4_2/Z_Ph",
    "appendix_a/pd/p_xy/stable",
}


def test_the_slips_are_these(verdicts):
    """They are 15: n = 36 stands in seven results of the UAV study and is one."""
    slips = verdicts[verdicts["verdict"] == "differs"]
    assert {*slips.index} == SLIPS
    assert len(slips.drop_duplicates(["quantity", "printed", "reason"])) == 15


def test_suspicious_numbers_are_marked(verdicts):
    """Negative control: a heavier damping carries a handle."""
    damping, suspicious = "section_3_8_1/B", verdicts["reason"].str.contains("Suspicious")
    assert {damping, "teleop.satisfaction/pairs.M-TMIG"} < {*verdicts.index[suspicious]}
    assert not quick({damping: "60"})[damping].reason.startswith("Suspicious")


def test_shape(verdicts):
    assert verdicts.index.is_unique
    words = {"reproduced", "within rounding", "differs", "not checkable"}
    assert set(verdicts["verdict"]) == words
    assert (verdicts["reason"].str.len() > 10).all()
    known = verdicts[["low", "recomputed", "high"]].dropna()
    assert (known.diff(axis=1).iloc[:, 1:] >= 0.0).all(axis=None)


def test_every_printed_number_is_there(verdicts):
    printed = []
    for path in sorted(PUBLISHED.glob("table_*.csv")):
        table = "table_" + path.stem.removeprefix("table_").replace("_", ".")
        keys = 2 if table == "table_2.3" else 1
        with path.open() as file:
            head, *rows = csv.reader(file)
        for row in rows:
            for column, text in zip(head[keys:], row[keys:], strict=True):
                printed.append((f"{table}/{'.'.join(row[:keys])}/{column}", text))
    for chapter, studies in tomllib.loads((PUBLISHED / "studies.toml").read_text()).items():
        for name, study in studies.items():
            for field, entry in study.items():
                listed = entry if isinstance(entry, dict) else {}
                if field in ("epsilon", "n"):
                    text = "df 140" if (chapter, entry) == ("uav", 36) else str(entry)
                    printed.append((f"{chapter}.{name}/{field}", text))
                printed += [(f"{chapter}.{name}/{field}.{key}", listed[key]) for key in listed]
    assert len(printed) > 430
    for id, text in printed:
        assert verdicts.loc[id, "printed"] == text, id
    with (PUBLISHED / "statements.csv").open() as file:
        for row in csv.DictReader(file):
            assert verdicts.index.str.startswith(row["id"]).any(), row["id"]


def hand(verdicts, id, value, abs=1e-9):
    assert verdicts.loc[id, "recomputed"] == approx(float(value), abs=abs)
    return verdicts.loc[id, "verdict"]


@parametrize("p", ["1", "2", "3", "4", "5"])
def test_delta_tsc_by_hand(verdicts, p):
    """What is printed for three participants is the difference, to its last digit."""
    verdict = "reproduced" if p in "13" else "differs"
    t = tl.published_table("2.1")[p]
    low, high, least, most = (Fraction(t[k]) for k in ("P_r_min", "P_r_max", "P_h_min", "P_h_max"))
    scale = high * most - low * least
    a_t, b_t = (most + least) / scale, (high + low) / scale
    robot, human = a_t * Fraction(t["delta_P_r"]), b_t * Fraction(t["delta_P_h"])
    assert hand(verdicts, f"table_2.1/delta_TSC/{p}", robot + human) == verdict
    assert (f"{float(robot - human):.4f}" == t["delta_TSC"]) == (verdict == "differs")
    reason = verdicts.loc[f"table_2.1/delta_TSC/{p}", "reason"]
    assert ("|a_T δ_Pr − b_T δ_Ph|" in reason) == (verdict == "differs")


def test_statistics_by_hand(verdicts):
    # P(F(4, m) > f) = x^(m/2) (1 + (m/2)(1 − x)), x = m/(m + 4 f).
    x = 140 / (140 + 4 * 18.714)
    # (100, 100, 50, 100, 42.86): n − 1 in the SD, not n.
    spread = np.std([100, 100, 50, 100, 42.86], ddof=1)
    for id, value, verdict in (
        ("uav.robot_performance/anova.p", x**70 * (1 + 70 * (1 - x)), "reproduced"),
        ("uav.trust/anova.eta2", 6.13 / 41.13, "reproduced"),
        ("teleop.tracking_error/anova.df1", 70.628 / 29, "differs"),
        ("uav.tlx/epsilon", 114.63 / 140, "reproduced"),
        ("uav.tlx/n", 20 - 2, "differs"),
        ("claim/section_2_4_2_4/uav_robot_performance_c2_over_c1", 5400 / 493, "reproduced"),
        ("table_2.6/C2/sd", spread, "reproduced"),
        ("section_2_2_2/weights", 1001 / 1000, "differs"),
    ):
        assert hand(verdicts, id, value) == verdict
    # (2.20) with the gain of (2.3), for a participant who is printed with .63.
    assert hand(verdicts, "table_2.2/r_l/1", 0.647, abs=5e-4) == "within rounding"


SPOILED = {
    "table_2.1/delta_TSC/1": "0.0042",
    "table_2.1/b_pr/2": "0.0023",
    "table_2.1/b_r/4": "0.005",
    "table_2.1/TSC_lb/2": "-0.604",
    "table_2.2/P_rl/4": "0.385",
    "table_2.2/r_l/5": "0.549",
    "table_2.6/C2/mean": "75.87",
    "table_2.6/C4/sd": "13.17",
    "uav.trust/anova.eta2": "0.194",
    "uav.trust/anova.df1": "2.696",
    "uav.tlx/anova.p": "0.01",
    "uav.followed/t_test.p": "0.01",
    "uav.trust/mauchly.p": "0.07",
    "teleop.trust/mauchly.p": "0.196",
    "teleop.tlx/mauchly.df": "6",
    "teleop.tlx/anova.df2": "116",
    "claim/remark_7/c2_utilization_below_c1": "5.1",
    "claim/remark_3/delta_tsc_of_the_pilot_operator": "0.0048",
    "section_3_9_2/participants": "31",
    "section_3_8_3/TMIG_error": "third best",
    "appendix_a/state/y_damping": "0.4760",
}


def test_spoiled_numbers_differ(verdicts):
    """None is an input of another, so that all can be spoiled at once."""
    rows = quick(SPOILED)
    for id in SPOILED:
        assert (verdicts.loc[id, "verdict"], rows[id].verdict) == ("reproduced", "differs"), id


def test_a_spoiled_input_shows_where_it_is_used():
    spoiled = {"table_2.1/b_pr/5": "0.0012", "uav.tlx/mean.C3": "44.226"}
    rows = quick(spoiled | {"table_3.1/MI/tlx_mean": "62.42"})
    claim = "claim/section_2_1/c3_lowers_perceived_workload_against_c1_by"
    for id in ("table_2.1/TSC_ub/5", claim, "section_3_8_3/MI_tlx"):
        assert rows[id].verdict == "reproduced"
    assert rows["table_2.1/b_pr/5"].verdict == "differs"


def test_a_gain_that_breaks_its_equation_is_no_excuse_but_is_named(verdicts):
    """
    P_r from .244 to .3616, P_h from .374 to .4094, a_pr = .99644 and b_pr = .00114 round as printed
    and give both limits of participant 5; (2.3) would print this b_pr as 0.0010.
    """
    assert "does not obey (2.3)" in verdicts.loc["table_2.1/TSC_ub/5", "reason"]


def test_impossible_numbers_differ(verdicts):
    changes = {
        "uav.utilization/anova.F": "9.9",  # means and SDs leave 10.26 and more
        "uav.followed/t_test.t": "1.9",
        "teleop.tlx/pairs.M-TMIG": "0.045",  # 6 p at a correlation of −1 is 0.015
        "uav.trust/mean.C5": "7.264",  # rated from 1 to 7
    }
    assert {*changes} < {*study_conflicts(printed_numbers(changes))}
    changes = {
        "uav.satisfaction/mauchly.chi2": "20.1",  # ε = 0.693 leaves 22.9 and more
        # (2.3) moves P_r by (1 − a_pr)(P_r_max − P_r_min) at most, 0.0035 × 0.12
        "table_2.1/delta_P_r/3": "4.9e-4",
        # Five scores of 0 and 100 with mean 42.44 have 55.26 at most, of 1 and 5 with mean 3.85
        # 2.03, of 0 and 1 with mean 0.651 0.53; eight distances with mean 3.79 have 3.79 √8
        "table_2.4/C1/tlx_sd": "55.31",
        "table_2.4/C1/satisfaction_sd": "2.04",
        "table_2.5/C1/r_sd": "0.54",
        "table_3.1/M/error_sd": "10.75",
    }
    mean = {"table_2.4/C1/tlx_mean": "120.00"}  # beyond the scale: with no SD
    assert quick(mean)["table_2.4/C1/tlx_sd"].verdict == "differs"
    rows = quick(changes)
    for id in changes:
        assert (verdicts.loc[id, "verdict"], rows[id].verdict) == ("not checkable", "differs"), id
        assert rows[id].reason.startswith("Impossible"), id  # certain, and no mere suspicion


def test_a_contradiction_of_a_study_is_a_verdict():
    # A share of mean 0.95 has at most 0.231.
    share = "uav.utilization/sd.C5"
    # Degrees of freedom of ten conditions follow from each other, but not from five.
    degrees = {"uav.tlx/anova.df1": "9", "uav.tlx/anova.df2": "315"}
    rows = audit({share: "0.250"} | degrees).set_index("id").loc[[share, *degrees]]
    assert (rows["verdict"] == "differs").all()
    assert rows.loc[share, "reason"].startswith("Impossible: sd.C5 = 0.250 must lie between 0 and")
    assert rows["reason"][1:].str.contains("belong to 10 conditions").all()


def test_a_p_value_that_some_adjustment_allows_is_no_contradiction():
    """Of two equal means Bonferroni's p is 1; the unadjusted one can be .95."""
    pair = "teleop.satisfaction/pairs.M-TMIG"
    conflicts = study_conflicts(
        printed_numbers({"teleop.satisfaction/mean.TMIG": "4.08", pair: ".95"})
    )
    assert pair not in conflicts


def test_a_mean_may_be_printed_as_a_bound():
    """Some whole points always lie below one."""
    rows = quick({"uav.tlx/mean.C1": "<55", "table_2.4/C4/tlx_mean": "<50"})
    assert rows["uav.tlx/scoring"].printed.startswith("<55, ")
    assert "none of" not in rows["table_2.4/tlx/scoring"].reason


def test_participant_3_follows_from_other_thresholds(verdicts):
    """The whole column by one pair of thresholds."""
    assert verdicts.loc["table_2.2/r_l/3", "verdict"] == "differs"
    assert "both 0.10 higher than those printed" in verdicts.loc["table_2.2/r_l/3", "reason"]
    rows = quick({"table_2.2/TSC_l/3": "0.10", "table_2.2/TSC_u/3": "0.37"})
    column = {rows[f"table_2.2/{name}/3"].verdict for name in ("P_rl", "P_ru", "r_l", "r_u")}
    assert column <= {"reproduced", "within rounding"}


def test_a_number_printed_twice_may_have_been_rounded_in_both_places(verdicts):
    """0.1 was called wrong beside 0.15, as if this were exact; 0.147 rounds to both."""
    lower, upper = (verdicts.loc[f"figure_2_18/TSC_{end}d"] for end in "lu")
    assert lower["verdict"] == "within rounding"
    assert lower[["low", "recomputed", "high"]].tolist() == [0.145, 0.15, 0.155]
    assert "from 0.145 to below 0.15 round to both" in lower["reason"]
    assert upper["verdict"] == "differs"
    assert "no numbers from 0.555 to below 0.555 round to both" in upper["reason"]


def test_what_is_not_printed_is_not_called_printed(verdicts):
    """n = 36 and a sum of weights of 1 were; degrees of freedom and "average" are."""
    assert verdicts.loc["section_2_2_2/weights", "printed"] == "average"
    assert "Printed is “df 140”, that is 36." in verdicts.loc["uav.tlx/n", "reason"]
    assert "n = “df 140”, that is 36 (uav.tlx/n)" in verdicts.loc["uav.tlx/epsilon", "inputs"]
    assert "Rests on uav.tlx/n, judged “differs”" in verdicts.loc["uav.tlx/epsilon", "reason"]


def test_no_certain_slip_within_rounding():
    # Brute force: 20,000 draws of inputs that round as printed never give the printed number, by
    # any convention.
    numbers = printed_numbers()
    checks = [check for check in relations(numbers) if isinstance(check, Follows)]
    checks = [check for check in checks if check.of + check.suffix in SLIPS]
    assert len(checks) == 19
    rng = np.random.default_rng(1)
    for check in checks:
        least, most = numbers[check.of].compatible
        for way in filter(None, (check, check.convention)):
            values = {}
            for symbol, id in way.at(check, numbers)[1].items():
                half = 0.0 if symbol in way.as_printed else numbers[id].half
                values[symbol] = numbers[id].value + half * rng.uniform(-1, 1, 20000)
            found = way.at(check, numbers, values)[0]
            assert not np.any((found >= least) & (found <= most)), (check.of, way.label)


@parametrize(
    ("id", "text", "message"),
    [
        ("table_2.1/a_r/9", "1", "no printed number has the id"),
        ("table_2.1/a_r/1", "inf", "must be a number as printed"),
        ("uav.tlx/n", "36.5", "n of 'uav.tlx' must be a whole number, 3 or more, got 36.5"),
        ("uav.tlx/sphericity", "violatd", "one of 'met', 'not met', 'violated'"),
    ],
)
def test_bad_changes_are_refused(id, text, message):
    with refused(message):
        audit({id: text})


def test_every_reason_for_an_unchecked_number_is_used(verdicts):
    with (PUBLISHED / "unchecked.csv").open() as file:
        reasons = {row["reason"] for row in csv.DictReader(file)}
    said = verdicts.loc[verdicts["verdict"] == "not checkable", "reason"]
    unused = [reason for reason in reasons if not said.str.contains(reason, regex=False).any()]
    assert unused == []
