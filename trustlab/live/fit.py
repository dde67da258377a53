"""
A person's model from minutes of driving: `fit_tsc`, with what the drive does not determine held at
another model's values.
"""

from collections.abc import Sequence
from dataclasses import asdict

from trustlab.identification.model import IdentificationError
from trustlab.identification.result import FitResult
from trustlab.identification.tsc import fit_tsc
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session

UNDETERMINED = ("weak", "at bound")
"""What a fit says of a parameter that the data do not determine."""

UNUSABLE = "do not use the numbers"
"""What a fit says whose search did not end at a minimum."""

LEVELS = ("human_p_min", "human_p_max", "robot_p_min", "robot_p_max")


def fit_holding(session: Session, reference: TscModel) -> FitResult:
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
    reference : TscModel
        Whose values are held.

    Raises
    ------
    IdentificationError
        If no level of performance remains that is the person's own.
    """
    known = {
        f"{part}_{name}": value
        for part, parameters in asdict(reference).items()
        for name, value in parameters.items()
    }
    fixed = {"r0": 0.0}
    fit, weak, said = _fit(session, fixed)
    while weak := [name for name in weak if name in known and name not in fixed]:
        slow = [name for name in weak if name not in LEVELS]
        fixed |= {name: known[name] for name in slow or weak}
        fit, weak, said = _fit(session, fixed)
    if fit is None or UNUSABLE in said or set(LEVELS) <= set(fixed):
        raise IdentificationError(
            f"{session.duration:.0f} s of this drive determine no level of performance, even with "
            "all else held at another model's values; drive longer (laps=8, as printed), in both "
            f"modes: {said}",
            tuple(fixed)[1:],
        )
    return fit


def _fit(session: Session, fixed: dict[str, float]) -> tuple[FitResult | None, Sequence[str], str]:
    """
    Return a fit with some parameters fixed, the parameters that the drive does not determine even
    so, and what the fit says.
    """
    try:
        fit = fit_tsc(session, fixed=fixed)
    except IdentificationError as error:
        return None, error.parameters, str(error)
    table = fit.parameters
    return fit, table.index[table["status"].isin(UNDETERMINED)], fit.message
