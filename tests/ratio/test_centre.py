"""The averaged centre: its weights, its evidence, its limits, its invariances, what it finds, and its standard error."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers import dense, dense_values, random_mdp, random_policy, rngs, rows_of
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio import conditional
from oee_tabular.ratio.prior import centre
from oee_tabular.ratio.prior.centre import fit_centre
from oee_tabular.ratio.prior.library import columns_of, library, values_in
from oee_tabular.ratio.prior.selection import Selection
from oee_tabular.ratio.prior.strength import choose_strength
from oee_tabular.ratio.prior.tilt import fit_default_tilt, minimise
from oee_tabular.ratio.result import Held, Part


def garnet(seed, n_states=20, n_actions=2, successors=5, discount=0.9, layout=None):
    """Rows of Dirichlet probabilities on a few random successors, rewards of states."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((n_states, n_actions, n_states))
    for s in range(n_states):
        for a in range(n_actions):
            rows[s, a, rng.choice(n_states, successors, replace=False)] = rng.dirichlet(np.full(successors, 2.0))
    pay = rng.normal(size=(n_states, n_actions))
    return FiniteMDP(rows, pay, np.full(n_states, 1 / n_states), discount, layout=layout)


def tilted_along(simulator, phi):
    """The target with rows proportional to P exp(phi), phi at the simulator's entries."""
    rows = Rows.of(simulator)
    model, _ = rows.tilt(phi)
    return simulator.with_transitions(
        sparse.csr_array(
            (model, simulator.transitions.indices, simulator.transitions.indptr), simulator.transitions.shape
        )
    )


def worse(simulator, policy, size=0.5):
    """A target in which everything is a little worse along V."""
    level = dense_values(simulator, policy)[simulator.transitions.indices]
    column = Rows.of(simulator).center(level)
    return tilted_along(simulator, -size * column / column.std())


def drawn(target, per_row, seed, *, left_out=()):
    shape = (target.n_states, target.n_actions)
    share = np.ones(shape)
    share.reshape(-1)[list(left_out)] = 0.0
    share /= share.sum()
    return oee.sample_transitions(target, share, int(per_row * np.prod(shape)), seed=seed)


def counts_of(log, simulator):
    rows = np.repeat(np.arange(simulator.transitions.shape[0]), np.diff(simulator.transitions.indptr))
    return log.counts(simulator.n_states, simulator.n_actions).toarray()[rows, simulator.transitions.indices]


def parts_of(log, simulator, policy, *, timed=False):
    counts = counts_of(log, simulator)
    tilt = fit_default_tilt(counts, simulator)
    time = oee.occupancy(simulator, policy).reshape(-1) if timed else None
    return fit_centre(counts, simulator, values_in(simulator, [policy], None), tilt, tilt.evidence, time=time)


CASES = [(seed, per_row, size) for seed in range(2) for per_row, size in ((2.0, 0.0), (5.0, 0.5), (30.0, 0.2))]


@pytest.mark.parametrize(("seed", "per_row", "size"), CASES)
def test_weights_are_tempered_evidence(seed, per_row, size):
    simulator = garnet(seed)
    policy = oee.optimal_policy(simulator)
    log = drawn(worse(simulator, policy, size), per_row, seed)
    parts = parts_of(log, simulator, policy, timed=True)
    weights, evidence = np.array([(part.weight, part.evidence) for part in parts]).T
    assert_allclose(weights.sum(), 1.0, rtol=1e-12)
    raw = np.exp(centre.TEMPER * (evidence - evidence.max()))
    assert_allclose(weights, raw / raw.sum(), rtol=1e-10)
    assert (np.diff(weights) <= 0).all()
    assert weights.min() >= 1e-3
    assert len({part.name for part in parts}) == len(parts)
    for part in parts:
        sums = np.add.reduceat(part.rows, simulator.transitions.indptr[:-1])
        assert_allclose(sums, 1.0, rtol=1e-12)
        assert part.gap < 1e-9
    zeta = oee.transition_ratio(log, simulator, values_of=policy)
    assert [(name, theta) for name, _, theta in zeta.details["centre"]] == [(part.name, part.theta) for part in parts]
    assert_allclose([weight for _, weight, _ in zeta.details["centre"]], weights, rtol=1e-9)


