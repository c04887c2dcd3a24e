"""The unit of rewards does not matter: every public function on scaled rewards.

Rewards times c multiply values, intervals and standard errors by c, variances by c^2,
and leave policies, ratios, occupancies, chances and decisions as they are. Powers of
two change no digit, so that most answers are equal to the bit.
"""

import warnings
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import pytest
from helpers import dense, random_mdp, random_policy
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import estimators, exact, inference, theory
from oee_tabular.data import Transitions

POWERS = [2.0**-332, 2.0**-40, 1024.0, 2.0**431]
ODD = [1e-100, 3e-10, 1e130]


@dataclass(frozen=True, eq=False)
class World:
    """A pair of environments with rewards times ``unit``, and a log of the target."""

    simulator: oee.FiniteMDP
    target: oee.FiniteMDP
    log: Transitions
    policy: np.ndarray
    other: np.ndarray
    behavior: np.ndarray
    horizon: int | None
    unit: float = 1.0

    def times(self, unit):
        """The same world in another unit."""
        columns = dict(self.log.columns())
        columns["reward"] = columns["reward"] * unit
        return replace(
            self,
            simulator=scaled(self.simulator, unit),
            target=scaled(self.target, unit),
            log=Transitions(**columns),
            unit=unit,
        )

    def plus(self, shift):
        """The same world with rewards r + shift."""
        columns = dict(self.log.columns())
        columns["reward"] = columns["reward"] + shift
        return replace(
            self,
            simulator=paying(self.simulator, lambda r: r + shift),
            target=paying(self.target, lambda r: r + shift),
            log=Transitions(**columns),
        )

    def renamed(self, seed):
        """The same world with states and actions in another order."""
        rng = np.random.default_rng(seed)
        states = rng.permutation(self.simulator.n_states)
        actions = rng.permutation(self.simulator.n_actions)
        place = np.argsort(states)
        columns = dict(self.log.columns())
        columns["state"] = place[columns["state"]]
        columns["next_state"] = place[columns["next_state"]]
        columns["action"] = np.argsort(actions)[columns["action"]]
        policies = (self.policy, self.other, self.behavior)
        policy, other, behavior = (x[np.ix_(states, actions)] for x in policies)
        return replace(
            self,
            simulator=reordered(self.simulator, states, actions),
            target=reordered(self.target, states, actions),
            log=Transitions(**columns),
            policy=policy,
            other=other,
            behavior=behavior,
        )

    @cached_property
    def problem(self):
        return oee.Problem(
            self.simulator,
            self.log,
            horizon=self.horizon,
            behavior_policy=self.behavior,
        )

    @property
    def ratio(self):
        return oee.true_ratio(self.target, self.simulator)

    @property
    def shares(self):
        return np.full(self.policy.shape, 1.0 / self.policy.size)

    @property
    def steps(self):
        return self.horizon or 7


def paying(mdp, change):
    """The MDP with other rewards, on the support of its transitions."""
    if mdp.transition_rewards is None:
        return mdp.with_rewards(change(mdp.rewards))
    rewards = mdp.transition_rewards.copy()
    rewards.data = change(rewards.data)
    return mdp.with_rewards(rewards)


def scaled(mdp, unit):
    return paying(mdp, lambda r: r * unit)


def reordered(mdp, states, actions):
    probability, rewards = dense(mdp)
    p = probability[np.ix_(states, actions, states)]
    r = rewards[np.ix_(states, actions, states)]
    if mdp.transition_rewards is None:
        r = mdp.rewards[np.ix_(states, actions)]
    layout = None if mdp.layout is None else np.asarray(mdp.layout)[states]
    return oee.FiniteMDP(p, r, mdp.initial[states], mdp.discount, layout=layout)


