"""Random signals of tests, from smooth to rough and of any size."""

import numpy as np


def random_signals(rng, t, size=3, fastest=2.0):
    """Two signals at times t [s]: each noise, sines up to 10^`fastest` rad/s, or steps."""
    count, drawn = len(t), []
    for kind in rng.integers(3, size=2):
        if kind == 0:
            signal = rng.normal(size=(count, size))
        elif kind == 1:
            rate = 10 ** rng.uniform(-1.0, fastest)
            signal = np.sin(rate * t[:, None] + rng.uniform(0.0, 6.0, size))
        else:
            signal = np.repeat(rng.normal(size=(count // 30 + 1, size)), 30, axis=0)[:count]
        drawn.append(10 ** rng.uniform(-2.0, 2.0) * signal)
    return drawn
