"""Kernels for the moments of weighted returns, backward and forward in time.

Actions are drawn from ``act`` and transitions from ``prob``; a step multiplies the
weight by f = u(s, a) w(s, a, s'). Every X is the second part of a pair (L, X) that a
matrix A carries back by a step:

    L_t = l L_{t+1},   X_t = e L_{t+1} + f (gamma_t X_{t+1} - k_t(s'))
    per decision   l = 1, L = 1,   e = u r(s, a)  or  f r(s, a, s')
    trajectory     l = f, L = W,   e = f r:  X = W G

    means m = E[A m'],   covariances C = E[A C' A^T] + Cov(A m' | s)

(law of total variance: every term is a variance or a positive multiple of one; E X^2 -
(E X)^2 would lose digits).

Per decision under a policy and rewards that do not depend on time, the actions are
merged, which is 6 to 10 times as fast. In state s, transitions to s' by several actions
give X = e + b y: b is the weight and e the reward of action and transition, and y =
gamma X' - k belongs to what follows s'. Over the actions that lead there, of
probability q together, X has the mean z = b_mean y + e_mean and the variance

    (c (y + rho)^2 + the residual of e on b) / q,
    c = q Var b,    rho = Cov(b, e) / Var b;

between the s' it has sum q (z - mean)^2. All are squares. The last one follows from the
differences d to the first entry's z, sum q d^2 - (sum q d)^2, of which at most a share
1 - q cancels: the first has at least half of the largest probability.

States are taken ``N_LANES`` at a time, states with equally many s' together: a strip.
The numbers of an entry stand side by side for the states (lanes) of a strip, so that
its arithmetic is done by vector instructions, with every sum in the order of its state.
Entries are in the order in which actions have them: in grids the entries of a strip
lead mostly to consecutive states and are read as such.
"""

from collections import namedtuple

import numpy as np

from oee_tabular._compiling import njit

N_LANES = 32  # states of a strip, whose numbers stand side by side
N_PARTS = 5  # numbers of an entry: q, b_mean, e_mean, c, rho
# the least q Var b, in squared weights: the squares of what is less have lost digits
MIN_WEIGHT_VARIANCE = 1e-280
# entries that padding may add, as a multiple of all entries, before states are sorted
MAX_PADDING_FACTOR = 1.25

# where each strip's entries begin; where an entry leads, and whether its lanes lead
# side by side; its numbers; probabilities and residuals of the states; the states by
# place, S in the places that stay empty
Strips = namedtuple("Strips", "offsets columns aligned numbers fixed order")


@njit(cache=True, error_model="numpy")
def backward(walk, discounts, offsets, is_trajectory, keep):
    """Compute means and covariances of (L, X), backward in time, action by action.

    m_t = E[A m_{t+1}], C_t = E[A C_{t+1} A^T] + Cov(A m_{t+1} | s).

    Returns (5, S): E L, E X, Var L, Cov(L, X), Var X of the first step, and each step's
    own Cov(A m' | s) if ``keep``: (T, 1, S), of X alone, or for a trajectory (T, 3, S),
    Var L, Cov(L, X), Var X. ``discounts`` (T,) are gamma_t, ``offsets`` (1 or T, S)
    k_t. A trajectory with rewards r(s, a) leaves the last w out: T rewards, T - 1
    transitions.
    """
    indptr, indices, prob, w, act, u, by_transition, rewards, initial, _ = walk
    horizon = len(discounts)
    n_states = len(initial)
    n_actions = act.shape[1] // n_states
    here = np.zeros((5, n_states))
    ahead = np.zeros((5, n_states))
    here[0] = 1.0
    ahead[0] = 1.0
    local = np.empty((horizon if keep else 0, 3 if is_trajectory else 1, n_states))
    # arrays with one row hold for every step
    for t in range(horizon - 1, -1, -1):
        t_act = t if len(act) > 1 else 0
        t_reward = t if len(rewards) > 1 else 0
        gamma = discounts[t]
        offset = offsets[t if len(offsets) > 1 else 0]
        omit_w = is_trajectory and not by_transition and t == horizon - 1
        for s in range(n_states):
            mean_l = 0.0
            mean_x = 0.0
            var_l = 0.0
            cov = 0.0
            var_x = 0.0
            own_l = 0.0
            own_cov = 0.0
            own_x = 0.0
            length = 0.0
            # first means and E[A C A^T], then the spread around these means
            for is_spread in range(2):
                for row in range(s * n_actions, (s + 1) * n_actions):
                    share = act[t_act, row]
                    factor = u[t_act, row]
                    if share == 0.0:
                        continue
                    reward = 0.0 if by_transition else rewards[t_reward, row]
                    for k in range(indptr[row], indptr[row + 1]):
                        j = indices[k]
                        chance = share * prob[k]
                        f = factor if omit_w else factor * w[k]
                        if by_transition:
                            reward = rewards[t_reward, k]
                        if is_trajectory:
                            length = f * ahead[0, j]
                            x = f * (reward * ahead[0, j] + gamma * ahead[1, j])
                        else:
                            x = (f if by_transition else factor) * reward + f * (
                                gamma * ahead[1, j] - offset[j]
                            )
                        if is_spread:
                            own_x += chance * (x - mean_x) * (x - mean_x)
                            if is_trajectory:
                                own_l += chance * (length - mean_l) * (length - mean_l)
                                own_cov += chance * (length - mean_l) * (x - mean_x)
                            continue
                        mean_x += chance * x
                        square = chance * f * f
                        var_x += square * gamma * gamma * ahead[4, j]
                        if is_trajectory:
                            mean_l += chance * length
                            var_l += square * ahead[2, j]
                            cov += square * (reward * ahead[2, j] + gamma * ahead[3, j])
                            var_x += (
                                square
                                * reward
                                * (reward * ahead[2, j] + 2.0 * gamma * ahead[3, j])
                            )
            here[1, s] = mean_x
            here[4, s] = var_x + own_x
            if is_trajectory:
                here[0, s] = mean_l
                here[2, s] = var_l + own_l
                here[3, s] = cov + own_cov
            if keep:
                local[t, -1, s] = own_x
                if is_trajectory:
                    local[t, 0, s] = own_l
                    local[t, 1, s] = own_cov
        here, ahead = ahead, here
    return ahead, local


