"""
One period of a team that a person leads, compiled to WebAssembly for browsers.

A browser's memory holds the arrays of a `TeamLoop`, and does at every decision what that loop does:
robots are judged by "motion", trust (4.1) follows, and somebody is chosen to lead.
"""

import numpy as np
from numba import carray

from trustlab.live.tasks.browser import entry, pointer
from trustlab.models.compiled import njit
from trustlab.models.trust import trust_step
from trustlab.teleoperation.ports.waves import ACCOUNT
from trustlab.teleoperation.records import record
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.decisions import most_trusted, rate_move, with_packets

COLUMNS = len(kernel.COLUMNS)

MOST_TRUSTED, HYSTERESIS, SUGGESTED, BY_HAND = range(4)
"""Who chooses the leader."""

LEAD = record(
    numbers="step pull tolerance min_dwell margin since wait",
    counts="samples decisions robots goals reached chooses wish leader free plain held",
)
"""
Settings of a run, and who leads since when. `plain` and `held` are the policies' picks without and
with hysteresis; `free` says whether another robot may take over, `wish` whom the person wants.
"""

FOLLOWER = record(vectors="place", numbers="share trust")
"""Where a robot is, and trust (4.1) in it, also as a share of its range."""

ROW = record(
    numbers=(
        "robot_x robot_y team_x team_y goal_x goal_y f_m_x f_m_y path_error leader suggested plain "
        "held free reached"
    )
)
"""What follows the commands in a row, up to trust."""

ADDRESSES = record(
    counts=(
        "leads followers row goals numbers robots formations stiffness storing delays draws drift "
        "now q zeta middle velocity asked trust arrives u_l u_r accounts inputs samples "
        "table places"
    )
)
"""Where the arrays of a run are."""

EMPTY = ("inputs", "samples", "u_l", "u_r", "table", "places", "row")
"""Arrays that are zero before a run."""


@njit(error_model="numpy")
def about(places, goal):
    """Return the middle of a team and how far its farthest robot is from a goal: x, y, far [m]."""
    x = y = far = 0.0
    for j in range(places.shape[0]):
        away = (places[j, 0] - goal[0]) ** 2 + (places[j, 1] - goal[1]) ** 2
        far = max(far, np.sqrt(away))
        x += places[j, 0] / places.shape[0]
        y += places[j, 1] / places.shape[0]
    return x, y, far


@njit(error_model="numpy")
def place_robots(setup, state, goal, followers):
    """Set where robots are [m]; q counts from the goal that the team's loop knows."""
    for j in range(followers.size):
        for i in range(3):
            followers[j].place[i] = state.q[j, i] * setup.robots[j].root + goal[i]


@njit(error_model="numpy")
def judge(setup, state, leader, k, followers):
    """Step trust in every robot by what the decision that ends before sample k has shown."""
    packets, received = setup.numbers[0].per_decision, 0.0
    for sample in range(k - packets, k):
        received += state.arrives[0, sample]
    for j in range(followers.size):
        robot, known = followers[j], setup.robots[j]
        rated = rate_move(state.velocity[j], state.asked[j])
        if j == leader:
            rated = with_packets(rated, received / packets)
        if not np.isnan(rated):
            robot.share = trust_step(robot.share, rated, known.hr_decay, known.hr_gain)  # (4.1)
        robot.trust = known.low + known.span * robot.share


@njit(error_model="numpy")
def choose(lead, t, trust):
    """Let the policies pick; the person or one of them chooses who leads from t on."""
    led = t - lead.since
    lead.free = lead.leader < 0 or led >= lead.min_dwell - 1e-9
    lead.wait = max(lead.min_dwell - led, 0.0)
    lead.plain = most_trusted(trust, lead.leader, lead.free, 0.0)
    lead.held = most_trusted(trust, lead.leader, lead.free, lead.margin)
    if lead.chooses == MOST_TRUSTED:
        chosen = lead.plain
    elif lead.chooses == HYSTERESIS:
        chosen = lead.held
    else:
        chosen = lead.wish - 1 if lead.wish > 0 else max(lead.leader, 0)
    if chosen != lead.leader and (lead.leader < 0 or led >= lead.min_dwell - 1e-6):
        lead.leader, lead.since = chosen, t


