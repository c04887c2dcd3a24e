"""Any Gymnasium environment: physics by name, states that are found or refused, its log
evaluated end to end.
"""

import json

import gymnasium
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.continuous.evaluation.policies import as_probabilities
from oee_tabular.continuous.task.base import Chance, check_probabilities
from oee_tabular.continuous.task.gymnasium_named import (
    action_set,
    gymnasium_simulator,
    gymnasium_spec,
)
from oee_tabular.report import Settings, evaluate_continuous
from oee_tabular.tasks import (
    GymnasiumTask,
    ResidualSimulator,
    monte_carlo_value,
    record,
)

CLASSIC = {
    "CartPole-v1:gravity=12,length=0.65": (
        4,
        {"gravity": 12, "length": 0.65, "polemass_length": 0.065},
    ),
    "Pendulum-v1,g=9.0,m=1.2": (2, {"g": 9.0, "m": 1.2}),
    "MountainCar-v0:gravity=0.0027": (2, {"gravity": 0.0027}),
    "MountainCarContinuous-v0:power=0.001": (2, {"power": 0.001}),
    "Acrobot-v1:LINK_MASS_2=1.3": (4, {"LINK_MASS_2": 1.3}),
}

SWING = """
import numpy as np

def swing(states):
    angle, speed = (states[:, 0] + np.pi) % (2 * np.pi) - np.pi, states[:, 1]
    energy = speed**2 / 6 + 5 * (np.cos(angle) - 1)
    torque = np.where(np.abs(angle) < 0.6, -8 * angle - 2 * speed, np.where(energy < 0, 2, -2) * np.sign(speed))
    return np.clip(torque, -2, 2)

def explore(states):
    spread = np.column_stack([np.interp(swing(states), [-2, -1, 0, 1, 2], one) for one in np.eye(5)])
    return 0.7 * spread + 0.3 / 5

def get(env):
    return env.unwrapped.state

def put(env, state):
    env.unwrapped.state = np.array(state)

def half(env):
    return env.unwrapped.state[:1]

def put_half(env, state):
    env.unwrapped.state = np.array([state[0], env.unwrapped.state[1]])
"""


@pytest.fixture
def mine(run, tmp_path, monkeypatch):
    """A module of one's own in the current directory."""
    (tmp_path / "swinging.py").write_text(SWING)
    monkeypatch.delitem(__import__("sys").modules, "swinging", raising=False)
    return tmp_path


# ---------------------------------------------------------------- physics and states


def test_a_family_keeps_the_physics_that_were_given():
    one, both = (
        gymnasium_simulator(f"CartPole-v1:gravity=12{more}").task
        for more in ("", ",length=0.65")
    )
    member = one.family(length=0.65)
    assert member.parameters() == both.parameters()
    arguments = np.array([[0.1, 0.2, 0.05, -0.3]]), np.array([1]), np.zeros((1, 0))
    assert_array_equal(
        member.moves(*arguments).next_state, both.moves(*arguments).next_state
    )


@pytest.mark.parametrize("spec", CLASSIC)
def test_physics_by_key_and_value(spec):
    """Constants are those that were asked for, and what is computed of them follows; a
    step is the environment's own.
    """
    simulator = gymnasium_simulator(spec)
    d, constants = CLASSIC[spec]
    inner = simulator.task._env.unwrapped
    assert {key: getattr(inner, key) for key in constants} == pytest.approx(constants)
    assert simulator.task.n_state == d
    identifier, physics = gymnasium_spec(spec)
    assert physics.items() <= constants.items()
    plain = gymnasium_simulator(identifier)
    log = record(
        simulator.task,
        simulator.policy("uniform"),
        n_transitions=40,
        max_steps=20,
        seed=0,
    )
    moved = [
        task.moves(log.state, log.action, np.zeros((40, 0))).next_state
        for task in (simulator.task, plain.task)
    ]
    assert_array_equal(moved[0], log.next_state)
    assert np.abs(moved[1] - moved[0]).max() > 0
    assert simulator.task.parameters() == physics


