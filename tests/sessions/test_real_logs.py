"""
Real logs, where they are: the shared-control study of Pan et al. (2024); and the synthetic ones
that come with the package.

Oracles: measures of the study's own, what is known of its robot; the script that makes the
synthetic sessions.
"""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from data.sessions import make_sessions
from tests.cases import refused
from trustlab.sessions import example, external_data, read_session, read_sessions, tracking_error

# --- Pan et al. (2024) ----------------------------------------------------------------------------


DATA = external_data("autonomy_cl_trust")
NEEDED = pytest.mark.skipif(
    DATA is None,
    reason="needs the sessions of AutonomyCLTrust (docs/reports.md): TRUSTLAB_DATA=folder",
)


@pytest.fixture(scope="module")
def sessions():
    return read_sessions(DATA, recipe="autonomy_cl_trust")


@NEEDED
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
        share = round(1 - more["autonomy"], 1)
        assert_array_equal(session["mode"], share)
        # The recipe's reading of columns 0-8 and of alpha_id: the robot followed the mixture of
        # human and reference. Column 10 is the distance in y and z.
        human, robot, reference = (
            session.data[[f"{who}_y", f"{who}_z"]].to_numpy()
            for who in ("human", "robot", "reference")
        )
        assert_allclose(robot, share * human + (1 - share) * reference, atol=1e-9)
        assert_allclose(session["path_error"], np.hypot(*(robot - reference).T), atol=1e-12)


@NEEDED
def test_tracking_errors_are_the_published_ones(sessions):
    published = pd.read_csv(DATA / "measures" / "traj_err_all_levels.csv")
    both = tracking_error(sessions).merge(
        published.rename(columns={"pid": "participant"}), on=["participant", "autonomy"]
    )
    assert len(both) == 40
    assert_allclose(both["traj_err_x"], both["traj_err_y"], rtol=0, atol=1e-9)


@NEEDED
def test_a_participant_who_was_replaced_is_not_known(tmp_path):
    shutil.copytree(DATA / "raw" / "part1", tmp_path / "part8")
    (tmp_path / "part8").chmod(0o755)
    (tmp_path / "part8" / "part1_header.csv").rename(tmp_path / "part8" / "part8_header.csv")
    with refused(r"part8.*'participant' \(from folder\): '8' is not in"):
        read_sessions(tmp_path, recipe="autonomy_cl_trust")


# --- synthetic sessions ---------------------------------------------------------------------------


FOLDER = Path(__file__).parents[2] / "data" / "sessions"


def test_committed_sessions_are_what_the_generator_makes(tmp_path):
    make_sessions.main(tmp_path)
    names = sorted(path.name for path in FOLDER.iterdir() if path.suffix in (".csv", ".parquet"))
    assert names == [*(f"participant_{k}.parquet" for k in range(1, 6)), "pilot.csv"]
    for name in names:
        kept, made = read_session(FOLDER / name), read_session(tmp_path / name)
        assert kept.with_metadata(source=None).metadata == made.with_metadata(source=None).metadata
        # Another platform's exp may differ in the last bit, which rounding to five decimals can
        # turn into one unit.
        assert_allclose(kept.data, made.data, rtol=0, atol=1.1e-5)
        assert kept.metadata.synthetic
        assert kept.sample_time == 0.1
        assert np.count_nonzero(np.diff(kept["mode"])) >= 6


def test_the_pilot_is_the_file_of_the_repository_wherever_one_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = pd.read_csv(FOLDER / "pilot.csv", comment="#", index_col="t")
    session = example("pilot")
    assert session.metadata.synthetic
    assert_array_equal(session.data[["mode", "p_r", "p_h"]], file)
