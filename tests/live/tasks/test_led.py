"""
One team: WebAssembly and numba give the same bits. Oracle: wasmtime, which shares no code with
numba's machine code, and `TeamLoop`, which decides in Python.
"""

import json

import numpy as np
import pytest

from tests.live.tasks import computed
from trustlab.live.tasks.task import sent_columns, task_named
from trustlab.live.tasks.team import LeadingSettings
from trustlab.trust.dynamics import MODELS

TASK = task_named("team")


def configured(condition, seed=5, **settings):
    content = LeadingSettings(**{"duration": 60.0, **settings}).as_json()
    return json.loads(json.dumps(TASK.config(content, condition, {}, seed)))


class Module(computed.Module):
    """A team."""

    def step(self, *command):
        assert self.period(*command) == -1
        row = self.numbers("row", 0, self.plan["columns"])
        first, size = self.plan["robot"]["trust"], self.plan["size"]
        robots = next(each for each in self.plan["arrays"] if each["name"] == "followers")
        places = range(first, robots["size"], size)
        return [*command, *row, *(self.numbers("followers", place)[0] for place in places)]


def led(config, person):
    """Rows of TeamLoop and of wasmtime under a scripted person."""
    run, hand = TASK.begin(config), TASK.hand(config, np.random.default_rng(person))
    there = Module("lead", TASK.memory(config))
    rows, rows_there = [], []
    while not run.done:
        command = hand(run.picture())
        rows.append(run.step(*command))
        rows_there.append(there.step(*command))
    return np.array(rows), np.array(rows_there)


@pytest.mark.parametrize(("robots", "seed"), [(3, 15), (4, 1), (6, 2)])
@pytest.mark.parametrize("condition", TASK.conditions)
def test_every_row_is_the_same_in_webassembly(condition, robots, seed):
    config = configured(condition, seed, robots=robots, min_dwell=2.0)
    rows, there = led(config, person=robots)
    np.testing.assert_array_equal(there, rows)
    assert TASK.replay(config, there) is True
    column = dict(zip(config["columns"], rows.T, strict=True))
    assert np.ptp(column["robot_x"]) > 0.1
    assert np.ptp(column["trust_2"]) > 0.0
    assert len(set(column["leader"])) > 1
    assert column["leader_suggested"].any() == (condition == "suggested")


def test_a_run_ends_at_its_last_goal_in_both():
    config = configured("hysteresis", goals=1, duration=120.0)
    rows, there = led(config, person=1)
    np.testing.assert_array_equal(there, rows)
    assert rows[-1, config["columns"].index("goals_reached")] == 1.0
    assert len(rows) < config["samples"]


def test_a_model_of_trust_is_led_by_the_server():
    assert sent_columns(configured("by_hand")) == configured("by_hand")["columns"]
    served = configured("by_hand", trust=MODELS["asymmetric"]())
    assert served["served"]
    assert TASK.memory(served) is None
    assert sent_columns(served) == served["commands"]
