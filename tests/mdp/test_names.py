"""Names of states and actions: checked, kept by whatever makes an MDP of the same
states, found again, and spoken.
"""

import pickle
import re
import unicodedata
from dataclasses import replace

import numpy as np
import pytest
from helpers import ACTIONS, ROWS, STATES, random_mdp, rngs
from hypothesis import given
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.mdp import displacements
from oee_tabular.mdp.naming import Names, name_text, number_of, numbers_of
from oee_tabular.testing import case


def three(**changes):
    """hall -> room -> dock, where it is over."""
    return FiniteMDP(
        ROWS,
        [-1.0, -1, 0],
        0,
        0.9,
        **{"state_names": STATES, "action_names": ACTIONS} | changes,
    )


def test_they_are_tuples_of_plain_python():
    mdp = three(
        state_names=np.array(["a", "b", "c"]),
        action_names=[("x", np.int64(1)), ("y", [np.float64(0.5)])],
    )
    assert mdp.state_names == ("a", "b", "c")
    assert mdp.action_names == (("x", 1), ("y", (0.5,)))
    assert [type(name) for name in mdp.state_names] == [str] * 3
    assert type(mdp.action_names[0][1]) is int
    assert mdp.with_names(action_names=["a", "b"]).names == Names(None, ("a", "b"))


def test_texts_that_files_might_trim_survive(tmp_path):
    odd = ("a\0", 'say "x"', ("ü\u2028x", 1))
    three(state_names=odd).save(tmp_path / "m.npz")
    assert FiniteMDP.load(tmp_path / "m.npz").state_names == odd


@pytest.mark.parametrize(
    ("initial", "law"),
    [
        ("hall", [1, 0, 0]),
        (("room", 1), [0, 1, 0]),
        (2, [0, 0, 1]),
        (np.int64(1), [0, 1, 0]),
        (np.array(0), [1, 0, 0]),
        ({"hall": 0.25, ("room", 1): 0.5, 2: 0.25}, [0.25, 0.5, 0.25]),
        ((0.5, 0.0, 0.5), [0.5, 0, 0.5]),
        ([0, 1, 0], [0, 1, 0]),
        ("('room', 1)", [0, 1, 0]),
    ],
)
def test_a_first_state(initial, law):
    assert_array_equal(
        FiniteMDP(ROWS, [0, 0, 0], initial, 0.9, state_names=STATES).initial, law
    )


def test_a_number_or_a_name():
    items = ("dock", ("room", 1), ["room", 1], "('room', 1)", 2)
    assert [number_of(item, STATES, 3, "x") for item in items] == [2, 1, 1, 1, 2]
    for item, text in (
        (True, r"x must be a name or a number; it is True$"),
        (1.0, r"x must be a name or a number; it is 1\.0$"),
        (
            "dok",
            r"x must be one of the MDP's names; it is 'dok' \(did you mean 'dock'\?\)$",
        ),
        (
            ("room", 2),
            r"x must be one of .*\('room', 2\) \(did you mean \('room', 1\)\?\)$",
        ),
    ):
        with pytest.raises(ValueError, match=f"^{text}"):
            number_of(item, STATES, 3, "x")
    with pytest.raises(
        ValueError, match=r"\(they are 's0', 's1', 's2', 's3', 's4', \.\.\.\)$"
    ):
        number_of("quux", tuple(f"s{k}" for k in range(6)), 6, "x")
    assert (name_text(STATES, 3), name_text(STATES, -1), name_text(None, 1)) == (
        "3",
        "-1",
        "1",
    )


def test_a_name_is_found_without_looking_through_all():
    """A lookup is made once for an MDP's names, not once a state: a policy by name of
    20 000 states takes no minutes.
    """
    names = tuple(f"s{k}" for k in range(20_000))
    assert [
        numbers_of(((0, 1), "(0,1)", (1, 0)))[text]
        for text in ("(0, 1)", "(0,1)", "(1,0)")
    ] == [0, 1, 2]
    assert numbers_of(names) is numbers_of(names)
    assert numbers_of(names)["s19999"] == 19_999


# ---------------------------------------------------------------- sentences


