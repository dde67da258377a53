"""
The teleoperated team (Fig. 4.1), compiled: O(N) per step in the Laplacian's eigenbasis, O(N²) on a
directed graph.

`run_team` takes one sample after another; a sample is a row of named steps, each on one record of
STATE. All that a run remembers stands in `RunMemory` and STATE, so that a run may pause at any
sample: the graph and the leader change between two calls.

Steps that take arrays do without reference counts (_nrt=False), as in `loop/kernel.py`: counts are
atomic and would take half of the time. They allocate nothing, and their caller keeps the arrays;
`move_directed` allocates, and is the exception.
"""

from typing import NamedTuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.trust import logistic_scale, trust_step
from trustlab.teleoperation.ports import device as haptic, waves
from trustlab.teleoperation.ports.ledger import read_waves
from trustlab.teleoperation.records import columns_of, dot, record

NO_FILTER = 0
TWO_PORT = 1
WAVES = 2
BLOCKS = ("haptic device", "channel", "team")

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
# Looked up or worked out before each end is solved: error as the operator sees it, what the hand
# pulls along (this error, or the way to where a live hand is), added force, waves, force at rest.
ARRIVED = "error aside pushed v_l v_r open_force"
# The operator's end, affine in what is still unknown: r_m = yielded + mobility · push, f_m = offset
# + resistance · r_m.
SIGNALS = "u_l u_r yielded mobility offset resistance channel_force aim"
# The hand's spring [N/m], powers of this sample [W], and what is dissipated in it.
POWERS = (
    "spring seen_power near_power far_power hand_power device_power device_loss team_loss "
    "error_loss"
)
WITHIN = record(vectors=f"{CARRIED} {ARRIVED} {SIGNALS}", numbers=POWERS)
# What both ends read and leave; it begins with the row of the log, so that energies since the start
# stand there alone.
STATE = np.dtype([*LOG.descr, *WITHIN.descr])

# One robot: its end of the channel, and its trust in the operator.
ROBOT = record(numbers="b beta_min beta_max decay gain t_min t_max")


# Device, filters, operator and how delays are read; see `TeamSettings` and `TeamOperator`.
NUMBERS = record(
    numbers=(
        "sample_time mass damping stiffness weight gain cutoff k12 k21 push grip reach drag budget "
        "reserve error_range steepness lead_gain force_gain"
    ),
    counts="read_out filtering vision",
    flags="guarded",
)


class Formation(NamedTuple):
    """
    The robots on their graph, for one step of the midpoint rule: q = (I + hL + h²LᵀL)⁻¹ (q₀ + hLᵀζ₀
    + h g D r_s).

    Robots of speeds S, (4.22) with S before every right side, are such a team as well: in q = √S w,
    ζ = √S z, with √S L √S for L and √S D for D. Undirected graphs are diagonal in the eigenbasis of
    L: `values`, shape (N,); `vectors` and `into`, shape (N, N), for q = vectors · w, w = intoᵀ q;
    and `solve`, shape (N,). A directed graph has no such basis: `laplacian`, `solved` = (I + hL +
    h²LᵀL)⁻¹ and `inner` = h · solved · Lᵀ, shape (N, N), and `felt`, `felt_inner` = √S L times
    these, from which the leader's force at rest is one row; `vectors` is then √S.
    """

    directed: bool
    values: np.ndarray
    vectors: np.ndarray
    into: np.ndarray
    solve: np.ndarray
    laplacian: np.ndarray
    solved: np.ndarray
    inner: np.ndarray
    felt: np.ndarray
    felt_inner: np.ndarray
    stiffness: np.ndarray  # what the team does to a leader's push, shape (N,)


# What a run keeps of each sample: the robot that leads, and the one for which the operator's end of
# the channel is set (the same, unless that end fails to switch); force added to the hand's, where a
# live hand wants the device to be (NaN without one), velocity sent to the leader, and its distance
# to the goal; dissipation and storage of the error system.
SAMPLE = record(vectors="pushed hand sent seen", numbers="lost stored", counts="lead head")