def drawn(seed, *, discount, horizon, form):
    rng = np.random.default_rng(seed)
    simulator = random_mdp(
        rng, n_states=6, n_actions=2, discount=discount, form=form, zeros=0.3
    )
    target = random_mdp(rng, like=simulator)
    behavior = np.array([[0.9, 0.1], [0.2, 0.8], [1.0, 0.0], [0.5, 0.5]] * 2)[:6]
    log = oee.sample_episodes(target, behavior, 12, 7, seed=1)
    policy, other = (random_policy(rng, simulator, zeros=0.1) for _ in range(2))
    # places that stay with their states where these get other numbers
    simulator, target = (x.with_layout(np.arange(6.0)) for x in (simulator, target))
    return World(simulator, target, log, policy, other, behavior, horizon)


@cache
def world(name):
    if name == "pairs":
        return drawn(3, discount=0.9, horizon=None, form=2)
    if name == "transitions":
        return drawn(4, discount=0.5, horizon=None, form=3)
    if name == "steps":
        return drawn(5, discount=1.0, horizon=7, form=3)
    if name == "sampled":
        rng = np.random.default_rng(6)
        noisy = drawn(6, discount=0.9, horizon=None, form=2)
        source = oee.sample_transitions(noisy.target, noisy.shares, 60, seed=2)
        columns = dict(source.columns())
        columns["reward"] = columns["reward"] + rng.random(60).round(2)
        source = Transitions(**columns)
        made = sampled_simulator(source)
        return SampledWorld(
            made,
            made,
            noisy.log,
            noisy.policy,
            noisy.other,
            noisy.behavior,
            None,
            source=source,
        )
    pair = oee.testing.case("ragged")
    log = pair.log(60, seed=0)
    return World(
        pair.simulator,
        pair.target,
        log,
        pair.policy,
        pair.behavior,
        pair.behavior,
        pair.horizon,
    )


@dataclass(frozen=True, eq=False)
class SampledWorld(World):
    """A world whose simulator is made of samples, and lacks some transitions."""

    source: Transitions | None = None

    def times(self, unit):
        columns = dict(self.source.columns())
        columns["reward"] = columns["reward"] * unit
        source = Transitions(**columns)
        return replace(
            super().times(unit),
            source=source,
            simulator=sampled_simulator(source),
        )

    @cached_property
    def problem(self):
        return oee.Problem(
            self.simulator, self.log, horizon=self.horizon, impossible="drop"
        )


def sampled_simulator(source):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return oee.FiniteMDP.from_log(
            source, discount=0.9, n_states=6, n_actions=2, initial=[1 / 6] * 6
        )


WORLDS = ["pairs", "transitions", "steps", "ragged", "sampled"]


def moments(found):
    return {
        1: [found.mean, found.standard_deviation, found.bias],
        2: [found.variance, found.by_state, found.by_step],
    }


def ends(found):
    facts = dict(found.diagnostics)
    return {
        1: [found.lower, found.upper, *(found.sampling or [])],
        0: [found.status, facts.get("unrecorded_share")],
    }


def exact_values(w):
    m, pi, t = w.simulator, w.policy, w.horizon
    solved = exact.evaluate_policy(m, pi, horizon=t)
    return {
        1: [
            oee.policy_value(m, pi, horizon=t),
            oee.state_values(m, pi, horizon=t),
            oee.action_values(m, pi, horizon=t),
            solved.values,
            solved.error_bound,
            exact.policy_values_by_horizon(m, pi, horizon=5),
            exact.transition_gradient(m, pi, horizon=t),
            exact.transition_gradient(m, pi, horizon=t, values_of=w.target),
            oee.policy_value(exact.reweight(m, w.ratio), pi, horizon=t),
        ],
        0: [
            oee.occupancy(m, pi, horizon=t),
            oee.optimal_policy(m, horizon=t),
            exact.weight_growth(m, w.ratio, pi),
            *exact.weight_moments(m, w.ratio, pi, horizon=5),
        ],
    }


