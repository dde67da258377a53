"""Measures of a teleoperation run against plain arithmetic on its log, and its figures."""

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

import trustlab as tl
from tests.flights import T, columns
from trustlab.teleoperation import Guidance
from trustlab.testbeds import plot_energies

matplotlib.use("Agg")
RUNS = [tl.simulate_teleoperation(scheme, seed=2, duration=12.0) for scheme in ("TMIG", "OMI")]


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_measures_are_those_of_the_log():
    table = tl.teleoperation_measures(RUNS)
    assert table["synthetic"].all()
    assert table["scheme"].tolist() == ["TMIG", "OMI"]
    assert table.attrs["origin"] == "simulated operators"
    assert len(tl.teleoperation_measures(RUNS[0])) == 1
    run = RUNS[0]
    error = np.linalg.norm(columns(run, "reference") - columns(run, "robot"), axis=1)
    expected = {
        "tracking_error": error.mean(),
        "worst_error": error.max(),
        "hand_force": np.linalg.norm(columns(run, "f_h"), axis=1).mean(),
        "alpha_rate": np.abs(np.diff(run["alpha"])).sum() / (T * (len(run) - 1)),
        "energy_operator": run["energy_operator"][-1],
        "guarded": (run["port_share"] < 1.0).mean(),
        "port_share": run["port_share"].mean(),
    }
    assert table.iloc[0][list(expected)].to_dict() == pytest.approx(expected, rel=1e-12)


def test_every_energy_is_drawn_where_all_are_apart():
    run = tl.simulate_teleoperation("TMIG", seed=0, guidance=Guidance(guard="off"))
    data = run.data.assign(energy_target=3.0 * run["energy_target"])
    panel = plot_energies(tl.sessions.Session(data, run.metadata))[1]
    names = ",".join(str(line.get_label()) for line in panel.lines)
    assert sum(names.count(word) for word in ("taken", "given")) == 5
    assert len(panel.lines) == 6  # and the axis
