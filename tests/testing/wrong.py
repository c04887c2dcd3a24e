"""Estimators that are wrong, each in one way, and a user's that is right.

``TABLE``: name -> (estimator, words that it claims, laws that it breaks).
"""

import numpy as np
from scipy import sparse

import oee_tabular as oee
from oee_tabular.estimators import ImportanceSampling, ModelBased, Simulator
from oee_tabular.estimators.rollouts import segment_products

ALWAYS = "consistent relabelling scale"


def sampling(
    ratio=np.divide,
    power=1,
    factor=lambda discount, timestep: discount**timestep,
    evaluated=lambda policy: policy,
    keep=lambda timestep, horizon: timestep < (np.inf if horizon is None else horizon),
    then=lambda value, problem, policy, seed: value,
):
    """Importance sampling per decision, right unless one of its parts is changed;
    ``then``: what becomes of its value.
    """

    def estimate(problem, policy, seed=None):
        log = problem.log
        pi = evaluated(policy)
        ratios = ratio(pi[log.state, log.action], log.behavior_probability)
        weights = segment_products(ratios, log.episode_starts) ** power
        rewards = (
            factor(problem.simulator.discount, log.timestep) * log.reward * weights
        )
        rewards = np.where(keep(log.timestep, problem.horizon), rewards, 0.0)
        return then(
            np.add.reduceat(rewards, log.episode_starts[:-1]).mean(),
            problem,
            policy,
            seed,
        )

    return estimate


def inverse_ratio(probability, behavior):
    return np.divide(
        behavior, probability, out=np.zeros_like(behavior), where=probability > 0
    )


def even(policy):
    return np.full(policy.shape, 1 / policy.shape[1])


def center_rewards_of_log(value, problem, policy, seed):
    if problem.log.reward.flags.writeable:
        problem.log.reward[:] -= problem.log.reward.mean()
    return value


def reverse_policy(value, problem, policy, seed):
    policy[0] = policy[0][::-1].copy()
    return value


def change_horizon(value, problem, policy, seed):
    object.__setattr__(problem, "horizon", 1)
    return value


def seed_global_state(value, problem, policy, seed):
    """The same seed gives the same bits, and everybody else's random numbers too."""
    np.random.seed(seed)  # noqa: NPY002
    return value + 1e-3 * np.random.normal()  # noqa: NPY002


def trust_state_zero(problem, policy):
    """The log's model everywhere but in state 0, as if numbers of states meant
    something.
    """
    model = ModelBased("simulator").model(problem)
    rows = model.transitions.toarray().reshape(model.n_states, model.n_actions, -1)
    rows[0] = problem.simulator.transitions.toarray().reshape(rows.shape)[0]
    return oee.policy_value(
        model.with_transitions(rows), policy, horizon=problem.horizon
    )


class LimitOfAnother:
    """Says that it tends to the behaviour policy's value."""

    def __call__(self, problem, policy):
        return sampling()(problem, policy)

    def limit(
        self,
        simulator,
        target,
        policy,
        *,
        data_distribution=None,
        behavior_policy=None,
        horizon=None,
    ):
        return oee.policy_value(
            target,
            even(policy) if behavior_policy is None else behavior_policy,
            horizon=horizon,
        )


class LimitWithoutSupport:
    """J of the target without the transitions that the simulator lacks, and without a
    word.
    """

    def __call__(self, problem, policy):
        return ModelBased("simulator")(problem, policy)

    def limit(self, simulator, target, policy, **options):
        inside = sparse.csr_array((simulator.transitions.toarray() > 0).astype(float))
        if inside[target.transitions.nonzero()].all():
            return ModelBased("simulator").limit(simulator, target, policy, **options)
        return oee.policy_value(
            oee.exact.reweight(target, inside), policy, horizon=options["horizon"]
        )


def self_normalized(kind, **options):
    """A plain function of an estimator of the package: without its limit and its
    claims.
    """
    return lambda problem, policy: ImportanceSampling(
        kind, self_normalized=True, **options
    )(problem, policy)


def noisy(make):
    """Right but for a draw of the generator that ``make`` makes of the seed."""
    return sampling(
        then=lambda value, problem, policy, seed: value + 1e-3 * make(seed).normal()
    )


PADDED = f"{ALWAYS} padding"
TABLE = {
    "ratio inverted": (
        sampling(ratio=inverse_ratio),
        PADDED,
        "consistent identical exact",
    ),
    "weights squared": (
        sampling(power=2),
        f"{ALWAYS} unbiased",
        "consistent identical unbiased exact",
    ),
    "discount forgotten": (
        sampling(factor=lambda g, t: g**0 * np.ones(len(t))),
        PADDED,
        "consistent identical ragged exact",
    ),
    "discount one step late": (
        sampling(factor=lambda g, t: g ** (t + 1)),
        PADDED,
        "consistent identical ragged exact",
    ),
    "policy ignored": (sampling(evaluated=even), PADDED, "consistent identical exact"),
    "horizon ignored": (
        sampling(keep=lambda t, horizon: t >= 0),
        PADDED,
        "consistent exact",
    ),
    "mean return of the log": (
        sampling(ratio=lambda p, b: np.ones(len(b))),
        f"{ALWAYS} shift",
        "consistent identical exact",
    ),
    "mean reward of the log": (
        lambda problem, policy: problem.log.reward.mean(),
        ALWAYS,
        "consistent ragged identical exact",
    ),
    "finished episodes dropped": (
        self_normalized("per_decision", ragged="zero"),
        f"{PADDED} shift",
        "consistent ragged identical padding exact",
    ),
    "simulator called consistent": (
        lambda problem, policy: Simulator()(problem, policy),
        ALWAYS,
        "consistent ragged exact",
    ),
    "log changed": (sampling(then=center_rewards_of_log), "scale", "input_unchanged"),
    "policy changed": (sampling(then=reverse_policy), "scale", "input_unchanged"),
    "problem changed": (sampling(then=change_horizon), "scale", "input_unchanged"),
    "nan": (
        sampling(
            then=lambda value, problem, *_: np.nan if problem.horizon == 1 else value
        ),
        PADDED,
        "well_formed",
    ),
    "global random state": (noisy(lambda seed: np.random), "random", "reproducible"),
    "global seed set": (sampling(then=seed_global_state), "random", "reproducible"),
    "seed ignored": (
        noisy(lambda seed: np.random.default_rng()),
        "random",
        "reproducible",
    ),
    "random but silent": (noisy(np.random.default_rng), "", "seeds"),
    "state zero special": (trust_state_zero, "relabelling scale", "relabelling"),
    "rewards clipped": (
        sampling(then=lambda value, *_: max(value, -5.0)),
        "scale",
        "scale",
    ),
    "unbiased": (
        self_normalized("trajectory"),
        "consistent unbiased shift",
        "unbiased",
    ),
    "shift": (sampling(), "unbiased shift", "shift"),
    "limit of another": (LimitOfAnother(), "", "limit exact"),
    "limit without support": (LimitWithoutSupport(), "consistent", "support"),
}


