"""``plan_data_collection``: which pairs to record next, or which behaviour policy to
run, for the narrowest intervals.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._parallel import one_thread
from oee_tabular._sparse import row_sums
from oee_tabular.design.advice import next_pairs
from oee_tabular.design.costs import row_costs
from oee_tabular.design.plan import Outlook, Plan
from oee_tabular.design.programs import (
    LARGEST_GAP,
    Solver,
    behavior_of,
    collection_mdp,
    solve_for_all,
    sum_variances,
)
from oee_tabular.estimators import Problem
from oee_tabular.exact import occupancy
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy, uniform_policy
from oee_tabular.mdp.horizons import optional_horizon_length
from oee_tabular.mdp.policies import split_policies
from oee_tabular.ratio import transition_ratio
from oee_tabular.ratio.dual import check_box
from oee_tabular.ratio.support import refuse_unsupported
from oee_tabular.typing import Array


@one_thread
def plan_data_collection(
    problem: Problem | FiniteMDP,
    policies: object,
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
) -> Plan:
    """Choose where to record the next n transitions of the target to estimate the
    policies' values most precisely.

    minimise over q  max_pi sum_x c^pi_x / (n_x + n q_x) / best_pi,   c^pi_x = Var_{s' ~
    P'(.|x)}[dJ_pi / dP'(s' | x)],

    with n_x the log's counts and best_pi the smallest sum that a plan for pi alone
    reaches.

    Parameters
    ----------
    problem : Problem, or the simulator (FiniteMDP) if there is no log yet
    policies : (S, A), or a mapping name -> (S, A): the worst of several counts
    n : how many transitions are to be recorded
    sampling : "free"
        Any state-action pair can be recorded.
        "behavior"
        A behaviour policy records: q is its occupancy in ``model``, restarted after
        each transition with probability ``restart``, and on entering a state that no
        action leaves.
    model : P', at which variances are evaluated: "estimate" (``transition_ratio``'s
        zeta * P from the log; the simulator if there is no log), "simulator", or a
        FiniteMDP, of which the transitions are used
    horizon : positive int or None; only if ``problem`` is a simulator (a Problem has
        its own)
    lower_ratio, upper_ratio : the box for pairs without spread, see ``optimistic``;
        None: any distribution there
    optimistic : True
        Pairs that ``model`` makes deterministic cost the largest plausible variance,
        not 0, or they would never be tested (``design`` has the set: another action is
        executed or nothing happens, within the box, and less often the more transitions
        the log has).
    restart : in (0, 1), "behavior" only; default 1 - discount (1 / horizon at discount
        1)
    restart_costs_a_move : False: the transition recorded after an episode's end is from
        a first state; True: one more is recorded in the state that ended it
    solver : "auto"
        In closed form for one policy and free sampling, else by an interior point
        method, to a gap of 0.01%. "frank_wolfe" is an older name of it.
        "CLARABEL"
        Clarabel by cvxpy: a smaller gap, but slow above 4000 pairs.
    confidence : in (0, 1), of the intervals whose widths are predicted (J ± z standard
        errors)

    Returns
    -------
    Plan

    Raises
    ------
    ValueError
        Bad arguments; discount 1 without a horizon; a ``model`` with transitions
        outside the simulator's support; episodes too short to reach a pair that
        matters.

    Notes
    -----
    Predictions are first-order and at ``model``: the variance of maximum likelihood
    with the counts that the plan expects. A pair that matters and has no data makes the
    present error infinite. An estimator that shares information between pairs
    (``OffEnvironment()``, by its tilt) has smaller errors, and gains less by planning.
    Cost: free, O(S A log(S A)) after two solves a policy; several policies or
    behaviour, 10 to 40 steps of 20 to 300 products with the collection MDP's
    transitions.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.tasks.gridworld(4, slip=0.3, discount=0.9)
    >>> plan = plan_data_collection(simulator, oee.tasks.gridworld_expert(4), n=1000)
    >>> round(plan.expected_standard_error[1], 3), plan.next_pairs[:3]
    (0.106, ((4, 0), (0, 0), (8, 0)))
    """
    _checks.boolean(optimistic, "optimistic")
    _checks.boolean(restart_costs_a_move, "restart_costs_a_move")
    counts, mdp, steps = _counts_and_simulator(problem, horizon)
    number = _checks.positive_integer(n, "n")
    _checks.one_of(sampling, "sampling", ("free", "behavior"))
    _checks.one_of(solver, "solver", ("auto", "frank_wolfe", "CLARABEL"))
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
    )
    collection = None
    if sampling == "behavior":
        chance = (
            1.0 / steps
            if steps is not None and mdp.discount == 1.0
            else 1.0 - mdp.discount
        )
        if restart is not None:
            chance = _checks.number_in(restart, "restart", 0.0, 1.0, open_ends=True)
        collection = collection_mdp(
            truth, chance, ends=mdp.closed(), restart_costs_a_move=restart_costs_a_move
        )
    base = counts / number
    costs = table / number
    matters = costs.max(axis=1) > 0.0
    least = np.zeros(len(pis))
    free = np.zeros(len(pis))
    gap = 0.0
    status = (
        "nothing to learn: these policies' values depend on no transition probability"
    )
    solved_by = "none"
    if matters.any():
        uncertain = [pi for pi, does in zip(pis, matters, strict=True) if does]
        (q, value, bound), least[matters], free[matters] = solve_for_all(
            costs[matters], base, collection, uncertain, solver
        )
        gap = max(0.0, 1.0 - bound / value)
        status = "ok"
        if gap > LARGEST_GAP:
            status = (
                f"not finished: another plan may be better by up to {gap:.1%} of the"
                " variance"
            )
        is_closed_form = collection is None and len(uncertain) == 1
        solved_by = (
            solver
            if solver == "CLARABEL"
            else "closed form"
            if is_closed_form
            else "interior point"
        )
    elif collection is None:
        q = np.full(base.size, 1.0 / base.size)
    else:
        q = occupancy(collection, uniform_policy(collection)).reshape(-1)
    now, after = (sum_variances(costs, base, x) for x in (np.zeros_like(base), q))
    to_least, to_free = (
        np.divide(after, x, out=np.ones_like(after), where=x > 0.0)
        for x in (least, free)
    )
    shape = (mdp.n_states, mdp.n_actions)
    return Plan(
        sampling=sampling,
        n=number,
        confidence=level,
        distribution=q.reshape(shape),
        behavior_policy=behavior_of(q, shape),
        policies=tuple(
            Outlook(
                name,
                float(now[k]),
                float(after[k]),
                float(to_least[k]),
                float(to_free[k]),
                level,
            )
            for k, name in enumerate(named)
        ),
        gap=gap,
        next_pairs=next_pairs(table, counts, shape[1], min(number, 10), level),
        counts=counts.reshape(shape),
        costs={name: c.reshape(shape) for name, c in zip(named, table, strict=True)},
        optimistic=certain.reshape(shape),
        restart=None if collection is None else 1.0 - collection.discount,
        model=source,
        solver=solved_by,
        status=status,
        names=mdp.names,
    )


def _counts_and_simulator(
    problem: Problem | FiniteMDP, horizon: int | None
) -> tuple[Array, FiniteMDP, int | None]:
    """Counts of the rows, the simulator with the rewards to be paid, the horizon."""
    if isinstance(problem, FiniteMDP):
        return (
            np.zeros(problem.n_states * problem.n_actions),
            problem,
            optional_horizon_length(horizon, problem),
        )
    _checks.instance(problem, Problem, "problem", "Problem or a FiniteMDP")
    if horizon is not None:
        raise ArgumentError(
            "horizon",
            f"must be left out with a Problem, which has its own ({problem.horizon});"
            f" it is {_checks.show(horizon)}",
        )
    return row_sums(problem.counts), problem.model, problem.horizon


def _check_policies(policies: Any, mdp: FiniteMDP) -> dict[str, Array]:
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
    return (
        transition_ratio(problem.observed, problem.simulator).target_model(mdp),
        "the estimate from the log",
    )
