"""
The audit of the eleven printed studies: degrees of freedom, p-values, effect sizes, sphericity,
pairs and duplicates.
"""

from collections import Counter
from itertools import combinations

import numpy as np
from scipy import stats

from trustlab.reproduction.audit.catalogue import conditions_of, study_names
from trustlab.reproduction.audit.verdict import (
    Check,
    Finding,
    Formula,
    Numbers,
    Possible,
    Remark,
    Row,
    listing,
    row_about,
)
from trustlab.reproduction.printed_number import PrintedNumber
from trustlab.studies.analysis.sphericity import mauchly_factor, mauchly_p_value

ALPHA = 0.05


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
    others = (p - single) / (p - 1.0)
    with np.errstate(all="ignore"):
        w = np.where((single > 0.0) & (others > 0.0), single * others ** (p - 1.0), 0.0)
        return -mauchly_factor(n, k) * np.log(w)


# What the symbols of formulas stand for within a study.
SYMBOLS = {
    "F": "anova.F",
    "df1": "anova.df1",
    "df2": "anova.df2",
    "n": "n",
    "p": "mauchly.p",
    "ε": "epsilon",
}


def _ids(name: str) -> dict[str, str]:
    return {symbol: f"{name}/{entry}" for symbol, entry in SYMBOLS.items()}


def _anova(name: str, numbers: Numbers, k: int) -> list[Check]:
    """
    Return the checks of a study's p, partial η², degrees of freedom and ε; each of the last by n
    and by the other.
    """
    ids, d = _ids(name), k - 1

    def check(symbol: str, first: str, *others: str) -> Check:
        return Check(ids[symbol], Formula.of(first, ids), tuple(Formula.of(x, ids) for x in others))

    inputs = {symbol: ids[symbol] for symbol in ("F", "df1", "df2")}
    tail = Formula("P(F(df1, df2) > F)", inputs, lambda v: stats.f.sf(v["F"], v["df1"], v["df2"]))
    eta2 = Formula.of("F / (F + n - 1)", ids, "partial η²")
    by_df = Formula.of("F * df1 / (F * df1 + df2)", ids, "partial η² with the printed df")
    checks = [Check(f"{name}/anova.p", tail), Check(f"{name}/anova.eta2", eta2, (by_df,))]
    if f"{name}/epsilon" in numbers:
        df1 = check("df1", "df2 / (n - 1)", f"{d} * ε")
        df2 = check("df2", f"{d} * ε * (n - 1)", "df1 * (n - 1)")
        return [*checks, df1, df2, check("ε", f"df2 / ({d} * (n - 1))", f"df1 / {d}")]
    conditions = Formula.of(f"{d}", {}, text=f"k − 1, k = {k}")
    errors = Formula.of(f"{d} * (n - 1)", ids, text=f"(k − 1)(n − 1), k = {k}")
    return [*checks, Check(ids["df1"], conditions), Check(ids["df2"], errors)]


def _f_ratio(name: str, numbers: Numbers) -> Possible | Remark:
    """
    Return the range of F that means and SDs leave: correlations from −1/(k − 1) on average to 1.
    """
    conditions = conditions_of(name)
    k = len(conditions)
    if any(f"{name}/mean.{c}" not in numbers for c in conditions):
        return Remark(f"{name}/anova.F", "The mean and SD of one condition are not printed.")
    inputs = means_and_sds(name, conditions)

    def f_ratio(v: dict, greatest: bool) -> np.ndarray:
        means = np.stack([v[f"M_{c}"] for c in conditions])
        sds = np.stack([v[f"SD_{c}"] for c in conditions])
        variance = (sds**2).mean(axis=0)
        covariance = (sds.sum(axis=0) ** 2 - (sds**2).sum(axis=0)) / (k * (k - 1.0))
        error = variance - covariance if greatest else variance * k / (k - 1.0)
        return v["n"] * means.var(axis=0, ddof=1) / error

    lowest = "F at the least average correlation, −1/(k − 1)"
    least = Formula(lowest, inputs, lambda v: f_ratio(v, greatest=False))
    most = Formula("F at correlations of 1", inputs, lambda v: f_ratio(v, greatest=True))
    return Possible(f"{name}/anova.F", least, most)


