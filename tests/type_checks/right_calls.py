"""Calls that a type checker must accept: what users write, in all its forms.

Nothing here is run; ``test_types.py`` gives the file to mypy and to pyright.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy import sparse

import oee_tabular as oee
from oee_tabular.exceptions import ArgumentError, DataWarning, OeeWarning
from oee_tabular.ratio import (
    Conditional,
    Joint,
    Kernel,
    Linear,
    Network,
    NoPrior,
    Quotient,
    Sgd,
    check_assumptions,
    density_ratio,
    gaussian,
    transition_ratio,
)
from oee_tabular.shrinkage import Shrinkage, SoftThreshold
from oee_tabular.typing import Array, PolicyLike, Seed

# simulators
P = [[[0.9, 0.1], [0.6, 0.4]], [[0.5, 0.5], [0.2, 0.8]]]
small = oee.FiniteMDP(P, [[1.0, 0.8], [0.0, 0.2]], initial=0, discount=0.9)
arrays = oee.FiniteMDP(np.array(P), np.ones((2, 2)), np.array([0.5, 0.5]), 0.9)
rows = sparse.csr_array(np.array(P).reshape(4, 2))
stored = oee.FiniteMDP(rows, [1.0, 0.0], [1, 0], 0.9, state_names=["left", "right"])
noisy = small.with_action_noise(0.1)
grid = oee.tasks.gridworld(10, slip=0.1, pay="current", discount=0.95)
small.save("simulator.npz")
loaded = oee.FiniteMDP.load(Path("simulator.npz"))

# policies
expert: Array = oee.tasks.gridworld_expert(10)
mixed: Array = oee.mix(expert, oee.uniform_policy(grid), 0.5)
forms: list[PolicyLike] = [
    expert,
    [0, 1],
    [[0.5, 0.5], [1.0, 0.0]],
    {"left": 0, "right": 1},
    lambda state: 0,
]
best: Array = oee.optimal_policy(grid)

# exact values
value: float = oee.policy_value(small, [0, 1])
by_state: Array = oee.state_values(small, {0: 0, 1: 1}, horizon=10)
both: Array = oee.action_values(small, lambda state: [0.5, 0.5])
visits = oee.occupancy(small, [0, 1], of="state_action")
moments = oee.return_moments(small, [0, 1], horizon=5)
spread: float = moments.variance
bound: float = oee.efficiency_bound(small, [0, 1], [[0.25, 0.25], [0.25, 0.25]])

# logs
log = oee.Transitions([0, 1], [0, 1], [1, 0], [0.5, 1.0])
more = oee.Transitions(np.array([0]), np.array([0]), np.array([1]), episode=[0])
frame = pd.DataFrame({"state": [0], "action": [0], "next_state": [1]})
from_frame = oee.Transitions.from_frame(frame)
from_file = oee.Transitions.load("log.csv")
from_path = oee.Transitions.load(Path("log.parquet"))
opened = oee.Transitions.open("log.parquet")
drawn = oee.sample_episodes(small, [0, 1], 10, 20, seed=0)
seeds: list[Seed] = [None, 0, [1, 2], np.random.default_rng(0)]
steps = oee.sample_transitions(small, np.full((2, 2), 0.25), 100, seed=[1, 2])
counts = log.counts(2, 2)

# problems, estimators, reports
problem = oee.Problem(small, log)
framed = oee.Problem(small, frame, horizon=20, rewards="log")
counted = oee.Problem(small, counts)
estimate = oee.estimators.OffEnvironment()(problem, [0, 1], seed=0)
number: float = estimate.value
ends = estimate.interval
product = oee.estimators.OffEnvironment(
    evaluation="monte_carlo", weighting="per_decision", n_rollouts=100
)
weighted = oee.estimators.ImportanceSampling(kind="per_decision", self_normalized=True)
limit: float = oee.estimators.ModelBased(fallback="simulator").limit(
    small, small, [0, 1], data_distribution=np.full((2, 2), 0.25)
)
report = oee.evaluate(problem, {"mine": [0, 1]}, confidence=0.9, seed=0)
narrowed = oee.evaluate(problem, [0, 1], lower_ratio=0.5, upper_ratio=2.0)
chosen = oee.evaluate(problem, [[0, 1], [1, 1]], estimators=["oee", "model-based"])
own = oee.evaluate(problem, [0, 1], estimators={"mine": weighted})


def mean(problem: oee.Problem, policy: Array) -> float:
    """Return an estimate, as users' own functions do."""
    return 1.0


def seeded(
    problem: oee.Problem, policy: PolicyLike, *, seed: Seed = None
) -> oee.Estimate:
    """Return an estimate, as users' own functions do."""
    return oee.Estimate(1.0)


