"""Policies are arrays: (S, A) for stationary ones, (T, S, A) where a function has a horizon."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._checks import Array, PolicyLike
from oee_tabular.mdp.policy_forms import Sized, are_several, deterministic_policy, is_policy_by_state, policy_table


def require_sized(mdp: object) -> None:
    """A ValueError for what has no states and actions."""
    if isinstance(mdp, type) or not all(hasattr(mdp, name) for name in ("n_states", "n_actions", "terminal_state")):
        raise ValueError(f"mdp must be a FiniteMDP; got {type(mdp).__name__}")


def check_policy(policy: PolicyLike, mdp: Sized, *, name: str = "policy", horizon: int | None = None) -> Array:
    """``policy`` as a new (S, A) array (or (T, S, A) where a horizon T is given), rows summing to 1 to 1e-8.

    A policy of the environment's own number of states is extended to the twins that termination appended, where any
    action does.

    Parameters
    ----------
    policy : (S, A), or (T, S, A) with a horizon T; nonnegative. Rows in single precision are scaled to sum to 1.
        Or (S,): an action a state, by number or name; a mapping state -> action, or its distribution ((A,), or a mapping
        action -> probability), in which states that are over may be left out; a function of a state that returns such.
        A function is given a state's name, or its number where there are no names
    mdp : FiniteMDP, or anything with ``n_states``, ``n_actions`` and ``terminal_state``
    name : what errors call the policy
    horizon : T; None: stationary policies only

    Raises
    ------
    ValueError
        With the place, the rule and the value found.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mdp = oee.tasks.gridworld(2, slip=0.1)
    >>> check_policy([[1, 0, 0, 0]] * 4, mdp).shape
    (4, 4)
    >>> check_policy([1, 1, 3, 0], mdp)[2].tolist(), check_policy(lambda state: [0.5, 0.5, 0, 0], mdp)[0].tolist()
    ([0.0, 0.0, 0.0, 1.0], [0.5, 0.5, 0.0, 0.0])
    >>> check_policy([[0.5, 0.4, 0, 0]] * 4, mdp)
    Traceback (most recent call last):
    ValueError: policy[0] must sum to 1 (tolerance 1e-08); it sums to 0.9 (4 such rows in all)
    """
    require_sized(mdp)
    _checks.instance(name, str, "name")
    if not (isinstance(policy, np.ndarray) and policy.ndim > 1):
        policy = policy_table(policy, mdp, name)
    array = _checks.float_array(policy, name)
    horizon = _checks.optional_horizon(horizon)
    if array.shape == (mdp.n_states, mdp.n_actions) and _are_fine(array, policy):
        return array
    own = len(mdp.terminal_state)
    shapes: list[tuple[int, ...]] = [(n, mdp.n_actions) for n in dict.fromkeys((mdp.n_states, own))]
    if horizon is not None:
        shapes += [(horizon, *shape) for shape in shapes]
    if array.shape not in shapes:
        rule = " or ".join(str(shape) for shape in shapes)
        raise ValueError(f"{name} must have shape {rule} (states, actions); it has shape {array.shape}")
    _checks.require_nonnegative(array, name)
    array = _checks.scaled_if_single(array, policy)
    _checks.require_sums_to_one(np.asarray(array.sum(axis=-1)), name)
    if array.shape[-2] < mdp.n_states:
        twins = (*array.shape[:-2], mdp.n_states - own, mdp.n_actions)
        array = np.concatenate([array, np.full(twins, 1.0 / mdp.n_actions)], axis=-2)
    return array


def _are_fine(array: Array, given: object) -> bool:
    """Whether nothing more is to be looked at: single precision is, and what misses the tolerance by a rounding."""
    from oee_tabular.mdp import _policies

    double = getattr(given, "dtype", None) != np.float32
    return double and bool(_policies.are_distributions(np.ascontiguousarray(array), 0.99 * _checks.SUM_TOLERANCE))


def check_policies(policies: Any, mdp: Sized, *, name: str = "policies", alone: str = "policy") -> dict[str, Array]:
    """Name -> (S, A) from a policy (called ``alone``), a list of them, or a mapping name -> policy; none: an empty one.

    A mapping all of whose keys are states is one policy.
    """
    require_sized(mdp)
    if isinstance(policies, Mapping) and not is_policy_by_state(policies, mdp):
        return {str(key): check_policy(policy, mdp, name=f"{name} {str(key)!r}") for key, policy in policies.items()}
    if are_several(policies, mdp):
        return {f"policy {k}": check_policy(p, mdp, name=f"{name} 'policy {k}'") for k, p in enumerate(policies)}
    return {alone: check_policy(policies, mdp, name=f"{name} {alone!r}")}


def uniform_policy(mdp: Sized) -> Array:
    """The (S, A) policy that takes each action with probability 1/A.

    Parameters
    ----------
    mdp : FiniteMDP, or anything with ``n_states`` and ``n_actions``

    Examples
    --------
    >>> import oee_tabular as oee
    >>> uniform_policy(oee.tasks.gridworld(2, slip=0.1))[0].tolist()
    [0.25, 0.25, 0.25, 0.25]
    """
    require_sized(mdp)
    return np.full((mdp.n_states, mdp.n_actions), 1.0 / mdp.n_actions)


def mix(policy_a: Any, policy_b: Any, weight_of_a: float) -> Array:
    """weight_of_a * policy_a + (1 - weight_of_a) * policy_b, action by action in each state.

    Parameters
    ----------
    policy_a, policy_b : (S, A) or (T, S, A), of one shape; rows sum to 1. One of them may be (S,) integers
    weight_of_a : float in [0, 1]

    Examples
    --------
    >>> mix([[1.0, 0.0]], [[0.5, 0.5]], 0.6).tolist()
    [[0.8, 0.2]]
    """
    weight = _checks.number_in(weight_of_a, "weight_of_a", 0.0, 1.0)
    given = (policy_a, "policy_a", policy_b), (policy_b, "policy_b", policy_a)
    arrays = [_checks.float_array(_beside(p, n, other), n, ndim=(2, 3)) for p, n, other in given]
    if arrays[0].shape != arrays[1].shape:
        raise ValueError(
            f"policy_a and policy_b must have one shape; they have {arrays[0].shape} and {arrays[1].shape}"
        )
    for array, name in zip(arrays, ("policy_a", "policy_b"), strict=True):
        _checks.require_nonnegative(array, name)
        _checks.require_sums_to_one(np.asarray(array.sum(axis=-1)), name)
    return np.asarray(weight * arrays[0] + (1.0 - weight) * arrays[1])


def _beside(policy: PolicyLike, name: str, other: Any) -> Any:
    """(S,) integers as (S, A), where the other policy is (S, A)."""
    array = _checks.as_array(policy, name)
    if array.ndim != 1 or array.dtype.kind not in "iu" or np.ndim(other) != 2:
        return policy
    n_actions = np.shape(other)[1]
    bad = np.flatnonzero((array < 0) | (array >= n_actions))
    if bad.size:
        raise ValueError(f"{name}[{bad[0]}] must be in 0..{n_actions - 1}; it is {array[bad[0]]}")
    return deterministic_policy(array.astype(np.int64), n_actions)


def policy_array(spec: str, name: str) -> Array:
    """The array that a .npy or .npz file holds."""
    arrays = _files.read_npz(spec)
    if _files.npz_kind(arrays) is not None:
        raise ValueError(f"{name} must be a file with an (S, A) array; {spec!r} holds a {_files.npz_kind(arrays)}")
    if "policy" not in arrays and len(arrays) != 1:
        raise ValueError(f"{name} must be a file with one array, or one named 'policy'; {spec!r} has {sorted(arrays)}")
    return arrays.get("policy", next(iter(arrays.values())))
