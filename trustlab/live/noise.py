"""
Random numbers that every machine draws alike: SplitMix64 of a seed and a count, for the steps that
draw from a generator.
"""

import numpy as np
from numba import types
from numba.extending import overload_method

from trustlab.models.compiled import njit
from trustlab.teleoperation.records import record

HASHED = record(counts="seed drawn")
"""A source of numbers: its seed, and how many were drawn."""


@njit
def logarithm(x):
    """
    Return the natural logarithm of a positive number from + − × ÷ alone, by fdlibm's polynomial
    (Sun Microsystems, 1993).
    """
    halvings = 0.0
    while x < 0.70710678118654752440:
        x, halvings = 2.0 * x, halvings - 1.0
    while x > 1.41421356237309504880:
        x, halvings = 0.5 * x, halvings + 1.0
    f = x - 1.0
    s = f / (2.0 + f)
    z = s * s
    r = 1.531383769920937332e-01 + z * 1.479819860511658591e-01
    r = 2.857142874366239149e-01 + z * (
        2.222219843214978396e-01 + z * (1.818357216161805012e-01 + z * r)
    )
    r = z * (6.666666666666735130e-01 + z * (3.999999999940941908e-01 + z * r))
    half = 0.5 * f * f
    # ln 2 in two parts
    return halvings * 6.93147180369123816490e-01 - (
        (half - (s * (half + r) + halvings * 1.90821492927058770002e-10)) - f
    )


@njit
def uniform(source):
    """
    Return the next number in [0, 1) of a record of HASHED: SplitMix64 (Steele, Lea and Flood,
    2014).
    """
    source.drawn += 1
    z = np.uint64(source.seed) + np.uint64(source.drawn) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


@njit
def normal(source):
    """Return the next standard normal number of a record of HASHED, by Marsaglia's polar method."""
    while True:
        x, y = 2.0 * uniform(source) - 1.0, 2.0 * uniform(source) - 1.0
        square = x * x + y * y
        if 0.0 < square < 1.0:
            return x * np.sqrt(-2.0 * logarithm(square) / square)


# Within compiled steps, a record of HASHED answers to the two methods of numpy's generators that
# they call. For this processor, target="cpu", and not any: numba then asks here before it looks for
# a field of that name, whatever was compiled before this module was imported.
def _is_source(record):
    return set(record.fields) == set(HASHED.names)


@overload_method(types.Record, "random", target="cpu")
def _random(source):
    return (lambda source: uniform(source)) if _is_source(source) else None


@overload_method(types.Record, "standard_normal", target="cpu")
def _standard_normal(source):
    return (lambda source: normal(source)) if _is_source(source) else None
