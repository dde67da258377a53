"""Whether a printed limit could come from a gain b_pr that rounds as printed but is not the one of (2.3)."""

from __future__ import annotations

from dataclasses import replace

from trustlab.reproduction.audit_checks import Check, Formula, Numbers

__all__ = ["untied_gain_note"]


def untied_gain_note(check: Check, tied: Formula, numbers: Numbers) -> str:
    """
    Return a note where only a b_pr that does not obey (2.3) reaches the printed limit; else an empty text.

    Parameters
    ----------
    check : Check
        Of the limit; its formula takes b_pr as printed.
    tied : Formula
        b_pr by (2.3).
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    """
    printed, gain = numbers[check.number], numbers[check.formula.inputs["b_pr"]]
    least, most = printed.compatible

    def reaches(formula: Formula) -> bool:
        _, low, high = formula.range(numbers)
        return low <= most and high >= least

    if any(map(reaches, (check.formula, *check.conventions))) or not reaches(
        replace(check.formula, as_printed=())
    ):
        return ""
    return (
        f"Only a b_pr that does not obey (2.3) and still rounds to {gain.printed}, from {gain.value - gain.half:.5f} to "
        f"{gain.value + gain.half:.5f}, could reach {printed.printed}; the text chooses b_pr by (2.3), here "
        f"{tied.range(numbers)[0]:.5f}."
    )
