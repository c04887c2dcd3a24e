"""The laws: what every estimator owes, whatever it claims, and laws about its values.

Every estimator owes well-formed answers, no side effects, and no number without
support. Of the laws about values the first five compare the mean over independent logs
with a number that is known exactly: the estimator's own limit, or J in the target. So
does ``exact``, on a log without chance. The other five compare two estimates of which
one determines the other: renamed states, other units of reward, rows without
information.
"""

from __future__ import annotations

import pickle
import random
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.special import stdtrit

from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.functions import RETURNED, as_estimator
from oee_tabular.exact import policy_value
from oee_tabular.testing.cases import Case, odd_cases, padded_log, relabelled_log
from oee_tabular.testing.subject import (
    Broken,
    NotClaimed,
    Raises,
    Refused,
    Subject,
    call,
    on_cases,
    shorten,
    value_of,
)
from oee_tabular.typing import Array, Csr, PolicyLike

# the logs whose estimates show where values tend to: 16 times as many episodes
N_SMALL_LOG_EPISODES = 300
N_LARGE_LOG_EPISODES = 4800
# rollouts at least, of an estimator that has such a field, by the episodes of the log
N_ROLLOUTS = {N_SMALL_LOG_EPISODES: 100, N_LARGE_LOG_EPISODES: 1000}
# the chance that one comparison rejects a right estimator, two-sided
FAILURE_CHANCE = 1e-5
# unbiasedness: episodes of a log, logs, and standard errors that their mean may be off
N_UNBIASED_EPISODES = 3
N_UNBIASED_LOGS = 400
MAX_UNBIASED_ERRORS = 4.0
# laws that compare two estimates: episodes, what rewards are multiplied by, what is
# added to them, and the seeds of an estimator that draws
N_EPISODES = 300
N_FEW_EPISODES = 40
REWARD_FACTOR = -2.5
ADDED_REWARD = 3.0
N_SEEDS = 16
# exact data: transitions of each pair, and how often a second log repeats the first
N_EXACT_TRANSITIONS = 1e9
N_COPIES = 16
# horizons with the steps of the log's episodes
SHORT_HORIZONS = ((1, 1), (1, 2), (2, 2))
# exact data: the seeds of an estimator that draws, and standard errors that the mean
# over them may be off
N_EXACT_SEEDS = 24
MAX_EXACT_ERRORS = 5.0
# episodes of the logs of odd problems, and of those that look at side effects
N_ODD_EPISODES = 20
N_PROTOCOL_EPISODES = 200


def well_formed(subject: Subject) -> str:
    """Check that odd small problems give an answer that says what it is.

    That is a finite value, a status that is not "ok", or a ValueError.
    """
    answers = []
    n_refused = 0
    refusals: dict[str, str] = {}  # reason -> the first problem refused for it
    for pair, log in _odd_problems(subject):
        try:
            with subject.look_at(pair, f", {len(log)} transitions"):
                answers.append(subject.estimate(pair, log, 0))
        except Refused as refusal:
            refusals.setdefault(str(refusal.__cause__), pair.title)
            n_refused += 1
    reasons = "; ".join(
        f"{title} {shorten(text, 160)}" for text, title in refusals.items()
    )
    if not answers:
        raise Raises(f"all {n_refused} problems are refused: {reasons}")
    text = f"{len(answers)} of {len(answers) + n_refused} odd problems answered"
    text += f", {n_refused} refused by a ValueError ({reasons})" if refusals else ""
    if any(RETURNED in estimate.diagnostics for estimate in answers):
        text += "; floats, so that standard errors, intervals and statuses are skipped"
    return text


def _odd_problems(subject: Subject) -> Iterator[tuple[Case, Transitions]]:
    """Yield logs of the odd cases; of others one episode, or no episodes."""
    for k, pair in enumerate(odd_cases()):
        yield pair, subject.draw_log(pair, N_ODD_EPISODES, "odd", k)
    for pair in subject.cases("ragged", "ragged infinite"):
        yield pair, subject.draw_log(pair, 1, "odd", "one episode")
        yield (
            pair,
            pair.log(N_ODD_EPISODES, seed=subject.log_seed("odd", "no episodes")).draw(
                10, seed=0
            ),
        )