def test_evidence_part_by_part():
    """That of Dirichlet rows around the part, less Laplace's size of its parameters, less the prices, all recomputed."""
    found = set()
    for seed in range(8):
        simulator = garnet(seed, n_states=8)
        policy = random_policy(np.random.default_rng(seed), simulator, zeros=0.0)
        log = drawn(worse(simulator, policy, 0.4), 4.0, seed, left_out=[3, 8])
        counts, matrix = counts_of(log, simulator), simulator.transitions
        n_row = np.add.reduceat(counts, matrix.indptr[:-1])
        told = np.repeat(n_row > 0, np.diff(matrix.indptr))
        rows = Rows.of(simulator).select(n_row > 0)
        missed = 1 - (n_row > 0).mean()
        tilt = fit_default_tilt(counts, simulator)
        for part in parts_of(log, simulator, policy):
            score = choose_strength(counts[told], part.rows[told], rows).score
            if part.name == "simulator":
                cost = 0.0
            elif part.name == "tilt by log P":
                cost = counts @ np.log(tilt.ratio) - tilt.evidence + 1.0 + 4.0 * missed
            elif part.name == "V":
                scores, information = part.at(part.whole)[1], np.asarray(part.information)
                weight = np.repeat(part.counted * n_row, np.diff(matrix.indptr))
                raw = float((weight * part.rows) @ scores[:, 0] ** 2)
                precision = information[0, 0] - raw
                column = rows.center((0.9 * dense_values(simulator, policy))[rows.arrival])
                scale = np.sqrt((rows.weights * column**2).sum() / len(rows))
                level = np.abs(dense_values(simulator, policy)).max()  # the feature is r + gamma V over its largest
                theta = part.theta["V"] * scale / level
                expected = rows.tilt(theta * column / scale)[0]
                assert_allclose(part.rows[told], expected, rtol=1e-8)
                size = 0.5 * (np.log(information[0, 0]) - np.log(precision) + precision * theta**2)
                cost = size + 1.0 + 4.0 * missed
            else:
                continue
            found.add(part.name)
            assert_allclose(part.evidence, score - cost, atol=1e-5)
    assert {"simulator", "tilt by log P", "V"} <= found


def test_prices_are_paid_by_feature():
    """1 nat for log P or V of all actions, 3 for another, 4 for each times the share of rows never visited."""
    simulator = garnet(0)
    policy = oee.optimal_policy(simulator)
    level = dense_values(simulator, policy)[simulator.transitions.indices]
    only = np.repeat(np.arange(40) % 2 == 1, 5)
    target = tilted_along(simulator, 2.0 * only * Rows.of(simulator).center(level) / level.std())
    parts = parts_of(drawn(target, 6.0, 1), simulator, policy)
    several = [part for part in parts if part.theta]
    assert several
    seen = np.mean(drawn(target, 6.0, 1).counts(20, 2).toarray().sum(axis=1) > 0)
    counts = counts_of(drawn(target, 6.0, 1), simulator)
    n_row = np.add.reduceat(counts, simulator.transitions.indptr[:-1])
    told = np.repeat(n_row > 0, 5)
    rows = Rows.of(simulator).select(n_row > 0)
    assert any("action" in name for part in several for name in part.theta)
    for part in several:
        score = choose_strength(counts[told], part.rows[told], rows).score
        scores, information = part.at(part.whole)[1], np.asarray(part.information)
        weight = np.repeat(part.counted * n_row, 5) * part.rows
        penalty = np.diag(information - (scores * weight[:, None]).T @ scores)
        features = library(simulator, values_in(simulator, [policy], None), rows)
        theta = []
        for name, value in part.theta.items():
            own, _, action = name.partition(", action ")
            (feature,) = [f for f in features if f.name == own]
            column = feature.column(rows) * (1.0 if action == "" else np.repeat(rows.action, 5) == int(action))
            theta.append(value * np.sqrt((rows.weights * column**2).sum() / len(rows)))
        size = np.linalg.slogdet(information)[1] - np.log(penalty).sum() + penalty @ np.array(theta) ** 2
        price = sum(1.0 if name in ("log P", "V", "V / sd") else 3.0 for name in part.theta)
        assert_allclose(part.evidence, score - 0.5 * size - price - 4.0 * (1 - seen) * len(theta), atol=1e-4)


