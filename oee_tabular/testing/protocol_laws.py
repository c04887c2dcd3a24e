"""Laws that every estimator owes, whatever it claims: well-formed answers, no side effects, no number without support."""

from __future__ import annotations

import pickle
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular._checks import PolicyLike
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.functions import RETURNED, as_estimator
from oee_tabular.exact import policy_value
from oee_tabular.mdp import FiniteMDP
from oee_tabular.testing.cases import Case
from oee_tabular.testing.subject import Broken, NotClaimed, Raises, Refused, Subject, call, on_cases, shorten

FEW, EPISODES = 20, 200


def well_formed(subject: Subject) -> str:
    """Odd small problems give a finite value, a status that is not "ok", or a ValueError that says why."""
    answers, n_refused = [], 0
    refusals: dict[str, str] = {}  # reason -> the first problem refused for it
    for pair, log in _odd_problems(subject):
        try:
            with subject.look_at(pair, f", {len(log)} transitions"):
                answers.append(subject.estimate(pair, log, 0))
        except Refused as refusal:
            refusals.setdefault(str(refusal.__cause__), pair.title)
            n_refused += 1
    reasons = "; ".join(f"{title} {shorten(text, 160)}" for text, title in refusals.items())
    if not answers:
        raise Raises(f"all {n_refused} problems are refused: {reasons}")
    text = f"{len(answers)} of {len(answers) + n_refused} odd problems answered"
    text += f", {n_refused} refused by a ValueError ({reasons})" if refusals else ""
    if any(RETURNED in estimate.diagnostics for estimate in answers):
        text += "; floats, so that standard errors, intervals and statuses are skipped"
    return text


def _odd_problems(subject: Subject) -> Iterator[tuple[Case, Transitions]]:
    """One state, one action, discounts 0 and 1, one reward, one episode, no episodes, actions never recorded."""
    single = FiniteMDP([[[1.0]]], [2.0], [1.0], 0.5)
    fork = [[[0.5, 0.5], [0.0, 1.0]], [[0.0, 1.0], [0.0, 1.0]]]  # half the starts are terminal
    leave = FiniteMDP(fork, [[1.0, 3.0], [0.0, 0.0]], [0.5, 0.5], 1.0)
    certain = FiniteMDP([[[0.0, 1.0]], [[1.0, 0.0]]], [1.0, -1.0], [1.0, 0.0], 0.9)
    first, even, one = [[1.0, 0.0]] * 2, [[0.5, 0.5]] * 2, [[1.0]]
    rows: list[tuple[str, FiniteMDP, Any, Any, int | None, int]] = [  # policy, behaviour, horizon, steps
        ("one state", single, one, one, 3, 3),
        ("one state", single, one, one, None, 60),
        ("discount 0", leave.with_discount(0.0), first, even, None, 5),
        ("discount 1", leave, first, even, 4, 4),
        ("discount 1", leave, even, even, None, 40),
        ("one reward", leave, first, even, 1, 3),
        ("nothing random", certain, one * 2, one * 2, 4, 4),
        ("an action never recorded", leave, even, first, 4, 4),
        ("no episode of the policy's", leave, [[0.0, 1.0], [1.0, 0.0]], first, 4, 4),
    ]
    for k, (name, mdp, policy, behavior, horizon, steps) in enumerate(rows):
        pair = Case(name, mdp, mdp, np.array(policy), np.array(behavior), horizon, steps)
        yield pair, pair.log(FEW, seed=subject.log_seed("odd", k))
    for pair in subject.cases("ragged", "ragged infinite"):
        yield pair, pair.log(1, seed=subject.log_seed("odd", "one episode"))
        yield pair, pair.log(FEW, seed=subject.log_seed("odd", "no episodes")).draw(10, seed=0)


@on_cases("ragged", "ragged infinite", "moves")
def input_unchanged(subject: Subject, pair: Case) -> str:
    """Problem, log, simulator and policy are after the call what they were, to the bit (their arrays made writable)."""
    problem, policy = pair.problem(EPISODES, seed=subject.log_seed("input", pair.name)), pair.policy.copy()
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
            if not np.array_equal(array, before[name], equal_nan=array.dtype.kind == "f"):
                n_changed = int(np.sum(array != before[name]))
                raise Broken(f"{name} is changed in {n_changed} of {array.size} places")
    return f"{len(arrays)} arrays and every field as before"


