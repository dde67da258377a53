"""
A rehearsal without browsers: scripted hands with a person's limits go through a whole study, page
by page.
"""

from typing import Any

import numpy as np

from trustlab.live.study.pages import Item, Step
from trustlab.live.study.participant import Participant
from trustlab.live.task import scripted_commands

SENT_AT_ONCE = 600


def rehearse(participants: list[Participant], seeds: list[np.random.SeedSequence]) -> None:
    """Let each participant go from where they are to the end."""
    for participant, seed in zip(participants, seeds, strict=True):
        rng = np.random.default_rng(seed)
        while (now := participant.state())["kind"] != "end":
            step = participant.steps[now["page"]]
            if now["kind"] == "form":
                answers = {item.name: _answer(item, rng) for item in step.page.items}
                participant.answers({"page": step.index, "answers": answers})
            else:
                _drive(participant, step, rng)
        participant.close()


def _answer(item: Item, rng: np.random.Generator) -> Any:
    """Return an answer drawn from all that are allowed: it means nothing."""
    if item.kind == "scale":
        return int(rng.choice(np.arange(item.low, item.high + 1, item.step)))
    if item.kind == "choice":
        return item.choices[rng.integers(len(item.choices))]
    if item.kind == "check":
        return True
    return "words" if item.required else ""


def _drive(participant: Participant, step: Step, rng: np.random.Generator) -> None:
    """Drive as a page would, by a hand that follows suggestions and takes over no other time."""
    about: dict = {"page": step.index, "window": "rehearsal"}
    participant.drive(about | {"begin": True})
    assert participant.trial is not None
    config = participant.trial.settings
    task = participant.plan.task
    commands, _ = scripted_commands(task, config, task.hand(config, rng))
    late = config["late"] / config["sample_time"]
    for k in range(0, len(commands), SENT_AT_ONCE):
        sent = commands[k : k + SENT_AT_ONCE]
        participant.drive(about | {"k": k, "commands": sent, "seen": max(k - late, 0.0)})
