"""Moments of weighted returns per decision for a policy that does not depend on time, with the actions merged.

In state s, the moves to s' by several actions pay X = e + b Y: b the weight and e the pay of the action and move, Y the mean of
what follows s'. Over the actions that lead there, of mass q together, X has the mean z = bm Y + em and the variance

    (c (Y + rho)^2 + the residual of e on b) / q,     c = q Var b, rho = Cov(b, e) / Var b;

between the s' it has sum q (z - total)^2. All are squares. The last is had from the differences d to the first entry's z,
sum q d^2 - (sum q d)^2, of which at most a share 1 - q cancels: the first has at least half of the largest mass.

States are taken LANES at a time, those with equally many s' together, and an entry's numbers stand side by side for such a
strip: so its arithmetic is done by vector instructions, with every sum in the order of its state. Entries are in the order of
their columns: in grids a strip's lead mostly to states that stand side by side too, and are read as such.
"""

from collections import namedtuple

import numpy as np
from numba import njit

LANES = 32  # states of a strip
SMALL = 1e-280
PARTS = 5  # numbers of an entry: q, bm, em, c, rho

# where each strip's entries begin; where an entry leads, and whether its lanes lead side by side; its numbers; masses and
# residuals of the states; the states by place, S in the places that stay empty
Strips = namedtuple("Strips", "offsets columns aligned numbers fixed order")


@njit(cache=True)
def merge_state(s, walk, place, to, numbers, single, entry):
    """Fill ``to`` and ``numbers`` (., PARTS) with the merged entries of s, one of large mass first.

    Returns how many they are, their mass, and the residual variance. ``place`` (S,) is zeros before and after; ``single``
    (., 3) and ``entry`` have room for q, b, e and the merged entry of each one.
    """
    indptr, indices, prob, w, acts, us, by_move, pay, _, _ = walk
    act, u = acts[0], us[0]
    n_actions = len(act) // len(place)
    rows = range(s * n_actions, (s + 1) * n_actions)
    i = 0
    size, count, mass, rest = 0, 0, 0.0, 0.0
    for row in rows:
        if act[row] != 0.0:
            for x in range(indptr[row], indptr[row + 1]):
                j = indices[x]
                if place[j] == 0:
                    place[j] = 1
                    to[size] = j
                    size += 1
    if size <= LANES:
        for i in range(1, size):
            j, k = to[i], i
            while k > 0 and to[k - 1] > j:
                to[k] = to[k - 1]
                k -= 1
            to[k] = j
    for i in range(size):
        place[to[i]] = i
        for part in range(PARTS):
            numbers[i, part] = 0.0
    for row in rows:
        share, f = act[row], u[row]
        if share == 0.0:
            continue
        for x in range(indptr[row], indptr[row + 1]):
            i = np.int64(place[indices[x]])
            q, b = share * prob[x], f * w[x]
            e = b * pay[x] if by_move else f * pay[row]
            numbers[i, 0] += q
            numbers[i, 1] += q * b
            numbers[i, 2] += q * e
            mass += q
            entry[count] = i
            single[count, 0], single[count, 1], single[count, 2] = q, b, e
            count += 1
    largest = 0
    for i in range(size):
        place[to[i]] = 0
        if numbers[i, 0] > 0.0:
            numbers[i, 1] /= numbers[i, 0]
            numbers[i, 2] /= numbers[i, 0]
        if numbers[i, 0] > numbers[largest, 0]:
            largest = i
    for x in range(count):
        i, q, b, e = entry[x], single[x, 0], single[x, 1] - numbers[entry[x], 1], single[x, 2] - numbers[entry[x], 2]
        numbers[i, 3] += q * b * b
        numbers[i, 4] += q * b * e
    for i in range(size):
        if numbers[i, 3] > SMALL:
            numbers[i, 4] /= numbers[i, 3]
        else:  # what is next to nothing has lost its digits: then all of e is residual
            numbers[i, 3] = numbers[i, 4] = 0.0
    for x in range(count):
        i, q, b, e = entry[x], single[x, 0], single[x, 1] - numbers[entry[x], 1], single[x, 2] - numbers[entry[x], 2]
        off = e - numbers[i, 4] * b
        rest += q * off * off
    if numbers[largest, 0] > 2.0 * numbers[0, 0]:
        for part in range(PARTS):
            numbers[0, part], numbers[largest, part] = numbers[largest, part], numbers[0, part]
        to[0], to[largest] = to[largest], to[0]
    return size, mass, rest


