"""
Whether several printed numbers can go together: the statistics of a study; means, whole points and
sample sizes; numbers that are printed twice.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from itertools import combinations
from statistics import mode
from typing import Any

import numpy as np
from scipy import stats

from trustlab.reproduction.audit.catalogue import PrintedNumber, studies
from trustlab.reproduction.audit.check import Numbers, Row, listing, row_about
from trustlab.reproduction.printed import ROUNDINGS, printed_interval
from trustlab.reproduction.published import PRINTED, published_facts
from trustlab.reproduction.reconstruction.contradictions import contradictions

MEASURES = published_facts("measures")
TLX_RULES = {rule: Fraction(points) for rule, points in MEASURES["tlx_rules"].items()}
ITEM_RULES = {f"{items} items": Fraction(items) for items in range(1, 41)}
# The id of a mean of ratings: table, condition and measure; or study, with its measure, and
# condition.
RATED = "(tlx|trust|satisfaction|preference)"
MEAN = re.compile(rf"(table_[23]\.[14])/(\w+)/{RATED}_mean|(\w+\.{RATED})/mean\.(\w+)")
PEOPLE = {
    "table_2.4": "section_2_4_1_1/participants",
    "table_3.1": "section_3_8_2_1/participants",
}


def study_conflicts(numbers: Numbers) -> dict[str, str]:
    """Return numbers of studies that others contradict however p was adjusted, with the reason."""
    conflicts = {}
    for name, study in studies().items():
        printed: dict[str, Any] = {
            key: {part: numbers[f"{name}/{key}.{part}"].printed for part in getattr(study, key)}
            for key in PRINTED
        }
        if study.epsilon:
            printed["epsilon"] = numbers[f"{name}/epsilon"].printed
        again = replace(study, n=int(numbers[f"{name}/n"].value), **printed)
        # What Holm's adjustment can make of a p includes what all others make of it.
        found = contradictions(again, "holm")
        conflicts |= {f"{name}/{key}": f"Impossible: {reason}." for key, reason in found.items()}
    return conflicts


def is_attainable(number: PrintedNumber, units: Fraction) -> bool:
    """
    Return whether some mean of whole points rounds to a printed one (the GRIM test).

    `units` are whole points per unit of the scale: respondents × items for ratings in steps of 1.
    """
    if not all(map(math.isfinite, number.compatible)):  # printed as a bound
        return True
    least, most = (Fraction(end) * units for end in number.compatible)
    return math.ceil(least) <= most


def sample_checks(numbers: Numbers) -> list[Row]:
    """
    Return the checks of questionnaires in Tables 2.4 and 3.1 and in the studies: the items, or the
    rule of scoring, that all means fit, and means that no whole points give.
    """
    measures: dict[tuple[str, str, str], dict[str, str]] = {}  # by condition the id of the mean
    for id in numbers:
        if cell := MEAN.fullmatch(id):
            table, in_table, column, study, kind, condition = cell.groups()
            measure = study or f"{table}/{column}", kind or column, PEOPLE.get(table, f"{study}/n")
            measures.setdefault(measure, {})[condition or in_table] = id
    return [row for measure, ids in measures.items() for row in _ratings(*measure, ids, numbers)]


def _ratings(
    measure: str, kind: str, size: str, ids: Mapping[str, str], numbers: Numbers
) -> list[Row]:
    """Return the rows of one questionnaire."""
    respondents = int(numbers[size].value)
    word, what, rules = "items", "number of items", ITEM_RULES
    if kind == "tlx":
        word, what, rules = "scoring", "rule of scoring", TLX_RULES

    def fitting(condition: str) -> list[str]:
        # Table 2.4 may rest on two sets of tests under C1.
        twice = measure.startswith("table_2.4") and condition == "C1"
        people = respondents * (int(numbers["section_2_4_1_3/sets"].value) if twice else 1)
        number = numbers[ids[condition]]
        return [rule for rule, points in rules.items() if is_attainable(number, people * points)]

    fits = {condition: fitting(condition) for condition in ids}
    together = [rule for rule in rules if all(rule in each for each in fits.values())]
    listed = MEASURES["expected_items"]
    expected, source = listed.get(measure) or listed.get(kind) or ("", "")
    rows = []
    for condition, id in ids.items():
        if not fits[condition]:
            remark = f"Suspicious: for n = {respondents} no whole points give it (GRIM)."
            rows.append(row_about(numbers[id], remark))
        elif expected and expected not in fits[condition]:
            rows.append(row_about(numbers[id], f"With {expected} no whole points round to it."))
    reason = f"The {what} is not printed. All means are whole points for: "
    reason += f"{'; '.join(together[:4]) or 'none of ' + '; '.join(rules)}."
    if expected and expected not in together:
        reason = f"Suspicious: not {expected} ({source}). {reason}"
    fewest = float(rules[together[0]]) if together and word == "items" else math.nan
    items = row_about(
        numbers[next(iter(ids.values()))],
        reason,
        span=(fewest, math.nan, math.nan),
        formula="mean × respondents × items is a whole number",
        inputs=listing({**ids, "n": size}, numbers),
        id=f"{measure}/{word}",
        quantity=f"{kind}: {word} that all means fit",
        printed=", ".join(numbers[id].printed for id in ids.values()),
    )
    return [*rows, items]


def remarks(numbers: Numbers, conflicts: Mapping[str, str]) -> Iterator[Row]:
    """
    Return remarks on bounds of p that are unlike all others, unless they conflict, and on copied
    tests.
    """
    limits = {id: x.printed for id, x in numbers.items() if "/pairs." in id and x.is_bound}
    for id in limits.keys() - conflicts.keys():
        if limits[id] != mode(limits.values()):
            remark = "most of its kind have another bound; probably a zero is missing."
            yield row_about(numbers[id], f"Suspicious: {remark}")
    ends = ("chi2", "p", "df")
    tests = {
        study: [numbers[f"{study}/mauchly.{end}"] for end in ends]
        for study, printed in studies().items()
        if printed.mauchly.keys() >= {*ends}
    }
    for (first, test), (_, (chi2, p, df)) in combinations(tests.items(), 2):
        if [chi2.printed, p.printed] == [x.printed for x in test[:2]]:
            chance = np.diff(stats.chi2.cdf(chi2.compatible, df.value)).item()
            reason = (
                f"Suspicious: χ² = {chi2.printed} and p = {p.printed} are printed for {first} as "
                "well; under sphericity two measures agree so closely with a chance of about 1 in "
                f"{1.0 / chance:.0f}. Probably one was copied from the other."
            )
            yield row_about(chi2, reason, id=f"{chi2.id}/duplicate")


# Where numbers are printed a second time, their first place, and its name.
PRINTED_TWICE = (
    ("figure_2_18", "section_2_5", "The text of Section 2.5"),
    ("appendix_a/state", "appendix_a/model", "The transfer function"),
)


def restated_rows(numbers: Numbers) -> Iterator[Row]:
    """
    Return whether numbers printed in a second place are those of the first, or these rounded; or
    both rounded from one number.
    """
    for second, first, where in PRINTED_TWICE:
        for id in (id for id in numbers if id.startswith(f"{second}/")):
            number, source = numbers[id], numbers[id.replace(second, first, 1)]
            here, there = Decimal(number.printed), Decimal(source.printed)
            (least, most), span = map(printed_interval, (number.printed, source.printed))
            low, high = max(least, span[0]), min(most, span[1])
            verdict, reason = "reproduced", f"{where} has {source.printed}."
            if here not in (there.quantize(here, rule) for rule in ROUNDINGS):
                verdict = "within rounding" if low < high else "differs"
                reason += f" Numbers from {low:g} to below {high:g} round to both."
                if low >= high:
                    reason = reason.replace("Numbers", "One of the two is wrong: no numbers")
            yield row_about(
                number,
                reason,
                verdict,
                (float(there), *span),
                formula="the same number in two places",
                inputs=f"{source.printed} ({source.id})",
            )
