"""What mutation testing showed that the other tests of ``mdp`` leave open: each test is named after what it pins down."""

import pickle

import gymnasium
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP


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
        for name in ("rewards", "initial", "terminal_state"):
            assert_array_equal(getattr(other, name), getattr(mdp, name))
        assert other.discount == 0.9
        assert (other.reward_data is None) == (form == 2)
        if form == 3:
            assert other.transition_rewards.shape == (3, 3)
            assert_array_equal(other.reward_data, mdp.reward_data)


def test_its_page_has_its_numbers():
    page = oee.tasks.gridworld(3, 0.3)._repr_html_()
    for label, value in (("states", "9"), ("actions", "4"), ("transitions", "120"), ("discount", "0.99"),
                         ("first states", "1"), ("states that are over", "1")):  # fmt: skip
        assert f"{label}</" in page
        assert f">{value}<" in page, label
    assert "FiniteMDP: rewards in units of the return" in page
    assert "r(s, a, s&#x27;), -0.8 to 0<" in page  # -0.8: two ways lead to one s'
    assert ">r(s, a), 1 to 3<" in with_a_state_that_nothing_leads_to()._repr_html_()
    assert "r(s, a, s'), 1 to 6" in with_a_state_that_nothing_leads_to(3)._repr_html_().replace("&#x27;", "'")


class Corridor(gymnasium.Env):
    """State 2, the last one, is begun in and never entered; an outcome of probability 0 leads there."""

    observation_space, action_space = gymnasium.spaces.Discrete(3), gymnasium.spaces.Discrete(1)
    initial_state_distrib = np.array([0.0, 0.0, 1.0])
    P = {
        0: {0: [(1.0, 0, 0.0, True)]},
        1: {0: [(0.5, 0, 0.0, True), (0.5, 1, 0.0, False), (0.0, 2, 7.0, False)]},
        2: {0: [(1.0, 1, 1.0, False)]},
    }


def test_a_table_whose_last_state_is_never_entered():
    mdp = FiniteMDP.from_gymnasium(Corridor(), discount=0.5)
    assert mdp.n_states == 3
    assert_array_equal(mdp.transitions.toarray(), [[1, 0, 0], [0.5, 0.5, 0], [0, 1, 0]])
    assert_array_equal(mdp.initial, [0, 0, 1])
    assert_array_equal(oee.state_values(mdp, np.ones((3, 1))), [0, 0, 1])


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