def test_sentences_speak_names():
    """Advice sets names of several words off."""
    mdp = three().with_names([STATES[0], STATES[1], "dock 1"], ACTIONS)
    moves = (
        [("hall", "go", ("room", 1))] * 6
        + [(("room", 1), "go", "dock 1")] * 3
        + [("hall", "go", "hall")] * 4
    )
    log = oee.Transitions(*zip(*moves, strict=True), np.full(13, -2.0))
    problem = oee.Problem(mdp, log)
    assert (
        "s=hall, a=go -> s'=('room', 1) is -2 in the log, -1 in the simulator"
        in str(problem.reward_conflict)
    )
    report = oee.evaluate(problem, {"run": ["go"] * 3}, estimators=["oee"], seed=0)
    assert (
        "To narrow the interval, record action go in state ('room', 1)"
        " first (3 transitions so far" in report.uncertainty.sentences[-1]
    )
    assert "('room', 1)" in report.to_html()
    plan = str(oee.plan_data_collection(problem, ["go"] * 3, n=10))
    assert "largest shares: action go in state ('room', 1)" in plan
    assert re.search(r"then the next \d+: action go in state \('room', 1\)", plan)
    unseen = oee.evaluate(problem, {"run": ["stay"] * 3}, estimators=["oee"], seed=0)
    assert "s=hall, a=stay" in str(unseen.records()) + " ".join(unseen.warnings)
    spaced = mdp.with_names(["day shift", *STATES[1:]], ["call in", "stay"])
    advice = oee.evaluate(
        oee.Problem(spaced, oee.Transitions([1], [0], [2])), [0] * 3, estimators=["oee"]
    ).uncertainty.next
    assert "action “call in” in state “day shift” first: it was never" in advice


# ---- coordinates of states: their forms, and the displacements that transitions from
# different states share
PLACES = np.array([[0.5, -1.0], [2.0, 3.0], [7.0, 7.0]])