class RunMemory(NamedTuple):
    """
    What a run keeps from sample to sample, K samples and N robots; changed in place.

    samples, shape (K,): records of SAMPLE. delays, arrives, shape (2, K): in samples, and whether
    waves arrive. accounts: `ledger.accounts()`. waves u_l, u_r, shape (K, 3). w, z, shape (3, N):
    the robots' distance to the goal and ζ in the eigenbasis. blown, shape (3, N): velocity [m/s]
    that drives robots beside (4.22), in the eigenbasis. trust, shape (N,): in the operator, (4.2).
    """

    samples: np.ndarray
    delays: np.ndarray
    arrives: np.ndarray
    accounts: np.ndarray
    u_l: np.ndarray
    u_r: np.ndarray
    w: np.ndarray
    z: np.ndarray
    blown: np.ndarray
    trust: np.ndarray


class FilterStep(NamedTuple):
    """
    The filters under the midpoint rule: midpoint = decay · state + gate · input; without filters
    the input itself.
    """

    decay: float
    gate: float
    k12: float
    k21: float
    pole: float  # ω_c T/2


class Rig(NamedTuple):
    """Device and filters as every step of a run takes them."""

    device: haptic.Device
    filters: FilterStep  # at the two ports
    low_pass: FilterStep  # of waves


@njit(error_model="numpy", forceinline=True)
def push_share(budget, power, pull, stir, square, drag):
    """
    Return the greatest share σ ≤ 1 of a push whose power does not exceed `power`.

    The device yields by r = a + y σ p to the push p, drag d at the hand: the hand gives r (σ p − d
    r) = −d a² + σ p a (1 − 2 d y) + σ² y p² (1 − d y), with the sums pull = Σ p a (1 − 2 d y), stir
    = Σ y p² (1 − d y) and square = Σ a². Nothing is pushed while the budget is spent.
    """
    if budget <= 0.0 or power <= 0.0:
        return 0.0
    free = power + drag * square
    if stir + pull <= free:
        return 1.0
    # the root of stir σ² + pull σ = free, in the form that does not cancel
    return min(2.0 * free / (pull + np.sqrt(pull * pull + 4.0 * stir * free)), 1.0)


@njit(error_model="numpy", forceinline=True)
def rig_of(n):
    """Return device and filters under the midpoint rule."""
    device = haptic.held_device(n.mass, n.damping, n.stiffness, n.weight, 0.0, 0.0, n.sample_time)
    pole = 0.5 * n.sample_time * n.cutoff
    low_pass = FilterStep(1.0 / (1.0 + pole), pole / (1.0 + pole), n.k12, n.k21, pole)
    no_filter = FilterStep(0.0, 1.0, 0.0, 0.0, 0.0)
    return Rig(device, low_pass if n.filtering == TWO_PORT else no_filter, low_pass)


@njit(error_model="numpy", forceinline=True, _nrt=False)
def store_energy(n, team, rig, w, z, state):
    """Set the storages at the start of the sample; the leader's port reaches the team g times."""
    state.v_hd = state.v_filter = 0.0
    state.v_fs, state.v_e = storages(team, w, z)
    state.v_fs *= n.force_gain / n.lead_gain  # (4.23)
    state.v_e /= n.lead_gain  # (4.29)
    for i in range(3):
        # (3.9)
        state.v_hd += haptic.device_storage(rig.device, state.device[i], state.device_velocity[i])
        if n.filtering == TWO_PORT:
            velocities = state.near_velocity[i] ** 2 + state.far_velocity[i] ** 2
            forces = state.near_force[i] ** 2 + state.far_force[i] ** 2
            state.v_filter += (n.k21 * velocities + n.k12 * forces) / n.cutoff


