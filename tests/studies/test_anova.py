"""
The engine. Oracles: SciPy; Mauchly's test and ε by hand, and as programs print them
(audit/test_verdict.py); theorems; R in test_against_r.py, and in test_factorial.py for sums of
squares.
"""

import numpy as np
import pandas as pd
from scipy import stats

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import parametrize
from trustlab.studies.anova import Design, effects, mauchly_p_value

OMNIBUS = ["F", "p", "p_gg", "p_hf", "epsilon_gg", "epsilon_hf", "epsilon_hf_untruncated"]
OMNIBUS += ["eta2_partial", "eta2_generalized", "mauchly_w", "mauchly_chi2", "mauchly_p"]


def draw(studies, n, k, seed=0):
    rng = np.random.default_rng(seed)
    scores = rng.standard_normal((studies, n, k)) * np.linspace(1.0, 2.0, k)
    return scores + rng.standard_normal((studies, n, 1)) + 0.3 * np.arange(k)


def analysed(array):
    return tl.repeated_measures_batch(array).droplevel("effect")


@parametrize(
    ("n", "k", "defined"),
    [(9, 2, False), (3, 3, True), (3, 4, False), (5, 5, True), (5, 6, False)],
)
def test_mauchly_needs_n_above_k_less_one(n, k, defined):
    batch = analysed(draw(20, n, k))
    assert (np.isfinite(batch[["mauchly_w", "mauchly_p"]]) == defined).all(axis=None)
    assert np.isfinite(batch[["F", "p", "epsilon_gg", "epsilon_hf", "p_gg", "p_hf"]]).all(axis=None)


def test_mauchly_is_refused_where_a_condition_is_the_mean_of_two_others():
    """Where it is so nearly, the test is defined."""
    array = draw(300, 12, 4)
    # Eigenvalues of ± 1e-17: both signs occur.
    array[::2, :, 3] = array[::2, :, :2].mean(axis=2)
    array[1, :, 3] = array[1, :, :2].mean(axis=1) + 1e-5 * array[1, :, 2]
    batch = analysed(array)
    assert np.isnan(batch.mauchly_w).tolist() == [True, False] * 150
    assert 0.0 < batch.mauchly_w[1] < 1e-9
    assert np.isfinite(batch.p_gg).all()


def test_false_positives_at_the_level():
    """Theorem: under sphericity and no effect, p is uniform; so is Mauchly's, nearly."""
    batch = analysed(np.random.default_rng(7).standard_normal((20_000, 20, 4)))
    for name in ("p", "mauchly_p"):
        assert stats.kstest(batch[name], "uniform").pvalue > 0.01, name


def test_a_study_without_error_is_named():
    array = draw(11, 8, 3)
    array[7] = 3.0
    with refused("array: study 7: the error variance is zero for condition "):
        analysed(array)


def test_units_cost_no_digits_and_those_beyond_double_precision_are_refused():
    array = draw(1, 5, 4)
    for unit in (1e160, 1e-170):
        with refused("no number holds it"), np.errstate(over="ignore"):
            analysed(array * unit)
    usual = analysed(array)
    for unit in (1e-95, 1e-20, 1e130):
        pd.testing.assert_frame_equal(analysed(array * unit)[OMNIBUS], usual[OMNIBUS], rtol=1e-9)


def test_a_factor_with_a_cross_in_its_name_keeps_its_place():
    """Main effects come first, in the order of the design, whatever they are called."""
    design = Design(8, {"A × B": range(2), "C": range(2)})
    table = effects(np.random.default_rng(0).normal(size=(1, 8, 4)), design)
    assert table.loc[0].index.tolist() == ["A × B", "C", "A × B × C"]


# ---- sphericity


def test_a_p_value_is_at_most_1():
    """The expansion exceeds 1 where subjects are as few as conditions, ten of either here."""
    assert mauchly_p_value(26.8, n=10, k=10) == 1.0
