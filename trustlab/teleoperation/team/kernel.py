"""
The teleoperated team (Fig. 4.1), compiled, with dense matrices: O(N²) a sample, on any graph.

`lead_team` is a kernel of `Simulation`: a sample is a row of named steps, each on the record of
STATE of operator and channel and on arrays of the robots. Who leads and on which graph comes from
outside and may change at any sample.
"""

from collections import namedtuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.records import AXES, block, columns_of, record, step
from trustlab.models.trust import logistic_scale, trust_step
from trustlab.teleoperation import ports
from trustlab.teleoperation.ports import DEVICE, END, copy, dot, read_waves

BLOCKS = ("the haptic device", "the channel", "the team")

# Below this, motion [m/s] is rounding, and there is nothing to judge by.
LEAST_SPEED = 1e-6

# A row of the log: storages before the sample and the signals of the sample.
LOG = record(
    vectors="leader device r_m f_h f_m r_s f_s",
    numbers=(
        "number beta trust_rh push v_h v_hd v_ch v_fs v_e v_e_delayed v_filter v_t supply_team "
        "supply_error supply_hand supply_device supply_filter supply_links lost_device lost_team "
        "lost_error lost_error_delayed"
    ),
)

COLUMNS = columns_of(LOG)

# The state proper beside the device's place, which the log has: its velocity before the sample and
# in its middle, and what the filters F1 (near) and F2 (far), or the filters of waves, hold.
CARRIED = (
    "device_velocity middle near_velocity near_force far_velocity far_force filtered_l filtered_r"
)
# Looked up or worked out before each end is solved: error as the operator sees it, the way along
# which the hand pulls (this error, or the way to where a live hand is), waves, force at rest.
ARRIVED = "error way v_l v_r open_force"
# Force of the channel at the operator's end before the device moves, force of a whole push, and
# what a robot's neighbours pull it by.
SIGNALS = "channel_force aim pulled"
# The hand's spring [N/m], powers of this sample [W], and what is dissipated in it.
POWERS = "spring seen_power near_power far_power device_loss team_loss error_loss"
# The graph of the sample before, and the robot for which the operator's end of the channel is set.
WITHIN = record(vectors=f"{CARRIED} {ARRIVED} {SIGNALS}", numbers=POWERS, counts="graph head")
# What both ends read and leave; it begins with the row of the log, so that energies since the start
# stand there alone.
STATE = np.dtype([*LOG.descr, *WITHIN.descr])

# One robot of speed s: √s, the velocity by which it drifts [m/s], the probability that it loses a
# packet, its trust in the operator, and the ends of the channel while it leads.
ROBOT = record(
    numbers="root drift loss beta_min beta_max decay gain t_min t_max", near=END, far=END
)

# Low-pass filters under the midpoint rule, and the gains of a two-port, (4.16). In the middle of a
# sample they give out decay · level + gate · input; the level is as far beyond that at its end as
# it was before it at its start.
LOW_PASS = record(numbers="decay gate k12 k21")

# What comes in goes out.
UNFILTERED = (0.0, 1.0, 0.0, 0.0)

# Device, two-port or none, filter of waves, and operator; see `TeamSettings` and `TeamOperator`.
NUMBERS = record(
    vectors="goal",
    numbers=(
        "sample_time cutoff push grip reach drag budget reserve error_range steepness "
        "lead_gain force_gain"
    ),
    counts="vision per_decision per_row",
    flags="guarded drifting switching filtering",
    device=DEVICE,
    filters=LOW_PASS,
    low_pass=LOW_PASS,
)

# What comes from outside in each sample: where a live hand wants the device to be (NaN without
# one), who leads, and the number of the graph.
INPUT = record(vectors="hand", counts="lead graph")


# What later samples look up of each sample: the velocity sent to the leader and its distance to the
# goal; dissipation and storage of the error system.
SAMPLE = record(vectors="sent seen", numbers="lost stored")

# Matrices of a formation.
SOLVED, INNER, LAPLACIAN = range(3)


# What stays the same in a run of K samples and M decisions of N robots. numbers, shape (1,): a
# record of NUMBERS. robots, shape (N,): records of ROBOT. formations, shape (G, 3, N, N), and
# stiffness, shape (G, N): what `formation_on` returns of each graph. storing, shape (G,): φ/g, the
# unit in which the formation's energy counts; NaN where the graph is directed. delays, shape (2,
# K): in samples. draws, shape (2, K): uniform numbers, by which packets are lost. drift, shape (M,
# N, 3): way [m] in half a sample that robots go beside (4.22), over √s.
TeamSetup = namedtuple(
    "TeamSetup", "numbers robots formations stiffness storing delays draws drift"
)

