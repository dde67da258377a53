"""
Noise of live drives. Oracles: SplitMix64 in Python's whole numbers, numpy's generators, SciPy's
Kolmogorov–Smirnov test.
"""

import subprocess
import sys

import numba
import numpy as np
import pytest
from scipy import stats

from trustlab.live.noise import HASHED, logarithm

MASK = 2**64 - 1


@numba.njit
def many(source, count):
    numbers = np.empty((count, 2))
    for k in range(count):
        numbers[k, 0], numbers[k, 1] = source.random(), source.standard_normal()
    return numbers


@numba.njit
def uniforms(source, count):
    return np.array([source.random() for _ in range(count)])


def source(seed):
    return np.array([(seed, 0)], HASHED)[0]


def split_mix(seed, count):
    z = (seed + count * 0x9E3779B97F4A7C15) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return ((z ^ (z >> 31)) >> 11) / 2**53


@pytest.mark.parametrize("seed", [0, 1234567, 2**62])
def test_hashed_numbers_are_those_of_splitmix(seed):
    assert uniforms(source(seed), 500).tolist() == [split_mix(seed, n) for n in range(1, 501)]


def test_published_numbers_of_splitmix():
    # The reference implementation (Vigna, 2015) begins with these from the seed 1234567.
    published = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert uniforms(source(1234567), 3).tolist() == [(z >> 11) / 2**53 for z in published]


def test_hashed_numbers_are_uniform_and_normal():
    numbers = many(source(5), 20_000)
    assert stats.kstest(numbers[:, 0], "uniform").pvalue > 0.01
    assert stats.kstest(numbers[:, 1], "norm").pvalue > 0.01
    assert abs(np.corrcoef(numbers[1:, 0], numbers[:-1, 0])[0, 1]) < 0.03
    assert stats.kstest(numbers[:, 1] * 1.05, "norm").pvalue < 0.01, "a spread wrong by 5 % is seen"


def test_generators_are_drawn_as_they_are():
    found, rng = many(np.random.default_rng(3), 50), np.random.default_rng(3)
    assert found.tolist() == [[rng.random(), rng.standard_normal()] for _ in range(50)]


def test_only_a_source_of_noise_has_the_methods_of_one():
    other = np.zeros(1, [("seed", np.int64)])[0]
    with pytest.raises(numba.core.errors.TypingError):
        uniforms(other, 1)


def test_logarithm():
    rng = np.random.default_rng(0)
    for x in np.r_[
        rng.random(3000), 10.0 ** rng.uniform(-15, 5, 2000), 1 + rng.normal(size=500) * 1e-5
    ]:
        exact = np.log(np.longdouble(x))
        assert abs(np.longdouble(logarithm(x)) - exact) <= 1.5 * np.spacing(abs(float(exact)))


def test_sources_answer_whatever_was_compiled_before():
    """In a process of its own, which has compiled something else first."""
    code = (
        "import numba, numpy as np\n"
        "numba.njit(lambda x: x + 1)(1)\n"
        "from trustlab.live.noise import HASHED\n"
        "source = np.zeros(1, HASHED)[0]\n"
        "print(numba.njit(lambda s: s.random() + s.standard_normal())(source))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-500:]
    assert np.isfinite(float(done.stdout))
