"""
A missing optional dependency is an error that names the extra; any other failed import stays as it
is.
"""

import pytest

from trustlab.models.extras import extra


def test_missing_package_names_the_extra():
    words = r'no_such_package is not installed.*"trustlab\[ros\]"'
    with pytest.raises(ModuleNotFoundError, match=words) as caught, extra("ros"):
        import no_such_package  # noqa: F401
    assert caught.value.name == "no_such_package"


def test_nothing_happens_where_everything_is_there():
    with extra("ros"):
        import json
    assert json.dumps(1) == "1"
