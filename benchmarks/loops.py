"""Loops at 100 Hz and 1 kHz: teleoperation, teams, virtual people."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import networkx as nx
import numpy as np

import trustlab as tl
from benchmarks.timing import Row, within


def logistic(state) -> tuple[np.ndarray, np.ndarray]:
    """Return TMIG's scales as a user would write them."""
    falls = [0.5 - 0.5 * np.tanh(5.0 * (t - 0.5)) for t in (state.trust_hr, state.trust_rh)]
    alpha = state.alpha_min + (state.alpha_max - state.alpha_min) * falls[0]
    return alpha, state.beta_min + (state.beta_max - state.beta_min) * falls[1]


def rows() -> Iterator[Row]:
    """Yield teleoperation, teams and virtual people."""
    yield from teleoperation()
    for robots, limit in ((4, 40.0), (100, 1e4)):
        graph = nx.circulant_graph(robots, [1, 2] if robots > 4 else [1])
        work = f"simulate_team, {robots} robots, a minute"
        yield within(work, lambda g=graph: tl.simulate_team(g, seed=0, duration=60.0), limit)
    work = "virtual_study, 1,000 people, five sessions of eight laps, two cores"
    tl.virtual_study(n=10, n_jobs=2)  # processes are there, kernels are compiled
    yield within(work, lambda: tl.virtual_study(n=1000, seed=1, n_jobs=2), 10_000.0, turns=1)


def teleoperation() -> Iterator[Row]:
    """Yield runs of two minutes, with our schemes and a user's, and a step of the optimal share."""

    def run(scheme="TMIG", **options):
        return tl.simulate_teleoperation(scheme, seed=1, duration=120.0, **options)

    work = "simulate_teleoperation, 120 s"
    yield within(work, run, 40.0)
    mine = tl.Scheme("mine", logistic)
    # Both have an exponential, whose last bits differ.
    np.testing.assert_allclose(run(mine).data, run().data, rtol=0.0, atol=1e-6)
    for name, scheme in (("a user's scheme, asked every sample", mine), ("scheme OMI", "OMI")):
        yield within(f"{work}, {name}", lambda s=scheme: run(s), 250.0)
    rng, blending = np.random.default_rng(3), tl.OptimalBlending()
    states = itertools.cycle(0.3 * rng.normal(size=(4000, 5, 3)))
    share = lambda: blending.step(*next(states))  # noqa: E731
    yield within("Optimal share of Appendix A, one step", share, 2.0)
