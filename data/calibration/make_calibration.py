"""Write the simulated studies behind the calibration of the UAV study (Section 2.4.2): `make calibration`."""

import sys
from pathlib import Path

import trustlab as tl
from trustlab.reproduction import write_calibration

HERE = Path(__file__).resolve().parent
SIMULATIONS, SEED = 400, 0

if __name__ == "__main__":
    campaign = sys.argv[1] if len(sys.argv) > 1 else HERE / "campaign"
    write_calibration(tl.calibrate("uav", SIMULATIONS, n=20, seed=SEED, n_jobs=2, out=campaign), HERE)
