"""
Data are found for what true data print, what contradicts by arithmetic is named, and what papers
correct by ε is recognised.

Oracle: statistics of data by their textbook definitions, and contradictions of changed digits by
arithmetic written here with SciPy's distributions.
"""

import itertools
import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.random import default_rng
from scipy import stats

import trustlab as tl
from tests import textbook
from tests.reproduction.cases import study_of
from trustlab import PublishedStudy, feasibility
from trustlab.reproduction.reconstruction.contradictions import (
    ADJUSTMENTS,
    BOTH,
    NEITHER,
    ONLY_DF,
    ONLY_P,
    contradictions,
    readings,
)

parametrize = pytest.mark.parametrize

STUDIES = tl.published_studies()
SEARCH = "trustlab.reproduction.reconstruction.search"
# Studies for which no data are found by an adjustment, from any start; by others they are.
NOT_FOUND = {
    "holm": {"uav.robot_performance", "teleop.tracking_error", "teleop.trust"},
    "none": STUDIES.keys() - {"uav.utilization", "uav.followed"},
}


def adjusted(p, p_adjust):
    """Bonferroni's and Holm's p, written out."""
    order = np.argsort(p)
    holm = np.empty_like(p)
    holm[order] = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    return {"none": p, "bonferroni": p * len(p), "holm": holm}[p_adjust].clip(max=1.0)


def true_study(seed, readings=(NEITHER, BOTH)):
    """What a paper prints of random data: its fields, and the adjustment of its pairs."""
    rng = default_rng([77, seed])
    k = int(rng.integers(2, 7))
    n = int(rng.integers(k + 2, 45))
    values = rng.normal(size=(n, k)) @ (np.eye(k) + 0.6 * rng.normal(size=(k, k)))
    values += 0.8 * rng.normal(size=(n, 1)) * rng.integers(0, 2)
    values += rng.normal(size=k) * rng.uniform(0.0, 1.2)
    scale = (-np.inf, np.inf)
    if rng.random() < 0.4:  # answers on a scale
        values, scale = np.clip(np.round(4.0 + 1.2 * values), 1.0, 7.0), (1.0, 7.0)
        values[:2] = [[1.0], [7.0]]
    names, decimals = "ABCDEF"[:k], int(rng.integers(1, 4))
    found = textbook.analysed(values)
    reading = readings[rng.integers(len(readings))] if k > 2 else NEITHER
    df, p_df = (found["epsilon"] if each else 1.0 for each in (reading.df, reading.p))
    anova = textbook.printed_anova(found, (n, k), df, p_df, 2 * reading.df)
    if rng.random() < 0.5:
        anova["eta2"] = f"{found['eta2']:.3f}"
    fields = {"n": n, "anova": anova, "scale": scale} | textbook.printed_cells(found, decimals)
    if reading.p and rng.random() < 0.5:
        fields["epsilon"] = f"{found['epsilon']:.3f}"
    p_adjust = str(rng.choice(["bonferroni", "holm", "none"]))
    p = adjusted(np.array([test.pvalue for test in found["pairs"]]), p_adjust)
    if k > 2 and (np.abs(p - 0.05) > 5e-4).all() and (p < 0.05).any():
        named = zip(combinations(names, 2), p, strict=True)
        fields["pairs"] = {f"{a}-{b}": textbook.text_of_p(x) for (a, b), x in named if x < 0.05}
    return fields, p_adjust


def contradicts(fields):
    """Whether arithmetic alone refutes the F, p, η² and degrees of freedom that are printed."""
    n, k, anova = fields["n"], len(fields["mean"]), fields["anova"]
    low, high = textbook.rounded(anova["F"])
    if "eta2" in anova:
        least, most = textbook.rounded(anova["eta2"])
        if most < low / (low + n - 1) or least > high / (high + n - 1):
            return True
    least, most = textbook.rounded(anova["p"])
    df1 = np.linspace(1.0, k - 1.0, 200)
    p = [stats.f.sf(f, df1, df1 * (n - 1)) for f in (low, high)]
    (low1, high1), (low2, high2) = textbook.rounded(anova["df1"]), textbook.rounded(anova["df2"])
    return (
        most < np.min(p)
        or least > np.max(p)
        or not (low1 <= k - 1 and high1 >= 1.0)
        or not (low2 <= (k - 1) * (n - 1) and high2 >= n - 1)
        or low2 / high1 > n - 1
        or high2 / low1 < n - 1
    )


def with_a_changed_digit(seed):
    """A true study with one digit of its analysis changed, and its adjustment."""
    fields, p_adjust = true_study(seed)
    rng = default_rng([5, seed])
    name = str(rng.choice(list(fields["anova"])))
    text = fields["anova"][name]
    place = int(rng.choice([q for q, c in enumerate(text) if c.isdigit()]))
    digit = str((int(text[place]) + int(rng.integers(1, 10))) % 10)
    changed = {name: text[:place] + digit + text[place + 1 :]}
    return {**fields, "anova": {**fields["anova"], **changed}}, p_adjust


