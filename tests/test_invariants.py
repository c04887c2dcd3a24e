"""The laws of notebooks/statements.md, by number: each has its test, and here are those
that belong to no one module.
"""

import re
from functools import partial
from pathlib import Path

import nbformat
import numpy as np
import pytest
from helpers import dense, random_mdp, random_policy, rngs
from hypothesis import given
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee

TESTS = Path(__file__).parent
PAGES = TESTS.parent / "notebooks"
STATED = (PAGES / "statements.md").read_text()
LAW = re.compile(
    r"^(\d+)\. \*\*(.+?)\.\*\* .+\n"
    r" +Test: \[`([\w/]+\.py)::(\w+)`\]\(\.\./tests/([\w/]+\.py)\)\. Shown: (.+)\.$",
    flags=re.M,
)
LAWS = LAW.findall(STATED)


def places(page):
    """The anchors of a page's or notebook's headings."""
    text = page.read_text()
    if page.suffix == ".ipynb":
        cells = nbformat.reads(text, as_version=4).cells
        text = "\n".join(c.source for c in cells if c.cell_type == "markdown")
    heads = re.findall(r"^##? (.+)$", text, flags=re.M)
    return {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}


def test_every_statement_has_its_test():
    assert [int(number) for number, *_ in LAWS] == list(range(1, 45))
    assert len({name for _, name, *_ in LAWS}) == 44
    for number, _, name, test, link, _ in LAWS:
        assert link == name
        assert re.search(rf"^def {test}\(", (TESTS / name).read_text(), flags=re.M), (
            number
        )


def test_other_tests_that_the_statements_name_exist():
    named = re.findall(r"\[`([\w/]+\.py)(?:::(\w+))?`\]\(\.\./tests/(.+?)\)", STATED)
    assert len(named) > 60
    for name, test, link in named:
        assert link == name
        text = (TESTS / name).read_text()
        assert not test or re.search(rf"^def {test}\(", text, flags=re.M), test


def test_every_statement_is_shown_where_it_says():
    section = STATED.partition("\n## Laws in a few lines\n")[2].partition("\n## ")[0]
    printed = " ".join(re.findall(r"^```text\n(.*?)^```", section, re.S | re.M))
    lines = {
        int(number)
        for start in re.findall(r"(?:^|\n| )(\d+(?:, \d+)*) [a-zA-Z]", printed)
        for number in start.split(", ")
    }
    for number, *_, shown in LAWS:
        links = re.findall(r"\]\(([\w/.]*)(?:#([\w-]+))?\)", shown)
        assert links, number
        for page, anchor in links:
            if not page:
                assert anchor == "laws-in-a-few-lines"
                assert int(number) in lines, number
                continue
            assert (PAGES / page).is_file(), page
            assert not anchor or anchor in places(PAGES / page), (page, anchor)


def pair(rng, **options):
    simulator = random_mdp(rng, discount=0.9, **options)
    return simulator, random_mdp(rng, like=simulator)


@given(rngs)
def test_04_shaping(rng):
    """gamma phi(s') - phi(s) on the move shifts J by -mu_0 phi in any dynamics;
    averaged over P it does not.
    """
    simulator, target = pair(rng)
    policy = random_policy(rng, simulator)
    phi = rng.normal(size=simulator.n_states)
    _, pay = dense(simulator)
    shaped = oee.FiniteMDP(
        dense(simulator)[0],
        pay + 0.9 * phi - phi[:, None, None],
        simulator.initial,
        0.9,
    )
    moved = oee.FiniteMDP(dense(simulator)[0], pay, simulator.initial, 0.9)
    p = target.transitions
    before, after = (
        oee.policy_value(m.with_transitions(p), policy) for m in (moved, shaped)
    )
    assert_allclose(after - before, -simulator.initial @ phi, rtol=1e-8, atol=1e-8)
    # E_P of it, as r(s, a)
    folded = oee.FiniteMDP(dense(simulator)[0], shaped.rewards, simulator.initial, 0.9)
    plain = oee.FiniteMDP(dense(simulator)[0], moved.rewards, simulator.initial, 0.9)
    shift = oee.policy_value(folded.with_transitions(p), policy) - oee.policy_value(
        plain.with_transitions(p), policy
    )
    left = 9 * (
        oee.occupancy(target, policy).reshape(-1) @ ((simulator.transitions - p) @ phi)
    )
    assert_allclose(shift + simulator.initial @ phi, left, rtol=1e-7, atol=1e-8)