def _mauchly(name: str, numbers: Numbers, k: int) -> list:
    """Return the checks of Mauchly's test, and of what the text concludes from it."""
    at = {key: f"{name}/mauchly.{key}" for key in ("chi2", "df", "p")}
    n = {"n": f"{name}/n"}
    epsilon = f"{name}/epsilon"
    sphericity = f"{name}/sphericity"
    given = {"ε": epsilon} | n
    least = Formula(
        "least χ² at this ε", given, lambda v: chi2_of_epsilon(v["ε"], v["n"], k, False)
    )
    most = Formula(
        "greatest χ² at this ε", given, lambda v: chi2_of_epsilon(v["ε"], v["n"], k, True)
    )
    if at["chi2"] not in numbers:
        (_, low, _), (_, _, high) = least.range(numbers), most.range(numbers)
        p_low, p_high = (
            float(mauchly_p_value(x, numbers[f"{name}/n"].value, k)) for x in (high, low)
        )
        reason = (
            f"χ² is not printed; ε = {numbers[epsilon].printed} leaves χ² from {low:.1f} to "
            f"{high:.1f}, that is p from {p_low:.2g} to {p_high:.2g}."
        )
        return [Remark(sphericity, reason)]
    df = Formula.of(f"{k} * ({k} - 1) / 2 - 1", {}, text=f"k(k − 1)/2 − 1, k = {k}")
    inputs = {"χ2": at["chi2"], "df": at["df"]}
    label = "first-order approximation"
    first_order = Formula(
        "P(χ²(df) > χ²)", inputs, lambda v: stats.chi2.sf(v["χ2"], v["df"]), label
    )
    second_order = Formula(
        "P(χ²(df) > χ²) + ω [P(χ²(df + 4) > χ²) − P(χ²(df) > χ²)]",
        {"χ2": at["chi2"]} | n,
        lambda v: mauchly_p_value(v["χ2"], v["n"], k),
        "second-order approximation, as statistical packages give it",
    )
    chi2 = Remark(at["chi2"], "Depends on correlations, which are not printed.")
    target = (0.05, 1.0) if numbers[sphericity].printed == "met" else (0.0, 0.05)
    note = "Sphericity is rejected below 0.05."
    return [
        Check(at["df"], df),
        Check(at["p"], second_order, (first_order,)),
        Check(sphericity, Formula.of("p", _ids(name)), target=target, note=note),
        Possible(at["chi2"], least, most) if epsilon in numbers else chi2,
    ]


def _t_test(name: str, numbers: Numbers) -> list[Check | Possible]:
    """Return the checks of a paired t and its p."""
    a, b = (id.split(".")[-1] for id in numbers if id.startswith(f"{name}/mean."))
    inputs = means_and_sds(name, (a, b))
    least = Formula("t at a correlation of −1", inputs, lambda v: extreme_t(v, a, b, -1))
    most = Formula("t at a correlation of 1", inputs, lambda v: extreme_t(v, a, b, 1))
    t, n = f"{name}/t_test.t", f"{name}/n"
    tail = Formula(
        "2 P(t(n − 1) > t)", {"t": t, "n": n}, lambda v: 2.0 * stats.t.sf(v["t"], v["n"] - 1.0)
    )
    return [Check(f"{name}/t_test.p", tail), Possible(t, least, most)]


def _sample_size(name: str) -> Check:
    """
    Return the check of n: participants less those dropped; the UAV study counts the trials of one
    person as people.
    """
    section = "section_2_4_2_2" if name.startswith("uav.") else "section_3_9_2"
    ids = {symbol: f"{section}/{symbol}" for symbol in ("participants", "dropped", "trials")}
    trials = Formula.of(
        "trials * (participants - dropped)", ids, "each trial of a person was counted as a person"
    )
    others = (trials,) if section == "section_2_4_2_2" else ()
    return Check(f"{name}/n", Formula.of("participants - dropped", ids), explanations=others)


