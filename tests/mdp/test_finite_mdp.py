"""The model: forms of its arguments, what is made of it, files and pickles."""

import pickle

import numpy as np
import pytest
from helpers import (
    ACTIONS,
    ROWS,
    STATES,
    dense,
    integer_distribution,
    random_mdp,
    random_policy,
    rngs,
)
from hypothesis import given
from kernels.files import save_npz
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.estimators import ModelBased
from oee_tabular.exact import reweight
from oee_tabular.lab.experiments.common import frequencies
from oee_tabular.lab.experiments.values import with_next_rewards_averaged
from oee_tabular.mdp.naming import Names

LOG = oee.Transitions([0, 0, 1], [0, 1, 0], [1, 0, 2], [0.0, 1.0, 1.0])


def make_loaded(mdp, folder):
    mdp.save(folder / "mdp.npz")
    assert [path.name for path in folder.iterdir()] == ["mdp.npz"]
    return FiniteMDP.load(folder / "mdp.npz")


@given(rngs)
def test_dense_and_sparse_arguments_files_and_pickles_make_the_same_mdp(
    tmp_path_factory, rng
):
    mdp = random_mdp(rng)
    policy = random_policy(rng, mdp)
    rewards = mdp.rewards if mdp.reward_data is None else mdp.transition_rewards.copy()
    for other in (
        FiniteMDP(mdp.transitions.tocoo(), rewards, mdp.initial, mdp.discount),
        make_loaded(mdp, tmp_path_factory.mktemp("mdp")),
        pickle.loads(pickle.dumps(mdp)),
        mdp.with_discount(mdp.discount),
    ):
        assert_same_bits(mdp, other)
        for call in (
            oee.policy_value,
            oee.state_values,
            oee.action_values,
            oee.occupancy,
        ):
            assert_array_equal(call(mdp, policy), call(other, policy))
        assert repr(mdp) == repr(other)
        assert mdp._repr_html_() == other._repr_html_()


def assert_same_bits(a, b):
    for name in ("rewards", "initial", "terminal_state", "reward_data", "discount"):
        assert_array_equal(getattr(a, name), getattr(b, name))
    assert_array_equal(a.absorbing(), b.absorbing())
    for name in ("transitions", "transition_rewards"):
        left = getattr(a, name)
        right = getattr(b, name)
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
    assert_array_equal(
        mdp.csr.to_matrix().toarray(), transitions.reshape(-1, mdp.n_states)
    )
    if mdp.reward_data is not None:
        assert_array_equal(
            mdp.transition_rewards.toarray()[mdp.transitions.toarray() > 0],
            mdp.reward_data,
        )


PLACES = np.array([[0.5, -1.0], [2.0, 3.0], [7.0, 7.0]])


@pytest.mark.parametrize("form", [2, 3])
def test_what_is_made_of_the_same_states_keeps_names_and_layout(form, tmp_path):
    rewards = np.array([[-1.0, -1], [-1, -1], [0, 0]])
    rewards = rewards if form == 2 else np.where(ROWS > 0, rewards[:, :, None], np.nan)
    mdp = FiniteMDP(
        ROWS, rewards, 0, 0.9, state_names=STATES, action_names=ACTIONS, layout=PLACES
    )
    others = {
        "transitions": mdp.with_transitions(mdp.transitions),
        "rewards": mdp.with_rewards([1.0, 2.0, 0.0]),
        "discount": mdp.with_discount(0.5),
        "initial": mdp.with_initial(1),
        "noise": mdp.with_action_noise(0.1),
        "support": mdp.with_support_of(oee.Transitions([0], [0], [2]), 0.1),
        "file": make_loaded(mdp, tmp_path),
        "pickle": pickle.loads(pickle.dumps(mdp)),
        "other names": mdp.with_names().with_names(STATES, ACTIONS),
        "another layout": mdp.with_layout([0, 1, 2]).with_layout(PLACES),
        "ratio": reweight(mdp, 1.1 * (mdp.transitions > 0)),
        "model": ModelBased().model(oee.Problem(mdp, LOG)),
        "rewards of the log": oee.Problem(mdp, LOG, rewards="log").model,
        "zeta": oee.transition_ratio(LOG, mdp).target_model(mdp),
        "averaged": with_next_rewards_averaged(mdp),
    }
    if form == 2:
        others["frequencies"] = mdp.with_transitions(frequencies(LOG.counts(3, 2), 2))
    for name, other in others.items():
        assert_array_equal(other.layout, PLACES, err_msg=name)
        assert other.names == Names(STATES, ACTIONS), name
    assert_array_equal(mdp.with_layout(None).rewards, mdp.rewards)


