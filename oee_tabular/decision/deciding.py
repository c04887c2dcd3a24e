"""The decision: deploy a policy, keep the one that runs, or record more first."""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any

import numpy as np

from oee_tabular import _checks, _progress
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular.decision.candidates import propose, require_other_names
from oee_tabular.decision.improvement import Candidate, Improvement, Verdict
from oee_tabular.decision.optimism import measure_optimism
from oee_tabular.decision.splitting import check_split, split_counts
from oee_tabular.design import Plan, plan_data_collection
from oee_tabular.estimators import Problem
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.gain import Gain, require_consistent_box
from oee_tabular.inference.intervals import check_factor
from oee_tabular.mdp import check_policies, check_policy
from oee_tabular.report import is_best_in_log
from oee_tabular.typing import Array, PoliciesLike, PolicyLike, Seed

# of the largest value in the comparison: a smaller gain is rounding
GAIN_TOLERANCE = 1e-10
MAX_TRANSITIONS = 10**9  # that a plan is for
# Of the log's transitions: a gain that takes more to be told from 0 is too small to be
# worth recording for.
MAX_LOGS = 10


@suggest_keywords
@one_thread
def improve(
    problem: Problem,
    running: PolicyLike,
    *,
    candidates: PoliciesLike | None = None,
    confidence: float = 0.95,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    unrecorded: float = math.inf,
    split: float | bool | None = None,
    seed: Seed = None,
) -> Improvement:
    """Decide whether another policy is to replace the one that runs in the target.

    A policy is deployed only if its gain over the running policy is certified: if the
    gain is above 0 in every model of the target that the log does not reject.

    Parameters
    ----------
    problem : Problem
        The simulator, the log of the target, and the horizon.
    running : PolicyLike
        The policy that runs in the target now.
    candidates : PolicyLike or mapping of str to PolicyLike, optional
        Your own policies by name, beside those of the package (see Notes). They must
        not have been made from this log's counts.
    confidence : float, default 0.95
        The level, in (0, 1), of the interval for the gain whose lower end is taken.
    lower_ratio : float, optional
        Lower bound nu in [0, 1] of the box nu P <= P_target <= mu P, which limits pairs
        that were never recorded. None for both bounds allows any distribution on the
        simulator's support.
    upper_ratio : float, optional
        Upper bound mu >= 1 of the box.
    unrecorded : float, default inf
        The factor, at least 1, by which pairs that were never recorded may differ from
        the estimate. ``inf``: they may do anything that simulator and box allow.
    split : float or bool, optional
        The share in (0, 1) of the log that makes and chooses policies; the rest of it
        certifies them. True is a half. Then the optimum of the log's own model is a
        candidate too. None uses the whole log for both.
    seed : int, Generator or SeedSequence, optional
        The seed of the split. None draws a new one.

    Returns
    -------
    Improvement
        The best candidate, its gain with the lower end, and the decision.

    Raises
    ------
    ValueError
        If an argument is out of its range, if a policy is not one of the simulator's,
        if a candidate has a name of the package's own, if the log contradicts the box,
        if counts are fractions, or if the discount is 1 and there is no horizon.

    See Also
    --------
    oee_tabular.evaluate : Evaluate policies, with an interval of each value.
    plan_data_collection : Plan what to record for a gain.

    Notes
    -----
    The candidates are "corrected", the optimal policy of the simulator corrected by the
    log (the default estimator's zeta * P); "corrected, recorded 1+", "... 3+" and
    "... 10+", the best policies that keep the running one's probabilities in pairs
    recorded fewer than 1, 3, 10 times; and "simulator", the simulator's optimal policy.
    With a horizon they are the first step's. The one with the largest lower end is
    taken, or, if none is above 0, the one with the largest gain. Its decision is
    "record" if a plan of at most ten times the log's transitions can tell its gain from
    0, and "keep" otherwise.

    The lower end is that of the profile likelihood: the least gain of all models with
    ``sum n KL(frequencies, model) <= chi2 / 2``, chi2 the quantile of ``confidence``.
    Both values are of one model, so what the policies share cancels. The end is found
    by ascents, which do not prove that no other model is worse; many are made. Where the
    policies reach at most 128 states, the best of them is changed row by row, and then
    moved inside the set of models as far as the gain's gradient promises more.

    A policy that was made from the counts themselves (an optimum of their frequencies)
    looks better than it is, and its bound fails much more often than it says. Such a
    candidate has no lower end here (nan); use ``split``. The package's own need no
    split: they follow the counts along few directions, and their lower end is lowered
    by what halves of the log show of their optimism: by how much a policy gains more in
    the half that made it than in the other one, by the root of 2.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.tasks.gridworld(4, slip=0.3)
    >>> target = oee.tasks.gridworld(4, slip=0.1)
    >>> running = oee.mix(
    ...     oee.tasks.gridworld_expert(4), oee.uniform_policy(target), 0.5
    ... )
    >>> log = oee.sample_episodes(target, running, 100, horizon=50, seed=0)
    >>> found = improve(oee.Problem(simulator, log), running)
    >>> found.decision, found.deploy, found.gain_lower > 0
    ('deploy', True, True)
    """
    _checks.instance(problem, Problem, "problem", "Problem(simulator, log, ...)")
    model = problem.model
    runs = check_policy(running, model, name="running")
    own: dict[str, Array] = {}
    if candidates is not None:
        own = _check_candidates(candidates, problem)
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    factor = check_factor(unrecorded, has_box=False)
    share = check_split(split)
    _checks.generator(seed)  # or an error
    if model.discount == 1.0 and problem.horizon is None:
        raise ArgumentError("horizon", "must be given at discount 1")
    if problem.soft:
        raise ArgumentError(
            "problem",
            "must have whole numbers of transitions, of which a likelihood is made; it"
            " has fractions (give it the log itself)",
        )
    chooser = certifier = problem
    number: Any = None
    if share is not None:
        # one number, by which the split is drawn again
        is_number = _checks.is_integer(seed)
        number = seed if is_number else _checks.generator(seed).integers(2**32)
        parts = split_counts(problem, share, number)
        chooser, certifier = (
            Problem(model, counts, horizon=problem.horizon) for counts in parts
        )

    def gain_of(policy: Array) -> Gain:
        """Return the gain of a policy, to be bounded."""
        box = (lower_ratio, upper_ratio)
        return Gain(certifier, problem, policy, runs, level, box, factor)

    with _progress.show_steps(only_terminal=True):
        require_consistent_box(gain_of(runs))
        gains: dict[str, Gain] = {}
        for name, policy in propose(chooser, runs, own, has_log=share is not None):
            gains[name] = gain_of(policy)
        logs = (problem,) if share is None else (problem, certifier)
        from_counts = {
            name
            for name in own
            if any(_is_from_counts(log, own[name], runs) for log in logs)
        }
        optimism: dict[str, float] = {}
        if share is None and len(gains) > len(own):
            optimism = measure_optimism(problem, runs)
        found = _bound(gains, from_counts, optimism)
        best = _choose(found)
        largest = max(abs(each.gain) for each in found if math.isfinite(each.gain))
        decision: Verdict = "keep"
        plan: Plan | None = None
        if best.gain_lower > 0.0:
            decision = "deploy"
        elif best.gain > GAIN_TOLERANCE * largest > 0.0:
            plan = _plan(problem, best, runs, level)
            if plan is not None and plan.n <= MAX_LOGS * max(problem.counts.sum(), 1):
                decision = "record"
    return Improvement(
        policy=best.policy,
        gain=best.gain,
        gain_lower=best.gain_lower,
        decision=decision,
        candidates=tuple(found),
        plan=plan,
        name=best.name,
        running=runs,
        confidence=level,
        unrecorded=factor,
        split=share,
        seed=None if number is None else int(number),
    )