@parametrize("count", [20, pytest.param(300, marks=pytest.mark.long)])
def test_data_are_found_for_what_true_data_print(count):
    studies = [true_study(seed) for seed in range(count)]
    assert not any(contradicts(fields) for fields, _ in studies)
    answers = [feasibility(PublishedStudy("s", **fields), by).feasible for fields, by in studies]
    assert answers.count(False) == 0
    assert answers.count(None) <= 0.01 * count


@parametrize("count", [20, pytest.param(230, marks=pytest.mark.long)])
def test_a_changed_digit_is_seen(count):
    changed = map(with_a_changed_digit, itertools.count())
    studies = itertools.islice((study for study in changed if contradicts(study[0])), count)
    answers = [feasibility(PublishedStudy("s", **fields), by).feasible for fields, by in studies]
    assert answers.count(True) <= 0.01 * count
    assert answers.count(False) >= 0.97 * count


def test_no_reading_of_true_data_is_called_a_contradiction():
    for seed in range(1000, 1100):
        fields, p_adjust = true_study(seed, (NEITHER, BOTH, ONLY_P, ONLY_DF))
        assert contradictions(PublishedStudy("s", **fields), p_adjust) == {}, seed


@pytest.mark.slow
@parametrize(
    "names",
    [
        pytest.param(["uav.followed", "uav.human_performance"], id="two"),
        pytest.param(list(STUDIES), marks=pytest.mark.long, id="all"),
    ],
)
def test_the_printed_studies_are_consistent_with_bonferroni(names, monkeypatch):
    if len(names) == 2:
        monkeypatch.setattr(f"{SEARCH}.STARTS", 12)
    for name in names:
        for p_adjust in ADJUSTMENTS:
            answer = feasibility(STUDIES[name], p_adjust)
            found = name not in NOT_FOUND.get(p_adjust, ())
            assert answer.rest_feasible is (True if found else None)
            assert answer.feasible is (False if answer.left_out else answer.rest_feasible)
            assert (answer.conflict == ()) == found


def test_a_paper_that_always_corrects_is_read_as_such(monkeypatch):
    """True data, printed with Greenhouse–Geisser degrees of freedom and no test of sphericity."""
    monkeypatch.setattr(f"{SEARCH}.STARTS", 12)
    cells = "mean.A = 1.37, mean.B = 1.01, mean.C = 1.56, sd.A = 1.47, sd.B = 1.91, sd.C = 1.34"
    anova = "anova.F = 0.63, anova.df1 = 1.60, anova.df2 = 17.64, anova.p = .509"
    printed = study_of(f"n = 12, {cells}, {anova}")
    answer = feasibility(printed)
    assert answer.feasible
    assert "Read as" in answer.message
    assert "Read as" not in feasibility(study_of(f"n = 12, {cells}")).message
    violated = feasibility(replace(printed, not_spherical=True))
    assert violated.feasible is None
    assert not violated
    assert "No data with all that is printed were found from" in violated.message
    table = violated.table()
    assert set(table.index[table["in_conflict"]]) == set(violated.conflict)


THREE = "n = 20, mean.A = 5.0, mean.B = 4.25, mean.F = 3.50, sd.A = 1.0, sd.B = 1.10, sd.F = 0.90"
# var(a − b) ≥ (s_a − s_b)², so that t is at most √n |m_a − m_b|/|s_a − s_b|.
TWO = "n = 36, mean.A = 5.0, mean.B = 6.0, sd.A = 1.0, sd.B = 2.0"
# F is the square of t.
ALIKE = "n = 10, mean.A = 1.00, mean.B = 2.00, sd.A = 1.00, sd.B = 1.00, t_test.t = -2.50"
TLX = STUDIES["uav.tlx"].table()["printed"].items()
TLX = ", ".join(["n = 36", *(f"{name} = {text}" for name, text in TLX)])


