"""What the tests of sessions share: a table written to a file and read."""

import pytest

from tests.sessions.logs import table_recipe
from trustlab.sessions import read_session


@pytest.fixture
def read(tmp_path):
    """A function that writes a text to a file and reads it, by a recipe for tables if given."""

    def read(text, recipe=None, name="run.csv", **options):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_session(path, recipe=recipe and table_recipe(recipe), **options)

    return read
