"""
Write the synthetic sessions of this folder: the pilot operator and the five participants of Table
2.1.

Each follows (2.3), (2.5) and (2.6) exactly, with the printed parameters, at 10 Hz: ten minutes
manual, ten minutes autonomous, then mixed phases of one to four minutes; white measurement noise of
standard deviation 0.003 is added to both performances, which are rounded to five decimals. Seeds:
SeedSequence(SEED), one child per operator.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import trustlab as tl
from trustlab.reproduction import published_models

SEED = 2020
STEPS = 20_000
SAMPLE_TIME = 0.1
NOISE = 0.003


def mode_phases(rng: np.random.Generator) -> np.ndarray:
    """
    Return 0/1 modes: 6000 samples manual, 6000 autonomous, then phases of 600 to 2400 samples in
    turn.
    """
    lengths, total = [6000, 6000], 12_000
    while total < STEPS:
        lengths.append(int(rng.integers(600, 2401)))
        total += lengths[-1]
    modes = np.arange(len(lengths)) % 2 == 0
    return np.repeat(modes.astype(float), lengths)[:STEPS]


def make_session(name: str, model: tl.TscModel, child: np.random.SeedSequence) -> tl.Session:
    """Return one operator's session."""
    rng = np.random.default_rng(child)
    mode = mode_phases(rng)
    run = model.simulate(mode, r0=0.0)
    noise = NOISE * rng.standard_normal((2, STEPS))
    frame = pd.DataFrame(
        {
            "mode": mode,
            "p_r": (run["p_r"] + noise[0]).round(5),
            "p_h": (run["p_h"] + noise[1]).round(5),
        }
    )
    frame.index = pd.Index(np.arange(STEPS) * SAMPLE_TIME, name="t").map(lambda t: round(t, 1))
    more = {
        "seed": SEED,
        "spawn_key": int(child.spawn_key[0]),
        "noise_sd": NOISE,
        "generator": "make_sessions.py",
    }
    return tl.Session(
        frame, tl.Metadata(participant=name, condition="identification", synthetic=True, more=more)
    )


def main(folder: Path) -> None:
    """Write all sessions into `folder`: the pilot's as CSV, the others as Parquet."""
    models = published_models()
    for (name, model), child in zip(
        models.items(), np.random.SeedSequence(SEED).spawn(len(models)), strict=True
    ):
        path = folder / ("pilot.csv" if name == "pilot" else f"participant_{name}.parquet")
        tl.write_session(make_session(name, model, child), path)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
