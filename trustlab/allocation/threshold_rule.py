"""The TSC-based switching rule (2.8), step by step."""

from __future__ import annotations

from dataclasses import dataclass

from trustlab.models.checks import finite_number, whole_number

__all__ = ["ThresholdRule"]


@dataclass
class ThresholdRule:
    """
    Manual when TSC has fallen to TSC_l, autonomous when it has risen to TSC_u, unchanged between, equation (2.8).

    Thresholds and mode may be assigned while the rule runs and are checked as at the beginning; `move` changes both
    thresholds at once.

    Parameters
    ----------
    lower, upper : float
        TSC_l and TSC_u, lower < upper.
    mode : int
        The mode to begin with: 1 manual, 0 autonomous.

    Raises
    ------
    ValueError
        If the thresholds are not finite or in the wrong order, or the mode is not 0 or 1.

    Examples
    --------
    >>> rule = ThresholdRule(lower=0.02, upper=0.45)
    >>> [rule.step(tsc=value) for value in (0.3, 0.5, 0.3, 0.0)]
    [1, 0, 0, 1]
    """

    lower: float
    upper: float
    mode: int = 1

    def __setattr__(self, name, value):
        if name in ("lower", "upper"):
            value = finite_number(name, value)
            pair = {"lower": self.__dict__.get("lower"), "upper": self.__dict__.get("upper")} | {name: value}
            if None not in pair.values():
                self._ordered(**pair)
        elif name == "mode":
            value = whole_number("mode", value, least=0, most=1)
        else:
            raise ValueError(f"a ThresholdRule has lower, upper and mode, but no {name!r}")
        object.__setattr__(self, name, value)

    @staticmethod
    def _ordered(lower: float, upper: float) -> None:
        if not lower < upper:
            raise ValueError(f"the lower threshold must be below the upper one, got {lower} and {upper}")

    def move(self, lower: float, upper: float) -> None:
        """
        Change both thresholds; the mode stays until the next step.

        Parameters
        ----------
        lower, upper : float
            TSC_l and TSC_u, lower < upper.

        Raises
        ------
        ValueError
            If they are not finite or in the wrong order; both stay what they were.
        """
        lower, upper = finite_number("lower", lower), finite_number("upper", upper)
        self._ordered(lower, upper)
        self.__dict__.update(lower=lower, upper=upper)

    def step(self, tsc: float, p_r: float | None = None) -> int:
        """
        Return the mode for this sample and remember it.

        Parameters
        ----------
        tsc : float
            TSC now.
        p_r : float, optional
            Robot performance; the rule has no use for it, and takes it so that both rules are called alike. It is
            checked all the same: a NaN in the loop that drives the rule should not go on unseen.

        Raises
        ------
        ValueError
            If a value given is not a finite number; the mode stays what it was.
        """
        try:
            tsc = finite_number("tsc, which rule (2.8) needs,", tsc)
            if p_r is not None:
                finite_number("p_r (unused by rule (2.8))", p_r)
        except ValueError as error:
            raise ValueError(f"{error}, so the mode stays {self.mode}") from None
        if tsc >= self.upper:
            self.__dict__["mode"] = 0
        elif tsc <= self.lower:
            self.__dict__["mode"] = 1
        return self.mode