def _duplicates(first: str, second: str, numbers: Numbers) -> list[Remark]:
    """Return remarks on statistics that two studies share to the last digit."""

    def same(key: str) -> bool:
        pair = [
            numbers[id].printed for id in (f"{first}/{key}", f"{second}/{key}") if id in numbers
        ]
        return len(pair) == 2 and len(set(pair)) == 1

    remarks = []
    if same("mauchly.chi2") and same("mauchly.p"):
        chi2, df = numbers[f"{second}/mauchly.chi2"], numbers[f"{second}/mauchly.df"]
        chance = float(np.diff(stats.chi2.cdf(chi2.compatible, df.value))[0])
        reason = (
            f"Suspicious: χ² = {chi2.printed} and p = {numbers[f'{second}/mauchly.p'].printed} "
            f"are printed for {first} as well; under sphericity two measures agree so closely "
            f"with a chance of about 1 in {1.0 / chance:.0f}. Probably one was copied from the "
            "other."
        )
        quantity = f"{chi2.quantity}, against {first}"
        remarks.append(Remark(chi2.id, reason, suffix="/duplicate", quantity=quantity))
    if same("anova.F"):
        reason = f"Suspicious: the same F is printed for {first}."
        remarks.append(Remark(f"{second}/anova.F", reason, suffix="/duplicate"))
    return remarks


