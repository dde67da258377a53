"""What the likelihood reads from runs: block means, and stretches of constant mode."""

import numpy as np

from trustlab.identification.log import Run, undo_window
from trustlab.identification.model import IdentificationError
from trustlab.identification.posterior.likelihood import Blocks

# Length of a block [s], short beside every time constant of the models.
BLOCK = 1.0

# Blocks that a run needs at least.
FEWEST = 8

OUTPUTS = ("p_h", "p_r")


def blocks_of(runs: list[Run]) -> Blocks:
    """Return runs as means over blocks of at most a second; windows are undone first."""
    step = runs[0].sample_time
    samples = max(1, int(BLOCK / step + 1e-6))
    parts = [_stretches(run["mode"], samples) for run in runs]
    counts = [run.size // samples for run in runs]
    for run, count in zip(runs, counts, strict=True):
        if count < FEWEST:
            raise IdentificationError(
                f"{run.label} lasts {run.size * step:g} s, too short to tell anything of time "
                f"constants of tens of seconds; record at least {FEWEST * samples * step:g} s"
            )
    first_block = np.cumsum([0, *counts])
    return Blocks(
        measured=np.column_stack([_means(run, samples) for run in runs]),
        lengths=np.concatenate([part[0] for part in parts]),
        modes=np.concatenate([part[1] for part in parts]),
        block=np.concatenate([part[2] + at for part, at in zip(parts, first_block, strict=False)]),
        first_stretch=np.cumsum([0, *(part[0].size for part in parts)]),
        first_block=first_block,
        step=step,
        samples=samples,
    )


def _stretches(mode: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return length, mode and block of every stretch of constant mode within a block."""
    size = mode.size // samples * samples
    starts = np.unique(np.r_[np.arange(0, size, samples), np.flatnonzero(np.diff(mode[:size])) + 1])
    lengths = np.diff(np.r_[starts, size])
    return lengths, np.ascontiguousarray(mode[starts], dtype=float), starts // samples


def _means(run: Run, samples: int) -> np.ndarray:
    """Return block means of both outputs, shape (2, blocks)."""
    size = run.size // samples * samples
    rows = []
    for name in OUTPUTS:
        values = run[name] if run.window == 1 else undo_window(run[name], run.window)
        rows.append(values[:size].reshape(-1, samples).mean(axis=1))
    return np.array(rows)
