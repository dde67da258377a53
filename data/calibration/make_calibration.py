"""
Write the simulated studies behind the calibrations of the UAV study (Section 2.4.2) and of that on
the ground robot: `make calibration`.

Goes on where it was stopped; `make_calibration.py uav` makes one of them.
"""

import sys
from pathlib import Path

import trustlab as tl
from trustlab.reproduction import write_calibration

HERE = Path(__file__).resolve().parent
SIMULATIONS, SEED = 400, 0
OPERATORS = {"uav": 20, "ground_robot": 5}
"""As many as people took part."""

if __name__ == "__main__":
    for study in sys.argv[1:] or OPERATORS:
        campaign = HERE / "campaign" / study
        write_calibration(
            tl.calibrate(study, SIMULATIONS, OPERATORS[study], SEED, n_jobs=2, out=campaign), HERE
        )
