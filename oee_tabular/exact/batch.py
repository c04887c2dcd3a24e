"""Many evaluations in one call: many small MDPs with a policy each, or many policies in one MDP."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.exact.reweighted import Model, ReweightedModel, require_model
from oee_tabular.exact.systems import TINY, readable, unsigned
from oee_tabular.exact.values import evaluate_policy
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import SHORT, steps_of


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


@dataclass(frozen=True, eq=False)
class ModelStack:
    """MDPs end to end in one set of arrays, for ``evaluate_batch``; made by ``stack_models``.

    Attributes
    ----------
    models : the MDPs
    sizes, actions : (M,) numbers of states and actions
    discounts : (M,)
    pointers, indices, data : their transitions, one CSR after the other, row pointers beginning at 0 in each
    rewards, initial : flat

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> stack_models([coin, coin])
    ModelStack(2 MDPs, 4 states)
    """

    models: tuple[Model, ...]
    sizes: IntArray
    actions: IntArray
    discounts: Array
    pointers: Any
    indices: Any
    data: Array
    rewards: Array
    initial: Array

    def __len__(self) -> int:
        return len(self.models)

    def __repr__(self) -> str:
        return f"ModelStack({len(self)} MDPs, {int(self.sizes.sum())} states)"


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
    if set(map(type, found)) != {FiniteMDP}:
        for i, model in enumerate(found):
            require_model(model, f"models[{i}]")
    rows = _each(found, "transitions")
    pointers, indices, data = (
        getattr(rows[0], name) if len(rows) == 1 else np.concatenate(_each(rows, name))
        for name in ("indptr", "indices", "data")
    )
    actions = np.array(_each(found, "n_actions"), dtype=np.int64)
    rewards = _each(found, "rewards")  # of equal widths they are flattened sooner once together
    flat = np.concatenate(rewards).reshape(-1) if actions.min() == actions.max() else np.concatenate(rewards, axis=None)
    return ModelStack(
        found,
        np.array(_each(found, "n_states"), dtype=np.int64),
        actions,
        np.array(_each(found, "discount"), dtype=np.float64),
        unsigned(pointers),
        unsigned(indices),
        readable(data),
        readable(flat),
        readable(np.concatenate(_each(found, "initial"))),
    )


def _each(things: Sequence[Any], name: str) -> list[Any]:
    return list(map(operator.attrgetter(name), things))


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
    MDPs of up to 32 states are solved in one compiled call, O(nnz + S^3) each (or O(nnz + T S^2)), about a microsecond
    for a few states. Larger ones, policies that change with time and discount 1 are evaluated one by one.

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
    if isinstance(models, FiniteMDP | ReweightedModel):
        stack, single = stack_models([models]), True
    else:
        stack, single = models if isinstance(models, ModelStack) else stack_models(models), False  # type: ignore[arg-type]
    if not isinstance(policies, np.ndarray) or policies.ndim == 0:
        policies = _checks.collection(policies, "policies", "a sequence of policies")
    count = len(policies)
    if not single and count != len(stack):
        raise ValueError(f"policies must be as many as models ({len(stack)}); there are {count}")
    if count == 0:
        return BatchValues(np.empty((0, int(stack.sizes[0]))), np.empty(0), np.empty(0))
    repeat = count if single else 1
    sizes, actions = np.tile(stack.sizes, repeat), np.tile(stack.actions, repeat)
    flat = None
    if stack.sizes.max() <= TINY and (steps is not None or stack.discounts.max() < 1.0):
        flat = _flat(policies, sizes, actions)
    if flat is not None and steps is not None and steps > SHORT:
        steps = max(steps_of(steps, model) for model in stack.models)
    if flat is None:
        return _one_by_one(stack.models * repeat, policies, steps)
    starts = _starts(sizes)
    values, errors = np.empty(starts[-1]), np.empty(count)
    _run(stack, flat, sizes, actions, steps, starts, values, errors)
    # rows beyond 1 / discount, or values beyond floats: the single evaluation has a certificate for those, or an error
    if np.isnan(errors).any() or not np.isfinite(values).all():
        return _one_by_one(stack.models * repeat, policies, steps)
    if sizes.min() == sizes.max():
        table = values.reshape(count, -1)
        return BatchValues(table, np.einsum("ns,ns->n", table, np.broadcast_to(
            stack.initial.reshape(-1, table.shape[1]), table.shape)), errors)  # fmt: skip
    total = np.add.reduceat(values * stack.initial, starts[:-1])
    return BatchValues(tuple(np.split(values, starts[1:-1])), total, errors)


def _starts(lengths: Any) -> IntArray:
    starts = np.zeros(len(lengths) + 1, dtype=np.int64)
    np.cumsum(lengths, out=starts[1:])
    return starts


def _flat(policies: Any, sizes: IntArray, actions: IntArray) -> Array | None:
    """All policies (S, A) end to end, checked; None where they must be looked at one by one."""
    uniform = sizes.min() == sizes.max() and actions.min() == actions.max()
    if isinstance(policies, np.ndarray) and _plain(policies):
        if not uniform or policies.shape[1:] != (sizes[0], actions[0]):
            return None
        flat = np.ascontiguousarray(policies, dtype=np.float64).reshape(-1)
    else:
        try:
            arrays = [np.asarray(policy) for policy in policies]
        except ValueError:  # ragged: the check of each says where
            return None
        shapes = list(zip(sizes.tolist(), actions.tolist(), strict=True))
        if [array.shape for array in arrays] != shapes or not all(_plain(array) for array in arrays):
            return None
        flat = np.concatenate(arrays, axis=None).astype(np.float64, copy=False)
    if uniform:
        sums = flat.reshape(-1, actions[0]) @ np.ones(actions[0])
    else:
        sums = np.add.reduceat(flat, _starts(np.repeat(actions, sizes))[:-1])
    fine = flat.min() >= 0.0 and bool((np.abs(sums - 1.0) <= _checks.SUM_TOLERANCE).all())
    return flat if fine else None


def _plain(array: Array) -> bool:
    """Numbers that are taken as they stand: rows of single precision are scaled by the check of a policy."""
    return array.dtype == np.float64 or array.dtype.kind in "iub"


def _run(
    stack: ModelStack, policies: Array, sizes: IntArray, actions: IntArray, steps: int | None, starts: IntArray,
    values: Array, errors: Array,
) -> None:  # fmt: skip
    """The compiled call; a single model stands for all."""
    from oee_tabular.exact._batches import small_values

    first_action = _starts(sizes * actions)
    if len(stack) == 1:
        first_pointer = first_entry = first_row = np.zeros(len(sizes), dtype=np.int64)
    else:
        first_row = first_action[:-1]
        first_pointer = first_row + np.arange(len(sizes))
        first_entry = _starts(stack.pointers[first_pointer + sizes * actions])[:-1]
    discounts = np.broadcast_to(stack.discounts, sizes.shape).copy()
    small_values(
        stack.pointers, first_pointer, first_entry, stack.indices, stack.data, first_row, stack.rewards,
        first_action, readable(policies), starts[:-1], sizes, discounts, 0 if steps is None else steps, values, errors,
    )  # fmt: skip


def _one_by_one(models: tuple[Model, ...], policies: Any, horizon: int | None) -> BatchValues:
    checked = [
        check_policy(policy, model, name=f"policies[{i}]", horizon=horizon)
        for i, (model, policy) in enumerate(zip(models, policies, strict=True))
    ]
    found = [evaluate_policy(model, policy, horizon=horizon) for model, policy in zip(models, checked, strict=True)]
    values = tuple(one.values for one in found)
    same = len({len(one) for one in values}) == 1
    return BatchValues(
        np.stack(values) if same else values,
        np.array([one.value for one in found]),
        np.array([one.error_bound for one in found]),
    )