@njit(error_model="numpy", forceinline=True)
def look_up_past(n, k, now, past, state):
    """
    Set what the operator sees, the leader of `vision` samples ago and what it was told to do;
    return the operator's performance as the robots judge it.
    """
    in_sight, live = k >= n.vision, not np.isnan(now.hand[0])
    state.spring = n.grip if live else n.push
    for i in range(3):
        state.error[i] = -past.seen[i] if in_sight else 0.0  # r_q − y_h(t − T), (4.26)
        state.aside[i] = now.hand[i] - state.device[i] if live else state.error[i]
        state.pushed[i] = now.pushed[i]
    state.seen_power = dot(past.sent, state.error) if in_sight else 0.0
    if in_sight and n.push > 0.0:
        return max(1.0 - np.sqrt(dot(state.error, state.error)) / n.error_range, 0.0)
    return 0.0


@njit(error_model="numpy", forceinline=True, _nrt=False)
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


@njit(error_model="numpy", forceinline=True, _nrt=False)
def receive(n, m, k, low_pass, state):
    """Set the waves that arrive at both ends, (3.16), filtered where waves are."""
    T, kind = n.sample_time, n.read_out
    books = m.accounts
    v_l, v_r = state.v_l, state.v_r
    read_waves(m.u_l, m.u_r, m.arrives, k, m.delays, n.gain, kind, T, books, v_l, v_r)
    if n.filtering == WAVES:
        filter_wave(low_pass, state.v_r, state.filtered_r)
        filter_wave(low_pass, state.v_l, state.filtered_l)


@njit(error_model="numpy", forceinline=True)
def operator_side(n, rig, end, spendable, state):
    """
    Solve the operator's end of the channel with filter, device and hand, in closed form, and the
    device's velocity.

    `spendable` is what V_h leaves above the reserve [J].
    """
    device, filters = rig.device, rig.filters
    loaded = 1.0 + state.beta * end.b * filters.k12
    set_hand_force(n, rig, end, loaded, spendable, state)
    state.device_power = state.device_loss = state.near_power = 0.0
    for i in range(3):
        state.r_m[i] = state.yielded[i] + state.mobility[i] * state.push * state.aim[i]
        state.f_m[i] = state.offset[i] + state.resistance[i] * state.r_m[i]
        state.f_h[i] = state.push * state.aim[i] - n.drag * state.r_m[i] + state.pushed[i]
        # the filter's far side, (4.16)-(4.17)
        force = state.channel_force[i] + state.beta * end.b * filters.gate / loaded * state.r_m[i]
        velocity = (
            filters.decay * state.near_velocity[i]
            + filters.gate * state.r_m[i]
            - filters.k12 * force
        )
        state.u_l[i] = waves.operator_wave(end, velocity, state.v_l[i])  # (3.22)
        x, v = state.device[i], state.device_velocity[i]
        # (4.6)
        v_middle = haptic.midpoint_velocity(device, x, v, state.f_h[i], state.f_m[i])
        state.middle[i] = v_middle
        state.device_power += state.r_m[i] * (state.f_h[i] - state.f_m[i])
        # (3.10)
        state.device_loss += haptic.device_loss(
            device, x + 0.5 * n.sample_time * v_middle, v_middle
        )
        state.near_power += velocity * force
        state.near_velocity[i] += low_pass_step(filters, state.r_m[i], state.near_velocity[i])
        state.near_force[i] += low_pass_step(filters, force, state.near_force[i])
    state.hand_power = dot(state.r_m, state.f_h)


