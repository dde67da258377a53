"""What the tests of sessions share: a table written to a file and read."""

import pytest

from tests.sessions.logs import table_recipe
from trustlab.sessions import read_session, read_sessions


@pytest.fixture
def read(tmp_path):
    """A function that writes a text to a file and reads it, by a recipe for tables if given."""

    def read(text, recipe=None, name="run.csv", **options):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_session(path, recipe=recipe and table_recipe(recipe), **options)

    return read


@pytest.fixture
def read_parts(tmp_path):
    """A function that writes a table to a file and reads the parts that a recipe cuts it into."""

    def read_parts(text, recipe):
        (tmp_path / "run.csv").write_text(text)
        return read_sessions(tmp_path, table_recipe(recipe))

    return read_parts
