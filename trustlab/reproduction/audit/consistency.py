"""
Whether several printed numbers can go together: the parameters, limits and bounds of a participant;
means, SDs, whole points and sample sizes; statistics that two studies share.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from decimal import ROUND_HALF_UP, Decimal
from fractions import Fraction
from itertools import combinations
from statistics import mode
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize, stats

from trustlab.reproduction.audit.catalogue import (
    PARTICIPANTS,
    PrintedNumber,
    conditions_of,
    study_names,
)
from trustlab.reproduction.audit.check import (
    Finding,
    Numbers,
    Row,
    beside,
    listing,
    row_about,
    row_within,
)
from trustlab.reproduction.audit.relations import (
    BOUNDS,
    LIMIT_INPUTS,
    RATE_INPUTS,
    bounds,
    claim_checks,
    limits,
    related,
    relations,
)
from trustlab.reproduction.printed import ROUNDINGS, greatest_sd, possible_f
from trustlab.reproduction.published import published_facts

LIMITS = ("TSC_lb", "TSC_ub", "b_pr")
# Cap on a misfit, in half units; also the misfit of an output that cannot be computed.
FARTHEST = 1e3

NEAREST = 10  # pairs of thresholds that are tried

MEASURES = published_facts("measures")
TLX_RULES = {rule: Fraction(points) for rule, points in MEASURES["tlx_rules"].items()}
MOST_ITEMS = 40
# The id of a mean: table, condition and measure; or study and condition.
MEAN = re.compile(r"(table_2\.[45]|table_3\.1)/(\w+)/(\w+)_mean|(.+)/mean\.(\w+)")


class JointCheck(NamedTuple):
    """
    Several printed outputs that should come from one set of parameters.

    `inputs` and `outputs` map symbols to ids; each function of `readings` computes all outputs from
    arrays of inputs, and one of them is enough.
    """

    numbers: Numbers
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    readings: tuple[Callable[[Any], dict], ...]

    def at_printed(self, **changes: np.ndarray) -> SimpleNamespace:
        """Return the inputs as printed, but for changes."""
        printed = {name: np.asarray(self.numbers[id].value) for name, id in self.inputs.items()}
        return SimpleNamespace(**printed | changes)

    def misfit(self, computed: Mapping[str, np.ndarray], names: tuple[str, ...] = ()) -> np.ndarray:
        """Return by how many half units the worst output lies beyond its rounding, or 0."""
        worst = np.asarray(0.0)
        for name in names or self.outputs:
            number = self.numbers[self.outputs[name]]
            miss = np.abs(computed[name] - number.value) / number.half - 1.0
            miss = np.nan_to_num(np.clip(miss, 0.0, FARTHEST), nan=FARTHEST)
            worst = np.maximum(worst, miss)
        return worst

    def least_misfit(self, **fixed: float) -> float:
        """
        Search the box of rounding, but for `fixed` inputs, for the parameters that miss least.
        """
        free = {name: self.numbers[id] for name, id in self.inputs.items() if name not in fixed}
        middle = np.array([number.value for number in free.values()])
        half = np.array([number.half for number in free.values()])
        least = FARTHEST
        for compute in self.readings:

            def miss(point: np.ndarray, compute: Callable = compute) -> np.ndarray:
                values = dict(zip(free, middle[:, None] + half[:, None] * point, strict=True))
                values |= {name: np.full(point.shape[1], value) for name, value in fixed.items()}
                return self.misfit(compute(SimpleNamespace(**values)))

            # A global search: the misfit has steps, as dwell times are whole numbers, and is flat
            # where all outputs fit.
            result = optimize.differential_evolution(
                miss,
                [(-1.0, 1.0)] * len(free),
                rng=0,
                maxiter=300,
                popsize=12,
                tol=1e-6,
                polish=False,
                vectorized=True,
                updating="deferred",
                callback=lambda intermediate_result: intermediate_result.fun == 0.0,
            )
            least = min(least, float(result.fun))
            if least == 0.0:
                break
        return least

    def row(self, explain: Callable[["JointCheck"], str]) -> Row:
        """Return the verdict; `explain` says what would give the outputs where they do not fit."""
        names, miss = ", ".join(self.outputs), self.least_misfit()
        if miss == 0.0:
            reason = f"{names} can all come from one set of parameters that round as printed."
            return self.described("within rounding", reason)
        reason = (
            f"{names} cannot all come from one set of parameters that round as printed; the "
            f"nearest found still miss one of them by {miss:.2g} half units beyond its rounding. "
            f"{explain(self)}"
        )
        if miss > 1.0:
            return self.described("differs", reason)
        return self.described("not checkable", f"Suspicious: {reason}")

    def described(self, verdict: str, reason: str) -> Row:
        """Return a row with this verdict under the id of the second output."""
        _, anchor, *_ = self.outputs.values()
        names = ", ".join(self.outputs)
        return row_about(
            self.numbers[anchor],
            reason,
            verdict,
            formula=f"{names} from one set of parameters",
            inputs=listing(self.inputs, self.numbers),
            id=f"{anchor}/column",
            quantity=f"{names} at once",
            printed=", ".join(self.numbers[id].printed for id in self.outputs.values()),
        )


def _finer_rate(check: JointCheck) -> str:
    """Say which a_pr with one more digit gives both limits, if one does."""
    rate, (compute, _) = check.numbers[check.inputs["a_pr"]], check.readings
    for k in sorted(range(-5, 6), key=abs):
        a_pr = rate.value + k * 10.0 ** -(rate.decimals + 1)
        computed = compute(check.at_printed(a_pr=np.asarray(a_pr)))
        if check.misfit(computed, ("TSC_lb", "TSC_ub")) == 0.0:
            return (
                f"Both limits follow from a_pr = {a_pr:.{rate.decimals + 1}f} (printed: "
                f"{rate.printed}), from which (2.3) gives b_pr = {float(computed['b_pr']):.2g}."
            )
    return ""


def _other_thresholds(check: JointCheck) -> str:
    """Say which thresholds, of two decimals, give the column, if any do."""
    grid = np.arange(-100, 101) / 100.0
    lower, upper = (x.ravel() for x in np.meshgrid(grid, grid))
    away = check.misfit(bounds(check.at_printed(TSC_l=lower, TSC_u=upper)), BOUNDS)
    away[lower >= upper] = np.inf
    first = check._replace(readings=check.readings[:1])
    for i in np.argsort(away, kind="stable")[:NEAREST]:
        if first.least_misfit(TSC_l=lower[i], TSC_u=upper[i]) == 0.0:
            return (
                "They follow, within the rounding of the other parameters, from TSC_l = "
                f"{lower[i]:.2f} and TSC_u = {upper[i]:.2f}: probably the thresholds printed are "
                "not those the column was computed from."
            )
    return ""


def _rows_of_participant(p: str, numbers: Numbers) -> Iterator[Row]:
    """
    Return the row of the limits of Table 2.1, and that of Table 2.2 together with these where they
    fit by themselves.
    """
    ids = beside("", f"/{p}", numbers)
    gain = numbers[ids["b_pr"]].value

    def where(*names: str) -> dict[str, str]:
        return {name: ids[name] for name in names}

    # b_pr as printed, then by (2.3).
    readings: tuple[Callable[[Any], dict], ...] = (lambda v: limits(v, gain), limits)
    check = JointCheck(numbers, where(*LIMIT_INPUTS), where(*LIMITS), readings)
    if related(ids["TSC_ub"], numbers).row(numbers).verdict == "differs":
        row = check.described("not checkable", "TSC_ub alone does not follow; see its own row.")
    else:
        row = check.row(_finer_rate)
    yield row
    inputs, outputs = where(*RATE_INPUTS), where(*BOUNDS)
    # c of (2.20) as it is, then as b_pr P_h/(1 − a_pr) with b_pr as printed.
    readings = (bounds, lambda v: bounds(v, gain))
    if row.verdict == "within rounding":
        inputs, outputs = inputs | where("delta_P_h"), outputs | where(*LIMITS)
        readings = (
            lambda v: bounds(v) | limits(v, gain),
            lambda v: bounds(v, gain) | limits(v, gain),
        )
    yield JointCheck(numbers, inputs, outputs, readings).row(_other_thresholds)


def joint_rows(numbers: Numbers) -> list[Row]:
    """Return whether limits and bounds fit together, two rows for every participant."""
    return [row for p in PARTICIPANTS for row in _rows_of_participant(p, numbers)]


def is_attainable(number: PrintedNumber, units: Fraction) -> bool:
    """
    Return whether some mean of whole points rounds to a printed one (the GRIM test).

    `units` are whole points per unit of the scale: respondents × items for ratings in steps of 1.
    """
    least, most = (Fraction(end) * units for end in number.compatible)
    return math.ceil(least) <= most


def _measures(numbers: Numbers) -> dict[str, dict[str, str]]:
    """Return, per measure, condition to id of its mean."""
    measures: dict[str, dict[str, str]] = {}
    for id in numbers:
        if cell := MEAN.fullmatch(id):
            table, in_table, column, study, condition = cell.groups()
            measure = study or f"{table}/{column}"
            measures.setdefault(measure, {})[condition or in_table] = id
    return measures


def _size(measure: str) -> str:
    """Return the id of the number of respondents."""
    tables = {"table_2": "section_2_4_1_1/participants", "table_3": "section_3_8_2_1/participants"}
    return tables.get(measure.split(".")[0], f"{measure}/n")


def _kind(measure: str) -> str:
    """Return what is measured: "tlx" of "uav.tlx" and of "table_2.4/tlx"."""
    return measure.replace("/", ".").split(".")[-1]


def _sd(measure: str, mean: str, numbers: Numbers) -> Row:
    """Return the range of an SD that the mean and the ends of the scale leave."""
    number = numbers[mean.replace("_mean", "_sd").replace("/mean.", "/sd.")]
    size, scale = _size(measure), MEASURES["scales"][measure]
    most = greatest_sd(numbers[mean].compatible, numbers[size].value, scale)
    text = f"all scores at the ends of the scale, {scale[0]:g} to {scale[1]:g}"
    text = "all scores but one at the lowest" if math.isinf(scale[1]) else text
    return row_within(number, (0.0, most), text, {"M": mean, "n": size}, numbers)


def _ratings(measure: str, ids: Mapping[str, str], numbers: Numbers) -> list[Row]:
    """
    Return a row on the items of a questionnaire, or on its rule of scoring, that all means fit, and
    remarks on means that no whole points give.
    """
    kind, respondents = _kind(measure), numbers[_size(measure)]
    word, tried, rules = "scoring", "; ".join(TLX_RULES), TLX_RULES
    if kind != "tlx":
        word, tried = "items", f"up to {MOST_ITEMS} items"
        rules = {f"{items} items": Fraction(items) for items in range(1, MOST_ITEMS + 1)}

    def fits(condition: str, rule: str) -> bool:
        # Table 2.4 may rest on two sets of tests under C1.
        twice = measure.startswith("table_2.4") and condition == "C1"
        sets = numbers["section_2_4_1_3/sets"].value if twice else 1
        return is_attainable(numbers[ids[condition]], int(respondents.value * sets) * rules[rule])

    fitting = [rule for rule in rules if all(fits(condition, rule) for condition in ids)]
    listed = MEASURES["expected_items"]
    expected, source = listed.get(measure) or listed.get(kind) or ("", "")
    rows = []
    for condition, id in ids.items():
        if kind == "tlx" and not any(fits(condition, rule) for rule in rules):
            remark = f"Suspicious: for n = {respondents.printed} no whole points give it, raw or "
            rows.append(row_about(numbers[id], f"{remark}weighted (GRIM)."))
        elif expected and not fits(condition, expected):
            rows.append(row_about(numbers[id], f"With {expected} no whole points round to it."))
    what = "rule of scoring" if word == "scoring" else "number of items"
    reason = f"The {what} is not printed. All means are whole points for: "
    reason += f"{'; '.join(fitting[:4]) or 'none of ' + tried}."
    if expected and expected not in fitting:
        reason = f"Suspicious: not {expected} ({source}). {reason}"
    fewest = float(rules[fitting[0]]) if fitting and word == "items" else math.nan
    items = row_about(
        numbers[next(iter(ids.values()))],
        reason,
        span=(fewest, math.nan, math.nan),
        formula="mean × respondents × items is a whole number",
        inputs=listing({**ids, "n": _size(measure)}, numbers),
        id=f"{measure}/{word}",
        quantity=f"{kind}: {word} that all means fit",
        printed=", ".join(numbers[id].printed for id in ids.values()),
    )
    return [*rows, items]


def sample_checks(numbers: Numbers) -> list[Row]:
    """Return the checks of the means and SDs in Tables 2.4, 2.5 and 3.1 and in the studies."""
    rows: list[Row] = []
    for measure, ids in _measures(numbers).items():
        if measure in MEASURES["scales"]:
            rows += [_sd(measure, id, numbers) for id in ids.values()]
        if _kind(measure) in ("tlx", "trust", "satisfaction", "preference"):
            rows += _ratings(measure, ids, numbers)
    return rows


def _duplicates(first: str, second: str, numbers: Numbers) -> list[Row]:
    """Return remarks on statistics that two studies share to the last digit."""

    def same(key: str) -> bool:
        pair = [
            numbers[id].printed for id in (f"{first}/{key}", f"{second}/{key}") if id in numbers
        ]
        return len(pair) == 2 and len(set(pair)) == 1

    rows = []
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
        rows.append(row_about(chi2, reason, id=f"{chi2.id}/duplicate", quantity=quantity))
    if same("anova.F"):
        f_ratio, reason = numbers[f"{second}/anova.F"], f"the same F is printed for {first}."
        rows.append(row_about(f_ratio, f"Suspicious: {reason}", id=f"{f_ratio.id}/duplicate"))
    return rows


def _allowed_rows(study: str, unusual: set[str], numbers: Numbers) -> Iterator[Row]:
    """
    Return the ranges that means and standard deviations leave F, t and p of pairs, and which p are
    bounded otherwise than most, "<.0005".
    """
    conditions, size = conditions_of(study), f"{study}/n"
    n, pairs = numbers[size].value, list(combinations(conditions, 2))
    for chosen in (conditions, *pairs):
        cells = {f"M_{c}": f"{study}/mean.{c}" for c in chosen}
        cells |= {f"SD_{c}": f"{study}/sd.{c}" for c in chosen}
        if not numbers.keys() >= set(cells.values()):
            continue
        mean, sd = np.split(np.array([numbers[id].compatible for id in cells.values()]), 2)
        f_ratio = np.array(possible_f(mean, sd, n))
        allowed = {"anova.F": f_ratio}
        if chosen in pairs:
            t = np.sqrt(f_ratio)
            p = 2.0 * stats.t.sf(t, n - 1.0)
            # Whether it is adjusted for the number of pairs, and how, is open.
            ends = np.array([p[1], min(len(pairs) * p[0], 1.0)])
            allowed = {"t_test.t": t, f"pairs.{'-'.join(chosen)}": ends}
        for statistic, (low, high) in allowed.items():
            if (id := f"{study}/{statistic}") in numbers:
                note = ""
                if id in unusual:
                    note = "Suspicious: most of its kind have another bound; probably a zero is "
                    note += "missing."
                text, inputs = "at any correlations", cells | {"n": size}
                yield row_within(numbers[id], (low, high), text, inputs, numbers, note)


def _unusual_bounds(numbers: Numbers) -> set[str]:
    """Return the p-values of pairs that are bounded otherwise than most are."""
    bounds = {id: x.printed for id, x in numbers.items() if "/pairs." in id and x.is_bound}
    usual = mode(bounds.values()) if bounds else ""
    return {id for id, text in bounds.items() if text != usual}


def study_checks(numbers: Numbers) -> list[Row]:
    """Return the rows about what the cells of studies allow, and about pairs of studies."""
    names, unusual = study_names(numbers), _unusual_bounds(numbers)
    rows = [row for name in names for row in _allowed_rows(name, unusual, numbers)]
    return rows + [row for pair in combinations(names, 2) for row in _duplicates(*pair, numbers)]


# Where numbers are printed a second time, their first place, and its name.
PRINTED_TWICE = (
    ("figure_2_18", "section_2_5", "The text of Section 2.5"),
    ("appendix_a/state", "appendix_a/model", "The transfer function"),
)


def relation_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of all relations and claims, and of numbers that are printed twice."""
    again = [
        _restated(id, id.replace(second, first, 1), where, numbers)
        for second, first, where in PRINTED_TWICE
        for id in numbers
        if id.startswith(f"{second}/")
    ]
    return [*relations(numbers), *claim_checks(numbers), *again]


def _restated(id: str, first: str, where: str, numbers: Numbers) -> Row:
    """
    Return whether a number printed in a second place is the one of the first, or that one rounded.
    """
    number, source = numbers[id], numbers[first]
    here, there = Decimal(number.printed), Decimal(source.printed)
    same = here in (there.quantize(here, rule) for rule in ROUNDINGS)
    reason = f"{where} has {source.printed}."
    if not same:
        rounded = there.quantize(here, ROUND_HALF_UP)
        reason += f" Here it would be {rounded}: one of the two is wrong."
    return row_about(
        number,
        reason,
        "reproduced" if same else "differs",
        (float(there),) * 3,
        formula="the same number in two places",
        inputs=f"{source.printed} ({source.id})",
    )
