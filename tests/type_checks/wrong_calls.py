"""Calls that a type checker must refuse, one a line: each line that ends in "# wrong".

Nothing here is run; ``test_types.py`` gives the file to mypy and to pyright.
"""

import numpy as np
import pandas as pd

import oee_tabular as oee
from oee_tabular import FiniteMDP, TransitionCounts, Transitions
from oee_tabular.estimators import OffEnvironment
from oee_tabular.mdp import check_policy, displacements, mix, uniform_policy
from oee_tabular.ratio import (
    Conditional,
    InClass,
    Joint,
    Kernel,
    Linear,
    Network,
    Quotient,
    Sgd,
    Tied,
    check_assumptions,
    density_ratio,
    transition_ratio,
)
from oee_tabular.shrinkage import Shrinkage

P = [[[0.9, 0.1], [0.6, 0.4]], [[0.5, 0.5], [0.2, 0.8]]]
mdp = oee.FiniteMDP(P, [[1.0, 0.8], [0.0, 0.2]], initial=0, discount=0.9)
log = oee.Transitions([0, 1], [0, 1], [1, 0])
problem = oee.Problem(mdp, log)
policy = oee.uniform_policy(mdp)
frame = pd.DataFrame({"a": [1]})

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
oee.Problem(mdp, 5)  # wrong
oee.Problem(log, mdp)  # wrong
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
oee.report.evaluate_continuous(log=None, polices={})  # wrong

# words that are not in the list
oee.interval(problem, policy, method="likelyhood")  # wrong
oee.transition_ratio(log, mdp, method="conditonal")  # wrong
oee.occupancy(mdp, policy, of="states")  # wrong
oee.weighted_return_moments(mdp, None, policy, kind="per_step")  # wrong
oee.tasks.gridworld(4, 0.1, pay="later")  # wrong
oee.Problem(mdp, log, rewards="robot")  # wrong
oee.Problem(mdp, log, trials=[1.0])  # wrong
oee.Trials.from_successes("9", 12)  # wrong
oee.Trials.load("a.csv", measure="speed")  # wrong
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

# models and logs, one argument at a time
FiniteMDP("P", [0, 1], 0, 0.9)  # wrong
FiniteMDP(P, "r", 0, 0.9)  # wrong
FiniteMDP(P, [0, 1], 0, "0.9")  # wrong
FiniteMDP(P, [0, 1], 0, 0.9, state_names="ab")  # wrong
FiniteMDP(P, [0, 1], 0, 0.9, layout="ab")  # wrong
FiniteMDP(P, [0, 1], 0, 0.9, terminal_state="ab")  # wrong
FiniteMDP(P, [0, 1], 0, 0.9, gamma=1)  # wrong
FiniteMDP(P, ["a", "b"], 0, 0.9)  # wrong
FiniteMDP.from_log("log.csv")  # wrong
FiniteMDP.from_gymnasium("FrozenLake-v1")  # wrong
FiniteMDP.from_env("FrozenLake-v1", samples_per_pair=3)  # wrong
mdp.with_rewards("x")  # wrong
mdp.with_support_of("x", 0.1)  # wrong
check_policy(3, mdp)  # wrong
check_policy("uniform", mdp)  # wrong
check_policy([[1, 0]], "mdp")  # wrong
uniform_policy(3)  # wrong
mix(0.5, [[1, 0]], 0.5)  # wrong
mix("x", [[1, 0]], 0.5)  # wrong
displacements(P)  # wrong
Transitions("x", "y", "z")  # wrong
Transitions(0, 0, 0)  # wrong
Transitions([0], [0], [0], "reward")  # wrong
Transitions([0], [0], [0], rewards=[0])  # wrong
Transitions.from_frame("log.csv")  # wrong
Transitions.from_frame(frame, stat="a")  # wrong
Transitions.from_frame(frame, columns=3)  # wrong
Transitions.from_frame(frame, reward=["a", "b"])  # wrong
Transitions.from_frame(frame, simulator="x")  # wrong
Transitions.open("x", bad_rows="keep")  # wrong
Transitions.open("x", n_jobs=2)  # wrong
Transitions.open(3)  # wrong
Transitions.load(3)  # wrong
TransitionCounts("x", [0], [0], [0])  # wrong
TransitionCounts.of("x", 2)  # wrong
log.counts("3", 2)  # wrong
log.select("x")  # wrong
log.first("3")  # wrong
log.numbered("x")  # wrong

