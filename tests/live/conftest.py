"""Browsers depend on what else the machine does: a test in a browser that fails is run once more, and says so."""

import warnings

from _pytest.runner import runtestprotocol

FIXTURES = {"browser", "chromium"}


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