def exact_bounds(w):
    t = w.horizon
    found = {
        2: [
            oee.efficiency_bound(w.target, w.policy, w.shares, horizon=t),
            exact.ratio_of_ratios_variance(
                w.simulator, w.target, w.policy, w.shares, w.shares, horizon=t
            ),
            exact.ratio_of_ratios_variance(
                w.simulator,
                w.target,
                w.policy,
                w.shares,
                w.shares,
                horizon=t,
                rows="normalised",
            ),
            *(
                oee.trajectory_efficiency_bound(
                    w.target,
                    oee.uniform_policy(w.target),
                    w.policy,
                    horizon=w.steps,
                    model=model,
                )
                for model in ("mdp", "tree", "stationary")
            ),
        ]
    }
    if t is None:
        found[1] = [exact.leading_bias(w.target, w.policy, w.shares)]
    return found


def exact_moments(**options):
    def found(w):
        return moments(
            oee.weighted_return_moments(
                w.simulator, w.ratio, w.policy, horizon=w.steps, sources=True, **options
            )
        )

    return found


def moments_of_returns(w):
    a = moments(oee.return_moments(w.simulator, w.policy, horizon=w.steps))
    b = moments(
        oee.policy_is_moments(
            w.simulator, oee.uniform_policy(w.simulator), w.policy, horizon=w.steps
        )
    )
    c = moments(
        oee.doubly_robust_moments(w.simulator, w.ratio, w.policy, horizon=w.steps)
    )
    return {k: [*a[k], *b[k], *c[k]] for k in a}


def ratios(w):
    found = [
        oee.transition_ratio(w.log, w.simulator, values_of=w.policy),
        oee.transition_ratio(w.log, w.simulator, values_of=[w.policy, w.other]),
        oee.transition_ratio(w.log, w.simulator, method="joint", seed=0),
    ]
    return {0: [zeta.values.data for zeta in found]}


def intervals(method, **options):
    def found(w):
        return ends(oee.interval(w.problem, w.policy, method=method, **options))

    return found


def intervals_under(form):
    """The intervals of models whose rows share parameters."""

    def found(w):
        matrix = w.simulator.transitions
        places = np.arange(6.0) if w.simulator.layout is None else w.simulator.layout
        keys = np.ravel(places).astype(int)[matrix.indices] % 3
        given = {"tie": keys} if form == "tie" else {"features": keys.astype(float)}
        return ends(oee.interval(w.problem, w.policy, **given))

    return found


def best_of_the_log(w):
    """A report on the policy that the log's own model likes best."""
    model = oee.transition_ratio(w.log, w.simulator, prior="simulator").target_model(
        w.simulator
    )
    best = oee.optimal_policy(model) if w.simulator.discount < 1.0 else w.policy
    report = oee.evaluate(w.problem, {"best": best, "a": w.policy}, quick=True, seed=0)
    return {
        0: [len(report.warnings), kinds_of(report)],
        1: [report.table.value.to_numpy(float)],
    }


def robust_policies(w):
    made = oee.robust_policy(w.simulator, 0.5, 2.0, horizon=w.horizon)
    return {0: [made.policy], 1: [made.value]}


def range_of_values(lower, upper):
    def found(w):
        return ends(
            oee.value_range(w.simulator, w.policy, lower, upper, horizon=w.horizon)
        )

    return found


def comparisons(**options):
    def found(w):
        two = {"a": w.policy, "b": w.other, "c": w.behavior}
        made = inference.compare_policies(w.problem, two, **options)
        values = dict(zip(made.names, made.values, strict=True))
        decision = made.decide(values, {})
        return {
            0: [
                made.names,
                made.probability_best,
                decision.candidates,
                decision.are_equal,
            ],
            1: [
                made.values,
                made.standard_errors,
                made.lower,
                made.upper,
                decision.margin or (),
            ],
            2: [made.covariance],
        }

    return found


def kinds_of(report):
    return [
        [finding.kind for finding in result.estimate.findings]
        for result in report.results
    ]