def test_where_a_state_is_over_is_what_the_steps_say():
    for spec, states in {
        "CartPole-v1": [[2.5, 0, 0, 0], [0, 0, 0.3, 0], [0, 0, 0, 0]],
        "MountainCar-v0": [[0.52, 0.03], [0.4, 0.03], [-0.5, 0.0]],
        "Acrobot-v1": [[3.0, 0.1, 0, 0], [1.0, 0.1, 0, 0], [0.0, 0.0, 0, 0]],
    }.items():
        task = gymnasium_simulator(spec).task
        log = record(
            task,
            lambda s, n=task.n_actions: np.full((len(s), n), 1 / n),
            n_transitions=600,
            max_steps=500,
            seed=1,
        )
        assert_array_equal(task.terminated(log.next_state), log.terminated)
        assert task.terminated(np.array(states, dtype=float)).tolist()[-1] is False
        assert task.terminated(np.array(states, dtype=float)).any()


@pytest.mark.parametrize("spec", ["CartPole-v1:gravity=12", "Pendulum-v1:g=9"])
def test_many_states_step_as_one_does(spec):
    """By environments that step together, or by formulas that take arrays."""
    simulator = gymnasium_simulator(spec)
    task = simulator.task
    rng = np.random.default_rng(0)
    assert task.steps_at_once
    log = record(
        task, simulator.policy("uniform"), n_transitions=300, max_steps=100, seed=0
    )
    many = task.step(log.state, log.action, rng)
    one = [
        task.step(log.state[i : i + 1], log.action[i : i + 1], rng) for i in range(300)
    ]
    assert_allclose(
        many.next_state,
        np.concatenate([step.next_state for step in one]),
        rtol=0,
        atol=1e-12,
    )
    assert_allclose(
        many.reward, np.concatenate([step.reward for step in one]), rtol=0, atol=1e-12
    )
    assert_array_equal(
        many.terminated, np.concatenate([step.terminated for step in one])
    )
    assert log.terminated.any() == task.terminates


def test_what_does_not_step_as_one_does_is_not_used():
    """Formulas with an "if", random numbers, and a vector environment of other physics."""
    assert not gymnasium_simulator("MountainCar-v0").task.steps_at_once
    assert not task_of(Noisy).steps_at_once
    named = gymnasium_simulator("CartPole-v1").task

    def vector(gravity):
        def make(n):
            envs = gymnasium.make_vec(
                "CartPole-v1", num_envs=n, vectorization_mode="vector_entry_point"
            )
            envs.unwrapped.gravity = gravity
            return envs

        return make

    for gravity in (9.8, 9.0):
        task = GymnasiumTask(
            lambda: gymnasium.make("CartPole-v1"),
            make_vector=vector(gravity),
            state_names=named.state_names,
            actions=[0, 1],
            low=named.feature_low,
            high=named.feature_high,
        )
        assert task.steps_at_once == (gravity == 9.8)


def task_of(make, low=(-9.0,), high=(9.0,), names=("place",), n_actions=2, **options):
    """Of an environment whose state is ``unwrapped.state``."""
    return GymnasiumTask(
        make, state_names=names, actions=range(n_actions), low=low, high=high, **options
    )


class Place(gymnasium.Env):
    """States between ``low`` and ``high`` at the beginning."""

    observation_space = gymnasium.spaces.Box(-9.0, 9.0, (1,), np.float64)
    action_space = gymnasium.spaces.Discrete(2)
    low = [0.0]
    high = [0.0]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = self.np_random.uniform(self.low, self.high)
        self.push = 0.0
        return self.state, {}


class Remembering(Place):
    """A point whose push is that of the step before: its position does not decide the
    next one.
    """

    def __init__(self, draws=None):
        self.draws = draws

    def step(self, action):
        if self.draws is not None:
            self.push = float(self.draws())
        self.state = self.state + 0.5 * self.push
        self.push = action - 0.5
        return self.state, 1.0, False, False, {}


class Noisy(Remembering):
    """Its chance is its own random numbers'."""

    def step(self, action):
        self.state = self.state + self.np_random.normal() + action
        return self.state, 1.0, False, False, {}