def _arrays(problem: Problem, policy: PolicyLike) -> Iterator[tuple[str, Any]]:
    simulator = problem.simulator
    yield "policy", policy
    yield "problem.behavior_policy", problem.behavior_policy
    yield from ((f"log.{name}", column) for name, column in problem.log.columns().items())
    yield from ((f"simulator.{name}", getattr(simulator, name)) for name in ("rewards", "initial", "terminal_state"))
    tables = {"simulator.transitions": simulator.transitions, "problem.counts": problem.counts}
    if simulator.transition_rewards is not None:
        tables["simulator.transition_rewards"] = simulator.transition_rewards
    for name, table in tables.items():
        yield from ((f"{name}.{part}", getattr(table, part)) for part in ("data", "indices", "indptr"))


@on_cases("ragged", "ragged infinite")
def reproducible(subject: Subject, pair: Case) -> str:
    """The same seed gives the same bits, whatever the global random state, which it leaves alone."""
    log = pair.log(EPISODES, seed=subject.log_seed("reproducible", pair.name))
    first, second = (_estimate_in_state(subject, pair, log, state) for state in (1, 2))
    for name in ("value", "standard_error"):
        values = getattr(first, name), getattr(second, name)
        before, after = (np.array(value, dtype=np.float64) for value in values)
        if not np.array_equal(before, after, equal_nan=True):
            text = f"{name} of seed 7 is {values[0]!r}, and when called again {values[1]!r}"
            raise Broken(text, "the same problem twice, seed=7")
    return f"seed 7 gives {first.value!r} twice"


def _estimate_in_state(subject: Subject, pair: Case, log: Transitions, state: int) -> Estimate:
    """An estimate of seed 7 under a global random state of ours, or ``Broken`` where it has changed that."""
    estimator, states = as_estimator(subject.estimator(pair)), []

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
    """Other seeds give the same bits (owed by every estimator that does not claim to be random)."""
    if "random" in subject.claims:
        raise NotClaimed("it claims to be random")
    log = pair.log(EPISODES, seed=subject.log_seed("seeds"))
    values = [subject.value(pair, log, seed=seed) for seed in range(4)]
    if len(set(values)) > 1:
        shown = ", ".join(f"{value:.8g}" for value in values)
        raise Broken(f"seeds 0 to 3 give {shown}, and 'random' is not among its claims")
    return f"seeds 0 to 3 give {values[0]:.8g} each"


@on_cases("violated")
def support(subject: Subject, pair: Case) -> str:
    """Where the target has transitions with simulator probability 0: a ValueError or a status, no silent number.

    ``Problem`` refuses a log with such a transition. Looked at are the estimator's limit for such a target (J_target itself is
    right), and an oracle of such a target.
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
    """An estimator made for the violating pair, on a log without violation."""
    inside = replace(pair, target=pair.simulator)
    log = inside.log(EPISODES, seed=subject.log_seed("support"))
    try:
        answer = subject.estimate(pair, log, 0)
    except Refused as refused:
        return f"oracle: {shorten(refused.text, 60)}"
    if answer.value != subject.estimate(inside, log, 0).value:  # else it does not look at the target
        _require_status(answer, pair)
    return "oracle: no number of its own"


def _require_status(estimate: Estimate, pair: Case) -> None:
    """``Broken`` where a value other than J_target has the status "ok"."""
    if estimate.status == "ok" and abs(estimate.value - pair.truth) > 1e-8 * max(1.0, abs(pair.truth)):
        simulator = policy_value(pair.simulator, pair.policy, horizon=pair.horizon)
        raise Broken(
            f"{estimate.value:.6g} without a word, J_target {pair.truth:.6g}, J_simulator {simulator:.6g}",
            "s=0 -> s'=2 has probability 0 in the simulator",
        )
