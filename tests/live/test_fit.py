"""A driver's model from a live drive, what the drive leaves undetermined held.

Oracle: `fit_tsc` called by hand with the same values held.
"""

import pytest

import trustlab as tl
from trustlab.live.hands import HumanHand
from trustlab.live.task import scripted_commands

OTHER = tl.published_models()["2"]


@pytest.fixture
def driven(tmp_path):
    """
    A function that returns a widget whose drive is done, by a scripted hand with a person's limits.
    """

    def drive(laps, seed=1):
        log = tmp_path / f"{laps}.jsonl"
        live = tl.LiveGroundRobot("C3", OTHER, (0.0, 0.35), laps=laps, seed=seed, log=log)
        config = live.trial.settings
        hand = HumanHand(config, seed)
        commands, _ = scripted_commands(live.trial.task, config, hand)
        live.trial.take({"begin": True})
        assert live.trial.take({"k": 0, "commands": commands, "seen": 0})["done"]
        return live

    return drive


def test_what_a_drive_leaves_undetermined_is_held_at_the_drives_model(driven):
    live = driven(4)
    alone = tl.fit_tsc(live.session)
    assert not alone.success
    assert alone.parameters.loc["human_a", "status"] == "weak"
    found = live.fit().parameters
    held = found.index[found["status"] == "fixed"]
    assert {"human_a", "human_beta"} <= set(held)
    known = {"human": OTHER.human, "robot": OTHER.robot}
    values = {name: getattr(known[name.partition("_")[0]], name.partition("_")[2]) for name in held}
    assert found.loc[held, "value"].to_dict() == values
    again = tl.fit_tsc(live.session, fixed=values | {"r0": 0.0})
    assert (found["status"] == "estimated").any()
    assert found["value"].to_dict() == again.parameters["value"].to_dict()
