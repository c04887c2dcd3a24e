import pickle
import tempfile
from pathlib import Path

import numpy as np
import pytest
from helpers import dense, integer_distribution, random_mdp, random_policy, rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP


def sparse_form(mdp):
    """The same MDP of sparse arguments."""
    rewards = mdp.rewards if mdp.reward_data is None else mdp.transition_rewards.copy()
    return FiniteMDP(mdp.transitions.tocoo(), rewards, mdp.initial, mdp.discount)


@given(rngs)
def test_dense_and_sparse_arguments_files_and_pickles_make_the_same_mdp(rng):
    mdp = random_mdp(rng)
    policy = random_policy(rng, mdp)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mdp.npz"
        mdp.save(path)
        assert [p.name for p in Path(folder).iterdir()] == ["mdp.npz"]
        loaded = FiniteMDP.load(path)
    for other in (sparse_form(mdp), loaded, pickle.loads(pickle.dumps(mdp)), mdp.with_discount(mdp.discount)):
        same_bits(mdp, other)
        for call in (oee.policy_value, oee.state_values, oee.action_values, oee.occupancy):
            assert_array_equal(call(mdp, policy), call(other, policy))
        assert repr(mdp) == repr(other)
        assert mdp._repr_html_() == other._repr_html_()


def same_bits(a, b):
    for name in ("rewards", "initial", "terminal_state", "reward_data", "discount"):
        assert_array_equal(getattr(a, name), getattr(b, name))
    assert_array_equal(a.absorbing(), b.absorbing())
    for name in ("transitions", "transition_rewards"):
        left, right = getattr(a, name), getattr(b, name)
        assert (left is None) == (right is None)
        for part in ("indptr", "indices", "data") if left is not None else ():
            assert_array_equal(getattr(left, part), getattr(right, part))
            assert getattr(left, part).dtype == getattr(right, part).dtype
            assert not getattr(right, part).flags.writeable


@given(rngs)
def test_matrices_are_canonical_and_made_once(rng):
    mdp = random_mdp(rng)
    transitions, _ = dense(mdp)
    assert mdp.transitions is mdp.transitions
    assert mdp.transitions.has_canonical_format
    assert (mdp.transitions.data > 0).all()
    assert mdp.transitions.nnz == (transitions > 0).sum()
    assert_array_equal(mdp.csr.to_matrix().toarray(), transitions.reshape(-1, mdp.n_states))
    if mdp.reward_data is not None:
        assert_array_equal(mdp.transition_rewards.toarray()[mdp.transitions.toarray() > 0], mdp.reward_data)


BAD_ROWS = {
    "negative": ([[[1.5, -0.5]], [[0, 1]]], "nonnegative"),
    "nan": ([[[np.nan, 1]], [[0, 1]]], "finite"),
    "infinite": ([[[np.inf, 0]], [[0, 1]]], "finite"),
    "sum": ([[[0.5, 0.4]], [[0, 1]]], "must sum to 1 .*; it sums to 0.9"),
}


@pytest.mark.parametrize("name", BAD_ROWS)
@pytest.mark.parametrize("form", [np.array, lambda rows: sparse.csr_array(np.array(rows)[:, 0])])
def test_bad_rows_are_refused_in_both_forms(name, form):
    rows, rule = BAD_ROWS[name]
    with pytest.raises(ValueError, match=f"^transitions.*{rule}"):
        FiniteMDP(form(rows), [0, 0], [1, 0], 0.9)


def broken_matrix():
    """Native code that follows its pointers reads beyond its arrays."""
    matrix = sparse.csr_array(np.eye(6))
    matrix.indptr[5] = 10**6
    return matrix


GOOD, LOG = np.eye(6)[:, None], oee.Transitions([0, 1], [0, 0], [1, 5], [0.0, 1.0])


@pytest.mark.parametrize(
    "call",
    [
        lambda bad: FiniteMDP(bad, np.zeros(6), 0, 0.9),
        lambda bad: FiniteMDP(GOOD, bad, 0, 0.9),
        lambda bad: FiniteMDP(GOOD, np.zeros(6), 0, 0.9).with_transitions(bad),
        lambda bad: FiniteMDP(GOOD, np.zeros(6), 0, 0.9).with_rewards(bad),
        lambda bad: FiniteMDP(GOOD, np.zeros(6), 0, 0.9).with_support_of(bad, 0.1),
        lambda bad: FiniteMDP.from_log(LOG, discount=0.9, rewards=bad),
    ],
)
@pytest.mark.filterwarnings("ignore:.*never recorded")
def test_a_malformed_csr_is_refused_before_it_is_read(call):
    with pytest.raises(ValueError, match=r"indptr\[[56]\] must be at"):
        call(broken_matrix())


