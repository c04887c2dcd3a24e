"""The page of the paper: every public function that its arrows name, against it, on
random MDPs.
"""

import functools
import inspect
import re
import subprocess
import sys
import warnings

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import inference, paper

EQUATIONS = {
    f"{section}.{k}"
    for section, last in ((3, 7), (4, 4), (5, 3))
    for k in range(1, last + 1)
}
SOURCE = inspect.getsource(paper)
# Clarabel's own steps go nearly to the boundary of the exponential cones, where its
# line search may stall at a gap of 1e-11 nats: 5e-6 in g. Half steps, small ones in
# that search and sharper linear algebra stay near the central path: below 1e-6.
SHORT_STEPS = {
    "max_step_fraction": 0.5,
    "max_iter": 500,
    "linesearch_backtrack_step": 0.9,
    "min_terminate_step_length": 1e-10,
    "iterative_refinement_reltol": 1e-15,
    "iterative_refinement_abstol": 1e-15,
}


def pair(rng, **options):
    """Simulator, target inside its support and a policy; rewards r(s, a)."""
    simulator = random_mdp(rng, form=2, **options)
    return simulator, random_mdp(rng, like=simulator), random_policy(rng, simulator)


def parts(mdp):
    shape = (mdp.n_states, mdp.n_actions, mdp.n_states)
    return mdp.transitions.toarray().reshape(shape), mdp.rewards, mdp.initial


def tables(rng, size):
    """p and q on ``size`` cells, none of q's below 0.02; p may have zeros."""
    p = rng.integers(0, 6, size=size) + np.eye(size)[0]
    q = rng.integers(1, 8, size=size)
    return p / p.sum(), q / q.sum()


@given(rngs)
def test_values_and_occupancies(rng):
    mdp, _, pi = pair(rng)
    P, r, S_0 = parts(mdp)
    gamma = mdp.discount
    assert_allclose(
        oee.policy_value(mdp, pi), paper.J(P, r, S_0, pi, gamma), rtol=1e-12, atol=1e-12
    )
    assert_allclose(
        oee.occupancy(mdp, pi), paper.d(P, S_0, pi, gamma), rtol=1e-12, atol=1e-12
    )
    moves = oee.occupancy(mdp, pi, of="transition").toarray().reshape(P.shape)
    assert_allclose(moves, paper.d_moves(P, S_0, pi, gamma), rtol=1e-12, atol=1e-12)
    assert_allclose(
        (paper.d(P, S_0, pi, gamma) * r).sum() / (1 - gamma),
        paper.J(P, r, S_0, pi, gamma),
        rtol=1e-9,
        atol=1e-9,
    )
    start = [paper.J(P, r, np.eye(len(P))[s], pi, gamma) for s in range(len(P))]
    assert_allclose(oee.state_values(mdp, pi), start, rtol=1e-12, atol=1e-12)


@given(rngs, st.integers(1, 12))
def test_the_true_ratio_and_the_value_of_its_products(rng, horizon):
    simulator, target, pi = pair(rng)
    P, r, S_0 = parts(simulator)
    zeta = paper.zeta(parts(target)[0], P)
    found = oee.true_ratio(target, simulator)
    assert_allclose(
        found.target_model(simulator).transitions.toarray().reshape(P.shape),
        zeta * P,
        rtol=1e-12,
        atol=1e-15,
    )
    assert_allclose(
        oee.transition_ratio(target.transitions * 1000, simulator, prior="none")
        .values.toarray()
        .reshape(P.shape),
        np.where(P > 0, zeta, 0.0),
        rtol=1e-12,
        atol=1e-12,
    )
    value = paper.J_of_products(zeta, P, r, S_0, pi, simulator.discount, horizon)
    assert_allclose(
        oee.policy_value(target, pi, horizon=horizon), value, rtol=1e-12, atol=1e-12
    )
    for kind in ("per_decision", "trajectory"):
        moments = oee.weighted_return_moments(
            simulator, found, pi, kind=kind, horizon=horizon
        )
        assert_allclose(moments.mean, value, rtol=1e-12, atol=1e-12)


@given(rngs, st.booleans(), st.sampled_from([0.0, 0.2]))
def test_the_convex_program_as_printed(rng, normalized, lam):
    p, q = tables(rng, int(rng.integers(2, 7)))
    nu = 0.1
    mu = float(rng.uniform(1.5, 10.0))
    with warnings.catch_warnings():
        # Clarabel at its limit: "may be inaccurate"
        warnings.simplefilter("ignore", UserWarning)
        printed = paper.beta(
            p, q, nu, mu, lam, normalized, accuracy=1e-14, **SHORT_STEPS
        )
    fit = oee.density_ratio(p, q, lower=nu, upper=mu, ridge=lam, normalized=normalized)
    assert_allclose(fit.objective, paper.risk(fit.ratio, p, q, lam), rtol=1e-12)
    assert_allclose(paper.risk(printed, p, q, lam), fit.objective, atol=1e-9)
    one = (
        (p > 0) | (lam > 0) | (not normalized)
    )  # elsewhere cells share what the others leave as they like, at one risk
    # risks equal to 1e-9 say no more
    assert_allclose(printed[one], fit.ratio[one], rtol=0, atol=1e-4)
    assert_allclose(
        q[~one] @ printed[~one], q[~one] @ fit.ratio[~one], rtol=0, atol=1e-5
    )
    assert (printed >= nu - 1e-5).all()
    assert (printed <= mu + 1e-5).all()


