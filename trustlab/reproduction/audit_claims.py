"""The audit of claims.csv: percentages and differences against the means they would be computed from."""

from __future__ import annotations

import numpy as np

from trustlab.reproduction.audit_checks import Check, Formula, Numbers, Remark

__all__ = ["claim_checks"]

POINTS = "difference in units of the measure, printed as %"
RELATIVE = "relative change"


def _change(after: str, before: str, percent: float = 100.0) -> tuple[Formula, Formula]:
    """Return the magnitude of a change, relative to `before`, and as a difference times `percent`."""
    inputs = {"after": after, "before": before}
    return (
        Formula(
            "100 |after − before|/before",
            inputs,
            lambda v: 100.0 * np.abs(v["after"] - v["before"]) / v["before"],
            RELATIVE,
        ),
        Formula(
            "|after − before|" if percent == 1.0 else f"{percent:g} |after − before|",
            inputs,
            lambda v: percent * np.abs(v["after"] - v["before"]),
            POINTS if percent == 1.0 else "percentage points",
        ),
    )


def _relative(after: str, before: str) -> Formula:
    return _change(after, before)[0]


def _by_2_39(after: str, before: str) -> tuple[Formula, Formula]:
    """Return the difference of two robot performances in % of the range, (2.39), and relative to the first."""
    inputs = {
        "after": after,
        "before": before,
        "P_r_min": "remark_7/P_r_min",
        "P_r_max": "remark_7/P_r_max",
    }
    share = Formula(
        "100 (after − before)/(P_r_max − P_r_min)",
        inputs,
        lambda v: 100.0 * (v["after"] - v["before"]) / (v["P_r_max"] - v["P_r_min"]),
        "difference of two values of (2.39)",
    )
    ratio = Formula(
        "100 (after − before)/(before − P_r_min)",
        {key: inputs[key] for key in ("after", "before", "P_r_min")},
        lambda v: 100.0 * (v["after"] - v["before"]) / (v["before"] - v["P_r_min"]),
        "relative change of (2.39)",
    )
    return share, ratio


def _in_points(number: str, numbers: Numbers, after: str, before: str, percent: float) -> Check:
    relative, points = _change(after, before, percent)
    would = relative.range(numbers)[0]
    note = f"Printed with a % sign, which reads as a relative change; that would be {would:.1f} %."
    return Check(number, points, (relative,), note=note)


def _case_one(numbers: Numbers) -> list:
    claim, mean = "claim/remark_7/", "table_2.5/{}/{}_mean".format
    checks = []
    for name, after, before in (
        ("c2_robot_performance_over_c1_by_2_39", "C2", "C1"),
        ("c3_robot_performance_over_c1_by_2_39", "C3", "C1"),
        ("c5_robot_performance_over_c3_by_2_39", "C5", "C3"),
    ):
        share, ratio = _by_2_39(mean(after, "P_r"), mean(before, "P_r"))
        checks.append(Check(claim + name, share, (ratio,)))
    for name, after, before in (
        ("c2_utilization_below_c1", "C2", "C1"),
        ("c3_utilization_below_c1", "C3", "C1"),
        ("c5_utilization_above_c3", "C5", "C3"),
    ):
        checks.append(_in_points(claim + name, numbers, mean(after, "r"), mean(before, "r"), 100.0))
    checks.append(
        _in_points(
            "claim/section_2_4_1_3/c2_suggestions_followed_more_than_c4_by",
            numbers,
            "table_2.6/C2/mean",
            "table_2.6/C4/mean",
            1.0,
        )
    )
    return checks


