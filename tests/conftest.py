"""What all tests share: settings of hypothesis, a browser, and the synthetic operators."""

import gc
import os
import shutil
from collections import Counter

# As many workers as cores, and one: one thread each for linear algebra, set before NumPy is loaded.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, settings

import trustlab as tl
from trustlab.reproduction import published_models

settings.register_profile(
    "trustlab",
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("trustlab")


@pytest.hookimpl(optionalhook=True)  # pytest may run without pytest-xdist
def pytest_xdist_auto_num_workers():
    """
    One worker more than cores: tests that drive in real time or wait for what they killed leave a
    core idle.
    """
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist looks at the groups
def pytest_collection_modifyitems(items):
    """
    Drive in browsers one after the other, in one worker, and from the start, as they take the
    longest.
    """
    for item in items:
        drives = "browser" in getattr(item, "fixturenames", ())
        if drives and item.nodeid.startswith("tests/live/"):
            item.add_marker(pytest.mark.xdist_group("browser"))


def pytest_collection_finish():
    """
    Keep what was collected, which lives to the end, out of garbage collection: walking it took a
    sixth of the time of tests.
    """
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter):
    """Say what was skipped and what it needs, each reason once."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in skipped)
    for reason, count in reasons.most_common():
        tests = "1 test" if count == 1 else f"{count} tests"
        terminalreporter.write_line(f"{tests} skipped: {reason}")


@pytest.fixture(scope="module")
def browser():
    """Chromium for the tests of a module; skipped with a line where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    names = map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))
    chromium = next(filter(None, names), None)
    if chromium is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu"]
        )
        yield started
        started.close()


@pytest.fixture(scope="session")
def operators():
    """The printed operators: "pilot", "1" … "5"."""
    return published_models()


@pytest.fixture(scope="session")
def make_session():
    """A function that simulates a session: model, mode, noise, seed, initial states."""

    def make(model, mode, noise=0.0, seed=0, r0=0.3, p_r0=0.3, sample_time=0.1, participant=1):
        rng = np.random.default_rng(seed)
        run = model.simulate(mode, r0, p_r0)
        frame = run[["mode", "p_r", "p_h"]].copy()
        for name in ("p_r", "p_h"):
            frame[name] += noise * rng.standard_normal(len(frame))
        frame.index = pd.Index(np.arange(len(frame)) * sample_time, name="t")
        return tl.Session(frame, tl.Metadata(participant=participant, synthetic=True))

    return make


@pytest.fixture(scope="session")
def switching():
    """Eight phases of 2500 samples: manual, autonomous, and so on (seven switches)."""
    return np.repeat([1.0, 0.0] * 4, 2500)