@njit(error_model="numpy")
def fill_row(lead, goal, state, robots, row):
    """Set a row of the log, after the samples of its period."""
    row.team_x, row.team_y, row.path_error = about(robots["place"], goal)
    row.robot_x, row.robot_y = robots[lead.leader].place[0], robots[lead.leader].place[1]
    row.goal_x, row.goal_y = goal[0], goal[1]
    row.f_m_x, row.f_m_y = state.f_m[0], state.f_m[1]
    if row.path_error <= lead.tolerance:
        lead.reached += 1
    suggests = lead.chooses == SUGGESTED and lead.free and lead.held != lead.leader
    row.leader = lead.leader + 1
    row.suggested = lead.held + 1 if suggests else 0
    row.plain = lead.plain + 1
    row.held = lead.held + 1
    row.free = lead.free
    row.reached = lead.reached


@njit(error_model="numpy", forceinline=True)
def setup_at(at, size, length, decisions):
    """Return what stays the same; the graph does."""
    return kernel.TeamSetup(
        carray(pointer(at.numbers), 1, kernel.NUMBERS),
        carray(pointer(at.robots), size, kernel.ROBOT),
        carray(pointer(at.formations), (1, 3, size, size), np.float64),
        carray(pointer(at.stiffness), (1, size), np.float64),
        carray(pointer(at.storing), 1, np.float64),
        carray(pointer(at.delays), (2, length), np.float64),
        carray(pointer(at.draws), (2, length), np.float64),
        carray(pointer(at.drift), (decisions, size, 3), np.float64),
    )


@njit(error_model="numpy", forceinline=True)
def state_at(at, size, length):
    """Return what samples hand on."""
    return kernel.TeamState(
        carray(pointer(at.now), 1, kernel.STATE),
        carray(pointer(at.now), COLUMNS, np.float64),  # the row of the log begins the state
        carray(pointer(at.q), (size, 3), np.float64),
        carray(pointer(at.zeta), (size, 3), np.float64),
        carray(pointer(at.middle), (size, 3), np.float64),
        carray(pointer(at.velocity), (size, 3), np.float64),
        carray(pointer(at.asked), (size, 3), np.float64),
        carray(pointer(at.trust), size, np.float64),
        carray(pointer(at.arrives), (2, length), np.bool_),
        carray(pointer(at.u_l), (length, 3), np.float64),
        carray(pointer(at.u_r), (length, 3), np.float64),
        carray(pointer(at.accounts), 2, ACCOUNT),
    )


def lead_there(first, stop, x, y, choice, addresses):
    """
    Lead for the samples from `first` to before `stop` with a hand in its square, for the robot that
    the person chose, 0 for none; return how the run ended, -1 for well.
    """
    at = carray(addresses, 1)[0]
    lead = carray(pointer(at.leads), 1, LEAD)[0]
    row = carray(pointer(at.row), 1, ROW)[0]
    followers = carray(pointer(at.followers), lead.robots, FOLLOWER)
    goals = carray(pointer(at.goals), (lead.goals, 3), np.float64)
    inputs = carray(pointer(at.inputs), lead.samples, kernel.INPUT)
    setup = setup_at(at, lead.robots, lead.samples, lead.decisions)
    state = state_at(at, lead.robots, lead.samples)
    log = kernel.TeamLog(
        carray(pointer(at.samples), lead.samples, kernel.SAMPLE),
        carray(pointer(at.table), (1, COLUMNS), np.float64),
        carray(pointer(at.places), (1, lead.robots, 3), np.float64),
    )
    decision, begins = divmod(first, setup.numbers[0].per_decision)
    lead.wish = int(choice)
    if begins == 0:  # a decision takes one period or more
        if decision > 0:
            judge(setup, state, lead.leader, first, followers)
        choose(lead, decision * lead.step, followers["trust"])
    for k in range(first, stop):
        inputs[k].lead = lead.leader
        inputs[k].hand[0] = lead.pull * x
        inputs[k].hand[1] = lead.pull * y
    block = kernel.lead_team(first, stop, setup, state, inputs, log)[1]
    if block >= 0:
        return block
    place_robots(setup, state, goals[lead.goals - 1], followers)
    fill_row(lead, goals[min(lead.reached, lead.goals - 1)], state.now[0], followers, row)
    return -1


ENTRIES = {"lead": entry(lead_there, ADDRESSES)}
"""The function that the WebAssembly module exports, and numba's signature."""
