"""Measures of a teleoperation run against plain arithmetic on its log, and its figures."""

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

import trustlab as tl
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
    data, row = RUNS[0].data, table.iloc[0]
    offset = (
        data[[f"reference_{a}" for a in "xyz"]].to_numpy()
        - data[[f"robot_{a}" for a in "xyz"]].to_numpy()
    )
    assert row["tracking_error"] == pytest.approx(np.linalg.norm(offset, axis=1).mean(), rel=1e-12)
    assert row["worst_error"] == pytest.approx(np.linalg.norm(offset, axis=1).max(), rel=1e-12)
    assert row["hand_force"] == pytest.approx(
        np.linalg.norm(data[[f"f_h_{a}" for a in "xyz"]], axis=1).mean()
    )
    assert row["alpha_rate"] == pytest.approx(
        np.abs(np.diff(data["alpha"])).sum() / (0.01 * (len(data) - 1))
    )
    assert row["energy_operator"] == data["energy_operator"].iloc[-1]
    assert row["guarded"] == pytest.approx((data["port_share"] < 1).mean())
    assert row["port_share"] == pytest.approx(data["port_share"].mean(), rel=1e-12)
    assert len(tl.teleoperation_measures(RUNS[0])) == 1


def test_every_energy_is_drawn_where_all_are_apart():
    run = tl.simulate_teleoperation("TMIG", seed=0, guidance=Guidance(guard="off"))
    data = run.data.assign(energy_target=3.0 * run["energy_target"])
    panel = plot_energies(tl.sessions.Session(data, run.metadata))[1]
    names = ",".join(str(line.get_label()) for line in panel.lines)
    assert sum(names.count(word) for word in ("taken", "given")) == 5
    assert len(panel.lines) == 6  # and the axis