@on_cases("ragged", "ragged infinite", "moves")
def input_unchanged(subject: Subject, pair: Case) -> str:
    """Check that problem, log, simulator and policy are left as they were, to the bit.

    Their arrays are made writable.
    """
    log = subject.draw_log(pair, N_PROTOCOL_EPISODES, "input", pair.name)
    subject.seen.log = log
    problem = pair.problem_of(log)
    policy = pair.policy.copy()
    fields = {name: getattr(problem, name) for name in Problem.__dataclass_fields__}
    arrays = dict(_arrays(problem, policy))
    for array in arrays.values():
        array.flags.writeable = True
    before = {name: array.copy() for name, array in arrays.items()}
    try:
        call(subject.estimator(pair), problem, policy, 0)
    finally:  # a changed input is told before an error
        for name, value in fields.items():
            if getattr(problem, name) is not value:
                raise Broken(f"problem.{name} is another object after the call")
        for name, array in arrays.items():
            if not np.array_equal(
                array, before[name], equal_nan=array.dtype.kind == "f"
            ):
                n_changed = int(np.sum(array != before[name]))
                raise Broken(f"{name} is changed in {n_changed} of {array.size} places")
    return f"{len(arrays)} arrays and every field as before"


def _arrays(problem: Problem, policy: PolicyLike) -> Iterator[tuple[str, Any]]:
    """Yield the name and the data of every array that an estimator is given."""
    simulator = problem.simulator
    yield "policy", policy
    yield "problem.behavior_policy", problem.behavior_policy
    yield from (
        (f"log.{name}", column) for name, column in problem.log.columns().items()
    )
    yield from (
        (f"simulator.{name}", getattr(simulator, name))
        for name in ("rewards", "initial", "terminal_state")
    )
    tables = {
        "simulator.transitions": simulator.transitions,
        "problem.counts": problem.counts,
    }
    if simulator.transition_rewards is not None:
        tables["simulator.transition_rewards"] = simulator.transition_rewards
    for name, table in tables.items():
        yield from (
            (f"{name}.{part}", getattr(table, part))
            for part in ("data", "indices", "indptr")
        )


@on_cases("ragged", "ragged infinite")
def reproducible(subject: Subject, pair: Case) -> str:
    """Check that the same seed gives the same bits in any global random state.

    The estimator leaves that state alone.
    """
    log = subject.draw_log(pair, N_PROTOCOL_EPISODES, "reproducible", pair.name)
    subject.seen.log = log
    first, second = (_estimate_in_state(subject, pair, log, state) for state in (1, 2))
    for name in ("value", "standard_error"):
        values = getattr(first, name), getattr(second, name)
        before, after = (np.array(value, dtype=np.float64) for value in values)
        if not np.array_equal(before, after, equal_nan=True):
            text = (
                f"{name} of seed 7 is {values[0]!r}, and when called again"
                f" {values[1]!r}"
            )
            raise Broken(text, "the same problem twice, seed=7")
    return f"seed 7 gives {first.value!r} twice"


def _estimate_in_state(
    subject: Subject, pair: Case, log: Transitions, state: int
) -> Estimate:
    """Return an estimate of seed 7 under a global random state of ours.

    ``Broken`` is raised where the estimator has changed that state.
    """
    estimator = as_estimator(subject.estimator(pair))
    states = []

    def watched(problem: Problem, policy: PolicyLike, seed: int) -> Estimate:
        random.seed(state)
        np.random.seed(state)  # noqa: NPY002 (what is watched over is the global one)
        states.append(pickle.dumps((random.getstate(), np.random.get_state())))  # noqa: NPY002
        answer = estimator(problem, policy, seed=seed)
        states.append(pickle.dumps((random.getstate(), np.random.get_state())))  # noqa: NPY002
        return answer

    estimate = call(watched, pair.problem_of(log), pair.policy.copy(), 7)
    if states[0] != states[1]:
        raise Broken("it changes the global random state (random, numpy.random)")
    return estimate


