"""
Write groups.csv, the table of docs/real_sessions.md: means over participants and tests, and nothing
of a single person. It reads the public study autonomy_cl_trust, in data/external or TRUSTLAB_DATA.
"""

from pathlib import Path

import pandas as pd

import trustlab as tl
from trustlab.publishing import required_data

HERE = Path(__file__).parent
# What a column of the study's tables is; task load is stretched to 0-100.
MEASURES = {
    "tracking error [cm]": ("traj_err", "traj_err"),
    "task load (0–100)": ("tlx", "tlx_ave"),
    "trust, MDMT (0–7)": ("mdmt", "mdmt_ave"),
    "trust, one item (1–10)": ("p_trust", "p_trust"),
    "perceived autonomy (1–10)": ("p_auto", "p_auto"),
    "pupil diameter [mm]": ("pupil", "pupil_diameter"),
    "tapping error [%]": ("tapping_err", "tapping_err_ave"),
}


def groups() -> pd.DataFrame:
    """Return a row per measure: its mean at each level of autonomy, and the test of the level."""
    folder = required_data("autonomy_cl_trust") / "measures"
    rows = {}
    for name, (table, column) in MEASURES.items():
        scores = pd.read_csv(folder / f"{table}.csv")
        if column == "tlx_ave":
            scores[column] = 100 * (scores[column] - 1) / 19
        if column == "pupil_diameter":  # 0 mm is no measurement
            scores = scores[scores.groupby("pid")[column].transform("min") > 0]
        means = scores.groupby("autonomy")[column].mean()
        result = tl.repeated_measures(scores, dv=column, within="autonomy", subject="pid")
        test = result.table().iloc[0]
        rows[name] = {f"at {level:g}": f"{mean:.2f}" for level, mean in means.items()}
        rows[name]["people"] = f"{test['n']:.0f}"
        rows[name]["F"] = f"{test['F']:.1f}"
        rows[name]["df"] = f"{test['df1_corrected']:.2f}, {test['df2_corrected']:.1f}"
        rows[name]["p"] = tl.studies.apa_p(test["p_corrected"]).lstrip("p= ")
        rows[name]["partial η²"] = f"{test['eta2_partial']:.2f}"
    return pd.DataFrame(rows).T.rename_axis("measure")


if __name__ == "__main__":
    groups().to_csv(HERE / "groups.csv")
