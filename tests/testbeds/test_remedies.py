"""Errors of testbeds and operators say what is allowed."""

import numpy as np
import pytest

from tests import cases
from trustlab.operators import operator
from trustlab.testbeds import Course, drive_modes


def test_delays_beyond_any_person_are_refused():
    with pytest.raises(ValueError, match=r"delay must lie in \[0, 5\], got 1e\+300"):
        operator(1, cases.model(), delay=1e300)


def test_a_bad_sample_of_mode_is_named():
    with pytest.raises(ValueError, match="sample 1 is nan"):
        drive_modes([1, np.nan], cases.driver())
    with pytest.raises(ValueError, match=r"zeros and ones, but sample 2 is 0\.5"):
        drive_modes([1, 0, 0.5], cases.driver())


def test_courses_too_fine_to_walk_are_refused():
    with pytest.raises(
        ValueError, match=r"too fine for a course of about 36 m; it must be at least 0\.000361 m"
    ):
        Course(corners=cases.CORNERS, resolution=1e-12)