def _case_two(numbers: Numbers) -> list:
    claim = "claim/section_2_4_2_4/"
    mean = "uav.{}/mean.{}".format
    checks = [
        Check(
            "claim/section_2_1/c3_raises_uav_robot_performance_over_c1_by",
            _relative(mean("robot_performance", "C3"), mean("robot_performance", "C1")),
        ),
        _in_points(
            "claim/section_2_1/c3_lowers_perceived_workload_against_c1_by",
            numbers,
            mean("tlx", "C3"),
            mean("tlx", "C1"),
            1.0,
        ),
        _in_points(
            claim + "c2_suggestions_are_more_likely_followed_than_c4_by",
            numbers,
            mean("followed", "C2"),
            mean("followed", "C4"),
            1.0,
        ),
    ]
    for c in ("C2", "C4", "C5"):
        after, before = mean("robot_performance", c), mean("robot_performance", "C1")
        finer = tuple(
            Formula(
                "100 |after − before|/before",
                {"after": after, "before": before},
                _relative(after, before).compute,
                f"the mean of {c} was {numbers[after].value + k / 1000:.3f}, printed as {numbers[after].printed}",
                {"after": numbers[after].value + k / 1000},
            )
            for k in (-1, 1, -2, 2, -3, 3, -4, 4)
            if numbers[after].decimals == 2
        )
        checks.append(
            Check(
                f"{claim}uav_robot_performance_{c.lower()}_over_c1",
                _relative(after, before),
                explanations=finer,
            )
        )
    for after in ("C4", "C5"):
        for before in ("C1", "C2", "C3"):
            checks.append(
                _in_points(
                    f"{claim}uav_utilization_{after.lower()}_over_{before.lower()}",
                    numbers,
                    mean("utilization", after),
                    mean("utilization", before),
                    100.0,
                )
            )
    return checks


def _teleoperation(numbers: Numbers) -> list:
    table, mean = "table_3.1/{}/{}_mean".format, "teleop.{}/mean.{}".format
    both = "claim/section_3_9_5/tmig_and_omi_lower_tracking_error_against_mmi_by"
    before = mean("tracking_error", "MMI")
    used = numbers[mean("tracking_error", "OMI")]
    relative = _relative(mean("tracking_error", "TMIG"), before)
    finer = (
        Formula(
            relative.text,
            relative.inputs,
            relative.compute,
            f"the value of OMI, {used.printed}, was used",
            {"after": used.value},
        ),
    )
    checks = [
        Check(
            "claim/section_3_8_3/tmig_lowers_error_against_m_by",
            _relative(table("TMIG", "error"), table("M", "error")),
        ),
        _in_points(
            "claim/section_3_8_3/tmig_lowers_workload_against_m_by",
            numbers,
            table("TMIG", "tlx"),
            table("M", "tlx"),
            1.0,
        ),
        Check(
            both,
            _relative(mean("tracking_error", "OMI"), before),
            quantity="OMI lowers tracking error against MMI by [%]",
        ),
        Check(
            both,
            relative,
            explanations=finer,
            suffix="/TMIG",
            quantity="TMIG lowers tracking error against MMI by [%]",
        ),
        Check("section_3_1/error", relative, explanations=finer),
        Check(
            "claim/section_3_8_1/f_i_for_a_delay_growing_at_most_0_5_s_s",
            Formula("√(1 − Ṫ_max)", {"T": "section_3_8_1/T_max"}, lambda v: np.sqrt(1.0 - v["T"])),
        ),
        Remark("section_3_8_1/T_max", "Chosen by the author."),
    ]
    for number in ("claim/section_3_9_5/tmig_lowers_task_load_against_mmi_by", "section_3_1/workload"):
        checks.append(_in_points(number, numbers, mean("tlx", "TMIG"), mean("tlx", "MMI"), 1.0))
    return checks


def _remark_seven() -> list:
    """Return the checks of the velocities and errors of Remark 7 by (2.4): a mean of products, not their product."""
    return [
        Check(
            f"remark_7/P_r_{end}",
            Formula(
                "v (1 − e/e_max)",
                {"v": f"remark_7/v_{end}", "e": f"remark_7/e_{end}", "e_max": "section_2_2_2/e_max"},
                lambda v: v["v"] * (1.0 - v["e"] / v["e_max"]),
            ),
            binding="(2.4) is a mean of products, which is below the product of the means where the robot is faster the farther "
            "it is from the path.",
        )
        for end in ("min", "max")
    ]


def claim_checks(numbers: Numbers) -> list:
    """
    Return the checks of the printed percentages and differences, and of Remark 7.

    Parameters
    ----------
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    """
    return [*_case_one(numbers), *_case_two(numbers), *_teleoperation(numbers), *_remark_seven()]
