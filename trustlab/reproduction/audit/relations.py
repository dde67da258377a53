"""
Relations between printed numbers: what follows from what, and the range that other numbers allow.

A relation is a line of arithmetic: `Follows(text, lambda v: …, of=number)`. v has the printed
numbers by their own names: those of the same participant, of the same study, or beside the number
that is checked. `ids` says where a symbol stands otherwise, and a * there makes it several.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import numpy as np
from scipy import stats

from trustlab.allocation.bounds import performance_as_printed, utilization_as_printed
from trustlab.allocation.limits import limits_as_printed
from trustlab.models.tsc import TscConstants, gain_of_human_performance, performance_weights
from trustlab.reproduction.audit.catalogue import PARTICIPANTS, conditions_of, study_names
from trustlab.reproduction.audit.check import (
    Allows,
    Follows,
    Formula,
    NotPrintedError,
    Numbers,
)
from trustlab.studies.anova import mauchly_factor, mauchly_p_value

INFINITE = float("inf")
POSITIVE = (1e-12, INFINITE)  # of a difference that must not be 0

# Names of printed numbers that formulas write as letters.
LETTERS = {"epsilon": "ε", "chi2": "χ2", "beta": "β"}

PERFORMANCE = ("P_r_min", "P_r_max", "P_h_min", "P_h_max")
LIMIT_INPUTS = (*PERFORMANCE, "a_pr", "delta_P_h")
RANGE_INPUTS = (*PERFORMANCE, "delta_TSC", "TSC_l", "TSC_u")
RATE_INPUTS = (*PERFORMANCE, "a_pr", "a_r", "delta_TSC", "TSC_l", "TSC_u")
BOUNDS = ("P_rl", "P_ru", "r_l", "r_u")


def robot_gain(v: dict) -> np.ndarray:
    """Return b_pr of (2.3) from a_pr, P_r_min, P_r_max and P_h_max."""
    return gain_of_human_performance(v["a_pr"], v["P_r_min"], v["P_r_max"], v["P_h_max"])


def constants(v: dict) -> TscConstants:
    """Return the constants at printed parameters; b_pr of (2.3) where it is not among them."""
    a_T, b_T = performance_weights(*(v[name] for name in PERFORMANCE))
    return TscConstants(
        a_r=v.get("a_r", np.nan),
        beta=np.nan,  # no limit and no bound depends on it
        p_h_min=v["P_h_min"],
        p_h_max=v["P_h_max"],
        a_pr=v["a_pr"],
        b_pr=v.get("b_pr", robot_gain(v)),
        p_r_min=v["P_r_min"],
        p_r_max=v["P_r_max"],
        a_T=a_T,
        b_T=b_T,
    )


def limits(v: dict) -> dict[str, np.ndarray]:
    """Return TSC_lb and TSC_ub, (2.9)-(2.10), and b_pr of (2.3)."""
    lower, upper = limits_as_printed(constants(v), v["delta_P_h"])
    return {"TSC_lb": lower, "TSC_ub": upper, "b_pr": robot_gain(v)}


def bounds(v: dict) -> dict[str, np.ndarray]:
    """
    Return P_rl, P_ru (2.15) and r_l, r_u (2.33).

    With b_pr among the parameters, c of (2.20) is b_pr P_h/(1 − a_pr); P_rl and P_ru need neither
    a_pr nor a_r.
    """
    v = {"a_pr": np.nan, "a_r": np.nan} | v
    rise = v["b_pr"] * v["P_h_max"] / (1.0 - v["a_pr"]) if "b_pr" in v else None
    p = performance_as_printed(constants(v), v["TSC_l"], v["TSC_u"], v["delta_TSC"], rise)
    r = utilization_as_printed(
        v["a_r"], p.dwell_manual_low, p.dwell_manual_high, p.dwell_autonomous_high
    )
    r_low, r_high = (np.where(p.p_r_low < p.p_r_high, x, np.nan) for x in r)
    return dict(zip(BOUNDS, (p.p_r_low, p.p_r_high, r_low, r_high), strict=True))


def bound(name: str) -> Callable[[Any], np.ndarray]:
    """Return how one of the four bounds is computed."""
    symbols = RATE_INPUTS if name.startswith("r") else RANGE_INPUTS
    return lambda v: bounds(v.named(*symbols))[name]


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


def f_of_moments(v: Any, k: int, greatest: bool) -> np.ndarray:
    """Return F at an average correlation of −1/(k − 1), the least, or 1, the greatest."""
    means, sds = v.M, v.SD
    if len(means) < k:
        raise NotPrintedError("a mean")
    variance = (sds**2).mean(axis=0)
    covariance = (sds.sum(axis=0) ** 2 - (sds**2).sum(axis=0)) / (k * (k - 1.0))
    error = variance - covariance if greatest else variance * k / (k - 1.0)
    return v.n * means.var(axis=0, ddof=1) / error


def t_of_moments(v: Any, correlation: int) -> np.ndarray:
    """Return the size of a paired t at a correlation of 1 (the greatest) or −1 (the least)."""
    means, sds = v.M, v.SD
    sd = np.abs(sds[0] - correlation * sds[1])
    return np.abs(means[0] - means[1]) * np.sqrt(v.n) / np.maximum(sd, 1e-12)


def p_of_moments(v: Any, correlation: int, times: float) -> np.ndarray:
    """Return a paired t-test's p at a correlation, times a number of comparisons, at most 1."""
    p = 2.0 * stats.t.sf(t_of_moments(v, correlation), v.n - 1.0)
    return np.minimum(times * p, 1.0)


