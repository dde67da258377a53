"""A disk that is full."""

import os
from contextlib import contextmanager

import pytest


@pytest.fixture
def full_disk(monkeypatch):
    """A context in which nothing can be saved."""

    def full(handle):
        raise OSError(28, "No space left on device")

    @contextmanager
    def disk():
        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", full)
            yield

    return disk
