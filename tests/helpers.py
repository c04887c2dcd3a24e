"""What several tests need: random MDPs, dense oracles that share no code with the
package, full enumeration, pages.
"""

import copy
import os
import subprocess
import sys
import time
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy import sparse

from oee_tabular import FiniteMDP, sample_transitions
from oee_tabular.mdp.rows import Rows

# seconds after which a test gives up waiting: it hangs, because no machine is so slow
GIVE_UP_SECONDS = 3600.0


def wait_until(is_done, process=None):
    """Wait until ``is_done()``, or until the process that is to do it has ended."""
    start = time.monotonic()
    while not is_done():
        assert process is None or process.poll() is None, "the process has ended"
        assert time.monotonic() - start < GIVE_UP_SECONDS, "it hangs"
        time.sleep(0.02)


def integer_distribution(rng, size, zeros=0.3):
    """A distribution from small integer weights: exact zeros, never 1e-300s."""
    weights = rng.integers(1, 10, size=size) * (rng.random(size) >= zeros)
    if weights.sum() == 0:
        weights[rng.integers(size)] = 1
    return weights / weights.sum()


def random_mdp(
    rng,
    *,
    n_states=None,
    n_actions=None,
    discount=None,
    form=None,
    zeros=0.3,
    like=None,
):
    """A random MDP with exact zeros; ``form`` of rewards 1 = r(s), 2 = r(s, a), 3 =
    r(s, a, s').

    ``like``: other dynamics for that MDP, inside its support (so that a ratio exists).
    """
    if like is not None:
        dense = like.transitions.toarray()
        rows = []
        for row in dense:
            support = np.flatnonzero(row)
            new = np.zeros(len(row))
            new[support] = integer_distribution(rng, len(support), zeros=0.2)
            rows.append(new)
        return like.with_transitions(
            np.array(rows).reshape(like.n_states, like.n_actions, -1)
        )
    n_states = n_states or int(rng.integers(1, 8))
    n_actions = n_actions or int(rng.integers(1, 4))
    transitions = np.array(
        [
            [integer_distribution(rng, n_states, zeros) for _ in range(n_actions)]
            for _ in range(n_states)
        ]
    )
    form = form or int(rng.integers(1, 4))
    shape = (n_states, n_actions, n_states)[:form]
    rewards = rng.integers(-5, 6, size=shape).astype(float)
    discount = (
        discount if discount is not None else float(rng.choice([0.0, 0.5, 0.9, 0.99]))
    )
    return FiniteMDP(
        transitions, rewards, integer_distribution(rng, n_states), discount
    )


def random_policy(rng, mdp, zeros=0.3):
    return np.array(
        [integer_distribution(rng, mdp.n_actions, zeros) for _ in range(mdp.n_states)]
    )


seeds = st.integers(0, 2**32 - 1)
rngs = seeds.map(np.random.default_rng)


def dense(mdp):
    """(S, A, S) transitions and rewards of the same shape."""
    shape = (mdp.n_states, mdp.n_actions, mdp.n_states)
    transitions = mdp.transitions.toarray().reshape(shape)
    if mdp.transition_rewards is None:
        return transitions, np.broadcast_to(mdp.rewards[:, :, None], shape)
    return transitions, mdp.transition_rewards.toarray().reshape(shape)


class Dense:
    """An MDP as arrays, with numpy alone: P and r (S, A, S'), mu (S,), the discount g."""

    def __init__(self, mdp):
        self.P, self.r = dense(mdp)
        self.mu = np.array(mdp.initial)
        self.g = float(mdp.discount)

    def like(self, transitions):
        """The same but for P."""
        other = copy.copy(self)
        other.P = transitions
        return other

    def chain(self, pi):
        return np.einsum("sa,sat->st", pi, self.P)

    def paid(self, pi):
        return np.einsum("sa,sat,sat->s", pi, self.P, self.r)

    def values(self, pi, horizon=None):
        """V (S,), or of a horizon V with t = horizon, ..., 0 rewards to go (T + 1, S),
        index t the time.
        """
        if horizon is None:
            return np.linalg.solve(
                np.eye(len(self.mu)) - self.g * self.chain(pi), self.paid(pi)
            )
        to_go = [np.zeros(len(self.mu))]
        for _ in range(horizon):
            to_go.append(self.paid(pi) + self.g * self.chain(pi) @ to_go[-1])
        return np.array(to_go[::-1])

    def J(self, pi, horizon=None):
        found = self.values(pi, horizon)
        return float(self.mu @ (found if horizon is None else found[0]))

    def visits(self, pi, horizon=None):
        """(S, A) expected discounted visits, not normalised; over a horizon a list by
        t, discounted.
        """
        if horizon is None:
            return (
                np.linalg.solve(
                    np.eye(len(self.mu)) - self.g * self.chain(pi).T, self.mu
                )[:, None]
                * pi
            )
        found = []
        at = self.mu
        for t in range(horizon):
            found.append(self.g**t * at[:, None] * pi)
            at = at @ self.chain(pi)
        return found

    def slope(self, pi, horizon=None):
        """(S, A, S') dJ / dP(s' | s, a), P taken as free numbers."""
        v = self.values(pi, horizon)
        if horizon is None:
            return self.visits(pi)[:, :, None] * (self.r + self.g * v)
        return sum(
            d[:, :, None] * (self.r + self.g * v[t + 1])
            for t, d in enumerate(self.visits(pi, horizon))
        )