def gain(v: Any) -> np.ndarray:
    """Return b_pr by (2.3)."""
    return robot_gain(v.named("a_pr", "P_r_min", "P_r_max", "P_h_max"))


def upper_limit(v: Any, *gain: str) -> np.ndarray:
    """Return TSC_ub by (2.10), with b_pr where it is named, otherwise by (2.3)."""
    return limits(v.named(*LIMIT_INPUTS, *gain))["TSC_ub"]


def step(v: Any, sign: float = 1.0) -> np.ndarray:
    """
    Return the largest step of TSC (Remark 3), or with −1 its expression as it stands, whose terms
    have opposite signs.
    """
    a_T, b_T = performance_weights(*v.named(*PERFORMANCE).values())
    return np.abs(a_T * v.delta_P_r + sign * b_T * v.delta_P_h)


def change(v: Any) -> np.ndarray:
    """Return a relative change in %."""
    return 100 * abs(v.after - v.before) / v.before


def above(of: str, higher: str, lower: str, column: str) -> Follows:
    """Return that the means of some conditions lie above those of others."""

    def end(word: str, conditions: str) -> str:
        names = [f"x_C{c}" for c in conditions]
        return f"{word}({', '.join(names)})" if len(names) > 1 else names[0]

    return Follows(
        f"{end('min', higher)} − {end('max', lower)}",
        lambda v: (
            np.min([getattr(v, f"x_C{c}") for c in higher], axis=0)
            - np.max([getattr(v, f"x_C{c}") for c in lower], axis=0)
        ),
        of=f"section_2_4_1_3/{of}",
        ids={"x": f"table_2.{column}_mean"},
        target=POSITIVE,
    )


def participants_left(v: Any, orders: int) -> np.ndarray:
    """Return how many participants are more than the last whole square of orders needs."""
    return v.participants % orders


def spread_of_participant_3(v: Any) -> np.ndarray:
    """Return σ_l + σ_u of participant 3 less the greatest of the others."""
    sums = {p: getattr(v, f"l_{p}") + getattr(v, f"u_{p}") for p in "31245"}
    return sums["3"] - np.max([sums[p] for p in "1245"], axis=0)