# What samples hand on; changed in place. now, shape (1,): a record of STATE. shown, shape (1,):
# likewise, the last sample as a row of the log has it. q, zeta, shape (N, 3):
# distance to the goal and ζ, over √s. middle, shape (N, 3): q in the middle of the sample, first as
# if the leader were not driven. rated, shape (N,): how well robots moved in the last sample before
# a decision. trust, shape (N,): in the operator, (4.2). arrives, shape (2, K): whether waves do.
# u_l, u_r, shape (K, 3): waves. accounts: `ports.accounts()`.
TeamState = namedtuple("TeamState", "now shown q zeta middle rated trust arrives u_l u_r accounts")

# samples, shape (K,): records of SAMPLE. table, shape (rows,): records of STATE, every `per_row`
# samples. places, shape (rows, N, 3): distances to the goal over √s.
TeamLog = namedtuple("TeamLog", "samples table places")


@block
def push_share(budget, power, pull, square, still, drag):
    """
    Return the greatest share σ ≤ 1 of a push whose power does not exceed `power`.

    The device yields by r = a + y σ p to the push p, drag d at the hand: the hand gives r (σ p − d
    r) = −d a² + σ p a (1 − 2 d y) + σ² y p² (1 − d y), with the sums pull = Σ p a (1 − 2 d y),
    square = Σ y p² (1 − d y) and still = Σ a². Nothing is pushed while the budget is spent.
    """
    if budget <= 0.0 or power <= 0.0:
        return 0.0
    free = power + drag * still
    if square + pull <= free:
        return 1.0
    # the root of square σ² + pull σ = free, in the form that does not cancel
    return min(2.0 * free / (pull + np.sqrt(pull * pull + 4.0 * square * free)), 1.0)


@step
def store_energy(n, state, now):
    """Set the storages of device, filters and error system at the start of the sample."""
    now.v_hd = squares = 0.0
    for i in AXES:
        # (3.9)
        now.v_hd += ports.device_storage(n.device, now.device[i], now.device_velocity[i])
    for j in range(state.trust.size):
        squares += dot(state.q[j], state.q[j]) + dot(state.zeta[j], state.zeta[j])
    now.v_e = 0.5 * squares / n.lead_gain  # (4.29)
    velocities = dot(now.near_velocity, now.near_velocity) + dot(now.far_velocity, now.far_velocity)
    forces = dot(now.near_force, now.near_force) + dot(now.far_force, now.far_force)
    now.v_filter = (n.filters.k21 * velocities + n.filters.k12 * forces) / n.cutoff


@step
def stored_by(setup, graph, state):
    """Return V_fs (4.23) on a graph; NaN on a directed one."""
    matrices, v_fs = setup.formations[graph], 0.0
    for j in range(state.trust.size):
        for m in range(state.trust.size):
            products = dot(state.q[j], state.q[m]) + dot(state.zeta[j], state.zeta[m])
            v_fs += 0.5 * matrices[LAPLACIAN, j, m] * products  # (4.23)
    return v_fs * setup.storing[graph]


@step
def look_up_past(n, k, given, past, state):
    """
    Set what the operator sees, the leader of `vision` samples ago and what it was told to do;
    return the operator's performance as the robots judge it.
    """
    in_sight, live = k >= n.vision, not np.isnan(given.hand[0])
    state.spring = n.grip if live else n.push
    for i in AXES:
        state.error[i] = -past.seen[i] if in_sight else 0.0  # r_q − y_h(t − T), (4.26)
        state.way[i] = given.hand[i] - state.device[i] if live else state.error[i]
    state.seen_power = dot(past.sent, state.error) if in_sight else 0.0
    if in_sight and n.push > 0.0:
        return max(1.0 - np.sqrt(dot(state.error, state.error)) / n.error_range, 0.0)
    return 0.0


@step
def share_force(n, robots, lead, trust, performance, state):
    """Set β by the leader's trust in the operator, and step the trust of all."""
    leader = robots[lead]
    state.number = lead
    state.trust_rh = leader.t_min + (leader.t_max - leader.t_min) * trust[lead]
    share = min(max(trust[lead], 0.0), 1.0)
    # (3.5)
    state.beta = logistic_scale(leader.beta_min, leader.beta_max, n.steepness, 0.5, share)
    for i in range(trust.size):
        trust[i] = trust_step(trust[i], performance, robots[i].decay, robots[i].gain)  # (4.2)


