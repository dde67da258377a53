"""
One flight: WebAssembly and numba give the same bits. Oracle: wasmtime, which shares no code with
numba's machine code, and node.
"""

import base64
import json

import numpy as np
import pytest

from tests.live.tasks import computed
from trustlab.live.tasks.flown import NUMBERS
from trustlab.live.tasks.task import sent_columns, task_named
from trustlab.live.tasks.teleoperation import SCHEMES, TeleoperationSettings
from trustlab.teleoperation.loop.kernel import GUIDANCE
from trustlab.trust.dynamics import MODELS

TASK = task_named("teleoperation")


class Module(computed.Module):
    """A flight."""

    def step(self, *command):
        self.end = self.period(*command)
        last = (self.periods * self.plan["every"] - 1) * self.plan["row"]
        return [*command, *(self.numbers("log", last + at)[0] for at in self.plan["logged"])]


def configured(scheme, **settings):
    content = TeleoperationSettings(**{"duration": 20.0, **settings}).as_json()
    return json.loads(json.dumps(TASK.config(content, scheme, {}, seed=5)))


def commands_of(config, seed=1):
    """Commands of a hand that wanders; it reaches both ends of its share."""
    k = np.arange(config["samples"])
    start = np.random.default_rng(seed).uniform(0.0, 6.0, 3)
    x, y, share = (np.sin(rate * k + s) for rate, s in zip((0.03, 0.021, 0.01), start, strict=True))
    choice = 0.5 * (1.0 + share) if config["allocates"] else np.full(len(k), -1.0)
    return np.column_stack([x, y, choice]).tolist()


@pytest.mark.parametrize("study", ["main", "preliminary"])
@pytest.mark.parametrize("guidance", GUIDANCE)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_row_is_the_same_in_webassembly(scheme, guidance, study):
    config = configured(scheme, guidance=guidance, study=study)
    there, run = Module("fly", TASK.memory(config)), TASK.begin(config)
    rows = [there.step(*command) for command in commands_of(config)]
    assert rows == [run.step(*command) for command in commands_of(config)]
    assert TASK.replay(config, rows) is True
    moved = np.ptp(np.array(rows), axis=0)
    assert moved[config["columns"].index("robot_x")] > 0.1
    assert moved[config["columns"].index("alpha")] > 0.0 or scheme == "M"


def test_a_flight_that_diverges_stands_still_in_both():
    config = configured("TMIG", guidance="through_channel")
    memory = TASK.memory(config)
    run = TASK.begin(config)
    numbers = next(array for array in memory["arrays"] if array["name"] == "numbers")
    changed = np.frombuffer(base64.b64decode(numbers["data"]), NUMBERS).copy()
    for records in (changed, run.flight.loop.simulation.setup.numbers):
        records["phi"] *= 3.0  # a vehicle that nobody can hold
    numbers["data"] = base64.b64encode(changed.tobytes()).decode()
    there = Module("fly", memory)
    for command in commands_of(config):
        row = run.step(*command)
        if run.failed:
            break
        assert there.step(*command) == row
    assert run.failed
    there.step(*command)
    assert there.end != -1


def test_a_model_of_trust_is_flown_by_the_server():
    assert sent_columns(configured("TMIG")) == configured("TMIG")["columns"]
    served = configured("TMIG", trust=MODELS["asymmetric"]())
    assert served["served"]
    assert TASK.memory(served) is None
    assert sent_columns(served) == served["commands"]
