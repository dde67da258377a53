"""Bounds that hold for every trajectory: sets of states propagated round the cycle."""

import math
from dataclasses import dataclass
from typing import overload

from trustlab.allocation.cycle.intervals import RangeIntervals, over_draws
from trustlab.allocation.cycle.phases import EFFORT, endless_phase
from trustlab.allocation.cycle.propagation import COARSE, ROUNDING, nest
from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.steady_ranges import SteadyRanges
from trustlab.identification.posterior.result import Posterior
from trustlab.models.checks import whole_number
from trustlab.models.tsc import TscModel

# Width of bounds on utilization from which on they tell nothing.
VACUOUS = 0.98

# Cells for each draw of a posterior, whose spread outweighs what more of them would gain.
CELLS_OF_DRAWS = 64


@dataclass(frozen=True, kw_only=True, repr=False)
class InvariantBounds(SteadyRanges):
    """
    Bounds for every trajectory under rule (2.8), whatever its initial state.

    They hold from the `cycles`-th return to manual control on, overshoot of the thresholds
    included.

    Parameters
    ----------
    guaranteed : bool
        Whether every trajectory is shown to keep switching within these bounds; where not, they are
        the trivial ones, and `reason` says from which state the rule stops switching.
    cycles : int
        After how many returns to manual control the bounds hold.
    """

    guaranteed: bool
    cycles: int

    def _qualified(self) -> str:
        return f"guaranteed={self.guaranteed}, cycles={self.cycles}"


@overload
def invariant_bounds(
    tsc: TscModel, lower: float, upper: float, cells: int = ..., cycles: int = ...
) -> InvariantBounds: ...


@overload
def invariant_bounds(
    tsc: Posterior, lower: float, upper: float, cells: int = ..., cycles: int = ...
) -> RangeIntervals: ...


def invariant_bounds(tsc, lower, upper, cells=1024, cycles=200):
    """
    Bound utilization, robot performance and dwell times for every trajectory under rule (2.8).

    At a switch TSC equals its threshold up to the overshoot of one step, so that the state lies in
    an interval of r with an interval of TSC. Both are propagated through a manual and an autonomous
    phase in interval arithmetic; starting from r in [0, 1] the intervals nest, and their limit
    encloses every trajectory after as many cycles. Where they stop shrinking, r is cut into more
    cells, each of which is propagated by itself. Where TSC tends to a limit between the thresholds
    in one of the modes, trajectories that begin there never switch, and nothing is guaranteed.

    Parameters
    ----------
    tsc : TscModel or Posterior
        The model; or a posterior (`sample_posterior`), of which 200 draws are bounded, in at most
        64 cells each.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    cells : int
        Into how many cells an interval of r is cut at most; more give tighter bounds and take
        longer.
    cycles : int
        Most cycles to follow; fewer give valid but wider bounds that hold sooner.

    Returns
    -------
    InvariantBounds or, for a posterior, RangeIntervals

    Raises
    ------
    ValueError
        If the thresholds are not finite or in the wrong order, or `cells` or `cycles` is not a
        whole number ≥ 1, or `tsc` is not a `TscModel`.

    Examples
    --------
    >>> import trustlab as tl
    >>> bounds = tl.invariant_bounds(tl.published_models()["2"], lower=0.0, upper=0.35)
    >>> bounds.table().round(3)
                               low     high
    quantity
    r                        0.757    0.783
    P_r                      0.310    0.336
    TSC                     -0.005    0.351
    dwell time manual      217.000  219.000
    dwell time autonomous   65.000   65.000
    """
    if isinstance(tsc, Posterior):
        cells = min(whole_number("cells", cells), CELLS_OF_DRAWS)

        def bounds_of(model):
            return invariant_bounds(model, lower, upper, cells, cycles)

        return over_draws(tsc.models, bounds_of, "guaranteed")
    lower, upper = check_thresholds(tsc, lower, upper)
    cells = whole_number("cells", cells)
    cycles = whole_number("cycles", cycles)
    endless = endless_phase(tsc, lower, upper)
    if endless:
        return _trivial(tsc, lower, upper, endless)
    c = tsc.constants()
    coarse = min(COARSE, cells)
    most = int(min(60.0 / (1.0 - max(c.a_r, c.a_pr)), EFFORT / (2 * coarse))) + 100
    enclosure, settled = nest(lower, upper, c, cells, cycles, most)
    done = enclosure.code
    if done < 0:
        phase = "a manual" if done == -1 else "an autonomous"
        return _trivial(
            tsc,
            lower,
            upper,
            f"every phase ends, but {phase} phase from some utilization was not shown to do so "
            f"within {most} samples; cells= below {coarse} allow longer phases",
        )
    manual = enclosure.manual
    autonomous = enclosure.autonomous
    # P_r and TSC are sums over as many samples as a phase has, each rounded; one ROUNDING per
    # sample is far more than that.
    slack = max(manual.dwell_high, autonomous.dwell_high) * ROUNDING
    # r falls in autonomous phases and rises in manual ones, so that its extremes are where these
    # begin.
    r_low = max(enclosure.low - slack, 0.0)
    r_high = min(enclosure.autonomous_high + slack, 1.0)
    reason = f"every trajectory keeps switching; sets of states nested over {done} cycles"
    if not settled:
        more = (
            "more cycles give" if done == cycles else f"more than {EFFORT:.0e} samples would give"
        )
        reason += f" and were still shrinking: {more} tighter bounds"
    if r_high - r_low > VACUOUS:
        reason += (
            f"; but the bounds on utilization, {r_low:.3g} to {r_high:.3g}, exclude next to "
            "nothing: more cells may narrow them, and limit_cycle shows the motion"
        )
    return InvariantBounds(
        model=tsc,
        lower=lower,
        upper=upper,
        guaranteed=True,
        reason=reason,
        cycles=done + 1,
        r_low=r_low,
        r_high=r_high,
        p_r_low=min(manual.p_r_low, autonomous.p_r_low) - slack,
        p_r_high=max(manual.p_r_high, autonomous.p_r_high) + slack,
        tsc_low=min(manual.tsc_low, lower - autonomous.overshoot) - slack,
        tsc_high=max(autonomous.tsc_high, upper + manual.overshoot) + slack,
        dwell_manual_low=manual.dwell_low,
        dwell_manual_high=manual.dwell_high,
        dwell_autonomous_low=autonomous.dwell_low,
        dwell_autonomous_high=autonomous.dwell_high,
    )


def _trivial(tsc: TscModel, lower: float, upper: float, reason: str) -> InvariantBounds:
    """Return the bounds that hold where phases are not known to end."""
    return InvariantBounds(
        model=tsc,
        lower=lower,
        upper=upper,
        guaranteed=False,
        reason=reason,
        cycles=0,
        r_low=0.0,
        r_high=1.0,
        p_r_low=tsc.robot.p_min,
        p_r_high=float(tsc.robot.steady_state(1.0, tsc.human.p_max)),
        tsc_low=-math.inf,
        tsc_high=math.inf,
        dwell_manual_low=1.0,
        dwell_manual_high=math.inf,
        dwell_autonomous_low=1.0,
        dwell_autonomous_high=math.inf,
    )
