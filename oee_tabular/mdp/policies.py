"""Policies pi(a | s) in every form that people have them, checked and made (S, A).

With a horizon T they may be (T, S, A).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks, _files
from oee_tabular._containers import MAX_SEQUENCE, count_in_ranges, length_of_range
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.arrays import require_numbers
from oee_tabular.mdp.naming import (
    Name,
    is_name,
    names_of,
    number_of,
    numbers_of,
    to_plain,
)
from oee_tabular.mdp.policy_frames import suggest_conversions
from oee_tabular.typing import (
    Array,
    BoolArray,
    IntArray,
    PolicyLike,
    SupportsArray,
)


class Sized(Protocol):
    """Describe a model with states and actions, such as a ``FiniteMDP``."""

    @property
    def n_states(self) -> int:
        """Return the number of states."""

    @property
    def n_actions(self) -> int:
        """Return the number of actions."""

    @property
    def terminal_state(self) -> IntArray:
        """Return where a transition that terminates on entering each state leads."""


@suggest_keywords
def check_policy(
    policy: PolicyLike,
    mdp: Sized,
    *,
    name: str = "policy",
    horizon: int | None = None,
) -> Array:
    """Check a policy in any of its forms and return it as a new array.

    A policy of the environment's own number of states is extended to the twins that
    termination appended, where any action does.

    Parameters
    ----------
    policy : PolicyLike
        Probabilities of shape (S, A), or (T, S, A) with a horizon T: nonnegative, each
        row sums to 1 (tolerance 1e-8; rows in single precision are scaled). Or (S,): an
        action for each state, by number or name. Or a mapping from states to actions,
        or to their distributions ((A,), or a mapping from actions to probabilities), in
        which terminal states may be left out. Or a function of a state that returns
        such, or a tuple that begins with the action, as (action, state) of other
        libraries' ``predict``; it is given a state's name, or its number where there
        are no names.
    mdp : FiniteMDP
        The model, or anything with ``n_states``, ``n_actions`` and ``terminal_state``.
    name : str, default 'policy'
        What errors call the policy.
    horizon : int, optional
        The number T of rewards. None means that only stationary policies are allowed.

    Returns
    -------
    ndarray of shape (S, A) or (T, S, A)
        The probabilities of the actions; each row sums to 1.

    Raises
    ------
    ValueError
        If the policy breaks a rule; the error has the place, the rule and the value.

    See Also
    --------
    uniform_policy : The policy that takes each action equally often.
    mix : A mixture of two policies.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mdp = oee.tasks.gridworld(2, slip=0.1)
    >>> check_policy([[1, 0, 0, 0]] * 4, mdp).shape
    (4, 4)
    >>> check_policy([1, 1, 3, 0], mdp)[2].tolist()
    [0.0, 0.0, 0.0, 1.0]
    >>> check_policy(lambda state: [0.5, 0.5, 0, 0], mdp)[0].tolist()
    [0.5, 0.5, 0.0, 0.0]
    >>> try:
    ...     check_policy([[0.5, 0.4, 0, 0]] * 4, mdp)
    ... except ValueError as error:
    ...     print(error)
    policy[0] must sum to 1 (tolerance 1e-08); it sums to 0.9 (4 such rows in all)
    """
    require_sized(mdp)
    _checks.instance(name, str, "name")
    horizon = _checks.optional_horizon(horizon)
    n_states = mdp.n_states
    n_actions = mdp.n_actions
    n_own = len(mdp.terminal_state)
    shapes = (n_states, n_actions), (horizon, n_states, n_actions)
    # most calls pass such an array, of which one compiled look suffices
    given: Any = policy
    is_float_array = type(given) is np.ndarray and given.dtype == np.float64
    if is_float_array and given.shape in shapes:
        array = np.array(given, order="C")
        if _are_distributions(array):
            if has_all_actions(mdp):
                return array
            return require_available(array, mdp, name)
    if not (isinstance(policy, np.ndarray) and policy.ndim > 1):
        given = policy_table(policy, mdp, name)
    array = _checks.float_array(given, name)
    if array.ndim == 1 and len(array) in (n_states, n_own):
        _refuse_rounded_actions(given, array, name)
    _require_policy_shape(array, (n_states, n_own), n_actions, horizon, name)
    array = _check_distributions(array, given, name)
    if array.shape[-2] < n_states:
        rows = uniform_policy(mdp)[n_own:]
        twins = np.broadcast_to(rows, (*array.shape[:-2], *rows.shape))
        array = np.concatenate([array, twins], axis=-2)
    return require_available(array, mdp, name)


def require_available(array: Array, mdp: Sized, name: str) -> Array:
    """Return (..., S, A) probabilities, 0 where an action cannot be taken.

    Another one is an ArgumentError that names state and action.
    """
    if has_all_actions(mdp):
        return array
    bad = np.argwhere((array > 0.0) & ~mdp.available)  # type: ignore[attr-defined]
    if len(bad):
        first = tuple(bad[0])
        names = names_of(mdp)
        state, action = first[-2:]
        more = _checks.in_all(len(bad), "such probabilities")
        raise ArgumentError(
            _checks.place(name, first),
            f"must be 0, for action {names.action(action)} cannot be taken in state"
            f" {names.state(state)}; it is {array[first]:g}{more} (mdp.available says"
            " which actions can: give the probability to these)",
        )
    return array


def _require_policy_shape(
    array: Array, sizes: tuple[int, int], n_actions: int, horizon: int | None, name: str
) -> None:
    """Raise an ArgumentError where an array has not the shape of a policy.

    ``sizes``: the numbers of states that it may have.
    """
    if array.shape == (sizes[0], n_actions):
        return
    allowed: list[tuple[int, ...]] = [(n, n_actions) for n in dict.fromkeys(sizes)]
    if horizon is not None:
        allowed += [(horizon, *shape) for shape in allowed]
    if array.shape not in allowed:
        rule = " or ".join(str(shape) for shape in allowed)
        raise ArgumentError(
            name,
            f"must have shape {rule} (states, actions); it has shape {array.shape}",
        )


def _refuse_rounded_actions(given: Any, array: Array, name: str) -> None:
    """Raise an ArgumentError for an action for each state that is no integer's type."""
    if (array == np.floor(array)).all():
        kind = np.asarray(_checks.plain_array(given, name)).dtype.name
        raise ArgumentError(
            name,
            f"must be integers where it has an action for each state; they are {kind}"
            " (of actions: numpy.asarray(policy).astype(int); of probabilities: a row for"
            " each state)",
        )