@on_cases("ragged")
def seeds(subject: Subject, pair: Case) -> str:
    """Check that other seeds give the same bits.

    Every estimator owes that which does not claim to be random.
    """
    if "random" in subject.claims:
        raise NotClaimed("it claims to be random")
    log = subject.draw_log(pair, N_PROTOCOL_EPISODES, "seeds")
    values = [subject.value(pair, log, seed=seed) for seed in range(4)]
    if len(set(values)) > 1:
        shown = ", ".join(f"{value:.8g}" for value in values)
        raise Broken(f"seeds 0 to 3 give {shown}, and 'random' is not among its claims")
    return f"seeds 0 to 3 give {values[0]:.8g} each"


@on_cases("violated")
def support(subject: Subject, pair: Case) -> str:
    """Check that a target outside the simulator's support gets no silent number.

    Where the target has transitions with simulator probability 0, there is a ValueError
    or a status. ``Problem`` refuses a log with such a transition. Looked at are the
    estimator's limit for such a target (J_target itself is right), and an oracle of
    such a target.
    """
    texts = ["Problem refuses the log"]
    try:
        own = subject.limit(pair)
    except Refused as refused:
        texts.append(f"limit: {shorten(refused.text, 60)}")
    else:
        if own is not None and np.isfinite(own) and "consistent" in subject.claims:
            _require_status(Estimate(own), pair)
            texts.append("limit is J_target")
    if subject.is_oracle:
        texts.append(_check_oracle(subject, pair))
    return ", ".join(texts)


def _check_oracle(subject: Subject, pair: Case) -> str:
    """Check an estimator made for the violating pair, on a log without violation."""
    inside = replace(pair, target=pair.simulator)
    log = subject.draw_log(inside, N_PROTOCOL_EPISODES, "support")
    try:
        answer = subject.estimate(pair, log, 0)
    except Refused as refused:
        return f"oracle: {shorten(refused.text, 60)}"
    # else it does not look at the target
    if answer.value != subject.estimate(inside, log, 0).value:
        _require_status(answer, pair)
    return "oracle: no number of its own"


def _require_status(estimate: Estimate, pair: Case) -> None:
    """Raise ``Broken`` where a value other than J_target has the status "ok"."""
    if estimate.status == "ok" and abs(estimate.value - pair.truth) > 1e-8 * max(
        1.0, abs(pair.truth)
    ):
        simulator = policy_value(pair.simulator, pair.policy, horizon=pair.horizon)
        raise Broken(
            f"{estimate.value:.6g} without a word, J_target {pair.truth:.6g},"
            f" J_simulator {simulator:.6g}",
            "s=0 -> s'=2 has probability 0 in the simulator",
        )


# ---- laws about values


@on_cases("ragged", "ragged infinite", "moves", "partial")
def limit(subject: Subject, pair: Case) -> str:
    """Check that values tend to ``estimator.limit``.

    This holds as well where the log lacks some (s, a) that the policy takes.
    """
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
    """Check that values and limit tend to J_target under full support."""
    return _tends_to_truth(subject, pair)


@on_cases("same ragged")
def identical(subject: Subject, pair: Case) -> str:
    """Check that values and limit tend to J where the target is the simulator."""
    return _tends_to_truth(subject, pair)


@on_cases("survival")
def ragged(subject: Subject, pair: Case) -> str:
    """Check that ended episodes count with reward 0, and are not left out.

    The case is a chain with reward 1 until it ends.
    """
    return _tends_to_truth(subject, pair)