STEP = "a_T δ_Pr + b_T δ_Ph"
GAIN = "(1 − a_pr)(P_r_max − P_r_min)/P_h_max"
UPPER = "a'_3 P_h + b'_3 (2.10)"
CHANGE = "100 |after − before|/before"
GREATEST_STEP = Formula(
    "(1 − a_pr)(P_r_max − P_r_min)", lambda v: (1 - v.a_pr) * (v.P_r_max - v.P_r_min)
)
ZERO = Formula("0", lambda v: 0)
FIVE = {c: {"x": f"table_2.6/{c}/[1-5]"} for c in ("C2", "C4")}
MEAN_OF_PRODUCTS = (
    "(2.4) is a mean of products, which is below the product of the means where the robot is "
    "faster the farther it is from the path."
)


def against_mmi(scheme: str) -> dict[str, str]:
    """Return where the tracking errors of a scheme and of MMI stand."""
    mean = "teleop.tracking_error/mean.{}".format
    return {"after": mean(scheme), "before": mean("MMI")}


def of_participant(p: str) -> Iterator[Follows | Allows]:
    """Return the relations of Tables 2.1 and 2.2 about a participant."""
    yield Follows("1 − a_r", lambda v: 1 - v.a_r, of=f"table_2.1/b_r/{p}")
    yield Follows(GAIN, gain, of=f"table_2.1/b_pr/{p}")
    yield Follows(
        STEP,
        step,
        of=f"table_2.1/delta_TSC/{p}",
        explanations=(
            Formula(
                "a_T δ_Pr − b_T δ_Ph",
                lambda v: step(v, -1.0),
                "|a_T δ_Pr − b_T δ_Ph| was taken as it stands in Remark 3, whose maximum is the "
                "sum",
            ),
        ),
    )
    yield Follows(
        "a_T b'_1 − b_T P_h_min (2.9)",
        lambda v: limits(v.named(*LIMIT_INPUTS))["TSC_lb"],
        of=f"table_2.1/TSC_lb/{p}",
    )
    yield Follows(
        UPPER,
        lambda v: upper_limit(v, "b_pr"),
        "b_pr as printed",
        of=f"table_2.1/TSC_ub/{p}",
        as_printed=("b_pr",),  # (2.3) ties it to the other parameters
        conventions=(
            Formula(UPPER, upper_limit, "b_pr of (2.3), not rounded; it makes TSC_ub = −TSC_lb"),
        ),
        explanations=tuple(
            Formula(
                UPPER,
                lambda v: upper_limit(v, "b_pr"),
                f"the b_pr of participant {other} was used",
                {"b_pr": f"table_2.1/b_pr/{other}"},
                ("b_pr",),
            )
            for other in PARTICIPANTS
        ),
    )
    yield Allows(of=f"table_2.1/delta_P_r/{p}", least=ZERO, most=GREATEST_STEP)
    for name in BOUNDS:
        equation = "(2.33)" if name.startswith("r") else "(2.15)"
        yield Follows(f"{name} of {equation}", bound(name), of=f"table_2.2/{name}/{p}")


def thresholds_of(p: str) -> Iterator[Follows]:
    """Return what the text says of the thresholds of a participant."""
    yield Follows(
        "min(β − r_l, r_u − β)",
        lambda v: np.minimum(v.β - v.r_l, v.r_u - v.β),
        of="section_2_4_1_2/enclose_beta",
        suffix=f"/{p}",
        quantity=f"r_l ≤ β ≤ r_u, participant {p}",
        target=(0.0, INFINITE),
    )
    yield Follows(
        "least gap in TSC_lb < TSC_l < TSC_u < TSC_ub",
        lambda v: np.min([v.TSC_l - v.TSC_lb, v.TSC_u - v.TSC_l, v.TSC_ub - v.TSC_u], axis=0),
        of="section_2_4_1_2/limits",
        suffix=f"/{p}",
        quantity=f"TSC_lb < TSC_l < TSC_u < TSC_ub, participant {p}",
        target=POSITIVE,
    )
    ends = {end: f"table_2.3/TSC_{end}" for end in "ul"}
    apart = Follows(
        "(μ_u − σ_u) − (μ_l + σ_l)",
        lambda v: v.u_mean - v.u_sd - v.l_mean - v.l_sd,
        ids={f"{end}_{x}": f"{id}.{x}/{p}" for end, id in ends.items() for x in ("mean", "sd")},
        of="section_2_4_1_3/follow",
        suffix=f"/{p}",
        quantity=f"μ ± σ of TSC_l and TSC_u apart, participant {p}",
        target=(0.0, INFINITE),
    )
    if p == "3":
        apart = replace(
            apart,
            of="section_2_4_1_3/not_distinguishable",
            suffix="",
            quantity="μ ± σ of TSC_l and TSC_u overlap, participant 3",
            target=(-INFINITE, 0.0),
        )
    yield apart


