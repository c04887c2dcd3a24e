"""Linear systems of a policy: bounds that bound, values right to the last bit, what has no solution."""

from fractions import Fraction

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse
from structures import STRUCTURES, grid, layered, random_rows

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.exact.linear import DivergentKernelError, solve_policy_system
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import policy_rewards


def rational(matrix, b, gamma):
    """(I - gamma K)^-1 b in fractions, by Gauss and Jordan."""
    n, g = len(b), Fraction(gamma)
    rows = [[(i == j) - g * Fraction(matrix[i][j]) for j in range(n)] + [Fraction(b[i])] for i in range(n)]
    for k in range(n):
        pivot = next(i for i in range(k, n) if rows[i][k] != 0)
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(n):
            if i != k and rows[i][k] != 0:
                f = rows[i][k]
                rows[i] = [value - f * other for value, other in zip(rows[i], rows[k], strict=True)]
    return [row[n] for row in rows]


def rational_values(mdp, policy, by_move=False):
    """The exact solution for the numbers as they are stored; ``by_move``: for r(s, a, s'), not for its expectation."""
    p, n = mdp.transitions.toarray(), mdp.n_states
    chance = [[Fraction(x) for x in row] for row in p.tolist()]
    act = [[Fraction(x) for x in row] for row in policy.tolist()]
    pay = [[Fraction(x) for x in row] for row in mdp.rewards.tolist()]
    if by_move and mdp.transition_rewards is not None:
        paid = [[Fraction(x) for x in row] for row in mdp.transition_rewards.toarray().tolist()]
        means = [sum(c * r for c, r in zip(*rows, strict=True)) for rows in zip(chance, paid, strict=True)]
        pay = [means[s * mdp.n_actions : (s + 1) * mdp.n_actions] for s in range(n)]
    actions = range(mdp.n_actions)
    kernel = [[sum(act[s][a] * chance[s * mdp.n_actions + a][t] for a in actions) for t in range(n)] for s in range(n)]
    return rational(kernel, [sum(act[s][a] * pay[s][a] for a in actions) for s in range(n)], mdp.discount)


@pytest.mark.parametrize("power", [530, -530, 1000, -1000])
@pytest.mark.parametrize("certify", [False, True])
def test_the_scale_of_the_right_side_does_not_matter(power, certify):
    """But for what leaves the range of floats: powers of two change no bit."""
    for kernel in (random_rows(900, 3), grid(22), layered(12, 40)):
        kernel = sparse.csr_array(kernel * 0.9)
        b = np.random.default_rng(0).normal(size=kernel.shape[0])
        for transpose in (False, True):
            one, other = (
                solve_policy_system(kernel, right, 0.95, transpose=transpose, certify=certify)
                for right in (b, np.ldexp(b, power))
            )
            assert_array_equal(other.x, np.ldexp(one.x, power))
            assert_allclose(other.error_bound, np.ldexp(one.error_bound, power), rtol=1e-12, atol=1e-320)
    mdp = oee.tasks.gridworld(7, 0.3, discount=0.9)
    far = mdp.with_rewards(np.ldexp(mdp.rewards, power))
    near = mdp.with_rewards(mdp.rewards)
    one, other = (exact.evaluate_policy(m, oee.uniform_policy(mdp), certify=certify) for m in (near, far))
    assert_array_equal(other.values, np.ldexp(one.values, power))
    assert other.value == np.ldexp(one.value, power)
    assert other.certified == one.certified


def test_what_is_too_small_for_pairs_of_floats_is_not_certified():
    """0.94 / (1 - 0.94 g) of rewards around 1e-307 is right to the last bit; subnormal values are not said to be."""
    reward, gamma = 3.707675519592279e-307, 0.9378850624888447
    found = exact.evaluate_policy(FiniteMDP([[[1.0]]], [reward], [1.0], gamma), [[1.0]], certify=True)
    truth = Fraction(reward) / (1 - Fraction(gamma))
    assert abs(Fraction(float(found.values[0])) - truth) <= Fraction(found.error_bound)
    assert found.certified == 0.0 or found.values[0] == float(truth)
    small = exact.evaluate_policy(FiniteMDP([[[1.0]]], [3e-318], [1.0], gamma), [[1.0]], certify=True)
    assert small.certified == 0.0
    assert abs(Fraction(float(small.values[0])) - Fraction(3e-318) / (1 - Fraction(gamma))) <= Fraction(
        small.error_bound
    )


