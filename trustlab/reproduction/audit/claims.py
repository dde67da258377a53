"""The audit of claims.csv: percentages and differences against the means they would be computed from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trustlab.reproduction.audit.verdict import Check, Formula, Numbers, Remark

__all__ = ["claim_checks"]

CASE_TWO, MAIN_STUDY = "claim/section_2_4_2_4/", "claim/section_3_9_5/"


def _table_2_5(condition: str, measure: str) -> str:
    return f"table_2.5/{condition}/{measure}_mean"


def _table_3_1(scheme: str, measure: str) -> str:
    return f"table_3.1/{scheme}/{measure}_mean"


def _uav(condition: str, measure: str) -> str:
    return f"uav.{measure}/mean.{condition}"


def _teleop(scheme: str, measure: str) -> str:
    return f"teleop.{measure}/mean.{scheme}"


BY_RANGE = (
    ("claim/remark_7/c2_robot_performance_over_c1_by_2_39", _table_2_5("C2", "P_r"), _table_2_5("C1", "P_r")),
    ("claim/remark_7/c3_robot_performance_over_c1_by_2_39", _table_2_5("C3", "P_r"), _table_2_5("C1", "P_r")),
    ("claim/remark_7/c5_robot_performance_over_c3_by_2_39", _table_2_5("C5", "P_r"), _table_2_5("C3", "P_r")),
)
"""Claims in % of the range of robot performance, (2.39): id, mean after, mean before."""

SHARES = (
    ("claim/remark_7/c2_utilization_below_c1", _table_2_5("C2", "r"), _table_2_5("C1", "r")),
    ("claim/remark_7/c3_utilization_below_c1", _table_2_5("C3", "r"), _table_2_5("C1", "r")),
    ("claim/remark_7/c5_utilization_above_c3", _table_2_5("C5", "r"), _table_2_5("C3", "r")),
    *(
        (
            f"{CASE_TWO}uav_utilization_{after.lower()}_over_{before.lower()}",
            _uav(after, "utilization"),
            _uav(before, "utilization"),
        )
        for after in ("C4", "C5")
        for before in ("C1", "C2", "C3")
    ),
)
"""Claims about shares between 0 and 1, printed with a % sign."""

POINTS = (
    (
        "claim/section_2_4_1_3/c2_suggestions_followed_more_than_c4_by",
        "table_2.6/C2/mean",
        "table_2.6/C4/mean",
    ),
    ("claim/section_2_1/c3_lowers_perceived_workload_against_c1_by", _uav("C3", "tlx"), _uav("C1", "tlx")),
    (
        f"{CASE_TWO}c2_suggestions_are_more_likely_followed_than_c4_by",
        _uav("C2", "followed"),
        _uav("C4", "followed"),
    ),
    (
        "claim/section_3_8_3/tmig_lowers_workload_against_m_by",
        _table_3_1("TMIG", "tlx"),
        _table_3_1("M", "tlx"),
    ),
    (f"{MAIN_STUDY}tmig_lowers_task_load_against_mmi_by", _teleop("TMIG", "tlx"), _teleop("MMI", "tlx")),
    ("section_3_1/workload", _teleop("TMIG", "tlx"), _teleop("MMI", "tlx")),
)
"""Claims about measures from 0 to 100, printed with a % sign."""


def _relative(after: str, before: str) -> Formula:
    """Return the magnitude of a change relative to `before`, in %."""
    return Formula(
        "100 |after − before|/before",
        {"after": after, "before": before},
        lambda v: 100.0 * np.abs(v["after"] - v["before"]) / v["before"],
        "relative change",
    )


def _by_range(number: str, after: str, before: str) -> Check:
    """Return the check of a difference of two robot performances in % of the range, or relative to the first."""
    low, high = {"P_r_min": "remark_7/P_r_min"}, {"P_r_max": "remark_7/P_r_max"}
    means = {"after": after, "before": before}
    share = Formula(
        "100 (after − before)/(P_r_max − P_r_min)",
        means | low | high,
        lambda v: 100.0 * (v["after"] - v["before"]) / (v["P_r_max"] - v["P_r_min"]),
        "difference of two values of (2.39)",
    )
    ratio = Formula(
        "100 (after − before)/(before − P_r_min)",
        means | low,
        lambda v: 100.0 * (v["after"] - v["before"]) / (v["before"] - v["P_r_min"]),
        "relative change of (2.39)",
    )
    return Check(number, share, (ratio,))


def _in_points(number: str, after: str, before: str, scale: float, numbers: Numbers) -> Check:
    """Return the check of a difference times `scale`, which is 100 for shares, or of a relative change."""
    relative = _relative(after, before)
    points = Formula(
        "|after − before|" if scale == 1.0 else f"{scale:g} |after − before|",
        relative.inputs,
        lambda v: scale * np.abs(v["after"] - v["before"]),
        "difference in units of the measure, printed as %" if scale == 1.0 else "percentage points",
    )
    would, _, _ = relative.range(numbers)
    note = f"Printed with a % sign, which reads as a relative change; that would be {would:.1f} %."
    return Check(number, points, (relative,), note=note)


def _robot_performance_of_case_two(numbers: Numbers) -> list[Check]:
    """Return the checks of the UAV's robot performance against C1, with finer means as explanations."""
    before = _uav("C1", "robot_performance")
    checks = []
    for c in ("C2", "C4", "C5"):
        after = _uav(c, "robot_performance")
        relative, mean = _relative(after, before), numbers[after]
        finer = [mean.value + k / 1000 for k in (-1, 1, -2, 2, -3, 3, -4, 4) if mean.decimals == 2]
        explanations = tuple(
            replace(
                relative,
                label=f"the mean of {c} was {value:.3f}, printed as {mean.printed}",
                changed={"after": value},
            )
            for value in finer
        )
        number = f"{CASE_TWO}uav_robot_performance_{c.lower()}_over_c1"
        checks.append(Check(number, relative, explanations=explanations))
    c1_to_c3 = "claim/section_2_1/c3_raises_uav_robot_performance_over_c1_by"
    return [*checks, Check(c1_to_c3, _relative(_uav("C3", "robot_performance"), before))]


