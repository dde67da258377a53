"""
A budget of energy for the port that guides the operator: how much it may give out, and what bounds
that.

Guidance that a passive port renders is hardly felt: it can help the hand by no more than the
channel's drag takes. A port with a budget may give out more, by a stated amount.

**Bound.** The port has an account. It starts at `energy`, every sample books what the port takes
or gives out, cuts the account at `energy`, and adds `power` times the sample time; the controller
("repay") lets no sample end below zero. So in any stretch of s seconds, whenever it begins, the
port gives out no more than the account then held and what was added since: energy + power s.

**What follows.** By (3.9)-(3.11) the device stores and dissipates what the operator supplies less
what the port takes. Over a time t it dissipates on average at most the operator's mean power +
`power` + (energy stored at the start + `energy`)/t. An r-passive device dissipates a positive
definite form of its position and velocity, so both stay bounded in the mean square, whatever
channel, delays, losses and vehicle do. With power = 0 the port is passive in the sense of Theorem
4, with `energy` as the constant.
"""

from dataclasses import dataclass

from trustlab.models.checks import Checked, NotNegative, not_negative


@dataclass(frozen=True)
class GuidanceBudget(Checked):
    """
    Energy that guidance at the operator may give out beyond what its port took.

    In any stretch of s seconds the port gives out at most energy + power · s, under the guard
    "repay"; what it takes beyond `energy` is not saved up.

    Parameters
    ----------
    energy : float
        In the account at the start, and the most that it holds [J].
    power : float
        Added all the time [W].

    Raises
    ------
    ValueError
        If a number is negative or not finite.

    Examples
    --------
    >>> import trustlab as tl
    >>> from trustlab.teleoperation import Guidance, GuidanceBudget
    >>> budget = GuidanceBudget(energy=0.2, power=0.5)
    >>> run = tl.simulate_teleoperation("M", duration=10.0, guidance=Guidance(budget=budget))
    >>> bool(run["energy_port"].min() >= -budget.bound(10.0))
    True
    """

    energy: NotNegative = 0.0
    power: NotNegative = 0.0

    def bound(self, seconds: float) -> float:
        """
        Return the most that the port gives out in so many seconds, whenever they begin [J].

        Parameters
        ----------
        seconds : float
            s.
        """
        return self.energy + self.power * not_negative("seconds", seconds)