def test_the_certified_bound_of_a_transposed_system_is_of_the_sum():
    d = np.linspace(0.1, 0.9, 100)
    found = solve_policy_system(
        sparse.csr_array(sparse.diags_array(d)), np.ones(100), 0.5, transpose=True, certify=True
    )
    missed = sum(
        abs(Fraction(x) - 1 / (1 - Fraction(v) / 2)) for x, v in zip(found.x.tolist(), d.tolist(), strict=True)
    )
    assert missed <= Fraction(found.error_bound) < 10 * missed


@pytest.mark.parametrize(
    ("kernel", "b", "discount", "words"),
    [
        (np.eye(2), [1, 1], 0.5, "kernel must be a sparse matrix; got ndarray"),
        (sparse.csr_array((2, 3)), [1, 1], 0.5, r"kernel must be square, \(S, S\); it has shape \(2, 3\)"),
        (sparse.csr_array([[0.5, -0.5], [0, 1]]), [1, 1], 0.5, r"nonnegative; kernel\[0, 1\] is -0.5"),
        (sparse.csr_array([[0.5, 0.5], [0, np.nan]]), [1, 1], 0.5, r"finite and nonnegative; kernel\[1, 1\] is nan"),
        (sparse.csr_array(np.eye(2)), [1, 1, 1], 0.5, "b must have 2 entries, one a state; it has 3"),
        (sparse.csr_array(np.eye(2)), [[1], [1]], 0.5, r"b must have 1 dimension\(s\); it has shape \(2, 1\)"),
        (sparse.csr_array(np.eye(2)), [1, np.inf], 0.5, r"b.*1.*inf"),
        (sparse.csr_array(np.eye(2)), [1, 1], -1, "discount must be in"),
        (sparse.csr_array(np.eye(2)), [1, 1], np.nan, "discount must be"),
    ],
)
def test_bad_systems(kernel, b, discount, words):
    with pytest.raises(ValueError, match=words):
        solve_policy_system(kernel, np.array(b), discount)


def test_a_matrix_by_columns_is_read_as_what_it_is():
    kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    for form in (kernel, kernel.tocsc(), kernel.tocoo()):
        assert_allclose(solve_policy_system(form, np.array([1.0, 0.0]), 0.5).x, [4 / 3, 0.0], rtol=1e-15)


@given(rngs)
@settings(max_examples=60)
def test_certified_values_are_the_exact_ones_correctly_rounded(rng):
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 6)), discount=float(rng.choice([0.0, 0.3, 0.9, 0.99, 0.9999])))
    policy = random_policy(rng, mdp)
    truth = rational_values(mdp, policy, by_move=True)
    found = exact.evaluate_policy(mdp, policy, certify=True)
    right = np.array([float(x) for x in truth])
    # around 0 a bound has two signs, near it the bound is wider than a float is fine (rng 497902), and half way between
    # floats no bound is small enough
    hard = np.array(
        [
            t == 0 or np.spacing(abs(x)) < 1e-26 or abs(Fraction(x) - t) * 4 >= Fraction(np.spacing(abs(x)))
            for x, t in zip(right.tolist(), truth, strict=True)
        ]
    )
    assert found.certified >= 1.0 - hard.mean() - 1e-12
    assert_array_equal(found.values[~hard], right[~hard])
    assert_allclose(found.values[hard], right[hard], rtol=3e-16, atol=1e-25)
    assert max(abs(Fraction(v) - t) for v, t in zip(found.values.tolist(), truth, strict=True)) <= found.error_bound
    value = sum(Fraction(m) * t for m, t in zip(mdp.initial.tolist(), truth, strict=True))
    ulps = np.spacing(abs(float(value))) + np.spacing(
        np.abs(right).max()
    )  # values of both signs may cancel (rng 10270478)
    assert abs(Fraction(found.value) - value) <= Fraction(ulps) + Fraction(1, 10**25)
    plain = exact.evaluate_policy(mdp, policy)
    assert plain.certified is None
    truth = rational_values(mdp, policy)
    worst = max(abs(Fraction(v) - t) for v, t in zip(plain.values.tolist(), truth, strict=True))
    assert worst <= Fraction(plain.error_bound)
    assert_array_equal(oee.state_values(mdp, policy, certify=True), found.values)


