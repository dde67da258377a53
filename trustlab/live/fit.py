"""
A person's model from minutes of driving: `fit_tsc`, with what the drive does not determine held at
another model's values.
"""

from collections.abc import Sequence
from dataclasses import asdict

from trustlab.identification.fit_result import FitResult
from trustlab.identification.structure import IdentificationError
from trustlab.identification.tsc import fit_tsc
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session

UNDETERMINED = ("weak", "at bound")
"""What a fit says of a parameter that the data do not determine."""

UNUSABLE = "do not use the numbers"
"""What a fit says whose search did not end at a minimum."""

LEVELS = ("human_p_min", "human_p_max", "robot_p_min", "robot_p_max")


def fit_holding(session: Session, other: TscModel) -> FitResult:
    """
    Identify a person's model from a drive, with what it leaves undetermined held at another model's
    values.

    Utilization is 0 at the beginning by definition. What the fit then calls weak or at its bound
    (mostly time constants, which are minutes long, and β) is held, levels of performance last, and
    the rest fitted again; held parameters have the status "fixed".

    Parameters
    ----------
    session : Session
        The drive.
    other : TscModel
        Whose values are held.

    Raises
    ------
    IdentificationError
        If no level of performance remains that is the person's own.
    """
    known = {
        f"{who}_{name}": value for who, own in asdict(other).items() for name, value in own.items()
    }
    held = {"r0": 0.0}
    fit, weak, said = _fit(session, held)
    while weak := [name for name in weak if name in known and name not in held]:
        slow = [name for name in weak if name not in LEVELS]
        held |= {name: known[name] for name in slow or weak}
        fit, weak, said = _fit(session, held)
    if fit is None or UNUSABLE in said or not set(LEVELS) - set(held):
        raise IdentificationError(
            f"{session.duration:.0f} s of this drive determine no level of performance, even with "
            "all else held at another model's values; drive longer (laps=8, as printed), in both "
            f"modes: {said}",
            tuple(name for name in held if name != "r0"),
        )
    return fit


def _fit(session: Session, held: dict[str, float]) -> tuple[FitResult | None, Sequence[str], str]:
    """
    Return a fit with some parameters held, the parameters that the drive does not determine even
    so, and what the fit says.
    """
    try:
        fit = fit_tsc(session, fixed=held)
    except IdentificationError as error:
        return None, error.parameters, str(error)
    return fit, list(fit.parameters.index[fit.parameters["status"].isin(UNDETERMINED)]), fit.message
