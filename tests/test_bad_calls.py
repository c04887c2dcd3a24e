"""Bad input: an error at the call, naming the argument, the place, the rule and the value found."""

import doctest

import numpy as np
import pandas as pd
import pytest
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Transitions, _files

GOOD = np.array([[[0.5, 0.5], [0.0, 1.0]], [[1.0, 0.0], [0.3, 0.7]]])
GRID = oee.tasks.gridworld(3, 0.3)
LOG = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 4, 20, seed=0)
UNIFORM = oee.uniform_policy(GRID)
HUGE = GRID.with_rewards(1e200 * GRID.rewards)


def edited(array, index, value):
    changed = np.array(array, dtype=float)
    changed[index] = value
    return changed


def mdp(transitions=GOOD, rewards=(0.0, 1.0), initial=(1.0, 0.0), discount=0.9, **options):
    return FiniteMDP(
        transitions, np.asarray(rewards) if isinstance(rewards, tuple) else rewards, initial, discount, **options
    )


def log(**changes):
    columns = {"state": [0, 1, 2], "action": [0, 0, 1], "next_state": [1, 2, 0], "episode": [0, 0, 0]}
    return Transitions(**(columns | changes))


def without(name):
    return Transitions(**{key: value for key, value in LOG.columns().items() if key != name})


NAMES = globals() | {"pd": pd, "sparse": sparse}

