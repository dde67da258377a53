"""
A robot at 20 Hz for two minutes over real DDS: from odometry to the command that answers it, and
what was lost.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.timing import Row, Spread

TITLE = "Robot over ROS 2"
SECONDS = 120.0
LATEST_MS = 5.0


def rows() -> Iterator[Row]:
    """Yield the delay of decisions, measured by a robot of another vendor, and the samples lost."""
    from tests.ros.driving import MISSING

    case = f"Decisions at 20 Hz for {SECONDS:g} s"
    ours = "odometry sent to command received (the greatest is the 99th percentile)"
    goal = f"p99 ≤ {LATEST_MS:g} ms, no sample lost"
    if MISSING:
        yield Row(case, ours, "", goal=goal, fault=f"there is no ROS 2: {MISSING}")
        return
    with tempfile.TemporaryDirectory() as folder:
        delays, lost, samples = measured(Path(folder))
    tail = float(np.percentile(delays, 99))
    spread = Spread(float(np.median(delays)), float(delays.min()), tail)
    yield Row(
        case,
        ours,
        "",
        spread,
        goal=goal,
        met=tail <= LATEST_MS and lost == 0,
        note=f"{samples} samples, {lost} lost",
    )


def measured(folder: Path) -> tuple[np.ndarray, int, int]:
    """
    Return delays [ms], lost samples and samples.

    Parameters
    ----------
    folder : Path
        Where the run goes.
    """
    import pandas as pd

    from tests.ros.driving import PEER, driven, run_for_peer
    from trustlab.ros.recorded import recorded_messages

    log = folder / "robot.csv"
    robot = [PEER, "robot,operator", SECONDS + 100.0, log]
    run = driven(folder, robot, run_for_peer(folder), SECONDS + 5.0)
    ticks = pd.read_csv(log, names=["t", "v", "w", "age", "delay", "stamp"])
    # A stamp is the first thing in a message with a header.
    poses = [data for topic, _, data in recorded_messages(run.path) if topic == "/pose"]
    stamps = [struct.unpack_from("<iI", data, 4) for data in poses]
    heard = [sec * 10**9 + nanosec for sec, nanosec in stamps]
    sent = ticks["stamp"][ticks["stamp"].between(heard[0], heard[-1])]
    lost = len(set(sent) - set(heard)) + max(len(heard) - len(run.decisions), 0)
    return 1e3 * ticks["delay"].dropna().to_numpy(), lost, len(sent)
