"""Conditions of live drives: those of the dissertation, and a lab's own."""

import re
from dataclasses import dataclass

from trustlab.models.checks import flag, not_negative, one_of, shown
from trustlab.testbeds.deciding import CONDITIONS, OWN, PERFORMANCE, TSC

NOTICE = 3.0
"""
Time between a suggestion that must be followed and its being carried out, if the person has not
accepted it before [s].
"""

SUGGESTIONS = {"none": OWN, "tsc": TSC, "performance": PERFORMANCE}
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,39}")


@dataclass(frozen=True)
class LiveCondition:
    """
    A condition of one's own for a live study: where suggestions come from, and who must follow.

    Parameters
    ----------
    name : str
        What the study calls it: letters, digits, - and _; participants do not see it.
    suggestions : {"none", "tsc", "performance"}
        None: people switch when they like, as in C1. By TSC and its thresholds (2.8), as in C2 and
        C3. By the robot's performance, Algorithm 2, as in C4 and C5.
    forced : bool
        Whether a suggestion is carried out if the person has not accepted it before.
    notice : float
        How long after the suggestion that happens [s]; 3 in C3 and C5.

    Raises
    ------
    ValueError
        If a value is not understood, or nothing is suggested that could be forced.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> slow = tl.LiveCondition("slow", suggestions="tsc", forced=True, notice=10.0)
    >>> tl.LiveStudy(tempfile.mkdtemp() + "/notices", ["C3", slow], 4, rehearsal=True)
    LiveStudy('notices': 4 participants, C3, slow)
    """

    name: str
    suggestions: str = "none"
    forced: bool = False
    notice: float = NOTICE

    def __post_init__(self):
        if not isinstance(self.name, str) or not NAME.fullmatch(self.name):
            raise ValueError(
                "a condition's name has letters, digits, - and _, at most 40, and begins with a "
                f"letter; got {shown(self.name)}"
            )
        if self.name in (*CONDITIONS, "training", "identification"):
            raise ValueError(f"{self.name!r} is a drive of the package's own; choose another name")
        one_of("suggestions", self.suggestions, SUGGESTIONS)
        not_negative("notice", self.notice)
        if flag("forced", self.forced) and self.suggestions == "none":
            raise ValueError(
                'forced=True needs suggestions="tsc" or "performance": there is nothing to follow'
            )

    @property
    def scheme(self) -> int:
        """What the kernel calls the source of suggestions."""
        return SUGGESTIONS[self.suggestions]
