"""
The session that every case works on: the pilot operator, 20,000 samples at 10 Hz, eight phases,
white noise.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

import trustlab as tl

SAMPLES = 20_000
PHASE = 2_500
SAMPLE_TIME = 0.1
NOISE = 0.003
SEED = 20_190


def pilot() -> tl.TscModel:
    """Return the model of the pilot operator of Section 2.3."""
    robot = tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.4602)
    return tl.TscModel(robot, tl.HumanModel(a=0.9991, beta=0.74, p_min=0.391, p_max=0.4602))


def modes() -> np.ndarray:
    """Return manual and autonomous phases of 250 s in turns, manual first."""
    return (np.arange(SAMPLES) // PHASE % 2 == 0).astype(float)


def session() -> tl.Session:
    """Return a run of the pilot operator with white measurement noise on both performances."""
    run = pilot().simulate(modes())
    rng = np.random.default_rng(np.random.SeedSequence(SEED))
    noisy = {
        name: run[name].to_numpy() + rng.normal(0.0, NOISE, SAMPLES) for name in ("p_r", "p_h")
    }
    t = pd.Index(SAMPLE_TIME * np.arange(SAMPLES), name="t")
    frame = pd.DataFrame({"mode": run["mode"].to_numpy(), **noisy}, index=t)
    return tl.Session(
        frame, tl.Metadata(participant=1, source=f"benchmarks, seed {SEED}", synthetic=True)
    )
