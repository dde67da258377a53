"""
A robot at 20 Hz for two minutes over real DDS: from odometry to the command that answers it, and
what was lost.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.timing import NotComparedError, Row, tail

SECONDS = 120.0


def rows() -> Iterator[Row]:
    """Yield the delay of decisions, measured by a robot of another vendor, and the samples lost."""
    import pandas as pd

    from tests.ros.driving import MISSING, PEER, driven, run_for_peer
    from trustlab.ros.recorded import recorded_messages

    if MISSING:
        raise NotComparedError(f"there is no ROS 2: {MISSING}")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        log = folder / "robot.csv"
        robot = [PEER, "robot,operator", SECONDS + 100.0, log]
        run = driven(folder, robot, run_for_peer(folder), SECONDS + 5.0)
        ticks = pd.read_csv(log, names=["t", "v", "w", "delay", "stamp"])
        poses = [data for topic, _, data in recorded_messages(run.path) if topic == "/pose"]
    # A stamp is the first thing in a message with a header.
    stamps = [struct.unpack_from("<iI", data, 4) for data in poses]
    heard = [sec * 10**9 + nanosec for sec, nanosec in stamps]
    sent = ticks["stamp"][ticks["stamp"].between(heard[0], heard[-1])]
    lost = len(set(sent) - set(heard)) + max(len(heard) - len(run.decisions), 0)
    work = f"Robot over DDS at 20 Hz for {SECONDS:g} s, odometry to command"
    note = f"{len(sent)} samples, {lost} lost"
    yield tail(work, 1e3 * ticks["delay"].dropna(), 5.0, ", none lost", lost == 0, note)