class Walled(Remembering):
    """A wall that the state does not show, met in a few steps of a hundred."""

    def step(self, action):
        self.state = self.state + action - 0.5
        self.push = 0.9 * self.push + self.np_random.random() * 0.0 + 1.0
        if 8.0 < self.push < 8.3:
            self.state = self.state + 1.0
        return self.state, 1.0, False, False, {}


@pytest.mark.parametrize("steps", [2**53 + 1, 10**12])
def test_more_steps_to_check_than_memory_holds_are_refused(steps):
    with pytest.raises(ValueError, match="check_steps must be small enough for this"):
        task_of(Remembering, check_steps=steps)


def test_a_state_that_does_not_decide_the_next_one_is_refused():
    match = (
        r"get_state and set_state must have all .*: \d+ of 200 steps of environment"
        r" differ from the record .* in place: "
    )
    with pytest.raises(ValueError, match=match):
        task_of(Remembering)
    with pytest.raises(
        ValueError,
        match=(
            r"chance must come from np_random: \d+ of 200 steps of environment differ"
        ),
    ):
        task_of(lambda: Remembering(np.random.default_rng(0).random))
    with pytest.warns(
        UserWarning, match=r": [1-9] of 200 steps of environment differ from the record"
    ):
        task_of(Walled)
    with pytest.raises(ValueError, match=r"\d+ of 50 steps of environment"):
        task_of(Remembering, check_steps=50)
    paid = task_of(
        Remembering,
        check_steps=0,
        reward_between=lambda s, a, following: (following - s)[:, 0],
    )
    assert_array_equal(
        paid.reward_between(np.zeros((2, 1)), np.zeros(2, dtype=int), np.ones((2, 1))),
        [1.0, 1.0],
    )


class Tank(Place):
    """A level and an inflow that scatters by the environment's own random numbers, or
    jumps up now and then.
    """

    observation_space = gymnasium.spaces.Box(-9.0, 9.0, (2,), np.float64)
    action_space = gymnasium.spaces.Discrete(3)
    low = [1.0, -0.1]
    high = [2.0, 0.1]

    def __init__(self, leak=0.1, jumps=False):
        self.leak = leak
        self.jumps = jumps

    def step(self, action):
        level, rate = self.state
        chance = (
            0.5 * (self.np_random.random() < 0.1)
            if self.jumps
            else self.np_random.normal(0.0, 0.02)
        )
        rate = 0.8 * rate + 0.2 * (action - 1) + chance
        level = level + 0.3 * rate - self.leak * np.sqrt(max(level, 0.0)) + 0.1
        self.state = np.array([level, rate])
        return self.state, -abs(level - 1.5), False, False, {}


def tank(**physics):
    return task_of(
        lambda: Tank(**physics), (0.0, -1.0), (4.0, 1.0), ("level", "rate"), 3
    )


def filling(states):
    return 0.8 * np.eye(3)[np.where(states[:, 0] < 1.5, 2, 0)] + 0.2 / 3


@pytest.mark.parametrize("jumps", [False, True])
def test_the_environment_s_own_chance_is_no_change(jumps):
    """Random numbers of a step are its disturbance: the same environment does not
    differ, another is corrected.
    """
    same = tank(jumps=jumps)
    other = tank(leak=0.14, jumps=jumps)
    assert same.n_disturbances == 1
    found = ResidualSimulator(
        same, same.record(filling, n_transitions=1500, max_steps=50, seed=0), seed=0
    )
    assert not any(c.differs for c in found.coordinates)
    assert [c.scatter for c in found.coordinates][:2] == ["simulator", "simulator"]
    found = ResidualSimulator(
        same, other.record(filling, n_transitions=1500, max_steps=50, seed=0), seed=0
    )
    truth, before, after = (
        monte_carlo_value(t, filling, 300, 50, seed=1).value
        for t in (other, same, found)
    )
    assert abs(after - truth) < 0.4 * abs(before - truth)


