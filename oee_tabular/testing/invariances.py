"""Laws that compare two runs: renamed states, other units of reward, rows that say nothing, other seeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oee_tabular.data import Transitions
from oee_tabular.testing.calls import Broken, Subject
from oee_tabular.testing.cases import Case, padded_log, relabelled_log
from oee_tabular.testing.laws import exactly, same_mean

EPISODES, FEW_EPISODES = 300, 40
SCALE, SHIFT = -2.5, 3.0
SEEDS = 16


def relabelling(subject: Subject) -> str:
    """Names of states and actions do not matter, places (``layout``) kept: exactly, or in the mean over seeds that matter."""
    found = []
    for k, pair in enumerate([*subject.cases("ragged"), subject.one_case("moves")]):
        log = pair.log(EPISODES, seed=subject.log_seed(11, k))
        states = np.roll(np.arange(pair.simulator.n_states), 1)
        actions = np.arange(pair.simulator.n_actions)[::-1].copy()
        renamed, other = pair.relabelled(states, actions), relabelled_log(log, states, actions)
        where = f"case({pair.name!r}).relabelled({states.tolist()}, {actions.tolist()}) and relabelled_log(log, ...)"
        both = ((pair, log), (renamed, other))
        first, second = (subject.value(a, b, seed=0) for a, b in both)
        try:
            exactly(second, first, f"{pair.name}: value after renaming", where)
            found.append(f"{pair.name}: {first:.6g} both")
        except Broken:
            before, after = (
                np.array([subject.value(a, b, seed=seed, rollouts=1000) for seed in range(SEEDS)]) for a, b in both
            )
            if np.ptp(before) == 0.0 and np.ptp(after) == 0.0:  # the seed does not matter
                raise
            found.append(same_mean(before, after, f"{pair.name}, before and after renaming", where))
    return "; ".join(found)


def scale(subject: Subject) -> str:
    """Rewards a r, in the log and in the simulator, give a J."""
    found = []
    for k, pair in enumerate([*subject.cases("ragged"), subject.one_case("moves")]):
        log = pair.log(EPISODES, seed=subject.log_seed(12, k))
        before, after = _paid_otherwise(subject, pair, log, SCALE, 0.0)
        exactly(after, SCALE * before, f"{pair.name}: value of rewards {SCALE} r", _reward_example(pair, SCALE, 0.0))
        found.append(f"{pair.name}: {before:.6g} to {after:.6g}")
    return "; ".join(found)


def shift(subject: Subject) -> str:
    """Rewards r + b give J + b sum_t gamma^t, also where some (s, a) were never recorded.

    Nothing ends in these cases: an absorbing state would pay too.
    """
    found = []
    for k, whole in enumerate(subject.cases("moves")):
        behavior = whole.behavior.copy()
        behavior[-1] = [1.0, 0.0]
        pair = replace(whole, behavior=behavior)
        log = pair.log(FEW_EPISODES, seed=subject.log_seed(13, k))
        gamma = pair.simulator.discount
        total = 1.0 / (1.0 - gamma) if pair.horizon is None else float(np.sum(gamma ** np.arange(pair.horizon)))
        before, after = _paid_otherwise(subject, pair, log, 1.0, SHIFT)
        expected = before + SHIFT * total
        exactly(after, expected, f"{pair.name}: value of rewards r + {SHIFT}", _reward_example(pair, 1.0, SHIFT))
        found.append(f"{pair.name}: {before:.6g} to {after:.6g}")
    return "; ".join(found)


def padding(subject: Subject) -> str:
    """Rows in the absorbing state after the end (the one action that policy and behaviour take there) change nothing."""
    return "; ".join(_padded(subject, pair, (0, 0, 0), 1.0) for pair in subject.cases("ragged"))


def after_end(subject: Subject) -> str:
    """Rows in the absorbing state change nothing, also where policy and behaviour take other actions there."""
    found = []
    for pair in subject.cases("ragged"):
        policy, behavior = pair.policy.copy(), pair.behavior.copy()
        policy[-1], behavior[-1] = [0.9, 0.1], [0.5, 0.5]
        found.append(_padded(subject, replace(pair, policy=policy, behavior=behavior), (0, 1, 0), 0.5))
    return "; ".join(found)


def seeds(subject: Subject) -> str:
    """Other seeds give the same bits (owed by every estimator that does not claim to be random)."""
    pair = subject.one_case("ragged")
    log = pair.log(EPISODES, seed=subject.log_seed(15))
    values = [subject.value(pair, log, seed=seed) for seed in range(4)]
    if len(set(values)) > 1:
        shown = ", ".join(f"{value:.8g}" for value in values)
        raise Broken(
            f"{pair.name}: seeds 0 to 3 give {shown}, and it does not claim to be random",
            f"case {pair.name!r}",
        )
    return f"{pair.name}: seeds 0 to 3 give {values[0]:.8g} each"


def _paid_otherwise(subject: Subject, pair: Case, log: Transitions, factor: float, added: float) -> tuple[float, float]:
    assert log.reward is not None
    other = Transitions(**(log.columns() | {"reward": factor * log.reward + added}))
    return subject.value(pair, log, seed=0), subject.value(pair.with_rewards(factor, added), other, seed=0)


def _reward_example(pair: Case, factor: float, added: float) -> str:
    return f"case({pair.name!r}).with_rewards({factor}, {added}), and the same of log.reward"


def _padded(subject: Subject, pair: Case, actions: tuple[int, ...], probability: float) -> str:
    log = pair.log(EPISODES, seed=subject.log_seed(14))
    before = subject.value(pair, log, seed=0)
    after = subject.value(pair, padded_log(log, actions, probability), seed=0)
    where = f"padded_log(case({pair.name!r}).log({EPISODES}, seed=0), {actions}, {probability})"
    exactly(after, before, f"{pair.name}: value with {len(actions)} rows after each end", where)
    return f"{pair.name}: {before:.6g} both"