def test_rows_never_visited_count_by_the_policy_s_time():
    simulator = garnet(2)
    policy = oee.optimal_policy(simulator)
    log = drawn(worse(simulator, policy, 0.5), 3.0, 2, left_out=[3, 8, 11])
    unseen = counts_of(log, simulator).reshape(-1, 5).sum(axis=1) == 0
    time = oee.occupancy(simulator, policy).reshape(-1)
    by_rows, by_time = ({p.name: p for p in parts_of(log, simulator, policy, timed=timed)} for timed in (False, True))
    paid = by_time["V"].evidence - by_rows["V"].evidence
    assert_allclose(paid, 4.0 * (unseen.mean() - time[unseen].sum()), atol=1e-9)


# ---- limits ------------------------------------------------------------------------------------------------------


def test_a_log_that_tells_nothing_leaves_the_simulator():
    """Moves of rows with a single successor only."""
    rows = np.zeros((3, 2, 3))
    rows[0, 0], rows[0, 1], rows[1], rows[2] = [0.2, 0.5, 0.3], [0, 0, 1], [0.6, 0.1, 0.3], [0, 0, 1]
    simulator = FiniteMDP(rows, np.array([1.0, 2.0, 0.0]), [1, 0, 0], 0.9)
    log = oee.Transitions([0, 2], [1, 0], [2, 2])
    policy = np.full((3, 2), 0.5)
    zeta = oee.transition_ratio(log, simulator, values_of=policy)
    assert zeta.details["centre"] == [("simulator", 1.0, {})]
    assert_allclose(zeta.values.data, 1.0, rtol=1e-14)
    value = oee.estimators.OffEnvironment()(oee.Problem(simulator, log), policy).value
    assert_allclose(value, oee.policy_value(simulator, policy), rtol=1e-12)


def test_one_move_changes_little():
    simulator = garnet(1)
    policy = oee.optimal_policy(simulator)
    log = drawn(simulator, 1.0 / 40, 0)
    assert len(log) == 1
    value = oee.estimators.OffEnvironment()(oee.Problem(simulator, log), policy).value
    J = oee.policy_value(simulator, policy)
    assert abs(value - J) < 0.05 * abs(J)


def test_identical_environments_keep_the_simulator_s_value():
    errors = []
    for seed in range(6):
        simulator = garnet(seed)
        policy = oee.optimal_policy(simulator)
        problem = oee.Problem(simulator, drawn(simulator, 30.0, seed))
        found = oee.estimators.OffEnvironment()(problem, policy)
        J = oee.policy_value(simulator, policy)
        errors.append((found.value - J, found.diagnostics["maximum_likelihood_value"] - J))
    ours, likelihood = np.sqrt(np.mean(np.square(errors), axis=0))
    assert ours < 0.5 * likelihood


def test_everywhere_visited_and_without_end_it_is_the_target():
    simulator = garnet(2)
    policy = oee.optimal_policy(simulator)
    target = worse(simulator, policy, 0.7)
    zeta = oee.transition_ratio(1e9 * target.transitions, simulator, values_of=policy)
    truth = oee.true_ratio(target, simulator)
    assert_allclose(zeta.values.data, truth.values.data, rtol=1e-5)


@pytest.mark.parametrize("size", [1e-6, 1e9, 1e15, 8e15])
def test_counts_of_any_size(size):
    """Up to 2^53, the most that is taken; where the tilt's evidence is lost to rounding it is left out."""
    rows = np.array([[9, 2], [4, 3], [1, 0], [0, 1], [7, 2], [0, 1]], dtype=float)
    rows /= rows.sum(axis=1, keepdims=True)
    simulator = FiniteMDP(rows.reshape(2, 3, 2), [1.0, 0.0], [1.0, 0.0], 0.5)
    target = np.array([[0.6, 0.4], [0, 1], [1, 0], [0, 1], [0, 1], [0, 1.0]])
    zeta = oee.transition_ratio(size * sparse.csr_array(target), simulator, values_of=np.full((2, 3), 1 / 3))
    assert np.isfinite(zeta.values.data).all()
    assert zeta.row_sum_error < 1e-9
    if size > 1e6:
        assert_allclose(zeta.target_model(simulator).transitions.toarray(), target, atol=1e-6)


