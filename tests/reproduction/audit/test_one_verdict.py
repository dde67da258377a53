"""
A printed number has one verdict, wherever it is shown: reports take verdicts from the audit, and
from nothing else.
"""

import json
from pathlib import Path

import pytest

import trustlab as tl

NOTEBOOKS = sorted((Path(__file__).parents[3] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_reports_take_verdicts_from_the_audit(path):
    """
    `recompute` varies every input by itself, b_pr too, which gave TSC_ub of participant 5 another
    verdict in report “allocation”.
    """
    code = "".join("".join(cell["source"]) for cell in json.loads(path.read_text())["cells"])
    assert "recompute(" not in code


def test_the_upper_limit_of_participant_5_differs():
    verdicts = tl.audit().set_index("id")["verdict"]
    assert verdicts["table_2.1/TSC_ub/5"] == "differs"
