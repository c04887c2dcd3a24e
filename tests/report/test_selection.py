"""Which policies a report takes for made from the log that they are evaluated on."""

import numpy as np
import pytest
from benchmarks import made_from_log
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings

import oee_tabular as oee
from oee_tabular.report.selection import is_best_in_log

FAMILIES = ("garnet_worse", "garnet_dirichlet10", "machine")


def recorded(family, per_pair, seed, **options):
    """A problem with so many transitions a pair of a half random policy, and it."""
    best = oee.optimal_policy(family.simulator)
    runs = oee.mix(best, oee.uniform_policy(family.simulator), 0.5)
    share = oee.occupancy(family.target, runs)
    log = oee.sample_transitions(family.target, share, per_pair * share.size, seed=seed)
    return oee.Problem(family.simulator, log, **options), runs


def models_of(problem, runs):
    """The log's own model, and the corrected simulator."""
    ratio = oee.transition_ratio(problem.log, problem.simulator, values_of=runs)
    return (
        ratio.maximum_likelihood_model(problem.simulator),
        ratio.target_model(problem.simulator),
    )


def keep_where_rare(model, runs, counts, least):
    """The best policy that keeps the running one in pairs with few records (SPIBB)."""
    is_rare = counts < least
    policy = runs
    for _ in range(50):
        values = np.where(is_rare, -np.inf, oee.action_values(model, policy))
        improved = np.where(is_rare, runs, 0.0)
        best = values.argmax(axis=1)
        rest = np.where(is_rare.all(axis=1), 0.0, 1.0 - improved.sum(axis=1))
        improved[np.arange(len(best)), best] += rest
        if (improved == policy).all():
            break
        policy = improved
    return policy


def counts_of(problem):
    return (
        problem.log.counts(problem.simulator.n_states, problem.simulator.n_actions)
        .sum(axis=1)
        .reshape(problem.simulator.rewards.shape)
    )


@pytest.mark.parametrize("name", FAMILIES)
def test_a_policy_of_the_counts_is_found_and_one_of_the_correction_is_not(name):
    family = oee.bench.families()[name]
    found = []
    for seed, per_pair in enumerate((3, 10, 30, 30)):
        problem, runs = recorded(family, per_pair, seed)
        own, corrected = models_of(problem, runs)
        made = oee.optimal_policy(own)
        found.append(is_best_in_log(problem, made))
        others = [
            oee.optimal_policy(corrected),
            keep_where_rare(corrected, runs, counts_of(problem), 3),
            keep_where_rare(corrected, runs, counts_of(problem), 10),
            oee.optimal_policy(family.simulator),
            oee.uniform_policy(family.simulator),
            runs,
        ]
        assert not any(is_best_in_log(problem, policy) for policy in others)
    assert sum(found) >= 3


@pytest.mark.parametrize("is_given", [True, False])
def test_a_policy_that_is_greedy_where_it_differs_from_the_recording_one(is_given):
    """The recording policy is given, or read from the counts."""
    family = oee.bench.families()["inventory20"]
    found = []
    for seed in range(4):
        problem, runs = recorded(family, 30, seed)
        counts = counts_of(problem)
        keeps = runs
        if is_given:
            problem = oee.Problem(family.simulator, problem.log, behavior_policy=runs)
        else:
            visits = counts.sum(axis=1, keepdims=True)
            keeps = np.where(visits > 0, counts / np.maximum(visits, 1), runs)
        own, _ = models_of(problem, runs)
        made = keep_where_rare(own, keeps, counts, 5)
        is_kept = (made == keeps).all(axis=1)
        # neither the policy that recorded nor the best of the log
        assert not is_kept.all()
        assert is_kept.any() or (made[~is_kept].max(axis=1) < 1).any()
        found.append(is_best_in_log(problem, made))
        # the same states with other actions are nobody's choice
        shifted = np.where(is_kept[:, None], made, np.roll(made, 1, axis=1))
        assert not is_best_in_log(problem, shifted)
    assert sum(found) >= 3


def test_at_discount_1_without_a_horizon_and_with_one():
    """Walks that end, and the first of a number of steps."""
    rng = np.random.default_rng(3)
    rows = rng.dirichlet(np.ones(8), size=(8, 3))
    rows[-1] = np.eye(8)[-1]
    pay = -rng.uniform(0.5, 1.5, size=(8, 3))
    pay[-1] = 0.0
    simulator = oee.FiniteMDP(rows, pay, np.append(np.ones(7) / 7, 0.0), 1.0)
    target = random_mdp(rng, like=simulator)
    share = np.full((8, 3), 1 / 24)
    log = oee.sample_transitions(target, share, 240, seed=0)
    own = oee.transition_ratio(log, simulator).maximum_likelihood_model(simulator)
    for horizon in (None, 12):
        problem = oee.Problem(simulator, log, horizon=horizon)
        made = oee.optimal_policy(own, horizon=horizon)
        best = oee.optimal_policy(simulator, horizon=horizon)
        made, best = (x if x.ndim == 2 else x[0] for x in (made, best))
        assert is_best_in_log(problem, made)
        assert not is_best_in_log(problem, best)
        assert not is_best_in_log(problem, oee.uniform_policy(simulator))
    # with a horizon a policy may never end
    stay = np.full((2, 2, 2), 0.5)
    simulator = oee.FiniteMDP(stay, np.eye(2), 0, 1.0)
    log = oee.Transitions([0, 0, 1, 1], [0, 1, 0, 1], [0, 1, 1, 0])
    problem = oee.Problem(simulator, log, horizon=5)
    assert not is_best_in_log(problem, oee.uniform_policy(simulator))


@given(rngs)
@settings(max_examples=25, deadline=None)
def test_policies_that_are_nobody_s_choice(rng):
    """Without a log that varies, and for random policies of some states."""
    simulator = random_mdp(rng, n_states=6, n_actions=3, discount=0.9, zeros=0.0)
    target = random_mdp(rng, like=simulator)
    runs = random_policy(rng, simulator, zeros=0.0)
    share = oee.occupancy(target, runs)
    log = oee.sample_transitions(target, share, 100, seed=0)
    problem = oee.Problem(simulator, log, behavior_policy=runs)
    assert not is_best_in_log(problem, runs)
    # one state is no evidence
    changed = runs.copy()
    changed[0] = np.eye(3)[rng.integers(3)]
    assert not is_best_in_log(problem, changed)
    # the simulator's own frequencies
    same = oee.Problem(simulator, 1e9 * simulator.transitions)
    assert not is_best_in_log(same, oee.optimal_policy(simulator))


def test_the_study_of_the_note_runs():
    """The small twin of ``python tests/benchmarks/made_from_log.py``."""
    noted, others, held = made_from_log.measure(["garnet_worse", "machine"], 30, 4)
    assert noted >= 0.5
    assert others == 0.0
    assert 0.0 <= held <= 1.0