# the beginning of each error
BAD_CALLS = r"""
# MDPs
>>> mdp(edited(GOOD, (1, 1), [0.3, 0.67]))
transitions[1, 1] must sum to 1 (tolerance 1e-08); it sums to 0.97
>>> mdp(GOOD * 2)
transitions[0, 0] must ...sums to 2 (4 such rows in all)
>>> mdp(sparse.csr_array(edited(GOOD, (1, 1), [0.3, 0.6]).reshape(4, 2)))
transitions[1, 1] must sum to 1 ...; it sums to 0.9
>>> mdp(sparse.csr_array(edited(GOOD, (1, 0), 0.0).reshape(4, 2)))
transitions[1, 0] must sum to 1 ...; it sums to 0
>>> mdp(edited(GOOD, (0, 1), [-0.5, 1.5]))
transitions[0, 1, 0] must be nonnegative; it is -0.5
>>> mdp(sparse.csr_array(edited(GOOD, (0, 1), [-0.5, 1.5]).reshape(4, 2)))
transitions must be nonnegative; at s=0, a=1 -> s'=0 it is -0.5
>>> mdp(edited(GOOD, (0, 1, 0), np.nan))
transitions[0, 1, 0] must be finite; it is nan
>>> mdp(sparse.csr_array(edited(GOOD, (0, 1, 0), np.nan).reshape(4, 2)))
transitions must be finite; at s=0, a=1 -> s'=0 it is nan
>>> mdp(np.ones((2, 2, 3)) / 3)
transitions must have shape (S, A, S), or ...; it has shape (2, 2, 3)
>>> mdp(np.ones((3, 2, 2)) / 2)
transitions must have shape ...; it has shape (3, 2, 2): the axes look like (A, S, S); use P.transpose(1, 0, 2)
>>> mdp(np.eye(2))
transitions must have shape (S, A, S), or (S*A, S) as a scipy.sparse array, ...; it has shape (2, 2)
>>> mdp(sparse.csr_array(np.ones((3, 2))))
transitions must have shape ...(S*A, S) as a scipy.sparse array, ...; it has shape (3, 2)
>>> mdp([["a"]])
transitions must be an array of numbers; got list
>>> mdp(np.zeros((0, 1, 0)))
transitions must have shape ... at least one state and one action
>>> mdp(rewards=np.zeros(3))
rewards must have shape (2,); it has shape (3,)
>>> mdp(rewards=(0.0, np.inf))
rewards[1] must be finite; it is inf
>>> mdp(rewards=np.full((2, 2, 2), np.nan))
rewards[0, 0, 0] must be finite where the transition has a probability; it is nan
>>> mdp(rewards=edited(np.zeros((2, 2, 2)), (0, 1, 0), np.inf))
rewards[0, 1, 0] must be finite; it is inf
>>> mdp(rewards=sparse.csr_array(edited(np.zeros((4, 2)), (1, 1), np.nan)))
rewards must be finite; at s=0, a=1 -> s'=1 it is nan
>>> mdp(rewards=sparse.csr_array(np.ones((2, 2))))
rewards must have shape (4, 2) when sparse; it has shape (2, 2)
>>> mdp(initial=(0.5, 0.4))
initial must sum to 1 ...; it sums to 0.9
>>> mdp(initial=(1.0,))
initial must have shape (2,); it has shape (1,)
>>> mdp(discount=1.01)
discount must be in [0, 1]; it is 1.01
>>> mdp(discount=np.nan)
discount must be in [0, 1]; it is nan
>>> mdp(discount="high")
discount must be a number; got 'high'
>>> mdp(terminal_state=[0, 2])
terminal_state[1] must be in 0..1; it is 2
>>> mdp(terminal_state=[0.5])
terminal_state must be 1 to 2 integers; got float64
>>> FiniteMDP(np.eye(6)[:, None], np.zeros(6), 0, 0.9, layout=(2, 4))
layout must be (height, width) with height * width = 6, the number of states; it is (2, 4)
>>> mdp(layout=[0.0, 1.0, 2.0])
layout must have shape (2,) or (2, c), a place for each state; it has shape (3,)
>>> mdp(layout=[[0.0, 1.0], [np.nan, 0.0]])
layout[1, 0] must be finite; it is nan
>>> mdp().with_transitions(GRID.transitions)
new ...transitions must be for 2 states and 2 actions; they are for 9 and 4
>>> mdp().with_action_noise(1.5)
epsilon must be in [0, 1]; it is 1.5

# policies and evaluation
>>> oee.policy_value(GRID, np.full((9, 3), 1 / 3))
policy must have shape (9, 4) (states, actions); it has shape (9, 3)
>>> oee.policy_value(GRID, edited(UNIFORM, (4, 0), 0.22))
policy[4] must sum to 1 (tolerance 1e-08); it sums to 0.97
>>> oee.policy_value(GRID, edited(UNIFORM, (4, slice(2)), [-0.1, 0.6]))
policy[4, 0] must be nonnegative; it is -0.1
>>> oee.occupancy(GRID, edited(UNIFORM, (4, 1), np.nan))
policy[4, 1] must be finite; it is nan
>>> oee.policy_value(GRID, np.stack([UNIFORM] * 3))
policy must have shape (9, 4) ...it has shape (3, 9, 4)
>>> oee.policy_value(GRID, np.stack([UNIFORM] * 3), horizon=4)
policy must have shape (9, 4) or (4, 9, 4)
>>> oee.policy_value(GRID, UNIFORM, horizon=0)
horizon must be a positive integer; it is 0
>>> oee.policy_value(GRID, UNIFORM, horizon=2.5)
horizon must be a positive integer; got 2.5
>>> oee.policy_value(GRID.with_discount(1.0), UNIFORM, horizon=3, normalized=True)
normalized must be False at discount 1
>>> oee.occupancy(GRID.with_discount(1.0), UNIFORM)
horizon must be given: at discount 1
>>> oee.occupancy(GRID, UNIFORM, of="action")
of must be one of 'state', 'state_action', 'tra
>>> oee.mix(UNIFORM, UNIFORM[:5], 0.5)
policy_a and policy_b must have one shape; they have (9, 4) and (5, 4)
>>> oee.mix(UNIFORM, UNIFORM, 2)
weight_of_a must be in [0, 1]; it is 2

# logs
>>> Transitions([], [], [])
state ...the log is empty
>>> Transitions([0, 1], [0], [1, 2])
columns must have equal lengths; they have {'state': 2, 'action': 1, 'next_state': 2}
>>> Transitions([0.5], [0], [1])
state[0] must be an integer; it is 0.5
>>> Transitions([0], [-1], [1])
action[0] must be at least 0; it is -1
>>> oee.Problem(GRID, {"state": [0]})
log must be Transitions; got dict (a mapping of columns: Transitions(**log))
>>> oee.Problem(GRID, np.zeros((3, 3)))
log must be Transitions; got ndarray (columns state, action, next_state: Transitions(*log.T))
>>> oee.Problem(GRID, "nowhere.csv")
[Errno ...nowhere.csv
>>> Transitions(pd.DataFrame({"state": [0]}))
action must be given, ...Transitions.from_frame(frame)
>>> oee.Problem(GRID, LOG, impossible="allow")
impossible must be one of 'refuse', 'drop'; got 'allow' (to allow them: simulator.with_support_of(log
>>> GRID.with_support_of(LOG, 2)
epsilon must be in (0, 1); it is 2
>>> GRID.with_support_of(pd.DataFrame({"state": [0]}), 0.1)
log must be Transitions; got DataFrame (of a data frame: Transitions.from_frame(log))
>>> oee.Problem(GRID, pd.DataFrame({"place": [0], "action": [0]}))
frame must have the columns state, action, next_state; it has place, action ...(frame, state='its name', ...))
>>> Transitions.from_frame("log.csv")
frame must be a data frame (...); got str (a file: Transitions.load)
>>> oee.tasks.gridworld(3, 0.3).with_names([("r", k) for k in range(9)]).with_initial(("r", 9))
initial must be one of the MDP's names; it is ('r', 9) (did you mean ('r', ...)?)
>>> oee.tasks.gridworld(3, 0.3).with_names([(k // 3, k % 3) for k in range(9)]).with_initial((7, 7))
initial must be one of the MDP's names; it is (7, 7)
>>> oee.interval(oee.Problem(GRID, LOG), "uniform")
policy ...states; it is 'uniform' (oee.uniform_policy(simulator))
>>> GRID.with_names([f"s{k // 2}" for k in range(GRID.n_states)])
state_names must differ; state_names[1] is 's0', as state_names[0] is
>>> oee.interval(oee.Problem(GRID.with_names(None, ["n", "east", "s", "w"]), LOG), lambda state: "eats")
policy(0) must be one of the MDP's names; it is 'eats' (did you mean 'east'?)
>>> oee.interval(oee.Problem(GRID, LOG), "north")
policy must be an action, or a distribution, for each of the ... states; it is 'north' (the same in every state
>>> oee.interval(oee.Problem(GRID, LOG), 2)
policy ...for each of the ... states; it is 2
>>> oee.interval(oee.Problem(GRID, LOG), lambda state: [0.5, 0.4, 0, 0])
policy(0) must sum to 1 ...; it sums to 0.9
>>> oee.interval(oee.Problem(GRID, LOG), lambda state: {}[state])
policy(0) must be an action or a distribution; it raises KeyError: 0
>>> oee.interval(oee.Problem(GRID, LOG), [4] * GRID.n_states)
policy[0] must be in 0..3; it is 4
>>> oee.inference.compare_policies(oee.Problem(GRID, LOG), [[0] * GRID.n_states])
policies must be at least two to compare; there is 'policy 0'
>>> oee.FiniteMDP.from_env("FrozenLake-v1", samples_per_pair=1)
env must be a Gymnasium environment; got str (gymnasium.make('FrozenLake-v1'))
>>> Transitions(["a"], [0], [1])
state must hold integers; it holds <U1
>>> Transitions([[0]], [0], [1])
state must have 1 dimension; it has shape (1, 1)
>>> Transitions([0], [0], [1], [np.inf])
reward[0] must be finite; it is inf
>>> Transitions([0], [0], [1], behavior_probability=[1.2])
behavior_probability[0] must be in [0, 1]; it is 1.2
>>> Transitions([0], [0], [1], terminated=[2])
terminated[0] must be a boolean ... it is 2
>>> log(next_state=[2, 2, 0])
next_state[0] must be the state of the next row of its episode, which is 1; it is 2
>>> log(episode=[0, 1, 0])
episode must keep the rows of an episode together; 0 begins again in row 2
>>> log(timestep=[0, 2, 1])
timestep[1] must be 1 (steps of an episode in order from 0); it is 2
>>> log(terminated=[1, 0, 0])
terminated[0] must be False: its episode continues in the next row
>>> log(truncated=[0, 1, 0])
truncated[1] must be False: its episode continues in the next row
>>> Transitions([0], [0], [1]).counts(2, 1, discount=0.9)
log must have timesteps (or episodes) to be counted with a discount
>>> LOG.draw(10**6, seed=0)
n must be at most the ... rows of the log; it is 1000000
>>> LOG.save("log.xlsx")
path must end in .npz, .csv, .csv.gz, .parquet, or be a Minari folder or id
>>> Transitions.load("log.xlsx")
path must end in .npz, .csv, .csv.gz, .parquet
>>> GRID.save("mdp.csv")
path must end in .npz; it is 'mdp.csv'

# problems
>>> oee.Problem(GRID, Transitions([0, 9], [0, 0], [3, 3]))
log.state[1] must be in 0..8, the simulator's; it is 9 (1 such transitions)
>>> oee.Problem(GRID, Transitions([0], [4], [3]))
log.action[0] must be in 0..3, the simulator's; it is 4
>>> oee.Problem(GRID, Transitions([0, 0, 0, 3], [0, 0, 0, 1], [8, 8, 3, 5]))
log ...gives probability 0 to 2 of its transitions (3 of 4 with repetitions): s=0, a=0 -> s'=8 (2); s=3, a=1 -> s'=5
>>> oee.Problem(GRID, Transitions([0], [0], [3], terminated=[True]))
log.terminated[0] must be False, or state 3 must be terminal in the simulator
>>> oee.Problem(GRID, np.zeros((3, 3)))
log must be Transitions; got ndarray
>>> oee.Problem(GOOD, LOG)
simulator must be a FiniteMDP; got ndarray
>>> oee.Problem(GRID, without("reward"), rewards="log")
rewards must be 'simulator' where the log has no reward column
>>> oee.Problem(GRID, LOG, rewards="both")
rewards must be one of 'simulator', 'log'; got 'both'
>>> oee.Problem(GRID, LOG, behavior_policy=np.ones((9, 1)))
behavior_policy must have shape (9, 4)

# estimators
>>> oee.estimators.ImportanceSampling()(oee.Problem(GRID, without("behavior_probability")), UNIFORM)
importance sampling needs behaviour probabilities: the log has none; give Problem(behavior_policy=...) (--behavior)
>>> oee.estimators.ImportanceSampling()(oee.Problem(GRID, Transitions(**(LOG.columns() | {"behavior_probability":
...     np.zeros(len(LOG))}))), UNIFORM)
log.behavior_probability must be positive for the actions taken; it is 0 in row 0 (s=0, a=...; ... such rows
>>> oee.estimators.ImportanceSampling()(oee.Problem(GRID, without("behavior_probability"),
...     behavior_policy=oee.tasks.gridworld_expert(3)), UNIFORM)
behavior_policy must be positive for the actions taken; it is 0 in row ... (s=...
>>> oee.estimators.ImportanceSampling()(oee.Problem(GRID, LOG.draw(5, seed=0)), UNIFORM)
importance sampling needs whole episodes: give the log its episode column, or Problem(episodes=...)
>>> oee.estimators.ImportanceSampling("weighted")
kind must be one of 'trajectory', 'per_decision'; got 'weighted'
>>> oee.estimators.ImportanceSampling(ragged="drop")
ragged must be one of 'pad', 'zero'; got 'drop'
>>> oee.estimators.ImportanceSampling(behavior="known")
behavior must be one of 'recorded', 'estimated'
>>> oee.estimators.ModelBased("go")
fallback must be one of 'stay', 'simulator'; got 'go'
>>> oee.estimators.OffEnvironment("joined")
ratio must be one of 'conditional', 'ratio_of_ratios', 'joint'; got
>>> oee.estimators.OffEnvironment(3.0)
ratio must be a method's name, a TransitionRatio or a function
>>> oee.estimators.OffEnvironment(evaluation="mc")
evaluation must be one of 'exact', 'monte_carlo'
>>> oee.estimators.OffEnvironment(weighting="step")
weighting must be one of 'per_decision', 'trajectory'
>>> oee.estimators.OffEnvironment(n_rollouts=0)
n_rollouts must be a positive integer; it is 0
>>> oee.estimators.Oracle(GRID)(oee.Problem(oee.tasks.gridworld(3, 0.0), Transitions([0], [0], [3])), UNIFORM)
target must stay in the simulator's support: the simulator gives probability 0 to
>>> oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, estimators=["oe"])
estimators must be among simulator, oee, ...; got 'oe' (did you mean 'oee'?)
>>> oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, estimators=["oracle"])
estimator 'oracle' needs the target environment
>>> oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, estimators=[])
estimators must name at least one
>>> oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, estimators={"mine": lambda problem, policy: (1.5, 0.1)})
an estimator must return a float or an Estimate; it returned tuple: Estimate(value, standard_error) holds both
>>> oee.evaluate(oee.Problem(GRID, LOG), {})
policies must hold at least one; it is empty
>>> oee.evaluate(oee.Problem(GRID, LOG), {"mine": UNIFORM * 0.9})
policy 'mine'[0] must sum to 1 ...; it sums to 0.9
>>> oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, confidence=1)
confidence must be in (0, 1); it is 1

# ratios
>>> oee.density_ratio([1, 1, 1], [1, 0, 0])
q ...the program is unbounded at the 2 entries with q = 0 < p (the first: 1, 2); give a finite upper bound
>>> oee.density_ratio([1, 1], [1, 1], lower=2, upper=1.5, normalized=False)
lower must not exceed upper; they are 2 and 1.5
>>> oee.density_ratio([1, 1], [1, 1], lower=1.5, upper=2)
the box [lower, upper] must contain 1 for sum q g = 1 to be possible; it is [1.5, 2]
>>> oee.density_ratio([1], [1], lower=-1)
lower must be in [0, inf); it is -1
>>> oee.density_ratio([1, -1], [1, 1])
p[1] must be nonnegative; it is -1
>>> oee.density_ratio([1, 1], [1, np.nan])
q[1] must be finite; it is nan
>>> oee.density_ratio([1, 2, 1], [1, 1, 1], features=np.arange(3.0))
features must span a function that is above 0, with sum q g = 1; none is at all points (a constant
>>> oee.density_ratio([0, 0], [1, 1])
p must have a positive, finite sum; it is 0
>>> oee.density_ratio([1, 1], [0, 0])
q must have a positive, finite sum; it is 0
>>> oee.density_ratio([1], [1, 1])
p and q must have one length; they have 1 and 2
>>> oee.density_ratio([[1]], [[1]])
p must have 1 dimension(s); it has shape (1, 1)
>>> oee.density_ratio([1], [1], ridge=-1.0)
ridge must be in [0, inf); it is -1
>>> oee.density_ratio([2], [1], ridge=lambda n: np.inf)
ridge(2) must be finite; it is inf
>>> oee.density_ratio([1], [1], ridge=1, toward=np.inf)
toward must be finite; it is inf
>>> oee.density_ratio([1], [1], lower=np.inf, normalized=False)
lower must be finite; it is inf
>>> oee.density_ratio([1], [1], upper=0, normalized=False)
upper must be positive: ...; it is 0
>>> oee.density_ratio([1e308] * 2, [1, 1])
p must have a positive, finite sum; it is inf
>>> oee.density_ratio([1, 2], [2, 1], ridge=1e308, toward=1)
the program must have numbers that double precision holds; ridge 1e+308
>>> oee.density_ratio([1, 2], [2, 1], ridge=1, toward=1e300, loss="chi2", normalized=False)
the program must have numbers that double precision holds; ridge 1 towards 1e+300
>>> oee.ratio.Conditional(ridge=1e308).fit(LOG, GRID)
the options of method 'conditional' must make a program that double precision holds; ...ridge 1e+308, toward 1
>>> oee.ratio.Conditional(ridge=1, toward=1e308).fit(LOG, GRID)
the options of method 'conditional' must make ...ridge 1, toward 1e+308
>>> oee.ratio.InClass(features=np.ones((GRID.transitions.nnz, 1)), ridge=1e308).fit(LOG, GRID)
ridge must leave a program that double precision holds; it is 1e+308
>>> oee.inference.compare_policies(oee.Problem(HUGE, LOG), {"a": UNIFORM, "b": [0] * 9})
the simulator's rewards must be at most 1e+140, ...; they reach 7.6e+199: give them in a larger unit
>>> oee.interval(oee.Problem(HUGE, LOG), UNIFORM, method="robust")
the simulator's rewards must be at most 1e+140, ...; they reach 7.6e+199
>>> oee.density_ratio([1j], [1])
p must be an array of numbers; got list (complex numbers)
>>> oee.density_ratio([1], [1], loss="l2")
loss must be one of 'kl', 'chi2'; got 'l2'
>>> oee.density_ratio([1], [1], ridge="a")
ridge must be a number; got 'a'
>>> oee.transition_ratio(LOG, GRID, simulator_data="exact")
simulator_data must not be given with method 'conditional', which does not use it; got 'exact'
>>> oee.transition_ratio(LOG, GRID, method="ratio_of_ratios", strength=2.0)
strength must not be given with method 'ratio_of_ratios', which does not use it; got 2.0
>>> oee.Problem(GRID, LOG, simulator_data="foo")
simulator_data must be Transitions, 'exact' or None; got 'foo'
>>> oee.true_ratio(None, GRID)
target must be a FiniteMDP; got NoneType
>>> oee.estimators.Oracle(5)
target must be a FiniteMDP; got int
>>> oee.policy_value(GOOD, UNIFORM)
mdp must be a FiniteMDP; got ndarray
>>> oee.occupancy(GOOD, UNIFORM)
mdp must be a FiniteMDP; got ndarray
>>> oee.estimators.OffEnvironment(oee.true_ratio(GRID, GRID))(
...     oee.Problem(oee.tasks.gridworld(3, 0.0), Transitions([0], [0], [3])), UNIFORM)
ratio must have the support of this simulator's transitions
>>> oee.estimators.OffEnvironment(oee.true_ratio(mdp(), mdp()))(oee.Problem(GRID, LOG), UNIFORM)
ratio must be for (36, 9) rows and states; it is for (4, 2)
>>> oee.sample_episodes(GRID, UNIFORM, 1, 1, seed="a")
seed must be what numpy.random
>>> LOG.draw(3, seed=-1)
seed must be what numpy.random.default_rng takes; got -1
>>> oee.policy_value(GRID, UNIFORM, horizon=True)
horizon must be a positive integer; got True
>>> GRID.with_action_noise("0.1")
epsilon must be a number; got '0.1'
>>> mdp(GOOD + 0j)
transitions must be an array of numbers; ...complex numbers
>>> mdp(sparse.csr_array(GOOD.reshape(4, 2) + 0j))
transitions must be real numbers; they are complex
>>> LOG.select([])
rows must choose at least one row; they choose none
>>> LOG.select([10**6])
rows must be a mask or row numbers of the log's ... rows
>>> LOG.counts("3", 2)
n_states must be a positive integer; got '3'
>>> Transitions([[0], [1, 2]], [0], [1])
state must be a column of integers
>>> Transitions([0, 0], [0, 0], [0, 0], episode=[[], [1]])
episode must be a column of integers
>>> Transitions([0], [0], [1], episode=[1e300])
episode[0] must be an integer; it is 1e+300
>>> Transitions(np.array([2**63 + 5], dtype=np.uint64), [0], [1])
state[0] must be below
>>> GRID.save("nowhere/mdp.npz")
[Errno ...no such folder...nowhere
>>> oee.density_ratio([1], [1], solver="dial")
solver must be 'dual' or one of ...; got 'dial'
>>> oee.transition_ratio(LOG, GRID, method="joined")
method must be one of 'conditional', 'tied', 'linear', 'kernel', 'ratio_
>>> oee.transition_ratio(LOG, GRID, prior="flat")
prior must be one of 'ridge', 'tilt', 'simulator', 'none'; got 'f
>>> oee.transition_ratio(LOG, GRID, strength=-1)
strength must be in [0, inf); it is -1
>>> oee.transition_ratio(np.zeros((36, 9)), GRID)
log_or_counts must be Transitions or sparse counts; got ndarray
>>> oee.transition_ratio(sparse.csr_array((36, 9)), GRID)
log_or_counts must have at least one transition
>>> oee.transition_ratio(sparse.csr_array(np.ones((4, 2))), GRID)
counts must have shape (36, 9) ...; they have shape (4, 2)
>>> oee.transition_ratio(GRID.transitions.sign() * -1.0, GRID)
counts must be finite and nonnegative; at s=0, a=0 -> s'=0 there is -1
>>> oee.transition_ratio(LOG, GRID, method="ratio_of_ratios", simulator_data="most")
simulator_data must be Transitions, 'exact' or None; got 'most'
>>> oee.exact.reweight(GRID, sparse.csr_array(np.ones((4, 2))))
ratio must be sparse of shape (36, 9), row s*A + a; got (4, 2)
>>> oee.true_ratio(mdp(), GRID)
target and simulator must have the same states and

# sampling
>>> oee.sample_episodes(GRID, UNIFORM, 0, 5, seed=0)
n_episodes must be a positive integer; it is 0
>>> oee.sample_transitions(GRID, np.ones((9, 4)), 5, seed=0)
distribution must sum to 1 ...; it sums to 36
>>> oee.tasks.toy_text("FrozenLake-v9")
environment ...'FrozenLake-v9' is neither; near: FrozenLake
>>> oee.tasks.gridworld(3, 1.1)
slip must be in [0, 1]; it is 1.1
>>> oee.tasks.named_task("FrozenLake-v1:success_rate=1/0")
success_rate must be a finite number; '1/0' divides by 0
>>> oee.tasks.named_task("gridworld:3,slip=.1,slip=.2")
slip must be given once; '3,slip=.1,slip=.2' has it twice
>>> oee.tasks.named_task("FrozenLake-v1:desc=x")
environment 'FrozenLake-v1' does not take these arguments {'desc': 'x'}
>>> oee.tasks.named_task("FrozenLake-v1:success_rate=7")
environment 'FrozenLake-v1' with success_rate=7 is no finite MDP: transitions[0, 0] must sum to 1
>>> oee.policy_value(GRID, np.full((9, 4), "0.25"))
policy must be an array of numbers; got ndarray (text or dates)
>>> oee.sample_episodes(GRID, UNIFORM, 10**14, 5, seed=0)
n_episodes must be small enough for this machine's memory; 100000000000000 needs 6.71e+06 GiB
>>> oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, estimators=["oee"], seed={1})
seed must be what numpy.random.SeedSequence takes; got {1}
>>> oee.uniform_policy(None)
mdp must be a FiniteMDP; got NoneType
>>> oee.estimators.OffEnvironment()(None, UNIFORM)
problem must be a Problem; got NoneType
>>> oee.estimators.calibrate(3, discretised=1.0, continuous=1.0)
estimate must be an Estimate; got int
>>> oee.tasks.gridworld(3, 0.1, pay="both")
pay must be one of 'next', 'current'
"""


