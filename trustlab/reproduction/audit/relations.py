"""
Relations between printed numbers: what follows from what, and the range that other numbers allow.

A relation is a line of arithmetic: `Follows(text, lambda v: …, of=number)`. {p} stands for each
participant, {study} for each study of k conditions, {a} and {b} for each of its printed pairs. v
has the printed numbers by their own names: those of the same participant, of the same study, or
beside the number that is checked. `inputs` says where a symbol stands otherwise, and a * there
makes it several.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from scipy import stats

from trustlab.reproduction.audit.catalogue import PARTICIPANTS, conditions_of, study_names
from trustlab.reproduction.audit.check import (
    Check,
    Formula,
    NotPrintedError,
    Numbers,
    Possible,
    Values,
)
from trustlab.reproduction.audit.equations import (
    LIMIT_INPUTS,
    PERFORMANCE,
    RANGE_INPUTS,
    RATE_INPUTS,
    bounds,
    largest_step,
    limits,
    robot_gain,
)
from trustlab.studies.anova import mauchly_factor, mauchly_p_value

INFINITE = float("inf")
POSITIVE = (1e-12, INFINITE)  # of a difference that must not be 0

# Names of printed numbers that formulas write as letters.
LETTERS = {"epsilon": "ε", "chi2": "χ2", "beta": "β"}


@dataclass(frozen=True)
class Way:
    """A formula of a relation: its text, its arithmetic, and where its symbols stand."""

    text: str
    compute: Callable[[Any], Any]
    label: str = ""
    inputs: Mapping[str, str] = field(default_factory=dict)
    as_printed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Follows(Way):
    """
    How the number `of` is defined by others; `conventions` are other readings, tried in turn, and
    `explanations` mistakes, named only if they give the printed number.

    `target` has the ends that the result must lie between where they are not those of the printed
    number: by printed word, or a function of v and the printed value. `only` and `unless` name a
    number that must and must not be printed; `binding` says why a number that differs may still be
    right.
    """

    of: str = ""
    conventions: tuple[Way, ...] = ()
    explanations: tuple[Way, ...] = ()
    target: Any = None
    note: str = ""
    suffix: str = ""
    quantity: str = ""
    binding: str = ""
    participants: tuple[str, ...] = PARTICIPANTS
    studies: str = "*"
    only: str = ""
    unless: str = ""


@dataclass(frozen=True)
class Allows:
    """The range that other numbers leave the number `of`; {each} in `only` is every condition."""

    of: str
    least: Way
    most: Way
    only: str = ""
    suffix: str = ""
    quantity: str = ""
    participants: tuple[str, ...] = PARTICIPANTS
    studies: str = "*"
    unless: str = ""


def chi2_of_epsilon(epsilon: np.ndarray, n: np.ndarray, k: int, greatest: bool) -> np.ndarray:
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


def f_of_moments(v: Any, greatest: bool) -> np.ndarray:
    """Return F at an average correlation of −1/(k − 1), the least, or 1, the greatest."""
    means, sds = v.M, v.SD
    n = v.n
    k = len(means)
    variance = (sds**2).mean(axis=0)
    covariance = (sds.sum(axis=0) ** 2 - (sds**2).sum(axis=0)) / (k * (k - 1.0))
    error = variance - covariance if greatest else variance * k / (k - 1.0)
    return n * means.var(axis=0, ddof=1) / error


def t_of_moments(v: Any, correlation: int) -> np.ndarray:
    """Return the size of a paired t at a correlation of 1 (the greatest) or −1 (the least)."""
    means, sds = v.M, v.SD
    n = v.n
    sd = np.abs(sds[0] - correlation * sds[1])
    return np.abs(means[0] - means[1]) * np.sqrt(n) / np.maximum(sd, 1e-12)


def p_of_moments(v: Any, correlation: int, times: float) -> np.ndarray:
    """Return a paired t-test's p at a correlation, times a number of comparisons, at most 1."""
    p = 2.0 * stats.t.sf(t_of_moments(v, correlation), v.n - 1.0)
    return np.minimum(times * p, 1.0)


def b_pr(v: Any) -> np.ndarray:
    """Return b_pr by (2.3)."""
    return robot_gain(v.named("a_pr", "P_r_min", "P_r_max", "P_h_max"))