# ---- what does not matter ----------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(rngs, st.sampled_from([1, 30, 3000]))
def test_rows_of_zeta_p_are_distributions(rng, n):
    simulator = random_mdp(rng, discount=0.9)
    target = random_mdp(rng, like=simulator)
    share = np.full((target.n_states, target.n_actions), 1 / (target.n_states * target.n_actions))
    log = oee.sample_transitions(target, share, n, seed=int(rng.integers(1 << 30)))
    policies = [random_policy(rng, simulator) for _ in range(2)]
    zeta = oee.transition_ratio(log, simulator, values_of=policies)
    assert zeta.row_sum_error < 1e-12
    assert (zeta.values.data >= 0).all()
    assert_allclose(sum(weight for _, weight, _ in zeta.details["centre"]), 1.0, rtol=1e-12)


def renamed(mdp, states, actions):
    """State ``states[k]`` and action ``actions[b]`` become k and b; places go along."""
    rows = dense(mdp)[0][np.ix_(states, actions, states)]
    return FiniteMDP(
        rows, mdp.rewards[np.ix_(states, actions)], mdp.initial[states], mdp.discount, layout=mdp.layout[states]
    )


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.sampled_from([2.0, 20.0]))
def test_names_of_states_and_actions_do_not_matter_where_places_are_given(seed, per_row):
    """Without a layout displacements are differences of the names. Rows of random probabilities: no eigenvalue is multiple, no
    two features gain the same; else the basis of an eigenspace, and the first of two equal features, depend on names."""
    rng = np.random.default_rng(seed)
    simulator = garnet(seed, n_states=12, layout=rng.integers(0, 3, (12, 2)).astype(float))
    policy = random_policy(rng, simulator, zeros=0.0)
    log = drawn(worse(simulator, policy), per_row, seed)
    states, actions = rng.permutation(12), rng.permutation(2)
    names, moves = np.argsort(states), np.argsort(actions)
    again = oee.Transitions(names[log.state], moves[log.action], names[log.next_state])
    turned = policy[np.ix_(states, actions)]
    default = oee.estimators.OffEnvironment()
    one = default(oee.Problem(simulator, log), policy)
    two = default(oee.Problem(renamed(simulator, states, actions), again), turned)
    assert_allclose(two.value, one.value, rtol=1e-6)
    assert_allclose(two.standard_error, one.standard_error, rtol=1e-6)


def test_names_matter_where_displacements_are_those_of_the_names():
    simulator = oee.tasks.gridworld(5, 0.3)
    bare = FiniteMDP(simulator.transitions, simulator.rewards, simulator.initial, simulator.discount)
    names = {f.name for f in library(bare, [], Rows.of(bare)) if f.name.startswith("move")}
    assert {"move +5", "move -5", "move +1", "move -1"} <= names
    lying = {f.name for f in library(simulator, [], Rows.of(simulator)) if f.name.startswith("move")}
    assert lying == {"move (0, 0)", "move (0, +1)", "move (+1, 0)", "move (-1, 0)", "move (0, -1)"}


@pytest.mark.parametrize("lying", [True, False])
def test_a_value_depends_on_names_only_without_places(lying):
    """An event that happens more often is found by s' - s; other names of the states hide it."""
    plain, policy = line().with_layout(np.arange(60)), np.full((60, 2), 0.5)
    log = drawn(more_often(plain, 0.4), 20.0, 0)
    states = np.random.default_rng(0).permutation(60)
    names = np.argsort(states)
    again = oee.Transitions(names[log.state], log.action, names[log.next_state])
    values = []
    for mdp, each in ((plain, log), (renamed(plain, states, np.arange(2)), again)):
        mdp = mdp if lying else mdp.with_layout(None)
        fitted = oee.transition_ratio(each, mdp, values_of=policy)
        values.append(oee.policy_value(fitted.target_model(mdp), policy))
    assert (abs(values[1] - values[0]) < 1e-6) == lying


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.sampled_from([1e-3, 1.0, -50.0]), st.sampled_from([0.0, -3.0, 10.0]))
def test_units_of_rewards_do_not_matter(seed, scale, shift):
    """r -> a r + b leaves zeta: a direction is the same as its opposite."""
    simulator = garnet(seed, n_states=10)
    policy = oee.optimal_policy(simulator)
    log = drawn(worse(simulator, policy), 8.0, seed)
    other = simulator.with_rewards(scale * simulator.rewards + shift)
    one, two = (oee.transition_ratio(log, mdp, values_of=policy) for mdp in (simulator, other))
    assert_allclose(two.values.data, one.values.data, rtol=1e-6)