def study_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of every printed study but those of its means and SDs."""
    checks: list[Finding] = []
    names = study_names(numbers)
    for name in names:
        k = len(conditions_of(name))
        checks.append(_sample_size(name))
        if f"{name}/t_test.t" in numbers:
            checks += _t_test(name, numbers)
            continue
        checks += [*_anova(name, numbers, k), _f_ratio(name, numbers), *_mauchly(name, numbers, k)]
        checks += pair_checks(name, numbers)
    for first, second in combinations(names, 2):
        checks += _duplicates(first, second, numbers)
    return checks


def means_and_sds(name: str, conditions: tuple[str, ...]) -> dict[str, str]:
    """Return symbol to id of the means and SDs of some conditions, and of n."""
    means = {f"M_{c}": f"{name}/mean.{c}" for c in conditions}
    return means | {f"SD_{c}": f"{name}/sd.{c}" for c in conditions} | {"n": f"{name}/n"}


def extreme_t(v: dict, a: str, b: str, correlation: int) -> np.ndarray:
    """
    Return the size of a paired t from means and SDs, at a correlation of 1 (the greatest) or −1
    (the least).
    """
    sd = np.abs(v[f"SD_{a}"] - correlation * v[f"SD_{b}"])
    return np.abs(v[f"M_{a}"] - v[f"M_{b}"]) * np.sqrt(v["n"]) / np.maximum(sd, 1e-12)


def _usual_bound(numbers: Numbers) -> str:
    """Return the bound that most pairwise p-values below one are printed with, "<.0005"."""
    bounds = Counter(x.printed for id, x in numbers.items() if "/pairs." in id and x.is_bound)
    return max(bounds, key=lambda text: bounds[text], default="")


def _pair(id: str, name: str, numbers: Numbers) -> Possible | Remark:
    """
    Return the range of one printed p: from correlation 1, unadjusted, to correlation −1, adjusted
    by Bonferroni.
    """
    a, b = id.removeprefix(f"{name}/pairs.").split("-")
    usual, odd = _usual_bound(numbers), ""
    if numbers[id].is_bound and numbers[id].printed != usual:
        odd = (
            f"Suspicious: every other bound of its kind is printed {usual}; probably a zero is "
            "missing."
        )
    if any(f"{name}/mean.{c}" not in numbers for c in (a, b)):
        return Remark(id, odd or "The mean and SD of one of the two conditions are not printed.")
    k = len(conditions_of(name))
    m = k * (k - 1) // 2
    inputs = means_and_sds(name, (a, b))

    def p_value(v: dict, correlation: int, times: float) -> np.ndarray:
        return np.minimum(
            times * 2.0 * stats.t.sf(extreme_t(v, a, b, correlation), v["n"] - 1.0), 1.0
        )

    least = Formula("p unadjusted at a correlation of 1", inputs, lambda v: p_value(v, 1, 1.0))
    most = Formula(
        f"{m} p (Bonferroni) at a correlation of −1", inputs, lambda v: p_value(v, -1, m)
    )
    return Possible(id, least, most, odd)


def _adjustment(name: str, numbers: Numbers) -> Row:
    """
    Return for which adjustment of p the printed pairs can go with the printed F.

    The variances of all k(k − 1)/2 differences add up to k(k − 1) MS_error, and MS_error =
    MS_conditions/F. A printed p fixes the variance of its difference, p < .0005 bounds it from
    above, no significance from below. Šidák's and Holm's p lie between the unadjusted and
    Bonferroni's. Not checkable, as neither the adjustment nor every pair is printed.
    """
    conditions, number = conditions_of(name), numbers[f"{name}/anova.F"]
    k = len(conditions)
    inputs = {c: f"{name}/mean.{c}" for c in conditions} | {"F": number.id, "n": f"{name}/n"}

    def total(v: dict) -> np.ndarray:
        means = np.stack([v[c] for c in conditions])
        return k * (k - 1.0) * v["n"] * np.var(means, axis=0, ddof=1) / v["F"]

    formula = Formula("k(k − 1) MS_conditions/F", inputs, total)
    value, low, high = formula.range(numbers)
    times = {"unadjusted": 1.0, "Bonferroni": k * (k - 1) / 2}
    spans = {way: _sum_of_variances(name, numbers, m) for way, m in times.items()}
    fits = [way for way, (least, most) in spans.items() if least <= high and most >= low]
    allowed = "; ".join(
        f"{way}: from {least:.4g} to {most:.4g}" for way, (least, most) in spans.items()
    )
    reason = (
        f"The variances of all differences add up to {value:.4g} by F, from {low:.4g} to "
        f"{high:.4g} within rounding. The printed pairs allow {allowed}, with pairs that are not "
        f"listed taken as not significant at {ALPHA}. "
    )
    if len(fits) == 2:
        reason += "The adjustment is not printed; these numbers leave it open."
    elif fits:
        reason += f"The adjustment is not printed; of the two only {fits[0]} is possible."
    else:
        reason = f"Suspicious: {reason}Neither is possible."
    span, used = (value, low, high), listing(inputs, numbers)
    id, quantity = f"{name}/pairs/adjustment", f"{number.quantity}, against the pairwise p-values"
    return row_about(number, "not checkable", reason, span, formula.text, used, id, quantity)


def _printed_p(name: str, pair: tuple[str, str], numbers: Numbers) -> tuple[float, float]:
    """Return least and greatest p of a pair; those not listed were not significant."""
    for a, b in (pair, pair[::-1]):
        if f"{name}/significant.{a}-{b}" in numbers:
            return 0.0, ALPHA
        if f"{name}/pairs.{a}-{b}" in numbers:
            return numbers[f"{name}/pairs.{a}-{b}"].compatible
    return ALPHA, 1.0


def _distance(first: PrintedNumber, second: PrintedNumber) -> tuple[float, float]:
    """Return least and greatest difference of two printed numbers within their rounding."""
    apart, slack = abs(first.value - second.value), first.half + second.half
    return max(apart - slack, 0.0), apart + slack


def _sum_of_variances(name: str, numbers: Numbers, times: float) -> tuple[float, float]:
    """
    Return least and greatest sum of the variances of all differences, where p-values were
    multiplied by `times`.
    """
    n = numbers[f"{name}/n"].value
    least = most = 0.0

    def spread(p: float, difference: float) -> float:
        """SD of a difference from its p and mean."""
        return difference * np.sqrt(n) / stats.t.isf(min(p / times, 1.0) / 2.0, n - 1.0)

    for pair in combinations(conditions_of(name), 2):
        means, sds = ([numbers[f"{name}/{what}.{c}"] for c in pair] for what in ("mean", "sd"))
        least_apart, most_apart = _distance(*means)
        least_sd, _ = _distance(*sds)  # at a correlation of 1; the greatest is at −1
        most_sd = sum(sd.value + sd.half for sd in sds)
        low_p, high_p = _printed_p(name, pair, numbers)
        below = spread(low_p, least_apart) if low_p > 0.0 else 0.0
        above = spread(high_p, most_apart) if high_p < 1.0 else np.inf
        least += max(below, least_sd) ** 2
        most += min(above, most_sd) ** 2
    return least, most


def pair_checks(name: str, numbers: Numbers) -> list[Finding]:
    """
    Return the checks of a study's pairwise p-values; the last is that of the adjustment, if all
    means are printed.
    """
    checks: list[Finding] = [
        _pair(id, name, numbers) for id in numbers if id.startswith(f"{name}/pairs.")
    ]
    if all(f"{name}/mean.{c}" in numbers for c in conditions_of(name)):
        checks.append(_adjustment(name, numbers))
    return checks