@njit(error_model="numpy", forceinline=True)
def set_hand_force(n, rig, end, loaded, spendable, state):
    """Set what the hand aims at, how device, filter and channel yield, and the share pushed."""
    device, filters = rig.device, rig.filters
    pushing = state.spring * np.sqrt(dot(state.aside, state.aside))
    stiffness = state.spring * min(1.0, n.reach / pushing) if pushing > 0.0 else 0.0
    admittance = device.lever / device.inertia
    pull = stir = 0.0
    for i in range(3):
        # the channel's force at its port, for the velocity that the filter holds: force = offset +
        # resistance r_m
        velocity = filters.decay * state.near_velocity[i]
        # (3.22), (3.12)
        state.channel_force[i] = (
            state.beta * (end.b * velocity + end.arriving * state.v_l[i]) / loaded
        )
        state.offset[i] = (
            filters.decay * state.near_force[i] + filters.gate * state.channel_force[i]
        )
        state.resistance[i] = filters.k21 + filters.gate * (
            state.beta * end.b * filters.gate / loaded
        )
        under = 1.0 + admittance * (state.resistance[i] + n.drag)
        state.aim[i] = stiffness * state.aside[i]
        state.mobility[i] = admittance / under
        free = haptic.free_output(device, state.device[i], state.device_velocity[i], 0.0)
        state.yielded[i] = (
            free - admittance * state.offset[i] + admittance * state.pushed[i]
        ) / under
        pull += state.aim[i] * state.yielded[i] * (1.0 - 2.0 * n.drag * state.mobility[i])
        stir += state.mobility[i] * state.aim[i] ** 2 * (1.0 - n.drag * state.mobility[i])
    state.push = 1.0
    if n.guarded:
        most = spendable / n.sample_time + state.seen_power
        square = dot(state.yielded, state.yielded)
        state.push = push_share(spendable, most, pull, stir, square, n.drag)  # (4.30)


@njit(error_model="numpy", forceinline=True)
def low_pass_step(filters, u, level):
    """Return by how much a low-pass filter's state changes over a sample."""
    return 2.0 * filters.pole * (u - level) / (1.0 + filters.pole)


@njit(error_model="numpy", forceinline=True)
def robot_side(filters, end, stiffness, state):
    """
    Solve the robots' end of the channel with filter and leader: f_s = open_force + stiffness · r_s.

    Each of the two relations is affine in the velocity at the channel's port, which the wave
    equation then fixes.
    """
    state.far_power = 0.0
    under = 1.0 + filters.k12 * stiffness
    for i in range(3):
        # the leader behind the filter, (4.16)-(4.17): r_s = offset + share · velocity
        offset = (filters.decay * state.far_velocity[i] - filters.k12 * state.open_force[i]) / under
        share = filters.gate / under
        force = filters.decay * state.far_force[i] + filters.gate * (
            state.open_force[i] + stiffness * offset
        )
        resistance = filters.k21 + filters.gate * stiffness * share
        free = end.arriving * state.v_r[i] / end.b
        velocity = (free - force / end.b) / (1.0 + resistance / end.b)  # (3.22), α = 1
        force += resistance * velocity
        state.r_s[i] = offset + share * velocity
        state.f_s[i] = state.open_force[i] + stiffness * state.r_s[i]  # (4.24)
        state.u_r[i] = waves.robot_wave(end, force, state.v_r[i])  # (3.22)
        state.far_power += velocity * force
        state.far_velocity[i] += low_pass_step(filters, velocity, state.far_velocity[i])
        state.far_force[i] += low_pass_step(filters, state.f_s[i], state.far_force[i])


@njit(error_model="numpy", forceinline=True)
def filter_wave(filters, wave, level):
    """Filter a wave in place; `level` is the filter's state."""
    for i in range(3):
        middle = filters.decay * level[i] + filters.gate * wave[i]
        level[i], wave[i] = 2.0 * middle - level[i], middle


@njit(error_model="numpy", forceinline=True, _nrt=False)
def storages(team, w, z):
    """
    Return V_fs and V_e, (4.23) and (4.29); V_fs is a storage on an undirected graph only, elsewhere
    NaN.
    """
    v_fs = v_e = 0.0
    for i in range(3):
        for j in range(w.shape[1]):
            square = w[i, j] ** 2 + z[i, j] ** 2
            v_e += 0.5 * square  # (4.29)
            if not team.directed:
                v_fs += 0.5 * team.values[j] * square  # (4.23)
    return np.nan if team.directed else v_fs, v_e


