"""
Compile the large kernels in two processes at once: `python notebooks/compile_kernels.py`.

`make test` and `make reports` begin with it, because parallel tests and notebooks would otherwise
compile the same kernels at the same time. Where they are compiled already, it does no more than
load them.
"""

from concurrent.futures import ProcessPoolExecutor

import networkx as nx
import numpy as np

import trustlab as tl


def _ground_robot() -> None:
    tl.run_condition("C3", participant=2, laps=2, seed=0)
    tl.virtual_study(n=4, testbed="uav_following", conditions=["C1", "C3"], seed=0)


def _the_rest() -> None:
    tl.simulate_teleoperation("TMIG", seed=0, duration=1.0)
    tl.simulate_team(nx.cycle_graph(4), policy="most_trusted", goal=(1.0, 2.0, 0.5), seed=0)
    tl.invariant_bounds(tl.published_models()["2"], 0.0, 0.35)
    run = tl.published_models()["2"].simulate(np.repeat([1.0, 0.0], 500))
    tl.fit_tsc(tl.Session(run.set_index(0.1 * run.index), tl.Metadata(synthetic=True)))


if __name__ == "__main__":
    with ProcessPoolExecutor(2) as pool:
        for half in [pool.submit(_ground_robot), pool.submit(_the_rest)]:
            half.result()