def upper_limit(v: Any, *gain: str) -> np.ndarray:
    """Return TSC_ub by (2.10), with b_pr where it is named, otherwise by (2.3)."""
    return limits(v.named(*LIMIT_INPUTS, *gain))["TSC_ub"]


def step(v: Any) -> np.ndarray:
    """Return the largest step of TSC (Remark 3)."""
    return largest_step(v.named(*PERFORMANCE, "delta_P_r", "delta_P_h"))


def step_of_difference(v: Any) -> np.ndarray:
    """Return Remark 3's expression as it stands, whose terms have opposite signs."""
    values = v.named(*PERFORMANCE, "delta_P_r", "delta_P_h")
    return largest_step(values | {"delta_P_h": -values["delta_P_h"]})


def change(v: Any) -> np.ndarray:
    """Return a relative change in %."""
    return 100 * abs(v.after - v.before) / v.before


def between_c2_c3_and_the_rest(v: Any) -> np.ndarray:
    """Return by how much the lesser of C2 and C3 exceeds all other conditions."""
    return np.minimum(v.x_C2, v.x_C3) - np.maximum(np.maximum(v.x_C1, v.x_C4), v.x_C5)


def gap_of_thresholds(v: Any) -> np.ndarray:
    """Return how far μ ± σ of the two thresholds of Table 2.3 lie apart."""
    return v.u_mean - v.u_sd - v.l_mean - v.l_sd


def spread_of_participant_3(v: Any) -> np.ndarray:
    """Return σ_l + σ_u of participant 3 less the greatest of the others."""
    sums = {p: getattr(v, f"l_{p}") + getattr(v, f"u_{p}") for p in "31245"}
    return sums["3"] - np.max([sums[p] for p in "1245"], axis=0)


STEP = "a_T δ_Pr + b_T δ_Ph"
GAIN = "(1 − a_pr)(P_r_max − P_r_min)/P_h_max"
UPPER = "a'_3 P_h + b'_3 (2.10)"
CHANGE = "100 |after − before|/before"
GREATEST_STEP = Way(
    "(1 − a_pr)(P_r_max − P_r_min)", lambda v: (1 - v.a_pr) * (v.P_r_max - v.P_r_min)
)
ZERO = Way("0", lambda v: 0)
FIVE = {c: {"x": f"table_2.6/{c}/[1-5]"} for c in ("C2", "C4")}
THRESHOLDS = {
    f"{end}_{kind}": f"table_2.3/TSC_{end}.{kind}/{{p}}" for end in "ul" for kind in ("mean", "sd")
}
APART = "(μ_u − σ_u) − (μ_l + σ_l)"
CELLS = {"M": "{study}/mean.*", "SD": "{study}/sd.*"}
PAIR = {
    f"{symbol}_{c}": f"{{study}}/{kind}.{{{c}}}"
    for symbol, kind in (("M", "mean"), ("SD", "sd"))
    for c in "ab"
}
OMI_USED = Way(
    CHANGE,
    change,
    "the value of OMI, {printed[teleop.tracking_error/mean.OMI]}, was used",
    {"after": "teleop.tracking_error/mean.OMI"},
)
MEAN_OF_PRODUCTS = (
    "(2.4) is a mean of products, which is below the product of the means where the robot is "
    "faster the farther it is from the path."
)


def against_mmi(scheme: str) -> dict[str, str]:
    """Return where the tracking errors of a scheme and of MMI stand."""
    mean = "teleop.tracking_error/mean.{}".format
    return {"after": mean(scheme), "before": mean("MMI")}


