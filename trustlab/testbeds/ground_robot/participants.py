"""The dissertation's participants as simulated operators: printed model, own thresholds, readiness to follow."""

from trustlab.models.checks import did_you_mean, whole_number
from trustlab.models.published import published_models, published_table
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator, operator

# TSC_l(0) and TSC_u(0) of the pilot operator, as printed in Section 2.5; Table 2.2 has no column for the pilot.
PILOT_THRESHOLDS = ("0.02", "0.45")


def participant_label(participant: int | str) -> str:
    """
    Return how a participant is called in the printed tables.

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant; the error lists those there are, the nearest first where one is near.
    """
    known = list(published_models())
    if isinstance(participant, str):
        label = participant.strip().lower()
    else:
        try:
            label = str(whole_number("participant", participant, most=10**6))
        except ValueError:
            label = ""
    if label in known:
        return label
    meant = did_you_mean(label, known)
    raise ValueError(
        f"there is no participant {participant!r:.60} among the printed ones: {', '.join(known)}{meant}. For someone else give "
        "an Operator as participant, with model="
    )


def published_model(participant: int | str) -> TscModel:
    """
    Return a participant's printed model, of Table 2.1 (the pilot's of Section 2.2).

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    return published_models()[participant_label(participant)]


def published_operator(participant: int | str) -> Operator:
    """
    Return the simulated stand-in for a participant, made of what is printed of them.

    Utilization and performance are those of Table 2.1, own thresholds (mean and SD) those of Table 2.3, and the shares
    of suggestions followed those of Table 2.6. Of the pilot operator only the model is printed (Sections 2.2.2 and
    2.2.3): own thresholds have the means printed as decision thresholds in Section 2.5, their spread and the
    shares are the defaults of `Operator`. How the hand drives and reacts is not printed of anyone and is that of `Operator`.

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    label = participant_label(participant)
    model = published_models()[label]
    if label == "pilot":
        lower, upper = published_thresholds(label)
        return operator(label, model, lower=(lower, 0.1), upper=(upper, 0.1))
    own, shares = published_table("2.3")[label].astype(float), published_table("2.6")[label].astype(float)
    return operator(
        label,
        model,
        lower=(own["TSC_l", "mean"], own["TSC_l", "sd"]),
        upper=(own["TSC_u", "mean"], own["TSC_u", "sd"]),
        follow=(shares["C2"] / 100.0, shares["C4"] / 100.0),
    )


def published_thresholds(participant: int | str) -> tuple[float, float]:
    """
    Return the decision thresholds TSC_l and TSC_u of Table 2.2 (the pilot's of Section 2.5).

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    label = participant_label(participant)
    printed = PILOT_THRESHOLDS if label == "pilot" else published_table("2.2").loc[["TSC_l", "TSC_u"], label]
    lower, upper = map(float, printed)
    return lower, upper
