"""
Tasks of campaigns, made inside functions so that they go to workers by value, as those of notebooks
do.
"""

import numpy as np
import pytest


@pytest.fixture(scope="session")
def mean_task():
    """
    A task with numbers, text and truth values, and with failures where k is 2 and the first draw is
    large.
    """

    def task(n, k, seed):
        x = np.random.default_rng(seed).normal(size=n)
        if k == 2 and x[0] > 1.0:
            raise ValueError(f"first draw too large for n = {n}")
        return {
            "mean": x.mean(),
            "count": n,
            "sign": "+" if x[0] > 0 else "−",
            "positive": bool(x[0] > 0),
        }

    return task