@pytest.mark.parametrize("scale", [1.0, 2.0**-700])
def test_rewards_of_moves_that_cancel_are_certified(scale):
    """r(s, a) = sum P r(s, a, s') loses six digits to cancellation when it is rounded: V is right to the last bit."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        p = rng.dirichlet(np.ones(4), (4, 2))
        rewards = rng.normal(size=(4, 2, 4))
        rewards -= (1.0 - 1e-6) * (p * rewards).sum(axis=2)[:, :, None]
        mdp = oee.FiniteMDP(p, rewards * scale, [1, 0, 0, 0], 0.9)
        policy = rng.dirichlet(np.ones(2), 4)
        truth = rational_values(mdp, policy, by_move=True)
        found = exact.evaluate_policy(mdp, policy, certify=True)
        assert found.certified == 1.0
        assert_array_equal(found.values, [float(v) for v in truth])
        assert max(abs(Fraction(v) - t) for v, t in zip(found.values.tolist(), truth, strict=True)) <= found.error_bound


@given(rngs)
@settings(max_examples=30)
def test_the_bound_of_a_compiled_small_system_bounds(rng):
    """Kernels of any row sums, against fractions; the rounding of the policy's kernel and rewards is in the bound."""
    mdp = random_mdp(rng, n_states=4, n_actions=3, discount=float(rng.choice([0.5, 0.95])))
    ratio = mdp.transitions.copy()
    ratio.data = rng.random(ratio.nnz) * 1.3
    model, policy = exact.reweight(mdp, ratio), random_policy(rng, mdp)
    try:
        found = exact.evaluate_policy(model, policy)
    except DivergentKernelError:
        return
    truth = rational_values(model, policy)
    worst = max(abs(Fraction(v) - t) for v, t in zip(found.values.tolist(), truth, strict=True))
    assert worst <= Fraction(found.error_bound)
    batched = exact.evaluate_batch([model], [policy])
    worst = max(abs(Fraction(v) - t) for v, t in zip(batched.values[0].tolist(), truth, strict=True))
    assert worst <= Fraction(float(batched.error_bound[0]))


def test_certified_at_discount_1_and_where_nothing_is_paid():
    rows = np.array([[[0.1, 0.7, 0.2]], [[0.3, 0.3, 0.4]], [[0.0, 0.0, 1.0]]])
    mdp = FiniteMDP(rows, [1.0, 1 / 3, 0.0], [1, 0, 0], 1.0)
    found = exact.evaluate_policy(mdp, np.ones((3, 1)), certify=True)
    inner = rational(rows[:2, 0, :2].tolist(), [1.0, 1 / 3], 1.0)
    assert found.certified == 1.0
    assert_array_equal(found.values, [*(float(x) for x in inner), 0.0])
    free = mdp.with_rewards(np.zeros(3)).with_discount(0.9)
    found = exact.evaluate_policy(free, np.ones((3, 1)), certify=True)
    assert (found.values.tolist(), found.certified, found.value) == ([0.0] * 3, 1.0, 0.0)
    over = FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 1.0)
    assert exact.evaluate_policy(over, np.ones((1, 1)), certify=True).certified == 1.0


def test_what_cannot_be_certified_is_said():
    """2 (1 - 1/2) - 1 = 0 without the graph telling so, and a value half way between two floats."""
    cancels = sparse.csr_array([[0.0, 1.0], [0.0, 0.0]])
    found = solve_policy_system(cancels, np.array([-0.5, 1.0]), 0.5, certify=True)
    assert_allclose(found.x, [0.0, 1.0], atol=1e-25)
    assert found.certified == 0.5
    half_way = sparse.csr_array([[0.0, 2.0**-53], [0.0, 0.0]])
    found = solve_policy_system(half_way, np.array([1.0, 1.0]), 1.0, certify=True)
    assert found.certified == 0.5
    assert abs(found.x[0] - 1.0) <= np.spacing(1.0)


def test_certify_is_for_the_infinite_sum():
    mdp = oee.tasks.gridworld(3, 0.3)
    with pytest.raises(ValueError, match="certify must be False with a horizon"):
        exact.evaluate_policy(mdp, oee.uniform_policy(mdp), horizon=3, certify=True)


@given(rngs)
def test_the_policy_kernel_is_the_product(rng):
    """Merged, sorted, without zeros: bit for bit what the sparse product gives."""
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 50)), zeros=float(rng.choice([0.0, 0.3, 0.9])))
    policy = random_policy(rng, mdp)
    n, m = mdp.n_states, mdp.n_actions
    averaging = sparse.csr_array((policy.reshape(-1), np.arange(n * m), np.arange(n + 1) * m), shape=(n, n * m))
    product = sparse.csr_array(averaging @ mdp.transitions)
    product.sort_indices()
    product.eliminate_zeros()
    kernel = policy_kernel(mdp, policy)
    assert kernel.has_canonical_format
    for part in ("data", "indices", "indptr"):
        assert_array_equal(getattr(kernel, part), getattr(product, part))
    assert_allclose(policy_rewards(mdp, policy), np.einsum("sa,sa->s", policy, mdp.rewards), rtol=1e-14, atol=1e-14)