def test_chance_gives_quantiles():
    xi = np.random.default_rng(0).standard_normal(20_000)
    drawn = [
        Chance(xi).uniform(1.0, 3.0, 20_000),
        Chance(xi).integers(2, 5, 20_000),
        Chance(xi).normal(1.0, 2.0, 20_000),
    ]
    assert [draw.mean() for draw in drawn] == pytest.approx([2.0, 3.0, 1.0], abs=0.05)
    assert (
        drawn[0].min() >= 1.0,
        drawn[0].max() < 3.0,
        np.unique(drawn[1]).tolist(),
    ) == (True, True, [2, 3, 4])
    assert Chance(xi).uniform([0.0, 1.0], [1.0, 2.0]).shape == (2,)
    # as in double precision
    assert Chance(np.array([9.0])).uniform(np.float32(-1.0), np.float32(1.0)) < 1.0
    with pytest.raises(IndexError, match="at most 1 random numbers"):
        Chance(xi[:1]).normal(size=2)


# ---------------------------------------------------------------- actions and policies


def test_actions_of_a_box():
    box = gymnasium.spaces.Box(
        np.array([-1.0, 0.0]), np.array([1.0, 4.0]), dtype=np.float64
    )
    assert len(action_set(box)) == 25
    assert_array_equal(action_set(box, 2), [[-1, 0], [-1, 4], [1, 0], [1, 4]])
    assert_array_equal(
        action_set(box, [0.0, 0.5]), [[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]]
    )
    assert_array_equal(action_set(box, [[0.5, 3.0]]), [[0.5, 3.0]])
    assert_array_equal(action_set(gymnasium.spaces.Discrete(3, start=1)), [1, 2, 3])


@pytest.mark.parametrize("seed", range(3))
def test_commands_keep_their_mean(seed):
    rng = np.random.default_rng(seed)
    actions = action_set(gymnasium.spaces.Box(-2.0, 2.0, (2,), dtype=np.float64), 4)[
        rng.permutation(16)
    ]
    wanted = rng.uniform(-2, 2, (30, 2))
    found = as_probabilities(lambda states: wanted, actions)(np.zeros((30, 3)))
    assert_allclose(found.sum(axis=1), 1.0)
    assert_allclose(found @ actions, wanted)


@pytest.mark.parametrize("n_commands", [3, 9])
def test_rounding_is_that_of_drawn_commands(n_commands):
    """Root mean square of drawn minus wanted commands; a quarter of the wanted ones lie
    beyond the range.
    """
    rng = np.random.default_rng(0)
    actions = np.linspace(-1.0, 1.0, n_commands)[:, None]
    wanted = np.r_[rng.uniform(-1, 1, (3000, 1)), np.full((1000, 1), 1.5)]
    policy = as_probabilities(lambda states: states, actions)
    probabilities = policy(wanted)
    drawn = actions[[rng.choice(n_commands, p=p) for p in probabilities]]
    distance, beyond = policy.rounding(wanted)
    assert distance == pytest.approx(
        np.sqrt(np.mean((drawn - np.minimum(wanted, 1.0)) ** 2)), rel=0.1
    )
    assert beyond == 0.25
    assert as_probabilities(lambda states: probabilities, actions).rounding(wanted) == (
        0.0,
        0.0,
    )
    assert as_probabilities(policy, actions) is policy


def test_other_forms_of_a_policy():
    states = np.zeros((2, 1))
    assert_array_equal(
        as_probabilities(lambda s: np.array([1, 0]), np.arange(2.0))(states),
        [[0, 1], [1, 0]],
    )
    table = np.full((2, 3), 1 / 3)
    assert (
        as_probabilities(lambda s: table, np.array([[0.0], [1.0], [2.0]]))(states)
        is table
    )
    # no product: the nearest
    scattered = np.array([[0.0, 0.0], [1.0, 1.0], [3.0, 0.0]])
    assert_array_equal(
        as_probabilities(lambda s: np.array([[0.9, 0.8], [2.5, 0.0]]), scattered)(
            states
        ),
        np.eye(3)[[1, 2]],
    )


