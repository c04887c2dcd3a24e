"""Plans of data collection: which pairs to record, or which behaviour policy to run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._sparse import row_sums
from oee_tabular.design.advice import next_pairs
from oee_tabular.design.costs import row_costs
from oee_tabular.design.plan import Outlook, Plan
from oee_tabular.design.programs import (
    MAX_GAP,
    Solver,
    behavior_of,
    collection_mdp,
    solve_for_all,
    sum_variances,
)
from oee_tabular.estimators import Problem
from oee_tabular.exact import occupancy
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import (
    FiniteMDP,
    check_policy,
    optional_horizon_length,
    place_names,
    split_policies,
    uniform_policy,
)
from oee_tabular.ratio.dual import check_box
from oee_tabular.ratio.support import refuse_unsupported
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array, PoliciesLike, PolicyLike

MAX_NEXT_PAIRS = 10  # that a plan lists
# of values, and of gains
NOTHING_TO_LEARN = (
    "nothing to learn: these policies' values depend on no transition probability",
    "nothing to learn: these policies' gains depend on no transition probability",
)


@suggest_keywords
@one_thread
def plan_data_collection(
    problem: Problem | FiniteMDP,
    policies: PoliciesLike,
    *,
    n: int,
    sampling: Literal["free", "behavior"] = "free",
    model: Literal["estimate", "simulator"] | FiniteMDP = "estimate",
    horizon: int | None = None,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    optimistic: bool = True,
    restart: float | None = None,
    restart_costs_a_move: bool = False,
    solver: Solver = "auto",
    confidence: float = 0.95,
    minus: PolicyLike | None = None,
) -> Plan:
    """Choose where to record the next n transitions of the target.

    The plan makes the standard errors of the policies' values as small as possible. It
    solves::

        minimise over q  max_pi sum_x c^pi_x / (n_x + n q_x) / best_pi

    where q is the distribution of the new transitions over state-action pairs x, c^pi_x
    = Var_{s' ~ P'(.|x)}[dJ_pi / dP'(s' | x)], n_x are the log's counts, and best_pi is
    the smallest sum that a plan for pi alone reaches.

    Parameters
    ----------
    problem : Problem or FiniteMDP
        The simulator and the log, or the simulator alone if there is no log yet.
    policies : PolicyLike or mapping of str to PolicyLike
        The policy, or the policies by name, whose values are to be estimated. Of
        several policies, the plan improves the one that is estimated worst, relative to
        a plan for it alone. A list is read as one policy.
    n : int
        The number of transitions to be recorded.
    sampling : {'free', 'behavior'}, default 'free'
        With "free" any state-action pair can be recorded. With "behavior" a behaviour
        policy records: q is its occupancy in ``model``, restarted after each transition
        with probability ``restart``, and on entering a state that no action leaves.
    model : {'estimate', 'simulator'} or FiniteMDP, default 'estimate'
        The model P' at which variances are evaluated: ``transition_ratio``'s zeta * P
        from the log (the simulator if there is no log), the simulator, or the
        transitions of a FiniteMDP.
    horizon : int, optional
        The number of rewards; only if ``problem`` is a simulator (a Problem has its
        own). None means the infinite discounted sum.
    lower_ratio : float, optional
        Lower bound in [0, 1] of the box for pairs without spread, see ``optimistic``.
        None for both bounds allows any distribution there.
    upper_ratio : float, optional
        Upper bound of at least 1 of this box.
    optimistic : bool, default True
        Whether pairs that ``model`` makes deterministic cost the largest plausible
        variance, not 0; otherwise they would never be tested. The plausible set is
        stated in ``design``: another action is executed or nothing happens, within the
        box, and less often the more transitions the log has.
    restart : float, optional
        The probability of a restart after each transition, in (0, 1), for "behavior"
        only. None means 1 - discount, and 1 / horizon at discount 1.
    restart_costs_a_move : bool, default False
        Whether one more transition is recorded in the state that ended an episode.
        Otherwise the transition after an episode's end is from a first state.
    solver : {'auto', 'CLARABEL'}, default 'auto'
        "auto" is in closed form for one policy and free sampling, else an interior
        point method, to a gap of 0.01%. "CLARABEL" is Clarabel by cvxpy: a smaller gap,
        but slow above 4000 pairs.
    confidence : float, default 0.95
        The level in (0, 1) of the intervals whose widths are predicted (J ± z standard
        errors).
    minus : PolicyLike, optional
        A policy whose value is subtracted, such as the one that runs now. The plan is
        then for the gains J(policy) - J(minus): it records where the two policies
        differ, and not where they share what they do not know. None plans for the
        values J(policy).

    Returns
    -------
    Plan
        Which share of the transitions each pair gets, the behaviour policy, and the
        precision that is predicted for each policy.

    Raises
    ------
    ValueError
        If an argument is out of its range, if the discount is 1 and there is no
        horizon, if ``model`` has transitions outside the simulator's support, or if
        episodes are too short to reach a pair that matters.

    See Also
    --------
    oee_tabular.evaluate : Evaluate policies from the log that there is.
    inference.interval : Compute the interval that the log allows now.

    Notes
    -----
    Predictions are first-order and at ``model``: the variance of maximum likelihood
    with the counts that the plan expects. A pair that matters and has no data makes the
    present standard error infinite. An estimator that shares information between pairs
    (``OffEnvironment()``, by its tilt) has smaller errors, and gains less by planning.

    With ``minus`` the costs are c_x = Var_{s' ~ P'(.|x)}[dJ_pi / dP' - dJ_minus / dP'].
    The program and its certificate are the same.

    Cost: free sampling, O(S A log(S A)) after two solves for each policy; several
    policies or behaviour, 10 to 40 steps of 20 to 300 products with the collection
    MDP's transitions.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.tasks.gridworld(4, slip=0.3, discount=0.9)
    >>> plan = plan_data_collection(simulator, oee.tasks.gridworld_expert(4), n=1000)
    >>> round(plan.expected_standard_error[1], 3), plan.next_pairs[:3]
    (0.106, ((4, 0), (0, 0), (8, 0)))

    The gain over a similar policy that runs now has a smaller error, and is best
    recorded elsewhere:

    >>> runs = oee.mix(
    ...     oee.tasks.gridworld_expert(4), oee.uniform_policy(simulator), 0.9
    ... )
    >>> gain = plan_data_collection(
    ...     simulator, oee.tasks.gridworld_expert(4), n=1000, minus=runs
    ... )
    >>> round(gain.expected_standard_error[1], 3), gain.next_pairs[:3]
    (0.014, ((5, 0), (4, 0), (9, 0)))
    """
    _checks.boolean(optimistic, "optimistic")
    _checks.boolean(restart_costs_a_move, "restart_costs_a_move")
    counts, mdp, steps = _counts_and_simulator(problem, horizon)
    number = _checks.positive_integer(n, "n")
    _checks.one_of(sampling, "sampling", ("free", "behavior"))
    _checks.one_of(solver, "solver", ("auto", "CLARABEL"))
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    box = check_box(
        lower_ratio, upper_ratio, normalized=True, names=("lower_ratio", "upper_ratio")
    )
    if sampling == "free" and restart is not None:
        raise ArgumentError(
            "restart",
            f"must be left out with sampling 'free'; it is {_checks.show(restart)}",
        )
    named = _check_policies(policies, mdp)
    pis = list(named.values())
    subtracted = None if minus is None else check_policy(minus, mdp, name="minus")
    if steps is None and mdp.discount == 1.0:
        raise ArgumentError("horizon", "must be given at discount 1")
    truth, source = _check_model(problem, mdp, model)
    table, certain = row_costs(
        mdp,
        truth,
        pis,
        counts,
        horizon=steps,
        box=box,
        confidence=level,
        optimistic=optimistic,
        minus=subtracted,
    )
    collection = None
    if sampling == "behavior":
        if restart is not None:
            chance = _checks.number_in(restart, "restart", 0.0, 1.0, open_ends=True)
        elif steps is not None and mdp.discount == 1.0:
            chance = 1.0 / steps
        else:
            chance = 1.0 - mdp.discount
        collection = collection_mdp(
            truth, chance, ends=mdp.closed(), restart_costs_a_move=restart_costs_a_move
        )
    base = counts / number
    costs = table / number
    matters = costs.max(axis=1) > 0.0
    least = np.zeros(len(pis))
    free = np.zeros(len(pis))
    gap = 0.0
    status = NOTHING_TO_LEARN[subtracted is not None]
    solved_by = "none"
    if matters.any():
        uncertain = [pi for pi, does in zip(pis, matters, strict=True) if does]
        (q, value, bound), least[matters], free[matters] = solve_for_all(
            costs[matters],
            base,
            collection,
            uncertain,
            solver,
            () if subtracted is None else (subtracted,),
        )
        gap = max(0.0, 1.0 - bound / value)
        status = "ok"
        if gap > MAX_GAP:
            status = (
                f"not finished: another plan may be better by up to {gap:.1%} of the"
                " variance"
            )
        if solver == "CLARABEL":
            solved_by = solver
        elif collection is None and len(uncertain) == 1:
            solved_by = "closed form"
        else:
            solved_by = "interior point"
    elif collection is None:
        q = mdp.available.reshape(-1) / np.count_nonzero(mdp.available)
    else:
        q = occupancy(collection, uniform_policy(collection)).reshape(-1)
    now = sum_variances(costs, base, np.zeros_like(base))
    after = sum_variances(costs, base, q)
    # a policy without variance is 1 from the best plan
    to_least = np.divide(after, least, out=np.ones_like(after), where=least > 0.0)
    to_free = np.divide(after, free, out=np.ones_like(after), where=free > 0.0)
    outlooks = tuple(
        Outlook(
            name,
            float(now[k]),
            float(after[k]),
            float(to_least[k]),
            float(to_free[k]),
            level,
        )
        for k, name in enumerate(named)
    )
    shape = (mdp.n_states, mdp.n_actions)
    return Plan(
        sampling=sampling,
        n=number,
        confidence=level,
        distribution=q.reshape(shape),
        behavior_policy=behavior_of(q, mdp),
        policies=outlooks,
        gap=gap,
        next_pairs=next_pairs(
            table, counts, shape[1], min(number, MAX_NEXT_PAIRS), level
        ),
        counts=counts.reshape(shape),
        costs={name: c.reshape(shape) for name, c in zip(named, table, strict=True)},
        optimistic=certain.reshape(shape),
        restart=None if collection is None else 1.0 - collection.discount,
        model=source,
        solver=solved_by,
        status=status,
        names=place_names(mdp),
        is_gain=subtracted is not None,
    )


def _counts_and_simulator(
    problem: Problem | FiniteMDP, horizon: int | None
) -> tuple[Array, FiniteMDP, int | None]:
    """Return the counts of rows, the simulator with the rewards, and the horizon."""
    if isinstance(problem, FiniteMDP):
        counts = np.zeros(problem.n_states * problem.n_actions)
        return counts, problem, optional_horizon_length(horizon, problem)
    _checks.instance(problem, Problem, "problem", "Problem or a FiniteMDP")
    if horizon is not None:
        raise ArgumentError(
            "horizon",
            f"must be left out with a Problem, which has its own ({problem.horizon});"
            f" it is {_checks.show(horizon)}",
        )
    return row_sums(problem.counts), problem.model, problem.horizon


def _check_policies(policies: Any, mdp: FiniteMDP) -> dict[str, Array]:
    """Check one policy, or a mapping of policies, and return name -> (S, A)."""
    several = split_policies(policies, mdp) if isinstance(policies, Mapping) else None
    if several is None:
        return {"policy": check_policy(policies, mdp, name="policies")}
    if not several:
        raise ArgumentError("policies", "must have at least one policy; it has none")
    return {
        name: check_policy(pi, mdp, name=f"policies[{name!r}]")
        for name, pi in several.items()
    }


def _check_model(
    problem: Problem | FiniteMDP, mdp: FiniteMDP, model: object
) -> tuple[FiniteMDP, str]:
    """Return the model at which variances are evaluated, and what a plan calls it."""
    if isinstance(model, FiniteMDP):
        if (model.n_states, model.n_actions) != (mdp.n_states, mdp.n_actions):
            raise ArgumentError(
                "model",
                f"must be for {mdp.n_states} states and {mdp.n_actions} actions; it is"
                f" for {model.n_states} and {model.n_actions}",
            )
        refuse_unsupported(model.transitions, mdp, what="model")
        return mdp.with_transitions(model.transitions), "a given model"
    if not isinstance(model, str):
        raise ArgumentError(
            "model",
            "must be 'estimate', 'simulator' or a FiniteMDP; got"
            f" {type(model).__name__}",
        )
    _checks.one_of(model, "model", ("estimate", "simulator"))
    if model == "simulator" or isinstance(problem, FiniteMDP):
        return mdp, "the simulator"
    ratio = transition_ratio(problem.observed, problem.simulator)
    return ratio.target_model(mdp), "the estimate from the log"
