"""Many evaluations in one call: many small MDPs with a policy each, or many policies in one MDP, as stacked dense arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, PolicyLike
from oee_tabular._threads import one_thread
from oee_tabular.exact.reweighted import Model, ReweightedModel, require_model
from oee_tabular.exact.values import evaluate_policy
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import SHORT_HORIZON, horizon_length

SMALL = 32  # states of an MDP that is made dense


@dataclass(frozen=True, eq=False)
class BatchValues:
    """V and J of many policies.

    Attributes
    ----------
    values : (N, S), or a tuple of N arrays where the numbers of states differ; ``values[i]`` is V of policy i
    value : (N,) J
    error_bound : (N,) of |V - V*|_inf, as in ``PolicyValues``

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> evaluate_batch([coin], [[[1.0]] * 2], horizon=1)
    BatchValues(1 policies, J 0.5 to 0.5, error bound at most 0)
    """

    values: Array | tuple[Array, ...]
    value: Array
    error_bound: Array

    def __len__(self) -> int:
        return len(self.value)

    def __repr__(self) -> str:
        if not len(self):
            return "BatchValues(0 policies)"
        return (
            f"BatchValues({len(self)} policies, J {self.value.min():.6g} to {self.value.max():.6g}, "
            f"error bound at most {self.error_bound.max():.2g})"
        )


class Group(NamedTuple):
    """Small MDPs of one shape: their places, transitions (N, S, A, S), rewards (N, S, A), initial (N, S), discounts (N,)."""

    at: IntArray
    chance: Array
    rewards: Array
    initial: Array
    discount: Array


@dataclass(frozen=True, eq=False)
class ModelStack:
    """MDPs with the dense arrays of the small ones, for ``evaluate_batch``; made by ``stack_models``.

    Attributes
    ----------
    models : the MDPs
    groups : dense arrays, for each number of states (up to 32) and actions

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> stack_models([coin, coin])
    ModelStack(2 MDPs, 4 states)
    """

    models: tuple[Model, ...]
    groups: tuple[Group, ...]

    def __len__(self) -> int:
        return len(self.models)

    def __repr__(self) -> str:
        return f"ModelStack({len(self)} MDPs, {sum(model.n_states for model in self.models)} states)"


def stack_models(models: Sequence[Model]) -> ModelStack:
    """The MDPs in one set of arrays: worth making where ``evaluate_batch`` is called on the same MDPs again.

    Parameters
    ----------
    models : at least one FiniteMDP or ReweightedModel, of any sizes

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> evaluate_batch(stack_models([coin, coin]), [[[1.0]] * 2] * 2).value.round(6).tolist()
    [1.0, 1.0]
    """
    found = _checks.collection(models, "models", "a FiniteMDP or a sequence of them")
    if not found:
        raise ValueError("models must be at least one FiniteMDP; there is none")
    shapes: dict[tuple[int, int], list[int]] = {}
    for i, model in enumerate(found):
        require_model(model, f"models[{i}]")
        shapes.setdefault((model.n_states, model.n_actions), []).append(i)
    return ModelStack(found, tuple(_dense(found, at, *shape) for shape, at in shapes.items() if shape[0] <= SMALL))


def _dense(models: tuple[Model, ...], at: list[int], s: int, a: int) -> Group:
    matrices = [models[i].transitions for i in at]
    pointers, indices, data = (np.concatenate([getattr(m, x) for m in matrices]) for x in ("indptr", "indices", "data"))
    lengths = np.diff(pointers.reshape(len(at), -1), axis=1).reshape(-1)
    chance = np.zeros((len(lengths), s))
    chance[np.repeat(np.arange(len(lengths)), lengths), indices] = data
    rewards, initial, discount = (
        np.array([getattr(models[i], x) for i in at]) for x in ("rewards", "initial", "discount")
    )
    return Group(np.array(at), chance.reshape(-1, s, a, s), rewards, initial, discount)


@one_thread
def evaluate_batch(
    models: Model | ModelStack | Sequence[Model], policies: Any, *, horizon: int | None = None
) -> BatchValues:
    """V, J and error bounds of many policies, as ``evaluate_policy`` gives them one by one.

    Parameters
    ----------
    models : one FiniteMDP (or ReweightedModel) for all policies, or a sequence or ``stack_models`` of them, of any sizes, one
        for each policy
    policies : (N, S, A), or a sequence of N arrays (S, A); with a horizon T also (T, S, A)
    horizon : positive int or None, the same for all

    Raises
    ------
    ValueError
        Bad arguments, the policy named by its place; without a horizon, a sum that does not exist.

    Notes
    -----
    MDPs of up to 32 states are solved together, O(A S^2 + S^3) each (or O(A S^2 + T S^2)). Larger ones, policies that change
    with time and kernels that need a certificate (discount 1, rows beyond 1 / discount) are evaluated one by one.

    Examples
    --------
    >>> import numpy as np
    >>> import oee_tabular as oee
    >>> mdp = oee.FiniteMDP([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1.0, 0.0], [2.0, 2.0]], [1, 0], 0.9)
    >>> found = evaluate_batch(mdp, np.array([[[1, 0], [1, 0]], [[0, 1], [0, 1]]]))
    >>> found.values.round(6).tolist(), found.value.round(6).tolist()
    ([[10.0, 20.0], [18.0, 20.0]], [10.0, 18.0])
    >>> other = oee.FiniteMDP([[[1.0]]], [3.0], [1], 0.5)
    >>> [v.round(6).tolist() for v in evaluate_batch([mdp, other], [[[1, 0], [1, 0]], [[1]]]).values]
    [[10.0, 20.0], [6.0]]
    """
    steps = _checks.optional_horizon(horizon)
    single = isinstance(models, FiniteMDP | ReweightedModel)
    stack = models if isinstance(models, ModelStack) else stack_models([models] if single else models)  # type: ignore[list-item, arg-type]
    policies = _policies(policies, None if single else len(stack))
    count = len(policies)
    if steps is not None and steps > SHORT_HORIZON:
        steps = max(horizon_length(steps, model) for model in stack.models)
    values: list[Array] = [np.full(1, np.nan)] * count
    value, errors = np.zeros(count), np.full(count, np.nan)
    for group in stack.groups:
        at = np.arange(count) if single else group.at
        pi = _stacked(policies if len(at) == count else [policies[i] for i in at], group.rewards.shape[1:])
        if pi is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                found, errors[at] = _solved(pi, group, steps)
            value[at] = np.einsum("ns,ns->n", found, np.broadcast_to(group.initial, found.shape))
            errors[at] = np.where(np.isfinite(found).all(axis=1), errors[at], np.nan)
            if len(at) == count and not np.isnan(errors).any():
                return BatchValues(found, value, errors)
            for i, one in zip(at, found, strict=True):
                values[i] = one
    for i in np.flatnonzero(np.isnan(errors)):
        values[i], value[i], errors[i] = _alone(stack.models[0 if single else i], policies[i], int(i), steps)
    same = len({model.n_states for model in stack.models}) == 1
    table = np.array(values).reshape(count, stack.models[0].n_states) if same else tuple(values)
    return BatchValues(table, value, errors)


def _policies(policies: object, wanted: int | None) -> Any:
    """A sequence of them, as many as there are models."""
    if not isinstance(policies, np.ndarray) or policies.ndim == 0:
        policies = _checks.collection(policies, "policies", "a sequence of policies")
    if wanted is not None and len(policies) != wanted:
        raise ValueError(f"policies must be as many as models ({wanted}); there are {len(policies)}")
    return policies


def _alone(model: Model, policy: PolicyLike, i: int, steps: int | None) -> tuple[Array, float, float]:
    """V, J and the error bound of one policy by itself."""
    found = evaluate_policy(model, check_policy(policy, model, name=f"policies[{i}]", horizon=steps), horizon=steps)
    return found.values, found.value, found.error_bound


def _stacked(policies: list[Any], shape: tuple[int, ...]) -> Array | None:
    """(N, S, A); None where policies must be looked at one by one (rows of single precision are scaled by their check)."""
    try:
        found = np.array(policies)
    except ValueError:  # ragged
        return None
    if found.shape[1:] != shape or not (found.dtype == np.float64 or found.dtype.kind in "iub"):
        return None
    fine = found.min() >= 0.0 and bool((np.abs(found.sum(axis=2) - 1.0) <= _checks.SUM_TOLERANCE).all())
    return found.astype(np.float64, copy=False) if fine else None


def _solved(pi: Array, group: Group, steps: int | None) -> tuple[Array, Array]:
    """V (N, S) and bounds on its error, nan where row sums give none; a group of one MDP is for all policies."""
    chance, rewards = np.broadcast_to(group.chance, (*pi.shape, pi.shape[1])), np.broadcast_to(group.rewards, pi.shape)
    kernel = np.einsum("nsa,nsat->nst", pi, chance) * group.discount[:, None, None]
    pay, paid = np.einsum("nsa,nsa->ns", pi, rewards), np.einsum("nsa,nsa->ns", pi, np.abs(rewards)).max(axis=1)
    values = np.zeros_like(pay)
    if steps is not None:
        for _ in range(steps):
            values = pay + np.einsum("nst,nt->ns", kernel, values)
        return values, np.zeros(len(pi))
    unit, roundings = 0.5 * np.finfo(float).eps, float(pi.shape[1] + pi.shape[2])
    carried = kernel.sum(axis=2).max(axis=1) * (1.0 + 2.0 * (roundings + 1.0) * unit)
    certain = carried <= 1.0 - 1e-9
    values[certain] = np.linalg.solve(np.eye(pi.shape[1]) - kernel[certain], pay[certain][..., None])[..., 0]
    missed = np.abs(pay + np.einsum("nst,nt->ns", kernel, values) - values).max(axis=1)
    rounding = (roundings + 4.0) * unit * (2.0 * np.abs(values).max(axis=1) + 2.0 * paid)
    return values, np.where(certain, (missed + rounding) / (1.0 - carried) * (1.0 + 1e-9), np.nan)