def _are_distributions(array: Array) -> bool:
    """Say whether the rows of an array in C's order are distributions.

    False is also the answer where rounding decides.
    """
    from oee_tabular.mdp._policies import is_stochastic_matrix

    rows = array.reshape(math.prod(array.shape[:-1]), array.shape[-1])
    # the tolerance is less by what the rounding of a sum may do
    return bool(is_stochastic_matrix(rows, 0.99 * _checks.SUM_TOLERANCE))


def _check_distributions(array: Array, given: object, name: str) -> Array:
    """Check that rows are distributions; those given in single precision are scaled."""
    if _are_distributions(np.ascontiguousarray(array)):
        return array
    array = _checks.scale_if_single(array, given)
    _checks.require_nonnegative(array, name)
    _checks.require_sums_to_one(np.asarray(array.sum(axis=-1)), name)
    return array


def check_policies(
    policies: Any, mdp: Sized, *, name: str = "policies", alone: str = "policy"
) -> dict[str, Array]:
    """Return a mapping from names to (S, A) policies.

    ``policies`` is one policy (then called ``alone``), a list of policies, or a mapping
    from names to policies. A mapping all of whose keys are states is one policy.
    """
    require_sized(mdp)
    several = split_policies(policies, mdp)
    named = {alone: policies} if several is None else several
    return {
        key: check_policy(policy, mdp, name=f"{name} {key!r}")
        for key, policy in named.items()
    }


def split_policies(policies: Any, mdp: Sized) -> dict[str, Any] | None:
    """Return the names and policies of several policies; None for one policy."""
    # a dok_array is a mapping
    if isinstance(policies, Mapping) and not _checks.is_sparse(policies):
        if _is_policy_by_state(policies, mdp):
            return None
        return {str(key): policy for key, policy in policies.items()}
    if isinstance(policies, list | tuple) and _is_list_of_policies(policies, mdp):
        return {f"policy {k}": policy for k, policy in enumerate(policies)}
    return None