def dense_values(mdp, policy):
    """V = (I - gamma P_pi)^-1 r_pi."""
    return Dense(mdp).values(policy)


def table_of(log, shape):
    """(S, A, S') counts of a log."""
    found = np.zeros((*shape, shape[0]))
    np.add.at(found, (log.state, log.action, log.next_state), 1.0)
    return found


def paths(mdp, policy, horizon):
    """Every path of ``horizon`` moves of positive probability: (probability, [(s, a,
    s', r), ...]).
    """
    transitions, rewards = dense(mdp)
    found = [(float(p), s, []) for s, p in enumerate(mdp.initial) if p > 0]
    for t in range(horizon):
        law = (policy if policy.ndim == 2 else policy[t])[:, :, None] * transitions
        moves = [np.argwhere(rows > 0).tolist() for rows in law]
        found = [
            (p * law[s, a, j], j, [*steps, (s, a, j, rewards[s, a, j])])
            for p, s, steps in found
            for a, j in moves[s]
        ]
    return [(p, steps) for p, _, steps in found]


STATES = ("hall", ("room", 1), "dock")
ACTIONS = ("go", "stay")
ROWS = np.array(
    [
        [[0.25, 0.75, 0.0], [1, 0, 0]],
        [[0.0, 0.5, 0.5], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 1]],
    ]
)
# hall -> room -> dock, where it is over
PLAIN = FiniteMDP(ROWS, [-1.0, -1.0, 0.0], 0, 0.9)
NAMED = PLAIN.with_names(STATES, ACTIONS)


def survival_chain(discount=0.9):
    """Two states: alive (pays 1, dies with probability 0.3) and over. V(alive) = 1 / (1
    - 0.7 gamma).
    """
    transitions = np.array([[[0.7, 0.3]], [[0.0, 1.0]]])
    return FiniteMDP(transitions, np.array([1.0, 0.0]), np.array([1.0, 0.0]), discount)


def run_command(*words):
    """The exit code of ``oee`` with these words."""
    from oee_tabular.cli import main

    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return ended.value.code or 0


def printed(script, **settings):
    """What a script prints in a process of its own, with these of numba's settings."""
    environment = os.environ | {name: str(value) for name, value in settings.items()}
    command = [sys.executable, "-c", script]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout


def rows_of(weights, indptr):
    """``Rows`` of one action with these probabilities; the states that they lead to are
    no matter.
    """
    indptr = np.asarray(indptr, dtype=np.int64)
    entries = np.arange(len(weights))
    return Rows(
        np.arange(len(indptr) - 1),
        entries,
        np.asarray(weights, dtype=float),
        indptr,
        entries,
        len(entries),
        1,
    )


def environments(form, discount=0.7):
    """A simulator and a target near it, three states and two actions, every move
    possible.
    """
    rng = np.random.default_rng(form)
    rows = rng.dirichlet(np.full(3, 4.0), (3, 2))
    rewards = rng.normal(size=(3, 2, 3)[:form])
    simulator = FiniteMDP(rows, rewards, [0.6, 0.4, 0.0], discount)
    return simulator, simulator.with_transitions(
        0.8 * rows + 0.2 * rng.dirichlet(np.ones(3), (3, 2))
    )


POLICY = np.array([[0.3, 0.7], [0.5, 0.5], [0.8, 0.2]])  # for these
BEHAVIOR = np.array([[0.4, 0.6], [0.5, 0.5], [0.6, 0.4]])


def ratio_of(rng, simulator):
    """Any weights on the simulator's entries: rows of zeta * P of any sum, zeros among
    them.
    """
    data = rng.integers(0, 4, simulator.transitions.nnz) / 2.0
    matrix = simulator.transitions
    return sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def tiny(seed, moves=25, left_out=(), form="sa", n_states=3, n_actions=2, discount=0.8):
    """A simulator, a target near nothing, a log of its moves (none of the pairs
    ``left_out``), and a policy.
    """
    rng = np.random.default_rng(seed)
    P = rng.dirichlet(np.full(n_states, 1.5), size=(n_states, n_actions))
    r = rng.normal(size=(n_states, n_actions, n_states)[: len(form)])
    simulator = FiniteMDP(P, r, rng.dirichlet(np.ones(n_states)), discount)
    target = simulator.with_transitions(
        rng.dirichlet(np.full(n_states, 2.0), size=(n_states, n_actions))
    )
    share = np.ones((n_states, n_actions))
    share.reshape(-1)[list(left_out)] = 0.0
    log = sample_transitions(target, share / share.sum(), moves, seed=seed)
    return simulator, target, log, rng.dirichlet(np.ones(n_actions), size=n_states)


VOID = {"meta", "link", "br", "hr", "img", "input"}


class Page(HTMLParser):
    """Tags with their attributes, texts, and whether every tag is closed in its place."""

    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.open = []
        self.words = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]
