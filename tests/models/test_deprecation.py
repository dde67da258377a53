"""Old names warn, say the new one and hand back the same thing."""

import pytest

from trustlab.models.deprecation import old_names


def test_an_old_name_warns_and_is_the_new_one():
    find = old_names("lab", {"new": 1}.__getitem__, {"old": "new"})
    with pytest.warns(DeprecationWarning, match=r"lab\.old is now lab\.new"):
        assert find("old") == 1
    assert find("new") == 1
