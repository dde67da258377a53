"""
Relations between printed numbers: what follows from what, and the range that other numbers allow.

A relation is a line of arithmetic: `Follows(number, text, lambda v: …)`, where * in the number
makes it a line for each that matches. v has the printed numbers by their own names: those of the
same participant, of the same study, or beside the number that is checked; k is the number of
conditions. `ids` says where a symbol stands otherwise, "./" beside the number, and a * there makes
it several.
"""

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import filter as matching
from typing import Any

import numpy as np
from scipy import stats

from trustlab.allocation.bounds import (
    PerformanceRange,
    performance_as_printed,
    utilization_as_printed,
)
from trustlab.allocation.limits import limits_as_printed
from trustlab.models.tsc import TscConstants, gain_of_human_performance, performance_weights
from trustlab.reproduction.audit.catalogue import PARTICIPANTS, rows_of
from trustlab.reproduction.audit.check import Allows, Follows, Formula, Numbers
from trustlab.reproduction.printed import greatest_sd
from trustlab.studies.anova import mauchly_factor, mauchly_p_value

INFINITE = float("inf")
POSITIVE = (1e-12, INFINITE)  # of a difference that must not be 0
AT_LEAST_0 = (0.0, INFINITE)


def robot_gain(v: Any) -> np.ndarray:
    """Return b_pr of (2.3)."""
    return gain_of_human_performance(v.a_pr, v.P_r_min, v.P_r_max, v.P_h_max)


def weights(v: Any) -> tuple[Any, Any]:
    """Return a_T and b_T."""
    return performance_weights(v.P_r_min, v.P_r_max, v.P_h_min, v.P_h_max)


def constants(v: Any, a_pr: Any, b_pr: Any) -> TscConstants:
    """Return the constants at printed parameters."""
    a_T, b_T = weights(v)
    return TscConstants(
        a_r=np.nan,  # no limit depends on a_r and β, and no bound on performance on b_pr, either
        beta=np.nan,
        p_h_min=v.P_h_min,
        p_h_max=v.P_h_max,
        a_pr=a_pr,
        b_pr=b_pr,
        p_r_min=v.P_r_min,
        p_r_max=v.P_r_max,
        a_T=a_T,
        b_T=b_T,
    )


