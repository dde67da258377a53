"""
Settings, drives and hands of the ground robot live, and a driver's model from a drive.

Oracles: Table 2.1 as printed; `fit_tsc` called by hand with the same values held.
"""

from operator import attrgetter

import pandas as pd

import trustlab as tl
from trustlab.live.hands import HumanHand
from trustlab.live.task import scripted_commands
from trustlab.live.tasks.ground_robot import TASK, drive_config

MODEL = tl.published_models()["2"]


def test_the_live_task_is_as_hard_as_people_found_it():
    """Means from 100 s on, when the window of (2.4) is full, beside the best of each person."""
    content, drives = tl.DriveSettings(laps=2).as_json(), []
    for seed in range(2):
        config = drive_config(content, "C1", seed)
        _, rows = scripted_commands(TASK, config, HumanHand(config, seed))
        drives.append(TASK.session(config, rows).data[100.0:])
    hand = pd.concat(drives).mean()
    people = [tl.published_models()[name] for name in "12345"]
    for signal, most in (
        ("p_r", [model.robot.p_max for model in people]),
        ("p_h", [model.human.p_max for model in people]),
    ):
        assert min(most) - 0.02 < hand[signal] < max(most) + 0.02, signal


def test_what_a_drive_leaves_undetermined_is_held_at_the_drives_model(tmp_path):
    log = tmp_path / "drive.jsonl"
    live = tl.LiveGroundRobot("C3", MODEL, (0.0, 0.35), laps=4, seed=1, log=log)
    settings = live.trial.settings
    commands, _ = scripted_commands(live.trial.task, settings, HumanHand(settings, 1))
    live.trial.take({"begin": True})
    assert live.trial.take({"k": 0, "commands": commands, "seen": 0})["done"]
    alone = tl.fit_tsc(live.session)
    assert not alone.success
    assert alone.parameters.loc["human_a", "status"] == "weak"
    found = live.fit().parameters
    held = found.index[found["status"] == "fixed"]
    assert {"human_a", "human_beta"} <= set(held)
    values = {name: attrgetter(name.replace("_", ".", 1))(MODEL) for name in held}
    assert found.loc[held, "value"].to_dict() == values
    again = tl.fit_tsc(live.session, fixed=values | {"r0": 0.0})
    assert (found["status"] == "estimated").any()
    assert found["value"].to_dict() == again.parameters["value"].to_dict()
