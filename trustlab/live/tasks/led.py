"""
One period of a team that a person leads, compiled to WebAssembly for browsers.

A browser's memory holds the arrays of a `TeamLoop`, and does at every decision what that loop does:
robots are judged by "motion", trust (4.1) follows, somebody is chosen to lead, and it is set which
packets arrive and where robots drift until the next decision.
"""

import numpy as np
from numba import carray

from trustlab.live.tasks.browser import entry, pointer
from trustlab.models.compiled import njit
from trustlab.models.trust import trust_step
from trustlab.teleoperation.ports.ledger import ACCOUNT
from trustlab.teleoperation.records import record
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.leader_policies import most_trusted
from trustlab.teleoperation.team.performance import rate_move, with_packets

MOST_TRUSTED, HYSTERESIS, SUGGESTED, BY_HAND = range(4)
"""Who chooses the leader."""

LEAD = record(
    numbers="step pull tolerance min_dwell margin since wait",
    counts=(
        "samples decisions per_decision robots goals reached chooses wish leader free plain held"
    ),
)
"""
Settings of a run, and who leads since when. `plain` and `held` are the policies' picks without and
with hysteresis; `free` says whether another robot may take over, `wish` whom the person wants.
"""

FOLLOWER = record(
    vectors="place velocity asked", numbers="speed loss low span decay gain share trust"
)
"""A robot with its faults, and trust (4.1) in it, also as a share of its range."""

ROW = record(
    numbers=(
        "robot_x robot_y team_x team_y goal_x goal_y f_m_x f_m_y path_error leader suggested plain "
        "held free reached"
    )
)
"""What follows the commands in a row, up to trust."""

ADDRESSES = record(
    counts=(
        "leads followers row goals draws drift before rows numbers ends states values vectors into "
        "solve stiffness samples delays arrives accounts u_l u_r w z blown trust"
    )
)
"""Where the arrays of a run are."""

EMPTY = ("samples", "arrives", "u_l", "u_r", "before", "rows", "row")
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
def place_robots(team, w, goal, robots):
    """Set where robots are [m]; w counts from the goal that the team's loop knows."""
    for j in range(robots.size):
        for i in range(3):
            at = 0.0
            for each in range(robots.size):
                at += w[i, each] * team.vectors[j, each]
            robots[j].place[i] = at + goal[i]