def _check_candidates(candidates: Any, problem: Problem) -> dict[str, Array]:
    """Check the user's policies, and return them by name."""
    if isinstance(candidates, Mapping):
        names = [str(name) for name in candidates]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ArgumentError(
                "candidates",
                f"must have names that differ as texts; {twice[0]!r} stands twice"
                " (rename one of them)",
            )
    own = check_policies(candidates, problem.model, name="candidates", alone="yours")
    require_other_names(own)
    return own


def _is_from_counts(problem: Problem, policy: Array, running: Array) -> bool:
    """Return whether a policy is an optimum of the log's own frequencies."""
    return not np.array_equal(policy, running) and is_best_in_log(problem, policy)


def _bound(
    gains: Mapping[str, Gain], from_counts: set[str], optimism: Mapping[str, float]
) -> list[Candidate]:
    """Bound all gains, those thoroughly that might be the best.

    A thorough search can only lower a rough end. So it is made for the one whose end is
    largest, until this one is thorough, and for the one that is chosen where no end is
    above 0. Ends are lowered by the ``optimism`` of those that the log made.
    """
    lower: dict[str, float] = {}
    for k, (name, gain) in enumerate(gains.items()):
        _progress.report_step(f"the gain of “{name}” (policy {k + 1} of {len(gains)})")
        lower[name] = math.nan
        if name not in from_counts:
            lower[name] = gain.rough - _optimism_of(gain, name, optimism)
    is_thorough = set(from_counts)

    def search(name: str) -> None:
        """Lower the end of a candidate by a thorough search."""
        _progress.report_step(f"the worst case of “{name}”")
        is_thorough.add(name)
        end = gains[name].lower - _optimism_of(gains[name], name, optimism)
        lower[name] = min(lower[name], end)

    while True:
        first = max(lower, key=lambda name: _order(lower[name]))
        if first in is_thorough:
            break
        search(first)

    def describe(name: str, gain: Gain) -> Candidate:
        """Return a candidate by what is known of its gain."""
        # no value stands outside of its interval
        point = gain.point
        if lower[name] > point:
            point = lower[name]
        less = _optimism_of(gain, name, optimism)
        return Candidate(name, gain.policy, point, lower[name], less)

    chosen = _choose([describe(name, gain) for name, gain in gains.items()]).name
    if chosen not in is_thorough:
        search(chosen)
    return [describe(name, gain) for name, gain in gains.items()]