@on_cases("ragged", "moves")
def unbiased(subject: Subject, pair: Case) -> str:
    """Check that the mean over many logs is J_target within 4 standard errors.

    Each log has few episodes.
    """
    logs = subject.draw_logs(
        pair, N_UNBIASED_EPISODES, N_UNBIASED_LOGS, pair.name, N_UNBIASED_EPISODES
    )
    values: Array = np.array(
        [subject.value(pair, log, seed=k) for k, log in enumerate(logs)]
    )
    mean = float(values.mean())
    error = float(values.std(ddof=1) / np.sqrt(N_UNBIASED_LOGS))
    distance = abs(mean - pair.truth)
    numbers = (
        f"mean {mean:.5g} of {N_UNBIASED_LOGS} logs of {N_UNBIASED_EPISODES} episodes,"
        f" J_target {pair.truth:.5g}"
    )
    allowed = MAX_UNBIASED_ERRORS * error + 1e-9 * max(1.0, abs(pair.truth))
    if distance <= allowed:
        subject.seen.tolerances.append(allowed / (abs(pair.truth) or 1.0))
        return f"{numbers}, tolerance {allowed:.2g}"
    does_vary = error > 1e-12 * abs(mean)
    off_by = (
        f"{distance / error:.1f} standard errors"
        if does_vary
        else f"{distance:.3g}, and does not vary"
    )
    raise Broken(
        f"{numbers}: off by {off_by}",
        f"mean over seeds of the value on pair.problem({N_UNBIASED_EPISODES}, seed=seed)",
    )


@on_cases("ragged", "ragged infinite", "moves")
def relabelling(subject: Subject, pair: Case) -> str:
    """Check that the numbers of states and actions do not matter.

    States keep their places (``layout``). Values are equal, or equal in the mean over
    seeds where these matter.
    """
    states = np.roll(np.arange(pair.simulator.n_states), 1)
    actions = np.arange(pair.simulator.n_actions)[::-1].copy()
    log = subject.draw_log(pair, N_EPISODES, "relabelling", pair.name)
    permutations = f"{states.tolist()}, {actions.tolist()}"
    renamed = subject.seen.remember(
        relabelled_log(log, states, actions),
        # those that draw the log are the case's own, not the renamed ones
        f"oee.testing.relabelled_log({_of_case(subject, pair, log)}, {permutations})",
    )
    runs = ((pair, log), (pair.relabelled(states, actions), renamed))
    before, after = (subject.value(*run) for run in runs)
    example = f"pair.relabelled({permutations}) and relabelled_log(log, {permutations})"
    try:
        return _equals(subject, after, before, before, "value after renaming", example)
    except Broken:
        first, second = (
            np.array(
                [
                    subject.value(*run, seed=seed, rollouts=1000)
                    for seed in range(N_SEEDS)
                ]
            )
            for run in runs
        )
        if np.ptp(first) == 0.0 and np.ptp(second) == 0.0:  # the seed does not matter
            raise
        return _have_same_mean(
            subject, first, second, "before and after renaming", example
        )


@on_cases("ragged", "ragged infinite", "moves")
def scale(subject: Subject, pair: Case) -> str:
    """Check that rewards a r, in the log and in the simulator, give a J."""
    return _compare_rewards(subject, pair, N_EPISODES, REWARD_FACTOR, 0.0)


@on_cases("moves", "moves infinite")
def shift(subject: Subject, pair: Case) -> str:
    """Check that rewards r + b give J + b sum_t gamma^t.

    This holds as well where some (s, a) were never recorded. Nothing ends in these
    cases, because an absorbing state would have reward b, too.
    """
    behavior = pair.behavior.copy()
    behavior[-1] = [1.0, 0.0]
    return _compare_rewards(
        subject, replace(pair, behavior=behavior), N_FEW_EPISODES, 1.0, ADDED_REWARD
    )


@on_cases("ragged", "ragged infinite")
def padding(subject: Subject, pair: Case) -> str:
    """Check that rows in the absorbing state after the end change nothing.

    They have the one action that policy and behaviour take there.
    """
    return _compare_padding(subject, pair, (0, 0, 0), 1.0)


@on_cases("ragged", "ragged infinite")
def after_end(subject: Subject, pair: Case) -> str:
    """Check the same where policy and behaviour take other actions after the end."""
    policy = pair.policy.copy()
    behavior = pair.behavior.copy()
    policy[-1] = [0.9, 0.1]
    behavior[-1] = [0.5, 0.5]
    return _compare_padding(
        subject, replace(pair, policy=policy, behavior=behavior), (0, 1, 0), 0.5
    )