def _is_policy_by_state(policies: Mapping[Any, Any], mdp: Sized) -> bool:
    """Say whether a mapping is one policy, from states to choices."""
    known = numbers_of(names_of(mdp).states or ())
    are_states = all(
        to_plain(key) in known or _checks.is_integer(key) for key in policies
    )
    has_tables = any(
        callable(value) or count_dimensions(value) >= 2 for value in policies.values()
    )
    return bool(policies) and are_states and not has_tables


def _is_list_of_policies(policies: Any, mdp: Sized) -> bool:
    """Say whether a list or tuple holds policies rather than the rows of one."""
    if not policies:
        return True
    first = policies[0]
    shape = shape_of(first)
    if callable(first) or isinstance(first, Mapping) or len(shape) >= 2:
        return True
    if len(shape) != 1:
        return False
    # it is an action for each state, or the first row of a table (S, A)
    sizes = (mdp.n_states, len(mdp.terminal_state))
    is_row = len(policies) in sizes and shape[0] == mdp.n_actions
    return shape[0] in sizes and not is_row


def uniform_policy(mdp: Sized) -> Array:
    """Return the policy that takes all actions of a state equally often.

    Parameters
    ----------
    mdp : FiniteMDP
        The model, or anything with ``n_states``, ``n_actions`` and ``terminal_state``.

    Returns
    -------
    ndarray of shape (S, A)
        The probabilities: 1/A, or 1 over the number of actions that can be taken in the
        state, and 0 for the others (``mdp.available``).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> uniform_policy(oee.tasks.gridworld(2, slip=0.1))[0].tolist()
    [0.25, 0.25, 0.25, 0.25]
    """
    require_sized(mdp)
    if has_all_actions(mdp):
        return np.full((mdp.n_states, mdp.n_actions), 1.0 / mdp.n_actions)
    available: BoolArray = mdp.available  # type: ignore[attr-defined]
    return np.asarray(available / available.sum(axis=1, keepdims=True))


def deterministic_policy(actions: Any, n_actions: int, name: str = "actions") -> Array:
    """Return the (S, A) policy that takes ``actions[s]`` in state s."""
    require_numbers(actions, n_actions, name)
    policy = np.zeros((len(actions), n_actions))
    policy[np.arange(len(actions)), actions.astype(np.int64)] = 1.0
    return policy


def mix(
    policy_a: SupportsArray | list[Any] | tuple[Any, ...],
    policy_b: SupportsArray | list[Any] | tuple[Any, ...],
    weight_of_a: float,
) -> Array:
    """Return weight_of_a * policy_a + (1 - weight_of_a) * policy_b.

    The mixture is taken action by action in each state.

    Parameters
    ----------
    policy_a, policy_b : array_like of shape (S, A) or (T, S, A)
        Probabilities of one shape, each row of which sums to 1. One of the policies may
        be (S,) numbers of actions where the other is (S, A).
    weight_of_a : float
        The weight of ``policy_a`` in [0, 1].

    Returns
    -------
    ndarray of shape (S, A) or (T, S, A)
        The mixture; each row sums to 1.

    Raises
    ------
    ValueError
        If a policy or the weight breaks a rule, or the policies have different shapes.

    See Also
    --------
    check_policy : Bring policies of other forms to an array.

    Examples
    --------
    >>> mix([[1.0, 0.0]], [[0.5, 0.5]], 0.6).tolist()
    [[0.8, 0.2]]
    """
    weight = _checks.number_in(weight_of_a, "weight_of_a", 0.0, 1.0)
    both = {"policy_a": policy_a, "policy_b": policy_b}
    given = {name: _checks.as_array(each, name) for name, each in both.items()}
    array_a = _check_mixed(policy_a, given["policy_a"], given["policy_b"], "policy_a")
    array_b = _check_mixed(policy_b, given["policy_b"], given["policy_a"], "policy_b")
    if array_a.shape != array_b.shape:
        raise ArgumentError(
            "policy_a and policy_b",
            f"must have one shape; they have {array_a.shape} and {array_b.shape}",
        )
    return np.asarray(weight * array_a + (1.0 - weight) * array_b)