def of_estimate(estimate):
    facts = dict(estimate.diagnostics)
    kept = [
        "one_step_value",
        "one_step_standard_error",
        "maximum_likelihood_value",
        "standard_error_if_centre_fits",
        "model_value",
        "simulator_value",
    ]
    same = ["moved", "one_step_distance", "coverage", "effective_sample_size"]
    return {
        1: [
            estimate.value,
            estimate.standard_error,
            estimate.interval,
            estimate.model_value,
            *(facts.get(key) for key in kept),
        ],
        0: [
            estimate.status,
            [finding.kind for finding in estimate.findings],
            *(facts.get(key) for key in same),
        ],
    }


def estimates(make, **options):
    def found(w):
        problem = w.problem
        if options:
            problem = oee.Problem(
                w.simulator,
                w.log,
                horizon=w.horizon,
                behavior_policy=w.behavior,
                **options,
            )
        return of_estimate(make(w)(problem, w.policy, seed=3))

    return found


def limits(make):
    def found(w):
        return {
            1: [
                make(w).limit(
                    w.simulator,
                    w.target,
                    w.policy,
                    behavior_policy=oee.uniform_policy(w.simulator),
                    horizon=w.horizon,
                )
            ]
        }

    return found


ESTIMATORS = {
    "Simulator": lambda w: estimators.Simulator(),
    "Oracle, rollouts": lambda w: estimators.Oracle(w.target, evaluation="monte_carlo"),
    "Oracle": lambda w: estimators.Oracle(w.target),
    "OffEnvironment": lambda w: estimators.OffEnvironment(),
    "OffEnvironment, rollouts": lambda w: estimators.OffEnvironment(
        evaluation="monte_carlo"
    ),
    "OffEnvironment, whole": lambda w: estimators.OffEnvironment(
        evaluation="monte_carlo", weighting="trajectory", self_normalized=True
    ),
    "OffEnvironment, ratio of ratios": lambda w: estimators.OffEnvironment(
        "ratio_of_ratios"
    ),
    "ModelBased": lambda w: estimators.ModelBased(),
    "ModelBased, simulator": lambda w: estimators.ModelBased(fallback="simulator"),
    "DoublyRobust": lambda w: estimators.DoublyRobust(),
    "DoublyRobust, beta": lambda w: estimators.DoublyRobust(weights="beta"),
    "DoublyRobust, rollouts": lambda w: estimators.DoublyRobust(data="rollouts"),
    "DoublyRobust, episodes": lambda w: estimators.DoublyRobust(data="episodes"),
    "DoublyRobust, normalised": lambda w: estimators.DoublyRobust(
        data="episodes", self_normalized=True
    ),
    "Magic": lambda w: estimators.Magic(),
    "Marginalized": lambda w: estimators.Marginalized(),
    "DualDice": lambda w: estimators.DualDice(),
    "ImportanceSampling": lambda w: estimators.ImportanceSampling(),
    "ImportanceSampling, whole": lambda w: estimators.ImportanceSampling(
        kind="trajectory", self_normalized=True
    ),
    "ImportanceSampling, zero": lambda w: estimators.ImportanceSampling(
        self_normalized=True, ragged="zero"
    ),
}


def reports(**options):
    def found(w):
        report = oee.evaluate(
            w.problem,
            {"a": w.policy, "b": w.other},
            estimators=["simulator", "oee", "model-based"],
            seed=0,
            target=w.target,
            **options,
        )
        table = report.table
        decision = report.uncertainty.decision
        columns = ["value", "lower", "upper", "standard_error", "error"]
        return {
            1: [table[c].to_numpy(float) for c in columns if c in table],
            0: [
                table.policy.tolist(),
                report.best,
                len(report.warnings),
                None if decision is None else list(decision.candidates),
                kinds_of(report),
                report.uncertainty.distance,
            ],
        }

    return found


def plans(**options):
    def found(w):
        plan = oee.plan_data_collection(
            w.problem, {"a": w.policy, "b": w.other}, n=50, **options
        )
        return {0: [plan.counts, plan.unrecorded]}

    return found