def test_wide_index_arrays_and_unsorted_rows_are_taken():
    kernel = STRUCTURES["grid"]
    parts = kernel.data[::-1].copy(), kernel.indices[::-1].astype(np.int64), kernel.nnz - kernel.indptr[::-1]
    wide = sparse.csr_array((*parts[:2], parts[2].astype(np.int64)), shape=kernel.shape)
    b = np.random.default_rng(0).random(484)
    flipped = sparse.csr_array(kernel.toarray()[::-1])
    assert_allclose(
        solve_policy_system(wide, b, 0.9).x, np.linalg.solve(np.eye(484) - 0.9 * flipped.toarray(), b), rtol=1e-11
    )


def test_policies_in_fortran_order_are_taken():
    for size in (3, 12):
        mdp = oee.tasks.gridworld(size, 0.3)
        policy = random_policy(np.random.default_rng(0), mdp)
        expected = exact.evaluate_policy(mdp, policy).values
        assert_array_equal(exact.evaluate_policy(mdp, np.asfortranarray(policy)).values, expected)
        assert_array_equal(exact.evaluate_batch(mdp, [np.asfortranarray(policy)]).values[0], expected if size > 5 else
                           exact.evaluate_batch(mdp, [policy]).values[0])  # fmt: skip


@pytest.mark.parametrize("name", ["one state", "grid", "layered", "expander", "ring", "dense", "disconnected"])
def test_without_a_discount_a_closed_class_diverges(name):
    kernel = STRUCTURES[name]
    for transpose in (False, True):
        for certify in (False, True):
            with pytest.raises(DivergentKernelError, match=r"spectral radius of (1|0\.9999)"):
                solve_policy_system(kernel, np.ones(kernel.shape[0]), 1.0, transpose=transpose, certify=certify)
    with pytest.raises(DivergentKernelError, match=r"spectral radius of 1\."):
        solve_policy_system(kernel * 1.5, np.ones(kernel.shape[0]), 0.9)


@pytest.mark.parametrize("n", [30, 500])
@pytest.mark.parametrize("transpose", [False, True])
def test_systems_and_their_transposes_at_both_sizes(n, transpose):
    """The answer, its method, and an error bound that holds and is no more than rounding (for the transpose, of sums)."""
    rng = np.random.default_rng(n)
    kernel = sparse.csr_array(sparse.random_array((n, n), density=6 / n, rng=rng) + sparse.eye_array(n) * 0.1)
    kernel = sparse.csr_array(sparse.diags_array(1 / kernel.sum(axis=1)) @ kernel)
    b = rng.normal(size=n)
    found = solve_policy_system(kernel, b, 0.9, transpose=transpose)
    matrix = np.eye(n) - 0.9 * kernel.toarray()
    truth = np.linalg.solve(matrix.T if transpose else matrix, b)
    assert_allclose(found.x, truth, rtol=0, atol=1e-11 * np.abs(truth).max())
    missed = np.abs(found.x - truth)
    assert (missed.sum() if transpose else missed.max()) <= found.error_bound + 1e-13 * np.abs(truth).sum()
    assert 0 < found.error_bound < 1e-9 * np.abs(truth).sum()
    assert found.method == ("dense LU" if n == 30 else "BiCGSTAB")


@pytest.mark.parametrize("transpose", [False, True])
def test_the_error_bound_is_residual_and_rounding_times_the_norm_of_the_inverse(transpose):
    """(|b - M x| + u (entries of the row + 4) (gamma K |x| + |x| + |b|)) / (1 - gamma): its sum, or its largest."""
    rows = np.array([[0.5, 0.5, 0.0], [0.0, 1.0, 0.0], [0.2, 0.3, 0.5]])
    b = np.array([1.0, -2.0, 3.0])
    found = solve_policy_system(sparse.csr_array(rows), b, 0.9, transpose=transpose)
    kernel = 0.9 * (rows.T if transpose else rows)
    entries = (kernel != 0).sum(axis=1) + 4
    sizes = kernel @ np.abs(found.x) + np.abs(found.x) + np.abs(b)
    missed = np.abs(b + kernel @ found.x - found.x) + 0.5 * np.finfo(float).eps * entries * sizes
    assert_allclose(found.error_bound, 10.0 * (missed.sum() if transpose else missed.max()), rtol=0.3)


def test_a_singular_system_at_either_size_is_divergence():
    for n in (2, 500):
        ring = sparse.csr_array((np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n))
        with pytest.raises(
            ValueError, match=r"spectral radius of 1, which must be below 1 \(its rows sum to at most 1\)"
        ):
            solve_policy_system(ring, np.ones(n), 1.0)
        with pytest.raises(ValueError, match=r"its rows sum to at most 1\.8"):
            solve_policy_system(ring * 2.0, np.ones(n), 0.9)
