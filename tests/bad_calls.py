"""The table of bad calls: a call, and how its error begins, with the argument, the
place and the rule; "..." is anything.

A line that begins with blanks belongs to the one above. The names are those of
tests/test_bad_calls.py and of the package.
"""

TABLE = r"""
# MDPs
mdp(edited(GOOD, (1, 1), [0.3, 0.67]))  ->  transitions[1, 1] must sum to 1
mdp(rows(edited(GOOD, (1, 1), [0.3, 0.6])))  ->  transitions[1, 1] must sum to 1
mdp(rows(edited(GOOD, (1, 0), 0.0)))  ->  transitions[1, 0] must sum to 1 ...; it sums to 0 (...: available=)
mdp(edited(LACKING, (1, 1), 0.0), available=CAN)  ->  transitions[1, 1] must sum to 1
mdp(edited(GOOD, (0, 1), [-0.5, 1.5]))  ->  transitions[0, 1, 0] must be nonnegative
mdp(rows(edited(GOOD, (0, 1), [-0.5, 1.5])))  ->  transitions must be nonnegative; at s=0, a=1 -> s'=0
mdp(edited(GOOD, (0, 1, 0), np.nan))  ->  transitions[0, 1, 0] must be finite
mdp(rows(edited(GOOD, (0, 1, 0), np.nan)))  ->  transitions must be finite; at s=0, a=1 -> s'=0
mdp(np.ones((2, 2, 3)) / 3)  ->  transitions must have shape (S, A, S), or
mdp(np.ones((3, 2, 2)) / 2)  ->  transitions must have shape ...: the axes look like (A, S, S); use P.transpose(1, 0, 2)
mdp(np.eye(2))  ->  transitions must have shape (S, A, S), or (S*A, S) as a scipy.sparse array,
mdp(sparse.csr_array(np.ones((3, 2))))  ->  transitions must have shape ...(S*A, S) as a scipy.sparse array,
mdp([["a"]])  ->  transitions must be an array of numbers
mdp(np.zeros((0, 1, 0)))  ->  transitions must have shape ... at least one state and one action
mdp(GOOD + 0j)  ->  transitions must be an array of numbers; ...complex numbers
mdp(rows(GOOD + 0j))  ->  transitions must be real numbers
mdp(rewards=np.zeros(3))  ->  rewards must have shape (2,)
mdp(rewards=np.array([0.0, np.inf]))  ->  rewards[1] must be finite
mdp(rewards=np.full((2, 2, 2), np.nan))  ->  rewards[0, 0, 0] must be finite where the transition has a probability
mdp(rewards=edited(np.zeros((2, 2, 2)), (0, 1, 0), np.inf))  ->  rewards[0, 1, 0] must be finite
mdp(rewards=rows(edited(np.zeros((2, 2, 2)), (0, 1, 1), np.nan)))  ->  rewards must be finite; at s=0, a=1 -> s'=1
mdp(rewards=sparse.csr_array(np.ones((2, 2))))  ->  rewards must have shape (4, 2) when sparse
mdp(initial=(0.5, 0.4))  ->  initial must sum to 1
mdp(initial=(1.0,))  ->  initial must have shape (2,)
mdp(terminal_state=[0, 2])  ->  terminal_state[1] must be in 0..1
mdp(terminal_state=[0.5])  ->  terminal_state must be 1 to 2 integers
mdp(available=[[1, 1], [0, 0]])  ->  available[1] must have an action that can be taken; state 1 has none
mdp(available=[[0, 0], [0, 1]], state_names=["a", "b"])  ->  available[0] must have ...; state a has none
mdp(available=CAN)  ->  transitions[1, 0] must be zeros where the action cannot be taken; s=1, a=0 has a next state, and
  available[1, 0] is False
mdp(rows(GOOD), available=CAN, action_names=["x", "y"])  ->  transitions[1, 0] must be zeros ...; s=1, a=x has
mdp(available=[[1, 1]])  ->  transitions must be for 1 states and 2 actions, as available is; they are for 2 and 2
mdp(available=[1, 1])  ->  available must have shape (S, A), a row for each state and a column for each action
mdp(available=[[1, 2], [1, 1]])  ->  available[0, 1] must be True or False; it is 2
mdp(available=[[1.0, 0.5], [1, 1]])  ->  available must be True or False; its entries are float64
mdp(available="all")  ->  available must have shape (S, A)
FiniteMDP(mdp(LACKING, available=CAN).csr, [0, 1], 0, 0.9)  ->  transitions[1, 0] must sum to 1
mdp(LACKING, available=CAN).with_transitions(GOOD)  ->  new transitions[1, 0] must be zeros where the action cannot be
mdp(LACKING, available=CAN).with_transitions(GRID.transitions)  ->  new transitions must be for 2 states and 2 actions
recycling_robot(alpha=1.5)  ->  alpha must be in [0, 1]
recycling_robot(beta="often")  ->  beta must be a number
recycling_robot(rescue_reward=np.inf)  ->  rescue_reward must be
named_task("recycling_robot:0.5,0.5,0.5")  ->  simulator 'recycling_robot:0.5,0.5,0.5' must be like
policy_value(recycling_robot(), [2, 1])  ->  policy[0, 2] must be 0, for action recharge cannot be taken in state high
policy_value(recycling_robot(), lambda state: "recharge")  ->  policy[0, 2] must be 0
value_range(recycling_robot(), np.full((2, 3), 1 / 3), 0.5, 2)  ->  policy[0, 2] must be 0
Problem(recycling_robot(), Transitions(["high"], ["recharge"], ["high"]))  ->  log[0] must have an action that can be
Problem(recycling_robot(), Transitions([0], [0], [0]), behavior_policy=[2, 2])  ->  behavior_policy[0, 2] must be 0
Problem(recycling_robot(), sparse.coo_array(([1], ([2], [0])), shape=(6, 2)))  ->  counts[2] must have an action that
sample_transitions(recycling_robot(), np.full((2, 3), 1 / 6), 9, seed=0)  ->  distribution[0, 2] must be 0
sample_episodes(recycling_robot(), [2, 2], 3, 4, seed=0)  ->  policy[0, 2] must be 0
plan_data_collection(recycling_robot(), [2, 2], n=9)  ->  policies[0, 2] must be 0
efficiency_bound(recycling_robot(), [0, 0], np.full((2, 3), 1 / 6))  ->  data_distribution[0, 2] must be 0
ModelBased().limit(recycling_robot(), mdp(np.full((2, 3, 2), 0.5)), [0, 0])  ->  target must have the simulator's available
FiniteMDP.from_log(LOG, available=[[1, 1, 1, 1]])  ->  available must have shape (9, 4), of the log's states and actions
FiniteMDP.from_log(LOG, available=np.eye(9, 4) + np.eye(9, 4, -4) + np.eye(9, 4, -8) == 1)  ->  log[
GRID.with_layout((2, 4))  ->  layout must be (height, width) with height * width = 9, the number of states
GRID.with_layout((0, 9))  ->  layout must be (height, width) with height * width = 9
mdp().with_transitions(GRID.transitions)  ->  new ...transitions must be for 2 states and 2 actions
GRID.save("mdp.csv")  ->  path must end in .npz; it is 'mdp.csv'
GRID.save("mdp.npz.gz")  ->  path must end in .npz
GRID.save("npz")  ->  path must end in .npz
GRID.save("nowhere/mdp.npz")  ->  [Errno ...no such folder...nowhere
HALL.with_layout(PLACES[:2])  ->  layout must have shape (3,) or (3, c), a place
HALL.with_layout(np.zeros((3, 0)))  ->  layout must ...; it has shape (3, 0)
HALL.with_layout(np.zeros((3, 1, 1)))  ->  layout must have 1 or 2 dimension(s)
HALL.with_layout([[0, 1], [2, np.nan], [0, 0]])  ->  layout[1, 1] must be finite
HALL.with_layout([0, 1, -np.inf])  ->  layout[2] must be finite
HALL.with_layout(["a", "b", "c"])  ->  layout must be an array of numbers
displacements(HALL, layout=[1j, 2, 3])  ->  layout must be an array of numbers
oee.plots.Map.of_shape(2, 10**12)  ->  rows must be small enough
oee.plots.Map.of_shape(10**12, 2)  ->  rows must be small enough
oee.plots.Map.of_shape(0, 2)  ->  rows must be a positive integer
mdp([sparse.eye_array(2), sparse.eye_array(3)])  ->  transitions[1] must have shape (2, 2), of states and next states
mdp([sparse.eye_array(2), np.eye(2)])  ->  transitions must be an array of numbers; got list (a sparse matrix: give .toarray())
mdp(initial=sparse.csr_array([[1.0, 0.0]]))  ->  initial must be ...: give .toarray()
mdp(available=sparse.csc_array(np.ones((2, 2))))  ->  available must be ...: give .toarray()
mdp({0: sparse.eye_array(2), 1: sparse.eye_array(2)})  ->  transitions must be ...; got dict, ...: list(mapping.values())
mdp(rewards={"a": 0.0, "b": 1.0})  ->  rewards must be ...; got dict, ...: list(mapping.values())
mdp(spoilt(sparse.csr_array, None))  ->  transitions must be a sound sparse matrix; ...; it is a NoneType
mdp(spoilt(sparse.coo_array, [0.5]))  ->  transitions must be a sound sparse matrix; ...; it is a list
mdp(rewards=spoilt(sparse.csc_array, "x"))  ->  rewards must be a sound sparse matrix; ...; it is a str
mdp(rewards=SIGNALLING)  ->  rewards[1] must be finite; it is nan
check_policy(sparse.csr_array(UNIFORM), GRID)  ->  policy must be ...: give .toarray()
efficiency_bound(GRID, UNIFORM, sparse.csr_array(UNIFORM / 9))  ->  data_distribution must be ...: give .toarray()
check_policy(Trained(), GRID)  ->  policy must be ...Trained, which has a method predict ...: lambda s: model.predict(s)[0]
evaluate(P, [Trained(), Trained()])  ->  policy 'policy' must be ...a list of Trained...: lambda s: model.predict(s)[0]
check_policy(lambda s: [np.array(1), None, None, None], GRID)  ->  policy(0) must be an action...: return the action alone
check_policy(lambda s: np.array([1, None], dtype=object), GRID)  ->  policy(0) must be an action...: return the action alone
check_policy(lambda s: [2, {}, {}, {}], GRID)  ->  policy(0) must be an action...: return the action alone
interval(P, UNIFORM, method="robust", seed={})  ->  seed must be what numpy.random.default_rng takes
interval(P, UNIFORM, method="delta", n_bootstrap=-3)  ->  n_bootstrap must be a positive integer; it is -3
compare_policies(P, [UNIFORM, UNIFORM], n_bootstrap=1.5)  ->  n_bootstrap must be a positive integer
density_ratio([1, 1], [1, 1], seed="q")  ->  seed must be what numpy.random.default_rng takes
mdp(GOOD.astype(np.float32).astype(float) * (1 + 1e-7))  ->  transitions[0,
  0] must sum to 1 ... (of single precision, or rounded? Divide each row by its sum)
mdp(initial=[0.3333333, 0.6666666])  ->  initial must sum to 1 ... (of single precision, or rounded? Divide by the sum)
mdp(rewards=sparse.coo_array(([1.0, 2.0], ([3, 3], [1, 1])), shape=(4, 2)))  ->  rewards[3,
  1] must have one value; it has 1 and 2
mdp(rewards=np.ma.array([0.0, 1.0], mask=[0, 1]))  ->  rewards[1] must be finite; it is nan
mdp(rewards=pd.Series([0.0, 1.0], index=["b", "a"]))  ->  rewards
  must be a plain array, ...; got Series whose index (b, a) is not 0, 1, 2, ...
mdp(rewards=pd.DataFrame({"go": [0.0, 1.0], "stay": [0.0, 1.0]}))  ->  rewards
  must be ...; got DataFrame whose columns (go, stay) are not 0, 1, 2
mdp(discount=True)  ->  discount must be a number; got True
mdp(discount=1.0000001)  ->  discount must be in [0, 1]; it is 1.0000001
mdp(discount=np.ma.masked)  ->  discount must have a value; it is masked
mdp(terminal_state=np.ma.array([0, 1], mask=[0, 1]))  ->  terminal_state[1] must have a value; it is masked
Transitions([0, pd.NA], [0, 0], [1, 1])  ->  state[1] must have a value; it is missing
Transitions([0, 1], np.ma.array([0, 0], mask=[1, 0]), [1, 1])  ->  action[0] must have a value; it is masked
occupancy(GRID, np.ma.array(UNIFORM, mask=UNIFORM > 1), horizon=np.ma.masked)  ->  horizon must have a value; it is masked
sample_transitions(GRID, EVEN, 9, seed=range(10**8))  ->  seed
  must be what numpy.random.default_rng takes; ... longer than 10000
sample_transitions(GRID, EVEN, 9, seed=True)  ->  seed must be an integer; got True
sample_transitions(GRID, EVEN, 9, seed=np.array([0.5]))  ->  seed
  must be what numpy.random.default_rng takes; ...an array of float64

# ranges without an end in sight
mdp(range(10**12))  ->  transitions must have at most 10000000 numbers as a range; it has 1000000000000 (more ...: numpy.arange)
mdp([[[0.5, 0.5]], range(10**12)])  ->  transitions must have at most 10000000 numbers as a range
mdp(rewards=range(10**30))  ->  rewards must have at most 10000000 numbers as a range
mdp(rewards=range(0, -(10**30), -3))  ->  rewards must have at most 10000000 numbers as a range
mdp(rewards=range(10**9000))  ->  rewards must have at most 10000000 numbers as a range; it has 2**63 or more
mdp(rewards=[range(10**8)] * 10**5)  ->  rewards must have at most 10000000 numbers as a range
mdp(discount=range(10**12))  ->  discount must be a number; got range(0, 1000000000000)
mdp(discount=[0.9])  ->  discount must be a number; got [0.9]
policy_value(GRID, UNIFORM, horizon=range(10**8))  ->  horizon must be a positive integer; got range(0, 100000000)
policy_value(GRID, UNIFORM, horizon=(3,))  ->  horizon must be a positive integer; got (3,)
policy_value(GRID, range(10**12))  ->  policy must have at most 10000000 numbers as a range
Problem(GRID, LOG, behavior_policy=[range(10**7)] * 9)  ->  behavior_policy must have at most 10000000 numbers as a range
Transitions(range(10**12), [0], [0])  ->  state must have at most 10000000 numbers as a range
Estimate(range(10**12))  ->  value must be a number; got range(0, 1000000000000)
Estimate(1.0, standard_error=[0.5])  ->  standard_error must be a number; got [0.5]
HALL.with_names(range(10**12))  ->  state_names must be ..., at most 10000000 of them; got range(0, 1000000000000)
HALL.with_names(action_names=range(10**30))  ->  action_names must be ..., at most 10000000 of them; got range(0, 1000
Transitions.concatenate(range(10**8))  ->  logs must be ..., at most 10000000 of them; got range(0, 100000000)

# functions that cannot be called as they must, or that fail
evaluate(P, {"a": UNIFORM}, tie=lambda s: 0)  ->  tie must be a function that can be called as tie(state, action, next_state),
  of three arrays of integers; it raises TypeError: ...takes 1 positional argument but 3 were given
evaluate(P, UNIFORM, features=object)  ->  features must be ...called as features(state, action, next_state), ...TypeError
interval(P, UNIFORM, tie=lambda *_: 1 / 0)  ->  tie must be ...; it raises ZeroDivisionError: division by zero
oee.report.contest(P, [UNIFORM, UP], features=lambda: 0)  ->  features must be ...; it raises TypeError
zeta(features=lambda s: 0.0)  ->  features must be ...; it raises TypeError
zeta(tie=lambda *_: {}["key"])  ->  tie must be ...; it raises KeyError: 'key'
zeta(coordinates=PLACE, method="kernel", kernel=lambda x: x)  ->  kernel must be ...called as kernel(x, c), ...TypeError
zeta(ridge=lambda: 1)  ->  ridge must be a function that can be called as ridge(n), n the sample size; it raises TypeError
density(ridge=lambda n: 1 / 0)  ->  ridge must be ...; it raises ZeroDivisionError: division by zero
density(ridge=object)  ->  ridge must be ...; it raises TypeError
Marginalized(features=lambda s: s)(P, UNIFORM)  ->  features must be ...called as features(state, action), ...TypeError
figure_png(draw=object)  ->  draw must be a function that can be called as draw(ax), ...; it raises TypeError
figure_svg(lambda ax: ax.plots([0, 1]), name="a", title="b", description="c")  ->  draw must be ...; it raises AttributeError
figure_png(draw=lambda ax: policy_value(GRID, UNIFORM, horizon=0))  ->  horizon must be a positive integer; it is 0
fit_parameters(object, {"gravity": 10.0}, pole())  ->  start must name parameters that task_of takes
fit_parameters(lambda gravity: 1 / 0, {"gravity": 10.0}, pole())  ->  task_of must be ...called as task_of(gravity=...)
fit_parameters(dict, {"gravity": 10.0}, pole())  ->  task_of(**start) must be a ContinuousTask; got dict

# names of states and actions
HALL.with_names(["caf\u00e9", "cafe\u0301", "c"])  ->  state_names
  must differ; state_names[1] is ... (in characters: 'cafe\u0301' and 'caf\xe9')
HALL.with_names(["h\u0430ll", "hall", "c"])  ->  state_names
  must differ; state_names[1] is 'hall', which looks as state_names[0] does
HALL.with_initial("h\u0430ll")  ->  initial must be one of ... (which looks like 'hall', in other characters: 'h\u0430ll')
HALL.with_names(["a", "b"])  ->  state_names must have 3 names, one for each
HALL.with_names(action_names=["a", "b", "c"])  ->  action_names must have 2 names, one for each
HALL.with_names(["(0, 1)", "b", (0, 1)])  ->  state_names must differ; state_names[2] is (0, 1), as state_names[0] is
HALL.with_names(["a", "b", 3])  ->  state_names[2] must be a text, or a tuple of texts and numbers
HALL.with_names(["a", "b", (float("nan"),)])  ->  state_names[2] must be a text, or a tuple
HALL.with_names(["a", "07", "c"])  ->  state_names[1] must not read as a number, ...; it is '07' (write 's07')
HALL.with_names(["a", "b", "nan"])  ->  state_names[2] must not read as a number
HALL.with_names(["a", "b", ""])  ->  state_names[2] must not be empty, nor begin or end with a blank
HALL.with_names(["a", " b", "c"])  ->  state_names[1] must not be empty, nor begin or end with a blank
HALL.with_names("abc")  ->  state_names must be a sequence of texts or tuples
HALL.with_names({"hall", "dock", "bay"})  ->  state_names must be a sequence of texts or tuples; got set, which has no order
HALL.with_names({"hall": 2, "dock": 0, "bay": 1})  ->  state_names
  must be ...; got dict, ... (in the order of their numbers: sorted(state_names, key=state_names.get))
HALL.with_initial("hal")  ->  initial must be one of the MDP's names; it is 'hal' (did you mean 'hall'?)
HALL.with_initial(("room", 2))  ->  initial must be one of the MDP's names; ... (did you mean ('room', 1)?)
HALL.with_initial(3)  ->  initial must be in 0..2
HALL.with_initial({"hall": 0.5})  ->  initial must sum to 1
HALL.with_initial({"hall": 1.5})  ->  initial['hall'] must be in [0, 1]
HALL.with_initial({"x": 1.0})  ->  initial's state must be one of the MDP's names; it is 'x' (they are 'hall'
HALL.with_initial(True)  ->  initial must have shape (3,)
GRID.with_names([(k // 3, k % 3) for k in range(9)]).with_initial((7, 7))  ->  initial must be one of the MDP's names
GRID.with_initial("hall")  ->  initial must be a number in 0..8, since the MDP has no names here
Problem(HALL, Transitions(["hall"], ["stay"], ["dock"]))  ->  log must stay ... s=hall, a=stay -> s'=dock
Problem(HALL, Transitions([0], [1], [2]))  ->  log must stay ... No action leads from hall to dock in the simulator
Problem(HALL, Transitions([0], [0], [1], terminated=[1]))  ->  log.terminated[0] ... state ('room', 1) must be terminal
reweight(HALL, -1.0 * HALL.transitions)  ->  ratio must be ... at s=hall, a=go -> s'=hall it is

# policies
policy_value(GRID, np.full((9, 3), 1 / 3))  ->  policy must have shape (9, 4) (states, actions)
policy_value(GRID, np.zeros(9))  ->  policy must be integers where it has an action for each state; they are float64
policy_value(GRID, edited(UNIFORM, (4, 0), 0.22))  ->  policy[4] must sum to 1
policy_value(GRID, edited(UNIFORM, (4, slice(2)), [-0.1, 0.6]))  ->  policy[4, 0] must be nonnegative
occupancy(GRID, edited(UNIFORM, (4, 1), np.nan))  ->  policy[4, 1] must be finite
policy_value(GRID, np.stack([UNIFORM] * 3))  ->  policy must have shape (9, 4) ...it has shape (3, 9, 4)
policy_value(GRID, np.stack([UNIFORM] * 3), horizon=4)  ->  policy must have shape (9, 4) or (4, 9, 4)
policy_values_by_horizon(GRID, np.stack([UNIFORM, 2 * UNIFORM]), horizon=2)  ->  policy[1, 0] must sum to 1
policy_value(GRID, np.full((9, 4), "0.25"))  ->  policy must be an array of numbers
policy_value(GRID.with_names(None, ["n", "east", "s", "w"]), lambda s: "eats")  ->  policy(0) must be one of the MDP's names
policy_value(GRID, lambda state: {}[state])  ->  policy(0) must be an action or a distribution; it raises KeyError: 0
policy_value(GRID, [4] * 9)  ->  policy[0] must be in 0..3
policy_value(HALL, lambda s: 0.5)  ->  policy('hall') must be an action, or a distribution over the 2 actions
policy_value(HALL, lambda s: [1.0, 0.0, 0.0])  ->  policy('hall') must be an action, or a distribution over the 2 actions
policy_value(HALL, lambda s: [1.5, -0.5])  ->  policy('hall')[1] must be nonnegative
policy_value(HALL, lambda s: (1, 0))  ->  policy('hall')
  must be an action, (action, state), or a distribution as a list of floats; it is (1, 0)
policy_value(HALL, lambda s: (0.5, None))  ->  policy('hall') must be an action, (action, state), or
policy_value(HALL, lambda s: (7, None))  ->  policy('hall') must be in 0..1
policy_value(HALL, lambda s: True)  ->  policy('hall') must be an action
policy_value(HALL, lambda s: "gone")  ->  policy('hall') must be one of the MDP's names; ... (did you mean 'go'?)
policy_value(HALL, lambda s: {"go": 0.5})  ->  policy('hall') must sum to 1
policy_value(HALL, {"hal": "go"})  ->  policy's state must be one of the MDP's names; it is 'hal' (did you mean 'hall'?)
policy_value(HALL, {"hall": "go"})  ->  policy must have every state that is not terminal; state ('room', 1) is not there
policy_value(HALL, {})  ->  policy must have every state ...; state hall is not there (2 such states in all)
policy_value(HALL, {"hall": 0, 0: 1})  ->  policy's states must differ; state hall is given twice
policy_value(HALL, [0, -1, 0])  ->  policy[1] must be in 0..1
policy_value(HALL, ["go", "stya", "go"])  ->  policy[1] must be one of the MDP's names; ... (did you mean 'stay'?)
policy_value(HALL, [0, 1])  ->  policy must have shape (3, 2) (states, actions)
policy_value(HALL, [True, False, True])  ->  policy must be integers where it has an action for each state; they are bool
policy_value(HALL, pd.DataFrame({"go": [1.0] * 3}))  ->  policy must be an array or a mapping ...DataFrame (...to_dict(
policy_value(HALL, pd.Series([0, 1, 0]))  ->  policy must be an array or a mapping by state; got Series (...to_dict(
policy_value(mdp(), ["go"] * 2)  ->  policy[0] must be a number in 0..1, since the MDP has no names here
mix(UNIFORM, UNIFORM[:5], 0.5)  ->  policy_a and policy_b must have one shape
mix(HALVES, [0, 2], 0.5)  ->  policy_b[1] must be in 0..1
mix([0, 1], [0, 1], 0.5)  ->  policy_a must have 2 or 3 dimension
mix(HALVES, [[0.6, 0.6]], 0.5)  ->  policy_b[0] must sum to 1
record_episodes(LAKE, [0, 4] + [0] * 14, n_episodes=3, seed=0)  ->  policy[1] must be in 0..3

# values, moments, efficiency
policy_value(GRID, UNIFORM, horizon=True)  ->  horizon must be a positive integer
policy_value(GRID, UNIFORM, horizon=2**63)  ->  horizon must be at most 2**63 - 1
policy_value(ENDLESS, UNIFORM, horizon=10**9)  ->  horizon must be ... 1000000000 steps take some ... multiply-adds (... hours)
optimal_policy(GRID, horizon=10**9)  ->  horizon must be one that can be carried out
policy_values_by_horizon(GRID, UNIFORM, horizon=10**9)  ->  horizon must be one that can be carried out
policy_value(ENDLESS, UNIFORM, horizon=3, normalized=True)  ->  normalized must be False at discount 1
occupancy(ENDLESS, UNIFORM)  ->  horizon must be given: at discount 1
return_moments(ENDLESS, UNIFORM)  ->  horizon must be given: at discount 1
transition_gradient(mdp(np.ones((1, 1, 1)), (1.0,), (1.0,), 1.0), [[1.0]])  ->  ...the policy is absorbed in states with
efficiency_bound(ENDLESS, UNIFORM, EVEN)  ->  horizon must be given at discount 1
doubly_robust_moments(GRID, ZETA, UNIFORM, horizon=2, baseline="V")  ->  baseline must be an array of numbers
doubly_robust_moments(GRID, ZETA, UNIFORM, horizon=2, baseline=np.full((3, 9), np.inf))  ->  baseline[0, 0] must be finite
doubly_robust_moments(GRID, ZETA, UNIFORM, horizon=2, baseline=np.ones((2, 9)))  ->  baseline must have shape (3, 9)
weighted_return_moments(GRID, ZETA, UNIFORM, kind="trajectory")  ->  horizon must be given: ... trajectory weights
weighted_return_moments(GRID, ZETA, UNIFORM, self_normalized=True)  ->  horizon must be given: ... self-normalised weights
weighted_return_moments(GRID, 3.0, UNIFORM)  ->  zeta must be sparse of shape (36, 9), row s*A + a; got float
weighted_return_moments(GRID, GRID.transitions * 1j, UNIFORM)  ->  zeta must be real numbers
weight_moments(GRID, -GRID.transitions, UNIFORM, horizon=2)  ->  zeta must be finite and nonnegative; at s=0, a=0 -> s'=0
weight_growth(GRID, np.nan * GRID.transitions, UNIFORM)  ->  zeta must be finite and nonnegative; at s=0, a=0 -> s'=0
reweight(GRID, sparse.csr_array(np.ones((4, 2))))  ->  ratio must be sparse of shape (36, 9), row s*A + a
reweight(GRID, true_ratio(mdp(), mdp()))  ->  ratio must be sparse of shape (36, 9)
ratio_of_ratios_variance(GRID, GRID, UNIFORM, EVEN, EVEN, rows="clipped")  ->  rows must be one of 'as_they_are', 'normalised'
ratio_of_ratios_variance(GRID, GRID, UNIFORM, EVEN, EVEN / 2)  ->  simulator_distribution must sum to 1
ratio_of_ratios_variance(STIFF, GRID, UNIFORM, EVEN, EVEN)  ->  target must stay in the simulator's support
trajectory_efficiency_bound(GRID, UNIFORM, UNIFORM, horizon=3, model="bush")  ->  model must be one of 'mdp', 'tree', 'stati
trajectory_efficiency_bound(GRID, UP, UNIFORM, horizon=3)  ->  behavior_policy must ...in state 0 it never takes action 1
transition_gradient(GRID, UNIFORM, values_of=mdp())  ->  values_of must have the model's states and actions, (9, 4)
transition_gradient(GRID, UNIFORM, values_of=mdp(), horizon=3)  ->  values_of must have the model's states and actions
transition_gradient(GRID, UNIFORM, values=np.zeros(3))  ->  values must have shape (9,); it has shape (3,)
transition_gradient(GRID, UNIFORM, values=np.zeros((9, 1)))  ->  values must have shape (9,); it has shape (9, 1)
transition_gradient(GRID, UNIFORM, values=2.0)  ->  values must have shape (9,); it has shape ()
transition_gradient(GRID, UNIFORM, values=np.zeros(3), horizon=3)  ->  values must have shape (9,)
transition_gradient(GRID, UNIFORM, values=[0.0, -np.inf] + [0.0] * 7)  ->  values[1] must be finite, or nan ...; it is -inf
transition_gradient(GRID, UNIFORM, values="V")  ->  values must be an array of numbers
transition_gradient(GRID, UNIFORM, values=object())  ->  values must be an array of numbers
transition_gradient(GRID, UNIFORM, time=np.ones((1, 1)))  ->  time must have shape (9, 4); it has shape (1, 1)
transition_gradient(GRID, UNIFORM, time=[0.5] * 9)  ->  time must have shape (9, 4); it has shape (9,)
transition_gradient(GRID, UNIFORM, time=-EVEN)  ->  time[0, 0] must be nonnegative
transition_gradient(GRID, UNIFORM, time=np.nan * EVEN)  ->  time[0, 0] must be finite; it is nan
transition_gradient(GRID, UNIFORM, time={})  ->  time must be an array of numbers; got dict
solve_policy_system(np.eye(2), [1, 1], 0.5)  ->  kernel must be a sparse matrix
solve_policy_system(sparse.csr_array((2, 3)), np.ones(2), 0.5)  ->  kernel must be square, (S, S)
solve_policy_system(sparse.csr_array([[0.5, -0.5], [0, 1]]), np.ones(2), 0.5)  ->  kernel ...nonnegative; kernel[0, 1] is
solve_policy_system(sparse.csr_array([[0.5, 0.5], [0, np.nan]]), np.ones(2), 0.5)  ->  kernel ...finite ...; kernel[1, 1] is
solve_policy_system(sparse.csr_array(np.eye(2)), np.ones(3), 0.5)  ->  b must have 2 entries, one a state
solve_policy_system(sparse.csr_array(np.eye(2)), np.ones((2, 1)), 0.5)  ->  b must have 1 dimension(s)
solve_policy_system(sparse.csr_array(np.eye(2)), np.array([1, np.inf]), 0.5)  ->  b...1...inf

# logs
Transitions([], [], [])  ->  state ...the log is empty
Transitions([0, 1], [0], [1, 2])  ->  columns must have equal lengths
Transitions([0.5], [0], [1])  ->  state[0] must be an integer
Transitions([0], [-1], [1])  ->  action[0] must be at least 0
Transitions(["a"], [0], [1])  ->  state must hold integers
Transitions([[0]], [0], [1])  ->  state must have 1 dimension
Transitions([[0], [1, 2]], [0], [1])  ->  state must be a column of integers
Transitions(np.array([2**63 + 5], dtype=np.uint64), [0], [1])  ->  state[0] must be below
Transitions([0], [0], [1], [np.inf])  ->  reward[0] must be finite
Transitions([0], [0], [1], behavior_probability=[1.2])  ->  behavior_probability[0] must be in [0, 1]
Transitions([0], [0], [1], terminated=[2])  ->  terminated[0] must be a boolean
Transitions([0], [0], [1], episode=[1e300])  ->  episode[0] must be below 2**63
Transitions([0, 0], [0, 0], [0, 0], episode=[[], [1]])  ->  episode must be a column of integers
Transitions(pd.DataFrame({"state": [0]}))  ->  action must be given, ...Transitions.from_frame(frame)
log(next_state=[2, 2, 0])  ->  next_state[0] must be the state of the next row of its episode, which is 1
log(episode=[0, 1, 0])  ->  episode must keep the rows of an episode together; 0 begins again in row 2
log(timestep=[0, 2, 1])  ->  timestep[1] must be 1 (steps of an episode in order from 0)
log(terminated=[1, 0, 0])  ->  terminated[0] must be False: its episode continues in the next row
Transitions([0], [0], [1]).counts(2, 1, discount=0.9)  ->  log must have timesteps (or episodes)
Transitions.concatenate([])  ->  logs must be one or more Transitions
Transitions.concatenate([LOG, "log"])  ->  logs must be one or more Transitions
LOG.draw(10**6, seed=0)  ->  n must be at most the ... rows of the log
LOG.select([])  ->  rows must choose at least one row
LOG.select([10**6])  ->  rows must be a mask or row numbers of the log's ... rows
LOG.save("log.xlsx")  ->  path must end in .npz, .csv, .csv.gz, .parquet, or be a new Minari folder or id; it is 'log.xlsx'
LOG.save("log.gz")  ->  path must end in .npz, .csv, .csv.gz, .parquet, or be a new
LOG.save("log.parquet.gz")  ->  path must end in .npz, .csv, .csv.gz, .parquet, or be a new
LOG.save("nowhere/log.csv.gz")  ->  [Errno ...no such folder...nowhere
Transitions.load("log.xlsx")  ->  path must end in .npz, .csv, .csv.gz, .parquet, or be a Minari folder or id; it is
Transitions.load("log.xlsx")  ->  path must end in .npz, .csv, .csv.gz, .parquet
Transitions.open("log.csv", jobs=0)  ->  jobs must be a positive integer
Transitions.open("log.csv", simulator=HALL, n_states=4)  ->  n_states and n_actions must be left out where simulator
TransitionCounts([-1], [0], [0], [1])  ->  state[0] must be at least 0
TransitionCounts([0], [0.5], [0], [1])  ->  action[0] must be an integer
TransitionCounts([0], [0], [0], [0])  ->  count[0] must be positive and at most 2**53
TransitionCounts([0, 1], [0], [0], [1])  ->  columns must have equal lengths
TransitionCounts([], [], [], [])  ->  state must have at least one row
TransitionCounts([0], [0], [0], [1], [0], [1.0])  ->  reward_sum, reward_min and reward_max must be given together
TransitionCounts([0], [0], [0], [1], [0], [np.inf], [0], [0])  ->  reward_sum[0] must be finite
TransitionCounts([0], [0], [0], [1], sample=[1])  ->  sample must be Transitions
TransitionCounts.of(0 * GRID.transitions, 4)  ->  matrix must have at least one transition

# logs of names, frames, episodes
Transitions(["a", "1"], [0, 0], ["a", "b"])  ->  state[1] must be a name, as others of the column are
Transitions(["a", "nan"], [0, 0], ["a", "b"])  ->  state[1] must be a name
Transitions(["1", "0"], [0, 0], [1, 0])  ->  state must hold integers; ...(numbers written as text? .astype(int))
Transitions([1, 0], [0, 0], [0, "x"])  ->  next_state must hold integers; next_state[1] is 'x' (names? state and
Transitions([1, 0], [0, 0], [1, 0], [0.5, "none yet"])  ->  reward must be an array of numbers; reward[1] is 'none yet'
Transitions([1, 0], [0, 0], [1, 0], ["0.5", "1"])  ->  reward must be an array of numbers; ... .astype(float))
Transitions([1, 0], [0, "up"], [1, 0])  ->  action must hold integers; action[1] is 'up'
Transitions([1, 0], [0, 0], ["a", "b"])  ->  next_state must hold integers
Transitions(["a", "a "], [0, 0], ["a", "b"])  ->  state[1] must not be empty, nor begin or end with a blank
Transitions([(0, 1), (1, ())], [0, 0], ["a", "b"])  ->  state[1] must be a name
Transitions([0], [0], [2], state_names=["a", "b"])  ->  next_state[0] must have a name, of which there are 2
Transitions([0], [1], [0], action_names=["a"])  ->  action[0] must have a name, of which there are 1
Transitions(["a"], [0], ["b"], state_names=["a", "b"])  ->  state must hold numbers where state_names are given
Transitions([0], [0], [1], state_names=["a", "a"])  ->  state_names must differ
Transitions(["a", "a"], [0, 0], ["b", "a"], episode=[0, 0])  ->  next_state[0] ..., which is a (or one ... is misspelt)
HALS.counts(3, 2)  ->  log must be in a simulator's numbers to be counted; ...log.numbered
HALS.save("set")  ->  log must be in numbers to be a Minari data set
Problem(HALL, HALS)  ->  log.state[1] must ... (did you mean 'hall'?); 2 such rows, of 1 name
Problem(HALL, Transitions([0], [0], [1]), episodes=HALS)  ->  episodes.state[1] must be one of
Problem(GRID, HALS)  ->  log.state[0] must be a number in 0..8, since the simulator has no names here; ...with_names
transition_ratio(Transitions([0], ["jump"], [0]), HALL)  ->  log.action[0] must be one of ... (they are 'go', 'stay')
Problem(HALL, frame(next_state="hal"))  ->  frame.next_state[0] must be one of ... (did you mean 'hall'?)
from_frame(frame(action="goo"), simulator=HALL)  ->  frame.action[0] must be one of ... (did you mean 'go'?)
Problem(GRID, pd.DataFrame({"place": [0], "action": [0]}))  ->  frame must have the columns state, action, next_state
from_frame("log.csv")  ->  frame must be a data frame (...); got str (a file: Transitions.load)
from_frame(pd.Series([1]))  ->  frame must be a data frame (pandas, polars, arrow)
from_frame(pd.DataFrame({"s": [0], "a": [0]}))  ->  frame must have ...state; it has s, a (say
from_frame([{"state": 0, "action": 0, "next_state": 1}])  ->  frame must be ...; got list (rows ...: pandas.DataFrame(rows))
from_frame({"state": [0], "action": [0]})  ->  frame must be ...; got dict (columns ...: pandas.DataFrame(columns))
from_episodes([{"state": 0, "action": 0, "next_state": 1}])  ->  episodes must be a list ... (rows ...: pandas.DataFrame(rows))
from_frame(frame(isOver=True))  ->  frame must have columns whose meaning is clear; 'isOver' may say that the task ended
from_frame(frame(logp=-1.0))  ->  frame must ...; 'logp' is the logarithm of a probability
from_frame(frame(trajectory_id=0, ep=0))  ->  frame must have one column of episode; 'trajectory_id' and 'ep' may each
from_frame(frame(), columns={"stat": "place"})  ->  columns must have keys of state, ...; got 'stat' (did you mean state?)
from_frame(frame(), columns={"place": "state"})  ->  columns must have keys ...'place' (the other way round: {'state': 'place'})
Problem(GRID, LOG, columns=np.ma.masked_array([1.0, 2.0]))  ->  columns must be left out for Transitions
Problem(GRID, LOG, columns=sparse.eye_array(3))  ->  columns must be left out for Transitions
TransitionCounts.load("\ud800")  ->  path must be text that a file's name can hold; got '\ud800'
oee.tasks.fit_parameters(lambda gravity: oee.tasks.CartPole(gravity), {"mass": 1.0}, states())  ->  start must name parameters
from_frame(frame(), columns=["state"])  ->  columns must be a mapping from a log's columns to those of the file
from_frame(frame(), columns={"state": "stat"})  ->  columns must name columns of frame, ...'stat' (did you mean 'state'?)
from_frame(frame(), columns={"state": None})  ->  columns must name a column for state; it is None
from_frame(frame(), columns={"state": "next_state"})  ->  columns must name a column for next_state as well
from_frame(frame(), columns={"state": "action", "action": "action"})  ->  columns must name each column once; 'action'
from_frame(frame(), columns={"reward": ["state", "action"]})  ->  columns must name one column for reward
from_frame(frame(), state="state", columns={"state": "action"})  ->  state must be the column that columns names, 'action'
from_frame(frame(), reward="next_state", columns={"reward": None})  ->  reward must be the column that columns names, None
Problem(HALL, HALS, columns={"state": "place"})  ->  columns must be left out for Transitions
Problem(HALL, [[(0, 0, 1.0), (1,)]], columns={"state": "place"})  ->  columns must be left out for a list of episodes
from_frame(pd.DataFrame())  ->  frame must have the columns ...; it has none
from_frame(frame().rename(columns={"state": "from"}), state="form")  ->  state must be ..., from, ... (did you mean 'from'?)
from_frame(frame(), stat="state")  ->  column_names must be of state, ... (did you mean state?)
from_frame(frame(), state=3)  ->  state must be the name of a column of the frame, ...; it is 3
from_frame(frame(), reward=["state", "action"])  ->  reward must be the name of one column
from_frame(frame(timestep=np.nan))  ->  frame: timestep[0] must have a value; it has none
from_frame(frame(action=None))  ->  frame: action[0] must have a value; it has none
from_frame(frame(action=pd.Timestamp(0)))  ->  frame: action[0] must be an integer; it is '1970-01-01...
from_frame(pd.concat([frame(), frame()], axis=1))  ->  frame must have columns that differ
from_frame(frame().head(0))  ->  state must have at least one row; the log is empty
from_frame(frame(state=0.5))  ->  frame: state[0] must be an integer
from_episodes([])  ->  episodes must have at least one transition whose next state is known
from_episodes([[(0, 0, 1.0)]])  ->  episodes must have at least one transition
from_episodes(3)  ->  episodes must be a list of episodes, each a list of steps
from_episodes([3])  ->  episodes[0] must be a list of steps, each (state, action, reward),
from_episodes([[{"observation": 0, "action": 0}]])  ->  episodes[0][0] must be a step, ... of observation, action
from_episodes([{"observations": [0], "actions": [1]}])  ->  episodes[0] must be a list ... mapping of observations, actions
from_episodes([[("a", "go", "b", 1.0)]])  ->  episodes[0][0] must be a step, ...; its reward is 'b'
from_episodes([[(("a", 1), "go", 1.0), ("b", 2)]])  ->  episodes[0][1] must be (state,) or ... ('b', 2) (of a state that is
from_episodes([["hall", "go"]])  ->  episodes[0][0] must be a step, (state, action, reward), ...; got str
from_episodes([[(0, 0), (1, 0, 1.0), (2,)]])  ->  episodes[0][0] must be a step, ...; it has 2 parts
from_episodes([[(0, 0, 1.0, 1, False, False, 3)]])  ->  episodes[0][0] must be a step, ...; it has 7 parts
from_episodes([[(0, 0, 1.0, 2), (1, 0, 1.0, 1)]])  ->  next_state[0] must be the state of the next row
from_episodes([[(0, 0, 1.0), (1, "yes")]])  ->  episodes[0][1] must be (state,) or

# MDPs of logs and of environments
FiniteMDP.from_log(HALS, state_names=["a", "c"])  ->  log.state[0] must be ... (they are 'a', 'c')
FiniteMDP.from_log(LOG, n_states=2)  ->  n_states must be at least 9, for the log has state 8
FiniteMDP.from_log(LOG, n_actions=3)  ->  n_actions must be at least 4, for the log has action 3
FiniteMDP.from_log(LOG, state_names=["a"] * 9)  ->  state_names must differ
FiniteMDP.from_log(LOG, initial=9)  ->  initial must be in 0..8
FiniteMDP.from_log(LOG, initial=[0.5] * 9)  ->  initial must sum to 1
FiniteMDP.from_log(LOG.state)  ->  log must be Transitions; got ndarray
FiniteMDP.from_log(Transitions([0], [0], [0]))  ->  rewards must be given where the log has none
FiniteMDP.from_log(LOG, [1.0, 2.0])  ->  rewards must have shape (9,)
FiniteMDP.from_log(LOG, 3.0)  ->  rewards must have 1 or 2 or 3 dimension
from_env("FrozenLake-v1")  ->  env must be a Gymnasium environment; got str (gymnasium.make('FrozenLake-v1'))
from_env(make_environment("CartPole-v1"))  ->  env.observation_space must be discrete
from_env(make_environment("Pendulum-v1"))  ->  env.action_space must be Discrete
from_env(type("E", (), {"action_space": LAKE.action_space})())  ->  env must be a Gymnasium environment; got E
from_env(type(LAKE))  ->  env must be a Gymnasium environment; got the class TimeLimit (make one: TimeLimit())
from_env(LAKE, state_names=["a", "b"])  ->  state_names must have 16 names, one for each; it has 2
from_env(LAKE, action_names=["a", "b", "c", "a"])  ->  action_names must differ; action_names[3] is 'a', as action_names[0] is
from_env(LAKE, discount=2)  ->  discount must be in [0, 1]
record_episodes("FrozenLake-v1", [0] * 16, n_episodes=1)  ->  env must be a Gymnasium environment; got str (gymnasium.make(
record_episodes(make_environment("Blackjack-v1"), [0], n_episodes=1)  ->  env.observation_space must be Discrete; it is
GRID.to_env(max_steps=0)  ->  max_steps must be a positive integer; it is 0
GRID.to_env(max_steps=2.5)  ->  max_steps must be a positive integer; got 2.5
GRID.to_env(10)  ->  ...to_env() takes 1 positional argument
GRID.to_env(maxsteps=10)  ->  to_env() got an unexpected keyword argument 'maxsteps'. Did you mean 'max_steps'?
FiniteMDP.load("sim.npz", until="end")  ->  until must be left out for a file that does not end in .umb; got 'end'
FiniteMDP.load("sim.npz", rewards="r")  ->  load() got an unexpected keyword argument 'rewards'. Did you mean 'reward'?
GRID.with_support_of(LOG, 2)  ->  epsilon must be in (0, 1)
GRID.with_support_of(pd.DataFrame({"state": [0]}), 0.1)  ->  log must be Transitions
HALL.with_support_of(LOG, 0.1)  ->  log.state[...] must be in 0..2, the simulator's
HALL.with_support_of(Transitions([0], [2], [0]), 0.1)  ->  log.action[0] must be in 0..1, the simulator's
HALL.with_support_of(Transitions([0], [0], [3]), 0.1)  ->  log.next_state[0] must be in 0..2, the simulator's
HALL.with_support_of(sparse.csr_array((3, 3)), 0.1)  ->  log must be of shape (6, 3) where it is counts
HALL.with_support_of(BROKEN, 0.1)  ->  log.indptr[6] must be at least
mdp().with_support_of(Transitions(["x"], [0], ["x"]), 0.1)  ->  log.state[0] must be a number in 0..1, since the simulator

# problems
Problem(GRID, {"state": [0]})  ->  log must be Transitions; got dict (a mapping of columns: Transitions(**log))
Problem(GRID, np.zeros((3, 3)))  ->  log must be Transitions; got ndarray (columns ...: Transitions(*log.T))
Problem(GRID, None)  ->  log must be Transitions; got NoneType
Problem(GRID, "nowhere.csv")  ->  [Errno ...nowhere.csv
Problem(GRID, Transitions([0, 9], [0, 0], [3, 3]))  ->  log.state[1] must be in 0..8, the simulator's
Problem(GRID, Transitions([0], [4], [3]))  ->  log.action[0] must be in 0..3, the simulator's
Problem(GRID, TransitionCounts([9], [0], [0], [1]))  ->  log.state[0] must be in 0..8, the simulator's
Problem(GRID, LOG, episodes=FAR)  ->  episodes.state[0] must be in 0..8, the simulator's; it is 9 (1 such transitions)
Problem(GRID, LOG, simulator_data=Transitions([0], [0], [9]))  ->  simulator_data.next_state[0] must be in 0..8
Problem(GRID, LOG, episodes=3)  ->  episodes must be Transitions
Problem(GRID, LOG, simulator_data="foo")  ->  simulator_data must be Transitions, 'exact' or None
Problem(GRID, Transitions([0, 0, 0, 3], [0, 0, 0, 1], [8, 8, 3, 5]))  ->  log must stay ...probability 0 to 2 of its transitions
  (3 of 4 with repetitions): s=0, a=0 -> s'=8 (2); s=3, a=1 -> s'=5
Problem(GRID, Transitions([0], [0], [3], terminated=[True]))  ->  log.terminated[0] must be False, or state 3 must be terminal
Problem(GRID, LOG, impossible="allow")  ->  impossible must be one of ... (to allow them: simulator.with_support_of(log
Problem(GRID, Transitions([0], [0], [8]), impossible="drop")  ->  log ...impossible='drop' leaves none
Problem(GRID, without("reward"), rewards="log")  ->  rewards must be 'simulator' where the log has no reward column
Problem(GRID, COUNTS, rewards="log")  ->  rewards must be 'simulator' where the log has no reward column
Problem(GRID, LOG, rewards="both")  ->  rewards must be one of 'simulator', 'log'
Problem(GRID, LOG, behavior_policy=np.ones((9, 1)))  ->  behavior_policy must have shape (9, 4)
Problem(GRID, LOG, counts=COUNTS.toarray())  ->  counts must be sparse, of shape (36, 9)
Problem(GRID, LOG, counts=COUNTS[:4])  ->  counts must have shape (36, 9) (row s*A + a, column s')
Problem(GRID, LOG, counts=COUNTS * 1j)  ->  counts must be real numbers
Problem(GRID, -0.5 * COUNTS)  ->  counts must be finite and nonnegative; at s=0, a=0 -> s'=... there is -
Problem(GRID, LOG, counts=0 * COUNTS)  ->  counts must have at least one transition
Problem(GRID, sparse.csr_array(([0.5], ([0], [8])), (36, 9)))  ->  counts must stay in the ... s=0, a=0 -> s'=8 (0.5)
Problem(GRID, LOG, counts=GRID.transitions.sign() * 2.0**54)  ->  counts must be at most 2**53; at s=0, a=0 -> s'=0

# estimators
ImportanceSampling()(Problem(GRID, without("behavior_probability")), UNIFORM)  ->  importance sampling needs ...give Problem
ImportanceSampling()(Problem(GRID, NEVER), UNIFORM)  ->  log.behavior_probability must be positive for the actions taken
ImportanceSampling()(Problem(GRID, without("behavior_probability"), 9, UP), UNIFORM)  ->  behavior_policy must be positive
ImportanceSampling()(Problem(GRID, LOG.draw(5, seed=0)), UNIFORM)  ->  importance sampling needs whole ...Problem(episodes=
DoublyRobust(data="episodes")(Problem(GRID, COUNTS), UNIFORM)  ->  importance sampling needs whole episodes
OffEnvironment("joined")  ->  ratio must be one of 'conditional', 'ratio_of_ratios', 'joint'
OffEnvironment(3.0)  ->  ratio must be a method's name, a TransitionRatio or a function
OffEnvironment(adjust="soft")  ->  adjust must be SoftThreshold() or None; it is 'soft'
OffEnvironment(adjust=True)  ->  adjust must be SoftThreshold() or None; it is True
OffEnvironment(adjust=SoftThreshold)  ->  adjust must be SoftThreshold() or None
OffEnvironment(adjust=Shrinkage())  ->  adjust must be SoftThreshold() or None
OffEnvironment(n_rollouts=10**14, evaluation="monte_carlo")(P, UNIFORM, seed=0)  ->  n_rollouts must be small enough for this
OffEnvironment(true_ratio(GRID, GRID))(RIGID, UNIFORM)  ->  ratio must have the support of this simulator's transitions
OffEnvironment(true_ratio(mdp(), mdp()))(P, UNIFORM)  ->  ratio must be for (36, 9) rows and states
Oracle(GRID)(RIGID, UNIFORM)  ->  target must stay in the simulator's support: the simulator gives probability 0 to
DoublyRobust(data="q")  ->  data must be one of 'transitions', 'rollouts', 'episodes'
DoublyRobust(self_normalized=True)  ->  self_normalized must be False with data 'transitions': it is for episodes
Magic().limit(GRID, GRID, UNIFORM, behavior_policy=UP, horizon=5)  ->  behavior_policy must take every action ... it never takes
DualDice()(Problem(GRID, LOG, horizon=3), UNIFORM)  ->  horizon must be None for DualDICE, ...; it is 3
DualDice()(Problem(ENDLESS, LOG), UNIFORM)  ->  discount must be below 1 for DualDICE
Marginalized(lower=2.0, upper=1.0)  ->  lower must not exceed upper
Marginalized("joint", features=np.eye(36))  ->  ratio must be left out with features
Marginalized(features=np.eye(36))(Problem(GRID, LOG, horizon=4), UNIFORM)  ->  horizon must be None with features
Marginalized(features=np.eye(36))(Problem(ENDLESS, LOG), UNIFORM)  ->  discount must be below 1 with features
Marginalized(features=np.ones((9, 4)))(P, UNIFORM)  ->  features must differ between ... pairs; every column is constant
Marginalized(features=np.eye(36)[:, [0, 1, 1]] * [1, 1, 0])(P, UNIFORM)  ->  features must ...; column 2 is
Marginalized(features=TWINS)(P, UNIFORM)  ->  features ...independent; columns 0, 1, 2 are not (column 1 is constant)
Marginalized(features=np.ones(7))(P, UNIFORM)  ->  features must have shape (9, 4) (+ d), or 36 rows
Marginalized(features=np.ones((36, 2, 2)))(P, UNIFORM)  ->  features must have shape ... they have shape (36, 2, 2)
Marginalized(features=np.full((9, 4), np.nan))(P, UNIFORM)  ->  features[0, 0] must be finite
ModelBased().limit(STIFF, GRID, UNIFORM)  ->  target must stay in the simulator's support
ModelBased().limit(GRID, mdp(), UNIFORM)  ->  target and simulator must have the same states and actions; ...(4, 2) and (36, 9)
calibrate(3, discretised=1.0, continuous=1.0)  ->  estimate must be an Estimate
calibrate(ONE, discretised=-1.0, continuous=2.0)  ->  kind must be 'difference' unless ... one sign; they are -1 and 2
calibrate(ONE, discretised=1.0, continuous=np.nan)  ->  continuous must be in
Estimate(1.0, findings=("look out",))  ->  findings[0] must be a Finding(kind, severity, text)

# reports
evaluate(GRID, None)  ->  problem must be a Problem(simulator, log, ...); got FiniteMDP
evaluate(P, UNIFORM, estimators=["oe"])  ->  estimators must be among simulator, oee, ...; got 'oe' (did you mean 'oee'?)
evaluate(P, UNIFORM, estimators=["fqee"])  ->  estimators must be among ...(did you mean 'fqe'?)
evaluate(P, UNIFORM, estimators=["oracle-product"])  ->  estimator 'oracle-product' needs the target environment
evaluate(P, UNIFORM, estimators=[])  ->  estimators must name at least one
evaluate(P, UNIFORM, estimators={"mine": lambda problem, policy: (1.5, 0.1)})  ->  an estimator must return ...it returned tuple
evaluate(P, UNIFORM, estimators=["oee"], seed={1})  ->  seed must be what numpy.random.SeedSequence takes
evaluate(P, {})  ->  policies must hold at least one
evaluate(P, {"mine": UNIFORM * 0.9})  ->  policy 'mine'[0] must sum to 1
evaluate(P, {"a": [0, 1, 7, 0, 0, 0, 0, 0, 0]})  ->  policy 'a'[2] must be in 0..3
evaluate(P, UNIFORM, target=mdp())  ->  target must have the simulator's 9 states and 4 actions
evaluate(Problem(GRID, LOG, counts=0.5 * COUNTS), UNIFORM, guaranteed=True)  ->  guaranteed must be False where counts are given
evaluate(P, UNIFORM, quick=1)  ->  quick must be True or False; got 1
evaluate(P, UNIFORM, quick=True, guaranteed=True)  ->  guaranteed must be False where quick is True
evaluate(P, UNIFORM, quick=True, upper_ratio=2.0)  ->  quick must be False with lower_ratio or upper_ratio
evaluate(P, UNIFORM, quick=True, unrecorded=np.inf)  ->  quick must be False with unrecorded=inf
evaluate(P, UNIFORM, quick=True, interval_seconds=9)  ->  quick must be False with interval_seconds
evaluate(P, UNIFORM, unrecorded=0.5)  ->  unrecorded must be in [1, inf]; it is 0.5
evaluate(P, UNIFORM, interval_seconds=0)  ->  interval_seconds must be in (0, inf)
evaluate(Problem(ENDLESS, LOG), UNIFORM, guaranteed=True)  ->  guaranteed must be False here: at discount 1 they need a horizon
evaluate(P, UNIFORM, tie=KEYS, features=1.0 * KEYS)  ->  tie and features must not be given together
evaluate(P, UNIFORM, quick=True).legend(3)  ->  rows must be a Report's records()
evaluate(P, UNIFORM, quick=True).legend([{"estimator": "oee"}])  ->  rows must be a Report's records(); one is {'estimator'
evaluate(P, UNIFORM, quick=True).to_html(grid=(3, 5))  ->  grid must have as many cells as the simulator has states, 9
evaluate(P, UNIFORM, quick=True).to_html(grid=4)  ->  grid must be (rows, columns)
evaluate(P, UNIFORM, quick=True).to_html(grid=(4, 0))  ->  grid[1] must be a positive integer

# ratios of tables
density_ratio([1, 1, 1], [1, 0, 0])  ->  q ...the program is unbounded at the 2 entries with q = 0 < p (the first: 1, 2); give a
density_ratio([1, 1], [1, 1], lower=2, upper=1.5, normalized=False)  ->  lower must not exceed upper
density_ratio([1, 1], [1, 1], lower=1.5, upper=2)  ->  the box [lower, upper] must contain 1 for sum q g = 1 to be possible
density_ratio([1, -1], [1, 1])  ->  p[1] must be nonnegative
density_ratio([1, 1], [1, np.nan])  ->  q[1] must be finite
density_ratio([1, 1], [0, 0])  ->  q must have a positive, finite sum
density_ratio([1e308] * 2, [1, 1])  ->  p must have a positive, finite sum
density_ratio([1], [1, 1])  ->  p and q must have one length
density_ratio([[1]], [[1]])  ->  p must have 1 dimension(s)
density_ratio([1j], [1])  ->  p must be an array of numbers
density_ratio([2], [1], ridge=lambda n: np.inf)  ->  ridge(2) must be finite
density(ridge=lambda n: -n)  ->  ridge(6) must be in [0, inf)
density(ridge="a")  ->  ridge must be a number
density(ridge=1, toward=np.inf)  ->  toward must be finite
density(lower=np.inf, normalized=False)  ->  lower must be finite
density(upper=0, normalized=False)  ->  upper must be positive:
density(ridge=1e308, toward=1)  ->  the program must have numbers that double precision holds; ridge 1e+308
density(ridge=1, toward=1e300, loss="chi2", normalized=False)  ->  the program must have numbers ...; ridge 1 towards 1e+300
density(solver="dial")  ->  solver must be 'dual' or one of
Sgd(step_size=0)  ->  step_size must be in (0, inf)
Sgd(batch_size=0)  ->  batch_size must be a positive integer
Sgd(n_iterations=0)  ->  n_iterations must be a positive integer
density(**SGD | {"upper": None})  ->  solver Sgd(...) must have 0 < lower and a finite upper; the box is [0.1, inf]
density(**SGD | {"lower": None})  ->  solver Sgd(...) must have 0 < lower and a finite upper; the box is [0, 9]
density(**SGD | {"normalized": True})  ->  solver Sgd(...) must have normalized=False and loss="kl"
density(loss="chi2", **SGD)  ->  solver Sgd(...) must have normalized=False and loss="kl"
density(functions=Linear([1, 2]))  ->  features must have 3 rows, one for each entry of p
density(functions=Linear([1, np.nan, 2]))  ->  features[1] must be finite
density(functions=Linear(np.arange(3.0)))  ->  features must span a function that is above 0, with sum q g = 1; none is
  at all points
density(functions=Linear([1, -1, 1]))  ->  features must span a function that is at least 0, with sum q g = 1; the
  nearest misses by
density(functions=Linear([1, -1, 1]), lower=0.5, upper=4.0, normalized=False)  ->  features must span ... at least 0.5
  and at most 4
density(functions=Linear([1, 1, 1]), kernel="gaussian")  ->  density_ratio() got an unexpected keyword argument
  'kernel'. Did you mean 'functions=Kernel(coordinates, kernel)'?
density(features=[1, 1, 1])  ->  density_ratio() got an unexpected keyword argument 'features'. Did you mean
  'functions=Linear(features)'?
density(n_iterations=5)  ->  density_ratio() got an unexpected keyword argument 'n_iterations'. Did you mean
  'solver=Sgd(n_iterations=...)'?
density(functions=Linear([1, 1, 1]), toward=1.0)  ->  toward must be left out with functions=Linear(...) or Kernel(...)
density(functions=Kernel([1, 2, 3]), loss="chi2")  ->  loss must be left out with functions=Linear(...) or Kernel(...)
density(functions=Linear([1, 1, 1]), solver="sgd")  ->  solver Sgd(...) must be left out with functions=Linear(...)
density(functions="table")  ->  functions must be Table(), Linear(features) or Kernel(coordinates); got 'table'
density(functions=Table)  ->  functions must be Table(), Linear(features) or Kernel(coordinates)
density(functions=Network())  ->  functions must be Table(), Linear(features) or Kernel(coordinates)
Linear([])  ->  features must have a row for each entry of p; they have shape (0,)
Linear("ab")  ->  features must be ...
Kernel([])  ->  coordinates must have a row for each entry of p; they have shape (0,)
Kernel([1, 2], n_centers=0)  ->  n_centers must be a positive integer
Kernel([1, 2], bandwidth=1.0)  ->  Kernel() got an unexpected keyword argument 'bandwidth'
density(functions=Linear([1, 1, 1]), lower=1.0)  ->  the box of a linear class must have lower < 1 < upper
density(functions=Kernel([1, 2], "gaussian"))  ->  coordinates must have 3 rows, one for each entry of p
density(functions=Kernel([0, np.inf, 1], "gaussian"))  ->  coordinates[1] must be finite
density(functions=Kernel([1, 2, 3], "rbf"))  ->  kernel must be one of 'gaussian'
density(functions=Kernel([1, 2, 3], lambda x, c: np.ones(3)))  ->  kernel must have 2 dimension(s)
density(functions=Kernel([1, 2, 3], lambda x, c: 1.0 - 3.0 * (x != c.T)))  ->  kernel must be symmetric and positive
density(functions=Kernel([1, 2, 3], lambda x, c: -np.ones((len(x), len(c)))))  ->  kernel must be positive semidefinite
density(functions=Kernel([1, 2, 3], lambda x, c: np.zeros((len(x), len(c)))))  ->  kernel must not be 0 at every point
check_assumptions([-1], [1], lower=0, upper=1)  ->  p[0] must be nonnegative

# ratios of transitions
transition_ratio(np.zeros((36, 9)), GRID)  ->  log_or_counts must be Transitions or sparse counts
transition_ratio(sparse.csr_array((36, 9)), GRID)  ->  log_or_counts must have at least one transition
transition_ratio(sparse.csr_array(np.ones((4, 2))), GRID)  ->  counts must have shape (36, 9)
transition_ratio(-GRID.transitions, GRID)  ->  counts must be finite and nonnegative; at s=0, a=0 -> s'=0
transition_ratio(GRID.transitions.sign() * 2.0**54, GRID)  ->  counts must be at most 2**53; at s=0, a=0 -> s'=0
transition_ratio(Transitions([0], [0], [1]), GRID, discount=0.9)  ->  log must have timesteps
transition_ratio(sparse.csr_array([[9, 1, 2, 3, 4, 5], [6] + [0] * 5] + [[0] * 6] * 4), LOOP)  ->  log must stay in ...0 to 5 of
  its transitions (15 of 30 with repetitions): s=0, a=0 -> s'=5 (5); ...(4); ...(3); s=0, a=0 -> s'=2 (2), ...
  No action leads from 0 to 5 in the simulator, ... P[0, 0] *= 0.99; P[0, 0, 5] += 0.01; (2) if the log is wrong, remove
true_ratio(GRID, STIFF)  ->  target must stay in the simulator's support: ... of its transitions
true_ratio(mdp(), GRID)  ->  target and simulator must have the same states and
true_ratio(GRID, GRID).maximum_likelihood_model(GRID)  ->  a ratio of method 'true' has no maximum-likelihood model
zeta(prior="flat")  ->  prior must be one of 'ridge', 'tilt', 'simulator', 'none'
zeta(prior="average")  ->  prior must be one of 'ridge', 'tilt', 'simulator', 'none'
zeta(strength="q")  ->  strength must be one of 'evidence', 'loo'
zeta(ridge="cv")  ->  ridge must be one of 'evidence', 'loo'
zeta(toward=-1)  ->  toward must be in [0, inf)
zeta(upper=0.5)  ->  the box [lower, upper] must contain 1 for sum q g = 1 to be possible
zeta(method="joint", ratio_upper=0.5)  ->  the box [ratio_lower, ratio_upper] must contain 1 for sum q g = 1
zeta(method="joint", ridge="loo")  ->  ridge must be a number or a function of n with method 'joint'
zeta(method="ratio_of_ratios", ridge="loo")  ->  ridge must be a number or a function of n with method 'ratio_of_ratios'
zeta(method="linear", features=PHI, ridge="loo")  ->  ridge must be a number or a function of n with method 'linear'
zeta(method="joint", behavior_policy=2 * UNIFORM)  ->  behavior_policy[0] must sum to 1
zeta(method="ratio_of_ratios", simulator_data="most")  ->  simulator_data must be Transitions, 'exact' or None
zeta(method="ratio_of_ratios", upper=np.inf, simulator_data=LOG.draw(3, seed=0))  ->  q must be ... give a finite upper bound
zeta(method="kernel", coordinates=PLACE, bandwidth=0)  ->  bandwidth must be in (0, inf)
zeta(method="kernel", coordinates=np.full(9, np.nan))  ->  coordinates[0] must be finite
zeta(method="kernel", coordinates=[1, 2])  ->  coordinates must have 9 rows, one a state
zeta(method="kernel")  ->  coordinates must be given with method "kernel"
zeta(method="linear")  ->  features must be given with method "linear"
zeta(method="tied")  ->  tie must be given with method 'tied': a key for each entry
zeta(method="linear", features=PHI, tie=KEYS)  ->  tie must not be given with method 'linear', which does not use it
zeta(tie=KEYS, ridge=1.0)  ->  ridge must not be given with method 'tied', which does not use it
zeta(tie=KEYS, strength="loo")  ->  strength must be a number with method 'tied'
zeta(tie=KEYS[:3])  ->  tie must have shape (120,), a key for each entry
zeta(tie=1.0 * KEYS)  ->  tie must have integer keys
zeta(discount=0.9)  ->  discount must be left out where counts are given: they have no timesteps
zeta(seed="q", method="ratio_of_ratios")  ->  seed must be what numpy.random.default_rng takes
zeta(features=PHI, prior="simulator")  ->  features must be left out with prior 'simulator', which does not use them
zeta(features=PHI, prior="none")  ->  features must be left out with prior 'none'
zeta(features=np.full(120, np.inf))  ->  features must be finite; feature 0 at s=0, a=0 -> s'=0 is inf
zeta(features=np.zeros(7))  ->  features must have 120 rows, one for each transition of the simulator, or shape (9, 4, 9)
zeta(features="log")  ->  features must be an array of numbers
zeta(features=lambda s, a, t: np.zeros(3))  ->  features must have 120 rows
zeta(values_of=np.ones((3, 2)) / 2)  ->  values_of must have shape (9, 4) (states, actions); it has shape (3, 2)
zeta(values_of=[UNIFORM, UNIFORM[:3]])  ->  values_of[1] must have shape (9, 4)
zeta(values_of=[UNIFORM, 2 * UNIFORM])  ->  values_of[1][0] must sum to 1
zeta(values_of=[])  ->  values_of must
zeta(values_of=UNIFORM, prior="simulator")  ->  values_of must ... 'simulator'
zeta(values_of=UNIFORM, prior="none")  ->  values_of must ... 'none'
zeta(values_of=UNIFORM, method="joint")  ->  values_of must not be given with method 'joint'
zeta(values_of=UNIFORM, method=Conditional(prior="tilt"))  ->  values_of must be left out with prior 'tilt'
zeta(horizon=3)  ->  horizon must be left out without values_of: it is that of the values
zeta(horizon=5, method="joint")  ->  horizon must ... 'joint'
Tied(KEYS, strength=-1)  ->  strength must be in [0, inf)
InClass()  ->  features must be given
InClass(features=PHI, kernel="gaussian", coordinates=PLACE)  ->  features must be left out with a kernel
InClass(features=np.ones((120, 1)), ridge=1e308).fit(LOG, GRID)  ->  ridge must leave a program that double precision holds
Quotient(solver=3)  ->  solver must be a name or Sgd(...)
Quotient(solver=Sgd()).fit(LOG, GRID)  ->  solver Sgd(...) must have normalized=False
Conditional(prior=3.0)  ->  prior must be a name or an object such as oee.shrinkage.Shrinkage(); got 3.0
Conditional(prior=Shrinkage)  ->  prior must be a name or an object such as oee.shrinkage.Shrinkage()
Conditional(prior=Joint())  ->  prior must be a name or an object such as oee.shrinkage.Shrinkage()
Conditional(Shrinkage("tilt"), strength=3.0)  ->  strength must be left out where prior is an object:
  Shrinkage(prior='tilt', ... has its own; got 3.0
Conditional(Shrinkage("tilt"), strength="evidence")  ->  strength must be left out where prior is an object
Conditional(NoPrior(), features=PHI)  ->  features must be left out where prior is an object: NoPrior() has its own
Conditional(Shrinkage(), functions=Network())  ->  prior must be left out with functions=
Conditional(strength="q")  ->  strength must be one of 'evidence', 'loo'
Conditional(strength=-1)  ->  strength must be in [0, inf)
zeta(prior=Shrinkage(), strength=3.0)  ->  strength must be left out where prior is an object
zeta(method=Conditional(), prior=Shrinkage())  ->  prior must be given to the method object
PriorRows([1.0, -1.0])  ->  kappa[1] must be nonnegative; it is -1
PriorRows([np.nan])  ->  kappa[0] must be finite
PriorRows("many")  ->  kappa must be ...
PriorRows([1.0], fitted=3.0)  ->  fitted must be ...
PriorRows([1.0], details=3.0)  ->  details must be ...
Conditional(prior_that_returns(None)).fit(LOG, GRID)  ->  prior must return PriorRows(...) from fit_rows; it returned None
Conditional(prior_that_returns(PriorRows([1.0]))).fit(LOG, GRID)  ->  prior must return a kappa for each of 36 rows; it
  returned 1
Shrinkage("flat")  ->  prior must be one of 'ridge', 'tilt', 'simulator', 'none'
Shrinkage("average")  ->  prior must be one of 'ridge', 'tilt', 'simulator', 'none'
Shrinkage(3.0)  ->  prior must be one of 'ridge', 'tilt', 'simulator', 'none'
Shrinkage(strength="q")  ->  strength must be one of 'evidence', 'loo'
Shrinkage(strength=np.nan)  ->  strength must be in [0, inf)
Shrinkage(strength=[1.0])  ->  strength must be a ...
Shrinkage("simulator", features=PHI)  ->  features must be left out with prior 'simulator', which does not use them
Shrinkage("none", features=PHI)  ->  features must be left out with prior 'none', which does not use them
Conditional(ridge=1e308).fit(LOG, GRID)  ->  the options of method 'conditional' must make ...ridge 1e+308, toward 1
Conditional(ridge=1, toward=1e308).fit(LOG, GRID)  ->  the options of method 'conditional' must make ...ridge 1, toward 1e+308
Network((0,))  ->  layers[0] must be a positive integer
Network(64)  ->  layers must be a collection of widths of hidden layers
Network(inputs="pixels")  ->  inputs must be one of 'one_hot'...'pixels'
Network(held_out=1)  ->  held_out must leave transitions to train on
boxed(functions="mlp")  ->  functions must be a Network(...)
boxed(normalized=True)  ->  normalized must be False with functions
boxed(solver="CLARABEL")  ->  solver must be left out with functions=
boxed(upper=np.inf)  ->  lower and upper must be a box with 0 < lower
boxed(lower=None)  ->  lower and upper must be a box
boxed(toward=None, ridge=1.0)  ->  toward must be a number with functions
Conditional(functions="mlp")  ->  functions must be a Network(...)
Conditional(functions=Network(), solver="CLARABEL")  ->  solver must be left out with functions=
Conditional(functions=Network(), prior="tilt")  ->  prior must be left out with functions=
Conditional(functions=Network(), features=[1.0])  ->  features must be left out with prior 'none'
Conditional(functions=Network(), upper=5.0)  ->  lower and upper must be left out with functions=
Conditional(functions=Network(), lower=0.1)  ->  lower and upper must be left out with functions=

# trials
Trials([])  ->  returns must have at least one trial; it is empty
Trials([1.0, np.nan])  ->  returns[1] must be finite
Trials(["x"])  ->  returns must be an array of numbers
Trials([[1.0]])  ->  returns must have 1 dimension(s)
Trials([1.0], discount=2)  ->  discount must be in [0, 1]; it is 2
Trials([1.0], horizon=0)  ->  horizon must be a positive integer
Trials([1.0, 2.0], policy=["a"])  ->  policy must be one name, or 2, one for each trial; there are 1
Trials.from_successes(1, 2, success=[np.nan])  ->  success[0] must be a name or a number; got nan
Trials.from_successes(1, 2, success=[[1]])  ->  success[0] must be a name or a number
Trials([1.0], policy=[None])  ->  policy[0] must be finite; it is nan
Trials([1.0], policy=[""])  ->  policy[0] must be a name
Trials([1.0], policy="")  ->  policy must be a name that is not empty
Trials([1.0], weight=[0.0])  ->  weight[0] must be positive and finite; it is 0
Trials([1.0], weight=[1.0, 1.0])  ->  weight must have one number for each of the 1 trials; it has 2
Trials.from_successes(13, 12)  ->  successes must be at most trials, 12; it is 13
Trials.from_successes(-1, 12)  ->  successes must be an integer in 0..12; it is -1
Trials.from_successes(True, 12)  ->  successes must be an integer in 0..12; got True
Trials.from_successes(0.5, 12)  ->  successes must be an integer in 0..12; got 0.5
Trials.from_successes(0, 0)  ->  trials must be a positive integer
Trials.from_successes(9, 10**12)  ->  trials must be at most
Trials.from_successes(9, 12, success=[])  ->  success must name at least one state; it is empty
Trials.load("nowhere.csv")  ->  [Errno 2]
Trials.load("trials.txt")  ->  path must end in .csv or .json; it is 'trials.txt'
Trials.load("trials.csv", task="a/0")  ->  task must be None for a CSV file
Trials.load("trials.csv", measure="speed")  ->  measure must be one of 'success', 'return'
Trials([1.0], policy="a").of("b")  ->  name must be a policy that was tried ('a'); got 'b'
success_simulator(GRID, 9)  ->  success must be in 0..8; it is 9
success_simulator(NAMED, "attic")  ->  success must be one of the MDP's names; it is 'attic'
success_simulator(GRID, [8, 9])  ->  success[1] must be in 0..8; it is 9
success_simulator(GRID, [8, 0])  ->  success must be states in which no episode starts
Problem(GRID, LOG, trials=[1.0])  ->  trials must be Trials; got list
Problem(GRID, LOG, trials=Trials.from_successes(9, 12))  ->  trials must be of the quantity that is evaluated: a
  success counts 1 at discount 1, and the problem has discount 0.99 (data.success_simulator
Problem(GRID, LOG, trials=Trials([-1.0], discount=0.9))  ->  trials.discount must be the problem's, 0.99; it is 0.9 (give
Problem(GRID, LOG, trials=Trials([-1.0], horizon=9))  ->  trials.horizon must be the problem's, None; it is 9
Problem(GRID, LOG, horizon=8, trials=Trials([-1.0], horizon=9))  ->  trials.horizon must be the problem's, 8; it is 9
Problem(GRID, LOG, trials=Trials([-1.0, 2.0]))  ->  trials.returns[1] must be in [...]...other discount or horizon
interval(TRIED, UNIFORM, method="delta")  ->  method must be 'likelihood' with trials
interval(TRIED, UNIFORM, tie=KEYS)  ->  tie must be None with trials
interval(TRIED, UP)  ->  trials.policy must be the policy that is evaluated; it is another one
evaluate(TRIED, {"up": UP})  ->  trials.policy must be a policy that is evaluated ('up'); it is another one
join_trials(P, UNIFORM)  ->  problem must have trials of this policy; it has none

# intervals, comparisons, plans
interval(P, UNIFORM, method="bootstrap", n_bootstrap=0)  ->  n_bootstrap must be a positive integer
interval(Problem(HUGE, LOG), UNIFORM, method="robust")  ->  the simulator's rewards must be at most 1e+140, ...larger unit
interval(P, UNIFORM, method="bootstrap", resample="episodes")  ->  log must have at least 10 episodes to be resampled by
interval(Problem(GRID, LOG.draw(9, seed=0)), UNIFORM, method="bootstrap", resample="episodes")  ->  log must have episodes to be
interval(Problem(GRID, 0.5 * COUNTS), UNIFORM, method="bootstrap")  ->  counts must be whole numbers to be resampled
interval(P, UNIFORM, tie=KEYS, features=PHI)  ->  tie and features must not be given together
interval(P, UNIFORM, unrecorded=-1)  ->  unrecorded must be in [1, inf]; it is -1
interval(P, UNIFORM, seconds=0)  ->  seconds must be in (0, inf)
interval(P, UNIFORM, tie=KEYS, lower_ratio=0.5)  ->  lower_ratio and upper_ratio must be None with tie
interval(P, UNIFORM, features=PHI, method="delta")  ->  method must be 'likelihood' with features
interval(P, UNIFORM, features=np.ones(120))  ->  features must differ between ...; feature 0 is constant
interval(P, UNIFORM, tie=KEYS[:-1])  ->  tie must have shape
interval(P, UNIFORM, tie=0.5 * KEYS)  ->  tie must have integer keys
value_range(GRID, UNIFORM, 1.2, 2.0)  ->  lower_ratio must be in [0, 1]
value_range(GRID, UNIFORM, 0.5, 0.5)  ->  upper_ratio must be in [1, inf]
value_range(walk(0.5), [0, 0], 0.0, 2.0)  ->  horizon must be given: ... stay for ever ... s=0 is one
value_range(walk(1.0), [0, 0], 0.5, 2.0)  ->  horizon must be given: ... s=0 has reward -1
robust_policy(GRID, 1.2, 2.0)  ->  lower_ratio must be in [0, 1]
robust_policy(GRID, 0.5, 0.5)  ->  upper_ratio must be in [1, inf]
robust_policy(GRID, 0.5, 2.0, horizon=0)  ->  horizon must be a positive integer
robust_policy(P, 0.5, 2.0)  ->  simulator must be a FiniteMDP
robust_policy(walk(0.5), 0.0, 2.0)  ->  horizon must be given: ... stay for ever ... s=0 is one
robust_policy(walk(1.0), 0.5, 2.0)  ->  horizon must be given: ... s=0 has reward -1
oee.RobustPolicy(UNIFORM, 1.0, np.array([0.0, 1.0]))  ->  gap must be
oee.RobustPolicy(UNIFORM[0], 1.0, 0.0)  ->  policy must have shape (states, actions)
compare_policies(P, [[0] * 9])  ->  policies must be at least two to compare; there is 'policy 0'
compare_policies(Problem(HUGE, LOG), {"a": UNIFORM, "b": UP})  ->  the simulator's rewards must be at most 1e+140,
selection_measures([1], [1])  ->  estimates and truths must have one length of at least 2
selection_measures([1, np.nan], [1, 2])  ->  estimates[1] must be finite
selection_measures([1, 2], [1, 2], k=3)  ->  k must be at most the number of policies, 2
plan(P, horizon=4)  ->  horizon must be left out with a Problem, which has its own
plan(GRID, UNIFORM[:3])  ->  policies must have shape (9, 4) (states, actions)
plan(GRID, {"a": UNIFORM, "b": 0.5 * UNIFORM})  ->  policies['b'][0] must sum to 1
plan(GRID, {})  ->  policies must have at least one policy
plan(GRID, solver="SCS")  ->  solver must be one of 'auto', 'CLARABEL'
plan(GRID, solver="frank_wolfe")  ->  solver must be one of 'auto', 'CLARABEL'
plan(GRID, model="truth")  ->  model must be one of 'estimate', 'simulator'
plan(GRID, model=GRID.transitions)  ->  model must be 'estimate', 'simulator' or a FiniteMDP
plan(GRID, model=mdp())  ->  model must be for 9 states and 4 actions
plan(STIFF, model=GRID)  ->  model must stay in the simulator's support: ...s=0, a=0 -> s'=
plan(GRID, restart=0.1)  ->  restart must be left out with sampling 'free'
plan(GRID, sampling="behavior", restart=1.0)  ->  restart must be in (0, 1)
plan(GRID, sampling="behavior", restart=1 - 1e-9)  ->  restart must let episodes reach ...; at 1 what
plan(GRID, minus=UNIFORM[:3])  ->  minus must have shape (9, 4) (states, actions)
plan(GRID, minus=0.5 * UNIFORM)  ->  minus[0] must sum to 1
plan(P, minus={"a": UNIFORM, "b": UNIFORM})  ->  minus
plan(GRID, lower_ratio=1.5)  ->  the box [lower_ratio, upper_ratio] must contain 1

# sampling and tasks
sample_transitions(GRID, np.ones(4), 5, seed=0)  ->  distribution must have 2 dimension
sample_transitions(GRID, np.ones((3, 4)) / 12, 5, seed=0)  ->  distribution must have shape (9, 4)
sample_episodes(GRID, UNIFORM, 10**14, 5, seed=0)  ->  n_episodes must be small enough for this machine's memory; 1000... GiB
sample_returns(GRID, UNIFORM, 3, 4, seed=0, zeta=-GRID.transitions)  ->  zeta must be finite and nonnegative; at ... it is -
bus_engines(30)  ->  seed must be given where 30 months are drawn; it is None (seed=0)
bus_engines(source="target")  ->  n_months must be given where months are sampled from the target
bus_engines(4293, seed=0)  ->  n_months must be at most 4292, the recorded months of group 4; it is 4293 (source='target'
bus_engines(3313, seed=0, target_group=3)  ->  n_months must be at most 3312, the recorded months of group 3
bus_engines(0, seed=0)  ->  n_months must be a positive integer
bus_engines(30, seed="x")  ->  seed must
bus_engines(30, seed=0, source="simulator")  ->  source must be one of 'recorded', 'target'; got 'simulator'
bus_engines(simulator_group=5)  ->  simulator_group must be one of the groups 1 to 4; it is 5
bus_engines(target_group=0)  ->  target_group must be a positive integer
bus_engines(discount=1.01)  ->  discount must be in [0, 1]; it is 1.01
bus_engines(source="target", n_months=10**14, seed=0)  ->  n_months must be small enough for this machine's memory
named_task("bus_engines:5")  ->  group must be one of the groups 1 to 4; it is 5
named_task("bus_engines:groups=4")  ->  simulator 'bus_engines:groups=4' must be like 'bus_engines:group=4'
toy_text("FrozenLake-v9")  ->  environment ...'FrozenLake-v9' is neither; near: FrozenLake
gridworld(10**6, 0.1)  ->  size must be small enough for this machine's memory; 1000000 needs ... GiB
named_task("FrozenLake-v1:success_rate=1/0")  ->  success_rate must be a finite number; '1/0' divides by 0
named_task("gridworld:3,slip=.1,slip=.2")  ->  slip must be given once; '3,slip=.1,slip=.2' has it twice
named_task("FrozenLake-v1:desc=x")  ->  environment 'FrozenLake-v1' does not take these arguments {'desc': 'x'}
named_task("FrozenLake-v1:success_rate=7")  ->  environment 'FrozenLake-v1' with success_rate=7 is no finite MDP: env.P[0][0]

# pictures
plot_curves([0, 1], {})  ->  curves must hold at least one
plot_curves([0, 1], {"a": [np.nan] * 2})  ->  curves must hold at least one finite number
plot_curves([0, 1], {"a": [1]})  ->  curves['a'] must have 2 values, one a point
plot_curves([0, np.nan], {"a": [1, 2]})  ->  x[1] must be finite
plot_curves([1], [1])  ->  curves must be a Mapping
plot_curves([0], {"a": [1]}, bands={"b": ([0], [1])})  ->  bands must be of names in curves
plot_curves([1], {"a": [1]}, bands={"a": [[1]]})  ->  bands['a'] must be (lower, upper)
plot_curves([1], {"a": [1]}, truth=[1, 2])  ->  truth must have 1 values, one a point
plot_curves([1], {"a": [1]}, xlabel=3)  ->  xlabel must be a text
plot_errors([0, 1], {"a": [1, 2]})  ->  n[0] must be positive
plot_errors([1, 2], {"a": [1, -2]})  ->  errors['a'][1] must be nonnegative
plot_variance_growth({})  ->  variances must hold at least one
plot_variance_growth({"a": [-1.0]})  ->  variances['a'][0] must be nonnegative
plot_intervals(["a"], [1], [0, 1], [2])  ->  ...one length; they have 1, 1, 2, 1 and 1
plot_intervals(["a"], [1], [0], [2], limits=(1, 1))  ->  limits must be (low, high)
plot_intervals(["a", ["b"]], [1, 2], [0, 1], [2, 3])  ->  names[1] must be a text; got ['b']
plot_intervals(["a", "b"], [1, 2], [0, 1], [2, 3], groups=["x", None])  ->  groups[1] must be a text; got None
plot_intervals([], [], [], [])  ->  values must have a finite number, or lower and upper
plot_intervals(["a"], [np.nan], [np.nan], [np.nan])  ->  values must ...there is nothing to draw
plot_values([])  ->  records must hold at least one finite value
plot_values([{"policy": "a"}])  ->  records must be mappings with estimator, lower, policy
plot_grid([1, 2, 3], (2, 2), label="x")  ->  values must have 4 entries, one a cell
plot_grid([np.nan], (1, 1), label="x")  ->  values must hold at least one finite number
plot_grid([1], 1, label="x")  ->  shape must be (rows, columns)
plot_grid([1], (1, 0), label="x")  ->  shape[1] must be a positive integer
plot_grid([1], (1, 1), label="x", crossed=[0, 1])  ->  crossed must have 1 entries
plot_grid([1], (1, 1), label="x", colormap="red")  ->  colormap must be the name of one
plot_ratio([1, -1], (1, 2))  ->  values[1] must be nonnegative
plot_ratio([np.nan], (1, 1))  ->  values must hold at least one finite number
plot_coverage([1, -1], (1, 2))  ->  counts[1] must be nonnegative
plot_coverage([1, 1], (1, 2), over=[True])  ->  over must have 2 entries
plot_occupancy([1, 0], (1, 2), unrecorded=[True])  ->  unrecorded must have 2 entries
plot_occupancy([np.nan], (1, 1))  ->  time must hold at least one finite number
plot_states([], [])  ->  time must hold at least one state
plot_states([np.nan], [1])  ->  time[0] must be finite
plot_states([1.0], [1, 2])  ->  recorded must have the shape of time, (1,)
plot_states([1.0], [1], names=[])  ->  names must have 1 entries, one a state
figure_png(print, size=(0, 1))  ->  size must be from 0.1 to 100 inches
figure_png(3)  ->  draw must be a function
label_ends(3)  ->  ax must be matplotlib Axes
save_figure(print, "a.gif")  ->  path must end in .png or .pdf or .svg; it is 'a.gif'
save_figure(print, "png")  ->  path must end in .png or .pdf or .svg; it is 'png'
save_figure(3, "a.png")  ->  draw must be a function
save_figure(print, "a.svg", size=(1, 101))  ->  size must be from 0.1 to 100 inches
schematic(3)  ->  ax must be matplotlib Axes
plot_policy(GRID, UNIFORM, 3)  ->  ax must be matplotlib Axes
plot_policy(GRID, 2 * UNIFORM)  ->  policy[0] must sum to 1
plot_policy(CHAIN, ONLY[:1])  ->  mdp must have states on a grid; its ...layout=
plot_policy(COIN, ONLY)  ->  mdp must have states on a grid; its 2 states have no (row, column) ...layout=), says
plot_paths(COIN, [0, 1])  ->  mdp must have states on a grid; its 2 states have no (row, column) ...layout=
plot_paths(GRID, [])  ->  paths must hold at least one state; it is empty
plot_paths(GRID, [[0, 1], []])  ->  paths[1] must hold at least one state; it is empty
plot_paths(GRID, [0, 9])  ->  paths[1] must be in 0..8; it is 9
plot_paths(GRID, [[0], [1, -1]])  ->  paths[1][1] must be in 0..8; it is -1
plot_paths(GRID, [0, "start"])  ->  paths[1] must be a number in 0..8, since the MDP has no names
plot_paths(GRID, 3)  ->  paths must be
plot_paths(GRID, FAR)  ->  paths must be a log with episodes, or lists of states; the log has no episodes
plot_paths(GRID, [0], max_paths=0)  ->  max_paths must be a positive integer
animate_two(GRID, GRID, UNIFORM, "a.png", seed=0)  ->  path must end in .gif; it is 'a.png'
animate_two(COIN, COIN, ONLY, "a.gif", seed=0)  ->  simulator must have states on a grid; ...layout=
animate_two(GRID, COIN, UNIFORM, "a.gif", seed=0)  ->  target must have the simulator's 9 states; it has 2
animate_two(GRID, GRID, 2 * UNIFORM, "a.gif", seed=0)  ->  policy[0] must sum to 1
animate_two(GRID, GRID, UNIFORM, "a.gif", seed=0, horizon=201)  ->  horizon must be at most 200
animate_two(GRID, GRID, UNIFORM, "a.gif", seed=0, frames_per_second=0)  ->  frames_per_second must be in [0.1, 50]
animate_two(GRID, GRID, UNIFORM, "a.gif", seed="x")  ->  seed must be what numpy

# theorems
kl_path_sides(CHAIN, CHAIN.transitions, ONLY)  ->  model must be a FiniteMDP or a ReweightedModel
unnormalised_sides(CHAIN, reweight(CHAIN, ONES), ONLY, ratio=ONES)  ->  model must be a FiniteMDP (the simulator) with a ratio
unnormalised_sides(CHAIN, CHAIN, ONLY, ratio=sparse.csr_array(np.ones((3, 2))))  ->  ratio must be sparse of shape (2, 2)
simulation_lemma(CHAIN, HALL, ONLY)  ->  target and model must have the same states and actions
simulation_lemma(CHAIN, CHAIN.with_discount(0.8), ONLY)  ->  model must have the target's discount 0.9
simulation_lemma(CHAIN, CHAIN.with_initial([0.5, 0.5]), ONLY)  ->  model.initial[0] must be the target's 1
simulation_lemma(CHAIN, CHAIN.with_rewards([1.0, 2.0]), ONLY)  ->  model.rewards[1, 0] must be the target's 0
simulation_lemma(COIN, PAID, ONLY)  ->  model must have the target's form of rewards, r(s, a); it has r(s, a, s')
simulation_lemma(PAID, PAID.with_rewards(np.full((2, 1, 2), 2.0)), ONLY)  ->  model's reward at s=0, a=0 -> s'=0 must be
normalised_sides(CHAIN, CHAIN, ONLY, ratio=ONES * 1.5)  ->  model.transitions[0, 0] must sum to 1
normalised_sides(CHAIN, CHAIN, np.ones((3, 1)))  ->  policy must have shape (2, 1) (states, actions)
path_kl(CHAIN, CHAIN, ONLY, horizon=2, ratio=ONES * 0.5)  ->  model.transitions[0, 0] must sum to 1
simulation_lemma(CHAIN, CHAIN, ONLY, ratio=ONES * 1.5)  ->  the infinite sum does not exist: ... spectral radius of 1.35
value_error_sides(PAID, PAID, ONLY, horizon=2, error=0.1, nu=0.5)  ->  target must have rewards r(s, a): Theorem 2
kl_path_bound([0.0, -1.0], 1.0, 0.9)  ->  path_divergence[1] must be nonnegative
renyi_divergence([1], [1, 1], 1)  ->  p and q must have one length
renyi_divergence([0], [1], 1)  ->  p must have a positive, finite sum
renyi_divergence([1], [-1], 1)  ->  q[0] must be nonnegative
excess_risk([1.0], [1, 1], [1, 1])  ->  g must have the length of p, 2
excess_risk([-1.0], [1], [1])  ->  g[0] must be nonnegative
squared_error_sides([1.0, 3.0], [1, 1], [1, 1], mu=2.0)  ->  mu must be at least g and p/q, ... 3
estimation_sides([1, 9], [1, 1], [1, 1], n=5, mu=2, nu=0.5, confidence=0.9, constant=1)  ->  g[1] must be in [nu, mu] = [0.5, 2]
ratio_error_bound(0.1, 2.0, 1.0)  ->  nu must be in (0, 1)
ratio_error_bound(0.1, 1.0, 0.5)  ->  mu must be in (1, inf)
ratio_error_sides([1.0], [1.0], [1.0, 1.0], [1.0], mu=2.0, nu=0.5)  ->  true_moves must have the length of moves, 1
universal_constant_counterexample(1)  ->  n must be at least 2
sup_error_bound(5, 0.5, 0.5, 2, 0.5, 0.9)  ->  mu must be in [1, inf)
value_bound_counterexample(2, 0.9, -0.1, 0.5)  ->  epsilon must be in [0, inf)
value_error_bound(2, 1.0, 0.9, error=0.1, nu=2.0)  ->  nu must be in (0, 1)

# continuous tasks
train_expert(elite=65)  ->  elite must be at most the population, 64; it is 65
record(CartPole(), POLE, n_transitions=5, n_episodes=5, max_steps=5)  ->  one of n_transitions and n_episodes must be given
record(CartPole(), lambda s: np.ones(len(s)), n_transitions=5, max_steps=5)  ->  policy(states) must have shape (256, 2)
monte_carlo_value(CartPole(), lambda s: np.full((len(s), 2), 0.25), 5, 5)  ->  policy(states)[0] must sum to 1 ...0.5 (5 such
Reacher(0.0)  ->  length must be positive; it is 0.0
Reacher(target=(1, 2, 3))  ->  target must be two finite numbers (x, y); it is (1, 2, 3)
Reacher(target=(0.1, float("nan")))  ->  target must be two finite numbers
oee.tasks.reacher_policy(0.5, length=np.zeros(()))  ->  length must be positive; it is array(0.)
oee.tasks.kinova_policy(np.timedelta64(3, "s"))  ->  goal must be in 0..4, a row of GOALS; it is np.timedelta64(3,'s')
oee.bench.run(families=["machine"], sizes=[1e308], seeds=1)  ->  sizes must be at most ...e+14; ..., for the family machine
oee.tasks.reacher_policy(0.5, target=(1.0, 0.0))  ->  target must be 0.01 to 0.21 m ...; it is 1 m away
KinovaArm(goal=5)  ->  goal must be in 0..4, a row of GOALS; it is 5
hand_log(hand(5))  ->  log.state must have 3 coordinates (position), 7 ...; it has 5
hand_log(hand(3, 456.0))  ->  log.state[0, 0] must be within +-1.3: positions in m; it is 456
hand_log(hand(7, 90.0))  ->  log.state[0, 0] must be within +-25.13: joint angles in rad; it is 90
hand_log(hand(3, action=(1.0, 0.0)))  ->  log.action must have 3 coordinates, along x, y, z; it has 2
hand_log(hand(3), speed=0.0)  ->  speed must be in
HistoryTask(CartPole(), -1).log(pole())  ->  steps must be a positive integer
HistoryTask(CartPole(), 200).log(pole())  ->  steps must be less than the longest episode
HistoryTask(CartPole()).log(pole(rows=slice(None, None, 2)))  ->  ...log.episode is not given, and no row begins where
HistoryTask(Reacher()).log(pole(width=3))  ->  log.state must have the 4 coordinates of Reacher
HistoryTask(CartPole()).policy(np.ones((3, 2)))  ->  policy must be
ResidualSimulator("cartpole", pole())  ->  task must be ...ContinuousTask
ResidualSimulator(CartPole(), None)  ->  log must be
ResidualSimulator(CartPole(), pole(width=2))  ->  log.state must ...; it has 2; speeds that were not recorded can
ResidualSimulator(CartPole(), pole(action=2))  ->  log.action[0] must be in 0..1
corrected_value(CartPole(), POLE, 10, 5)  ->  corrected must be a ResidualSimulator
corrected_value(corrected(), np.ones((3, 2)), 10, 5)  ->  policy must be
fit_parameters(CartPole, {}, pole())  ->  start must map names
fit_parameters(CartPole, {b"gravity": 10.0}, pole())  ->  start must have texts as names of parameters; one is b'gravity'
fit_parameters(CartPole, {"gravity": 10.0}, pole(), {"gravity": (11, 12)})  ->  start['gravity'] must be in its bounds, 11 to 12
fit_parameters(CartPole, {"gravity": 10.0}, pole(), {"mass": (0.0, 1.0)})  ->  bounds must be of parameters in start
fit_parameters(None, {"gravity": 10.0}, pole())  ->  task_of must be
evaluate_continuous(CartPole(), pole(), {"p": POLE}, horizon=10, fit="gravity")  ->  fit must be names
evaluate_continuous(CartPole(), pole(), {"p": POLE}, horizon=9, fit=["gravty"])  ->  fit must name ...(did you mean gravity?)
evaluate_continuous(CartPole(), pole(), {"p": POLE}, horizon=9, history="all")  ->  history must be a positive integer

# continuous tasks as finite MDPs
GridInterpolation(60)  ->  shape must be a tuple of positive integers; got 60
cells((60, 1))  ->  cells must have at least 2 vertices ...; it is (60, 1)
cells((60, 1.5))  ->  cells must be a positive integer; got 1.5
cells((9, 9, 9))  ->  shape must have 2 numbers, one for each feature of CartPole (theta, theta_dot); it is (9, 9, 9)
cells(GridInterpolation((9, 9), low=(0.0, 3.2)))  ->  high[1] must be above low[1], 3.2; it is 3.2
cells(GridInterpolation((9, 9), low=(0.0, np.nan)))  ->  low[1] must be finite; it is nan
cells(GridInterpolation((9, 9), high=(1.0,)))  ->  high must have shape (2,)
cells(GridInterpolation((9, 9), noise_points=(3, 3)))  ->  noise_points must be a positive integer; got (3, 3)
discretize(5)  ->  task must be a ContinuousTask; got int
discretize(Nowhere(), cells=(6, 6))  ->  task must step to finite states; from [... it steps to [nan
discretize(pendulum(terminates=False), cells=(5, 5)).counts(states(terminated=[0, 1]))  ->  log.terminated[1] must be False: ep
cells(floor=1.0)  ->  floor must be in (0, 1); it is 1
cells(floor=0.1)  ->  floor must be 0 without a log, for CartPole has no others; it is 0.1
cells(log=pole(width=2))  ->  log.state must have the 4 coordinates of CartPole (x, x_dot, theta, theta_dot); it has 2
cells().encode_states(np.zeros((3, 2)))  ->  states must have shape (n, 4), the x, x_dot, theta, theta_dot of CartPole
cells().encode_states([[0, 0, np.nan, 0]])  ->  states[0, 2] must be finite; it is nan
cells().counts(Transitions([0], [0], [0]))  ->  log must be ContinuousTransitions; got Transitions
cells().counts(pole(action=2))  ->  log.action[0] must be in 0..1, ...; it is 2
cells().counts(pole(state=[0.0, 0.0, 0.5, 0.0]))  ->  log.state[0] must be a state in which CartPole goes on; it is
cells().counts(pole(next_state=[0.0, 0.0, 0.0, 9.0]))  ->  log.next_state must be inside ...: 1 of 50 rows ...theta_dot=9
cells().encode(pole(), outside="clip")  ->  outside must be one of 'error', 'nearest', ...; got 'clip'
cells(floor=0.2, others=[CartPole(5.0)]).mixture([1.0])  ->  weights must have shape (2,); it has shape (1,)
cells(floor=0.2, others=[CartPole(5.0)]).mixture([0.6, 0.6])  ->  weights must sum to 1
visited_states([], [POLE], 5, max_steps=5, seed=0)  ->  tasks and policies must have at least one each
pendulum(actions=[[-3.0]])  ->  actions[0] must be in Box(-2.0, 2.0, (1,), float32); it is [-3.0]
pendulum(state_names=("a",))  ->  get_state must return the 1 numbers ...; it returns shape (2,)
pendulum(set_state=lambda env, state: env.reset())  ->  set_state must set what get_state reads; ... became
pendulum(low=[0.0])  ->  low must have shape (2,), one for each of state_names; it has shape (1,)
GymnasiumTask(5, state_names=(), actions=[0], low=[], high=[])  ->  make must be a function; got int

# logs of continuous tasks
states(state=[0.0, 1.0])  ->  state must have shape (n, d); it has shape (2,)
states(state=np.zeros((0, 2)))  ->  state must have at least one row; the log is empty
states(state=[[0.0, np.nan], [0.4, 0.1]])  ->  state[0, 1] must be finite; it is nan
states(next_state=[[0.4, 0.1], [np.inf, 0.0]])  ->  next_state[1, 0] must be finite; it is inf
states(state=[["a", "b"]])  ->  state must be an array of numbers; state[0, 0] is 'a'...
states(next_state=[[0.4], [0.5]])  ->  next_state must have the 2 coordinates of state; it has 1
states(action=[0])  ->  columns must have equal lengths; ...'action': 1
states(action=[0, -1])  ->  action[1] must be at least 0; it is -1
states(action=[0, 0.5])  ->  action[1] must be an integer; it is 0.5 (call the column of a continuous task's commands action_0)
states(next_state=[[0.25, 0.3], [0.5, 0.0]])  ->  next_state[0] must be the state of the next row of its episode
states(terminated=[1, 0])  ->  terminated[0] must be False: its episode continues in the next row
states(reward=[0.0, np.nan])  ->  reward[1] must be finite; it is nan
states(action=[0, 3]).action_numbers([-1.0, 1.0])  ->  log.action[1] must be in 0..1, ...it is 3
states(action=np.zeros((2, 2))).action_numbers([-1.0, 1.0])  ->  log.action must have the 1 coordinates of
states(action=[[0.5]] * 2).action_numbers([-1.0, 1.0], strict=True)  ->  log.action must be one of the task's 2 actions; 2 of 2
states().select([])  ->  rows must choose at least one row
states().first(5)  ->  n must be at most the 2 rows of the log; it is 5
states().save("log.txt")  ->  path must end in .npz, .csv, .csv.gz, .parquet; it is 'log.txt'
states().save("folder")  ->  path must end in .npz, .csv, .csv.gz, .parquet; it is 'folder'
ContinuousTransitions.load("none.csv")  ->  ...none.csv
ContinuousTransitions.concatenate([states(), "log"])  ->  logs must be one or more ContinuousTransitions

# families of the bench
family(target=GRID)  ->  target and simulator must have the same states and actions; ...(60, 30)
family(simulator=STIFF, target=GRID, policy=UNIFORM, data_policy=UNIFORM)  ->  target must stay in ... ...s=0, a=
family(policy=np.ones((30, 2)))  ->  policy[0] must sum to 1 ...it sums to 2
family(data_policy=np.ones((2, 2)) / 2)  ->  data_policy must have shape (30, 2)
family(target=PAIR.target.with_discount(0.9))  ->  target must have the simulator's discount, 0.98; it has 0.9
family(target=PAIR.target.with_rewards(2 * PAIR.target.rewards))  ->  target must pay the ...; at s=0, a=0 it pays -2 on average
family(target=PAIR.target.with_initial(np.eye(30)[0]))  ->  target must have the ...initial distribution; initial[0] is 1
family(about=" ")  ->  about must be a sentence that says what the simulator has wrong; got ' '
family(length=2.5)  ->  length must be a positive integer; got 2.5
PAIR.size(-1)  ->  per_row must be in [0, inf); it is -1
gymnasium_simulator("Pendulum-v1", actions=10**12)  ->  actions must be at most ... in all; there are 1000000000000
gymnasium_simulator("Pendulum-v1", actions=[])  ->  actions must have a level or a command; it is empty
PAIR.size(1e308)  ->  per_row must be at most 1.55297e+14; it is 1e+308
oee.bench.run("simulator", families=np.ma.masked_array([1.0]))  ->  families[0] must be a text
oee.bench.run("simulator", sizes=NotImplemented)  ->  sizes must be numbers; got NotImplementedType
oee.testing.as_code(ITSELF)  ->  value must not be nested so deep, or hold itself
PAIR.log(2**40, seed=0)  ->  n must be small enough for this machine's memory; 1099511627776 needs
oee.bench.run("simulator", seeds=2**53)  ->  seeds must be small enough for this machine's memory
replace(REPORT, seed=sparse.csr_array(np.eye(3)))  ->  seed must be None, an integer or a sequence of integers; got <csr_array
replace(REPORT, seed=[[1], [2, 3]])  ->  seed must be None, an integer or a sequence of integers; got [[1], [2, 3]]
replace(REPORT, seed="x")  ->  seed must be None, an integer or a sequence of integers; got 'x'
replace(RAGGED, behavior=RAGGED.behavior * 2)  ->  behavior[0] must sum to 1
replace(RAGGED, policy=RAGGED.policy[:1])  ->  behavior must have shape (1, 2)
RAGGED.with_rewards(1e308, 0.0)  ->  scale must leave rewards that double precision holds; 1e+308 * 7 + 0 is too large
RAGGED.with_rewards(1.0, -1.7e308).with_rewards(2.0, 0.0)  ->  scale must leave rewards that double precision holds
replace(RAGGED_PLAN, distribution=2 * RAGGED_PLAN.distribution)  ->  distribution
  must have nonnegative shares that sum to 1; ...their sum 2
PAIR.log(3, seed="x")  ->  seed must be what numpy.random.default_rng takes; got 'x'
families(-1)  ->  seed must be an integer from 0; got -1
families(0.5)  ->  seed must be an integer from 0; got 0.5
garnet_worse(4)  ->  n_states must be at least 5; it is 4

# oracles, laws and strategies of testing
check_estimator(3)  ->  estimator must be a function (problem, policy) ...; got int
check_estimator(lambda problem: 1.0)  ->  estimator must be callable as ..., seed); it takes (problem)
check_estimator(lambda problem, policy, rng: 1.0)  ->  estimator must ...it takes (problem, policy, rng)
check_estimator(Oracle)  ->  estimator must make an estimator without arguments; it raises TypeError
check_estimator(lambda: 3)  ->  estimator must make a function ...; it makes int
check_estimator(Simulator(), seed=-1)  ->  seed must be an integer of at least 0; got -1
check_estimator(Simulator(), repetitions=2)  ->  repetitions must be at least 3; it is 2
check_estimator(Simulator(), laws=["shfit"])  ->  laws must be one of ...'shift'...; got 'shfit'
check_estimator(Simulator(), claims=["unbaised"])  ->  claims must ...got 'unbaised' (did you mean 'unbiased'?)
check_estimator(Simulator(), claims="unbiased")  ->  claims must be a collection of words; got str
check_estimator(Oracle, from_pair=True)  ->  estimator must be a function (simulator, target) ->
check_answer("risk", abs)  ->  exercise must be one of 1_risk, ...; it is 'risk'
check_answer(None, abs)  ->  exercise must be one of 1_risk, ...; it is None
check_answer("1_risk", abs, cases="12")  ->  cases must be numbers of cases, as in range(5); it is '12'
check_answer("1_risk", abs, cases=3)  ->  cases must be numbers of cases, as in range(5); it is 3
check_answer("1_risk", abs, cases=[])  ->  cases must have a case; it is empty
check_answer("1_risk", abs, cases=[0, -1])  ->  cases[1] must be an integer from 0 to 9999; it is -1
check_answer("1_risk", abs, cases=[0.5])  ->  cases[0] must be an integer from 0 to 9999; it is 0.5
draw_case("9_risk", 0)  ->  exercise must be one of 1_risk, ...; it is '9_risk'
draw_case("1_risk", True)  ->  case must be an integer from 0 to 9999; it is True
draw_case("1_risk", None)  ->  case must be an integer from 0 to 9999; it is None
case("raged")  ->  name must be one of 'ragged', ...; got 'raged'
relabelled_log(LOG, [0, 1], [1, 0])  ->  states must have a number for each of ... states; it has 2
relabelled_log(LOG, [0] * 9, [1, 0])  ->  states must be a permutation of 0, 1, ...; it is [0, 0
relabelled_log(LOG, range(9), [True, False])  ->  actions must be a permutation ...; it is [True, False
relabelled_log({}, [0], [0])  ->  log must be Transitions; got dict
padded_log(LOG.draw(3, seed=0), [0], 0.5)  ->  log must have episodes; it has none
compared(behavior_policy=None)  ->  one of behavior_policy and data_distribution must be given
compared(data_distribution=EVEN)  ->  one of behavior_policy and data_distribution must be given
compared(pair=(GRID,))  ->  pair must be (simulator, target); it holds 1
compared(pair=3)  ->  pair must be (simulator, target); got int
compared(pair=(GRID, 3))  ->  target must be a FiniteMDP; got int
compared(pair=(GRID, HALL))  ->  target and simulator must have the same states and actions
compared(estimator=lambda problem: 1.0)  ->  estimator must be callable as ...; it takes (problem)
compared(estimator=lambda problem, policy: (1.0, 2.0))  ->  an estimator must return a float or an Estimate; it returned tuple
mdps(min_states=3, max_states=2)  ->  min_states must be at most max_states; they are 3 and 2
mdps(discounts=[1.5])  ->  discounts must be in [0, 1]; it is 1.5
mdps(discounts=[])  ->  discounts must hold at least one; it is empty
mdps(rewards=["ss"])  ->  rewards must be one of 's', 'sa', 'sas'; got 'ss'
mdp_pairs(support="violated", min_states=1)  ->  min_states must be at least 2 for support 'violated'; it is 1
# decisions
oee.improve(3, UNIFORM)  ->  problem must be a Problem
oee.improve(P, np.full((9, 5), 0.2))  ->  running must have shape
oee.improve(P, np.full(9, 4))  ->  running[0] must be in 0..3; it is 4
oee.improve(P, UNIFORM, candidates={"corrected": UP})  ->  candidates must have names of their own; 'corrected' is that of
oee.improve(P, UNIFORM, candidates={"running": UP})  ->  candidates must have names of their own; 'running' is that of
oee.improve(P, UNIFORM, candidates={1.5: UP, "1.5": UP})  ->  candidates must have names that differ as texts; '1.5' stands
oee.improve(P, UNIFORM, candidates={"mine": [[1.0]]})  ->  candidates 'mine' must have shape
oee.improve(P, UNIFORM, confidence=1.0)  ->  confidence must be in (0, 1); it is 1
oee.improve(P, UNIFORM, lower_ratio=2.0)  ->  lower_ratio must be in [0, 1]; it is 2
oee.improve(P, UNIFORM, upper_ratio=0.5)  ->  upper_ratio must be in [1, inf]; it is 0.5
oee.improve(P, UNIFORM, unrecorded=0.5)  ->  unrecorded must be in [1, inf]; it is 0.5
oee.improve(P, UNIFORM, split=1.5)  ->  split must be in (0, 1); it is 1.5
oee.improve(P, UNIFORM, split="half")  ->  split must be
oee.improve(P, UNIFORM, split=True, seed=-1)  ->  seed must
oee.improve(P, UNIFORM, canditates={"mine": UP})  ->  improve() got an unexpected ...'canditates'. Did you mean 'candidates'?
# misspelt keywords, and options that a method does not have
evaluate(P, UNIFORM, lower_raito=3)  ->  evaluate() got an unexpected ...'lower_raito'. Did you mean 'lower_ratio'?
evaluate(P, UNIFORM, sed=3)  ->  evaluate() got an unexpected keyword argument 'sed'. Did you mean 'seed'?
oee.report.contest(P, [UNIFORM, UP], horizon=3)  ->  contest() got an unexpected ...'horizon'. It takes problem, policies,
interval(P, UNIFORM, confidnce=0.9)  ->  interval() got an unexpected keyword argument 'confidnce'. Did you mean 'confidence'?
zeta(lowr=0.5)  ->  transition_ratio() got an unexpected keyword argument 'lowr'. Did you mean 'lower'?
zeta(method=Conditional(), lower=0.5)  ->  lower must ...
policy_value(GRID, UNIFORM, horizn=3)  ->  policy_value() got an unexpected keyword argument 'horizn'. Did you mean 'horizon'?
plan(P, nn=3)  ->  plan_data_collection() got an unexpected keyword argument 'nn'. Did you mean 'n'?
Transitions.load("log.csv", colums={})  ->  load() got an unexpected keyword argument 'colums'. Did you mean 'columns'?
Conditional(rdge=1.0)  ->  Conditional() got an unexpected keyword argument 'rdge'. Did you mean 'ridge'?
Problem(GRID, LOG, horizn=3)  ->  Problem() got an unexpected keyword argument 'horizn'. Did you mean 'horizon'?
Transitions([0], [0], [0], rewrd=[1.0])  ->  Transitions() got an unexpected keyword argument 'rewrd'. Did you mean 'reward'?
Estimate(1.0, diagnostics={}).diagnostics.update(coverage=1.0)  ->  the diagnostics of an estimate are read-only
"""