TABLE_2_1 = (
    Follows("1 − a_r", lambda v: 1 - v.a_r, of="table_2.1/b_r/{p}"),
    Follows("1 − a_r", lambda v: 1 - v.a_r, of="pilot/b_r"),
    Follows(GAIN, b_pr, of="table_2.1/b_pr/{p}"),
    Follows(GAIN, b_pr, of="pilot/b_pr"),
    Follows(
        STEP,
        step,
        of="table_2.1/delta_TSC/{p}",
        explanations=(
            Way(
                "a_T δ_Pr − b_T δ_Ph",
                step_of_difference,
                "|a_T δ_Pr − b_T δ_Ph| was taken as it stands in Remark 3, whose maximum is the "
                "sum",
            ),
        ),
    ),
    Follows(
        STEP,
        step,
        of="claim/remark_3/delta_tsc_of_the_pilot_operator",
        inputs={x: f"pilot/{x}" for x in (*PERFORMANCE, "delta_P_r", "delta_P_h")},
    ),
    Follows(
        "a_T b'_1 − b_T P_h_min (2.9)",
        lambda v: limits(v.named(*LIMIT_INPUTS))["TSC_lb"],
        of="table_2.1/TSC_lb/{p}",
    ),
    Follows(
        UPPER,
        lambda v: upper_limit(v, "b_pr"),
        "b_pr as printed",
        of="table_2.1/TSC_ub/{p}",
        as_printed=("b_pr",),  # (2.3) ties it to the other parameters
        conventions=(
            Way(UPPER, upper_limit, "b_pr of (2.3), not rounded; it makes TSC_ub = −TSC_lb"),
        ),
        explanations=tuple(
            Way(
                UPPER,
                lambda v: upper_limit(v, "b_pr"),
                f"the b_pr of participant {p} was used",
                {"b_pr": f"table_2.1/b_pr/{p}"},
                ("b_pr",),
            )
            for p in PARTICIPANTS
        ),
    ),
    Allows("table_2.1/delta_P_r/{p}", ZERO, GREATEST_STEP),
    Allows("pilot/delta_P_r", ZERO, GREATEST_STEP),
)

TABLES_2_2_AND_2_3 = (
    Follows(
        "P_rl of (2.15)", lambda v: bounds(v.named(*RANGE_INPUTS))["P_rl"], of="table_2.2/P_rl/{p}"
    ),
    Follows(
        "P_ru of (2.15)", lambda v: bounds(v.named(*RANGE_INPUTS))["P_ru"], of="table_2.2/P_ru/{p}"
    ),
    Follows(
        "r_l of (2.33)", lambda v: bounds(v.named(*RATE_INPUTS))["r_l"], of="table_2.2/r_l/{p}"
    ),
    Follows(
        "r_u of (2.33)", lambda v: bounds(v.named(*RATE_INPUTS))["r_u"], of="table_2.2/r_u/{p}"
    ),
    Follows(
        "min(β − r_l, r_u − β)",
        lambda v: np.minimum(v.β - v.r_l, v.r_u - v.β),
        of="section_2_4_1_2/enclose_beta",
        suffix="/{p}",
        quantity="r_l ≤ β ≤ r_u, participant {p}",
        target=(0.0, INFINITE),
    ),
    Follows(
        "least gap in TSC_lb < TSC_l < TSC_u < TSC_ub",
        lambda v: np.min(
            [v.TSC_l - v.TSC_lb, v.TSC_u - v.TSC_l, v.TSC_ub - v.TSC_u],
            axis=0,
        ),
        of="section_2_4_1_2/limits",
        suffix="/{p}",
        quantity="TSC_lb < TSC_l < TSC_u < TSC_ub, participant {p}",
        target=POSITIVE,
    ),
    Follows(
        APART,
        gap_of_thresholds,
        of="section_2_4_1_3/follow",
        inputs=THRESHOLDS,
        participants=("1", "2", "4", "5"),
        suffix="/{p}",
        quantity="μ ± σ of TSC_l and TSC_u apart, participant {p}",
        target=(0.0, INFINITE),
    ),
    Follows(
        APART,
        gap_of_thresholds,
        of="section_2_4_1_3/not_distinguishable",
        inputs=THRESHOLDS,
        participants=("3",),
        quantity="μ ± σ of TSC_l and TSC_u overlap, participant {p}",
        target=(-INFINITE, 0.0),
    ),
    Follows(
        "σ_l + σ_u of participant 3 less the greatest of the others",
        spread_of_participant_3,
        of="section_2_4_1_3/higher_sd",
        inputs={"l": "table_2.3/TSC_l.sd/*", "u": "table_2.3/TSC_u.sd/*"},
        target=POSITIVE,
    ),
)

