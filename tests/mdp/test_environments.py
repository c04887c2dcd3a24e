"""What environments return: every form that can be read is read, and every other one is
an error that names the call, the state, the rule and the value.
"""

import importlib
import io
import warnings
from decimal import Decimal
from fractions import Fraction

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import (
    FlattenObservation,
    PassiveEnvChecker,
    TimeLimit,
    TransformAction,
)
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.exceptions import ArgumentError


class Line(gymnasium.Env):
    """Places 0 to 3, action 1 goes on, 3 is over; what it returns is changed by
    functions of it.
    """

    def __init__(self, **changes):
        self.changes = changes
        self.observation_space = changes.get("observations", spaces.Discrete(4))
        self.action_space = changes.get("actions", spaces.Discrete(2))

    def change(self, name, value):
        return self.changes.get(name, lambda same: same)(value)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return self.change("begin", (self.change("see", 0), {}))

    def step(self, action):
        self.change("act", (self.place, action))
        self.place = min(self.place + int(action), 3)
        result = (
            self.change("see", self.place),
            self.change("pay", -1.0),
            self.change("over", self.place == 3),
            self.change("cut", False),
            {},
        )
        return self.change("give", result)


def sample(env, **more):
    return FiniteMDP.from_env(env, samples_per_pair=2, seed=0, **more)


def record(env, **more):
    space = env.observation_space
    n = space.n + space.start if isinstance(space, spaces.Discrete) else 4
    return oee.record_episodes(env, np.full((n, 2), 0.5), n_episodes=3, seed=0, **more)


DOORS = [sample, record]
SAME = {
    "list": {"give": list},
    "no info": {"begin": lambda result: (result[0], None)},
    "float": {"see": float},
    "single": {"see": np.float32},
    "array of one": {"see": lambda place: np.array([place])},
    "array of none": {"see": np.array},
    "int8": {"see": np.int8},
    "reward 0-d": {"pay": np.array},
    "reward of shape (1, 1)": {"pay": lambda reward: np.array([[reward]])},
    "reward single": {"pay": np.float32},
    "reward int": {"pay": int},
    "reward decimal": {"pay": Decimal},
    "reward fraction": {"pay": Fraction},
    "over as a number": {"over": int},
    "over as an array": {"over": lambda over: np.array([over])},
    "over of numpy": {"over": np.bool_, "cut": np.bool_},
}


@pytest.mark.parametrize("name", SAME)
def test_other_forms_of_the_same_are_the_same(name):
    plain = sample(Line())
    other = sample(Line(**SAME[name]))
    assert_array_equal(other.transitions.toarray(), plain.transitions.toarray())
    assert_array_equal(other.rewards, plain.rewards)
    ours, theirs = record(Line()).columns(), record(Line(**SAME[name])).columns()
    for label, column in ours.items():
        assert_array_equal(theirs[label], column)


