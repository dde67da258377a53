"""The guide's ten minutes: a study of leading a team, from the plan to the report."""

import zipfile

import pytest

import trustlab as tl


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*do not fill whole squares")
def test_a_study_from_plan_to_report(tmp_path):
    """Driving comes to its report in `test_browser.py`."""
    conditions = ["by_hand", "most_trusted"]
    settings = {"duration": 20.0, "training": 5.0, "rehearsal": True, "whole_squares": False}
    plan = tl.LiveStudy(tmp_path / "team", conditions, 3, task="team", seed=0, **settings)
    plan.rehearse()
    study = tl.read_live_study(plan.folder)
    assert len(study.measures) == 6
    assert study.analysis("force").n == 3
    with zipfile.ZipFile(study.export()) as archive:
        assert "measures.csv, measures.parquet: 6 rows" in archive.read("README.txt").decode()
    page = study.report().read_text()
    assert "scripted hands" in page.lower()
    assert all(condition in page for condition in conditions)
