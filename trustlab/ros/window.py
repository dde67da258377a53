"""The mean over a window, value by value, with the bits that `window_mean` has for a whole log."""

import math
from collections import deque


class WindowMean:
    """
    The mean of the last `samples` values.

    pandas, on which `window_mean` relies, compensates what is added and what leaves the window
    apart (Kahan), and returns equal values and zeros exactly; so does this class.
    """

    def __init__(self, samples: int):
        self.samples = samples
        self.values: deque[float] = deque()
        self.sum = 0.0
        self.gain = 0.0  # compensation of additions
        self.loss = 0.0  # compensation of removals
        self.negative = 0
        self.equal = 0
        self.last = math.nan

    def step(self, value: float) -> float:
        """Add a value and return the mean."""
        if len(self.values) == self.samples:
            oldest = self.values.popleft()
            self.sum, self.loss = _compensated(self.sum, -oldest, self.loss)
            self.negative -= math.copysign(1.0, oldest) < 0.0
        self.sum, self.gain = _compensated(self.sum, value, self.gain)
        self.negative += math.copysign(1.0, value) < 0.0
        self.equal = self.equal + 1 if value == self.last else 1
        self.last = value
        self.values.append(value)
        return self._mean(len(self.values))

    def _mean(self, count: int) -> float:
        mean = self.sum / count
        if self.equal >= count:
            return self.last
        if self.negative == 0:
            return max(mean, 0.0)
        if self.negative == count:
            return min(mean, 0.0)
        return mean


def _compensated(total: float, value: float, compensation: float) -> tuple[float, float]:
    term = value - compensation
    after = total + term
    return after, after - total - term
