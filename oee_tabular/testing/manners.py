"""Laws that every estimator owes, whatever it claims: well-formed answers, no traces left, no number without support."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular._checks import PolicyLike
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.exact import policy_value
from oee_tabular.mdp import FiniteMDP
from oee_tabular.testing.calls import Broken, Raises, Refused, Subject, call, guarded, malformed, shorten
from oee_tabular.testing.cases import Case

FEW, EPISODES = 20, 200


def well_formed(subject: Subject) -> str:
    """Odd small problems give an Estimate (a finite value, or a status that is not "ok"), or a ValueError that says why."""
    answered, refused, example = 0, 0, ""
    for pair, log in odd_problems(subject):
        try:
            subject.estimate(pair, log, seed=0)
            answered += 1
        except Refused as refusal:
            refused, example = refused + 1, refusal.text
    total = answered + refused
    if answered == 0:
        raise Raises(f"all {total} problems are refused, the last: {example}")
    return f"{answered} of {total} odd problems answered" + (
        f", {refused} refused ({shorten(example, 80)})" if refused else ""
    )


def input_unchanged(subject: Subject) -> str:
    """Problem, log, simulator and policy are after the call what they were, to the bit (their arrays made writable)."""
    n = 0
    for pair in [*subject.cases("ragged"), subject.one_case("moves")]:
        problem, policy = pair.problem(EPISODES, seed=subject.log_seed(2)), pair.policy.copy()
        estimator = subject.estimator(pair)
        arrays = dict(_arrays(problem, policy))
        for array in arrays.values():
            array.flags.writeable = True
        before = {name: array.copy() for name, array in arrays.items()}
        fields = {name: getattr(problem, name) for name in Problem.__dataclass_fields__}
        failure: Broken | None = None
        try:
            call(estimator, problem, policy, 0, pair.name)
        except Broken as broken:
            failure = broken
        for name, value in fields.items():
            if getattr(problem, name) is not value:
                raise Broken(f"problem.{name} is another object after the call", f"case {pair.name!r}")
        for name, array in arrays.items():
            if not np.array_equal(array, before[name], equal_nan=array.dtype.kind == "f"):
                changed = int(np.sum(array != before[name]))
                raise Broken(f"{name} is changed in {changed} of {array.size} places", f"case {pair.name!r}")
        if failure is not None:
            raise failure
        n = len(arrays)
    return f"{n} arrays and every field as before"


def reproducible(subject: Subject) -> str:
    """The same seed gives the same bits, whatever the global random state, which it leaves alone."""
    found = []
    for pair in subject.cases("ragged"):
        log = pair.log(EPISODES, seed=subject.log_seed(3))
        first, second = (_watched(subject, pair, log, state) for state in (1, 2))
        for name in ("value", "standard_error"):
            one, two = getattr(first, name), getattr(second, name)
            if one != two and not (one is not None and two is not None and np.isnan(one) and np.isnan(two)):
                text = f"{name} of seed 7 is {one!r}, and when called again {two!r}"
                raise Broken(f"{pair.name}: {text}", f"case {pair.name!r}, the same problem twice, seed=7")
        found.append(f"{pair.name}: seed 7 gives {first.value!r} twice")
    return "; ".join(found)


def support(subject: Subject) -> str:
    """Where the target moves to what the simulator gives probability 0: a ValueError or a status, no silent number.

    A log with such a move; the estimator's limit for such a target (J_target itself is right); an oracle of such a target.
    """
    pair = subject.one_case("violated")
    found = []
    try:
        problem = pair.problem(EPISODES, seed=subject.log_seed(4))
    except ValueError as error:
        found.append(f"Problem refuses the log ({shorten(str(error), 100)})")
    else:
        _no_silent_number(call(subject.estimator(pair), problem, pair.policy.copy(), 0, pair.name), pair)
        found.append("the log is refused")
    try:
        own = subject.limit(pair)
    except Refused as refused:
        found.append(f"limit: {shorten(refused.text, 60)}")
    else:
        if own is not None and np.isfinite(own) and "consistent" in subject.claims:
            _no_silent_number(Estimate(own), pair)
            found.append("limit is J_target")
    if subject.oracle:
        found.append(_oracle(subject, pair))
    return "; ".join(found)


def _oracle(subject: Subject, pair: Case) -> str:
    """An estimator made for the violating pair, on a log without violation."""
    inside = replace(pair, target=pair.simulator)
    log = inside.log(EPISODES, seed=subject.log_seed(4))
    try:
        answer = subject.estimate(pair, log, 0)
    except Refused as refused:
        return f"oracle: {shorten(refused.text, 60)}"
    if answer.value != subject.estimate(inside, log, 0).value:  # else it does not look at the target
        _no_silent_number(answer, pair)
    return "oracle: no number of its own"


def _no_silent_number(found: Estimate, pair: Case) -> None:
    if found.status != "ok" or abs(found.value - pair.truth) <= 1e-8 * max(1.0, abs(pair.truth)):
        return
    text = f"{pair.name}: {found.value:.6g} without a word, J_target {pair.truth:.6g}"
    simulator = policy_value(pair.simulator, pair.policy, horizon=pair.horizon)
    raise Broken(
        f"{text}, J_simulator {simulator:.6g}",
        f"case {pair.name!r}: s=0 -> s'=2 has probability 0 in the simulator",
    )


def odd_problems(subject: Subject) -> Iterator[tuple[Case, Transitions]]:
    """One state, one action, discounts 0 and 1, one reward, one episode, no episodes, actions never recorded."""
    one = FiniteMDP(np.ones((1, 1, 1)), np.array([2.0]), np.ones(1), 0.5)
    fork = np.array([[[0.5, 0.5], [0.0, 1.0]], [[0.0, 1.0], [0.0, 1.0]]])
    leave = FiniteMDP(fork, np.array([[1.0, 3.0], [0.0, 0.0]]), np.array([0.5, 0.5]), 1.0)  # half the starts are over
    certain = FiniteMDP(np.array([[[0.0, 1.0]], [[1.0, 0.0]]]), np.array([1.0, -1.0]), np.array([1.0, 0.0]), 0.9)
    first, even = np.array([[1.0, 0.0], [1.0, 0.0]]), np.full((2, 2), 0.5)
    own = [
        Case("one state", one, one, np.ones((1, 1)), np.ones((1, 1)), 3, 3),
        Case("one state, no horizon", one, one, np.ones((1, 1)), np.ones((1, 1)), None, 60),
        Case("discount 0", leave.with_discount(0.0), leave.with_discount(0.0), first, even, None, 5),
        Case("discount 1", leave, leave, first, even, 4, 4),
        Case("discount 1, no horizon", leave, leave, even, even, None, 40),
        Case("one reward", leave, leave, first, even, 1, 3),
        Case("nothing random", certain, certain, np.ones((2, 1)), np.ones((2, 1)), 4, 4),
        Case("an action never recorded", leave, leave, even, first, 4, 4),
        Case("no episode the policy's way", leave, leave, np.array([[0.0, 1.0], [1.0, 0.0]]), first, 4, 4),
    ]
    for k, pair in enumerate(own):
        yield pair, pair.log(FEW, seed=subject.log_seed(1, k))
    for pair in subject.cases("ragged"):
        yield pair, pair.log(1, seed=subject.log_seed(1, 20))
        yield pair, pair.log(FEW, seed=subject.log_seed(1, 21)).draw(10, seed=0)


def _watched(subject: Subject, pair: Case, log: Transitions, state: int) -> Estimate:
    """An estimate under a global random state of ours, or ``Broken`` where that has moved."""
    estimator, problem, policy = subject.estimator(pair), pair.problem_of(log), pair.policy.copy()
    with guarded("estimator(problem, policy, seed=7)", pair.name):
        random.seed(state)
        np.random.seed(state)  # noqa: NPY002 (what is watched over is the global one)
        before = random.getstate(), _plain(np.random.get_state())  # noqa: NPY002
        found = estimator(problem, policy, seed=7)
        moved = before != (random.getstate(), _plain(np.random.get_state()))  # noqa: NPY002
        trouble = malformed(found)
    if trouble:
        raise Broken(trouble, f"case {pair.name!r}, seed=7")
    if moved:
        raise Broken(f"{pair.name}: the global random state (random, numpy.random) is moved", f"case {pair.name!r}")
    assert isinstance(found, Estimate)
    return found


def _plain(state: Any) -> Any:
    return tuple(part.tobytes() if isinstance(part, np.ndarray) else part for part in state)


def _arrays(problem: Problem, policy: PolicyLike) -> Iterator[tuple[str, Any]]:
    yield "policy", policy
    yield "problem.behavior_policy", problem.behavior_policy
    for name, column in problem.log.columns().items():
        yield f"log.{name}", column
    simulator = problem.simulator
    for name in ("rewards", "initial", "terminal_state"):
        yield f"simulator.{name}", getattr(simulator, name)
    tables = {"simulator.transitions": simulator.transitions, "problem.counts": problem.counts}
    if simulator.transition_rewards is not None:
        tables["simulator.transition_rewards"] = simulator.transition_rewards
    for name, table in tables.items():
        for part in ("data", "indices", "indptr"):
            yield f"{name}.{part}", getattr(table, part)
