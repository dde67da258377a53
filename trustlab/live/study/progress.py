"""Where a participant is: a fold over their events, and nothing else."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field


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
    model : dict or None
        Model and thresholds from the identification drive, or what stands in for them.
    ended : bool
        Whether the participation was ended.
    withdrawn : bool
        Whether the participant did that.
    completion : str
        The code that the last page shows who came by the link for joining.
    notes : list of dict
        What the experimenter has noted, and torn lines.
    """

    done: dict[int, dict] = field(default_factory=dict)
    attempts: dict[int, int] = field(default_factory=dict)
    model: dict | None = None
    ended: bool = False
    withdrawn: bool = False
    completion: str = ""
    notes: list[dict] = field(default_factory=list)

    def page(self, pages: int) -> int:
        """
        Return the page to show of so many: the first that is not done, and the last one at the end.
        """
        last = pages - 1
        if self.ended:
            return last
        return next((page for page in range(last) if page not in self.done), last)

    def attempt(self, page: int) -> int:
        """Return the number of the current attempt of a drive."""
        return self.attempts.get(page, 0)


def progress_of(events: Iterable[Mapping]) -> Progress:
    """Return where a participant is, from all that has happened."""
    now = Progress()
    for event in events:
        match event["kind"]:
            case "page":
                now.done[event["page"]] = dict(event)
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