def _teleoperation(numbers: Numbers) -> list:
    """Return the checks of the tracking errors of Chapter 3, and of the filter's gain under a growing delay."""
    both = f"{MAIN_STUDY}tmig_and_omi_lower_tracking_error_against_mmi_by"
    before = _teleop("MMI", "tracking_error")
    omi = numbers[_teleop("OMI", "tracking_error")]
    tmig = _relative(_teleop("TMIG", "tracking_error"), before)
    used = (replace(tmig, label=f"the value of OMI, {omi.printed}, was used", changed={"after": omi.value}),)
    gain = Formula("√(1 − Ṫ_max)", {"T": "section_3_8_1/T_max"}, lambda v: np.sqrt(1.0 - v["T"]))
    return [
        Check(
            "claim/section_3_8_3/tmig_lowers_error_against_m_by",
            _relative(_table_3_1("TMIG", "error"), _table_3_1("M", "error")),
        ),
        Check(both, _relative(omi.id, before), quantity="OMI lowers tracking error against MMI by [%]"),
        Check(
            both,
            tmig,
            explanations=used,
            suffix="/TMIG",
            quantity="TMIG lowers tracking error against MMI by [%]",
        ),
        Check("section_3_1/error", tmig, explanations=used),
        Check("claim/section_3_8_1/f_i_for_a_delay_growing_at_most_0_5_s_s", gain),
        Remark("section_3_8_1/T_max", "Chosen by the author."),
    ]


def _remark_seven(end: str) -> Check:
    """Return the check of a velocity and an error of Remark 7 by (2.4)."""
    inputs = {"v": f"remark_7/v_{end}", "e": f"remark_7/e_{end}", "e_max": "section_2_2_2/e_max"}
    return Check(
        f"remark_7/P_r_{end}",
        Formula("v (1 − e/e_max)", inputs, lambda v: v["v"] * (1.0 - v["e"] / v["e_max"])),
        binding="(2.4) is a mean of products, which is below the product of the means where the robot is faster the farther "
        "it is from the path.",
    )


def claim_checks(numbers: Numbers) -> list:
    """Return the checks of the printed percentages and differences, and of Remark 7."""
    return [
        *(_by_range(*claim) for claim in BY_RANGE),
        *(_in_points(*claim, 100.0, numbers) for claim in SHARES),
        *(_in_points(*claim, 1.0, numbers) for claim in POINTS),
        *_robot_performance_of_case_two(numbers),
        *_teleoperation(numbers),
        *(_remark_seven(end) for end in ("min", "max")),
    ]
