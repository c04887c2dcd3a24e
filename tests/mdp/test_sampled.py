"""MDPs from samples: a log's frequencies, an environment that is stepped, and support
for a log's transitions.
"""

import pickle
import re
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Transitions
from oee_tabular.exceptions import DataWarning

GRID = oee.tasks.gridworld(3, slip=0.3)
LOG = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 400, 40, seed=0)
FILLED = "never recorded and are filled in"
# most logs here are a few transitions
pytestmark = pytest.mark.filterwarnings("ignore:the log has no episodes")


def dense(mdp):
    return mdp.transitions.toarray().reshape(mdp.n_states, mdp.n_actions, mdp.n_states)


# ---------------------------------------------------------------- a log


def test_a_log_without_episodes_does_not_say_where_they_start():
    rows = LOG.select(np.arange(len(LOG)))
    with pytest.warns(DataWarning, match=r"^the log has no episodes: .*\(say where"):
        mean = FiniteMDP.from_log(rows)
    assert mean.initial[0] < 0.9
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert FiniteMDP.from_log(rows, initial=0).initial[0] == 1
        FiniteMDP.from_log(LOG)


def test_frequencies_are_those_of_the_counts():
    mdp = FiniteMDP.from_log(
        LOG, GRID.transition_rewards, discount=0.9, layout=GRID.layout
    )
    counts = LOG.counts(9, 4).toarray()
    expected = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    seen = counts.sum(axis=1) > 0
    assert_allclose(mdp.transitions.toarray()[seen], expected[seen], rtol=1e-14)
    assert_array_equal(
        mdp.initial,
        np.bincount(LOG.state[LOG.episode_starts[:-1]], minlength=9) / LOG.n_episodes,
    )
    assert mdp.discount == 0.9
    assert_array_equal(mdp.layout, GRID.layout)
    alive = ~mdp.absorbing()
    assert_allclose(
        mdp.rewards[alive],
        GRID.with_transitions(mdp.transitions).rewards[alive],
        rtol=1e-12,
    )


def test_rewards_are_the_log_s_means_or_those_given():
    log = Transitions([0, 0, 0, 1], [0, 0, 0, 0], [0, 1, 1, 1], [1.0, 2.0, 4.0, 7.0])
    assert FiniteMDP.from_log(log).transition_rewards.toarray().tolist() == [
        [1.0, 3.0],
        [0.0, 7.0],
    ]
    for rewards in ([5.0, 6.0], [[5.0], [6.0]]):
        mdp = FiniteMDP.from_log(log, rewards)
        assert mdp.transition_rewards is None
        assert mdp.rewards.tolist() == [[5.0], [6.0]]
    table = np.array([[[1.0, 10.0]], [[100.0, 1000.0]]])
    for rewards in (table, sparse.csr_array(table.reshape(2, 2))):
        assert FiniteMDP.from_log(log, rewards).rewards.round(9).tolist() == [
            [7.0],
            [1000.0],
        ]


@pytest.mark.parametrize("rewards", [None, [1.0, 2.0, 5.0]])
def test_where_transitions_terminated_is_terminal_with_reward_0(rewards):
    log = Transitions(
        ["a", "b"],
        ["x", "x"],
        ["b", "c"],
        [1.0, 2.0],
        episode=[0, 0],
        terminated=[0, 1],
    )
    mdp = FiniteMDP.from_log(log, rewards, discount=0.5)
    assert (mdp.state_names, mdp.action_names) == (("a", "b", "c"), ("x",))
    assert mdp.rewards.tolist() == [[1.0], [2.0], [0.0]]
    assert mdp.absorbing().tolist() == [False, False, True]
    assert oee.policy_value(mdp, ["x"] * 3) == 2.0