@given(rngs)
def test_05_relabelling(rng):
    """States and actions in another order: J, the bound, and the tilt's estimate (the
    default's: ratio/test_prior.py).
    """
    simulator, target = pair(rng, n_states=4, n_actions=2, form=2)
    policy = random_policy(rng, simulator)
    states = rng.permutation(4)
    actions = rng.permutation(2)

    def other(mdp):
        rows = dense(mdp)[0][np.ix_(states, actions, states)]
        return oee.FiniteMDP(
            rows, mdp.rewards[np.ix_(states, actions)], mdp.initial[states], 0.9
        )

    turned = policy[np.ix_(states, actions)]
    assert_allclose(
        oee.policy_value(other(target), turned),
        oee.policy_value(target, policy),
        rtol=1e-9,
        atol=1e-9,
    )
    share = np.full((4, 2), 1 / 8)
    bound = oee.efficiency_bound(target, policy, share)
    assert_allclose(
        oee.efficiency_bound(other(target), turned, share), bound, rtol=1e-7, atol=1e-9
    )
    log = oee.sample_transitions(target, share, 200, seed=int(rng.integers(1 << 30)))
    names = np.argsort(states)
    moves = np.argsort(actions)
    again = oee.Transitions(names[log.state], moves[log.action], names[log.next_state])
    tilt = partial(oee.transition_ratio, prior="tilt")
    estimates = (
        oee.estimators.OffEnvironment(tilt)(oee.Problem(m, each), p).value
        for m, each, p in ((simulator, log, policy), (other(simulator), again, turned))
    )
    one, two = estimates
    assert_allclose(two, one, rtol=1e-6, atol=1e-6)


@given(rngs)
def test_06_a_cloned_state(rng):
    """A state in two copies, entered with .3 and .7 of its probability: J and the
    per-decision moments stay.
    """
    simulator, target = pair(rng, n_states=3, n_actions=2)
    policy = random_policy(rng, simulator)
    parts = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0.3, 0.7]])
    origin = [0, 1, 2, 2]

    def cloned(mdp):
        rows, pay = dense(mdp)
        form = (
            pay[np.ix_(origin, range(2), origin)]
            if mdp.transition_rewards is not None
            else mdp.rewards[origin]
        )
        return oee.FiniteMDP((rows @ parts)[origin], form, mdp.initial @ parts, 0.9)

    wide = policy[origin]
    assert_allclose(
        oee.policy_value(cloned(target), wide),
        oee.policy_value(target, policy),
        rtol=1e-9,
        atol=1e-9,
    )
    if simulator.absorbing().any():
        return  # a clone of an absorbing state is no longer one
    found, again = (
        oee.weighted_return_moments(s, oee.true_ratio(t, s), p, horizon=4)
        for s, t, p in (
            (simulator, target, policy),
            (cloned(simulator), cloned(target), wide),
        )
    )
    assert_allclose(
        (again.mean, again.variance), (found.mean, found.variance), rtol=1e-8, atol=1e-8
    )


@given(rngs)
def test_08_discount_0(rng):
    """J = mu_0 pi r for any zeta, where rewards are r(s, a)."""
    simulator = random_mdp(rng, form=2, discount=0.0)
    policy = random_policy(rng, simulator)
    zeta = sparse.csr_array(simulator.transitions)
    zeta.data = rng.integers(0, 3, size=zeta.nnz) + 0.0
    expected = simulator.initial @ (policy * simulator.rewards).sum(axis=1)
    assert_allclose(
        oee.policy_value(oee.exact.reweight(simulator, zeta), policy),
        expected,
        rtol=1e-12,
        atol=1e-13,
    )


@given(rngs)
def test_09_the_average_reward(rng):
    """(1 - gamma) J tends to the stationary distribution's reward."""
    mdp = random_mdp(rng, n_states=4, zeros=0.0, form=2, discount=1 - 1e-7)
    policy = random_policy(rng, mdp)
    kernel = np.einsum("sa,sat->st", policy, dense(mdp)[0])
    system = np.vstack([kernel.T - np.eye(4), np.ones(4)])
    stationary = np.linalg.lstsq(system, np.append(np.zeros(4), 1.0))[0]
    expected = stationary @ (policy * mdp.rewards).sum(axis=1)
    assert_allclose(oee.policy_value(mdp, policy, normalized=True), expected, atol=1e-4)