def _check_mixed(
    policy: Any, given: NDArray[Any], other: NDArray[Any], name: str
) -> Array:
    """Check a policy of a mixture and return it as an array of probabilities.

    ``given`` is its array. It may be (S,) actions where the ``other`` is (S, A).
    """
    if given.ndim == 1 and given.dtype.kind in "iu" and other.ndim == 2:
        given = deterministic_policy(given, other.shape[1], name)
    array = _checks.float_array(given, name, ndim=(2, 3))
    return _check_distributions(array, policy, name)


def read_policy_array(path: str, name: str) -> Array:
    """Read the array that a .npy or .npz file holds."""
    arrays = _files.read_npz(path)
    kind = _files.npz_kind(arrays)
    if kind is not None:
        raise ArgumentError(
            name, f"must be a file with an (S, A) array; {path!r} holds a {kind}"
        )
    if "policy" not in arrays and len(arrays) != 1:
        raise ArgumentError(
            name,
            f"must be a file with one array, or one named 'policy'; {path!r} has"
            f" {sorted(arrays)}",
        )
    return arrays.get("policy", next(iter(arrays.values())))


def has_all_actions(mdp: object) -> bool:
    """Say whether each action can be taken in each state of a model."""
    has: bool = getattr(mdp, "has_all_actions", True)
    return has


def require_sized(mdp: object) -> None:
    """Raise an ArgumentError for what has no states and actions."""
    sizes = ("n_states", "n_actions", "terminal_state")
    is_sized = all(hasattr(mdp, size) for size in sizes)
    if isinstance(mdp, type) or not is_sized:
        raise ArgumentError("mdp", f"must be a FiniteMDP; got {type(mdp).__name__}")


def policy_table(policy: PolicyLike, mdp: Sized, name: str) -> Any:
    """Return actions, a mapping or a function as (S0, A) or (S, A).

    Anything else, arrays of probabilities among it, is returned as it is.
    """
    if isinstance(policy, str | bytes | int | np.integer) or policy is None:
        hint = (
            f"the same in every state: lambda state: {_checks.show(policy):.40}; a"
            " file: numpy.load"
        )
        if policy in ("uniform", "optimal"):
            hint = f"oee.{policy}_policy(simulator)"
        raise ArgumentError(
            name,
            f"must be an action, or a distribution, for each of the {mdp.n_states}"
            f" states; it is {_checks.show(policy)} ({hint})",
        )
    policy = _checks.to_native(policy)
    _refuse_models(policy, name)
    is_function = callable(policy) and not hasattr(policy, "__array__")
    if isinstance(policy, Mapping) or is_function:
        return _choice_table(policy, mdp, name)
    # xarray's say more than their order
    if hasattr(policy, "to_dict") and not hasattr(policy, "dims"):
        ways = "in the order of the states: policy.to_numpy()"
        if hasattr(policy, "iloc"):  # of pandas, which has labels
            ways = suggest_conversions(
                policy, names_of(mdp), mdp.n_states, mdp.n_actions
            )
        raise ArgumentError(
            name,
            f"must be an array or a mapping by state; got {type(policy).__name__}"
            f" ({ways})",
        )
    plain = _checks.plain_array(policy, name, "a policy's array")
    return _action_table(plain, mdp, name)


def _refuse_models(policy: Any, name: str) -> None:
    """Raise an ArgumentError for a trained model of another library, or a list of them.

    Such an object is no function; its method ``predict`` returns (action, state).
    """
    is_list = isinstance(policy, list | tuple) and len(policy) > 0
    model: Any = policy[0] if is_list else policy
    kind = type(model)
    is_model = callable(getattr(kind, "predict", None))
    if not is_model or callable(model) or hasattr(kind, "__array__"):
        return
    raise ArgumentError(
        name,
        "must be an array, a mapping by state, or a function of a state; got"
        f" {'a list of ' if is_list else ''}{kind.__name__}, which has a method predict"
        " (a function of it: lambda s: model.predict(s)[0])",
    )