@step
def receive(n, setup, lead, k, state, now):
    """Set the waves that arrive at both ends, (3.16), filtered where waves are."""
    for way in range(2):
        state.arrives[way, k] = setup.draws[way, k] >= setup.robots[lead].loss
    sent, how = (state.u_l, state.u_r), (n.sample_time, state.accounts)
    read_waves(*sent, state.arrives, k, setup.delays, *how, now.v_l, now.v_r)
    if n.filtering:
        filter_wave(n.low_pass, now.v_r, now.filtered_r)
        filter_wave(n.low_pass, now.v_l, now.filtered_l)


@step
def middle_of(low_pass, u, level):
    """Return what a low-pass filter gives out in the middle of a sample."""
    return low_pass.decay * level + low_pass.gate * u


@step
def filter_wave(low_pass, wave, level):
    """Filter a wave in place; `level` is the filter's state."""
    for i in AXES:
        wave[i] = middle_of(low_pass, wave[i], level[i])
        level[i] = 2.0 * wave[i] - level[i]


@step
def operator_side(n, end, spendable, state, u_l):
    """
    Solve the operator's end of the channel with filter, device and hand, and the device's velocity.

    The channel's force, f_m and r_m are affine in each other, with the same slopes on every axis:
    force = channel_force + echo · r_m, f_m = offset + resistance · r_m, and the device yields to a
    force by `mobility`. `spendable` is what V_h leaves above the reserve [J], `u_l` the wave sent.
    """
    device, filters = n.device, n.filters
    loaded = 1.0 + state.beta * end.b * filters.k12
    echo = state.beta * end.b * filters.gate / loaded
    resistance = filters.k21 + filters.gate * echo
    admittance = device.lever / device.inertia
    under = 1.0 + admittance * (resistance + n.drag)
    mobility = admittance / under
    pushing = state.spring * np.sqrt(dot(state.way, state.way))
    spring = state.spring * min(1.0, n.reach / pushing) if pushing > 0.0 else 0.0
    for i in AXES:  # f_m and r_m as if the hand did not push
        held = ports.operator_force(end, filters.decay * state.near_velocity[i], state.v_l[i])
        state.channel_force[i] = state.beta * held / loaded  # (3.22), (3.12)
        state.f_m[i] = middle_of(filters, state.channel_force[i], state.near_force[i])
        x, v = state.device[i], state.device_velocity[i]
        state.r_m[i] = ports.free_output(device, x, v, -state.f_m[i]) / under
        state.aim[i] = spring * state.way[i]
    state.push = 1.0
    if n.guarded:
        power = spendable / n.sample_time + state.seen_power
        pull = (1.0 - 2.0 * n.drag * mobility) * dot(state.aim, state.r_m)
        square = mobility * (1.0 - n.drag * mobility) * dot(state.aim, state.aim)
        still = dot(state.r_m, state.r_m)
        state.push = push_share(spendable, power, pull, square, still, n.drag)  # (4.30)
    state.device_loss = state.near_power = 0.0
    for i in AXES:
        state.r_m[i] += mobility * state.push * state.aim[i]
        state.f_m[i] += resistance * state.r_m[i]
        state.f_h[i] = state.push * state.aim[i] - n.drag * state.r_m[i]
        # the filter's far side, (4.16)-(4.17)
        force = state.channel_force[i] + echo * state.r_m[i]
        passed = middle_of(filters, state.r_m[i], state.near_velocity[i])
        velocity = passed - filters.k12 * force
        u_l[i] = ports.operator_wave(end, velocity, state.v_l[i])  # (3.22)
        x, v = state.device[i], state.device_velocity[i]
        # (4.6)
        v_middle = ports.midpoint_velocity(device, x, v, state.f_h[i], state.f_m[i])
        state.middle[i] = v_middle
        x_middle = x + 0.5 * n.sample_time * v_middle
        state.device_loss += ports.device_loss(device, x_middle, v_middle)  # (3.10)
        state.near_power += velocity * force
        passed_force = state.f_m[i] - filters.k21 * state.r_m[i]
        state.near_velocity[i] = 2.0 * passed - state.near_velocity[i]
        state.near_force[i] = 2.0 * passed_force - state.near_force[i]