@given(rngs)
def test_11_what_the_simulator_cannot_do_is_lost(rng):
    """sum P zeta = 1 - P'(P = 0), and the product's limit is J of the substochastic P'
    1[P > 0].
    """
    simulator = random_mdp(rng, n_states=4, zeros=0.5, form=2, discount=0.9)
    target = random_mdp(
        rng, n_states=4, n_actions=simulator.n_actions, zeros=0.2, form=2
    )
    target = simulator.with_transitions(target.transitions)
    policy = random_policy(rng, simulator)
    p = dense(target)[0]
    q = dense(simulator)[0]
    zeta = np.divide(p, q, out=np.zeros_like(p), where=q > 0)
    model = oee.exact.reweight(simulator, sparse.csr_array(zeta.reshape(-1, 4)))
    assert_allclose(
        model.transitions.toarray().sum(axis=1),
        1 - (p * (q == 0)).sum(axis=2).reshape(-1),
        atol=1e-12,
    )
    value = np.zeros(4)
    for _ in range(5):
        value = (policy * (simulator.rewards + 0.9 * (p * (q > 0)) @ value)).sum(axis=1)
    assert_allclose(
        oee.policy_value(model, policy, horizon=5),
        simulator.initial @ value,
        rtol=1e-10,
        atol=1e-11,
    )
    if (p * (q == 0)).sum() > 0:
        with pytest.raises(
            ValueError, match="target must stay in the simulator's support"
        ):
            oee.true_ratio(target, simulator)


def kl(p, q):
    return float((p[p > 0] * np.log(p[p > 0] / q[p > 0])).sum())


@given(rngs)
def test_15_the_chain_rule_of_divergences(rng):
    """KL(d'(s, a, s') || d(s, a, s')) = KL(d'(s, a) || d(s, a)) + E_d' KL(P' || P)."""
    simulator, target = pair(rng, zeros=0.0)
    policy = random_policy(rng, simulator)
    moves = [
        oee.occupancy(m, policy, of="transition").toarray() for m in (target, simulator)
    ]
    pairs = [m.sum(axis=1) for m in moves]
    rows = [
        kl(p, q)
        for p, q in zip(
            *(m.transitions.toarray() for m in (target, simulator)), strict=True
        )
    ]
    assert_allclose(
        kl(moves[0], moves[1]),
        kl(pairs[0], pairs[1]) + pairs[0] @ rows,
        rtol=1e-8,
        atol=1e-10,
    )


@given(rngs)
def test_16_lumping_and_the_chi_square(rng):
    """Cells taken together are closer; E_q zeta^2 = 1 + chi^2."""
    p = rng.dirichlet(np.ones(6))
    q = rng.dirichlet(np.ones(6))
    together = np.kron(np.eye(3), np.ones(2))
    assert kl(together @ p, together @ q) <= kl(p, q) + 1e-14
    zeta = oee.density_ratio(p, q).ratio
    assert_allclose(q @ zeta**2, 1 + ((p - q) ** 2 / q).sum(), rtol=1e-10)


@given(rngs)
def test_17_three_estimates_of_the_divergence(rng):
    """KL - E_P phi(g/g*) = E_P log g - E_Q g + 1 <= E_P log g - log E_Q g <= KL; equal
    once g is normalised.
    """
    p = rng.dirichlet(np.ones(5))
    q = rng.dirichlet(np.ones(5))
    g = rng.uniform(0.2, 3.0, 5)
    u = g / (p / q)
    dual = p @ np.log(g) - q @ g + 1
    varadhan = p @ np.log(g) - np.log(q @ g)
    assert_allclose(dual, kl(p, q) - p @ (u - 1 - np.log(u)), atol=1e-12)
    assert dual <= varadhan + 1e-13
    assert varadhan <= kl(p, q) + 1e-13
    h = g / (q @ g)
    assert_allclose(p @ np.log(h) - q @ h + 1, varadhan, atol=1e-12)
    assert_allclose(oee.density_ratio(p, q).divergence, kl(p, q), atol=1e-12)
