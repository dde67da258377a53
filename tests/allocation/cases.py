"""What several tests of the room share; equations written out, without the package."""

import warnings

import numpy as np

import trustlab as tl
from trustlab.allocation import TargetWarning

PILOT, SECOND = (tl.published_models()[name] for name in ("pilot", "2"))
START, TARGET = (0.02, 0.45), (0.15, 0.56)  # of Section 2.5


def shape(r, beta):
    """The curve of (2.6), from 0 at the ends to 1 at β."""
    return (r / beta) ** beta * ((1 - r) / (1 - beta)) ** (1 - beta)


def phases(mode):
    """Modes of the whole phases of a run, and their lengths."""
    mode = np.asarray(mode)
    edges = np.flatnonzero(np.diff(mode)) + 1
    return mode[edges[:-1]], np.diff(edges)


def corrector(model=PILOT, target=TARGET, **options):
    """A corrector, whose target may lie outside the limits of Theorem 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TargetWarning)
        return tl.ThresholdCorrector(model, target, **options)