def test_the_three_forms_of_rewards():
    transitions = np.array([[[0.25, 0.75]], [[1.0, 0.0]]])
    by_state = FiniteMDP(transitions, [1.0, 2.0], [1, 0], 0.5)
    assert_array_equal(by_state.rewards, [[1.0], [2.0]])
    by_action = FiniteMDP(transitions, [[1.0], [2.0]], [1, 0], 0.5)
    assert_array_equal(by_action.rewards, [[1.0], [2.0]])
    assert by_action.transition_rewards is None
    by_move = FiniteMDP(transitions, np.array([[[4.0, 8.0]], [[1.0, np.nan]]]), [1, 0], 0.5)
    assert_array_equal(by_move.rewards, [[7.0], [1.0]])
    assert_array_equal(by_move.reward_data, [4.0, 8.0, 1.0])


def test_it_is_immutable():
    mdp = random_mdp(np.random.default_rng(0), form=3)
    with pytest.raises(AttributeError, match="immutable"):
        mdp.discount = 0.5
    with pytest.raises(AttributeError, match="immutable"):
        del mdp.discount
    for array in (mdp.rewards, mdp.initial, mdp.transitions.data, mdp.transition_rewards.data, mdp.reward_data):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_it_does_not_change_or_keep_what_it_was_given():
    transitions, initial = np.ones((1, 1, 1)), np.ones(1)
    mdp = FiniteMDP(transitions, np.ones(1), initial, 0.5)
    transitions[:] = 0.0
    initial[:] = 0.0
    assert mdp.transitions.data[0] == mdp.initial[0] == 1.0


@given(rngs)
def test_action_noise_is_the_policy_mixed_with_uniform(rng):
    """V under (P_eps, pi) is V under (P, (1 - eps) pi + eps uniform): dynamics and rewards both."""
    mdp = random_mdp(rng)
    policy = random_policy(rng, mdp)
    epsilon = float(rng.choice([0.0, 0.25, 1.0]))
    noisy = mdp.with_action_noise(epsilon)
    mixed = oee.mix(policy, oee.uniform_policy(mdp), 1 - epsilon)
    assert_allclose(oee.state_values(noisy, policy), oee.state_values(mdp, mixed), rtol=0, atol=1e-9)


def test_action_noise_keeps_the_rewards_of_the_action_that_was_carried_out():
    """Both actions move 0 -> 1, one paying 0, one 10; with noise 0.5 the first pays 0 or 10 with 3 to 1."""
    transitions = np.array([[[0.0, 1.0], [0.0, 1.0]], [[0.0, 1.0], [0.0, 1.0]]])
    rewards = np.array([[[0.0, 0.0], [0.0, 10.0]], [[0.0, 0.0], [0.0, 0.0]]])
    noisy = FiniteMDP(transitions, rewards, [1, 0], 0.9).with_action_noise(0.5)
    assert_allclose(noisy.rewards[0], [2.5, 7.5], rtol=1e-15)


@given(rngs)
def test_other_transitions_average_the_rewards_again(rng):
    mdp = random_mdp(rng, form=3)
    target = random_mdp(rng, like=mdp)
    transitions, _ = dense(target)
    _, rewards = dense(mdp)
    assert_allclose(target.rewards, np.einsum("sat,sat->sa", transitions, rewards), rtol=0, atol=1e-12)


def test_a_dense_reward_is_defined_off_the_support_and_a_nan_is_not():
    transitions = np.array([[[1.0, 0.0]], [[0.0, 1.0]]])
    other = np.array([[[0.5, 0.5]], [[0.0, 1.0]]])
    everywhere = FiniteMDP(transitions, np.array([[[1.0, 5.0]], [[0.0, 0.0]]]), [1, 0], 0.9)
    assert_allclose(everywhere.with_transitions(other).rewards[0, 0], 3.0)
    partly = FiniteMDP(transitions, np.array([[[1.0, np.nan]], [[0.0, 0.0]]]), [1, 0], 0.9)
    with pytest.raises(ValueError, match=r"1 .*do not, the first: s=0, a=0 -> s'=1"):
        partly.with_transitions(other)


