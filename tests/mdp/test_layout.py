"""Coordinates of states: kept by whatever makes an MDP of the same states, and what moves from different states share."""

import pickle
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP, _files
from oee_tabular.estimators import ModelBased, Problem
from oee_tabular.exact import reweight
from oee_tabular.mdp import displacements
from oee_tabular.testing import case

GRID = oee.tasks.gridworld(3, 0.3)
PLACES = np.array([[0.5, -1.0], [2.0, 3.0], [7.0, 7.0]])
LOG = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 5, 10, seed=0)


def three(form=2, layout=PLACES):
    """0 goes on or stays, 1 goes on, 2 is closed; rewards r(s, a) or r(s, a, s')."""
    rows = np.array([[[0.25, 0.75, 0.0]], [[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]])
    rewards = np.ones((3, 1)) if form == 2 else np.where(rows > 0, rows, np.nan)
    return FiniteMDP(rows, rewards, [1, 0, 0], 0.9, layout=layout)


# ---------------------------------------------------------------- the argument


def test_one_number_or_several_a_state():
    assert_array_equal(three(layout=[1, 5, 2]).layout, [[1.0], [5.0], [2.0]])
    mdp = three()
    assert_array_equal(mdp.layout, PLACES)
    assert mdp.layout.dtype == np.float64
    assert three(layout=None).layout is None


def test_a_grids_shape():
    chain = FiniteMDP(np.eye(6)[:, None], np.zeros(6), 0, 0.9, layout=(2, 3))
    assert chain.layout.tolist() == [[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]
    assert chain.with_layout((np.int64(3), 2)).layout[-1].tolist() == [2, 1]
    assert_array_equal(oee.tasks.gridworld(3, 0.3).with_layout((3, 3)).layout, GRID.layout)
    log = oee.Transitions([0, 1], [0, 0], [1, 2], [0.0, 1.0], terminated=[0, 1])
    assert FiniteMDP.from_log(log, layout=(1, 3)).layout.tolist() == [[0, 0], [0, 1], [0, 2]]
    for shape in ((2, 2), (4, 2), (-2, -3), (0, 6)):
        with pytest.raises(
            ValueError, match=r"^layout must be \(height, width\) with height \* width = 6, the number of"
        ):
            chain.with_layout(shape)
    two = FiniteMDP(np.eye(2)[:, None], np.zeros(2), 0, 0.9)
    assert two.with_layout((2, 1)).layout.tolist() == [[0, 0], [1, 0]]
    assert two.with_layout((5, 7)).layout.tolist() == [[5], [7]]  # places of two states


def test_coordinates_in_names_are_a_layout_where_none_is_given(tmp_path):
    named = three(layout=None).with_names([(0, 0.5), (1, 0.5), (1, -2)])
    assert_array_equal(named.layout, [[0, 0.5], [1, 0.5], [1, -2]])
    named.save(tmp_path / "named.npz")
    assert_array_equal(FiniteMDP.load(tmp_path / "named.npz").layout, named.layout)
    assert_array_equal(pickle.loads(pickle.dumps(named)).with_discount(0.5).layout, named.layout)
    assert_array_equal(named.with_names([(7,), (8,), (9,)]).layout, [[7], [8], [9]])
    assert named.with_names(["a", "b", "c"]).layout is None
    assert_array_equal(named.with_layout(PLACES).layout, PLACES)  # a given one comes first
    assert_array_equal(named.with_layout(PLACES).with_layout(None).layout, named.layout)
    longer, text, digits = [(0, 0), (0, 1), (0, 1, 2)], [(0, 0), (0, 1), "dock"], [(0,), ("1",), (2,)]
    for names in (longer, text, digits, [(0, (1,)), (1, (1,)), (2, (1,))], [(10**400,), (1,), (2,)]):
        assert three(layout=None).with_names(names).layout is None


def test_a_twin_lies_where_its_state_does():
    log = oee.Transitions(
        [(0, 0), (0, 0), (0, 1)], ["go"] * 3, [(0, 1), (0, 1), (0, 0)], [1.0] * 3, terminated=[0, 1, 0]
    )
    made = FiniteMDP.from_log(log)
    assert made.state_names[-1] == (0, 1, "over")
    assert made.layout.tolist() == [[0, 0], [0, 1], [0, 1]]


def test_it_is_copied_and_read_only():
    given_places = PLACES.copy()
    mdp = three(layout=given_places)
    given_places[:] = 0.0
    assert_array_equal(mdp.layout, PLACES)
    with pytest.raises(ValueError, match="read-only"):
        mdp.layout[0, 0] = 1.0
    with pytest.raises(AttributeError, match="immutable"):
        mdp.layout = None


@pytest.mark.parametrize("form", [2, 3])
def test_what_is_made_of_the_same_states_keeps_it(form, tmp_path):
    mdp = three(form)
    mdp.save(tmp_path / "mdp.npz")
    others = {
        "transitions": mdp.with_transitions(mdp.transitions),
        "rewards": mdp.with_rewards([1.0, 2.0, 3.0]),
        "discount": mdp.with_discount(0.5),
        "noise": mdp.with_action_noise(0.1),
        "file": FiniteMDP.load(tmp_path / "mdp.npz"),
        "pickle": pickle.loads(pickle.dumps(mdp)),
        "ratio": reweight(mdp, 1.1 * (mdp.transitions > 0)),
        "another layout": mdp.with_layout([0, 1, 2]).with_layout(PLACES),
    }
    for name, other in others.items():
        assert_array_equal(other.layout, PLACES, err_msg=name)
        assert_array_equal(other.transitions.toarray(), mdp.transitions.toarray() * (1.1 if name == "ratio" else 1.0))
    assert mdp.with_layout(None).layout is None
    assert_array_equal(mdp.with_layout(PLACES).rewards, mdp.rewards)


def test_models_of_the_target_keep_it():
    for model in (
        ModelBased().model(Problem(GRID, LOG)),
        Problem(GRID, LOG, rewards="log").model,
        oee.transition_ratio(LOG, GRID).target_model(GRID),
    ):
        assert_array_equal(model.layout, GRID.layout)


def test_other_numbers_of_the_states_take_it_along():
    pair = case("ragged")
    states = np.roll(np.arange(pair.simulator.n_states), 1)
    lying = replace(
        pair,
        simulator=pair.simulator.with_layout(10 * np.arange(len(states))),
        target=pair.target.with_layout(None),
    )
    renamed = lying.relabelled(states, np.arange(lying.simulator.n_actions))
    assert_array_equal(renamed.simulator.layout[states], lying.simulator.layout)
    assert renamed.target.layout is None


def test_files_without_it_load_and_broken_ones_name_it(tmp_path):
    path = tmp_path / "mdp.npz"
    three(layout=None).save(path)
    assert "layout" not in np.load(path).files
    assert FiniteMDP.load(path).layout is None
    for broken, text in (
        (np.zeros((2, 2)), r"'.*mdp.npz': layout must have shape \(3,\) or \(3, c\).*; it has shape \(2, 2\)$"),
        (np.array([0.0, np.inf, 1.0]), r"'.*mdp.npz': layout\[1\] must be finite; it is inf$"),
        (np.array(["a", "b", "c"]), r"'.*mdp.npz': layout must be an array of numbers"),
    ):
        _files.save_npz(path, "finite_mdp", three(layout=None).arrays() | {"layout": np.array(broken)})
        with pytest.raises(ValueError, match=text):
            FiniteMDP.load(path)


# ---------------------------------------------------------------- the built-in tasks


def test_gridworlds_have_rows_and_columns():
    assert_array_equal(GRID.layout, [divmod(s, 3) for s in range(9)])


@pytest.mark.parametrize(
    ("name", "kwargs", "columns"),
    [
        ("FrozenLake-v1", {"map_name": "8x8"}, 8),
        ("FrozenLake-v1", {"desc": ["SFH", "FFG"]}, 3),
        ("CliffWalking-v1", {}, 12),
    ],
)
def test_maps_have_rows_and_columns(name, kwargs, columns):
    mdp = oee.tasks.toy_text(name, **kwargs)
    assert_array_equal(mdp.layout, [divmod(s, columns) for s in range(mdp.n_states)])


def test_taxi_has_a_map_that_is_not_its_states():
    assert oee.tasks.toy_text("Taxi-v4").layout is None


class Ledge(gymnasium.Env):
    """2 x 2 cells; state 3 is entered alive from 1 and by termination from 2, and so has a twin; 0 ends nowhere else."""

    observation_space, action_space = gymnasium.spaces.Discrete(4), gymnasium.spaces.Discrete(1)
    initial_state_distrib = np.array([1.0, 0.0, 0.0, 0.0])
    P = {
        0: {0: [(0.5, 1, 0.0, False), (0.5, 2, 0.0, False)]},
        1: {0: [(1.0, 3, 0.0, False)]},
        2: {0: [(1.0, 3, 1.0, True)]},
        3: {0: [(1.0, 2, 0.0, False)]},
    }

    def __init__(self, shape):
        self.shape = shape


def test_a_twin_lies_where_its_state_lies():
    mdp = FiniteMDP.from_gymnasium(Ledge((2, 2)))
    assert mdp.terminal_state[3] == 4
    assert_array_equal(mdp.layout, [[0, 0], [0, 1], [1, 0], [1, 1], [1, 1]])


@pytest.mark.parametrize("shape", [(4,), (2, 3), (4, None), "2x2", None])
def test_what_is_no_map_of_the_states_is_left(shape):
    assert FiniteMDP.from_gymnasium(Ledge(shape)).layout is None


# ---------------------------------------------------------------- displacements


def by_hand(mdp, places):
    """(kind -> sum of P, kind of each entry), entry by entry."""
    mass, kinds = {}, []
    matrix = mdp.transitions
    for row in range(matrix.shape[0]):
        for j in range(matrix.indptr[row], matrix.indptr[row + 1]):
            step = places[matrix.indices[j]] - places[row // mdp.n_actions]
            kind = tuple(float(x) for x in np.round(step, 9) + 0.0)
            mass[kind] = mass.get(kind, 0.0) + matrix.data[j]
            kinds.append(kind)
    return mass, kinds


@given(rngs)
def test_displacements_against_entry_by_entry(rng):
    mdp = random_mdp(rng)
    places = rng.integers(0, 3, size=(mdp.n_states, int(rng.integers(1, 4)))) / 10.0  # .3 - .2 is not .1
    for found, expected in (
        (displacements(mdp.with_layout(places)), places),
        (displacements(mdp, layout=places), places),
        (displacements(mdp.with_layout(places + 1.0), layout=places), places),
        (displacements(mdp), np.arange(mdp.n_states)[:, None]),
    ):
        kinds, kind = found
        mass, each = by_hand(mdp, expected)
        assert [tuple(kinds[k]) for k in kind] == each
        assert len(kinds) == len(mass)
        order = sorted(mass, key=lambda d: (-round(mass[d], 9), d))
        assert [tuple(row) for row in kinds] == order
        assert kind.dtype == np.int64


def test_masses_that_differ_by_rounding_alone_are_equal():
    """One step ahead has .1 + .2, more than .3 in its last digit; one step back has .3 and comes first, as the smaller."""
    mdp = FiniteMDP([[[0.9, 0.1, 0]], [[0, 0.8, 0.2]], [[0, 0.3, 0.7]]], np.zeros(3), [1, 0, 0], 0.9)
    assert 0.1 + 0.2 > 0.3
    assert_array_equal(displacements(mdp)[0], [[0], [-1], [1]])


def test_no_minus_zero_and_no_two_of_one():
    mdp = three(layout=[0.3, 0.3 + 1e-10, 0.3 - 1e-10])
    kinds, kind = displacements(mdp)
    assert kinds.tolist() == [[0.0]]
    there_and_back = FiniteMDP([[[0.0, 1.0]], [[1.0, 0.0]]], [0, 0], [1, 0], 0.9, layout=[1e-10, 0.0])
    assert not np.signbit(displacements(there_and_back)[0]).any()
    assert_array_equal(kind, np.zeros(4))
    assert len(displacements(three(layout=[0.3, 0.3 + 2e-9, 0.3]))[0]) == 3


BAD = {
    "layout of another length": (
        partial(three, layout=PLACES[:2]),
        r"^layout must have shape \(3,\) or \(3, c\), a place ",
    ),
    "of no coordinates": (partial(three, layout=np.zeros((3, 0))), r"layout must .*; it has shape \(3, 0\)$"),
    "of three dimensions": (
        partial(three, layout=np.zeros((3, 1, 1))),
        r"layout must have 1 or 2 dimension\(s\); it has",
    ),
    "a number": (partial(three, layout=3.0), r"layout must have 1 or 2 dimension\(s\); it has shape \(\)"),
    "nan": (partial(three, layout=[[0, 1], [2, np.nan], [0, 0]]), r"^layout\[1, 1\] must be finite; it is nan$"),
    "infinite": (partial(three, layout=[0, 1, -np.inf]), r"^layout\[2\] must be finite; it is -inf$"),
    "words": (partial(three, layout=["a", "b", "c"]), r"^layout must be an array of numbers; got list"),
    "complex": (
        partial(three, layout=[1j, 2, 3]),
        r"^layout must be an array of numbers; got list \(complex numbers\)",
    ),
    "of another length later": (lambda: three().with_layout([1, 2]), r"^layout must have shape \(3,\)"),
    "of displacements": (lambda: displacements(three(), layout=[1, 2]), r"^layout must have shape \(3,\)"),
    "nan of displacements": (lambda: displacements(three(), layout=[1, 2, np.nan]), r"^layout\[2\] must be finite"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_layouts(name):
    call, text = BAD[name]
    with pytest.raises(ValueError, match=text):
        call()