def _of_case(subject: Subject, pair: Case, log: Transitions) -> str:
    """Return how a log is made anew, with the target and behaviour of a named case."""
    recipe = subject.seen.recipe(log)
    for name in ("target", "behavior"):
        recipe = recipe.replace(f"{name},", f"oee.testing.case({pair.name!r}).{name},")
    return recipe


# ---- exact data


@on_cases("exact", "exact infinite", "exact partial", "exact partial infinite")
def exact(subject: Subject, pair: Case) -> str:
    """Check that the value is exact on a log with every episode as often as probable.

    It is J_target, or the estimator's limit, to the tolerance that the estimator
    declares, or 1e-6 of the value. An estimator that draws may be off by five standard
    errors of its mean over seeds. One with a prior is given 10^9 transitions a pair as
    ``problem.counts``, or 16 times as many episodes: it may be off by a third of what
    they change.
    """
    goal = pair.truth
    what = "J_target"
    if "consistent" not in subject.claims or pair.name.startswith("exact partial"):
        try:
            own = subject.limit(pair, **_data(pair))
        except Refused as refused:
            return f"refused ({shorten(refused.text, 60)})"
        if own is None:
            if "consistent" not in subject.claims:
                raise NotClaimed("it does not claim consistent, and has no limit")
            return "it has no limit"
        goal = own
        what = "its limit"
    try:
        return _is_exact(subject, pair, goal, what)
    except Raises:
        raise
    except Broken as broken:
        # the shortest log in which it is broken is easiest to look at
        for horizon, steps in (
            SHORT_HORIZONS if what == "J_target" and pair.horizon else ()
        ):
            short = replace(pair, horizon=horizon, steps=steps)
            try:
                _is_exact(subject, short, short.truth, what)
            except Broken as shorter:
                raise Broken(
                    f"{broken.text}; already at horizon {horizon}: {shorter.text}",
                    f"pair = dataclasses.replace(pair, horizon={horizon},"
                    f" steps={steps}); {broken.example}",
                ) from shorter
        subject.seen.pair = pair
        raise


def _is_exact(subject: Subject, pair: Case, goal: float, what: str) -> str:
    """Return a sentence with the numbers, or raise ``Broken``."""
    unit = abs(goal) or 1.0
    recipe = (
        f"oee.testing.Case({pair.name!r}, simulator, target, policy, behavior,"
        f" {pair.horizon}, {pair.steps}).exact_log()"
    )
    log = subject.seen.remember(pair.exact_log(), recipe)
    problem = replace(pair.problem_of(log), simulator_data="exact")
    value, chance = _mean_of_seeds(subject, pair, log, problem)
    data = f"{log.n_episodes} episodes, each as frequent as probable"
    allowed = subject.tolerance * unit + chance
    if not abs(value - goal) <= allowed:
        many = None
        with suppress(Broken):
            many = _mean_of_seeds(
                subject,
                pair,
                log,
                replace(problem, _counts=_sure_counts(pair)),
            )
        if many is not None and abs(many[0] - goal) <= (
            subject.tolerance * unit + many[1]
        ):
            value, chance = many
            allowed = subject.tolerance * unit + chance
            data = f"counts of {N_EXACT_TRANSITIONS:.0e} transitions a pair"
        else:
            larger = pair.exact_log(N_COPIES)
            again = replace(pair.problem_of(larger), simulator_data="exact")
            second, second_chance = _mean_of_seeds(subject, pair, larger, again)
            subject.seen.log = log
            allowed = subject.tolerance * unit + second_chance
            allowed += max(abs(value - second) - chance, 0.0) / 3.0
            value = second
            data = f"{larger.n_episodes} episodes, each as frequent as probable"
    numbers = f"{value:.8g} of {data}, {what} {goal:.8g}"
    if abs(value - goal) <= allowed:
        subject.seen.tolerances.append(allowed / unit)
        return f"{numbers}, tolerance {allowed / unit:.1g} of it"
    raise Broken(
        f"{numbers}: off by {abs(value - goal) / unit:.2g} of it, tolerance"
        f" {allowed / unit:.1g}",
        "estimator(pair.problem_of(pair.exact_log()), pair.policy, seed=0)",
    )