@parametrize(
    ("printed", "names", "reason"),
    [
        (f"{TLX}, anova.eta2 = 0.164", "anova.eta2", "= 0.164, but F gives"),
        (f"{TLX}, anova.p = 0.03", "anova.p", "= 0.03, but F and"),
        (f"{TLX}, anova.df1 = 3.375", "anova.df1", "3.375 needs ε"),
        (f"{TLX}, anova.df2 = 124.63", "anova.df2", "124.63 needs ε"),
        (f"{THREE}, anova.F = 8.1, anova.p = 1.2", "anova.p", "must lie between 0 and 1"),
        (f"{THREE}, anova.F = 8.1, anova.p = <0", "anova.p", "must lie between 0 and 1"),
        (f"{THREE}, anova.eta2 = 1.3", "anova.eta2", "must lie between 0 and 1"),
        (f"{THREE}, epsilon = 0.3", "epsilon", "must lie between 0.5 and 1"),
        (f"{THREE}, epsilon = 1.2", "epsilon", "must lie between 0.5 and 1"),
        (f"{THREE}, pairs.A-F = 1.2", "pairs.A-F", "must lie between 0 and 1"),
        (f"{THREE}, mauchly.df = 9", "mauchly.df", "must be 2 for 3 conditions"),
        (f"{THREE}, mauchly.chi2 = 9.9, mauchly.p = .5", "mauchly.p", "χ² gives 0.006"),
        (f"{THREE}, anova.F = -3", "anova.F", "must lie between 0 and inf$"),
        (f"{THREE}, sd.A = -1", "sd.A", "must lie between 0 and inf$"),
        # All but one at 0: at most the mean times √n, 5.05 √20 = 22.6.
        (
            f"{THREE}, sd.A = 23.7, scale = 0 to inf",
            "sd.A",
            "for 20 values from 0 to inf with mean 5.0",
        ),
        (f"{THREE}, mean.A = >7, scale = 1 to 7", "mean.A", "7 on its scale"),
        (f"{THREE}, t_test.t = 2", "t_test.t", "compares two conditions, and there are 3"),
        (f"{THREE}, n = 3, mean.G = 3, mauchly.p = .2", "mauchly.p", "no test of sphericity"),
        (f"{TWO}, t_test.t = 9.5", "t_test.t", "means and standard deviations allow"),
        (f"{TWO}, t_test.p = .5", "t_test.p", "means and standard deviations allow"),
        (f"{TWO}, t_test.t = 2.10, t_test.p = .50", "t_test.p", "t gives 0.04"),
        (f"{ALIKE}, anova.F = 9.25", "t_test.t", "F gives"),
        (f"{ALIKE}, anova.F = 6.25", "", ""),
        # F(2.1, 37.8) of three conditions: 37.8/2.1 = n − 1, and 2.1 = 3 ε.
        (
            f"{THREE}, n = 19, anova.df1 = 2.1, anova.df2 = 37.8",
            "anova.df1 anova.df2",
            "2.1 and 37.8 belong to 4 conditions, n = 19, ε = 0.70",
        ),
        # F(1.74, 33.06) = 1.52 has p = .234; at ε = 1/3 and 1 it is .233 and .219.
        (f"{THREE}, mean.G = 4, sd.A = 2, anova.F = 1.52, anova.p = .234", "", ""),
        # A mean printed as a bound, with an SD printed as one: any F and any p.
        (
            "n = 8, mean.A = 0, mean.B = >0.0, sd.A = 0.0, sd.B = >0, t_test.t = 2, pairs.A-B = .3",
            "",
            "",
        ),
    ],
)
def test_numbers_that_cannot_be_are_named_with_their_reason(printed, names, reason):
    """A paper can print them: they are an answer, not an error."""
    found = contradictions(study_of(printed))
    assert list(found) == names.split()
    for said in found.values():
        assert re.search(reason, said), said


@parametrize("name", ["p", "a.p", "pdf", "epsilon"])
def test_conditions_may_have_the_names_of_statistics(name):
    """A negative mean of "pdf" is no number of degrees of freedom, one of "p" no p-value."""
    study = study_of(f"n = 12, mean.{name} = -5.0, mean.B = -6.0, sd.{name} = 1.0, sd.B = 1.0")
    assert feasibility(study).scores.mean(axis=0).round(1).tolist() == [-5.0, -6.0]
    ((named, said),) = contradictions(replace(study, scale=(-5.5, 7))).items()
    assert named == "mean.B"
    assert "-5.5 and 7 on its scale" in said


def test_too_many_degrees_of_freedom_were_not_corrected():
    """No ε makes them larger, so that with them p alone can be corrected."""
    many = study_of(f"{THREE}, anova.F = 5.2, anova.df1 = 4, anova.df2 = 112")
    assert [reading.df for reading in readings(many)] == [many.corrected, False]


def printed_at_random(rng):
    """A number as a misprint or a careless table may have it."""
    value = rng.normal() * 10.0 ** rng.uniform(-3.0, 3.0)
    text = f"{value:.{rng.integers(0, 4)}f}" if rng.random() < 0.9 else "0"
    return rng.choice(["<", ">"]) + text.lstrip("-") if rng.random() < 0.15 else text


TESTS = ["anova.F", "anova.df1", "anova.df2", "anova.p", "anova.eta2", "pairs.A-B"]
TESTS += ["mauchly.chi2", "mauchly.df", "mauchly.p", "t_test.t", "t_test.df", "t_test.p"]