PILOT_AND_THRESHOLDS = (
    Follows("1 − a_r", lambda v: 1 - v.a_r, of="pilot/b_r"),
    Follows(GAIN, gain, of="pilot/b_pr"),
    Follows(
        STEP,
        step,
        of="claim/remark_3/delta_tsc_of_the_pilot_operator",
        ids={x: f"pilot/{x}" for x in (*PERFORMANCE, "delta_P_r", "delta_P_h")},
    ),
    Allows(of="pilot/delta_P_r", least=ZERO, most=GREATEST_STEP),
    Follows(
        "σ_l + σ_u of participant 3 less the greatest of the others",
        spread_of_participant_3,
        of="section_2_4_1_3/higher_sd",
        ids={"l": "table_2.3/TSC_l.sd/*", "u": "table_2.3/TSC_u.sd/*"},
        target=POSITIVE,
    ),
)

TABLES_2_4_TO_2_6 = (
    above("trust", "23", "145", "4/*/trust"),
    above("satisfaction", "23", "145", "4/*/satisfaction"),
    above("workload", "145", "23", "4/*/tlx"),
    above("robot_performance", "23", "1", "5/*/P_r"),
    above("human_performance", "23", "1", "5/*/P_h"),
    above("utilization", "1", "23", "5/*/r"),
    *(
        Follows(
            "mean of the five",
            lambda v: v.x.mean(axis=0),
            of=f"table_2.6/{condition}/mean",
            ids=five,
        )
        for condition, five in FIVE.items()
    ),
    *(
        Follows(
            "SD of the five",
            lambda v: v.x.std(axis=0, ddof=1),
            "divided by n − 1",
            of=f"table_2.6/{condition}/sd",
            ids=five,
            conventions=(Formula("SD of the five", lambda v: v.x.std(axis=0), "divided by n"),),
        )
        for condition, five in FIVE.items()
    ),
)


def of_section(numbers: Numbers) -> Iterator[Follows]:
    """Return the relations about statements that are compared with, or rest on, other numbers."""
    omi = numbers["teleop.tracking_error/mean.OMI"]
    used = Formula(CHANGE, change, f"the value of OMI, {omi.printed}, was used", {"after": omi.id})
    lower = Follows(
        CHANGE,
        change,
        "relative change",
        against_mmi("TMIG"),
        of="section_3_1/error",
        explanations=(used,),
    )
    yield lower
    claim = "claim/section_3_9_5/tmig_and_omi_lower_tracking_error_against_mmi_by"
    for scheme, suffix in (("OMI", ""), ("TMIG", "/TMIG")):
        yield replace(
            lower,
            ids=against_mmi(scheme),
            of=claim,
            suffix=suffix,
            quantity=f"{scheme} lowers tracking error against MMI by [%]",
        )
    means = [x.value for id, x in numbers.items() if id.startswith("uav.human_performance/mean.")]
    # Nobody who is measured performs better than a perfect operator, u_h = u_i.
    yield Follows(
        "(u_i − u_h)/du_max at u_h = u_i",
        lambda v: 0 * v.x.max(axis=0),
        of="section_2_4_2/Z_Ph",
        ids={"x": "uav.human_performance/mean.*"},
        target=(max(means), INFINITE),
        note="The means are printed as performance: a quality would be 1 − |u_i − u_h|/du_max.",
    )
    study = "section_2_4_2_3/study"
    yield Follows(
        "(tutorial + identification + 5 trials task)/60",
        lambda v: (v.tutorial + v.identification + 5 * v.trials * v.task) / 60,
        "five conditions",
        {"trials": "section_2_4_2_2/trials"},
        of=study,
        target=(0.0, numbers[study].value),
        note="The rest is for questionnaires, consent and breaks.",
    )


