"""Whatever bytes a file holds, reading it gives a valid session or one of our errors."""

import contextlib
import os
import re
from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from tests.sessions import fuzz
from tests.sessions.test_recipes import LAB
from trustlab.sessions import RecipeError, read_session
from trustlab.sessions.recipe import Recipe

# A number of examples for a longer search, other ones each time.
MORE = os.environ.get("TRUSTLAB_FUZZ")
EXAMPLES = int(MORE or 120)
deterministic = settings(
    max_examples=EXAMPLES,
    derandomize=not MORE,
    deadline=10_000,  # [ms]
    database=None,
)
SUFFIXES = [".csv", ".csv.gz", ".tsv", ".parquet", ".bag", ".mcap", ".db3"]


def test_damaged_logs_and_recipes_at_random(tmp_path):
    for name in {**fuzz.originals(tmp_path), **dict.fromkeys(fuzz.READS)}:
        good, failures = fuzz.fuzz(name, range(EXAMPLES // (2 if name in fuzz.READS else 4)))
        assert failures == []
        assert good >= 2 or name not in fuzz.READS, name


def test_an_error_that_is_not_ours_is_noticed(monkeypatch):
    # Negative control.
    monkeypatch.setattr("trustlab.sessions.bags._guard", contextlib.nullcontext)
    assert fuzz.fuzz("a.bag", range(25))[1]


def test_an_answer_that_is_no_session_is_noticed(monkeypatch):
    # Negative control.
    backwards = SimpleNamespace(data=pd.DataFrame({"r": [0.5, 0.5]}), t=np.array([1.0, 0.0]))
    monkeypatch.setattr(fuzz, "read_session", lambda *_, **__: backwards)
    assert len(fuzz.fuzz("file", range(3))[1]) == 3


@deterministic
@given(
    data=st.binary(max_size=300),
    start=st.sampled_from([b"", b"\xef\xbb\xbf", b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"PAR1"]),
    suffix=st.sampled_from(SUFFIXES),
)
@pytest.mark.filterwarnings("error", "ignore:.*(last line has no end|column p_r)")
def test_any_bytes(tmp_path, data, start, suffix):
    """Nor does a warning or a traceback stand beside the error."""
    path = tmp_path / f"any{suffix}"
    path.write_bytes(start + data)
    assert not fuzz.readable(lambda: [read_session(path)])


WORDS = st.sampled_from(re.split(r"[\s={}]+", LAB.strip())) | st.sampled_from(
    "[] {} -1 nan inf 1e400 true '' 1979-05-27 [[columns]] bag [1,2]".split()  # noqa: SIM905
)


@settings(deterministic, max_examples=3 * EXAMPLES)
@given(old=WORDS, new=WORDS, seed=st.integers(0, 2**32 - 1), words=st.booleans())
def test_damaged_recipes(old, new, seed, words):
    damage = partial(fuzz.damaged, rng=np.random.default_rng(seed))
    text = LAB.replace(old, new) if words else damage(LAB.encode()).decode("utf-8", "replace")
    try:
        recipe = Recipe.from_toml(text)
    except RecipeError as error:
        assert str(error).startswith("recipe: ")  # noqa: PT017
    else:
        assert recipe.columns
