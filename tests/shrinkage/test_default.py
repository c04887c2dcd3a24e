"""The default fit by own formulas: the tilt, its strengths, kappa, the rows, the moved
value and its error.
"""

import numpy as np
import pytest
from helpers import Dense, table_of
from numpy.testing import assert_allclose
from scipy import optimize, sparse
from scipy.special import gammaln

import oee_tabular as oee


def grid_case(moves):
    simulator = oee.tasks.gridworld(4, 0.3, discount=0.9)
    target = oee.tasks.gridworld(4, 0.15, discount=0.9)
    policy = oee.tasks.gridworld_policy(4, 0.6)
    share = np.ones((16, 4))
    share[9:12] = 0.0
    return (
        simulator,
        policy,
        oee.sample_transitions(target, share / share.sum(), moves, seed=3),
    )


def random_case(moves):
    rng = np.random.default_rng(8)
    rows = rng.dirichlet(np.full(4, 1.5), size=(8, 2))
    places = np.array(
        [[rng.choice(8, 4, replace=False) for _ in range(2)] for _ in range(8)]
    )
    P = np.zeros((8, 2, 8))
    Q = np.zeros((8, 2, 8))
    pay = rng.normal(size=(8, 2))
    np.put_along_axis(P, places, rows, axis=2)
    simulator = oee.FiniteMDP(P, pay, np.full(8, 1 / 8), 0.9)
    policy = rng.dirichlet([1.0, 1.0], size=8)
    V = Dense(simulator).values(policy)
    Q = P * np.exp(-0.5 * V / V.std())
    target = simulator.with_transitions(Q / Q.sum(axis=2, keepdims=True))
    share = np.ones((8, 2))
    share[5] = 0.0
    return (
        simulator,
        policy,
        oee.sample_transitions(target, share / share.sum(), moves, seed=1),
    )


def moved_case():
    """Against the worst state, two fifths of all moves: no direction of the library."""
    rng = np.random.default_rng(7)
    P = rng.dirichlet(np.full(8, 0.7), size=(8, 1))
    r = rng.normal(size=8)
    simulator = oee.FiniteMDP(P, r, np.full(8, 1 / 8), 0.9)
    Q = 0.6 * P
    Q[:, :, np.argmin(r)] += 0.4
    log = oee.sample_transitions(
        simulator.with_transitions(Q), np.full((8, 1), 1 / 8), 160, seed=4
    )
    return simulator, np.ones((8, 1)), log


CASES = [grid_case(70), grid_case(900), random_case(120), moved_case()]


def dirichlet(counts, model, kappa):
    """ln of the Dirichlet-multinomial probability of one row's sequence of moves,
    Dirichlet(kappa model).
    """
    on = model > 0
    n = counts[on]
    b = kappa * model[on]
    return (
        gammaln(kappa) - gammaln(kappa + n.sum()) + np.sum(gammaln(b + n) - gammaln(b))
    )


def kinds_of(simulator_rows, counts):
    """A label a row: rows with the same probabilities in any order; 0 where fewer than
    5 were visited, or 100 moves made.
    """
    label = [tuple(np.sort(np.round(row[row > 0], 6))) for row in simulator_rows]
    found = np.zeros(len(label), dtype=int)
    for number, key in enumerate(sorted(set(label)), start=1):
        mine = np.array([k == key for k in label])
        if (counts[mine].sum(axis=1) > 0).sum() >= 5 and counts[mine].sum() >= 100:
            found[mine] = number
    return found


def strengths(counts, model, kind):
    """kappa of each row, the best in [1, 1e8] for its kind, and the sum of the kinds'
    evidence.
    """
    kappa = np.empty(len(counts))
    score = 0.0
    for k in np.unique(kind):
        mine = np.flatnonzero((kind == k) & (counts.sum(axis=1) > 0))

        def missing(t, mine=mine):
            return -sum(dirichlet(counts[i], model[i], np.exp(t)) for i in mine)

        grid = np.linspace(0.0, np.log(1e8), 80)
        level = np.array([missing(t) for t in grid])
        best = grid[int(np.argmin(level))]
        found = optimize.minimize_scalar(
            missing,
            bounds=(max(best - 0.3, 0.0), min(best + 0.3, grid[-1])),
            method="bounded",
            options={"xatol": 1e-6},
        )
        at = found.x if found.fun < level.min() else best
        kappa[kind == k] = np.exp(at)
        score = score - min(found.fun, level.min())
    return kappa, score