def theorems(w):
    model = oee.transition_ratio(w.log, w.simulator).target_model(w.simulator)
    t = w.horizon
    lemma = theory.simulation_lemma(w.target, model, w.policy, horizon=t)
    sides = [
        theory.unnormalised_sides(w.target, model, w.policy, horizon=t),
        theory.normalised_sides(w.target, model, w.policy, horizon=t),
        theory.kl_path_sides(w.target, model, w.policy, horizon=t),
    ]
    largest = 3.0 * w.unit
    return {
        1: [
            *vars(lemma).values(),
            *(x for side in sides for x in (side.left, side.right)),
            theory.unnormalised_bound(0.3, largest, 0.5, horizon=5),
            theory.normalised_bound(0.3, largest, 0.5, horizon=5),
        ],
        0: [theory.path_kl(w.target, model, w.policy, horizon=5)],
        2: [theory.value_error_bound(5, largest, 0.9, error=0.3, nu=0.5)],
    }


FUNCTIONS = {
    "exact values": exact_values,
    "exact bounds": exact_bounds,
    "moments": exact_moments(),
    "moments of trajectories": exact_moments(kind="trajectory"),
    "moments, normalised": exact_moments(self_normalized=True),
    "moments of trajectories, normalised": exact_moments(
        kind="trajectory", self_normalized=True
    ),
    "moments of returns": moments_of_returns,
    "ratios": ratios,
    "likelihood": intervals("likelihood"),
    "likelihood in a box": intervals("likelihood", lower_ratio=0.2, upper_ratio=5.0),
    "delta": intervals("delta"),
    "bootstrap": intervals("bootstrap", seed=1, n_bootstrap=40),
    "bootstrap of episodes": intervals(
        "bootstrap", seed=1, n_bootstrap=40, resample="episodes"
    ),
    "robust": intervals("robust"),
    "robust in a box": intervals("robust", lower_ratio=0.1, upper_ratio=9.0),
    "likelihood under a tie": intervals_under("tie"),
    "likelihood under features": intervals_under("features"),
    "robust policy": robust_policies,
    "range": range_of_values(0.5, 2.0),
    "range without a lower bound": range_of_values(None, 3.0),
    "range without an upper bound": range_of_values(0.25, None),
    "comparison": comparisons(),
    "comparison in a box": comparisons(lower_ratio=0.5, upper_ratio=2.0),
    "comparison by resamples": comparisons(method="bootstrap", n_bootstrap=30),
    **{name: estimates(make) for name, make in ESTIMATORS.items()},
    **{
        f"{name}, the log's rewards": estimates(make, rewards="log")
        for name, make in ESTIMATORS.items()
    },
    **{f"limit of {name}": limits(make) for name, make in ESTIMATORS.items()},
    "report": reports(),
    "report on a policy of the log": best_of_the_log,
    "report, guaranteed": reports(guaranteed=True),
    "report in a box": reports(lower_ratio=0.1, upper_ratio=9.0),
    "plan": plans(),
    "theorems": theorems,
}


