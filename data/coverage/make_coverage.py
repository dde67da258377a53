"""
Write fits.csv: the errors of fits of simulated sessions, with noise and windows of all kinds, in
standard errors.

`python data/coverage/make_coverage.py` takes half an hour on one core and goes on where it was
stopped; `--setting white` does the settings whose names begin so (a regular expression), `--seeds
10` the first of their sessions.
"""

import argparse
import importlib.util
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # the matrices are small: threads would take more time, not less
from trustlab.models.digest import room_digest

HERE = Path(__file__).resolve().parent
FITS = HERE / "fits.csv"
SEED = 11


def settings():
    """Return the module of the settings, which stands beside the notebook."""
    spec = importlib.util.spec_from_file_location(
        "noise_settings", HERE.parents[1] / "notebooks" / "noise_settings.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    """Fit what is missing or was fitted by other source, and print what came of it all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--setting", default="")
    parser.add_argument("--seeds", type=int, default=200)
    given = parser.parse_args()
    made = settings()
    source = room_digest("identification")
    planned = [
        (name, i)
        for i in range(200)
        for name in (*made.SETTINGS, *made.WINDOWS)
        if i < 100 or name in made.WINDOWS
    ]
    known = (
        pd.read_csv(FITS)
        if FITS.exists()
        else pd.DataFrame(columns=["setting", "session", "source"])
    )
    done = set(
        known.loc[known["source"] == source, ["setting", "session"]].itertuples(
            index=False, name=None
        )
    )
    for name, i in planned:
        if (name, i) in done or i >= given.seeds or not re.match(given.setting, name):
            continue
        row = {"setting": name, "session": i} | made.covers(np.random.SeedSequence([SEED, i]), name)
        frame = pd.DataFrame([row | {"source": source}])
        frame.to_csv(FITS, mode="a", header=not FITS.exists(), index=False, float_format="%.3g")
    order = {pair: k for k, pair in enumerate(planned)}
    rows = pd.read_csv(FITS).drop_duplicates(["setting", "session"], keep="last")
    place = [
        order[pair] for pair in rows[["setting", "session"]].itertuples(index=False, name=None)
    ]
    rows.iloc[np.argsort(place)].to_csv(FITS, index=False)
    print(made.summary(rows).round(3).to_string())


if __name__ == "__main__":
    main()