# ---- what it finds -----------------------------------------------------------------------------------------------


def errors_of(pairs, per_row):
    """RMSE of the default and of maximum likelihood, over pairs (simulator, target, policy)."""
    found = []
    for seed, (simulator, target, policy) in enumerate(pairs):
        estimate = oee.estimators.OffEnvironment()(oee.Problem(simulator, drawn(target, per_row, seed)), policy)
        J = oee.policy_value(target, policy)
        found.append((estimate.value - J, estimate.diagnostics["maximum_likelihood_value"] - J))
    return np.sqrt(np.mean(np.square(found), axis=0))


def test_a_target_that_is_a_little_worse_everywhere_is_found():
    pairs = []
    for seed in range(8):
        simulator = garnet(seed, n_states=40, n_actions=3)
        policy = oee.optimal_policy(simulator)
        pairs.append((simulator, worse(simulator, policy), policy))
    for per_row, share in ((3.0, 0.7), (10.0, 0.7)):
        ours, likelihood = errors_of(pairs, per_row)
        assert ours < share * likelihood
    zeta = oee.transition_ratio(drawn(pairs[0][1], 10.0, 0), pairs[0][0], values_of=pairs[0][2])
    name, _, theta = zeta.details["centre"][0]
    assert "V" in name
    assert theta[next(key for key in theta if key.startswith("V"))] < 0


def line(n=60):
    """One more, one less, or the same, with probabilities of each state's own; waiting costs."""
    rng = np.random.default_rng(0)
    rows = np.zeros((n, 2, n))
    for s in range(n):
        for a in range(2):
            stay, more, less = rng.dirichlet([4.0, 8.0, 8.0 + 4.0 * a])
            rows[s, a, s] += stay
            rows[s, a, min(s + 1, n - 1)] += more
            rows[s, a, max(s - 1, 0)] += less
    return FiniteMDP(rows, np.arange(n)[:, None] * [-1.0, -1.0] - [0.0, 0.5], np.eye(n)[5], 0.95)


def more_often(simulator, theta):
    """The target in which s + 1 follows s more often."""
    rows = Rows.of(simulator)
    return tilted_along(simulator, theta * (rows.arrival - rows.spread(rows.state) == 1))


def test_one_displacement_that_is_more_frequent_is_found():
    simulator, policy = line(), np.full((60, 2), 0.5)
    target = more_often(simulator, 0.4)
    ours, likelihood = errors_of([(simulator, target, policy)] * 8, 3.0)
    assert ours < 0.75 * likelihood
    zeta = oee.transition_ratio(drawn(target, 60.0, 0), simulator)
    name, _, theta = zeta.details["centre"][0]
    assert name.startswith("move +1")
    assert_allclose(theta["move +1"], 0.4, atol=0.15)


def test_several_policies_have_a_direction_each():
    simulator = garnet(4, n_states=30)
    good, bad = oee.optimal_policy(simulator), oee.optimal_policy(simulator.with_rewards(-simulator.rewards))
    target = worse(simulator, good, 0.8)
    zeta = oee.transition_ratio(drawn(target, 10.0, 0), simulator, values_of=[bad, good])
    assert any("V of policy 2" in name for name, _, _ in zeta.details["centre"])
    one = oee.transition_ratio(drawn(target, 10.0, 0), simulator, values_of=good)
    listed = oee.transition_ratio(drawn(target, 10.0, 0), simulator, values_of=[good])
    assert_array_equal(one.values.data, listed.values.data)


