"""Links between reports, to the equations and to the sections that show what is named."""

import tomllib
from operator import attrgetter
from pathlib import Path

import pytest

import trustlab as tl
from trustlab.publishing.mathml import to_mathml

ROOT = Path(__file__).parents[2]
EQUATIONS = tomllib.loads((ROOT / "data" / "published" / "equations.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("number", EQUATIONS)
def test_equation_can_be_shown_and_is_computed_by_what_it_names(number):
    entry = EQUATIONS[number]
    assert "<math" in to_mathml(entry["latex"], display=True)
    assert entry["says"].endswith(".")
    if "computed_by" in entry:
        assert attrgetter(entry["computed_by"])(tl) is not None