def placed(layout=PLACES):
    """0 goes on or stays, 1 goes on, 2 is closed."""
    rows = np.array([[[0.25, 0.75, 0.0]], [[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]])
    return FiniteMDP(rows, np.ones((3, 1)), [1, 0, 0], 0.9, layout=layout)


def test_one_number_or_several_a_state():
    assert_array_equal(placed(layout=[1, 5, 2]).layout, [[1.0], [5.0], [2.0]])
    assert_array_equal(placed().layout, PLACES)
    assert placed().layout.dtype == np.float64
    assert placed(layout=None).layout is None


def test_a_grids_shape():
    chain = FiniteMDP(np.eye(6)[:, None], np.zeros(6), 0, 0.9, layout=(2, 3))
    assert chain.layout.tolist() == [[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]
    assert chain.with_layout((np.int64(3), 2)).layout[-1].tolist() == [2, 1]
    grid = oee.tasks.gridworld(3, 0.3)
    assert_array_equal(grid.layout, [divmod(s, 3) for s in range(9)])
    assert_array_equal(grid.with_layout((3, 3)).layout, grid.layout)
    log = oee.Transitions([0, 1], [0, 0], [1, 2], [0.0, 1.0], terminated=[0, 1])
    assert FiniteMDP.from_log(log, initial=0, layout=(1, 3)).layout.tolist() == [
        [0, 0],
        [0, 1],
        [0, 2],
    ]
    two = FiniteMDP(np.eye(2)[:, None], np.zeros(2), 0, 0.9)
    assert two.with_layout((2, 1)).layout.tolist() == [[0, 0], [1, 0]]
    assert two.with_layout((5, 7)).layout.tolist() == [[5], [7]]  # places of two states


def test_coordinates_in_names_are_a_layout_where_none_is_given(tmp_path):
    named = placed(layout=None).with_names([(0, 0.5), (1, 0.5), (1, -2)])
    assert_array_equal(named.layout, [[0, 0.5], [1, 0.5], [1, -2]])
    named.save(tmp_path / "named.npz")
    assert_array_equal(FiniteMDP.load(tmp_path / "named.npz").layout, named.layout)
    assert_array_equal(
        pickle.loads(pickle.dumps(named)).with_discount(0.5).layout, named.layout
    )
    assert_array_equal(named.with_names([(7,), (8,), (9,)]).layout, [[7], [8], [9]])
    # a given one comes first
    assert_array_equal(named.with_layout(PLACES).layout, PLACES)
    assert_array_equal(named.with_layout(PLACES).with_layout(None).layout, named.layout)
    longer = [(0, 0), (0, 1), (0, 1, 2)]
    text = [(0, 0), (0, 1), "dock"]
    digits = [(0,), ("1",), (2,)]
    for names in (
        longer,
        text,
        digits,
        [(0, (1,)), (1, (1,)), (2, (1,))],
        [(10**400,), (1,), (2,)],
        "abc",
    ):
        assert named.with_names(list(names)).layout is None


def test_other_numbers_of_the_states_take_layout_and_names_along():
    pair = case("ragged")
    names = [f"s{k}" for k in range(pair.simulator.n_states)]
    order = np.roll(np.arange(len(names)), 1)
    simulator = pair.simulator.with_layout(10 * np.arange(len(names))).with_names(names)
    renamed = replace(
        pair, simulator=simulator, target=pair.target.with_layout(None)
    ).relabelled(order, np.arange(simulator.n_actions))
    assert_array_equal(renamed.simulator.layout[order], simulator.layout)
    assert [renamed.simulator.state_names[k] for k in order] == names
    assert renamed.target.layout is None


# ---------------------------------------------------------------- displacements


def list_displacements(mdp, places):
    """(displacement -> sum of P, displacement of each entry), entry by entry."""
    mass = {}
    each = []
    matrix = mdp.transitions
    for row in range(matrix.shape[0]):
        for j in range(matrix.indptr[row], matrix.indptr[row + 1]):
            step = places[matrix.indices[j]] - places[row // mdp.n_actions]
            each.append(tuple(float(x) for x in np.round(step, 9) + 0.0))
            mass[each[-1]] = mass.get(each[-1], 0.0) + matrix.data[j]
    return mass, each


@given(rngs)
def test_displacements_against_entry_by_entry(rng):
    mdp = random_mdp(rng)
    # .3 - .2 is not .1
    places = rng.integers(0, 3, size=(mdp.n_states, int(rng.integers(1, 4)))) / 10.0
    for found, expected in (
        (displacements(mdp.with_layout(places)), places),
        (displacements(mdp.with_layout(places + 1.0), layout=places), places),
        (displacements(mdp), np.arange(mdp.n_states)[:, None]),
    ):
        kinds, kind = found
        mass, each = list_displacements(mdp, expected)
        assert [tuple(kinds[k]) for k in kind] == each
        assert [tuple(row) for row in kinds] == sorted(
            mass, key=lambda d: (-round(mass[d], 9), d)
        )
        assert kind.dtype == np.int64


def test_masses_that_differ_by_rounding_alone_are_equal():
    """One step ahead has .1 + .2, more than .3 in its last digit; one step back has .3
    and comes first, as the smaller.
    """
    mdp = FiniteMDP(
        [[[0.9, 0.1, 0]], [[0, 0.8, 0.2]], [[0, 0.3, 0.7]]], np.zeros(3), [1, 0, 0], 0.9
    )
    assert 0.1 + 0.2 > 0.3
    assert_array_equal(displacements(mdp)[0], [[0], [-1], [1]])


def test_no_minus_zero_and_no_two_of_one():
    kinds, kind = displacements(placed(layout=[0.3, 0.3 + 1e-10, 0.3 - 1e-10]))
    assert kinds.tolist() == [[0.0]]
    assert_array_equal(kind, np.zeros(4))
    assert not np.signbit(kinds).any()
    assert len(displacements(placed(layout=[0.3, 0.3 + 2e-9, 0.3]))[0]) == 3


# ---- Unicode
SPELLINGS = [
    ("caf\u00e9", "cafe\u0301"),
    ("\u212b", "\u00c5"),
    ("\uac00", "\u1100\u1161"),
]


@pytest.mark.parametrize(("one", "other"), SPELLINGS)
def test_a_name_is_found_in_every_form_of_unicode(one, other):
    P = np.full((2, 2, 2), 0.5)
    for kept, asked in ((one, other), (other, one)):
        mdp = oee.FiniteMDP(
            P, [0.0, 1.0], asked, 0.9, state_names=[kept, "b"], action_names=[kept, "x"]
        )
        assert mdp.state_names == (unicodedata.normalize("NFC", one), "b")
        policy = {asked: asked, "b": "x"}
        assert oee.mdp.check_policy(policy, mdp).tolist() == [[1, 0], [0, 1]]
        log = oee.Transitions([asked, "b"], [asked, asked], ["b", kept])
        assert log.numbered(mdp).state.tolist() == [0, 1]
        mixed = oee.Transitions([asked, kept], ["x", "x"], ["b", "b"])
        assert len(mixed.state_names) == 2
    nested = oee.FiniteMDP(P, [0.0, 1.0], 0, 0.9, state_names=[(one, 1), (one, 2)])
    assert nested.with_initial((other, 2)).initial.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        *SPELLINGS,
        ("hall", "h\u0430ll"),
        ("a b", "a\u00a0b"),
        ("ab", "a\u200bb"),
        ("ab", "a\u00adb"),
        ("a-b", "a\u2011b"),
        ("\u0391", "A"),
        ("x", "x\ufe0f"),
        ((0, "hall"), (0, "h\u0430ll")),
    ],
)
def test_names_that_look_alike_are_refused(one, other):
    with pytest.raises(
        ValueError, match=r"action_names must differ; action_names\[1\]"
    ):
        oee.FiniteMDP(
            np.full((2, 2, 2), 0.5), [0.0, 1.0], 0, 0.9, action_names=[one, other]
        )


def test_a_name_in_other_characters_is_shown_as_such():
    mdp = oee.FiniteMDP(
        np.eye(2)[:, None], [0.0, 1.0], 0, 0.9, state_names=["hall", "b"]
    )
    with pytest.raises(ValueError, match=r"looks like 'hall', .*'h\\u0430ll'"):
        mdp.with_initial("h\u0430ll")


def test_names_that_differ_to_the_eye_stay_different():
    names = ["x²", "x2", "ﬁt", "fit", "Hall", "hall", "ä", "a"]
    mdp = oee.FiniteMDP(np.eye(8)[:, None], np.zeros(8), 0, 0.9, state_names=names)
    assert mdp.state_names == tuple(names)