@njit(error_model="numpy", forceinline=True, _nrt=False)
def force_at_rest(team, lead, h, w, z, i):
    """
    Return the force (4.24) on axis i that the leader would report at the midpoint if it were not
    driven.
    """
    force = 0.0
    for j in range(w.shape[1]):
        if team.directed:
            force += team.felt[lead, j] * w[i, j] + team.felt_inner[lead, j] * z[i, j]
        else:
            value = team.values[j]
            force += team.vectors[lead, j] * value * team.solve[j] * (w[i, j] + h * value * z[i, j])
    return force


@njit(error_model="numpy", forceinline=True, _nrt=False)
def move_undirected(n, team, w, z, blown, state):
    """Step (4.22) in the eigenbasis; set the leader's place at the midpoint, and what is lost."""
    h, lead = 0.5 * n.sample_time, int(state.number)
    state.team_loss = state.error_loss = 0.0
    for i in range(3):
        drive = n.lead_gain * state.r_s[i]
        at = pulled = bent = 0.0
        for j in range(w.shape[1]):
            value = team.values[j]
            # (4.22): q̇ = Lᵀζ − L q + D r_s, ζ̇ = −L q
            driven = team.vectors[lead, j] * drive + blown[i, j]
            q = team.solve[j] * (w[i, j] + h * (value * z[i, j] + driven))
            w[i, j] = 2.0 * q - w[i, j]
            z[i, j] -= 2.0 * h * value * q
            at += team.vectors[lead, j] * q
            pulled += (value * q) ** 2
            bent += value * q * q
        state.leader[i] = at
        state.team_loss += n.force_gain / n.lead_gain * pulled  # (4.25)
        state.error_loss += bent / n.lead_gain  # (4.33)


@njit(error_model="numpy")
def move_directed(n, team, w, z, blown, state):
    """Do the same on a directed graph, where w and z are q and ζ of each robot over √S."""
    h, lead = 0.5 * n.sample_time, int(state.number)
    root = team.vectors[lead, lead]
    state.team_loss = state.error_loss = 0.0
    for i in range(3):
        drive = n.lead_gain * root * state.r_s[i]
        start = w[i] + h * blown[i]
        q = team.solved @ start + team.inner @ z[i] + h * drive * team.solved[:, lead]  # (4.22)
        pulled = team.laplacian @ q
        for j in range(q.size):  # numba would compile an assignment of whole rows for two seconds
            w[i, j] = 2.0 * q[j] - w[i, j]
            z[i, j] -= 2.0 * h * pulled[j]
        state.leader[i] = root * q[lead]
        state.team_loss += n.force_gain / n.lead_gain * np.dot(pulled, pulled)
        state.error_loss += np.dot(q, pulled) / n.lead_gain


@njit(error_model="numpy", forceinline=True, _nrt=False)
def moves_undirected(team, m, w_before, z_before, sample_time, rows):
    """
    Set how robots moved in the last sample, and how (4.22) asks them to, in the eigenbasis: three
    rows each.
    """
    for i in range(3):
        for j in range(m.w.shape[1]):
            middle, inner = 0.5 * (m.w[i, j] + w_before[i, j]), 0.5 * (m.z[i, j] + z_before[i, j])
            rows[i, j] = (m.w[i, j] - w_before[i, j]) / sample_time
            rows[3 + i, j] = team.values[j] * (inner - middle)


@njit(error_model="numpy", forceinline=True)
def account_energy(n, seen_loss, state):
    """Step the device, and book the energy of every port; `seen_loss` is that of the picture."""
    T = n.sample_time
    filter_power = 0.0
    for i in range(3):
        state.device[i] += T * state.middle[i]
        state.device_velocity[i] = 2.0 * state.middle[i] - state.device_velocity[i]
        filter_power += state.r_m[i] * state.f_m[i] - state.r_s[i] * state.f_s[i]
    state.v_h += T * (state.seen_power - state.hand_power)  # (4.30)
    state.v_ch += T * (state.near_power - state.far_power)  # (4.15)
    state.supply_team += T * dot(state.r_s, state.f_s)
    state.supply_error += T * dot(state.r_s, state.leader)
    state.supply_hand += T * state.hand_power
    state.supply_device += T * state.device_power
    state.supply_filter += T * (filter_power - state.near_power + state.far_power)
    state.lost_device += T * state.device_loss
    state.lost_team += T * state.team_loss
    state.lost_error += T * state.error_loss
    state.lost_error_delayed += T * seen_loss