def of_study(study: str, numbers: Numbers) -> Iterator[Follows | Allows]:
    """Return the relations about F, its degrees of freedom, t and the number of subjects."""
    d = len(conditions_of(study)) - 1
    of = f"{study}/{{}}".format
    cells = {"M": of("mean.*"), "SD": of("sd.*")}
    section = "section_3_9_2"
    trials: tuple[Formula, ...] = ()
    if study.startswith("uav."):
        section = "section_2_4_2_2"
        counted = Formula(
            "trials (participants − dropped)",
            lambda v: v.trials * (v.participants - v.dropped),
            "each trial of a person was counted as a person",
        )
        trials = (counted,)
    yield Follows(
        "participants − dropped",
        lambda v: v.participants - v.dropped,
        of=of("n"),
        ids={x: f"{section}/{x}" for x in ("participants", "dropped", "trials")},
        explanations=trials,
    )
    yield Follows("P(F(df1, df2) > F)", lambda v: stats.f.sf(v.F, v.df1, v.df2), of=of("anova.p"))
    eta2 = Formula(
        "F df1/(F df1 + df2)",
        lambda v: v.F * v.df1 / (v.F * v.df1 + v.df2),
        "partial η² with the printed df",
    )
    yield Follows(
        "F/(F + n − 1)",
        lambda v: v.F / (v.F + v.n - 1),
        "partial η²",
        of=of("anova.eta2"),
        conventions=(eta2,),
    )
    yield from degrees_of_freedom(of, d, of("epsilon") in numbers)
    yield Allows(
        of=of("anova.F"),
        least=Formula(
            "F at the least average correlation, −1/(k − 1)",
            lambda v: f_of_moments(v, d + 1, greatest=False),
            ids=cells,
        ),
        most=Formula(
            "F at correlations of 1", lambda v: f_of_moments(v, d + 1, greatest=True), ids=cells
        ),
    )
    yield Follows("2 P(t(n − 1) > t)", lambda v: 2 * stats.t.sf(v.t, v.n - 1), of=of("t_test.p"))
    yield Allows(
        of=of("t_test.t"),
        least=Formula("t at a correlation of −1", lambda v: t_of_moments(v, -1), ids=cells),
        most=Formula("t at a correlation of 1", lambda v: t_of_moments(v, 1), ids=cells),
    )


def degrees_of_freedom(of: Callable[[str], str], d: int, corrected: bool) -> Iterator[Follows]:
    """Return the relations about degrees of freedom and ε; with an ε, each follows from another."""
    if not corrected:
        text = f"k = {d + 1}"
        yield Follows(f"k − 1, {text}", lambda v: d, of=of("anova.df1"))
        yield Follows(f"(k − 1)(n − 1), {text}", lambda v: d * (v.n - 1), of=of("anova.df2"))
        return
    yield Follows(
        "df2/(n − 1)",
        lambda v: v.df2 / (v.n - 1),
        of=of("anova.df1"),
        conventions=(Formula(f"{d} ε", lambda v: d * v.ε),),
    )
    yield Follows(
        f"{d} ε (n − 1)",
        lambda v: d * v.ε * (v.n - 1),
        of=of("anova.df2"),
        conventions=(Formula("df1 (n − 1)", lambda v: v.df1 * (v.n - 1)),),
    )
    yield Follows(
        f"df2/({d} (n − 1))",
        lambda v: v.df2 / (d * (v.n - 1)),
        of=of("epsilon"),
        conventions=(Formula(f"df1/{d}", lambda v: v.df1 / d),),
    )


