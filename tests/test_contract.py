"""What a user may type at any public name; how it is judged stands in `tests/contract.py`."""

import tempfile

import matplotlib.pyplot as plt
import pytest

from tests import contract

WALKED = set()  # methods of results that several functions return


@pytest.fixture
def folder(tmp_path, monkeypatch):
    scratch = contract.Scratch(tmp_path)
    monkeypatch.chdir(scratch.here)
    monkeypatch.setattr(tempfile, "tempdir", str(scratch.here))
    yield scratch
    plt.close("all")


def calls(key, folder):
    """Yield the good calls of a name, and of the methods of its answer."""
    owner, name = contract.names()[key]
    documented = getattr(owner, name)
    call = contract.good_call(key, owner, name, documented, folder)
    yield key, call
    if call and owner is contract.tl:
        for method, method_call in contract.methods(call, documented, folder):
            if method not in WALKED:
                WALKED.add(method)
                yield method, method_call


@pytest.mark.parametrize("key", contract.names())
@pytest.mark.filterwarnings("ignore")
def test_every_argument(key, folder):
    lines = []
    for name, call in calls(key, folder):
        if call is None:
            lines.append(f"{name} has no good call: give an example, or one in tests/good_calls.py")
        else:
            lines += [f"{name}: {line}" for line in contract.faults(call)]
    assert not lines, "\n" + "\n".join(lines)
