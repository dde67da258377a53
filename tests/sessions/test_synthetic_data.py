"""data/sessions/ is what its generator writes, and says that it is synthetic."""

import importlib.util
from pathlib import Path

import numpy as np
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
    assert names == [
        "participant_1.parquet",
        *(f"participant_{k}.parquet" for k in range(2, 6)),
        "pilot.csv",
    ]
    for name in names:
        kept, made = tl.read_session(FOLDER / name), tl.read_session(fresh / name)
        assert kept.metadata.as_dict() | {"source": None} == made.metadata.as_dict() | {
            "source": None
        }
        # Another platform's exp may differ in the last bit, which rounding to five decimals can
        # turn into one unit.
        np.testing.assert_allclose(kept.data, made.data, rtol=0, atol=1.1e-5)
        assert kept.metadata.synthetic
        assert kept.sample_time == 0.1
        assert np.count_nonzero(np.diff(kept["mode"])) >= 6