@given(rngs)
def test_the_dual_of_the_divergence(rng):
    p, q = tables(rng, 5)
    fit = oee.density_ratio(p, q, normalized=False)
    assert_allclose(
        fit.divergence, 1 - paper.risk(np.where(p > 0, p / q, 0.0), p, q), atol=1e-12
    )
    assert_allclose(fit.divergence, inference.renyi_divergence(p, q, 1), atol=1e-12)


@given(rngs)
def test_the_quotient_of_two_ratios(rng):
    simulator, target, pi = pair(rng, discount=0.9)
    P, _, S_0 = parts(simulator)
    P_te = parts(target)[0]
    reached = paper.d(P, S_0, pi, 0.9) > 0
    d_te = paper.d_moves(P_te, S_0, pi, 0.9)
    d_tr = paper.d_moves(P, S_0, pi, 0.9)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = paper.zeta_of(d_te / d_tr, d_te.sum(axis=2) / d_tr.sum(axis=2))
    both = reached & (d_te.sum(axis=2) > 0)
    seen = both[:, :, None] & (P > 0)
    assert_allclose(found[seen], paper.zeta(P_te, P)[seen], rtol=1e-9, atol=1e-9)


@given(
    st.integers(1, 10**6),
    st.floats(0.05, 0.95),
    st.floats(1.1, 20.0),
    st.floats(0.0, 3.0),
)
def test_the_three_right_hand_sides(n, nu, mu, divergence):
    assert_allclose(
        inference.estimation_bound(n, mu, nu, 0.95, divergence, 2.0),
        paper.theorem_1(n, nu, mu, 0.05, divergence, 2.0),
    )
    assert_allclose(inference.ratio_error_bound(0.1, mu, nu), paper.lemma(0.1, nu, mu))
    assert_allclose(
        inference.value_error_bound(1 + n % 40, 2.0, 0.9, error=0.1, nu=nu),
        paper.theorem_2(1 + n % 40, 2.0, 0.9, 0.1, nu),
        rtol=1e-9,
    )


def test_policy_importance_sampling_is_equation_3_5():
    rng = np.random.default_rng(0)
    mdp, _, pi = pair(rng, n_states=4, n_actions=2)
    moments = oee.policy_is_moments(mdp, oee.uniform_policy(mdp), pi, horizon=6)
    P, r, S_0 = parts(mdp)
    assert_allclose(
        moments.mean,
        paper.J_of_products(np.ones_like(P), P, r, S_0, pi, mdp.discount, 6),
        rtol=1e-12,
    )


def test_each_equation_heads_one_place_of_a_short_page():
    assert len(SOURCE.splitlines()) <= 240
    heads = re.findall(r'(?:^|""")(?:# )?Eq\. (\d\.\d)', SOURCE, flags=re.MULTILINE)
    heads += re.findall(r"^\s+Eq\. (4\.1)", SOURCE, flags=re.MULTILINE)
    assert sorted(set(heads)) == sorted(EQUATIONS)
    for head in EQUATIONS:
        assert sum(h == head for h in heads) - (head == "4.1") <= 1 or head == "4.1"
    assert "Algorithm 1" in paper.algorithm_1.__doc__


def test_arrows_lead_somewhere():
    for arrow in re.findall(r"-> ([\w.]+)", SOURCE):
        found = oee
        for name in arrow.split("."):
            found = getattr(found, name)
        assert callable(found)


def test_what_arrows_lead_to_says_its_number():
    """The docstring at an arrow's end has the number that heads the function, or the
    sentence, where it begins.
    """
    head = None
    for line in SOURCE.splitlines():
        head = (
            found[1]
            if (
                found := re.search(
                    r"(?:Eq\.|Assumption|Algorithm) (\d\.\d|V\.1|1)", line
                )
            )
            else head
        )
        for arrow in re.findall(r"-> ([\w.]+)", line):
            target = functools.reduce(getattr, arrow.split("."), oee)
            assert head in target.__doc__, (head, arrow)


def test_the_page_needs_numpy_alone():
    code = (
        "import sys, oee_tabular.paper; print([m for m in ('scipy', 'cvxpy', 'numba',"
        " 'pandas') if m in sys.modules])"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "[]"
    )


@pytest.mark.parametrize("lam", [0.0, 0.1])
def test_algorithm_1_comes_near_the_program(lam):
    """Against the exact optimum of 3.7 on the same counts."""
    rng = np.random.default_rng(3)
    shape = (3, 2)
    S = 3
    D_te, D_tr = (
        np.column_stack(
            [
                rng.integers(S, size=400),
                rng.integers(2, size=400),
                rng.integers(S, size=400),
            ]
        )
        for _ in range(2)
    )
    moves, pairs = paper.algorithm_1(
        D_te, D_tr, shape, 0.1, 10.0, lam, eta=0.02, N=200, iterations=6000, seed=1
    )
    for g, width in ((moves, 3), (pairs, 2)):
        p = np.zeros(g.shape)
        q = np.zeros(g.shape)
        for share, D in ((p, D_te), (q, D_tr)):
            np.add.at(share, tuple(D[:, :width].T), 1 / len(D))
        best = oee.density_ratio(
            p.ravel(), q.ravel(), lower=0.1, upper=10.0, ridge=lam, normalized=False
        )
        excess = paper.risk(g.ravel(), p.ravel(), q.ravel(), lam) - best.objective
        assert 0.0 <= excess + 1e-12 < 2e-3
        start = paper.risk(np.ones(g.size), p.ravel(), q.ravel(), lam) - best.objective
        assert excess < 0.2 * start