def of_sphericity(study: str, numbers: Numbers) -> Iterator[Follows | Allows]:
    """Return the relations about Mauchly's test."""
    k = len(conditions_of(study))
    of = f"{study}/{{}}".format
    yield Follows(f"k(k − 1)/2 − 1, k = {k}", lambda v: k * (k - 1) / 2 - 1, of=of("mauchly.df"))
    first_order = Formula(
        "P(χ²(df) > χ²)", lambda v: stats.chi2.sf(v.χ2, v.df), "first-order approximation"
    )
    yield Follows(
        "P(χ²(df) > χ²) + ω [P(χ²(df + 4) > χ²) − P(χ²(df) > χ²)]",
        lambda v: mauchly_p_value(v.χ2, v.n, k),
        "second-order approximation, as statistical packages give it",
        of=of("mauchly.p"),
        conventions=(first_order,),
    )
    if of("sphericity") in numbers:
        met = numbers[of("sphericity")].printed == "met"
        yield Follows(
            "p",
            lambda v: v.p_of_Mauchly,
            of=of("sphericity"),
            ids={"p_of_Mauchly": of("mauchly.p")},
            target=(0.05, 1.0) if met else (0.0, 0.05),
            note="Sphericity is rejected below 0.05.",
        )
    yield Allows(
        of=of("mauchly.chi2"),
        least=Formula("least χ² at this ε", lambda v: chi2_of_epsilon(v.ε, v.n, k, False)),
        most=Formula("greatest χ² at this ε", lambda v: chi2_of_epsilon(v.ε, v.n, k, True)),
    )


def of_pairs(study: str, numbers: Numbers) -> Iterator[Allows]:
    """Return the relations about pairs of conditions."""
    k = len(conditions_of(study))
    m = k * (k - 1) // 2
    start = f"{study}/pairs."
    for id in [id for id in numbers if id.startswith(start)]:
        pair = zip("ab", id.removeprefix(start).split("-"), strict=True)
        ids = {"n": f"{study}/n"}
        for letter, condition in pair:
            ids |= {f"M_{letter}": f"{study}/mean.{condition}"}
            ids |= {f"SD_{letter}": f"{study}/sd.{condition}"}
        yield Allows(
            of=id,
            least=Formula(
                "p unadjusted at a correlation of 1", lambda v: p_of_moments(v, 1, 1), ids=ids
            ),
            most=Formula(
                f"{m} p (Bonferroni) at a correlation of −1",
                lambda v: p_of_moments(v, -1, m),
                ids=ids,
            ),
        )


# What is counted, where, and the numbers of which there should be as many.
COUNTED = (
    ("printed ANOVAs", "section_2_4_2_4/anovas", "uav.*/anova.df1"),
    ("printed ANOVAs", "section_3_9_4/anovas", "teleop.*/anova.df1"),
    (
        "printed measures of the UAV study, which has the same variables",
        "section_2_4_1_2/variables",
        "uav.*/n",
    ),
    ("rows of Table 3.1", "section_3_8_2/levels", "table_3.1/*/error_mean"),
)
SEVENTH = "The seventh, uav.followed, has two conditions and was compared by a t-test."

