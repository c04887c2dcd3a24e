"""Names of states that may be misspellings of others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import oee_tabular as oee
from oee_tabular.exceptions import DataWarning
from oee_tabular.mdp.naming import find_misspelt, find_misspelt_ends

WORDS = st.text("abcdefghklmnopqrstuwyz", min_size=5, max_size=9)


@given(WORDS, st.integers(0, 8), st.sampled_from(["drop", "add", "change", "swap"]))
def test_one_edit_is_found(word, place, edit):
    k = place % (len(word) - 1)
    made = {
        "drop": word[:k] + word[k + 1 :],
        "add": word[:k] + "q" + word[k:],
        "change": word[:k] + "q" + word[k + 1 :],
        "swap": word[:k] + word[k + 1] + word[k] + word[k + 2 :],
    }[edit]
    found = find_misspelt([made, "elsewhere"], [word, "another one"])
    # an "a" in front may negate
    is_other = made == word or word == f"a{made}"
    assert found == ({} if is_other else {made: [word]})


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("Depot", "depot"),
        ("loading  dock", "loading dock"),
        ("loading-dock", "Loading_Dock"),
        ("R2C2", "r2c2"),
        ("caf\u00e9 noir", "cafe\u0301 Noir"),
        ("\uff44\uff45\uff50\uff4f\uff54", "depot"),
        ("hall_2", "hlal_2"),
    ],
)
def test_other_forms_are_found(name, other):
    assert find_misspelt([name], [other]) == {name: [other]}


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("r2c2", "r2c1"),
        ("s10", "s1"),
        ("room_a", "room_b"),
        ("roomA", "roomB"),
        ("stage ii", "stage iii"),
        ("stage IIIA", "stage IIIB"),
        ("(-1, 0)", "(1, 0)"),
        ("x=\u22121", "x=1"),
        ("cell_+1_2", "cell_-1_2"),
        ("1001", "1002"),
        ("XVII", "XVIII"),
        ("healthy", "unhealthy"),
        ("asymptomatic", "symptomatic"),
        ("grade A+", "grade A-"),
        ("credit+", "credit-"),
        ("北京东站", "北京西站"),
        ("open", "opened"),
        ("end", "bed"),
        ("won", "now"),
        ("goal", "hall"),
        ("charged", "discharged"),
        ((0, 1), (0, 2)),
    ],
)
def test_names_of_their_own_are_not(name, other):
    assert find_misspelt([name], [name, other]) == {}


def test_many_names_take_little_time():
    names = [
        f"warehouse {k:b}".translate(str.maketrans("01", "pq")) for k in range(20_000)
    ]
    assert find_misspelt(["nowhere"], names) == {}


def samples(**columns):
    """Return the log of a way to the depot, of which one row is misspelt."""
    return oee.Transitions(
        ["hall", "hall", "depot", "door"],
        ["go"] * 4,
        ["depto", "depot", "hall", "hall"],
        [0.0, 0.0, 1.0, 0.0],
        **columns,
    )


def test_a_misspelt_next_state_of_samples_is_named():
    with pytest.warns() as told:
        mdp = oee.FiniteMDP.from_log(samples(), initial="hall", discount=0.9)
    texts = [str(each.message) for each in told if each.category is DataWarning]
    assert len(texts) == 1
    assert texts[0].startswith("log.next_state[0] 'depto' resembles the state 'depot'")
    assert "depto" in mdp.state_names


def test_a_state_that_ends_the_task_is_meant():
    terminated = np.array([True, False, False, False])
    oee.FiniteMDP.from_log(samples(terminated=terminated), initial="hall", discount=0.9)


def test_a_code_that_resembles_several_states_is_none():
    """Nine squares of a game: the end of it is one move from many boards."""
    names = ["xoxoxxoox", "xoxoxxoxx", "xoxoxxooo", "bold", "gold", "sold"]
    is_end = np.array([True, False, False, False, False, True])
    assert find_misspelt_ends(names, is_end, np.ones(6, dtype=int)) == []
    assert find_misspelt_ends(["depto", "depot"], is_end[:2], np.ones(2, dtype=int))