# reports, intervals, comparisons and plans
oee.evaluate(problem, 3)  # wrong
oee.evaluate(problem, "new")  # wrong
oee.evaluate(problem, policy, lower_raito=3)  # wrong
oee.evaluate(problem, policy, lower_ratio="3")  # wrong
oee.evaluate(problem, policy, estimators="oeee")  # wrong
oee.evaluate(problem, policy, estimators=["oee", "wpdsi"])  # wrong
oee.evaluate(problem, policy, estimators={"a": 3})  # wrong
oee.evaluate(problem, policy, estimators=lambda problem, policy: "text")  # wrong
oee.evaluate(problem, policy, tie="key")  # wrong
oee.report.contest(problem, policy, confidnce=0.9)  # wrong
oee.report.contest(problem, 3)  # wrong
oee.report.contest(problem, [policy, policy], seed=3)  # wrong
oee.interval(problem, policy, method="likelyhood")  # wrong
oee.interval(problem, 3)  # wrong
oee.interval(problem, policy, features="x")  # wrong
oee.interval(problem, policy, radius="always")  # wrong
oee.inference.compare_policies(problem, "x")  # wrong
oee.inference.compare_policies(problem, [policy, policy], method="robust")  # wrong
oee.plan_data_collection(problem, 3, n=3)  # wrong
oee.plan_data_collection(problem, policy, n=3, sampling="fre")  # wrong

# ratios and their methods
transition_ratio(log, mdp, method="conditionl")  # wrong
transition_ratio(log, mdp, method=Conditional(), lower=0.5)  # wrong
transition_ratio(log, mdp, method=Joint(), toward=None)  # wrong
transition_ratio(log, mdp, lowr=0.5)  # wrong
transition_ratio(log, mdp, prior="rigde")  # wrong
transition_ratio(log, mdp, strength="cv")  # wrong
transition_ratio(log, mdp, ridge="cv")  # wrong
transition_ratio(log, mdp, simulator_data="most")  # wrong
transition_ratio(log, mdp, features="log")  # wrong
transition_ratio(log, mdp, tie=[0.5, 1.0])  # wrong
transition_ratio(log, mdp, kernel="gauss")  # wrong
transition_ratio(log, mdp, normalized="yes")  # wrong
transition_ratio([[1.0, 2.0]], mdp)  # wrong
transition_ratio(log, mdp, values_of=3)  # wrong
Conditional(prior="flat")  # wrong
Conditional(lowr=0.1)  # wrong
Conditional(solver=Sgd())  # wrong
Tied(tie="keys")  # wrong
Tied(strength="loo")  # wrong
InClass(kernel="gauss")  # wrong
Quotient(data="most")  # wrong
Quotient(functions="mlp")  # wrong
Joint(ridge="loo")  # wrong
Network(activation="sigmoid")  # wrong
Network(inputs="onehot")  # wrong
Network(optimizer="rmsprop")  # wrong
Sgd("0.1")  # wrong
density_ratio("ab", [1, 2])  # wrong
density_ratio([1, 2], [1, 2], loss="l2")  # wrong
density_ratio([1, 2], [1, 2], solver=3)  # wrong
density_ratio([1, 2], [1, 2], functions="table")  # wrong
Kernel([0, 1], "gauss")  # wrong
Linear("ab")  # wrong
Shrinkage("flat")  # wrong
OffEnvironment(adjust=True)  # wrong
Conditional(prior=3)  # wrong
check_assumptions("ab", [2, 2], lower=0.1, upper=1.0)  # wrong


# the diagnostics of an estimate cannot be changed, and what follows is still checked
def change_diagnostics(estimate: oee.Estimate) -> None:
    estimate.diagnostics["note"] = 1  # wrong
    del estimate.diagnostics["note"]  # wrong
    estimate.diagnostics.update(note=1)  # wrong
    estimate.diagnostics.pop("note")  # wrong
    estimate.diagnostics.setdefault("note", 1)  # wrong
    oee.evaluate("nonsense", policy)  # wrong


oee.evaluate(problem, policy, seed=np.random.default_rng(0))  # wrong
