"""Laws about an estimator's values.

The first five compare the mean over independent logs with a number that is known exactly: the estimator's own limit, or J in
the target. The other five compare two estimates of which one determines the other: renamed states, other units of reward,
rows without information.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from oee_tabular._checks import Array
from oee_tabular.data import Transitions
from oee_tabular.testing.cases import Case, padded_log, relabelled_log
from oee_tabular.testing.subject import Broken, NotClaimed, Raises, Refused, Subject, on_cases, shorten

SMALL, LARGE = 300, 4800  # episodes
ROLLOUTS = {SMALL: 100, LARGE: 1000}  # of an estimator that has such a field, at least
FAILURE_CHANCE = 1e-5  # of a right estimator in one comparison, two-sided
FEW, MANY = 3, 400  # episodes of a log, and logs, for unbiasedness
N_ERRORS = 4.0  # standard errors that a mean may be off
EPISODES, FEW_EPISODES = 300, 40  # of the logs of laws that compare two estimates
SCALE, SHIFT = -2.5, 3.0
SEEDS = 16


@on_cases("ragged", "ragged infinite", "moves", "partial")
def limit(subject: Subject, pair: Case) -> str:
    """Its values tend to ``estimator.limit``, also where the log never shows some (s, a) that the policy takes."""
    try:
        goal = subject.limit(pair, **_data(pair))
    except Refused as refused:
        if not pair.name.startswith("partial"):
            raise
        return f"refused ({shorten(refused.text, 60)})"
    if goal is None:
        raise NotClaimed("it has no limit of its own")
    return _tends_to(subject, pair, goal, "its limit")


@on_cases("ragged", "ragged infinite", "moves")
def consistent(subject: Subject, pair: Case) -> str:
    """Its values tend to J_target under full support; so does its own limit, where it has one."""
    return _tends_to_truth(subject, pair)


@on_cases("same ragged")
def identical(subject: Subject, pair: Case) -> str:
    """Where the target is the simulator (zeta = 1) its values tend to J of both, and its limit is J."""
    return _tends_to_truth(subject, pair)


@on_cases("survival")
def ragged(subject: Subject, pair: Case) -> str:
    """A chain with reward 1 until it ends: ended episodes count with reward 0, they are not left out."""
    return _tends_to_truth(subject, pair)


@on_cases("ragged", "moves")
def unbiased(subject: Subject, pair: Case) -> str:
    """The mean over many logs of few episodes is J_target within 4 standard errors."""
    logs = pair.logs(FEW, MANY, seed=subject.log_seed(pair.name, FEW))
    values: Array = np.array([subject.value(pair, log, seed=k) for k, log in enumerate(logs)])
    mean, error = float(values.mean()), float(values.std(ddof=1) / np.sqrt(MANY))
    distance = abs(mean - pair.truth)
    numbers = f"mean {mean:.5g} of {MANY} logs of {FEW} episodes, J_target {pair.truth:.5g}"
    allowed = N_ERRORS * error + 1e-9 * max(1.0, abs(pair.truth))
    if distance <= allowed:
        return f"{numbers}, tolerance {allowed:.2g}"
    does_vary = error > 1e-12 * abs(mean)
    off_by = f"{distance / error:.1f} standard errors" if does_vary else f"{distance:.3g}, and does not vary"
    raise Broken(f"{numbers}: off by {off_by}", f"mean over seeds of the value on pair.problem({FEW}, seed=seed)")


@on_cases("ragged", "ragged infinite", "moves")
def relabelling(subject: Subject, pair: Case) -> str:
    """Names of states and actions do not matter, places (``layout``) kept: exactly, or in the mean over seeds that matter."""
    states = np.roll(np.arange(pair.simulator.n_states), 1)
    actions = np.arange(pair.simulator.n_actions)[::-1].copy()
    log = pair.log(EPISODES, seed=subject.log_seed("relabelling", pair.name))
    runs = ((pair, log), (pair.relabelled(states, actions), relabelled_log(log, states, actions)))
    before, after = (subject.value(*run) for run in runs)
    permutations = f"{states.tolist()}, {actions.tolist()}"
    example = f"pair.relabelled({permutations}) and relabelled_log(log, {permutations})"
    try:
        return _equals(after, before, before, "value after renaming", example)
    except Broken:
        first, second = (
            np.array([subject.value(*run, seed=seed, rollouts=1000) for seed in range(SEEDS)]) for run in runs
        )
        if np.ptp(first) == 0.0 and np.ptp(second) == 0.0:  # the seed does not matter
            raise
        return _have_same_mean(first, second, "before and after renaming", example)


@on_cases("ragged", "ragged infinite", "moves")
def scale(subject: Subject, pair: Case) -> str:
    """Rewards a r, in the log and in the simulator, give a J."""
    return _compare_rewards(subject, pair, EPISODES, SCALE, 0.0)


@on_cases("moves", "moves infinite")
def shift(subject: Subject, pair: Case) -> str:
    """Rewards r + b give J + b sum_t gamma^t, also where some (s, a) were never recorded.

    Nothing ends in these cases, because an absorbing state would have reward b, too.
    """
    behavior = pair.behavior.copy()
    behavior[-1] = [1.0, 0.0]
    return _compare_rewards(subject, replace(pair, behavior=behavior), FEW_EPISODES, 1.0, SHIFT)


@on_cases("ragged", "ragged infinite")
def padding(subject: Subject, pair: Case) -> str:
    """Rows in the absorbing state after the end (the one action that policy and behaviour take there) change nothing."""
    return _compare_padding(subject, pair, (0, 0, 0), 1.0)


@on_cases("ragged", "ragged infinite")
def after_end(subject: Subject, pair: Case) -> str:
    """Rows in the absorbing state change nothing, also where policy and behaviour take other actions there."""
    policy, behavior = pair.policy.copy(), pair.behavior.copy()
    policy[-1], behavior[-1] = [0.9, 0.1], [0.5, 0.5]
    return _compare_padding(subject, replace(pair, policy=policy, behavior=behavior), (0, 1, 0), 0.5)


# ---- does the mean of an estimator's values tend to a number? ----------------------------------------------------------


def _tends_to_truth(subject: Subject, pair: Case) -> str:
    for data in ({}, _data(pair)):
        own = subject.limit(pair, **data)
        if own is not None:
            example = f"estimator.limit(pair.simulator, pair.target, pair.policy, horizon={pair.horizon})"
            _equals(own, pair.truth, own, "its limit is not J_target", example)
    return _tends_to(subject, pair, pair.truth, "J_target")


def _data(pair: Case) -> dict[str, Any]:
    return {"behavior_policy": pair.behavior.copy(), "data_distribution": pair.data_distribution}


def _tends_to(subject: Subject, pair: Case, goal: float, what: str) -> str:
    """A sentence with the numbers, or ``Broken``.

    The mean over the large logs may be off by chance, and by a third of what 16 times as many episodes changed it: a bias of
    order n^-1/2 changes by three times what is left of it, one of order 1/n by 15 times.
    """
    if pair.name not in subject.values:
        small = _draw_values(subject, pair, SMALL, max(subject.repetitions // 2, 2), 0)
        subject.values[pair.name] = small, _draw_values(subject, pair, LARGE, subject.repetitions, 1000)
    small, large = subject.values[pair.name]
    n, mean = len(large), float(large.mean())
    allowed = _chance(float(large.std(ddof=1) / np.sqrt(n)), n) + 1e-9 * max(1.0, abs(goal))
    allowed += abs(float(small.mean()) - mean) / 3.0 if len(small) else 0.0
    numbers = f"mean {mean:.5g} (of {n} logs of {LARGE} episodes), {what} {goal:.5g}"
    if abs(mean - goal) <= allowed:
        return f"{numbers}, tolerance {allowed:.2g}"
    truth = "" if goal == pair.truth else f", J_target {pair.truth:.5g}"
    raise Broken(
        f"{numbers}: off by {abs(mean - goal):.3g}, tolerance {allowed:.2g}{truth}",
        f"estimator(pair.problem({LARGE}, seed=0), pair.policy, seed=0) against {goal:.5g}",
    )


def _draw_values(subject: Subject, pair: Case, n: int, repetitions: int, first_seed: int) -> Array:
    """Values of independent logs of ``n`` episodes; small logs may have none."""
    values = []
    for k, log in enumerate(pair.logs(n, repetitions, seed=subject.log_seed(pair.name, n))):
        try:
            values.append(subject.value(pair, log, seed=first_seed + k, rollouts=ROLLOUTS[n]))
        except Broken as broken:
            if n == LARGE or isinstance(broken, Raises):
                raise
    return np.array(values)


def _chance(error: float, n: int) -> float:
    """How far the mean of ``n`` values may be off by chance."""
    return float(stdtrit(n - 1, 1.0 - FAILURE_CHANCE / 2)) * error


# ---- two estimates -----------------------------------------------------------------------------------------------------


def _equals(value: float, expected: float, before: float, what: str, example: str) -> str:
    """``Broken`` where two numbers differ by more than rounding."""
    distance = abs(value - expected)
    if not distance <= 1e-8 * max(1.0, abs(expected)):
        raise Broken(f"{what}: {value:.10g}, expected {expected:.10g} (off by {distance:.2g})", example)
    return f"{before:.6g} both" if before == expected else f"{before:.6g} to {value:.6g}"


def _have_same_mean(first: Array, second: Array, what: str, example: str) -> str:
    """``Broken`` where the means of two samples of one size differ by more than chance allows."""
    n = len(first)
    allowed = _chance(float(np.sqrt((first.var(ddof=1) + second.var(ddof=1)) / n)), n) + 1e-9
    distance = abs(float(first.mean() - second.mean()))
    numbers = f"{what}: means {first.mean():.5g} and {second.mean():.5g} over {n} seeds"
    if not distance <= allowed:
        raise Broken(f"{numbers}, apart by {distance:.2g}, tolerance {allowed:.2g}", example)
    return f"{numbers}, tolerance {allowed:.2g}"


def _compare_rewards(subject: Subject, pair: Case, n: int, factor: float, added: float) -> str:
    """Rewards factor * r + added give factor * J + added * sum_t gamma^t."""
    log = pair.log(n, seed=subject.log_seed("rewards", pair.name))
    columns, gamma = log.columns(), pair.simulator.discount
    other = Transitions(**(columns | {"reward": factor * columns["reward"] + added}))
    total = 1.0 / (1.0 - gamma) if pair.horizon is None else float(np.sum(gamma ** np.arange(pair.horizon)))
    before = subject.value(pair, log)
    after = subject.value(pair.with_rewards(factor, added), other)
    example = f"pair.with_rewards({factor}, {added}), and the same of log.reward"
    what = f"value of rewards {factor:g} r + {added:g}"
    return _equals(after, factor * before + added * total, before, what, example)


def _compare_padding(subject: Subject, pair: Case, actions: tuple[int, ...], probability: float) -> str:
    log = pair.log(EPISODES, seed=subject.log_seed("padding", pair.name))
    before = subject.value(pair, log)
    after = subject.value(pair, padded_log(log, actions, probability))
    example = f"padded_log(pair.log({EPISODES}, seed=0), {actions}, {probability})"
    return _equals(after, before, before, f"value with {len(actions)} rows after each end", example)
