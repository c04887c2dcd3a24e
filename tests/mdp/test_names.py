"""Names of states and actions: checked, kept by whatever makes an MDP of the same states, found again, and spoken."""

import numpy as np
import pytest
from helpers import ACTIONS, ROWS, STATES
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.mdp.naming import Names, name_text, number_of, numbers_of


def three(**changes):
    """hall -> room -> dock, where it is over."""
    return FiniteMDP(ROWS, [-1.0, -1, 0], 0, 0.9, **{"state_names": STATES, "action_names": ACTIONS} | changes)


def test_they_are_tuples_of_plain_python():
    mdp = three(state_names=np.array(["a", "b", "c"]), action_names=[("x", np.int64(1)), ("y", [np.float64(0.5)])])
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
    [("hall", [1, 0, 0]), (("room", 1), [0, 1, 0]), (2, [0, 0, 1]), (np.int64(1), [0, 1, 0]), (np.array(0), [1, 0, 0]),
     ({"hall": 0.25, ("room", 1): 0.5, 2: 0.25}, [0.25, 0.5, 0.25]), ((0.5, 0.0, 0.5), [0.5, 0, 0.5]),
     ([0, 1, 0], [0, 1, 0]), ("('room', 1)", [0, 1, 0])],
)  # fmt: skip
def test_a_first_state(initial, law):
    assert_array_equal(FiniteMDP(ROWS, [0, 0, 0], initial, 0.9, state_names=STATES).initial, law)


def test_a_number_or_a_name():
    items = ("dock", ("room", 1), ["room", 1], "('room', 1)", 2)
    assert [number_of(item, STATES, 3, "x") for item in items] == [2, 1, 1, 1, 2]
    for item, text in (
        (True, r"x must be a name or a number; it is True$"),
        (1.0, r"x must be a name or a number; it is 1\.0$"),
        ("dok", r"x must be one of the MDP's names; it is 'dok' \(did you mean 'dock'\?\)$"),
        (("room", 2), r"x must be one of .*\('room', 2\) \(did you mean \('room', 1\)\?\)$"),
    ):
        with pytest.raises(ValueError, match=f"^{text}"):
            number_of(item, STATES, 3, "x")
    with pytest.raises(ValueError, match=r"\(they are 's0', 's1', 's2', 's3', 's4', \.\.\.\)$"):
        number_of("quux", tuple(f"s{k}" for k in range(6)), 6, "x")
    assert (name_text(STATES, 3), name_text(STATES, -1), name_text(None, 1)) == ("3", "-1", "1")


def test_a_name_is_found_without_looking_through_all():
    """A lookup is made once for an MDP's names, not once a state: a policy by name of 20 000 states takes no minutes."""
    names = tuple(f"s{k}" for k in range(20_000))
    assert [numbers_of(((0, 1), "(0,1)", (1, 0)))[text] for text in ("(0, 1)", "(0,1)", "(1,0)")] == [0, 1, 2]
    assert numbers_of(names) is numbers_of(names)
    assert numbers_of(names)["s19999"] == 19_999


# ---------------------------------------------------------------- sentences


def test_sentences_speak_names():
    """Advice sets names of several words off."""
    mdp = three().with_names([STATES[0], STATES[1], "dock 1"], ACTIONS)
    moves = [("hall", "go", ("room", 1))] * 6 + [(("room", 1), "go", "dock 1")] * 3 + [("hall", "go", "hall")] * 4
    log = oee.Transitions(*zip(*moves, strict=True), np.full(13, -2.0))
    problem = oee.Problem(mdp, log)
    assert "s=hall, a=go -> s'=('room', 1) is -2 in the log, -1 in the simulator" in str(problem.reward_conflict)
    report = oee.evaluate(problem, {"run": ["go"] * 3}, estimators=["oee"], seed=0)
    assert "Record action go in state ('room', 1) first (3 transitions so far" in report.uncertainty.sentences[-1]
    assert "('room', 1)" in report.to_html()
    plan = str(oee.plan_data_collection(problem, ["go"] * 3, n=10))
    assert "largest shares: action go in state ('room', 1)" in plan
    assert "then one transition each: action go in state ('room', 1), " in plan
    unseen = oee.evaluate(problem, {"run": ["stay"] * 3}, estimators=["oee"], seed=0)
    assert "s=hall, a=stay" in str(unseen.records()) + " ".join(unseen.warnings)
    spaced = mdp.with_names(["day shift", *STATES[1:]], ["call in", "stay"])
    advice = oee.evaluate(
        oee.Problem(spaced, oee.Transitions([1], [0], [2])), [0] * 3, estimators=["oee"]
    ).uncertainty.next
    assert "action “call in” in state “day shift” first (never recorded)." in advice