def _sure_counts(pair: Case) -> Csr:
    """Return 10^9 times the target's rows of the pairs that logs have."""
    recorded = sparse.diags_array(
        N_EXACT_TRANSITIONS * (pair.data_distribution.ravel() > 0), format="csr"
    )
    return sparse.csr_array(recorded @ pair.target.transitions)


def _mean_of_seeds(
    subject: Subject, pair: Case, log: Transitions, problem: Problem
) -> tuple[float, float]:
    """Return the mean value over seeds that matter, and five standard errors of it."""
    seeds = N_EXACT_SEEDS if "random" in subject.claims else 1
    values: Array = np.array(
        [
            value_of(
                subject.estimate_problem(
                    pair, log, problem, seed, rollouts=N_ROLLOUTS[N_LARGE_LOG_EPISODES]
                ),
                seed,
            )
            for seed in range(seeds)
        ]
    )
    if np.ptp(values) == 0.0:
        return float(values[0]), 0.0
    error = float(values.std(ddof=1) / np.sqrt(seeds))
    return float(values.mean()), MAX_EXACT_ERRORS * error


# ---- does the mean of an estimator's values tend to a number?


def _tends_to_truth(subject: Subject, pair: Case) -> str:
    """Check that limit and values tend to J_target."""
    for data in ({}, _data(pair)):
        own = subject.limit(pair, **data)
        if own is not None:
            example = (
                "estimator.limit(pair.simulator, pair.target, pair.policy,"
                f" horizon={pair.horizon})"
            )
            _equals(subject, own, pair.truth, own, "its limit is not J_target", example)
    return _tends_to(subject, pair, pair.truth, "J_target")


def _data(pair: Case) -> dict[str, Any]:
    """Return what a limit may depend on beside the pair and the policy."""
    return {
        "behavior_policy": pair.behavior.copy(),
        "data_distribution": pair.data_distribution,
    }


