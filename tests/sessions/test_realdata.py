"""
The shared-control study of Pan et al. (2024), where its files are. Oracle: its own header and
measures.
"""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from trustlab.sessions import (
    SessionError,
    external_data,
    read_sessions,
    tracking_error,
)

DATA = external_data("autonomy_cl_trust")
pytestmark = pytest.mark.skipif(
    DATA is None,
    reason="needs the sessions of AutonomyCLTrust (docs/reports.md): TRUSTLAB_DATA=folder",
)


@pytest.fixture(scope="module")
def sessions():
    return read_sessions(DATA, recipe="autonomy_cl_trust")


def test_what_there_is(sessions):
    assert [(s.metadata.participant, s.metadata.more["trial"]) for s in sessions] == [
        (participant, trial) for participant in range(1, 9) for trial in range(1, 31)
    ]
    for session in sessions:
        more = session.metadata.more
        assert session.metadata.condition == more["autonomy"]
        assert more["training"] == (more["trial"] <= 5)
        assert more["block"] == (more["trial"] - 1) // 5
        assert session.sample_time == pytest.approx(0.024)
        np.testing.assert_array_equal(session["mode"], round(1 - more["autonomy"], 1))
        # Column 10 is the distance in y and z.
        distance = np.hypot(
            session["robot_y"] - session["reference_y"], session["robot_z"] - session["reference_z"]
        )
        np.testing.assert_allclose(session["path_error"], distance, atol=1e-12)


def test_the_robot_followed_the_mixture(sessions):
    # The recipe's reading of columns 0-8 and of alpha_id: robot = share · human + (1 − share) ·
    # reference.
    for session in sessions:
        for axis in "yz":
            share = session["mode"]
            mixture = share * session[f"human_{axis}"] + (1 - share) * session[f"reference_{axis}"]
            np.testing.assert_allclose(session[f"robot_{axis}"], mixture, atol=1e-9)


def test_each_block_has_one_autonomy_level(sessions):
    frame = pd.DataFrame([s.metadata.as_dict() for s in sessions])
    assert (frame.groupby(["participant", "block"])["autonomy"].agg(np.ptp) == 0).all()
    later = frame[~frame["training"]].drop_duplicates(["participant", "block"])
    assert (later.groupby("participant")["autonomy"].nunique() == 5).all()


def test_mean_errors_against_the_header(sessions):
    for session in sessions:
        folder = Path(session.metadata.source).parent
        header = pd.read_csv(folder / f"{folder.name}_header.csv").set_index("trial_number")
        printed = header.loc[session.metadata.more["trial"], "overall_ave"]
        assert session["path_error"].mean() == pytest.approx(printed, rel=1e-9)


def test_tracking_errors_are_the_published_ones(sessions):
    published = pd.read_csv(DATA / "measures" / "traj_err_all_levels.csv")
    both = tracking_error(sessions).merge(
        published.rename(columns={"pid": "participant"}), on=["participant", "autonomy"]
    )
    assert len(both) == 40
    np.testing.assert_allclose(both["traj_err_x"], both["traj_err_y"], rtol=0, atol=1e-9)


def test_a_participant_who_was_replaced_is_not_known(tmp_path):
    shutil.copytree(DATA / "raw" / "part1", tmp_path / "part8")
    (tmp_path / "part8").chmod(0o755)
    (tmp_path / "part8" / "part1_header.csv").rename(tmp_path / "part8" / "part8_header.csv")
    with pytest.raises(SessionError, match=r"part8.*'participant' \(from folder\): '8' is not in"):
        read_sessions(tmp_path, recipe="autonomy_cl_trust")