function = oee.evaluate(problem, [0, 1], estimators=[mean, seeded, "mwl"])
classes = oee.evaluate(problem, [0, 1], estimators=[oee.estimators.ModelBased])
tied_row = oee.evaluate(problem, lambda s: 0, tie=np.zeros(8, dtype=np.int64))
featured = oee.evaluate(problem, {"s": 0}, features=lambda s, a, t: s + t)
certain = oee.interval(problem, [0, 1], method="robust", tie=[1, 2, 3])
best_policy = oee.report.contest(problem, {"a": [0, 1], "b": [1, 1]})
table: pd.DataFrame = report.table
report.to_html("page.html")
sure = oee.interval(problem, [0, 1], method="likelihood", confidence=0.9)
inside: bool = 0.5 in sure
width: float = sure.width
range_ = oee.value_range(small, [0, 1], 0.5, 2.0)
deployed: bool = oee.improve(problem, policy, candidates={"mine": policy}).deploy
guarded: float = oee.robust_policy(small, 0.5, 2.0).gap
plan = oee.plan_data_collection(problem, {"mine": [0, 1]}, n=100)

# ratios
fit = oee.density_ratio([1, 2], [2, 2], lower=0.1, upper=10.0, ridge=0.1)
zeta = oee.transition_ratio(log, small)
boxed = oee.transition_ratio(log, small, method="conditional", lower=0.5, upper=2.0)
quotient = oee.transition_ratio(log, small, method=oee.ratio.Quotient(normalized=False))
tied = oee.transition_ratio(counts, small, method="conditional", ridge=0.1)
model: oee.FiniteMDP = zeta.target_model(small)
true = oee.true_ratio(noisy, small)

# errors and warnings
try:
    oee.tasks.gridworld(4, slip=2.0)
except ArgumentError as error:
    argument: str = error.argument
kinds: list[type[OeeWarning]] = [DataWarning]
verdicts = oee.testing.check_estimator(weighted)

# models and logs in other forms
by_name = oee.FiniteMDP(
    rows, sparse.csr_matrix(np.ones((4, 2))), {"a": 1.0}, 0.9, state_names=["a", "b"]
)
indexed = oee.FiniteMDP(P, P, "a", 0.9, state_names=pd.Index(["a", "b"]))
moved = indexed.with_initial(np.int64(1)).with_layout(None)
series = oee.Transitions(pd.Series([0, 1]), range(2), ["a", "b"], state_names=["a"])
renamed = oee.Transitions.from_frame(frame, state="state", next_state="next_state")
several = oee.Transitions.open(["a.csv", "b.csv"], simulator=small, jobs=-1)
tallied = oee.TransitionCounts([0, 1], [0, 0], [1, 1], [30, 12])
walks = oee.Transitions.from_episodes([[("hall", "go", -1.0), ("dock", True)]])
wider = small.with_support_of(log, 0.1)
learned = oee.FiniteMDP.from_log(log, discount=0.9, initial=0)

# ratios and their methods
keys = np.zeros(4, dtype=np.int64)
transition_ratio(log, small)
transition_ratio(
    log.counts(3, 2), small, method="joint", ratio_upper=2.0, simulator_data="exact"
)
transition_ratio(log, small, method=Joint(upper=3.0), seed=0)
transition_ratio(log, small, tie=keys, strength=2)
transition_ratio(log, small, tie=lambda s, a, t: a)
transition_ratio(log, small, toward=None, ridge=lambda n: 1 / n)
transition_ratio(
    log, small, ridge="loo", strength="evidence", prior="tilt", features=[[1.0], [2.0]]
)
transition_ratio(log, small, values_of=[np.ones((3, 2)) / 2], horizon=4)
density_ratio([3, 1], [2, 2], solver="SCS", loss="chi2")
density_ratio([3, 1], np.ones(2), functions=Kernel([0, 1], gaussian(1.0)))
density_ratio([3, 1], np.ones(2), functions=Linear([[1, 0], [1, 1]]), ridge=0.1)
Conditional(Shrinkage("tilt", 3, [[1.0], [2.0]]))
Conditional(NoPrior(), upper=2)
oee.estimators.OffEnvironment(Conditional(), adjust=None)
oee.estimators.OffEnvironment(adjust=SoftThreshold())(problem, [0, 1])
oee.estimators.OffEnvironment.paper(upper=5, n_rollouts=10)
check_assumptions([3, 1], [2, 2], lower=0.1, upper=np.inf)
Conditional(features=lambda s, a, t: t, prior="ridge")
Network([32, 32], "tanh", inputs=[0.0, 1.0])
Quotient(solver=Sgd(0.1), functions=None, data="exact", normalized=False)


class Mine:
    """An estimator of one's own, which is made without arguments."""

    def __call__(self, problem: oee.Problem, policy: Array) -> float:
        """Return an estimate."""
        return 1.0


of_a_class = oee.evaluate(problem, [0, 1], estimators={"mine": Mine})
of_numbers = oee.sample_episodes(small, range(2), 10, 20, seed=np.array([1, 2]))