FORM = r"\(observation, reward, terminated, truncated, info\)"
REFUSED = {
    "4 values": (
        {"give": lambda r: (*r[:3], r[4])},
        rf"^env.step\([01]\) must return {FORM}; in state 0 it returns 4 values, .*old",
    ),
    "6 values": ({"give": lambda r: (*r, 0)}, "in state 0 it returns 6 values, "),
    "one value": ({"give": lambda r: r[0]}, "in state 0 it returns "),
    "bare reset": (
        {"begin": lambda r: r[0]},
        r"^env.reset must return \(observation, info\), info a dict; .* returns 0 \(old",
    ),
    "reset of a pair": ({"begin": lambda r: (0, 1)}, r"Line returns \(0, 1\)"),
    "reset of three": ({"begin": lambda r: (0, {}, {})}, r"Line returns \(0, \{\}, "),
    "no reward": ({"pay": lambda r: None}, "finite number as reward; .* gives None$"),
    "nan": ({"pay": lambda r: np.nan}, "finite number as reward; .* it gives nan$"),
    "infinite": ({"pay": lambda r: -np.inf}, "finite number as reward; .* -inf$"),
    "text": ({"pay": str}, "finite number as reward; in state 0 it gives '-1.0'$"),
    "complex": ({"pay": complex}, "finite number as reward; "),
    "masked": ({"pay": lambda r: np.ma.masked}, "finite number as reward; "),
    "two rewards": ({"pay": lambda r: np.array([r, r])}, "finite number as reward; "),
    "agents": ({"pay": lambda r: {"a": r}}, "finite .* several agents"),
    "over None": (
        {"over": lambda over: None},
        r"^env.step\([01]\) must give True or False as terminated; in state 0 it gives",
    ),
    "over text": ({"over": str}, "as terminated; in state 0 it gives 'False'$"),
    "over half": ({"over": lambda over: 0.5}, "as terminated; .* 0.5$"),
    "cut None": ({"cut": lambda cut: None}, "as truncated; in state 0 it gives None$"),
    "outside": (
        {"see": lambda place: 2 * place},
        r"must give an observation in env.observation_space, Discrete\(4\); in state 2 "
        "it gives 4$",
    ),
    "below": ({"see": lambda place: place - 1}, r"env.reset must give .* gives -1$"),
    "half": ({"see": lambda place: place + 0.5}, r"env.reset must give .* gives 0.5$"),
    "text in numbers": ({"see": str}, "gives '0'$"),
    "nothing": ({"see": lambda place: None}, "gives None$"),
    "lacking action": (
        {"act": lambda at: {0: 0}[at[1]]},
        r"^env.step\(1\) must not raise; in state 0 of Line it raises KeyError: 1 \(an",
    ),
    "own error": (
        {"act": lambda at: 1 / 0},
        "in state 0 of Line it raises ZeroDivisionError: division by zero$",
    ),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_step_is_named(name, door):
    changes, text = REFUSED[name]
    with pytest.raises(ArgumentError, match=text):
        door(Line(**changes))


@given(
    value=st.one_of(
        st.none(), st.text(), st.binary(), st.complex_numbers(), st.lists(st.floats())
    ),
    part=st.integers(1, 3),
)
def test_no_foreign_value_passes_as_a_reward_or_flag(value, part):
    def give(result):
        return (*result[:part], value, *result[part + 1 :])

    with pytest.raises(ArgumentError, match=r"^env.step\([01]\) must give "):
        record(Line(give=give))


@pytest.mark.parametrize("door", DOORS)
def test_an_environment_s_own_error_is_the_cause(door):
    with pytest.raises(ArgumentError) as caught:
        door(Line(act=lambda at: {}[at]))
    assert isinstance(caught.value.__cause__, KeyError)

    class Old(Line):
        def reset(self):
            return 0

    with pytest.raises(ArgumentError, match=r"^env.reset must take seed= .* TypeError"):
        door(Old())


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    ("make", "text"),
    [
        (
            lambda: gymnasium.make_vec("FrozenLake-v1", num_envs=3),
            "SyncVec.* steps 3 at",
        ),
        (lambda: Line(actions=spaces.Discrete(2, start=1)), r"a \+ 1, .*Discrete\(2\)"),
        (
            lambda: Line(actions=spaces.MultiDiscrete([2, 3])),
            r"\(2, 3\)\)\), .*te\(6\)",
        ),
        (
            lambda: Line(actions=spaces.MultiBinary(2)),
            r"must be Discrete, from 0; it is",
        ),
        (
            lambda: Line(actions=None),
            "env.action_space must be Discrete, from 0; it is N",
        ),
        (
            lambda: Line(observations=spaces.Discrete(4, start=-2)),
            r"must not begin below 0; .* s \+ 2",
        ),
    ],
)
def test_spaces_that_are_no_numbers_from_0_have_a_wrapper_as_remedy(make, text, door):
    with pytest.raises(ArgumentError, match=text):
        door(make())


def test_the_wrappers_of_the_remedies_work():
    flat = FlattenObservation(
        Line(
            see=lambda place: {"at": place},
            observations=spaces.Dict(at=spaces.Discrete(4)),
        )
    )
    assert sample(flat).n_states == 4
    shifted = Line(
        actions=spaces.Discrete(2, start=1), act=lambda at: {1: 0, 2: 0}[at[1]]
    )
    sample(TransformAction(shifted, lambda a: a + 1, spaces.Discrete(2)))
    with pytest.raises(ArgumentError, match="FlattenObservation"):
        sample(flat.env)


def test_numbers_that_begin_at_1_stay():
    env = Line(see=lambda place: place + 1, observations=spaces.Discrete(4, start=1))
    mdp = sample(env)
    assert mdp.n_states == 5
    assert mdp.initial.tolist() == [0, 1, 0, 0, 0]
    log = record(env)
    assert log.state.min() == 1
    oee.Problem(mdp, log)


def test_booleans_and_integers_without_a_space_are_numbers():
    two = {"see": lambda place: np.bool_(place > 0), "observations": None}
    assert len(sample(Line(**two)).terminal_state) == 2
    assert sample(Line(see=float, observations=None)).state_names is None


