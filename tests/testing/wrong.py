"""Estimators that are deliberately wrong, each in one way, and a user's that is right."""

import numpy as np
from scipy import sparse

import oee_tabular as oee
from oee_tabular.estimators import ImportanceSampling, ModelBased, Simulator
from oee_tabular.estimators.rollouts import segment_products

ALWAYS = {"consistent", "relabelling", "scale"}


class Sampling:
    """Importance sampling per decision, right; the wrong ones change one of its parts."""

    claims = frozenset({*ALWAYS, "padding"})

    def ratio(self, probability, behavior):
        return probability / behavior

    def weights(self, products):
        return products

    def factors(self, discount, timestep):
        return discount**timestep

    def policy(self, policy):
        return policy

    def keep(self, timestep, horizon):
        return timestep < (np.inf if horizon is None else horizon)

    def __call__(self, problem, policy, *, seed=None):
        log, pi = problem.log, self.policy(policy)
        ratios = self.ratio(pi[log.state, log.action], log.behavior_probability)
        weights = self.weights(segment_products(ratios, log.episode_starts))
        paid = self.factors(problem.simulator.discount, log.timestep) * log.reward * weights
        paid = np.where(self.keep(log.timestep, problem.horizon), paid, 0.0)
        values = np.add.reduceat(paid, log.episode_starts[:-1])
        return oee.Estimate(float(values.mean()), float(values.std() / np.sqrt(len(values))))


class RatioInverted(Sampling):
    def ratio(self, probability, behavior):
        return np.divide(behavior, probability, out=np.zeros_like(behavior), where=probability > 0)


class WeightsSquared(Sampling):
    claims = frozenset({*ALWAYS, "unbiased"})

    def weights(self, products):
        return products**2


class DiscountForgotten(Sampling):
    def factors(self, discount, timestep):
        return np.ones(len(timestep))


class DiscountOneStepLate(Sampling):
    def factors(self, discount, timestep):
        return discount ** (timestep + 1)


class PolicyIgnored(Sampling):
    def policy(self, policy):
        return np.full(policy.shape, 1 / policy.shape[1])


class HorizonIgnored(Sampling):
    def keep(self, timestep, horizon):
        return np.full(len(timestep), True)


class MeanReturnOfTheLog(Sampling):
    claims = frozenset({*ALWAYS, "shift"})

    def ratio(self, probability, behavior):
        return np.ones(len(behavior))


class LogsMeanReward:
    def __call__(self, problem, policy, *, seed=None):
        return oee.Estimate(float(problem.log.reward.mean()))


class FinishedEpisodesDropped:
    claims = frozenset({*ALWAYS, "shift", "padding"})

    def __call__(self, problem, policy, *, seed=None):
        return ImportanceSampling(self_normalized=True, ragged="zero")(problem, policy)


class SimulatorCalledConsistent:
    claims = frozenset(ALWAYS)

    def __call__(self, problem, policy, *, seed=None):
        return Simulator()(problem, policy)


class LogChanged(Sampling):
    claims = frozenset({"scale"})

    def __call__(self, problem, policy, *, seed=None):
        found = super().__call__(problem, policy)
        if problem.log.reward.flags.writeable:
            problem.log.reward[:] -= problem.log.reward.mean()
        return found


class PolicyChanged(Sampling):
    claims = frozenset({"scale"})

    def __call__(self, problem, policy, *, seed=None):
        found = super().__call__(problem, policy)
        policy[0] = policy[0][::-1].copy()
        return found


class ProblemChanged(Sampling):
    claims = frozenset({"scale"})

    def __call__(self, problem, policy, *, seed=None):
        found = super().__call__(problem, policy)
        object.__setattr__(problem, "horizon", 1)
        return found


class NanWithStatusOk(Sampling):
    """Where no weight is positive."""

    def __call__(self, problem, policy, *, seed=None):
        found = super().__call__(problem, policy)
        return oee.Estimate(float("nan")) if problem.horizon == 1 else found


class NegativeError(Sampling):
    def __call__(self, problem, policy, *, seed=None):
        return oee.Estimate(super().__call__(problem, policy).value, -1.0)


class PlainFloat(Sampling):
    def __call__(self, problem, policy, *, seed=None):
        return super().__call__(problem, policy).value


class GlobalRandomState(Sampling):
    claims = frozenset({"random"})

    def __call__(self, problem, policy, *, seed=None):
        return oee.Estimate(super().__call__(problem, policy).value + 1e-3 * np.random.normal())  # noqa: NPY002


class GlobalSeedSet(Sampling):
    """The same seed gives the same bits, and everybody else's random numbers too."""

    claims = frozenset({"random"})

    def __call__(self, problem, policy, *, seed=None):
        np.random.seed(seed)  # noqa: NPY002
        return oee.Estimate(super().__call__(problem, policy).value + 1e-3 * np.random.normal())  # noqa: NPY002


