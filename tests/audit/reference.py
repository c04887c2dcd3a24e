"""What the audit computes with: dense arrays, numpy and scipy. Nothing of the package but the numbers put into it."""

import itertools

import numpy as np
from helpers import dense
from scipy import optimize
from scipy.special import gammaln


class Dense:
    """An MDP as arrays: P and r (S, A, S'), mu (S,), the discount g."""

    def __init__(self, mdp, transitions=None):
        self.P, self.r = dense(mdp)
        self.P = self.P if transitions is None else transitions
        self.mu, self.g = np.array(mdp.initial), float(mdp.discount)

    def like(self, transitions):
        """The same but for P."""
        other = object.__new__(Dense)
        other.P, other.r, other.mu, other.g = transitions, self.r, self.mu, self.g
        return other

    def chain(self, pi):
        return np.einsum("sa,sat->st", pi, self.P)

    def paid(self, pi):
        return np.einsum("sa,sat,sat->s", pi, self.P, self.r)

    def values(self, pi, horizon=None):
        """V (S,), or of a horizon V with t = horizon, ..., 0 rewards to go (T + 1, S), index t the time."""
        if horizon is None:
            return np.linalg.solve(np.eye(len(self.mu)) - self.g * self.chain(pi), self.paid(pi))
        to_go = [np.zeros(len(self.mu))]
        for _ in range(horizon):
            to_go.append(self.paid(pi) + self.g * self.chain(pi) @ to_go[-1])
        return np.array(to_go[::-1])

    def J(self, pi, horizon=None):
        found = self.values(pi, horizon)
        return float(self.mu @ (found if horizon is None else found[0]))

    def visits(self, pi, horizon=None):
        """(S, A) expected discounted visits, not normalised; over a horizon a list by t, discounted."""
        if horizon is None:
            return np.linalg.solve(np.eye(len(self.mu)) - self.g * self.chain(pi).T, self.mu)[:, None] * pi
        found, at = [], self.mu
        for t in range(horizon):
            found.append(self.g**t * at[:, None] * pi)
            at = at @ self.chain(pi)
        return found

    def slope(self, pi, horizon=None):
        """(S, A, S') dJ / dP(s' | s, a), P taken as free numbers."""
        v = self.values(pi, horizon)
        if horizon is None:
            return self.visits(pi)[:, :, None] * (self.r + self.g * v)
        return sum(d[:, :, None] * (self.r + self.g * v[t + 1]) for t, d in enumerate(self.visits(pi, horizon)))


def table_of(log, shape):
    """(S, A, S') counts of a log."""
    found = np.zeros((*shape, shape[0]))
    for s, a, j in zip(log.state, log.action, log.next_state, strict=True):
        found[s, a, j] += 1
    return found


def dirichlet(counts, model, kappa):
    """ln of the Dirichlet-multinomial probability of one row's sequence of moves, Dirichlet(kappa model)."""
    on = model > 0
    n, b = counts[on], kappa * model[on]
    return gammaln(kappa) - gammaln(kappa + n.sum()) + np.sum(gammaln(b + n) - gammaln(b))


def kinds_of(simulator_rows, counts):
    """A label a row: rows with the same probabilities in any order; 0 where fewer than 5 were visited, or 100 moves made."""
    label = [tuple(np.sort(np.round(row[row > 0], 6))) for row in simulator_rows]
    found = np.zeros(len(label), dtype=int)
    for number, key in enumerate(sorted(set(label)), start=1):
        mine = np.array([k == key for k in label])
        if (counts[mine].sum(axis=1) > 0).sum() >= 5 and counts[mine].sum() >= 100:
            found[mine] = number
    return found


def strengths(counts, model, kind):
    """kappa of each row, the best in [1, 1e8] for its kind, and the sum of the kinds' evidence."""
    kappa, score = np.empty(len(counts)), 0.0
    for k in np.unique(kind):
        mine = np.flatnonzero((kind == k) & (counts.sum(axis=1) > 0))

        def missing(t, mine=mine):
            return -sum(dirichlet(counts[i], model[i], np.exp(t)) for i in mine)

        grid = np.linspace(0.0, np.log(1e8), 80)
        level = np.array([missing(t) for t in grid])
        best = grid[int(np.argmin(level))]
        found = optimize.minimize_scalar(
            missing, bounds=(max(best - 0.3, 0.0), min(best + 0.3, grid[-1])), method="bounded", options={"xatol": 1e-6}
        )
        at = found.x if found.fun < level.min() else best
        kappa[kind == k], score = np.exp(at), score - min(found.fun, level.min())
    return kappa, score


def sequences(dense_mdp, pi, steps):
    """(probability, [(s, a, s'), ...]) of every path of ``steps`` moves under pi."""
    n_states, n_actions = pi.shape
    for start in np.flatnonzero(dense_mdp.mu):
        for moves in itertools.product(itertools.product(range(n_actions), range(n_states)), repeat=steps):
            probability, s, path = dense_mdp.mu[start], start, []
            for a, j in moves:
                probability *= pi[s, a] * dense_mdp.P[s, a, j]
                if probability == 0.0:
                    break
                path.append((s, a, j))
                s = j
            else:
                yield probability, path