@pytest.mark.parametrize(
    ("see", "text"),
    [
        (lambda place: "0123"[place], "a name must not read as a number"),
        (lambda place: (np.nan, place), "tuple of texts and numbers; it is"),
        (lambda place: object(), "it gives <object"),
        (lambda place: place + 0.5, "it gives 0.5$"),
        (lambda place: b"a", "it gives b'a'$"),
        (
            lambda place: place or "hall",
            "numbers alone or names alone .* after 'hall'$",
        ),
    ],
)
def test_observations_that_are_no_states_are_refused_when_they_are_first_seen(
    see, text
):
    steps = []
    with pytest.raises(ArgumentError, match=text):
        sample(Line(see=see, observations=None, act=steps.append))
    assert len(steps) < 10


def test_wrappers_that_check_or_cut():
    assert sample(PassiveEnvChecker(Line())).n_states == 4
    assert sample(TimeLimit(Line(over=lambda over: False), 5)).n_states == 4
    old = TimeLimit(Line(give=lambda r: (*r[:3], r[4])), 5)
    with pytest.raises(ArgumentError, match=r"ValueError: .* without its wrappers"):
        sample(old)


def test_episodes_that_never_end_need_max_steps(monkeypatch):
    module = importlib.import_module("oee_tabular.tasks.toy_text")
    monkeypatch.setattr(module, "MAX_EPISODE_STEPS", 100)
    endless = {"over": lambda over: False}
    with pytest.raises(
        ArgumentError, match=r"^max_steps must be given .* after 100 st"
    ):
        record(Line(**endless))
    assert len(record(Line(**endless), max_steps=150)) == 450
    rows = np.full((4, 2), 0.5)
    log = oee.record_episodes(Line(**endless), rows, n_transitions=300, seed=0)
    assert len(log) == 300


def test_names_of_states_and_actions():
    named = sample(Line(), state_names=list("abcd"), action_names=["stay", "go"])
    assert named.state_names == ("a", "b", "c", "d")
    assert_array_equal(
        named.transitions.toarray(), sample(Line()).transitions.toarray()
    )
    texts = {"see": lambda place: "abcd"[place], "observations": None}
    reversed_ = sample(Line(**texts), state_names=list("xdcba"))
    assert reversed_.state_names == tuple("xdcba")
    assert reversed_.initial.tolist() == [0, 0, 0, 0, 1]
    free = {"observations": None}
    assert sample(Line(**free), state_names=list("abcde")).n_states == 5
    steps = []
    for env, more, text in (
        (Line(act=steps.append), {"state_names": list("abc")}, "must have 4 names"),
        (Line(act=steps.append), {"action_names": "a"}, "must be a sequence of texts"),
        (Line(act=steps.append), {"discount": np.nan}, "discount must be in"),
        (Line(**free), {"state_names": list("abc")}, "has the state 3; it has 3"),
        (Line(**texts), {"state_names": list("abcx")}, "'d' is not there"),
    ):
        with pytest.raises(ArgumentError, match=text):
            sample(env, **more)
    assert not steps  # what can be known before the first step is


