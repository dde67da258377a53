"""Conditions of live drives: those of the dissertation, and a lab's own."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from trustlab.allocation.limits import threshold_pair
from trustlab.models.checks import finite_number, flag, not_negative, one_of, shown
from trustlab.testbeds.deciding import CONDITIONS, OWN, PERFORMANCE, TSC, suggested_by_tsc

NOTICE = 3.0
"""
Time between a suggestion that must be followed and its being carried out, if the person has not
accepted it before [s].
"""

SCORE = 5
"""A source of suggestions beside those of `deciding`: thresholds of a weighted sum of signals."""

SIGNALS = ("tsc", "p_r", "p_h", "r")
"""What is summed."""

SUGGESTIONS = {"none": OWN, "tsc": TSC, "performance": PERFORMANCE}
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,39}")


def given_thresholds(
    condition: str, thresholds: tuple[float, float] | None, own: "LiveCondition | None" = None
) -> tuple[float, float] | None:
    """
    Return TSC_l and TSC_u: C2, C3 and own conditions by TSC need them, and elsewhere they have no
    effect.
    """
    if not (own.suggestions == "tsc" if own else suggested_by_tsc(condition)):
        if thresholds is not None:
            raise ValueError(f"thresholds have no effect in {condition}; leave them out")
        return None
    if thresholds is None:
        raise ValueError(
            f"{condition} needs thresholds=(TSC_l, TSC_u): take them from "
            "trustlab.choose_thresholds(model)"
        )
    return thresholds


@dataclass(frozen=True)
class LiveCondition:
    """
    A condition of one's own for a live study: where suggestions come from, and who must follow.

    Parameters
    ----------
    name : str
        What the study calls it: letters, digits, - and _; participants do not see it.
    suggestions : {"none", "tsc", "performance"} or mapping
        None: people switch when they like, as in C1. By TSC and its thresholds (2.8), as in C2 and
        C3. By the robot's performance, Algorithm 2, as in C4 and C5. Or a rule of one's own:
        weights of "tsc", "p_r", "p_h" and "r", whose weighted sum takes the place of TSC in (2.8).
    forced : bool
        Whether a suggestion is carried out if the person has not accepted it before.
    notice : float
        How long after the suggestion that happens [s]; 3 in C3 and C5. Suggestions count as
        followed within 15 s.
    thresholds : (float, float), optional
        Of a rule of one's own: the person is to drive where the sum is at or below the first, the
        robot where it is at or above the second; between them the mode stays.

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
    <Live study notices: 4 participants, C3, slow; rehearsal by scripted hands>

    A busy operator hands over, a rested one takes over again:

    >>> tl.LiveCondition("rest", suggestions={"r": 1.0}, thresholds=(0.3, 0.6)).thresholds
    (0.3, 0.6)
    """

    name: str
    suggestions: str | Mapping[str, float] = "none"
    forced: bool = False
    notice: float = NOTICE
    thresholds: tuple[float, float] | None = None

    def __post_init__(self):
        if not isinstance(self.name, str) or not NAME.fullmatch(self.name):
            raise ValueError(
                "a condition's name has letters, digits, - and _, at most 40, and begins with a "
                f"letter; got {shown(self.name)}"
            )
        if self.name in (*CONDITIONS, "training", "identification"):
            raise ValueError(f"{self.name!r} is a drive of the package's own; choose another name")
        if isinstance(self.suggestions, Mapping):
            self._check_rule(self.suggestions)
        else:
            one_of("suggestions", self.suggestions, SUGGESTIONS, also="weights of signals")
            if self.thresholds is not None:
                raise ValueError(
                    "thresholds go with weights of signals; those of TSC are each participant's own"
                )
        self.__dict__["notice"] = not_negative("notice", self.notice)
        if not flag("forced", self.forced):
            if self.notice != NOTICE:
                raise ValueError("notice has no effect without forced=True; leave it out")
        elif self.suggestions == "none":
            raise ValueError(
                "forced=True has no effect without suggestions: there is nothing to follow"
            )

    def _check_rule(self, weights: Mapping[str, float]) -> None:
        """Check a rule of one's own, whose numbers are kept as floats."""
        for signal in weights:
            one_of("a signal of suggestions", signal, SIGNALS)
        numbers = {s: finite_number(f"the weight of {s}", weights.get(s, 0.0)) for s in SIGNALS}
        self.__dict__["suggestions"] = numbers
        if not any(numbers.values()):
            raise ValueError("suggestions: a rule needs a weight that is not zero")
        if self.thresholds is None:
            raise ValueError("weights of signals need thresholds=(lower, upper)")
        # A sum lies in no limits of its own.
        self.__dict__["thresholds"] = threshold_pair("threshold", self.thresholds, math.inf)

    @property
    def scheme(self) -> int:
        """What the kernel calls the source of suggestions."""
        return SCORE if isinstance(self.suggestions, Mapping) else SUGGESTIONS[self.suggestions]

    @property
    def weights(self) -> dict[str, float]:
        """The weight of each signal in a rule of one's own."""
        if isinstance(self.suggestions, Mapping):
            return dict(self.suggestions)
        return dict.fromkeys(SIGNALS, 0.0)
