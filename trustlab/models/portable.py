"""
Elementary functions from +, −, × and ÷ alone, so that every machine gets the same bits.

IEEE 754 fixes the results of these four operations, of the square root, of rounding to a whole
number and of scaling by powers of 2, but not those of a library's sine or exponential. The
polynomials are those of fdlibm (Sun Microsystems, 1993; freely distributable). Angles are reduced
by π/2 in two parts: within 2 units in the last place, or 10⁻²¹, for |x| ≤ 10⁵; `exponential` is
within 1 unit.
"""

import math

import numpy as np

from trustlab.models.compiled import njit


@njit
def cos_sin(x):
    """Return the cosine and the sine of an angle."""
    turns = np.floor(x * 0.6366197723675814 + 0.5)
    # π/2 in two parts; the first has 33 bits, so that its small multiples are exact.
    near, rest = x - turns * 1.57079632673412561417, turns * 6.07710050650619224932e-11
    a = near - rest
    tail = (near - a) - rest
    z = a * a
    c = -2.75573143513906633035e-07 + z * (
        2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
    )
    c = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * c)
    c = z * (4.16666666666666019037e-02 + z * c)
    half = 0.5 * z
    cos = (1.0 - half) + (((1.0 - (1.0 - half)) - half) + (z * c - a * tail))
    s = 2.75573137070700676789e-06 + z * (
        -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    )
    s = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * s)
    sin = a - ((z * (0.5 * tail - z * a * s) - tail) + 1.66666666666666324348e-01 * (z * a))
    if int(turns) & 1:
        cos, sin = -sin, cos
    return (-cos, -sin) if int(turns) & 2 else (cos, sin)


@njit
def arctangent(x):
    """Return the angle in [0, π/2] whose tangent is x ≥ 0."""
    if x < 0.4375:
        high, low = 0.0, 0.0
    elif x < 0.6875:
        high = 4.63647609000806093515e-01
        low = 2.26987774529616870924e-17
        x = (2.0 * x - 1.0) / (2.0 + x)
    elif x < 1.1875:
        high = 7.85398163397448278999e-01
        low = 3.06161699786838301793e-17
        x = (x - 1.0) / (x + 1.0)
    elif x < 2.4375:
        high = 9.82793723247329054082e-01
        low = 1.39033110312309984516e-17
        x = (x - 1.5) / (1.0 + 1.5 * x)
    else:
        high = 1.57079632679489655800e00
        low = 6.12323399573676603587e-17
        x = -1.0 / x
    z = x * x
    w = z * z
    odd = 6.66107313738753120669e-02 + w * (
        4.97687799461593236017e-02 + w * 1.62858201153657823623e-02
    )
    odd = 3.33333333333329318027e-01 + w * (
        1.42857142725034663711e-01 + w * (9.09088713343650656196e-02 + w * odd)
    )
    even = -7.69187620504482999495e-02 + w * (
        -5.83357013379057348645e-02 + w * -3.65315727442169155270e-02
    )
    even = w * (-1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01 + w * even))
    return high - ((x * (z * odd + even) - low) - x)


@njit
def direction(y, x):
    """Return the angle of the vector (x, y), in (−π, π]; 0 for no vector."""
    angle = 0.0 if y == 0.0 else 1.57079632679489655800e00
    if x != 0.0:
        angle = arctangent(abs(y) / abs(x))
    if x < 0.0:
        angle = 3.14159265358979311600e00 - (angle - 1.22464679914735320717e-16)
    return -angle if y < 0.0 else angle


@njit
def wrapped(angle):
    """Return the angle in (−π, π]."""
    return angle - 6.28318530717958623200e00 * np.ceil(angle * 0.15915494309189534561 - 0.5)


@njit
def exponential(x):
    """Return e to the power of x."""
    if not x < 709.78:
        return np.inf if x > 0.0 else np.nan
    if x < -745.13:
        return 0.0
    power = math.floor(x * 1.44269504088896338700 + 0.5)
    high = x - power * 6.93147180369123816490e-01
    low = power * 1.90821492927058770002e-10
    r = high - low
    z = r * r
    c = 6.61375632143793436117e-05 + z * (
        -1.65339022054652515390e-06 + z * 4.13813679705723846039e-08
    )
    c = r - z * (1.66666666666666019037e-01 + z * (-2.77777777770155933842e-03 + z * c))
    return math.ldexp(1.0 - ((low - r * c / (2.0 - c)) - high), int(power))