@njit(error_model="numpy", forceinline=True)
def diverged(state):
    """Return the block whose storage grew without bound, −1: none; "not <" counts NaN as such."""
    if not state.v_hd < 1e12:
        return 0
    if not abs(state.v_ch) < 1e12:
        return 1
    return -1 if state.v_e < 1e12 else 2


@njit(error_model="numpy", forceinline=True, _nrt=False)
def solve_ends(n, team, rig, robots, m, k, state):
    """Solve both ends of the channel in sample k, for what has arrived by then."""
    now, past = m.samples[k], m.samples[max(k - n.vision, 0)]
    lead, head = now.lead, robots[now.head]
    store_energy(n, team, rig, m.w, m.z, state)
    performance = look_up_past(n, k, now, past, state)
    share_force(n, robots, lead, m.trust, performance, state)
    receive(n, m, k, rig.low_pass, state)
    near_end = waves.operator_end(head.b, head.beta_min, head.beta_max)  # (4.7)
    operator_side(n, rig, near_end, state.v_h + n.budget - n.reserve, state)
    for i in range(3):
        rest = force_at_rest(team, lead, 0.5 * n.sample_time, m.w, m.z, i)
        state.open_force[i] = n.force_gain * rest
    far_end = waves.robot_end(robots[lead].b, 1.0, 1.0)
    stiffness = n.force_gain * n.lead_gain * team.stiffness[lead]
    robot_side(rig.filters, far_end, stiffness, state)


@njit(error_model="numpy", forceinline=True, _nrt=False)
def log_sample(n, m, k, every, state, row, table):
    """Keep what later samples look up, log, and book; return the block that diverged, −1: none."""
    now, past = m.samples[k], m.samples[max(k - n.vision, 0)]
    now.stored, now.lost = state.v_e, state.error_loss
    for i in range(3):
        m.u_l[k, i], m.u_r[k, i] = state.u_l[i], state.u_r[i]
        now.sent[i], now.seen[i] = state.r_s[i], state.leader[i]
    if k % every == 0:
        state.v_e_delayed = past.stored
        stored = state.v_h + n.budget + state.v_hd + state.v_ch + state.v_fs
        state.v_t = stored + state.v_e_delayed + state.v_filter  # (4.32)
        for i in range(row.size):
            table[k // every, i] = row[i]
    account_energy(n, past.lost if k >= n.vision else 0.0, state)
    return diverged(state)


@njit(error_model="numpy", forceinline=True, _nrt=False)
def record_places(m, at, coordinates):
    """Record where the robots are, in the eigenbasis, in row `at`."""
    for i in range(3):
        for j in range(m.trust.size):
            coordinates[at, i, j] = m.w[i, j]


@njit(error_model="numpy")
def run_team(n, team, robots, memory, first, last, every, states, row, table, coordinates):
    """
    Run the team from sample `first` to before `last`, with a row of `table` and of `coordinates`
    every `every` samples.

    n: a record of NUMBERS. team: a Formation. robots, shape (N,): records of ROBOT. states, shape
    (1,): a record of STATE, of which `row` is the part that is logged. coordinates, shape (rows, 3,
    N): of the distance to the goal. Returns the samples done and the block that diverged (−1:
    none).
    """
    rig, state = rig_of(n), states[0]
    w, z = memory.w, memory.z
    for k in range(first, last):
        solve_ends(n, team, rig, robots, memory, k, state)
        if k % every == 0:
            record_places(memory, k // every, coordinates)
        if team.directed:
            move_directed(n, team, w, z, memory.blown, state)
        else:
            move_undirected(n, team, w, z, memory.blown, state)
        block = log_sample(n, memory, k, every, state, row, table)
        if block >= 0:
            return k + 1, block
    return last, -1