def test_absorbing_states_pay_nothing_and_lead_only_to_themselves():
    transitions = np.zeros((3, 1, 3))
    transitions[0, 0, 1] = transitions[1, 0, 1] = transitions[2, 0, 2] = 1.0
    mdp = FiniteMDP(transitions, [0.0, 0.0, 1.0], [1, 0, 0], 0.9)
    assert_array_equal(mdp.absorbing(), [False, True, False])


def test_large_sparse_rewards_are_not_made_dense():
    n = 20000
    ring = sparse.csr_array((np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n))
    mdp = FiniteMDP(ring, ring * 2.0, integer_distribution(np.random.default_rng(0), n), 0.5)
    assert mdp.transition_rewards.nnz == n
    assert_allclose(oee.policy_value(mdp, np.ones((n, 1))), 4.0)


def with_a_state_that_nothing_leads_to(form=2):
    """State 2 comes last and leads to the others; an entry of 0 is stored; twins: of states 0 and 1."""
    matrix = sparse.csr_array(
        (np.array([0.5, 0.5, 1.0, 0.0, 0.25, 0.75]), np.array([0, 1, 1, 0, 0, 1]), np.array([0, 2, 4, 6])), shape=(3, 3)
    )
    rewards = np.array([[1.0], [2.0], [3.0]])
    if form == 3:
        rewards = sparse.csr_array((np.arange(1.0, 7.0), matrix.indices, matrix.indptr), shape=(3, 3))
    return FiniteMDP(matrix, rewards, [0.0, 0.5, 0.5], 0.9, terminal_state=[0, 2])


def test_stored_zeros_are_taken_and_dropped():
    assert with_a_state_that_nothing_leads_to().transitions.nnz == 5
    assert_array_equal(with_a_state_that_nothing_leads_to(3).reward_data, [1.0, 2.0, 3.0, 5.0, 6.0])


@pytest.mark.parametrize("form", [2, 3])
def test_a_last_state_that_nothing_leads_to_survives_files_pickles_and_copies(form, tmp_path):
    mdp = with_a_state_that_nothing_leads_to(form)
    mdp.save(tmp_path / "mdp.npz")
    copies = FiniteMDP.load(tmp_path / "mdp.npz"), pickle.loads(pickle.dumps(mdp)), mdp.with_discount(0.9)
    for other in (*copies, mdp.with_rewards(mdp.rewards if form == 2 else mdp.transition_rewards)):
        assert other.transitions.shape == (3, 3)
        same_bits(mdp, other)


def test_its_page_has_its_numbers():
    page = oee.tasks.gridworld(3, 0.3)._repr_html_()
    for label, value in (("states", "9"), ("actions", "4"), ("transitions", "120"), ("discount", "0.99"),
                         ("first states", "1"), ("terminal states", "1")):  # fmt: skip
        assert f"{label}</" in page
        assert f">{value}<" in page, label
    assert "FiniteMDP: rewards in units of the return" in page
    assert "r(s, a, s&#x27;), -0.8 to 0<" in page  # -0.8: two ways lead to one s'
    assert ">r(s, a), 1 to 3<" in with_a_state_that_nothing_leads_to()._repr_html_()
    assert "r(s, a, s'), 1 to 6" in with_a_state_that_nothing_leads_to(3)._repr_html_().replace("&#x27;", "'")


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (lambda: oee.mix([[1.0]], np.ones((1, 1, 1, 1)), 0.5), "policy_b must have 2 or 3 dimension"),
        (lambda: oee.mix([1.0], [[1.0]], 0.5), "policy_a must have 2 or 3 dimension"),
        (lambda: oee.mix([[1.0]], [["x"]], 0.5), "policy_b must be an array of numbers"),
        (lambda: oee.mix([[1.0, 0.0]], [[0.6, 0.6]], 0.5), "policy_b"),
        (lambda: oee.mdp.check_policy([["x"]], oee.tasks.gridworld(2, 0.1)), "policy must be an array of numbers"),
        (lambda: FiniteMDP([[[1.0]]], np.ones((1, 1, 1, 1)), [1.0], 0.5), "rewards must have 1 or 2 or 3 dimension"),
        (lambda: FiniteMDP([[[1.0]]], 1.0, [1.0], 0.5), "rewards must have 1 or 2 or 3 dimension"),
    ],
)
def test_errors_name_their_argument(bad, words):
    with pytest.raises(ValueError, match=words):
        bad()
