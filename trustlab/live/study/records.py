"""What a participant's files say, and whether they are as the study wrote them."""

from typing import Any, NamedTuple

from trustlab.live.chain import read_chain
from trustlab.live.study.drives import attempt_name, read_attempt
from trustlab.live.study.plan import Plan
from trustlab.live.study.progress import Progress, progress_of
from trustlab.live.study.store import EVENTS, PLAN, file_origin
from trustlab.models.digest import digest


class Fault(NamedTuple):
    """Whose file is not as it was written, and what is wrong with it."""

    code: str
    file: str
    fault: str


class ParticipantRecord(NamedTuple):
    """A participant's events, where they lead to, and what is wrong with their file."""

    code: str
    events: list[dict[str, Any]]
    progress: Progress
    fault: str


def read_record(plan: Plan, code: str) -> ParticipantRecord:
    """Return a participant's record; a file whose lines cannot be read is refused."""
    path = plan.folder / code / f"{EVENTS}.jsonl"
    if not path.exists():
        return ParticipantRecord(code, [], Progress(), "")
    reading = read_chain(path, file_origin(plan.digest, code, EVENTS))
    try:
        if reading.damaged:
            raise ValueError(reading.fault)
        for event in reading.entries:
            if event["kind"] == "page" and not {"page", "name"} < set(event):
                raise KeyError("page")
        return ParticipantRecord(code, reading.entries, progress_of(reading.entries), reading.fault)
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{code}/{path.name} cannot be read ({error}): it was changed after it was written; "
            "restore it from a copy"
        ) from None


def faults_of(plan: Plan, record: ParticipantRecord) -> list[Fault]:
    """Return what is wrong with the plan and with a participant's files."""
    code = record.code
    folder = plan.folder / code
    faults = [Fault(code, PLAN, plan.fault)] if plan.fault else []
    if record.fault:
        # Nothing that its events say can be relied on.
        return [*faults, Fault(code, f"{EVENTS}.jsonl", record.fault)]
    steps = plan.steps(code)
    links: dict[str, list[str]] = {}
    attempts = dict.fromkeys((event["page"], event["attempt"]) for event in _drives(record.events))
    for page, attempt in attempts:
        name = attempt_name(steps[page], attempt)
        driven = read_attempt(plan, code, name)
        links[name] = driven.links
        if driven.fault:
            faults.append(Fault(code, f"{name}.jsonl", driven.fault))
    for event in _drives(record.events):
        name = attempt_name(steps[event["page"]], event["attempt"])
        faults += _faults_of_event(folder, code, event, name, links[name])
    tables = {
        f"{attempt_name(steps[event['page']], event['attempt'])}.csv"
        for event in _drives(record.events)
        if event["kind"] == "page"
    }
    for path in sorted(folder.glob("*.csv")):
        if path.name not in tables:
            faults.append(Fault(code, path.name, f"{path.name}: no event says that it was written"))
    return faults


def _drives(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the events that say how far an attempt at a drive had come."""
    return [event for event in events if "link" in event]


def _faults_of_event(
    folder: Any, code: str, event: dict[str, Any], name: str, links: list[str]
) -> list[Fault]:
    """Return where files are behind what an event says of them, or differ from it."""
    if event["kind"] != "page":
        if event["link"] in links:
            return []
        return [Fault(code, f"{name}.jsonl", f"{name}.jsonl: rows of it are missing")]
    faults = []
    if links[-1:] != [event["link"]]:
        fault = f"{name}.jsonl: it does not end where the drive was finished"
        faults.append(Fault(code, f"{name}.jsonl", fault))
    table = folder / f"{name}.csv"
    if not table.exists() or digest(table.read_bytes()) != event["csv"]:
        faults.append(Fault(code, table.name, f"{table.name}: it was changed"))
    return faults
