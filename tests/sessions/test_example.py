"""The session that comes with the package. Oracle: pandas on the file in the repository."""

import numpy as np
import pandas as pd

import trustlab as tl
from tests.house.documents import ROOT


def test_the_pilot_is_the_file_of_the_repository_wherever_one_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = pd.read_csv(ROOT / "data" / "sessions" / "pilot.csv", comment="#", index_col="t")
    session = tl.sessions.example("pilot")
    assert session.metadata.synthetic
    np.testing.assert_array_equal(session.data[["mode", "p_r", "p_h"]], file)