@step
def robot_side(filters, end, stiffness, state, u_r):
    """
    Solve the robots' end of the channel with filter and leader: f_s = open_force + stiffness · r_s.

    Both relations of the filter, (4.16)-(4.17), are affine in the velocity at the channel's port,
    r_s = offset + share · velocity and force = held + resistance · velocity, which the wave
    equation then fixes.
    """
    state.far_power = 0.0
    under = 1.0 + filters.k12 * stiffness
    share = filters.gate / under
    resistance = filters.k21 + filters.gate * stiffness * share
    for i in AXES:
        loose = filters.decay * state.far_velocity[i]
        offset = (loose - filters.k12 * state.open_force[i]) / under
        held = middle_of(filters, state.open_force[i] + stiffness * offset, state.far_force[i])
        free = ports.robot_velocity(end, held, state.v_r[i])
        velocity = free / (1.0 + resistance / end.b)  # (3.22), α = 1
        force = held + resistance * velocity
        state.r_s[i] = offset + share * velocity
        state.f_s[i] = state.open_force[i] + stiffness * state.r_s[i]  # (4.24)
        u_r[i] = ports.robot_wave(end, force, state.v_r[i])  # (3.22)
        state.far_power += velocity * force
        passed = loose + filters.gate * velocity
        passed_force = force - filters.k21 * velocity
        state.far_velocity[i] = 2.0 * passed - state.far_velocity[i]
        state.far_force[i] = 2.0 * passed_force - state.far_force[i]


@step
def add_row(matrix, j, vectors, out):
    """Add row j of a matrix times the robots' vectors to `out`."""
    for m in range(matrix.shape[0]):
        for i in AXES:
            out[i] += matrix[j, m] * vectors[m, i]


@step
def rest(n, matrices, leader, lead, state, now):
    """
    Set where robots would be in the middle of the sample if the leader were not driven, and the
    force (4.24) that it would report then.
    """
    for j in range(state.trust.size):
        for i in AXES:
            state.middle[j, i] = 0.0
        add_row(matrices[SOLVED], j, state.q, state.middle[j])
        add_row(matrices[INNER], j, state.zeta, state.middle[j])
    for i in AXES:
        now.open_force[i] = 0.0
    add_row(matrices[LAPLACIAN], lead, state.middle, now.open_force)
    for i in AXES:
        now.open_force[i] *= n.force_gain * leader.root


@step
def move(n, matrices, leader, lead, drift, state, now):
    """Step (4.22); set the leader's place in the middle of the sample, and what is lost."""
    h = 0.5 * n.sample_time
    now.team_loss = now.error_loss = 0.0
    for j in range(state.trust.size):
        for i in AXES:
            drive = h * n.lead_gain * leader.root * now.r_s[i]
            state.middle[j, i] += drive * matrices[SOLVED, j, lead]
        if n.drifting:
            add_row(matrices[SOLVED], j, drift, state.middle[j])
    for j in range(state.trust.size):
        for i in AXES:
            now.pulled[i] = 0.0
        add_row(matrices[LAPLACIAN], j, state.middle, now.pulled)
        for i in AXES:
            # (4.22): q̇ = Lᵀζ − L q + D r_s, ζ̇ = −L q
            state.q[j, i] = 2.0 * state.middle[j, i] - state.q[j, i]
            state.zeta[j, i] -= 2.0 * h * now.pulled[i]
        now.team_loss += dot(now.pulled, now.pulled) * n.force_gain / n.lead_gain  # (4.25)
        now.error_loss += dot(now.pulled, state.middle[j]) / n.lead_gain  # (4.33)
    for i in AXES:
        now.leader[i] = leader.root * state.middle[lead, i]


@step
def rate_motion(n, robots, drift, state):
    """
    Rate how each robot moved, v, against how (4.22) asks a faultless one in its place to, v̂:
    1 − ‖v − v̂‖/(‖v‖ + ‖v̂‖), which is 2 s/(1 + s) for one of speed s; NaN where nothing moves. In
    steps of 0.001, so that no two faultless robots differ by their rounding.
    """
    h = 0.5 * n.sample_time
    for j in range(robots.size):
        off = moved = asked = 0.0
        for i in AXES:
            way = state.q[j, i] - state.middle[j, i]  # in half a sample, over √s
            velocity = robots[j].root * way / h
            faultless = (way - drift[j, i]) / (robots[j].root * h)
            off += (velocity - faultless) ** 2
            moved += velocity**2
            asked += faultless**2
        moving, state.rated[j] = np.sqrt(moved) + np.sqrt(asked), np.nan
        if moving > LEAST_SPEED:
            state.rated[j] = np.rint(1000.0 * (1.0 - np.sqrt(off) / moving)) / 1000.0