PERCENTAGES_AND_COUNTS = (
    Follows(
        "√(1 − Ṫ_max)",
        lambda v: (1 - v.T) ** 0.5,
        of="claim/section_3_8_1/f_i_for_a_delay_growing_at_most_0_5_s_s",
        ids={"T": "section_3_8_1/T_max"},
    ),
    *(
        Follows(
            "v (1 − e/e_max)",
            lambda v: v.v * (1 - v.e / v.e_max),
            of=f"remark_7/P_r_{end}",
            ids={
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
    *(
        Follows(
            f"number of {counted}",
            lambda v: len(v.x),
            of=of,
            ids={"x": pattern},
            note=SEVENTH if of == "section_2_4_2_4/anovas" else "",
        )
        for counted, of, pattern in COUNTED
    ),
    *(
        Follows(
            f"participants modulo {orders}",
            partial(participants_left, orders=orders),
            of=f"{section}/square",
            ids={"participants": f"{group}/participants"},
            target=(0.0, 0.0),
            note=f"A square balanced for order and carry-over has {orders} orders; those dropped "
            "break the balance.",
        )
        for section, group, orders in (
            ("section_2_4_2_2", "section_2_4_2_2", 10),
            ("section_3_9_3", "section_3_9_2", 4),
        )
    ),
    Follows("sets × laps", lambda v: v.sets * v.laps, of="section_2_4_1_3/laps_in_all"),
    *(
        Follows("female + male", lambda v: v.female + v.male, of=f"{section}/participants")
        for section in ("section_2_4_2_2", "section_3_8_2_1", "section_3_9_2")
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
        ids={"df1": "teleop.tlx/anova.df1"},
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

STATEMENTS: tuple[Follows | Allows, ...] = (
    *PILOT_AND_THRESHOLDS,
    *TABLES_2_4_TO_2_6,
    *PERCENTAGES_AND_COUNTS,
)


def relations(numbers: Numbers, pattern: str = "*") -> Iterator[Follows | Allows]:
    """
    Return every relation about a number whose id matches a pattern.

    A study need not print everything that its relations use.
    """
    groups: list[tuple[Iterable[Follows | Allows], dict[str, str]]] = []
    for p in PARTICIPANTS:
        beside = _named(("table_2.2/", "table_2.1/"), numbers, f"/{p}")
        groups += [(of_participant(p), beside), (thresholds_of(p), beside)]
    for study in study_names(numbers):
        starts = tuple(f"{study}/{test}" for test in ("t_test.", "mauchly.", "anova.", ""))
        beside = _named(starts, numbers)
        groups += [(about(study, numbers), beside) for about in (of_study, of_sphericity, of_pairs)]
    for statement in (*STATEMENTS, *of_section(numbers)):
        folder = statement.of.rpartition("/")[0]
        groups.append(([statement], _named((f"{folder}/",), numbers)))
    for group, beside in groups:
        for relation in group:
            if relation.of in numbers and fnmatchcase(relation.of, pattern):
                with suppress(NotPrintedError):
                    yield _completed(relation, beside, numbers)


def related(number: str, numbers: Numbers) -> Follows:
    """Return the first relation that a number follows from."""
    return next(check for check in relations(numbers, number) if isinstance(check, Follows))


def _named(starts: tuple[str, ...], numbers: Numbers, end: str = "") -> dict[str, str]:
    """Return ids by the names that formulas use, without their beginning and end."""
    ids = {}
    for start in starts:
        for id in numbers:
            if id.startswith(start) and id.endswith(end):
                name = id.removeprefix(start).removesuffix(end)
                ids[LETTERS.get(name, name)] = id
    return ids


def _completed(
    relation: Follows | Allows, beside: Mapping[str, str], numbers: Numbers
) -> Follows | Allows:
    """Return a relation whose formulas say where all their symbols stand."""

    def formula(way: Formula, ids: Mapping[str, str]) -> Any:
        way = replace(way, ids={**ids, **_listed(way.ids, numbers)})
        way.inputs(numbers)  # all of them are printed
        return way

    if isinstance(relation, Allows):
        ends = formula(relation.least, beside), formula(relation.most, beside)
        return replace(relation, least=ends[0], most=ends[1])
    first = formula(relation, beside)
    return replace(
        first,
        conventions=tuple(formula(way, first.ids) for way in relation.conventions),
        explanations=tuple(formula(way, first.ids) for way in relation.explanations),
    )


def _listed(ids: Mapping[str, str], numbers: Numbers) -> dict[str, str]:
    """Return ids by symbol; a pattern gives a symbol for each number that matches."""
    listed = {}
    for symbol, pattern in ids.items():
        if pattern in numbers:
            listed[symbol] = pattern
            continue
        start = pattern.partition("*")[0].partition("[")[0]
        for id in numbers:
            if fnmatchcase(id, pattern):
                name, _, _ = id.removeprefix(start).partition("/")
                listed[f"{symbol}_{name}"] = id
    return listed