def _choice_table(policy: Any, mdp: Sized, name: str) -> Array:
    """Return the (S, A) of a mapping or a function of the environment's own states.

    Terminal states may be left out.
    """
    names = names_of(mdp)
    n_own = len(mdp.terminal_state)
    # states whose actions need not be given
    is_free: BoolArray = np.zeros(mdp.n_states, dtype=np.bool_)
    if hasattr(mdp, "absorbing"):
        is_free = mdp.absorbing()
    table = np.full((mdp.n_states, mdp.n_actions), np.nan)
    states = (names.states or range(mdp.n_states))[:n_own]
    for state, choice, place in _list_choices(policy, states, name):
        s = number_of(state, names.states, mdp.n_states, f"{name}'s state")
        if not np.isnan(table[s, 0]):
            raise ArgumentError(
                f"{name}'s states",
                f"must differ; state {names.state(s)} is given twice",
            )
        if choice is not None or not is_free[s]:
            if isinstance(choice, tuple):
                choice = _choice_in_tuple(
                    choice,
                    names.actions,
                    mdp.n_actions,
                    place,
                    is_returned=not isinstance(policy, Mapping),
                )
            table[s] = _choice_row(choice, names.actions, mdp.n_actions, place)
    missing = np.flatnonzero((np.isnan(table[:, 0]) & ~is_free)[:n_own])
    if missing.size:
        more = _checks.in_all(len(missing), "such states")
        raise ArgumentError(
            name,
            "must have every state that is not terminal; state"
            f" {names.state(missing[0])} is not there{more}",
        )
    return np.where(np.isnan(table), uniform_policy(mdp), table)


def _list_choices(
    policy: Any, states: Any, name: str
) -> Iterator[tuple[Any, Any, str]]:
    """Yield each state with its choice and what errors call that.

    The states are those of a mapping, or ``states``.
    """
    if isinstance(policy, Mapping):
        for state, choice in policy.items():
            yield state, choice, f"{name}[{_checks.show(state)}]"
        return
    for state in states:
        place = f"{name}({_checks.show(state)})"
        try:
            choice = policy(state)
        except Exception as error:
            reason = _checks.escape_controls(str(error))
            raise ArgumentError(
                place,
                "must be an action or a distribution; it raises"
                f" {type(error).__name__}: {reason:.300}",
            ) from error
        yield state, choice, place


def _choice_in_tuple(
    choice: tuple[Any, ...],
    names: tuple[Name, ...] | None,
    n_actions: int,
    place: str,
    *,
    is_returned: bool,
) -> Any:
    """Return the action of a tuple (action, state, ...), or the tuple itself.

    Models return such. A tuple of floats is a distribution, and so is one of any
    numbers unless it ``is_returned`` by a function. A tuple may also be a name.
    """
    if len(choice) < 2 or _is_action(to_plain(choice), names):
        return choice
    integers = [_single_integer(part) for part in choice]
    are_integers = None not in integers
    if integers[0] is None:
        begins_with_name = _is_action(to_plain(choice[0]), names) and names is not None
        if begins_with_name:
            return choice[0]
        is_odd = any(part is None or isinstance(part, bool) for part in choice)
        are_floats = not is_odd and all(number is None for number in integers)
        if not is_returned or are_floats:
            return choice
    elif not is_returned and all(isinstance(part, int | float) for part in choice):
        return choice
    elif not (are_integers and len(choice) == n_actions):
        return integers[0]
    raise ArgumentError(
        place,
        "must be an action, (action, state), or a distribution as a list of floats; it"
        f" is {_checks.show(choice)} (of a distribution: return a list; of an action:"
        " return it alone)",
    )


def _single_integer(part: Any) -> int | None:
    """Return an integer, or that in an array of one; None for anything else."""
    if _checks.is_integer(part):
        return int(part)
    if not hasattr(part, "__array__") or not hasattr(part, "dtype"):
        return None
    try:
        array = np.asarray(_checks.plain_array(part, "action"))
    except ArgumentError:  # masked, or with a unit
        return None
    if array.size != 1 or array.dtype.kind not in "iu":
        return None
    return int(array.reshape(-1)[0])