TABLES_2_4_TO_2_6 = (
    *(
        Follows(
            "min(x_C2, x_C3) − max(x_C1, x_C4, x_C5)",
            between_c2_c3_and_the_rest,
            of=f"section_2_4_1_3/{measure}",
            inputs={"x": f"table_2.4/*/{measure}_mean"},
            target=POSITIVE,
        )
        for measure in ("trust", "satisfaction")
    ),
    Follows(
        "min(x_C1, x_C4, x_C5) − max(x_C2, x_C3)",
        lambda v: np.min([v.x_C1, v.x_C4, v.x_C5], axis=0) - np.maximum(v.x_C2, v.x_C3),
        of="section_2_4_1_3/workload",
        inputs={"x": "table_2.4/*/tlx_mean"},
        target=POSITIVE,
    ),
    *(
        Follows(
            "min(x_C2, x_C3) − x_C1",
            lambda v: np.minimum(v.x_C2, v.x_C3) - v.x_C1,
            of=f"section_2_4_1_3/{measure}_performance",
            inputs={"x": f"table_2.5/*/P_{measure[0]}_mean"},
            target=POSITIVE,
        )
        for measure in ("robot", "human")
    ),
    Follows(
        "x_C1 − max(x_C2, x_C3)",
        lambda v: v.x_C1 - np.maximum(v.x_C2, v.x_C3),
        of="section_2_4_1_3/utilization",
        inputs={"x": "table_2.5/*/r_mean"},
        target=POSITIVE,
    ),
    *(
        Follows(
            "mean of the five",
            lambda v: v.x.mean(axis=0),
            of=f"table_2.6/{condition}/mean",
            inputs=five,
        )
        for condition, five in FIVE.items()
    ),
    *(
        Follows(
            "SD of the five",
            lambda v: v.x.std(axis=0, ddof=1),
            "divided by n − 1",
            of=f"table_2.6/{condition}/sd",
            inputs=five,
            conventions=(Way("SD of the five", lambda v: v.x.std(axis=0), "divided by n", five),),
        )
        for condition, five in FIVE.items()
    ),
)