@njit(cache=True, error_model="numpy")
def forward(walk, horizon, power, with_returns):
    """Compute E[W^p G^i 1{s_t = s}], p = ``power``, forward in time.

    W_{t+1} = W_t f, G_{t+1} = G_t + gamma^t r_t: W has the factors and G the discounted
    rewards of the steps before t. Returns (T + 1, 3, S) for i = 0, 1, 2, or (T + 1, 1,
    S) for i = 0 alone without ``with_returns``.
    """
    indptr, indices, prob, w, act, u, by_transition, rewards, initial, gamma = walk
    n_states = len(initial)
    out = np.zeros((horizon + 1, 3 if with_returns else 1, n_states))
    n_actions = act.shape[1] // n_states
    out[0, 0] = initial
    discount = 1.0
    # each step adds what the entries carry from s to j
    for t in range(horizon):
        t_act = t if len(act) > 1 else 0
        for s in range(n_states):
            if out[t, 0, s] == 0.0:
                continue
            for row in range(s * n_actions, (s + 1) * n_actions):
                share = act[t_act, row]
                if share == 0.0:
                    continue
                for k in range(indptr[row], indptr[row + 1]):
                    j = indices[k]
                    f = u[t_act, row] * w[k]
                    chance = share * prob[k] * (f if power == 1 else f * f)
                    out[t + 1, 0, j] += chance * out[t, 0, s]
                    if with_returns:
                        r = discount * (
                            rewards[0, k] if by_transition else rewards[0, row]
                        )
                        before = out[t, 0, s]
                        before_2 = out[t, 1, s]
                        out[t + 1, 1, j] += chance * (before_2 + r * before)
                        out[t + 1, 2, j] += chance * (
                            out[t, 2, s] + 2.0 * r * before_2 + r * r * before
                        )
        discount *= gamma
    return out


