"""Laws about where an estimator's values go: its limit, J in the target, the mean over logs; and laws that compare two runs:
renamed states, other units of reward, rows that say nothing, other seeds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from oee_tabular._checks import Array
from oee_tabular.data import Transitions
from oee_tabular.testing.calls import Broken, Raises, Refused, Subject, shorten
from oee_tabular.testing.cases import Case, padded_log, relabelled_log

SMALL, LARGE = 300, 4800  # episodes
ROLLOUTS = {SMALL: 100, LARGE: 1000}  # of an estimator that has such a field, at least
SURE = 1e-5  # chance of a right estimator's failing a comparison, two-sided
FEW, MANY = 3, 400  # episodes of a log, and logs, for unbiasedness
ERRORS = 4.0  # standard errors that a mean may be off


def limit(subject: Subject) -> str:
    """Its values tend to ``estimator.limit``, also where the log never shows some (s, a) that the policy takes."""
    found = []
    for pair in [*subject.cases("ragged"), subject.one_case("moves"), subject.one_case("partial")]:
        try:
            goal = subject.limit(pair, **_data(pair))
        except Refused as refused:
            if not pair.name.startswith("partial"):
                raise
            found.append(f"{pair.name}: refused ({shorten(refused.text, 60)})")
            continue
        assert goal is not None
        found.append(tends_to(subject, pair, goal, "its limit"))
    return "; ".join(found)


def consistent(subject: Subject) -> str:
    """Its values tend to J_target under full support; so does its own limit, where it has one."""
    found = []
    for pair in [*subject.cases("ragged"), subject.one_case("moves")]:
        truth = pair.truth
        for data in ({}, _data(pair)):
            own = subject.limit(pair, **data)
            if own is not None:
                exactly(own, truth, f"{pair.name}: its limit is not J_target", _limit_example(pair))
        found.append(tends_to(subject, pair, truth, "J_target"))
    return "; ".join(found)


def identical(subject: Subject) -> str:
    """Where the target is the simulator (zeta = 1) its values tend to J of both, and its limit is J."""
    pair = subject.one_case("same ragged")
    own = subject.limit(pair, **_data(pair))
    if own is not None:
        exactly(own, pair.truth, f"{pair.name}: its limit is not J", _limit_example(pair))
    return tends_to(subject, pair, pair.truth, "J")


def ragged(subject: Subject) -> str:
    """A chain that pays 1 while it lives: episodes that are over count as paying nothing, they are not left out."""
    pair = subject.one_case("survival")
    return tends_to(subject, pair, pair.truth, "J_target")


def unbiased(subject: Subject) -> str:
    """The mean over many logs of few episodes is J_target within 4 standard errors."""
    found = []
    for pair in (subject.one_case("ragged"), subject.one_case("moves")):
        logs = pair.logs(FEW, MANY, seed=subject.log_seed(sum(pair.name.encode()), FEW))
        values: Array = np.array([subject.value(pair, log, seed=k) for k, log in enumerate(logs)])
        mean, error = float(values.mean()), float(values.std(ddof=1) / np.sqrt(MANY))
        off = abs(mean - pair.truth)
        numbers = (
            f"{pair.name}: mean {mean:.5g} ± {error:.2g} of {MANY} logs of {FEW} episodes, J_target {pair.truth:.5g}"
        )
        if not off <= ERRORS * error + 1e-9 * max(1.0, abs(pair.truth)):
            apart = (
                f"{off / error:.1f} standard errors" if error > 1e-12 * abs(mean) else f"{off:.3g}, and does not vary"
            )
            text = f"{numbers}: off by {apart}"
            raise Broken(
                text,
                f"pair = case({pair.name!r}); mean over seeds of the value on pair.problem({FEW}, seed=seed)",
            )
        found.append(numbers)
    return "; ".join(found)


def _data(pair: Case) -> dict[str, Any]:
    return {"behavior_policy": pair.behavior.copy(), "data_distribution": pair.data_distribution}


def _limit_example(pair: Case) -> str:
    return (
        f"pair = case({pair.name!r}); estimator.limit(pair.simulator, pair.target, pair.policy, horizon={pair.horizon})"
    )


# ---- does the mean of an estimator's values tend to a number? ----------------------------------------------------------


@dataclass(frozen=True)
class Runs:
    """Values of independent logs of ``SMALL`` and of ``LARGE`` episodes (the small ones without those that had no value)."""

    small: Array
    large: Array

    @property
    def mean(self) -> float:
        """Mean over the large logs."""
        return float(self.large.mean())

    @property
    def tolerance(self) -> float:
        """How far the mean may be from its limit: by chance, and by a third of what 16 times as many episodes moved it.

        A bias of order n^-1/2 is moved by three times what is left of it, one of order 1/n by 15 times.
        """
        n = len(self.large)
        chance = float(stdtrit(n - 1, 1.0 - SURE / 2) * self.large.std(ddof=1) / np.sqrt(n))
        moved = abs(float(self.small.mean()) - self.mean) / 3.0 if len(self.small) else 0.0
        return chance + moved


def runs(subject: Subject, pair: Case) -> Runs:
    """The values on a case, worked out once."""
    if pair.name not in subject.memory:
        small, large = [], []
        key = sum(pair.name.encode())
        half = max(subject.repetitions // 2, 2)
        for k, log in enumerate(pair.logs(SMALL, half, seed=subject.log_seed(key, SMALL))):
            try:
                small.append(subject.value(pair, log, seed=k, rollouts=ROLLOUTS[SMALL]))
            except Raises:
                raise
            except Broken:
                pass  # no value
        for k, log in enumerate(pair.logs(LARGE, subject.repetitions, seed=subject.log_seed(key, LARGE))):
            large.append(subject.value(pair, log, seed=1000 + k, rollouts=ROLLOUTS[LARGE]))
        subject.memory[pair.name] = Runs(np.array(small), np.array(large))
    found: object = subject.memory[pair.name]
    assert isinstance(found, Runs)
    return found


def tends_to(subject: Subject, pair: Case, goal: float, what: str) -> str:
    """A sentence with the numbers, or ``Broken``."""
    found = runs(subject, pair)
    allowed = found.tolerance + 1e-9 * max(1.0, abs(goal))
    numbers = f"{pair.name}: mean {found.mean:.5g} (of {len(found.large)} logs of {LARGE} episodes), {what} {goal:.5g}"
    if not abs(found.mean - goal) <= allowed:
        truth = "" if goal == pair.truth else f", J_target {pair.truth:.5g}"
        raise Broken(
            f"{numbers}: off by {abs(found.mean - goal):.3g}, tolerance {allowed:.2g}{truth}",
            f"pair = case({pair.name!r}); estimator(pair.problem({LARGE}, seed=0), pair.policy, seed=0) against {goal:.5g}",
        )
    return f"{numbers}, tolerance {allowed:.2g}"


def exactly(found: float, expected: float, what: str, where: str, *, tolerance: float = 1e-8) -> None:
    """``Broken`` where two numbers differ by more than a relative tolerance."""
    if not abs(found - expected) <= tolerance * max(1.0, abs(expected)):
        raise Broken(f"{what}: {found:.10g}, expected {expected:.10g} (off by {abs(found - expected):.2g})", where)


def same_mean(first: Array, second: Array, what: str, where: str) -> str:
    """``Broken`` where the means of two samples differ by more than chance allows."""
    error = float(np.sqrt(first.var(ddof=1) / len(first) + second.var(ddof=1) / len(second)))
    allowed = float(stdtrit(min(len(first), len(second)) - 1, 1.0 - SURE / 2)) * error + 1e-9
    apart = abs(float(first.mean() - second.mean()))
    numbers = f"{what}: means {first.mean():.5g} and {second.mean():.5g} over {len(first)} seeds"
    if not apart <= allowed:
        raise Broken(f"{numbers}, apart by {apart:.2g}, tolerance {allowed:.2g}", where)
    return f"{numbers}, tolerance {allowed:.2g}"


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
