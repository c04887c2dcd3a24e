"""Calls that a type checker must refuse, one a line: each line that ends in "# wrong".

Nothing here is run; ``test_types.py`` gives the file to mypy and to pyright.
"""

import numpy as np

import oee_tabular as oee

P = [[[0.9, 0.1], [0.6, 0.4]], [[0.5, 0.5], [0.2, 0.8]]]
mdp = oee.FiniteMDP(P, [[1.0, 0.8], [0.0, 0.2]], initial=0, discount=0.9)
log = oee.Transitions([0, 1], [0, 1], [1, 0])
problem = oee.Problem(mdp, log)
policy = oee.uniform_policy(mdp)

# texts and numbers in the place of arrays, models, logs and policies
oee.FiniteMDP("simulator.npz", [1.0, 0.0], 0, 0.9)  # wrong
oee.FiniteMDP(P, "rewards", 0, 0.9)  # wrong
oee.FiniteMDP(P, [1.0, 0.0], 0, "0.9")  # wrong
oee.policy_value(mdp, 3)  # wrong
oee.policy_value(P, policy)  # wrong
oee.policy_value(mdp, "expert")  # wrong
oee.policy_value(mdp, policy, horizon=2.5)  # wrong
oee.evaluate(problem, 3)  # wrong
oee.evaluate(problem, "expert")  # wrong
oee.evaluate(mdp, policy)  # wrong
oee.Problem(mdp, "log.csv")  # wrong
oee.Problem(log, mdp)  # wrong
oee.Transitions([0], [0])  # wrong
oee.Transitions.load(5)  # wrong
oee.density_ratio("counts", [1.0, 2.0])  # wrong

# misspelt keywords
oee.evaluate(problem, policy, lower_raito=3)  # wrong
oee.evaluate(problem, policy, confidense=0.9)  # wrong
oee.report.contest(problem, {"a": policy}, sed=0)  # wrong
oee.interval(problem, policy, level=0.9)  # wrong
oee.policy_value(mdp, policy, horizn=5)  # wrong
oee.tasks.gridworld(4, slipp=0.1)  # wrong
oee.Transitions.open("log.csv", simulatr=mdp)  # wrong
oee.Transitions.from_frame({"state": [0]}, stat="state")  # wrong
oee.transition_ratio(log, mdp, lowr=0.5)  # wrong
oee.plan_data_collection(problem, {"a": policy}, m=100)  # wrong
oee.density_ratio([1.0], [1.0], loer=0.5)  # wrong
oee.tasks.evaluate_continuous(log=None, polices={})  # wrong

# words that are not in the list
oee.interval(problem, policy, method="likelyhood")  # wrong
oee.transition_ratio(log, mdp, method="conditonal")  # wrong
oee.occupancy(mdp, policy, of="states")  # wrong
oee.weighted_return_moments(mdp, None, policy, kind="per_step")  # wrong
oee.tasks.gridworld(4, 0.1, pay="later")  # wrong
oee.Problem(mdp, log, rewards="robot")  # wrong
oee.evaluate(problem, policy, estimators=["oe"])  # wrong

# options of objects
oee.estimators.OffEnvironment(evaluation="sampled")  # wrong
oee.estimators.ImportanceSampling(kind="per_step")  # wrong
oee.estimators.ImportanceSampling(ragged="trim")  # wrong
oee.estimators.ModelBased(fallback="move")  # wrong
oee.ratio.Conditional(prior="dirichlet")  # wrong
oee.ratio.Quotient(ridg=0.1)  # wrong
oee.ratio.Quotient(normalized="yes")  # wrong
oee.ratio.Sgd(step_size="small")  # wrong

# results
number: int = oee.policy_value(mdp, policy)  # wrong
text: str = oee.interval(problem, policy)  # wrong
oee.interval(problem, policy).widht  # wrong
oee.evaluate(problem, policy).tabel  # wrong
oee.mix(policy, policy)  # wrong
oee.sample_episodes(mdp, policy, 10, 20, sed=0)  # wrong
oee.sample_episodes(mdp, policy, "10", 20, seed=0)  # wrong
oee.estimators.ImportanceSampling()(problem)  # wrong
np.asarray(oee.uniform_policy(5))  # wrong