class Own:
    """The default's prior by dense formulas: every direction as a column of its own,
    scipy's minimiser, MacKay's rule.
    """

    def __init__(self, simulator, policy, log):
        self.mdp = Dense(simulator)
        self.policy = policy
        P = self.mdp.P
        self.shape = P.shape
        self.counts = table_of(log, policy.shape)
        self.seen = (self.counts.sum(axis=2) > 0) & ((P > 0).sum(axis=2) > 1)
        self.rows = P[self.seen]
        self.n = self.counts[self.seen]
        self.action = np.nonzero(self.seen)[1]
        self.kind = kinds_of(
            P.reshape(-1, P.shape[2]), self.counts.reshape(-1, P.shape[2])
        )[self.seen.reshape(-1)]
        places = (
            np.arange(len(P))[:, None] if simulator.layout is None else simulator.layout
        )
        self.places = (places - places.mean(axis=0)) / places.std(axis=0)

    def columns(self):
        """[(group, (S, A, S) values)] of the directions."""
        P = self.mdp.P
        x = self.places
        logs = np.log(np.where(P > 0, P, 1.0))
        pay = self.mdp.r if (self.mdp.r != self.mdp.r[:, :, :1]).any() else 0.0
        ahead = pay + self.mdp.g * self.mdp.values(self.policy)
        drift = np.broadcast_to((x[None] - x[:, None])[:, None], (*P.shape, x.shape[1]))
        found = [
            ("log P", logs),
            ("log P", logs**2),
            ("V", ahead / np.abs(ahead).max() + 0.0 * P),
        ]
        found += [("log P at s", logs * x[:, None, None, i]) for i in range(x.shape[1])]
        found += [("drift", drift[..., i]) for i in range(x.shape[1])]
        pairs = np.ndindex(x.shape[1], x.shape[1])
        found += [("drift at s", drift[..., i] * x[:, None, None, j]) for i, j in pairs]
        keys = np.round(drift, 6)
        kinds = np.unique(keys[self.seen][self.rows > 0], axis=0)
        indicators = [(keys == kind).all(axis=3) for kind in kinds]
        mass = [(P * at)[self.seen].sum() for at in indicators]
        most = np.argsort(-np.round(mass, 12), kind="stable")[:24]
        return found + [("steps", indicators[k] * 1.0) for k in most]

    def features(self):
        """(k, rows, S) centred, of root mean square 1 over the visited rows, and the
        group of each.
        """
        found = []
        groups = []
        for part in range(1 + self.shape[1] if self.shape[1] > 1 else 1):
            for group, column in self.columns():
                phi = np.where(self.rows > 0, column[self.seen], 0.0)
                phi = np.where(
                    self.rows > 0,
                    phi - (self.rows * phi).sum(axis=1, keepdims=True),
                    0.0,
                )
                phi = phi * (1.0 if part == 0 else (self.action == part - 1)[:, None])
                size = np.sqrt((self.rows * phi**2).sum() / len(phi))
                if size > 1e-9:
                    found.append(phi / size)
                    groups.append((group, part > 0))
        return np.array(found), groups

    def fit(self, features, weight, precision, start):
        """theta and f'' by scipy on the risk as it is written."""
        counts = weight[:, None] * self.n

        def tilt(theta):
            raw = self.rows * np.exp(np.tensordot(theta, features, 1))
            return raw / raw.sum(axis=1, keepdims=True), np.log(raw.sum(axis=1))

        def risk(theta):
            linear = np.sum(counts * np.tensordot(theta, features, 1))
            return (
                counts.sum(axis=1) @ tilt(theta)[1]
                - linear
                + 0.5 * precision @ theta**2
            )

        def slope(theta):
            expected = counts.sum(axis=1, keepdims=True) * tilt(theta)[0]
            return (
                np.sum((expected - counts) * features, axis=(1, 2)) + precision * theta
            )

        def bend(theta):
            model = tilt(theta)[0]
            score = features - (model * features).sum(axis=2, keepdims=True)
            return np.einsum(
                "irx,jrx,rx,r->ij", score, score, model, counts.sum(axis=1)
            ) + np.diag(precision)

        theta = optimize.minimize(
            risk,
            start,
            jac=slope,
            hess=bend,
            method="Newton-CG",
            options={"xtol": 1e-10},
        ).x
        return theta, bend(theta), tilt(theta)[0]

    def prior(self):
        """The tilted rows, theta and the strengths by group."""
        every, groups = self.features()
        names = sorted(set(groups))
        group_of = np.array([names.index(group) for group in groups])
        plain = np.array([group[0] != "V" for group in groups])
        theta = np.zeros(len(groups))
        level = np.ones(len(names))
        model = self.rows
        # first what no policy changes
        for rounds, used in ((6, plain), (3, plain), (6, plain | True)):
            kappa = self.coarse_kappa(model)
            n = self.n.sum(axis=1)
            weight = np.minimum((1 + kappa) / (n + kappa), 1.0)
            features = every[used]
            member = group_of[used]
            for _ in range(rounds):
                theta[used], bend, _ = self.fit(
                    features, weight, level[member], theta[used]
                )
                told = 1 - level[member] * np.diag(np.linalg.inv(bend))
                size = np.bincount(member, theta[used] ** 2, len(names))
                new = np.clip(
                    (0.25 + np.bincount(member, told, len(names)))
                    / np.maximum(size, 1e-300),
                    1.0,
                    1e6,
                )
                level[np.unique(member)] = new[np.unique(member)]
            theta[used], _, model = self.fit(
                features, weight, level[member], theta[used]
            )
        return model, dict(zip(names, level, strict=True))

    def coarse_kappa(self, model):
        """The best of two values a decade for each kind, the largest of several that
        are as good.
        """
        kappa = np.empty(len(model))
        for kind in np.unique(self.kind):
            mine = np.flatnonzero(self.kind == kind)
            grid = np.geomspace(1.0, 1e8, 17)
            level = np.array(
                [sum(dirichlet(self.n[i], model[i], k) for i in mine) for k in grid]
            )
            kappa[mine] = grid[
                np.flatnonzero(level >= level.max() - 1e-9 * (1 + abs(level.max())))[-1]
            ]
        return kappa