def _optimism_of(gain: Gain, name: str, optimism: Mapping[str, float]) -> float:
    """Return what the end of a candidate is lowered by; 0 over the policy itself."""
    return 0.0 if gain.is_none else optimism.get(name, 0.0)


def _order(value: float) -> float:
    """Return a key of numbers, nan first."""
    return value if math.isfinite(value) else -math.inf


def _choose(found: list[Candidate]) -> Candidate:
    """Return the candidate with the largest end, or, if none is above 0, gain."""
    best = max(found, key=lambda each: _order(each.gain_lower))
    if best.gain_lower > 0.0:
        return best
    return max(found, key=lambda each: _order(each.gain))


def _plan(
    problem: Problem, best: Candidate, running: Array, confidence: float
) -> Plan | None:
    """Plan about as many transitions as tell the gain from 0; None if none can.

    That is where z standard errors are the gain, by Neyman's formula: the least
    variance of n transitions is (sum of the roots of the costs)^2 / n. Each pair that
    matters needs one transition, for until then it may do anything.
    """
    policies = {best.name: best.policy}

    def plan(n: int) -> Plan:
        """Plan n transitions for the gain."""
        return plan_data_collection(
            problem, policies, n=n, confidence=confidence, minus=running
        )

    _progress.report_step("a plan of what to record for the gain")
    first = plan(1)
    costs = first.costs[best.name]
    if not costs.max() > 0.0:
        return None
    z = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    wanted = (z * float(np.sqrt(costs).sum()) / best.gain) ** 2
    number = max(math.ceil(min(wanted, MAX_TRANSITIONS)), first.unrecorded, 1)
    return plan(number)