@njit(error_model="numpy")
def judge(n, lead, team, m, k, before, rows, robots):
    """Step trust in every robot by what the decision that ends before sample k has shown."""
    kernel.moves_undirected(team, m, before[0], before[1], n.sample_time, rows)
    told, received = m.samples[k - 1], 0.0
    for sample in range(k - lead.per_decision, k):
        received += m.arrives[0, sample]
    for j in range(robots.size):
        robot = robots[j]
        for i in range(3):
            moved = wanted = 0.0
            for each in range(robots.size):
                moved += rows[i, each] * team.vectors[j, each]
                wanted += rows[3 + i, each] * team.vectors[j, each]
            robot.velocity[i], robot.asked[i] = moved, wanted / robot.speed
            if j == told.lead:
                robot.asked[i] += n.lead_gain * told.sent[i]
        rated = rate_move(robot.velocity, robot.asked)
        if j == told.lead:
            rated = with_packets(rated, received / lead.per_decision)
        if not np.isnan(rated):
            robot.share = trust_step(robot.share, rated, robot.decay, robot.gain)  # (4.1)
        robot.trust = robot.low + robot.span * robot.share


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
def set_faults(lead, team, m, k, draws, drift, robots):
    """Set which packets arrive until the next decision, and where robots drift."""
    for sample in range(k, min(k + lead.per_decision, lead.samples)):
        for way in range(2):
            m.arrives[way, sample] = draws[way, sample] >= robots[lead.leader].loss
    for i in range(3):
        for j in range(robots.size):
            blown = 0.0
            for each in range(robots.size):
                blown += drift[k // lead.per_decision, i, each] * team.into[each, j]
            m.blown[i, j] = blown


@njit(error_model="numpy")
def remember(m, before):
    """Keep where the robots are before a sample."""
    for i in range(3):
        for j in range(m.w.shape[1]):
            before[0, i, j] = m.w[i, j]
            before[1, i, j] = m.z[i, j]


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
def team_at(at, size):
    """Return the robots on their undirected graph."""
    basis = carray(pointer(at.vectors), (size, size), np.float64)
    return kernel.Formation(
        False,
        carray(pointer(at.values), size, np.float64),
        basis,
        carray(pointer(at.into), (size, size), np.float64),
        carray(pointer(at.solve), size, np.float64),
        basis,  # five matrices of directed graphs, which nobody reads
        basis,
        basis,
        basis,
        basis,
        carray(pointer(at.stiffness), size, np.float64),
    )


@njit(error_model="numpy", forceinline=True)
def memory_at(at, size, length):
    """Return what a run of so many samples keeps."""
    return kernel.RunMemory(
        carray(pointer(at.samples), length, kernel.SAMPLE),
        carray(pointer(at.delays), (2, length), np.float64),
        carray(pointer(at.arrives), (2, length), np.bool_),
        carray(pointer(at.accounts), 2, ACCOUNT),
        carray(pointer(at.u_l), (length, 3), np.float64),
        carray(pointer(at.u_r), (length, 3), np.float64),
        carray(pointer(at.w), (3, size), np.float64),
        carray(pointer(at.z), (3, size), np.float64),
        carray(pointer(at.blown), (3, size), np.float64),
        carray(pointer(at.trust), size, np.float64),
    )


@njit(error_model="numpy", forceinline=True)
def decide(at, k, n, lead, team, m, robots):
    """Judge, choose, and set faults, where sample k begins a decision."""
    before = carray(pointer(at.before), (2, 3, robots.size), np.float64)
    if k % lead.per_decision == 0:
        rows = carray(pointer(at.rows), (6, robots.size), np.float64)
        draws = carray(pointer(at.draws), (2, lead.samples), np.float64)
        drift = carray(pointer(at.drift), (lead.decisions, 3, robots.size), np.float64)
        if k > 0:
            judge(n, lead, team, m, k, before, rows, robots)
        choose(lead, k // lead.per_decision * lead.step, robots["trust"])
        set_faults(lead, team, m, k, draws, drift, robots)
    if (k + 1) % lead.per_decision == 0:
        remember(m, before)


def lead_there(first, stop, x, y, choice, addresses):
    """
    Lead for the samples from `first` to before `stop` with a hand in its square, for the robot that
    the person chose, 0 for none; return how the run ended, -1 for well.
    """
    at = carray(addresses, 1)[0]
    lead = carray(pointer(at.leads), 1, LEAD)[0]
    n = carray(pointer(at.numbers), 1, kernel.NUMBERS)[0]
    state = carray(pointer(at.states), 1, kernel.STATE)[0]
    row = carray(pointer(at.row), 1, ROW)[0]
    robots = carray(pointer(at.followers), lead.robots, FOLLOWER)
    ends = carray(pointer(at.ends), lead.robots, kernel.ROBOT)
    goals = carray(pointer(at.goals), (lead.goals, 3), np.float64)
    no_log = carray(pointer(at.row), (1, 0), np.float64)
    team = team_at(at, lead.robots)
    m = memory_at(at, lead.robots, lead.samples)
    rig = kernel.rig_of(n)
    lead.wish = int(choice)
    for k in range(first, stop):
        decide(at, k, n, lead, team, m, robots)
        now = m.samples[k]
        now.lead = now.head = lead.leader
        now.hand[0] = lead.pull * x
        now.hand[1] = lead.pull * y
        kernel.solve_ends(n, team, rig, ends, m, k, state)
        kernel.move_undirected(n, team, m.w, m.z, m.blown, state)
        block = kernel.log_sample(n, m, k, lead.samples, state, no_log[0], no_log)
        if block >= 0:
            return block
    place_robots(team, m.w, goals[lead.goals - 1], robots)
    fill_row(lead, goals[min(lead.reached, lead.goals - 1)], state, robots, row)
    return -1


ENTRIES = {"lead": entry(lead_there, ADDRESSES)}
"""The function that the WebAssembly module exports, and numba's signature."""