STUDIES = (
    Follows(
        "participants − dropped",
        lambda v: v.participants - v.dropped,
        of="{study}/n",
        studies="uav.*",
        inputs={x: f"section_2_4_2_2/{x}" for x in ("participants", "dropped", "trials")},
        explanations=(
            Way(
                "trials (participants − dropped)",
                lambda v: v.trials * (v.participants - v.dropped),
                "each trial of a person was counted as a person",
            ),
        ),
    ),
    Follows(
        "participants − dropped",
        lambda v: v.participants - v.dropped,
        of="{study}/n",
        studies="teleop.*",
        inputs={x: f"section_3_9_2/{x}" for x in ("participants", "dropped")},
    ),
    Follows("P(F(df1, df2) > F)", lambda v: stats.f.sf(v.F, v.df1, v.df2), of="{study}/anova.p"),
    Follows(
        "F/(F + n − 1)",
        lambda v: v.F / (v.F + v.n - 1),
        "partial η²",
        of="{study}/anova.eta2",
        conventions=(
            Way(
                "F df1/(F df1 + df2)",
                lambda v: v.F * v.df1 / (v.F * v.df1 + v.df2),
                "partial η² with the printed df",
            ),
        ),
    ),
    Follows("k − 1, k = {k}", lambda v: v.k - 1, of="{study}/anova.df1", unless="{study}/epsilon"),
    Follows(
        "(k − 1)(n − 1), k = {k}",
        lambda v: (v.k - 1) * (v.n - 1),
        of="{study}/anova.df2",
        unless="{study}/epsilon",
    ),
    # With an epsilon, each of it and the degrees of freedom follows from n and from the other.
    Follows(
        "df2/(n − 1)",
        lambda v: v.df2 / (v.n - 1),
        of="{study}/anova.df1",
        only="{study}/epsilon",
        conventions=(Way("{d} ε", lambda v: (v.k - 1) * v.ε),),
    ),
    Follows(
        "{d} ε (n − 1)",
        lambda v: (v.k - 1) * v.ε * (v.n - 1),
        of="{study}/anova.df2",
        only="{study}/epsilon",
        conventions=(Way("df1 (n − 1)", lambda v: v.df1 * (v.n - 1)),),
    ),
    Follows(
        "df2/({d} (n − 1))",
        lambda v: v.df2 / ((v.k - 1) * (v.n - 1)),
        of="{study}/epsilon",
        conventions=(Way("df1/{d}", lambda v: v.df1 / (v.k - 1)),),
    ),
    Allows(
        "{study}/anova.F",
        Way(
            "F at the least average correlation, −1/(k − 1)",
            lambda v: f_of_moments(v, greatest=False),
            inputs=CELLS,
        ),
        Way("F at correlations of 1", lambda v: f_of_moments(v, greatest=True), inputs=CELLS),
        only="{study}/mean.{each}",
    ),
    Follows(
        "k(k − 1)/2 − 1, k = {k}",
        lambda v: v.k * (v.k - 1) / 2 - 1,
        of="{study}/mauchly.df",
    ),
    Follows(
        "P(χ²(df) > χ²) + ω [P(χ²(df + 4) > χ²) − P(χ²(df) > χ²)]",
        lambda v: mauchly_p_value(v.χ2, v.n, v.k),
        "second-order approximation, as statistical packages give it",
        of="{study}/mauchly.p",
        conventions=(
            Way(
                "P(χ²(df) > χ²)",
                lambda v: stats.chi2.sf(v.χ2, v.df),
                "first-order approximation",
            ),
        ),
    ),
    Follows(
        "p",
        lambda v: v.p_of_Mauchly,
        of="{study}/sphericity",
        inputs={"p_of_Mauchly": "{study}/mauchly.p"},
        target={"met": (0.05, 1.0), "not met": (0.0, 0.05), "violated": (0.0, 0.05)},
        note="Sphericity is rejected below 0.05.",
    ),
    Allows(
        "{study}/mauchly.chi2",
        Way("least χ² at this ε", lambda v: chi2_of_epsilon(v.ε, v.n, v.k, False)),
        Way("greatest χ² at this ε", lambda v: chi2_of_epsilon(v.ε, v.n, v.k, True)),
    ),
    Follows("2 P(t(n − 1) > t)", lambda v: 2 * stats.t.sf(v.t, v.n - 1), of="{study}/t_test.p"),
    Allows(
        "{study}/t_test.t",
        Way("t at a correlation of −1", lambda v: t_of_moments(v, -1), inputs=CELLS),
        Way("t at a correlation of 1", lambda v: t_of_moments(v, 1), inputs=CELLS),
    ),
    Allows(
        "{study}/pairs.{a}-{b}",
        Way("p unadjusted at a correlation of 1", lambda v: p_of_moments(v, 1, 1), inputs=PAIR),
        Way(
            "{m} p (Bonferroni) at a correlation of −1",
            lambda v: p_of_moments(v, -1, v.k * (v.k - 1) // 2),
            inputs=PAIR,
        ),
    ),
)

PERCENTAGES_AND_COUNTS = (
    Follows(
        CHANGE,
        change,
        "relative change",
        against_mmi("OMI"),
        of="claim/section_3_9_5/tmig_and_omi_lower_tracking_error_against_mmi_by",
        quantity="OMI lowers tracking error against MMI by [%]",
    ),
    Follows(
        CHANGE,
        change,
        "relative change",
        against_mmi("TMIG"),
        of="claim/section_3_9_5/tmig_and_omi_lower_tracking_error_against_mmi_by",
        suffix="/TMIG",
        quantity="TMIG lowers tracking error against MMI by [%]",
        explanations=(OMI_USED,),
    ),
    Follows(
        CHANGE,
        change,
        "relative change",
        against_mmi("TMIG"),
        of="section_3_1/error",
        explanations=(OMI_USED,),
    ),
    Follows(
        "number of printed ANOVAs",
        lambda v: len(v.x),
        of="section_2_4_2_4/anovas",
        inputs={"x": "uav.*/anova.df1"},
        note="The seventh, uav.followed, has two conditions and was compared by a t-test.",
    ),
    Follows(
        "number of printed ANOVAs",
        lambda v: len(v.x),
        of="section_3_9_4/anovas",
        inputs={"x": "teleop.*/anova.df1"},
    ),
    Follows(
        "number of printed measures of the UAV study, which has the same variables",
        lambda v: len(v.x),
        of="section_2_4_1_2/variables",
        inputs={"x": "uav.*/n"},
    ),
    Follows(
        "number of rows of Table 3.1",
        lambda v: len(v.x),
        of="section_3_8_2/levels",
        inputs={"x": "table_3.1/*/error_mean"},
    ),
    # Nobody who is measured performs better than a perfect operator, u_h = u_i.
    Follows(
        "(u_i − u_h)/du_max at u_h = u_i",
        lambda v: 0 * v.x.max(axis=0),
        of="section_2_4_2/Z_Ph",
        inputs={"x": "uav.human_performance/mean.*"},
        target=lambda v, printed: (v.x.max(axis=0), INFINITE),
        note="The means are printed as performance: a quality would be 1 − |u_i − u_h|/du_max.",
    ),
    Follows(
        "(tutorial + identification + 5 trials task)/60",
        lambda v: (v.tutorial + v.identification + 5 * v.trials * v.task) / 60,
        "five conditions",
        {"trials": "section_2_4_2_2/trials"},
        of="section_2_4_2_3/study",
        target=lambda v, printed: (0.0, printed),
        note="The rest is for questionnaires, consent and breaks.",
    ),
    Follows(
        "√(1 − Ṫ_max)",
        lambda v: (1 - v.T) ** 0.5,
        of="claim/section_3_8_1/f_i_for_a_delay_growing_at_most_0_5_s_s",
        inputs={"T": "section_3_8_1/T_max"},
    ),
    *(
        Follows(
            "v (1 − e/e_max)",
            lambda v: v.v * (1 - v.e / v.e_max),
            of=f"remark_7/P_r_{end}",
            inputs={
                "v": f"remark_7/v_{end}",
                "e": f"remark_7/e_{end}",
                "e_max": "section_2_2_2/e_max",
            },
            binding=MEAN_OF_PRODUCTS,
        )
        for end in ("min", "max")
    ),
    Follows(
        "(W/T + 1)/(W/T)",
        lambda v: (v.W / v.T + 1) / (v.W / v.T),
        "W + 1 terms from k − W to k, divided by W",
        of="section_2_2_2/weights",
    ),
    Follows("sets × laps", lambda v: v.sets * v.laps, of="section_2_4_1_3/laps_in_all"),
    *(
        Follows("female + male", lambda v: v.female + v.male, of=f"{section}/participants")
        for section in ("section_2_4_2_2", "section_3_8_2_1", "section_3_9_2")
    ),
    Follows(
        "participants modulo 10",
        lambda v: v.participants % 10,
        of="section_2_4_2_2/square",
        target=(0.0, 0.0),
        note="A square balanced for order and carry-over has 10 orders; those dropped break the "
        "balance.",
    ),
    Follows(
        "objective + subjective",
        lambda v: v.objective + v.subjective,
        of="section_3_8_2/variables",
    ),
    Follows(
        "df1 + 1",
        lambda v: v.df1 + 1,
        of="section_3_9_1/levels",
        inputs={"df1": "teleop.tlx/anova.df1"},
    ),
    Follows(
        "participants modulo 4",
        lambda v: v.participants % 4,
        of="section_3_9_3/square",
        inputs={"participants": "section_3_9_2/participants"},
        target=(0.0, 0.0),
        note="A square balanced for order and carry-over has 4 orders; those dropped break the "
        "balance.",
    ),
    Follows(
        "damping (stiffness + gain d) − gain p",
        lambda v: v.damping * (v.stiffness + v.gain * v.d) - v.gain * v.p,
        "Routh: positive where the loop is stable",
        {
            "damping": "appendix_a/model/x_damping",
            "stiffness": "appendix_a/model/x_stiffness",
            "gain": "appendix_a/model/x_gain",
            "d": "appendix_a/pd/d_xy",
            "p": "appendix_a/pd/p_xy",
        },
        of="appendix_a/pd/p_xy",
        suffix="/stable",
        target=(0.0, INFINITE),
        note="The error rows of Appendix A with α = 0 diverge along x: the autonomous control "
        "alone is unstable.",
    ),
)

RELATIONS: tuple[Follows | Allows, ...] = (
    *TABLE_2_1,
    *TABLES_2_2_AND_2_3,
    *TABLES_2_4_TO_2_6,
    *STUDIES,
    *PERCENTAGES_AND_COUNTS,
)


def relations(numbers: Numbers, pattern: str = "*") -> Iterator[Check | Possible]:
    """
    Return every relation about a number whose id matches a pattern.

    A study need not print everything that its relations use; elsewhere an input that is not
    printed is a fault of the list.
    """
    for kind in (Follows, Allows):
        for relation in RELATIONS:
            if not isinstance(relation, kind):
                continue
            for context in _contexts(relation, numbers):
                number = relation.of.format_map(context)
                if number not in numbers or not fnmatchcase(number, pattern):
                    continue
                try:
                    if _applies(relation, context, numbers):
                        yield _checked(relation, number, context, numbers)
                except NotPrintedError as missing:
                    if "study" not in context:
                        raise ValueError(f"{number} has no input {missing}") from None


def _contexts(relation: Follows | Allows, numbers: Numbers) -> Iterator[dict]:
    """Return what a relation's placeholders stand for, one after the other."""
    named = relation.of + relation.suffix + relation.quantity
    if "{p}" in named:
        yield from ({"p": p} for p in relation.participants)
        return
    if "{study}" not in named:
        yield {}
        return
    for study in study_names(numbers):
        if not fnmatchcase(study, relation.studies):
            continue
        k = len(conditions_of(study))
        context = {"study": study, "k": k, "d": k - 1, "m": k * (k - 1) // 2}
        pairs = [id.rpartition(".")[2] for id in numbers if id.startswith(f"{study}/pairs.")]
        if "{a}" not in named:
            yield context
            continue
        for pair in pairs:
            a, _, b = pair.partition("-")
            yield context | {"a": a, "b": b}


def _applies(relation: Follows | Allows, context: dict, numbers: Numbers) -> bool:
    """Return whether the numbers are printed that a relation asks for."""
    each = conditions_of(context["study"]) if "{each}" in relation.only else [""]
    asked = [relation.only.format_map({**context, "each": c}) for c in each if relation.only]
    unless = relation.unless.format_map(context)
    return all(id in numbers for id in asked) and unless not in numbers


def _beside(number: str, context: dict, numbers: Numbers) -> dict[str, str]:
    """Return the numbers of the same participant or study, or in the same place, by name."""
    folder, ids = number.rpartition("/")[0], {}
    if "p" in context:
        for table in ("table_2.2", "table_2.1"):
            listed = [id.split("/") for id in numbers if id.startswith(f"{table}/")]
            ids |= {name: f"{table}/{name}/{p}" for _, name, p in listed if p == context["p"]}
    elif "study" in context:
        folder = context["study"]
        for test in ("t_test.", "mauchly.", "anova.", ""):
            start = f"{folder}/{test}"
            ids |= {id.removeprefix(start): id for id in numbers if id.startswith(start)}
    else:
        ids = {id.removeprefix(f"{folder}/"): id for id in numbers if id.startswith(f"{folder}/")}
    return {LETTERS.get(name, name): id for name, id in ids.items()}


def _checked(
    relation: Follows | Allows, number: str, context: dict, numbers: Numbers
) -> Check | Possible:
    """Return the check of one number."""
    beside = _beside(number, context, numbers)
    texts = context | {"printed": {id: number.printed for id, number in numbers.items()}}

    def formula(way: Way, ids: Mapping[str, str]) -> Formula:
        ids = {**ids, **_listed(way.inputs, context, numbers)}
        text, label = way.text.format_map(texts), way.label.format_map(texts)
        constants = {"k": context["k"]} if "k" in context else {}
        return Formula(
            text, way.compute, ids, label, as_printed=way.as_printed, constants=constants
        )

    if isinstance(relation, Allows):
        least, most = formula(relation.least, beside), formula(relation.most, beside)
        least.inputs(numbers), most.inputs(numbers)
        return Possible(number, least, most)
    first = formula(relation, beside)
    first.inputs(numbers)
    target = relation.target
    if isinstance(target, dict):
        target = target[numbers[number].printed]
    elif callable(target):
        target = target(Values(first.ids, lambda _, id: numbers[id].value), numbers[number].value)
    return Check(
        number,
        first,
        tuple(formula(way, first.ids) for way in relation.conventions),
        tuple(formula(way, first.ids) for way in relation.explanations),
        relation.note,
        relation.suffix.format_map(context),
        relation.quantity.format_map(context),
        relation.binding,
        target,
    )


def _listed(inputs: Mapping[str, str], context: dict, numbers: Numbers) -> dict[str, str]:
    """Return the ids of `inputs`; a pattern gives a symbol for each number that matches."""
    ids = {}
    for symbol, pattern in inputs.items():
        pattern = pattern.format_map(context)
        start = pattern.partition("*")[0].partition("[")[0]
        if pattern in numbers:
            ids[symbol] = pattern
            continue
        for id in numbers:
            if fnmatchcase(id, pattern):
                name, _, _ = id.removeprefix(start).partition("/")
                ids[f"{symbol}_{name}"] = id
    return ids
