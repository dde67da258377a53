"""The control schemes of Sections 3.8 and 3.9 by name, and the printed settings of both studies."""

from dataclasses import dataclass
from difflib import SequenceMatcher

MANUAL, LOGISTIC, STEP, OPERATOR, OPTIMAL = 0, 1, 2, 3, 4


@dataclass(frozen=True)
class Scheme:
    """
    Who sets the scales, and whether the operator feels a force.

    Parameters
    ----------
    name : str
        M, MI, MMI, TMIG, TMIS or OMI.
    title : str
        What it is.
    allocation : int
        How α is set: MANUAL (its upper bound), LOGISTIC (3.5), STEP (3.6), OPERATOR (by hand) or OPTIMAL (Appendix A).
        β follows robot-to-human trust in LOGISTIC and STEP, and stays at its upper bound otherwise.
    bilateral : bool
        Whether forces come back.
    """

    name: str
    title: str
    allocation: int
    bilateral: bool = True


SCHEMES = {
    scheme.name: scheme
    for scheme in (
        Scheme("M", "manual teleoperation with force feedback", MANUAL),
        Scheme("MI", "mixed initiative by trust (3.5), without force feedback", LOGISTIC, bilateral=False),
        Scheme("MMI", "mixed initiative, allocated by hand, with force feedback", OPERATOR),
        Scheme("TMIG", "mixed initiative by trust, logistic scales (3.5), with force feedback", LOGISTIC),
        Scheme("TMIS", "mixed initiative by trust, step scales (3.6), with force feedback", STEP),
        Scheme("OMI", "mixed initiative, optimal allocation (Appendix A), with force feedback", OPTIMAL),
    )
}


def scheme_named(name: str) -> Scheme:
    """Return the scheme of this name; an unknown one is refused with the nearest."""
    if isinstance(name, str) and name in SCHEMES:
        return SCHEMES[name]
    likeness = {known: _likeness(str(name).upper(), known) for known in SCHEMES}
    near = max(likeness, key=likeness.get)
    hint = f"; did you mean {near!r}?" if likeness[near][0] >= 0.3 else ""
    raise ValueError(f"no scheme {name!r}: there are {', '.join(SCHEMES)}{hint}")


def _likeness(name: str, known: str) -> tuple[float, int]:
    """Return how alike two names are, and how many letters they share in any order, which decides between equals."""
    shared = sum(min(name.count(letter), known.count(letter)) for letter in set(name))
    return SequenceMatcher(None, name, known).ratio(), shared