def test_progress_is_shown_on_a_terminal_alone(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr("oee_tabular._progress.SECONDS", 0.0)
    shown = []
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr("sys.stderr", stream)
        FiniteMDP.from_env(
            Line(), samples_per_pair=600, seed=0, state_names=list("abcd")
        )
        shown.append(stream.getvalue())
    assert "sampling" in shown[0]
    assert shown[1] == ""


# ---------------------------------------------------------------- tables


class Toy:
    """A table of two states and two actions, with changes."""

    def __init__(self, s=0, a=0, outcomes=None, **facts):
        self.P = {
            s: {a: [(0.5, 0, 1.0, False), (0.5, 1, 0.0, False)] for a in range(2)}
            for s in range(2)
        }
        if outcomes is not None:
            self.P[s][a] = outcomes
        self.initial_state_distrib = [1.0, 0.0]
        vars(self).update(facts)


def lacking(**gone):
    toy = Toy()
    for name, value in gone.items():
        del {"state": toy.P, "action": toy.P[1]}[name][value]
    return toy


TABLES = [
    (Toy(1, 1, [(0.9, 0, 0.0, False)]), r"P\[1\]\[1\] must .* sum to 1 .* sum to 0.9"),
    (
        Toy(0, 1, [(-0.001, 0, 0.0, False), (1.0, 1, 0.0, False)]),
        r"P\[0\]\[1\]\[0\] must have a probability in \[0, 1\]; it has -0.001",
    ),
    (Toy(0, 1, [(np.nan, 0, 0.0, False)]), "must have a probability .*; it has nan"),
    (Toy(0, 1, [("1", 0, 0.0, False)]), "must have a probability .*; it has '1'"),
    (Toy(0, 1, [(1.0, 0, 0.0)]), r"must be \(probability, next state, reward, term"),
    (Toy(0, 1, (1.0, 0, 0.0, False)), r"P\[0\]\[1\]\[0\] must be \(prob.*; it is 1.0"),
    (Toy(P=np.full((2, 2, 2), 0.5)), r"FiniteMDP\(transitions, rewards, initial"),
    (
        Toy(0, 1, {}, P={0: {0: []}, 1: {}}),
        r"P\[0\] must have an action .*; state 0 has",
    ),
    (Toy(0, 1, 7), r"an entry for each outcome; it is 7"),
    (Toy(0, 1, [(1.0, 2, 0.0, False)]), r"lead to a state in 0..1; it leads to 2"),
    (Toy(0, 1, [(1.0, -1, 0.0, False)]), r"lead to a state in 0..1; it leads to -1"),
    (Toy(0, 1, [(1.0, 0.5, 0.0, False)]), r"lead to a state in 0..1; it leads to 0.5"),
    (Toy(0, 1, [(1.0, 0, "2", False)]), r"must have a finite reward; it has '2'"),
    (Toy(0, 1, [(1.0, 0, np.inf, False)]), r"must have a finite reward; it has inf"),
    (Toy(0, 1, [(1.0, 0, 0.0, None)]), r"True or False as terminated; it has None"),
    (
        Toy(P=[[Toy().P[0][0]] * 2, [Toy().P[1][0]]]),
        r"P\[1\] must have the actions 0..1; it lacks 1 .*\[1\]\[1\] = \[\]",
    ),
    (lacking(state=0), r"P must have the states 0..0; it lacks 0; its keys are \[1\]"),
    (
        Toy(1, 2, [(1.0, 0, 0.0, False)], action_space=spaces.Discrete(2)),
        r"P\[1\] must have actions in 0..1; it has 3: \[",
    ),
    (Toy(P="table"), r"P must be a dict or list with an entry for each state"),
    (Toy(P={}), r"P must be a dict or list with an entry for each state; it is \{\}"),
    (Toy(observation_space=spaces.Discrete(3)), r"P must have the 3 states of env.obs"),
    (
        Toy(action_space=spaces.Discrete(3)),
        r"each action 0..2 .* no state has action 2",
    ),
    (Toy(initial_state_distrib=[1.0]), r"^env.initial_state_distrib must have shape"),
    (
        Toy(initial_state_distrib=[0.5, 0.4]),
        r"^env.initial_state_distrib must sum to 1",
    ),
    (
        "FrozenLake-v1",
        r"^env must be a Gymnasium environment; .*make\('FrozenLake-v1'\)",
    ),
    (Toy, r"got the class Toy \(make one: Toy\(\)\)"),
]


@pytest.mark.parametrize(("env", "text"), TABLES)
def test_entries_of_a_table_that_break_a_rule_are_named(env, text):
    with pytest.raises(ArgumentError, match=text):
        FiniteMDP.from_gymnasium(env)


def test_tables_in_other_forms():
    plain = FiniteMDP.from_gymnasium(Toy())
    listed = Toy(P=[[Toy().P[s][a] for a in range(2)] for s in range(2)])
    arrays = Toy(P=[[np.array(pair) for pair in row] for row in listed.P])
    old = Toy(isd=[1.0, 0.0])
    del old.initial_state_distrib
    for env in (listed, arrays, old):
        other = FiniteMDP.from_gymnasium(env)
        assert_array_equal(other.transitions.toarray(), plain.transitions.toarray())
        assert_array_equal(other.rewards, plain.rewards)
    third = np.float32(1.0) / np.float32(3.0)
    single = [(third, 0, 0.0, False), (third, 1, 0.0, False), (third, 1, 0.0, False)]
    mdp = FiniteMDP.from_gymnasium(Toy(0, 1, single))
    assert abs(mdp.transitions.toarray()[1] - [1 / 3, 2 / 3]).max() < 1e-7


def test_no_warning_of_python_s_own_is_made():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ArgumentError):
            record(Line(pay=lambda reward: np.ma.masked))
