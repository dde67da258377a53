"""
data/sessions/ is what its generator writes, and says that it is synthetic; the example that comes
with the package is the pilot. Oracle of the example: pandas on the file in the repository.
"""

import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import trustlab as tl

FOLDER = Path(__file__).parents[2] / "data" / "sessions"


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    spec = importlib.util.spec_from_file_location("make_sessions", FOLDER / "make_sessions.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    folder = tmp_path_factory.mktemp("sessions")
    module.main(folder)
    return folder


def test_committed_sessions_are_what_the_generator_makes(fresh):
    names = sorted(path.name for path in FOLDER.iterdir() if path.suffix in (".csv", ".parquet"))
    assert names == [*(f"participant_{k}.parquet" for k in range(1, 6)), "pilot.csv"]
    for name in names:
        kept, made = tl.read_session(FOLDER / name), tl.read_session(fresh / name)
        assert kept.with_metadata(source=None).metadata == made.with_metadata(source=None).metadata
        # Another platform's exp may differ in the last bit, which rounding to five decimals can
        # turn into one unit.
        np.testing.assert_allclose(kept.data, made.data, rtol=0, atol=1.1e-5)
        assert kept.metadata.synthetic
        assert kept.sample_time == 0.1
        assert np.count_nonzero(np.diff(kept["mode"])) >= 6


def test_the_pilot_is_the_file_of_the_repository_wherever_one_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = pd.read_csv(FOLDER / "pilot.csv", comment="#", index_col="t")
    session = tl.sessions.example("pilot")
    assert session.metadata.synthetic
    np.testing.assert_array_equal(session.data[["mode", "p_r", "p_h"]], file)
