"""
Infeasible is proved, feasible is shown; the proof never refutes what real data say; conflicts can
be named.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

import trustlab as tl
from trustlab.reproduction import compare_adjustments
from trustlab.reproduction.reconstruction.constraints import (
    ADJUSTMENTS,
    arithmetic_conflicts,
    constraints,
    select,
)
from trustlab.reproduction.reconstruction.feasibility import moment_problem
from trustlab.reproduction.reconstruction.moment_search import MomentProblem
from trustlab.reproduction.reconstruction.reconstruction import reanalyse
from trustlab.reproduction.reconstruction.relaxation import proves_infeasible

STUDIES = tl.published_studies()
IMPOSSIBLE = {
    "uav.robot_performance": ("holm", "none"),
    "uav.human_performance": ("none",),
    "uav.tlx": ("none",),
    "uav.satisfaction": ("none",),
    "uav.trust": ("none",),
    "teleop.tracking_error": ("holm", "none"),
    "teleop.tlx": ("none",),
    "teleop.satisfaction": ("none",),
    "teleop.trust": ("holm", "none"),
}


def refuted(study, p_adjust, branches=80):
    found = select(constraints(study, p_adjust), arithmetic_conflicts(study))
    return proves_infeasible(moment_problem(study, found, p_adjust), branches)


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_impossible_adjustments_are_proved_impossible(name):
    for p_adjust in IMPOSSIBLE[name]:
        assert refuted(STUDIES[name], p_adjust)


@pytest.mark.parametrize("name", STUDIES)
def test_possible_adjustments_are_not_refuted(name):
    for p_adjust in set(ADJUSTMENTS) - set(IMPOSSIBLE.get(name, ())):
        assert not refuted(STUDIES[name], p_adjust, branches=3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [
        pytest.param(["uav.tlx", "uav.followed", "teleop.tracking_error"], id="three"),
        pytest.param(list(STUDIES), marks=pytest.mark.long, id="all"),
    ],
)
def test_analyses_are_consistent_with_bonferroni(names):
    table = compare_adjustments({name: STUDIES[name] for name in names})
    assert len(table) == len(names) * len(ADJUSTMENTS)
    columns = ["feasible", "rest_feasible", "status", "violation", "left_out"]
    assert list(table.columns) == columns
    for (name, p_adjust), row in table.iterrows():
        possible = p_adjust not in IMPOSSIBLE.get(name, ())
        assert row["rest_feasible"] == possible
        assert row["feasible"] == (possible and row["left_out"] == "")
        assert row["status"] == ("solved" if possible else "proved")


def study_of(values, p_adjust, decimals):
    """A study that prints what these data have, under an adjustment."""
    n, k = values.shape
    names = tuple("ABCDE"[:k])
    blank = tl.PublishedStudy(
        "s", n, dict.fromkeys(names, "0"), dict.fromkeys(names, "1"), epsilon="1.0"
    )
    got = reanalyse(values, blank, p_adjust)

    def text(name, places):
        return f"{got[name]:.{places}f}"

    pairs = [f"{a}-{b}" for q, a in enumerate(names) for b in names[q + 1 :]]
    return tl.PublishedStudy(
        "s",
        n,
        {c: text(f"mean.{c}", decimals) for c in names},
        {c: text(f"sd.{c}", decimals) for c in names},
        anova={"F": text("anova.F", 3), "eta2": text("anova.eta2", 3), "p": text("anova.p", 3)},
        mauchly={"chi2": text("mauchly.chi2", 3), "p": text("mauchly.p", 3)},
        epsilon=text("epsilon", 3),
        pairs={
            p: "<.0005" if got[f"pairs.{p}"] < 0.0005 else text(f"pairs.{p}", 3)
            for p in pairs
            if got[f"pairs.{p}"] < 0.05
        },
    )


@settings(max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([3, 4, 5]),
    st.sampled_from(ADJUSTMENTS),
    st.integers(2, 4),
)
def test_what_data_say_is_never_refuted(seed, k, p_adjust, decimals):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(k + 3 + seed % 30, k)) @ (
        np.eye(k) + rng.normal(size=(k, k))
    ) + 1.5 * rng.normal(size=k)
    study = study_of(values, p_adjust, decimals)
    assert arithmetic_conflicts(study) == {}
    found = constraints(study, p_adjust)
    some = [s for s in found if rng.random() < 0.4] or found
    for said in (found, some):
        assert not proves_infeasible(moment_problem(study, said, p_adjust), branches=3)


def test_two_constraints_on_sphericity_alone_are_not_refuted():
    values = {
        "n": 12,
        "mean": {"A": "5", "B": "4", "C": "3"},
        "sd": {"C": "0.90"},
        "mauchly": {"p": "0.95"},
    }
    study = tl.PublishedStudy.from_dict({**values, "scale": (0, 9)})
    found = [s for s in constraints(study) if s.name in ("sd.C", "mauchly.p")]
    assert not proves_infeasible(MomentProblem(found, 12, 3, "none"))
    assert tl.feasibility(study)


@pytest.mark.parametrize("p_adjust", ADJUSTMENTS)
def test_what_data_say_is_found_again(p_adjust):
    rng = np.random.default_rng(8)
    values = rng.normal(size=(20, 4)) + rng.normal(size=(20, 1)) + np.array([0.0, 0.3, 0.8, 1.2])
    study = study_of(values, p_adjust, 3)
    result = tl.feasibility(study, p_adjust)
    assert result
    assert result.status == "solved"
    assert result.conflict == ()
    assert result.violation == 0.0


def test_a_paper_that_always_corrects_is_read_as_such():
    """True data, printed with Greenhouse–Geisser degrees of freedom and no test of sphericity."""
    printed = {
        "n": 12,
        "mean": {"C1": "1.37", "C2": "1.01", "C3": "1.56"},
        "sd": {"C1": "1.47", "C2": "1.91", "C3": "1.34"},
        "anova": {"F": "0.63", "df1": "1.60", "df2": "17.64", "p": ".509"},
    }
    assert tl.feasibility(tl.PublishedStudy("gg", **printed)).feasible
    violated = tl.PublishedStudy("gg", **printed, not_spherical=True)
    assert "mauchly.violated" in tl.feasibility(violated).message


def test_a_changed_f_is_refuted_and_the_conflict_named():
    study = STUDIES["uav.followed"]
    values = {
        "n": study.n,
        "mean": dict(study.mean),
        "sd": dict(study.sd),
        "t_test": {"t": "25.0"},
        "scale": study.scale,
    }
    result = tl.feasibility(tl.PublishedStudy.from_dict(values, "changed"))
    assert not result
    assert result.status == "proved"
    # var(a − b) ≥ (s_a − s_b)²: the least t possible is too large only for a smaller variance.
    assert set(result.conflict) == {"mean.C2", "mean.C4", "sd.C2", "sd.C4", "t_test.t"}
    assert "t_test.t" in result.remedies
    table = result.table()
    assert table.loc["t_test.t", "in_conflict"]
    assert table.loc["t_test.t", "remedy"]


def with_anova(name, **changes):
    study = STUDIES[name]
    fields = ("n", "mean", "sd", "conditions", "mauchly", "epsilon", "pairs", "scale")
    values = {field: getattr(study, field) for field in fields}
    return tl.PublishedStudy.from_dict({**values, "anova": {**study.anova, **changes}}, name)


def test_a_changed_f_of_an_analysis_is_refuted():
    assert not refuted(with_anova("uav.tlx"), "bonferroni", branches=3)
    assert refuted(with_anova("uav.tlx", F="60.0", eta2="0.632"), "bonferroni")
    assert refuted(with_anova("uav.tlx", F="2.5", eta2="0.067", p="0.055"), "bonferroni")


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"eta2": "0.164"}, "anova.eta2"),
        ({"p": "0.03"}, "anova.p"),
        ({"df1": "3.375"}, "anova.df1"),
        ({"df2": "124.63"}, "anova.df2"),
    ],
)
def test_arithmetic_conflicts_are_named(changes, name):
    conflicts = arithmetic_conflicts(with_anova("uav.tlx", **changes))
    assert list(conflicts) == [name]
    assert next(iter(changes.values())) in conflicts[name]


def test_the_printed_studies_have_one_arithmetic_conflict():
    found = {name: tuple(arithmetic_conflicts(study)) for name, study in STUDIES.items()}
    assert {name: c for name, c in found.items() if c} == {"teleop.tracking_error": ("anova.df1",)}


def test_mauchlys_p_is_that_of_packages():
    """
    Oracle: p of χ² = 7 at n = 9, k = 4 by the k form, written out, and the plain χ² tail, which
    packages do not print.
    """
    n = 9
    k = 4
    d = 3
    factor = n - 1 - (2 * d * d + d + 2) / (6 * d)
    weight = (
        (d + 2) * (d - 1) * (d - 2) * (2 * d**3 + 6 * d * d + 3 * k + 2) / (288 * (d * factor) ** 2)
    )
    plain, shifted = stats.chi2.sf(7.0, 5), stats.chi2.sf(7.0, 9)
    values = {"n": n, "mean": dict.fromkeys("ABCD", "5.0"), "sd": dict.fromkeys("ABCD", "1.0")}
    for p, conflicts in ((plain, ["mauchly.p"]), (plain + weight * (shifted - plain), [])):
        printed = {"chi2": "7.000", "p": f"{p:.4f}"}
        study = tl.PublishedStudy.from_dict({**values, "mauchly": printed})
        assert list(arithmetic_conflicts(study)) == conflicts


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="p_adjust must be one of"):
        tl.feasibility(STUDIES["uav.tlx"], "fdr")
    with pytest.raises(ValueError, match="study must be of class PublishedStudy"):
        tl.feasibility({"n": 3})
    with pytest.raises(ValueError, match="seed"):
        tl.feasibility(STUDIES["uav.tlx"], seed="0")
