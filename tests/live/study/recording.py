"""What the files of a study say, and how a participant comes to a page without answering."""

import json

from trustlab.live.study.plan import file_origin
from trustlab.live.trial import read_record


def record(plan, code="P01", name="01-training"):
    """What the log of a drive says."""
    origin = file_origin(plan.digest, code, name)
    return read_record(plan.folder / code / f"{name}.jsonl", origin)[0]


def entries(path):
    """The entries of a log, without the digests before them."""
    return [json.loads(line)[1] for line in path.read_text().splitlines()]


def events(plan, code="P01"):
    path = plan.folder / code / "events.jsonl"
    return entries(path) if path.exists() else []


def advance(participant, name):
    """Have every page before the first of this name done; return that page's number."""
    page = next(step.index for step in participant.steps if step.page.name == name)
    for index in set(range(page)) - set(participant.progress.done):
        participant.add("page", page=index, name="x", attempt=0, link="")
    return page