@njit(cache=True)
def strip_offsets(length, order, n_states):
    """Where each strip's entries begin: it has as many as the longest of its states."""
    offsets = np.zeros(len(order) // LANES + 1, np.int64)
    for strip in range(len(offsets) - 1):
        longest = 0
        for i in range(strip * LANES, min(n_states, (strip + 1) * LANES)):
            longest = max(longest, length[order[i]])
        offsets[strip + 1] = offsets[strip] + longest
    return offsets


@njit(cache=True, error_model="numpy")
def merge(walk):
    """The ``Strips`` of a walk whose policy does not depend on time."""
    indptr, indices, act, n_states = walk.indptr, walk.indices, walk.act[0], len(walk.initial)
    n_actions = len(act) // n_states
    place = np.zeros(n_states, np.uint32)
    length = np.zeros(n_states + 1, np.int64)
    for s in range(n_states):
        count = 0
        for row in range(s * n_actions, (s + 1) * n_actions):
            if act[row] == 0.0:
                continue
            for x in range(indptr[row], indptr[row + 1]):
                if place[indices[x]] != s + 1:
                    place[indices[x]] = s + 1
                    count += 1
        length[s] = count
    place[:] = 0
    longest = length.max()
    strips = (n_states + LANES - 1) // LANES
    order = np.full(strips * LANES, n_states, np.int64)
    order[:n_states] = np.arange(n_states)
    offsets = strip_offsets(length, order, n_states)
    if offsets[strips] * LANES > 1.25 * length[:n_states].sum():  # too much padding: states of one length go together
        behind = np.zeros(longest + 2, np.int64)
        for s in range(n_states):
            behind[length[s] + 1] += 1
        for size in range(1, longest + 2):
            behind[size] += behind[size - 1]
        for s in range(n_states):
            order[behind[length[s]]] = s
            behind[length[s]] += 1
        offsets = strip_offsets(length, order, n_states)
    lane_of = np.zeros(n_states, np.uint32)
    for i in range(n_states):
        lane_of[order[i]] = i
    columns = np.full(offsets[strips] * LANES, strips * LANES, np.uint32)
    numbers = np.zeros(offsets[strips] * LANES * PARTS)
    fixed = np.zeros(2 * strips * LANES)  # mass and residual
    to, own = np.zeros(longest, np.uint32), np.zeros((longest, PARTS))
    most = 0
    for s in range(n_states):
        most = max(most, np.int64(indptr[(s + 1) * n_actions]) - np.int64(indptr[s * n_actions]))
    single, entry_of = np.zeros((most, 3)), np.zeros(most, np.int64)
    for i in range(n_states):
        s, first, lane = order[i], offsets[i // LANES], i % LANES
        size, mass, rest = merge_state(s, walk, place, to, own, single, entry_of)
        fixed[(i - lane) * 2 + lane], fixed[(i - lane) * 2 + LANES + lane] = mass, rest
        for entry in range(size):
            place_of = np.int64(lane_of[to[entry]])
            columns[(first + entry) * LANES + lane] = place_of
            for part in range(PARTS):
                numbers[((first + entry) * PARTS + part) * LANES + lane] = own[entry, part]
    aligned = np.ones(offsets[strips], np.bool_)
    for entry in range(len(aligned)):
        for lane in range(1, LANES):
            aligned[entry] &= columns[entry * LANES + lane] == columns[entry * LANES] + np.uint32(lane)
    return Strips(offsets, columns, aligned, numbers, fixed, order)


@njit(cache=True, error_model="numpy")
def advance(strips, extras, t, shift_all, gamma, here, there, local, room, lanes):
    """All strips at step t: y, v of what follows -> those of the step before, or mean, variance at t = 0.

    The last LANES of y and v are room for what an entry leads to where that does not stand side by side. ``lanes`` is LANES:
    a short loop over a number known beforehand would be unrolled before it is made of vector instructions, and not be.
    """
    offsets, columns, aligned, numbers, fixed, _ = strips
    shift, scale, _, h, k = extras
    (y, v), (new_y, new_v) = here, there
    one, tail = np.uint64(LANES), np.uint64(np.uint32(len(y) - LANES))
    two, three, four = one * np.uint64(2), one * np.uint64(3), one * np.uint64(4)
    unit = scale[t]
    lowered = shift[t] if shift_all else 0.0
    factor, lower, square = 1.0, 0.0, 1.0  # of the step before
    if t > 0:
        factor, lower, square = gamma / scale[t - 1], 0.0 if shift_all else shift[t - 1], gamma * gamma
    for strip in range(len(offsets) - 1):
        for entry in range(offsets[strip], offsets[strip + 1]):
            at = np.uint64(entry) * one
            if aligned[entry]:
                j = np.uint64(columns[at])
            else:
                j = tail
                for i in range(one):
                    x = np.uint64(columns[at + i])
                    y[tail + i] = y[x]
                    v[tail + i] = v[x]
            at *= np.uint64(PARTS)
            if entry == offsets[strip]:
                for i in range(one):
                    b, off = numbers[at + one + i], y[j + i] + numbers[at + four + i]
                    c = numbers[at + three + i]
                    room[i] = b * y[j + i] + numbers[at + two + i]
                    room[one + i] = 0.0
                    room[two + i] = c * off * off
                    room[three + i] = (numbers[at + i] * b * b + c) * v[j + i]
                continue
            for i in range(one):
                q, b, c = numbers[at + i], numbers[at + one + i], numbers[at + three + i]
                off = y[j + i] + numbers[at + four + i]
                d = b * y[j + i] + numbers[at + two + i] - room[i]
                room[one + i] += q * d
                room[two + i] += q * d * d + c * off * off
                room[three + i] += (q * b * b + c) * v[j + i]
        at = np.uint64(strip) * one
        both = at * np.uint64(2)
        for i in range(lanes):
            weight, d = fixed[both + i], room[one + i]
            own = room[two + i] - (2.0 - weight) * d * d + fixed[both + one + i]
            own = max(own, 0.0) * unit * unit
            room[two + i] = own
            new_y[at + i] = factor * unit * (weight * room[i] + d - weight * lowered) - lower
            new_v[at + i] = square * (own + room[three + i])
        if len(local):
            for i in range(lanes):
                local[t, at + i] = room[two + i]
        if len(h):
            for i in range(lanes):
                new_y[at + i] += factor * (h[t, at + i] - k[t, at + i])


@njit(cache=True, error_model="numpy")
def merged_moments(strips, steps, extras, shift_all, gamma, keep):
    """What ``_moments.per_decision`` gives, by places: mean, variance (N,), the steps' shares (T, N).

    h and k are (T, N), k[0] = 0, or empty where they are 0; ``shift_all``: the shift is of X, not of what b multiplies.
    """
    size = len(strips.order)
    # of what follows, in units of the step's scale: mean and variance; then what padding reads, then room
    long = size + 1 + LANES
    here, there = (np.zeros(long), np.zeros(long)), (np.zeros(long), np.zeros(long))
    local = np.empty((steps if keep else 0, size))
    if not shift_all:
        here[0][:size] = -extras.shift[steps - 1]
    room = np.zeros(4 * LANES)  # z of the first entry; sums of q d, of squares, of what v carries
    lanes = np.uint64(len(room) // 4)
    for t in range(steps - 1, -1, -1):
        advance(strips, extras, t, shift_all, gamma, here, there, local, room, lanes)
        here, there = there, here
    return here[0][:size], here[1][:size], local