def _choice_row(
    choice: Any, names: tuple[Name, ...] | None, n_actions: int, name: str
) -> Array:
    """Return an action, a mapping from actions to probabilities, or a row, as (A,)."""
    row = np.zeros(n_actions)
    if hasattr(choice, "__array__") and type(choice) is not np.ndarray:
        choice = _checks.plain_array(choice, name, "an action or a distribution")
    given = to_plain(choice)
    is_named = isinstance(choice, str | tuple) and _is_action(given, names)
    if isinstance(choice, Mapping):
        for action, probability in choice.items():
            a = number_of(action, names, n_actions, f"{name}'s action")
            row[a] += _checks.number_in(
                probability, f"{name}[{_checks.show(action)}]", 0.0, 1.0
            )
    elif is_named or _checks.is_integer(given):
        row[number_of(given, names, n_actions, name)] = 1.0
    elif _has_more_than_numbers(choice):
        raise ArgumentError(
            name,
            f"must be an action, or a distribution over the {n_actions} actions; it is"
            f" {_checks.show(choice)} (of an action with something beside it: return"
            " the action alone, as in lambda s: model.predict(s)[0])",
        )
    elif shape_of(choice) == (n_actions,):
        row = _checks.float_array(choice, name, ndim=1)
    else:
        rule = f"an action, or a distribution over the {n_actions} actions"
        is_rounded = isinstance(choice, float | bool | np.floating | np.bool_)
        hint = " (an action is an integer: int(action))" if is_rounded else ""
        raise ArgumentError(name, f"must be {rule}; it is {_checks.show(choice)}{hint}")
    return _check_distributions(row, choice, name)


def _has_more_than_numbers(choice: Any) -> bool:
    """Say whether a list is an action with something else, or has None in it.

    So are (action, state) of other libraries where they come as a list or an array.
    """
    if isinstance(choice, np.ndarray):
        if choice.ndim != 1 or not choice.dtype.hasobject:
            return False
        choice = choice.tolist()
    if not isinstance(choice, list | tuple) or len(choice) < 2:
        return False
    if any(part is None for part in choice):
        return True
    others = (Mapping, str, bytes, list, tuple)
    return _single_integer(choice[0]) is not None and any(
        isinstance(part, others) or getattr(part, "size", 1) != 1 for part in choice[1:]
    )


def _action_table(policy: PolicyLike, mdp: Sized, name: str) -> Any:
    """Return the (S, A) of an action for each state, by number or name.

    Anything else is returned as it is.
    """
    names = names_of(mdp).actions
    n_actions = mdp.n_actions
    array: Any
    try:
        array = np.asarray(policy)
    except (TypeError, ValueError):  # names of several lengths
        array = np.zeros((0, 0))
    is_numeric = array.ndim == 2 and array.dtype.kind in "biuf"
    if array.ndim == 0 or (is_numeric and array.shape[1] == n_actions):
        return policy
    actions: Any = policy
    are_numbers = array.ndim == 1 and array.dtype.kind in "iu"
    if not are_numbers and not all(_is_action(action, names) for action in actions):
        return policy
    if len(actions) not in (mdp.n_states, len(mdp.terminal_state)):
        return policy
    if not are_numbers:
        array = np.array(
            [
                number_of(action, names, n_actions, f"{name}[{s}]")
                for s, action in enumerate(actions)
            ]
        )
    return deterministic_policy(array, n_actions, name)


def _is_action(action: object, names: tuple[Name, ...] | None) -> bool:
    """Say whether an action is given as a text, or as a tuple that is a name."""
    if isinstance(action, tuple):
        return is_name(action) and action in numbers_of(names or ())
    return isinstance(action, str)


def count_dimensions(value: Any) -> int:
    """Return the number of dimensions of an array; 0 for anything else."""
    return len(shape_of(value))


def shape_of(value: Any) -> tuple[int, ...]:
    """Return the shape of an array, or of lists that make one; () for anything else."""
    if isinstance(value, range):
        return (length_of_range(value),)  # numpy would make an array of it
    is_list = isinstance(value, list | tuple)
    if is_list and count_in_ranges(value) > MAX_SEQUENCE:
        return ()
    try:
        return () if isinstance(value, Mapping) else np.shape(value)
    except Exception:  # another library's object may raise anything
        return ()