def _tends_to(subject: Subject, pair: Case, goal: float, what: str) -> str:
    """Return a sentence with the numbers, or raise ``Broken``.

    The mean over the large logs may be off by chance, and by a third of what 16 times
    as many episodes changed it: a bias of order n^-1/2 changes by three times what is
    left of it, one of order 1/n by 15 times.
    """
    if pair.name not in subject.values:
        small = _draw_values(
            subject, pair, N_SMALL_LOG_EPISODES, max(subject.repetitions // 2, 2), 0
        )
        subject.values[pair.name] = (
            small,
            _draw_values(
                subject, pair, N_LARGE_LOG_EPISODES, subject.repetitions, 1000
            ),
        )
    small, large = subject.values[pair.name]
    n = len(large)
    mean = float(large.mean())
    allowed = _chance(float(large.std(ddof=1) / np.sqrt(n)), n) + 1e-9 * max(
        1.0, abs(goal)
    )
    allowed += abs(float(small.mean()) - mean) / 3.0 if len(small) else 0.0
    numbers = (
        f"mean {mean:.5g} (of {n} logs of {N_LARGE_LOG_EPISODES} episodes),"
        f" {what} {goal:.5g}"
    )
    if abs(mean - goal) <= allowed:
        subject.seen.tolerances.append(allowed / (abs(goal) or 1.0))
        return f"{numbers}, tolerance {allowed:.2g}"
    truth = "" if goal == pair.truth else f", J_target {pair.truth:.5g}"
    raise Broken(
        f"{numbers}: off by {abs(mean - goal):.3g}, tolerance {allowed:.2g}{truth}",
        f"estimator(pair.problem({N_LARGE_LOG_EPISODES}, seed=0), pair.policy, seed=0) against"
        f" {goal:.5g}",
    )


def _draw_values(
    subject: Subject, pair: Case, n: int, repetitions: int, first_seed: int
) -> Array:
    """Return values of independent logs of ``n`` episodes; small logs may have none."""
    values = []
    for k, log in enumerate(subject.draw_logs(pair, n, repetitions, pair.name, n)):
        try:
            values.append(
                subject.value(pair, log, seed=first_seed + k, rollouts=N_ROLLOUTS[n])
            )
        except Broken as broken:
            if n == N_LARGE_LOG_EPISODES or isinstance(broken, Raises):
                raise
    return np.array(values)


def _chance(error: float, n: int) -> float:
    """Return how far the mean of ``n`` values may be off by chance."""
    return float(stdtrit(n - 1, 1.0 - FAILURE_CHANCE / 2)) * error


# ---- two estimates


ROUNDING_TOLERANCE = 1e-8  # share of a number by which an equal one may differ


def _equals(
    subject: Subject,
    value: float,
    expected: float,
    before: float,
    what: str,
    example: str,
) -> str:
    """Raise ``Broken`` where two numbers differ by more than rounding."""
    distance = abs(value - expected)
    subject.seen.tolerances.append(ROUNDING_TOLERANCE)
    if not distance <= ROUNDING_TOLERANCE * max(1.0, abs(expected)):
        raise Broken(
            f"{what}: {value:.10g}, expected {expected:.10g} (off by {distance:.2g})",
            example,
        )
    return (
        f"{before:.6g} both" if before == expected else f"{before:.6g} to {value:.6g}"
    )


def _have_same_mean(
    subject: Subject, first: Array, second: Array, what: str, example: str
) -> str:
    """Raise ``Broken`` where two samples' means differ by more than chance allows."""
    n = len(first)
    allowed = (
        _chance(float(np.sqrt((first.var(ddof=1) + second.var(ddof=1)) / n)), n) + 1e-9
    )
    distance = abs(float(first.mean() - second.mean()))
    subject.seen.tolerances.append(allowed / (abs(float(first.mean())) or 1.0))
    numbers = f"{what}: means {first.mean():.5g} and {second.mean():.5g} over {n} seeds"
    if not distance <= allowed:
        raise Broken(
            f"{numbers}, apart by {distance:.2g}, tolerance {allowed:.2g}", example
        )
    return f"{numbers}, tolerance {allowed:.2g}"


def _compare_rewards(
    subject: Subject, pair: Case, n: int, factor: float, added: float
) -> str:
    """Check that rewards factor * r + added give factor * J + added * sum_t gamma^t."""
    log = subject.draw_log(pair, n, "rewards", pair.name)
    columns = log.columns()
    gamma = pair.simulator.discount
    other = subject.seen.remember(
        Transitions(**(columns | {"reward": factor * columns["reward"] + added})),
        # the case's rewards are factor * r + added as well
        subject.seen.recipe(log),
    )
    total = (
        1.0 / (1.0 - gamma)
        if pair.horizon is None
        else float(np.sum(gamma ** np.arange(pair.horizon)))
    )
    before = subject.value(pair, log)
    after = subject.value(pair.with_rewards(factor, added), other)
    example = f"pair.with_rewards({factor}, {added}), and the same of log.reward"
    what = f"value of rewards {factor:g} r + {added:g}"
    expected = factor * before + added * total
    return _equals(subject, after, expected, before, what, example)


def _compare_padding(
    subject: Subject, pair: Case, actions: tuple[int, ...], probability: float
) -> str:
    """Check that rows in an absorbing state after an episode's end change nothing."""
    log = subject.draw_log(pair, N_EPISODES, "padding", pair.name)
    before = subject.value(pair, log)
    padded = subject.seen.remember(
        padded_log(log, actions, probability),
        f"oee.testing.padded_log({subject.seen.recipe(log)}, {actions}, {probability})",
    )
    after = subject.value(pair, padded)
    example = f"padded_log(pair.log({N_EPISODES}, seed=0), {actions}, {probability})"
    what = f"value with {len(actions)} rows after each end"
    return _equals(subject, after, before, before, what, example)