@pytest.mark.parametrize("case", range(4))
def test_the_prior_by_dense_formulas(case):
    """Strengths to the tolerance of the rounds, rows of the tilt, kappa around them,
    and the posterior mean.
    """
    simulator, policy, log = CASES[case]
    zeta = oee.transition_ratio(log, simulator, values_of=policy)
    own = Own(simulator, policy, log)
    model, level = own.prior()
    for (group, alone), strength in level.items():
        assert_allclose(
            np.log(zeta.details["direction_strengths"][group][int(alone)]),
            np.log(strength),
            atol=0.05,
        )
    kappa, score = strengths(own.n, model, own.kind)
    assert_allclose(zeta.details["strength_score"], score, atol=0.05)
    rows = (zeta.values.toarray().reshape(own.shape) * own.mdp.P)[own.seen]
    n = own.n.sum(axis=1, keepdims=True)
    assert_allclose(
        rows, (own.n + kappa[:, None] * model) / (n + kappa[:, None]), atol=2e-3
    )


def leaves(P):
    """(S, 1): whether some action leaves the state."""
    return np.array([[(P[s, :, s] < 1).any()] for s in range(len(P))])


@pytest.mark.parametrize("horizon", [None, 6])
@pytest.mark.parametrize("case", range(len(CASES)))
def test_the_value_its_error_and_its_interval(case, horizon):
    simulator, policy, log = CASES[case]
    estimate = oee.estimators.OffEnvironment()(
        oee.Problem(simulator, log, horizon=horizon), policy
    )
    zeta = oee.transition_ratio(log, simulator, values_of=policy, horizon=horizon)
    base = Dense(simulator)
    n = table_of(log, policy.shape)
    total = n.sum(axis=2)
    model = base.like(
        (zeta.values.toarray() * simulator.transitions.toarray()).reshape(base.P.shape)
    )
    likeliest = base.like(
        np.where(total[:, :, None] > 0, n / np.maximum(total, 1)[:, :, None], model.P)
    )
    slope = model.slope(policy, horizon)
    value = model.J(policy, horizon)
    first = float((slope * (likeliest.P - model.P)).sum())
    second = likeliest.J(policy, horizon) - value
    variance = (model.P * slope**2).sum(axis=2) - (model.P * slope).sum(axis=2) ** 2
    seen = total > 0
    each = variance[seen] / total[seen]
    within = estimate.diagnostics["standard_error_if_centre_fits"]
    own = np.sqrt(max(each.sum() - within**2, 0.0))
    nearer = np.sign(first) * min(abs(first), abs(second))
    further = np.clip((abs(nearer) / own - 2) / 2, 0, 1)
    change = 0.0 if first * second <= 0 else nearer + further * (second - nearer)
    table = {0.3: 0.55, 1: 0.73, 5: 0.98, 10: 1.12, 30: 1.38, 100: 1.70}
    limit = (
        np.interp(np.log(own**2 / within**2), np.log(list(table)), list(table.values()))
        * own
    )
    moved = max(0.0, 1 - limit / abs(change)) if change else 0.0
    error = np.sqrt(each.sum() + variance[~seen].sum())
    assert_allclose(estimate.value, value + moved * change, rtol=1e-9)
    assert_allclose(estimate.standard_error, error, rtol=1e-7)
    assert_allclose(
        estimate.interval,
        value + moved * change + np.array([-1, 1]) * 1.959963984540054 * error,
        rtol=1e-7,
    )
    told = estimate.diagnostics
    assert_allclose(told["model_value"], value, rtol=1e-9)
    assert_allclose(told["one_step_value"], value + first, rtol=1e-9)
    assert_allclose(told["maximum_likelihood_value"], value + second, rtol=1e-9)
    assert_allclose(
        told["unrecorded_standard_error"],
        np.sqrt(variance[~seen].sum()),
        rtol=1e-7,
        atol=1e-12,
    )
    time = model.visits(policy, horizon)
    time = np.where(leaves(base.P), time if horizon is None else sum(time), 0.0)
    assert_allclose(told["coverage"], time[seen].sum() / time.sum(), rtol=1e-9)
    assert_allclose(
        told["effective_sample_size"],
        time[seen].sum() ** 2 / (time[seen] ** 2 / total[seen]).sum(),
        rtol=1e-9,
    )
    assert moved > 0 or case != 3 or horizon  # or the rule would not be seen here
    assert_allclose(
        [told["moved"], told["one_step_distance"]],
        [moved, abs(change) / own],
        rtol=1e-6,
    )


def test_in_the_limit_rows_without_data_are_the_centre_s_of_the_horizon_asked_for():
    simulator, policy, _ = random_case(10)
    base = Dense(simulator)
    share = np.full((8, 2), 1 / 14)
    share[5] = 0.0
    V = base.values(policy, 2)[0]
    Q = base.P * np.exp(-0.5 * V / V.std())
    Q /= Q.sum(axis=2, keepdims=True)
    counts = sparse.csr_array((1e12 * share[:, :, None] * Q).reshape(16, 8))
    found = {}
    for horizon in (2, None):
        options = {} if horizon is None else {"horizon": horizon}
        zeta = oee.transition_ratio(counts, simulator, values_of=policy, **options)
        rows = np.where(
            share[:, :, None] > 0, Q, zeta.values.toarray().reshape(Q.shape) * base.P
        )
        found[horizon] = base.like(rows).J(policy, 2)
    limit = oee.estimators.OffEnvironment().limit(
        simulator,
        simulator.with_transitions(Q),
        policy,
        data_distribution=share,
        horizon=2,
    )
    assert_allclose(limit, found[2], rtol=1e-9)
    assert abs(found[2] - found[None]) > 1e-5  # or the horizon would not be seen