def make_unentered(form=2):
    """State 2 comes last and leads to the others; an entry of 0 is stored; twins: of
    states 0 and 1.
    """
    matrix = sparse.csr_array(
        (
            np.array([0.5, 0.5, 1.0, 0.0, 0.25, 0.75]),
            np.array([0, 1, 1, 0, 0, 1]),
            np.array([0, 2, 4, 6]),
        ),
        shape=(3, 3),
    )
    rewards = np.array([[1.0], [2.0], [3.0]])
    if form == 3:
        rewards = sparse.csr_array(
            (np.arange(1.0, 7.0), matrix.indices, matrix.indptr), shape=(3, 3)
        )
    return FiniteMDP(matrix, rewards, [0.0, 0.5, 0.5], 0.9, terminal_state=[0, 2])


@pytest.mark.parametrize("form", [2, 3])
def test_a_last_state_that_nothing_leads_to_survives_files_pickles_and_copies(
    form, tmp_path
):
    mdp = make_unentered(form)
    assert mdp.transitions.nnz == 5  # stored zeros are dropped
    assert form == 2 or mdp.reward_data.tolist() == [1.0, 2.0, 3.0, 5.0, 6.0]
    copies = (
        make_loaded(mdp, tmp_path),
        pickle.loads(pickle.dumps(mdp)),
        mdp.with_discount(0.9),
    )
    for other in (
        *copies,
        mdp.with_rewards(mdp.rewards if form == 2 else mdp.transition_rewards),
    ):
        assert other.transitions.shape == (3, 3)
        assert_same_bits(mdp, other)


def test_a_file_without_names_and_layout_has_none(tmp_path):
    loaded = make_loaded(make_unentered(), tmp_path)
    assert not {"state_names", "action_names", "layout"} & set(
        np.load(tmp_path / "mdp.npz").files
    )
    assert (loaded.layout, loaded.names) == (None, Names())


@pytest.mark.parametrize(
    ("broken", "text"),
    [
        (
            {"layout": np.zeros((2, 2))},
            r"layout must have shape \(3,\) or \(3, c\).*; it has shape \(2, 2\)$",
        ),
        (
            {"layout": np.array([0.0, np.inf, 1.0])},
            r"layout\[1\] must be finite; it is inf$",
        ),
        ({"layout": np.array(["a", "b", "c"])}, r"layout must be an array of numbers"),
        (
            {"state_names": np.arange(3)},
            r"state_names must be texts; it has int64 of shape \(3,\)$",
        ),
        (
            {"state_names": np.array(["hall", "x", "y"])},
            r"state_names must be names as JSON; it has 'hall'$",
        ),
        (
            {"state_names": np.array(['"a"', '"a"', '"b"'])},
            r"state_names must differ; state_names\[1\] is 'a', as state",
        ),
        (
            {"state_names": np.array(['"a"', '"b"'])},
            r"state_names must have 3 names, one for each; it has 2$",
        ),
    ],
)
def test_broken_files_are_named_with_the_part(broken, text, tmp_path):
    path = tmp_path / "mdp.npz"
    save_npz(path, "finite_mdp", make_unentered().arrays() | broken)
    with pytest.raises(ValueError, match=rf"'.*mdp\.npz': {text}"):
        FiniteMDP.load(path)


# ---------------------------------------------------------------- rewards and dynamics


def test_the_three_forms_of_rewards():
    transitions = np.array([[[0.25, 0.75]], [[1.0, 0.0]]])
    for rewards in ([1.0, 2.0], [[1.0], [2.0]]):
        mdp = FiniteMDP(transitions, rewards, [1, 0], 0.5)
        assert_array_equal(mdp.rewards, [[1.0], [2.0]])
        assert mdp.transition_rewards is None
    by_transition = FiniteMDP(
        transitions, np.array([[[4.0, 8.0]], [[1.0, np.nan]]]), [1, 0], 0.5
    )
    assert_array_equal(by_transition.rewards, [[7.0], [1.0]])
    assert_array_equal(by_transition.reward_data, [4.0, 8.0, 1.0])