@pytest.mark.parametrize("rewards", [None, [1.0, 1.0]])
def test_a_state_that_ends_and_goes_on_gets_a_twin(rewards):
    log = Transitions(
        [0, 1, 0], [0, 0, 0], [1, 1, 1], [1.0, 1.0, 1.0], terminated=[0, 1, 1]
    )
    mdp = FiniteMDP.from_log(log, rewards, layout=[3, 4])
    assert mdp.transitions.toarray().tolist() == [[0, 0.5, 0.5], [0, 0, 1], [0, 0, 1]]
    assert mdp.terminal_state.tolist() == [0, 2]
    assert mdp.rewards.tolist() == [[1.0], [1.0], [0.0]]
    assert mdp.layout.tolist() == [[3], [4], [4]]
    oee.Problem(mdp, log)  # its own log is possible in it


def test_a_twin_s_mean_reward_has_its_own_error():
    """s^2 / 3 where three rewards were recorded, and the pooled s^2 where one was."""
    rewards = [1.0, 3.0, 8.0, 5.0, 0.0, 0.0]
    ended = [1, 1, 1, 0, 0, 0]
    log = Transitions(
        [0, 0, 0, 0, 1, 1], [0] * 6, [1, 1, 1, 1, 0, 0], rewards, terminated=ended
    )
    sampling = FiniteMDP.from_log(log).sampling
    assert_allclose(
        sampling.reward_error.toarray(), [[0, 26 / 3, 13 / 3], [0, 0, 0], [0, 0, 0]]
    )
    assert sampling.pairs.tolist() == [4.0, 2.0, np.inf]


def test_pairs_never_recorded_do_as_the_others_do_and_are_named():
    log = Transitions([0, 0, 0], [0, 0, 2], [0, 1, 1], [3.0, 6.0, 9.0])
    with pytest.warns(
        UserWarning,
        match=rf"^4 .* pairs were {FILLED} .*: s=0, a=1; s=1, a=0; s=1, a=1; \.\.\.",
    ):
        mdp = FiniteMDP.from_log(log)
    assert_allclose(dense(mdp)[0], [[0.5, 0.5], [1 / 3, 2 / 3], [0, 1]], rtol=1e-15)
    # by the number of transitions
    assert_allclose(mdp.rewards[0], [4.5, (3 + 6 + 9) / 3, 9.0], rtol=1e-15)
    assert_array_equal(dense(mdp)[1], [[0, 1]] * 3)
    assert_array_equal(mdp.rewards[1], 0.0)
    still = Transitions([0], [0], [0], [1.0])
    # states never met are not named
    assert FiniteMDP.from_log(still, n_states=3).closed().tolist() == [True] * 3
    # two states that may begin
    with pytest.warns(UserWarning, match=f"^3 state-action pairs were {FILLED}"):
        FiniteMDP.from_log(still, n_states=2, n_actions=2, initial={0: 0.5, 1: 0.5})


NAMED = Transitions(["b", "a"], [1, 1], ["a", "b"], [1.0, 2.0])


def test_sizes_names_and_starts():
    with pytest.warns(
        UserWarning, match=f"^4 .* {FILLED}.*: s=a, a=left; s=b, a=left; s=c, a=left; "
    ):
        mdp = FiniteMDP.from_log(
            NAMED,
            state_names=["a", "b", "c"],
            action_names=["left", "right"],
            initial="c",
        )
    assert mdp.initial.tolist() == [0, 0, 1]
    assert dense(mdp)[:, 1].tolist() == [[0, 1, 0], [1, 0, 0], [0, 0, 1]]
    bag = Transitions([0, 0, 1], [0, 0, 0], [1, 1, 0], [0.0] * 3)
    assert_allclose(FiniteMDP.from_log(bag).initial, [2 / 3, 1 / 3])


# ---------------------------------------------------------------- an environment


