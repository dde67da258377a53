"""
A rehearsal without browsers: scripted hands with a person's limits go through a whole study, page
by page.
"""

from typing import Any

import numpy as np

from trustlab.live.study.drives import attempt_name
from trustlab.live.study.pages import Item, Step
from trustlab.live.study.participation import Participation
from trustlab.live.tasks.task import task_of

SENT_AT_ONCE = 600


def rehearse(participations: list[Participation], seeds: list[np.random.SeedSequence]) -> None:
    """Let each participant go from where they are to the end."""
    for participation, seed in zip(participations, seeds, strict=True):
        rng = np.random.default_rng(seed)
        while (now := participation.state())["kind"] != "end":
            step = participation.steps[now["page"]]
            if now["kind"] == "form":
                answers = {item.name: _answer(item, rng) for item in step.page.items}
                participation.answers({"page": step.index, "answers": answers})
            else:
                _drive(participation, step, rng)


def _answer(item: Item, rng: np.random.Generator) -> Any:
    """Return an answer drawn from all that are allowed: it means nothing."""
    if item.kind == "scale":
        return int(rng.choice(np.arange(item.low, item.high + 1, item.step)))
    if item.kind == "choice":
        return item.choices[rng.integers(len(item.choices))]
    return True if item.kind == "check" else ""


def _drive(participation: Participation, step: Step, rng: np.random.Generator) -> None:
    """Drive as a page would, by a hand that follows suggestions and takes over no other time."""
    about: dict[str, Any] = {"page": step.index, "tab": "rehearsal"}
    about["attempt"] = participation.begin(about)["attempt"]
    header = participation.participant.header(attempt_name(step, about["attempt"]))
    assert header is not None
    config = header["config"]
    made = task_of(config).scripted_rows(config, rng)
    stamped = [[k, 1000.0 * config["sample_time"] * k, *row] for k, row in enumerate(made.tolist())]
    for first in range(0, len(stamped), SENT_AT_ONCE):
        participation.rows(about | {"rows": stamped[first : first + SENT_AT_ONCE]})
    participation.done(about | {"rows": len(stamped)})