@njit(cache=True, error_model="numpy")
def merge(walk):
    """Merge the transitions of each state by where they lead.

    q = sum pi P, b_mean = sum pi P f / q, e_mean = sum pi P e / q, c = q Var b, rho =
    Cov(b, e) / Var b over the actions that lead to s'. Returns a CSR matrix with
    ``N_PARTS`` numbers an entry, and each state's residual of e on b.
    """
    indptr, indices, prob, w, acts, us, by_transition, rewards, initial, _ = walk
    n_states = len(initial)
    act = acts[0]
    u = us[0]
    n_actions = len(act) // n_states
    filled = np.uint32(0)
    starts = np.zeros(n_states + 1, np.uint32)
    place = np.zeros(n_states, np.uint32)
    columns = np.empty(len(indices), np.uint32)
    numbers = np.zeros((len(indices), N_PARTS))
    residual = np.zeros(n_states)
    for s in range(n_states):
        begin = filled
        # three passes: means, then variances and covariances, then the residual
        for turn in range(3):
            for row in range(s * n_actions, (s + 1) * n_actions):
                for k in range(indptr[row], indptr[row + 1]):
                    q = act[row] * prob[k]
                    b = u[row] * w[k]
                    j = indices[k]
                    if q == 0.0:
                        continue
                    e = b * rewards[0, k] if by_transition else u[row] * rewards[0, row]
                    at = place[j]
                    if turn == 0:
                        if not (begin <= at and at < filled and columns[at] == j):
                            at = filled
                            place[j] = filled
                            columns[filled] = j
                            filled += np.uint32(1)
                        numbers[at, 0] += q
                        numbers[at, 1] += q * b
                        numbers[at, 2] += q * e
                        continue
                    b -= numbers[at, 1]
                    e -= numbers[at, 2]
                    if turn == 1:
                        numbers[at, 3] += q * b * b
                        numbers[at, 4] += q * b * e
                    else:
                        residual[s] += q * (e - numbers[at, 4] * b) ** 2
            for at in range(begin, filled):
                if turn == 0:
                    numbers[at, 1] /= numbers[at, 0]
                    numbers[at, 2] /= numbers[at, 0]
                elif turn == 1 and numbers[at, 3] > MIN_WEIGHT_VARIANCE:
                    numbers[at, 4] /= numbers[at, 3]
                elif turn == 1:  # b does not vary: all of e is residual
                    numbers[at, 3] = numbers[at, 4] = 0.0
        starts[s + 1] = filled
    return starts, columns[:filled], numbers[:filled], residual