@pytest.mark.parametrize(
    "example", doctest.DocTestParser().get_examples(BAD_CALLS), ids=lambda example: example.want[:60]
)
def test_bad_calls(example):
    with pytest.raises((ValueError, FileNotFoundError)) as refused:
        eval(example.source, NAMES)
    wanted = example.want.rstrip() + "...\n"
    assert doctest.OutputChecker().check_output(wanted, f"{refused.value}\n", doctest.ELLIPSIS), refused.value


def test_files_that_hold_something_else(tmp_path):
    GRID.save(tmp_path / "mdp.npz")
    LOG.save(tmp_path / "log.npz")
    np.savez(tmp_path / "other.npz", a=np.ones(3))
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not really")
    (tmp_path / "broken.parquet").write_bytes(b"no")
    (tmp_path / "no_columns.csv").write_text("s,a\n0,1\n")
    (tmp_path / "gap.csv").write_text("state,action,next_state\n0,1,2\n1,,2\n")
    (tmp_path / "words.csv").write_text("state,action,next_state\nhall,0,2\n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "surplus.csv").write_text("state,action,next_state\n0,0,1,9\n")
    _files.save_npz(tmp_path / "parts.npz", "finite_mdp", {"shape": np.array([2, 1])})
    table = [
        (FiniteMDP.load, "log.npz", r"must hold a FiniteMDP; it holds a log of numbered states"),
        (Transitions.load, "mdp.npz", r"must hold a log of numbered states \(Transitions\); it holds a FiniteMDP"),
        (FiniteMDP.load, "other.npz", r"must hold a FiniteMDP; it holds the arrays "),
        (FiniteMDP.load, "broken.npz", r"must be an npz or npy file of plain arrays"),
        (Transitions.load, "broken.parquet", r"must be a parquet table"),
        (Transitions.load, "no_columns.csv", r"must have the columns state, action, next_state; it has s, a"),
        (Transitions.load, "gap.csv", r"action\[1\] must have a value; it has none"),
        (Transitions.load, "words.csv", r"words.csv': state must hold integers"),
        (Transitions.load, "surplus.csv", r"must have 3 fields, as the header has"),
        (
            FiniteMDP.load,
            "parts.npz",
            r"must hold every part of a FiniteMDP; 'rewards_data' is missing",
        ),
        (Transitions.load, "empty.csv", r"must have the columns state, action, next_state; it has none"),
    ]
    for load, name, text in table:
        with pytest.raises(ValueError, match=text):
            load(tmp_path / name)
    for name in ("nowhere.npz", "nowhere.csv", "nowhere.parquet"):
        with pytest.raises(FileNotFoundError, match="nowhere"):
            Transitions.load(tmp_path / name)


def test_an_extra_that_is_not_installed_is_named(tmp_path, monkeypatch):
    import importlib.util

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"is not installed; in a clone: pip install '.\[minari\]'"):
        LOG.save(tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []
