"""The audit of claims.csv: percentages and differences against the means they would be computed from."""

from dataclasses import replace

import numpy as np

from trustlab.reproduction.audit.catalogue import claims
from trustlab.reproduction.audit.verdict import Check, Formula, Numbers


def _relative(after: str, before: str) -> Formula:
    """Return the magnitude of a change relative to `before`, in %."""
    ids = {"after": after, "before": before}
    return Formula.of("100 * abs(after - before) / before", ids, "relative change")


def _by_range(number: str, after: str, before: str) -> Check:
    """Return the check of a difference of two robot performances in % of the range, or relative to the first."""
    ids = {"after": after, "before": before, "P_r_min": "remark_7/P_r_min", "P_r_max": "remark_7/P_r_max"}
    change = "100 * (after - before)"
    difference = Formula.of(f"{change} / (P_r_max - P_r_min)", ids, "difference of two values of (2.39)")
    relative = Formula.of(f"{change} / (before - P_r_min)", ids, "relative change of (2.39)")
    return Check(number, difference, (relative,))


def _in_points(number: str, after: str, before: str, scale: float, numbers: Numbers) -> Check:
    """Return the check of a difference times `scale`, which is 100 for shares, or of a relative change."""
    relative = _relative(after, before)
    label = "difference in units of the measure, printed as %" if scale == 1.0 else "percentage points"
    difference = "abs(after - before)" if scale == 1.0 else f"{scale:g} * abs(after - before)"
    points = Formula.of(difference, relative.inputs, label)
    would, _, _ = relative.range(numbers)
    note = f"Printed with a % sign, which reads as a relative change; that would be {would:.1f} %."
    return Check(number, points, (relative,), note=note)


def _as_change(number: str, after: str, before: str, numbers: Numbers) -> Check:
    """Return the check of a relative change; a mean of two decimals may have been used with three."""
    relative, mean = _relative(after, before), numbers[after]
    finer = [mean.value + k / 1000 for k in (-1, 1, -2, 2, -3, 3, -4, 4) if mean.decimals == 2]
    condition = after.partition("/")[2].removeprefix("mean.")

    def with_mean(value: float) -> Formula:
        label = f"the mean of {condition} was {value:.3f}, printed as {mean.printed}"
        return replace(relative, label=label, changed={"after": value})

    return Check(number, relative, explanations=tuple(map(with_mean, finer)))


def _claim(number: str, reading: str, after: str, before: str, numbers: Numbers) -> Check:
    """Return the check of a claim by its reading."""
    if reading == "range":
        return _by_range(number, after, before)
    if reading == "relative":
        return _as_change(number, after, before, numbers)
    return _in_points(number, after, before, 100.0 if reading == "share" else 1.0, numbers)


def _teleoperation(numbers: Numbers) -> list[Check]:
    """Return the checks of the claims of Chapter 3 that are made twice, and of the filter's gain under a growing delay."""
    both = "claim/section_3_9_5/tmig_and_omi_lower_tracking_error_against_mmi_by"
    mean = "teleop.{}/mean.{}".format
    omi, before = numbers[mean("tracking_error", "OMI")], mean("tracking_error", "MMI")
    tmig = _relative(mean("tracking_error", "TMIG"), before)
    used = (replace(tmig, label=f"the value of OMI, {omi.printed}, was used", changed={"after": omi.value}),)
    quantity = "{} lowers tracking error against MMI by [%]".format
    gain = Formula("√(1 − Ṫ_max)", {"T": "section_3_8_1/T_max"}, lambda v: np.sqrt(1.0 - v["T"]))
    return [
        Check(both, _relative(omi.id, before), quantity=quantity("OMI")),
        Check(both, tmig, explanations=used, suffix="/TMIG", quantity=quantity("TMIG")),
        Check("section_3_1/error", tmig, explanations=used),
        _in_points("section_3_1/workload", mean("tlx", "TMIG"), mean("tlx", "MMI"), 1.0, numbers),
        Check("claim/section_3_8_1/f_i_for_a_delay_growing_at_most_0_5_s_s", gain),
    ]


def _remark_seven(end: str) -> Check:
    """Return the check of a velocity and an error of Remark 7 by (2.4)."""
    ids = {"v": f"remark_7/v_{end}", "e": f"remark_7/e_{end}", "e_max": "section_2_2_2/e_max"}
    mean_of_products = (
        "(2.4) is a mean of products, which is below the product of the means where the robot is faster the farther "
        "it is from the path."
    )
    return Check(f"remark_7/P_r_{end}", Formula.of("v * (1 - e / e_max)", ids), binding=mean_of_products)


def claim_checks(numbers: Numbers) -> list[Check]:
    """Return the checks of the printed percentages and differences, and of Remark 7."""
    read = [_claim(x.id, reading, after, before, numbers) for x, reading, after, before in claims() if reading]
    return [*read, *_teleoperation(numbers), _remark_seven("min"), _remark_seven("max")]