@given(rngs)
def test_other_transitions_average_the_rewards_again(rng):
    mdp = random_mdp(rng, form=3)
    target = random_mdp(rng, like=mdp)
    expected = np.einsum("sat,sat->sa", dense(target)[0], dense(mdp)[1])
    assert_allclose(target.rewards, expected, rtol=0, atol=1e-12)


def test_a_dense_reward_is_defined_off_the_support_and_a_nan_is_not():
    transitions = np.array([[[1.0, 0.0]], [[0.0, 1.0]]])
    other = np.array([[[0.5, 0.5]], [[0.0, 1.0]]])
    everywhere = FiniteMDP(
        transitions, np.array([[[1.0, 5.0]], [[0.0, 0.0]]]), [1, 0], 0.9
    )
    assert_allclose(everywhere.with_transitions(other).rewards[0, 0], 3.0)
    partly = FiniteMDP(
        transitions, np.array([[[1.0, np.nan]], [[0.0, 0.0]]]), [1, 0], 0.9
    )
    with pytest.raises(ValueError, match=r"1 .*do not, the first: s=0, a=0 -> s'=1"):
        partly.with_transitions(other)


@given(rngs)
def test_action_noise_is_the_policy_mixed_with_uniform(rng):
    """V under (P_eps, pi) is V under (P, (1 - eps) pi + eps uniform): dynamics and
    rewards both.
    """
    mdp = random_mdp(rng)
    policy = random_policy(rng, mdp)
    epsilon = float(rng.choice([0.0, 0.25, 1.0]))
    noisy = mdp.with_action_noise(epsilon)
    mixed = oee.mix(policy, oee.uniform_policy(mdp), 1 - epsilon)
    assert_allclose(
        oee.state_values(noisy, policy), oee.state_values(mdp, mixed), rtol=0, atol=1e-9
    )


def test_absorbing_states_pay_nothing_and_lead_only_to_themselves():
    transitions = np.eye(3)[[1, 1, 2], None]
    mdp = FiniteMDP(transitions, [0.0, 0.0, 1.0], [1, 0, 0], 0.9)
    assert_array_equal(mdp.absorbing(), [False, True, False])
    assert_array_equal(mdp.closed(), [False, True, True])


def test_large_sparse_rewards_are_not_made_dense():
    n = 20000
    ring = sparse.csr_array(
        (np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n)
    )
    mdp = FiniteMDP(
        ring, ring * 2.0, integer_distribution(np.random.default_rng(0), n), 0.5
    )
    assert mdp.transition_rewards.nnz == n
    assert np.shares_memory(mdp.transition_rewards.indices, mdp.transitions.indices)
    assert np.shares_memory(mdp.transition_rewards.data, mdp.reward_data)
    assert_allclose(oee.policy_value(mdp, np.ones((n, 1))), 4.0)


# ---------------------------------------------------------------- immutability, page


def test_it_is_immutable_and_keeps_nothing_that_it_was_given():
    mdp = random_mdp(np.random.default_rng(0), form=3).with_layout(np.arange(6))
    for change in (
        lambda: setattr(mdp, "discount", 0.5),
        lambda: delattr(mdp, "layout"),
    ):
        with pytest.raises(AttributeError, match="immutable"):
            change()
    for array in (
        mdp.rewards,
        mdp.initial,
        mdp.layout,
        mdp.transitions.data,
        mdp.transition_rewards.data,
        mdp.reward_data,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    transitions = np.ones((1, 1, 1))
    initial = np.ones(1)
    layout = np.ones(1)
    mdp = FiniteMDP(transitions, np.ones(1), initial, 0.5, layout=layout)
    for array in (transitions, initial, layout):
        array[:] = 0.0
    assert mdp.transitions.data[0] == mdp.initial[0] == mdp.layout[0, 0] == 1.0


def test_its_page_has_its_numbers():
    page = oee.tasks.gridworld(3, 0.3)._repr_html_()
    for label, value in (
        ("states", "9"),
        ("actions", "4"),
        ("transitions", "120"),
        ("discount", "0.99"),
        ("first states", "1"),
        ("terminal states", "1"),
    ):
        assert f"{label}</" in page
        assert f">{value}<" in page, label
    assert "FiniteMDP: rewards in units of the return" in page
    assert "r(s, a, s&#x27;), -0.8 to 0<" in page  # -0.8: two ways lead to one s'
    assert ">r(s, a), 1 to 3<" in make_unentered()._repr_html_()
