"""
Bounds that hold for every trajectory: sets of states propagated round the cycle.

Interval arithmetic of our own, as compiled code takes no other.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trustlab.allocation.steady import EFFORT, SteadyRanges, endless_phase
from trustlab.models.checks import in_order, of_class, whole_number
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, advance, human_at, human_range, tsc_at

# By how much intervals are widened after each phase: far more than the rounding of the arithmetic.
ROUNDING = 1e-12

# Into how many cells intervals of utilization are cut at first, and by less than which share they
# must shrink in a cycle for more cells to be tried; and, with most cells, for an end.
COARSE = 32
SHRINK = 0.02
SETTLED = 1e-3

# Nearer than this to rest or full load (2.6) is so steep that its one-step changes are bounded by
# its range alone.
STEEP = 1e-6


class PhaseImage(NamedTuple):
    """Bounds of a phase: states at its end, overshoot of its threshold, dwell time, samples."""

    r_low: float
    r_high: float
    overshoot: float
    dwell_low: float
    dwell_high: float
    p_r_low: float
    p_r_high: float
    tsc_low: float
    tsc_high: float


NO_IMAGE = PhaseImage(np.inf, -np.inf, 0.0, np.inf, 0.0, np.inf, -np.inf, np.inf, -np.inf)


@njit
def overshoot(manual, low, high, threshold, c):
    """
    Bound by how much TSC can pass a threshold in the step that meets it, from r in [low, high].

    One step from TSC = threshold changes TSC by this much; from further back it passes by less.
    """
    mode = 1.0 if manual else 0.0
    p_low, p_high = human_range(low, high, c)
    after_low = advance(low, 0.0, 0.0, mode, c)[0]
    after_high = advance(high, 0.0, 0.0, mode, c)[0]
    next_low, next_high = human_range(after_low, after_high, c)
    rest = 1.0 - c.a_pr
    gain = c.b_pr / (1.0 - c.a_pr)
    # With P_r = (threshold + b_T P_h)/a_T put into (2.3), and (2.1) taken before and after the
    # step, ΔTSC = rest (a_T (P_min + M gain P_h) − threshold − b_T P_h) − b_T (P_h(after) − P_h):
    # linear in P_h but for the last term.
    slope = rest * (c.a_T * gain * mode - c.b_T)
    base = rest * (c.a_T * c.p_r_min - threshold)
    # P_h(after) − P_h is at most what any two values of either range differ by. Away from the steep
    # ends it is bounded better: (2.6) is concave, so every one-step chord has a slope between those
    # of the chords at the ends of the range.
    least = next_low - p_high
    most = next_high - p_low
    if (manual and 1.0 - high > STEEP) or (not manual and low > STEEP):
        step_low = abs(after_low - low)
        step_high = abs(after_high - high)
        chord_low = (human_at(after_low, c) - human_at(low, c)) / step_low
        chord_high = (human_at(after_high, c) - human_at(high, c)) / step_high
        chord_least = np.inf
        chord_most = -np.inf
        for chord in (chord_low, chord_high):
            for length in (step_low, step_high):
                chord_least = min(chord_least, chord * length)
                chord_most = max(chord_most, chord * length)
        # Differences of neighbouring values cancel digits.
        slack = 1e-6 * max(abs(chord_least), abs(chord_most))
        least = max(least, chord_least - slack)
        most = min(most, chord_most + slack)
    if manual:
        over = base + max(slope * p_low, slope * p_high) - c.b_T * least
    else:
        over = -(base + min(slope * p_low, slope * p_high)) + c.b_T * most
    return max(0.0, over) * (1.0 + 1e-9) + ROUNDING


@njit
def propagate(manual, low, high, tsc_low, tsc_high, target, c, most, image):
    """
    Propagate utilizations [low, high] with TSC in [tsc_low, tsc_high] through one phase.

    Returns whether all of them end the phase within `most` samples, and the image united with the
    one given. Sample by sample r, P_h and P_r are intervals; the phase can end from the first
    sample at which some TSC can meet the target until all must have.
    """
    mode = 1.0 if manual else 0.0
    p_low, p_high = human_range(low, high, c)
    p_r_low = (tsc_low + c.b_T * p_low) / c.a_T
    p_r_high = (tsc_high + c.b_T * p_high) / c.a_T
    end_low, end_high = image.r_low, image.r_high
    least_p, most_p = image.p_r_low, image.p_r_high
    least_tsc, most_tsc = image.tsc_low, image.tsc_high
    first = -1
    before_low = low
    before_high = high
    last_low = low
    last_high = high
    for n in range(most):
        t_low = tsc_at(p_r_low, p_high, c)
        t_high = tsc_at(p_r_high, p_low, c)
        least_p = min(least_p, p_r_low)
        most_p = max(most_p, p_r_high)
        # At the first sample the interval of TSC given is better than what those of P_r and P_h say
        # about it.
        least_tsc = min(least_tsc, max(t_low, tsc_low) if n == 0 else t_low)
        most_tsc = max(most_tsc, min(t_high, tsc_high) if n == 0 else t_high)
        if n > 0:
            if first < 0 and (t_high >= target if manual else t_low <= target):
                first = n
                before_low = last_low
                before_high = last_high
            if first > 0:
                end_low = min(end_low, low)
                end_high = max(end_high, high)
                before_low = min(before_low, last_low)
                before_high = max(before_high, last_high)
            if t_low >= target if manual else t_high <= target:
                over = overshoot(manual, before_low, before_high, target, c)
                over = max(image.overshoot, over)
                dwells = min(image.dwell_low, first), max(image.dwell_high, n)
                ranges = least_p, most_p, least_tsc, most_tsc
                return True, PhaseImage(end_low, end_high, over, *dwells, *ranges)
        last_low, last_high = low, high
        low, p_r_low = advance(low, p_r_low, p_low, mode, c)
        high, p_r_high = advance(high, p_r_high, p_high, mode, c)
        p_low, p_high = human_range(low, high, c)
    return False, image


@njit
def phase_image(manual, low, high, start, over, target, c, cells, most):
    """
    Propagate [low, high] through one phase cell by cell, as `propagate`.

    TSC begins within `over` beyond `start`.
    """
    image = NO_IMAGE
    tsc_low = start - over if manual else start
    tsc_high = start if manual else start + over
    for k in range(cells):
        left = low + (high - low) * k / cells
        right = low + (high - low) * (k + 1) / cells
        ends, image = propagate(manual, left, right, tsc_low, tsc_high, target, c, most, image)
        if not ends:
            return False, NO_IMAGE
    return True, image


def nest(lower, upper, c, cells, cycles, most):
    """
    Shrink the utilizations with which manual phases begin from [0, 1], cycle by cycle.

    What encloses every trajectory after k cycles encloses it after k + 1 as well as its image does:
    the intersection. Intervals are cut into COARSE cells at first, and into twice as many, up to
    `cells`, whenever a cycle has shrunk them by less than SHRINK, until they have settled, or the
    cycles or EFFORT run out. Returns the utilizations with which manual and autonomous phases
    begin, the images of both, after how many cycles, and whether they had settled; nothing where a
    phase was not shown to end.
    """
    low = 0.0
    high = 1.0
    over = overshoot(False, 0.0, 1.0, lower, c)
    count = min(COARSE, cells)
    effort = EFFORT
    settled = False
    done = 0
    while True:
        ends, manual = phase_image(True, low, high, lower, over, upper, c, count, most)
        if not ends:
            return ()
        first = max(manual.r_low - ROUNDING, 0.0)
        last = min(manual.r_high + ROUNDING, 1.0)
        begun = False, first, last, upper, manual.overshoot
        ends, autonomous = phase_image(*begun, lower, c, count, most)
        if not ends:
            return ()
        samples = manual.dwell_high + autonomous.dwell_high
        # The image of the last utilizations is what is reported.
        if done == cycles or settled or (done > 0 and effort < count * samples):
            return low, last, manual, autonomous, done, settled
        next_low = max(low, autonomous.r_low - ROUNDING)
        next_high = min(high, autonomous.r_high + ROUNDING)
        shrunk = 1.0 - (next_high - next_low) / (high - low)
        low = next_low
        high = next_high
        over = min(over, autonomous.overshoot)
        effort -= count * samples
        done += 1
        settled = shrunk <= SETTLED and count == cells and done > 1
        if shrunk <= SHRINK:
            count = min(2 * count, cells)


# --- for a user ----------------------------------------------------------------------------------


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

    title = "Bounds for every trajectory"

    guaranteed: bool
    cycles: int


def invariant_bounds(
    tsc: TscModel, lower: float, upper: float, cells: int = 1024, cycles: int = 200
) -> InvariantBounds:
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
    tsc : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    cells : int
        Into how many cells an interval of r is cut at most; more give tighter bounds and take
        longer.
    cycles : int
        Most cycles to follow; fewer give valid but wider bounds that hold sooner.

    Returns
    -------
    InvariantBounds

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
    of_class("tsc", tsc, TscModel)
    lower, upper = in_order("lower", lower, "upper", upper)
    cells = whole_number("cells", cells)
    cycles = whole_number("cycles", cycles)
    c = tsc.constants()
    reason = endless_phase(tsc, lower, upper)
    nested = ()
    if not reason:
        coarse = min(COARSE, cells)
        most = int(min(60.0 / (1.0 - max(c.a_r, c.a_pr)), EFFORT / (2 * coarse))) + 100
        nested = nest(lower, upper, c, cells, cycles, most)
        reason = (
            f"a phase from some utilization was not shown to end within {most} samples; "
            f"cells= below {coarse} allow longer phases"
        )
    # P_r keeps to its range and to where the operator at their worst and best would take it.
    robot, human = tsc.robot, tsc.human
    ends = [robot.steady_state(1.0, p_h) for p_h in (human.p_min, human.p_max)]
    of_robot = min(robot.p_min, *ends), max(robot.p_max, *ends)
    unknown = PhaseImage(0.0, 1.0, np.inf, 1.0, np.inf, *of_robot, -np.inf, np.inf)
    low, high, manual, autonomous, done, settled = nested or (0.0, 1.0, unknown, unknown, -1, True)
    slack = 0.0
    if nested:
        reason = f"every trajectory keeps switching; sets of states nested over {done} cycles"
        if not settled:
            reason += " and were still shrinking, so that tighter bounds exist"
        # P_r and TSC are sums over as many samples as a phase has, each rounded; one ROUNDING per
        # sample is far more than that.
        slack = max(manual.dwell_high, autonomous.dwell_high) * ROUNDING
    # r falls in autonomous phases and rises in manual ones, so that its extremes are where these
    # begin.
    return InvariantBounds(
        model=tsc,
        lower=lower,
        upper=upper,
        guaranteed=bool(nested),
        reason=reason,
        cycles=done + 1,
        r_low=max(low - slack, 0.0),
        r_high=min(high + slack, 1.0),
        p_r_low=min(manual.p_r_low, autonomous.p_r_low) - slack,
        p_r_high=max(manual.p_r_high, autonomous.p_r_high) + slack,
        tsc_low=min(manual.tsc_low, lower - autonomous.overshoot) - slack,
        tsc_high=max(autonomous.tsc_high, upper + manual.overshoot) + slack,
        dwell_manual_low=manual.dwell_low,
        dwell_manual_high=manual.dwell_high,
        dwell_autonomous_low=autonomous.dwell_low,
        dwell_autonomous_high=autonomous.dwell_high,
    )
