"""
The guide's ten minutes: a study of driving and one of leading a team, from the plan to the report,
with three scripted people each.
"""

import zipfile

import pandas as pd
import pytest

import trustlab as tl


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*do not fill whole squares", "ignore:nobody may switch")
@pytest.mark.parametrize(
    ("task", "conditions", "settings", "measure"),
    [
        ("ground_robot", ["C1", "C3"], {"laps": 1, "training": 10.0}, "p_r"),
        ("team", ["by_hand", "most_trusted"], {"duration": 20.0, "training": 5.0}, "force"),
    ],
)
def test_a_study_from_plan_to_report(tmp_path, task, conditions, settings, measure):
    plan = tl.LiveStudy(
        tmp_path / task,
        conditions,
        participants=3,
        task=task,
        rehearsal=True,
        whole_squares=False,
        seed=0,
        **settings,
    )
    plan.rehearse()
    study = tl.read_live_study(plan.folder)
    assert study.participants["complete"].all()
    assert len(study.measures) == 6
    assert study.measures["verified"].all()
    assert study.faults().empty
    assert study.analysis(measure).n == 3
    with zipfile.ZipFile(study.export()) as archive:
        names = archive.namelist()
        assert "measures.csv, measures.parquet: 6 rows" in archive.read("README.txt").decode()
        (table,) = [name for name in names if name.endswith("measures.csv")]
        with archive.open(table) as file:
            assert len(pd.read_csv(file)) == 6
    page = study.report().read_text()
    assert "scripted hands" in page.lower()
    assert all(condition in page for condition in conditions)