def limits(v: Any, b_pr: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return TSC_lb and TSC_ub, (2.9)-(2.10), by a gain."""
    return limits_as_printed(constants(v, v.a_pr, b_pr), v.delta_P_h)


def performance(v: Any, a_pr: Any = np.nan, move: float = 0.0) -> PerformanceRange:
    """Return P_rl, P_ru (2.15), and dwell times, which alone need a_pr, by moved thresholds."""
    tsc = constants(v, a_pr, np.nan)
    return performance_as_printed(tsc, v.TSC_l + move, v.TSC_u + move, v.delta_TSC)


def utilization(v: Any, move: float = 0.0) -> tuple[np.ndarray, ...]:
    """Return r_l and r_u of (2.33), by thresholds that are moved."""
    p = performance(v, v.a_pr, move)
    r = utilization_as_printed(
        v.a_r, p.dwell_manual_low, p.dwell_manual_high, p.dwell_autonomous_high
    )
    return tuple(np.where(p.p_r_low < p.p_r_high, x, np.nan) for x in r)


def chi2_of_epsilon(
    epsilon: np.ndarray, n: float | np.ndarray, k: int, greatest: bool
) -> np.ndarray:
    """
    Return the least or greatest χ² of Mauchly that an ε of Greenhouse and Geisser leaves.

    W = ∏λ/(mean λ)^p and ε = (Σλ)²/(p Σλ²) of the same p = k − 1 eigenvalues; at given ε, W is
    extreme where all but one eigenvalue are equal, or one is 0.
    """
    p = k - 1
    # Eigenvalues of mean 1: one is 1 ± spread, the others share the rest, which gives Σλ² = p/ε.
    spread = np.sqrt(np.maximum(p / np.minimum(epsilon, 1.0) - p, 0.0) * (p - 1.0) / p)
    single = 1.0 - spread if greatest else 1.0 + spread
    equal = (p - single) / (p - 1.0)
    with np.errstate(all="ignore"):
        w = np.where((single > 0.0) & (equal > 0.0), single * equal ** (p - 1.0), 0.0)
        return -mauchly_factor(n, k) * np.log(w)


def step(v: Any, sign: float = 1.0) -> np.ndarray:
    """
    Return the largest step of TSC (Remark 3), or with −1 its expression as it stands, whose terms
    have opposite signs.
    """
    a_T, b_T = weights(v)
    return np.abs(a_T * v.delta_P_r + sign * b_T * v.delta_P_h)


def change(v: Any) -> np.ndarray:
    """Return a relative change in %."""
    return 100 * abs(v.after - v.before) / v.before


def lies_above(of: str, higher: str, lower: str, column: str) -> Follows:
    """Return that the means of some conditions of a table lie above those of others."""
    table, measure = column.split("/")
    mean = f"{table}/C[{{}}]/{measure}_mean".format
    return Follows(
        f"section_2_4_1_3/{of}",
        "min(above) − max(below)",
        lambda v: v.above.min(axis=0) - v.below.max(axis=0),
        ids={"above": mean(higher), "below": mean(lower)},
        target=POSITIVE,
    )


def spreads_apart(of: str, p: str, claim: str, **checked: Any) -> Follows:
    """Return how far the captured thresholds of a participant lie apart, less their SDs."""
    return Follows(
        f"section_2_4_1_3/{of}",
        "(μ_u − σ_u) − (μ_l + σ_l)",
        lambda v: v.u_mean - v.u_sd - v.l_mean - v.l_sd,
        ids={f"{end}_{x}": f"table_2.3/TSC_{end}.{x}/{p}" for end in "ul" for x in ("mean", "sd")},
        quantity=f"μ ± σ of TSC_l and TSC_u {claim}, participant {p}",
        **checked,
    )


def epsilon(v: Any) -> Any:
    """Return the printed ε, 1 where the degrees of freedom are not corrected."""
    return getattr(v, "ε", 1.0)


def against_mmi(scheme: str) -> dict[str, str]:
    """Return where the tracking errors of a scheme and of MMI stand."""
    mean = "teleop.tracking_error/mean.{}".format
    return {"after": mean(scheme), "before": mean("MMI")}


def analysed(v: Any) -> np.ndarray:
    """Return how many people are left."""
    return v.participants - v.dropped


def sd_limits(of: str, participants: str, low: float, high: float) -> Allows:
    """Return that an SD is at most that of scores at the ends of the scale, with the mean."""
    most = "all scores but one at the lowest"
    if high < INFINITE:
        most = f"all scores at the ends of the scale, {low:g} to {high:g}"

    ids = {"M": f"./{of.rpartition('/')[2]}_mean", "n": participants}
    return Allows(
        f"{of}_sd",
        f"0 … {most}",
        lambda v: (0, greatest_sd((v.M, v.M), v.n, (low, high))),
        ids=ids,
    )


def square(section: str, group: str, orders: int) -> Follows:
    """Return that participants fill whole squares of so many orders."""
    return Follows(
        f"{section}/square",
        f"participants modulo {orders}",
        lambda v: v.participants % orders,
        beside=group,
        target=(0.0, 0.0),
        note=f"A square balanced for order and carry-over has {orders} orders; those dropped "
        "break the balance.",
    )


def ranked(i: int, measure: str, sign: int) -> Follows:
    """Return that a scheme of Table 3.1 has its rank among all, 1 for the best."""
    return Follows(
        f"section_3_8_3/{SCHEMES[i]}_{measure}",
        f"rank of {SCHEMES[i]}, the best first",
        lambda v: 1.0 + (sign * v.x > sign * v.x[i]).sum(axis=0),
        ids={"x": f"table_3.1/*/{measure}_mean"},
    )


STEP = "a_T δ_Pr + b_T δ_Ph"
BEYOND = "Beyond the limits between which Theorem 1 guarantees switching"
UPPER = "a'_3 P_h + b'_3 (2.10)"
CHANGE = "100 |after − before|/before"
FIVE = {"x": "./[1-5]"}

LOWER = "lowers tracking error against MMI by [%]"
BOTH_LOWER = "claim/section_3_9_5/tmig_and_omi_lower_tracking_error_against_mmi_by"

SCHEMES = ("M", "MI", "MMI", "TMIG", "TMIS")
# Measures of Table 3.1, and 1 where more is better.
RANKED = (("error", -1), ("tlx", -1), ("trust", 1), ("preference", 1))

RELATIONS: tuple[Follows | Allows, ...] = (
    # Models, limits and bounds of the participants.
    Follows("*/b_r*", "1 − a_r", lambda v: 1 - v.a_r),
    Follows("*/b_pr*", "(1 − a_pr)(P_r_max − P_r_min)/P_h_max", robot_gain),
    Follows(
        "table_2.1/delta_TSC/*",
        STEP,
        step,
        explanations=(
            Formula(
                "a_T δ_Pr − b_T δ_Ph",
                lambda v: step(v, -1.0),
                "|a_T δ_Pr − b_T δ_Ph| was taken as it stands in Remark 3, whose maximum is the "
                "sum",
            ),
        ),
    ),
    Follows("claim/remark_3/delta_tsc_of_the_pilot_operator", STEP, step, beside="pilot"),
    Follows(
        "table_2.1/TSC_lb/*",
        "a_T b'_1 − b_T P_h_min (2.9)",
        lambda v: limits(v, robot_gain(v))[0],
    ),
    Follows(
        "table_2.1/TSC_ub/*",
        UPPER,
        lambda v: limits(v, v.b_pr)[1],
        "b_pr as printed",
        as_printed=("b_pr",),  # (2.3) ties it to the other parameters
        convention=Formula(
            UPPER,
            lambda v: limits(v, robot_gain(v))[1],
            "b_pr of (2.3), not rounded; it makes TSC_ub = −TSC_lb",
        ),
        explanations=tuple(
            Formula(
                UPPER,
                lambda v: limits(v, v.b_pr)[1],
                f"the b_pr of participant {other} was used",
                {"b_pr": f"table_2.1/b_pr/{other}"},
                ("b_pr",),
            )
            for other in PARTICIPANTS
        ),
        note="A b_pr that rounds as printed but does not obey (2.3) may reach further.",
    ),
    *(
        Allows(
            of,
            "TSC_lb (2.9) … TSC_ub (2.10)",
            lambda v: limits(v, v.b_pr),
            beside=beside,
            as_printed=("b_pr",),
            binding=binding,
        )
        for of, binding, beside in (
            ("table_2.2/TSC_[lu]/*", BEYOND, ""),
            ("section_2_5/TSC_*", f"Suspicious: {BEYOND}", "pilot"),
        )
    ),
    Allows(
        "table_2.3/TSC_u.mean/*",
        "TSC_lb … TSC_ub",
        lambda v: (v.TSC_lb, v.TSC_ub),
        binding=f"{BEYOND}. It is captured, and the condition is sufficient, not necessary",
    ),
    Allows(
        "*/delta_P_r*",
        "0 … (1 − a_pr)(P_r_max − P_r_min)",
        lambda v: (0, (1 - v.a_pr) * (v.P_r_max - v.P_r_min)),
    ),
    Follows("table_2.2/P_rl/*", "P_rl of (2.15)", lambda v: performance(v).p_r_low),
    Follows("table_2.2/P_ru/*", "P_ru of (2.15)", lambda v: performance(v).p_r_high),
    Follows(
        "table_2.2/r_l/*",
        "r_l of (2.33)",
        lambda v: utilization(v)[0],
        explanations=(
            Formula(
                "r_l at TSC_l + 0.10 and TSC_u + 0.10",
                lambda v: utilization(v, 0.10)[0],
                "thresholds were used that are both 0.10 higher than those printed",
            ),
        ),
    ),
    Follows("table_2.2/r_u/*", "r_u of (2.33)", lambda v: utilization(v)[1]),
    # Case study I.
    *(
        Follows(
            "section_2_4_1_2/enclose_beta",
            "min(β − r_l, r_u − β)",
            lambda v: np.minimum(v.β - v.r_l, v.r_u - v.β),
            suffix=f"/{p}",
            quantity=f"r_l ≤ β ≤ r_u, participant {p}",
            target=AT_LEAST_0,
        )
        for p in PARTICIPANTS
    ),
    *(
        Follows(
            "section_2_4_1_2/limits",
            "least gap in TSC_lb < TSC_l < TSC_u < TSC_ub",
            lambda v: np.min([v.TSC_l - v.TSC_lb, v.TSC_u - v.TSC_l, v.TSC_ub - v.TSC_u], axis=0),
            suffix=f"/{p}",
            quantity=f"TSC_lb < TSC_l < TSC_u < TSC_ub, participant {p}",
            target=POSITIVE,
        )
        for p in PARTICIPANTS
    ),
    *(
        spreads_apart("follow", p, "apart", suffix=f"/{p}", target=AT_LEAST_0)
        for p in PARTICIPANTS
        if p != "3"
    ),
    spreads_apart("not_distinguishable", "3", "overlap", target=(-INFINITE, 0.0)),
    Follows(
        "section_2_4_1_3/higher_sd",
        "σ_l + σ_u of participant 3 less the greatest of the others",
        lambda v: (v.l + v.u)[2] - np.delete(v.l + v.u, 2, axis=0).max(axis=0),
        ids={"l": "table_2.3/TSC_l.sd/*", "u": "table_2.3/TSC_u.sd/*"},
        target=POSITIVE,
    ),
    lies_above("trust", "23", "145", "table_2.4/trust"),
    lies_above("satisfaction", "23", "145", "table_2.4/satisfaction"),
    lies_above("workload", "145", "23", "table_2.4/tlx"),
    lies_above("robot_performance", "23", "1", "table_2.5/P_r"),
    lies_above("human_performance", "23", "1", "table_2.5/P_h"),
    lies_above("utilization", "1", "23", "table_2.5/r"),
    *(
        Allows(
            f"table_2.5/*/{p}_mean",
            f"mean of {p}_min of Table 2.1 … mean of {p}_max of Table 2.1",
            lambda v: (v.min.mean(axis=0), v.max.mean(axis=0)),
            ids={end: f"table_2.1/{p}_{end}/*" for end in ("min", "max")},
        )
        for p in ("P_r", "P_h")
    ),
    *(
        sd_limits(f"table_{measure}", f"section_{people}/participants", low, high)
        for measure, people, low, high in (
            ("2.4/*/tlx", "2_4_1_1", 0, 100),
            ("2.4/*/satisfaction", "2_4_1_1", 1, 5),
            ("2.5/*/r", "2_4_1_1", 0, 1),
            ("3.1/*/error", "3_8_2_1", 0, INFINITE),
            ("3.1/*/preference", "3_8_2_1", 1, 5),
            ("3.1/*/tlx", "3_8_2_1", 0, 100),
        )
    ),
    Follows("table_2.6/*/mean", "mean of the five", lambda v: v.x.mean(axis=0), ids=FIVE),
    Follows(
        "table_2.6/*/sd",
        "SD of the five",
        lambda v: v.x.std(axis=0, ddof=1),
        "divided by n − 1",
        ids=FIVE,
        convention=Formula("SD of the five", lambda v: v.x.std(axis=0), "divided by n"),
    ),
    # F, its degrees of freedom, ε, t and Mauchly's test of a study; each of ε and the degrees of
    # freedom follows from another.
    Follows("*/anova.p", "P(F(df1, df2) > F)", lambda v: stats.f.sf(v.F, v.df1, v.df2)),
    Follows(
        "*/anova.eta2",
        "F/(F + n − 1)",
        lambda v: v.F / (v.F + v.n - 1),
        "partial η²",
        convention=Formula(
            "F df1/(F df1 + df2)",
            lambda v: v.F * v.df1 / (v.F * v.df1 + v.df2),
            "partial η² with the printed df",
        ),
    ),
    Follows(
        "*/anova.df1",
        "df2/(n − 1)",
        lambda v: v.df2 / (v.n - 1),
        convention=Formula("(k − 1) ε", lambda v: (v.k - 1) * epsilon(v)),
    ),
    Follows(
        "*/anova.df2",
        "(k − 1) ε (n − 1)",
        lambda v: (v.k - 1) * epsilon(v) * (v.n - 1),
        convention=Formula("df1 (n − 1)", lambda v: v.df1 * (v.n - 1)),
    ),
    Follows(
        "*/epsilon",
        "df2/((k − 1)(n − 1))",
        lambda v: v.df2 / ((v.k - 1) * (v.n - 1)),
        convention=Formula("df1/(k − 1)", lambda v: v.df1 / (v.k - 1)),
    ),
    Follows("*/t_test.p", "2 P(t(n − 1) > t)", lambda v: 2 * stats.t.sf(v.t, v.n - 1)),
    Follows("*/mauchly.df", "k(k − 1)/2 − 1", lambda v: v.k * (v.k - 1) / 2 - 1),
    Follows(
        "*/mauchly.p",
        "P(χ²(df) > χ²) + ω [P(χ²(df + 4) > χ²) − P(χ²(df) > χ²)]",
        lambda v: mauchly_p_value(v.χ2, v.n, v.k),
        "second-order approximation, as statistical packages give it",
        convention=Formula(
            "P(χ²(df) > χ²)", lambda v: stats.chi2.sf(v.χ2, v.df), "first-order approximation"
        ),
    ),
    Follows(
        "*/sphericity",
        "p",
        lambda v: v.p_of_Mauchly,
        ids={"p_of_Mauchly": "./mauchly.p"},
        target={"met": (0.05, 1.0), "not met": (0.0, 0.05), "violated": (0.0, 0.05)},
        note="Sphericity is rejected below 0.05.",
    ),
    Allows(
        "*/mauchly.chi2",
        "least χ² at this ε … greatest χ² at this ε",
        lambda v: [chi2_of_epsilon(v.ε, v.n, v.k, greatest) for greatest in (False, True)],
    ),
    # Percentages and counts.
    Follows(
        "claim/section_3_8_1/f_i_for_a_delay_growing_at_most_0_5_s_s",
        "√(1 − Ṫ_max)",
        lambda v: (1 - v.T_max) ** 0.5,
        beside="section_3_8_1",
    ),
    *(
        Follows(
            f"remark_7/P_r_{end}",
            "v (1 − e/e_max)",
            lambda v: v.v * (1 - v.e / v.e_max),
            ids={"v": f"./v_{end}", "e": f"./e_{end}", "e_max": "section_2_2_2/e_max"},
            binding="(2.4) is a mean of products, which is below the product of the means where "
            "the robot is faster the farther it is from the path.",
        )
        for end in ("min", "max")
    ),
    Follows(
        "section_2_2_2/weights",
        "(W/T + 1)/(W/T)",
        lambda v: (v.W / v.T + 1) / (v.W / v.T),
        "W + 1 terms from k − W to k, divided by W",
    ),
    *(
        Follows(
            of,
            CHANGE,
            change,
            "relative change",
            against_mmi(scheme),
            explanations=(Formula(CHANGE, change, "OMI's value was used", against_mmi("OMI")),),
            suffix=suffix,
            quantity=quantity,
        )
        for of, suffix, scheme, quantity in (
            ("section_3_1/error", "", "TMIG", ""),
            (BOTH_LOWER, "", "OMI", f"OMI {LOWER}"),
            (BOTH_LOWER, "/TMIG", "TMIG", f"TMIG {LOWER}"),
        )
    ),
    *(
        Follows(of, f"number of {what}", lambda v: len(v.x), ids={"x": pattern}, note=note)
        for of, what, pattern, note in (
            (
                "section_2_4_2_4/anovas",
                "printed ANOVAs",
                "uav.*/anova.df1",
                "The seventh, uav.followed, has two conditions and was compared by a t-test.",
            ),
            ("section_3_9_4/anovas", "printed ANOVAs", "teleop.*/anova.df1", ""),
            (
                "section_2_4_1_2/variables",
                "printed measures of the UAV study, which has the same variables",
                "uav.*/n",
                "",
            ),
            ("section_3_8_2/levels", "rows of Table 3.1", "table_3.1/*/error_mean", ""),
        )
    ),
    Follows(
        "uav.*/n",
        "participants − dropped",
        analysed,
        beside="section_2_4_2_2",
        explanations=(
            Formula(
                "trials (participants − dropped)",
                lambda v: v.trials * analysed(v),
                "each trial of a person was counted as a person",
            ),
        ),
    ),
    Follows("teleop.*/n", "participants − dropped", analysed, beside="section_3_9_2"),
    square("section_2_4_2_2", "section_2_4_2_2", 10),
    square("section_3_9_3", "section_3_9_2", 4),
    # (3.10) at rest, of a handle of 50 g: no handle of a haptic device is so light.
    Allows(
        "section_3_*/B",
        "0.05 Λ … ∞",
        lambda v: (0.05 * v.Lambda, INFINITE),
        binding="Suspicious: by (3.10) B must be at least MΛ, here for a handle of 50 g, lighter "
        "than any that a hand holds",
    ),
    Follows("section_2_4_1_3/laps_in_all", "sets × laps", lambda v: v.sets * v.laps),
    Follows("section_*/participants", "female + male", lambda v: v.female + v.male),
    Follows(
        "section_3_8_2/variables",
        "objective + subjective",
        lambda v: v.objective + v.subjective,
    ),
    Follows(
        "section_3_9_1/levels",
        "df1 + 1",
        lambda v: v.df1 + 1,
        ids={"df1": "teleop.tlx/anova.df1"},
    ),
    Follows(
        "section_2_4_2_3/study",
        "study − (tutorial + identification + 5 trials task)/60",
        lambda v: v.study - (v.tutorial + v.identification + 5 * v.trials * v.task) / 60,
        "five conditions",
        beside="section_2_4_2_2",
        target=AT_LEAST_0,
        note="The rest is for questionnaires, consent and breaks.",
    ),
    # Nobody who is measured performs better than a perfect operator, u_h = u_i.
    Follows(
        "section_2_4_2/Z_Ph",
        "(u_i − u_h)/du_max at u_h = u_i, less the greatest printed mean",
        lambda v: -v.x.max(axis=0),
        ids={"x": "uav.human_performance/mean.*"},
        target=AT_LEAST_0,
        note="The means are printed as performance: a quality would be 1 − |u_i − u_h|/du_max.",
    ),
    Follows(
        "appendix_a/pd/p_xy",
        "x_damping (x_stiffness + x_gain d_xy) − x_gain p_xy",
        lambda v: v.x_damping * (v.x_stiffness + v.x_gain * v.d_xy) - v.x_gain * v.p_xy,
        "Routh: positive where the loop is stable",
        beside="appendix_a/model",
        suffix="/stable",
        target=AT_LEAST_0,
        note="The error rows of Appendix A with α = 0 diverge along x: the autonomous control "
        "alone is unstable.",
    ),
    # Ranks in Table 3.1.
    *(ranked(i, measure, sign) for i in range(len(SCHEMES)) for measure, sign in RANKED),
)

RELATIVE = Formula(CHANGE, change, "relative change")
PERCENT = "Printed with a % sign, which reads as a relative change; that would be {1:.1f} %."
# How a claim is read that compares two means, by its reading in statements.csv.
READINGS = {
    "relative": Follows("", CHANGE, change, "relative change"),
    "points": Follows(
        "",
        "|after − before|",
        lambda v: abs(v.after - v.before),
        "difference in units of the measure, printed as %",
        convention=RELATIVE,
        note=PERCENT,
    ),
    "share": Follows(
        "",
        "100 |after − before|",
        lambda v: 100 * abs(v.after - v.before),
        "percentage points",
        convention=RELATIVE,
        note=PERCENT,
    ),
    "range": Follows(
        "",
        "100 (after − before)/(P_r_max − P_r_min)",
        lambda v: 100 * (v.after - v.before) / (v.P_r_max - v.P_r_min),
        "difference of two values of (2.39)",
        convention=Formula(
            "100 (after − before)/(before − P_r_min)",
            lambda v: 100 * (v.after - v.before) / (v.before - v.P_r_min),
            "relative change of (2.39)",
        ),
    ),
}


def relations(numbers: Numbers) -> Iterator[Follows | Allows]:
    """Return every relation about every number that it matches, and the readings of claims."""
    for relation in RELATIONS:
        for id in matching(numbers, relation.of):
            yield replace(relation, of=id)
    for id, _, _, _, reading, after, before in rows_of("statements"):
        if reading:
            ids = {"after": after, "before": before}
            yield replace(READINGS[reading], of=id, ids=ids, beside="remark_7")