@pytest.mark.filterwarnings("error")
@parametrize(("count", "seed"), [(3, 9), pytest.param(150, 4, marks=pytest.mark.long)])
def test_no_row_of_numbers_raises(count, seed):
    """Whatever is printed, the answer says what is wrong with it."""
    rng = default_rng(seed)
    for _ in range(count):
        conditions = "ABCD"[: rng.integers(2, 5)]
        cells = [f"{cell}.{name}" for cell in ("mean", "sd") for name in conditions]
        names = [name for name in [*cells, *TESTS] if rng.random() < 0.7]
        numbers = [f"{name} = {printed_at_random(rng)}" for name in names]
        numbers += ["scale = 1 to 7"] if rng.random() < 0.3 else []
        text = ", ".join([f"n = {rng.integers(3, 30)}, mean.A = 1", *numbers])
        answer = feasibility(study_of(text, conditions=(*conditions,)))
        assert answer.message
        assert len(answer.table()) >= 1


# --- readings -------------------------------------------------------------------------------------


def epsilon_of(values):
    return textbook.analysed(values)["epsilon"]


FOUR = "n = 18, scale = 1 to 7, mean.A = 2.31, mean.B = 3.05, mean.C = 3.40, mean.D = 2.90"
FOUR += ", sd.A = 0.84, sd.B = 0.79, sd.C = 0.95, sd.D = 1.02, anova.F = 4.10"
PLAIN = f"{FOUR}, anova.df1 = 3, anova.df2 = 51"
CORRECTED = f"{FOUR}, anova.df1 = 1.65, anova.df2 = 28.05"
# p of F = 4.1 with these degrees of freedom times ε.
P, P_CORRECTED = (f"anova.p = {stats.f.sf(4.1, 3 * e, 51 * e):.3f}" for e in (1.0, 0.55))


@parametrize(
    ("printed", "reading"),
    [
        (f"{PLAIN}, {P}", NEITHER),
        (f"{PLAIN}, {P}, epsilon = 0.55", NEITHER),
        (f"{CORRECTED}, {P_CORRECTED}, epsilon = 0.55", BOTH),
        (f"{CORRECTED}, {P_CORRECTED}", BOTH),
        (f"{PLAIN}, {P_CORRECTED}, epsilon = 0.55", ONLY_P),
        (f"{PLAIN}, {P_CORRECTED}", ONLY_P),
        (f"{PLAIN}, anova.p = .03, epsilon = 0.55", ONLY_P),
        (f"{CORRECTED}, {P}, epsilon = 0.55", ONLY_DF),
    ],
)
def test_what_was_corrected_is_recognised(printed, reading):
    answer = feasibility(study_of(printed))
    assert answer.feasible
    assert answer.reading == reading.words
    assert reading.words in answer.message
    values = answer.scores
    factors = [epsilon_of(values) if c else 1.0 for c in reading[1:3]]
    assert textbook.misses(answer.study, values, *factors) == set()


def test_a_rounded_epsilon_is_recognised():
    answer = feasibility(study_of(f"{CORRECTED}, {P_CORRECTED}, epsilon = 0.554"))
    assert answer.feasible
    assert answer.reading.endswith("ε rounded to 0.55")
    assert textbook.misses(answer.study, answer.scores, 0.55, 0.55) == set()
    # Negative control: a third ε fits nothing.
    assert not feasibility(study_of(f"{CORRECTED}, anova.p = .034, epsilon = 0.614"))


def test_the_message_names_the_reading_that_an_answer_needs():
    """Without a printed p it kept the rounded ε to itself, under which alone these can hold."""
    anova = "anova.F = 20.10, anova.df1 = 1.60, anova.df2 = 30.40"
    answer = feasibility(study_of(f"{THREE}, {anova}, epsilon = 0.75"))
    assert "corrected by ε rounded to 0.8" in answer.message


def test_a_contradiction_is_never_consistent():
    """F(3, 57) with n = 18: degrees of freedom of 20 people."""
    study = study_of(f"{FOUR}, anova.df1 = 3, anova.df2 = 57, anova.p = .03")
    answer = feasibility(study)
    assert answer.feasible is False
    assert answer.rest_feasible
    reason = answer.left_out["anova.df2"]
    assert "belong to 4 conditions, n = 20" in reason
    assert reason in answer.message
    assert answer.table().loc["anova.df2", "left_out"] == reason
    values = answer.scores
    assert textbook.misses(study, values, p=epsilon_of(values)) == {"anova.df2"}
    # The n that the message names is consistent.
    assert feasibility(replace(study, n=20))


def test_a_study_of_which_nothing_is_left_is_answered():
    """Its only number cannot be."""
    answer = feasibility(study_of("n = 12, mean.A = 9, scale = 1 to 7", conditions=[*"AB"]))
    assert answer.feasible is False
    assert answer.rest_feasible
