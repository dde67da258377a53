"""
Chromium for the tests that drive and fly in it.

Browsers depend on what else the machine does: a test in a browser that fails is run once more, and
says so.
"""

import shutil
import warnings

import pytest
from _pytest.runner import runtestprotocol

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
OPTIONS = {"executable_path": CHROMIUM, "args": ["--no-sandbox", "--disable-gpu"]}
FIXTURES = {"browser", "chromium"}


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


def pytest_runtest_protocol(item, nextitem):
    if not FIXTURES & set(item.fixturenames):
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = runtestprotocol(item, nextitem=nextitem, log=False)
    if any(report.failed for report in reports):
        first = next(report for report in reports if report.failed)
        warnings.warn(f"{item.nodeid} failed at first: {str(first.longrepr)[-300:]}", stacklevel=1)
        item._initrequest()
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True
