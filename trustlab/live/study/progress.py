"""Where a participant is: a fold over their events, and nothing else."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Progress:
    """
    What a participant's events add up to.

    Parameters
    ----------
    done : dict of int to dict
        The event that finished each page.
    attempts : dict of int to int
        Number of the current attempt of each drive, from 0.
    tabs : dict of (int, int) to str
        The window of a browser that drives, by page and attempt: the last one in which the drive
        was begun.
    model : dict or None
        Model and thresholds from the identification drive, or what stands in for them.
    ended : bool
        Whether the participation was ended.
    withdrawn : bool
        Whether the participant did that.
    completion : str
        The code that the last page shows who came by the link for joining.
    notes : list of dict
        What the experimenter, or the page, has noted.
    """

    done: dict[int, dict[str, Any]] = field(default_factory=dict)
    attempts: dict[int, int] = field(default_factory=dict)
    tabs: dict[tuple[int, int], str] = field(default_factory=dict)
    model: dict[str, Any] | None = None
    ended: bool = False
    withdrawn: bool = False
    completion: str = ""
    notes: list[dict[str, Any]] = field(default_factory=list)

    def page(self, pages: int) -> int:
        """
        Return the page to show of so many: the first that is not done, and the last one at the end.
        """
        return (
            pages - 1
            if self.ended
            else next(i for i in range(pages) if i not in self.done or i == pages - 1)
        )

    def attempt(self, page: int) -> int:
        """Return the number of the current attempt of a drive."""
        return self.attempts.get(page, 0)


def progress_of(events: Iterable[Mapping[str, Any]]) -> Progress:
    """Return where a participant is, from all that has happened."""
    now = Progress()
    for event in events:
        match event["kind"]:
            case "page":
                now.done[event["page"]] = dict(event)
            case "begin":
                now.tabs[event["page"], event["attempt"]] = event["tab"]
            case "restart":
                page = event["page"]
                now.done.pop(page, None)
                now.attempts[page] = now.attempt(page) + 1
            case "model":
                now.model = dict(event)
            case "enrol":
                now.completion = event["completion"]
            case "end":
                now.ended = True
                now.withdrawn |= event.get("source") == "participant"
            case "note" | "torn":
                now.notes.append(dict(event))
    return now
