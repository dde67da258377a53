"""Chromium for the tests that drive and fly in it, and a disk that is full."""

import os
import shutil
from contextlib import contextmanager

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
OPTIONS = {"executable_path": CHROMIUM, "args": ["--no-sandbox", "--disable-gpu"]}


@pytest.fixture(scope="module")
def chromium():
    """Playwright's Chromium; skipped with a line where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        yield playwright.chromium


@pytest.fixture(scope="module")
def browser(chromium):
    """One browser for the tests of a module."""
    started = chromium.launch(**OPTIONS)
    yield started
    started.close()


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