class Corridor(gymnasium.Env):
    """Places 0 to 3; forwards succeeds in 3 of 4, and 3 is over; observed as texts,
    pairs or numbers.
    """

    action_space = spaces.Discrete(2)

    def __init__(self, seen=lambda place: (place, 0), space=None):
        self.seen = seen
        self.observation_space = space or spaces.Tuple(
            [spaces.Discrete(4), spaces.Discrete(2)]
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        self.steps = 0
        return self.seen(0), {}

    def step(self, action):
        self.steps += 1
        self.place += int(action == 1 and self.np_random.random() < 0.75)
        return self.seen(self.place), -1.0, self.place == 3, self.steps == 50, {}


@pytest.mark.parametrize(
    ("seen", "names"),
    [
        (lambda place: (place, 0), ((0, 0), (1, 0), (2, 0), (3, 0))),
        (lambda place: np.array([place, 7]), ((0, 7), (1, 7), (2, 7), (3, 7))),
        (lambda place: "dcba"[place], ("a", "b", "c", "d")),
        (lambda place: np.int64(place), None),
    ],
)
def test_an_environment_is_stepped_until_every_pair_has_its_samples(seen, names):
    mdp = FiniteMDP.from_env(Corridor(seen), samples_per_pair=400, seed=0, discount=0.9)
    assert (mdp.n_states, mdp.n_actions, mdp.state_names) == (4, 2, names)
    order = [3, 2, 1, 0] if names == ("a", "b", "c", "d") else [0, 1, 2, 3]
    rows = dense(mdp)[np.ix_(order, range(2), order)]
    assert_array_equal(rows[:3, 0], np.eye(4)[:3])
    assert_allclose(
        rows[:3, 1],
        0.25 * np.eye(4)[:3] + 0.75 * np.eye(4)[1:],
        atol=4 * np.sqrt(0.75 * 0.25 / 400),
    )
    assert mdp.absorbing()[order].tolist() == [False, False, False, True]
    assert mdp.initial[order].tolist() == [1, 0, 0, 0]
    assert mdp.rewards[order].tolist() == [[-1, -1]] * 3 + [[0, 0]]


WORLDS = {
    "FrozenLake-v1": {"map_name": "8x8", "is_slippery": False},
    "CliffWalking-v1": {"is_slippery": True},
}


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_is_sampled_within_five_steps_a_sample(name):
    """2.5 to 2.9 steps for each of 30 samples of some 200 pairs; in as many steps a
    random walk leaves 60 pairs short.
    """
    pairs = FiniteMDP.from_env(
        gymnasium.make(name, **WORLDS[name]), samples_per_pair=30, seed=0
    ).sampling.pairs
    met = pairs[np.isfinite(pairs) & (pairs > 0)]
    assert len(met) > 140
    assert met.min() == 30
    assert met.sum() <= 5 * 30 * len(met)


class Table(gymnasium.Env):
    """Deterministic: next[state][action], terminated where it is negative."""

    observation_space = spaces.Discrete(9)

    def __init__(self, following, starts=(0,), limit=50):
        self.following = following
        self.starts = starts
        self.limit = limit
        self.n_steps = 0
        self.action_space = spaces.Discrete(len(following[0]))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = int(self.np_random.choice(self.starts))
        self.steps = 0
        return self.state, {}

    def step(self, action):
        self.n_steps += 1
        following = self.following[self.state][action]
        self.steps = self.steps + 1
        self.state = abs(following)
        return self.state, 0.0, following < 0, self.steps == self.limit, {}


def test_a_trap_is_left_by_a_reset():
    """State 1 has no way out but the limit of a million steps, and the way to 2 begins
    in 0.
    """
    env = Table([[1, 2], [1, 1], [0, -3]], limit=10**6)
    mdp = FiniteMDP.from_env(env, samples_per_pair=20, seed=0, max_steps=500)
    assert mdp.sampling.pairs[:6].min() == 20
    assert env.n_steps < 250


def test_environments_that_end_at_once():
    env = Table([[-8, -8], [-8, -8], [-8, -8]], starts=(0, 0, 0, 1, 2))
    mdp = FiniteMDP.from_env(env, samples_per_pair=10, seed=0)
    assert mdp.sampling.pairs[:6].min() == 10
    assert_allclose(mdp.initial[:3], [0.6, 0.2, 0.2], atol=0.25)


def test_states_beyond_every_episode_do_not_hold_it():
    """A line of nine states whose episodes are cut after four steps: in the fifth state
    nothing can be done.
    """
    env = Table([[max(s - 1, 0), min(s + 1, 8)] for s in range(9)], limit=4)
    with pytest.warns(
        UserWarning,
        match=f"^2 state-action pairs were {FILLED} .*: s=4, a=0; s=4, a=1$",
    ):
        mdp = FiniteMDP.from_env(env, samples_per_pair=25, seed=0)
    assert mdp.sampling.pairs[:8].min() == 25
    assert env.n_steps < 5 * 200


class Once(Table):
    """It begins in state 1 once, and in 0 from then on."""

    def reset(self, *, seed=None, options=None):
        first = super().reset(seed=seed)
        self.starts = (0,)
        return first


@pytest.mark.parametrize(
    ("env", "max_steps", "pairs"),
    [
        (
            Once([[0, 0], [0, 0]], starts=(1,)),
            300,
            "2 of the 4 .* pairs: s=1, a=0; s=1, a=1$",
        ),
        (Corridor(), 20, "[1-6] of the 6 .* pairs: s="),
    ],
)
@pytest.mark.filterwarnings(f"ignore:.*{FILLED}")
def test_pairs_with_fewer_samples_are_named(env, max_steps, pairs):
    text = (
        rf"^samples_per_pair, 5, was not reached within max_steps, {max_steps}, in"
        rf" {pairs}"
    )
    with pytest.warns(UserWarning, match=text):
        FiniteMDP.from_env(env, samples_per_pair=5, seed=0, max_steps=max_steps)


def test_the_same_seed_gives_the_same_bits_and_another_others():
    one, two, other = (
        FiniteMDP.from_env(Corridor(), samples_per_pair=20, seed=seed)
        for seed in (0, 0, 1)
    )
    assert_array_equal(one.transitions.data, two.transitions.data)
    assert not np.array_equal(one.transitions.data, other.transitions.data)


def test_numbers_that_no_episode_meets_stay():
    mdp = FiniteMDP.from_env(
        Corridor(int, spaces.Discrete(6)), samples_per_pair=2, seed=0
    )
    assert mdp.absorbing().tolist() == [False] * 3 + [True] * 3


# ---------------------------------------------------------------- support


def still(form):
    rows = np.array(
        [[[1.0, 0, 0], [0, 1, 0]], [[0, 0.5, 0.5], [0, 1, 0]], [[0, 0, 1], [0, 0, 1]]]
    )
    rewards = np.array([[-1.0, -2], [-3, -4], [0, 0]])
    return FiniteMDP(
        rows,
        rewards if form == 2 else np.where(rows > 0, rewards[:, :, None], np.nan),
        0,
        0.9,
    )


@pytest.mark.parametrize("form", [2, 3])
def test_only_rows_with_impossible_transitions_change(form):
    log = Transitions(
        [0, 0, 0, 0, 1], [0, 0, 0, 1, 0], [0, 1, 2, 1, 2], [9.0, 5.0, 7.0, -2.0, -3.0]
    )
    simulator = still(form)
    with pytest.raises(ValueError, match="Fix one of these"):
        oee.Problem(simulator, log)
    allowing = simulator.with_support_of(log, 0.2)
    rows = dense(simulator)
    rows[0, 0] = [0.8, 0.1, 0.1]
    assert_allclose(dense(allowing), rows, rtol=1e-15)
    assert oee.interval(oee.Problem(allowing, log), [0, 0, 0]).lower < 0
    # new transitions pay what the log says, old ones what the simulator says
    if form == 3:
        assert_allclose(allowing.transition_rewards.toarray()[0], [-1, 5, 7])
        assert_allclose(allowing.rewards[0, 0], 0.8 * -1 + 0.1 * 5 + 0.1 * 7)
    else:
        assert_array_equal(allowing.rewards, simulator.rewards)


def test_epsilon_is_shared_by_the_new_transitions_of_each_pair_alone():
    """Two new transitions of one pair, one of another: each pair has 0.2 in all."""
    log = Transitions([0, 0, 1, 1], [0, 0, 1, 1], [1, 2, 0, 1])
    rows = dense(still(2).with_support_of(log, 0.2))
    assert_allclose(rows[0, 0], [0.8, 0.1, 0.1], rtol=1e-15)
    assert_allclose(rows[1, 1], [0.2, 0.8, 0.0], rtol=1e-15)
    assert_allclose(rows.sum(axis=2), 1.0, rtol=1e-15)


def told(simulator, log):
    """The epsilon of the error about the log's impossible transitions, or None."""
    with pytest.raises(ValueError, match="must stay in the simulator's support") as got:
        oee.Problem(simulator, log)
    text = str(got.value)
    found = re.findall(r"with_support_of\(log, ([\d.e-]+)\)", text)
    assert ("was made of samples" in text) == bool(found)
    assert all(f"--impossible allow={epsilon})" in text for epsilon in found)
    return float(found[0]) if found else None


@pytest.mark.parametrize("n", [1, 4, 30, 1000])
def test_a_sampled_simulator_s_error_gives_its_own_remedy(n, tmp_path):
    """It survives files, pickles and other discounts; a known one has all remedies."""
    rows = Transitions([0] * n + [1], [0] * (n + 1), [0] * n + [1], [1.0] * (n + 1))
    sampled = FiniteMDP.from_log(rows, n_states=3)
    log = Transitions([0], [0], [1])
    sampled.save(tmp_path / "sampled.npz")
    for simulator in (
        sampled,
        FiniteMDP.load(tmp_path / "sampled.npz"),
        pickle.loads(pickle.dumps(sampled)),
        sampled.with_discount(0.5),
        sampled.with_rewards(np.zeros((3, 1))),
        sampled.with_names(["a", "b", "c"]),
        sampled.with_initial(1),
        sampled.with_action_noise(0.1),
    ):
        assert told(simulator, log) == float(f"{1 / (n + 1):.2g}")
    epsilon = told(sampled, log)
    oee.Problem(sampled.with_support_of(log, epsilon), log)
    assert told(sampled.with_transitions(sampled.transitions), log) is None
    # of a pair that was never sampled, and of a terminal state
    assert told(sampled, Transitions([2], [0], [1])) == 0.5
    over = FiniteMDP.from_log(Transitions([0], [0], [1], [1.0], terminated=[1]))
    assert told(over, Transitions([1], [0], [0])) is None


def test_without_rewards_in_the_log_new_transitions_have_the_pair_s_reward():
    counts = sparse.csr_array(([2.0], ([0], [1])), shape=(6, 3))
    named = still(3).with_names(["x", "y", "z"], ["a", "b"])
    for log in (Transitions([0], [0], [1]), counts, Transitions(["x"], ["a"], ["y"])):
        allowing = named.with_support_of(log, 0.25)
        assert allowing.transition_rewards.toarray()[0, :2].tolist() == [-1.0, -1.0]
        assert allowing.transitions.toarray()[0].tolist() == [0.75, 0.25, 0.0]
        assert allowing.names == named.names


def test_rewards_defined_beyond_the_support_are_kept():
    rewards = np.full((3, 2, 3), 4.0)
    allowing = (
        still(2)
        .with_rewards(rewards)
        .with_support_of(Transitions([0], [0], [1], [9.0]), 0.5)
    )
    assert_array_equal(allowing.transition_rewards.toarray(), 4.0)


def test_nothing_impossible_nothing_changed():
    same = GRID.with_support_of(LOG, 0.1)
    assert_array_equal(same.transitions.data, GRID.transitions.data)
    assert_array_equal(same.reward_data, GRID.reward_data)


def test_terminated_transitions_lead_where_termination_leads():
    mdp = FiniteMDP.from_gymnasium(gymnasium.make("FrozenLake-v1", is_slippery=False))
    log = Transitions([14], [0], [15], terminated=[True])
    allowing = mdp.with_support_of(log, 0.1)
    assert allowing.transitions[[14 * 4], :].toarray()[
        0, [13, mdp.terminal_state[15]]
    ].tolist() == [0.9, 0.1]
    oee.Problem(allowing, log)
