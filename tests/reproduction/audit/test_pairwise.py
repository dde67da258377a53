"""
Pairwise p-values against F: printed statistics of simulated data must fit under the adjustment they
were made with.

Oracles: scipy.stats.ttest_rel on the data; the F ratio from sums of squares of the data.
"""

from itertools import combinations

import numpy as np
import pytest

from tests import textbook
from trustlab.reproduction.audit.catalogue import PrintedNumber, conditions_of, printed_numbers
from trustlab.reproduction.audit.check import rows_of
from trustlab.reproduction.audit.consistency import study_checks
from trustlab.reproduction.audit.relations import of_pairs

NAMES = conditions_of("uav.made")


def printed_study(seed, times, n=36):
    """A study of simulated data as a paper would print it, p-values multiplied by `times`."""
    rng = np.random.default_rng(seed)
    data = (
        rng.normal(size=(n, 1))
        + rng.normal(size=(n, 5)) * rng.uniform(0.6, 1.4, 5)
        + rng.normal(0.0, 0.4, 5)
    )
    found = textbook.analysed(data)
    printed = {"n": str(n), "anova.F": f"{found['F']:.3f}"}
    for c, mean, sd in zip(NAMES, found["mean"], found["sd"], strict=True):
        printed |= {f"mean.{c}": f"{mean:.3f}", f"sd.{c}": f"{sd:.3f}"}
    for (a, b), test in zip(combinations(NAMES, 2), found["pairs"], strict=True):
        p = min(times * test.pvalue, 1.0)
        if p < 0.0495:
            printed[f"pairs.{a}-{b}"] = "<.0005" if p < 0.0005 else f"{p:.3f}"
    return {
        f"uav.made/{key}": PrintedNumber(f"uav.made/{key}", "made here", key, text, key == "n")
        for key, text in printed.items()
    }


def fits(numbers):
    (row,) = study_checks(numbers)
    assert row.id == "uav.made/pairs/adjustment"
    if "leave it open" in row.reason:
        return {"unadjusted", "Bonferroni"}
    if "Neither" in row.reason:
        assert row.reason.startswith("Suspicious")
        return set()
    return {"unadjusted" if "only unadjusted" in row.reason else "Bonferroni"}


@pytest.mark.parametrize(("way", "times"), [("unadjusted", 1.0), ("Bonferroni", 10.0)])
def test_data_fit_under_their_own_adjustment(way, times):
    found = [fits(printed_study(seed, times)) for seed in range(25)]
    assert all(way in each for each in found)
    if (
        way == "Bonferroni"
    ):  # the other one is ruled out now and then, else the check would show nothing
        assert any(len(each) == 1 for each in found)


def test_each_printed_pair_is_possible():
    numbers = printed_study(4, 10.0)
    rows = rows_of([*of_pairs("uav.made", numbers), *study_checks(numbers)], numbers)
    assert len(rows) > 2
    assert {row.verdict for row in rows} == {"not checkable"}


def test_the_printed_studies_are_bonferronis():
    reasons = {row.id: row.reason for row in study_checks(printed_numbers())}
    assert "leave it open" in reasons["uav.tlx/pairs/adjustment"]
    for name in ("teleop.trust", "teleop.satisfaction"):
        assert "only Bonferroni is possible" in reasons[f"{name}/pairs/adjustment"]