# ---- biases of a few parts in a thousand to a few percent


def likely(
    rows=lambda rows, problem: rows,
    discount=1.0,
    horizon=0,
    start=0.0,
    mixed=0.0,
    then=lambda value: value,
):
    """The log's model, the simulator's in unrecorded pairs: right unless one of its
    parts is changed.
    """

    def estimate(problem, policy):
        model = ModelBased("simulator").model(problem)
        table = model.transitions.toarray()
        model = model.with_transitions(
            rows(table, problem).reshape(model.n_states, model.n_actions, -1)
        ).with_discount(discount * model.discount)
        even_start = np.full(model.n_states, 1 / model.n_states)
        model = model.with_initial((1 - start) * model.initial + start * even_start)
        steps = problem.horizon
        steps = None if steps is None else max(steps + horizon, 1)
        pi = oee.mix(even(policy), policy, mixed)
        return then(oee.policy_value(model, pi, horizon=steps))

    return estimate


def blend(share):
    """So much of the simulator's rows, however long the log is."""
    return lambda rows, problem: (
        (1 - share) * rows + share * problem.simulator.transitions.toarray()
    )


def sticky(rows, problem):
    """A hundredth of each row goes to the state where it is largest."""
    return 0.99 * rows + 0.01 * np.eye(rows.shape[1])[rows.argmax(axis=1)]


def without_last_rewards(share):
    """So much of the reward of a transition that terminates is lost."""
    return sampling(
        factor=lambda g, t: g**t,
        then=lambda value, problem, policy, seed: (
            value - share * terminal_part(problem, policy)
        ),
    )


def terminal_part(problem, policy):
    """What rewards of terminated transitions add to importance sampling's value."""
    log = problem.log
    horizon = np.inf if problem.horizon is None else problem.horizon
    ratios = policy[log.state, log.action] / log.behavior_probability
    weights = segment_products(ratios, log.episode_starts)
    paid = problem.simulator.discount**log.timestep * log.reward * weights
    counted = np.where(log.terminated & (log.timestep < horizon), paid, 0.0)
    return np.add.reduceat(counted, log.episode_starts[:-1]).mean()


# name -> (estimator, its claims): each is off by .2 to 4% in the exact cases
SLIGHTLY = {
    "1% too high": (likely(then=lambda value: 1.01 * value), f"{ALWAYS}"),
    "half a percent too low": (likely(then=lambda value: 0.995 * value), f"{ALWAYS}"),
    "97% likelihood, 3% simulator": (likely(rows=blend(0.03)), f"{ALWAYS} shift"),
    "99% likelihood, 1% simulator": (likely(rows=blend(0.01)), f"{ALWAYS} shift"),
    "discount 1% too small": (likely(discount=0.99), ALWAYS),
    "start mixed with the uniform one": (likely(start=0.05), f"{ALWAYS} shift"),
    "policy mixed with the uniform one": (likely(mixed=0.03), f"{ALWAYS} shift"),
    "rows pulled to their largest entry": (likely(rows=sticky), f"{ALWAYS} shift"),
    "a twenty-fifth of the last rewards lost": (without_last_rewards(0.04), ALWAYS),
    "weights cut off": (
        sampling(ratio=lambda p, b: np.minimum(p / b, 3.1)),
        ALWAYS,
    ),
    "rewards rounded down by .05": (
        likely(then=lambda value: value - 0.05),
        "consistent relabelling",
    ),
    "one episode too many in the mean": (
        sampling(then=lambda value, *_: value * 100 / 101),
        ALWAYS,
    ),
}


class Shrunk:
    """The log's frequencies, shrunk to the simulator's by ``strength`` transitions a
    row; right.
    """

    claims = frozenset({"consistent", "relabelling", "scale", "shift"})

    def __init__(self, strength=5.0):
        self.strength = strength

    def __call__(self, problem, policy, *, seed=None):
        simulator = problem.simulator
        counts = problem.counts.toarray()
        prior = self.strength * simulator.transitions.toarray()
        rows = (counts + prior) / (counts.sum(axis=1, keepdims=True) + self.strength)
        model = simulator.with_transitions(
            rows.reshape(simulator.n_states, simulator.n_actions, -1)
        )
        return oee.Estimate(oee.policy_value(model, policy, horizon=problem.horizon))