@step
def account_energy(n, seen_loss, state):
    """Step the device, and book the energy of every port; `seen_loss` is that of the picture."""
    T = n.sample_time
    for i in AXES:
        state.device[i] += T * state.middle[i]
        state.device_velocity[i] = 2.0 * state.middle[i] - state.device_velocity[i]
    hand, port = dot(state.r_m, state.f_h), dot(state.r_m, state.f_m)
    team, channel = dot(state.r_s, state.f_s), state.near_power - state.far_power
    state.v_h += T * (state.seen_power - hand)  # (4.30)
    state.v_ch += T * channel  # (4.15)
    state.supply_team += T * team
    state.supply_error += T * dot(state.r_s, state.leader)
    state.supply_hand += T * hand
    state.supply_device += T * (hand - port)
    state.supply_filter += T * (port - team - channel)
    state.lost_device += T * state.device_loss
    state.lost_team += T * state.team_loss
    state.lost_error += T * state.error_loss
    state.lost_error_delayed += T * seen_loss


@step
def diverged(state):
    """Return the block whose storage grew without bound, −1: none; "not <" counts NaN as such."""
    if not state.v_hd < 1e12:
        return 0
    if not abs(state.v_ch) < 1e12:
        return 1
    return -1 if state.v_e < 1e12 else 2


@step
def log_places(state, places):
    """Log where the robots are."""
    for j in range(state.trust.size):
        copy(state.q[j], places[j])


@njit(error_model="numpy", _nrt=False)
def lead_team(first, stop, setup, state, inputs, log):
    """
    Lead the team, as a kernel of `Simulation`.

    setup: a `TeamSetup`. state: a `TeamState`. inputs: records of INPUT. log: a `TeamLog`.
    """
    n, now = setup.numbers[0], state.now[0]
    robots = setup.robots
    for k in range(first, stop):
        given, sample = inputs[k], log.samples[k]
        past = log.samples[max(k - n.vision, 0)]
        lead, graph = given.lead, given.graph
        leader = robots[lead]
        if n.switching or k == 0:  # the first leader's for ever, if that end fails to switch
            now.head = lead
        matrices = setup.formations[graph]
        if graph != now.graph:
            before = stored_by(setup, now.graph, state)
            now.supply_links += stored_by(setup, graph, state) - before
            now.graph = graph
        drift = setup.drift[k // n.per_decision]
        store_energy(n, state, now)
        performance = look_up_past(n, k, given, past, now)
        share_force(n, robots, lead, state.trust, performance, now)
        receive(n, setup, lead, k, state, now)
        spendable = now.v_h + n.budget - n.reserve
        operator_side(n, robots[now.head].near, spendable, now, state.u_l[k])  # (4.7)
        rest(n, matrices, leader, lead, state, now)
        stiffness = n.force_gain * n.lead_gain * setup.stiffness[graph, lead]
        robot_side(n.filters, leader.far, stiffness, now, state.u_r[k])
        logged, at = k % n.per_row == 0, k // n.per_row
        shown = logged or k == stop - 1
        if logged:
            log_places(state, log.places[at])
        if shown:
            now.v_fs = stored_by(setup, graph, state)
        move(n, matrices, leader, lead, drift, state, now)
        sample.stored, sample.lost = now.v_e, now.error_loss
        copy(now.r_s, sample.sent)
        copy(now.leader, sample.seen)
        if shown:
            now.v_e_delayed = past.stored
            stored = now.v_h + n.budget + now.v_hd + now.v_ch + now.v_fs
            now.v_t = stored + now.v_e_delayed + now.v_filter  # (4.32)
            state.shown[0] = now
            for i in AXES:
                state.shown[0].leader[i] += n.goal[i]
        if logged:
            log.table[at] = state.shown[0]
        if (k + 1) % n.per_decision == 0:
            rate_motion(n, robots, drift, state)
        account_energy(n, past.lost if k >= n.vision else 0.0, now)
        block = diverged(now)
        if block >= 0:
            return k, block
    return stop, -1
