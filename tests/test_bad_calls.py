"""Bad input: an error at the call, naming the argument, the place, the rule and the value found."""

import numpy as np
import pandas as pd
import pytest
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions, _files
from oee_tabular.estimators import ImportanceSampling, ModelBased, OffEnvironment, Oracle

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


TABLE = {
    # MDPs
    "rows that miss 1": (
        lambda: mdp(edited(GOOD, (1, 1), [0.3, 0.67])),
        r"^transitions\[1, 1\] must sum to 1 \(tolerance 1e-08\); it sums to 0.97$",
    ),
    "many rows that miss 1": (lambda: mdp(GOOD * 2), r"transitions\[0, 0\] must .*sums to 2 \(4 such rows in all\)"),
    "sparse rows that miss 1": (
        lambda: mdp(sparse.csr_array(edited(GOOD, (1, 1), [0.3, 0.6]).reshape(4, 2))),
        r"transitions\[1, 1\] must sum to 1 .*; it sums to 0.9",
    ),
    "an empty sparse row": (
        lambda: mdp(sparse.csr_array(edited(GOOD, (1, 0), 0.0).reshape(4, 2))),
        r"transitions\[1, 0\] must sum to 1 .*; it sums to 0$",
    ),
    "negative probability": (
        lambda: mdp(edited(GOOD, (0, 1), [-0.5, 1.5])),
        r"transitions\[0, 1, 0\] must be nonnegative; it is -0.5",
    ),
    "negative sparse probability": (
        lambda: mdp(sparse.csr_array(edited(GOOD, (0, 1), [-0.5, 1.5]).reshape(4, 2))),
        r"transitions must be nonnegative; at s=0, a=1 -> s'=0 it is -0.5",
    ),
    "nan probability": (
        lambda: mdp(edited(GOOD, (0, 1, 0), np.nan)),
        r"transitions\[0, 1, 0\] must be finite; it is nan",
    ),
    "nan sparse probability": (
        lambda: mdp(sparse.csr_array(edited(GOOD, (0, 1, 0), np.nan).reshape(4, 2))),
        r"transitions must be finite; at s=0, a=1 -> s'=0 it is nan",
    ),
    "transitions of a wrong shape": (
        lambda: mdp(np.ones((2, 2, 3)) / 3),
        r"transitions must have shape \(S, A, S\), or .*; it has shape \(2, 2, 3\)",
    ),
    "transitions of two dimensions": (
        lambda: mdp(np.eye(2)),
        r"transitions must have shape \(S, A, S\), or \(S\*A, S\) as a scipy.sparse array, .*; it has shape \(2, 2\)",
    ),
    "sparse transitions of a wrong shape": (
        lambda: mdp(sparse.csr_array(np.ones((3, 2)))),
        r"transitions must have shape .*\(S\*A, S\) as a scipy.sparse array, .*; it has shape \(3, 2\)",
    ),
    "transitions that are words": (lambda: mdp([["a"]]), r"transitions must be an array of numbers; got list"),
    "no states": (
        lambda: mdp(np.zeros((0, 1, 0))),
        r"transitions must have shape .* at least one state and one action",
    ),
    "rewards of a wrong shape": (
        lambda: mdp(rewards=np.zeros(3)),
        r"rewards must have shape \(2,\); it has shape \(3,\)",
    ),
    "infinite reward": (lambda: mdp(rewards=(0.0, np.inf)), r"rewards\[1\] must be finite; it is inf"),
    "undefined reward of a possible move": (
        lambda: mdp(rewards=np.full((2, 2, 2), np.nan)),
        r"rewards\[0, 0, 0\] must be finite where the transition has a probability; it is nan",
    ),
    "infinite reward of a move": (
        lambda: mdp(rewards=edited(np.zeros((2, 2, 2)), (0, 1, 0), np.inf)),
        r"rewards\[0, 1, 0\] must be finite; it is inf",
    ),
    "sparse nan reward": (
        lambda: mdp(rewards=sparse.csr_array(edited(np.zeros((4, 2)), (1, 1), np.nan))),
        r"rewards must be finite; at s=0, a=1 -> s'=1 it is nan",
    ),
    "sparse rewards of a wrong shape": (
        lambda: mdp(rewards=sparse.csr_array(np.ones((2, 2)))),
        r"rewards must have shape \(4, 2\) when sparse; it has shape \(2, 2\)",
    ),
    "initial that misses 1": (lambda: mdp(initial=(0.5, 0.4)), r"initial must sum to 1 .*; it sums to 0.9"),
    "initial of a wrong shape": (lambda: mdp(initial=(1.0,)), r"initial must have shape \(2,\); it has shape \(1,\)"),
    "discount above 1": (lambda: mdp(discount=1.01), r"discount must be in \[0, 1\]; it is 1.01"),
    "discount nan": (lambda: mdp(discount=np.nan), r"discount must be in \[0, 1\]; it is nan"),
    "discount a word": (lambda: mdp(discount="high"), r"discount must be a number; got 'high'"),
    "terminal state outside": (
        lambda: mdp(terminal_state=[0, 2]),
        r"terminal_state\[1\] must be in 0..1; it is 2",
    ),
    "terminal states of a wrong type": (
        lambda: mdp(terminal_state=[0.5]),
        r"terminal_state must be 1 to 2 integers; got float64",
    ),
    "a grid's shape that does not fit": (
        lambda: FiniteMDP(np.eye(6)[:, None], np.zeros(6), 0, 0.9, layout=(2, 4)),
        r"^layout must be \(height, width\) with height \* width = 6, the number of states; it is \(2, 4\)$",
    ),
    "a layout of another length": (
        lambda: mdp(layout=[0.0, 1.0, 2.0]),
        r"^layout must have shape \(2,\) or \(2, c\), a place for each state; it has shape \(3,\)$",
    ),
    "nan in a layout": (
        lambda: mdp(layout=[[0.0, 1.0], [np.nan, 0.0]]),
        r"^layout\[1, 0\] must be finite; it is nan$",
    ),
    "other transitions of another size": (
        lambda: mdp().with_transitions(GRID.transitions),
        r"transitions must be for 2 states and 2 actions; they are for 9 and 4",
    ),
    "action noise above 1": (lambda: mdp().with_action_noise(1.5), r"epsilon must be in \[0, 1\]; it is 1.5"),
    # policies and evaluation
    "policy of a wrong shape": (
        lambda: oee.policy_value(GRID, np.full((9, 3), 1 / 3)),
        r"policy must have shape \(9, 4\) \(states, actions\); it has shape \(9, 3\)",
    ),
    "policy with a row of 0.97": (
        lambda: oee.policy_value(GRID, edited(UNIFORM, (4, 0), 0.22)),
        r"policy\[4\] must sum to 1 \(tolerance 1e-08\); it sums to 0.97",
    ),
    "negative policy": (
        lambda: oee.policy_value(GRID, edited(UNIFORM, (4, slice(2)), [-0.1, 0.6])),
        r"policy\[4, 0\] must be nonnegative; it is -0.1",
    ),
    "nan policy": (
        lambda: oee.occupancy(GRID, edited(UNIFORM, (4, 1), np.nan)),
        r"policy\[4, 1\] must be finite; it is nan",
    ),
    "a time-dependent policy without a horizon": (
        lambda: oee.policy_value(GRID, np.stack([UNIFORM] * 3)),
        r"policy must have shape \(9, 4\) .*it has shape \(3, 9, 4\)",
    ),
    "a time-dependent policy of another length": (
        lambda: oee.policy_value(GRID, np.stack([UNIFORM] * 3), horizon=4),
        r"policy must have shape \(9, 4\) or \(4, 9, 4\)",
    ),
    "horizon 0": (lambda: oee.policy_value(GRID, UNIFORM, horizon=0), r"horizon must be a positive integer; it is 0"),
    "horizon 2.5": (
        lambda: oee.policy_value(GRID, UNIFORM, horizon=2.5),
        r"horizon must be a positive integer; got 2.5",
    ),
    "normalized at discount 1": (
        lambda: oee.policy_value(GRID.with_discount(1.0), UNIFORM, horizon=3, normalized=True),
        r"normalized must be False at discount 1",
    ),
    "occupancy at discount 1": (
        lambda: oee.occupancy(GRID.with_discount(1.0), UNIFORM),
        r"horizon must be given: at discount 1",
    ),
    "occupancy of what": (
        lambda: oee.occupancy(GRID, UNIFORM, of="action"),
        r"of must be one of 'state', 'state_action', 'tra",
    ),
    "mixing unequal shapes": (
        lambda: oee.mix(UNIFORM, UNIFORM[:5], 0.5),
        r"policy_a and policy_b must have one shape; they have \(9, 4\) and \(5, 4\)",
    ),
    "mixing with weight 2": (lambda: oee.mix(UNIFORM, UNIFORM, 2), r"weight_of_a must be in \[0, 1\]; it is 2"),
    # logs
    "empty log": (lambda: Transitions([], [], []), r"the log is empty"),
    "unequal columns": (
        lambda: Transitions([0, 1], [0], [1, 2]),
        r"columns must have equal lengths; they have \{'state': 2, 'action': 1, 'next_state': 2\}",
    ),
    "fractional state": (lambda: Transitions([0.5], [0], [1]), r"state\[0\] must be an integer; it is 0.5"),
    "negative action": (lambda: Transitions([0], [-1], [1]), r"action\[0\] must be at least 0; it is -1"),
    "a mapping as a log": (
        lambda: Problem(GRID, {"state": [0]}),
        r"log must be Transitions; got dict \(a mapping of columns: Transitions\(\*\*log\)\)",
    ),
    "rows of numbers as a log": (
        lambda: Problem(GRID, np.zeros((3, 3))),
        r"log must be Transitions; got ndarray \(columns state, action, next_state: Transitions\(\*log\.T\)\)",
    ),
    "a log's path that is not there": (lambda: Problem(GRID, "nowhere.csv"), r"nowhere\.csv"),
    "a log that is a data frame alone": (
        lambda: Transitions(pd.DataFrame({"state": [0]})),
        r"action must be given, .*Transitions\.from_frame\(frame\)",
    ),
    "impossible moves allowed": (
        lambda: Problem(GRID, LOG, impossible="allow"),
        r"impossible must be one of 'refuse', 'drop'; got 'allow' \(to allow them: simulator\.with_support_of\(log",
    ),
    "support for all and more": (lambda: GRID.with_support_of(LOG, 2), r"epsilon must be in \(0, 1\); it is 2"),
    "support of a data frame": (
        lambda: GRID.with_support_of(pd.DataFrame({"state": [0]}), 0.1),
        r"log must be Transitions; got DataFrame \(of a data frame: Transitions\.from_frame\(log\)\)",
    ),
    "a frame without its columns": (
        lambda: Problem(GRID, pd.DataFrame({"place": [0], "action": [0]})),
        r"frame must have the columns state, action, next_state; it has place, action "
        r"\(say which it is: Transitions\.from_frame\(frame, state='its name', \.\.\.\)\)$",
    ),
    "a frame that is a file": (
        lambda: Transitions.from_frame("log.csv"),
        r"frame must be a data frame \(.*\); got str \(a file: Transitions\.load\)$",
    ),
    "a first state like a name": (
        lambda: oee.tasks.gridworld(3, 0.3).with_names([("r", k) for k in range(9)]).with_initial(("r", 9)),
        r"initial must be one of the MDP's names; it is \('r', 9\) \(did you mean \('r', \d\)\?\)",
    ),
    "a first state of numbers": (
        lambda: oee.tasks.gridworld(3, 0.3).with_names([(k // 3, k % 3) for k in range(9)]).with_initial((7, 7)),
        r"initial must be one of the MDP's names; it is \(7, 7\)",
    ),
    "a policy by the word of the command": (
        lambda: oee.interval(oee.Problem(GRID, LOG), "uniform"),
        r"states; it is 'uniform' \(oee\.uniform_policy\(simulator\)\)$",
    ),
    "names twice": (
        lambda: GRID.with_names([f"s{k // 2}" for k in range(GRID.n_states)]),
        r"state_names must differ; state_names\[1\] is 's0', as state_names\[0\] is",
    ),
    "a name that is not there": (
        lambda: oee.interval(oee.Problem(GRID.with_names(None, ["n", "east", "s", "w"]), LOG), lambda state: "eats"),
        r"policy\(0\) must be one of the MDP's names; it is 'eats' \(did you mean 'east'\?\)",
    ),
    "a policy that is a word": (
        lambda: oee.interval(oee.Problem(GRID, LOG), "north"),
        r"policy must be an action, or a distribution, for each of the \d+ states; it is 'north' \(the same in every state",
    ),
    "a policy that is one action": (
        lambda: oee.interval(oee.Problem(GRID, LOG), 2),
        r"for each of the \d+ states; it is 2",
    ),
    "a policy that returns no distribution": (
        lambda: oee.interval(oee.Problem(GRID, LOG), lambda state: [0.5, 0.4, 0, 0]),
        r"policy\(0\) must sum to 1 .*; it sums to 0.9",
    ),
    "a policy that raises": (
        lambda: oee.interval(oee.Problem(GRID, LOG), lambda state: {}[state]),
        r"policy\(0\) must be an action or a distribution; it raises KeyError: 0",
    ),
    "a policy's action out of range": (
        lambda: oee.interval(oee.Problem(GRID, LOG), [4] * GRID.n_states),
        r"policy\[0\] must be in 0\.\.3; it is 4",
    ),
    "one policy to compare": (
        lambda: oee.inference.compare_policies(oee.Problem(GRID, LOG), [[0] * GRID.n_states]),
        r"policies must be at least two to compare; there is 'policy 0'",
    ),
    "an environment's name": (
        lambda: oee.FiniteMDP.from_env("FrozenLake-v1", samples_per_pair=1),
        r"env must be a Gymnasium environment; got str \(gymnasium\.make\('FrozenLake-v1'\)\)",
    ),
    "states as words": (lambda: Transitions(["a"], [0], [1]), r"state must hold integers; it holds <U1"),
    "two-dimensional states": (
        lambda: Transitions([[0]], [0], [1]),
        r"state must have 1 dimension; it has shape \(1, 1\)",
    ),
    "reward of a log": (lambda: Transitions([0], [0], [1], [np.inf]), r"reward\[0\] must be finite; it is inf"),
    "probability above 1": (
        lambda: Transitions([0], [0], [1], behavior_probability=[1.2]),
        r"behavior_probability\[0\] must be in \[0, 1\]; it is 1.2",
    ),
    "terminated 2": (
        lambda: Transitions([0], [0], [1], terminated=[2]),
        r"terminated\[0\] must be a boolean .* it is 2",
    ),
    "an episode that is not a chain": (
        lambda: log(next_state=[2, 2, 0]),
        r"next_state\[0\] must be the state of row 1, the next of episode 0; it is 2, and state\[1\] is 1",
    ),
    "an episode that begins again": (
        lambda: log(episode=[0, 1, 0]),
        r"episode must keep the rows of an episode together; 0 begins again in row 2",
    ),
    "steps out of order": (
        lambda: log(timestep=[0, 2, 1]),
        r"timestep\[1\] must be 1 \(steps of an episode in order from 0\); it is 2 in episode 0",
    ),
    "terminated in the middle": (
        lambda: log(terminated=[1, 0, 0]),
        r"terminated\[0\] must be False: episode 0 goes on in row 1",
    ),
    "truncated in the middle": (
        lambda: log(truncated=[0, 1, 0]),
        r"truncated\[1\] must be False: episode 0 goes on in row 2",
    ),
    "discounted counts without time": (
        lambda: Transitions([0], [0], [1]).counts(2, 1, discount=0.9),
        r"log must have timesteps \(or episodes\) to be counted with a discount",
    ),
    "drawing too many": (lambda: LOG.draw(10**6, seed=0), r"n must be at most the \d+ rows of the log; it is 1000000"),
    "unknown file type": (
        lambda: LOG.save("log.xlsx"),
        r"path must end in .npz, .csv, .csv.gz, .parquet, or be a Minari folder or id",
    ),
    "unknown file type to load": (
        lambda: Transitions.load("log.xlsx"),
        r"path must end in .npz, .csv, .csv.gz, .parquet",
    ),
    "an MDP to another suffix": (lambda: GRID.save("mdp.csv"), r"path must end in .npz; it is 'mdp.csv'"),
    # problems
    "state outside the simulator": (
        lambda: Problem(GRID, Transitions([0, 9], [0, 0], [3, 3])),
        r"log.state\[1\] must be in 0..8, the simulator's; it is 9 \(1 such rows in all\)",
    ),
    "action outside the simulator": (
        lambda: Problem(GRID, Transitions([0], [4], [3])),
        r"log.action\[0\] must be in 0..3, the simulator's; it is 4",
    ),
    "a move without probability": (
        lambda: Problem(GRID, Transitions([0, 0, 0, 3], [0, 0, 0, 1], [8, 8, 3, 5])),
        r"gives probability 0 to 2 different moves \(3 of 4 in all\), the heaviest: s=0, a=0 -> s'=8 \(2\); s=3, a=1 -> s'=5",
    ),
    "termination where the simulator goes on": (
        lambda: Problem(GRID, Transitions([0], [0], [3], terminated=[True])),
        r"log.terminated\[0\] must be False, or the simulator must be over in state 3",
    ),
    "a log that is an array": (lambda: Problem(GRID, np.zeros((3, 3))), r"log must be Transitions; got ndarray"),
    "a simulator that is an array": (lambda: Problem(GOOD, LOG), r"simulator must be a FiniteMDP; got ndarray"),
    "log rewards that are not there": (
        lambda: Problem(GRID, without("reward"), rewards="log"),
        r"rewards must be 'simulator' where the log has no reward column",
    ),
    "unknown rewards": (
        lambda: Problem(GRID, LOG, rewards="both"),
        r"rewards must be one of 'simulator', 'log'; got 'both'",
    ),
    "behaviour policy of a wrong shape": (
        lambda: Problem(GRID, LOG, behavior_policy=np.ones((9, 1))),
        r"behavior_policy must have shape \(9, 4\)",
    ),
    # estimators
    "importance sampling without probabilities": (
        lambda: ImportanceSampling()(Problem(GRID, without("behavior_probability")), UNIFORM),
        r"needs behaviour probabilities: the log has none; give Problem\(behavior_policy=...\) \(--behavior\), or use beh",
    ),
    "a taken action with probability 0": (
        lambda: ImportanceSampling()(
            Problem(GRID, Transitions(**(LOG.columns() | {"behavior_probability": np.zeros(len(LOG))}))), UNIFORM
        ),
        r"log.behavior_probability must be positive for the actions taken; it is 0 in row 0 \(s=0, a=\d; \d+ such rows",
    ),
    "a taken action that the behaviour policy never takes": (
        lambda: ImportanceSampling()(
            Problem(GRID, without("behavior_probability"), behavior_policy=oee.tasks.gridworld_expert(3)), UNIFORM
        ),
        r"behavior_policy must be positive for the actions taken; it is 0 in row \d+ \(s=\d",
    ),
    "importance sampling of a bag": (
        lambda: ImportanceSampling()(Problem(GRID, LOG.draw(5, seed=0)), UNIFORM),
        r"importance sampling needs whole episodes: give the log its episode column, or Problem\(episodes=...\)",
    ),
    "unknown kind": (
        lambda: ImportanceSampling("weighted"),
        r"kind must be one of 'trajectory', 'per_decision'; got 'weighted'",
    ),
    "unknown ragged": (lambda: ImportanceSampling(ragged="drop"), r"ragged must be one of 'pad', 'zero'; got 'drop'"),
    "unknown behaviour": (
        lambda: ImportanceSampling(behavior="known"),
        r"behavior must be one of 'recorded', 'estimated'",
    ),
    "unknown fallback": (lambda: ModelBased("go"), r"fallback must be one of 'stay', 'simulator'; got 'go'"),
    "unknown ratio": (
        lambda: OffEnvironment("joined"),
        r"ratio must be one of 'conditional', 'ratio_of_ratios', 'joint'; got",
    ),
    "ratio of a wrong type": (
        lambda: OffEnvironment(3.0),
        r"ratio must be a method's name, a TransitionRatio or a function",
    ),
    "unknown evaluation": (
        lambda: OffEnvironment(evaluation="mc"),
        r"evaluation must be one of 'exact', 'monte_carlo'",
    ),
    "unknown weighting": (
        lambda: OffEnvironment(weighting="step"),
        r"weighting must be one of 'per_decision', 'trajectory'",
    ),
    "no rollouts": (lambda: OffEnvironment(n_rollouts=0), r"n_rollouts must be a positive integer; it is 0"),
    "an oracle outside the support": (
        lambda: Oracle(GRID)(Problem(oee.tasks.gridworld(3, 0.0), Transitions([0], [0], [3])), UNIFORM),
        r"target must stay where the simulator has probability: it gives probability 0 to",
    ),
    "unknown estimator": (
        lambda: oee.evaluate(Problem(GRID, LOG), UNIFORM, estimators=["oe"]),
        r"estimators must be among simulator, oee, .*; got 'oe' \(did you mean 'oee'\?\)",
    ),
    "an oracle without a target": (
        lambda: oee.evaluate(Problem(GRID, LOG), UNIFORM, estimators=["oracle"]),
        r"estimator 'oracle' needs the target environment",
    ),
    "no estimators": (
        lambda: oee.evaluate(Problem(GRID, LOG), UNIFORM, estimators=[]),
        r"estimators must name at least one",
    ),
    "an estimator that returns a number": (
        lambda: oee.evaluate(Problem(GRID, LOG), UNIFORM, estimators={"mine": lambda problem, policy, seed: 1.5}),
        r"what estimator 'mine' returns must be an Estimate, Estimate\(value\); got float",
    ),
    "no policies": (lambda: oee.evaluate(Problem(GRID, LOG), {}), r"policies must hold at least one; it is empty"),
    "a bad policy among several": (
        lambda: oee.evaluate(Problem(GRID, LOG), {"mine": UNIFORM * 0.9}),
        r"policy 'mine'\[0\] must sum to 1 .*; it sums to 0.9",
    ),
    "confidence 1": (
        lambda: oee.evaluate(Problem(GRID, LOG), UNIFORM, confidence=1),
        r"confidence must be in \(0, 1\); it is 1",
    ),
    # ratios
    "unbounded ratio": (
        lambda: oee.density_ratio([1, 1, 1], [1, 0, 0]),
        r"the program is unbounded at the 2 entries with q = 0 < p \(the first: 1, 2\); give a finite upper bound",
    ),
    "lower above upper": (
        lambda: oee.density_ratio([1, 1], [1, 1], lower=2, upper=1.5, normalized=False),
        r"lower must not exceed upper; they are 2 and 1.5",
    ),
    "a box without 1": (
        lambda: oee.density_ratio([1, 1], [1, 1], lower=1.5, upper=2),
        r"the box \[lower, upper\] must contain 1 for sum q g = 1 to be possible; it is \[1.5, 2\]",
    ),
    "negative lower": (lambda: oee.density_ratio([1], [1], lower=-1), r"lower must be in \[0, inf\); it is -1"),
    "negative weights": (lambda: oee.density_ratio([1, -1], [1, 1]), r"p\[1\] must be nonnegative; it is -1"),
    "nan weights": (lambda: oee.density_ratio([1, 1], [1, np.nan]), r"q\[1\] must be finite; it is nan"),
    "a class without room": (
        lambda: oee.density_ratio([0, 2, 1], [1, 1, 1], features=np.arange(3.0)),
        r"features must span a function that is above 0, with sum q g = 1; none is at all points \(a constant",
    ),
    "a class that is 0 at a point": (
        lambda: oee.density_ratio(
            [2, 1, 1, 0, 2, 2],
            [0, 2, 1, 0, 0, 0],
            features=[[2, -2, -2], [2, -1, 2], [1, 1, 0], [0, 0, 0], [-1, -1, -1], [2, 1, 2]],
        ),
        r"features must span a function that is above 0, with sum q g = 1; none is at all points \(a constant",
    ),
    "all-zero p": (lambda: oee.density_ratio([0, 0], [1, 1]), r"p must have a positive, finite sum; it is 0"),
    "all-zero q": (lambda: oee.density_ratio([1, 1], [0, 0]), r"q must have a positive, finite sum; it is 0"),
    "unequal lengths": (lambda: oee.density_ratio([1], [1, 1]), r"p and q must have one length; they have 1 and 2"),
    "matrices": (lambda: oee.density_ratio([[1]], [[1]]), r"p must have 1 dimension\(s\); it has shape \(1, 1\)"),
    "negative ridge": (
        lambda: oee.density_ratio([1], [1], ridge=-1.0),
        r"ridge must be in \[0, inf\); it is -1",
    ),
    "a ridge that is infinite at n": (
        lambda: oee.density_ratio([2], [1], ridge=lambda n: np.inf),
        r"ridge\(2\) must be finite; it is inf",
    ),
    "an infinite center": (
        lambda: oee.density_ratio([1], [1], ridge=1, toward=np.inf),
        r"toward must be finite; it is inf",
    ),
    "an infinite lower": (
        lambda: oee.density_ratio([1], [1], lower=np.inf, normalized=False),
        r"lower must be finite; it is inf",
    ),
    "an upper of 0": (
        lambda: oee.density_ratio([1], [1], upper=0, normalized=False),
        r"upper must be positive: .*; it is 0",
    ),
    "a sum that overflows": (
        lambda: oee.density_ratio([1e308] * 2, [1, 1]),
        r"p must have a positive, finite sum; it is inf",
    ),
    "a ridge that overflows": (
        lambda: oee.density_ratio([1, 2], [2, 1], ridge=1e308, toward=1),
        r"the program must have numbers that double precision holds; ridge 1e\+308",
    ),
    "a centre that overflows": (
        lambda: oee.density_ratio([1, 2], [2, 1], ridge=1, toward=1e300, loss="chi2", normalized=False),
        r"the program must have numbers that double precision holds; ridge 1 towards 1e\+300",
    ),
    "a ridge that overflows in rows": (
        lambda: oee.ratio.Conditional(ridge=1e308).fit(LOG, GRID),
        r"the options of method 'Conditional' must make a program that double precision holds; .*ridge 1e\+308, toward 1$",
    ),
    "a centre that overflows in rows": (
        lambda: oee.ratio.Conditional(ridge=1, toward=1e308).fit(LOG, GRID),
        r"the options of method 'Conditional' must make .*ridge 1, toward 1e\+308$",
    ),
    "a ridge of a class that overflows": (
        lambda: oee.ratio.InClass(features=np.ones((GRID.transitions.nnz, 1)), ridge=1e308).fit(LOG, GRID),
        r"the options of method 'linear' must make a program that double precision holds; .*ridge 1e\+308",
    ),
    "rewards whose squares overflow, compared": (
        lambda: oee.inference.compare_policies(Problem(HUGE, LOG), {"a": UNIFORM, "b": [0] * 9}),
        r"the simulator's rewards must be at most 1e\+140, .*; they reach 7.6e\+199: give them in a larger unit",
    ),
    "rewards whose squares overflow, robust": (
        lambda: oee.interval(Problem(HUGE, LOG), UNIFORM, method="robust"),
        r"the simulator's rewards must be at most 1e\+140, .*; they reach 7.6e\+199",
    ),
    "complex weights": (
        lambda: oee.density_ratio([1j], [1]),
        r"p must be an array of numbers; got list \(complex numbers\)",
    ),
    "an unknown loss": (lambda: oee.density_ratio([1], [1], loss="l2"), r"loss must be one of .kl., .chi2.; got .l2."),
    "a word for a ridge": (lambda: oee.density_ratio([1], [1], ridge="a"), r"ridge must be a number; got 'a'"),
    "data of the simulator where it has no use": (
        lambda: oee.transition_ratio(LOG, GRID, simulator_data="exact"),
        r"simulator_data must not be given with method 'conditional', which does not use it; got 'exact'",
    ),
    "a prior where it has no use": (
        lambda: oee.transition_ratio(LOG, GRID, method="ratio_of_ratios", strength=2.0),
        r"strength must not be given with method 'ratio_of_ratios', which does not use it; got 2.0",
    ),
    "simulator data that a problem cannot use": (
        lambda: Problem(GRID, LOG, simulator_data="foo"),
        r"simulator_data must be Transitions, 'exact' or None; got 'foo'",
    ),
    "a true ratio of what": (lambda: oee.true_ratio(None, GRID), r"target must be a FiniteMDP; got NoneType"),
    "an oracle of what": (lambda: Oracle(5), r"target must be a FiniteMDP; got int"),
    "a value of what": (lambda: oee.policy_value(GOOD, UNIFORM), r"mdp must be a FiniteMDP; got ndarray"),
    "an occupancy of what": (lambda: oee.occupancy(GOOD, UNIFORM), r"mdp must be a FiniteMDP; got ndarray"),
    "a ratio of another simulator": (
        lambda: OffEnvironment(oee.true_ratio(GRID, GRID))(
            Problem(oee.tasks.gridworld(3, 0.0), Transitions([0], [0], [3])), UNIFORM
        ),
        r"ratio must have the support of this simulator's transitions",
    ),
    "a ratio of another size": (
        lambda: OffEnvironment(oee.true_ratio(mdp(), mdp()))(Problem(GRID, LOG), UNIFORM),
        r"ratio must be for \(36, 9\) rows and states; it is for \(4, 2\)",
    ),
    "a seed that is a word": (
        lambda: oee.sample_episodes(GRID, UNIFORM, 1, 1, seed="a"),
        r"seed must be what numpy.random",
    ),
    "a negative seed": (lambda: LOG.draw(3, seed=-1), r"seed must be what numpy.random.default_rng takes; got -1"),
    "horizon True": (
        lambda: oee.policy_value(GRID, UNIFORM, horizon=True),
        r"horizon must be a positive integer; got True",
    ),
    "a number as a word": (lambda: GRID.with_action_noise("0.1"), r"epsilon must be a number; got '0.1'"),
    "complex transitions": (lambda: mdp(GOOD + 0j), r"transitions must be an array of numbers; .*complex numbers"),
    "complex sparse transitions": (
        lambda: mdp(sparse.csr_array(GOOD.reshape(4, 2) + 0j)),
        r"transitions must be real numbers; they are complex",
    ),
    "no rows chosen": (lambda: LOG.select([]), r"rows must choose at least one row; they choose none"),
    "rows that are not there": (
        lambda: LOG.select([10**6]),
        r"rows must be a mask or row numbers of the log's \d+ rows",
    ),
    "counts for a word": (lambda: LOG.counts("3", 2), r"n_states must be a positive integer; got '3'"),
    "ragged states": (lambda: Transitions([[0], [1, 2]], [0], [1]), r"state must be a column of integers"),
    "ragged episodes": (
        lambda: Transitions([0, 0], [0, 0], [0, 0], episode=[[], [1]]),
        r"episode must be a column of integers",
    ),
    "an episode number past all integers": (
        lambda: Transitions([0], [0], [1], episode=[1e300]),
        r"episode\[0\] must be an integer; it is 1e\+300",
    ),
    "a state past 2**63": (
        lambda: Transitions(np.array([2**63 + 5], dtype=np.uint64), [0], [1]),
        r"state\[0\] must be below",
    ),
    "saving into a folder that is not there": (lambda: GRID.save("nowhere/mdp.npz"), r"no such folder.*nowhere"),
    "unknown solver": (
        lambda: oee.density_ratio([1], [1], solver="dial"),
        r"solver must be 'dual' or one of .*; got 'dial'",
    ),
    "unknown method": (
        lambda: oee.transition_ratio(LOG, GRID, method="joined"),
        r"method must be one of 'conditional', 'tied', 'linear', 'kernel', 'ratio_",
    ),
    "unknown prior": (
        lambda: oee.transition_ratio(LOG, GRID, prior="flat"),
        r"prior must be one of 'average', 'tilt', 'simulator', 'none'; got 'f",
    ),
    "negative strength": (
        lambda: oee.transition_ratio(LOG, GRID, strength=-1),
        r"strength must be in \[0, inf\); it is -1",
    ),
    "dense counts": (
        lambda: oee.transition_ratio(np.zeros((36, 9)), GRID),
        r"log_or_counts must be Transitions or sparse counts; got ndarray",
    ),
    "no counts": (
        lambda: oee.transition_ratio(sparse.csr_array((36, 9)), GRID),
        r"log_or_counts must have at least one move",
    ),
    "counts of another MDP": (
        lambda: oee.transition_ratio(sparse.csr_array(np.ones((4, 2))), GRID),
        r"counts must have shape \(36, 9\) .*; they have shape \(4, 2\)",
    ),
    "negative counts": (
        lambda: oee.transition_ratio(GRID.transitions.sign() * -1.0, GRID),
        r"counts must be finite and nonnegative; at s=0, a=0 -> s'=0 there is -1",
    ),
    "unknown simulator data": (
        lambda: oee.transition_ratio(LOG, GRID, method="ratio_of_ratios", simulator_data="most"),
        r"simulator_data must be Transitions, 'exact' or None; got 'most'",
    ),
    "a ratio of another shape": (
        lambda: oee.exact.reweight(GRID, sparse.csr_array(np.ones((4, 2)))),
        r"ratio must be sparse of shape \(36, 9\), row s\*A \+ a; got \(4, 2\)",
    ),
    "a true ratio of unequal MDPs": (
        lambda: oee.true_ratio(mdp(), GRID),
        r"target and simulator must have the same states and",
    ),
    # sampling
    "no episodes": (
        lambda: oee.sample_episodes(GRID, UNIFORM, 0, 5, seed=0),
        r"n_episodes must be a positive integer; it is 0",
    ),
    "a distribution that misses 1": (
        lambda: oee.sample_transitions(GRID, np.ones((9, 4)), 5, seed=0),
        r"distribution must sum to 1 .*; it sums to 36",
    ),
    "an unknown environment": (
        lambda: oee.tasks.toy_text("FrozenLake-v9"),
        r"'FrozenLake-v9' is neither; near: FrozenLake",
    ),
    "a slip above 1": (lambda: oee.tasks.gridworld(3, 1.1), r"slip must be in \[0, 1\]; it is 1.1"),
    "a rate of 1/0": (
        lambda: oee.tasks.named_task("FrozenLake-v1:success_rate=1/0"),
        r"success_rate must be a finite number; '1/0' divides by 0",
    ),
    "a slip given twice": (
        lambda: oee.tasks.named_task("gridworld:3,slip=.1,slip=.2"),
        r"slip must be given once; '3,slip=.1,slip=.2' has it twice",
    ),
    "a map that is none": (
        lambda: oee.tasks.named_task("FrozenLake-v1:desc=x"),
        r"environment 'FrozenLake-v1' does not take these arguments \{'desc': 'x'\}",
    ),
    "a rate of 7": (
        lambda: oee.tasks.named_task("FrozenLake-v1:success_rate=7"),
        r"environment 'FrozenLake-v1' with success_rate=7 is no finite MDP: transitions\[0, 0\] must sum to 1",
    ),
    "a policy of texts": (
        lambda: oee.policy_value(GRID, np.full((9, 4), "0.25")),
        r"policy must be an array of numbers; got ndarray \(text or dates\)",
    ),
    "more episodes than memory": (
        lambda: oee.sample_episodes(GRID, UNIFORM, 10**14, 5, seed=0),
        r"n_episodes must be small enough for this machine's memory; 100000000000000 needs 6.71e\+06 GiB",
    ),
    "a seed that is a set": (
        lambda: oee.evaluate(Problem(GRID, LOG), UNIFORM, estimators=["oee"], seed={1}),
        r"seed must be what numpy.random.SeedSequence takes; got \{1\}",
    ),
    "an MDP that is none": (lambda: oee.uniform_policy(None), r"mdp must be a FiniteMDP; got NoneType"),
    "a problem that is none": (lambda: OffEnvironment()(None, UNIFORM), r"problem must be a Problem; got NoneType"),
    "an estimate that is none": (
        lambda: oee.estimators.calibrate(3, discretised=1.0, continuous=1.0),
        r"estimate must be an Estimate; got int",
    ),
    "a payment that is neither": (
        lambda: oee.tasks.gridworld(3, 0.1, pay="both"),
        r"pay must be one of 'next', 'current'",
    ),
}


@pytest.mark.parametrize("name", TABLE)
def test_bad_calls(name):
    call, text = TABLE[name]
    with pytest.raises((ValueError, FileNotFoundError), match=text):
        call()


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