@pytest.mark.parametrize(
    "one",
    [
        lambda s: 1 if s[1] > 0 else 0,
        lambda s: [0.5, 0.5] if sum(s) > 0 else [1.0, 0.0],
    ],
)
def test_a_policy_of_one_state_has_its_own_error(one):
    states = np.ones((3, 4))
    text = (
        r"^policy must take all states at once, an array of shape \(n, 4\), .* raises"
        r" ValueError: The truth value "
    )
    for ask in (
        lambda: as_probabilities(one, np.arange(2))(states),
        lambda: check_probabilities(one, states, 2),
        lambda: check_probabilities(as_probabilities(one, np.arange(2)), states, 2),
    ):
        with pytest.raises(ValueError, match=text) as caught:
            ask()
        assert str(caught.value).count("all states at once") == 1
    # as it says
    every = as_probabilities(
        lambda states: np.array([one(state) for state in states]), np.arange(2)
    )
    whole = check_probabilities(every, states, 2)
    assert_allclose(whole.sum(axis=1), 1.0)


def test_a_policy_s_bad_answers_keep_their_own_sentence():
    states = np.ones((3, 4))
    commands = np.array([[0.0], [1.0]])
    for answer, actions, text in (
        (
            np.array([0, 2, 0]),
            np.arange(2),
            r"^policy\(states\)\[1\] must be in 0\.\.1; it is 2$",
        ),
        (
            np.array([[0.0], [0.0], [np.nan]]),
            commands,
            r"^policy\(states\)\[2\] must be finite; it is \[nan\]$",
        ),
    ):
        with pytest.raises(ValueError, match=text):
            check_probabilities(
                as_probabilities(lambda s, answer=answer: answer, actions), states, 2
            )


# ---------------------------------------------------------------- end to end


def test_pendulum_from_the_command_line(run, mine):
    """Sample a target, evaluate in another simulator: the first row is near the truth,
    rows are in order.
    """
    said = run(
        "sample Pendulum-v1:g=11,m=1.2 --policy swinging:explore"
        " --task-option=actions=5 --transitions 2000 --output log.csv"
    )
    assert "actions are 1-dimensional commands" in said
    words = (
        "evaluate --simulator Pendulum-v1 --log log.csv --policy near=swinging:swing"
        " --task-option=simulations=40 --horizon 60 --target Pendulum-v1,g=11,m=1.2"
        " --json"
    )
    report = json.loads(run(words, "--grid=15x15"))
    rows = {row["estimator"]: row for row in report["results"]}
    assert list(rows) == [
        "oee (residual)",
        "oee (calibrated)",
        "linear model of the log",
        "pdis",
        "wpdis",
        "simulator (continuous)",
        "simulator",
        "simulator (plain)",
        "model-based",
        "oee on the grid",
        "target (continuous)",
    ]
    truth = rows["target (continuous)"]
    noise = 0.1 * truth["standard_error"]  # common random numbers
    assert abs(rows["oee (residual)"]["value"] - truth["value"]) < noise
    assert not any("rewards contradict" in text for text in report["warnings"])
    assert report["conclusion"][0].startswith(
        "The target's steps differ from the simulator's in "
    )
    without = {row["estimator"]: row for row in json.loads(run(words))["results"]}
    assert [name for name in rows if name in without] == list(without)
    assert without["oee (residual)"] == rows["oee (residual)"] | {
        "notes": without["oee (residual)"]["notes"]
    }


def test_a_state_by_two_functions(run, mine):
    run(
        "sample Pendulum-v1 --task-option=state=swinging:get,put"
        " --task-option=actions=-2,2 --episodes 2 --horizon 5",
        "--output log.npz",
    )
    assert_array_equal(
        np.unique(oee.ContinuousTransitions.load("log.npz").action), [-2.0, 2.0]
    )
    half = (
        "sample Pendulum-v1 --task-option=state=swinging:half,put_half --episodes 1"
        " --output l.npz"
    )
    assert "get_state and set_state must have all that decides the next step" in run(
        half, code=2
    )


OWN = """
import gymnasium
import numpy as np

class Drift(gymnasium.Env):
    observation_space, action_space = gymnasium.spaces.Box(-9.0, 9.0, (1,), np.float64), gymnasium.spaces.Discrete(2)

    def __init__(self, wind=0.0):
        self.wind = wind

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-1.0, 1.0, 1)
        return self.state, {}

    def step(self, action):
        self.state = 0.9 * self.state + 0.2 * action - 0.1 + self.wind
        return self.state, -abs(float(self.state[0])), False, False, {}

def right(states):
    return np.full(len(states), 1)

gymnasium.register("OwnDrift-v0", entry_point=Drift, max_episode_steps=30)
"""


def test_an_environment_that_one_s_own_module_registers(run, mine, monkeypatch):
    (mine / "drifting.py").write_text(OWN)
    run("sample drifting:OwnDrift-v0:wind=0.1 --transitions 600 --output log.csv")
    words = (
        "--log log.csv --policy drifting:right --task-option=simulations=50 --horizon"
        " 20 --json --target drifting:OwnDrift-v0:wind=0.1"
    )
    said = [
        json.loads(run("evaluate --simulator", spec, words))["results"]
        for spec in ("drifting:OwnDrift-v0:wind=0.0", "drifting:OwnDrift-v0,wind=0.0")
    ]
    value = {row["estimator"]: row["value"] for row in said[0]}
    assert value["oee (residual)"] == pytest.approx(
        value["target (continuous)"], rel=0.02
    )
    assert abs(value["simulator (continuous)"] - value["target (continuous)"]) > 1.0
    assert said[0] == said[1]
    error = run("evaluate --simulator drifting:Drift --log log.csv", code=2)
    assert (
        "has states that are vectors: register the environment (gymnasium.register)"
        in error
    )
    assert "module 'nowhere' cannot be found" in run(
        "evaluate --simulator nowhere:A-v0", words, code=2
    )
    gymnasium.registry.pop("OwnDrift-v0")
    monkeypatch.delitem(__import__("sys").modules, "drifting")


BAD = {
    "no state": (
        "Blackjack3-v0",
        "must have a state that can be set, unwrapped.state (numbers) or",
    ),
    "no Box": (
        "Blackjack-v1",
        "must have a state that can be set, unwrapped.state (numbers) or",
    ),
    "physics": (
        "Pendulum-v1:q=3",
        "q must be an argument or a number of Pendulum-v1: it takes render_mode, g",
    ),
    "a word": ("Pendulum-v1:g=strong", "g must be a number; got 'strong'"),
    "state": (
        "Pendulum-v1 --task-option=state=swinging:get",
        "state must be like my_module:get,set",
    ),
    "no function": (
        "Pendulum-v1 --task-option=state=swinging:get,got",
        "'swinging' has no object 'got'",
    ),
    "actions": (
        "Pendulum-v1 --task-option=actions=many",
        "must be a number of levels (9)",
    ),
    "an action": (
        "Pendulum-v1 --task-option=actions=0,3",
        "actions[1] must be in Box(-2.0, 2.0, (1,)",
    ),
    "discrete": (
        "CartPole-v1 --task-option=actions=3",
        "must be left out where the environment has Discrete",
    ),
    "ours": (
        "cartpole --task-option=actions=3",
        "--task-option actions must be left out for cartpole",
    ),
    "unknown": (
        "Pendulum-v1 --task-option=floor=0.1",
        "NAME one of state, actions; got 'floor=0.1'",
    ),
    "finite": (
        "FrozenLake-v1 --task-option=actions=3",
        "--task-option needs a continuous task",
    ),
    "mistyped": (
        "Pendulm-v1 --task-option=actions=3",
        "'Pendulm-v1' is neither; near: Pendulum-v1",
    ),
    "mistyped, ours": (
        "cartpol --task-option=actions=3",
        "'cartpol' is neither; near: cartpole",
    ),
    "mistyped, one's own": (
        "swinging:Pendulm-v1 --task-option=actions=3",
        "is neither; near: Pendulum-v1",
    ),
    "policy": (
        "Pendulum-v1 --policy expert",
        "policy of Pendulum-v1 must be uniform or MODULE:FUNCTION of",
    ),
}


class Nameless(Place):
    """Says nothing of its state."""

    def reset(self, *, seed=None, options=None):
        gymnasium.Env.reset(self, seed=seed)
        return np.zeros(1), {}


@pytest.mark.parametrize("case", BAD)
def test_bad_words(run, mine, monkeypatch, case):
    spec = gymnasium.envs.registration.EnvSpec("Blackjack3-v0", Nameless)
    monkeypatch.setitem(gymnasium.registry, "Blackjack3-v0", spec)
    words, text = BAD[case]
    said = run("sample", words, "--episodes 1 --output l.csv", code=2)
    assert text in said
    assert said.count("\n") == 1
    assert not (mine / "l.csv").exists()


def test_a_log_of_other_commands_or_states(run, mine):
    words = "evaluate --simulator Pendulum-v1 --policy uniform --log log.csv"
    for n_state, actions, options, texts in (
        (
            3,
            [[0.0]] * 3,
            "",
            (
                (
                    "the 2 coordinates of Pendulum-v1 (angle, speed); it has 3; if"
                    " these are observations,"
                ),
            ),
        ),
        (
            1,
            [[0.0]] * 3,
            "",
            (
                (
                    "it has 1; speeds that were not recorded can be had from positions,"
                    " by finite differences"
                ),
            ),
        ),
        (
            2,
            [[0.0], [2.0], [7.0]],
            "--task-option=actions=-2,0,2",
            (
                "log.action must lie among the task's 3 actions",
                "row 2, is [7.0], 5 from [2.0]",
            ),
        ),
        (2, [0, 1, 2], "", ("--task-option actions must be given",)),
        (
            2,
            [0, 1, 2],
            "--task-option=actions=3 --fit grvity",
            ("--fit must name parameters of Pendulum-v1 (",),
        ),
    ):
        oee.ContinuousTransitions(
            np.zeros((3, n_state)), actions, np.zeros((3, n_state))
        ).save("log.csv")
        said = run(words, options, code=2)
        assert all(text in said for text in texts)
    said = run(
        "evaluate --simulator Pendulum-v1 --log log.csv --task-option=actions=3", code=2
    )
    assert "--policy must be given for Pendulum-v1" in said


# ---------------------------------------------------------------- more dimensions than
# a grid has


class Chain(Place):
    """Three masses on springs, pushed at one end: six dimensions."""

    observation_space = gymnasium.spaces.Box(-9.0, 9.0, (6,), np.float64)
    action_space = gymnasium.spaces.Discrete(3)
    low = [-0.5] * 6
    high = [0.5] * 6

    def __init__(self, spring=1.0, weight=1.0):
        self.spring = spring
        self.weight = weight

    def step(self, action):
        x = self.state[:3]
        v = self.state[3:]
        pull = -self.spring * (2 * x - np.append(x[1:], 0.0) - np.append(0.0, x[:-1]))
        pull[0] += action - 1.0
        v = 0.97 * v + 0.1 * pull / self.weight
        paid = -float(x @ x)
        self.state = np.concatenate([x + 0.1 * v, v])
        return self.state, paid, False, False, {}


def damped(states):
    return np.where(states[:, 3] > 0, 0, 2)


def test_six_dimensions_have_a_value_without_cells(monkeypatch):
    monkeypatch.setitem(
        gymnasium.registry,
        "Chain-v0",
        gymnasium.envs.registration.EnvSpec("Chain-v0", Chain),
    )
    simulator, target = (
        gymnasium_simulator(spec)
        for spec in ("Chain-v0", "Chain-v0:spring=1.6,weight=1.2")
    )
    log = record(
        target.task, target.policy("uniform"), n_transitions=1500, max_steps=50, seed=0
    )
    report = evaluate_continuous(
        simulator.task,
        log,
        {"damped": damped},
        settings=Settings(episodes=60),
        seed=0,
        horizon=50,
        target=target.task,
        normalized=True,
    )
    rows = {row["estimator"]: row for row in report.records()}
    assert list(rows) == [
        "oee (residual)",
        "linear model of the log",
        "pdis",
        "wpdis",
        "simulator (continuous)",
        "target (continuous)",
    ]
    truth = rows["target (continuous)"]["value"]
    before = rows["simulator (continuous)"]["value"]
    assert abs(rows["oee (residual)"]["value"] - truth) < 0.05 * abs(before - truth)
    assert rows["oee (residual)"]["lower"] < truth < rows["oee (residual)"]["upper"]
    assert "<!doctype html>" in report.to_html()
    again = record(
        target.task, target.policy("uniform"), n_transitions=4000, max_steps=50, seed=1
    )
    found = evaluate_continuous(
        simulator,
        again,
        {"uniform": simulator.policy("uniform")},
        settings=Settings(episodes=60),
        seed=0,
        horizon=50,
        estimators=["pdis", "model-based"],
    )
    # the behaviour itself: every weight is 1
    weighted = {row["estimator"]: row for row in found.records()}["pdis"]
    gamma = 0.99 ** np.asarray(again.timestep)
    mean = (gamma * again.reward).sum() / len(np.unique(again.episode))
    assert weighted["value"] == pytest.approx(mean)
    assert any(
        "model-based is left out: they need cells" in text for text in found.warnings
    )