# ---- the standard error ------------------------------------------------------------------------------------------


def test_the_standard_error_of_an_average_by_refits():
    """The parts' thetas refitted after half a move more or less; weights, precisions and kappas are those of the fit."""
    simulator = garnet(3, n_states=5, successors=3)
    policy = np.full((5, 2), 0.5)
    rng = np.random.default_rng(0)
    rows = Rows.of(simulator)
    features = library(simulator, values_in(simulator, [policy], None), rows)
    base = np.column_stack([f.column(rows) for f in features])
    allowed = np.ones((3, len(features)), dtype=bool)
    counts = rng.multinomial(40, [1 / 30] * 30) * 3.0 + 1.0
    kappa, strength, weights = np.exp(rng.uniform(0, 3, 10)), 7.0, (0.3, 0.5, 0.2)
    chosen = [((0, 0),), ((3, 0), (2, 1))]
    made = Selection(rows, counts, base, allowed)
    fits = [made.fit(each, kappa) for each in chosen]
    n_row = rows.sums(counts)

    def model(observed):
        other = Selection(rows, observed, base, allowed)
        other.count = n_row  # the rows' numbers of moves are given
        found = [rows.weights]
        for each, fitted in zip(chosen, fits, strict=True):
            risk = other._risk(each, kappa, fitted.precision)
            risk.n = made.counted(kappa) * n_row
            found.append(minimise(risk, fitted.theta).model)
        centre_rows = sum(w * m for w, m in zip(weights, found, strict=True))
        return (observed + strength * centre_rows) / rows.spread(n_row + strength)

    gradient = rng.normal(size=30)
    slopes = np.zeros(30)
    for x in range(30):
        step = np.zeros(30)
        step[x] = 0.02
        slopes[x] = gradient @ (model(counts + step) - model(counts - step)) / 0.04
    shares = counts / rows.spread(n_row)
    centred = slopes - rows.spread(rows.sums(shares * slopes))
    expected = np.sqrt(np.sum(n_row * rows.sums(shares * centred**2)))

    parts = [Part("simulator", weights[0], 0.0, Held(rows.weights, None), rows)]
    for each, fitted, weight in zip(chosen, fits, weights[1:], strict=True):
        columns = columns_of(each, lambda j: base[:, j], made.scale, np.repeat(rows.action, 3))
        scores = columns - rows.spread(rows.sums(fitted.model[:, None] * columns))
        parts.append(
            Part("tilt", weight, 0.0, Held(fitted.model, scores), rows, fitted.information, counted=made.counted(kappa))
        )
    plain = oee.transition_ratio(on_rows(counts, simulator), simulator, prior="simulator", strength=strength)
    zeta_p = model(counts)
    influence = replace(
        plain._influence, ratio=zeta_p / rows.weights, curvature=rows.weights**2 / zeta_p, parts=tuple(parts)
    )  # p / zeta^2, p = zeta P
    assert_allclose(influence.standard_error(gradient), expected, rtol=1e-4)


def on_rows(counts, simulator):
    return sparse.csr_array(
        (counts, simulator.transitions.indices, simulator.transitions.indptr), simulator.transitions.shape
    )


@pytest.mark.parametrize("options", [{}, {"prior": "tilt"}, {"prior": "tilt", "smoothness": 3.0}])
def test_a_fit_in_another_process_is_the_same(options):
    """Parts are functions of rows here, arrays there."""
    simulator = garnet(5)
    policy = oee.optimal_policy(simulator)
    about = {} if options else {"values_of": policy}
    zeta = oee.transition_ratio(drawn(worse(simulator, policy), 20.0, 0), simulator, **about, **options)
    assert any(part.information is not None for part in zeta._influence.parts)
    gradient = np.random.default_rng(0).normal(size=simulator.transitions.nnz)
    other = pickle.loads(pickle.dumps(zeta))
    assert other.log_standard_error(gradient) == zeta.log_standard_error(gradient)
    assert other.one_step(gradient) == zeta.one_step(gradient)