class SeedIgnored(Sampling):
    claims = frozenset({"random"})

    def __call__(self, problem, policy, *, seed=None):
        return oee.Estimate(super().__call__(problem, policy).value + 1e-3 * np.random.default_rng().normal())


class RandomButSilent(Sampling):
    """Uses its seed and does not say so."""

    claims = frozenset()

    def __call__(self, problem, policy, *, seed=None):
        return oee.Estimate(super().__call__(problem, policy).value + 1e-3 * np.random.default_rng(seed).normal())


class StateZeroSpecial:
    """Trusts the log everywhere but in state 0, as if numbers of states meant something."""

    claims = frozenset({"relabelling", "scale"})

    def __call__(self, problem, policy, *, seed=None):
        model = ModelBased("simulator").model(problem)
        rows = model.transitions.toarray().reshape(model.n_states, model.n_actions, -1)
        own = problem.simulator.transitions.toarray().reshape(rows.shape)
        rows[0] = own[0]
        return oee.Estimate(oee.policy_value(model.with_transitions(rows), policy, horizon=problem.horizon))


class RewardsClipped(Sampling):
    claims = frozenset({"scale"})

    def __call__(self, problem, policy, *, seed=None):
        return oee.Estimate(max(super().__call__(problem, policy).value, -5.0))


class ClaimsToBeUnbiased:
    claims = frozenset({"consistent", "unbiased", "shift"})

    def __call__(self, problem, policy, *, seed=None):
        return ImportanceSampling("trajectory", self_normalized=True)(problem, policy)


class ClaimsToShift(Sampling):
    claims = frozenset({"unbiased", "shift"})


class LimitOfAnother(Sampling):
    """Says that it tends to the behaviour policy's value."""

    claims = frozenset()

    def limit(self, simulator, target, policy, *, data_distribution=None, behavior_policy=None, horizon=None):
        even = np.full(policy.shape, 1 / policy.shape[1])
        return oee.policy_value(target, even if behavior_policy is None else behavior_policy, horizon=horizon)


class LimitWithoutSupport:
    """J of the target without the moves that the simulator lacks, and without a word."""

    claims = frozenset({"consistent"})

    def __call__(self, problem, policy, *, seed=None):
        return ModelBased("simulator")(problem, policy)

    def limit(self, simulator, target, policy, **options):
        inside = sparse.csr_array((simulator.transitions.toarray() > 0).astype(float))
        if inside[target.transitions.nonzero()].all():
            return ModelBased("simulator").limit(simulator, target, policy, **options)
        return oee.policy_value(oee.exact.reweight(target, inside), policy, horizon=options["horizon"])


class Raises:
    def __call__(self, problem, policy, *, seed=None):
        raise KeyError("no such key")


class Exits:
    def __call__(self, problem, policy, *, seed=None):
        raise SystemExit(3)


class Wrongly:
    """Attributes and representation raise as well."""

    def __call__(self, problem):
        return None

    def __repr__(self):
        raise RuntimeError("no repr")


TABLE = {
    RatioInverted: {"consistent", "identical"},
    WeightsSquared: {"consistent", "identical", "unbiased"},
    DiscountForgotten: {"consistent", "identical", "ragged"},
    DiscountOneStepLate: {"consistent", "identical", "ragged"},
    PolicyIgnored: {"consistent", "identical"},
    HorizonIgnored: {"consistent"},
    MeanReturnOfTheLog: {"consistent", "identical"},
    LogsMeanReward: {"consistent", "ragged", "identical"},
    FinishedEpisodesDropped: {"consistent", "ragged", "identical", "padding"},
    SimulatorCalledConsistent: {"consistent", "ragged"},
    LogChanged: {"input_unchanged"},
    PolicyChanged: {"input_unchanged"},
    ProblemChanged: {"input_unchanged"},
    NanWithStatusOk: {"well_formed"},
    GlobalRandomState: {"reproducible"},
    GlobalSeedSet: {"reproducible"},
    SeedIgnored: {"reproducible"},
    RandomButSilent: {"seeds"},
    StateZeroSpecial: {"relabelling"},
    RewardsClipped: {"scale"},
    ClaimsToBeUnbiased: {"unbiased"},
    ClaimsToShift: {"shift"},
    LimitOfAnother: {"limit"},
    LimitWithoutSupport: {"support"},
}


class Shrunk:
    """The log's frequencies, shrunk to the simulator's by ``strength`` moves a row."""

    claims = frozenset({"consistent", "relabelling", "scale", "shift"})

    def __init__(self, strength=5.0):
        self.strength = strength

    def __call__(self, problem, policy, *, seed=None):
        simulator, counts = problem.simulator, problem.counts.toarray()
        prior = self.strength * simulator.transitions.toarray()
        rows = (counts + prior) / (counts.sum(axis=1, keepdims=True) + self.strength)
        model = simulator.with_transitions(rows.reshape(simulator.n_states, simulator.n_actions, -1))
        return oee.Estimate(oee.policy_value(model, policy, horizon=problem.horizon))