def answer(function, given):
    """What a function says, or the error that it raises."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return function(given)
    except ValueError as error:
        return {0: [f"{type(error).__name__}: {error}"]}


@cache
def plain_answer(name, where):
    return answer(FUNCTIONS[name], world(where))


def flat(items):
    """Numbers and texts of nested lists and arrays, one after the other."""
    for item in items:
        if item is None or isinstance(item, str | bool | np.bool_):
            yield item
        elif hasattr(item, "toarray"):
            yield from flat(item.data.tolist())
        elif isinstance(item, list | tuple | np.ndarray):
            yield from flat(list(item))
        else:
            yield float(item)


def distance(name, where, unit):
    """The largest relative difference, and where."""
    plain = plain_answer(name, where)
    found = answer(FUNCTIONS[name], world(where).times(unit))
    assert plain.keys() == found.keys(), (plain, found)
    worst = 0.0, ""
    for degree in plain:
        ours, theirs = (list(flat(x[degree])) for x in (plain, found))
        assert len(ours) == len(theirs)
        size = max([abs(x) for x in ours if isinstance(x, float)], default=1.0) or 1.0
        for k, (x, y) in enumerate(zip(ours, theirs, strict=True)):
            if not isinstance(x, float):
                assert x == y, (degree, k, x, y)
                continue
            y = y / unit**degree
            if np.isnan(x) or np.isinf(x):
                assert x == y or (np.isnan(x) and np.isnan(y)), (degree, k, x, y)
                continue
            off = abs(x - y) / size
            worst = max(
                worst, (off if off == off else np.inf, f"{degree}[{k}] {x} {y}")
            )
    return worst


@pytest.mark.parametrize("where", WORLDS)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_powers_of_two_change_no_digit(name, where):
    for unit in POWERS:
        off, what = distance(name, where, unit)
        assert off <= 1e-13, (unit, off, what)


@pytest.mark.parametrize("where", WORLDS)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_unit_of_rewards_does_not_matter(name, where):
    for unit in ODD:
        off, what = distance(name, where, unit)
        assert off <= 1e-9, (unit, off, what)


@pytest.mark.parametrize("unit", [1e-100, 1e-9, 1.0, 1e130])
def test_rewards_that_differ_contradict_in_any_unit(unit):
    """By a millionth of the largest they agree, by more they do not."""
    coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, np.array([0.0, 1.0]) * unit, [1, 0], 0.9)

    def conflict(rewards):
        log = Transitions([0, 1], [0, 0], [1, 0], np.array(rewards) * unit)
        return oee.Problem(coin, log).reward_conflict

    assert conflict([0.0, 1.0]) is None
    assert conflict([1e-8, 1.0 + 1e-8]) is None
    assert conflict([0.0, 1.01]).rows == 1
    assert conflict([0.01, 1.01]).rows == 2


@pytest.mark.parametrize("unit", [1e-100, 1e-9, 1.0, 1e130])
def test_theorems_need_the_target_s_rewards_in_any_unit(unit):
    coin, other = (
        oee.FiniteMDP([[[0.5, 0.5]]] * 2, np.array([0.0, r]) * unit, [1, 0], 0.9)
        for r in (1.0, 1.01)
    )
    assert theory.normalised_sides(coin, coin, [[1.0]] * 2).holds
    with pytest.raises(ValueError, match="must be the target's"):
        theory.normalised_sides(coin, other, [[1.0]] * 2)


@pytest.mark.parametrize("unit", [1e-100, 1e-9, 1.0, 1e130])
def test_a_policy_that_the_log_chose_is_told_in_any_unit(unit):
    family = oee.bench.families()["garnet_dirichlet10"]
    simulator = family.simulator.with_rewards(family.simulator.rewards * unit)
    runs = oee.mix(oee.optimal_policy(simulator), oee.uniform_policy(simulator), 0.5)
    share = oee.occupancy(family.target, runs)
    log = oee.sample_transitions(family.target, share, 10 * share.size, seed=1)
    problem = oee.Problem(simulator, replace(log, reward=None))
    fitted = oee.transition_ratio(problem.log, simulator, values_of=runs)
    policies = {
        "log's": oee.optimal_policy(fitted.maximum_likelihood_model(simulator)),
        "simulator's": oee.optimal_policy(simulator),
    }
    report = oee.evaluate(problem, policies, quick=True, seed=0)
    chosen = {
        (result.policy, finding.kind)
        for result in report.results
        for finding in result.estimate.findings
        if finding.kind == "selected"
    }
    assert {policy for policy, _ in chosen} == {"log's"}


# ---- rewards r + b, and other numbers of the states and actions

SHIFTED = ["pairs", "transitions", "steps"]  # an end without reward would get one


def shifted_estimate(make):
    def found(w):
        estimate = make(w)(w.problem, w.policy, seed=3)
        return [estimate.value, *(estimate.interval or ())], [
            estimate.standard_error or 0.0
        ]

    return found


def shifted_interval(**options):
    def found(w):
        made = oee.interval(w.problem, w.policy, **options)
        return [made.lower, made.upper], [made.width]

    return found


def shifted_comparison(w):
    made = inference.compare_policies(w.problem, {"a": w.policy, "b": w.other})
    return made.values, [
        made.standard_errors,
        made.lower,
        made.upper,
        made.probability_best,
    ]


def shifted_robust_policy(w):
    made = oee.robust_policy(w.simulator, 0.5, 2.0, horizon=w.horizon)
    return [made.value], [made.policy]


def shifted_range(w):
    made = oee.value_range(w.simulator, w.policy, 0.5, 2.0, horizon=w.horizon)
    return [made.lower, made.upper], [made.width]


# what moves with the rewards, and what does not
LEVELS_AND_SPREADS = {
    "values": lambda w: (
        [oee.policy_value(w.simulator, w.policy, horizon=w.horizon)],
        [
            oee.efficiency_bound(w.target, w.policy, w.shares, horizon=w.horizon),
            oee.occupancy(w.target, w.policy, horizon=w.horizon),
        ],
    ),
    "moments": lambda w: (
        [oee.return_moments(w.simulator, w.policy, horizon=7).mean],
        [oee.return_moments(w.simulator, w.policy, horizon=7).variance],
    ),
    "likelihood": shifted_interval(),
    "likelihood in a box": shifted_interval(lower_ratio=0.1, upper_ratio=9.0),
    "delta": shifted_interval(method="delta"),
    "robust": shifted_interval(method="robust"),
    "bootstrap": shifted_interval(method="bootstrap", seed=1, n_bootstrap=30),
    "robust policy": shifted_robust_policy,
    "range": shifted_range,
    "comparison": shifted_comparison,
    **{
        name: shifted_estimate(ESTIMATORS[name])
        for name in (
            "Simulator",
            "Oracle",
            "OffEnvironment",
            "ModelBased, simulator",
            "DoublyRobust",
            "DoublyRobust, beta",
        )
    },
}


@pytest.mark.parametrize("where", SHIFTED)
@pytest.mark.parametrize("name", LEVELS_AND_SPREADS)
def test_a_reward_that_is_added_to_all_moves_values_alone(name, where):
    plain = world(where)
    gamma = plain.simulator.discount
    steps = 7 if name == "moments" else plain.horizon
    count = (
        1.0 / (1.0 - gamma) if steps is None else sum(gamma**t for t in range(steps))
    )
    levels, spreads = (list(flat(x)) for x in LEVELS_AND_SPREADS[name](plain))
    size = max(map(abs, levels))
    for shift in (-2.5, 40.0):
        moved, kept = (
            list(flat(x)) for x in LEVELS_AND_SPREADS[name](plain.plus(shift))
        )
        expected = np.array(levels) + shift * count
        assert_allclose(moved, expected, rtol=0, atol=2e-6 * (size + 40.0))
        assert_allclose(kept, spreads, rtol=2e-5, atol=1e-7 * size)


# what numbers every state or action, or draws, has other digits
UNNUMBERED = [
    *(name for name in FUNCTIONS if name.startswith(("moments", "range", "robust"))),
    *(name for name in FUNCTIONS if name.startswith(("limit", "likelihood"))),
    "exact bounds",
    "delta",
    *(x for x in ESTIMATORS if "rollouts" not in x and "ratio of" not in x),
    "theorems",
]
UNNUMBERED = [name for name in UNNUMBERED if "whole" not in name or "limit" in name]


@pytest.mark.parametrize("where", ["pairs", "transitions", "steps"])
@pytest.mark.parametrize("name", UNNUMBERED)
def test_the_numbers_of_states_and_actions_do_not_matter(name, where):
    plain = plain_answer(name, where)
    found = answer(FUNCTIONS[name], world(where).renamed(1))
    for degree in (1, 2):
        ours, theirs = (
            [x for x in flat(x.get(degree, [])) if isinstance(x, float)]
            for x in (plain, found)
        )
        assert len(ours) == len(theirs)
        size = max((abs(x) for x in ours if np.isfinite(x)), default=1.0)
        # by state, in any order
        if "moments" in name:
            ours, theirs = sorted(ours), sorted(theirs)
        assert_allclose(theirs, ours, rtol=0, atol=2e-6 * size)