def test_the_parts_of_a_fit_count_moves_as_their_tilts_do():
    simulator = garnet(5)
    policy = oee.optimal_policy(simulator)
    log = drawn(worse(simulator, policy), 20.0, 0)
    zeta = oee.transition_ratio(log, simulator, values_of=policy)
    for part in zeta._influence.parts:
        if not part.theta:
            assert part.counted is None
            continue
        n = zeta.counts.reshape(-1)
        assert part.counted.shape == (40,)
        assert ((part.counted > 0) & (part.counted <= 1)).all()
        kappa = (1 - part.counted * n) / np.where(part.counted < 1, part.counted - 1, 1)  # of w = (1 + k) / (n + k)
        assert ((kappa >= 1) | (part.counted == 1)).all()


# ---- bad calls ---------------------------------------------------------------------------------------------------

SIMULATOR = garnet(0, n_states=4, successors=2)
LOG = drawn(SIMULATOR, 3.0, 0)
POLICY = np.full((4, 2), 0.5)
BAD = {
    "a policy of another shape": (
        {"values_of": np.ones((3, 2)) / 2},
        r"^values_of must have shape \(4, 2\) \(states, actions\); it has shape \(3, 2\)$",
    ),
    "one of several": (
        {"values_of": [POLICY, POLICY[:3]]},
        r"^values_of\[1\] must have shape \(4, 2\) .*; it has shape \(3, 2\)$",
    ),
    "rows that do not sum to one": ({"values_of": 2 * POLICY}, r"^values_of\[0\] must sum to 1"),
    "rows of the second": ({"values_of": [POLICY, 2 * POLICY]}, r"^values_of\[1\]\[0\] must sum to 1"),
    "a negative probability": ({"values_of": POLICY - [[1.0, -1.0]]}, r"^values_of\[0, 0\] must be nonnegative"),
    "no policies": ({"values_of": []}, r"^values_of must "),
    "a word": ({"values_of": "policy"}, r"^values_of must "),
    "a horizon of 0": ({"values_of": POLICY, "horizon": 0}, r"^horizon must be a positive integer; it is 0$"),
    "half a horizon": ({"values_of": POLICY, "horizon": 2.5}, r"^horizon must be a positive integer; got 2.5$"),
    "a horizon alone": ({"horizon": 5}, r"^horizon must be left out without values_of: it is that of the values$"),
    "values for the simulator": (
        {"values_of": POLICY, "prior": "simulator"},
        r"^values_of must be left out with prior 'simulator'",
    ),
    "values for the tilt": ({"values_of": POLICY, "prior": "tilt"}, r"^values_of must be left out with prior 'tilt'"),
    "values for features": (
        {"values_of": POLICY, "features": np.ones(16)},
        r"^values_of must be left out with prior 'tilt'",
    ),
    "values for nothing": ({"values_of": POLICY, "prior": "none"}, r"^values_of must be left out with prior 'none'"),
    "values for another method": (
        {"values_of": POLICY, "method": "joint"},
        r"^values_of must not be given with method 'joint'",
    ),
    "a horizon for another method": (
        {"horizon": 5, "method": "linear"},
        r"^horizon must not be given with method 'linear'",
    ),
    "features of the average": (
        {"features": np.ones(16), "prior": "average"},
        r"^features must be left out with prior 'average'",
    ),
    "smoothness of the average": (
        {"smoothness": 1.0, "prior": "average"},
        r"^smoothness must be left out with prior 'average'",
    ),
    "an unknown prior": (
        {"prior": "mean"},
        r"^prior must be one of 'average', 'tilt', 'simulator', 'none'; got 'mean'$",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_calls(name):
    options, text = BAD[name]
    with pytest.raises(ValueError, match=text):
        oee.transition_ratio(LOG, SIMULATOR, **options)


def test_a_cvxpy_solver_gives_the_same_centre():
    simulator = garnet(1, n_states=8, successors=3)
    policy = oee.optimal_policy(simulator)
    log = drawn(worse(simulator, policy, 0.8), 10.0, 0)
    ours, theirs = (
        oee.transition_ratio(log, simulator, values_of=policy, strength=20.0, solver=solver)
        for solver in ("dual", "CLARABEL")
    )
    assert_allclose(theirs.values.data, ours.values.data, atol=1e-4)
    assert [name for name, _, _ in theirs.details["centre"]] == [name for name, _, _ in ours.details["centre"]]
    assert len(ours.details["centre"]) > 1


# ---- the candidates ----------------------------------------------------------------------------------------------


def test_the_same_features_in_another_order_count_once():
    class Log:
        def strength(self, model):
            return choose_strength(np.array([3.0, 1.0]), model, rows_of([0.5, 0.5], [0, 2]))

    rows = np.array([0.6, 0.4])

    def candidate(name, theta, cost):
        return centre._Candidate(name, rows, cost, lambda some: (rows, None), None, theta)

    same = {"V": 1.0, "stay": 2.0}
    found = centre._averaged(
        [
            candidate("simulator", {}, 0.0),
            candidate("tilt by log P", {}, 0.0),
            candidate("V + stay", same, 2.0),
            candidate("stay + V", dict(reversed(same.items())), 2.0),
        ],
        Log(),
        None,
    )
    assert {part.name for part in found} == {"simulator", "tilt by log P", "V + stay"}
    share = np.exp(-0.75 * 2.0) / (2 + np.exp(-0.75 * 2.0))
    assert_allclose([part.weight for part in found if part.theta], share)


def test_what_theory_names_is_always_a_candidate(monkeypatch):
    """Each V alone and beside log P, whatever the search finds."""
    seen = []
    averaged = centre._averaged
    monkeypatch.setattr(
        centre, "_averaged", lambda candidates, *rest: averaged(seen.append(candidates) or candidates, *rest)
    )
    simulator = garnet(7)
    policies = [oee.optimal_policy(simulator), np.full((20, 2), 0.5)]
    log = drawn(simulator, 3.0, 0)
    for values in (policies[0], policies):
        oee.transition_ratio(log, simulator, values_of=values)
    first, second = ([c.name for c in candidates] for candidates in seen)
    assert first[:4] == ["simulator", "tilt by log P", "V", "log P + V"]
    each = [f"{before}V of policy {k}" for k in (1, 2) for before in ("", "log P + ")]
    assert second[:6] == ["simulator", "tilt by log P", *each]


def test_a_cvxpy_solver_is_asked_for_every_tilt_along_features(monkeypatch):
    asked = []
    by_cvxpy = Selection.by_cvxpy
    monkeypatch.setattr(
        Selection,
        "by_cvxpy",
        lambda self, fitted, kappa, solver: (
            asked.append((fitted.chosen, solver)) or by_cvxpy(self, fitted, kappa, solver)
        ),
    )
    simulator = garnet(1, n_states=8, successors=3)
    log = drawn(simulator, 5.0, 0)
    oee.transition_ratio(log, simulator, values_of=oee.optimal_policy(simulator), solver="CLARABEL", strength=5.0)
    assert len(asked) >= 2
    assert {solver for _, solver in asked} == {"CLARABEL"}


def test_the_gap_is_that_of_the_worst_program(monkeypatch):
    rows = Rows.of(SIMULATOR)
    parts = tuple(Part("simulator", 0.5, 0.0, Held(rows.weights, None), rows, gap=gap) for gap in (0.25, 0.125))
    monkeypatch.setattr("oee_tabular.ratio.conditional.fit_centre", lambda *args, **options: parts)
    assert oee.transition_ratio(LOG, SIMULATOR).gap == 0.25


def test_what_no_policy_changes_is_made_once_for_a_problem(monkeypatch):
    simulator = oee.tasks.gridworld(4, 0.2)
    log = oee.sample_episodes(oee.tasks.gridworld(4, 0.4), oee.uniform_policy(simulator), 40, 30, seed=0)
    problem, policies = oee.Problem(simulator, log), [oee.uniform_policy(simulator), oee.tasks.gridworld_expert(4)]
    alone = [oee.estimators.OffEnvironment()(oee.Problem(simulator, log), policy).value for policy in policies]
    calls, whole = [], conditional._tilt
    monkeypatch.setattr(conditional, "_tilt", lambda *given: calls.append(given) or whole(*given))
    assert [oee.estimators.OffEnvironment()(problem, policy).value for policy in policies] == alone
    assert len(calls) == 1
    assert not pickle.loads(pickle.dumps(problem)).made