@njit(cache=True)
def strip_offsets(lengths, order):
    """Compute where each strip's entries begin.

    A strip has as many entries as the longest of its states.
    """
    offsets = np.zeros((len(order) + N_LANES - 1) // N_LANES + 1, np.int64)
    for strip in range(len(offsets) - 1):
        offsets[strip + 1] = (
            offsets[strip]
            + lengths[order[strip * N_LANES : (strip + 1) * N_LANES]].max()
        )
    return offsets


@njit(cache=True)
def lay_strips(starts, columns, numbers, residual):
    """Lay merged transitions out as ``Strips``.

    The first entry of each state has at least half of its largest probability.
    """
    n_states = len(residual)
    n_filled = len(columns)
    lengths = np.diff(starts.astype(np.int64))
    states = np.arange(n_states)
    offsets = strip_offsets(lengths, states)
    # where that pads too much, states of one length go together
    if offsets[-1] * N_LANES > MAX_PADDING_FACTOR * n_filled:
        states = np.argsort(lengths, kind="mergesort")
        offsets = strip_offsets(lengths, states)
    size = (len(offsets) - 1) * N_LANES
    lane_of = np.zeros(n_states, np.uint32)
    order = np.full(size, n_states, np.int64)
    order[:n_states] = states
    lane_of[states] = np.arange(n_states)
    to = np.full(offsets[-1] * N_LANES, size, np.uint32)
    laid = np.zeros(offsets[-1] * N_LANES * N_PARTS)
    fixed = np.zeros(2 * size)
    # the entries of state s in its lane, one of large probability in front
    for i in range(n_states):
        s = states[i]
        first = offsets[i // N_LANES]
        lane = i % N_LANES
        begin = np.int64(starts[s])
        end = np.int64(starts[s + 1])
        both = (i - lane) * 2 + lane
        fixed[both + N_LANES] = residual[s]
        largest = begin
        for entry in range(begin, end):
            fixed[both] += numbers[entry, 0]
            if numbers[entry, 0] > 2.0 * numbers[largest, 0]:
                largest = entry
        for entry in range(begin, end):
            # the first entry and the largest change places
            source = entry
            if entry == largest:
                source = begin
            elif entry == begin:
                source = largest
            at = first + entry - begin
            to[at * N_LANES + lane] = lane_of[columns[source]]
            for part in range(N_PARTS):
                laid[(at * N_PARTS + part) * N_LANES + lane] = numbers[source, part]
    # whether an entry leads from all lanes to consecutive states
    aligned = np.ones(offsets[-1], np.bool_)
    for entry in range(len(aligned)):
        for lane in range(1, N_LANES):
            aligned[entry] &= to[entry * N_LANES + lane] == to[
                entry * N_LANES
            ] + np.uint32(lane)
    return Strips(offsets, to, aligned, laid, fixed, order)


@njit(cache=True, error_model="numpy")
def step_back(strips, factor, offset, here, there, local, room, lanes):
    """Carry all strips one step back: y, v -> factor X - offset, factor^2 Var X.

    X(s) = sum q (b_mean y + e_mean), Var X(s) = sum (q b_mean^2 + c) v + the state's
    own variance, which ``local`` takes. The last ``N_LANES`` of y and v are room for
    what an entry leads to where that does not stand side by side. ``lanes`` is
    ``N_LANES`` as an argument: a short loop over a number that the compiler knows would
    be unrolled, and then not be made of vector instructions.
    """
    offsets, columns, aligned, numbers, fixed, _ = strips
    (y, v) = here
    (new_y, new_v) = there
    one = np.uint64(N_LANES)
    tail = np.uint64(np.uint32(len(y) - N_LANES))
    two = one * np.uint64(2)
    three = one * np.uint64(3)
    four = one * np.uint64(4)
    for strip in range(len(offsets) - 1):
        for entry in range(offsets[strip], offsets[strip + 1]):
            # j is where y and v of what the lanes lead to begin
            at = np.uint64(entry) * one
            if aligned[entry]:
                j = np.uint64(columns[at])
            else:
                j = tail
                for i in range(one):
                    x = np.uint64(columns[at + i])
                    y[tail + i] = y[x]
                    v[tail + i] = v[x]
            at *= np.uint64(N_PARTS)
            # the first entry's z, from which the others' differences are taken
            if entry == offsets[strip]:
                for i in range(one):
                    b = numbers[at + one + i]
                    off = y[j + i] + numbers[at + four + i]
                    c = numbers[at + three + i]
                    room[i] = b * y[j + i] + numbers[at + two + i]
                    room[one + i] = 0.0
                    room[two + i] = c * off * off
                    room[three + i] = (numbers[at + i] * b * b + c) * v[j + i]
                continue
            # sums of q d, of the squares, and of what v carries
            for i in range(one):
                q = numbers[at + i]
                b = numbers[at + one + i]
                c = numbers[at + three + i]
                off = y[j + i] + numbers[at + four + i]
                d = b * y[j + i] + numbers[at + two + i] - room[i]
                room[one + i] += q * d
                room[two + i] += q * d * d + c * off * off
                room[three + i] += (q * b * b + c) * v[j + i]
        # the means and variances of the strip's states
        at = np.uint64(strip) * one
        both = at * np.uint64(2)
        for i in range(lanes):
            mass = fixed[both + i]
            d = room[one + i]
            own = max(room[two + i] - (2.0 - mass) * d * d + fixed[both + one + i], 0.0)
            room[two + i] = own
            new_y[at + i] = factor * (mass * room[i] + d)
            new_v[at + i] = factor * factor * (own + room[three + i])
        if len(local):
            for i in range(lanes):
                local[at + i] = room[two + i]
        if len(offset):
            for i in range(lanes):
                new_y[at + i] -= offset[at + i]


@njit(cache=True, error_model="numpy")
def backward_merged(strips, discounts, offsets, keep):
    """Compute E X and Var X (N,) of the first step by places, actions merged.

    X_t = sum q (b_mean (gamma_t X_{t+1} - k_t) + e_mean). Returns also each step's own
    variance (T, N) if ``keep``. ``discounts`` (T,) are gamma_t, ``offsets`` (T, N) are
    k_t, or (0, N) where they are 0.
    """
    horizon = len(discounts)
    size = len(strips.order)
    # per lane: z of the first entry; sums of q d, of squares, of what v carries
    room = np.zeros(4 * N_LANES)
    # y and v have a 0 behind the states, which padding reads, and then room
    lanes = np.uint64(len(room) // 4)
    length = size + 1 + N_LANES
    here = (np.zeros(length), np.zeros(length))
    there = (np.zeros(length), np.zeros(length))
    local = np.empty((horizon if keep else 0, size))
    nothing = np.zeros(0)
    if len(offsets):
        here[0][:size] = -offsets[horizon - 1]
    for t in range(horizon - 1, -1, -1):
        factor = discounts[t - 1] if t > 0 else 1.0
        offset = offsets[t - 1] if t > 0 and len(offsets) else nothing
        step_back(
            strips,
            factor,
            offset,
            here,
            there,
            local[t] if keep else nothing,
            room,
            lanes,
        )
        here, there = there, here
    return here[0][:size], here[1][:size], local