def test_inverted_double_pendulum():
    """MuJoCo: found by itself, six dimensions, other physics by the model's fields."""
    pytest.importorskip("mujoco")
    plain = gymnasium_simulator("InvertedDoublePendulum-v5", actions=3)
    assert plain.task.state_names[:3] == ("qpos_0", "qpos_1", "qpos_2")
    assert plain.task.n_state == 6
    damping = plain.task._env.unwrapped.model.dof_damping * 3.0
    target = gymnasium_simulator(
        f"InvertedDoublePendulum-v5:dof_damping={damping.tolist()}", actions=3
    )
    assert_allclose(target.task._env.unwrapped.model.dof_damping, damping)
    logs = [
        record(
            each.task, each.policy("uniform"), n_transitions=40, max_steps=20, seed=0
        )
        for each in (plain, target)
    ]
    assert_array_equal(logs[0].state[0], logs[1].state[0])
    assert np.abs(logs[0].next_state[0] - logs[1].next_state[0]).max() > 1e-6


class Cart(gymnasium.Env):
    """A number that actions move; what it returns is changed by functions of it."""

    observation_space = gymnasium.spaces.Box(-9.0, 9.0, (1,))
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, **changes):
        self.changes = changes
        self.state = None

    def change(self, name, value):
        return self.changes.get(name, lambda same: same)(value)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = np.array([self.np_random.random()])
        return self.change("begin", (self.state, {}))

    def step(self, action):
        self.change("act", action)
        self.state = self.state + 0.1 * (2 * action - 1)
        over = bool(abs(self.state[0]) > 3)
        return self.change("give", (self.state, 1.0, over, False, {}))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (
            lambda: Cart(give=lambda r: (*r[:3], r[4])),
            r"^env.step\(.\) must return .* 4",
        ),
        (
            lambda: Cart(give=lambda r: (r[0], None, *r[2:])),
            "must give a finite number",
        ),
        (lambda: Cart(give=lambda r: (r[0], "1", *r[2:])), "must give a finite number"),
        (
            lambda: Cart(give=lambda r: (*r[:2], None, *r[3:])),
            "must give True or False",
        ),
        (lambda: Cart(begin=lambda r: r[0]), r"^env.reset must return \(observation,"),
        (lambda: Cart(act=lambda a: {}[a]), r"^env.step\(.\) must not raise; .* Key"),
        (
            lambda: {}["env"],
            "^make must make an environment; it raises KeyError: 'env'",
        ),
        (lambda: "Pendulum-v1", r"^env must be a Gymnasium environment; got str \(gym"),
        (lambda: gymnasium.make_vec("CartPole-v1", 2), "^env must be a single environ"),
    ],
)
def test_what_an_environment_returns_is_checked(make, text):
    with pytest.raises(ValueError, match=text):
        GymnasiumTask(make, actions=[0, 1], state_names=["x"])


def test_functions_of_a_state_that_raise_are_named():
    GymnasiumTask(
        lambda: Cart(give=lambda r: (r[0], np.ones(1), *r[2:])), actions=[0, 1]
    )
    for name in ("get_state", "set_state"):
        with pytest.raises(ValueError, match=f"^{name} must .* AttributeError"):
            GymnasiumTask(Cart, actions=[0, 1], **{name: lambda env, *state: env.lost})
