"""Communication delays: numbers, functions of time, random walks, and traces of packets."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trustlab.models.checks import (
    Seed,
    between,
    finite_array,
    in_order,
    not_negative,
    positive,
    shown,
    whole_seed,
)
from trustlab.models.simulation import asked

SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class Delay:
    """
    A delay as a function of the time of reception.

    Parameters
    ----------
    function : callable
        Takes times [s], shape (N,), and returns delays [s], shape (N,), or one for all.
    max_rate : float
        Ṫ_max, how fast the delay grows at most [s/s].
    title : str
        What it is, for errors.
    end : float
        Time up to which it is known [s].
    """

    function: Callable[[np.ndarray], np.ndarray | float]
    max_rate: float
    title: str
    end: float = np.inf

    def samples(self, count: int, sample_time: float) -> np.ndarray:
        """
        Return the delay at every sample, in seconds, checked.

        Parameters
        ----------
        count : int
            How many samples.
        sample_time : float
            T [s].

        Returns
        -------
        numpy.ndarray, shape (count,)
            At least one sample everywhere.

        Raises
        ------
        ValueError
            If a delay is not finite, below one sample, longer than the run, not known until the end
            of the run, or grows faster than `max_rate`; the time is named.
        """
        t = sample_time * np.arange(count)
        if t[-1] > self.end + SLACK:
            raise ValueError(
                f"{self.title} is known until {self.end:g} s, and the run lasts until {t[-1]:g} s"
            )
        values = asked(
            f"{self.title} gives no {count} delays",
            lambda: np.full(count, self.function(t), float),
        )
        length = count * sample_time
        least = sample_time * (1.0 - SLACK)
        growth = np.diff(np.nan_to_num(values), append=values[-1]) / sample_time
        for bad, reason in (
            (
                ~((values >= least) & (values <= length)),
                f"it must be at least one sample, {sample_time:g} s, and not be longer than the "
                f"run of {length:g} s",
            ),
            (
                growth > self.max_rate + 1e-6,
                f"from there it grows faster than max_rate = {self.max_rate:g}, for which f_i = "
                "√(1 − max_rate) is set (3.13); give a Delay whose max_rate covers it, up to 1, or "
                "a packet_delay, which read_out='ledger' keeps passive however it grows",
            ),
        ):
            if bad.any():
                k = int(np.argmax(bad))
                raise ValueError(f"{self.title} is {values[k]:g} s at t = {t[k]:g} s: {reason}")
        return np.maximum(values, sample_time)


def random_walk_delay(
    low: float,
    high: float,
    max_rate: float,
    seed: Seed = 0,
    hold: float = 0.5,
) -> Delay:
    """
    Return a delay that wanders between bounds, its rate drawn anew every `hold` seconds.

    Rates are uniform in [−max_rate, max_rate]; at a bound the delay stays until the rate leads away
    from it.

    Parameters
    ----------
    low, high : float
        Bounds [s], 0 < low < high.
    max_rate : float
        Ṫ_max in [0, 1].
    seed : int or numpy.random.SeedSequence
        Seed of the start and the rates.
    hold : float
        How long a rate lasts [s].

    Raises
    ------
    ValueError
        If bounds, rate, seed or hold are out of range.
    """
    low, high = in_order("low", positive("low", low), "high", high)
    hold, rate = positive("hold", hold), between("max_rate", max_rate, 0.0, 1.0)
    if not isinstance(seed, np.random.SeedSequence):
        seed = np.random.SeedSequence(whole_seed(seed))

    def walk(t: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(seed)  # drawn anew at each call: the same walk every time
        knots = max(int(np.ceil(t[-1] / hold)) + 1, 2)
        values = [rng.uniform(low, high)]
        for step in rng.uniform(-rate, rate, knots - 1) * hold:
            values.append(min(max(values[-1] + step, low), high))
        return np.interp(t, hold * np.arange(knots), values)

    return Delay(walk, rate, f"a random-walk delay in [{low:g}, {high:g}] s")


def packet_delay(sent: np.ndarray, received: np.ndarray) -> Delay:
    """
    Return the delay of a real network from a trace of packets, jitter, loss and overtaking
    included.

    At any time the newest packet that has arrived is read. Between arrivals the delay grows as fast
    as time, so that the trace needs read_out="ledger", the default, which is passive under any
    delay.

    Parameters
    ----------
    sent : array_like, shape (N,)
        When each packet was sent [s], in order; 0 is the start of the run.
    received : array_like, shape (N,)
        When it arrived [s]; NaN where it never did.

    Raises
    ------
    ValueError
        If the trace runs backwards: a packet sent before the one before it, or received before it
        was sent.
    """
    sent = finite_array("sent", sent)
    try:
        received = np.asarray(received, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"received must be times, got {shown(received)}") from None
    if received.shape != sent.shape:
        raise ValueError(
            f"sent and received need the same number of packets, got {sent.shape} and "
            f"{received.shape}"
        )
    backwards = (np.diff(sent, prepend=sent[0]) < 0.0) | (received < sent)
    if backwards.any():
        k = int(np.argmax(backwards))
        raise ValueError(
            f"the trace runs backwards: packet {k}, sent at t = {sent[k]:g} s, was sent before the "
            "one before it, or received before it was sent"
        )
    arrived = received[np.isfinite(received)]
    if not arrived.size:
        raise ValueError("no packet of the trace was ever received")
    order = np.argsort(received, kind="stable")  # those that never arrived come last
    arrivals, newest = received[order], np.maximum.accumulate(sent[order])

    def trace(times: np.ndarray) -> np.ndarray:
        if arrivals[0] > times[-1]:
            raise ValueError(
                f"the first packet of the trace arrives at {arrivals[0]:g} s, after the end of the "
                "run: give seconds from the start of the run, (sent - sent[0], received - sent[0])"
            )
        step = times[1] - times[0]
        last = np.searchsorted(arrivals, times + SLACK, side="right") - 1
        # nothing has been sent that could be read before the first packet; none is read in the
        # sample that it was sent in
        return np.maximum(times - np.where(last >= 0, newest[last], -step), step)

    return Delay(trace, np.inf, "a delay from a trace of packets", float(arrived.max()))


def delay_from(name: str, delay, max_rate: float) -> Delay:
    """Return a delay by its argument's name: from a number, a function of time, or a `Delay`."""
    if isinstance(delay, Delay):
        return replace(delay, title=f"{name}: {delay.title}")
    if callable(delay):
        return Delay(np.vectorize(delay, otypes=[float]), max_rate, name)
    title = f"{name}: a constant delay"
    seconds = not_negative(title, delay)
    return Delay(lambda t: seconds, 0.0, title)


def both_ways(delay: Any) -> dict[str, Any]:
    """Return the delays to the robot and back by name, from one for both ways or a pair."""
    pair = delay if isinstance(delay, tuple) else (delay, delay)
    if len(pair) != 2:
        raise ValueError(f"delay must be one for both ways, or (to the robot, back), got {pair}")
    return dict(zip(("delay to the robot", "delay back"), pair, strict=True))


def delays_in_samples(
    pair: Mapping[str, Any], max_rate: float, count: int, sample_time: float
) -> np.ndarray:
    """
    Return the delays both ways in samples, shape (2, count), from arguments by name.

    Delays within 1e-6 of a whole number of samples are made whole, so that rounding does not mix
    two samples.
    """
    delays = np.array(
        [
            delay_from(name, delay, max_rate).samples(count, sample_time) / sample_time
            for name, delay in pair.items()
        ]
    )
    whole = np.round(delays)
    return np.where(np.abs(delays - whole) < 1e-6, whole, delays)
